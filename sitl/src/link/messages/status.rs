//! What a component says of itself.

use super::Text;

/// The longest part of a text, bytes.
pub const MAX_TEXT: usize = 50;

views! {
    /// Once a second: what the sender is, and its mode.
    Heartbeat = HEARTBEAT_DATA {
        /// The mode by the autopilot's own numbers.
        0 => custom_mode: u32,
        /// MAV_TYPE.
        4 => kind: u8,
        /// MAV_AUTOPILOT.
        5 => autopilot: u8,
        /// MAV_MODE_FLAG bits.
        6 => base_mode: u8,
        /// MAV_STATE.
        7 => system_status: u8,
        /// 3 for MAVLink 2.
        8 => mavlink_version: u8,
    }

    /// A text for people, or a part of a long one.
    StatusText = STATUSTEXT_DATA {
        /// MAV_SEVERITY: 0 (emergency) to 7 (debug).
        0 => severity: u8,
        /// Up to its first NUL. A part without one goes on in the next.
        1 => text: Text<MAX_TEXT>,
        /// The same in all parts of a text; 0: this is a whole one.
        51 => id: u16,
        /// Number of the part, from 0.
        53 => chunk_seq: u8,
    }

    /// What an autopilot can do.
    AutopilotVersion = AUTOPILOT_VERSION_DATA {
        /// MAV_PROTOCOL_CAPABILITY bits.
        0 => capabilities: u64,
    }

    /// How often a message is sent.
    MessageInterval = MESSAGE_INTERVAL_DATA {
        /// Between two messages, µs; -1 is never, 0 unknown.
        0 => interval_us: i32,
        /// Which message.
        4 => message_id: u16,
    }
}
