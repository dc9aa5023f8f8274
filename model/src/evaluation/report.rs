//! All that `model evaluate` measures, as one value: JSON for programs, a table for people.

use crpl_sitl::program::columns;
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::seq::SliceRandom;
use serde::Serialize;

use crate::encoder::probe::{covariance, effective_rank, r_squared};
use crate::encoder::weights::vector;
use crate::evaluation::hard::{self, HardReport};
use crate::evaluation::robustness::{self, RobustnessRow};
use crate::evaluation::rollout::{
    self, Forecaster, HORIZONS, Known, LONGEST, Panel, RolloutErrors, RolloutRow, RolloutStart, Trajectory,
};
use crate::evaluation::{Judged, decoded, judged};
use crate::heads::labels::{self, BaseStation, Scene, auc, calibration_error};
use crate::numeric::statistics::{Interval, bootstrap, of_quantile, quantile, wilson};
use crate::predictor::Networks;
use crate::world_model::WorldModel;
use crate::world_model::dataset::{Acceptance, Selection};

/// How much is measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportConfig {
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// Trajectories from each start.
    pub trajectories: usize,
    /// Frames for probes and heads.
    pub frames: usize,
    /// M, frames that the observer sees.
    pub window: usize,
    /// Camera of the trajectories.
    pub camera: String,
}

impl Default for ReportConfig {
    fn default() -> Self {
        Self { seed: 0, trajectories: 1000, frames: 6000, window: 20, camera: "clean".into() }
    }
}

/// What was measured.
#[derive(Debug, Clone, Serialize)]
pub struct EvaluationReport {
    /// Every predictor, start and look-ahead, on trajectories that stay in the frame and below v_max.
    pub rollout: Vec<RolloutRow>,
    /// How many candidates those are.
    pub acceptance: Vec<AcceptanceRow>,
    /// The same with no trajectory discarded.
    pub unselected: Vec<RolloutRow>,
    /// Positions from latents.
    pub probe: ProbeReport,
    /// Risk and channel.
    pub heads: HeadsReport,
    /// Whether actions matter.
    pub actions: ActionsReport,
    /// Effective ranks.
    pub rank: Rank,
    /// Every camera with a name, and leakage.
    #[serde(flatten)]
    pub cameras: HardReport,
    /// The harder cameras and states for which the centroid encoder was made.
    pub states: Vec<RobustnessRow>,
}

/// How many candidates from a start stay in the frame and below v_max for the whole trajectory.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct AcceptanceRow {
    /// From where.
    pub start: RolloutStart,
    /// The count.
    #[serde(flatten)]
    pub count: Acceptance,
    /// Its share.
    pub rate: f64,
    /// 95 % interval of the share, Wilson's.
    pub ci: Interval,
}

/// Positions from latents on held-out frames, l1.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ProbeReport {
    /// UAV, whole disc, 90 % quantile.
    pub z_c_p90_px: f64,
    /// Obstacle, 90 % quantile.
    pub z_u_p90_px: f64,
    /// R² of the obstacle's position from z_c.
    pub leak_c: f64,
    /// R² of the UAV's position from z_u.
    pub leak_u: f64,
    /// UAV whose disc the frame cuts, 90 % quantile.
    pub z_c_cut_p90_px: f64,
    /// 95 % intervals of the three quantiles, in the order z_c, z_u, z_c cut.
    pub ci: [Interval; 3],
}

/// The heads, each frame and rollout with a base station anywhere in the frame's square.
#[derive(Debug, Clone, Serialize)]
pub struct HeadsReport {
    /// Area under the curve of p_coll > ½, frames.
    pub auc: f64,
    /// Expected calibration error of p_coll, frames.
    pub ece: f64,
    /// Gain on frames, rms.
    pub gain_rms_db: f64,
    /// Gain along rollouts of 100 steps from rest, every tenth step, rms.
    pub gain_rollout_rms_db: f64,
    /// Area under the curve along rollouts.
    pub auc_rollout: f64,
    /// Expected calibration error along rollouts.
    pub ece_rollout: f64,
    /// Gain on frames with the UAV within 0.06 of the base station, rms.
    pub gain_near_rms_db: f64,
    /// Bootstrap 95 % intervals of auc, ece, gain_rms_db and gain_rollout_rms_db.
    pub ci: [Interval; 4],
    /// Reliability on frames: mean predicted and true probability, and count, of ten bins.
    pub reliability: Vec<(f64, f64, usize)>,
}

