//! The linear predictor inside bounds of motion: a longest step, and a box that stops what reaches it.
//!
//! The bounds are seven numbers in plane coordinates. They are either learned from latents
//! ([`training::bounds`](crate::training::bounds)) or known. Knows latents and actions; neither frames nor positions.

use nalgebra::{Matrix2, Vector2};

use crate::numeric::kernel::{LANES, ZERO};
use crate::numeric::tensors::{Reader, TensorError, Writer};
use crate::predictor::linear::{Displacement, Pair, PlaneLinear};

/// Bounds of motion, plane coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Longest step of an interval, latent units.
    pub reach: f64,
    /// Least coordinates.
    pub low: Vector2<f64>,
    /// Largest coordinates.
    pub high: Vector2<f64>,
    /// How far off a bound a frame may show y while it is at that bound, latent units.
    pub contact: f64,
    /// Share of the outward speed that is left at a bound.
    pub kept: f64,
}

impl Bounds {
    /// No bounds at all.
    pub const NONE: Self = Self {
        reach: f64::INFINITY,
        low: Vector2::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
        high: Vector2::new(f64::INFINITY, f64::INFINITY),
        contact: 0.0,
        kept: 1.0,
    };

    /// Name of the tensor.
    const NAME: &'static str = "bounds";

    /// Adds them to a file.
    pub fn put(&self, out: &mut Writer) {
        let Self { reach, low, high, contact, kept } = *self;
        out.f64(Self::NAME, &[7], [reach, low.x, low.y, high.x, high.y, contact, kept]);
    }

    /// Reads what [`Bounds::put`] wrote; `None` if the file has none.
    ///
    /// # Errors
    /// If the tensor has another shape.
    pub fn get(from: &Reader<'_>) -> Result<Option<Self>, TensorError> {
        if !from.has(Self::NAME) {
            return Ok(None);
        }
        let b = from.f64(Self::NAME, &[7])?;
        let (low, high) = (Vector2::new(b[1], b[2]), Vector2::new(b[3], b[4]));
        Ok(Some(Self { reach: b[0], low, high, contact: b[5], kept: b[6] }))
    }

    /// Whether y is at the bound towards which v points, on this axis.
    #[must_use]
    pub fn meets(&self, axis: usize, y: f64, v: f64, slack: f64) -> bool {
        (v > 0.0 && y >= self.high[axis] - slack) || (v < 0.0 && y <= self.low[axis] + slack)
    }
}

/// A step that is longer than `reach`, shortened to it, and the slope of the shorter one in the longer: what
/// is left of an error is what lies across the step. `None` if it is not too long.
#[must_use]
pub fn shorten(step: Vector2<f64>, reach: f64) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let length = step.norm();
    (length > reach).then(|| {
        let along = step / length;
        (along * reach, (Matrix2::identity() - along * along.transpose()) * (reach / length))
    })
}

/// y_{k+1} = clamp(y_k + shorten(Ψ_0 y_k + Ψ_1 y'_{k-1} + Ψ_a a_k - y_k)), where y'_{k-1} has only the share
/// `kept` of the speed with which y_k came to a bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounded {
    /// The predictor between the bounds.
    pub linear: PlaneLinear,
    /// The bounds.
    pub bounds: Bounds,
}

/// Steps forward that were not taken back: y_k, y_{k-1} and a_k of each.
#[derive(Debug, Clone, Default)]
pub struct BoundedMemory {
    begun: bool,
    steps: Vec<[Pair; 3]>,
}

/// A step, its slopes in y_k, y_{k-1} and a_k.
struct Local {
    next: Vector2<f64>,
    slopes: [Matrix2<f64>; 3],
}

impl Bounded {
    /// One step of several rollouts, each given as `[y_k, y_{k-1}]`, in place. The first one begins at what a frame
    /// shows, all later ones at the rollout's own y, which is at a bound or is not.
    pub fn advance(
        &self,
        memory: &mut BoundedMemory,
        states: &mut [[Vector2<f64>; 2]],
        actions: impl Fn(usize) -> Vector2<f64>,
    ) {
        let slack = self.slack(memory.begun);
        memory.begun = true;
        for (n, [now, before]) in states.iter_mut().enumerate() {
            (*now, *before) = (self.local(*now, *before, actions(n), slack).next, *now);
        }
    }

    /// The step from y_k at velocity v as a frame shows them, and its slopes.
    #[must_use]
    pub fn displacement(&self, y: Vector2<f64>, v: Vector2<f64>, a: Vector2<f64>) -> Displacement {
        let Local { next, slopes: [by_now, by_before, _] } = self.local(y, y - v, a, self.slack(false));
        Displacement { step: next - y, by_y: by_now + by_before - Matrix2::identity(), by_v: -by_before }
    }

    /// y_{k+1} of [`LANES`] rollouts.
    #[must_use]
    pub fn forward(&self, memory: &mut BoundedMemory, now: &Pair, before: &Pair, a: &Pair) -> Pair {
        let slack = self.slack(!memory.steps.is_empty());
        memory.steps.push([*now, *before, *a]);
        let mut out = [ZERO; 2];
        for l in 0..LANES {
            let next = self.local(lane(now, l), lane(before, l), lane(a, l), slack).next;
            (out[0][l], out[1][l]) = (next.x as f32, next.y as f32);
        }
        out
    }

    /// Adds the slopes in y_k, y_{k-1} and a_k of the last step that was not yet taken back.
    pub fn backward(&self, memory: &mut BoundedMemory, d_next: &Pair, mut into: [&mut Pair; 3]) {
        let Some([now, before, a]) = memory.steps.pop() else { return };
        let slack = self.slack(!memory.steps.is_empty());
        for l in 0..LANES {
            let Local { slopes, .. } = self.local(lane(&now, l), lane(&before, l), lane(&a, l), slack);
            for (slope, into) in slopes.iter().zip(&mut into) {
                let d = slope.transpose() * lane(d_next, l);
                into[0][l] += d.x as f32;
                into[1][l] += d.y as f32;
            }
        }
    }

