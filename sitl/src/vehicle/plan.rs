//! A mission as it is flown: items, the current one, arrival, jumps. Knows no messages but its own
//! items' two forms, and no peers.
//!
//! | item | flown as |
//! |---|---|
//! | NAV_WAYPOINT (16) | to the point; param1 seconds of hold, param2 metres of acceptance, 0 for the default |
//! | NAV_LOITER_UNLIM (17) | to the point, and stays |
//! | NAV_LOITER_TIME (19), NAV_DELAY (93) | to the point, or here; param1 seconds |
//! | NAV_RETURN_TO_LAUNCH (20) | RTL |
//! | NAV_LAND (21) | to the point, or here; then LAND |
//! | NAV_TAKEOFF (22) | up, if it is on the ground |
//! | DO_JUMP (177) | to item param1, param2 times, -1 for ever |
//! | DO_CHANGE_SPEED (178) | param2 m/s, from here on |
//!
//! Points are latitude and longitude, or north and east in frame LOCAL_NED; 0, 0 is here. Heights are
//! kept and not flown: the vehicle is planar. A mission avoids nothing, so a point inside the obstacle
//! is refused while the obstacle stands; what the way between two points passes is the planner's.

use std::collections::BTreeMap;
use std::time::Duration;

use nalgebra::Vector2;

use super::modes::Mode;
use super::params::is_flyable;
use super::{Vehicle, geodesy};
use crate::link::dialect::{self, MavCmd, MavFrame, MavMissionResult, MavMissionType, MissionState};
use crate::link::messages::mission::{MissionItem, Place};
use crate::scenario::Obstacle;
use crate::world::dynamics::State;

/// What can be flown, by its number.
const COMMANDS: [(u16, MavCmd); 9] = [
    (WAYPOINT, MavCmd::MAV_CMD_NAV_WAYPOINT),
    (LOITER_UNLIM, MavCmd::MAV_CMD_NAV_LOITER_UNLIM),
    (LOITER_TIME, MavCmd::MAV_CMD_NAV_LOITER_TIME),
    (RETURN, MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH),
    (LAND, MavCmd::MAV_CMD_NAV_LAND),
    (TAKEOFF, MavCmd::MAV_CMD_NAV_TAKEOFF),
    (DELAY, MavCmd::MAV_CMD_NAV_DELAY),
    (JUMP, MavCmd::MAV_CMD_DO_JUMP),
    (SPEED, MavCmd::MAV_CMD_DO_CHANGE_SPEED),
];
const WAYPOINT: u16 = 16;
const LOITER_UNLIM: u16 = 17;
const LOITER_TIME: u16 = 19;
const RETURN: u16 = 20;
const LAND: u16 = 21;
const TAKEOFF: u16 = 22;
const DELAY: u16 = 93;
const JUMP: u16 = 177;
const SPEED: u16 = 178;

/// The frames that an item may have, by their number.
const FRAMES: [(u8, MavFrame); 6] = [
    (0, MavFrame::MAV_FRAME_GLOBAL),
    (LOCAL_NED, MavFrame::MAV_FRAME_LOCAL_NED),
    (MISSION_FRAME, MavFrame::MAV_FRAME_MISSION),
    (3, MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT),
    (5, MavFrame::MAV_FRAME_GLOBAL_INT),
    (6, MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT),
];
const LOCAL_NED: u8 = 1;
const MISSION_FRAME: u8 = 2;

/// Items that are looked at in one interval: jumps can go round in circles.
const MAX_STEPS: usize = 64;