/// Error after 100 steps from rest, 90 % quantile.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ActionsReport {
    /// With the true actions.
    pub true_px: f64,
    /// Without actions.
    pub zero_px: f64,
    /// With another trajectory's.
    pub shuffled_px: f64,
    /// 95 % intervals in that order.
    pub ci: [Interval; 3],
}

/// exp of the entropy of the covariance's normalised eigenvalues.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Rank {
    /// Of z_c.
    pub z_c: f64,
    /// Of z_u.
    pub z_u: f64,
}

/// The report, and the errors along all rollouts for the figures.
#[derive(Debug, Clone)]
pub struct Measured {
    /// What is printed.
    pub report: EvaluationReport,
    /// Errors of every predictor from every start, on trajectories that stay in the frame and below v_max.
    pub errors: Vec<RolloutErrors>,
}

/// The rollouts of Fig. 3 alone: from rest, by every predictor.
#[must_use]
pub fn from_rest(
    model: &WorldModel,
    networks: &Networks,
    config: &ReportConfig,
    scenario: &Scenario,
) -> Vec<RolloutErrors> {
    let (panel, noise) = (Panel::new(model, networks, scenario), Noise::new(config.seed ^ EVALUATION));
    Forecasts::of(&panel, RolloutStart::Rest, Selection::Free, config, scenario, &noise, || ()).errors
}

/// Measures; `tick` is called for every encoded trajectory.
#[must_use]
pub fn measure(
    model: &WorldModel,
    networks: &Networks,
    config: &ReportConfig,
    scenario: &Scenario,
    tick: impl Fn() + Sync,
) -> Measured {
    let noise = Noise::new(config.seed ^ EVALUATION);
    let panel = Panel::new(model, networks, scenario);
    let forecast = |selection| {
        RolloutStart::ALL
            .map(|start| Forecasts::of(&panel, start, selection, config, scenario, &noise, &tick))
    };
    let (free, all) = (forecast(Selection::Free), forecast(Selection::All));
    let acceptance = free.each_ref().map(|f| {
        let Acceptance { kept, candidates } = f.count;
        AcceptanceRow { start: f.start, count: f.count, rate: f.count.rate(), ci: wilson(kept, candidates) }
    });
    let unselected = all.iter().flat_map(Forecasts::rows).collect();
    let rollout = free.iter().flat_map(Forecasts::rows).collect();
    let [rest, moving_obstacle, moving] = free;
    let (trajectories, known) = (rest.trajectories, rest.known);
    let errors = [rest.errors, moving_obstacle.errors, moving.errors].concat();
    let report = EvaluationReport {
        rollout,
        acceptance: acceptance.into(),
        unselected,
        probe: probe(model, config.frames, scenario, &noise),
        heads: heads_report(model, config.frames, (&trajectories, &known), scenario, &noise),
        actions: actions(model, &trajectories, &known, &noise),
        rank: rank(model, config.frames.min(2000), scenario, &noise),
        cameras: cameras(model, config, scenario, &noise),
        states: robustness::robustness_table(model, config.frames.min(2000), scenario, &noise),
    };
    Measured { report, errors }
}

/// Every camera with a name, and that of the trajectories if it has none.
fn cameras(model: &WorldModel, config: &ReportConfig, scenario: &Scenario, noise: &Noise) -> HardReport {
    let count = config.frames.min(CASE_PICTURES);
    let mut report = hard::measure(model, count, scenario, noise);
    if report.hard.iter().all(|row| row.case != config.camera) {
        report.hard.push(hard::of_camera(model, &config.camera, &scenario.camera, count, scenario, noise));
    }
    report
}

