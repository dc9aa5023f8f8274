//! Algorithm 1 (Sec. III-D): π_s by gradient through latent rollouts (problem 1), then π_p along trajectories
//! that π_s flies (problem 2).
//!
//! The warm start tries both ways round the obstacle, each from an easier problem, and keeps the
//! better on common random rollouts. Knows latents alone: no position, no simulator.

use crpl_sitl::units::TxPower;
use crpl_sitl::world::noise::{Noise, Stream};
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::numeric::adam::{Adam, Betas, WeightMean};
use crate::numeric::kernel::LANES;
use crate::numeric::mlp::Mlp;
use crate::planning::config::{OptimiseConfig, OptimiseError};
use crate::planning::objective;
use crate::planning::plant::{Execution, Objective, ObjectiveEstimate, RolloutOptions, Scores};
use crate::planning::policy::Policies;
use crate::planning::power::{Sample, executed_power, power_gradient};
use crate::planning::problem::PlanningProblem;
use crate::planning::rollout;

/// One phase of problem 1: which network, where the obstacle is, which barrier.
#[derive(Debug, Clone, PartialEq)]
struct OptimisePhase {
    name: String,
    side: PassingSide,
    obstacle: [f32; 2],
    eta: Option<f64>,
    iterations: usize,
    /// Whether all iterations are made, whatever J does.
    is_whole: bool,
}

/// Which network a phase trains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PassingSide {
    /// Before the two candidates part.
    Free,
    /// The candidate that passes with the obstacle on its left, seen from start to goal.
    Right,
    /// The candidate that passes with the obstacle on its right.
    Left,
    /// The chosen one.
    Chosen,
}

/// What survives an interruption; phases begin with fresh optimiser state, so a resumed
/// run takes the same steps as an unbroken one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OptimiseProgress {
    phase: usize,
    free: Mlp,
    right: Option<Mlp>,
    left: Option<Mlp>,
    chosen: Option<Mlp>,
    comparison: Option<Comparison>,
}

impl OptimiseProgress {
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
    /// The way right of the obstacle, seen from start to goal.
    pub right: ObjectiveEstimate,
    /// The way left of it.
    pub left: ObjectiveEstimate,
    /// J(right) - J(left); negative chooses right where both are feasible.
    pub margin: f64,
    /// Standard error of the margin (paired, first order in the barrier).
    pub margin_se: f64,
    /// The choice.
    pub chosen: PassingSide,
}

/// What Algorithm 1 found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OptimiseOutcome {
    /// The two ways round.
    pub comparison: Comparison,
    /// The chosen policy at maximum power, on fresh rollouts, at the last η.
    pub motion: ObjectiveEstimate,
    /// The finished pair: P̂_comm at the powers of π_p, and the mean a_p, over problem 2's rollouts.
    pub p_comm_executed: f64,
    /// Mean transmit power along problem 2's rollouts, as executed.
    pub mean_power: f64,
}

/// What the caller sees while it runs.
pub trait OptimiseWatch {
    /// Called after every iteration: phase, iteration within it, its length, estimate, gradient norm.
    fn iteration(&mut self, phase: &str, done: usize, of: usize, estimate: &ObjectiveEstimate, norm: f64);
    /// Called when a phase has ended; `progress` may be saved.
    ///
    /// # Errors
    /// The progress cannot be saved, or the run is to stop: it ends with this error.
    fn phase_done(&mut self, phase: &str, progress: &OptimiseProgress) -> Result<(), OptimiseError>;
    /// Called once the candidates have been compared.
    fn compared(&mut self, comparison: &Comparison);
}

/// Number of iterations of both stages, for a progress bar.
#[must_use]
pub fn total_iterations(config: &OptimiseConfig) -> usize {
    lengths(config).sum::<usize>() + config.stage2_iterations
}

/// Iterations of each phase of problem 1, in order.
fn lengths(config: &OptimiseConfig) -> impl Iterator<Item = usize> + use<> {
    let [free, each, candidate] = config.warm_iterations;
    let mut side = vec![each; config.displacements.len()];
    side.push(candidate);
    let mut barrier = vec![config.stage1_iterations; etas(config).count()];
    if let Some(last) = barrier.last_mut() {
        *last = config.last_iterations;
    }
    [vec![free], side.clone(), side, barrier].into_iter().flatten()
}

fn etas(config: &OptimiseConfig) -> impl Iterator<Item = f64> + use<> {
    let (growth, end) = (config.barrier_growth, config.barrier_end);
    std::iter::successors(Some(growth), move |eta| Some(eta * growth)).take_while(move |eta| 1.0 / eta >= end)
}

