//! One item of a mission, a fence or the rally points: what it is to the vehicle, where, and what is wrong with it.

use super::geodesy::Site;
use crate::link::dialect::{MavMissionResult, MavMissionType};
use crate::link::messages::mission::{MissionItem, Place};
use crate::link::wire::Above;

/// What an item is to the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Waypoint,
    LoiterUnlimited,
    /// At the point, or here, for some seconds.
    Wait,
    /// To the point and the height, and on.
    Pass,
    Height,
    Return,
    Land,
    Takeoff,
    Jump,
    Speed,
    Yaw,
    /// Kept and passed.
    Kept,
}

impl Role {
    /// The role of a MAV_CMD; `None` for what no mission holds.
    fn of(command: u16) -> Option<Self> {
        Some(match command {
            WAYPOINT | 82 => Self::Waypoint,
            17 => Self::LoiterUnlimited,
            19 | 93 => Self::Wait,
            18 | 31 | 94 => Self::Pass,
            30 => Self::Height,
            20 => Self::Return,
            21 | 85 => Self::Land,
            22 | 84 => Self::Takeoff,
            177 => Self::Jump,
            178 => Self::Speed,
            115 => Self::Yaw,
            // NAV_ROI and NAV_GUIDED_ENABLE are no ways either; the others are the standard's and ArduPilot's
            // ranges of CONDITION and DO commands.
            80 | 92 | 112..=114 | 159..=252 | 530..=534 | 2000..=2999 | 4501..=4502 | 42_000..=43_099 => {
                Self::Kept
            }
            _ => return None,
        })
    }

    fn has_place(self) -> bool {
        matches!(self, Self::Waypoint | Self::LoiterUnlimited | Self::Wait | Self::Pass | Self::Land)
    }

    fn has_height(self) -> bool {
        matches!(
            self,
            Self::Waypoint | Self::LoiterUnlimited | Self::Wait | Self::Pass | Self::Height | Self::Takeoff
        )
    }
}

pub(super) const WAYPOINT: u16 = 16;
pub(super) const DELAY: u16 = 93;
pub(super) const LOCAL_NED: u8 = 1;

/// An item as it was uploaded: of a mission, a fence or the rally points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StoredItem {
    pub command: u16,
    pub frame: u8,
    pub params: [f32; 4],
    /// 1e-7 degrees, or 1e-4 m in LOCAL_NED.
    x: i32,
    y: i32,
    z: f32,
    autocontinue: u8,
}

/// What is wrong with an item.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fault {
    pub result: MavMissionResult,
    pub why: &'static str,
}

impl Fault {
    /// A refusal with its reason.
    pub fn of(result: MavMissionResult, why: &'static str) -> Self {
        Self { result, why }
    }
}

impl StoredItem {
    /// The item of a message, at `place`.
    pub fn of(sent: &MissionItem, place: Place) -> Self {
        let MissionItem { params, z, command, frame, autocontinue, .. } = *sent;
        let [x, y] = match place {
            Place::Integers(place) => place,
            // What is no number becomes 0.
            Place::Floats(place) => place.map(|v| (f64::from(v) * per_unit(frame)).round() as i32),
        };
        Self { command, frame, params, x, y, z, autocontinue }
    }

    /// Item 0 of a mission: where the vehicle returns to.
    pub fn home([x, y]: [i32; 2], altitude_m: f64) -> Self {
        let z = altitude_m as f32;
        Self { command: WAYPOINT, frame: 0, params: [0.0; 4], x, y, z, autocontinue: 1 }
    }

    /// The fields of MISSION_ITEM_INT; of MISSION_ITEM, whose place is in floats, if `as_int` is false.
    pub fn told(&self, seq: u16, as_int: bool, to: (u8, u8), list: MavMissionType) -> MissionItem {
        let float = |v: i32| ((f64::from(v) / per_unit(self.frame)) as f32).to_bits() as i32;
        let place = [self.x, self.y].map(|v| if as_int { v } else { float(v) });
        MissionItem {
            params: self.params,
            place,
            z: self.z,
            seq,
            command: self.command,
            target: to.into(),
            frame: self.frame,
            current: 0,
            autocontinue: self.autocontinue,
            mission_type: list as u8,
        }
    }

    pub fn role(&self) -> Role {
        Role::of(self.command).unwrap_or(Role::Kept)
    }

    /// Whether it is kept, told, and not carried out.
    pub fn is_kept_only(&self) -> bool {
        self.role() == Role::Kept
    }

