//! Rollouts of every predictor from three start conditions, compared with where the UAV really went.
//!
//! All predictors forecast from the same frame. What differs is what is known of the time before it:
//! the observer sees a window of frames and the actions between them, the others the last two.

use crpl_sitl::camera::{self, Body, Film, Poses, SIDE};
use crpl_sitl::scenario::Scenario;
use crpl_sitl::units::Tick;
use crpl_sitl::world::dynamics::{self, State};
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::Serialize;

use crate::encoder::weights::vector;
use crate::numeric::statistics::{Interval, of_quantile, quantile, wilson};
use crate::predictor::bounded::{Bounded, Bounds};
use crate::predictor::observer::{LatentObserver, LatentReading, MotionModel};
use crate::predictor::{Begin, Networks, Predictor, PredictorKind};
use crate::world_model::WorldModel;
use crate::world_model::dataset::{
    self, Acceptance, OBSTACLE_SPEED, START_SPEED, Selection, direction, inside, is_free,
};

/// How a trajectory begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RolloutStart {
    /// UAV and obstacle rest: all frames of the window are equal.
    Rest,
    /// The UAV rests, the obstacle moves.
    RestMovingObstacle,
    /// The UAV moves, at up to 0.02 units per interval at the start, and so does the obstacle.
    Moving,
}

impl RolloutStart {
    /// All, in the order of the tables.
    pub const ALL: [Self; 3] = [Self::Rest, Self::RestMovingObstacle, Self::Moving];
}

/// Who predicts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Forecaster {
    /// The last step for ever.
    ConstantVelocity,
    /// The linear predictor on what the observer makes of its window.
    Observer,
    /// The linear predictor with v_max and walls as Algorithm 1's rollouts have them: at the frame's encoded
    /// corners, and a wall that was touched takes no speed beyond the step that it cut.
    PlannerLimits,
    /// The linear predictor with v_max and walls as the simulator has them.
    KnownLimits,
    /// The same on what an observer that knows them makes of its window.
    ObserverKnownLimits,
    /// The bounded predictor on what an observer with the learned bounds makes of its window.
    ObserverBounded,
    /// A predictor on the last two latents.
    #[serde(untagged)]
    Predictor(PredictorKind),
}

impl Forecaster {
    /// Those that are compared on trajectories that v_max and the frame do not bend, in the order of the table.
    pub const FREE: [Self; 5] = [
        Self::Predictor(PredictorKind::Linear),
        Self::Predictor(PredictorKind::Mlp),
        Self::Predictor(PredictorKind::Lstm),
        Self::ConstantVelocity,
        Self::Observer,
    ];

    /// Those that are compared on all trajectories, in the order of the table.
    pub const ALL: [Self; 10] = [
        Self::Predictor(PredictorKind::Linear),
        Self::PlannerLimits,
        Self::KnownLimits,
        Self::Predictor(PredictorKind::Mlp),
        Self::Predictor(PredictorKind::Lstm),
        Self::Predictor(PredictorKind::Bounded),
        Self::ConstantVelocity,
        Self::Observer,
        Self::ObserverKnownLimits,
        Self::ObserverBounded,
    ];

    /// The forecasters of a selection.
    #[must_use]
    pub fn of(selection: Selection) -> &'static [Self] {
        match selection {
            Selection::Free => &Self::FREE,
            Selection::All => &Self::ALL,
        }
    }
}

/// Look-aheads that are reported.
pub const HORIZONS: [usize; 5] = [1, 10, 20, 50, 100];

/// Length of a rollout.
pub const LONGEST: usize = 100;

/// Both bodies before the forecast, and the UAV after it.
#[derive(Debug, Clone)]
pub struct Trajectory {
    /// Places of UAV and obstacle, the last being where the forecast begins.
    pub history: Vec<[Vector2<f64>; 2]>,
    /// Normalised accelerations between them.
    pub flown: Vec<Vector2<f64>>,
    /// What is flown after.
    pub actions: Vec<Vector2<f64>>,
    /// Where the UAV goes.
    pub path: Vec<Vector2<f64>>,
}

/// `count` trajectories, and how many candidates that took.
///
/// - [`Selection::Free`]: the UAV stays in the frame and below v_max throughout; all others are discarded.
/// - [`Selection::All`]: nothing is discarded, and walls and v_max act as in the simulator. What the start says
///   of the UAV then holds where the window begins.
#[must_use]
pub fn draw(
    count: usize,
    start: RolloutStart,
    selection: Selection,
    window: usize,
    scenario: &Scenario,
    noise: &Noise,
) -> (Vec<Trajectory>, Acceptance) {
    dataset::first(count, |index| {
        let mut rng = noise.generator(Stream::Evaluation, (start as u64 + 20) << 32 | index);
        match selection {
            Selection::Free => free(start, window, scenario, &mut rng),
            Selection::All => Some(any(start, window, scenario, &mut rng)),
        }
    })
}

