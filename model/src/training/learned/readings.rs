//! What is fitted to the trained encoder's readings of the recording: the noise of a reading, the predictors, the
//! radius at which the bodies touch. No position is in it.

use crpl_sitl::camera::SIDE;
use nalgebra::Vector2;
use rayon::prelude::*;

use crate::encoder::votes::noise::{ReadingNoise, SpreadSample};
use crate::encoder::votes::{BODIES, VoteEncoder, VoteWeights, Votes};
use crate::numeric::tensors::TensorError;
use crate::predictor::linear::{self, Half, Linear, Plane, Window};
use crate::world_model::recording::Recording;
use crate::world_model::sight::{LearnedSight, plane_of_px};

/// Largest σ of a reading from which predictors and heads learn, px.
const GOOD_PX: f64 = 0.6;

/// Pictures between those of a triple from which the noise is told: beyond a ground patch that pulls alike.
const NOISE_LAG: usize = 4;

/// The encoder's reading of a whole recording.
#[derive(Debug)]
pub struct EpisodeReadings {
    /// Votes of every picture of every episode.
    pub votes: Vec<Vec<Votes>>,
}

/// Reads every picture; `done` is called after each episode.
///
/// # Errors
/// If a picture cannot be read.
pub fn read_all(
    weights: &VoteWeights,
    recording: &Recording,
    done: impl Fn() + Sync,
) -> Result<EpisodeReadings, TensorError> {
    let sight = LearnedSight { encoder: VoteEncoder::new(weights.clone()), noise: ReadingNoise::default() };
    let votes = recording.episodes().par_iter().map(|episode| {
        let read = (0..episode.len()).map(|k| Ok(sight.votes(&episode.frame(k)?))).collect();
        done();
        read
    });
    Ok(EpisodeReadings { votes: votes.collect::<Result<_, TensorError>>()? })
}

/// The noise of a reading, from the episodes from `first` on.
#[must_use]
pub fn noise(readings: &EpisodeReadings, recording: &Recording, first: usize) -> ReadingNoise {
    let px = (recording.a_max * SIDE as f64) as f32;
    let mut samples: [Vec<SpreadSample>; BODIES] = Default::default();
    let episodes = recording.episodes().iter().zip(&readings.votes).skip(first);
    for (episode, votes) in episodes {
        for k in 0..votes.len().saturating_sub(2 * NOISE_LAG) {
            let seen = [0, 1, 2].map(|m| &votes[k + m * NOISE_LAG]);
            let response = episode.response(k, NOISE_LAG) * px;
            for (body, samples) in samples.iter_mut().enumerate() {
                let y = if body == 0 { [response.x, response.y] } else { [0.0; 2] };
                let difference = |axis: usize| {
                    let p = seen.map(|v| v.p[body][axis]);
                    f64::from(p[2] - 2.0 * p[1] + p[0] - y[axis])
                };
                let spread = seen.iter().map(|v| f64::from(v.spread[body])).fold(0.0, f64::max);
                let difference_px = [difference(0), difference(1)];
                samples.push(SpreadSample { spread_px: spread.sqrt(), difference_px });
            }
        }
    }
    ReadingNoise::fit([&samples[0], &samples[1]])
}

/// Share of the variance of z_c's second differences that the actions explain, in the episodes from `first` on, lags
/// of 16: what tells without a label whether the UAV is found. The median picture counts: walls and lost bodies
/// are left out beyond six median deviations.
#[must_use]
pub fn explained(readings: &EpisodeReadings, recording: &Recording, first: usize) -> f64 {
    const LAG: usize = 16;
    let px = (recording.a_max * SIDE as f64) as f32;
    let mut pairs: Vec<[f64; 2]> = Vec::new();
    for (episode, votes) in recording.episodes().iter().zip(&readings.votes).skip(first) {
        for k in 0..votes.len().saturating_sub(2 * LAG) {
            let y = episode.response(k, LAG) * px;
            for (axis, y) in [y.x, y.y].into_iter().enumerate() {
                let p = [0, 1, 2].map(|m| votes[k + m * LAG].p[0][axis]);
                pairs.push([f64::from(p[2] - 2.0 * p[1] + p[0]), f64::from(y)]);
            }
        }
    }
    let median = |of: &dyn Fn(&[f64; 2]) -> f64| {
        let mut values: Vec<f64> = pairs.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or_default()
    };
    let (error, size) = (median(&|[d, y]| (d - y).abs()), median(&|[_, y]| y.abs()));
    if size > 0.0 { 1.0 - (error / size).powi(2) } else { 0.0 }
}

