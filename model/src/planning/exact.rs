//! A head that is the simulator's own equation, read through the probe: with it in place of a learned
//! head, Algorithm 1 shows what learning the heads costs. No flight and no shipped policy uses it.

use crpl_sitl::Scenario;
use crpl_sitl::world::{channel, safety};
use nalgebra::Vector2;

use crate::encoder::probe::Probe;
use crate::numeric::kernel::{LANES, Lane, ZERO};

/// Step of the central differences, latent units: a hundred-thousandth of the frame's side or so, small
/// beside every softness and large beside f64's rounding.
const STEP: f64 = 1e-4;

/// The quantity of an exact head.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Logit of the collision probability.
    CollisionLogit,
    /// ln(|h|²/P_n)
    LogGain,
}

/// The equation of one quantity in one scenario.
#[derive(Debug, Clone)]
pub struct Exact {
    quantity: Quantity,
    probe: Probe,
    scenario: Scenario,
}

impl Exact {
    /// The equation; `probe` maps latents to positions.
    #[must_use]
    pub fn new(quantity: Quantity, probe: Probe, scenario: Scenario) -> Self {
        Self { quantity, probe, scenario }
    }

    /// Its value for `[y_c, y_u]`.
    fn at(&self, y: [f64; 4]) -> f64 {
        let s = &self.scenario;
        let uav = self.probe.c.apply(Vector2::new(y[0], y[1]));
        let obstacle = self.probe.u.apply(Vector2::new(y[2], y[3]));
        match self.quantity {
            Quantity::CollisionLogit => {
                let clearance = safety::clearance(uav, obstacle, s.uav_radius, s.obstacle().radius);
                (s.safety.d_min - clearance) / s.safety.softness
            }
            Quantity::LogGain => {
                (channel::gain(uav, obstacle, s.obstacle().radius, &s.channel) / s.channel.noise_power).ln()
            }
        }
    }

    /// Its value for all lanes.
    pub(super) fn value(&self, y: &[Lane; 4]) -> Lane {
        std::array::from_fn(|l| self.at(lane(y, l)) as f32)
    }

    /// Gradient with respect to y_c, by central differences.
    pub(super) fn gradient(&self, y: &[Lane; 4]) -> [Lane; 2] {
        let mut slope = [ZERO; 2];
        for l in 0..LANES {
            for axis in 0..2 {
                let moved = |by: f64| {
                    let mut y = lane(y, l);
                    y[axis] += by;
                    self.at(y)
                };
                slope[axis][l] = ((moved(STEP) - moved(-STEP)) / (2.0 * STEP)) as f32;
            }
        }
        slope
    }
}

fn lane(y: &[Lane; 4], l: usize) -> [f64; 4] {
    std::array::from_fn(|i| f64::from(y[i][l]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encoder::BuiltIn;
    use crate::world_model::WorldModel;

    #[test]
    fn it_is_the_simulators_equation_and_its_slope() {
        let world = WorldModel::built_in(BuiltIn::Centroid).unwrap();
        let scenario = Scenario::default();
        let (r, o) = (Vector2::new(0.4, 0.31), scenario.obstacle().position);
        let (y_c, y_u) = (world.probe.c.invert(r).unwrap(), world.probe.u.invert(o).unwrap());
        let y: [Lane; 4] = [y_c.x, y_c.y, y_u.x, y_u.y].map(|y| [y as f32; LANES]);
        let head = |quantity| Exact::new(quantity, world.probe, scenario.clone());

        let logit = f64::from(head(Quantity::CollisionLogit).value(&y)[0]);
        let clearance = safety::clearance(r, o, scenario.uav_radius, scenario.obstacle().radius);
        let p = safety::collision_probability(clearance, scenario.safety.d_min, scenario.safety.softness);
        assert!((channel::sigmoid(logit) - p).abs() < 1e-5, "{logit} {p}");

        // Moving a hundredth away from the obstacle lowers the logit by 0.01/τ_c.
        let away = (r - o).normalize() * 0.01;
        let step = world.probe.c.invert(r + away).unwrap() - y_c;
        let slope = head(Quantity::CollisionLogit).gradient(&y);
        let change = f64::from(slope[0][0]) * step.x + f64::from(slope[1][0]) * step.y;
        assert!((change + 0.01 / scenario.safety.softness).abs() < 1e-3, "{change}");
    }

    #[test]
    fn the_gain_is_the_simulators_over_its_noise() {
        let world = WorldModel::built_in(BuiltIn::Centroid).unwrap();
        let mut scenario = Scenario::default();
        scenario.channel.noise_power *= 3.0;
        let (r, o) = (Vector2::new(0.4, 0.31), scenario.obstacle().position);
        let (y_c, y_u) = (world.probe.c.invert(r).unwrap(), world.probe.u.invert(o).unwrap());
        let y: [Lane; 4] = [y_c.x, y_c.y, y_u.x, y_u.y].map(|y| [y as f32; LANES]);
        let found = f64::from(Exact::new(Quantity::LogGain, world.probe, scenario.clone()).value(&y)[0]);
        let snr =
            channel::gain(r, o, scenario.obstacle().radius, &scenario.channel) / scenario.channel.noise_power;
        assert!((found - snr.ln()).abs() < 1e-3, "{found} instead of {}", snr.ln());
    }
}
