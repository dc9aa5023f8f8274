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

use std::collections::VecDeque;

use nalgebra::{Matrix2, Matrix4, Matrix4x2, Vector2, Vector4};

use crate::predictor::Predictor;
use crate::predictor::bounded::shorten;
use crate::predictor::linear::Displacement;

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

    /// The place of a half if it stands still: the mean of the readings near `way`, each by its own error and the
    /// camera's `shake`, a variance. `None` if a straight line fits them better than a half that stands would let it.
    fn standing(&self, intervals: &[Interval], way: Estimate, shake: f64) -> Option<Estimate> {
        let near = intervals.iter().rev().enumerate().filter_map(|(back, interval)| {
            let (seen, back) = (interval.seen?, back as f64);
            let error = shake + self.noise(seen).powi(2);
            let off = seen.y - (way.y - way.v * back);
            (off.norm_squared() <= POOR * error).then_some((back, seen.y, 1.0 / error))
        });
        let near: Vec<(f64, Vector2<f64>, f64)> = near.collect();
        if near.len() < LEAST_DIFFERENCES {
            return None;
        }
        let weights: f64 = near.iter().map(|(_, _, w)| w).sum();
        let when = near.iter().map(|(back, _, w)| w * back).sum::<f64>() / weights;
        let mean = near.iter().map(|(_, y, w)| y * *w).sum::<Vector2<f64>>() / weights;
        let lever: f64 = near.iter().map(|(back, _, w)| w * (back - when).powi(2)).sum();
        let slope =
            near.iter().map(|(back, y, w)| (y - mean) * (w * (back - when))).sum::<Vector2<f64>>() / lever;
        let explained = slope.norm_squared() * lever;
        let total: f64 = near.iter().map(|(_, y, w)| w * (y - mean).norm_squared()).sum();
        let each = (total - explained) / (2 * near.len() - 4) as f64;
        (explained <= STANDING * each).then(|| Estimate { y: mean, v: Vector2::zeros() })
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

/// Least correlation of both halves' second differences from which the camera is said to shake.
const SHAKEN: f64 = 0.7;

/// A second difference so many times the median's size is no shake: a body that was lost, a wall.
const OUTLIER: f64 = 4.0;

/// What a straight line may explain of z_u's readings, in variances of one, while z_u still stands; one that stands
/// stays below in 2,999 of 3,000 cases (2 degrees of freedom).
const STANDING: f64 = 16.0;

/// Frames of z_u that are worth keeping for [`steadied`].
pub const STEADY_MEMORY: usize = 100;

/// Both halves from a camera that shakes; `None` where it does not, or that is not yet known.
///
/// A shake moves both bodies alike, and nothing else does: it is told by the correlation of their second
/// differences. z_u moves evenly or stands, so its way through all frames that are kept says by how much each frame is
/// off, and z_c is corrected by as much of that as is shake and not z_u's own error.
#[must_use]
pub fn steadied(c: &LatentObserver, u: &LatentObserver) -> Option<(Estimate, Estimate)> {
    let mut recent = c.recent(c.window);
    let variance = shake(c, u, &recent)?;
    let all = u.recent(u.memory);
    let Filtered { filter, since, .. } = u.filtered(&all)?;
    let way = u.within_reach(&filter);
    let way = u.standing(&all[since..], way, variance).unwrap_or(way);
    for (back, interval) in recent.iter_mut().rev().enumerate() {
        let Some(seen) = &mut interval.seen else { continue };
        let own = c.noise(*seen).powi(2);
        // As far as z_u's way is known, and the frame shows z_u near it.
        let other = all.len().checked_sub(back + 1).filter(|k| *k >= since).and_then(|k| all[k].seen);
        let steady = other.and_then(|other| {
            let error = u.noise(other).powi(2);
            let off = other.y - (way.y - way.v * back as f64);
            (off.norm_squared() <= POOR * (variance + error)).then_some((off, error))
        });
        let left = match steady {
            Some((off, error)) => {
                let share = variance / (variance + error);
                seen.y -= off * share;
                share * error
            }
            None => variance,
        };
        seen.sigma_scale = (own + left).sqrt() / c.motion.noise;
    }
    let steady = LatentObserver { last: recent.into(), ..c.clone() };
    Some((steady.estimate()?, way))
}

/// Variance of a coordinate by the camera's shake, latent units squared; `None` if it does not shake.
fn shake(c: &LatentObserver, u: &LatentObserver, recent: &[Interval]) -> Option<f64> {
    if !(c.motion.lost && u.motion.lost) {
        return None;
    }
    let other = u.recent(c.window);
    let each = recent.windows(3).rev().zip(other.windows(3).rev());
    let pairs: Vec<[Vector2<f64>; 2]> =
        each.filter_map(|(a, b)| Some([c.second_difference(a)?, u.second_difference(b)?])).collect();
    let median = |half: usize| {
        let mut sizes: Vec<f64> = pairs.iter().map(|pair| pair[half].norm_squared()).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).copied()
    };
    let bounds = [median(0)?, median(1)?].map(|size| OUTLIER * OUTLIER * size);
    let within = |pair: &&[Vector2<f64>; 2]| (0..2).all(|k| pair[k].norm_squared() <= bounds[k]);
    let kept: Vec<_> = pairs.iter().filter(within).collect();
    let sum = |f: fn(&[Vector2<f64>; 2]) -> f64| kept.iter().map(|pair| f(pair)).sum::<f64>();
    let (both, of_c, of_u) =
        (sum(|[c, u]| c.dot(u)), sum(|[c, _]| c.norm_squared()), sum(|[_, u]| u.norm_squared()));
    let shaken = kept.len() >= LEAST_DIFFERENCES && both > SHAKEN * (of_c * of_u).sqrt();
    // A second difference of white noise has six times its variance, in each of two axes.
    (shaken && both > 0.0).then(|| both / (12.0 * kept.len() as f64))
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
mod tests {
    use crpl_sitl::world::noise::{Noise, Stream};
    use rand::Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::predictor::linear::PlaneLinear;

    const SCALE: f64 = 10.0;

    fn motion(gust: f64) -> MotionModel {
        let (two, one) = (Matrix2::identity() * 2.0, Matrix2::identity());
        let ca = Matrix2::new(0.035, 0.001, -0.002, 0.034);
        let linear = PlaneLinear { newer: two, older: -one, action: ca };
        MotionModel::new(Predictor::Linear(linear), SCALE, 0.04, gust)
    }

    /// A flight that obeys `motion`: places, and the action flown before each.
    fn flight(
        motion: &MotionModel,
        steps: usize,
        gust: f64,
        rng: &mut impl Rng,
    ) -> Vec<(Vector2<f64>, Vector2<f64>)> {
        let mut normal = || -> f64 { StandardNormal.sample(rng) };
        let mut state = Vector4::new(1.0, -2.0, 0.1, 0.05);
        let mut out = vec![(Vector2::new(1.0, -2.0), Vector2::zeros())];
        for k in 0..steps {
            let a = Vector2::new((k as f64 * 1.3).sin(), (k as f64 * 0.7).cos());
            let pushed = a + Vector2::new(normal(), normal()) * (gust / 0.0035);
            state = motion.step(&state, pushed).0;
            out.push((state.fixed_rows::<2>(0).into_owned(), a));
        }
        out
    }

    fn truth(flight: &[(Vector2<f64>, Vector2<f64>)]) -> Estimate {
        let [.., before, now] = flight else { unreachable!("a flight has two places") };
        Estimate { y: now.0, v: now.0 - before.0 }
    }

    fn apart(a: Estimate, b: Estimate) -> f64 {
        (a.y - b.y).norm().max((a.v - b.v).norm())
    }

    #[test]
    fn without_noise_it_is_exact_for_every_window() {
        let mut rng = Noise::new(1).generator(Stream::Evaluation, 0);
        let flight = flight(&motion(0.0), 40, 0.0, &mut rng);
        for window in [2, 3, 10, 20, 50] {
            for gust in [0.0, 0.0015] {
                let mut observer = LatentObserver::new(motion(gust), window);
                for (y, a) in &flight {
                    observer.observe(*y, &[*a]);
                }
                let off = apart(observer.estimate().unwrap(), truth(&flight));
                assert!(off < 1e-6, "window {window}, gust {gust}: off by {off}");
            }
        }
    }

    #[test]
    fn two_frames_are_the_difference_and_one_stands_still() {
        let mut observer = LatentObserver::new(motion(0.0), 2);
        assert_eq!(observer.estimate(), None);
        observer.observe(Vector2::new(1.0, 2.0), &[]);
        assert_eq!(observer.estimate(), Some(Estimate { y: Vector2::new(1.0, 2.0), v: Vector2::zeros() }));
        observer.observe(Vector2::new(1.1, 1.9), &[Vector2::new(1.0, 0.0)]);
        let found = observer.estimate().unwrap();
        let wanted = Estimate { y: Vector2::new(1.1, 1.9), v: Vector2::new(0.1, -0.1) };
        assert!(apart(found, wanted) < 1e-6, "{found:?}");
    }

    #[test]
    fn more_frames_see_the_speed_better_and_gusts_are_not_averaged_away() {
        let mut rng = Noise::new(2).generator(Stream::Evaluation, 0);
        let speed_error = |window: usize, reckoned: f64, gust: f64, rng: &mut _| -> f64 {
            let squares: Vec<f64> = (0..200)
                .map(|_| {
                    let flight = flight(&motion(0.0), 30, gust, rng);
                    let mut observer = LatentObserver::new(motion(reckoned), window);
                    for (y, a) in &flight {
                        let noise = Vector2::new(StandardNormal.sample(rng), StandardNormal.sample(rng));
                        observer.observe(y + noise * (SCALE * FRAME_NOISE), &[*a]);
                    }
                    (observer.estimate().unwrap().v - truth(&flight).v).norm_squared()
                })
                .collect();
            (squares.iter().sum::<f64>() / 200.0).sqrt() / (SCALE * FRAME_NOISE)
        };
        // Least squares: the speed's variance is 12/(M(M²-1)) of a frame's in each axis, and twice at 2.
        let (two, twenty) = (speed_error(2, 0.0, 0.0, &mut rng), speed_error(20, 0.0, 0.0, &mut rng));
        assert!((1.7..2.3).contains(&two), "{two}");
        let ideal = (24.0f64 / (20.0 * 399.0)).sqrt();
        assert!((0.8 * ideal..1.3 * ideal).contains(&twenty), "{twenty} instead of {ideal}");
        // In gusts five times a frame's error, the filter that reckons with them is no worse than two.
        let (two, kalman) =
            (speed_error(2, 0.0, 0.0015, &mut rng), speed_error(20, 0.0015, 0.0015, &mut rng));
        assert!(kalman < 1.02 * two, "{kalman} with 20 frames, {two} with 2");
    }

    #[test]
    fn a_missing_frame_is_bridged_by_the_actions_flown() {
        let mut rng = Noise::new(3).generator(Stream::Evaluation, 0);
        let flight = flight(&motion(0.0), 30, 0.0, &mut rng);
        let mut observer = LatentObserver::new(motion(0.0), 20);
        let mut pending = Vec::new();
        for (k, (y, a)) in flight.iter().enumerate() {
            pending.push(*a);
            if ![12, 13, 14, 27].contains(&k) {
                observer.observe(*y, &pending);
                pending.clear();
            }
        }
        let off = apart(observer.estimate().unwrap(), truth(&flight));
        assert!(off < 1e-6, "off by {off}");
        // A gap longer than the window leaves one frame, of which no speed is known.
        observer.observe(Vector2::new(3.0, 3.0), &[Vector2::zeros(); 100]);
        assert_eq!(observer.estimate().unwrap().v, Vector2::zeros());
    }

    #[test]
    fn ahead_is_where_the_same_actions_lead() {
        let mut rng = Noise::new(5).generator(Stream::Evaluation, 0);
        let flight = flight(&motion(0.0), 40, 0.0, &mut rng);
        let mut observer = LatentObserver::new(motion(0.0), 20);
        flight[..=25].iter().for_each(|(y, a)| observer.observe(*y, &[*a]));
        let flown: Vec<_> = flight[26..].iter().map(|(_, a)| *a).collect();
        let now = observer.estimate().unwrap();
        assert!(apart(observer.ahead(now, &flown), truth(&flight)) < 1e-6);
        assert_eq!(observer.ahead(now, &[]), now);
    }

    /// A UAV in gusts beside an obstacle that stands, as a camera shows them that shakes by so many units; the error
    /// of the UAV's place and speed, root mean square, alone and steadied by the obstacle.
    fn errors_with_shake(shake: f64) -> [f64; 4] {
        let mut rng = Noise::new(6).generator(Stream::Evaluation, 0);
        let learned = |gust| MotionModel { lost: true, ..motion(gust) };
        let mut sums = [0.0; 4];
        for _ in 0..60 {
            let flight = flight(&motion(0.0), 60, 0.0015, &mut rng);
            let mut c = LatentObserver::new(learned(0.0015), 20);
            let mut u = LatentObserver::new(learned(0.0), 20).remembering(STEADY_MEMORY);
            for (y, a) in &flight {
                let mut normal = |size: f64| {
                    let [x, y]: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
                    Vector2::new(x, y) * (SCALE * size)
                };
                let (off, own, others) = (normal(shake), normal(FRAME_NOISE), normal(FRAME_NOISE));
                c.observe(y + off + own, &[*a]);
                u.observe(Vector2::new(2.0, 1.0) + off + others, &[Vector2::zeros()]);
            }
            let (truth, alone) = (truth(&flight), c.estimate().unwrap());
            let steady = steadied(&c, &u).map_or(alone, |(c, _)| c);
            for (k, found) in [alone, steady].into_iter().enumerate() {
                sums[2 * k] += (found.y - truth.y).norm_squared() / 60.0;
                sums[2 * k + 1] += (found.v - truth.v).norm_squared() / 60.0;
            }
        }
        sums.map(|square| square.sqrt() / SCALE)
    }

    #[test]
    fn an_obstacle_steadies_a_camera_that_shakes() {
        let [place, speed, steady_place, steady_speed] = errors_with_shake(0.01);
        assert!(steady_place < 0.3 * place, "{steady_place} of {place}");
        assert!(steady_speed < 0.5 * speed, "{steady_speed} of {speed}");
        // One that does not shake is left alone, to the last bit.
        let [place, speed, steady_place, steady_speed] = errors_with_shake(0.0);
        assert_eq!([place, speed], [steady_place, steady_speed]);
    }

    #[test]
    fn the_action_flown_counts_and_not_another() {
        let mut rng = Noise::new(4).generator(Stream::Evaluation, 0);
        let flight = flight(&motion(0.0), 25, 0.0, &mut rng);
        let watch = |told: &dyn Fn(usize) -> Vector2<f64>| {
            let mut observer = LatentObserver::new(motion(0.0), 20);
            for (k, (y, _)) in flight.iter().enumerate() {
                observer.observe(*y, &[told(k)]);
            }
            apart(observer.estimate().unwrap(), truth(&flight))
        };
        let flown = watch(&|k| flight[k].1);
        // Told what was sent in an outage of the last four intervals, and not what was held: too little
        // for the gate to see.
        let sent = watch(&|k| flight[k].1 + Vector2::new(if k < 21 { 0.0 } else { 0.2 }, 0.0));
        assert!(flown < 1e-6 && sent > 1e-3, "{flown} and {sent}");
    }

    #[test]
    fn one_poor_frame_spoils_nothing() {
        let mut rng = Noise::new(6).generator(Stream::Evaluation, 0);
        let flight = flight(&motion(0.0), 25, 0.0, &mut rng);
        let mut observer = LatentObserver::new(motion(0.0), 20);
        for (k, (y, a)) in flight.iter().enumerate() {
            let wrong = if k == 22 { 15.0 * SCALE * FRAME_NOISE } else { 0.0 };
            observer.observe(y + Vector2::new(wrong, 0.0), &[*a]);
        }
        let off = (observer.estimate().unwrap().v - truth(&flight).v).norm();
        // Two frames around it would be wrong by 15 standard deviations.
        assert!(off < 0.5 * SCALE * FRAME_NOISE, "off by {off}");
    }

    #[test]
    fn a_frame_that_shows_the_body_elsewhere_breaks_nothing_where_bodies_are_lost() {
        let mut rng = Noise::new(6).generator(Stream::Evaluation, 1);
        let lost = MotionModel { lost: true, ..motion(0.0) };
        let flight = flight(&lost, 25, 0.0, &mut rng);
        let watch = |motion: &MotionModel, gone: &[usize]| {
            let mut observer = LatentObserver::new(motion.clone(), 20);
            for (k, (y, a)) in flight.iter().enumerate() {
                let wrong = if gone.contains(&k) { 4.0 + k as f64 } else { 0.0 };
                observer.observe(y + Vector2::new(wrong, -wrong), &[*a]);
            }
            apart(observer.estimate().unwrap(), truth(&flight))
        };
        for gone in [&[15][..], &[25], &[12, 13, 19], &[6, 20]] {
            let off = watch(&lost, gone);
            assert!(off < 1e-3, "lost in {gone:?}: off by {off}");
        }
        assert!(watch(&motion(0.0), &[25]) > 1.0, "the clean drawing loses no body");
    }

    #[test]
    fn a_camera_that_shakes_more_than_the_encoder_says_is_averaged_out() {
        let mut rng = Noise::new(7).generator(Stream::Evaluation, 1);
        let lost = MotionModel { lost: true, ..motion(0.0) };
        let mut errors = [0.0; 2];
        for _ in 0..60 {
            let flight = flight(&lost, 25, 0.0, &mut rng);
            for (n, model) in [lost.clone(), motion(0.0)].into_iter().enumerate() {
                let mut observer = LatentObserver::new(model, 20);
                for (y, a) in &flight {
                    let shake =
                        Vector2::new(StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng));
                    observer.observe(y + shake * (10.0 * SCALE * FRAME_NOISE), &[*a]);
                }
                errors[n] += (observer.estimate().unwrap().v - truth(&flight).v).norm() / 60.0;
            }
        }
        assert!(3.0 * errors[0] < errors[1], "{errors:?}");
        assert!(errors[0] < SCALE * FRAME_NOISE, "{errors:?}");
    }

    #[test]
    fn where_bodies_are_lost_two_frames_tell_of_a_wall() {
        let motion = MotionModel { lost: true, ..motion(0.0) };
        let mut observer = LatentObserver::new(motion.clone(), 20);
        let mut state = Vector4::new(-4.0, 0.0, 0.3, 0.0);
        for _ in 0..10 {
            state = motion.step(&state, Vector2::zeros()).0;
            observer.observe(state.fixed_rows::<2>(0).into_owned(), &[Vector2::zeros()]);
        }
        let wall = state.fixed_rows::<2>(0).into_owned();
        for _ in 0..4 {
            observer.observe(wall, &[Vector2::zeros()]);
        }
        let found = observer.estimate().unwrap();
        assert!(found.v.norm() < 1e-6 && (found.y - wall).norm() < 1e-6, "{found:?}");
    }

    #[test]
    fn at_the_speed_limit_and_after_a_wall_it_is_right() {
        // Full thrust east: the limit is reached after twelve intervals.
        let motion = motion(0.0);
        let mut observer = LatentObserver::new(motion.clone(), 20);
        let mut state = Vector4::new(-4.0, 0.0, 0.0, 0.0);
        let a = Vector2::new(1.0, 0.0);
        observer.observe(Vector2::new(-4.0, 0.0), &[]);
        for k in 0..30 {
            state = motion.step(&state, a).0;
            let wobble = SCALE * FRAME_NOISE * (k as f64 * 2.1).sin();
            observer.observe(state.fixed_rows::<2>(0) + Vector2::new(wobble, -wobble), &[a]);
        }
        let v = observer.estimate().unwrap().v;
        assert!((v.norm() - motion.reach).abs() < 1e-3, "{v} at the limit {}", motion.reach);
        // A wall stops it: two frames later the speed is zero, however long the window.
        let y = state.fixed_rows::<2>(0).into_owned();
        for _ in 0..3 {
            observer.observe(y, &[Vector2::zeros()]);
        }
        let found = observer.estimate().unwrap();
        assert!(found.v.norm() < 3.0 * SCALE * FRAME_NOISE, "{found:?}");
    }
}
