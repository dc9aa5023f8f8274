//! What a flight over a link was, from the station's side, and how it has ended.

use std::time::Duration;

use crpl_sitl::link::splitter::Counts;
use crpl_sitl::program::terminal::Signal;
use crpl_sitl::radio::message::Percept;
use serde::{Serialize, Serializer};

/// How a flight has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FlightEnd {
    /// After its last tick, or after a collision at which the vehicle falls.
    #[default]
    Over,
    /// By a signal.
    Interrupted(Signal),
    /// The operator has changed the vehicle's mode, and flies.
    TakenOver,
    /// A failsafe of the vehicle has ended it.
    Failsafe,
    /// The vehicle's motors have stopped in the air, or it says that it has crashed.
    Crashed,
    /// Nothing came for [`super::Options::timeout`].
    LinkLost,
    /// The vehicle's time has gone back.
    Rebooted,
    /// The vehicle flies a setpoint, or transmits at a power, that this station has not sent.
    ForeignSetpoint,
    /// The controller, a program of somebody's own, gives no answers.
    NoController,
}

impl FlightEnd {
    /// Its name in tables and JSON.
    #[must_use]
    pub fn key(self) -> &'static str {
        match self {
            Self::Over => "over",
            Self::Interrupted(_) => "interrupted",
            Self::TakenOver => "taken over",
            Self::Failsafe => "failsafe",
            Self::Crashed => "crashed",
            Self::LinkLost => "link lost",
            Self::Rebooted => "rebooted",
            Self::ForeignSetpoint => "foreign setpoint",
            Self::NoController => "no controller",
        }
    }

    /// The exit code of a program whose flight has ended so; `None`: success.
    #[must_use]
    pub fn exit_code(self) -> Option<u8> {
        match self {
            Self::Over => None,
            Self::Interrupted(signal) => Some(signal.exit_code()),
            Self::LinkLost => Some(3),
            Self::TakenOver => Some(4),
            Self::Rebooted => Some(5),
            Self::ForeignSetpoint => Some(6),
            Self::Failsafe => Some(8),
            Self::NoController => Some(9),
            Self::Crashed => Some(10),
        }
    }
}

impl Serialize for FlightEnd {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.key())
    }
}

/// A flight from the station's side.
#[derive(Debug, Clone, Default)]
pub struct Flight {
    /// How it has ended.
    pub ended: FlightEnd,
    /// Why, in one line.
    pub why: String,
    /// The newest percept. After `ticks` it closes the last interval; the station has not been
    /// asked for a command to it.
    pub last: Option<Percept>,
    /// From the last datagram of a percept to its command on the socket, one a percept, µs.
    pub latencies_us: Vec<f64>,
    /// From the first percept to the last.
    pub wall: Duration,
    /// How often the vehicle has asked again for a command.
    pub repeats: u64,
    /// What arrived.
    pub packets: Counts,
    /// Frames of the vehicle that never came.
    pub lost: u64,
    /// Setpoints of other stations that were not forwarded to the vehicle.
    pub suppressed_setpoints: u64,
    /// Reports and frames that were rejected.
    pub rejected_messages: u64,
    /// Why the tlog is not complete, if so.
    pub log_error: Option<String>,
}

impl Flight {
    /// What the link has carried, by name.
    #[must_use]
    pub fn counters(&self) -> serde_json::Value {
        serde_json::json!({
            "frames": self.packets.frames,
            "frames_lost": self.lost,
            "repeats": self.repeats,
            "rejected": self.rejected_messages,
            "setpoints_held_back": self.suppressed_setpoints,
        })
    }
}
