//! Flights in process: the same `Sim` and the same `Station` as over UDP, without a link.

pub mod attempts;
pub mod bound;
pub mod check;
pub mod crew;
pub mod demo;
pub mod environment;
pub mod episodes;
pub mod figures;
pub mod optimise;
pub mod policies;
pub mod random;
pub mod record;
pub mod report;
pub mod run_folder;
pub mod sensitivity;
pub mod summary;
pub mod sweep;
pub mod tune;

use std::sync::Arc;

use anyhow::{Context, Result};
use crpl_model::planning::policy::Policies;
use crpl_model::world_model::WorldModel;
use crpl_sitl::sim::metric::FlightScore;
use crpl_sitl::sim::record::Record;
use crpl_sitl::{Scenario, Sim};

use crate::station::Station;
use crate::station::models::{Models, PolicyOrigin};
use crate::station::pilot::crpl::Crpl;
use crate::station::pilot::{Controller, Pilot};
use crate::station::seen::MotionLimits;

/// Flies `ticks` control intervals, frames rendered and encoded at each, or up to the fall after a
/// collision.
pub fn fly(sim: &mut Sim, station: &mut Station, ticks: u64) {
    for _ in 0..ticks {
        if sim.is_fallen() {
            break;
        }
        let command = station.handle(&sim.percept());
        sim.handle(command);
        sim.advance();
    }
    station.finish(&sim.percept());
}

/// A controller that is ready to fly a scenario again and again.
#[derive(Debug, Clone)]
pub struct Contender {
    /// Who flies.
    pub controller: Controller,
    scenario: Scenario,
    world: Arc<WorldModel>,
    pilot: Pilot,
    policy: Option<PolicyOrigin>,
}

impl Contender {
    /// Loads what `controller` needs, once.
    ///
    /// # Errors
    /// As [`Pilot::load`].
    pub fn new(models: &Models, controller: Controller, scenario: &Scenario) -> Result<Self> {
        let (pilot, policy) = Pilot::load(controller, models, scenario)?;
        Ok(Self { controller, scenario: scenario.clone(), world: models.world.clone(), pilot, policy })
    }

    /// `crpl` with policies that are not on disk yet.
    #[must_use]
    pub fn with_policies(world: &Arc<WorldModel>, policies: &Policies, scenario: &Scenario) -> Self {
        Self {
            controller: Controller::Crpl,
            scenario: scenario.clone(),
            world: world.clone(),
            pilot: Pilot::Crpl(Crpl::new(
                Arc::new(policies.clone()),
                world.scale,
                MotionLimits::of(scenario),
            )),
            policy: None,
        }
    }

    /// Where the policies come from; `None` for a controller without any, and for policies not on disk yet.
    #[must_use]
    pub fn policy(&self) -> Option<&PolicyOrigin> {
        self.policy.as_ref()
    }

    /// What is flown.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// A whole flight, interval by interval. Equal seeds give equal records.
    #[must_use]
    pub fn records(&self, seed: u64) -> Vec<Record> {
        self.flown(seed).records().to_vec()
    }

    /// A whole flight's score.
    ///
    /// # Errors
    /// If the scenario's horizon is 0.
    pub fn fly(&self, seed: u64) -> Result<FlightScore> {
        self.flown(seed).score().context("no interval was flown")
    }

    fn flown(&self, seed: u64) -> Station {
        let mut station = Station::new(self.scenario.clone(), self.world.clone(), self.pilot.clone());
        let mut sim = Sim::new(self.scenario.clone(), seed);
        fly(&mut sim, &mut station, self.scenario.horizon);
        station
    }
}
