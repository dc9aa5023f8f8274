//! Learns the bounds of motion from latents along trajectories of which none was discarded.
//!
//! Each round moves every number to where it explains the samples on which it acts: the longest step by the
//! steps that would have been longer, a side of the box by the frames that would lie beyond it, the share of
//! the outward speed by what comes after a bound. Medians, because a frame that cuts the UAV's disc errs more.
//! Knows latents and actions; neither positions, nor v_max, nor where the walls are.

use nalgebra::Vector2;

use crate::numeric::statistics::quantile;
use crate::predictor::bounded::{Bounds, shorten};
use crate::predictor::linear::PlaneLinear;

/// Three latents of one trajectory in a row and the action that bends them, plane coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// y_{k-1}
    pub before: Vector2<f64>,
    /// y_k
    pub now: Vector2<f64>,
    /// a_k
    pub a: Vector2<f64>,
    /// y_{k+1}, as the frame shows it.
    pub shown: Vector2<f64>,
}

/// Rounds of the fit; it stands still long before.
const ROUNDS: usize = 40;

/// Share of the frames at a bound that lie within [`Bounds::contact`] of it.
const CONTACT: f64 = 0.95;

/// The bounds that explain the samples best beside `linear`; [`Bounds::NONE`]'s where no sample tells.
#[must_use]
pub fn fit(linear: &PlaneLinear, samples: &[Sample]) -> Bounds {
    let of =
        |p: f64, value: &dyn Fn(&Sample) -> f64| quantile(&samples.iter().map(value).collect::<Vec<_>>(), p);
    let corner = |p: f64| Vector2::new(of(p, &|s| s.shown.x), of(p, &|s| s.shown.y));
    // From inside: with too narrow bounds the samples that they would stop lie beyond them.
    let mut bounds = Bounds {
        reach: of(0.5, &|s| (s.shown - s.now).norm()),
        low: corner(0.1),
        high: corner(0.9),
        ..Bounds::NONE
    };
    for _ in 0..ROUNDS {
        bounds = round(linear, samples, bounds);
    }
    bounds
}

/// What one round collects.
#[derive(Default)]
struct Evidence {
    /// Lengths of steps that would have been longer.
    reach: Vec<f64>,
    /// Coordinates shown where they would lie beyond a bound, `[low, high][axis]`.
    sides: [[Vec<f64>; 2]; 2],
    /// How far off the bound those are.
    off: Vec<f64>,
    /// Σ v r and Σ v² after a bound: v the outward speed, r what the prediction lacks.
    left: [f64; 2],
}

fn round(linear: &PlaneLinear, samples: &[Sample], bounds: Bounds) -> Bounds {
    let mut seen = Evidence::default();
    for sample in samples {
        weigh(linear, &bounds, sample, &mut seen);
    }
    let median = |of: &[f64], else_: f64| if of.is_empty() { else_ } else { quantile(of, 0.5) };
    let side =
        |n: usize, now: Vector2<f64>| Vector2::from_fn(|axis, _| median(&seen.sides[n][axis], now[axis]));
    let [cross, square] = seen.left;
    let more = if square > 0.0 { cross / square } else { 0.0 };
    Bounds {
        reach: median(&seen.reach, bounds.reach),
        low: side(0, bounds.low),
        high: side(1, bounds.high),
        contact: if seen.off.is_empty() { 0.0 } else { quantile(&seen.off, CONTACT) },
        kept: (bounds.kept + more).clamp(0.0, 1.0),
    }
}

fn weigh(linear: &PlaneLinear, bounds: &Bounds, s: &Sample, seen: &mut Evidence) {
    let v = s.now - s.before;
    let met = [0, 1].map(|axis| bounds.meets(axis, s.now[axis], v[axis], bounds.contact));
    let kept = Vector2::from_fn(|axis, _| if met[axis] { bounds.kept } else { 1.0 });
    let free = linear.step(s.now, s.now - kept.component_mul(&v), s.a) - s.now;
    let short = shorten(free, bounds.reach);
    let next = s.now + short.map_or(free, |(step, _)| step);
    let mut stopped = false;
    for axis in 0..2 {
        let side = if next[axis] < bounds.low[axis] { Some((0, bounds.low)) } else { None };
        let side = if next[axis] > bounds.high[axis] { Some((1, bounds.high)) } else { side };
        if let Some((n, bound)) = side {
            stopped = true;
            seen.sides[n][axis].push(s.shown[axis]);
            seen.off.push((s.shown[axis] - bound[axis]).abs());
        } else if met[axis] && short.is_none() {
            seen.left[0] += v[axis] * (s.shown[axis] - next[axis]);
            seen.left[1] += v[axis] * v[axis];
        }
    }
    if short.is_some() && !stopped && met == [false; 2] {
        seen.reach.push((s.shown - s.now).dot(&free) / free.norm());
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::Scenario;
    use crpl_sitl::world::noise::{Noise, Stream};
    use nalgebra::Matrix2;
    use rand::RngExt;

    use super::*;
    use crate::world_model::dataset::{EpisodeStart, Selection, select};

    /// Places with 0.02 px of error, as latents of ten a unit.
    fn samples(selection: Selection) -> (PlaneLinear, Vec<Sample>, Scenario) {
        let scenario = Scenario::default();
        let noise = Noise::new(8);
        let (episodes, _) = select(150, 100, (EpisodeStart::Rest, selection), &scenario, &noise, 3);
        let mut rng = noise.generator(Stream::Evaluation, 0);
        let mut off = || 2e-3 * Vector2::new(rng.random_range(-1.0..=1.0), rng.random_range(-1.0..=1.0));
        let mut out = Vec::new();
        for e in &episodes {
            let y: Vec<_> = e.uav.iter().map(|r| r * 10.0 + off()).collect();
            let steps = y.windows(3).zip(&e.actions);
            out.extend(steps.map(|(y, a)| Sample { before: y[0], now: y[1], a: *a, shown: y[2] }));
        }
        let (two, one) = (Matrix2::identity() * 2.0, Matrix2::identity());
        let action = one * (10.0 * scenario.dynamics.a_max);
        (PlaneLinear { newer: two, older: -one, action }, out, scenario)
    }

    #[test]
    fn it_finds_speed_limit_and_walls_that_nobody_told_it() {
        let (linear, samples, scenario) = samples(Selection::All);
        let found = fit(&linear, &samples);
        assert!((found.reach / (10.0 * scenario.dynamics.v_max) - 1.0).abs() < 2e-3, "{found:?}");
        assert!(found.low.amax() < 2e-3 && (found.high - Vector2::repeat(10.0)).amax() < 2e-3, "{found:?}");
        assert!(found.kept < 0.02 && found.contact < 5e-3, "{found:?}");
    }

    #[test]
    fn trajectories_that_were_selected_teach_it_nothing_of_them() {
        let (linear, samples, scenario) = samples(Selection::Free);
        let found = fit(&linear, &samples);
        assert!((found.reach / (10.0 * scenario.dynamics.v_max) - 1.0).abs() > 2e-3, "{found:?}");
    }
}
