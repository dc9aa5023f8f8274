//! `apc-paper`, the simplest analytical predictive controller: it knows the equations and looks ahead in them at
//! every interval, with obstacles that stand still and without gusts. No bound: [`super::apc`] is the oracle.
//!
//! Beam search over motions that are held a few intervals each, without disturbance; both sides of
//! the first obstacle survive the pruning (all of it our choice; docs/choices.md).

use crpl_sitl::Scenario;
use crpl_sitl::units::{Motion, TxPower};
use crpl_sitl::world::channel::{self, sigmoid};
use crpl_sitl::world::dynamics::{self, State};
use crpl_sitl::world::obstacles::Obstacles;
use nalgebra::Vector2;

use super::reactive::Present;

/// Intervals that a motion is held in the search.
const HOLD: usize = 4;
/// Motions in a row.
const DEPTH: usize = 7;
/// Nodes that survive on each side of the first obstacle.
const SIDE: usize = 12;
/// Low power is enough where it reaches this times γ_min.
const HEADROOM: f64 = 1.05;
/// Intervals that the power looks ahead.
const POWER_STEPS: usize = 2;

/// Where a sequence of motions leads.
#[derive(Clone, Copy)]
struct Node {
    state: State,
    cost: f64,
    rank: f64,
    first: Motion,
}

/// The beam search, with the equations, which are the scenario.
#[derive(Debug, Clone)]
pub struct ApcPaper {
    scenario: Scenario,
}

impl ApcPaper {
    /// The search in `scenario`.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        Self { scenario: scenario.clone() }
    }

    /// Motion and power for the interval that begins.
    #[must_use]
    pub fn decide(&self, now: &Present) -> (Motion, TxPower) {
        let motion = search(now, &self.scenario);
        (motion, power(now, motion, &self.scenario))
    }
}

fn search(now: &Present, scenario: &Scenario) -> Motion {
    let root = Node { state: State { r: now.r, v: now.v }, cost: 0.0, rank: 0.0, first: Motion::Coast };
    let mut nodes = vec![root];
    for depth in 0..DEPTH {
        nodes = nodes
            .iter()
            .flat_map(|node| {
                Motion::ALL.map(|motion| hold(node, motion, depth == 0, &now.obstacles, scenario))
            })
            .collect();
        // Stable, so ties go to the earlier node.
        nodes.sort_by(|a, b| a.rank.total_cmp(&b.rank));
        if nodes.len() > 2 * SIDE {
            let mut kept = [0; 2];
            nodes.retain(|node| {
                let side = usize::from(now.obstacles.first().is_some_and(|o| node.state.r.y > o.y));
                kept[side] += 1;
                kept[side] <= SIDE
            });
        }
    }
    nodes.first().map_or(Motion::Coast, |best| best.first)
}

/// The node after `motion` has been held.
fn hold(node: &Node, motion: Motion, is_first: bool, obstacles: &Obstacles, scenario: &Scenario) -> Node {
    let a = motion.vector();
    let (mut state, mut cost) = (node.state, node.cost);
    for _ in 0..HOLD {
        state = dynamics::step(state, a, Vector2::zeros(), &scenario.dynamics);
        cost += stage_cost(state.r, a, obstacles, scenario);
    }
    let ahead = state.r + 6.0 * state.v - scenario.goal;
    let rank = cost + 12.0 * scenario.cost.goal * ahead.norm_squared();
    Node { state, cost, rank, first: if is_first { motion } else { node.first } }
}

/// λ_g |r - r_g|² + λ_s |a|² + λ_p a_p² + σ(5 (1 - 4 γ/γ_min))/(H δ2) + 5 max(0, p_coll - 0.8 δ1), with
/// γ at a_p = 1 and the smallest power that suffices.
fn stage_cost(r: Vector2<f64>, a: Vector2<f64>, obstacles: &Obstacles, scenario: &Scenario) -> f64 {
    let (limits, snr_min) = (&scenario.safety, scenario.channel.snr_min);
    let snr = snr_at_low(r, obstacles, scenario);
    let power = if snr >= HEADROOM * snr_min { TxPower::Low } else { TxPower::High };
    let outage = sigmoid(5.0 * (1.0 - 4.0 * snr / snr_min));
    let risk = obstacles.collision_probability(r, scenario);
    scenario.stage_cost(r, a, power)
        + outage / (scenario.horizon as f64 * limits.outage_tolerance)
        + 5.0 * (risk - 0.8 * limits.collision_tolerance).max(0.0)
}

fn snr_at_low(r: Vector2<f64>, obstacles: &Obstacles, scenario: &Scenario) -> f64 {
    channel::snr(obstacles.gain(r, scenario), TxPower::Low.level(), &scenario.channel).0
}

/// Low if it reaches γ_min with headroom now and in the next intervals of the chosen motion.
fn power(now: &Present, motion: Motion, scenario: &Scenario) -> TxPower {
    let mut state = State { r: now.r, v: now.v };
    let mut least = snr_at_low(state.r, &now.obstacles, scenario);
    for _ in 0..POWER_STEPS {
        state = dynamics::step(state, motion.vector(), Vector2::zeros(), &scenario.dynamics);
        least = least.min(snr_at_low(state.r, &now.obstacles, scenario));
    }
    if least >= HEADROOM * scenario.channel.snr_min { TxPower::Low } else { TxPower::High }
}
