//! Training data: the UAV flies random actions over the whole unit square, the obstacle moves at
//! constant speed and reflects. Positions only; frames are drawn from them when they are needed.
//!
//! The UAV's centre may be anywhere in `[0,1]`², so discs that the frame cuts are in the data. With
//! [`Selection::Free`] an episode that would leave the square or exceed v_max is discarded and another one
//! drawn, so its motion is linear in the actions throughout. Each candidate has its own random stream: equal seeds give equal bytes.

use std::path::Path;

use crpl_sitl::camera::{self, Frame};
use crpl_sitl::scenario::{Dynamics, Scenario};
use crpl_sitl::world::dynamics::{self, State};
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::Serialize;

use crate::numeric::tensors::{self, Reader, TensorError, Writer, write_all};

/// Name of the dataset's file.
pub const EPISODES: &str = "episodes.safetensors";

/// Speed of the obstacle in training data, units per interval (Sec. IV-A1).
pub const OBSTACLE_SPEED: f64 = 0.0125;

/// Largest speed with which an episode begins, units per interval (our choice).
pub const START_SPEED: f64 = 0.02;

/// Width of the band along the edges in which edge episodes begin, units: there a disc is cut.
pub const EDGE_BAND: f64 = 0.04;

/// How an episode's UAV begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EpisodeStart {
    /// Anywhere; 30 % at rest, the others at a speed up to [`START_SPEED`].
    Mixed,
    /// Anywhere, at rest.
    Rest,
    /// Within [`EDGE_BAND`] of an edge; else as `Mixed`.
    Edge,
}

/// Which candidates become trajectories.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Selection {
    /// Those that stay in the square and below v_max: their motion is linear in the actions.
    Free,
    /// All of them; walls and v_max act as in the simulator.
    All,
}

/// How many candidates were kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Acceptance {
    /// Kept.
    pub kept: usize,
    /// Drawn until then.
    pub candidates: usize,
}

impl Acceptance {
    /// Kept of drawn, at most 1.
    #[must_use]
    pub fn rate(&self) -> f64 {
        self.kept as f64 / self.candidates.max(1) as f64
    }
}

/// The first `count` candidates that `draw` keeps, in the order of their indices, and how many it took.
pub fn first<T: Send>(count: usize, draw: impl Fn(u64) -> Option<T> + Sync) -> (Vec<T>, Acceptance) {
    const CHUNK: u64 = 1 << 12;
    let (mut found, mut candidates) = (Vec::with_capacity(count), 0);
    while found.len() < count {
        let chunk: Vec<Option<T>> = (candidates..candidates + CHUNK).into_par_iter().map(&draw).collect();
        for candidate in chunk {
            candidates += 1;
            found.extend(candidate);
            if found.len() == count {
                break;
            }
        }
    }
    let kept = found.len();
    (found, Acceptance { kept, candidates: candidates as usize })
}

/// One trajectory of both bodies, paper units.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// r_c at frames 0..=T+1; frames 0 and 1 are one unaccelerated step apart.
    pub uav: Vec<Vector2<f64>>,
    /// Normalised accelerations 0..T: r_{k+2} - 2 r_{k+1} + r_k = a_max a_k.
    pub actions: Vec<Vector2<f64>>,
    /// r_u at frames 0..=T+1.
    pub obstacle: Vec<Vector2<f64>>,
}

impl Episode {
    /// The frame at frame `k`.
    #[must_use]
    pub fn frame(&self, k: usize, scenario: &Scenario) -> Frame {
        camera::render(self.uav[k], self.obstacle[k], scenario)
    }

    /// What the actions contribute to r_{k+2d} - 2 r_{k+d} + r_k, in units of a_max.
    #[must_use]
    pub fn input_response(&self, k: usize, d: usize) -> Vector2<f64> {
        (1..2 * d).map(|j| self.actions[k + j - 1] * (d - d.abs_diff(j)) as f64).sum()
    }
}

/// Three frames `lag` apart, oldest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Triple {
    /// Index of the episode.
    pub episode: usize,
    /// First frame.
    pub first: usize,
    /// Frames between first and second, and second and third.
    pub lag: usize,
}

/// Draws `count` episodes of `steps` actions that stay in the square and below v_max. `purpose` keeps several
/// sets of one seed apart.
#[must_use]
pub fn collect(
    count: usize,
    steps: usize,
    start: EpisodeStart,
    scenario: &Scenario,
    noise: &Noise,
    purpose: u64,
) -> Vec<Episode> {
    select(count, steps, (start, Selection::Free), scenario, noise, purpose).0
}

/// The same with any selection, and how many candidates it took.
#[must_use]
pub fn select(
    count: usize,
    steps: usize,
    (start, selection): (EpisodeStart, Selection),
    scenario: &Scenario,
    noise: &Noise,
    purpose: u64,
) -> (Vec<Episode>, Acceptance) {
    first(count, |index| {
        let mut rng = noise.generator(Stream::Data, (purpose << 32) | index);
        draw(steps, start, selection, scenario, &mut rng)
    })
}

