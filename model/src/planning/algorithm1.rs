//! Algorithm 1 (Sec. III-D): π_s by gradient through latent rollouts (stage 1), then π_p along trajectories
//! that π_s flies (stage 2).
//!
//! The warm start tries both ways round the obstacle, each from an easier problem, and keeps the
//! better on common random rollouts. Knows latents alone: no position, no simulator.

use crpl_sitl::world::noise::{Noise, Stream};
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::numeric::adam::{Adam, Mean};
use crate::numeric::kernel::LANES;
use crate::numeric::mlp::Mlp;
pub use crate::planning::lookahead::{Lookahead, LookaheadConfig};
use crate::planning::objective::{self, Estimate, Execution, Limits, Objective, Scores, Setting};
use crate::planning::policy::Policies;
use crate::planning::power::{Sample, executed_power, power_gradient};
pub use crate::planning::problem::{Encode, Here, Stage};
pub use crate::planning::receding::{Receding, RecedingConfig};
use crate::world_model::checkpoint::CheckpointError;

/// Every number of Algorithm 1. `Default` as argued in docs/choices.md.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiseConfig {
    /// J_η
    pub objective: Objective,
    /// What the latent rollout knows beyond the learned predictor.
    pub limits: Limits,
    /// Which heads of risk and gain the latent rollout reads.
    pub heads: Heads,
    /// H
    pub horizon: usize,
    /// K, a multiple of 32.
    pub rollouts: usize,
    /// λ of Adam.
    pub learning_rate: f32,
    /// Largest global gradient norm of stage 1.
    pub gradient_clip: f32,
    /// Standard deviation of the speed's kick in training rollouts, units per interval.
    pub kick: f64,
    /// Spread of the start position, units, and of the start speed, units per interval.
    pub start_spread: [f64; 2],
    /// Rendered and encoded start pairs.
    pub starts: usize,
    /// Iterations of the warm start: without obstacle, at each displacement, at the true place.
    pub warm_iterations: [usize; 3],
    /// Displacements of the obstacle in the warm start, units.
    pub displacements: Vec<f64>,
    /// Iterations at each η.
    pub stage1_iterations: usize,
    /// A candidate and each η end with the mean of the weights of their last iterations, this many:
    /// the last iterate alone carries the noise of one batch.
    pub averaged_iterations: usize,
    /// μ, growth of η.
    pub barrier_growth: f64,
    /// ε_0: stage 1 ends when 1/η falls below it.
    pub barrier_end: f64,
    /// Rollouts on which the two candidates and the final policy are measured.
    pub comparison_rollouts: usize,
    /// Stored rollouts of stage 2.
    pub stage2_rollouts: usize,
    /// Iterations of stage 2.
    pub stage2_iterations: usize,
    /// Closed-loop flights on which the finished pair is checked before it is kept.
    pub check_flights: usize,
    /// Kick of the gusts in those flights, where the scenario has none of its own; units per interval.
    pub check_kick: f64,
}

/// Heads of risk and gain in the latent rollout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Heads {
    /// The world model's own.
    Learned,
    /// The simulator's equations, to measure what learning them costs.
    Exact,
}

impl Default for OptimiseConfig {
    fn default() -> Self {
        Self {
            objective: Objective::default(),
            limits: Limits::Walls,
            heads: Heads::Learned,
            horizon: 100,
            rollouts: 64,
            learning_rate: 1e-3,
            gradient_clip: 1.0,
            kick: 0.0027,
            start_spread: [0.03, 0.01],
            starts: 2048,
            warm_iterations: [150, 75, 400],
            displacements: vec![0.22, 0.165, 0.11, 0.055],
            stage1_iterations: 400,
            averaged_iterations: 100,
            barrier_growth: 2.0,
            barrier_end: 1e-3,
            comparison_rollouts: 65_536,
            stage2_rollouts: 512,
            stage2_iterations: 2500,
            check_flights: 1000,
            check_kick: 0.0015,
        }
    }
}

