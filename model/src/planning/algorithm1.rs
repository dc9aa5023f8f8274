//! Algorithm 1 (Sec. III-D): π_s by gradient through latent rollouts (problem 1), then π_p along trajectories
//! that π_s flies (problem 2).
//!
//! The warm start tries both ways round the obstacle, each from an easier problem, and keeps the
//! better on common random rollouts. Knows latents alone: no position, no simulator.

use crpl_sitl::world::noise::{Noise, Stream};
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::numeric::adam::{Adam, Betas, WeightMean};
use crate::numeric::kernel::LANES;
use crate::numeric::mlp::Mlp;
use crate::planning::config::{OptimiseConfig, OptimiseError};
use crate::planning::objective;
use crate::planning::plant::{Execution, ObjectiveEstimate, RolloutOptions, Scores};
use crate::planning::policy::Policies;
use crate::planning::power::{Sample, executed_power, power_gradient};
use crate::planning::problem::PlanningProblem;
use crate::planning::rollout;

/// One run_phase of problem 1: which network, where the obstacle is, which barrier.
#[derive(Debug, Clone, PartialEq)]
struct OptimisePhase {
    name: String,
    side: PassingSide,
    obstacle: [f32; 2],
    eta: Option<f64>,
    iterations: usize,
}

/// Which network a phase trains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PassingSide {
    /// Before the two candidates part.
    Free,
    /// The candidate that passes below the obstacle (smaller y).
    Below,
    /// The candidate that passes above.
    Above,
    /// The chosen one.
    Chosen,
}

/// OptimiseProgress that survives an interruption; phases begin with fresh optimiser state, so a resumed
/// run takes the same steps as an unbroken one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OptimiseProgress {
    phase: usize,
    free: Mlp,
    below: Option<Mlp>,
    above: Option<Mlp>,
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
    /// The way below the obstacle.
    pub below: ObjectiveEstimate,
    /// The way above.
    pub above: ObjectiveEstimate,
    /// J(below) - J(above); negative chooses below.
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
    let barrier = vec![config.stage1_iterations; etas(config).count()];
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
    };
    let mut all = vec![phase("no obstacle".into(), PassingSide::Free, problem.obstacle, None, free)];
    for (side, name, places) in [
        (PassingSide::Below, "below", &problem.displaced[0]),
        (PassingSide::Above, "above", &problem.displaced[1]),
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
    all
}

/// Runs Algorithm 1 from the start or from saved `progress`.
///
/// # Errors
/// If a number of `config` is out of range, no candidate is feasible, the result violates a chance constraint,
/// or `watch` cannot save.
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
        below: None,
        above: None,
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
            PassingSide::Below => progress.below.get_or_insert_with(|| free.clone()),
            PassingSide::Above => progress.above.get_or_insert_with(|| free.clone()),
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
    // The short stretches past a displaced obstacle only lead the way: averaging would hold them back.
    let averaged =
        if phase.iterations >= 4 * config.averaged_iterations { config.averaged_iterations } else { 1 };
    let first_averaged = phase.iterations.saturating_sub(averaged.max(1));
    let mut mean = WeightMean::default();
    for i in 0..phase.iterations {
        let index = (number << 20) | i as u64;
        let draws =
            problem.draws(noise, Stream::Batches, index, config.rollouts, phase.obstacle, config.horizon);
        let (estimate, grad) = objective::gradient(&problem.plant, &config.objective, options, net, &draws);
        let norm = adam.descend(net, &grad, config.gradient_clip, config.learning_rate);
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
    problem: &PlanningProblem,
    config: &OptimiseConfig,
    noise: &Noise,
    motion: &Mlp,
    eta: f64,
) -> (ObjectiveEstimate, Scores) {
    let options = RolloutOptions { eta: Some(eta), power: 4.0, execution: Execution::Nearest };
    // In portions, so that 65,536 rollouts need no more memory than 4,096.
    let portion = config.comparison_rollouts.min(4096);
    let mut all = Scores::default();
    for index in 0..(config.comparison_rollouts.div_ceil(portion)) as u64 {
        let draws =
            problem.draws(noise, Stream::Evaluation, index, portion, problem.obstacle, config.horizon);
        let (_, scores) = objective::evaluate(&problem.plant, &config.objective, options, motion, &draws);
        all.cost.extend(scores.cost);
        all.safe.extend(scores.safe);
        all.comm.extend(scores.comm);
    }
    (objective::estimate(&config.objective, options, &all), all)
}

/// Keeps the feasible candidate with the smaller J at η = 1.
fn choose(
    problem: &PlanningProblem,
    config: &OptimiseConfig,
    noise: &Noise,
    progress: &mut OptimiseProgress,
) -> Result<(), OptimiseError> {
    let (Some(below), Some(above)) = (&progress.below, &progress.above) else {
        return Err(OptimiseError::Progress("saved progress lacks a candidate".into()));
    };
    let (b, b_scores) = measure(problem, config, noise, below, 1.0);
    let (a, a_scores) = measure(problem, config, noise, above, 1.0);
    let o = &config.objective;
    let feasible =
        |e: &ObjectiveEstimate| e.p_safe > 1.0 - o.collision_tolerance && e.p_comm > 1.0 - o.outage_tolerance;
    let chosen = match (feasible(&b), feasible(&a)) {
        (true, true) => {
            if b.j <= a.j {
                PassingSide::Below
            } else {
                PassingSide::Above
            }
        }
        (true, false) => PassingSide::Below,
        (false, true) => PassingSide::Above,
        (false, false) => return Err(OptimiseError::Infeasible([b, a])),
    };
    let (ib, ia) = (objective::influence(o, 1.0, &b, &b_scores), objective::influence(o, 1.0, &a, &a_scores));
    let n = ib.len() as f64;
    let paired: Vec<f64> = ib.iter().zip(&ia).map(|(b, a)| b - a).collect();
    let mean = paired.iter().sum::<f64>() / n;
    let variance = paired.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    progress.chosen = Some(if chosen == PassingSide::Below { below.clone() } else { above.clone() });
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

/// PlanningProblem 2 and the last check.
fn finish(
    problem: &PlanningProblem,
    config: &OptimiseConfig,
    noise: &Noise,
    motion: Mlp,
    mut power: Mlp,
    comparison: Comparison,
    watch: &mut dyn OptimiseWatch,
) -> Result<(Policies, OptimiseOutcome), OptimiseError> {
    let o = &config.objective;
    let last_eta = etas(config).last().unwrap_or(1.0);
    // Stored rollouts of the executed policy; index 2^40 keeps them apart from problem 1's.
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
    let mut adam = Adam::of(&power, Betas::SLOW);
    let per_batch = (config.rollouts / LANES).min(blocks.len());
    let mut rng = noise.generator(Stream::Batches, 2 << 30);
    for i in 0..config.stage2_iterations {
        let batch: Vec<&[Sample]> =
            (0..per_batch).map(|_| blocks[rng.random_range(0..blocks.len())].as_slice()).collect();
        let (estimate, grad) = power_gradient(o, w, eps, &power, &batch);
        let norm = adam.descend(&mut power, &grad, f32::INFINITY, config.learning_rate);
        watch.iteration("stage 2, power", i + 1, config.stage2_iterations, &estimate, norm);
    }
    let policies = Policies { motion, power, world: problem.world.clone(), scope: None };
    let (p_comm_executed, mean_power) = executed_power(o, &policies, &blocks);
    let (motion_estimate, _) = measure(problem, config, noise, &policies.motion, last_eta);
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
    Ok((policies, OptimiseOutcome { comparison, motion: motion_estimate, p_comm_executed, mean_power }))
}