/// Whether a reading of a body is one to learn from.
fn is_good(noise: &ReadingNoise, votes: &Votes, body: usize) -> bool {
    noise.sigma_px(body, votes.spread[body]) < GOOD_PX
}

/// The learned predictors, and how far they are from constant velocity.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedPredictor {
    /// Ψ of both halves, Ψ_0 and Ψ_1 held to (2I, -I) by the ridge.
    pub linear: Linear,
    /// |Ψ - (2I, -I)| on the planes, Frobenius: the larger of both halves.
    pub off: f64,
    /// The same without the ridge: errors of the readings draw a one-step fit towards no motion.
    pub off_free: f64,
}

/// Whether a body's disc is whole in the picture. A cut disc is read further inside than it is, and just there the
/// flights accelerate inwards: a fit would take the one for the other.
fn is_whole(p: [f32; 2]) -> bool {
    p.iter().all(|x| (EDGE_PX..=SIDE as f32 - EDGE_PX).contains(x))
}

/// Distance from the picture's edge within which a disc may be cut, px.
const EDGE_PX: f32 = 6.0;

/// Ψ of both halves by least squares on one-step windows of the readings; Ψ_a on windows of `lag` steps, over which
/// the action moves the UAV further and an error of reading weighs less. `None` if the normal equations are
/// singular.
#[must_use]
pub fn predictor(
    readings: &EpisodeReadings,
    recording: &Recording,
    noise: &ReadingNoise,
    planes: &[Plane; BODIES],
    (scale, ridge, lag): (f64, f64, usize),
) -> Option<FittedPredictor> {
    let windows = |body: usize, lag: usize| -> Vec<Window> {
        let mut out = Vec::new();
        for (episode, votes) in recording.episodes().iter().zip(&readings.votes) {
            for k in 0..votes.len().saturating_sub(2 * lag) {
                let seen = [0, 1, 2].map(|m| &votes[k + m * lag]);
                if seen.iter().all(|v| is_good(noise, v, body) && is_whole(v.p[body])) {
                    let half = seen.map(|v| -> Half {
                        let y = plane_of_px(v.p[body], scale);
                        planes[body] * Vector2::new(f64::from(y[0]), f64::from(y[1]))
                    });
                    let a =
                        if body == 0 { episode.response(k, lag).map(f64::from) } else { Vector2::zeros() };
                    out.push((half, a));
                }
            }
        }
        trimmed(out)
    };
    let (c, u, lagged) = (windows(0, 1), windows(1, 1), windows(0, lag));
    let fit = |ridge: f64| -> Option<Linear> {
        let (c0, c1, _) = linear::fit_pinned(&c, ridge)?;
        let (u0, u1) = linear::fit_free(&u, ridge)?;
        Some(Linear { c0, c1, ca: linear::fit_action(&lagged), u0, u1 })
    };
    let off = |linear: &Linear| {
        let identity = nalgebra::Matrix2::identity();
        let one = |psi: linear::PlaneLinear| {
            ((psi.newer - identity * 2.0).norm_squared() + (psi.older + identity).norm_squared()).sqrt()
        };
        one(linear.controllable(&planes[0])).max(one(linear.uncontrollable(&planes[1])))
    };
    let (linear, free) = (fit(ridge)?, fit(FREE_RIDGE)?);
    Some(FittedPredictor { off: off(&linear), off_free: off(&free), linear })
}

