//! Learns the bounds of motion from latents along trajectories of which none was discarded.
//!
//! First from single steps, then from whole trajectories: a frame's error hides in one step what a bound does, and
//! adds up to nothing over many. From single steps each round moves every number to where it explains the samples on which it acts best, by the sum of absolute
//! errors: the longest step by the steps that would have been longer, a side of the box by the frames that would
//! lie beyond it, the share of the outward speed by what comes after a bound. A sample weighs as much as the
//! bound changes it: one that is hardly touched tells more of its frames' errors than of the bound. Knows
//! latents and actions; neither positions, nor v_max, nor where the walls are.

use nalgebra::Vector2;
use rayon::prelude::*;

use crate::numeric::statistics::quantile;
use crate::predictor::bounded::{Bounded, BoundedMemory, Bounds, shorten};
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

/// Latents of one trajectory that begins at rest, and the actions between them.
#[derive(Debug, Clone, PartialEq)]
pub struct LatentPath {
    /// y_0, y_1, ..., plane coordinates, as frames show them.
    pub y: Vec<Vector2<f64>>,
    /// a_0, a_1, ...: a_k leads from y_k to y_{k+1}.
    pub actions: Vec<Vector2<f64>>,
}

impl LatentPath {
    /// Its latents, three in a row.
    pub fn samples(&self) -> impl Iterator<Item = Sample> {
        let steps = self.y.windows(3).zip(self.actions.iter().skip(1));
        steps.map(|(y, a)| Sample { before: y[0], now: y[1], a: *a, shown: y[2] })
    }
}

/// Rounds between two searches of what a bound leaves of the speed.
const ROUNDS: usize = 20;

/// Widest [`Bounds::contact`] that is tried, in longest steps.
const WIDEST: f64 = 0.5;

/// Times that the search along whole trajectories halves its steps.
const HALVINGS: usize = 12;

/// Values of [`Bounds::kept`], and of [`Bounds::contact`], that are tried.
const TRIED: u32 = 31;

/// The bounds that explain the trajectories best beside `linear`; [`Bounds::NONE`]'s where none tells.
#[must_use]
pub fn fit(linear: &PlaneLinear, paths: &[LatentPath]) -> Bounds {
    let samples: Vec<Sample> = paths.iter().flat_map(LatentPath::samples).collect();
    let bounds = by_steps(linear, &samples);
    if !bounds.reach.is_finite() || samples.is_empty() {
        return bounds;
    }
    let along = |kept: f64| by_trajectories(linear, paths, Bounds { kept, ..bounds });
    let found = [along(bounds.kept), along(0.0)].into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
    found.map_or(bounds, |(found, _)| best_contact(linear, &samples, found))
}

/// Numbers of a bound that trajectories tell, and how far the search moves each at first, in longest steps; the share
/// of the speed has no unit.
const MOVED: [f64; 6] = [0.02, 0.1, 0.1, 0.1, 0.1, 0.3];

/// The bounds beside which whole trajectories are foretold best, by a pattern search from `bounds`, and their cost.
fn by_trajectories(linear: &PlaneLinear, paths: &[LatentPath], bounds: Bounds) -> (Bounds, f64) {
    // An error of a quarter of a step counts half, one of many steps no more than whole: what was lost is lost.
    let half = bounds.reach / 4.0;
    let cost = |bounds: Bounds| -> f64 {
        let bounded = Bounded { linear: *linear, bounds };
        let of = |path: &LatentPath| off_along(&bounded, path, half);
        paths.par_iter().map(of).collect::<Vec<f64>>().iter().sum()
    };
    let mut best = (bounds, cost(bounds));
    let mut share = 1.0;
    for _ in 0..HALVINGS {
        let mut better = true;
        while better {
            better = false;
            for (number, step) in MOVED.into_iter().enumerate() {
                for sign in [1.0, -1.0] {
                    let tried = moved(best.0, number, sign * share * step, bounds.reach);
                    let cost = cost(tried);
                    if cost < best.1 {
                        (best, better) = ((tried, cost), true);
                    }
                }
            }
        }
        share /= 2.0;
    }
    best
}

/// The bounds with one of their numbers `by` larger, in units of [`MOVED`].
fn moved(mut bounds: Bounds, number: usize, by: f64, reach: f64) -> Bounds {
    match number {
        0 => bounds.reach += by * reach,
        1 | 2 => bounds.low[number - 1] += by * reach,
        3 | 4 => bounds.high[number - 3] += by * reach,
        _ => bounds.kept = (bounds.kept + by).clamp(0.0, 1.0),
    }
    bounds
}

