//! Flights in process: the same `Sim` and the same `Station` as over UDP, without a link.

pub mod aired;
pub mod attempts;
pub mod bound;
pub mod check;
pub mod crew;
pub mod demo;
pub mod environment;
pub mod episodes;
pub mod figures;
pub mod fleet;
pub mod flown;
pub mod mavlink_flights;
pub mod optimise;
pub mod policies;
pub mod random;
pub mod record;
pub mod report;
pub mod run_folder;
pub mod scenarios;
pub mod sensitivity;
pub mod summary;
pub mod sweep;
pub mod tune;

use std::sync::Arc;

use anyhow::{Context, Result, bail};
use crpl_model::planning::policy::Policies;
use crpl_model::world_model::WorldModel;
use crpl_sitl::sim::metric::FlightScore;
use crpl_sitl::sim::record::Record;
use crpl_sitl::{Scenario, Sim};

use crate::lab::aired::{AirPlan, AirTally};
use crate::lab::mavlink_flights::MavlinkFlights;
use crate::station::Station;
use crate::station::models::{Models, PolicyOrigin};
use crate::station::pilot::crpl::Crpl;
use crate::station::pilot::own::AnswerTally;
use crate::station::pilot::own::name::OwnKind;
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
        if station.failure().is_some() {
            break;
        }
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
    flyer: Flyer,
    policy: Option<PolicyOrigin>,
}

/// What flies.
#[derive(Debug, Clone)]
enum Flyer {
    /// A station of ours.
    Station(Pilot),
    /// One of somebody's own, by MAVLink.
    Mavlink(Arc<MavlinkFlights>),
}

impl Contender {
    /// Loads what `controller` needs, once.
    ///
    /// # Errors
    /// As [`Pilot::load`].
    pub fn new(models: &Models, controller: Controller, scenario: &Scenario) -> Result<Self> {
        let (flyer, policy) = match controller.own().filter(|own| own.kind == OwnKind::Mavlink) {
            Some(own) => (Flyer::Mavlink(Arc::new(MavlinkFlights::new(own, models.own, scenario)?)), None),
            None => {
                let (pilot, policy) = Pilot::load(controller, models, scenario)?;
                (Flyer::Station(pilot), policy)
            }
        };
        Ok(Self { controller, scenario: scenario.clone(), world: models.world.clone(), flyer, policy })
    }

    /// `crpl` with policies that are not on disk yet.
    #[must_use]
    pub fn with_policies(world: &Arc<WorldModel>, policies: &Policies, scenario: &Scenario) -> Self {
        Self {
            controller: Controller::Crpl,
            scenario: scenario.clone(),
            world: world.clone(),
            flyer: Flyer::Station(Pilot::Crpl(Crpl::new(
                Arc::new(policies.clone()),
                world.scale,
                MotionLimits::of(scenario),
            ))),
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
    ///
    /// # Errors
    /// A controller of somebody's own that gives no answers.
    pub fn records(&self, seed: u64) -> Result<Vec<Record>> {
        let pilot = match &self.flyer {
            Flyer::Mavlink(flights) => return flights.records(seed),
            Flyer::Station(pilot) => pilot.clone(),
        };
        let mut station = Station::new(self.scenario.clone(), self.world.clone(), pilot);
        let mut sim = Sim::new(self.scenario.clone(), seed);
        fly(&mut sim, &mut station, self.scenario.horizon);
        match station.failure() {
            Some(why) => bail!("flight of seed {seed}: {why}"),
            None => Ok(station.into_records()),
        }
    }

    /// A whole flight's score.
    ///
    /// # Errors
    /// As [`Contender::records`]; if the scenario's horizon is 0.
    pub fn fly(&self, seed: u64) -> Result<FlightScore> {
        FlightScore::of(&self.records(seed)?, &self.scenario).context("no interval was flown")
    }

    /// A whole flight over a radio that carries everything: its score, and what went over the radio.
    ///
    /// # Errors
    /// As [`aired::fly`]; the scenario's horizon is 0.
    pub fn fly_over(&self, plan: &AirPlan, seed: u64) -> Result<(FlightScore, AirTally)> {
        let mut sim = Sim::new(self.scenario.clone(), seed);
        let horizon = self.scenario.horizon;
        let (records, tally) = aired::fly(&mut sim, &mut self.station()?, &self.world, plan, horizon)?;
        let score = FlightScore::of(&records, &self.scenario).context("no interval was flown")?;
        Ok((score, tally))
    }

    /// Whether the controller goes by frames and not by reports.
    #[must_use]
    pub fn sees_frames(&self) -> bool {
        matches!(&self.flyer, Flyer::Station(pilot) if pilot.sees_frames())
    }

    /// A station of its own that has heard nothing yet, for flights over a radio that carries everything and for
    /// fleets.
    ///
    /// # Errors
    /// A controller of somebody's own: it answers percepts as they come, and these come late or not at all.
    pub fn station(&self) -> Result<Station> {
        match &self.flyer {
            Flyer::Station(pilot) if !matches!(pilot, Pilot::Own(_)) => {
                Ok(Station::new(self.scenario.clone(), self.world.clone(), pilot.clone()))
            }
            _ => bail!("{} flies with --radio setpoints alone, and in no fleet", self.controller),
        }
    }

    /// How a controller of somebody's own has answered in the flights so far; `None` for another.
    #[must_use]
    pub fn answers(&self) -> Option<AnswerTally> {
        match &self.flyer {
            Flyer::Station(Pilot::Own(own)) => Some(own.all_answers()),
            _ => None,
        }
    }
}
