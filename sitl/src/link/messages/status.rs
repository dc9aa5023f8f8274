//! What a component says of itself.

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
