//! Where an encoder breaks: the same errors on harder cameras and in harder states, case by case.
//!
//! Positions are decoded by the model's own probe, as a ground station would: nothing is fitted to a
//! case. Errors are l1 in px, 90 % quantiles.

use crpl_sitl::camera::{Frame, SIDE};
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::dynamics::{self, State};
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::encoder::infer::Latent;
use crate::encoder::weights::vector;
use crate::heads::labels::{self, Scene};
use crate::numeric::statistics::quantile;
use crate::predictor::Begin;
use crate::world_model::WorldModel;
use crate::world_model::dataset::{EDGE_BAND, OBSTACLE_SPEED, START_SPEED};
use crpl_sitl::camera::effects::{CameraSet, Effects, FrameId};

/// One case: 90 % quantiles of the l1 errors, px.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobustnessRow {
    /// What is hard about it.
    pub case: String,
    /// UAV.
    pub z_c_p90_px: f64,
    /// Obstacle.
    pub z_u_p90_px: f64,
}

/// Steps that the cases with moving bodies look ahead, from two frames.
pub const AHEAD: usize = 10;

/// All cases, `count` frames or flights each.
#[must_use]
pub fn robustness_table(
    model: &WorldModel,
    count: usize,
    scenario: &Scenario,
    noise: &Noise,
) -> Vec<RobustnessRow> {
    let frames = frame_cases(scenario).into_iter().map(|case| {
        let errors = decode(model, &case, count, noise);
        row(case.name.into(), errors)
    });
    let flights = flight_cases(scenario).into_iter().map(|case| {
        let errors = look_ahead(model, &case, count, scenario, noise);
        row(format!("{}, {AHEAD} steps ahead", case.name), errors)
    });
    frames.chain(flights).collect()
}

/// 90 % quantiles of the l1 errors through some cameras, px.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DecodeErrors {
    /// UAV, whole disc.
    pub whole_px: f64,
    /// UAV, disc cut by the edge.
    pub cut_px: f64,
    /// Obstacle.
    pub obstacle_px: f64,
}

/// Decode errors on `count` frames with whole discs and as many with cut ones, taken by `cameras`.
#[must_use]
pub fn decode_errors(
    model: &WorldModel,
    cameras: &CameraSet,
    count: usize,
    scenario: &Scenario,
    noise: &Noise,
) -> DecodeErrors {
    let of = |wanted: fn(&Scene, &Scenario) -> bool| {
        decode_with(model, scenario, wanted, count, noise, |frame, id| cameras.apply(frame, id))
    };
    let ([whole, obstacle], [cut, _]) = (of(whole), of(cut));
    DecodeErrors {
        whole_px: quantile(&whole, 0.9),
        cut_px: quantile(&cut, 0.9),
        obstacle_px: quantile(&obstacle, 0.9),
    }
}

/// A way to take frames, and which scenes.
struct FrameCase {
    name: &'static str,
    effects: Effects,
    scenario: Scenario,
    wanted: fn(&Scene, &Scenario) -> bool,
}

fn frame_cases(scenario: &Scenario) -> Vec<FrameCase> {
    let clean = Effects::default();
    let with_radius = |radius: f64| {
        let mut other = scenario.clone();
        other.obstacles[0].radius = radius;
        other
    };
    let case = |name, effects| FrameCase { name, effects, scenario: scenario.clone(), wanted: anything };
    vec![
        FrameCase { wanted: whole, ..case("clean, whole disc", clean) },
        FrameCase { wanted: cut, ..case("disc cut by the edge", clean) },
        FrameCase { wanted: overlapping, ..case("UAV over the obstacle", clean) },
        FrameCase { wanted: whole, ..case("mixed colours", Effects::mixed_colours()) },
        FrameCase { wanted: whole, ..case("pixel noise 2/255", Effects { noise: 2.0, ..clean }) },
        FrameCase { wanted: whole, ..case("pixel noise 5/255", Effects { noise: 5.0, ..clean }) },
        FrameCase {
            wanted: whole,
            ..case("mixed colours, pixel noise 2/255", Effects { noise: 2.0, ..Effects::mixed_colours() })
        },
        FrameCase { wanted: whole, ..case("texture up to 20/255", Effects { texture: 20.0, ..clean }) },
        FrameCase { wanted: whole, ..case("brightness drift 20 %", Effects { drift: 0.2, ..clean }) },
        FrameCase { wanted: whole, scenario: with_radius(0.08), ..case("obstacle radius 0.08", clean) },
        FrameCase { wanted: whole, scenario: with_radius(0.12), ..case("obstacle radius 0.12", clean) },
    ]
}

