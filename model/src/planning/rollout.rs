//! Latent rollouts (Eq. (20), Sec. III-B), forward and backward,
//! [`LANES`](crate::numeric::kernel::LANES) at a time.

use multiversion::multiversion;

use crate::numeric::kernel::{self, LANES, Lane, ZERO};
use crate::numeric::mlp::Mlp;
use crate::planning::area::Area;
use crate::planning::lanes::{Back, HIDDEN, probabilities, weight_gradient};
use crate::planning::plant::{Draws, Edge, Execution, Objective, Plant, RolloutLimits, RolloutOptions};
use crate::planning::policy::FEATURES;
use crate::predictor::Memory;

const MOTIONS: usize = 5;

/// Everything that the backward pass reads again, for one block.
pub(super) struct RolloutTrace {
    x: Vec<Lane>,
    h1: Vec<Lane>,
    h2: Vec<Lane>,
    p: Vec<Lane>,
    a: Vec<[Lane; 2]>,
    /// y_{-1}, y_0, ... y_H
    y: Vec<[Lane; 2]>,
    /// As `y`, of each obstacle.
    u: Vec<Vec<[Lane; 2]>>,
    /// Unclipped step y_raw - y_k.
    raw: Vec<[Lane; 2]>,
    /// Collision probability at k+1, and softmin weights.
    risk: Vec<Lane>,
    weight: Vec<Lane>,
    /// γ/γ_min and smooth outage at k.
    ratio: Vec<Lane>,
    outage: Vec<Lane>,
    /// Intervals of the flight after the rollout.
    beyond: usize,
    /// What the predictor takes back.
    memory: Memory,
    pub(super) cost: Lane,
    pub(super) safe: Lane,
    pub(super) comm: Lane,
}

/// What a rollout tells who looks ahead, `[interval]` each.
pub(super) struct Told<Y> {
    /// The policy's inputs, [`FEATURES`] an interval.
    pub(super) x: Vec<Lane>,
    /// y_c after each interval.
    pub(super) y_c: Y,
    /// γ/γ_min in each interval.
    pub(super) ratio: Vec<Lane>,
    /// Collision probability after each interval.
    pub(super) risk: Vec<Lane>,
}

impl RolloutTrace {
    pub(super) fn told(self) -> Told<impl Iterator<Item = [Lane; 2]>> {
        Told { x: self.x, y_c: self.y.into_iter().skip(2), ratio: self.ratio, risk: self.risk }
    }
}