/// An item as it was uploaded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StoredItem {
    command: u16,
    frame: u8,
    params: [f32; 4],
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

    /// StoredItem 0: where the vehicle returns to.
    pub fn home([x, y]: [i32; 2]) -> Self {
        let z = geodesy::HOME[2] as f32;
        Self { command: WAYPOINT, frame: 0, params: [0.0; 4], x, y, z, autocontinue: 1 }
    }

    /// MISSION_ITEM_INT.
    pub fn as_int(&self, seq: u16, current: u8, asker: (u8, u8)) -> dialect::MISSION_ITEM_INT_DATA {
        let [param1, param2, param3, param4] = self.params;
        dialect::MISSION_ITEM_INT_DATA {
            param1,
            param2,
            param3,
            param4,
            x: self.x,
            y: self.y,
            z: self.z,
            seq,
            command: self.typed_command(),
            target_system: asker.0,
            target_component: asker.1,
            frame: self.typed_frame(),
            current,
            autocontinue: self.autocontinue,
            mission_type: MavMissionType::MAV_MISSION_TYPE_MISSION,
        }
    }

    /// MISSION_ITEM.
    pub fn as_float(&self, seq: u16, current: u8, asker: (u8, u8)) -> dialect::MISSION_ITEM_DATA {
        let int = self.as_int(seq, current, asker);
        let [x, y] = [int.x, int.y].map(|v| (f64::from(v) / per_unit(self.frame)) as f32);
        dialect::MISSION_ITEM_DATA {
            param1: int.param1,
            param2: int.param2,
            param3: int.param3,
            param4: int.param4,
            x,
            y,
            z: int.z,
            seq: int.seq,
            command: int.command,
            target_system: int.target_system,
            target_component: int.target_component,
            frame: int.frame,
            current: int.current,
            autocontinue: int.autocontinue,
            mission_type: int.mission_type,
        }
    }

    // StoredItem 0 may be anything, and is told as home; all others have passed `Vehicle::fault`.
    fn typed_command(&self) -> MavCmd {
        COMMANDS.iter().find(|(number, _)| *number == self.command).map_or(COMMANDS[0].1, |(_, known)| *known)
    }

    fn typed_frame(&self) -> MavFrame {
        FRAMES.iter().find(|(number, _)| *number == self.frame).map_or(FRAMES[0].1, |(_, known)| *known)
    }

    fn needs_place(&self) -> bool {
        matches!(self.command, WAYPOINT | LOITER_UNLIM | LOITER_TIME | LAND)
    }

    /// North and east, m; `None` is here.
    fn place(&self) -> Option<[f32; 2]> {
        if !self.needs_place() || (self.x, self.y) == (0, 0) && self.frame != LOCAL_NED {
            return None;
        }
        let coordinates = [self.x, self.y].map(|v| f64::from(v) / per_unit(self.frame));
        Some(if self.frame == LOCAL_NED {
            coordinates.map(|v| v as f32)
        } else {
            geodesy::north_east(coordinates)
        })
    }
}

/// An integer coordinate's steps in a degree or a metre.
fn per_unit(frame: u8) -> f64 {
    if frame == LOCAL_NED { 1e4 } else { 1e7 }
}

/// A mission and how far it is flown.
#[derive(Debug, Clone, Default)]
pub(super) struct StoredMission {
    items: Vec<StoredItem>,
    current: u16,
    /// Intervals since the current item's point was reached.
    arrived: Option<u64>,
    jumps: BTreeMap<u16, u32>,
    /// The point that was reached last: where it waits behind the last item.
    last: Option<Vector2<f64>>,
    begun: bool,
}

impl StoredMission {
    /// A mission that nobody has begun.
    pub fn new(items: Vec<StoredItem>) -> Self {
        Self { current: u16::from(items.len() > 1), items, ..Self::default() }
    }

    /// Whether the items fit together: jumps need somewhere to go.
    pub fn check(items: &[StoredItem]) -> Result<(), Fault> {
        let lost =
            |item: &&StoredItem| item.command == JUMP && !(1.0..items.len() as f32).contains(&item.params[0]);
        let why = "a jump leads out of it";
        let fault = Fault { result: MavMissionResult::MAV_MISSION_INVALID_PARAM1, why };
        items.iter().skip(1).find(lost).map_or(Ok(()), |_| Err(fault))
    }

    /// All items, home first.
    pub fn items(&self) -> &[StoredItem] {
        &self.items
    }

    /// The item that is flown, or would be.
    pub fn current(&self) -> u16 {
        self.current
    }

    /// The current item's point, north and east, m.
    pub fn place(&self) -> Option<[f32; 2]> {
        self.items.get(usize::from(self.current)).and_then(StoredItem::place)
    }

    /// Goes on with that item, if there is one.
    pub fn go_to(&mut self, seq: u16) -> bool {
        if usize::from(seq) >= self.items.len() {
            return false;
        }
        (self.current, self.arrived) = (seq, None);
        true
    }