/// The trajectories of one start and all forecasts of them.
struct Forecasts {
    start: RolloutStart,
    count: Acceptance,
    trajectories: Vec<Trajectory>,
    known: Vec<Known>,
    errors: Vec<RolloutErrors>,
}

impl Forecasts {
    fn of(
        panel: &Panel<'_>,
        start: RolloutStart,
        selection: Selection,
        config: &ReportConfig,
        scenario: &Scenario,
        noise: &Noise,
        tick: impl Fn() + Sync,
    ) -> Self {
        let (trajectories, count) =
            rollout::draw(config.trajectories, start, selection, config.window, scenario, noise);
        let known = panel.look(&trajectories, scenario, tick);
        let errors = Forecaster::of(selection).iter();
        let errors =
            errors.filter_map(|name| Some((*name, start, panel.errors(*name, &trajectories, &known)?)));
        let errors = errors.collect();
        Self { start, count, trajectories, known, errors }
    }

    /// Every forecaster and look-ahead.
    fn rows(&self) -> Vec<RolloutRow> {
        let each = self.errors.iter();
        each.flat_map(|(name, start, e)| HORIZONS.map(|h| RolloutRow::of(*name, *start, h, e))).collect()
    }
}

/// Pictures of each camera.
const CASE_PICTURES: usize = 600;

/// Keeps evaluation apart from training on the same seed.
const EVALUATION: u64 = 0x6576_616c_7561_7465;

fn probe(model: &WorldModel, frames: usize, scenario: &Scenario, noise: &Noise) -> ProbeReport {
    let d = decoded(model, frames, scenario, noise);
    let p90 = |e: &[f64]| quantile(e, 0.9);
    ProbeReport {
        z_c_p90_px: p90(&d.whole),
        z_u_p90_px: p90(&d.obstacle),
        leak_c: r_squared(&d.z_c, &d.r_u),
        leak_u: r_squared(&d.z_u, &d.r_c),
        z_c_cut_p90_px: p90(&d.cut),
        ci: [&d.whole, &d.obstacle, &d.cut].map(|e| of_quantile(e, 0.9)),
    }
}

fn heads_report(
    model: &WorldModel,
    frames: usize,
    (trajectories, known): (&[Trajectory], &[Known]),
    scenario: &Scenario,
    noise: &Noise,
) -> HeadsReport {
    let floor = model.card.config.heads.distance_floor;
    let mut rng = noise.generator(Stream::Evaluation, 11);
    let scenes = labels::sample(frames, BaseStation::Anywhere, scenario, &mut rng);
    let seen = model.encode_all(&scenes, |(s, _)| s.frame(scenario));
    let seen: Vec<_> = seen.iter().map(|l| (vector(model.y_c(l)), vector(model.y_u(l)))).collect();
    let frames = judged(model, &scenes, &seen, scenario, floor);

    let (mut along, mut places) = (Vec::new(), Vec::new());
    for (t, k) in trajectories.iter().zip(known) {
        let station = BaseStation::Anywhere.draw(scenario, &mut rng);
        let obstacle = t.history[t.history.len() - 1][1];
        let path = model.predictor.rollout(k.begin(&t.actions));
        for h in (9..LONGEST).step_by(10) {
            along.push((Scene { uav: t.path[h], obstacle }, station));
            places.push((path[h], k.y_u));
        }
    }
    let rollouts = judged(model, &along, &places, scenario, floor);
    let near: Vec<f64> = (scenes.iter().zip(&frames.gain_db))
        .filter(|((s, station), _)| (s.uav - station).norm() < 0.06)
        .map(|(_, e)| *e)
        .collect();
    let n = scenes.len();
    // Points of one rollout hang together: whole rollouts are drawn again.
    let each = LONGEST / 10;
    let rollouts_ci = bootstrap(trajectories.len(), &mut rng, |picks| {
        rms(picks.iter().flat_map(|&t| &rollouts.gain_db[t * each..(t + 1) * each]).copied())
    });
    let pick = |picks: &[usize], values: &[f64]| picks.iter().map(|&n| values[n]).collect::<Vec<_>>();
    HeadsReport {
        auc: auc(&frames.predicted, &frames.hit()),
        ece: calibration_error(&frames.predicted, &frames.truth),
        gain_rms_db: rms(frames.gain_db.iter().copied()),
        gain_rollout_rms_db: rms(rollouts.gain_db.iter().copied()),
        auc_rollout: auc(&rollouts.predicted, &rollouts.hit()),
        ece_rollout: calibration_error(&rollouts.predicted, &rollouts.truth),
        gain_near_rms_db: rms(near.into_iter()),
        ci: [
            bootstrap(n, &mut rng, |picks| {
                let some = Judged {
                    predicted: pick(picks, &frames.predicted),
                    truth: pick(picks, &frames.truth),
                    gain_db: Vec::new(),
                };
                auc(&some.predicted, &some.hit())
            }),
            bootstrap(n, &mut rng, |picks| {
                calibration_error(&pick(picks, &frames.predicted), &pick(picks, &frames.truth))
            }),
            bootstrap(n, &mut rng, |picks| rms(picks.iter().map(|&n| frames.gain_db[n]))),
            rollouts_ci,
        ],
        reliability: reliability(&frames),
    }
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0usize), |(s, n), v| (s + v * v, n + 1));
    (sum / n.max(1) as f64).sqrt()
}