/// What keeps the normal equations regular where no ridge is wanted: 14 of 16 dimensions are empty.
const FREE_RIDGE: f64 = 1e-9;

/// The windows without those that a wall, a bounce or a lost body bent: within six median deviations of what
/// constant velocity and the best action explain.
fn trimmed(windows: Vec<Window>) -> Vec<Window> {
    let action = linear::fit_action(&windows);
    let size = |(z, a): &Window| (z[2] - z[1] * 2.0 + z[0] - action * a).norm();
    let mut sizes: Vec<f64> = windows.iter().map(size).collect();
    sizes.sort_by(f64::total_cmp);
    let limit = 6.0 * sizes.get(sizes.len() / 2).copied().unwrap_or_default();
    windows.into_iter().filter(|w| size(w) <= limit).collect()
}

/// A picture from which the heads learn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadSample {
    /// Both bodies, px.
    pub p: [[f32; 2]; BODIES],
    /// The base station, picture sides.
    pub station: Vector2<f64>,
    /// Measured gain, dB and a constant.
    pub gain_db: f32,
    /// Distance of the bodies' centres, px: the smaller one of this picture and the one before.
    pub distance_px: f64,
    /// Whether they touched since then.
    pub contact: bool,
}

/// The pictures with good readings of both bodies and a measured gain.
#[must_use]
pub fn head_samples(
    readings: &EpisodeReadings,
    recording: &Recording,
    noise: &ReadingNoise,
) -> Vec<HeadSample> {
    let mut out = Vec::new();
    let apart = |v: &Votes| {
        let [c, u] = v.p;
        f64::from((c[0] - u[0]).hypot(c[1] - u[1]))
    };
    for (episode, votes) in recording.episodes().iter().zip(&readings.votes) {
        let Some(station) = episode.base_station else { continue };
        for k in 1..votes.len() {
            let both = |v: &Votes| is_good(noise, v, 0) && is_good(noise, v, 1);
            let (Some(gain_db), true) = (episode.gain_db(k), both(&votes[k]) && both(&votes[k - 1])) else {
                continue;
            };
            let distance_px = apart(&votes[k]).min(apart(&votes[k - 1]));
            let contact = episode.steps[k].contact;
            out.push(HeadSample { p: votes[k].p, station, gain_db, distance_px, contact });
        }
    }
    out
}

/// The distance of the centres at which the bodies touch, px, from the contacts alone: where as many contacts are
/// missed beyond it as there are none within. `None` without both.
#[must_use]
pub fn touch_distance_px(samples: &[HeadSample]) -> Option<f64> {
    let mut sorted: Vec<(f64, bool)> = samples.iter().map(|s| (s.distance_px, s.contact)).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let touched = sorted.iter().filter(|(_, contact)| *contact).count();
    if touched == 0 || touched == sorted.len() {
        return None;
    }
    // Errors of the rule "they touch within d": contacts beyond d and none within d.
    let (mut errors, mut best) = (touched, (touched, sorted[0].0));
    for pair in sorted.windows(2) {
        errors = if pair[0].1 { errors - 1 } else { errors + 1 };
        if errors < best.0 {
            best = (errors, 0.5 * (pair[0].0 + pair[1].0));
        }
    }
    Some(best.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_of_touch_is_found_from_contacts() {
        let sample = |n: usize| {
            let distance_px = n as f64 * 0.05;
            // A few are told wrongly, on both sides.
            let contact = (distance_px < 12.0) != n.is_multiple_of(41);
            HeadSample { p: [[0.0; 2]; 2], station: Vector2::zeros(), gain_db: 0.0, distance_px, contact }
        };
        let samples: Vec<HeadSample> = (0..1000).map(sample).collect();
        assert!((touch_distance_px(&samples).unwrap() - 12.0).abs() < 0.1);
        assert_eq!(touch_distance_px(&samples[500..500]), None);
    }
}