fn phases(problem: &PlanningProblem, config: &OptimiseConfig) -> Vec<OptimisePhase> {
    let [free, each, candidate] = config.warm_iterations;
    let phase = |name: String, side, obstacle, eta, iterations| OptimisePhase {
        name,
        side,
        obstacle,
        eta,
        iterations,
        is_whole: false,
    };
    let mut all = vec![phase("no obstacle".into(), PassingSide::Free, problem.obstacle, None, free)];
    for (side, name, places) in [
        (PassingSide::Right, "right", &problem.displaced[0]),
        (PassingSide::Left, "left", &problem.displaced[1]),
    ] {
        for (d, y_u) in config.displacements.iter().zip(places) {
            all.push(phase(format!("{name}, obstacle {d} away"), side, *y_u, Some(1.0), each));
        }
        all.push(phase(format!("{name}, candidate"), side, problem.obstacle, Some(1.0), candidate));
    }
    for eta in etas(config) {
        let name = format!("stage 1, eta {eta}");
        all.push(phase(name, PassingSide::Chosen, problem.obstacle, Some(eta), config.stage1_iterations));
    }
    if let Some(last) = all.last_mut().filter(|phase| phase.side == PassingSide::Chosen) {
        (last.iterations, last.is_whole) = (config.last_iterations, true);
    }
    all
}

/// Runs Algorithm 1 from the start or from saved `progress`.
///
/// # Errors
/// If a number of `config` is out of range, or `watch` cannot save. A result that violates a chance constraint
/// is none: flights in closed loop tell.
pub fn optimise(
    problem: &PlanningProblem,
    config: &OptimiseConfig,
    seed: u64,
    progress: Option<OptimiseProgress>,
    watch: &mut dyn OptimiseWatch,
) -> Result<(Policies, OptimiseOutcome), OptimiseError> {
    config.check()?;
    let noise = Noise::new(seed);
    let untrained = Policies::untrained(&mut noise.generator(Stream::Weights, 0));
    let mut progress = progress.unwrap_or(OptimiseProgress {
        phase: 0,
        free: untrained.motion,
        right: None,
        left: None,
        chosen: None,
        comparison: None,
    });
    let all = phases(problem, config);
    for (n, phase) in all.iter().enumerate().skip(progress.phase) {
        if phase.side == PassingSide::Chosen && progress.chosen.is_none() {
            choose(problem, config, &noise, &mut progress)?;
            if let Some(comparison) = &progress.comparison {
                watch.compared(comparison);
            }
        }
        let free = &progress.free;
        let net = match phase.side {
            PassingSide::Free => &mut progress.free,
            PassingSide::Right => progress.right.get_or_insert_with(|| free.clone()),
            PassingSide::Left => progress.left.get_or_insert_with(|| free.clone()),
            PassingSide::Chosen => progress
                .chosen
                .as_mut()
                .ok_or_else(|| OptimiseError::Progress("saved progress has no chosen candidate".into()))?,
        };
        run_phase(problem, config, &noise, n as u64, phase, net, watch);
        progress.phase = n + 1;
        watch.phase_done(&phase.name, &progress)?;
    }
    let (Some(motion), Some(comparison)) = (progress.chosen, progress.comparison) else {
        return Err(OptimiseError::Progress("saved progress is from another config".into()));
    };
    finish(problem, config, &noise, motion, untrained.power, comparison, watch)
}

/// Windows of iterations, by which a phase tells that it goes no further.
struct Windows {
    length: usize,
    tolerance: f64,
    j: Vec<f64>,
    before: Option<(f64, f64)>,
}

impl Windows {
    fn new(config: &OptimiseConfig) -> Self {
        Self { length: config.averaged_iterations, tolerance: config.tolerance, j: Vec::new(), before: None }
    }

    /// Whether the next iteration is the first one of a window.
    fn begins(&self) -> bool {
        self.j.is_empty()
    }

    /// Takes the J of one more iteration, and tells at the end of a window whether the phase is over.
    fn is_over(&mut self, j: f64) -> bool {
        self.j.push(j);
        if self.j.len() < self.length {
            return false;
        }
        let n = self.length as f64;
        let mean = self.j.iter().sum::<f64>() / n;
        let variance = self.j.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0) / n;
        self.j.clear();
        let over = self.tolerance > 0.0
            && self.before.is_some_and(|(before, its)| {
                before - mean < (self.tolerance * before.abs()).max((variance + its).sqrt())
            });
        self.before = Some((mean, variance));
        over
    }
}

