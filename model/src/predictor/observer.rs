//! The latent observer: place and speed of both halves from the last M frames and the actions flown
//! between them.
//!
//! Two frames give a speed that carries both frames' errors, and a rollout of 100 steps multiplies
//! it by 100. Here every frame of a window counts: a Kalman filter runs over the window from its
//! first frame on, so without an assumed disturbance (`gust` 0) it is least squares after the
//! actions' contribution is taken out, and with a large one it leans on the last two frames. Plane
//! coordinates throughout. Knows latents and actions; neither frames nor positions.
//!
//! - A missing frame is a step without a measurement.
//! - The speed limit is part of the prediction: at v_max the linear model alone would run ahead.
//! - A poor frame (a disc that the frame cuts, a UAV over the obstacle) weighs less.
//! - A wall or a bounce breaks the model: an innovation that no frame's error explains, or several poor
//!   frames in a row, and the window restarts with the last two.

mod steady;

use std::collections::VecDeque;

use nalgebra::{Matrix2, Matrix4, Matrix4x2, Vector2, Vector4};

use crate::predictor::Predictor;
use crate::predictor::bounded::shorten;
use crate::predictor::linear::Displacement;

pub use steady::{STEADY_MEMORY, steadied};

/// Assumed standard deviation of a decoded coordinate, units: 0.03 px. Whole discs on empty
/// ground are three times better; a rim of the obstacle under the UAV is not.
pub const FRAME_NOISE: f64 = 3e-4;

/// Missing share of the UAV's colour beyond which the frame's edge cuts its disc; below, the pixels'
/// rounding.
const WHOLE: f32 = 2e-3;

/// How many times further off such a frame is, and a row of them is off alike.
const CUT: f64 = 4.0;

/// Standard deviation of the UAV's coordinates in units of [`FRAME_NOISE`], from the missing share q of
/// its colour: a whole disc is more accurate than one that the frame's edge cuts.
#[must_use]
pub fn sigma_scale(missing: f32) -> f64 {
    if missing.abs() > WHOLE { CUT } else { 1.0 }
}

/// What a frame shows of one half.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatentReading {
    /// y
    pub y: Vector2<f64>,
    /// Its standard deviation in units of [`FRAME_NOISE`].
    pub sigma_scale: f64,
}

impl From<Vector2<f64>> for LatentReading {
    fn from(y: Vector2<f64>) -> Self {
        Self { y, sigma_scale: 1.0 }
    }
}

/// Squared Mahalanobis distance beyond which a frame is poor: four standard deviations.
const POOR: f64 = 16.0;

/// Squared Mahalanobis distance beyond which the window breaks: 25 standard deviations, 0.8 px.
const BREAK: f64 = 625.0;

/// Longest step in an interval that two readings of one body may be apart where no limit is known, units.
const FASTEST: f64 = 0.05;

/// Second differences from which a window's roughness is told.
const LEAST_DIFFERENCES: usize = 6;

/// Largest roughness.
const ROUGHEST: f64 = 30.0;

/// Missing frames after which earlier frames are dropped.
const LONGEST_GAP: usize = 50;

/// Poor frames in a row that break the window.
const PATIENCE: usize = 3;

/// Variance of a speed of which nothing is known, in units of a frame's.
const UNKNOWN: f64 = 1e8;

/// How one half moves, in plane coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionModel {
    /// Predicts the next interval.
    pub predictor: Predictor,
    /// Longest step in an interval, latent units; infinite where no limit is known.
    pub reach: f64,
    /// Standard deviation of a frame's coordinate, latent units.
    pub noise: f64,
    /// Standard deviation of the speed's disturbance in an interval and axis, latent units.
    pub gust: f64,
    /// Whether a frame may show the half somewhere else altogether: then one frame alone breaks no window, but two
    /// that agree.
    pub lost: bool,
}

impl MotionModel {
    /// A half with `scale` latent units per unit of length; `v_max` (infinite where no limit is known) and
    /// `gust`, the standard deviation of a gust, in units per interval.
    #[must_use]
    pub fn new(predictor: Predictor, scale: f64, v_max: f64, gust: f64) -> Self {
        Self { predictor, reach: scale * v_max, noise: scale * FRAME_NOISE, gust: scale * gust, lost: false }
    }