/// Ten bins of the predicted probability: mean predicted, mean true, count.
fn reliability(judged: &Judged) -> Vec<(f64, f64, usize)> {
    let mut bins = [(0.0, 0.0, 0usize); 10];
    for (p, t) in judged.predicted.iter().zip(&judged.truth) {
        let bin = &mut bins[((p * 10.0) as usize).min(9)];
        *bin = (bin.0 + p, bin.1 + t, bin.2 + 1);
    }
    let filled = bins.into_iter().filter(|b| b.2 > 0);
    filled.map(|(p, t, n)| (p / n as f64, t / n as f64, n)).collect()
}

fn actions(model: &WorldModel, trajectories: &[Trajectory], known: &[Known], noise: &Noise) -> ActionsReport {
    let mut other: Vec<usize> = (0..trajectories.len()).collect();
    other.shuffle(&mut noise.generator(Stream::Evaluation, 12));
    let still = vec![Vector2::zeros(); LONGEST];
    let ends = |given: &dyn Fn(usize) -> Vec<Vector2<f64>>| -> Vec<f64> {
        let each = trajectories.iter().zip(known).enumerate();
        each.filter_map(|(n, (t, k))| {
            let path = model.predictor.rollout(k.begin(&given(n)));
            rollout::off(model, &path, &t.path).last().copied()
        })
        .collect()
    };
    let all = [
        ends(&|n| trajectories[n].actions.clone()),
        ends(&|_| still.clone()),
        ends(&|n| trajectories[other[n]].actions.clone()),
    ];
    let [true_px, zero_px, shuffled_px] = all.each_ref().map(|e| quantile(e, 0.9));
    ActionsReport { true_px, zero_px, shuffled_px, ci: all.each_ref().map(|e| of_quantile(e, 0.9)) }
}

fn rank(model: &WorldModel, frames: usize, scenario: &Scenario, noise: &Noise) -> Rank {
    let mut rng = noise.generator(Stream::Evaluation, 13);
    let scenes: Vec<Scene> = (0..frames).map(|_| labels::uniform_scene(scenario, &mut rng)).collect();
    let latents = model.encode_all(&scenes, |s| s.frame(scenario));
    let (c, u): (Vec<_>, Vec<_>) = latents.iter().map(|l| (l.z_c, l.z_u)).unzip();
    Rank { z_c: effective_rank(&covariance(&c)), z_u: effective_rank(&covariance(&u)) }
}

