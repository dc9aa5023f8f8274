//! A scenario's obstacles as one list, and what they do together to collision risk and radio.
//!
//! The paper has one obstacle. With several, a collision is one with any of them, and the channel is
//! that of the obstacle which blocks most: NLOS is a state of the link, and a further obstacle in the
//! same sight line does not change it (our choice; docs/choices.md). With none, the sight line is free
//! and the collision probability is 0.

use nalgebra::Vector2;

use super::{channel, safety};
use crate::scenario::{Obstacle, Scenario};
pub use crate::units::{MAX_OBSTACLES, Obstacles, PerObstacle};

impl Obstacles {
    /// Centre and parameters of each.
    pub fn each<'a>(&self, scenario: &'a Scenario) -> impl Iterator<Item = (Vector2<f64>, &'a Obstacle)> {
        self.iter().copied().zip(&scenario.obstacles)
    }

    /// |h|² from the base station to `uav`: the smallest that one of them leaves; that of a free sight
    /// line where there is none.
    #[must_use]
    pub fn gain(&self, uav: Vector2<f64>, scenario: &Scenario) -> f64 {
        self.each(scenario)
            .map(|(centre, o)| channel::gain(uav, centre, o.radius, &scenario.channel))
            .reduce(f64::min)
            .unwrap_or_else(|| channel::los_gain(uav, &scenario.channel))
    }

    /// Blockage probability of the sight line to `uav`: the largest of theirs, 0 where there is none.
    #[must_use]
    pub fn blockage(&self, uav: Vector2<f64>, scenario: &Scenario) -> f64 {
        self.each(scenario)
            .map(|(centre, o)| channel::blockage(uav, centre, o.radius, &scenario.channel))
            .fold(0.0, f64::max)
    }

    /// Boundary distance between `uav` and the nearest one, units; infinite where there is none.
    #[must_use]
    pub fn clearance(&self, uav: Vector2<f64>, scenario: &Scenario) -> f64 {
        self.each(scenario)
            .map(|(centre, o)| safety::clearance(uav, centre, scenario.uav_radius, o.radius))
            .fold(f64::INFINITY, f64::min)
    }

    /// p_coll = 1 - Π (1 - p_i); 0 where there is none.
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

    /// The default obstacle and one at (0.5, 0.8).
    fn two() -> Scenario {
        Scenario::from_toml("[[obstacle]]\n[[obstacle]]\nposition = [0.5, 0.8]\n").unwrap()
    }

    #[test]
    fn one_obstacle_is_the_papers_to_the_last_bit() {
        let s = Scenario::default();
        let Obstacle { position: first, radius, .. } = *s.obstacle();
        let (uav, alone) = (Vector2::new(0.41, 0.52), Obstacles::from([first]));
        let clearance = safety::clearance(uav, first, s.uav_radius, radius);
        assert_eq!(alone.gain(uav, &s), channel::gain(uav, first, radius, &s.channel));
        assert_eq!(alone.clearance(uav, &s), clearance);
        let p = safety::collision_probability(clearance, s.safety.d_min, s.safety.softness);
        assert_eq!(alone.collision_probability(uav, &s), p);
    }

    #[test]
    fn none_blocks_nothing_and_none_collides() {
        let s = Scenario::from_toml("obstacle = []").unwrap();
        let (uav, none) = (Vector2::new(0.5, 0.45), Obstacles::default());
        assert_eq!(none.gain(uav, &s), channel::los_gain(uav, &s.channel));
        assert_eq!([none.blockage(uav, &s), none.collision_probability(uav, &s)], [0.0; 2]);
    }

    #[test]
    fn either_one_blocks_and_either_one_collides() {
        let s = two();
        let [first, second] = [0, 1].map(|n: usize| s.obstacles[n].position);
        let (both, without) = (Obstacles::from([first, second]), Obstacles::from([first]));
        // Beyond the second, whose shadow the first one's does not reach.
        let s_off = {
            let mut s = s.clone();
            s.channel.base_station = Vector2::new(0.95, 0.8);
            s
        };
        let uav = Vector2::new(0.2, 0.8);
        assert!(both.gain(uav, &s_off) < 0.2 * without.gain(uav, &s_off));
        // In both shadows the channel is no worse than in one.
        let (uav, alone) = (Vector2::new(0.5, 0.97), Obstacles::from([second]));
        assert_eq!(both.gain(uav, &s), without.gain(uav, &s).min(alone.gain(uav, &s)));
        // At contact with one, far from the other: one half; between two contacts: three quarters.
        let near = Vector2::new(0.5 + s.obstacles[0].radius + s.uav_radius, 0.8);
        assert!((both.collision_probability(near, &s) - 0.5).abs() < 1e-5);
        let close = Obstacles::from([near + Vector2::new(0.12, 0.0), second]);
        assert!((close.collision_probability(near, &s) - 0.75).abs() < 1e-6);
        assert!((both.clearance(near, &s)).abs() < 1e-12);
    }
}
