//! CRPL's objective J_η (Eq. (29), Sec. III-D) on latent rollouts, and its gradient with respect to π_s.
//!
//! Everything happens in plane coordinates (z = E y, so nothing is lost): the learned predictor
//! rolls the latents out, the learned heads tell risk and channel, and the chance constraints enter
//! by barriers. The reverse mode is written by hand; the tests hold it against finite differences
//! and against burn's autodiff. Rollouts run [`LANES`](crate::numeric::kernel::LANES) at a time, blocks of them
//! on all cores.

use crpl_sitl::world::channel;
use rayon::prelude::*;

use crate::numeric::kernel::Lane;
use crate::numeric::mlp::Mlp;
use crate::planning::plant::{Draws, Objective, ObjectiveEstimate, Plant, RolloutOptions, Scores};
use crate::planning::rollout::{RolloutTrace, Share, backward, forward};

/// Soft minimum m_β(x) = -(1/β) log Σ e^(-β x_k), Eq. (23), Sec. III-C.
#[must_use]
pub fn softmin(x: &[f64], beta: f64) -> f64 {
    let least = x.iter().copied().fold(f64::INFINITY, f64::min);
    least - x.iter().map(|v| (-beta * (v - least)).exp()).sum::<f64>().ln() / beta
}

/// Smooth outage p̂_out = σ_α(1 - γ/γ_min), Eq. (25), Sec. III-C.
#[must_use]
pub fn outage_surrogate(snr: f64, snr_min: f64, alpha: f64) -> f64 {
    channel::sigmoid(alpha * (1.0 - snr / snr_min))
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

/// J_η of a batch.
#[must_use]
pub fn evaluate(
    plant: &Plant,
    objective: &Objective,
    options: RolloutOptions,
    motion: &Mlp,
    draws: &[Draws],
) -> (ObjectiveEstimate, Scores) {
    let blocks: Vec<(Lane, Lane, Lane)> = draws
        .par_iter()
        .map(|d| {
            let t = forward(plant, objective, options, motion, d);
            (t.cost, t.safe, t.comm)
        })
        .collect();
    let mut scores = Scores::default();
    for (cost, safe, comm) in blocks {
        scores.cost.extend(cost.iter().map(|&v| f64::from(v)));
        scores.safe.extend(safe.iter().map(|&v| f64::from(v)));
        scores.comm.extend(comm.iter().map(|&v| f64::from(v)));
    }
    (estimate(objective, options, &scores), scores)
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
pub fn influence(objective: &Objective, eta: f64, at: &ObjectiveEstimate, scores: &Scores) -> Vec<f64> {
    let (w, eps) = barrier_weight(eta, objective.barrier_residual);
    let safe = w * log_ext_slope(at.p_safe - 1.0 + objective.collision_tolerance, eps);
    let comm = w * log_ext_slope(at.p_comm - 1.0 + objective.outage_tolerance, eps);
    let rollouts = scores.cost.iter().zip(&scores.safe).zip(&scores.comm);
    rollouts.map(|((l, s), c)| l - safe * s - comm * c).collect()
}

/// J_η from single rollouts' scores.
#[must_use]
pub fn estimate(objective: &Objective, options: RolloutOptions, scores: &Scores) -> ObjectiveEstimate {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let (cost, p_safe, p_comm) = (mean(&scores.cost), mean(&scores.safe), mean(&scores.comm));
    let penalty = options.eta.map_or(0.0, |eta| {
        let (w, eps) = barrier_weight(eta, objective.barrier_residual);
        barrier(p_safe, p_comm, w, eps, objective)
    });
    ObjectiveEstimate { j: cost + penalty, cost, p_safe, p_comm }
}

/// J_η of a batch and its gradient with respect to π_s.
#[must_use]
pub fn gradient(
    plant: &Plant,
    objective: &Objective,
    options: RolloutOptions,
    motion: &Mlp,
    draws: &[Draws],
) -> (ObjectiveEstimate, Mlp) {
    let mut traces: Vec<RolloutTrace> =
        draws.par_iter().map(|d| forward(plant, objective, options, motion, d)).collect();
    let mut scores = Scores::default();
    for t in &traces {
        scores.cost.extend(t.cost.iter().map(|&v| f64::from(v)));
        scores.safe.extend(t.safe.iter().map(|&v| f64::from(v)));
        scores.comm.extend(t.comm.iter().map(|&v| f64::from(v)));
    }
    let estimate = estimate(objective, options, &scores);
    let rollouts = scores.cost.len() as f64;
    // dJ/ds_safe and dJ/ds_comm of one rollout.
    let (d_safe, d_comm) = options.eta.map_or((0.0, 0.0), |eta| {
        let (w, eps) = barrier_weight(eta, objective.barrier_residual);
        let slope = |p: f64, tolerance: f64| -w * log_ext_slope(p - 1.0 + tolerance, eps) / rollouts;
        (
            slope(estimate.p_safe, objective.collision_tolerance),
            slope(estimate.p_comm, objective.outage_tolerance),
        )
    });
    let share = Share { each: (1.0 / rollouts) as f32, d_safe: d_safe as f32, d_comm: d_comm as f32 };
    let parts: Vec<Mlp> =
        traces.par_iter_mut().map(|t| backward(plant, objective, &share, motion, t)).collect();
    (estimate, sum(parts))
}
