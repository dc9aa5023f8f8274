//! A search beside π_s: rollouts that open with a few held motions before π_s continues, scored one by one
//! by Algorithm 1's objective, and the first motion of the best.
//!
//! π_s is a function of place and speed, made beside obstacles where they stood; one that crosses fast
//! asks for a wait or a detour *now*. The openings lead both ways round and to a stop, and π_s alone is
//! one of them, so the choice is never worse than π_s on the rollout that it is made on. Nothing is
//! drawn at random and nothing learned in flight.

use serde::{Deserialize, Serialize};

use crate::numeric::kernel::{LANES, ZERO};
use crate::numeric::mlp::Mlp;
use crate::planning::objective;
use crate::planning::plant::{Draws, Execution, Objective, RolloutOptions};
use crate::planning::problem::{PlanningProblem, PlanningState};
use crpl_sitl::units::Motion;

/// Which openings there are, and how they are scored. `Default` as argued in docs/choices.md.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LookaheadConfig {
    /// Intervals of a rollout; 0 leaves every decision to π_s.
    pub horizon: usize,
    /// Intervals for which a single motion is held.
    pub single: Vec<usize>,
    /// Intervals for which each of two motions in a row is held.
    pub double: Vec<[usize; 2]>,
    /// η, the barrier's inverse weight.
    pub eta: f64,
    /// δ1 of a single rollout without gusts: below the scenario's, for gusts come on top.
    pub collision_tolerance: f64,
    /// α, slope of the smooth outage.
    pub alpha: f64,
    /// γ that counts as connected at full power: the paper's γ_min, unless the radio needs more.
    pub snr_min: f64,
}

impl Default for LookaheadConfig {
    fn default() -> Self {
        Self {
            horizon: 40,
            single: vec![1, 2, 4, 6, 9, 12],
            double: vec![[3, 5], [6, 6], [9, 9]],
            eta: 64.0,
            collision_tolerance: 0.03,
            alpha: 3.0,
            snr_min: 1.0,
        }
    }
}

/// The openings, ready to be tried.
#[derive(Debug, Clone)]
pub struct Lookahead {
    config: LookaheadConfig,
    objective: Objective,
    /// One motion an interval; the first is empty, π_s alone.
    openings: Vec<Vec<Motion>>,
}

impl Lookahead {
    /// Scores by `objective`, with the config's own slopes and tolerance.
    #[must_use]
    pub fn new(config: LookaheadConfig, objective: &Objective) -> Self {
        let objective = Objective {
            collision_tolerance: config.collision_tolerance,
            alpha: config.alpha,
            snr_min: config.snr_min,
            ..objective.clone()
        };
        Self { openings: openings(&config), config, objective }
    }

    /// The first motion of the best opening; `None` where π_s alone is best. `motion` is π_s,
    /// `remaining` the intervals of the flight that are left.
    #[must_use]
    pub fn best(
        &self,
        problem: &PlanningProblem,
        motion: &Mlp,
        state: &PlanningState,
        remaining: usize,
    ) -> Option<Motion> {
        let horizon = self.config.horizon.min(remaining);
        if horizon == 0 {
            return None;
        }
        let calm = Draws { beyond: remaining - horizon, ..problem.calm(state, horizon) };
        let draws: Vec<Draws> = self
            .openings
            .chunks(LANES)
            .map(|some| Draws { opening: rows(some, horizon), ..calm.clone() })
            .collect();
        let (o, eta) = (&self.objective, self.config.eta);
        let options = RolloutOptions { eta: Some(eta), power: 4.0, execution: Execution::Nearest };
        let (_, scores) = objective::evaluate(&problem.plant, o, options, motion, &draws);
        let (w, eps) = objective::barrier_weight(eta, o.barrier_residual);
        let rollouts = scores.cost.iter().zip(&scores.safe).zip(&scores.comm);
        let j = rollouts.map(|((cost, safe), comm)| cost + objective::barrier(*safe, *comm, w, eps, o));
        // Of equals the first: π_s before all others.
        let (best, _) = self.openings.iter().zip(j).min_by(|a, b| a.1.total_cmp(&b.1))?;
        best.first().copied()
    }
}

