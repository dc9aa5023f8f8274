//! Algorithm 1's problem 1 in flight: every few intervals a few iterations on rollouts that begin at the
//! present belief, from the policy that flew so far.
//!
//! The budget is counted in iterations, so equal beliefs give equal policies on every machine.

use crpl_sitl::units::Motion;
use crpl_sitl::world::noise::Noise;
use serde::{Deserialize, Serialize};

use crate::numeric::adam::{Adam, Betas};
use crate::numeric::mlp::Mlp;
use crate::planning::lookahead::{Lookahead, LookaheadConfig};
use crate::planning::objective;
use crate::planning::plant::{Draws, Execution, Objective, RolloutOptions};
use crate::planning::problem::{PlanningProblem, PlanningState};

/// The budget. `Default` as argued in docs/choices.md.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecedingConfig {
    /// Intervals from one re-optimisation to the next.
    pub every: u64,
    /// Iterations of each.
    pub iterations: usize,
    /// K, a multiple of 32.
    pub rollouts: usize,
    /// λ of Adam.
    pub learning_rate: f32,
    /// Largest global gradient norm.
    pub gradient_clip: f32,
    /// η, the barrier's inverse weight.
    pub eta: f64,
    /// Intervals that a rollout looks ahead at least, near the end of the flight too.
    pub least_horizon: usize,
    /// The openings that are tried at every interval.
    pub lookahead: LookaheadConfig,
}

impl Default for RecedingConfig {
    fn default() -> Self {
        Self {
            every: 4,
            iterations: 0,
            rollouts: 64,
            learning_rate: 1e-3,
            gradient_clip: 1.0,
            eta: 64.0,
            least_horizon: 20,
            lookahead: LookaheadConfig::default(),
        }
    }
}

/// π_s under way.
#[derive(Debug, Clone)]
pub struct Receding {
    problem: PlanningProblem,
    objective: Objective,
    config: RecedingConfig,
    lookahead: Lookahead,
    noise: Noise,
    motion: Mlp,
}

impl Receding {
    /// Starts from `motion`, which was optimised for `problem`.
    #[must_use]
    pub fn new(problem: PlanningProblem, objective: Objective, config: RecedingConfig, motion: Mlp) -> Self {
        let lookahead = Lookahead::new(config.lookahead.clone(), &objective);
        Self { problem, objective, config, lookahead, noise: Noise::new(0), motion }
    }

    /// The policy as it is.
    #[must_use]
    pub fn motion(&self) -> &Mlp {
        &self.motion
    }

    /// y_u that the policy reads: the obstacle's place in its training.
    #[must_use]
    pub fn reported_obstacle(&self) -> [f32; 2] {
        self.problem.obstacle
    }

    /// The motion that beats π_s from `state` on, if one of the openings does; `remaining` intervals
    /// before the end.
    #[must_use]
    pub fn better(&self, state: &PlanningState, remaining: usize) -> Option<Motion> {
        let ahead = remaining.max(self.config.least_horizon);
        self.lookahead.best(&self.problem, &self.motion, state, ahead)
    }

    /// Re-optimises at every [`RecedingConfig::every`]th tick, `remaining` intervals before the end.
    /// The new policy is kept if it is better on rollouts that it was not made from.
    pub fn at(&mut self, tick: u64, state: &PlanningState, remaining: usize) {
        let c = &self.config;
        if !tick.is_multiple_of(c.every.max(1)) || c.iterations == 0 {
            return;
        }
        let horizon = remaining.max(c.least_horizon);
        let options = RolloutOptions { eta: Some(c.eta), power: 4.0, execution: Execution::Nearest };
        let draws = |n: u64| -> Vec<Draws> {
            self.problem.draws_from(state, &self.noise, (tick << 8) | n, c.rollouts, horizon)
        };
        let mut next = self.motion.clone();
        let mut adam = Adam::of(&next, Betas::SLOW);
        for i in 0..c.iterations as u64 {
            let (_, grad) =
                objective::gradient(&self.problem.plant, &self.objective, options, &next, &draws(i + 1));
            adam.descend(&mut next, &grad, c.gradient_clip, c.learning_rate);
        }
        let common = draws(0);
        let j =
            |net: &Mlp| objective::evaluate(&self.problem.plant, &self.objective, options, net, &common).0.j;
        if j(&next) < j(&self.motion) {
            self.motion = next;
        }
    }
}
