//! Learns the bounds of motion from latents along trajectories of which none was discarded.
//!
//! Each round moves every number to where it explains the samples on which it acts best, by the sum of absolute
//! errors: the longest step by the steps that would have been longer, a side of the box by the frames that would
//! lie beyond it, the share of the outward speed by what comes after a bound. A sample weighs as much as the
//! bound changes it: one that is hardly touched tells more of its frames' errors than of the bound. Knows
//! latents and actions; neither positions, nor v_max, nor where the walls are.

use nalgebra::Vector2;

use crate::numeric::statistics::quantile;
use crate::predictor::bounded::{Bounded, Bounds, shorten};
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

/// Rounds between two searches of what a bound leaves of the speed.
const ROUNDS: usize = 20;

/// Widest [`Bounds::contact`] that is tried, in longest steps.
const WIDEST: f64 = 0.15;

/// Values of [`Bounds::kept`], and of [`Bounds::contact`], that are tried.
const TRIED: u32 = 31;

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
    for _ in 0..2 {
        for _ in 0..ROUNDS {
            bounds = round(linear, samples, bounds);
        }
        bounds = best_stop(linear, samples, bounds);
    }
    bounds
}

/// Values that samples tell, each with its weight.
type Told = Vec<(f64, f64)>;

/// What one round collects.
#[derive(Default)]
struct Evidence {
    /// Lengths of steps that would have been longer.
    reach: Told,
    /// Coordinates shown where they would lie beyond a bound, `[low, high][axis]`.
    sides: [[Told; 2]; 2],
}

fn round(linear: &PlaneLinear, samples: &[Sample], bounds: Bounds) -> Bounds {
    let mut seen = Evidence::default();
    for sample in samples {
        weigh(linear, &bounds, sample, &mut seen);
    }
    let [low, high] = seen.sides.map(|side| side.map(weighted_median));
    let side = |told: [Option<f64>; 2], now: Vector2<f64>| {
        Vector2::new(told[0].unwrap_or(now.x), told[1].unwrap_or(now.y))
    };
    Bounds {
        reach: weighted_median(seen.reach).unwrap_or(bounds.reach),
        low: side(low, bounds.low),
        high: side(high, bounds.high),
        ..bounds
    }
}

/// The bounds with the share of the outward speed, and the distance at which a frame counts as one at a bound,
/// that explain best what comes near the bounds. Both are tried together: with too large a share, frames that
/// came back from a bound seem to be far off it.
fn best_stop(linear: &PlaneLinear, samples: &[Sample], bounds: Bounds) -> Bounds {
    let widest = WIDEST * bounds.reach;
    let near = |s: &&Sample| {
        let v = s.now - s.before;
        (0..2).any(|axis| bounds.meets(axis, s.now[axis], v[axis], widest))
    };
    let near: Vec<&Sample> = samples.iter().filter(near).collect();
    let off = |bounds: Bounds| -> f64 {
        let bounded = Bounded { linear: *linear, bounds };
        let lacks = |s: &&Sample| {
            let step = bounded.displacement(s.now, s.now - s.before, s.a).step;
            (s.shown - s.now - step).abs().sum()
        };
        near.iter().map(lacks).sum()
    };
    let tried = (0..TRIED * TRIED).map(|n| {
        let [kept, wide] = [n / TRIED, n % TRIED].map(|n| f64::from(n) / f64::from(TRIED - 1));
        let bounds = Bounds { kept, contact: wide * widest, ..bounds };
        (bounds, off(bounds))
    });
    tried.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(bounds, |(best, _)| best)
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
        let beyond = [bounds.low[axis] - next[axis], next[axis] - bounds.high[axis]];
        if let Some(n) = beyond.iter().position(|by| *by > 0.0) {
            stopped = true;
            seen.sides[n][axis].push((s.shown[axis], beyond[n]));
        }
    }
    if short.is_some() && !stopped && met == [false; 2] {
        let length = free.norm();
        seen.reach.push(((s.shown - s.now).dot(&free) / length, length - bounds.reach));
    }
}

/// The value below which half of the weight lies; `None` without weight.
fn weighted_median(mut told: Told) -> Option<f64> {
    told.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = told.iter().map(|(_, weight)| weight).sum::<f64>() / 2.0;
    let mut sum = 0.0;
    let middle = told.into_iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    middle.map(|(value, _)| value)
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
    fn samples() -> (PlaneLinear, Vec<Sample>, Scenario) {
        let scenario = Scenario::default();
        let noise = Noise::new(8);
        let (episodes, _) = select(150, 100, (EpisodeStart::Rest, Selection::All), &scenario, &noise, 3);
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
        let (linear, samples, scenario) = samples();
        let found = fit(&linear, &samples);
        // To within the error of one place.
        assert!((found.reach - 10.0 * scenario.dynamics.v_max).abs() < 2e-3, "{found:?}");
        assert!(found.low.amax() < 2e-3 && (found.high - Vector2::repeat(10.0)).amax() < 2e-3, "{found:?}");
        assert!(found.kept < 0.02 && found.contact < 5e-3, "{found:?}");
    }
}