/// Why Algorithm 1 could not start or may not ship.
#[derive(Debug, thiserror::Error)]
pub enum OptimiseError {
    /// A number in the config makes no sense.
    #[error("{key} = {value}: {must}")]
    Range {
        /// The key.
        key: &'static str,
        /// What it was.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// The heads are not 4-64-64-1 networks.
    #[error("the world model's {0} head is not a 4-64-64-1 network")]
    Head(&'static str),
    /// Neither side of the obstacle satisfies the constraints.
    #[error("no candidate is feasible: P_safe {:.4} / {:.4}, P_comm {:.4} / {:.4}", .0[0].p_safe, .0[1].p_safe, .0[0].p_comm, .0[1].p_comm)]
    Infeasible([Estimate; 2]),
    /// The finished policy violates a chance constraint.
    #[error("the policy is not safe to ship: {what} = {value:.4} on {rollouts} rollouts, needed {needed}")]
    Violated {
        /// Which constraint.
        what: &'static str,
        /// Its estimate.
        value: f64,
        /// 1 - δ.
        needed: f64,
        /// On how many rollouts.
        rollouts: usize,
    },
    /// The world model has no fingerprint.
    #[error(transparent)]
    World(#[from] CheckpointError),
    /// Saved progress could not be used.
    #[error("{0}")]
    Progress(String),
}

impl OptimiseConfig {
    /// Checks the numbers that the loops rely on.
    pub fn check(&self) -> Result<(), OptimiseError> {
        let blocks = |n: usize| n >= LANES && n.is_multiple_of(LANES);
        for (key, n) in [
            ("rollouts", self.rollouts),
            ("comparison_rollouts", self.comparison_rollouts),
            ("stage2_rollouts", self.stage2_rollouts),
        ] {
            if !blocks(n) {
                return Err(OptimiseError::Range {
                    key,
                    value: n as f64,
                    must: "must be a positive multiple of 32",
                });
            }
        }
        for (key, value) in [
            ("horizon", self.horizon as f64),
            ("starts", self.starts as f64),
            ("learning_rate", f64::from(self.learning_rate)),
            ("gradient_clip", f64::from(self.gradient_clip)),
            ("barrier_growth - 1", self.barrier_growth - 1.0),
            ("barrier_end", self.barrier_end),
            ("objective.snr_min", self.objective.snr_min),
            ("check_flights", self.check_flights as f64),
            ("check_kick", self.check_kick),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(OptimiseError::Range { key, value, must: "must be above 0" });
            }
        }
        Ok(())
    }
}

/// One stretch of stage 1: which network, where the obstacle is, which barrier.
#[derive(Debug, Clone, PartialEq)]
struct Phase {
    name: String,
    side: Side,
    obstacle: [f32; 2],
    eta: Option<f64>,
    iterations: usize,
}

/// Which network a phase trains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// Before the two candidates part.
    Free,
    /// The candidate that passes below the obstacle (smaller y).
    Below,
    /// The candidate that passes above.
    Above,
    /// The chosen one.
    Chosen,
}

/// Progress that survives an interruption; phases begin with fresh optimiser state, so a resumed
/// run takes the same steps as an unbroken one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    phase: usize,
    free: Mlp,
    below: Option<Mlp>,
    above: Option<Mlp>,
    chosen: Option<Mlp>,
    comparison: Option<Comparison>,
}

impl Progress {
    /// Iterations that lie behind.
    #[must_use]
    pub fn iterations(&self, config: &OptimiseConfig) -> usize {
        lengths(config).take(self.phase).sum()
    }
}

/// The two candidates on common random rollouts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Rollouts.
    pub rollouts: usize,
    /// The way below the obstacle.
    pub below: Estimate,
    /// The way above.
    pub above: Estimate,
    /// J(below) - J(above); negative chooses below.
    pub margin: f64,
    /// Standard error of the margin (paired, first order in the barrier).
    pub margin_se: f64,
    /// The choice.
    pub chosen: Side,
}

/// What Algorithm 1 found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// The two ways round.
    pub comparison: Comparison,
    /// The chosen policy at maximum power, on fresh rollouts, at the last η.
    pub motion: Estimate,
    /// The finished pair: P̂_comm at the powers of π_p, and the mean a_p, over stage 2's rollouts.
    pub p_comm_executed: f64,
    /// Mean transmit power along stage 2's rollouts, as executed.
    pub mean_power: f64,
}

/// What the caller sees while it runs.
pub trait Watch {
    /// Called after every iteration: phase, iteration within it, its length, estimate, gradient norm.
    fn iteration(&mut self, phase: &str, done: usize, of: usize, estimate: &Estimate, norm: f64);
    /// Called when a phase has ended; `progress` may be saved.
    fn phase_done(&mut self, phase: &str, progress: &Progress) -> Result<(), OptimiseError>;
    /// Called once the candidates have been compared.
    fn compared(&mut self, comparison: &Comparison);
}

/// Number of iterations of both stages, for a progress bar.
#[must_use]
pub fn total_iterations(config: &OptimiseConfig) -> usize {
    lengths(config).sum::<usize>() + config.stage2_iterations
}

/// Iterations of each phase of stage 1, in order.
fn lengths(config: &OptimiseConfig) -> impl Iterator<Item = usize> + use<> {
    let [free, each, candidate] = config.warm_iterations;
    let mut side = vec![each; config.displacements.len()];
    side.push(candidate);
    let barrier = vec![config.stage1_iterations; etas(config).count()];
    [vec![free], side.clone(), side, barrier].into_iter().flatten()
}

