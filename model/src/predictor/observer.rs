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
    window: usize,
    last: VecDeque<Interval>,
}

impl LatentObserver {
    /// Nothing seen; at most `window` (at least 2) frames are kept.
    #[must_use]
    pub fn new(motion: MotionModel, window: usize) -> Self {
        Self { motion, window: window.max(2), last: VecDeque::new() }
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
        while self.last.iter().filter(|i| i.seen.is_some()).count() > self.window {
            self.last.pop_front();
        }
    }

    /// Place and speed at the newest frame; `None` before the first.
    #[must_use]
    pub fn estimate(&self) -> Option<Estimate> {
        // Two frames and no more are their difference, to the last bit.
        if let (2, [.., Interval { seen: Some(before), .. }, Interval { seen: Some(now), .. }]) =
            (self.window, self.last.iter().copied().collect::<Vec<_>>().as_slice())
        {
            return Some(Estimate { y: now.y, v: now.y - before.y });
        }
        let Estimate { y, v } = self.filtered()?.0.estimate();
        // No encoded step faster than v_max is real.
        let v = if v.norm() > self.motion.reach { v * (self.motion.reach / v.norm()) } else { v };
        Some(Estimate { y, v })
    }

    /// How well place and speed at the newest frame are known; `None` before the first.
    #[must_use]
    pub fn certainty(&self) -> Option<Certainty> {
        let (filter, disagrees) = self.filtered()?;
        let covariance = |at| filter.covariance.fixed_view::<2, 2>(at, at).into_owned();
        Some(Certainty { y: covariance(0), v: covariance(2), moving: filter.moving, disagrees })
    }

    /// The filter after the newest frame, and whether that frame was left out because it shows the half elsewhere.
    fn filtered(&self) -> Option<(Filter, bool)> {
        let rough = if self.motion.lost { self.roughness() } else { 1.0 };
        let noise = |seen| rough * self.noise(seen);
        let mut filter: Option<Filter> = None;
        let mut before: Option<(usize, LatentReading)> = None;
        let mut odd: Option<(usize, LatentReading)> = None;
        for (k, interval) in self.last.iter().enumerate() {
            if let Some(filter) = &mut filter {
                filter.predict(&self.motion, interval.flown);
            }
            let Some(seen) = interval.seen else { continue };
            let fits = filter.as_mut().is_some_and(|f| f.update(seen.y, noise(seen)));
            if fits {
                odd = None;
            } else if !self.motion.lost || filter.is_none() {
                filter = Some(self.anew(before, k, seen, rough));
            } else if odd.is_some_and(|other| self.agree(other, (k, seen), rough)) {
                // Two frames in a row against what was predicted: a wall, or what came before was lost.
                filter = Some(self.anew(odd.take(), k, seen, rough));
            } else {
                odd = Some((k, seen));
                continue;
            }
            before = Some((k, seen));
        }
        Some((filter?, odd.is_some()))
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
    fn roughness(&self) -> f64 {
        let seen: Vec<&Interval> = self.last.iter().collect();
        let mut ratios: Vec<f64> = seen
            .windows(3)
            .filter_map(|w| {
                let [a, b, c] = [w[0].seen?, w[1].seen?, w[2].seen?];
                let off = c.y - b.y - self.motion.predictor.displacement(b.y, b.y - a.y, w[2].flown).step;
                let [a, b, c] = [a, b, c].map(|r| self.noise(r).powi(2));
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

    /// A filter that knows the frame of interval `k` and the one before it.
    fn anew(
        &self,
        before: Option<(usize, LatentReading)>,
        k: usize,
        seen: LatentReading,
        rough: f64,
    ) -> Filter {
        let noise = |seen| rough * self.noise(seen);
        let Some((since, first)) = before else { return Filter::at(seen.y, noise(seen)) };
        let mut filter = Filter::at(first.y, noise(first));
        for interval in self.last.range(since + 1..=k) {
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