fn anything(_: &Scene, _: &Scenario) -> bool {
    true
}

/// Smallest distance of the UAV's centre to an edge.
fn depth(scene: &Scene) -> f64 {
    scene.uav.iter().map(|x| x.min(1.0 - x)).fold(1.0, f64::min)
}

fn whole(scene: &Scene, _: &Scenario) -> bool {
    depth(scene) >= EDGE_BAND
}

fn cut(scene: &Scene, _: &Scenario) -> bool {
    depth(scene) < EDGE_BAND
}

fn overlapping(scene: &Scene, scenario: &Scenario) -> bool {
    let reach = scenario.obstacle().radius + scenario.uav_radius + scenario.camera.edge_px / SIDE as f64;
    (scene.uav - scene.obstacle).norm() < reach && whole(scene, scenario)
}

/// Errors of UAV and obstacle.
type Errors = [Vec<f64>; 2];

fn row(case: String, [c, u]: Errors) -> RobustnessRow {
    RobustnessRow { case, z_c_p90_px: quantile(&c, 0.9), z_u_p90_px: quantile(&u, 0.9) }
}

fn l1(a: Vector2<f64>, b: Vector2<f64>) -> f64 {
    SIDE as f64 * (a - b).abs().sum()
}

/// Decode errors on `count` frames of the case.
fn decode(model: &WorldModel, case: &FrameCase, count: usize, noise: &Noise) -> Errors {
    let take = |frame, id| case.effects.apply(frame, id, noise);
    decode_with(model, &case.scenario, case.wanted, count, noise, take)
}

fn decode_with(
    model: &WorldModel,
    scenario: &Scenario,
    wanted: fn(&Scene, &Scenario) -> bool,
    count: usize,
    noise: &Noise,
    take: impl Fn(Frame, FrameId) -> Frame + Sync,
) -> Errors {
    let mut rng = noise.generator(Stream::Evaluation, 30);
    let scenes: Vec<Scene> = std::iter::repeat_with(|| labels::uniform_scene(scenario, &mut rng))
        .filter(|scene| wanted(scene, scenario))
        .take(count)
        .collect();
    let (c, u) = scenes
        .par_iter()
        .enumerate()
        .map(|(n, scene)| {
            let latent = model.encode(&take(scene.frame(scenario), FrameId { series: n as u64, frame: 0 }));
            (l1(model.uav(&latent), scene.uav), l1(model.obstacle(&latent), scene.obstacle))
        })
        .unzip();
    [c, u]
}

/// A way to fly.
struct FlightCase {
    name: &'static str,
    /// Speed at the start, units per interval.
    speed: f64,
    /// σ_c of the disturbance.
    sigma_c: f64,
}

fn flight_cases(scenario: &Scenario) -> [FlightCase; 3] {
    [
        FlightCase { name: "moving", speed: START_SPEED, sigma_c: 0.0 },
        FlightCase { name: "at v_max", speed: scenario.dynamics.v_max, sigma_c: 0.0 },
        FlightCase { name: "sigma_c 0.005", speed: START_SPEED, sigma_c: 0.005 },
    ]
}

/// A short flight: both bodies in the two frames and at the end, and the actions.
struct ShortFlight {
    seen: [Scene; 2],
    actions: Vec<Vector2<f64>>,
    end: Scene,
}

