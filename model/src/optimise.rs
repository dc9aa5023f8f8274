//! Algorithm 1: π_s by gradient through latent rollouts (stage 1), then π_p along the trajectories
//! that π_s flies (stage 2).
//!
//! The warm start tries both ways round the obstacle, each from an easier problem, and keeps the
//! better on common random rollouts. Knows latents alone: no position, no simulator.

use multiversion::multiversion;
use nalgebra::Vector2;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sitl::Scenario;
use sitl::camera;
use sitl::world::dynamics::limit_speed;
use sitl::world::noise::{Noise, Stream};

use crate::checkpoint::{self, CheckpointError};
use crate::crpl::{self, Draws, Estimate, Execution, Head, Limits, Objective, Plant, Scores, Setting};
use crate::kernel::{LANES, Lane, ZERO};
use crate::mlp::Mlp;
use crate::policy::{FEATURES, Policies};
use crate::world_model::WorldModel;

/// Every number of Algorithm 1. `Default` as argued in docs/choices.md.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiseConfig {
    /// J_η
    pub objective: Objective,
    /// What the latent rollout knows beyond the learned predictor.
    pub limits: Limits,
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
}

impl Default for OptimiseConfig {
    fn default() -> Self {
        Self {
            objective: Objective::default(),
            limits: Limits::Walls,
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
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(OptimiseError::Range { key, value, must: "must be above 0" });
            }
        }
        Ok(())
    }
}

/// What the encoder must provide: plane coordinates of a picture of UAV and obstacle.
pub type Encode<'a> = dyn Fn(&camera::Frame) -> ([f32; 2], [f32; 2]) + Sync + 'a;

/// A scenario seen through the encoder: start pairs, obstacle places.
#[derive(Debug, Clone)]
pub struct Stage {
    plant: Plant,
    /// Fingerprint of the world model.
    world: String,
    /// (y_c at 0, y_c at -1)
    starts: Vec<([f32; 2], [f32; 2])>,
    /// y_u where the obstacle stands.
    obstacle: [f32; 2],
    /// y_u of the displaced obstacles: [below: +y, above: -y][displacement].
    displaced: [Vec<[f32; 2]>; 2],
    /// kick / a_max
    wind: f32,
}

impl Stage {
    /// The scenario as `world` sees it.
    pub fn of(
        world: &WorldModel,
        scenario: &Scenario,
        config: &OptimiseConfig,
        seed: u64,
    ) -> Result<Self, OptimiseError> {
        let plant = plant(world, scenario, config)?;
        let encode = |frame: &camera::Frame| {
            let latent = world.encode(frame);
            (world.y_c(&latent), world.y_u(&latent))
        };
        let world = checkpoint::fingerprint(world)?;
        Ok(Self { world, ..Self::new(plant, &encode, scenario, config, seed) })
    }

