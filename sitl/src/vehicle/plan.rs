//! A mission as it is flown: items, the current one, arrival, jumps. Knows no messages but its own
//! items' two forms, and no peers.
//!
//! | item | flown as |
//! |---|---|
//! | NAV_WAYPOINT (16), NAV_SPLINE_WAYPOINT (82) | to the point; param1 seconds of hold, param2 metres of acceptance, 0 for the default |
//! | NAV_LOITER_UNLIM (17) | to the point, and stays |
//! | NAV_LOITER_TIME (19), NAV_DELAY (93) | to the point, or here; param1 seconds |
//! | NAV_LOITER_TURNS (18), NAV_LOITER_TO_ALT (31), NAV_PAYLOAD_PLACE (94) | to the point and its height, and on: it does not circle and drops nothing |
//! | NAV_CONTINUE_AND_CHANGE_ALT (30) | to the height |
//! | NAV_RETURN_TO_LAUNCH (20) | RTL |
//! | NAV_LAND (21), NAV_VTOL_LAND (85) | to the point, or here; then LAND |
//! | NAV_TAKEOFF (22), NAV_VTOL_TAKEOFF (84) | up to its height, never down |
//! | DO_JUMP (177) | to item param1, param2 times, -1 for ever |
//! | DO_CHANGE_SPEED (178) | param2 m/s, from here on; param1 as in the command |
//! | CONDITION_YAW (115) | turns, and goes on at once |
//! | every other DO and CONDITION command | kept, told on download, and passed: the vehicle has no camera to point and no servo |
//!
//! Points are latitude and longitude, or north and east in frame LOCAL_NED; 0, 0 is here, and a height of 0
//! above home or the sea the present one, as with ArduCopter. A point outside the walls is flown to their edge,
//! which the upload says. A mission avoids nothing, so a point inside the obstacle is refused while the obstacle
//! stands; what the way between two points passes is the planner's.
//!
//! An interval passes one point at most, however near the next one is.

use std::collections::BTreeMap;
use std::time::Duration;

use nalgebra::Vector2;

use super::conduct::Mode;
use super::geodesy::Site;
use super::item::{Fault, Role, StoredItem, list_id};
use super::params::is_flyable;
use super::{Vehicle, height};
use crate::link::dialect::{self, MavMissionResult, MissionState};
use crate::scenario::Obstacle;
use crate::world::dynamics::State;

/// How far below its height a takeoff is done, m.
const TAKEOFF_SLACK_M: f64 = 1.0;

/// Items that are looked at in one interval: jumps can go round in circles.
const MAX_STEPS: usize = 64;

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
    /// The height, m, of the last item that had one.
    height_m: Option<f64>,
    begun: bool,
}

impl StoredMission {
    /// A mission that nobody has begun.
    pub fn new(items: Vec<StoredItem>) -> Self {
        Self { current: u16::from(items.len() > 1), items, ..Self::default() }
    }

