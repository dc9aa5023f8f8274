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

#[cfg(test)]
mod tests {
    use crpl_sitl::Scenario;
    use nalgebra::Vector2;

    use super::*;
    use crate::encoder::BuiltIn;
    use crate::planning::config::OptimiseConfig;
    use crate::planning::policy::Policies;
    use crate::world_model::WorldModel;

    /// From an untrained policy, which coasts for ever.
    fn receding(config: RecedingConfig) -> (Receding, PlanningState) {
        let (world, scenario) = (WorldModel::built_in(BuiltIn::Centroid).unwrap(), Scenario::default());
        let optimise = OptimiseConfig { starts: 1, ..OptimiseConfig::default() };
        let problem = PlanningProblem::of(&world, &scenario, &optimise, 0).unwrap();
        let motion =
            Policies::untrained(&mut Noise::new(0).generator(crpl_sitl::world::noise::Stream::Weights, 0))
                .motion;
        let objective = problem.objective(&optimise.objective, 1.0);
        let (y_c, y_u) = world.latents_at(Vector2::new(0.3, 0.3), scenario.obstacle().position);
        let state = PlanningState { y_c: [y_c; 2], y_u: std::iter::once([y_u; 2]).collect() };
        (Receding::new(problem, objective, config, motion), state)
    }

    #[test]
    fn it_goes_on_at_every_fourth_tick_and_keeps_what_is_better() {
        let config =
            RecedingConfig { iterations: 6, rollouts: 32, learning_rate: 1e-2, ..RecedingConfig::default() };
        let (mut receding, state) = receding(config.clone());
        let before = receding.motion().clone();
        for tick in [1, 2, 3, 5] {
            receding.at(tick, &state, 40);
            assert_eq!(receding.motion(), &before, "tick {tick}");
        }
        receding.at(4, &state, 40);
        assert_ne!(receding.motion(), &before);
        let options = RolloutOptions { eta: Some(config.eta), power: 4.0, execution: Execution::Nearest };
        let draws = receding.problem.draws_from(&state, &Noise::new(77), 0, 256, 40);
        let j = |net: &Mlp| {
            objective::evaluate(&receding.problem.plant, &receding.objective, options, net, &draws).0.j
        };
        assert!(j(receding.motion()) < j(&before));
        // Equal beliefs at equal ticks give equal policies; at another tick the gusts are others.
        let after = |tick| {
            let (mut other, state) = self::receding(config.clone());
            other.at(tick, &state, 40);
            other.motion
        };
        assert_eq!(&after(4), receding.motion());
        assert_ne!(&after(8), receding.motion());
    }

    #[test]
    fn a_step_that_is_too_large_is_not_kept() {
        let config =
            RecedingConfig { iterations: 1, rollouts: 32, learning_rate: 1e3, ..RecedingConfig::default() };
        let (mut receding, state) = receding(config);
        let before = receding.motion().clone();
        receding.at(0, &state, 40);
        assert_eq!(receding.motion(), &before);
    }

    #[test]
    fn no_iterations_leave_the_policy_alone_and_an_opening_may_beat_it() {
        let (mut receding, state) = receding(RecedingConfig::default());
        let before = receding.motion().clone();
        receding.at(0, &state, 40);
        assert_eq!(receding.motion(), &before);
        assert_eq!(receding.reported_obstacle(), receding.problem.obstacle);
        // To the goal at (0.9, 0.5) one must move at all, and so near the end too.
        assert!([60, 1].map(|remaining| receding.better(&state, remaining)).iter().all(Option::is_some));
    }
}
