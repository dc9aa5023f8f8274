//! CRPL's objective J_η on latent rollouts, and its gradient with respect to π_s (Sec. III).
//!
//! Everything happens in plane coordinates (z = E y, so nothing is lost): the learned predictor
//! rolls the latents out, the learned heads tell risk and channel, and the chance constraints enter
//! by barriers. The reverse mode is written by hand; the tests hold it against finite differences
//! and against burn's autodiff. Rollouts run [`LANES`] at a time, blocks of them on all cores.

use multiversion::multiversion;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::kernel::{self, LANES, Lane, ZERO};
use crate::mlp::{Dense, Mlp};
use crate::policy::FEATURES;

const HIDDEN: usize = 64;
const MOTIONS: usize = 5;

/// Soft minimum m_β(x) = -(1/β) log Σ e^(-β x_k).
#[must_use]
pub fn softmin(x: &[f64], beta: f64) -> f64 {
    let least = x.iter().copied().fold(f64::INFINITY, f64::min);
    least - x.iter().map(|v| (-beta * (v - least)).exp()).sum::<f64>().ln() / beta
}

/// Smooth outage p̂_out = σ_α(1 - γ/γ_min).
#[must_use]
pub fn outage_surrogate(snr: f64, snr_min: f64, alpha: f64) -> f64 {
    1.0 / (1.0 + (-alpha * (1.0 - snr / snr_min)).exp())
}

/// ln x, continued below `eps` by its tangent, so that an infeasible start has a finite objective.
#[must_use]
pub fn log_ext(x: f64, eps: f64) -> f64 {
    if x >= eps { x.ln() } else { eps.ln() + (x - eps) / eps }
}

/// Derivative of [`log_ext`].
fn log_ext_slope(x: f64, eps: f64) -> f64 {
    1.0 / x.max(eps)
}

/// Barrier weight w = ε_b + 1/η and the end ε = min(0.02, w/2) of the logarithm proper.
#[must_use]
pub fn barrier_weight(eta: f64, residual: f64) -> (f64, f64) {
    let w = residual + 1.0 / eta;
    (w, (w / 2.0).min(0.02))
}

/// -w [log_ext(P_safe - 1 + δ1) + log_ext(P_comm - 1 + δ2)]: the paper's log(a / b^-1) is a product.
#[must_use]
pub fn barrier(p_safe: f64, p_comm: f64, w: f64, eps: f64, objective: &Objective) -> f64 {
    -w * (log_ext(p_safe - 1.0 + objective.collision_tolerance, eps)
        + log_ext(p_comm - 1.0 + objective.outage_tolerance, eps))
}

/// Weights and slopes of J_η. `Default`: paper-given where the paper gives them, else docs/choices.md.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Objective {
    /// Weight of |r - r_g|²: what the unknown latent scale of the paper's ‖z_c - z_g‖² stands for.
    pub lambda_goal: f64,
    /// λ_s
    pub lambda_motion: f64,
    /// λ_p
    pub lambda_power: f64,
    /// α, slope of the smooth outage.
    pub alpha: f64,
    /// β of the soft minimum.
    pub beta: f64,
    /// ε_b
    pub barrier_residual: f64,
    /// δ1
    pub collision_tolerance: f64,
    /// δ2
    pub outage_tolerance: f64,
    /// γ_min P_n: the received power that counts as connected.
    pub snr_min: f64,
}

impl Default for Objective {
    fn default() -> Self {
        Self {
            lambda_goal: 0.05,
            lambda_motion: 1e-4,
            lambda_power: 1e-5,
            alpha: 3.0,
            beta: 500.0,
            barrier_residual: 1e-4,
            collision_tolerance: 0.05,
            outage_tolerance: 0.05,
            snr_min: 1.0,
        }
    }
}

/// What the latent rollout knows beyond the linear predictor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Limits {
    /// The learned predictor alone.
    Plain,
    /// And the speed limit.
    Clip,
    /// And the walls.
    Walls,
}

/// A head with scalar output, MLP 4-64-64-1 on [y_c, y_u] (scales and constants folded in).
#[derive(Debug, Clone)]
pub struct Head {
    net: Mlp,
    w1_transposed: Vec<f32>,
    w2_transposed: Vec<f32>,
}