    /// One step of (y, y - y_before) under an action, and its Jacobian.
    fn step(&self, state: &Vector4<f64>, a: Vector2<f64>) -> (Vector4<f64>, Matrix4<f64>) {
        let (y, v) = (state.fixed_rows::<2>(0).into_owned(), state.fixed_rows::<2>(2).into_owned());
        let Displacement { mut step, mut by_y, mut by_v } = self.predictor.displacement(y, v, a);
        if let Some((short, turn)) = shorten(step, self.reach) {
            (by_y, by_v) = (turn * by_y, turn * by_v);
            step = short;
        }
        let mut jacobian = Matrix4::zeros();
        jacobian.fixed_view_mut::<2, 2>(0, 0).copy_from(&(Matrix2::identity() + by_y));
        jacobian.fixed_view_mut::<2, 2>(0, 2).copy_from(&by_v);
        jacobian.fixed_view_mut::<2, 2>(2, 0).copy_from(&by_y);
        jacobian.fixed_view_mut::<2, 2>(2, 2).copy_from(&by_v);
        let next = y + step;
        (Vector4::new(next.x, next.y, step.x, step.y), jacobian)
    }
}

/// Where a half is and how far it moved in the last interval, plane coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// y
    pub y: Vector2<f64>,
    /// y_k - y_{k-1}; zero until two frames have been seen.
    pub v: Vector2<f64>,
}

impl Estimate {
    /// y one interval earlier: the older latent that the predictor reads.
    #[must_use]
    pub fn before(&self) -> Vector2<f64> {
        self.y - self.v
    }
}

/// How well an [`Estimate`] is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Certainty {
    /// Covariance of y, latent units squared.
    pub y: Matrix2<f64>,
    /// Covariance of v, latent units squared; says nothing unless `moving`.
    pub v: Matrix2<f64>,
    /// Whether two frames have given a speed.
    pub moving: bool,
    /// Whether the newest frame shows the half somewhere else, and was left out.
    pub disagrees: bool,
}

/// An interval and the frame at its end.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Interval {
    /// Normalised acceleration that was flown in it.
    flown: Vector2<f64>,
    /// What the frame shows, if it arrived.
    seen: Option<LatentReading>,
}

/// The window of one half.
#[derive(Debug, Clone)]
pub struct LatentObserver {
    motion: MotionModel,
    /// Frames that an estimate is made of.
    window: usize,
    /// Frames that are kept.
    memory: usize,
    last: VecDeque<Interval>,
}

impl LatentObserver {
    /// Nothing seen; at most `window` (at least 2) frames are kept.
    #[must_use]
    pub fn new(motion: MotionModel, window: usize) -> Self {
        let window = window.max(2);
        Self { motion, window, memory: window, last: VecDeque::new() }
    }

    /// The same, and so many frames are kept for [`steadied`].
    #[must_use]
    pub fn remembering(self, frames: usize) -> Self {
        Self { memory: frames.max(self.window), ..self }
    }

    /// A frame has come; `flown` are the normalised accelerations of the intervals since the last
    /// frame, oldest first: one, or more where frames are missing.
    pub fn observe(&mut self, seen: impl Into<LatentReading>, flown: &[Vector2<f64>]) {
        let (newest, missing) = flown.split_last().map_or((Vector2::zeros(), flown), |(a, rest)| (*a, rest));
        if missing.len() >= LONGEST_GAP {
            self.last.clear();
        } else {
            self.last.extend(missing.iter().map(|a| Interval { flown: *a, seen: None }));
        }
        self.last.push_back(Interval { flown: newest, seen: Some(seen.into()) });
        while self.last.iter().filter(|i| i.seen.is_some()).count() > self.memory {
            self.last.pop_front();
        }
    }

    /// Place and speed at the newest frame; `None` before the first.
    #[must_use]
    pub fn estimate(&self) -> Option<Estimate> {
        let recent = self.recent(self.window);
        // Two frames and no more are their difference, to the last bit.
        if let (2, [.., Interval { seen: Some(before), .. }, Interval { seen: Some(now), .. }]) =
            (self.window, recent.as_slice())
        {
            return Some(Estimate { y: now.y, v: now.y - before.y });
        }
        Some(self.within_reach(&self.filtered(&recent)?.filter))
    }

    /// What a filter says, but that no encoded step faster than v_max is real.
    fn within_reach(&self, filter: &Filter) -> Estimate {
        let Estimate { y, v } = filter.estimate();
        let v = if v.norm() > self.motion.reach { v * (self.motion.reach / v.norm()) } else { v };
        Estimate { y, v }
    }

