//! The chance constraints as flights measure them: the finished pair of policies flies the simulator
//! from rendered and encoded pictures, and the flights that keep each constraint are counted.
//!
//! Algorithm 1 itself sees latents and smooth stand-ins alone; this is where its promise meets the
//! world. Eqs. of Sec. III-B: P_safe is the share of flights that never touch the obstacle, P_comm
//! that of flights whose SNR, at the executed powers, never falls below γ_min.

use crpl_sitl::radio::message::Command;
use crpl_sitl::{Scenario, Sim};
use nalgebra::Vector2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::encoder::weights::vector;
use crate::evaluation::intervals::{Interval, wilson};
use crate::planning::objective::Objective;
use crate::planning::policy::{Policies, features};
use crate::predictor::observer::Observer;
use crate::world_model::WorldModel;

/// Flights that kept one constraint.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// Share of the flights.
    pub share: f64,
    /// Its 95 % Wilson interval.
    pub ci: Interval,
    /// 1 - δ.
    pub needed: f64,
}

impl Kept {
    fn of(kept: usize, flights: usize, tolerance: f64) -> Self {
        Self {
            share: kept as f64 / flights.max(1) as f64,
            ci: wilson(kept, flights),
            needed: 1.0 - tolerance,
        }
    }

    /// Whether even the low end of the interval keeps the promise.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.ci[0] >= self.needed
    }
}

/// Both chance constraints, measured in closed loop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Flown {
    /// Flights.
    pub flights: usize,
    /// Seed of the first one.
    pub first_seed: u64,
    /// Standard deviation of the gusts' kick, units per interval.
    pub kick: f64,
    /// No touch of the obstacle.
    pub safe: Kept,
    /// No SNR below γ_min.
    pub comm: Kept,
    /// Mean terminal distance to the goal, units.
    pub d_f: f64,
}

/// Flies `flights` seeds from `first_seed` on, on all cores. The gusts are the scenario's.
#[must_use]
pub fn measure(
    world: &WorldModel,
    policies: &Policies,
    scenario: &Scenario,
    objective: &Objective,
    flights: usize,
    first_seed: u64,
) -> Flown {
    let ends: Vec<End> =
        (0..flights as u64).into_par_iter().map(|n| fly(world, policies, scenario, first_seed + n)).collect();
    let count = |kept: fn(&End) -> bool| ends.iter().filter(|end| kept(end)).count();
    Flown {
        flights,
        first_seed,
        kick: scenario.disturbance.kick(),
        safe: Kept::of(count(|end| end.clear), flights, objective.collision_tolerance),
        comm: Kept::of(count(|end| end.connected), flights, objective.outage_tolerance),
        d_f: ends.iter().map(|end| end.d_f).sum::<f64>() / flights.max(1) as f64,
    }
}

/// What came of one flight.
struct End {
    /// It stayed clear of the obstacle.
    clear: bool,
    /// Its SNR stayed above γ_min.
    connected: bool,
    /// d_f, units.
    d_f: f64,
}

fn fly(world: &WorldModel, policies: &Policies, scenario: &Scenario, seed: u64) -> End {
    let mut sim = Sim::new(scenario.clone(), seed);
    let [c, u] = world.motions(scenario.dynamics.v_max, scenario.disturbance.kick());
    let window = scenario.observer.window as usize;
    let (mut controllable, mut uncontrollable) = (Observer::new(c, window), Observer::new(u, window));
    let (scale, v_max) = (world.scale as f32, scenario.dynamics.v_max as f32);
    let least_db = 10.0 * scenario.channel.snr_min.log10();
    let narrow = |y: Vector2<f64>| [y.x as f32, y.y as f32];
    let [mut clear, mut connected] = [true; 2];
    let mut flown = Vec::new();
    for _ in 0..scenario.horizon {
        let latent = world.encode(&sim.frame());
        controllable.observe(vector(world.y_c(&latent)), &flown);
        uncontrollable.observe(vector(world.y_u(&latent)), &vec![Vector2::zeros(); flown.len()]);
        // Both have just seen a picture.
        let (Some(c), Some(u)) = (controllable.estimate(), uncontrollable.estimate()) else { break };
        let now = features(narrow(c.y), narrow(c.before()), narrow(u.y), scale, v_max);
        let (motion, power) = policies.act(&now);
        let accel = scenario.scale.ned_from_paper_acceleration(scenario.dynamics.a_max * motion.vector());
        sim.handle(Command::new(sim.tick(), accel, power));
        sim.advance();
        flown = vec![sim.flown()];
        clear &= sim.world().clearance(scenario) >= scenario.safety.d_min;
        connected &= sim.telemetry().link.is_some_and(|link| f64::from(link.snr_db) >= least_db);
    }
    End { clear, connected, d_f: (sim.world().uav.r - scenario.goal).norm() }
}