impl Head {
    /// Wraps a 4-64-64-1 network; `None` for other widths.
    #[must_use]
    pub fn new(net: Mlp) -> Option<Self> {
        let [a, b, c] = net.layers.as_slice() else { return None };
        let widths = [a.inputs, a.outputs, b.outputs, c.outputs];
        if widths != [4, HIDDEN, HIDDEN, 1] {
            return None;
        }
        let (w1_transposed, w2_transposed) =
            (kernel::transpose(&a.w, HIDDEN), kernel::transpose(&b.w, HIDDEN));
        Some(Self { net, w1_transposed, w2_transposed })
    }

    /// Hidden layers and output for all lanes.
    #[inline(always)]
    fn layers(&self, x: &[Lane; 4]) -> ([Lane; HIDDEN], [Lane; HIDDEN], Lane) {
        let [l1, l2, l3] = self.net.layers.as_slice() else { return ([ZERO; HIDDEN], [ZERO; HIDDEN], ZERO) };
        let (mut h1, mut h2, mut out) = ([ZERO; HIDDEN], [ZERO; HIDDEN], [ZERO; 1]);
        kernel::affine(&l1.w, &l1.b, x, &mut h1);
        tanh_all(&mut h1);
        kernel::affine(&l2.w, &l2.b, &h1, &mut h2);
        tanh_all(&mut h2);
        kernel::affine(&l3.w, &l3.b, &h2, &mut out);
        (h1, h2, out[0])
    }

    /// Gradient of the output with respect to y_c.
    #[inline(always)]
    fn gradient(&self, x: &[Lane; 4]) -> [Lane; 2] {
        let (h1, h2, _) = self.layers(x);
        let Some(last) = self.net.layers.last() else { return [ZERO; 2] };
        let mut d2 = [ZERO; HIDDEN];
        for ((d, h), w) in d2.iter_mut().zip(&h2).zip(&last.w) {
            for (d, h) in d.iter_mut().zip(h) {
                *d = w * (1.0 - h * h);
            }
        }
        let (mut d1, mut dx) = ([ZERO; HIDDEN], [ZERO; 4]);
        kernel::affine(&self.w2_transposed, &[0.0; HIDDEN], &d2, &mut d1);
        times_tanh_slope(&mut d1, &h1);
        kernel::affine(&self.w1_transposed, &[0.0; 4], &d1, &mut dx);
        [dx[0], dx[1]]
    }
}

#[inline(always)]
fn tanh_all(h: &mut [Lane]) {
    for v in h.as_flattened_mut() {
        *v = kernel::tanh(*v);
    }
}

/// d ← d (1 - h²), the slope of tanh at output h.
#[inline(always)]
fn times_tanh_slope(d: &mut [Lane], h: &[Lane]) {
    for (d, h) in d.as_flattened_mut().iter_mut().zip(h.as_flattened()) {
        *d *= 1.0 - h * h;
    }
}

/// The learned world in plane coordinates: predictor, heads and goal.
#[derive(Debug, Clone)]
pub struct Plant {
    /// Ψ_c0, Ψ_c1 [2][2] and Ψ_ca [2][2], reduced to the plane; row-major.
    pub psi_c: [[[f32; 2]; 2]; 3],
    /// Ψ_u0, Ψ_u1 reduced to the plane.
    pub psi_u: [[[f32; 2]; 2]; 2],
    /// S, latent units per unit of length.
    pub scale: f32,
    /// v_max, units per interval.
    pub v_max: f32,
    /// Images of the frame's corners (0,0) and (1,1) in y_c.
    pub corners: [[f32; 2]; 2],
    /// What the rollout knows of limits.
    pub limits: Limits,
    /// y_g
    pub goal: [f32; 2],
    /// Logit of the collision probability.
    pub collision: Head,
    /// log(|h|²/P_n).
    pub gain: Head,
}

