//! A mission item as files and people have it, and as MISSION_ITEM_INT has it.

use crpl_sitl::link::decoder::Packet;
use crpl_sitl::link::dialect::{MISSION_ITEM_DATA, MISSION_ITEM_INT_DATA};

/// MAV_FRAME_GLOBAL and its kin hold latitude and longitude.
const GLOBAL_FRAMES: [u8; 6] = [0, 3, 5, 6, 10, 11];
/// Integer twins of GLOBAL, GLOBAL_RELATIVE_ALT and GLOBAL_TERRAIN_ALT.
const INT_FRAMES: [(u8, u8); 3] = [(5, 0), (6, 3), (11, 10)];
/// MAV_FRAME_MISSION: x and y are params.
const FRAME_MISSION: u8 = 2;

/// One item. Latitude and longitude in degrees, lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Item {
    /// MAV_FRAME.
    pub frame: u8,
    /// MAV_CMD, also such as the dialect has no name for.
    pub command: u16,
    /// Whether it is the one to begin with.
    pub current: bool,
    /// Whether the next one follows by itself.
    pub autocontinue: bool,
    /// param1 to param4; NaN leaves one to the vehicle.
    pub params: [f32; 4],
    /// param5: latitude, or x.
    pub x: f64,
    /// param6: longitude, or y.
    pub y: f64,
    /// param7: height, or z.
    pub z: f32,
}

/// Units of x and y in one of the message's integers.
fn scale(frame: u8) -> f64 {
    match frame {
        FRAME_MISSION => 1.0,
        frame if GLOBAL_FRAMES.contains(&frame) => 1e7,
        _ => 1e4,
    }
}

impl Item {
    /// The payload of MISSION_ITEM_INT.
    #[must_use]
    pub fn payload(&self, sequence: u16, target: (u8, u8)) -> [u8; 38] {
        let mut payload = [0; 38];
        let scale = scale(self.frame);
        // A cast saturates, and makes 0 of what is no number.
        let [x, y] = [self.x, self.y].map(|v| (v * scale).round() as i32);
        for (k, param) in self.params.iter().enumerate() {
            payload[4 * k..4 * k + 4].copy_from_slice(&param.to_le_bytes());
        }
        payload[16..20].copy_from_slice(&x.to_le_bytes());
        payload[20..24].copy_from_slice(&y.to_le_bytes());
        payload[24..28].copy_from_slice(&self.z.to_le_bytes());
        payload[28..30].copy_from_slice(&sequence.to_le_bytes());
        payload[30..32].copy_from_slice(&self.command.to_le_bytes());
        payload[32..37].copy_from_slice(&[
            target.0,
            target.1,
            self.frame,
            u8::from(self.current),
            u8::from(self.autocontinue),
        ]);
        payload
    }

    /// The item in a MISSION_ITEM_INT or the older MISSION_ITEM, with its number.
    #[must_use]
    pub fn of(packet: &Packet) -> Option<(u16, Self)> {
        let fields = packet.fields();
        let frame = fields.u8(34);
        let place = |at| {
            if packet.is::<MISSION_ITEM_INT_DATA>() {
                f64::from(fields.u32(at) as i32) / scale(frame)
            } else {
                f64::from(fields.f32(at))
            }
        };
        if !packet.is::<MISSION_ITEM_INT_DATA>() && !packet.is::<MISSION_ITEM_DATA>() {
            return None;
        }
        let item = Self {
            // Files know the twins without INT alone.
            frame: INT_FRAMES.iter().find(|(int, _)| *int == frame).map_or(frame, |&(_, plain)| plain),
            command: fields.u16(30),
            current: fields.u8(35) != 0,
            autocontinue: fields.u8(36) != 0,
            params: std::array::from_fn(|k| fields.f32(4 * k)),
            x: place(16),
            y: place(20),
            z: fields.f32(24),
        };
        Some((fields.u16(28), item))
    }
}
