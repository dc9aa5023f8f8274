//! Mode, arming, takeoff and landing of a vehicle that is in the air from the start, armed and in
//! GUIDED, and that knows no height but its own. What it cannot do it refuses, and says why.
//!
//! | asked | answered |
//! |---|---|
//! | COMPONENT_ARM_DISARM 1 | ACCEPTED: it is armed |
//! | COMPONENT_ARM_DISARM 0 | FAILED: in the air |
//! | the same, forced by 21196 | FAILED: a planar model cannot fall, and would hover on without motors |
//! | COMPONENT_ARM_DISARM of anything else | DENIED |
//! | DO_SET_MODE with a custom mode, SET_MODE: GUIDED (4) | ACCEPTED: it is in GUIDED |
//! | another mode, or no custom mode | DENIED |
//! | NAV_TAKEOFF to the height it flies at, within a metre | ACCEPTED: it is there |
//! | NAV_TAKEOFF to another height | DENIED |
//! | NAV_LAND | UNSUPPORTED |

use std::time::Duration;

use super::Vehicle;
use super::messages::MODE_GUIDED;
use crate::link::dialect::{MavModeFlag, MavResult, MavSeverity};
use crate::link::wire::Ask;

pub(super) const CMD_NAV_LAND: u16 = 21;
pub(super) const CMD_NAV_TAKEOFF: u16 = 22;
pub(super) const CMD_DO_SET_MODE: u16 = 176;
pub(super) const CMD_ARM_DISARM: u16 = 400;

/// How far from its own height a takeoff may aim, m.
const HEIGHT_TOLERANCE_M: f32 = 1.0;
const FORCED: f32 = 21_196.0;

impl Vehicle {
    /// What becomes of a command of this module.
    pub(super) fn mode_command(&mut self, ask: &Ask, now: Duration) -> MavResult {
        let [first, second] = ask.params;
        match ask.command {
            CMD_ARM_DISARM => self.arm(first, second, now),
            // A float that is no number becomes 0, which is no custom mode.
            CMD_DO_SET_MODE => self.set_mode(first as u8, second, now),
            CMD_NAV_TAKEOFF => self.take_off(ask.height, now),
            _ => {
                self.tally.unsupported += 1;
                self.refused("landing", "landing refused: this vehicle is planar", now);
                MavResult::MAV_RESULT_UNSUPPORTED
            }
        }
    }

    fn arm(&mut self, arm: f32, force: f32, now: Duration) -> MavResult {
        if arm == 1.0 {
            return MavResult::MAV_RESULT_ACCEPTED;
        }
        if arm != 0.0 {
            return MavResult::MAV_RESULT_DENIED;
        }
        let why = if force == FORCED { "a planar model cannot fall" } else { "in the air" };
        self.refused("disarming", &format!("disarming refused: {why}"), now);
        MavResult::MAV_RESULT_FAILED
    }

    /// `base` holds MAV_MODE_FLAG; the custom mode counts if its flag is set.
    pub(super) fn set_mode(&mut self, base: u8, custom: f32, now: Duration) -> MavResult {
        let is_custom = base & MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED.bits() != 0;
        if is_custom && custom == MODE_GUIDED as f32 {
            return MavResult::MAV_RESULT_ACCEPTED;
        }
        let asked = if is_custom { format!("mode {custom}") } else { format!("base mode {base}") };
        self.refused("mode", &format!("{asked} refused: only GUIDED (4)"), now);
        MavResult::MAV_RESULT_DENIED
    }

    fn take_off(&mut self, height: f32, now: Duration) -> MavResult {
        let own = self.sim.scenario().scale.altitude_m as f32;
        if (height - own).abs() <= HEIGHT_TOLERANCE_M {
            return MavResult::MAV_RESULT_ACCEPTED;
        }
        self.refused("takeoff", &format!("takeoff refused: flies at {own} m, always"), now);
        MavResult::MAV_RESULT_DENIED
    }

    fn refused(&mut self, kind: &'static str, text: &str, now: Duration) {
        self.say(kind, MavSeverity::MAV_SEVERITY_WARNING, text, now);
    }
}