/// Starts and disturbances of [`LANES`] rollouts.
#[derive(Debug, Clone)]
pub struct Draws {
    /// y_c at k = 0 and k = -1.
    pub start: [[Lane; 2]; 2],
    /// y_u at k = 0 and k = -1.
    pub obstacle: [[Lane; 2]; 2],
    /// (kick/a_max) w_k, one [Lane; 2] an interval; its length is the horizon H.
    pub wind: Vec<[Lane; 2]>,
}

/// Rollout-based estimates of one batch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// J_η
    pub j: f64,
    /// Mean of Σ_k ℓ_k.
    pub cost: f64,
    /// P̂_safe
    pub p_safe: f64,
    /// P̂_comm at the given power.
    pub p_comm: f64,
}

/// Scores of single rollouts: Σ ℓ_k, s_safe, s_comm.
#[derive(Debug, Clone, Default)]
pub struct Scores {
    /// Σ_k ℓ_k
    pub cost: Vec<f64>,
    /// s_safe
    pub safe: Vec<f64>,
    /// s_comm
    pub comm: Vec<f64>,
}

/// How the batch enters J: barrier weight (`None` while the obstacle is removed) and power.
#[derive(Debug, Clone, Copy)]
pub struct Setting {
    /// η, or no barrier at all.
    pub eta: Option<f64>,
    /// a_p during the rollout (stage 1: the maximum).
    pub power: f64,
    /// Whether the rollout flies the feasible action nearest to the relaxed one, with the relaxed
    /// one's gradient (straight-through), or the relaxed one itself.
    pub execution: Execution,
}

/// Which action a training rollout flies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Execution {
    /// Nearest feasible forward, relaxed backward.
    Nearest,
    /// Relaxed both ways.
    Relaxed,
}

/// Everything that the backward pass reads again, for one block.
struct Trace {
    x: Vec<Lane>,
    h1: Vec<Lane>,
    h2: Vec<Lane>,
    p: Vec<Lane>,
    a: Vec<[Lane; 2]>,
    /// y_{-1}, y_0, ... y_H
    y: Vec<[Lane; 2]>,
    /// As `y`, of the obstacle.
    u: Vec<[Lane; 2]>,
    /// Unclipped step y_raw - y_k.
    raw: Vec<[Lane; 2]>,
    /// Collision probability at k+1, and softmin weights.
    risk: Vec<Lane>,
    weight: Vec<Lane>,
    /// γ/γ_min and smooth outage at k.
    ratio: Vec<Lane>,
    outage: Vec<Lane>,
    cost: Lane,
    safe: Lane,
    comm: Lane,
}

/// J_η of a batch.
#[must_use]
pub fn evaluate(
    plant: &Plant,
    objective: &Objective,
    setting: Setting,
    motion: &Mlp,
    draws: &[Draws],
) -> (Estimate, Scores) {
    let blocks: Vec<(Lane, Lane, Lane)> = draws
        .par_iter()
        .map(|d| {
            let t = forward(plant, objective, setting, motion, d);
            (t.cost, t.safe, t.comm)
        })
        .collect();
    let mut scores = Scores::default();
    for (cost, safe, comm) in blocks {
        scores.cost.extend(cost.iter().map(|&v| f64::from(v)));
        scores.safe.extend(safe.iter().map(|&v| f64::from(v)));
        scores.comm.extend(comm.iter().map(|&v| f64::from(v)));
    }
    (estimate(objective, setting, &scores), scores)
}

/// Sum of gradients, in order: the result does not depend on the number of threads.
pub(crate) fn sum(parts: Vec<Mlp>) -> Mlp {
    let mut parts = parts.into_iter();
    let mut total = parts.next().unwrap_or_else(|| Mlp { layers: Vec::new() });
    for part in parts {
        for (sum, layer) in total.layers.iter_mut().zip(&part.layers) {
            sum.w.iter_mut().zip(&layer.w).for_each(|(s, v)| *s += v);
            sum.b.iter_mut().zip(&layer.b).for_each(|(s, v)| *s += v);
        }
    }
    total
}

