//! What a station wants a vehicle to follow.

use super::Target;

views! {
    /// Position, velocity or acceleration in a local frame.
    SetPositionTargetLocalNed = SET_POSITION_TARGET_LOCAL_NED_DATA {
        /// Since the sender or the vehicle booted, ms.
        0 => time_boot_ms: u32,
        /// North, east, down, m.
        4 => position: [f32; 3],
        /// North, east, down, m/s.
        16 => velocity: [f32; 3],
        /// North, east, down, m/s².
        28 => acceleration: [f32; 3],
        /// Yaw, rad, and its rate, rad/s.
        40 => yaw: [f32; 2],
        /// POSITION_TARGET_TYPEMASK: a set bit ignores a field.
        48 => type_mask: u16,
        /// Whom it is for.
        50 => target: Target,
        /// MAV_FRAME.
        52 => coordinate_frame: u8,
    }

    /// Position, velocity or acceleration at a place on Earth.
    SetPositionTargetGlobalInt = SET_POSITION_TARGET_GLOBAL_INT_DATA {
        /// Since the sender or the vehicle booted, ms.
        0 => time_boot_ms: u32,
        /// Latitude and longitude, 1e-7 degrees.
        4 => place: [i32; 2],
        /// Height, m, from what the frame says.
        12 => altitude: f32,
        /// North, east, down, m/s.
        16 => velocity: [f32; 3],
        /// North, east, down, m/s².
        28 => acceleration: [f32; 3],
        /// Yaw, rad, and its rate, rad/s.
        40 => yaw: [f32; 2],
        /// POSITION_TARGET_TYPEMASK: a set bit ignores a field.
        48 => type_mask: u16,
        /// Whom it is for.
        50 => target: Target,
        /// MAV_FRAME.
        52 => coordinate_frame: u8,
    }
}