    /// The intervals since the last `frames` frames, oldest first.
    fn recent(&self, frames: usize) -> Vec<Interval> {
        let mut left = frames;
        let newest = self.last.iter().rev().take_while(|interval| {
            let counted = usize::from(interval.seen.is_some());
            let within = left >= counted;
            left = left.saturating_sub(counted);
            within
        });
        let mut recent: Vec<Interval> = newest.copied().collect();
        recent.reverse();
        recent
    }

    /// How well place and speed at the newest frame are known; `None` before the first.
    #[must_use]
    pub fn certainty(&self) -> Option<Certainty> {
        let Filtered { filter, disagrees, .. } = self.filtered(&self.recent(self.window))?;
        let covariance = |at| filter.covariance.fixed_view::<2, 2>(at, at).into_owned();
        Some(Certainty { y: covariance(0), v: covariance(2), moving: filter.moving, disagrees })
    }

    /// The filter over these intervals, after the newest frame.
    fn filtered(&self, intervals: &[Interval]) -> Option<Filtered> {
        let rough = if self.motion.lost { self.roughness(intervals) } else { 1.0 };
        let noise = |seen| rough * self.noise(seen);
        let mut filter: Option<Filter> = None;
        let mut since = 0;
        let mut before: Option<(usize, LatentReading)> = None;
        let mut odd: Option<(usize, LatentReading)> = None;
        for (k, interval) in intervals.iter().enumerate() {
            if let Some(filter) = &mut filter {
                filter.predict(&self.motion, interval.flown);
            }
            let Some(seen) = interval.seen else { continue };
            let fits = filter.as_mut().is_some_and(|f| f.update(seen.y, noise(seen)));
            if fits {
                odd = None;
            } else if !self.motion.lost || filter.is_none() {
                since = before.map_or(k, |(first, _)| first);
                filter = Some(self.anew(intervals, before, k, seen, rough));
            } else if odd.is_some_and(|other| self.agree(other, (k, seen), rough)) {
                // Two frames in a row against what was predicted: a wall, or what came before was lost.
                since = odd.map_or(k, |(first, _)| first);
                filter = Some(self.anew(intervals, odd.take(), k, seen, rough));
            } else {
                odd = Some((k, seen));
                continue;
            }
            before = Some((k, seen));
        }
        Some(Filtered { filter: filter?, disagrees: odd.is_some(), since })
    }

    /// Where the half is after further intervals in which these normalised accelerations are flown, oldest first:
    /// the latent prediction, within the speed limit.
    #[must_use]
    pub fn ahead(&self, from: Estimate, flown: &[Vector2<f64>]) -> Estimate {
        let mut state = Vector4::new(from.y.x, from.y.y, from.v.x, from.v.y);
        for a in flown {
            state = self.motion.step(&state, *a).0;
        }
        Estimate { y: state.fixed_rows::<2>(0).into_owned(), v: state.fixed_rows::<2>(2).into_owned() }
    }

    /// How many times further off the readings of this window are than their encoder says: a camera that shakes, a
    /// ground that it has not seen. From second differences less what the actions add, whose median no lost body
    /// and no wall moves; at least 1.
    fn roughness(&self, intervals: &[Interval]) -> f64 {
        let mut ratios: Vec<f64> = intervals
            .windows(3)
            .filter_map(|w| {
                let off = self.second_difference(w)?;
                let [a, b, c] = [w[0].seen?, w[1].seen?, w[2].seen?].map(|r| self.noise(r).powi(2));
                Some(off.norm_squared() / (a + 4.0 * b + c + self.motion.gust.powi(2)))
            })
            .collect();
        if ratios.len() < LEAST_DIFFERENCES {
            return 1.0;
        }
        ratios.sort_by(f64::total_cmp);
        // The median of a squared normal deviate in two dimensions is 2 ln 2.
        let median = ratios[ratios.len() / 2] / (2.0 * std::f64::consts::LN_2);
        median.sqrt().clamp(1.0, ROUGHEST)
    }

    /// y_2 - 2 y_1 + y_0 of three intervals, less what the action adds; `None` if a frame is missing.
    fn second_difference(&self, three: &[Interval]) -> Option<Vector2<f64>> {
        let [a, b, c] = [three[0].seen?, three[1].seen?, three[2].seen?];
        Some(c.y - b.y - self.motion.predictor.displacement(b.y, b.y - a.y, three[2].flown).step)
    }