    /// North and east of the origin, m; `None` is here.
    pub fn place(&self, site: &Site) -> Option<[f32; 2]> {
        if !self.role().has_place() || self.is_here() { None } else { Some(self.north_east(site)) }
    }

    /// Whether it has no place of its own: both coordinates are 0 on Earth, or the greatest integer.
    fn is_here(&self) -> bool {
        let none = if self.frame == LOCAL_NED { i32::MAX } else { 0 };
        self.command == DELAY || [(none, none), (i32::MAX, i32::MAX)].contains(&(self.x, self.y))
    }

    /// The same of an item that has a place whatever its numbers are.
    pub fn north_east(&self, site: &Site) -> [f32; 2] {
        let coordinates = self.coordinates();
        if self.frame == LOCAL_NED { coordinates.map(|v| v as f32) } else { site.north_east(coordinates) }
    }

    /// Degrees, or metres in LOCAL_NED.
    fn coordinates(&self) -> [f64; 2] {
        [self.x, self.y].map(|v| f64::from(v) / per_unit(self.frame))
    }

    /// Whether its frame is one in which points are told here.
    pub fn frame_has_places(&self) -> bool {
        self.frame == LOCAL_NED || Above::of_frame(self.frame).is_some()
    }

    /// What keeps its coordinates from being a place.
    pub fn place_fault(&self) -> Result<(), Fault> {
        let [latitude, longitude] = self.coordinates();
        if self.frame != LOCAL_NED && latitude.abs() > 90.0 {
            return Err(Fault::of(MavMissionResult::MAV_MISSION_INVALID_PARAM5_X, "no latitude"));
        }
        if self.frame != LOCAL_NED && longitude.abs() > 180.0 {
            return Err(Fault::of(MavMissionResult::MAV_MISSION_INVALID_PARAM6_Y, "no longitude"));
        }
        Ok(())
    }

    /// The height above home to which it is flown, m; `None` is the present one.
    pub fn height_m(&self, site: &Site) -> Option<f64> {
        let z = f64::from(self.z);
        let is_present = z.is_nan() || z == 0.0 && self.frame != LOCAL_NED;
        if !self.role().has_height() || self.command == DELAY || is_present {
            return None;
        }
        match Above::of_frame(self.frame) {
            Some(Above::Sea) => Some(z - site.altitude_m),
            Some(Above::Home) => Some(z),
            None => (self.frame == LOCAL_NED).then_some(-z),
        }
    }

    /// What keeps it from being flown, whatever the vehicle can do.
    pub fn fault(&self) -> Result<(), Fault> {
        let Some(role) = Role::of(self.command) else {
            return Err(Fault::of(MavMissionResult::MAV_MISSION_UNSUPPORTED, "its command is not flown"));
        };
        if role.has_place() && self.command != DELAY && !self.frame_has_places() {
            let result = MavMissionResult::MAV_MISSION_UNSUPPORTED_FRAME;
            return Err(Fault::of(result, "its frame is not flown"));
        }
        let [first, second, ..] = self.params;
        let bad = |value: f32| value < 0.0 || value.is_infinite();
        if matches!(role, Role::Waypoint | Role::Wait) && bad(first) {
            let result = MavMissionResult::MAV_MISSION_INVALID_PARAM1;
            return Err(Fault::of(result, "its time is below 0 or infinite"));
        }
        if role == Role::Waypoint && bad(second) {
            let result = MavMissionResult::MAV_MISSION_INVALID_PARAM2;
            return Err(Fault::of(result, "its radius is below 0 or infinite"));
        }
        if role.has_height() && self.z.is_infinite() {
            return Err(Fault::of(MavMissionResult::MAV_MISSION_INVALID_PARAM7, "its height is infinite"));
        }
        if role.has_place() && !self.is_here() { self.place_fault() } else { Ok(()) }
    }
}

/// An integer coordinate's steps in a degree or a metre.
fn per_unit(frame: u8) -> f64 {
    if frame == LOCAL_NED { 1e4 } else { 1e7 }
}

/// A number that changes with a list: FNV-1a over what its items say; 0 without any.
pub(super) fn list_id(items: &[StoredItem]) -> u32 {
    let mut hash = 0x811c_9dc5_u32;
    let mut take = |bytes: &[u8]| {
        for &byte in bytes {
            hash = (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        }
    };
    for item in items {
        take(&item.command.to_le_bytes());
        take(&[item.frame, item.autocontinue]);
        item.params.iter().chain([&item.z]).for_each(|value| take(&value.to_le_bytes()));
        take(&item.x.to_le_bytes());
        take(&item.y.to_le_bytes());
    }
    if items.is_empty() { 0 } else { hash.max(1) }
}
