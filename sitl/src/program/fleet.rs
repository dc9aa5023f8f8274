//! Many vehicles in one process: each with its own system id, seed and obstacle, on its own ports or on
//! shared ones.

use nalgebra::Vector2;
use rand::RngExt;

use crate::link::endpoint::Endpoint;
use crate::scenario::Scenario;
use crate::world::noise::{Noise, Stream};

/// Number of system ids. Most ground stations have the last one, 255, with other component ids.
pub const MAX_VEHICLES: usize = 255;

/// The scenario of vehicle `index`: the first has it as it is, each other one its first obstacle
/// elsewhere, where it blocks neither start nor goal. A function of the seed and the index alone.
#[must_use]
pub fn scenario(base: &Scenario, seed: u64, index: usize) -> Scenario {
    let mut scenario = base.clone();
    let Some(obstacle) = scenario.obstacles.first_mut().filter(|_| index > 0) else { return scenario };
    let margin = obstacle.margin;
    let mut rng = Noise::new(seed).generator(Stream::Start, index as u64);
    let mut places =
        std::iter::repeat_with(|| Vector2::from_fn(|_, _| rng.random_range(margin..=1.0 - margin)));
    let reach = obstacle.radius + base.uav_radius + base.goal_radius.max(base.safety.d_min);
    let is_free =
        |place: &Vector2<f64>| (place - base.start).norm() > reach && (place - base.goal).norm() > reach;
    // An obstacle so large that it fits nowhere stays where it is.
    if let Some(place) = places.by_ref().take(1000).find(is_free) {
        obstacle.position = place;
        scenario.name = format!("{}, obstacle {index}", base.name);
    }
    scenario
}

/// The endpoints of vehicle `index` when each has its own: as many ports further; `None` beyond the
/// last port.
#[must_use]
pub fn endpoints(base: &[Endpoint], index: usize) -> Option<Vec<Endpoint>> {
    base.iter().map(|endpoint| endpoint.further(u16::try_from(index).ok()?)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_has_its_own_obstacle_which_blocks_nothing_and_is_always_the_same() {
        let base = Scenario::default();
        assert_eq!(scenario(&base, 5, 0), base);
        let all: Vec<Scenario> = (0..MAX_VEHICLES).map(|index| scenario(&base, 5, index)).collect();
        for (index, one) in all.iter().enumerate().skip(1) {
            one.check().unwrap();
            assert_eq!(*one, scenario(&base, 5, index));
            assert_ne!(one.obstacle().position, all[index - 1].obstacle().position);
            assert!((one.obstacle().position - base.start).norm() > 0.12, "{index}");
        }
        let mut wide = base;
        wide.obstacles[0].radius = 1.0;
        assert_eq!(scenario(&wide, 5, 1).obstacles, wide.obstacles);
    }

    #[test]
    fn each_has_its_own_ports() {
        let base: Vec<Endpoint> =
            ["udpin:127.0.0.1:14550", "tcpin:127.0.0.1:5760"].map(|t| t.parse().unwrap()).into();
        let shown: Vec<String> = endpoints(&base, 3).unwrap().iter().map(Endpoint::to_string).collect();
        assert_eq!(shown, ["udpin:127.0.0.1:14553", "tcpin:127.0.0.1:5763"]);
        let last: Vec<Endpoint> = vec!["udpin:127.0.0.1:65535".parse().unwrap()];
        assert_eq!(endpoints(&last, 1), None);
    }
}