/// First-order influence of each rollout on J_η: its mean is J up to a constant, its spread tells
/// the standard error of J.
#[must_use]
pub fn influence(objective: &Objective, eta: f64, at: &Estimate, scores: &Scores) -> Vec<f64> {
    let (w, eps) = barrier_weight(eta, objective.barrier_residual);
    let safe = w * log_ext_slope(at.p_safe - 1.0 + objective.collision_tolerance, eps);
    let comm = w * log_ext_slope(at.p_comm - 1.0 + objective.outage_tolerance, eps);
    let rollouts = scores.cost.iter().zip(&scores.safe).zip(&scores.comm);
    rollouts.map(|((l, s), c)| l - safe * s - comm * c).collect()
}

/// J_η from single rollouts' scores.
#[must_use]
pub fn estimate(objective: &Objective, setting: Setting, scores: &Scores) -> Estimate {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let (cost, p_safe, p_comm) = (mean(&scores.cost), mean(&scores.safe), mean(&scores.comm));
    let penalty = setting.eta.map_or(0.0, |eta| {
        let (w, eps) = barrier_weight(eta, objective.barrier_residual);
        barrier(p_safe, p_comm, w, eps, objective)
    });
    Estimate { j: cost + penalty, cost, p_safe, p_comm }
}

/// J_η of a batch and its gradient with respect to π_s.
#[must_use]
pub fn gradient(
    plant: &Plant,
    objective: &Objective,
    setting: Setting,
    motion: &Mlp,
    draws: &[Draws],
) -> (Estimate, Mlp) {
    let traces: Vec<Trace> =
        draws.par_iter().map(|d| forward(plant, objective, setting, motion, d)).collect();
    let mut scores = Scores::default();
    for t in &traces {
        scores.cost.extend(t.cost.iter().map(|&v| f64::from(v)));
        scores.safe.extend(t.safe.iter().map(|&v| f64::from(v)));
        scores.comm.extend(t.comm.iter().map(|&v| f64::from(v)));
    }
    let estimate = estimate(objective, setting, &scores);
    let rollouts = scores.cost.len() as f64;
    // dJ/ds_safe and dJ/ds_comm of one rollout.
    let (d_safe, d_comm) = setting.eta.map_or((0.0, 0.0), |eta| {
        let (w, eps) = barrier_weight(eta, objective.barrier_residual);
        let slope = |p: f64, tolerance: f64| -w * log_ext_slope(p - 1.0 + tolerance, eps) / rollouts;
        (
            slope(estimate.p_safe, objective.collision_tolerance),
            slope(estimate.p_comm, objective.outage_tolerance),
        )
    });
    let share = Share { each: (1.0 / rollouts) as f32, d_safe: d_safe as f32, d_comm: d_comm as f32 };
    let parts: Vec<Mlp> = traces.par_iter().map(|t| backward(plant, objective, &share, motion, t)).collect();
    (estimate, sum(parts))
}

/// A rollout's share in J: 1/K, and the slopes of J in its two scores.
struct Share {
    each: f32,
    d_safe: f32,
    d_comm: f32,
}

#[inline(always)]
fn apply(m: &[[f32; 2]; 2], v: &[Lane; 2], out: &mut [Lane; 2]) {
    for (row, o) in m.iter().zip(out) {
        for ((o, a), b) in o.iter_mut().zip(&v[0]).zip(&v[1]) {
            *o = row[0].mul_add(*a, row[1].mul_add(*b, *o));
        }
    }
}

#[inline(always)]
fn apply_transposed(m: &[[f32; 2]; 2], v: &[Lane; 2], out: &mut [Lane; 2]) {
    let t = [[m[0][0], m[1][0]], [m[0][1], m[1][1]]];
    apply(&t, v, out);
}

/// Nearest feasible action to (x, y), ties to the lowest index, without branches that break lanes.
#[inline(always)]
fn nearest(x: f32, y: f32) -> (f32, f32) {
    // |w - a|² - |w|² of the five actions: 0, 1-2x, 1+2x, 1-2y, 1+2y.
    let (mut best, mut ax, mut ay) = (0.0, 0.0, 0.0);
    for (score, cx, cy) in [
        (1.0 - 2.0 * x, 1.0, 0.0),
        (1.0 + 2.0 * x, -1.0, 0.0),
        (1.0 - 2.0 * y, 0.0, 1.0),
        (1.0 + 2.0 * y, 0.0, -1.0),
    ] {
        let better = score < best;
        best = if better { score } else { best };
        ax = if better { cx } else { ax };
        ay = if better { cy } else { ay };
    }
    (ax, ay)
}

