//! Where the radio reaches in a scenario, and what a flight straight to the goal would need.

use crpl_sitl::Scenario;
use crpl_sitl::scenario::Rule;
use crpl_sitl::units::TxPower;
use crpl_sitl::world::obstacles::Obstacles;
use crpl_sitl::world::{World, channel};
use nalgebra::Vector2;
use serde::Serialize;

/// Points of the straight line that are looked at.
const POINTS: u32 = 1000;
/// Blockage from which a place counts as in the shadow.
const SHADOW: f64 = 0.5;

/// The least power that carries a packet to a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum PowerReach {
    /// Low power does.
    Low,
    /// High power does.
    High,
    /// None does.
    Nothing,
}

/// The radio field of a scenario at its beginning.
#[derive(Debug)]
pub struct RadioField<'a> {
    scenario: &'a Scenario,
    /// Where the obstacles are.
    pub obstacles: Obstacles,
}

/// The straight line from start to goal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StraightLine {
    /// Units.
    pub length: f64,
    /// The least transmit power that carries every packet on it, units of the paper (low is 1, high is 4).
    pub least_power: f64,
    /// Share of it that low power serves.
    pub low: f64,
    /// Share of it that needs high power.
    pub high: f64,
    /// Share of it that no power serves.
    pub nothing: f64,
    /// Share of it in the shadow of an obstacle.
    pub shadow: f64,
    /// Distance between the UAV's and the nearest obstacle's edge, units; negative: it flies through. `None` without
    /// obstacles.
    pub clearance: Option<f64>,
}

impl<'a> RadioField<'a> {
    /// That of a scenario.
    #[must_use]
    pub fn of(scenario: &'a Scenario) -> Self {
        Self { scenario, obstacles: World::new(scenario).obstacles() }
    }

    /// The least power that carries a packet to `place`.
    #[must_use]
    pub fn reach(&self, place: Vector2<f64>) -> PowerReach {
        let fails = |power: TxPower| {
            let snr = channel::snr(self.gain(place), power.level(), &self.scenario.channel);
            channel::outage(self.scenario.radio.b_dt, snr, self.scenario.radio.packet_bits)
        };
        match () {
            () if self.scenario.radio.rule == Rule::Ideal || !fails(TxPower::Low) => PowerReach::Low,
            () if !fails(TxPower::High) => PowerReach::High,
            () => PowerReach::Nothing,
        }
    }

    /// Whether an obstacle blocks the sight line to `place`.
    #[must_use]
    pub fn is_shadow(&self, place: Vector2<f64>) -> bool {
        self.obstacles.blockage(place, self.scenario) >= SHADOW
    }

    /// Which obstacle covers `place`, if one does.
    #[must_use]
    pub fn obstacle_at(&self, place: Vector2<f64>) -> Option<usize> {
        self.obstacles.each(self.scenario).position(|(centre, o)| (place - centre).norm() <= o.radius)
    }

    fn gain(&self, place: Vector2<f64>) -> f64 {
        self.obstacles.gain(place, self.scenario)
    }

    /// What a flight straight to the goal meets, the obstacles where they begin.
    #[must_use]
    pub fn straight_line(&self) -> StraightLine {
        let Scenario { start, goal, radio, channel: radio_channel, .. } = self.scenario;
        let points: Vec<Vector2<f64>> =
            (0..=POINTS).map(|n| start.lerp(goal, f64::from(n) / f64::from(POINTS))).collect();
        let share = |is: &dyn Fn(Vector2<f64>) -> bool| {
            points.iter().filter(|place| is(**place)).count() as f64 / points.len() as f64
        };
        let weakest = points.iter().map(|place| self.gain(*place)).fold(f64::INFINITY, f64::min);
        let needed = channel::outage_snr(radio.b_dt, radio.packet_bits).0;
        let clearance = points
            .iter()
            .map(|place| self.obstacles.clearance(*place, self.scenario))
            .fold(f64::INFINITY, f64::min);
        StraightLine {
            length: (goal - start).norm(),
            least_power: needed * radio_channel.noise_power / weakest,
            low: share(&|place| self.reach(place) == PowerReach::Low),
            high: share(&|place| self.reach(place) == PowerReach::High),
            nothing: share(&|place| self.reach(place) == PowerReach::Nothing),
            shadow: share(&|place| self.is_shadow(place)),
            clearance: clearance.is_finite().then_some(clearance),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_power_of_the_line_is_the_edge_between_reach_and_outage() {
        let mut scenario = Scenario::named("demo").unwrap();
        let line = RadioField::of(&scenario).straight_line();
        assert!((line.low + line.high + line.nothing - 1.0).abs() < 1e-9);
        // With that power in place of low power, every packet on the line gets through; with less, one does not.
        for (factor, all) in [(1.001, true), (0.999, false)] {
            scenario.channel.noise_power =
                Scenario::named("demo").unwrap().channel.noise_power / (line.least_power * factor);
            let again = RadioField::of(&scenario).straight_line();
            assert_eq!(again.low == 1.0, all, "{factor}: {again:?}");
        }
    }

    #[test]
    fn an_ideal_radio_reaches_everywhere() {
        let scenario = Scenario::named("1-ideal").unwrap();
        let field = RadioField::of(&scenario);
        assert_eq!(field.reach(Vector2::new(0.02, 0.02)), PowerReach::Low);
        assert_eq!(field.straight_line().low, 1.0);
    }
}
