//! The autopilots whose protocols are known, and their modes.

use clap::ValueEnum;

use super::field::WhenOver;

/// The autopilot whose protocol a foreign vehicle follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ForeignStack {
    /// ArduCopter, flown in GUIDED
    Ardupilot,
    /// PX4, flown in OFFBOARD
    Px4,
}

impl ForeignStack {
    /// DO_SET_MODE's first three parameters at the end: BRAKE, LAND or RTL; PX4's AUTO with LOITER, which its
    /// stations call Hold, LAND or RTL.
    pub(super) fn last_mode(self, over: WhenOver) -> [f32; 3] {
        match (self, over) {
            (Self::Ardupilot, WhenOver::Hold) => [1.0, 17.0, 0.0],
            (Self::Ardupilot, WhenOver::Land) => [1.0, 9.0, 0.0],
            (Self::Ardupilot, WhenOver::Rtl) => [1.0, 6.0, 0.0],
            (Self::Px4, WhenOver::Hold) => [1.0, 4.0, 3.0],
            (Self::Px4, WhenOver::Land) => [1.0, 4.0, 6.0],
            (Self::Px4, WhenOver::Rtl) => [1.0, 4.0, 5.0],
        }
    }
}