    fn slack(&self, begun: bool) -> f64 {
        if begun { 0.0 } else { self.bounds.contact }
    }

    fn local(&self, now: Vector2<f64>, before: Vector2<f64>, a: Vector2<f64>, slack: f64) -> Local {
        let Self { linear, bounds } = self;
        let (v, mut kept) = (now - before, Vector2::repeat(1.0));
        for axis in 0..2 {
            if bounds.meets(axis, now[axis], v[axis], slack) {
                kept[axis] = bounds.kept;
            }
        }
        let free = linear.step(now, now - kept.component_mul(&v), a) - now;
        let share = Matrix2::from_diagonal(&kept);
        let mut by_now = linear.newer + linear.older * (Matrix2::identity() - share) - Matrix2::identity();
        let (mut by_before, mut by_a) = (linear.older * share, linear.action);
        let mut step = free;
        if let Some((short, turn)) = shorten(free, bounds.reach) {
            step = short;
            (by_now, by_before, by_a) = (turn * by_now, turn * by_before, turn * by_a);
        }
        by_now += Matrix2::identity();
        let mut next = now + step;
        for axis in 0..2 {
            let inside = next[axis].max(bounds.low[axis]).min(bounds.high[axis]);
            if inside != next[axis] {
                next[axis] = inside;
                [&mut by_now, &mut by_before, &mut by_a].into_iter().for_each(|s| s.row_mut(axis).fill(0.0));
            }
        }
        Local { next, slopes: [by_now, by_before, by_a] }
    }
}

/// Both axes of one rollout.
fn lane(of: &Pair, l: usize) -> Vector2<f64> {
    Vector2::new(of[0][l].into(), of[1][l].into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crpl_sitl::Scenario;
    use crpl_sitl::world::dynamics::{self, State};

    /// The simulator's own world with ten latent units a unit.
    fn known(scenario: &Scenario) -> Bounded {
        let (two, one) = (Matrix2::identity() * 2.0, Matrix2::identity());
        let d = &scenario.dynamics;
        let linear = PlaneLinear { newer: two, older: -one, action: one * (10.0 * d.a_max) };
        let bounds = Bounds {
            reach: 10.0 * d.v_max,
            low: Vector2::zeros(),
            high: Vector2::repeat(10.0),
            contact: 0.0,
            kept: 0.0,
        };
        Bounded { linear, bounds }
    }

    #[test]
    fn with_the_simulators_bounds_it_is_the_simulator() {
        let scenario = Scenario::default();
        let (bounded, mut memory) = (known(&scenario), BoundedMemory::default());
        let mut state = State::at_rest(Vector2::new(0.9, 0.2));
        let mut y = [[state.r * 10.0; 2]];
        let (mut fast, mut stopped) = (0, 0);
        for k in 0..300 {
            let a = Vector2::new((f64::from(k) * 0.07).sin(), (f64::from(k) * 0.05).cos());
            state = dynamics::step(state, a, Vector2::zeros(), &scenario.dynamics);
            bounded.advance(&mut memory, &mut y, |_| a);
            assert!((y[0][0] - state.r * 10.0).norm() < 1e-9, "{k}: {y:?} instead of {}", state.r * 10.0);
            fast += usize::from(state.v.norm() > 0.9999 * scenario.dynamics.v_max);
            stopped += usize::from(state.r.iter().any(|x| *x == 0.0 || *x == 1.0));
        }
        assert!(fast > 20 && stopped > 20, "{fast} at v_max, {stopped} at a wall");
    }

    #[test]
    fn without_bounds_it_is_the_linear_predictor() {
        let bounded = Bounded { bounds: Bounds::NONE, ..known(&Scenario::default()) };
        let (now, before, a) = (Vector2::new(1.0, 2.0), Vector2::new(-3.0, 9.0), Vector2::new(0.5, -1.0));
        let mut y = [[now, before]];
        bounded.advance(&mut BoundedMemory::default(), &mut y, |_| a);
        assert!((y[0][0] - bounded.linear.step(now, before, a)).norm() < 1e-12);
    }

    /// Against differences: free, at the longest step, at a bound.
    #[test]
    fn its_slopes_are_its_differences() {
        let bounded = Bounded {
            bounds: Bounds { kept: 0.3, contact: 0.02, ..known(&Scenario::default()).bounds },
            ..known(&Scenario::default())
        };
        let a = Vector2::new(0.2, -0.4);
        for (now, v) in [([5.0, 5.0], [0.1, 0.2]), ([5.0, 5.0], [0.5, 0.3]), ([9.99, 5.0], [0.2, 0.1])] {
            let (now, v) = (Vector2::from(now), Vector2::from(v));
            let at = |now, before, a| bounded.local(now, before, a, 0.02).next;
            let found = bounded.local(now, now - v, a, 0.02).slopes;
            for axis in 0..2 {
                let h = Vector2::from_fn(|row, _| if row == axis { 1e-6 } else { 0.0 });
                let o = Vector2::zeros();
                let slope = |n, b, c| {
                    let ends = [1.0, -1.0].map(|s| at(now + n * s, now - v + b * s, a + c * s));
                    (ends[0] - ends[1]) / 2e-6
                };
                for (found, by) in found.iter().zip([slope(h, o, o), slope(o, h, o), slope(o, o, h)]) {
                    assert!((found.column(axis) - by).norm() < 1e-6, "{now} {v}: {found} {by}");
                }
            }
        }
    }
}
