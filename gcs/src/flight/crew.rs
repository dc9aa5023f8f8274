//! Who decides in a flight over a link. Knows no link.

use std::path::PathBuf;

use anyhow::Result;
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::units::Tick;

use crate::watch::map::FieldPlace;

/// Who decides on the ground, and who writes it down.
pub trait Crew {
    /// The command for the interval that this percept begins; asked once for each percept, in the order of
    /// ticks.
    fn command(&mut self, percept: &Percept) -> Command;

    /// The same where the percept has come late: the interval that begins is `now`.
    fn command_at(&mut self, percept: &Percept, _now: Tick) -> Command {
        self.command(percept)
    }

    /// The flight begins with its first percept, which is here. Gives the file of the tlog, if there is to be
    /// one.
    ///
    /// # Errors
    /// A run folder that cannot be made: the flight does not begin.
    fn begin(&mut self) -> Result<Option<PathBuf>> {
        Ok(None)
    }

    /// The command is on its way: there is time to write.
    fn sent(&mut self) {}

    /// The vehicle says something, of severity 0 (emergency) to 7 (debug).
    fn heard(&mut self, _severity: u8, _text: &str) {}

    /// Where on Earth the field lies, if that is known: told once, after [`Crew::begin`].
    fn located(&mut self, _place: FieldPlace) {}

    /// Counters of the link, by name: once a second, and at the end.
    fn link(&mut self, _counters: &serde_json::Value) {}

    /// Whether the flight is over with the newest percept, before [`super::Options::ticks`]: the command to it is not
    /// sent.
    fn is_done(&self) -> bool {
        false
    }

    /// Why the crew cannot fly on, if it cannot: the command to the newest percept is not sent, and the vehicle
    /// brakes.
    fn failure(&self) -> Option<String> {
        None
    }
}

impl<F: FnMut(&Percept) -> Command> Crew for F {
    fn command(&mut self, percept: &Percept) -> Command {
        self(percept)
    }
}
