//! Stage 2: π_p along stored rollouts of the executed motion policy.

use multiversion::multiversion;
use rayon::prelude::*;

use crate::numeric::kernel::{LANES, Lane, ZERO};
use crate::numeric::mlp::Mlp;
use crate::planning::lanes::{self, HIDDEN};
use crate::planning::objective;
use crate::planning::plant::{Objective, ObjectiveEstimate};
use crate::planning::policy::{FEATURES, Policies};

/// The policies' inputs and γ/γ_min at a_p = 1 in one interval of [`LANES`] rollouts.
pub(super) type Sample = ([Lane; FEATURES], Lane);

/// P̂_comm and mean power when the power that [`Policies::act`] chooses is used.
pub(super) fn executed_power(
    objective: &Objective,
    policies: &Policies,
    blocks: &[Vec<Sample>],
) -> (f64, f64) {
    let sums: Vec<(f64, f64, usize)> = blocks
        .par_iter()
        .map(|block| {
            let mut sum = (0.0, 0.0, 0);
            for (x, ratio) in block {
                for l in 0..LANES {
                    let level = policies.act(&std::array::from_fn(|i| x[i][l])).1.level();
                    sum.0 +=
                        1.0 - objective::outage_surrogate(f64::from(ratio[l]) * level, 1.0, objective.alpha);
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
pub(super) fn power_gradient(
    objective: &Objective,
    w: f64,
    eps: f64,
    net: &Mlp,
    batch: &[&[Sample]],
) -> (ObjectiveEstimate, Mlp) {
    let rollouts = (batch.len() * LANES) as f64;
    let horizon = batch[0].len() as f64;
    let alpha = objective.alpha as f32;
    let passes: Vec<PowerPass> = batch.par_iter().map(|block| power_forward(alpha, net, block)).collect();
    let connected = passes.iter().map(|p| p.connected).sum::<f64>() / (rollouts * horizon);
    let spent = passes.iter().map(|p| p.spent).sum::<f64>() / rollouts;
    let margin = connected - 1.0 + objective.outage_tolerance;
    let cost = objective.cost.power * spent;
    let estimate = ObjectiveEstimate {
        j: cost - w * objective::log_ext(margin, eps),
        cost,
        p_safe: f64::NAN,
        p_comm: connected,
    };
    let d_outage = (w / margin.max(eps) / (rollouts * horizon)) as f32;
    let d_spent = (objective.cost.power / rollouts) as f32;
    let grads: Vec<Mlp> =
        passes.par_iter().map(|pass| power_backward(net, pass, d_outage, d_spent)).collect();
    (estimate, objective::sum(grads))
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
        lanes::probabilities(net, x, &mut pass.h1[hidden.clone()], &mut pass.h2[hidden], p);
        let (mut connected, mut spent) = (0.0, 0.0);
        for (a, level) in LEVELS.iter().enumerate() {
            for l in 0..LANES {
                let outage = crate::numeric::kernel::sigmoid(alpha * (1.0 - ratio[l] * level));
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
    let back = lanes::Back::new(net);
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
    lanes::weight_gradient(net, [(&pass.x, &d1), (&pass.h1, &d2), (&pass.h2, &d3)])
}
