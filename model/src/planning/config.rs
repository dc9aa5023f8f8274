//! Every number of Algorithm 1, and why it could not start.

use serde::{Deserialize, Serialize};

use crate::numeric::kernel::LANES;
use crate::numeric::tensors::TensorError;
use crate::planning::plant::{Objective, RolloutLimits};

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
    /// Learning rate of Adam in stage 1 (λ in Algorithm 1).
    pub learning_rate: f32,
    /// Largest norm of the whole gradient in stage 1; a longer one is scaled down to it.
    pub gradient_clip: f32,
    /// Least standard deviation of the gusts in training rollouts, per axis, units per interval.
    pub gust_std: f64,
    /// Each rollout has gusts of its own strength, from this share of the full one up to it.
    pub gust_least: f64,
    /// Gusts in training rollouts over those of the scenario, at least.
    pub gust_factor: f64,
    /// Softness of the edge's risk in rollouts, units.
    pub edge_softness: f64,
    /// Factor on the SNR that a packet needs: what the channel head may be wrong by.
    pub snr_headroom: f64,
    /// Standard deviations, per axis: of the start position, units, and of the start velocity, units per interval.
    pub start_spread: [f64; 2],
    /// Starts that are rendered and encoded, as two frames one interval apart.
    pub starts: usize,
    /// Iterations of the warm start: without obstacle, at each displacement, at the true place.
    pub warm_iterations: [usize; 3],
    /// Displacements of the obstacle in the warm start, along the normal of the line from start to goal, units,
    /// largest first.
    pub displacements: Vec<f64>,
    /// Iterations of stage 1 at each η but the last.
    pub stage1_iterations: usize,
    /// Iterations of stage 1 at the last η, all of which are made: J hardly changes there while the policy learns
    /// to stop at the goal.
    pub last_iterations: usize,
    /// Iterations of a window: a candidate and each η end with the mean weights of their last window, because
    /// the last iterate alone carries the noise of one batch, and windows are compared to end a phase.
    pub averaged_iterations: usize,
    /// A phase ends when a window's mean J is lower than that of the window before by less than this share of
    /// it, or by less than the standard error of the difference. The numbers of iterations are caps. At 0 all
    /// iterations are made.
    pub tolerance: f64,
    /// μ, factor from one η to the next, above 1 (Algorithm 1, line 15).
    pub barrier_growth: f64,
    /// ε_0: stage 1 ends when 1/η falls below it (Algorithm 1, line 16).
    pub barrier_end: f64,
    /// Most rollouts on which the two candidates are compared; fewer where the difference is four standard
    /// errors.
    pub comparison_rollouts: usize,
    /// Stored rollouts of stage 2.
    pub stage2_rollouts: usize,
    /// Iterations of stage 2.
    pub stage2_iterations: usize,
    /// α of the smooth outage in stage 2. Stage 1 needs its gentle slope, along which a trajectory finds out of the
    /// shadow; in stage 2 such a slope buys power where no packet is lost.
    pub stage2_alpha: f64,
    /// Learning rate of stage 2, whose gradients do not pass through rollouts.
    pub stage2_learning_rate: f32,
    /// Closed-loop flights on which the finished pair is checked before it is kept.
    pub check_flights: usize,
    /// Standard deviation of the gusts in those flights if the scenario has none, per axis, units per interval.
    pub check_gust_std: f64,
    /// Share of those flights that must end in the goal region.
    pub check_reached: f64,
    /// Attempts, each with tighter constraints than the one before, until a pair passes the check.
    pub attempts: usize,
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
            gust_std: 0.0027,
            gust_least: 1.0,
            gust_factor: 1.8,
            edge_softness: 0.006,
            snr_headroom: 1.08,
            start_spread: [0.03, 0.01],
            starts: 2048,
            warm_iterations: [100, 60, 200],
            displacements: vec![0.2, 0.1],
            stage1_iterations: 100,
            last_iterations: 600,
            averaged_iterations: 50,
            tolerance: 2e-3,
            barrier_growth: 2.0,
            barrier_end: 1e-3,
            comparison_rollouts: 65_536,
            stage2_rollouts: 512,
            stage2_iterations: 600,
            stage2_alpha: 30.0,
            stage2_learning_rate: 5e-3,
            check_flights: 1000,
            check_gust_std: 0.0015,
            check_reached: 0.95,
            attempts: 4,
        }
    }
}

/// Why Algorithm 1 could not start.
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
    /// The learned heads were not trained for the scenario.
    #[error("{0}")]
    Untrained(String),
    /// The world model has no fingerprint.
    #[error(transparent)]
    World(#[from] TensorError),
    /// Saved progress could not be used.
    #[error("{0}")]
    Progress(String),
}

/// Which attempt at a scenario this is, and what the ones before it have shown to be too loose.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Attempt {
    /// From 0.
    pub number: usize,
    /// How often δ1 has been halved.
    pub safety: i32,
    /// How often δ2 has been halved and 15 % more SNR asked for.
    pub outage: i32,
    /// How often the policies have begun from other random weights.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub fresh: u64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn is_zero(n: &u64) -> bool {
    *n == 0
}

