//! The learned world as Algorithm 1 rolls it out; a batch of rollouts: its draws, options and scores.

use crpl_sitl::scenario::Cost;
use serde::{Deserialize, Serialize};

use crate::numeric::kernel::{LANES, Lane};
use crate::planning::area::Area;
use crate::planning::head::Head;
use crate::predictor::Predictor;
use crate::predictor::linear::PlaneLinear;

/// Weights and slopes of J_η, Eq. (29). `Default`: the values of Sec. IV-A5, else those of docs/choices.md.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Objective {
    /// Weights of the stage cost, Eq. (9), and of a terminal cost. In [`PlanningProblem::objective`](super::problem::PlanningProblem::objective)
    /// they are the scenario's.
    #[serde(skip)]
    pub cost: Cost,
    /// α, slope of the smooth outage, Eq. (26).
    pub alpha: f64,
    /// β of the soft minimum, Eq. (23).
    pub beta: f64,
    /// ε_b, weight of the barrier as η grows without bound.
    pub barrier_residual: f64,
    /// δ1, tolerated probability of a collision, Eq. (10).
    pub collision_tolerance: f64,
    /// δ2, tolerated probability of an outage, Eq. (14).
    pub outage_tolerance: f64,
    /// γ_min, SNR that counts as connected, linear. The gain head already has the noise power folded in.
    pub snr_min: f64,
}

impl Default for Objective {
    fn default() -> Self {
        Self {
            cost: Cost::default(),
            alpha: 3.0,
            beta: 500.0,
            barrier_residual: 1e-4,
            collision_tolerance: 0.05,
            outage_tolerance: 0.05,
            snr_min: 1.0,
        }
    }
}

/// What the latent rollout knows beyond the predictor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RolloutLimits {
    /// The learned predictor alone.
    Plain,
    /// And the speed limit.
    Clip,
    /// And the walls.
    Walls,
}

/// The constraint of the field's edge: a UAV at distance d of it is at risk with probability
/// sigmoid((margin - d)/softness).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Latent units.
    pub margin: f32,
    /// Latent units.
    pub softness: f32,
}

/// The learned world in plane coordinates: predictor, heads and goal.
#[derive(Debug, Clone)]
pub struct Plant {
    /// Predicts y_c. A gust enters as an action.
    pub predictor: Predictor,
    /// Predicts y_u of each obstacle.
    pub uncontrollable: PlaneLinear,
    /// S, latent units per unit of length.
    pub scale: f32,
    /// v_max, units per interval.
    pub v_max: f32,
    /// y_c of the frame's corners (0, 0) and (1, 1).
    pub corners: [[f32; 2]; 2],
    /// The field's edge as a risk; `None` where the scenario asks for no margin.
    pub edge: Option<Edge>,
    /// Where each obstacle can be, in y_u; `None`, or no entry, predicts it straight on for ever.
    pub areas: Vec<Option<Area>>,
    /// What the rollout knows of limits.
    pub limits: RolloutLimits,
    /// y_g, y_c of the goal.
    pub goal: [f32; 2],
    /// Logit of the collision probability, from `[y_c, y_u]`.
    pub collision: Head,
    /// ln(|h|²/P_n), from `[y_c, y_u]`.
    pub gain: Head,
}

/// Starts and disturbances of [`LANES`] rollouts.
#[derive(Debug, Clone)]
pub struct Draws {
    /// y_c at k = 0 and k = -1.
    pub start: [[Lane; 2]; 2],
    /// y_u of each obstacle at k = 0 and k = -1; at least one.
    pub obstacles: Vec<[[Lane; 2]; 2]>,
    /// The y_u that the policy reads, if it is not the first obstacle's own: one that was trained beside a
    /// standing obstacle has learned nothing of others.
    pub reported_obstacle: Option<[f32; 2]>,
    /// Gusts in units of a_max, one `[Lane; 2]` an interval; its length is the horizon H.
    pub wind: Vec<[Lane; 2]>,
    /// Intervals of the flight that follow the rollout's last one.
    pub beyond: usize,
    /// Motions of the first intervals that are not the policy's, one row an interval; for
    /// [`evaluate`](crate::planning::objective::evaluate) alone,
    /// [`gradient`](crate::planning::objective::gradient) takes them for the policy's own.
    pub opening: Vec<[Option<[f32; 2]>; LANES]>,
}

/// Rollout-based estimates of one batch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ObjectiveEstimate {
    /// J_η, Eq. (29).
    pub j: f64,
    /// Mean over the rollouts of Σ_k ℓ_k, Eq. (9).
    pub cost: f64,
    /// P̂_safe, Eq. (24), at most 1.
    pub p_safe: f64,
    /// P̂_comm, Eq. (28), at the given power, in 0..=1.
    pub p_comm: f64,
}

/// Scores of single rollouts: Σ ℓ_k, s_safe, s_comm.
#[derive(Debug, Clone, Default)]
pub struct Scores {
    /// Σ_k ℓ_k of each rollout.
    pub cost: Vec<f64>,
    /// s_safe of each rollout, Eq. (22).
    pub safe: Vec<f64>,
    /// s_comm of each rollout, Eq. (27).
    pub comm: Vec<f64>,
}

/// How the batch enters J: barrier weight (`None` while the obstacle is removed) and power.
#[derive(Debug, Clone, Copy)]
pub struct RolloutOptions {
    /// η, or no barrier at all.
    pub eta: Option<f64>,
    /// a_p during the rollout, 1 or 4 (stage 1: the maximum).
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
