//! What people call the commands that a foreign vehicle gets.

use crpl_sitl::link::dialect::MavCmd;

/// A command as people call it.
pub(super) fn words(command: MavCmd) -> &'static str {
    match command {
        MavCmd::MAV_CMD_DO_SET_MODE => "mode",
        MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => "arming",
        MavCmd::MAV_CMD_NAV_TAKEOFF => "takeoff",
        _ => "command",
    }
}
