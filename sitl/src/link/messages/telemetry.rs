//! Where the vehicle is, what it follows, and named values.

use super::Text;

views! {
    /// Where the vehicle is in its local frame.
    LocalPositionNed = LOCAL_POSITION_NED_DATA {
        /// Since the vehicle booted, ms.
        0 => time_boot_ms: u32,
        /// North, east, down, m.
        4 => position: [f32; 3],
        /// North, east, down, m/s.
        16 => velocity: [f32; 3],
    }

    /// Where the vehicle is on Earth.
    GlobalPositionInt = GLOBAL_POSITION_INT_DATA {
        /// Since the vehicle booted, ms.
        0 => time_boot_ms: u32,
        /// Latitude and longitude, 1e-7 degrees.
        4 => place: [i32; 2],
        /// Height above sea level and above home, mm.
        12 => heights: [i32; 2],
        /// North, east, down, cm/s.
        20 => velocity: [i16; 3],
        /// Heading, 0.01 degrees; 65535 is unknown.
        26 => heading: u16,
    }

    /// The setpoint that the vehicle follows.
    PositionTargetLocalNed = POSITION_TARGET_LOCAL_NED_DATA {
        /// Since the vehicle booted, ms.
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
        /// MAV_FRAME.
        50 => coordinate_frame: u8,
    }

    /// A named vector.
    DebugVect = DEBUG_VECT_DATA {
        /// Since 1970 or since boot, µs.
        0 => time_usec: u64,
        /// Its x, y, z, in units of its own.
        8 => vector: [f32; 3],
        /// Its name.
        20 => name: Text<10>,
    }

    /// A named number.
    NamedValueFloat = NAMED_VALUE_FLOAT_DATA {
        /// Since the sender booted, ms.
        0 => time_boot_ms: u32,
        /// Its value, in units of its own.
        4 => value: f32,
        /// Its name.
        8 => name: Text<10>,
    }
}
