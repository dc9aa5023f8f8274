//! What one interval costs the oracle: the shared stage cost, and the constraints as penalties.

use crpl_model::planning::scope;
use crpl_sitl::Scenario;
use crpl_sitl::units::TxPower;
use crpl_sitl::world::channel;
use crpl_sitl::world::dynamics::{self, State};
use crpl_sitl::world::obstacles::Obstacles;
use nalgebra::Vector2;

/// Weight of the collision probability beyond δ1, and of the depth in the edge's margin in units of τ_c. The mean of
/// a flight's largest risk keeps δ1 with it up to the paper's largest σ_c; 0.2 breaks it there (our choice).
const RISK: f64 = 1.0;

/// Whether the chance constraints count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Constraints {
    /// As penalties.
    Kept,
    /// Not at all, and every packet arrives: what bounds every controller, those too that break a constraint.
    Ignored,
}

/// The costs of a scenario.
#[derive(Debug, Clone)]
pub struct Stage<'a> {
    scenario: &'a Scenario,
    constraints: Constraints,
    /// The SNR that counts as connected, linear.
    needed: f64,
    /// Cost of an interval without a link: 1/(H δ2), so that the tolerated share of a flight costs 1.
    outage: f64,
}

impl<'a> Stage<'a> {
    /// The costs of `scenario`.
    #[must_use]
    pub fn new(scenario: &'a Scenario, constraints: Constraints) -> Self {
        let tolerated = scenario.horizon as f64 * scenario.safety.outage_tolerance.max(1e-3);
        Self { scenario, constraints, needed: scope::required_snr(scenario), outage: 1.0 / tolerated }
    }

    /// The least power that connects a UAV at `r`; low where none does.
    #[must_use]
    pub fn power(&self, r: Vector2<f64>, obstacles: &Obstacles) -> TxPower {
        if self.connects(r, obstacles, TxPower::Low) || !self.connects(r, obstacles, TxPower::High) {
            TxPower::Low
        } else {
            TxPower::High
        }
    }

    fn connects(&self, r: Vector2<f64>, obstacles: &Obstacles, power: TxPower) -> bool {
        let gain = obstacles.gain(r, self.scenario);
        channel::snr(gain, power.level(), &self.scenario.channel).0 >= self.needed
    }

    /// What an interval costs that begins at `r`, before any motion: λ_p a_p², and the outage's penalty; whether
    /// a command gets through.
    #[must_use]
    pub fn departure(&self, r: Vector2<f64>, obstacles: &Obstacles) -> (f64, bool) {
        if self.constraints == Constraints::Ignored {
            return (self.scenario.cost.power * TxPower::Low.level().powi(2), true);
        }
        let power = self.power(r, obstacles);
        let connected = self.connects(r, obstacles, power);
        let spent = self.scenario.cost.power * power.level().powi(2);
        (spent + if connected { 0.0 } else { self.outage }, connected)
    }

    /// What it costs that an interval ends at `r`, `left` intervals before the flight's end: λ_g |r - r_g|², the
    /// terminal cost, and the penalties of risk beyond δ1 and of the edge's margin.
    #[must_use]
    pub fn arrival(&self, r: Vector2<f64>, obstacles: &Obstacles, left: u64) -> f64 {
        let s = self.scenario;
        let settle = match self.constraints {
            // The last interval's end has none left, and counts as the last of the terminal cost's.
            Constraints::Kept if left < s.cost.settle_intervals => s.cost.settle,
            _ => 0.0,
        };
        let goal = (s.cost.goal + settle) * (r - s.goal).norm_squared();
        if self.constraints == Constraints::Ignored {
            return goal;
        }
        let risk = obstacles.collision_probability(r, s) - s.safety.collision_tolerance;
        let edge = r.iter().map(|x| x.min(1.0 - x)).fold(f64::INFINITY, f64::min);
        let depth = (s.safety.edge_margin - edge) / s.safety.softness;
        goal + RISK * (risk.max(0.0) + depth.max(0.0))
    }
}

/// Where obstacles that are at `now` at the start of interval `tick` are at its end.
#[must_use]
pub fn moved(now: &Obstacles, scenario: &Scenario, tick: u64) -> Obstacles {
    let ways = scenario.obstacles.iter().map(|o| {
        // The direction that it has got by reflections so far.
        let mut state = State { r: o.position, v: o.velocity };
        if o.velocity != Vector2::zeros() {
            (0..tick).for_each(|_| state = dynamics::step_obstacle(state, o.margin));
        }
        (state.v, o.margin)
    });
    now.iter()
        .zip(ways)
        .map(|(r, (v, margin))| dynamics::step_obstacle(State { r: *r, v }, margin).r)
        .collect()
}

/// Where the scenario's obstacles are at the start of each interval from 0 to H.
#[must_use]
pub fn evolution(scenario: &Scenario) -> Vec<Obstacles> {
    let mut states: Vec<State> =
        scenario.obstacles.iter().map(|o| State { r: o.position, v: o.velocity }).collect();
    (0..=scenario.horizon)
        .map(|_| {
            let here = states.iter().map(|s| s.r).collect();
            for (state, o) in states.iter_mut().zip(&scenario.obstacles) {
                *state = dynamics::step_obstacle(*state, o.margin);
            }
            here
        })
        .collect()
}