/// One candidate, or `None` if the selection discards it.
fn draw(
    steps: usize,
    start: EpisodeStart,
    selection: Selection,
    scenario: &Scenario,
    rng: &mut impl Rng,
) -> Option<Episode> {
    let mut r = Vector2::new(rng.random::<f64>(), rng.random::<f64>());
    if start == EpisodeStart::Edge {
        let axis = rng.random_range(0..2);
        let depth = EDGE_BAND * rng.random::<f64>();
        r[axis] = if rng.random() { depth } else { 1.0 - depth };
    }
    let at_rest = rng.random::<f64>() < 0.3 || start == EpisodeStart::Rest;
    let speed = START_SPEED * rng.random::<f64>();
    let mut v = direction(rng) * if at_rest { 0.0 } else { speed };

    let mut dynamics = scenario.dynamics.clone();
    let all = selection == Selection::All;
    dynamics.walls = all;
    if all {
        // What comes out of a wall comes from the other side.
        for axis in 0..2 {
            let outside = !(0.0..=1.0).contains(&(r[axis] - v[axis]));
            v[axis] = if outside { -v[axis] } else { v[axis] };
        }
    }
    let mut state = State { r, v };
    let mut uav = vec![r - v, r];
    if !inside(r - v) {
        return None;
    }
    let mut actions = Vec::with_capacity(steps);
    for _ in 0..steps {
        let a = Vector2::new(rng.random_range(-1.0..=1.0), rng.random_range(-1.0..=1.0));
        let next = dynamics::step(state, a, Vector2::zeros(), &dynamics);
        if !all && !is_free(state, a, next, &dynamics) {
            return None;
        }
        state = next;
        actions.push(a);
        uav.push(state.r);
    }

    let margin = scenario.obstacle().margin;
    let mut place = || margin + (1.0 - 2.0 * margin) * rng.random::<f64>();
    let centre = Vector2::new(place(), place());
    let mut body = State { r: centre, v: direction(rng) * OBSTACLE_SPEED };
    let obstacle = (0..steps + 2)
        .map(|_| {
            let now = body.r;
            body = dynamics::step_obstacle(body, margin);
            now
        })
        .collect();
    Some(Episode { uav, actions, obstacle })
}

/// Whether `r` is in the square.
#[must_use]
pub fn inside(r: Vector2<f64>) -> bool {
    r.iter().all(|x| (0.0..=1.0).contains(x))
}

/// Whether neither v_max nor the square bent a step.
#[must_use]
pub fn is_free(from: State, a: Vector2<f64>, to: State, dynamics: &Dynamics) -> bool {
    (from.v + dynamics.a_max * a).norm() <= dynamics.v_max && inside(to.r)
}

/// A unit vector anywhere.
pub fn direction(rng: &mut impl Rng) -> Vector2<f64> {
    let angle = std::f64::consts::TAU * rng.random::<f64>();
    Vector2::new(angle.cos(), angle.sin())
}

/// `count` triples with a lag that is log-uniform in `low..=high`; a quarter of them begin with the
/// episode, where an edge episode has its cut disc.
#[must_use]
pub fn triples(
    episodes: &[Episode],
    count: usize,
    low: usize,
    high: usize,
    rng: &mut impl Rng,
) -> Vec<Triple> {
    let (from, to) = ((low as f64 - 0.49).ln(), (high as f64 + 0.49).ln());
    (0..count)
        .map(|_| {
            let lag = ((from + (to - from) * rng.random::<f64>()).exp().round() as usize).clamp(low, high);
            let episode = rng.random_range(0..episodes.len());
            let last = episodes[episode].uav.len() - 1 - 2 * lag;
            let first = if rng.random::<f64>() < 0.25 { 0 } else { rng.random_range(0..=last) };
            Triple { episode, first, lag }
        })
        .collect()
}

/// Writes the episodes of a dataset: `uav`, `velocity`, `obstacle` `[n, T+2, 2]`, `actions` `[n, T, 2]`.
///
/// # Errors
/// If a file cannot be written.
pub fn save(episodes: &[Episode], dir: &Path) -> Result<(), TensorError> {
    std::fs::create_dir_all(dir).map_err(TensorError::file(dir))?;
    let steps = episodes.first().map_or(0, |e| e.actions.len());
    let shape = [episodes.len(), steps + 2, 2];
    let flat = |pick: fn(&Episode) -> Vec<Vector2<f64>>| {
        episodes.iter().flat_map(move |e| pick(e).into_iter().flat_map(|v| [v.x, v.y]))
    };
    let mut out = Writer::default();
    out.f64("uav", &shape, flat(|e| e.uav.clone()));
    out.f64("velocity", &shape, flat(velocities));
    out.f64("obstacle", &shape, flat(|e| e.obstacle.clone()));
    out.f64("actions", &[episodes.len(), steps, 2], flat(|e| e.actions.clone()));
    write_all(&dir.join(EPISODES), &out.bytes()?)
}

/// v at every frame: the step that led to it.
fn velocities(episode: &Episode) -> Vec<Vector2<f64>> {
    let steps = episode.uav.windows(2).map(|r| r[1] - r[0]);
    episode.uav.get(1).map(|r| r - episode.uav[0]).into_iter().chain(steps).collect()
}

