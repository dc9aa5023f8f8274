//! Where the obstacles are, one or two, and what they do together to risk and radio.
//!
//! The paper has one. With two, a collision is one with either, and the channel is that of the obstacle
//! which blocks more: NLOS is a state of the link, and a second obstacle in the same sight line makes
//! it no more so (our choice; docs/choices.md).

use nalgebra::Vector2;

use super::{channel, safety};
use crate::scenario::{Obstacle, Scenario};

/// Centres, paper units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Obstacles {
    /// r_u
    pub first: Vector2<f64>,
    /// The second one's, in a scenario that has one.
    pub second: Option<Vector2<f64>>,
}

impl Obstacles {
    /// Centre and parameters of each.
    fn each<'a>(&self, scenario: &'a Scenario) -> impl Iterator<Item = (Vector2<f64>, &'a Obstacle)> {
        let second = self.second.zip(scenario.second_obstacle.as_ref());
        std::iter::once((self.first, &scenario.obstacle)).chain(second)
    }

    /// |h|² from the base station to `uav`: the smallest that one of them leaves.
    #[must_use]
    pub fn gain(&self, uav: Vector2<f64>, scenario: &Scenario) -> f64 {
        self.each(scenario)
            .map(|(centre, o)| channel::gain(uav, centre, o.radius, &scenario.channel))
            .fold(f64::INFINITY, f64::min)
    }

    /// Blockage probability of the sight line to `uav`: the largest of theirs.
    #[must_use]
    pub fn blockage(&self, uav: Vector2<f64>, scenario: &Scenario) -> f64 {
        self.each(scenario)
            .map(|(centre, o)| channel::blockage(uav, centre, o.radius, &scenario.channel))
            .fold(0.0, f64::max)
    }

    /// Boundary distance between `uav` and the nearer one.
    #[must_use]
    pub fn clearance(&self, uav: Vector2<f64>, scenario: &Scenario) -> f64 {
        self.each(scenario)
            .map(|(centre, o)| safety::clearance(uav, centre, scenario.uav_radius, o.radius))
            .fold(f64::INFINITY, f64::min)
    }

    /// p_coll = 1 - Π (1 - p_i).
    #[must_use]
    pub fn collision_probability(&self, uav: Vector2<f64>, scenario: &Scenario) -> f64 {
        let (d_min, softness) = (scenario.safety.d_min, scenario.safety.softness);
        self.each(scenario)
            .map(|(centre, o)| safety::clearance(uav, centre, scenario.uav_radius, o.radius))
            .map(|clearance| safety::collision_probability(clearance, d_min, softness))
            // From 0 on, so that one obstacle's p stays as it is to the last bit.
            .fold(0.0, |all, p| all + p * (1.0 - all))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> Scenario {
        Scenario::from_toml("[second_obstacle]\nposition = [0.5, 0.8]\n").unwrap()
    }

    #[test]
    fn one_obstacle_is_the_papers_to_the_last_bit() {
        let s = Scenario::default();
        let (uav, first) = (Vector2::new(0.41, 0.52), s.obstacle.position);
        let alone = Obstacles { first, second: None };
        let clearance = safety::clearance(uav, first, s.uav_radius, s.obstacle.radius);
        assert_eq!(alone.gain(uav, &s), channel::gain(uav, first, s.obstacle.radius, &s.channel));
        assert_eq!(alone.clearance(uav, &s), clearance);
        let p = safety::collision_probability(clearance, s.safety.d_min, s.safety.softness);
        assert_eq!(alone.collision_probability(uav, &s), p);
    }

    #[test]
    fn either_one_blocks_and_either_one_collides() {
        let s = two();
        let (first, second) = (s.obstacle.position, s.second_obstacle.as_ref().unwrap().position);
        let both = Obstacles { first, second: Some(second) };
        let without = Obstacles { first, second: None };
        // Beyond the second, whose shadow the first one's does not reach.
        let s_off = {
            let mut s = s.clone();
            s.channel.base_station = Vector2::new(0.95, 0.8);
            s
        };
        let uav = Vector2::new(0.2, 0.8);
        assert!(both.gain(uav, &s_off) < 0.2 * without.gain(uav, &s_off));
        // In both shadows the channel is no worse than in one.
        let (uav, alone) = (Vector2::new(0.5, 0.97), Obstacles { first: second, second: None });
        assert_eq!(both.gain(uav, &s), without.gain(uav, &s).min(alone.gain(uav, &s)));
        // At contact with one, far from the other: one half; between two contacts: three quarters.
        let near = Vector2::new(0.5 + s.obstacle.radius + s.uav_radius, 0.8);
        assert!((both.collision_probability(near, &s) - 0.5).abs() < 1e-5);
        let close = Obstacles { first: near + Vector2::new(0.12, 0.0), second: Some(second) };
        assert!((close.collision_probability(near, &s) - 0.75).abs() < 1e-6);
        assert!((both.clearance(near, &s)).abs() < 1e-12);
    }
}