    /// Jumps count anew.
    pub fn reset(&mut self) {
        self.jumps.clear();
        self.begun = false;
    }

    /// A number that changes with the mission: FNV-1a over what its items say; 0 without any.
    pub fn id(&self) -> u32 {
        let mut hash = 0x811c_9dc5_u32;
        let mut take = |bytes: &[u8]| {
            for &byte in bytes {
                hash = (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
            }
        };
        for item in self.items.iter().skip(1) {
            take(&item.command.to_le_bytes());
            take(&[item.frame, item.autocontinue]);
            item.params.iter().chain([&item.z]).for_each(|value| take(&value.to_le_bytes()));
            take(&item.x.to_le_bytes());
            take(&item.y.to_le_bytes());
        }
        if self.items.is_empty() { 0 } else { hash.max(1) }
    }

    /// Whether its last item is behind it.
    pub fn is_over(&self) -> bool {
        usize::from(self.current) >= self.items.len()
    }

    /// MISSION_CURRENT; `flying` in AUTO.
    pub fn status(&self, flying: bool) -> dialect::MISSION_CURRENT_DATA {
        let last = (self.items.len() as u16).saturating_sub(1);
        let mission_state = match (self.items.len(), self.is_over(), self.begun, flying) {
            (0 | 1, ..) => MissionState::MISSION_STATE_NO_MISSION,
            (_, true, ..) => MissionState::MISSION_STATE_COMPLETE,
            (_, _, _, true) => MissionState::MISSION_STATE_ACTIVE,
            (_, _, true, _) => MissionState::MISSION_STATE_PAUSED,
            (_, _, false, _) => MissionState::MISSION_STATE_NOT_STARTED,
        };
        dialect::MISSION_CURRENT_DATA {
            seq: self.current.min(last),
            total: last,
            mission_state,
            // 1: in mission mode, 2: suspended.
            mission_mode: if flying { 1 } else { 2 },
            mission_id: self.id(),
            ..Default::default()
        }
    }
}

impl Vehicle {
    /// What keeps an item from being flown.
    pub(super) fn fault(&self, item: &StoredItem) -> Result<(), Fault> {
        let no = |result, why| Err(Fault { result, why });
        if !COMMANDS.iter().any(|(number, _)| *number == item.command) {
            return no(MavMissionResult::MAV_MISSION_UNSUPPORTED, "its command is not flown");
        }
        if !FRAMES.iter().any(|(number, _)| *number == item.frame)
            || item.frame == MISSION_FRAME && item.needs_place()
        {
            return no(MavMissionResult::MAV_MISSION_UNSUPPORTED_FRAME, "its frame is not flown");
        }
        let [first, second, ..] = item.params;
        match item.command {
            WAYPOINT | LOITER_TIME | DELAY if first < 0.0 || first.is_infinite() => {
                return no(MavMissionResult::MAV_MISSION_INVALID_PARAM1, "its time is below 0 or infinite");
            }
            WAYPOINT if second < 0.0 || second.is_infinite() => {
                return no(MavMissionResult::MAV_MISSION_INVALID_PARAM2, "its radius is below 0 or infinite");
            }
            SPEED if second != -1.0 && second != -2.0 && !self.takes_speed(second.into()) => {
                return no(MavMissionResult::MAV_MISSION_INVALID_PARAM2, "its speed is out of range");
            }
            _ => {}
        }
        let Some(place) = item.place() else { return Ok(()) };
        let Some(place) = self.inside(place) else {
            let inside = |ne: [f32; 2]| self.inside(ne).is_some();
            let centre = 0.5 * self.sim.scenario().scale.metres_per_unit as f32;
            return if inside([place[0], centre]) {
                no(MavMissionResult::MAV_MISSION_INVALID_PARAM6_Y, "east or west of the square")
            } else {
                no(MavMissionResult::MAV_MISSION_INVALID_PARAM5_X, "north or south of the square")
            };
        };
        let (world, scenario) = (self.sim.world(), self.sim.scenario());
        let is_inside = |(state, obstacle): (&State, &Obstacle)| {
            let reach = obstacle.radius + scenario.uav_radius;
            state.v == Vector2::zeros() && (place - state.r).norm() < reach
        };
        if world.obstacles.iter().zip(&scenario.obstacles).any(is_inside) {
            return no(MavMissionResult::MAV_MISSION_INVALID_PARAM5_X, "inside the obstacle");
        }
        Ok(())
    }

