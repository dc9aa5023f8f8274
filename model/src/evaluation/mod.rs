//! The accuracy of a world model on held-out frames: decode errors, leakage, rollouts, heads.
//!
//! Ground truth is used only here, and only to measure. Errors are l1 in px (0.01 unit), as in
//! Sec. IV-B.

pub mod chart;
#[cfg(feature = "train")]
pub mod command;
pub mod diagnostics;
pub mod figures;
pub mod hard;
pub mod report;
pub mod robustness;
pub mod rollout;

use crpl_sitl::camera::SIDE;
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::seq::SliceRandom;

use crate::encoder::probe::r_squared;
use crate::encoder::weights::{LATENT, vector};
use crate::heads::labels::{self, BaseStation, HeadsConfig, Scene, auc, calibration_error};
use crate::numeric::statistics::quantile;
use crate::predictor::Begin;
use crate::world_model::WorldModel;
use crate::world_model::card::{FitCheck, HeadMetrics, ProbeMetrics, RolloutMetrics, WorldMetrics};
use crate::world_model::config::EvaluationConfig;
use crate::world_model::dataset::{self, EDGE_BAND, Episode, EpisodeStart, Selection};

/// Measures everything but `label_free`, which the fit hands over.
#[must_use]
pub fn measure(
    model: &WorldModel,
    config: &EvaluationConfig,
    heads_config: &HeadsConfig,
    scenario: &Scenario,
    noise: &Noise,
    label_free: FitCheck,
) -> WorldMetrics {
    let (episodes, acceptance) = dataset::select(
        config.rollouts,
        config.horizon,
        (EpisodeStart::Rest, Selection::Free),
        scenario,
        noise,
        EVALUATION_EPISODES,
    );
    let (rollout, ends) = rollouts(model, &episodes, scenario, noise);
    let [given, anywhere] = [BaseStation::Given, BaseStation::Anywhere].map(|station| {
        let mut rng = noise.generator(Stream::Evaluation, 1);
        let scenes = labels::sample(config.frames, station, scenario, &mut rng);
        let seen = model.encode_all(&scenes, |(s, _)| s.frame(scenario));
        let seen: Vec<_> = seen.iter().map(|l| (vector(model.y_c(l)), vector(model.y_u(l)))).collect();
        let last: Vec<_> =
            episodes.iter().map(|e| (last_scene(e), station.draw(scenario, &mut rng))).collect();
        [
            judge(model, &scenes, &seen, scenario, heads_config),
            judge(model, &last, &ends, scenario, heads_config),
        ]
    });
    WorldMetrics {
        probe: decode(model, config.frames, scenario, noise),
        rollout: RolloutMetrics { acceptance: Some(acceptance.rate()), ..rollout },
        heads: given[0],
        heads_after_rollout: given[1],
        heads_anywhere: anywhere[0],
        heads_anywhere_after_rollout: anywhere[1],
        label_free,
        learned: None,
    }
}

/// Keeps the held-out episodes apart from the training ones.
const EVALUATION_EPISODES: u64 = 9;

/// Decode errors on `count` fresh frames, both bodies anywhere.
#[must_use]
pub fn decode(model: &WorldModel, count: usize, scenario: &Scenario, noise: &Noise) -> ProbeMetrics {
    let d = decoded(model, count, scenario, noise);
    ProbeMetrics {
        c_middle_p90_px: quantile(&d.whole, 0.9),
        c_edge_p90_px: quantile(&d.cut, 0.9),
        c_edge_max_px: quantile(&d.cut, 1.0),
        u_p90_px: quantile(&d.obstacle, 0.9),
        u_overlap_p90_px: quantile(&d.covered, 0.9),
        leak_c_to_u: r_squared(&d.z_c, &d.r_u),
        leak_u_to_c: r_squared(&d.z_u, &d.r_c),
    }
}

/// Decode errors and what they come from, l1, px.
#[derive(Debug, Clone, Default)]
struct DecodeSamples {
    /// UAV whose disc is whole.
    whole: Vec<f64>,
    /// UAV whose disc the frame cuts.
    cut: Vec<f64>,
    /// Obstacle.
    obstacle: Vec<f64>,
    /// Obstacle of which the UAV covers a part.
    covered: Vec<f64>,
    z_c: Vec<[f32; LATENT]>,
    z_u: Vec<[f32; LATENT]>,
    r_c: Vec<Vector2<f64>>,
    r_u: Vec<Vector2<f64>>,
}

fn decoded(model: &WorldModel, count: usize, scenario: &Scenario, noise: &Noise) -> DecodeSamples {
    let mut rng = noise.generator(Stream::Evaluation, 0);
    let scenes: Vec<Scene> = (0..count).map(|_| labels::uniform_scene(scenario, &mut rng)).collect();
    let latents = model.encode_all(&scenes, |s| s.frame(scenario));
    let px = SIDE as f64;
    let l1 = |a: Vector2<f64>, b: Vector2<f64>| px * (a - b).abs().sum();
    let reach = scenario.obstacle().radius + scenario.uav_radius + scenario.camera.edge_px / px;
    let mut d = DecodeSamples::default();
    for (s, l) in scenes.iter().zip(&latents) {
        let depth = s.uav.iter().map(|x| x.min(1.0 - x)).fold(1.0, f64::min);
        let (c, u) = (l1(model.uav(l), s.uav), l1(model.obstacle(l), s.obstacle));
        if depth < EDGE_BAND {
            d.cut.push(c)
        } else {
            d.whole.push(c)
        }
        if (s.uav - s.obstacle).norm() < reach {
            d.covered.push(u);
        }
        d.obstacle.push(u);
        d.z_c.push(l.z_c);
        d.z_u.push(l.z_u);
        d.r_c.push(s.uav);
        d.r_u.push(s.obstacle);
    }
    d
}

