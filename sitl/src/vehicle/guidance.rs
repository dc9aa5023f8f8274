//! Flying without a station: braking, and going to a point. Knows the UAV's limits, not why it goes.
//!
//! All in units of the paper: positions of the square, speeds a control interval. An acceleration is
//! normalised, within ±1 on each axis, as the actuators are.

use nalgebra::Vector2;

use crate::scenario::Dynamics;
use crate::world::dynamics::State;

/// The part of the braking power that an approach counts on; the rest is for gusts.
const MARGIN: f64 = 0.7;

/// The acceleration that stops the UAV as soon as its actuators can, and keeps it stopped.
pub(super) fn brake(state: State, dynamics: &Dynamics) -> Vector2<f64> {
    follow(state, Vector2::zeros(), dynamics)
}

/// The acceleration of a straight approach to `target` at `speed` at most, stopping there.
pub(super) fn approach(state: State, target: Vector2<f64>, speed: f64, dynamics: &Dynamics) -> Vector2<f64> {
    follow(state, approach_velocity(state, target, speed, dynamics), dynamics)
}

/// The velocity of that approach, units an interval.
pub(super) fn approach_velocity(
    state: State,
    target: Vector2<f64>,
    speed: f64,
    dynamics: &Dynamics,
) -> Vector2<f64> {
    let way = target - state.r;
    let distance = way.norm();
    if distance == 0.0 {
        return Vector2::zeros();
    }
    let allowed = speed.min(dynamics.v_max).min(stoppable(distance, MARGIN * dynamics.a_max));
    way * (allowed / distance)
}

/// Where the UAV comes to rest if it brakes from now on, with the share of its power that an approach counts on.
pub(super) fn rest(state: State, dynamics: &Dynamics) -> Vector2<f64> {
    // Speeds v, v - b, v - 2b, ... sum to v (v + b) / 2b.
    let speed = state.v.norm();
    let loss = MARGIN * dynamics.a_max;
    state.r + state.v * ((speed + loss) / (2.0 * loss))
}

/// The largest speed from which the UAV stops within `distance`, losing `loss` of it an interval:
/// speeds v, v - b, v - 2b, ... sum to v (v + b) / 2b. Below one such step it arrives at once.
fn stoppable(distance: f64, loss: f64) -> f64 {
    if distance <= loss {
        return distance;
    }
    loss * ((0.25 + 2.0 * distance / loss).sqrt() - 0.5)
}

/// The acceleration that brings the speed to `wish`, or as near as an interval allows.
pub(super) fn follow(state: State, wish: Vector2<f64>, dynamics: &Dynamics) -> Vector2<f64> {
    ((wish - state.v) / dynamics.a_max).map(|x| x.clamp(-1.0, 1.0))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::world::dynamics::step;

    fn at(r: [f64; 2], v: [f64; 2]) -> State {
        State { r: Vector2::from(r), v: Vector2::from(v) }
    }

    #[test]
    fn it_stops_in_as_many_intervals_as_its_speed_needs_and_stays() {
        let dynamics = Dynamics::default();
        let mut state = at([0.5, 0.5], [0.02, -0.01]);
        for _ in 0..6 {
            state = step(state, brake(state, &dynamics), Vector2::zeros(), &dynamics);
        }
        assert_eq!(state.v, Vector2::zeros(), "0.02 at 0.0035 an interval is six intervals");
        assert_eq!(step(state, brake(state, &dynamics), Vector2::zeros(), &dynamics), state);
    }

    proptest! {
        #[test]
        fn every_target_is_reached_within_the_speed_and_without_passing_the_square(
            (x, y) in (0.05..0.95, 0.05..0.95), (vx, vy) in (-0.02..0.02, -0.02..0.02),
            (gx, gy) in (0.0..1.0, 0.0..1.0), speed in 0.002..0.04,
        ) {
            let (dynamics, target) = (Dynamics { walls: false, ..Dynamics::default() }, Vector2::new(gx, gy));
            let mut state = at([x, y], [vx, vy]);
            let intervals = 60 + (1.5 / speed) as usize;
            for k in 0..intervals {
                state = step(state, approach(state, target, speed, &dynamics), Vector2::zeros(), &dynamics);
                if k > 20 {
                    prop_assert!(state.v.norm() <= speed + 1e-9);
                }
            }
            prop_assert!((state.r - target).norm() < 1e-6 && state.v.norm() < 1e-6, "{state:?}");
        }
    }
}