/// A candidate from the start condition backwards and forwards; `None` if v_max or the frame bends its motion.
fn free(start: RolloutStart, window: usize, scenario: &Scenario, rng: &mut impl Rng) -> Option<Trajectory> {
    let (a_max, v_max) = (scenario.dynamics.a_max, scenario.dynamics.v_max);
    let mut free = scenario.dynamics.clone();
    free.walls = false;
    let State { r: now, v } = begin(start, rng);

    // Backwards in time: v_{k-1} = v_k - a_max a_{k-1}.
    let (mut places, mut flown) = (vec![now], Vec::new());
    let (mut r, mut back) = (now, v);
    for _ in 1..window {
        let a = before(start, rng);
        r -= back;
        back -= a_max * a;
        if !inside(r) || back.norm() > v_max {
            return None;
        }
        places.push(r);
        flown.push(a);
    }
    places.reverse();
    flown.reverse();

    let mut state = State { r: now, v };
    let (mut actions, mut path) = (Vec::with_capacity(LONGEST), Vec::with_capacity(LONGEST));
    for _ in 0..LONGEST {
        let a = action(rng);
        let next = dynamics::step(state, a, Vector2::zeros(), &free);
        if !is_free(state, a, next, &free) {
            return None;
        }
        state = next;
        actions.push(a);
        path.push(state.r);
    }
    Some(Trajectory { history: beside(places, start, scenario, rng), flown, actions, path })
}

/// A candidate from the window's first frame on, in the simulator's own world.
fn any(start: RolloutStart, window: usize, scenario: &Scenario, rng: &mut impl Rng) -> Trajectory {
    let mut state = begin(start, rng);
    let mut fly = |a: &Vector2<f64>| {
        state = dynamics::step(state, *a, Vector2::zeros(), &scenario.dynamics);
        state.r
    };
    let mut places = vec![fly(&Vector2::zeros())];
    let flown: Vec<_> = (1..window).map(|_| before(start, rng)).collect();
    places.extend(flown.iter().map(&mut fly));
    let actions: Vec<_> = (0..LONGEST).map(|_| action(rng)).collect();
    let path = actions.iter().map(fly).collect();
    Trajectory { history: beside(places, start, scenario, rng), flown, actions, path }
}

/// The UAV where a start condition holds.
fn begin(start: RolloutStart, rng: &mut impl Rng) -> State {
    let r = Vector2::new(rng.random::<f64>(), rng.random::<f64>());
    let speed = if start == RolloutStart::Moving { START_SPEED * rng.random::<f64>() } else { 0.0 };
    State { r, v: direction(rng) * speed }
}

/// What is flown in an interval of the window.
fn before(start: RolloutStart, rng: &mut impl Rng) -> Vector2<f64> {
    if start == RolloutStart::Moving { action(rng) } else { Vector2::zeros() }
}

/// These places of the UAV, each with that of an obstacle.
fn beside(
    places: Vec<Vector2<f64>>,
    start: RolloutStart,
    scenario: &Scenario,
    rng: &mut impl Rng,
) -> Vec<[Vector2<f64>; 2]> {
    let margin = scenario.obstacle().margin;
    let mut place = || margin + (1.0 - 2.0 * margin) * rng.random::<f64>();
    let r = Vector2::new(place(), place());
    let speed = if start == RolloutStart::Rest { 0.0 } else { OBSTACLE_SPEED };
    let mut body = State { r, v: direction(rng) * speed };
    let pair = |uav| {
        let here = body.r;
        body = dynamics::step_obstacle(body, margin);
        [uav, here]
    };
    places.into_iter().map(pair).collect()
}

fn action(rng: &mut impl Rng) -> Vector2<f64> {
    Vector2::new(rng.random_range(-1.0..=1.0), rng.random_range(-1.0..=1.0))
}

/// The predictors that are compared.
#[derive(Debug, Clone)]
pub struct Panel<'a> {
    model: &'a WorldModel,
    networks: &'a Networks,
    planner: Bounds,
    known: Bounds,
}

/// Whose estimate a forecast begins with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sight {
    /// The last two frames.
    Pair,
    /// The observer with v_max.
    Observer,
    /// The observer that knows the limits.
    Knowing,
    /// The observer with the learned bounds.
    Learned,
}

