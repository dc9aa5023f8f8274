//! Every number of Algorithm 1, and why it could not start or may not ship.

use serde::{Deserialize, Serialize};

use crate::numeric::kernel::LANES;
use crate::numeric::tensors::TensorError;
use crate::planning::plant::{Objective, ObjectiveEstimate, RolloutLimits};

/// Every number of Algorithm 1. `Default` as argued in docs/choices.md.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiseConfig {
    /// Weights and slopes of J_η, Eq. (29).
    pub objective: Objective,
    /// What the latent rollout knows beyond the learned predictor.
    pub limits: RolloutLimits,
    /// Which heads of risk and gain the latent rollout reads.
    pub heads: HeadSource,
    /// H, intervals of a rollout.
    pub horizon: usize,
    /// K, rollouts of an iteration, a multiple of 32.
    pub rollouts: usize,
    /// Learning rate of Adam in both stages (λ in Algorithm 1).
    pub learning_rate: f32,
    /// Largest norm of the whole gradient in stage 1; a longer one is scaled down to it.
    pub gradient_clip: f32,
    /// Standard deviation of the gusts in training rollouts, per axis, units per interval.
    pub kick: f64,
    /// Standard deviations, per axis: of the start position, units, and of the start velocity, units per interval.
    pub start_spread: [f64; 2],
    /// Starts that are rendered and encoded, as two frames one interval apart.
    pub starts: usize,
    /// Iterations of the warm start: without obstacle, at each displacement, at the true place.
    pub warm_iterations: [usize; 3],
    /// Displacements of the obstacle along y in the warm start, units, largest first.
    pub displacements: Vec<f64>,
    /// Iterations of stage 1 at each η.
    pub stage1_iterations: usize,
    /// Last iterations of a candidate and of each η whose weights are averaged: the last iterate alone carries
    /// the noise of one batch.
    pub averaged_iterations: usize,
    /// μ, factor from one η to the next, above 1 (Algorithm 1, line 15).
    pub barrier_growth: f64,
    /// ε_0: stage 1 ends when 1/η falls below it (Algorithm 1, line 16).
    pub barrier_end: f64,
    /// Rollouts on which the two candidates and the final policy are measured.
    pub comparison_rollouts: usize,
    /// Stored rollouts of stage 2.
    pub stage2_rollouts: usize,
    /// Iterations of stage 2.
    pub stage2_iterations: usize,
    /// Closed-loop flights on which the finished pair is checked before it is kept.
    pub check_flights: usize,
    /// Standard deviation of the gusts in those flights if the scenario has none, per axis, units per interval.
    pub check_kick: f64,
}

/// Where the heads of risk and gain come from in the latent rollout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HeadSource {
    /// The world model's own.
    Learned,
    /// The simulator's equations, to measure what learning them costs.
    Exact,
}

impl Default for OptimiseConfig {
    fn default() -> Self {
        Self {
            objective: Objective::default(),
            limits: RolloutLimits::Walls,
            heads: HeadSource::Learned,
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
    Infeasible([ObjectiveEstimate; 2]),
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
    World(#[from] TensorError),
    /// Saved progress could not be used.
    #[error("{0}")]
    Progress(String),
}

impl OptimiseConfig {
    /// Checks the numbers that the loops rely on.
    ///
    /// # Errors
    /// [`OptimiseError::Range`] with the key.
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