#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn forward(plant: &Plant, objective: &Objective, setting: Setting, motion: &Mlp, draws: &Draws) -> Trace {
    let horizon = draws.wind.len();
    let power = setting.power as f32;
    let relaxed = setting.execution == Execution::Relaxed;
    let mut t = Trace {
        x: vec![ZERO; horizon * FEATURES],
        h1: vec![ZERO; horizon * HIDDEN],
        h2: vec![ZERO; horizon * HIDDEN],
        p: vec![ZERO; horizon * MOTIONS],
        a: vec![[ZERO; 2]; horizon],
        y: vec![[ZERO; 2]; horizon + 2],
        u: vec![[ZERO; 2]; horizon + 2],
        raw: vec![[ZERO; 2]; horizon],
        risk: vec![ZERO; horizon],
        weight: vec![ZERO; horizon],
        ratio: vec![ZERO; horizon],
        outage: vec![ZERO; horizon],
        cost: ZERO,
        safe: ZERO,
        comm: ZERO,
    };
    t.y[0] = draws.start[1];
    t.y[1] = draws.start[0];
    t.u[0] = draws.obstacle[1];
    t.u[1] = draws.obstacle[0];
    let (place, speed) = (2.0 / plant.scale, 1.0 / (plant.scale * plant.v_max));
    let goal_weight = (objective.lambda_goal / f64::from(plant.scale).powi(2)) as f32;
    let motion_weight = objective.lambda_motion as f32;
    let power_cost = (objective.lambda_power as f32) * power * power;
    let reach = plant.scale * plant.v_max;

    for k in 0..horizon {
        let (now, before, obstacle) = (t.y[k + 1], t.y[k], t.u[k + 1]);
        let x = &mut t.x[k * FEATURES..(k + 1) * FEATURES];
        for i in 0..2 {
            for l in 0..LANES {
                x[i][l] = place * now[i][l];
                x[2 + i][l] = speed * (now[i][l] - before[i][l]);
                x[4 + i][l] = 0.5 * obstacle[i][l];
            }
        }
        let p = &mut t.p[k * MOTIONS..(k + 1) * MOTIONS];
        let hidden = k * HIDDEN..(k + 1) * HIDDEN;
        probabilities(motion, x, &mut t.h1[hidden.clone()], &mut t.h2[hidden], p);
        for l in 0..LANES {
            // Straight-through: the feasible action goes forward, the relaxed one's gradient back.
            let (wx, wy) = (p[1][l] - p[2][l], p[3][l] - p[4][l]);
            let (ax, ay) = if relaxed { (wx, wy) } else { nearest(wx, wy) };
            t.a[k][0][l] = ax;
            t.a[k][1][l] = ay;
        }
        let mut pushed = t.a[k];
        for i in 0..2 {
            for l in 0..LANES {
                pushed[i][l] += draws.wind[k][i][l];
            }
        }
        let mut next = [ZERO; 2];
        apply(&plant.psi_c[0], &now, &mut next);
        apply(&plant.psi_c[1], &before, &mut next);
        apply(&plant.psi_c[2], &pushed, &mut next);
        for l in 0..LANES {
            let (dx, dy) = (next[0][l] - now[0][l], next[1][l] - now[1][l]);
            t.raw[k][0][l] = dx;
            t.raw[k][1][l] = dy;
            if plant.limits != Limits::Plain {
                let length = (dx * dx + dy * dy).sqrt();
                let factor = if length > reach { reach / length } else { 1.0 };
                next[0][l] = now[0][l] + factor * dx;
                next[1][l] = now[1][l] + factor * dy;
            }
            if plant.limits == Limits::Walls {
                for i in 0..2 {
                    next[i][l] = next[i][l].max(plant.corners[0][i]).min(plant.corners[1][i]);
                }
            }
            let (gx, gy) = (next[0][l] - plant.goal[0], next[1][l] - plant.goal[1]);
            let effort = t.a[k][0][l] * t.a[k][0][l] + t.a[k][1][l] * t.a[k][1][l];
            t.cost[l] += goal_weight * (gx * gx + gy * gy) + motion_weight * effort + power_cost;
        }
        t.y[k + 2] = next;
        let mut drift = [ZERO; 2];
        apply(&plant.psi_u[0], &t.u[k + 1], &mut drift);
        apply(&plant.psi_u[1], &t.u[k], &mut drift);
        t.u[k + 2] = drift;
    }
    score(plant, objective, power, &mut t);
    t
}