/// Both bodies in a scene, and what they moved since the one before.
fn poses(before: [Vector2<f64>; 2], now: [Vector2<f64>; 2], scenario: &Scenario) -> Poses {
    let body = |n: usize, radius: f64| Body { position: now[n], velocity: now[n] - before[n], radius };
    let obstacle = body(1, scenario.obstacle().radius);
    Poses { uav: body(0, scenario.uav_radius), obstacles: std::iter::once(obstacle).collect() }
}

impl<'a> Panel<'a> {
    /// All that `model` and `networks` have, and the scenario's limits.
    #[must_use]
    pub fn new(model: &'a WorldModel, networks: &'a Networks, scenario: &Scenario) -> Self {
        let reach = model.scale * scenario.dynamics.v_max;
        let corner = |r: f64| Vector2::repeat(r);
        let decoded = |r: f64| model.probe.c.invert(corner(r)).unwrap_or_default();
        let encoded = |r: f64| {
            let frame = camera::render(corner(r), scenario.obstacle().position, scenario);
            vector(model.y_c(&model.encode(&frame)))
        };
        let planner = Bounds { reach, low: encoded(0.0), high: encoded(1.0), contact: 0.0, kept: 1.0 };
        let contact = CONTACT * model.scale;
        let known = Bounds { reach, low: decoded(0.0), high: decoded(1.0), contact, kept: 0.0 };
        Self { model, networks, planner, known }
    }

    fn bounded(&self, bounds: Bounds) -> Predictor {
        Predictor::Bounded(Bounded { linear: self.model.controllable(), bounds })
    }

    /// How a forecaster goes on, and from what; `None` for constant velocity, or if the networks lack it.
    fn forecaster(&self, name: Forecaster) -> Option<(Predictor, Sight)> {
        let linear = self.model.controllable();
        let of = |kind| Predictor::of(kind, linear, self.networks);
        Some(match name {
            Forecaster::ConstantVelocity => return None,
            Forecaster::Observer => (Predictor::Linear(linear), Sight::Observer),
            Forecaster::PlannerLimits => (self.bounded(self.planner), Sight::Pair),
            Forecaster::KnownLimits => (self.bounded(self.known), Sight::Pair),
            Forecaster::ObserverKnownLimits => (self.bounded(self.known), Sight::Knowing),
            Forecaster::ObserverBounded => (of(PredictorKind::Bounded)?, Sight::Learned),
            Forecaster::Predictor(kind) => (of(kind)?, Sight::Pair),
        })
    }

    /// What the observers of [`Sight`] go by, in its order.
    fn motions(&self, v_max: f64) -> [MotionModel; 3] {
        let [plain, _] = self.model.motions(v_max, 0.0);
        let lost = plain.lost;
        let within = |bounds: Bounds| MotionModel {
            lost,
            ..MotionModel::new(self.bounded(bounds), self.model.scale, bounds.reach / self.model.scale, 0.0)
        };
        let learned = self.networks.bounds.map_or_else(|| plain.clone(), within);
        [plain, within(self.known), learned]
    }

    /// Encodes the window of every trajectory and lets the observers read it.
    #[must_use]
    pub fn look(
        &self,
        trajectories: &[Trajectory],
        scenario: &Scenario,
        tick: impl Fn() + Sync,
    ) -> Vec<Known> {
        let motions = self.motions(scenario.dynamics.v_max);
        let known = trajectories.par_iter().enumerate().map(|(n, t)| {
            let film = Film::new(&scenario.camera, n as u64);
            let window = t.history.len();
            let mut observers = motions.clone().map(|motion| LatentObserver::new(motion, window));
            let mut pair = [Vector2::zeros(); 2];
            let mut y_u = Vector2::zeros();
            let mut last: Option<([Vector2<f64>; 2], [LatentReading; 2])> = None;
            for (k, scene) in t.history.iter().enumerate() {
                // Equal scenes give equal frames: encoded once.
                let [c, u] = match last {
                    Some((before, seen)) if before == *scene => seen,
                    _ => {
                        let before = t.history[k.saturating_sub(1)];
                        self.model.see(&film.frame(Tick(k as u64), &poses(before, *scene, scenario)))
                    }
                };
                last = Some((*scene, [c, u]));
                pair = [c.y, if k == 0 { c.y } else { pair[0] }];
                y_u = u.y;
                let flown = if k == 0 { &[] } else { &t.flown[k - 1..k] };
                observers.iter_mut().for_each(|observer| observer.observe(c, flown));
            }
            tick();
            let observed = observers.map(|o| o.estimate().map_or(pair, |e| [e.y, e.before()]));
            Known { pair, observed, y_u }
        });
        known.collect()
    }

