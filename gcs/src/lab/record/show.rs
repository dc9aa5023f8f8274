//! A recording for a page: pictures, the path, the radio, and how many episodes there are.

use crpl_sitl::Scenario;
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::sim::record::Record;
use serde_json::Value;

use crate::watch::Shown;
use crate::watch::feed::{Feed, ShownVehicle, WatchEvent};
use crate::watch::narrator::{Narrator, SeenScene, StationSight};
use crate::watch::watcher::{NarratorThread, hello};

/// The number of the only vehicle.
const VEHICLE: u32 = 1;

/// Tells a feed of a recording; nobody waits for it.
#[derive(Debug)]
pub struct RecordingShow {
    feed: Feed,
    scenario: Scenario,
    narrator: NarratorThread,
    before: Option<(Percept, Command)>,
}

impl RecordingShow {
    /// Of a recording of a vehicle in `scenario`.
    #[must_use]
    pub fn begin(feed: &Feed, scenario: &Scenario, seed: u64) -> Self {
        let vehicle = ShownVehicle { id: VEHICLE, name: "recording".into(), controller: None };
        let program = "gcs record".into();
        let shown = Shown { program, seed: Some(seed), vehicles: vec![vehicle], ..Shown::default() };
        // A recording has no end of its own in intervals.
        let mut first = hello(scenario, &shown);
        if let WatchEvent::Hello { ticks, .. } = &mut first {
            *ticks = None;
        }
        feed.send(&first);
        let narrator = NarratorThread::begin(Narrator::new(vec![feed.clone()], VEHICLE, scenario, None));
        Self { feed: feed.clone(), scenario: scenario.clone(), narrator, before: None }
    }

    /// The command to `percept` has left.
    pub fn saw(&mut self, percept: &Percept, command: Command) {
        let before = self.before.replace((percept.clone(), command));
        let follows = |before: &Percept| before.telemetry.tick.next() == percept.telemetry.tick;
        let records = before.filter(|(before, _)| follows(before)).map(|(before, command)| {
            Record::new(&before.telemetry, &command, &percept.telemetry, &self.scenario)
        });
        let scene = || SeenScene { frame: percept.frame.clone(), belief: None, foresight: None };
        self.narrator.tell(StationSight {
            telemetry: percept.telemetry,
            command: Some(command),
            records: records.into_iter().collect(),
            scene: self.narrator.keeps_up().then(scene),
        });
    }

    /// So many episodes are there.
    pub fn counted(&self, done: usize, total: usize) {
        let [done, total] = [done, total].map(|n| n as u64);
        self.feed.send(&WatchEvent::Progress { done, total, text: "episodes".into() });
    }

    /// The vehicle or the link says something.
    pub fn log(&self, level: &'static str, text: &str) {
        let tick = self.before.as_ref().map_or(0, |(percept, _)| percept.telemetry.tick.0);
        self.feed.log(level, tick as f64 * self.scenario.scale.interval_s, text);
    }

    /// Counters of the link, by name.
    pub fn link(&self, counters: &Value) {
        let tick = self.before.as_ref().map_or(0, |(percept, _)| percept.telemetry.tick.0);
        self.feed.send(&WatchEvent::Link { vehicle: VEHICLE, tick, counters: counters.clone() });
    }

    /// The recording is over: all is told.
    pub fn end(self) {
        if let Some(mut narrator) = self.narrator.end() {
            narrator.finish();
        }
    }
}