/// Risk at k+1 and channel at k for all k, and the two scores of each rollout.
#[inline(always)]
fn score(plant: &Plant, objective: &Objective, power: f32, t: &mut Trace) {
    let horizon = t.a.len();
    let (alpha, beta) = (objective.alpha as f32, objective.beta as f32);
    let connected = power / objective.snr_min as f32;
    let mut riskiest = [0.0f32; LANES];
    for k in 0..horizon {
        let (after, now) = (k + 2, k + 1);
        let (_, _, logit) =
            plant.collision.layers(&[t.y[after][0], t.y[after][1], t.u[after][0], t.u[after][1]]);
        let (_, _, log_gain) = plant.gain.layers(&[t.y[now][0], t.y[now][1], t.u[now][0], t.u[now][1]]);
        for l in 0..LANES {
            t.risk[k][l] = kernel::sigmoid(logit[l]);
            riskiest[l] = riskiest[l].max(t.risk[k][l]);
            t.ratio[k][l] = kernel::exp(log_gain[l]) * connected;
            t.outage[k][l] = kernel::sigmoid(alpha * (1.0 - t.ratio[k][l]));
            t.comm[l] += 1.0 - t.outage[k][l];
        }
    }
    let mut sum = ZERO;
    for k in 0..horizon {
        for l in 0..LANES {
            t.weight[k][l] = kernel::exp(beta * (t.risk[k][l] - riskiest[l]));
            sum[l] += t.weight[k][l];
        }
    }
    for k in 0..horizon {
        for l in 0..LANES {
            t.weight[k][l] /= sum[l];
        }
    }
    for l in 0..LANES {
        t.safe[l] = 1.0 - riskiest[l] - sum[l].ln() / beta;
        t.comm[l] /= horizon as f32;
    }
}

/// Gradient below which a step's head is not differentiated, relative to a rollout's share in J.
const NEGLIGIBLE: f32 = 1e-7;

/// Gradient of the whole of J with respect to each y_k (k = 0..=H) through cost and heads, and not
/// through the policy: [Lane; 2] each.
#[inline(always)]
fn outer_slopes(plant: &Plant, objective: &Objective, share: &Share, t: &Trace) -> Vec<[Lane; 2]> {
    let horizon = t.a.len();
    let mut g = vec![[ZERO; 2]; horizon + 1];
    let goal = 2.0 * share.each * (objective.lambda_goal / f64::from(plant.scale).powi(2)) as f32;
    for k in 0..horizon {
        let after = k + 2;
        for i in 0..2 {
            for l in 0..LANES {
                g[k + 1][i][l] += goal * (t.y[after][i][l] - plant.goal[i]);
            }
        }
        // s_safe = softmin(1 - p): ds/dp_k = -weight_k; p = sigmoid(logit).
        let mut through = ZERO;
        for l in 0..LANES {
            through[l] = -share.d_safe * t.weight[k][l] * t.risk[k][l] * (1.0 - t.risk[k][l]);
        }
        if through.iter().any(|v| v.abs() > NEGLIGIBLE * share.each) {
            let d = plant.collision.gradient(&[t.y[after][0], t.y[after][1], t.u[after][0], t.u[after][1]]);
            for i in 0..2 {
                for l in 0..LANES {
                    g[k + 1][i][l] += through[l] * d[i][l];
                }
            }
        }
        // s_comm = mean(1 - p_out): dp_out/dlog g = -α ratio p_out (1 - p_out).
        let per_step = share.d_comm * objective.alpha as f32 / horizon as f32;
        for l in 0..LANES {
            through[l] = per_step * t.ratio[k][l] * t.outage[k][l] * (1.0 - t.outage[k][l]);
        }
        if through.iter().any(|v| v.abs() > NEGLIGIBLE * share.each) {
            let now = k + 1;
            let d = plant.gain.gradient(&[t.y[now][0], t.y[now][1], t.u[now][0], t.u[now][1]]);
            for i in 0..2 {
                for l in 0..LANES {
                    g[k][i][l] += through[l] * d[i][l];
                }
            }
        }
    }
    g
}