fn etas(config: &OptimiseConfig) -> impl Iterator<Item = f64> + use<> {
    let (growth, end) = (config.barrier_growth, config.barrier_end);
    std::iter::successors(Some(growth), move |eta| Some(eta * growth)).take_while(move |eta| 1.0 / eta >= end)
}

fn phases(stage: &Stage, config: &OptimiseConfig) -> Vec<Phase> {
    let [free, each, candidate] = config.warm_iterations;
    let phase =
        |name: String, side, obstacle, eta, iterations| Phase { name, side, obstacle, eta, iterations };
    let mut all = vec![phase("no obstacle".into(), Side::Free, stage.obstacle, None, free)];
    for (side, name, places) in
        [(Side::Below, "below", &stage.displaced[0]), (Side::Above, "above", &stage.displaced[1])]
    {
        for (d, y_u) in config.displacements.iter().zip(places) {
            all.push(phase(format!("{name}, obstacle {d} away"), side, *y_u, Some(1.0), each));
        }
        all.push(phase(format!("{name}, candidate"), side, stage.obstacle, Some(1.0), candidate));
    }
    for eta in etas(config) {
        let name = format!("stage 1, eta {eta}");
        all.push(phase(name, Side::Chosen, stage.obstacle, Some(eta), config.stage1_iterations));
    }
    all
}

/// Runs Algorithm 1 from the start or from saved `progress`.
pub fn optimise(
    stage: &Stage,
    config: &OptimiseConfig,
    seed: u64,
    progress: Option<Progress>,
    watch: &mut dyn Watch,
) -> Result<(Policies, Outcome), OptimiseError> {
    config.check()?;
    let noise = Noise::new(seed);
    let untrained = Policies::untrained(&mut noise.generator(Stream::Weights, 0));
    let mut progress = progress.unwrap_or(Progress {
        phase: 0,
        free: untrained.motion,
        below: None,
        above: None,
        chosen: None,
        comparison: None,
    });
    let all = phases(stage, config);
    for (n, phase) in all.iter().enumerate().skip(progress.phase) {
        if phase.side == Side::Chosen && progress.chosen.is_none() {
            choose(stage, config, &noise, &mut progress)?;
            if let Some(comparison) = &progress.comparison {
                watch.compared(comparison);
            }
        }
        let free = &progress.free;
        let net = match phase.side {
            Side::Free => &mut progress.free,
            Side::Below => progress.below.get_or_insert_with(|| free.clone()),
            Side::Above => progress.above.get_or_insert_with(|| free.clone()),
            Side::Chosen => progress
                .chosen
                .as_mut()
                .ok_or_else(|| OptimiseError::Progress("saved progress has no chosen candidate".into()))?,
        };
        stretch(stage, config, &noise, n as u64, phase, net, watch);
        progress.phase = n + 1;
        watch.phase_done(&phase.name, &progress)?;
    }
    let (Some(motion), Some(comparison)) = (progress.chosen, progress.comparison) else {
        return Err(OptimiseError::Progress("saved progress is from another config".into()));
    };
    finish(stage, config, &noise, motion, untrained.power, comparison, watch)
}

/// Iterations of one phase.
fn stretch(
    stage: &Stage,
    config: &OptimiseConfig,
    noise: &Noise,
    number: u64,
    phase: &Phase,
    net: &mut Mlp,
    watch: &mut dyn Watch,
) {
    let mut adam = Adam::new(net, config.learning_rate, config.gradient_clip);
    let setting = Setting { eta: phase.eta, power: 4.0, execution: Execution::Nearest };
    // The short stretches past a displaced obstacle only lead the way: averaging would hold them back.
    let averaged =
        if phase.iterations >= 4 * config.averaged_iterations { config.averaged_iterations } else { 1 };
    let first_averaged = phase.iterations.saturating_sub(averaged.max(1));
    let mut mean = Mean::default();
    for i in 0..phase.iterations {
        let index = (number << 20) | i as u64;
        let draws =
            stage.draws(noise, Stream::Batches, index, config.rollouts, phase.obstacle, config.horizon);
        let (estimate, grad) = objective::gradient(&stage.plant, &config.objective, setting, net, &draws);
        let norm = adam.descend(net, &grad);
        if i >= first_averaged {
            mean.add(net);
        }
        watch.iteration(&phase.name, i + 1, phase.iterations, &estimate, norm);
    }
    if let Some(mean) = mean.net() {
        *net = mean;
    }
}

