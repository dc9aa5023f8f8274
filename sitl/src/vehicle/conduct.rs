//! What the vehicle is about, beside its place: its mode, its motors, what it follows.

use super::guided::GuidedTarget;
use crate::link::dialect::MavModeFlag;

/// ArduCopter's flight modes, those that a vehicle without a pilot can fly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum Mode {
    Auto = 3,
    Guided = 4,
    Loiter = 5,
    Return = 6,
    Land = 9,
    Brake = 17,
}

impl Mode {
    pub const ALL: [Self; 6] =
        [Self::Auto, Self::Guided, Self::Loiter, Self::Return, Self::Land, Self::Brake];

    /// ArduCopter's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "AUTO",
            Self::Guided => "GUIDED",
            Self::Loiter => "LOITER",
            Self::Return => "RTL",
            Self::Land => "LAND",
            Self::Brake => "BRAKE",
        }
    }

    /// Whether the motors may be started in it.
    pub fn takes_off(self) -> bool {
        matches!(self, Self::Auto | Self::Guided | Self::Loiter)
    }
}

/// What the vehicle is about, beside its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Conduct {
    pub mode: Mode,
    pub armed: bool,
    /// It fell, and its motors will not start again.
    pub crashed: bool,
    /// On its way up from the ground, to so many m.
    pub climbing: Option<f64>,
    /// RTL has arrived and descends.
    pub landing: bool,
    /// GUIDED has been entered in flight, and no setpoint has got through since.
    pub waiting: bool,
    /// What GUIDED follows beside the held command.
    pub guided: Option<GuidedTarget>,
}

impl Conduct {
    /// In the air, armed, in GUIDED.
    pub fn flying() -> Self {
        Self {
            mode: Mode::Guided,
            armed: true,
            crashed: false,
            climbing: None,
            landing: false,
            waiting: false,
            guided: None,
        }
    }

    /// On the ground, disarmed, in GUIDED.
    pub fn parked() -> Self {
        Self { armed: false, ..Self::flying() }
    }

    /// `base_mode` of the heartbeat, as ArduCopter sets it.
    pub fn base_mode(&self) -> MavModeFlag {
        let mut flags = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_MANUAL_INPUT_ENABLED;
        if self.mode != Mode::Land {
            flags |= MavModeFlag::MAV_MODE_FLAG_GUIDED_ENABLED;
        }
        if self.armed {
            flags |= MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED;
        }
        flags
    }
}