/// The objective of the warm start and of the choice: without the terminal cost, which says nothing of the way.
fn leading(problem: &PlanningProblem, config: &OptimiseConfig) -> Objective {
    let mut o = problem.objective(&config.objective, config.snr_headroom);
    o.cost.settle = 0.0;
    o
}

/// Iterations of one phase.
fn run_phase(
    problem: &PlanningProblem,
    config: &OptimiseConfig,
    noise: &Noise,
    number: u64,
    phase: &OptimisePhase,
    net: &mut Mlp,
    watch: &mut dyn OptimiseWatch,
) {
    let mut adam = Adam::of(net, Betas::SLOW);
    let options = RolloutOptions { eta: phase.eta, power: 4.0, execution: Execution::Nearest };
    let o = match phase.side {
        PassingSide::Chosen => problem.objective(&config.objective, config.snr_headroom),
        _ => leading(problem, config),
    };
    // The short stretches past a displaced obstacle only lead the way: averaging would hold them back.
    let is_short = phase.iterations < 4 * config.averaged_iterations;
    let mut windows = Windows::new(config);
    let mut mean = WeightMean::default();
    for i in 0..phase.iterations {
        let index = (number << 20) | i as u64;
        let draws =
            problem.draws(noise, Stream::Batches, index, config.rollouts, phase.obstacle, config.horizon);
        let (estimate, grad) = objective::gradient(&problem.plant, &o, options, net, &draws);
        let norm = adam.descend(net, &grad, config.gradient_clip, config.learning_rate);
        watch.iteration(&phase.name, i + 1, phase.iterations, &estimate, norm);
        if is_short {
            continue;
        }
        if windows.begins() && phase.iterations - i >= config.averaged_iterations {
            mean = WeightMean::default();
        }
        mean.add(net);
        if windows.is_over(estimate.j) && !phase.is_whole {
            break;
        }
    }
    if let Some(mean) = mean.net() {
        *net = mean;
    }
}

/// Rollouts of one portion of a measurement.
const PORTION: usize = 4096;

/// Measures a motion policy at maximum power on portion `index` of the common random rollouts.
fn measure(
    problem: &PlanningProblem,
    config: &OptimiseConfig,
    noise: &Noise,
    o: &Objective,
    motion: &Mlp,
    index: u64,
    all: &mut Scores,
) {
    let options = RolloutOptions { eta: None, power: 4.0, execution: Execution::Nearest };
    let portion = config.comparison_rollouts.min(PORTION);
    let draws = problem.draws(noise, Stream::Evaluation, index, portion, problem.obstacle, config.horizon);
    let (_, scores) = objective::evaluate(&problem.plant, o, options, motion, &draws);
    all.cost.extend(scores.cost);
    all.safe.extend(scores.safe);
    all.comm.extend(scores.comm);
}

/// The estimate of J_η from the scores of [`measure`].
fn estimate(o: &Objective, eta: f64, scores: &Scores) -> ObjectiveEstimate {
    let options = RolloutOptions { eta: Some(eta), power: 4.0, execution: Execution::Nearest };
    objective::estimate(o, options, scores)
}

/// Standard errors of the margin at which the comparison ends early.
const CLEAR: f64 = 4.0;

/// Keeps the feasible candidate with the smaller J at η = 1. Where neither is feasible yet, J tells which is
/// nearer to it.
fn choose(
    problem: &PlanningProblem,
    config: &OptimiseConfig,
    noise: &Noise,
    progress: &mut OptimiseProgress,
) -> Result<(), OptimiseError> {
    let (Some(right), Some(left)) = (&progress.right, &progress.left) else {
        return Err(OptimiseError::Progress("saved progress lacks a candidate".into()));
    };
    let o = leading(problem, config);
    let mut scores = [Scores::default(), Scores::default()];
    let (r, l, margin, margin_se) = loop {
        let index = (scores[0].cost.len() / PORTION) as u64;
        for (net, scores) in [right, left].into_iter().zip(&mut scores) {
            measure(problem, config, noise, &o, net, index, scores);
        }
        let [r, l] = [0, 1].map(|n| estimate(&o, 1.0, &scores[n]));
        let (ir, il) =
            (objective::influence(&o, 1.0, &r, &scores[0]), objective::influence(&o, 1.0, &l, &scores[1]));
        let (margin, se) = (r.j - l.j, paired_error(&ir, &il));
        if margin.abs() >= CLEAR * se || scores[0].cost.len() >= config.comparison_rollouts {
            break (r, l, margin, se);
        }
    };
    // The relaxed P̂_comm lets δ2 of a flight be without a link. Where only one way has a link all along, Eq. (14)
    // asks for that one.
    let connected = [right, left].map(|net| always_connected(problem, config, noise, &o, net));
    let chosen = side(&o, [&r, &l], connected);
    progress.chosen = Some(if chosen == PassingSide::Right { right.clone() } else { left.clone() });
    let rollouts = scores[0].cost.len();
    progress.comparison = Some(Comparison { rollouts, right: r, left: l, margin, margin_se, chosen });
    Ok(())
}