#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn backward(plant: &Plant, objective: &Objective, share: &Share, motion: &Mlp, t: &Trace) -> Mlp {
    let horizon = t.a.len();
    let slopes = outer_slopes(plant, objective, share, t);
    let back = Back::new(motion);
    let (place, speed) = (2.0 / plant.scale, 1.0 / (plant.scale * plant.v_max));
    let effort = 2.0 * share.each * objective.lambda_motion as f32;
    let reach = plant.scale * plant.v_max;

    let mut d1 = vec![ZERO; horizon * HIDDEN];
    let mut d2 = vec![ZERO; horizon * HIDDEN];
    let mut d3 = vec![ZERO; horizon * MOTIONS];
    // Adjoints of y_{k+1} and, as the predictor's older latent, of y_k.
    let mut newer = slopes[horizon];
    let mut older = [ZERO; 2];
    for k in (0..horizon).rev() {
        // Through walls and speed limit back to the predictor's own output.
        let mut kept = [ZERO; 2];
        for l in 0..LANES {
            if plant.limits == Limits::Walls {
                for i in 0..2 {
                    let y = t.y[k + 2][i][l];
                    let at_wall = y <= plant.corners[0][i] || y >= plant.corners[1][i];
                    newer[i][l] = if at_wall { 0.0 } else { newer[i][l] };
                }
            }
            if plant.limits != Limits::Plain {
                let (dx, dy) = (t.raw[k][0][l], t.raw[k][1][l]);
                let length = (dx * dx + dy * dy).sqrt();
                if length > reach {
                    let (ux, uy) = (dx / length, dy / length);
                    let (gx, gy) = (newer[0][l], newer[1][l]);
                    let along = gx * ux + gy * uy;
                    let factor = reach / length;
                    newer[0][l] = factor * (gx - along * ux);
                    newer[1][l] = factor * (gy - along * uy);
                    kept[0][l] = gx - newer[0][l];
                    kept[1][l] = gy - newer[1][l];
                }
            }
        }
        let mut da = [ZERO; 2];
        apply_transposed(&plant.psi_c[2], &newer, &mut da);
        let p = &t.p[k * MOTIONS..(k + 1) * MOTIONS];
        let mut dp = [ZERO; MOTIONS];
        for l in 0..LANES {
            let gx = da[0][l] + effort * t.a[k][0][l];
            let gy = da[1][l] + effort * t.a[k][1][l];
            dp[1][l] = gx;
            dp[2][l] = -gx;
            dp[3][l] = gy;
            dp[4][l] = -gy;
        }
        let hidden = k * HIDDEN..(k + 1) * HIDDEN;
        let dh1 = &mut d1[hidden.clone()];
        back.hidden(
            p,
            &dp,
            (&t.h1[hidden.clone()], &t.h2[hidden.clone()]),
            (dh1, &mut d2[hidden], &mut d3[k * MOTIONS..(k + 1) * MOTIONS]),
        );
        let mut dx = [ZERO; FEATURES];
        kernel::affine(&back.w1, &[0.0; FEATURES], dh1, &mut dx);

        let mut here = older;
        let mut past = [ZERO; 2];
        apply_transposed(&plant.psi_c[0], &newer, &mut here);
        apply_transposed(&plant.psi_c[1], &newer, &mut past);
        for i in 0..2 {
            for l in 0..LANES {
                let by_speed = speed * dx[2 + i][l];
                here[i][l] += slopes[k][i][l] + kept[i][l] + place * dx[i][l] + by_speed;
                past[i][l] -= by_speed;
            }
        }
        newer = here;
        older = past;
    }

    weight_gradient(motion, [(&t.x, &d1), (&t.h1, &d2), (&t.h2, &d3)])
}