    /// Errors of one forecaster along all trajectories; `None` if the networks lack it.
    #[must_use]
    pub fn errors(&self, name: Forecaster, trajectories: &[Trajectory], known: &[Known]) -> Option<Errors> {
        let each = || trajectories.iter().zip(known);
        let paths: Vec<Vec<Vector2<f64>>> = if name == Forecaster::ConstantVelocity {
            each().map(|(t, k)| straight(k.pair, t.actions.len())).collect()
        } else {
            let (predictor, sight) = self.forecaster(name)?;
            let begins = each().map(|(t, k)| {
                let [now, before] = k.seen(sight);
                Begin { now, before, actions: &t.actions }
            });
            predictor.rollouts(&begins.collect::<Vec<_>>())
        };
        Some(paths.iter().zip(trajectories).map(|(path, t)| off(self.model, path, &t.path)).collect())
    }
}

/// How far off a wall a UAV that touches it may be decoded, units: what a cut disc is off by, p90.
const CONTACT: f64 = 2e-3;

/// The last step for ever.
fn straight([now, before]: [Vector2<f64>; 2], steps: usize) -> Vec<Vector2<f64>> {
    (1..=steps).map(|h| now + (now - before) * h as f64).collect()
}

/// What is known where a forecast begins, plane coordinates.
#[derive(Debug, Clone, Copy)]
pub struct Known {
    /// y_c of the last frame, and of the one before.
    pub pair: [Vector2<f64>; 2],
    /// The same as the observers have them: with v_max, with the limits known, with the learned bounds.
    pub observed: [[Vector2<f64>; 2]; 3],
    /// y_u of the last frame.
    pub y_u: Vector2<f64>,
}

impl Known {
    /// A forecast from the last two frames.
    #[must_use]
    pub fn begin<'a>(&self, actions: &'a [Vector2<f64>]) -> Begin<'a> {
        Begin { now: self.pair[0], before: self.pair[1], actions }
    }

    fn seen(&self, sight: Sight) -> [Vector2<f64>; 2] {
        match sight {
            Sight::Pair => self.pair,
            Sight::Observer => self.observed[0],
            Sight::Knowing => self.observed[1],
            Sight::Learned => self.observed[2],
        }
    }
}

/// l1 errors of the decoded position, px: one list a trajectory, one entry a step.
pub type Errors = Vec<Vec<f64>>;

/// Errors of one forecaster from one start.
pub type RolloutErrors = (Forecaster, RolloutStart, Errors);

/// l1 distance of the decoded latents to the true places, px.
#[must_use]
pub fn off(model: &WorldModel, path: &[Vector2<f64>], truth: &[Vector2<f64>]) -> Vec<f64> {
    path.iter().zip(truth).map(|(y, r)| SIDE as f64 * (model.probe.c.apply(*y) - r).abs().sum()).collect()
}

/// Intervals of a row.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RowIntervals {
    /// Of `p02`.
    pub p02: Interval,
    /// Of `p1`.
    pub p1: Interval,
    /// Of `p5`.
    pub p5: Interval,
    /// Of `p90_px`.
    pub p90_px: Interval,
}

/// One predictor, start and look-ahead.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RolloutRow {
    /// Who predicts.
    pub predictor: Forecaster,
    /// From where.
    pub start: RolloutStart,
    /// Look-ahead H, intervals.
    pub h: usize,
    /// Share of errors up to 0.2 px.
    pub p02: f64,
    /// Share of errors up to 1 px.
    pub p1: f64,
    /// Share of errors up to 5 px.
    pub p5: f64,
    /// 90 % quantile, px.
    pub p90_px: f64,
    /// 95 % intervals: Wilson's for the shares, order statistics for the quantile.
    pub ci: RowIntervals,
}

