//! What the UAV touches: obstacles, and the field's edge.

use nalgebra::Vector2;

use super::obstacles::Obstacles;
use crate::scenario::Scenario;

/// What the UAV touched in one control interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Contact {
    /// Index of the obstacle with which it collided: of several, the one that it overlapped most.
    pub obstacle: Option<usize>,
    /// Whether its centre was at the field's edge, or beyond it, when the interval ended.
    pub edge: bool,
}

/// How near to 0 or 1 a coordinate is at the edge: a position that crossed the link is a float.
const EDGE: f64 = 1e-6;

impl Contact {
    /// The contacts of the interval between two states, each the UAV's position and the obstacles', paper
    /// units. A collision is d(Ω_c, Ω_u) <= d_min (Eq. (21)) at any time of the interval, in which UAV and
    /// obstacles move on straight lines.
    #[must_use]
    pub fn between(
        before: (Vector2<f64>, &Obstacles),
        after: (Vector2<f64>, &Obstacles),
        scenario: &Scenario,
    ) -> Self {
        let pairs = before.1.iter().zip(after.1.iter()).zip(&scenario.obstacles).enumerate();
        let clearances = pairs.map(|(n, ((from, to), obstacle))| {
            let distance = least_length(before.0 - from, after.0 - to);
            (n, distance - obstacle.radius - scenario.uav_radius)
        });
        let nearest = clearances.min_by(|(_, a), (_, b)| a.total_cmp(b));
        let beyond = |x: &f64| !(EDGE..=1.0 - EDGE).contains(x);
        Self {
            obstacle: nearest.filter(|(_, clearance)| *clearance <= scenario.safety.d_min).map(|(n, _)| n),
            edge: after.0.iter().any(beyond),
        }
    }
}

/// The least length of a vector that changes from `from` to `to` at a constant rate.
fn least_length(from: Vector2<f64>, to: Vector2<f64>) -> f64 {
    let change = to - from;
    let t = -from.dot(&change) / change.norm_squared().max(f64::MIN_POSITIVE);
    // Exactly the end where the end is nearest.
    if t >= 1.0 { to.norm() } else { (from + t.max(0.0) * change).norm() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scenario 2's obstacle: centre (0.5, 0.45), radius 0.1; the UAV's is 0.02.
    fn contact(from: [f64; 2], to: [f64; 2]) -> Contact {
        let scenario = Scenario::default();
        let obstacles = Obstacles::from([scenario.obstacle().position]);
        Contact::between((from.into(), &obstacles), (to.into(), &obstacles), &scenario)
    }

    #[test]
    fn a_uav_that_flies_through_an_obstacle_within_one_interval_collides() {
        let collides = |from, to| contact(from, to).obstacle == Some(0);
        assert!(collides([0.3, 0.45], [0.7, 0.45]), "through it, both ends outside");
        assert!(collides([0.3, 0.45], [0.4, 0.45]), "it ends inside");
        assert!(collides([0.3, 0.5], [0.5, 0.5699]), "it ends within both radii");
        assert!(!collides([0.3, 0.5701], [0.7, 0.5701]), "past it");
        assert!(!collides([0.3, 0.45], [0.3799, 0.45]), "stops before it");
    }

    #[test]
    fn a_collision_is_a_clearance_of_d_min_or_less_in_the_obstacles_frame() {
        let mut scenario = Scenario::default();
        let at = |y: f64| Obstacles::from([Vector2::new(0.5, y)]);
        let uav = Vector2::new(0.5, 0.9);
        // The UAV stands, and the obstacle comes: 0.9 - 0.77 = 0.13.
        let came =
            |scenario: &Scenario| Contact::between((uav, &at(0.6)), (uav, &at(0.77)), scenario).obstacle;
        assert_eq!(came(&scenario), None);
        scenario.safety.d_min = 0.011;
        assert_eq!(came(&scenario), Some(0));
    }

    #[test]
    fn of_several_obstacles_the_one_hit_hardest_is_named() {
        let scenario = Scenario::from_toml("[[obstacle]]\n[[obstacle]]\nposition = [0.5, 0.75]\n").unwrap();
        let obstacles: Obstacles = scenario.obstacles.iter().map(|o| o.position).collect();
        let hit = |y: f64| {
            let r = Vector2::new(0.5, y);
            Contact::between((r, &obstacles), (r, &obstacles), &scenario).obstacle
        };
        assert_eq!([hit(0.5), hit(0.6), hit(0.7)], [Some(0), None, Some(1)]);
    }

    #[test]
    fn the_edge_is_where_the_walls_are() {
        assert!(contact([0.98, 0.9], [1.0, 0.9]).edge);
        assert!(contact([0.5, 0.01], [0.5, -0.02]).edge, "without walls it is beyond");
        assert!(!contact([0.98, 0.9], [0.999, 0.9]).edge);
    }
}
