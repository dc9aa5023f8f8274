//! Algorithm 1's stage 1 in flight: every few intervals a few iterations on rollouts that begin at the
//! present belief, from the policy that flew so far.
//!
//! The budget is counted in iterations, so equal beliefs give equal policies on every machine.

use crpl_sitl::units::Motion;
use crpl_sitl::world::noise::Noise;
use serde::{Deserialize, Serialize};

use crate::numeric::adam::Adam;
use crate::numeric::mlp::Mlp;
use crate::planning::lookahead::{Lookahead, LookaheadConfig};
use crate::planning::objective::{self, Draws, Execution, Objective, Setting};
use crate::planning::problem::{Here, Stage};

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
    /// What is tried at every interval beside π_s.
    pub lookahead: LookaheadConfig,
}

impl Default for RecedingConfig {
    fn default() -> Self {
        Self {
            every: 4,
            iterations: 10,
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
    stage: Stage,
    objective: Objective,
    config: RecedingConfig,
    lookahead: Lookahead,
    noise: Noise,
    motion: Mlp,
}

impl Receding {
    /// Starts from `motion`, which was optimised for `stage`.
    #[must_use]
    pub fn new(stage: Stage, objective: Objective, config: RecedingConfig, motion: Mlp) -> Self {
        let lookahead = Lookahead::new(config.lookahead.clone(), &objective);
        Self { stage, objective, config, lookahead, noise: Noise::new(0), motion }
    }

    /// The policy as it is.
    #[must_use]
    pub fn motion(&self) -> &Mlp {
        &self.motion
    }

    /// y_u that the policy is told: the obstacle's place in its training.
    #[must_use]
    pub fn told(&self) -> [f32; 2] {
        self.stage.obstacle
    }

    /// The motion that beats π_s from `here` on, if one of the openings does; `remaining` intervals
    /// before the end.
    #[must_use]
    pub fn better(&self, here: &Here, remaining: usize) -> Option<Motion> {
        let ahead = remaining.max(self.config.least_horizon);
        self.lookahead.best(&self.stage, &self.motion, here, ahead)
    }

    /// Re-optimises at every [`RecedingConfig::every`]th tick, `remaining` intervals before the end.
    /// The new policy is kept if it is better on rollouts that it was not made from.
    pub fn at(&mut self, tick: u64, here: &Here, remaining: usize) {
        let c = &self.config;
        if !tick.is_multiple_of(c.every.max(1)) || c.iterations == 0 {
            return;
        }
        let horizon = remaining.max(c.least_horizon);
        let setting = Setting { eta: Some(c.eta), power: 4.0, execution: Execution::Nearest };
        let draws = |n: u64| -> Vec<Draws> {
            self.stage.draws_from(here, &self.noise, (tick << 8) | n, c.rollouts, horizon)
        };
        let mut next = self.motion.clone();
        let mut adam = Adam::new(&next, c.learning_rate, c.gradient_clip);
        for i in 0..c.iterations as u64 {
            let (_, grad) =
                objective::gradient(&self.stage.plant, &self.objective, setting, &next, &draws(i + 1));
            adam.descend(&mut next, &grad);
        }
        let common = draws(0);
        let j =
            |net: &Mlp| objective::evaluate(&self.stage.plant, &self.objective, setting, net, &common).0.j;
        if j(&next) < j(&self.motion) {
            self.motion = next;
        }
    }
}
