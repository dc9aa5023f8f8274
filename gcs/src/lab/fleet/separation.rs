//! Vehicles of one base station keep clear of each other: it commands all of them, so it knows where all of them say
//! they are.
//!
//! The learned encoder knows one UAV and its obstacles by their colours; it sees no other vehicle. So this rule reads
//! reports: a controller's wish stands where the vehicle, on the wish and then straight on, stays clear of what the
//! others do straight on; else the nearest action that does, and of two equally near ones that to the right.

use crpl_sitl::Scenario;
use crpl_sitl::units::Motion;
use crpl_sitl::world::dynamics::{State, limit_speed};
use crpl_sitl::world::obstacles::Obstacles;
use nalgebra::Vector2;

use crate::station::pilot::reactive::constrained_clearance;

/// How far ahead it looks, intervals: as RCC does (our choice).
const STEPS: u32 = 12;
/// What a turn to the left costs beside one to the right, in squares of a normalised acceleration.
const LEFT: f64 = 0.01;

/// The rule for one kind of vehicle.
#[derive(Debug, Clone)]
pub struct Separation<'a> {
    scenario: &'a Scenario,
    /// Least distance of two centres, units.
    keep: f64,
}

impl<'a> Separation<'a> {
    /// Two vehicles keep from each other what one keeps from an obstacle: the clearance at which p_coll = δ1.
    #[must_use]
    pub fn of(scenario: &'a Scenario) -> Self {
        let keep = 2.0 * scenario.uav_radius + constrained_clearance(&scenario.safety);
        Self { scenario, keep }
    }

    /// The normalised acceleration to fly in place of `wish`.
    #[must_use]
    pub fn of_wish(
        &self,
        own: State,
        wish: Vector2<f64>,
        others: &[State],
        obstacles: &Obstacles,
    ) -> Vector2<f64> {
        if others.is_empty() || self.apart(own, wish, others) >= self.keep {
            return wish;
        }
        let scores = Motion::ALL.map(|motion| self.score(own, motion.vector(), wish, others, obstacles));
        let best = (0..scores.len()).min_by(|a, b| scores[*a].total_cmp(&scores[*b])).unwrap_or(0);
        Motion::ALL[best].vector()
    }

    fn score(
        &self,
        own: State,
        a: Vector2<f64>,
        wish: Vector2<f64>,
        others: &[State],
        obstacles: &Obstacles,
    ) -> f64 {
        let left = if own.v.perp(&a) > 0.0 { LEFT } else { 0.0 };
        let short = (self.keep - self.apart(own, a, others)).max(0.0) + self.lacks(own, a, obstacles);
        (a - wish).norm_squared() + left + 1000.0 * short
    }

    fn speed(&self, own: State, a: Vector2<f64>) -> Vector2<f64> {
        let dynamics = &self.scenario.dynamics;
        limit_speed(own.v + dynamics.a_max * a, dynamics.v_max)
    }

    /// Least distance to another vehicle.
    fn apart(&self, own: State, a: Vector2<f64>, others: &[State]) -> f64 {
        let v = self.speed(own, a);
        let far = |other: &State| {
            let at = |j: u32| (own.r - other.r + f64::from(j) * (v - other.v)).norm();
            (1..=STEPS).map(at).fold(f64::INFINITY, f64::min)
        };
        others.iter().map(far).fold(f64::INFINITY, f64::min)
    }

    /// How much the way lacks of the clearance to an obstacle, units.
    fn lacks(&self, own: State, a: Vector2<f64>, obstacles: &Obstacles) -> f64 {
        let v = self.speed(own, a);
        let least = constrained_clearance(&self.scenario.safety);
        let clear = |j: u32| obstacles.clearance(own.r + f64::from(j) * v, self.scenario);
        (least - (1..=STEPS).map(clear).fold(f64::INFINITY, f64::min)).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(r: [f64; 2], v: [f64; 2]) -> State {
        State { r: r.into(), v: v.into() }
    }

    #[test]
    fn a_wish_that_comes_near_nobody_stands() {
        let scenario = Scenario::default();
        let rule = Separation::of(&scenario);
        let own = state([0.2, 0.3], [0.02, 0.0]);
        let wish = Vector2::new(0.3, -0.2);
        let nobody = Obstacles::default();
        assert_eq!(rule.of_wish(own, wish, &[], &nobody), wish);
        assert_eq!(rule.of_wish(own, wish, &[state([0.8, 0.8], [-0.02, 0.0])], &nobody), wish);
    }

    #[test]
    fn two_that_meet_head_on_pass_each_other_on_the_right() {
        let scenario = Scenario::default();
        let rule = Separation::of(&scenario);
        let (mut a, mut b) = (state([0.3, 0.3], [0.02, 0.0]), state([0.7, 0.3], [-0.02, 0.0]));
        let (mut nearest, mut alone) = (f64::INFINITY, f64::INFINITY);
        for k in 0..16 {
            let coast = Vector2::zeros();
            let nobody = Obstacles::default();
            let (of_a, of_b) = (rule.of_wish(a, coast, &[b], &nobody), rule.of_wish(b, coast, &[a], &nobody));
            let step = |s, w| crpl_sitl::world::dynamics::step(s, w, coast, &scenario.dynamics);
            (a, b) = (step(a, of_a), step(b, of_b));
            nearest = nearest.min((a.r - b.r).norm());
            alone = alone.min((0.4 - 0.04 * f64::from(k)).abs());
        }
        assert!(alone < 0.01 && nearest > 2.0 * scenario.uav_radius + scenario.safety.d_min, "{nearest}");
        // To the right of the way east is south, smaller y.
        assert!(a.r.y < 0.3 && b.r.y > 0.3, "{a:?} {b:?}");
    }
}
