//! A station that flies over a link, and its run folder, which grows with the flight.

use std::path::PathBuf;

use anyhow::Result;
use crpl_sitl::program::terminal::ExitWith;
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::units::Tick;

use crate::flight::{Crew, Flight};
use crate::lab::run_folder::RunFolder;
use crate::lab::summary::{FlightEnded, Summary};
use crate::station::Station;
use crate::station::pilot::Controller;
use crate::watch::Shown;
use crate::watch::feed::Feed;
use crate::watch::map::FieldPlace;
use crate::watch::watcher::FlightWatcher;

/// The exit code of a flight whose results could not be written.
const NOT_WRITTEN: u8 = 7;

/// Who flies, and who writes it down.
#[derive(Debug)]
pub struct LoggedStation {
    station: Station,
    folder: RunFolder,
    controller: Controller,
    seed: Option<u64>,
    shown: Shown,
    /// Where others watch, if they can.
    live: Option<Feed>,
    watcher: Option<FlightWatcher>,
    /// What was decided on, until it has left.
    decided: Option<(Percept, Command)>,
}

/// A flight that has ended, and all that is known of it.
#[derive(Debug)]
pub struct Landed {
    /// Its numbers; `None` if no interval was flown.
    pub summary: Option<Summary>,
    /// Where its files are.
    pub dir: PathBuf,
    /// With what the program ends, unless the flight went as it should.
    pub exit: Option<ExitWith>,
}

impl LoggedStation {
    /// A station that flies `controller`; `seed` of the gusts, if they are known.
    #[must_use]
    pub fn new(station: Station, folder: RunFolder, controller: Controller, seed: Option<u64>) -> Self {
        let shown = Shown { seed, ..Shown::one("gcs", controller) };
        Self { station, folder, controller, seed, shown, live: None, watcher: None, decided: None }
    }

    /// The same, under these names on the page; `live` is where others watch.
    #[must_use]
    pub fn shown_as(self, shown: Shown, live: Option<Feed>) -> Self {
        Self { shown, live, ..self }
    }

    /// The end: writes what is left.
    #[must_use]
    pub fn land(mut self, flight: &Flight) -> Landed {
        if let Some(last) = &flight.last {
            self.station.finish(last);
        }
        let ended = FlightEnded::of(flight);
        let summary = Summary::of(self.controller, self.seed, &self.station, flight, ended.clone());
        let dir = self.folder.dir().to_path_buf();
        if let Some(watcher) = self.watcher {
            let last = flight.last.as_ref().map(|last| &last.telemetry);
            let reason = if ended.why.is_empty() { ended.how.key() } else { &ended.why };
            let told = serde_json::to_value(&summary).unwrap_or_default();
            watcher.link(ended.tick.unwrap_or_default(), &flight.counters());
            self.folder.page(&watcher.finish(&self.station, last, reason, told));
        }
        let failed = self.folder.finish(ended, summary.clone(), self.station.records());
        let failed = failed.or_else(|| flight.log_error.clone());
        let exit = exit_of(flight, failed);
        Landed { summary, dir, exit }
    }
}

/// With what a program ends after this flight, of whose results something may have `failed` to be written; `None`:
/// success.
#[must_use]
pub fn exit_of(flight: &Flight, failed: Option<String>) -> Option<ExitWith> {
    match (flight.ended.exit_code(), failed) {
        (Some(code), _) => Some(ExitWith { code, why: flight.why.clone() }),
        (None, Some(why)) => Some(ExitWith { code: NOT_WRITTEN, why }),
        (None, None) => None,
    }
}

impl Crew for LoggedStation {
    fn command(&mut self, percept: &Percept) -> Command {
        self.command_at(percept, percept.telemetry.tick)
    }

    fn command_at(&mut self, percept: &Percept, now: Tick) -> Command {
        let command = self.station.handle_at(percept, now);
        self.decided = Some((percept.clone(), command));
        command
    }

    fn begin(&mut self) -> Result<Option<PathBuf>> {
        let tlog = self.folder.begin()?;
        self.watcher = Some(FlightWatcher::new(&self.station, &self.shown, self.live.clone()));
        Ok(Some(tlog))
    }

    fn failure(&self) -> Option<String> {
        self.station.failure().map(ToOwned::to_owned)
    }

    fn sent(&mut self) {
        self.folder.record(self.station.records());
        if let (Some(watcher), Some((percept, command))) = (&mut self.watcher, self.decided.take()) {
            watcher.saw(&self.station, &percept, command);
        }
    }

    fn heard(&mut self, severity: u8, text: &str) {
        let watched = self.watcher.iter().flat_map(FlightWatcher::feeds);
        let time = self.station.records().last().map_or(0.0, |record| record.tick.0 as f64);
        let time = time * self.station.scenario().scale.interval_s;
        watched.for_each(|feed| feed.log(level(severity), time, format!("vehicle: {text}")));
    }

    fn located(&mut self, place: FieldPlace) {
        if let Some(watcher) = &self.watcher {
            watcher.locate(place);
        }
    }

    fn link(&mut self, counters: &serde_json::Value) {
        let tick = self.station.records().last().map_or(0, |record| record.tick.0);
        if let Some(watcher) = &self.watcher {
            watcher.link(tick, counters);
        }
    }
}

/// The log's level of a severity of MAVLink.
#[must_use]
pub fn level(severity: u8) -> &'static str {
    match severity {
        0..=3 => "error",
        4 => "warn",
        _ => "info",
    }
}