/// Sum of e / (e + `half`) over the errors e along a trajectory that is foretold from its first latent, at rest.
fn off_along(bounded: &Bounded, path: &LatentPath, half: f64) -> f64 {
    let Some(first) = path.y.first() else { return 0.0 };
    let (mut memory, mut state) = (BoundedMemory::default(), [[*first; 2]]);
    let errors = path.y[1..].iter().zip(&path.actions).map(|(shown, a)| {
        bounded.advance(&mut memory, &mut state, |_| *a);
        let e = (shown - state[0][0]).norm();
        e / (e + half)
    });
    errors.sum()
}

/// The bounds that explain the samples best.
fn by_steps(linear: &PlaneLinear, samples: &[Sample]) -> Bounds {
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
struct BoundEvidence {
    /// Lengths of steps that would have been longer.
    reach: Told,
    /// Coordinates shown where they would lie beyond a bound, `[low, high][axis]`.
    sides: [[Told; 2]; 2],
}

fn round(linear: &PlaneLinear, samples: &[Sample], bounds: Bounds) -> Bounds {
    let mut seen = BoundEvidence::default();
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
    best_of(linear, samples, bounds, (0..TRIED).map(|n| f64::from(n) / f64::from(TRIED - 1)))
}

/// The same with the share of `bounds`.
fn best_contact(linear: &PlaneLinear, samples: &[Sample], bounds: Bounds) -> Bounds {
    best_of(linear, samples, bounds, std::iter::once(bounds.kept))
}

fn best_of(
    linear: &PlaneLinear,
    samples: &[Sample],
    bounds: Bounds,
    shares: impl Iterator<Item = f64>,
) -> Bounds {
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
    let tried = shares.flat_map(|kept| (0..TRIED).map(move |wide| (kept, wide))).map(|(kept, wide)| {
        let contact = f64::from(wide) / f64::from(TRIED - 1) * widest;
        let bounds = Bounds { kept, contact, ..bounds };
        (bounds, off(bounds))
    });
    tried.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(bounds, |(best, _)| best)
}

fn weigh(linear: &PlaneLinear, bounds: &Bounds, s: &Sample, seen: &mut BoundEvidence) {
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

    /// Trajectories as latents of ten a unit, each of which a frame shows up to `off` away, and `inwards` at a wall.
    fn paths(off: f64, inwards: f64) -> (PlaneLinear, Vec<LatentPath>, Scenario) {
        let scenario = Scenario::default();
        let noise = Noise::new(8);
        let (episodes, _) = select(150, 100, (EpisodeStart::Rest, Selection::All), &scenario, &noise, 3);
        let mut rng = noise.generator(Stream::Evaluation, 0);
        let mut shown = |r: &Vector2<f64>| {
            r.map(|x| {
                let wall = if x <= 0.0 {
                    inwards
                } else if x >= 1.0 {
                    -inwards
                } else {
                    0.0
                };
                x * 10.0 + wall + off * rng.random_range(-1.0..=1.0)
            })
        };
        let paths = episodes.into_iter().map(|e| {
            // The first picture is there twice: at rest.
            LatentPath { y: e.uav[1..].iter().map(&mut shown).collect(), actions: e.actions }
        });
        let paths = paths.collect();
        let (two, one) = (Matrix2::identity() * 2.0, Matrix2::identity());
        let action = one * (10.0 * scenario.dynamics.a_max);
        (PlaneLinear { newer: two, older: -one, action }, paths, scenario)
    }

    #[test]
    fn it_finds_speed_limit_and_walls_that_nobody_told_it() {
        let (linear, paths, scenario) = paths(2e-3, 0.0);
        let found = fit(&linear, &paths);
        // To within the error of one place.
        assert!((found.reach - 10.0 * scenario.dynamics.v_max).abs() < 2e-3, "{found:?}");
        assert!(found.low.amax() < 2e-3 && (found.high - Vector2::repeat(10.0)).amax() < 2e-3, "{found:?}");
        assert!(found.kept < 0.02 && found.contact < 0.02, "{found:?}");
    }

    /// As a learned encoder shows them: a tenth of a pixel off anywhere, more where the disc is cut.
    #[test]
    fn errors_of_frames_are_not_taken_for_speed_that_a_wall_leaves() {
        let (linear, paths, scenario) = paths(1e-2, 3e-2);
        let found = fit(&linear, &paths);
        assert!((found.reach - 10.0 * scenario.dynamics.v_max).abs() < 2e-3, "{found:?}");
        assert!(found.low.amax() < 3e-2 && (found.high - Vector2::repeat(10.0)).amax() < 3e-2, "{found:?}");
        assert!(found.kept < 0.1, "{found:?}");
    }
}