/// Standard error of the mean difference of two samples, pair by pair.
fn paired_error(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len() as f64;
    let paired: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    let mean = paired.iter().sum::<f64>() / n;
    let variance = paired.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (variance / n).sqrt()
}

/// The way that alone is feasible and has a link all along, else the one with the smaller J; right, left.
fn side(o: &Objective, estimates: [&ObjectiveEstimate; 2], connected: [f64; 2]) -> PassingSide {
    let fits = [0, 1].map(|n| {
        let e = estimates[n];
        e.p_safe > 1.0 - o.collision_tolerance
            && e.p_comm > 1.0 - o.outage_tolerance
            && connected[n] > 1.0 - o.outage_tolerance
    });
    match fits {
        [true, false] => PassingSide::Right,
        [false, true] => PassingSide::Left,
        _ if estimates[0].j <= estimates[1].j => PassingSide::Right,
        _ => PassingSide::Left,
    }
}

/// Rollouts on which [`always_connected`] counts.
const COUNTED: usize = 1024;

/// Share of rollouts at full power in which the link holds in every interval: P_comm of Eq. (14) itself.
fn always_connected(
    problem: &PlanningProblem,
    config: &OptimiseConfig,
    noise: &Noise,
    o: &Objective,
    motion: &Mlp,
) -> f64 {
    let draws = problem.draws(noise, Stream::Evaluation, 1 << 30, COUNTED, problem.obstacle, config.horizon);
    let full = TxPower::High.level() as f32;
    let kept: usize = draws
        .par_iter()
        .map(|d| {
            let samples = rollout::samples(&problem.plant, o, motion, d);
            (0..LANES).filter(|l| samples.iter().all(|(_, ratio)| ratio[*l] * full >= 1.0)).count()
        })
        .sum();
    kept as f64 / COUNTED as f64
}

/// Problem 2, and what was found.
fn finish(
    problem: &PlanningProblem,
    config: &OptimiseConfig,
    noise: &Noise,
    motion: Mlp,
    mut power: Mlp,
    comparison: Comparison,
    watch: &mut dyn OptimiseWatch,
) -> Result<(Policies, OptimiseOutcome), OptimiseError> {
    let o = &problem.objective(&config.objective, config.snr_headroom);
    let last_eta = etas(config).last().unwrap_or(1.0);
    // Stored rollouts of the executed policy; index 2^30 keeps them apart from problem 1's.
    let stored = problem.draws(
        noise,
        Stream::Batches,
        1 << 30,
        config.stage2_rollouts,
        problem.obstacle,
        config.horizon,
    );
    let blocks: Vec<Vec<Sample>> =
        stored.par_iter().map(|d| rollout::samples(&problem.plant, o, &motion, d)).collect();
    let (w, eps) = objective::barrier_weight(last_eta, o.barrier_residual);
    let sharp = &Objective { alpha: config.stage2_alpha, ..o.clone() };
    let mut adam = Adam::of(&power, Betas::SLOW);
    let per_batch = (config.rollouts / LANES).min(blocks.len());
    let mut rng = noise.generator(Stream::Batches, 2 << 30);
    for i in 0..config.stage2_iterations {
        let batch: Vec<&[Sample]> =
            (0..per_batch).map(|_| blocks[rng.random_range(0..blocks.len())].as_slice()).collect();
        let (estimate, grad) = power_gradient(sharp, w, eps, &power, &batch);
        let norm = adam.descend(&mut power, &grad, f32::INFINITY, config.stage2_learning_rate);
        watch.iteration("stage 2, power", i + 1, config.stage2_iterations, &estimate, norm);
    }
    let policies = Policies { motion, power, world: problem.world.clone(), scope: None };
    let (p_comm_executed, mean_power) = executed_power(sharp, &policies, &blocks);
    let mut scores = Scores::default();
    for index in 0..2 {
        measure(problem, config, noise, o, &policies.motion, index, &mut scores);
    }
    let motion_estimate = estimate(o, last_eta, &scores);
    Ok((policies, OptimiseOutcome { comparison, motion: motion_estimate, p_comm_executed, mean_power }))
}

#[cfg(test)]
mod tests;