    /// A filter that knows the frame of interval `k` and the one before it.
    fn anew(
        &self,
        intervals: &[Interval],
        before: Option<(usize, LatentReading)>,
        k: usize,
        seen: LatentReading,
        rough: f64,
    ) -> Filter {
        let noise = |seen| rough * self.noise(seen);
        let Some((since, first)) = before else { return Filter::at(seen.y, noise(seen)) };
        let mut filter = Filter::at(first.y, noise(first));
        for interval in &intervals[since + 1..=k] {
            filter.predict(&self.motion, interval.flown);
        }
        filter.correct(seen.y, noise(seen));
        filter
    }

    /// Whether a body can have moved from one reading to the other.
    fn agree(
        &self,
        (since, first): (usize, LatentReading),
        (k, seen): (usize, LatentReading),
        rough: f64,
    ) -> bool {
        let step = self.motion.reach.min(FASTEST * self.motion.noise / FRAME_NOISE);
        let errors = rough * (self.noise(first) + self.noise(seen));
        (seen.y - first.y).norm() <= step * (k - since) as f64 + POOR.sqrt() * errors
    }

    /// Standard deviation of a frame's coordinate, latent units.
    fn noise(&self, seen: LatentReading) -> f64 {
        self.motion.noise * seen.sigma_scale
    }
}

/// What a filter has come to.
struct Filtered {
    filter: Filter,
    /// Whether the newest frame shows the half somewhere else, and was left out.
    disagrees: bool,
    /// Index of the first interval that the filter knows of.
    since: usize,
}

/// (y, v) and its covariance.
#[derive(Debug, Clone, Copy)]
struct Filter {
    state: Vector4<f64>,
    covariance: Matrix4<f64>,
    /// Whether a second frame has given a velocity.
    moving: bool,
    /// Poor frames since the last good one.
    poor: usize,
}

impl Filter {
    /// One frame: a place, no speed.
    fn at(y: Vector2<f64>, noise: f64) -> Self {
        let r = noise * noise;
        let covariance = Matrix4::from_diagonal(&Vector4::new(r, r, UNKNOWN * r, UNKNOWN * r));
        Self { state: Vector4::new(y.x, y.y, 0.0, 0.0), covariance, moving: false, poor: 0 }
    }

    fn predict(&mut self, motion: &MotionModel, a: Vector2<f64>) {
        let (next, jacobian) = motion.step(&self.state, a);
        // The gust enters the speed, and with it the place.
        let entry = Matrix4x2::new(1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0) * motion.gust;
        self.state = next;
        self.covariance = jacobian * self.covariance * jacobian.transpose() + entry * entry.transpose();
    }

    /// Takes in a frame; `false` if what was predicted cannot be true.
    fn update(&mut self, y: Vector2<f64>, noise: f64) -> bool {
        let off = y - self.state.fixed_rows::<2>(0);
        let Some(inverse) = self.spread(noise).try_inverse() else { return false };
        let distance = off.dot(&(inverse * off));
        self.poor = if distance > POOR { self.poor + 1 } else { 0 };
        if distance > BREAK || self.poor >= PATIENCE {
            return false;
        }
        self.correct(y, noise * (distance / POOR).max(1.0).sqrt());
        true
    }

    fn spread(&self, noise: f64) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0) + Matrix2::identity() * (noise * noise)
    }

    fn correct(&mut self, y: Vector2<f64>, noise: f64) {
        let Some(inverse) = self.spread(noise).try_inverse() else { return };
        let gain = self.covariance.fixed_columns::<2>(0) * inverse;
        let off = y - self.state.fixed_rows::<2>(0);
        self.state += gain * off;
        // Joseph's form: stays symmetric and positive where the speed was unknown.
        let mut keep = Matrix4::identity();
        let mut left = keep.fixed_columns_mut::<2>(0);
        left -= gain;
        self.covariance =
            keep * self.covariance * keep.transpose() + gain * gain.transpose() * (noise * noise);
        self.moving = true;
    }

    fn estimate(&self) -> Estimate {
        let y = self.state.fixed_rows::<2>(0).into_owned();
        let v = if self.moving { self.state.fixed_rows::<2>(2).into_owned() } else { Vector2::zeros() };
        Estimate { y, v }
    }
}

#[cfg(test)]
mod tests;
