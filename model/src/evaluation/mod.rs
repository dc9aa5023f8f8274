//! What a world model is worth, on held-out pictures: decode errors, leakage, rollouts, heads.
//!
//! Ground truth is used here alone, and only to measure. Errors are l1 in px (0.01 unit), as in
//! Sec. IV-B.

pub mod alarms;
pub mod chart;
#[cfg(feature = "train")]
pub mod command;
pub mod figures;
pub mod report;
pub mod robustness;
pub mod rollout;

use crpl_sitl::camera::SIDE;
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};

use crate::encoder::probe::r_squared;
use crate::encoder::weights::{LATENT, vector};
use crate::heads::labels::{self, HeadsConfig, Scene, Station, auc, calibration_error};
use crate::numeric::statistics::quantile;
use crate::training::closed_form::Check;
use crate::world_model::WorldModel;
use crate::world_model::dataset::{self, EDGE_BAND, Episode, Start};

/// How much is measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Pictures for the probe, and again as many for its test.
    pub frames: usize,
    /// Trajectories of 100 steps, each from rest.
    pub rollouts: usize,
    /// Length of a rollout, intervals.
    pub horizon: usize,
}

impl Default for EvaluationConfig {
    fn default() -> Self {
        Self { frames: 4000, rollouts: 500, horizon: 100 }
    }
}

/// Results on held-out data.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Metrics {
    /// Decode errors.
    pub probe: ProbeMetrics,
    /// Latent rollouts.
    pub rollout: RolloutMetrics,
    /// Heads on pictures, the base station where the scenario has it.
    pub heads: HeadMetrics,
    /// Heads at the end of latent rollouts, the same station.
    pub heads_after_rollout: HeadMetrics,
    /// Heads on pictures, each with a base station anywhere in the frame's square.
    pub heads_anywhere: HeadMetrics,
    /// Heads at the end of latent rollouts, stations as above.
    pub heads_anywhere_after_rollout: HeadMetrics,
    /// What the closed form says of itself without labels.
    pub label_free: Check,
}

/// Errors of the positions decoded from the latents, l1, px; share of variance leaked.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProbeMetrics {
    /// UAV at least 4 px from every edge, 90 % quantile.
    pub c_middle_p90_px: f64,
    /// UAV within 4 px of an edge: its disc is cut. 90 % quantile.
    pub c_edge_p90_px: f64,
    /// The same, largest error.
    pub c_edge_max_px: f64,
    /// Obstacle, 90 % quantile.
    pub u_p90_px: f64,
    /// Obstacle where the UAV covers a part of it, 90 % quantile.
    pub u_overlap_p90_px: f64,
    /// R² of the obstacle's position from z_c.
    pub leak_c_to_u: f64,
    /// R² of the UAV's position from z_u.
    pub leak_u_to_c: f64,
}

/// Errors of the UAV's position along latent rollouts from rest (both history frames equal).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RolloutMetrics {
    /// Share within 0.2 px after one step.
    pub one_step_within_02_px: f64,
    /// Share within 1 px at the end.
    pub end_within_1_px: f64,
    /// At the end with the true actions, 90 % quantile, px.
    pub true_p90_px: f64,
    /// With the actions set to zero.
    pub zero_p90_px: f64,
    /// With the actions of another trajectory.
    pub shuffled_p90_px: f64,
}

/// Quality of the heads.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeadMetrics {
    /// Area under the curve of p_coll > ½.
    pub collision_auc: f64,
    /// Expected calibration error of p_coll.
    pub collision_ece: f64,
    /// Mean absolute error of p_coll.
    pub collision_mae: f64,
    /// Root mean square error of |h|², dB.
    pub gain_rms_db: f64,
    /// 90 % quantile of its absolute error, dB.
    pub gain_p90_db: f64,
}

/// Measures everything but `label_free`, which the fit hands over.
#[must_use]
pub fn measure(
    model: &WorldModel,
    config: &EvaluationConfig,
    heads_config: &HeadsConfig,
    scenario: &Scenario,
    noise: &Noise,
    label_free: Check,
) -> Metrics {
    let episodes =
        dataset::collect(config.rollouts, config.horizon, Start::Rest, scenario, noise, EVALUATION_EPISODES);
    let (rollout, ends) = rollouts(model, &episodes, scenario, noise);
    let [given, anywhere] = [Station::Given, Station::Anywhere].map(|station| {
        let mut rng = noise.generator(Stream::Evaluation, 1);
        let scenes = labels::sample(config.frames, station, scenario, &mut rng);
        let seen = model.encoder.encode_all(&scenes, |(s, _)| s.frame(scenario));
        let seen: Vec<_> = seen.iter().map(|l| (vector(model.y_c(l)), vector(model.y_u(l)))).collect();
        let last: Vec<_> =
            episodes.iter().map(|e| (last_scene(e), station.draw(scenario, &mut rng))).collect();
        [
            judge(model, &scenes, &seen, scenario, heads_config),
            judge(model, &last, &ends, scenario, heads_config),
        ]
    });
    Metrics {
        probe: decode(model, config.frames, scenario, noise),
        rollout,
        heads: given[0],
        heads_after_rollout: given[1],
        heads_anywhere: anywhere[0],
        heads_anywhere_after_rollout: anywhere[1],
        label_free,
    }
}

