//! CRPL's objective J_η (Eq. (29), Sec. III-D) on latent rollouts, and its gradient with respect to π_s.
//!
//! Everything happens in plane coordinates (z = E y, so nothing is lost): the learned predictor
//! rolls the latents out, the learned heads tell risk and channel, and the chance constraints enter
//! by barriers. The reverse mode is written by hand; the tests hold it against finite differences
//! and against burn's autodiff. Rollouts run [`LANES`] at a time, blocks of them on all cores.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::numeric::kernel::{LANES, Lane};
use crate::numeric::mlp::Mlp;
pub use crate::planning::area::Area;
pub use crate::planning::exact::{Exact, Quantity};
pub use crate::planning::head::Head;
pub(crate) use crate::planning::rollout::samples;
use crate::planning::rollout::{Share, Trace, backward, forward};

/// Soft minimum m_β(x) = -(1/β) log Σ e^(-β x_k), Eq. (23), Sec. III-C.
#[must_use]
pub fn softmin(x: &[f64], beta: f64) -> f64 {
    let least = x.iter().copied().fold(f64::INFINITY, f64::min);
    least - x.iter().map(|v| (-beta * (v - least)).exp()).sum::<f64>().ln() / beta
}

/// Smooth outage p̂_out = σ_α(1 - γ/γ_min), Eq. (25), Sec. III-C.
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

/// Barrier weight w = ε_b + 1/η of Eq. (29) and the end ε = min(0.02, w/2) of the logarithm proper.
#[must_use]
pub fn barrier_weight(eta: f64, residual: f64) -> (f64, f64) {
    let w = residual + 1.0 / eta;
    (w, (w / 2.0).min(0.02))
}

/// -w [log_ext(P_safe - 1 + δ1) + log_ext(P_comm - 1 + δ2)]: the log(a / b^-1) of Eq. (29) is a product.
#[must_use]
pub fn barrier(p_safe: f64, p_comm: f64, w: f64, eps: f64, objective: &Objective) -> f64 {
    -w * (log_ext(p_safe - 1.0 + objective.collision_tolerance, eps)
        + log_ext(p_comm - 1.0 + objective.outage_tolerance, eps))
}

/// Weights and slopes of J_η. `Default`: paper-given where the paper gives them, else docs/choices.md.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Objective {
    /// Weight of |r - r_g|²: what the unknown latent scale of ‖z_c - z_g‖² in Eq. (9) stands for.
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
    /// Where each obstacle can be, in y_u; `None`, or no entry, predicts it straight on for ever.
    pub areas: Vec<Option<Area>>,
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
    /// y_u of each obstacle at k = 0 and k = -1; at least one.
    pub obstacles: Vec<[[Lane; 2]; 2]>,
    /// The y_u that the policy is told, if it is not the first obstacle's own: one that was trained beside a
    /// standing obstacle has learned nothing of others.
    pub told: Option<[f32; 2]>,
    /// (kick/a_max) w_k, one [Lane; 2] an interval; its length is the horizon H.
    pub wind: Vec<[Lane; 2]>,
    /// Motions of the first intervals that are not the policy's, one row an interval; for
    /// [`evaluate`] alone, [`gradient`] takes them for the policy's own.
    pub opening: Vec<[Option<[f32; 2]>; LANES]>,
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