/// Errors of the positions predicted [`AHEAD`] steps ahead from two clean frames and the actions.
fn look_ahead(
    model: &WorldModel,
    case: &FlightCase,
    count: usize,
    scenario: &Scenario,
    noise: &Noise,
) -> Errors {
    let mut rng = noise.generator(Stream::Evaluation, 31);
    let flights: Vec<ShortFlight> = std::iter::repeat_with(|| fly(case, scenario, &mut rng))
        .filter(|f| f.seen.iter().chain([&f.end]).all(|s| whole(s, scenario)))
        .take(count)
        .collect();
    let uncontrollable = model.uncontrollable();
    let (c, u) = flights
        .par_iter()
        .map(|flight| {
            let [before, now] = flight.seen.map(|s| model.encode(&s.frame(scenario)));
            let start = |of: fn(&WorldModel, &Latent) -> [f32; 2]| {
                (vector(of(model, &now)), vector(of(model, &before)))
            };
            let (c, mut u) = (start(WorldModel::y_c), start(WorldModel::y_u));
            let path = model.predictor.rollout(Begin { now: c.0, before: c.1, actions: &flight.actions });
            for _ in &flight.actions {
                u = (uncontrollable.coast(u.0, u.1), u.0);
            }
            let uav = model.probe.c.apply(path.last().copied().unwrap_or(c.0));
            (l1(uav, flight.end.uav), l1(model.probe.u.apply(u.0), flight.end.obstacle))
        })
        .unzip();
    [c, u]
}

fn fly(case: &FlightCase, scenario: &Scenario, rng: &mut impl Rng) -> ShortFlight {
    let mut unit = || {
        let angle = std::f64::consts::TAU * rng.random::<f64>();
        Vector2::new(angle.cos(), angle.sin())
    };
    let (heading, drift) = (unit(), unit() * OBSTACLE_SPEED);
    let mut place = |low: f64| low + (1.0 - 2.0 * low) * rng.random::<f64>();
    let mut uav = State { r: Vector2::new(place(0.0), place(0.0)), v: heading * case.speed };
    // So far from its walls that it meets none.
    let margin = scenario.obstacle().margin + OBSTACLE_SPEED * (AHEAD + 1) as f64;
    let obstacle = Vector2::new(place(margin), place(margin));
    let mut free = scenario.dynamics.clone();
    free.walls = false;
    let std = scenario.disturbance.gust_scale * case.sigma_c;
    let at = |uav: Vector2<f64>, k: usize| Scene { uav, obstacle: obstacle + drift * k as f64 };
    let seen = [at(uav.r - uav.v, 0), at(uav.r, 1)];
    let mut actions = Vec::with_capacity(AHEAD);
    for _ in 0..AHEAD {
        let mut draw = || rng.random_range(-1.0..=1.0);
        let a = Vector2::new(draw(), draw());
        let mut gust = || -> f64 { StandardNormal.sample(rng) };
        let gust = Vector2::new(gust(), gust()) * std;
        uav = dynamics::step(uav, a, gust, &free);
        actions.push(a);
    }
    ShortFlight { seen, actions, end: at(uav.r, AHEAD + 1) }
}

/// The table for people: one row a case, one pair of columns a model.
#[must_use]
pub fn table(names: &[&str], rows: &[Vec<RobustnessRow>]) -> String {
    let Some(cases) = rows.first() else { return String::new() };
    let head: String = names.iter().map(|name| format!(" {name} z_c | {name} z_u |")).collect();
    let line = "---|".repeat(1 + 2 * names.len());
    let mut out = format!("| case, p90 in px |{head}\n|{line}\n");
    for (n, case) in cases.iter().enumerate() {
        let cells: String =
            rows.iter().map(|r| format!(" {} | {} |", px(r[n].z_c_p90_px), px(r[n].z_u_p90_px))).collect();
        out += &format!("| {} |{cells}\n", case.case);
    }
    out
}

/// Three digits that mean something.
fn px(value: f64) -> String {
    if value < 1.0 { format!("{value:.3}") } else { format!("{value:.2}") }
}
