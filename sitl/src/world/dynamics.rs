//! Motion: the UAV's second-order dynamics in its box, and the obstacle that stands or reflects.

use nalgebra::Vector2;

use crate::scenario::Dynamics;

/// Position (units) and velocity (units per interval) of an entity, paper x/y.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State {
    /// r
    pub r: Vector2<f64>,
    /// v
    pub v: Vector2<f64>,
}

impl State {
    /// At `r`, at rest.
    #[must_use]
    pub fn at_rest(r: Vector2<f64>) -> Self {
        Self { r, v: Vector2::zeros() }
    }
}

/// v · min(1, v_max/|v|): the speed is limited before the position is updated (Sec. IV-A1).
#[must_use]
pub fn limit_speed(v: Vector2<f64>, v_max: f64) -> Vector2<f64> {
    let speed = v.norm();
    if speed > v_max { v * (v_max / speed) } else { v }
}

/// One control interval of the UAV, Eq. (30), Sec. IV-A1, in the paper's order:
/// v' = limit(v + a_max a + gust), r' = r + v', then the box.
///
/// `a` is the normalised acceleration, `gust` the velocity disturbance σ w_k in units per interval.
#[must_use]
pub fn step(state: State, a: Vector2<f64>, gust: Vector2<f64>, dynamics: &Dynamics) -> State {
    let v = limit_speed(state.v + dynamics.a_max * a + gust, dynamics.v_max);
    let moved = State { r: state.r + v, v };
    if dynamics.walls { contain(moved) } else { moved }
}

/// The box `[0, 1]²`: an axis beyond it is clipped and its outward velocity is zeroed (our choice).
#[must_use]
pub fn contain(mut state: State) -> State {
    for axis in 0..2 {
        if state.r[axis] < 0.0 {
            state.r[axis] = 0.0;
            state.v[axis] = state.v[axis].max(0.0);
        } else if state.r[axis] > 1.0 {
            state.r[axis] = 1.0;
            state.v[axis] = state.v[axis].min(0.0);
        }
    }
    state
}

/// The obstacle: r_u' = r_u + v_u (Sec. IV-A1), reflected where its centre would pass `margin` from a wall.
#[must_use]
pub fn step_obstacle(state: State, margin: f64) -> State {
    let mut next = State { r: state.r + state.v, v: state.v };
    for axis in 0..2 {
        let (low, high) = (margin, 1.0 - margin);
        if state.v[axis] == 0.0 {
            continue;
        }
        if next.r[axis] < low {
            next.r[axis] = 2.0 * low - next.r[axis];
            next.v[axis] = -next.v[axis];
        } else if next.r[axis] > high {
            next.r[axis] = 2.0 * high - next.r[axis];
            next.v[axis] = -next.v[axis];
        }
    }
    next
}
