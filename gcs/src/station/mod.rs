//! The ground station: percept in, command out. Opens no socket, reads no clock, draws no lot.
//!
//! A percept that comes again gives the same command again, so a link that loses datagrams delays a
//! flight in lockstep and changes nothing in it.

pub mod belief;
pub mod models;
pub mod pilot;
pub mod seen;

use std::sync::Arc;

use anyhow::Result;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use crpl_sitl::radio::Fates;
use crpl_sitl::radio::message::{Command, Percept, Telemetry};
use crpl_sitl::sim::metric::FlightScore;
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::{Motion, Tick, TxPower};

use crate::station::belief::Belief;
use crate::station::models::{Models, PolicyOrigin};
use crate::station::pilot::own::AnswerTally;
use crate::station::pilot::{Controller, Pilot};
use crate::station::seen::{BeliefConfig, Heard};

/// A flight in progress, seen from the ground.
#[derive(Debug, Clone)]
pub struct Station {
    scenario: Scenario,
    world: Arc<WorldModel>,
    pilot: Pilot,
    belief: Belief,
    last: Option<(Telemetry, Command)>,
    records: Vec<Record>,
    missed: u64,
    policy: Option<PolicyOrigin>,
}

impl Models {
    /// A station that flies `controller`.
    ///
    /// # Errors
    /// As [`Pilot::load`].
    pub fn station(&self, controller: Controller, scenario: &Scenario) -> Result<Station> {
        let (pilot, policy) = Pilot::load(controller, self, scenario)?;
        Ok(Station { policy, ..Station::new(scenario.clone(), self.world.clone(), pilot) })
    }
}

impl Station {
    /// A station that has heard nothing yet.
    #[must_use]
    pub fn new(scenario: Scenario, world: Arc<WorldModel>, pilot: Pilot) -> Self {
        Self {
            belief: Belief::new(&world, BeliefConfig::of(&scenario)),
            scenario,
            world,
            pilot,
            last: None,
            records: Vec::new(),
            missed: 0,
            policy: None,
        }
    }

    /// The command for the interval that this percept begins.
    pub fn handle(&mut self, percept: &Percept) -> Command {
        if let Some((before, command)) = self.last
            && percept.telemetry.tick <= before.tick
        {
            return command;
        }
        self.close(&percept.telemetry);
        let heard = Heard::from(&percept.telemetry);
        self.belief.observe(&self.world, &heard, &percept.frame);
        let decision = self.pilot.decide(&self.belief, percept, &self.scenario.scale);
        let command = self.command(percept.telemetry.tick, decision);
        self.belief.ledger_mut().send(command.tick);
        self.last = Some((percept.telemetry, command));
        command
    }

    fn command(&self, tick: Tick, (motion, power): (Motion, TxPower)) -> Command {
        let physical = self.scenario.dynamics.a_max * motion.vector();
        Command::new(tick, self.scenario.scale.ned_from_paper_acceleration(physical), power)
    }

    /// The last percept of a flight: its interval is written down, nothing is answered.
    pub fn finish(&mut self, percept: &Percept) {
        if self.last.is_some_and(|(before, _)| percept.telemetry.tick > before.tick) {
            self.close(&percept.telemetry);
            self.belief.ledger_mut().hear(&Heard::from(&percept.telemetry));
            self.last = None;
        }
    }

    /// Writes down the interval that this report ends.
    fn close(&mut self, after: &Telemetry) {
        if let Some((before, command)) = &self.last {
            self.missed += after.tick.0 - before.tick.0 - 1;
            self.records.push(Record::new(before, command, after, &self.scenario));
        }
    }

    /// One line per interval so far.
    #[must_use]
    pub fn records(&self) -> &[Record] {
        &self.records
    }

    /// The lines of a flight that is over.
    #[must_use]
    pub fn into_records(self) -> Vec<Record> {
        self.records
    }

    /// Intervals of which no percept arrived (real time only).
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// What became of the commands so far.
    #[must_use]
    pub fn fates(&self) -> Fates {
        self.belief.ledger().fates()
    }

    /// The paper's metrics so far; `None` before the first interval has ended.
    #[must_use]
    pub fn score(&self) -> Option<FlightScore> {
        FlightScore::of(&self.records, &self.scenario)
    }

    /// Where the controller's policies come from; `None` for a controller without any.
    #[must_use]
    pub fn policy(&self) -> Option<&PolicyOrigin> {
        self.policy.as_ref()
    }

    /// Why the controller cannot fly on, if it cannot: one of somebody's own that gives no answers.
    #[must_use]
    pub fn failure(&self) -> Option<&str> {
        match &self.pilot {
            Pilot::Own(own) => own.failure(),
            _ => None,
        }
    }

    /// How a controller of somebody's own has answered; `None` for another.
    #[must_use]
    pub fn answers(&self) -> Option<&AnswerTally> {
        match &self.pilot {
            Pilot::Own(own) => Some(own.answers()),
            _ => None,
        }
    }

    /// The flight's parameters.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }
}