impl EvaluationReport {
    /// The table for people; no wider than `width`.
    #[must_use]
    pub fn table(&self, width: Option<usize>) -> String {
        let mut text =
            String::from("trajectories that stay in the frame and below v_max; kept of the candidates:\n");
        text.extend(self.acceptance.iter().map(|row| {
            let Acceptance { kept, candidates } = row.count;
            let start = word(&row.start);
            format!(
                "  {start:<22} {kept} of {candidates}: {:.4} [{:.4}, {:.4}]\n",
                row.rate, row.ci[0], row.ci[1]
            )
        }));
        let mut text = columns::wrapped(&text, 4, width) + &rollouts(&self.rollout, width);
        text += "\nnothing discarded: walls and v_max as in the simulator\n";
        text += &rollouts(&self.unselected, width);
        let (p, h, a) = (&self.probe, &self.heads, &self.actions);
        let with =
            |value: f64, [low, high]: Interval, unit: &str| format!("{value:.4} [{low:.4}, {high:.4}]{unit}");
        let rows = [
            ("z_c -> UAV, whole disc, p90", with(p.z_c_p90_px, p.ci[0], " px")),
            ("z_c -> UAV, cut disc, p90", with(p.z_c_cut_p90_px, p.ci[2], " px")),
            ("z_u -> obstacle, p90", with(p.z_u_p90_px, p.ci[1], " px")),
            ("leak z_c -> obstacle, z_u -> UAV, R²", format!("{:.4}, {:.4}", p.leak_c, p.leak_u)),
            ("effective rank of z_c, z_u", format!("{:.3}, {:.3}", self.rank.z_c, self.rank.z_u)),
            ("100 steps from rest, true actions, p90", with(a.true_px, a.ci[0], " px")),
            ("  zero actions", with(a.zero_px, a.ci[1], " px")),
            ("  shuffled actions", with(a.shuffled_px, a.ci[2], " px")),
            ("collision AUC, frames", with(h.auc, h.ci[0], "")),
            ("collision ECE, frames", with(h.ece, h.ci[1], "")),
            ("collision AUC, ECE, rollouts", format!("{:.4}, {:.4}", h.auc_rollout, h.ece_rollout)),
            ("gain rms, frames", with(h.gain_rms_db, h.ci[2], " dB")),
            ("gain rms, rollouts", with(h.gain_rollout_rms_db, h.ci[3], " dB")),
            ("gain rms, within 0.06 of the base station", format!("{:.4} dB", h.gain_near_rms_db)),
        ];
        text.push('\n');
        let named = |(name, value): &(&str, String)| format!("{name:<44} {value}\n");
        text += &columns::wrapped(&rows.iter().map(named).collect::<String>(), 4, width);
        let mut states = String::from("harder cameras and states, p90 in px              z_c      z_u\n");
        states.extend(
            self.states.iter().map(|r| format!("{:<44} {:8.3} {:8.3}\n", r.case, r.z_c_p90_px, r.z_u_p90_px)),
        );
        let states = columns::folded(&states, &[44, 9, 9], width);
        format!("{text}\n{states}\n{}", self.cameras.table(width))
    }
}

/// A table of rollouts for people.
fn rollouts(rows: &[RolloutRow], width: Option<usize>) -> String {
    let mut text = String::from(
        "predictor             start                   H  P(<=.2 px)  P(<=1 px) [95 %]         P(<=5 px)  p90, px [95 %]\n",
    );
    for r in rows {
        let (name, start) = (word(&r.predictor), word(&r.start));
        text += &format!(
            "{name:<21} {start:<22} {:>3}       {:.3}  {:.3} [{:.3}, {:.3}]          {:.3}  {:.3} [{:.3}, {:.3}]\n",
            r.h, r.p02, r.p1, r.ci.p1[0], r.ci.p1[1], r.p5, r.p90_px, r.ci.p90_px[0], r.ci.p90_px[1]
        );
    }
    columns::folded(&text, &[21, 23, 4, 12, 22, 15, 22], width)
}

/// An enum's name as in JSON.
fn word(value: &impl Serialize) -> String {
    serde_json::to_value(value).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}