    /// Renders and encodes what Algorithm 1 needs of a scenario. `plant`'s goal and corners are
    /// replaced by the encoded ones.
    #[must_use]
    pub fn new(
        mut plant: Plant,
        encode: &Encode<'_>,
        scenario: &Scenario,
        config: &OptimiseConfig,
        seed: u64,
    ) -> Self {
        let place =
            |uav: Vector2<f64>, obstacle: Vector2<f64>| encode(&camera::render(uav, obstacle, scenario));
        let there = scenario.obstacle.position;
        plant.goal = place(scenario.goal, there).0;
        plant.corners = [place(Vector2::zeros(), there).0, place(Vector2::repeat(1.0), there).0];
        plant.limits = config.limits;
        let noise = Noise::new(seed);
        let starts = (0..config.starts as u64)
            .into_par_iter()
            .map(|n| {
                let mut rng = noise.generator(Stream::Start, n);
                let mut normal = |s: f64| {
                    let (x, y): (f64, f64) =
                        (StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng));
                    s * Vector2::new(x, y)
                };
                let r = scenario.start + normal(config.start_spread[0]);
                let v = limit_speed(normal(config.start_spread[1]), scenario.dynamics.v_max);
                (place(r, there).0, place(r - v, there).0)
            })
            .collect();
        let displaced = [1.0, -1.0].map(|sign| {
            let shift = |d: &f64| place(scenario.start, there + Vector2::new(0.0, sign * d)).1;
            config.displacements.iter().map(shift).collect()
        });
        Self {
            obstacle: place(scenario.start, there).1,
            displaced,
            starts,
            wind: (config.kick / scenario.dynamics.a_max) as f32,
            world: String::new(),
            plant,
        }
    }

    /// The learned world with this scenario's goal.
    #[must_use]
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Common random rollouts number `index`: equal for equal (seed, index), whoever asks.
    #[must_use]
    pub fn draws(
        &self,
        noise: &Noise,
        stream: Stream,
        index: u64,
        rollouts: usize,
        y_u: [f32; 2],
        horizon: usize,
    ) -> Vec<Draws> {
        let fixed = [[y_u[0]; LANES], [y_u[1]; LANES]];
        (0..(rollouts / LANES) as u64)
            .into_par_iter()
            .map(|block| {
                let mut rng = noise.generator(stream, (index << 16) | block);
                let mut start = [[ZERO; 2]; 2];
                for l in 0..LANES {
                    let (now, before) = self.starts[rng.random_range(0..self.starts.len())];
                    for i in 0..2 {
                        start[0][i][l] = now[i];
                        start[1][i][l] = before[i];
                    }
                }
                let mut lane = || -> Lane {
                    std::array::from_fn(|_| {
                        let z: f64 = StandardNormal.sample(&mut rng);
                        self.wind * z as f32
                    })
                };
                let wind = (0..horizon).map(|_| [lane(), lane()]).collect();
                Draws { start, obstacle: [fixed, fixed], wind }
            })
            .collect()
    }
}

/// The learned world in plane coordinates, scales and noise power folded into the heads.
fn plant(world: &WorldModel, scenario: &Scenario, config: &OptimiseConfig) -> Result<Plant, OptimiseError> {
    let psi = world.reduced();
    let rows = |m: &nalgebra::Matrix2<f64>| {
        [[m[(0, 0)] as f32, m[(0, 1)] as f32], [m[(1, 0)] as f32, m[(1, 1)] as f32]]
    };
    let heads = &world.heads;
    // Input scales into the first layer's rows, output scale and offset into the last layer.
    let fold = |net: &Mlp, factor: f32, offset: f32| {
        let mut net = net.clone();
        if let Some(first) = net.layers.first_mut() {
            let outputs = first.outputs;
            for (i, row) in first.w.chunks_exact_mut(outputs).enumerate() {
                let scale = if i < 2 { heads.scale_c } else { heads.scale_u };
                row.iter_mut().for_each(|w| *w *= scale);
            }
        }
        if let Some(last) = net.layers.last_mut() {
            last.w.iter_mut().for_each(|w| *w *= factor);
            last.b.iter_mut().for_each(|b| *b = *b * factor + offset);
        }
        net
    };
    let received = heads.gain_mean - (scenario.channel.noise_power as f32).ln();
    let collision = fold(&heads.collision, 1.0, 0.0);
    let gain = fold(&heads.gain, heads.gain_std, received);
    Ok(Plant {
        psi_c: [rows(&psi.c0), rows(&psi.c1), rows(&psi.ca)],
        psi_u: [rows(&psi.u0), rows(&psi.u1)],
        scale: world.scale as f32,
        v_max: scenario.dynamics.v_max as f32,
        corners: [[f32::NEG_INFINITY; 2], [f32::INFINITY; 2]],
        limits: config.limits,
        goal: [0.0; 2],
        collision: Head::new(collision).ok_or(OptimiseError::Head("collision"))?,
        gain: Head::new(gain).ok_or(OptimiseError::Head("gain"))?,
    })
}

/// Adam (0.9, 0.999, 1e-8) over one network.
struct Adam {
    rate: f32,
    clip: f32,
    step: i32,
    first: Mlp,
    second: Mlp,
}

impl Adam {
    fn new(net: &Mlp, rate: f32, clip: f32) -> Self {
        let mut zeros = net.clone();
        for layer in &mut zeros.layers {
            layer.w.fill(0.0);
            layer.b.fill(0.0);
        }
        Self { rate, clip, step: 0, first: zeros.clone(), second: zeros }
    }

