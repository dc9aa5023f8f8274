//! A station that flies over a link, and its run folder, which grows with the flight.

use std::path::PathBuf;

use anyhow::Result;
use crpl_sitl::program::terminal::ExitWith;
use crpl_sitl::radio::message::{Command, Percept};

use crate::flight::{Crew, Flight};
use crate::lab::run_folder::RunFolder;
use crate::lab::summary::{FlightEnded, Summary};
use crate::station::Station;
use crate::station::pilot::Controller;

/// The exit code of a flight whose results could not be written.
const NOT_WRITTEN: u8 = 7;

/// Who flies, and who writes it down.
#[derive(Debug)]
pub struct LoggedStation {
    station: Station,
    folder: RunFolder,
    controller: Controller,
    seed: Option<u64>,
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
        Self { station, folder, controller, seed }
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
        self.station.handle(percept)
    }

    fn begin(&mut self) -> Result<Option<PathBuf>> {
        self.folder.begin().map(Some)
    }

    fn failure(&self) -> Option<String> {
        self.station.failure().map(ToOwned::to_owned)
    }

    fn sent(&mut self) {
        self.folder.record(self.station.records());
    }
}