/// Reads what [`save`] wrote; `steps` must be the episodes' length.
///
/// # Errors
/// If the file is missing, a tensor has another shape, or a position lies outside the unit square.
pub fn load(dir: &Path, steps: usize) -> Result<Vec<Episode>, TensorError> {
    let path = dir.join(EPISODES);
    let bytes = tensors::read(&path)?;
    let from = Reader::new(&bytes, path.clone())?;
    let wrong = |message: &str| TensorError::Format { path: path.clone(), message: message.into() };
    let count = from.shape("uav")?.first().copied().unwrap_or(0);
    if count == 0 {
        return Err(wrong("it holds no episode"));
    }
    let states = [count, steps + 2, 2];
    let (uav, obstacle) = (from.f64("uav", &states)?, from.f64("obstacle", &states)?);
    let actions = from.f64("actions", &[count, steps, 2])?;
    if !uav.iter().chain(&obstacle).all(|x| (0.0..=1.0).contains(x)) {
        return Err(wrong("a position lies outside the unit square"));
    }
    let part = |values: &[f64], n: usize, length: usize| -> Vec<Vector2<f64>> {
        values[n * length * 2..][..length * 2].chunks_exact(2).map(|v| Vector2::new(v[0], v[1])).collect()
    };
    Ok((0..count)
        .map(|n| Episode {
            uav: part(&uav, n, steps + 2),
            actions: part(&actions, n, steps),
            obstacle: part(&obstacle, n, steps + 2),
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some(start: EpisodeStart) -> Vec<Episode> {
        collect(20, 40, start, &Scenario::default(), &Noise::new(5), 1)
    }

    #[test]
    fn second_differences_are_the_actions() {
        for episode in some(EpisodeStart::Mixed) {
            for d in [1, 4, 10] {
                let r = |k: usize| episode.uav[k];
                let found = r(3 + 2 * d) - 2.0 * r(3 + d) + r(3);
                assert!((found - 3.5e-3 * episode.input_response(3, d)).norm() < 1e-12, "lag {d}");
            }
        }
    }

    #[test]
    fn nothing_is_discarded_and_walls_and_speed_limit_act() {
        let scenario = Scenario::default();
        let any = |selection| {
            let noise = Noise::new(5);
            select(300, 100, (EpisodeStart::Mixed, selection), &scenario, &noise, 1)
        };
        let (free, kept) = any(Selection::Free);
        assert!(kept.kept == 300 && kept.rate() < 0.5, "{kept:?}");
        let (all, kept) = any(Selection::All);
        assert_eq!(kept, Acceptance { kept: 300, candidates: 300 });
        let at_wall = |e: &Episode| e.uav.iter().flat_map(|r| r.iter()).any(|x| *x == 0.0 || *x == 1.0);
        let v_max = scenario.dynamics.v_max;
        let fast = |e: &Episode| velocities(e).iter().any(|v| (v.norm() - v_max).abs() < 1e-12);
        let share = |of: &[Episode], what: &dyn Fn(&Episode) -> bool| of.iter().filter(|e| what(e)).count();
        assert_eq!((share(&free, &at_wall), share(&free, &fast)), (0, 0));
        assert!(share(&all, &at_wall) > 0 && share(&all, &fast) > 0);
        assert!(all.iter().flat_map(|e| &e.uav).all(|r| inside(*r)));
    }

    #[test]
    fn edge_episodes_begin_at_an_edge_and_all_stay_inside() {
        for episode in some(EpisodeStart::Edge) {
            let r = episode.uav[1];
            let depth = r.x.min(r.y).min(1.0 - r.x).min(1.0 - r.y);
            assert!(depth <= EDGE_BAND, "begins {depth} inside");
            assert!(episode.uav.iter().all(|r| r.iter().all(|x| (0.0..=1.0).contains(x))));
        }
    }

    #[test]
    fn equal_seeds_give_equal_data_and_it_survives_the_disk() {
        let episodes = some(EpisodeStart::Rest);
        assert_eq!(episodes, some(EpisodeStart::Rest));
        let dir = tempfile::tempdir().unwrap();
        save(&episodes, dir.path()).unwrap();
        assert_eq!(load(dir.path(), 40).unwrap(), episodes);
        let wrong = load(dir.path(), 41).unwrap_err().to_string();
        assert!(wrong.contains("tensor `uav` has shape [20, 42, 2], expected [20, 43, 2]"), "{wrong}");
    }

    #[test]
    fn a_dataset_that_cannot_be_drawn_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let mut episodes = some(EpisodeStart::Mixed);
        episodes[7].obstacle[3].x = 1e300;
        save(&episodes, dir.path()).unwrap();
        let outside = load(dir.path(), 40).unwrap_err().to_string();
        assert!(outside.ends_with("a position lies outside the unit square"), "{outside}");
        save(&[], dir.path()).unwrap();
        let empty = load(dir.path(), 0).unwrap_err().to_string();
        assert!(empty.ends_with("it holds no episode"), "{empty}");
    }
}
