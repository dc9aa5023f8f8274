//! What a station wants a vehicle to follow: SET_POSITION_TARGET_LOCAL_NED and SET_POSITION_TARGET_GLOBAL_INT.
//! Knows masks and frames, not where the vehicle is.
//!
//! | frame | position | velocity, acceleration |
//! |---|---|---|
//! | LOCAL_NED (1) | north, east, down of the origin, m | north, east, down |
//! | LOCAL_OFFSET_NED (7) | north, east, down of the vehicle, m | north, east, down |
//! | BODY_NED (8), BODY_OFFSET_NED (9), BODY_FRD (12) | forward, right, down of the vehicle, m | forward, right, down |
//! | GLOBAL (0), GLOBAL_INT (5) | 1e-7 degrees; m above the sea | north, east, down |
//! | GLOBAL_RELATIVE_ALT (3), its INT (6), GLOBAL_TERRAIN_ALT (10), its INT (11) | 1e-7 degrees; m above home | north, east, down |
//!
//! The mask is read as ArduCopter reads it, but for one thing: what is down is asked for or ignored by itself, so
//! a velocity to the north can come with a height. An ignored x or y ignores both. What the mask ignores is not
//! looked at. A yaw that is not finite is none.

use super::Above;
use crate::link::messages::setpoint::{SetPositionTargetGlobalInt, SetPositionTargetLocalNed};
use crate::link::messages::{Target, View};
use crate::link::packet::Packet;

const FRAME_LOCAL_NED: u8 = 1;
const FRAME_LOCAL_OFFSET_NED: u8 = 7;
/// BODY_NED, BODY_OFFSET_NED and BODY_FRD.
const FRAMES_BODY: [u8; 3] = [8, 9, 12];

const MASK_FORCE: u16 = 512;
const MASK_IGNORES_YAW: u16 = 1024;
const MASK_IGNORES_YAW_RATE: u16 = 2048;

/// In which terms a setpoint is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SetpointFrame {
    /// North, east, down; places from the origin of the local frame.
    Local,
    /// North, east, down; places from the vehicle.
    Offset,
    /// Forward, right, down; places from the vehicle.
    Body,
    /// Places in degrees, heights above the sea; else north, east, down.
    Sea,
    /// Places in degrees, heights above home; else north, east, down.
    Home,
}

/// A quantity of a setpoint; what is ignored is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Axes {
    /// The first two components.
    pub level: Option<[f64; 2]>,
    /// Down.
    pub down: Option<f64>,
}

impl Axes {
    fn is_empty(&self) -> bool {
        self.level.is_none() && self.down.is_none()
    }

    fn is_finite(&self) -> bool {
        self.level.iter().flatten().chain(&self.down).all(|value| value.is_finite())
    }

    /// Those of three components that three bits of a mask, from `shift` on, leave.
    fn of([x, y, down]: [f64; 3], mask: u16, shift: u16) -> Self {
        let bits = mask >> shift;
        Self { level: (bits & 0b11 == 0).then_some([x, y]), down: (bits & 0b100 == 0).then_some(down) }
    }
}

/// What a station wants a vehicle to follow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setpoint {
    /// Its `time_boot_ms`, the station's or ours.
    pub stamp_ms: u32,
    /// Of the quantities below.
    pub frame: SetpointFrame,
    /// m, or degrees of latitude and longitude; down in m.
    pub position: Axes,
    /// m/s
    pub velocity: Axes,
    /// m/s²
    pub acceleration: Axes,
    /// rad, clockwise from north; in a body frame from where the vehicle looks.
    pub yaw: Option<f32>,
    /// rad/s, clockwise.
    pub yaw_rate: Option<f32>,
}

impl Setpoint {
    /// North and east, m/s², of the setpoint that CRPL's stations send: an acceleration of the plane alone.
    #[must_use]
    pub fn level_acceleration(&self) -> Option<[f32; 2]> {
        let alone = self.position.is_empty() && self.velocity.is_empty();
        let stays = self.acceleration.down.is_none_or(|down| down == 0.0);
        let level = self.acceleration.level.map(|level| level.map(|value| value as f32));
        level.filter(|_| alone && stays && self.frame != SetpointFrame::Body)
    }
}