/// Measures a motion policy at maximum power on common random rollouts of the evaluation stream.
#[must_use]
pub fn measure(
    stage: &Stage,
    config: &OptimiseConfig,
    noise: &Noise,
    motion: &Mlp,
    eta: f64,
) -> (Estimate, Scores) {
    let setting = Setting { eta: Some(eta), power: 4.0, execution: Execution::Nearest };
    // In portions, so that 65,536 rollouts need no more memory than 4,096.
    let portion = config.comparison_rollouts.min(4096);
    let mut all = Scores::default();
    for index in 0..(config.comparison_rollouts.div_ceil(portion)) as u64 {
        let draws = stage.draws(noise, Stream::Evaluation, index, portion, stage.obstacle, config.horizon);
        let (_, scores) = objective::evaluate(&stage.plant, &config.objective, setting, motion, &draws);
        all.cost.extend(scores.cost);
        all.safe.extend(scores.safe);
        all.comm.extend(scores.comm);
    }
    (objective::estimate(&config.objective, setting, &all), all)
}

/// Keeps the feasible candidate with the smaller J at η = 1.
fn choose(
    stage: &Stage,
    config: &OptimiseConfig,
    noise: &Noise,
    progress: &mut Progress,
) -> Result<(), OptimiseError> {
    let (Some(below), Some(above)) = (&progress.below, &progress.above) else {
        return Err(OptimiseError::Progress("saved progress lacks a candidate".into()));
    };
    let (b, b_scores) = measure(stage, config, noise, below, 1.0);
    let (a, a_scores) = measure(stage, config, noise, above, 1.0);
    let o = &config.objective;
    let feasible =
        |e: &Estimate| e.p_safe > 1.0 - o.collision_tolerance && e.p_comm > 1.0 - o.outage_tolerance;
    let chosen = match (feasible(&b), feasible(&a)) {
        (true, true) => {
            if b.j <= a.j {
                Side::Below
            } else {
                Side::Above
            }
        }
        (true, false) => Side::Below,
        (false, true) => Side::Above,
        (false, false) => return Err(OptimiseError::Infeasible([b, a])),
    };
    let (ib, ia) = (objective::influence(o, 1.0, &b, &b_scores), objective::influence(o, 1.0, &a, &a_scores));
    let n = ib.len() as f64;
    let paired: Vec<f64> = ib.iter().zip(&ia).map(|(b, a)| b - a).collect();
    let mean = paired.iter().sum::<f64>() / n;
    let variance = paired.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    progress.chosen = Some(if chosen == Side::Below { below.clone() } else { above.clone() });
    progress.comparison = Some(Comparison {
        rollouts: b_scores.cost.len(),
        below: b,
        above: a,
        margin: b.j - a.j,
        margin_se: (variance / n).sqrt(),
        chosen,
    });
    Ok(())
}

/// Stage 2 and the last check.
fn finish(
    stage: &Stage,
    config: &OptimiseConfig,
    noise: &Noise,
    motion: Mlp,
    mut power: Mlp,
    comparison: Comparison,
    watch: &mut dyn Watch,
) -> Result<(Policies, Outcome), OptimiseError> {
    let o = &config.objective;
    let last_eta = etas(config).last().unwrap_or(1.0);
    // Stored rollouts of the executed policy; index 2^40 keeps them apart from stage 1's.
    let stored =
        stage.draws(noise, Stream::Batches, 1 << 30, config.stage2_rollouts, stage.obstacle, config.horizon);
    let blocks: Vec<Vec<Sample>> =
        stored.par_iter().map(|d| objective::samples(&stage.plant, o, &motion, d)).collect();
    let (w, eps) = objective::barrier_weight(last_eta, o.barrier_residual);
    let mut adam = Adam::new(&power, config.learning_rate, f32::INFINITY);
    let per_batch = (config.rollouts / LANES).min(blocks.len());
    let mut rng = noise.generator(Stream::Batches, 2 << 30);
    for i in 0..config.stage2_iterations {
        let batch: Vec<&[Sample]> =
            (0..per_batch).map(|_| blocks[rng.random_range(0..blocks.len())].as_slice()).collect();
        let (estimate, grad) = power_gradient(o, w, eps, &power, &batch);
        let norm = adam.descend(&mut power, &grad);
        watch.iteration("stage 2, power", i + 1, config.stage2_iterations, &estimate, norm);
    }
    let policies = Policies { motion, power, world: stage.world.clone() };
    let (p_comm_executed, mean_power) = executed_power(o, &policies, &blocks);
    let (motion_estimate, _) = measure(stage, config, noise, &policies.motion, last_eta);
    let checks = [
        ("P_safe", motion_estimate.p_safe, 1.0 - o.collision_tolerance),
        ("P_comm", p_comm_executed, 1.0 - o.outage_tolerance),
    ];
    for (what, value, needed) in checks {
        if value.is_nan() || value < needed {
            let rollouts = config.comparison_rollouts;
            return Err(OptimiseError::Violated { what, value, needed, rollouts });
        }
    }
    Ok((policies, Outcome { comparison, motion: motion_estimate, p_comm_executed, mean_power }))
}