impl Attempt {
    /// The next one, after a check that P_safe and P_comm did or did not pass; where both did, the goal was missed,
    /// and both are tightened.
    #[must_use]
    pub fn next(self, safe: bool, connected: bool) -> Self {
        let neither = safe && connected;
        Self {
            number: self.number + 1,
            safety: self.safety + i32::from(!safe || neither),
            outage: self.outage + i32::from(!connected || neither),
            ..self
        }
    }

    /// The next one from other random weights, with the tolerances of this one: where a probability is as low as
    /// here, the descent has not found a way at all, and no tolerance mends that.
    #[must_use]
    pub fn afresh(self) -> Self {
        Self { number: self.number + 1, fresh: self.fresh + 1, ..self }
    }

    /// The seed of this attempt's weights and rollouts.
    #[must_use]
    pub fn seed(self, seed: u64) -> u64 {
        seed ^ (self.fresh << 48)
    }
}

/// A measured probability below this is no matter of a tolerance.
pub const HOPELESS: f64 = 0.8;

impl OptimiseConfig {
    /// The config of an attempt.
    #[must_use]
    pub fn attempt(&self, attempt: Attempt) -> Self {
        let mut config = self.clone();
        config.objective.collision_tolerance *= 0.5_f64.powi(attempt.safety);
        config.objective.outage_tolerance *= 0.5_f64.powi(attempt.outage);
        config.snr_headroom *= 1.15_f64.powi(attempt.outage);
        config
    }

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
            ("stage2_learning_rate", f64::from(self.stage2_learning_rate)),
            ("stage2_alpha", self.stage2_alpha),
            ("gradient_clip", f64::from(self.gradient_clip)),
            ("barrier_growth - 1", self.barrier_growth - 1.0),
            ("barrier_end", self.barrier_end),
            ("objective.snr_min", self.objective.snr_min),
            ("check_flights", self.check_flights as f64),
            ("check_gust_std", self.check_gust_std),
            ("snr_headroom", self.snr_headroom),
            ("edge_softness", self.edge_softness),
            ("gust_factor", self.gust_factor),
            ("attempts", self.attempts as f64),
            ("averaged_iterations", self.averaged_iterations as f64),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(OptimiseError::Range { key, value, must: "must be above 0" });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_attempt_tightens_what_did_not_pass_and_both_where_the_goal_was_missed() {
        let now = Attempt { number: 3, safety: 2, outage: 5, fresh: 0 };
        let next = |safety, outage| Attempt { number: 4, safety, outage, fresh: 0 };
        assert_eq!(now.next(false, true), next(3, 5));
        assert_eq!(now.next(true, false), next(2, 6));
        assert_eq!(now.next(false, false), next(3, 6));
        assert_eq!(now.next(true, true), next(3, 6));
    }

    #[test]
    fn an_attempt_halves_its_tolerances_and_asks_for_more_snr() {
        let objective =
            Objective { collision_tolerance: 0.08, outage_tolerance: 0.4, ..Objective::default() };
        let config = OptimiseConfig { objective, snr_headroom: 2.0, ..OptimiseConfig::default() };
        let tight = config.attempt(Attempt { number: 4, safety: 3, outage: 2, fresh: 0 });
        let of = &tight.objective;
        for (is, must) in
            [(of.collision_tolerance, 0.01), (of.outage_tolerance, 0.1), (tight.snr_headroom, 2.645)]
        {
            assert!((is - must).abs() < 1e-12, "{is}, {must}");
        }
    }

    #[test]
    fn a_number_that_is_zero_infinite_or_no_multiple_is_named() {
        OptimiseConfig::default().check().unwrap();
        let refused = |change: fn(&mut OptimiseConfig)| {
            let mut config = OptimiseConfig::default();
            change(&mut config);
            config.check().unwrap_err().to_string()
        };
        assert_eq!(refused(|c| c.horizon = 0), "horizon = 0: must be above 0");
        assert_eq!(refused(|c| c.stage2_alpha = f64::INFINITY), "stage2_alpha = inf: must be above 0");
        assert_eq!(refused(|c| c.barrier_growth = 1.0), "barrier_growth - 1 = 0: must be above 0");
        assert_eq!(refused(|c| c.rollouts = 0), "rollouts = 0: must be a positive multiple of 32");
        assert_eq!(refused(|c| c.rollouts = 48), "rollouts = 48: must be a positive multiple of 32");
    }

    #[test]
    fn a_fresh_attempt_has_other_weights_and_the_same_tolerances() {
        let first = Attempt { number: 2, safety: 1, outage: 3, fresh: 0 };
        let fresh = first.afresh();
        assert_eq!(fresh, Attempt { number: 3, safety: 1, outage: 3, fresh: 1 });
        assert_eq!(first.seed(7), 7);
        assert_eq!(fresh.seed(7), 7 + (1 << 48));
        assert_eq!(fresh.afresh().seed(7), 7 + (2 << 48));
        // Of a seed that has that bit it is taken away: no two attempts are equal.
        assert_eq!(fresh.seed(7 + (1 << 48)), 7);
        // An attempt that never began afresh is written as before there was such a number.
        assert!(!toml::to_string(&first).unwrap().contains("fresh"));
        assert!(toml::to_string(&fresh).unwrap().contains("fresh = 1"));
    }
}