    /// One step down `grad`; returns the gradient's norm before clipping.
    fn descend(&mut self, net: &mut Mlp, grad: &Mlp) -> f64 {
        let squares = |l: &crate::mlp::Dense| {
            l.w.iter().chain(&l.b).map(|g| f64::from(*g) * f64::from(*g)).sum::<f64>()
        };
        let norm = grad.layers.iter().map(squares).sum::<f64>().sqrt();
        // A gradient that is not finite teaches nothing; the iteration is skipped.
        if !norm.is_finite() {
            return norm;
        }
        let scale = if norm > f64::from(self.clip) { (f64::from(self.clip) / norm) as f32 } else { 1.0 };
        self.step += 1;
        let (c1, c2) = (1.0 - 0.9f32.powi(self.step), 1.0 - 0.999f32.powi(self.step));
        let layers = net.layers.iter_mut().zip(&grad.layers);
        for ((layer, g), (m, v)) in layers.zip(self.first.layers.iter_mut().zip(&mut self.second.layers)) {
            let weights = layer.w.iter_mut().chain(&mut layer.b).zip(g.w.iter().chain(&g.b));
            let moments = m.w.iter_mut().chain(&mut m.b).zip(v.w.iter_mut().chain(&mut v.b));
            for ((w, g), (m, v)) in weights.zip(moments) {
                let g = scale * g;
                *m = 0.9 * *m + 0.1 * g;
                *v = 0.999 * *v + 0.001 * g * g;
                *w -= self.rate * (*m / c1) / ((*v / c2).sqrt() + 1e-8);
            }
        }
        norm
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
        let (estimate, grad) = crpl::gradient(&stage.plant, &config.objective, setting, net, &draws);
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

/// Running sum of a network's weights in f64.
#[derive(Default)]
struct Mean {
    sums: Vec<f64>,
    like: Option<Mlp>,
    count: f64,
}

impl Mean {
    fn add(&mut self, net: &Mlp) {
        let weights = net.layers.iter().flat_map(|l| l.w.iter().chain(&l.b));
        self.sums.resize(weights.clone().count(), 0.0);
        self.sums.iter_mut().zip(weights).for_each(|(s, w)| *s += f64::from(*w));
        self.like.get_or_insert_with(|| net.clone());
        self.count += 1.0;
    }

    /// The mean; `None` if nothing was added.
    fn net(self) -> Option<Mlp> {
        let mut net = self.like?;
        let weights = net.layers.iter_mut().flat_map(|l| l.w.iter_mut().chain(&mut l.b));
        weights.zip(self.sums).for_each(|(w, s)| *w = (s / self.count) as f32);
        Some(net)
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
        let (_, scores) = crpl::evaluate(&stage.plant, &config.objective, setting, motion, &draws);
        all.cost.extend(scores.cost);
        all.safe.extend(scores.safe);
        all.comm.extend(scores.comm);
    }
    (crpl::estimate(&config.objective, setting, &all), all)
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
    let (ib, ia) = (crpl::influence(o, 1.0, &b, &b_scores), crpl::influence(o, 1.0, &a, &a_scores));
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
        stored.par_iter().map(|d| crpl::samples(&stage.plant, o, &motion, d)).collect();
    let (w, eps) = crpl::barrier_weight(last_eta, o.barrier_residual);
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

/// The policies' inputs and γ/γ_min at a_p = 1 in one interval of [`LANES`] rollouts.
type Sample = ([Lane; FEATURES], Lane);

/// P̂_comm and mean power when the power that [`Policies::act`] chooses is used.
fn executed_power(objective: &Objective, policies: &Policies, blocks: &[Vec<Sample>]) -> (f64, f64) {
    let sums: Vec<(f64, f64, usize)> = blocks
        .par_iter()
        .map(|block| {
            let mut sum = (0.0, 0.0, 0);
            for (x, ratio) in block {
                for l in 0..LANES {
                    let level = policies.act(&std::array::from_fn(|i| x[i][l])).1.level();
                    sum.0 += 1.0 - crpl::outage_surrogate(f64::from(ratio[l]) * level, 1.0, objective.alpha);
                    sum.1 += level;
                    sum.2 += 1;
                }
            }
            sum
        })
        .collect();
    let n = sums.iter().map(|s| s.2).sum::<usize>().max(1) as f64;
    (sums.iter().map(|s| s.0).sum::<f64>() / n, sums.iter().map(|s| s.1).sum::<f64>() / n)
}

/// Stage 2's objective λ_p Σ E[a_p²] - w log_ext(P_comm - 1 + δ2) and its gradient.
fn power_gradient(
    objective: &Objective,
    w: f64,
    eps: f64,
    net: &Mlp,
    batch: &[&[Sample]],
) -> (Estimate, Mlp) {
    let rollouts = (batch.len() * LANES) as f64;
    let horizon = batch[0].len() as f64;
    let alpha = objective.alpha as f32;
    let passes: Vec<PowerPass> = batch.par_iter().map(|block| power_forward(alpha, net, block)).collect();
    let connected = passes.iter().map(|p| p.connected).sum::<f64>() / (rollouts * horizon);
    let spent = passes.iter().map(|p| p.spent).sum::<f64>() / rollouts;
    let margin = connected - 1.0 + objective.outage_tolerance;
    let cost = objective.lambda_power * spent;
    let estimate =
        Estimate { j: cost - w * crpl::log_ext(margin, eps), cost, p_safe: f64::NAN, p_comm: connected };
    let d_outage = (w / margin.max(eps) / (rollouts * horizon)) as f32;
    let d_spent = (objective.lambda_power / rollouts) as f32;
    let grads: Vec<Mlp> =
        passes.par_iter().map(|pass| power_backward(net, pass, d_outage, d_spent)).collect();
    (estimate, crpl::sum(grads))
}

/// What stage 2's backward pass reads again.
struct PowerPass {
    x: Vec<Lane>,
    h1: Vec<Lane>,
    h2: Vec<Lane>,
    p: Vec<Lane>,
    /// Smooth outage at each of the two powers.
    outage: Vec<[Lane; 2]>,
    connected: f64,
    spent: f64,
}

const HIDDEN: usize = 64;
const LEVELS: [f32; 2] = [1.0, 4.0];

#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn power_forward(alpha: f32, net: &Mlp, block: &[Sample]) -> PowerPass {
    let steps = block.len();
    let mut pass = PowerPass {
        x: block.iter().flat_map(|(x, _)| *x).collect(),
        h1: vec![ZERO; steps * HIDDEN],
        h2: vec![ZERO; steps * HIDDEN],
        p: vec![ZERO; steps * 2],
        outage: vec![[ZERO; 2]; steps],
        connected: 0.0,
        spent: 0.0,
    };
    for (k, (x, ratio)) in block.iter().enumerate() {
        let hidden = k * HIDDEN..(k + 1) * HIDDEN;
        let p = &mut pass.p[2 * k..2 * k + 2];
        crpl::probabilities(net, x, &mut pass.h1[hidden.clone()], &mut pass.h2[hidden], p);
        let (mut connected, mut spent) = (0.0, 0.0);
        for (a, level) in LEVELS.iter().enumerate() {
            for l in 0..LANES {
                let outage = crate::kernel::sigmoid(alpha * (1.0 - ratio[l] * level));
                pass.outage[k][a][l] = outage;
                connected += p[a][l] * (1.0 - outage);
                spent += p[a][l] * level * level;
            }
        }
        pass.connected += f64::from(connected);
        pass.spent += f64::from(spent);
    }
    pass
}

#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn power_backward(net: &Mlp, pass: &PowerPass, d_outage: f32, d_spent: f32) -> Mlp {
    let back = crpl::Back::new(net);
    let steps = pass.outage.len();
    let (mut d1, mut d2, mut d3) =
        (vec![ZERO; steps * HIDDEN], vec![ZERO; steps * HIDDEN], vec![ZERO; steps * 2]);
    for (k, outage) in pass.outage.iter().enumerate() {
        let mut dp = [ZERO; 2];
        for (a, level) in LEVELS.iter().enumerate() {
            for l in 0..LANES {
                dp[a][l] = d_outage * outage[a][l] + d_spent * level * level;
            }
        }
        let hidden = k * HIDDEN..(k + 1) * HIDDEN;
        back.hidden(
            &pass.p[2 * k..2 * k + 2],
            &dp,
            (&pass.h1[hidden.clone()], &pass.h2[hidden.clone()]),
            (&mut d1[hidden.clone()], &mut d2[hidden], &mut d3[2 * k..2 * k + 2]),
        );
    }
    crpl::weight_gradient(net, [(&pass.x, &d1), (&pass.h1, &d2), (&pass.h2, &d3)])
}