/// A rollout's share in J: 1/K, and the slopes of J in its two scores.
pub(super) struct Share {
    pub(super) each: f32,
    pub(super) d_safe: f32,
    pub(super) d_comm: f32,
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
pub(super) fn forward(
    plant: &Plant,
    objective: &Objective,
    options: RolloutOptions,
    motion: &Mlp,
    draws: &Draws,
) -> RolloutTrace {
    let horizon = draws.wind.len();
    let power = options.power as f32;
    let relaxed = options.execution == Execution::Relaxed;
    let mut t = RolloutTrace {
        x: vec![ZERO; horizon * FEATURES],
        h1: vec![ZERO; horizon * HIDDEN],
        h2: vec![ZERO; horizon * HIDDEN],
        p: vec![ZERO; horizon * MOTIONS],
        a: vec![[ZERO; 2]; horizon],
        y: vec![[ZERO; 2]; horizon + 2],
        u: Vec::with_capacity(draws.obstacles.len()),
        raw: vec![[ZERO; 2]; horizon],
        risk: vec![ZERO; horizon],
        weight: vec![ZERO; horizon],
        ratio: vec![ZERO; horizon],
        outage: vec![ZERO; horizon],
        beyond: draws.beyond,
        memory: Memory::default(),
        cost: ZERO,
        safe: ZERO,
        comm: ZERO,
    };
    t.y[0] = draws.start[1];
    t.y[1] = draws.start[0];
    for (n, obstacle) in draws.obstacles.iter().enumerate() {
        let area = plant.areas.get(n).and_then(Option::as_ref);
        t.u.push(drift(plant, area, *obstacle, horizon));
    }
    let (place, speed) = (2.0 / plant.scale, 1.0 / (plant.scale * plant.v_max));
    let motion_weight = objective.cost.motion as f32;
    let power_cost = (objective.cost.power as f32) * power * power;
    let reach = plant.scale * plant.v_max;

    for k in 0..horizon {
        let goal_weight = goal_weight(plant, objective, horizon - k + t.beyond);
        let (now, before) = (t.y[k + 1], t.y[k]);
        let reported = draws.reported_obstacle.map_or_else(|| t.u[0][k + 1], |y_u| y_u.map(|v| [v; LANES]));
        let x = &mut t.x[k * FEATURES..(k + 1) * FEATURES];
        for i in 0..2 {
            for l in 0..LANES {
                x[i][l] = place * now[i][l];
                x[2 + i][l] = speed * (now[i][l] - before[i][l]);
                x[4 + i][l] = 0.5 * reported[i][l];
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
        if let Some(opening) = draws.opening.get(k) {
            for (l, a) in opening.iter().enumerate() {
                if let Some(a) = a {
                    (t.a[k][0][l], t.a[k][1][l]) = (a[0], a[1]);
                }
            }
        }
        let mut pushed = t.a[k];
        for i in 0..2 {
            for l in 0..LANES {
                pushed[i][l] += draws.wind[k][i][l];
            }
        }
        let mut next = plant.predictor.forward(&mut t.memory, &now, &before, &pushed);
        for l in 0..LANES {
            let (dx, dy) = (next[0][l] - now[0][l], next[1][l] - now[1][l]);
            t.raw[k][0][l] = dx;
            t.raw[k][1][l] = dy;
            if plant.limits != RolloutLimits::Plain {
                let length = (dx * dx + dy * dy).sqrt();
                let factor = if length > reach { reach / length } else { 1.0 };
                next[0][l] = now[0][l] + factor * dx;
                next[1][l] = now[1][l] + factor * dy;
            }
            if plant.limits == RolloutLimits::Walls {
                for i in 0..2 {
                    next[i][l] = next[i][l].max(plant.corners[0][i]).min(plant.corners[1][i]);
                }
            }
            let (gx, gy) = (next[0][l] - plant.goal[0], next[1][l] - plant.goal[1]);
            let effort = t.a[k][0][l] * t.a[k][0][l] + t.a[k][1][l] * t.a[k][1][l];
            t.cost[l] += goal_weight * (gx * gx + gy * gy) + motion_weight * effort + power_cost;
        }
        t.y[k + 2] = next;
    }
    score(plant, objective, power, &mut t);
    t
}

/// Weight of |y - y_g|² after an interval, the last of `left` of a rollout.
#[inline(always)]
fn goal_weight(plant: &Plant, objective: &Objective, left: usize) -> f32 {
    let cost = &objective.cost;
    let settle = if left as u64 <= cost.settle_intervals { cost.settle } else { 0.0 };
    ((cost.goal + settle) / f64::from(plant.scale).powi(2)) as f32
}

/// The nearest side of the field's edge: logit of its risk, the axis, and the logit's slope along it.
#[inline(always)]
fn edge_logit(plant: &Plant, edge: &Edge, y: [f32; 2]) -> (f32, usize, f32) {
    let mut nearest = (f32::NEG_INFINITY, 0, 0.0);
    for (axis, y) in y.into_iter().enumerate() {
        for (distance, slope) in [(y - plant.corners[0][axis], -1.0), (plant.corners[1][axis] - y, 1.0)] {
            let logit = (edge.margin - distance) / edge.softness;
            if logit > nearest.0 {
                nearest = (logit, axis, slope / edge.softness);
            }
        }
    }
    nearest
}

/// y_u of an obstacle at -1, 0, ... H: straight as its linear predictor has it, reflected where walls
/// and margin end.
#[inline(always)]
fn drift(
    plant: &Plant,
    area: Option<&Area>,
    [now, before]: [[Lane; 2]; 2],
    horizon: usize,
) -> Vec<[Lane; 2]> {
    let mut u = vec![[ZERO; 2]; horizon + 2];
    (u[0], u[1]) = (before, now);
    let (mut straight, mut straight_before) = (now, before);
    for seen in &mut u[2..] {
        let mut next = plant.uncontrollable.forward_coasting(&straight, &straight_before);
        (straight, straight_before) = (next, straight);
        if let (RolloutLimits::Walls, Some(area)) = (plant.limits, area) {
            area.reflect(&mut next);
        }
        *seen = next;
    }
    u
}

/// `[y_c, y_u]` of one obstacle.
#[inline(always)]
fn pair(y: &[Lane; 2], u: &[Lane; 2]) -> [Lane; 4] {
    [y[0], y[1], u[0], u[1]]
}

/// Risk at k+1 and channel at k for all k, and the two scores of each rollout.
#[inline(always)]
fn score(plant: &Plant, objective: &Objective, power: f32, t: &mut RolloutTrace) {
    let horizon = t.a.len();
    let (alpha, beta) = (objective.alpha as f32, objective.beta as f32);
    let connected = power / objective.snr_min as f32;
    let mut riskiest = [0.0f32; LANES];
    for k in 0..horizon {
        let (after, now) = (k + 2, k + 1);
        let mut log_gain = [f32::INFINITY; LANES];
        for u in &t.u {
            let logit = plant.collision.value(&pair(&t.y[after], &u[after]));
            let other = plant.gain.value(&pair(&t.y[now], &u[now]));
            for l in 0..LANES {
                // From 0 on, so that one obstacle's p stays as it is to the last bit.
                let p = kernel::sigmoid(logit[l]);
                t.risk[k][l] = p.mul_add(1.0 - t.risk[k][l], t.risk[k][l]);
                log_gain[l] = log_gain[l].min(other[l]);
            }
        }
        if let Some(edge) = &plant.edge {
            for l in 0..LANES {
                let p = kernel::sigmoid(edge_logit(plant, edge, [t.y[after][0][l], t.y[after][1][l]]).0);
                t.risk[k][l] = p.mul_add(1.0 - t.risk[k][l], t.risk[k][l]);
            }
        }
        for l in 0..LANES {
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
/// through the policy: `[Lane; 2]` each.
#[inline(always)]
fn outer_slopes(plant: &Plant, objective: &Objective, share: &Share, t: &RolloutTrace) -> Vec<[Lane; 2]> {
    let horizon = t.a.len();
    let mut g = vec![[ZERO; 2]; horizon + 1];
    for k in 0..horizon {
        let after = k + 2;
        let goal = 2.0 * share.each * goal_weight(plant, objective, horizon - k + t.beyond);
        for i in 0..2 {
            for l in 0..LANES {
                g[k + 1][i][l] += goal * (t.y[after][i][l] - plant.goal[i]);
            }
        }
        // s_safe = softmin(1 - p): ds/dp_k = -weight_k, and p = 1 - Π_i (1 - p_i), p_i = sigmoid(logit_i):
        // dp/dlogit_i = p_i (1 - p).
        let mut through = ZERO;
        for u in &t.u {
            let alone = t.u.len() == 1 && plant.edge.is_none();
            let own = if alone { t.risk[k] } else { risk(plant, &t.y[after], &u[after]) };
            for l in 0..LANES {
                through[l] = -share.d_safe * t.weight[k][l] * own[l] * (1.0 - t.risk[k][l]);
            }
            if through.iter().any(|v| v.abs() > NEGLIGIBLE * share.each) {
                let d = plant.collision.gradient(&pair(&t.y[after], &u[after]));
                for i in 0..2 {
                    for l in 0..LANES {
                        g[k + 1][i][l] += through[l] * d[i][l];
                    }
                }
            }
        }
        if let Some(edge) = &plant.edge {
            for l in 0..LANES {
                let (logit, axis, slope) = edge_logit(plant, edge, [t.y[after][0][l], t.y[after][1][l]]);
                let own = kernel::sigmoid(logit);
                g[k + 1][axis][l] -= share.d_safe * t.weight[k][l] * own * (1.0 - t.risk[k][l]) * slope;
            }
        }
        // s_comm = mean(1 - p_out): dp_out/dlog g = -α ratio p_out (1 - p_out).
        let per_step = share.d_comm * objective.alpha as f32 / horizon as f32;
        for l in 0..LANES {
            through[l] = per_step * t.ratio[k][l] * t.outage[k][l] * (1.0 - t.outage[k][l]);
        }
        if through.iter().any(|v| v.abs() > NEGLIGIBLE * share.each) {
            let now = k + 1;
            let d = gain_slope(plant, &t.y[now], &t.u, now);
            for i in 0..2 {
                for l in 0..LANES {
                    g[k][i][l] += through[l] * d[i][l];
                }
            }
        }
    }
    g
}

/// Collision probability beside one obstacle.
#[inline(always)]
fn risk(plant: &Plant, y: &[Lane; 2], u: &[Lane; 2]) -> Lane {
    let mut p = plant.collision.value(&pair(y, u));
    for v in &mut p {
        *v = kernel::sigmoid(*v);
    }
    p
}

/// Gradient of the log gain at index `now` with respect to y_c: that of the obstacle that blocks more.
#[inline(always)]
fn gain_slope(plant: &Plant, y: &[Lane; 2], u: &[Vec<[Lane; 2]>], now: usize) -> [Lane; 2] {
    if let [u] = u {
        return plant.gain.gradient(&pair(y, &u[now]));
    }
    let (mut slope, mut least) = ([ZERO; 2], [f32::INFINITY; LANES]);
    for u in u {
        let both = pair(y, &u[now]);
        let (gain, own) = (plant.gain.value(&both), plant.gain.gradient(&both));
        for l in 0..LANES {
            if gain[l] < least[l] {
                (least[l], slope[0][l], slope[1][l]) = (gain[l], own[0][l], own[1][l]);
            }
        }
    }
    slope
}

#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
pub(super) fn backward(
    plant: &Plant,
    objective: &Objective,
    share: &Share,
    motion: &Mlp,
    t: &mut RolloutTrace,
) -> Mlp {
    let horizon = t.a.len();
    let slopes = outer_slopes(plant, objective, share, t);
    let back = Back::new(motion);
    let (place, speed) = (2.0 / plant.scale, 1.0 / (plant.scale * plant.v_max));
    let effort = 2.0 * share.each * objective.cost.motion as f32;
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
            if plant.limits == RolloutLimits::Walls {
                for i in 0..2 {
                    let y = t.y[k + 2][i][l];
                    let at_wall = y <= plant.corners[0][i] || y >= plant.corners[1][i];
                    newer[i][l] = if at_wall { 0.0 } else { newer[i][l] };
                }
            }
            if plant.limits != RolloutLimits::Plain {
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
        // Slopes in y_k, y_{k-1} and the action.
        let (mut here, mut past, mut da) = (older, [ZERO; 2], [ZERO; 2]);
        plant.predictor.backward(&mut t.memory, &newer, [&mut here, &mut past, &mut da]);
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

/// What stage 2 learns from: the policies' inputs and γ/γ_min at a_p = 1 along executed rollouts,
/// one entry an interval.
pub(crate) fn samples(
    plant: &Plant,
    objective: &Objective,
    motion: &Mlp,
    draws: &Draws,
) -> Vec<([Lane; FEATURES], Lane)> {
    let options = RolloutOptions { eta: None, power: 1.0, execution: Execution::Nearest };
    let t = forward(plant, objective, options, motion, draws);
    let inputs = t.x.chunks_exact(FEATURES).map(|x| std::array::from_fn(|i| x[i]));
    inputs.zip(t.ratio).collect()
}

#[cfg(test)]
mod tests;