/// y_c and y_u of a frame, or at the end of a rollout.
type Ends = (Vector2<f64>, Vector2<f64>);

/// Latent rollouts of the UAV from rest, and where both halves end.
fn rollouts(
    model: &WorldModel,
    episodes: &[Episode],
    scenario: &Scenario,
    noise: &Noise,
) -> (RolloutMetrics, Vec<Ends>) {
    let starts = model.encode_all(episodes, |e| e.frame(1, scenario));
    let mut other: Vec<usize> = (0..episodes.len()).collect();
    other.shuffle(&mut noise.generator(Stream::Evaluation, 2));
    let px = SIDE as f64;
    let error = |y: Vector2<f64>, r: Vector2<f64>| px * (model.probe.c.apply(y) - r).abs().sum();
    let fly = |start: Vector2<f64>, actions: &[Vector2<f64>]| {
        let path = model.predictor.rollout(Begin { now: start, before: start, actions });
        path.last().copied().unwrap_or(start)
    };
    let mut errors: [Vec<f64>; 4] = Default::default();
    let mut ends = Vec::with_capacity(episodes.len());
    for (n, (episode, start)) in episodes.iter().zip(&starts).enumerate() {
        let (y, actions) = (vector(model.y_c(start)), &episode.actions);
        let Some(goal) = episode.uav.last() else { continue };
        let zero = vec![Vector2::zeros(); actions.len()];
        let end = fly(y, actions);
        ends.push((end, vector(model.y_u(start))));
        errors[0].push(error(fly(y, &actions[..1]), episode.uav[2]));
        errors[1].push(error(end, *goal));
        errors[2].push(error(fly(y, &zero), *goal));
        errors[3].push(error(fly(y, &episodes[other[n]].actions), *goal));
    }
    let within = |e: &[f64], px: f64| e.iter().filter(|e| **e <= px).count() as f64 / e.len().max(1) as f64;
    let metrics = RolloutMetrics {
        one_step_within_02_px: within(&errors[0], 0.2),
        end_within_1_px: within(&errors[1], 1.0),
        true_p90_px: quantile(&errors[1], 0.9),
        zero_p90_px: quantile(&errors[2], 0.9),
        shuffled_p90_px: quantile(&errors[3], 0.9),
        acceptance: None,
    };
    (metrics, ends)
}

/// The true end of a rollout from rest, with the obstacle where it was at the start.
fn last_scene(episode: &Episode) -> Scene {
    Scene { uav: episode.uav[episode.uav.len() - 1], obstacle: episode.obstacle[1] }
}

/// The heads' outputs and the truth.
#[derive(Debug, Clone, Default)]
struct Judged {
    /// p_coll as predicted.
    predicted: Vec<f64>,
    /// p_coll.
    truth: Vec<f64>,
    /// Absolute error of the gain, dB.
    gain_db: Vec<f64>,
}

impl Judged {
    /// What counts as a collision.
    fn hit(&self) -> Vec<bool> {
        self.truth.iter().map(|p| *p > 0.5).collect()
    }
}

/// Heads at these plane coordinates against the truth of the scenes with their base stations.
fn judged(
    model: &WorldModel,
    scenes: &[(Scene, Vector2<f64>)],
    seen: &[Ends],
    scenario: &Scenario,
    floor: f64,
) -> Judged {
    let decibel = 10.0 / std::f64::consts::LN_10;
    let narrow = |y: &Vector2<f64>| [y.x as f32, y.y as f32];
    let mut judged = Judged::default();
    for ((scene, station), (c, u)) in scenes.iter().zip(seen) {
        let label = scene.label(*station, scenario, floor);
        let (heads, c, u) = (model.heads.at(*station, &model.probe), narrow(c), narrow(u));
        judged.predicted.push(f64::from(heads.collision(c, u)));
        judged.truth.push(label.collision);
        judged.gain_db.push(decibel * (f64::from(heads.log_gain(c, u)) - label.log_gain).abs());
    }
    judged
}

fn judge(
    model: &WorldModel,
    scenes: &[(Scene, Vector2<f64>)],
    seen: &[Ends],
    scenario: &Scenario,
    config: &HeadsConfig,
) -> HeadMetrics {
    let j = judged(model, scenes, seen, scenario, config.distance_floor);
    let n = scenes.len().max(1) as f64;
    HeadMetrics {
        collision_auc: auc(&j.predicted, &j.hit()),
        collision_ece: calibration_error(&j.predicted, &j.truth),
        collision_mae: j.predicted.iter().zip(&j.truth).map(|(p, t)| (p - t).abs()).sum::<f64>() / n,
        gain_rms_db: (j.gain_db.iter().map(|e| e * e).sum::<f64>() / n).sqrt(),
        gain_p90_db: quantile(&j.gain_db, 0.9),
    }
}