/// π_s alone, each motion held, and each after each other one.
fn openings(config: &LookaheadConfig) -> Vec<Vec<Motion>> {
    let single = config.single.iter().flat_map(|n| Motion::ALL.map(|motion| vec![motion; *n]));
    let pairs = || Motion::ALL.into_iter().flat_map(|a| Motion::ALL.map(|b| (a, b))).filter(|(a, b)| a != b);
    let double = config
        .double
        .iter()
        .flat_map(|[n, m]| pairs().map(|(a, b)| [vec![a; *n], vec![b; *m]].concat()).collect::<Vec<_>>());
    std::iter::once(Vec::new()).chain(single).chain(double).collect()
}

/// One opening a lane, as rows of intervals; lanes that are left over are π_s alone.
fn rows(some: &[Vec<Motion>], horizon: usize) -> Vec<[Option<[f32; 2]>; LANES]> {
    let longest = some.iter().map(Vec::len).max().unwrap_or(0).min(horizon);
    let at = |lane: usize, k: usize| {
        some.get(lane).and_then(|opening| opening.get(k)).map(|motion| {
            let a = motion.vector();
            [a.x as f32, a.y as f32]
        })
    };
    (0..longest).map(|k| std::array::from_fn(|lane| at(lane, k))).collect()
}

impl PlanningProblem {
    /// Rollouts that all begin at `state`, in still air.
    fn calm(&self, state: &PlanningState, horizon: usize) -> Draws {
        let lanes = |y: [f32; 2]| y.map(|v| [v; LANES]);
        Draws {
            start: state.y_c.map(lanes),
            obstacles: state.y_u.iter().map(|y_u| y_u.map(lanes)).collect(),
            reported_obstacle: Some(self.obstacle),
            wind: vec![[ZERO; 2]; horizon],
            beyond: 0,
            opening: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::{Scenario, camera};
    use nalgebra::Vector2;

    use super::*;
    use crate::encoder::BuiltIn;
    use crate::planning::config::OptimiseConfig;
    use crate::planning::policy::Policies;
    use crate::world_model::WorldModel;

    #[test]
    fn every_opening_is_there_once_and_the_policy_comes_first() {
        let all = openings(&LookaheadConfig::default());
        assert_eq!(all.len(), 1 + 6 * 5 + 3 * 20);
        assert!(all[0].is_empty());
        for (n, opening) in all.iter().enumerate() {
            assert!(!all[n + 1..].contains(opening), "{opening:?} twice");
        }
    }

    /// The UAV flies east at 0.02 an interval; an obstacle stands 0.2 ahead of it, or comes down on its way.
    #[test]
    fn it_steers_away_from_an_obstacle_that_the_policy_does_not_know() {
        let world = WorldModel::built_in(BuiltIn::Centroid).unwrap();
        let policies = Policies::shipped(BuiltIn::Centroid, 2).unwrap();
        let scenario = Scenario::default();
        let config = OptimiseConfig { starts: 1, ..OptimiseConfig::default() };
        let problem = PlanningProblem::of(&world, &scenario, &config, 0).unwrap();
        let lookahead = Lookahead::new(LookaheadConfig::default(), &config.objective);
        let see = |uav: [f64; 2], obstacle: Vector2<f64>| {
            let latent = world.encode(&camera::render(Vector2::from(uav), obstacle, &scenario));
            (world.y_c(&latent), world.y_u(&latent))
        };
        let decide = |obstacle: [f64; 2], speed: [f64; 2], second: Option<[f64; 2]>| {
            let now = Vector2::from(obstacle);
            let before = now - Vector2::from(speed);
            let there = |place: Vector2<f64>| see([0.1, 0.9], place).1;
            let state = PlanningState {
                y_c: [see([0.7, 0.5], now).0, see([0.68, 0.5], now).0],
                y_u: std::iter::once([there(now), there(before)])
                    .chain(second.map(|place| [there(Vector2::from(place)); 2]))
                    .collect(),
            };
            lookahead.best(&problem, &policies.motion, &state, 60)
        };
        let away = [0.3, 0.2];
        let free = decide(away, [0.0; 2], None);
        assert_ne!(free, Some(Motion::West), "nothing is in the way");
        for met in [
            decide([0.88, 0.5], [0.0; 2], None),
            decide([0.85, 0.6], [0.0, -0.0125], None),
            decide(away, [0.0; 2], Some([0.88, 0.5])),
        ] {
            assert!(met.is_some() && met != free, "{met:?} as if nothing were in the way");
            assert!(![Some(Motion::East), Some(Motion::Coast)].contains(&met), "{met:?} into the obstacle");
        }
    }
}
