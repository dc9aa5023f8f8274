//! A mission item as files and people have it, and as MISSION_ITEM_INT has it.

use crpl_sitl::link::messages::mission::{MissionItem, Place};
use crpl_sitl::link::packet::Packet;

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
    /// The fields of MISSION_ITEM_INT; `seq` is the item's number.
    #[must_use]
    pub fn to_message(&self, seq: u16, target: (u8, u8)) -> MissionItem {
        let scale = scale(self.frame);
        MissionItem {
            params: self.params,
            // A cast saturates, and makes 0 of what is no number.
            place: [self.x, self.y].map(|v| (v * scale).round() as i32),
            z: self.z,
            seq,
            command: self.command,
            target: target.into(),
            frame: self.frame,
            current: self.current.into(),
            autocontinue: self.autocontinue.into(),
            mission_type: 0,
        }
    }

    /// The item in a MISSION_ITEM_INT or the older MISSION_ITEM, with the message's own fields.
    #[must_use]
    pub fn of(packet: &Packet) -> Option<(MissionItem, Self)> {
        let (sent, place) = MissionItem::with_place(packet)?;
        let MissionItem { params, z, command, frame, current, autocontinue, .. } = sent;
        let [x, y] = match place {
            Place::Integers(place) => place.map(|v| f64::from(v) / scale(frame)),
            Place::Floats(place) => place.map(f64::from),
        };
        // Files know the twins without INT alone.
        let plain = INT_FRAMES.iter().find(|(int, _)| *int == frame).map_or(frame, |&(_, plain)| plain);
        let (current, autocontinue) = (current != 0, autocontinue != 0);
        Some((sent, Self { frame: plain, command, current, autocontinue, params, x, y, z }))
    }
}