    /// Whether the items fit together: jumps need somewhere to go.
    pub fn check(items: &[StoredItem]) -> Result<(), Fault> {
        let lost = |item: &&StoredItem| {
            item.role() == Role::Jump && !(1.0..items.len() as f32).contains(&item.params[0])
        };
        let fault = Fault::of(MavMissionResult::MAV_MISSION_INVALID_PARAM1, "a jump leads out of it");
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

    /// The current item's point, north and east of the origin, m.
    pub fn place(&self, site: &Site) -> Option<[f32; 2]> {
        self.flown().and_then(|item| item.place(site))
    }

    /// The item that is flown, or would be: the first where home is current.
    fn flown(&self) -> Option<&StoredItem> {
        self.items.get(usize::from(self.current.max(1)))
    }

    /// The same mission, as if it had just come.
    pub fn restart(&mut self) {
        *self = Self::new(std::mem::take(&mut self.items));
    }

    /// AUTO begins anew: the height of former items counts no longer.
    pub fn resume(&mut self) {
        self.height_m = None;
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

    /// A number that changes with the mission.
    pub fn id(&self) -> u32 {
        if self.items.is_empty() { 0 } else { list_id(&self.items[1..]).max(1) }
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
        item.fault()?;
        let [kind, speed, ..] = item.params;
        if item.role() == Role::Speed && (speed.is_nan() || speed > 0.0 && !self.takes_speed(kind, speed)) {
            let result = MavMissionResult::MAV_MISSION_INVALID_PARAM2;
            return Err(Fault::of(result, "its speed is out of range"));
        }
        let Some(place) = item.place(&self.site) else { return Ok(()) };
        let (world, scenario) = (self.sim.world(), self.sim.scenario());
        if !scenario.dynamics.walls && self.inside(place).is_none() {
            return Err(Fault::of(MavMissionResult::MAV_MISSION_INVALID_PARAM5_X, "too far away"));
        }
        let place = self.nearest(place);
        let is_inside = |(state, obstacle): (&State, &Obstacle)| {
            let reach = obstacle.radius + scenario.uav_radius;
            state.v == Vector2::zeros() && (place - state.r).norm() < reach
        };
        if world.obstacles.iter().zip(&scenario.obstacles).any(is_inside) {
            return Err(Fault::of(MavMissionResult::MAV_MISSION_INVALID_PARAM5_X, "inside the obstacle"));
        }
        Ok(())
    }

    /// How many items of a mission lie outside the walls.
    pub(super) fn count_outside(&self, items: &[StoredItem]) -> usize {
        let places = items.iter().skip(1).filter_map(|item| item.place(&self.site));
        places.filter(|place| self.inside(*place).is_none()).count()
    }

    /// Whether it can fly by itself at so many m/s, of the kind that DO_CHANGE_SPEED names.
    fn takes_speed(&self, kind: f32, mps: f32) -> bool {
        let mut settings = self.settings.clone();
        if kind >= 2.0 {
            settings.autopilot.climb_mps = mps.into();
        } else {
            settings.autopilot.speed_mps = mps.into();
        }
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
        let mut passed = false;
        for _ in 0..MAX_STEPS {
            // Flying home means: from the first item on.
            self.plan.current = self.plan.current.max(1);
            let seq = self.plan.current;
            let Some(&item) = self.plan.items.get(usize::from(seq)) else {
                return self.plan.last;
            };
            self.plan.height_m = item.height_m(&self.site).or(self.plan.height_m);
            let place = item.place(&self.site).map(|place| self.nearest(place));
            match item.role() {
                Role::Jump => {
                    self.jump(seq, &item);
                    continue;
                }
                Role::Speed if item.params[1] > 0.0 || item.params[1] == -2.0 => {
                    self.change_speed(item.params[0], item.params[1], now);
                }
                Role::Yaw => drop(self.condition_yaw(item.params, now)),
                Role::Speed | Role::Kept => {}
                Role::Return => {
                    self.reached(seq, now);
                    self.enter(Mode::Return, now);
                    return Some(self.return_point());
                }
                _ if passed || !self.done(&item, place, now) => return place,
                Role::Land => {
                    self.enter(Mode::Land, now);
                    return None;
                }
                _ => passed = true,
            }
            self.next_item(seq + 1, now);
        }
        None
    }

    /// The height, m, at which AUTO flies; `None` is the present one.
    pub(super) fn mission_height(&self) -> Option<f64> {
        let item = self.plan.flown();
        let height = item.and_then(|item| item.height_m(&self.site)).or(self.plan.height_m)?;
        // A takeoff leads up alone.
        let is_takeoff = item.is_some_and(|item| item.role() == Role::Takeoff);
        Some(if is_takeoff { height.max(self.height.altitude_m) } else { height })
    }

    /// Whether it is at an item's height.
    fn is_at_height(&self, item: &StoredItem) -> bool {
        let Some(goal) = item.height_m(&self.site) else { return true };
        let above = self.height.altitude_m - height::nearest(goal);
        let slack = self.settings.autopilot.acceptance_m;
        if item.role() == Role::Takeoff { above >= -TAKEOFF_SLACK_M } else { above.abs() <= slack }
    }

    /// Whether the vehicle has been long enough where this item wants it.
    fn done(&mut self, item: &StoredItem, place: Option<Vector2<f64>>, now: Duration) -> bool {
        let role = item.role();
        let Some(intervals) = self.plan.arrived else {
            let acceptance = f64::from(item.params[1]);
            let there = place.is_none_or(|place| {
                let metres =
                    (self.sim.world().uav.r - place).norm() * self.sim.scenario().scale.metres_per_unit;
                if role == Role::Waypoint && acceptance > 0.0 {
                    metres <= acceptance
                } else {
                    metres <= self.settings.autopilot.acceptance_m
                }
            });
            let there = there && self.is_at_height(item);
            if there {
                self.plan.arrived = Some(0);
                self.plan.last = place.or(Some(self.sim.world().uav.r));
                self.reached(self.plan.current, now);
            }
            return there && role != Role::LoiterUnlimited && seconds_held(item) <= 0.0;
        };
        let intervals = intervals + 1;
        self.plan.arrived = Some(intervals);
        role != Role::LoiterUnlimited && intervals as f64 * self.clock.interval_s() >= seconds_held(item)
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

/// How long an item stays at its point, s.
fn seconds_held(item: &StoredItem) -> f64 {
    match item.role() {
        // A number that is none becomes no time at all.
        Role::Waypoint | Role::Wait => f64::from(item.params[0].max(0.0)),
        _ => 0.0,
    }
}