    /// Whether it can fly by itself at so many m/s.
    fn takes_speed(&self, mps: f64) -> bool {
        let mut settings = self.settings.clone();
        settings.autopilot.speed_mps = mps;
        is_flyable(&settings)
    }

    /// The fastest that the vehicle flies, m/s.
    pub(super) fn top_speed_mps(&self) -> f64 {
        let scenario = self.sim.scenario();
        scenario.dynamics.v_max * scenario.scale.mps_per_speed()
    }

    /// Where AUTO flies in the interval that begins now; `None` stays here. Goes on to the next items
    /// as they are done.
    pub(super) fn mission_target(&mut self, now: Duration) -> Option<Vector2<f64>> {
        if !self.plan.begun {
            self.plan.begun = true;
            self.tell_current(now);
        }
        for _ in 0..MAX_STEPS {
            let seq = self.plan.current;
            let Some(&item) = self.plan.items.get(usize::from(seq)).filter(|_| seq > 0) else {
                return self.plan.last;
            };
            match item.command {
                JUMP => {
                    self.jump(seq, &item);
                    continue;
                }
                SPEED => drop(self.change_speed(item.params[0], item.params[1], now)),
                RETURN => {
                    self.reached(seq, now);
                    self.enter(Mode::Return, now);
                    return Some(self.sim.scenario().start);
                }
                // Only on the ground is there something to do, and AUTO climbs by itself then.
                TAKEOFF => self.reached(seq, now),
                _ => {
                    let place = item.place().and_then(|place| self.inside(place));
                    if !self.done(&item, place, now) {
                        return place;
                    }
                    if item.command == LAND {
                        self.enter(Mode::Land, now);
                        return None;
                    }
                }
            }
            self.next_item(seq + 1, now);
        }
        None
    }

    /// Whether the vehicle has been long enough where this item wants it.
    fn done(&mut self, item: &StoredItem, place: Option<Vector2<f64>>, now: Duration) -> bool {
        let Some(intervals) = self.plan.arrived else {
            let acceptance = f64::from(item.params[1]);
            let there = place.is_none_or(|place| {
                let metres =
                    (self.sim.world().uav.r - place).norm() * self.sim.scenario().scale.metres_per_unit;
                if item.command == WAYPOINT && acceptance > 0.0 {
                    metres <= acceptance
                } else {
                    metres <= self.settings.autopilot.acceptance_m
                }
            });
            if there {
                self.plan.arrived = Some(0);
                self.plan.last = place.or(Some(self.sim.world().uav.r));
                self.reached(self.plan.current, now);
            }
            let passes = matches!(item.command, WAYPOINT | LOITER_TIME | DELAY | LAND);
            return there && passes && seconds_held(item) <= 0.0;
        };
        let intervals = intervals + 1;
        self.plan.arrived = Some(intervals);
        item.command != LOITER_UNLIM && intervals as f64 * self.clock.interval_s() >= seconds_held(item)
    }

    fn jump(&mut self, seq: u16, item: &StoredItem) {
        let times = item.params[1];
        let jumped = self.plan.jumps.entry(seq).or_default();
        let again = times < 0.0 || f64::from(*jumped) < f64::from(times);
        if again {
            *jumped = jumped.saturating_add(1);
        }
        self.plan.current = if again { item.params[0] as u16 } else { seq + 1 };
        self.plan.arrived = None;
    }

    fn next_item(&mut self, seq: u16, now: Duration) {
        self.plan.current = seq;
        self.plan.arrived = None;
        if self.plan.is_over() {
            self.notice("mission over", "mission complete", now);
        }
        self.tell_current(now);
    }

    fn reached(&mut self, seq: u16, now: Duration) {
        self.tell_all(&dialect::MISSION_ITEM_REACHED_DATA { seq });
        tracing::debug!(seq, ?now, "mission item reached");
    }
}

/// How long an item stays at its point.
fn seconds_held(item: &StoredItem) -> f64 {
    match item.command {
        // A number that is none becomes no time at all.
        WAYPOINT | LOITER_TIME | DELAY => f64::from(item.params[0].max(0.0)),
        _ => 0.0,
    }
}