/// A policy's action probabilities for all lanes, keeping the hidden layers for the way back.
#[inline(always)]
pub(crate) fn probabilities(net: &Mlp, x: &[Lane], h1: &mut [Lane], h2: &mut [Lane], p: &mut [Lane]) {
    let [l1, l2, l3] = net.layers.as_slice() else { return };
    kernel::affine(&l1.w, &l1.b, x, h1);
    tanh_all(h1);
    kernel::affine(&l2.w, &l2.b, h1, h2);
    tanh_all(h2);
    kernel::affine(&l3.w, &l3.b, h2, p);
    let (mut top, mut sum) = (p[0], ZERO);
    for lane in &p[1..] {
        for (t, v) in top.iter_mut().zip(lane) {
            *t = t.max(*v);
        }
    }
    for lane in p.iter_mut() {
        for ((v, t), s) in lane.iter_mut().zip(&top).zip(&mut sum) {
            *v = kernel::exp(*v - t);
            *s += *v;
        }
    }
    for lane in p {
        for (v, s) in lane.iter_mut().zip(&sum) {
            *v /= s;
        }
    }
}

/// A policy network's transposed weights, for the way back.
pub(crate) struct Back {
    w1: Vec<f32>,
    w2: Vec<f32>,
    w3: Vec<f32>,
}

impl Back {
    pub(crate) fn new(net: &Mlp) -> Self {
        let t = |n: usize| net.layers.get(n).map_or(Vec::new(), |l| kernel::transpose(&l.w, l.outputs));
        Self { w1: t(0), w2: t(1), w3: t(2) }
    }

    /// From the slopes `dp` in the probabilities `p` to the slopes before each layer's activation.
    #[inline(always)]
    pub(crate) fn hidden(
        &self,
        p: &[Lane],
        dp: &[Lane],
        (h1, h2): (&[Lane], &[Lane]),
        (d1, d2, d3): (&mut [Lane], &mut [Lane], &mut [Lane]),
    ) {
        let mut mean = ZERO;
        for (p, d) in p.iter().zip(dp) {
            for ((m, p), d) in mean.iter_mut().zip(p).zip(d) {
                *m = p.mul_add(*d, *m);
            }
        }
        for ((out, p), d) in d3.iter_mut().zip(p).zip(dp) {
            for (((o, p), d), m) in out.iter_mut().zip(p).zip(d).zip(&mean) {
                *o = p * (d - m);
            }
        }
        kernel::affine(&self.w3, &[0.0; HIDDEN], d3, d2);
        times_tanh_slope(d2, h2);
        kernel::affine(&self.w2, &[0.0; HIDDEN], d2, d1);
        times_tanh_slope(d1, h1);
    }
}

/// Gradient of the weights from each layer's inputs and the slopes before its activation.
#[inline(always)]
pub(crate) fn weight_gradient(net: &Mlp, parts: [(&[Lane], &[Lane]); 3]) -> Mlp {
    let mut grad = Mlp { layers: net.layers.iter().map(|l| Dense::zeros(l.inputs, l.outputs)).collect() };
    for (layer, (x, dy)) in grad.layers.iter_mut().zip(parts) {
        kernel::outer(x, layer.inputs, dy, layer.outputs, &mut layer.w);
        kernel::sum_lanes(dy, &mut layer.b);
    }
    grad
}

/// What stage 2 learns from: the policies' inputs and γ/γ_min at a_p = 1 along executed rollouts,
/// one entry an interval.
pub(crate) fn samples(
    plant: &Plant,
    objective: &Objective,
    motion: &Mlp,
    draws: &Draws,
) -> Vec<([Lane; FEATURES], Lane)> {
    let setting = Setting { eta: None, power: 1.0, execution: Execution::Nearest };
    let t = forward(plant, objective, setting, motion, draws);
    let inputs = t.x.chunks_exact(FEATURES).map(|x| std::array::from_fn(|i| x[i]));
    inputs.zip(t.ratio).collect()
}
