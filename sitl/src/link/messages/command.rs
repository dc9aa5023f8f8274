//! Commands and their answers.

use super::Target;

views! {
    /// A command with seven floats.
    CommandLong = COMMAND_LONG_DATA {
        /// param1 to param7.
        0 => params: [f32; 7],
        /// MAV_CMD.
        28 => command: u16,
        /// Whom it is for.
        30 => target: Target,
        /// 0 at first, then the number of the repetition.
        32 => confirmation: u8,
    }

    /// A command with a place in integers.
    CommandInt = COMMAND_INT_DATA {
        /// param1 to param4.
        0 => params: [f32; 4],
        /// Latitude and longitude, 1e-7 degrees, or x and y, 1e-4 m.
        16 => place: [i32; 2],
        /// Height, m.
        24 => z: f32,
        /// MAV_CMD.
        28 => command: u16,
        /// Whom it is for.
        30 => target: Target,
        /// MAV_FRAME.
        32 => frame: u8,
        /// Not used by the standard.
        33 => current: u8,
        /// Not used by the standard.
        34 => autocontinue: u8,
    }

    /// The answer to a command.
    CommandAck = COMMAND_ACK_DATA {
        /// MAV_CMD; for SET_MODE its message id.
        0 => command: u16,
        /// MAV_RESULT.
        2 => result: u8,
        /// Percent; 255 is unknown.
        3 => progress: u8,
        /// More about the result, by the command.
        4 => result_param2: i32,
        /// Who asked.
        8 => target: Target,
    }

    /// The older way to set a mode.
    SetMode = SET_MODE_DATA {
        /// The mode by the autopilot's own numbers.
        0 => custom_mode: u32,
        /// System id.
        4 => system: u8,
        /// MAV_MODE_FLAG bits.
        5 => base_mode: u8,
    }
}
