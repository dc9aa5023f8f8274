//! The ground station: percept in, command out. Opens no socket, reads no clock, draws no lot.
//!
//! A percept that comes again gives the same command again, so a link that loses datagrams delays a
//! flight in lockstep and changes nothing in it.

pub mod belief;
pub mod flight_log;
pub mod models;
pub mod pilot;
pub mod seen;
pub mod sighting;

use std::sync::Arc;

use anyhow::Result;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use crpl_sitl::camera::Frame;
use crpl_sitl::radio::Fates;
use crpl_sitl::radio::message::{Command, Percept, Telemetry};
use crpl_sitl::sim::metric::FlightScore;
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::{Motion, Tick, TxPower};
use crpl_sitl::world::dynamics::{self, State};
use nalgebra::Vector2;

use crate::station::belief::{Belief, Latents};
use crate::station::models::{Models, PolicyOrigin};
use crate::station::pilot::own::AnswerTally;
use crate::station::pilot::{Controller, Pilot};
use crate::station::seen::{BeliefConfig, Heard};
use crate::station::sighting::Sighting;

/// A flight in progress, seen from the ground.
#[derive(Debug, Clone)]
pub struct Station {
    scenario: Scenario,
    world: Arc<WorldModel>,
    pilot: Pilot,
    belief: Belief,
    last: Option<(Telemetry, Command)>,
    /// The newest report of those that come by themselves.
    heard: Option<Telemetry>,
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
            heard: None,
            records: Vec::new(),
            missed: 0,
            policy: None,
        }
    }

    /// The command for the interval that this percept begins.
    pub fn handle(&mut self, percept: &Percept) -> Command {
        self.handle_at(percept, percept.telemetry.tick)
    }

    /// The command for interval `now`, where this percept is the newest and may be late: see [`Station::decide`].
    pub fn handle_at(&mut self, percept: &Percept, now: Tick) -> Command {
        if let Some((before, command)) = self.last
            && percept.telemetry.tick <= before.tick
        {
            return command;
        }
        self.close(&percept.telemetry);
        let heard = Heard::from(&percept.telemetry);
        self.belief.hear(&heard);
        if let Some(sighting) = Sighting::of_percept(&self.world, percept, self.scenario.obstacles.len()) {
            self.belief.see(heard.tick, &sighting);
        }
        let frame = Some(percept.frame.as_ref());
        let command = self.answer(now.max(percept.telemetry.tick), &percept.telemetry, frame);
        self.last = Some((percept.telemetry, command));
        command
    }

    /// A report has arrived, early or late, with or without its frame. Such a station decides by
    /// [`Station::decide`], and writes no records.
    pub fn hear(&mut self, telemetry: &Telemetry) {
        self.belief.hear(&Heard::from(telemetry));
        if self.heard.is_none_or(|newest| telemetry.tick > newest.tick) {
            self.heard = Some(*telemetry);
        }
    }

    /// What the frame of a tick shows has arrived, early or late.
    pub fn see(&mut self, tick: Tick, sighting: &Sighting) {
        self.belief.see(tick, sighting);
    }

    /// The command for interval `now`, from what has arrived so far; `None` while the controller has nothing to
    /// go by. What is late counts as what it is: the belief is rolled forward, and so is what an oracle knows;
    /// a reactive controller sees the newest report as it came.
    pub fn decide(&mut self, now: Tick) -> Option<Command> {
        let heard = self.heard?;
        if self.pilot.sees_frames() {
            self.belief.seen()?;
        }
        Some(self.answer(now, &heard, None))
    }

    /// The ticks of the newest frame and of the newest report that have arrived.
    #[must_use]
    pub fn newest(&self) -> [Option<Tick>; 2] {
        [self.belief.seen(), self.heard.map(|heard| heard.tick)]
    }

    /// The latents of the newest frame.
    #[must_use]
    pub fn latents(&self) -> Latents {
        self.belief.latents()
    }

    /// Whether the controller goes by frames and not by reports.
    #[must_use]
    pub fn sees_frames(&self) -> bool {
        self.pilot.sees_frames()
    }

    fn answer(&mut self, now: Tick, telemetry: &Telemetry, frame: Option<&Frame>) -> Command {
        let rolled = self.pilot.knows_equations().then(|| self.rolled(*telemetry, now));
        let present = rolled.as_ref().unwrap_or(telemetry);
        let decision = self.pilot.decide(now, &self.belief, present, frame, &self.scenario.scale);
        let command = self.command(now, decision);
        self.belief.send(&command);
        command
    }

    /// A report brought up to `now` by the equations of motion, without gusts. Obstacles are where they were.
    fn rolled(&self, heard: Telemetry, now: Tick) -> Telemetry {
        let scale = &self.scenario.scale;
        let begin = State {
            r: scale.paper_from_ned(heard.position),
            v: scale.paper_from_ned_velocity(heard.velocity),
        };
        let flown = self.belief.actions(heard.tick, now);
        let step = |at, a: &Vector2<f64>| dynamics::step(at, *a, Vector2::zeros(), &self.scenario.dynamics);
        let State { r, v } = flown.iter().fold(begin, step);
        match flown.is_empty() {
            true => heard,
            false => Telemetry {
                position: scale.ned_from_paper(r),
                velocity: scale.ned_from_paper_velocity(v),
                ..heard
            },
        }
    }

    fn command(&self, tick: Tick, (motion, power): (Motion, TxPower)) -> Command {
        let physical = self.scenario.dynamics.a_max * motion.vector();
        Command::new(tick, self.scenario.scale.ned_from_paper_acceleration(physical), power)
    }

    /// The last percept of a flight: its interval is written down, nothing is answered.
    pub fn finish(&mut self, percept: &Percept) {
        if self.last.is_some_and(|(before, _)| percept.telemetry.tick > before.tick) {
            self.close(&percept.telemetry);
            self.belief.hear(&Heard::from(&percept.telemetry));
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

    /// What it makes of the frames.
    #[must_use]
    pub fn belief(&self) -> &Belief {
        &self.belief
    }

    /// Who decides.
    #[must_use]
    pub fn pilot(&self) -> &Pilot {
        &self.pilot
    }

    /// The world model.
    #[must_use]
    pub fn world(&self) -> &Arc<WorldModel> {
        &self.world
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