/// Why a setpoint is not flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Refusal {
    /// Another coordinate frame.
    #[error("setpoint refused: its frame is not flown")]
    Frame,
    /// The mask ignores everything.
    #[error("setpoint refused: its mask ignores all")]
    Empty,
    /// Force in place of acceleration.
    #[error("setpoint refused: force bit set")]
    Force,
    /// A field that matters is infinite or not a number.
    #[error("setpoint refused: not finite")]
    NotFinite,
    /// Latitude or longitude beyond their ranges.
    #[error("setpoint refused: no place on Earth")]
    NoPlace,
}

impl Refusal {
    /// A word that tells it from the others.
    #[must_use]
    pub fn kind(self) -> &'static str {
        match self {
            Self::Frame => "refused frame",
            Self::Empty => "refused mask",
            Self::Force => "refused force",
            Self::NotFinite => "refused value",
            Self::NoPlace => "refused place",
        }
    }
}

/// The setpoint in a packet, and whom it is for.
#[must_use]
pub fn setpoint_of(packet: &Packet) -> Option<(Target, Result<Setpoint, Refusal>)> {
    if let Some(asked) = SetPositionTargetLocalNed::of(packet) {
        let frame = match asked.coordinate_frame {
            FRAME_LOCAL_NED => Some(SetpointFrame::Local),
            FRAME_LOCAL_OFFSET_NED => Some(SetpointFrame::Offset),
            frame => FRAMES_BODY.contains(&frame).then_some(SetpointFrame::Body),
        };
        return Some((asked.target, checked(&asked, asked.position.map(f64::from), frame)));
    }
    let asked = SetPositionTargetGlobalInt::of(packet)?;
    let frame = Above::of_frame(asked.coordinate_frame).map(|above| match above {
        Above::Sea => SetpointFrame::Sea,
        Above::Home => SetpointFrame::Home,
    });
    let [latitude, longitude] = asked.place.map(|value| f64::from(value) / 1e7);
    let position = [latitude, longitude, -f64::from(asked.altitude)];
    // All that follows the place is the same in both messages.
    let alike = SetPositionTargetLocalNed {
        time_boot_ms: asked.time_boot_ms,
        position: [0.0; 3],
        velocity: asked.velocity,
        acceleration: asked.acceleration,
        yaw: asked.yaw,
        type_mask: asked.type_mask,
        target: asked.target,
        coordinate_frame: asked.coordinate_frame,
    };
    Some((asked.target, checked(&alike, position, frame)))
}

/// What is asked at `position`, if it can be followed.
fn checked(
    asked: &SetPositionTargetLocalNed,
    position: [f64; 3],
    frame: Option<SetpointFrame>,
) -> Result<Setpoint, Refusal> {
    let mask = asked.type_mask;
    let frame = frame.ok_or(Refusal::Frame)?;
    let turn = |value: f32, ignores: u16| Some(value).filter(|v| mask & ignores == 0 && v.is_finite());
    let setpoint = Setpoint {
        stamp_ms: asked.time_boot_ms,
        frame,
        position: Axes::of(position, mask, 0),
        velocity: Axes::of(asked.velocity.map(f64::from), mask, 3),
        acceleration: Axes::of(asked.acceleration.map(f64::from), mask, 6),
        yaw: turn(asked.yaw[0], MASK_IGNORES_YAW),
        yaw_rate: turn(asked.yaw[1], MASK_IGNORES_YAW_RATE),
    };
    let moves = [setpoint.position, setpoint.velocity, setpoint.acceleration];
    if mask & MASK_FORCE != 0 {
        return Err(Refusal::Force);
    }
    if moves.iter().all(Axes::is_empty) && setpoint.yaw.is_none() && setpoint.yaw_rate.is_none() {
        return Err(Refusal::Empty);
    }
    if !moves.iter().all(Axes::is_finite) {
        return Err(Refusal::NotFinite);
    }
    let is_global = matches!(frame, SetpointFrame::Sea | SetpointFrame::Home);
    if is_global && setpoint.position.level.is_some_and(|place| !super::on_globe(&place)) {
        return Err(Refusal::NoPlace);
    }
    Ok(setpoint)
}
