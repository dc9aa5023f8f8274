//! APC, the analytical predictive controller: an oracle that knows the equations, the gusts' statistics and the
//! obstacles' evolution. It shows what can be had, and cannot be built in practice.
//!
//! It minimises the objective that all controllers share, J (the stage cost of Eq. (9) on true states), under the
//! chance constraints as penalties, by stochastic dynamic programming over (position, velocity, time): [`value`]
//! solves it once for a scenario, [`decide`](Apc::decide) looks one interval ahead from the exact state into the
//! value function (all of it our choice; docs/controllers.md).

pub mod lattice;
pub mod stage;
pub mod value;

use std::sync::Arc;

use crpl_sitl::Scenario;
use crpl_sitl::units::{Motion, Tick, TxPower};
use crpl_sitl::world::dynamics::{self, State};
use nalgebra::Vector2;

use super::reactive::Present;
use stage::{Constraints, Stage};
use value::{Solution, ValueConfig};

/// The oracle, with the equations, which are the scenario, and their solution.
#[derive(Debug, Clone)]
pub struct Apc {
    scenario: Arc<Scenario>,
    solution: Arc<Solution>,
}

/// Nodes and weights of the three-point Gauss-Hermite rule, in standard deviations.
const NODES: [(f64, f64); 3] =
    [(-1.732_050_807_568_877_2, 1.0 / 6.0), (0.0, 2.0 / 3.0), (1.732_050_807_568_877_2, 1.0 / 6.0)];

impl Apc {
    /// The oracle of `scenario`; solves it, seconds on one core.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        Self {
            scenario: Arc::new(scenario.clone()),
            solution: Arc::new(Solution::of(scenario, Constraints::Kept, &ValueConfig::default())),
        }
    }

    /// What was solved.
    #[must_use]
    pub fn solution(&self) -> &Solution {
        &self.solution
    }

    /// Motion and power for interval `tick`, which begins.
    #[must_use]
    pub fn decide(&self, tick: Tick, now: &Present) -> (Motion, TxPower) {
        let scenario = &self.scenario;
        let stage = Stage::new(scenario, Constraints::Kept);
        let power = stage.power(now.r, &now.obstacles);
        // The obstacles at the end of the interval, as the scenario has them move.
        let after = stage::moved(&now.obstacles, scenario, tick.0);
        let gust = scenario.disturbance.gust_std();
        let to_go = scenario.horizon.saturating_sub(tick.0 + 1);
        let state = State { r: now.r, v: now.v };
        let value = |motion: Motion| -> f64 {
            let a = motion.vector();
            let effort = scenario.cost.motion * a.norm_squared();
            let ahead = |wind: Vector2<f64>| {
                let next = dynamics::step(state, a, wind, &scenario.dynamics);
                stage.arrival(next.r, &after, to_go) + self.solution.value(to_go, next)
            };
            if gust == 0.0 {
                return effort + ahead(Vector2::zeros());
            }
            let nodes = NODES.iter().flat_map(|x| NODES.iter().map(move |y| (x, y)));
            effort + nodes.map(|(x, y)| x.1 * y.1 * ahead(gust * Vector2::new(x.0, y.0))).sum::<f64>()
        };
        let mut best = (Motion::Coast, value(Motion::Coast));
        for motion in &Motion::ALL[1..] {
            let v = value(*motion);
            if v < best.1 {
                best = (*motion, v);
            }
        }
        (best.0, power)
    }
}