/// Keeps the held-out episodes apart from the training ones.
const EVALUATION_EPISODES: u64 = 9;

/// Decode errors on `count` fresh pictures, both bodies anywhere.
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
struct Decoded {
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

fn decoded(model: &WorldModel, count: usize, scenario: &Scenario, noise: &Noise) -> Decoded {
    let mut rng = noise.generator(Stream::Evaluation, 0);
    let scenes: Vec<Scene> = (0..count).map(|_| labels::uniform_scene(scenario, &mut rng)).collect();
    let latents = model.encoder.encode_all(&scenes, |s| s.frame(scenario));
    let px = SIDE as f64;
    let l1 = |a: Vector2<f64>, b: Vector2<f64>| px * (a - b).abs().sum();
    let reach = scenario.obstacle().radius + scenario.uav_radius + scenario.camera.edge_px / px;
    let mut d = Decoded::default();
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

/// y_c and y_u of a picture, or at the end of a rollout.
type Ends = (Vector2<f64>, Vector2<f64>);

/// Latent rollouts of the UAV from rest, and where both halves end.
fn rollouts(
    model: &WorldModel,
    episodes: &[Episode],
    scenario: &Scenario,
    noise: &Noise,
) -> (RolloutMetrics, Vec<Ends>) {
    let psi = model.reduced();
    let starts = model.encoder.encode_all(episodes, |e| e.frame(1, scenario));
    let mut other: Vec<usize> = (0..episodes.len()).collect();
    other.shuffle(&mut noise.generator(Stream::Evaluation, 2));
    let px = SIDE as f64;
    let error = |y: Vector2<f64>, r: Vector2<f64>| px * (model.probe.c.apply(y) - r).abs().sum();
    let fly = |start: Vector2<f64>, actions: &[Vector2<f64>]| {
        let (mut now, mut before) = (start, start);
        for a in actions {
            (now, before) = (psi.step_c(now, before, *a), now);
        }
        now
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
    };
    (metrics, ends)
}

/// Where a rollout from rest truly ends, beside the obstacle as it stood at its start.
fn last_scene(episode: &Episode) -> Scene {
    Scene { uav: episode.uav[episode.uav.len() - 1], obstacle: episode.obstacle[1] }
}

/// The heads' answers beside the truth.
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
        let (heads, c, u) = (model.heads_at(*station), narrow(c), narrow(u));
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

impl Metrics {
    /// The table that `model train` ends with.
    #[must_use]
    pub fn table(&self) -> String {
        let (p, r, h, e) = (&self.probe, &self.rollout, &self.heads, &self.heads_after_rollout);
        let (any, any_end) = (&self.heads_anywhere, &self.heads_anywhere_after_rollout);
        let decibels = |h: &HeadMetrics| format!("{:.3} / {:.3} dB", h.gain_rms_db, h.gain_p90_db);
        let check = &self.label_free;
        let rows = [
            ("z_c -> UAV, whole disc, p90", format!("{:.3} px", p.c_middle_p90_px)),
            ("z_c -> UAV, cut disc, p90", format!("{:.3} px", p.c_edge_p90_px)),
            ("z_c -> UAV, cut disc, largest", format!("{:.3} px", p.c_edge_max_px)),
            ("z_u -> obstacle, p90", format!("{:.3} px", p.u_p90_px)),
            ("z_u -> obstacle under the UAV, p90", format!("{:.3} px", p.u_overlap_p90_px)),
            ("leak z_c -> obstacle, R²", format!("{:.4}", p.leak_c_to_u)),
            ("leak z_u -> UAV, R²", format!("{:.4}", p.leak_u_to_c)),
            ("one step within 0.2 px", format!("{:.3}", r.one_step_within_02_px)),
            ("rollout from rest within 1 px at the end", format!("{:.3}", r.end_within_1_px)),
            ("  true actions, p90", format!("{:.3} px", r.true_p90_px)),
            ("  zero actions, p90", format!("{:.1} px", r.zero_p90_px)),
            ("  shuffled actions, p90", format!("{:.1} px", r.shuffled_p90_px)),
            ("collision AUC / ECE / MAE, pictures", three(h)),
            ("collision AUC / ECE / MAE, after rollout", three(e)),
            ("gain rms / p90, pictures", decibels(h)),
            ("gain rms / p90, after rollout", decibels(e)),
            ("  base station anywhere, ECE, pictures", format!("{:.4}", any.collision_ece)),
            ("  base station anywhere, gain, pictures", decibels(any)),
            ("  base station anywhere, gain, after rollout", decibels(any_end)),
            ("label-free: residual of z_c", format!("{:.3} px", check.residual_c_px)),
            ("label-free: eigenvalues of z_u", check.eigenvalues.map(|v| format!("{v:.1e}")).join(" ")),
        ];
        rows.iter().map(|(name, value)| format!("{name:<44} {value}\n")).collect()
    }
}

fn three(h: &HeadMetrics) -> String {
    format!("{:.4} / {:.4} / {:.4}", h.collision_auc, h.collision_ece, h.collision_mae)
}