impl RolloutRow {
    /// The row at look-ahead `h`, which must be at least 1 and at most the rollouts' length.
    #[must_use]
    pub fn of(predictor: Forecaster, start: RolloutStart, h: usize, errors: &Errors) -> Self {
        let at: Vec<f64> = errors.iter().map(|e| e[h - 1]).collect();
        let n = at.len().max(1);
        let hits = |px: f64| at.iter().filter(|e| **e <= px).count();
        let share = |px: f64| hits(px) as f64 / n as f64;
        let ci = |px: f64| wilson(hits(px), n);
        Self {
            predictor,
            start,
            h,
            p02: share(0.2),
            p1: share(1.0),
            p5: share(5.0),
            p90_px: quantile(&at, 0.9),
            ci: RowIntervals { p02: ci(0.2), p1: ci(1.0), p5: ci(5.0), p90_px: of_quantile(&at, 0.9) },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_history_obeys_the_dynamics_and_ends_where_the_forecast_begins() {
        let scenario = Scenario::default();
        for start in RolloutStart::ALL {
            let (free, _) = draw(20, start, Selection::Free, 20, &scenario, &Noise::new(3));
            for t in free {
                assert!(t.history.len() == 20 && t.flown.len() == 19 && t.path.len() == LONGEST);
                let r: Vec<_> = t.history.iter().map(|h| h[0]).chain(t.path.clone()).collect();
                let actions: Vec<_> = t.flown.iter().chain(&t.actions).collect();
                for k in 1..r.len() - 1 {
                    let bend = r[k + 1] - 2.0 * r[k] + r[k - 1];
                    assert!((bend - 3.5e-3 * actions[k]).norm() < 1e-12, "{start:?}, frame {k}");
                }
                let still = t.history[0][0] == t.history[19][0];
                assert_eq!(still, start != RolloutStart::Moving);
                let obstacle_still = t.history[0][1] == t.history[19][1];
                assert_eq!(obstacle_still, start == RolloutStart::Rest);
            }
        }
    }

    /// Whether a place, or a step between places, is where walls or v_max put it.
    fn bent(t: &Trajectory, v_max: f64) -> [bool; 2] {
        let wall = t.path.iter().flat_map(|r| r.iter()).any(|x| *x == 0.0 || *x == 1.0);
        let fast = t.path.windows(2).any(|r| (r[1] - r[0]).norm() > (1.0 - 1e-9) * v_max);
        [wall, fast]
    }

    #[test]
    fn the_share_that_is_kept_is_counted_and_small() {
        let (scenario, noise) = (Scenario::default(), Noise::new(3));
        for start in RolloutStart::ALL {
            let (kept, acceptance) = draw(50, start, Selection::Free, 20, &scenario, &noise);
            assert!(acceptance.kept == 50 && kept.len() == 50);
            assert!((0.01..0.2).contains(&acceptance.rate()), "{start:?}: {acceptance:?}");
            assert!(kept.iter().all(|t| bent(t, scenario.dynamics.v_max) == [false; 2]));
        }
    }

    #[test]
    fn with_nothing_discarded_candidates_follow_each_other_and_walls_and_v_max_act() {
        let (scenario, noise) = (Scenario::default(), Noise::new(3));
        for start in RolloutStart::ALL {
            let (all, acceptance) = draw(200, start, Selection::All, 20, &scenario, &noise);
            assert_eq!(acceptance, Acceptance { kept: 200, candidates: 200 });
            let bent: Vec<_> = all.iter().map(|t| bent(t, scenario.dynamics.v_max)).collect();
            let share = |n: usize| bent.iter().filter(|b| b[n]).count();
            let free = bent.iter().filter(|b| **b == [false; 2]).count();
            assert!(share(0) > 0 && share(1) > 0, "{start:?}: {} at a wall, {} at v_max", share(0), share(1));
            assert!(free < 100, "{start:?}: {free} of 200 are bent by neither");
        }
    }

    #[test]
    fn with_nothing_discarded_the_path_is_the_simulators() {
        let (scenario, noise) = (Scenario::default(), Noise::new(4));
        for t in draw(50, RolloutStart::Rest, Selection::All, 20, &scenario, &noise).0 {
            let mut state = State::at_rest(t.history[19][0]);
            for (a, r) in t.actions.iter().zip(&t.path) {
                state = dynamics::step(state, *a, Vector2::zeros(), &scenario.dynamics);
                assert_eq!(state.r, *r);
            }
        }
    }

    #[test]
    fn a_row_counts() {
        let errors: Errors = (0..100).map(|n| vec![f64::from(n) / 10.0]).collect();
        let row = RolloutRow::of(Forecaster::Observer, RolloutStart::Rest, 1, &errors);
        assert!((row.p02 - 0.03).abs() < 1e-12 && (row.p1 - 0.11).abs() < 1e-12);
        assert!((row.p5 - 0.51).abs() < 1e-12 && (row.p90_px - 8.9).abs() < 0.11, "{row:?}");
        assert!(row.ci.p1[0] < 0.11 && row.ci.p1[1] > 0.11);
    }
}
