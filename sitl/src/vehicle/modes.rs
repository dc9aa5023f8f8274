//! Mode, arming, takeoff and landing, with ArduCopter's numbers and answers. It begins armed, in the
//! air and in GUIDED, or with `--on-ground` disarmed. What it cannot do it refuses, and says why.
//!
//! | mode | flies |
//! |---|---|
//! | GUIDED (4) | the station's setpoints ([`super::guided`]); after another mode it brakes until the first; DO_REPOSITION's point |
//! | AUTO (3) | the mission ([`super::missions`]) |
//! | LOITER (5), BRAKE (17) | brakes and stays |
//! | RTL (6) | back to the start, or to a rally point that is nearer, then lands |
//! | LAND (9) | brakes, descends, disarms on the ground |
//!
//! | asked | answered |
//! |---|---|
//! | COMPONENT_ARM_DISARM 1 | ACCEPTED; FAILED in a mode that cannot take off, and after a crash |
//! | COMPONENT_ARM_DISARM 0 | ACCEPTED on the ground, FAILED in the air |
//! | the same, forced by 21196 | ACCEPTED: in the air the motors stop, and it falls |
//! | COMPONENT_ARM_DISARM of anything else | DENIED |
//! | DO_SET_MODE with a custom mode, SET_MODE: a mode above | ACCEPTED; AUTO without a mission FAILED |
//! | another mode, or no custom mode | DENIED |
//! | NAV_TAKEOFF to a height above home | ACCEPTED: it climbs, or in the air and in GUIDED goes to that height; disarmed FAILED |
//! | NAV_TAKEOFF to a height below the ground, or to none | DENIED |
//! | NAV_LAND, NAV_RETURN_TO_LAUNCH | ACCEPTED, as LAND and RTL |
//! | MISSION_START | ACCEPTED, as AUTO from the current item |
//! | DO_PAUSE_CONTINUE 0, 1 | ACCEPTED: LOITER; the mission goes on, or GUIDED; else DENIED |
//! | DO_REPOSITION in the air to a point and a height that can be flown to, in GUIDED or with the flag to change mode | ACCEPTED, else DENIED; without a place or a height the present one stays |
//! | DO_SET_HOME, here or to a point that can be flown to | ACCEPTED, and HOME_POSITION to all; else DENIED |
//! | CONDITION_YAW, absolute or relative | ACCEPTED in GUIDED and AUTO, else FAILED |
//! | DO_CHANGE_SPEED to a ground speed up to the limit, a speed of climb; -1 no change, -2 the speed of its start | ACCEPTED, else DENIED |
//!
//! In lockstep a setpoint is also the clock: it lets its interval pass in every mode, and is flown in
//! GUIDED alone.

use std::time::Duration;

use nalgebra::Vector2;

use super::conduct::{Conduct, Mode};
use super::guided::GuidedTarget;
use super::height::{self, Lift};
use super::params::is_flyable;
use super::{Vehicle, guidance};
use crate::link::dialect::{MavModeFlag, MavResult, MavSeverity, MavState};
use crate::link::wire::{Above, Ask};
use crate::scenario::Autopilot;
use crate::sim::Control;

pub(super) const CMD_NAV_RETURN: u16 = 20;
pub(super) const CMD_NAV_LAND: u16 = 21;
pub(super) const CMD_NAV_TAKEOFF: u16 = 22;
pub(super) const CMD_CONDITION_YAW: u16 = 115;
pub(super) const CMD_DO_SET_MODE: u16 = 176;
pub(super) const CMD_DO_CHANGE_SPEED: u16 = 178;
pub(super) const CMD_DO_REPOSITION: u16 = 192;
pub(super) const CMD_DO_PAUSE_CONTINUE: u16 = 193;
pub(super) const CMD_MISSION_START: u16 = 300;
pub(super) const CMD_ARM_DISARM: u16 = 400;
/// All commands of this module.
pub(super) const COMMANDS: [u16; 10] = [
    CMD_NAV_RETURN,
    CMD_NAV_LAND,
    CMD_NAV_TAKEOFF,
    CMD_CONDITION_YAW,
    CMD_DO_SET_MODE,
    CMD_DO_CHANGE_SPEED,
    CMD_DO_REPOSITION,
    CMD_DO_PAUSE_CONTINUE,
    CMD_MISSION_START,
    CMD_ARM_DISARM,
];

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const DENIED: MavResult = MavResult::MAV_RESULT_DENIED;
const FAILED: MavResult = MavResult::MAV_RESULT_FAILED;

/// How near to a takeoff's height it is there already, m.
const HEIGHT_TOLERANCE_M: f64 = 1.0;
/// How far from the origin it flies where there are no walls, m: the Earth is told as flat.
const FAR_M: f32 = 1e6;
/// The magic number of a forced arming or disarming.
const FORCED: f32 = 21_196.0;
/// MAV_DO_REPOSITION_FLAGS_CHANGE_MODE.
const CHANGE_MODE: u32 = 1;
/// SPEED_TYPE_GROUNDSPEED; SPEED_TYPE_AIRSPEED is the same in still air.
const GROUND_SPEEDS: [f32; 2] = [0.0, 1.0];
/// SPEED_TYPE_CLIMB_SPEED and SPEED_TYPE_DESCENT_SPEED, which are one here.
const CLIMB_SPEEDS: [f32; 2] = [2.0, 3.0];

impl Vehicle {
    /// What becomes of a command of this module.
    pub(super) fn mode_command(&mut self, ask: &Ask, now: Duration) -> MavResult {
        let [first, second, ..] = ask.params;
        match ask.command {
            CMD_ARM_DISARM => self.arm(first, second == FORCED, now),
            // A float that is no number becomes 0, which is no custom mode.
            CMD_DO_SET_MODE => self.set_mode(first as u8, second, now),
            CMD_NAV_TAKEOFF => self.take_off(self.height_asked(ask), now),
            CMD_CONDITION_YAW => self.condition_yaw(ask.params, now),
            CMD_NAV_LAND => self.enter(Mode::Land, now),
            CMD_NAV_RETURN => self.enter(Mode::Return, now),
            CMD_MISSION_START => self.enter(Mode::Auto, now),
            CMD_DO_PAUSE_CONTINUE if first == 0.0 => self.enter(Mode::Loiter, now),
            CMD_DO_PAUSE_CONTINUE if first == 1.0 => {
                let mode = if self.has_mission() { Mode::Auto } else { Mode::Guided };
                self.enter(mode, now)
            }
            CMD_DO_REPOSITION => self.reposition(ask, now),
            CMD_DO_CHANGE_SPEED => self.change_speed(first, second, now),
            _ => DENIED,
        }
    }

    fn arm(&mut self, arm: f32, forced: bool, now: Duration) -> MavResult {
        let (conduct, in_air) = (self.conduct, !self.height.on_ground());
        match arm {
            1.0 if conduct.armed => ACCEPTED,
            1.0 if conduct.crashed || in_air => self.refused("arming", "arming refused: crashed", now),
            1.0 if !conduct.mode.takes_off() => {
                let text = format!("arming refused: mode {} does not take off", conduct.mode.name());
                self.refused("arming", &text, now)
            }
            1.0 => {
                self.conduct.armed = true;
                self.begun = true;
                self.notice("arming", "armed", now);
                ACCEPTED
            }
            0.0 if in_air && !forced => self.refused("disarming", "disarming refused: in the air", now),
            0.0 => {
                if conduct.armed && in_air {
                    self.cut_motors(now);
                    self.leave_station();
                } else if conduct.armed {
                    self.notice("disarming", "disarmed", now);
                }
                self.conduct.armed = false;
                self.conduct.climbing = None;
                ACCEPTED
            }
            _ => DENIED,
        }
    }

    /// The motors stop in the air: it falls.
    pub(super) fn cut_motors(&mut self, now: Duration) {
        self.say("fall", MavSeverity::MAV_SEVERITY_EMERGENCY, "motors off in the air: falling", now);
        self.begun = true;
        self.conduct.armed = false;
        self.conduct.climbing = None;
    }

    /// `base` holds MAV_MODE_FLAG; the custom mode counts if its flag is set.
    pub(super) fn set_mode(&mut self, base: u8, custom: f32, now: Duration) -> MavResult {
        let is_custom = base & MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED.bits() != 0;
        let mode = Mode::ALL.into_iter().find(|&mode| is_custom && custom == mode as u32 as f32);
        let Some(mode) = mode else {
            let asked = if is_custom { format!("mode {custom}") } else { format!("base mode {base}") };
            self.refused("mode", &format!("{asked} refused: only 3, 4, 5, 6, 9, 17"), now);
            return DENIED;
        };
        self.enter(mode, now)
    }

    /// Changes to a mode; the same one again changes nothing.
    pub(super) fn enter(&mut self, mode: Mode, now: Duration) -> MavResult {
        if mode == Mode::Auto && !self.has_mission() {
            return self.refused("mode", "AUTO refused: there is no mission", now);
        }
        if mode == self.conduct.mode {
            return ACCEPTED;
        }
        self.leave_station();
        self.conduct =
            Conduct { mode, landing: false, waiting: mode == Mode::Guided, guided: None, ..self.conduct };
        // What it flies by itself takes time without a setpoint.
        self.begun |= mode != Mode::Guided;
        self.plan.resume();
        self.loss_of_link.settle();
        self.notice("mode change", &format!("mode {}", mode.name()), now);
        ACCEPTED
    }

    /// The held command is over: it must not be flown again on coming back.
    pub(super) fn leave_station(&mut self) {
        self.sim.release();
    }

    /// A command's height above the ground at home, m; not a number if it has none.
    fn height_asked(&self, ask: &Ask) -> f64 {
        let height = f64::from(ask.height);
        match ask.above {
            Some(Above::Home) => height,
            Some(Above::Sea) => height - self.site.altitude_m,
            None => f64::NAN,
        }
    }

    fn take_off(&mut self, height_m: f64, now: Duration) -> MavResult {
        if !height::is_flyable(height_m) || height_m <= 0.0 {
            self.refused("takeoff", &format!("takeoff refused: to {height_m} m"), now);
            return DENIED;
        }
        if !self.conduct.armed {
            return self.refused("takeoff", "takeoff refused: not armed", now);
        }
        if self.height.on_ground() {
            self.climb(height_m);
            return ACCEPTED;
        }
        let is_there = (self.height.altitude_m - height_m).abs() <= HEIGHT_TOLERANCE_M;
        if !is_there && self.conduct.mode != Mode::Guided {
            return self.refused("takeoff", "takeoff refused: in the air", now);
        }
        if !is_there {
            self.loss_of_link.settle();
            self.follow_target(GuidedTarget::at(Some(self.sim.world().uav.r), Some(height_m)));
        }
        ACCEPTED
    }

    /// Up from the ground to a height, m, and then wait there.
    pub(super) fn climb(&mut self, height_m: f64) {
        self.leave_station();
        self.conduct.climbing = Some(height_m);
        self.conduct.waiting = true;
        self.conduct.guided = None;
        self.begun = true;
    }

    /// MAV_CMD_CONDITION_YAW: degrees, degrees a second, direction, 1 for relative.
    pub(super) fn condition_yaw(
        &mut self,
        [degrees, speed, direction, relative]: [f32; 4],
        now: Duration,
    ) -> MavResult {
        let given = [degrees, speed, direction, relative];
        if !given.iter().all(|value| value.is_finite()) || ![0.0, 1.0].contains(&relative) {
            return DENIED;
        }
        if !matches!(self.conduct.mode, Mode::Guided | Mode::Auto) {
            return self.refused("yaw", "yaw refused: neither in GUIDED nor in AUTO", now);
        }
        let (angle, speed) = (f64::from(degrees).to_radians(), f64::from(speed).to_radians());
        let way = if direction < 0.0 { -angle } else { angle };
        self.heading.turn_to(if relative == 1.0 { self.heading.yaw + way } else { angle }, speed);
        ACCEPTED
    }

    fn reposition(&mut self, ask: &Ask, now: Duration) -> MavResult {
        let changes = ask.params[1] as u32 & CHANGE_MODE != 0;
        let place = if ask.stays {
            Some(self.sim.world().uav.r)
        } else {
            ask.place.and_then(|place| self.inside(self.site.north_east(place)))
        };
        let height_m = self.height_asked(ask);
        let refused = match place {
            _ if self.conduct.mode != Mode::Guided && !changes => Some("not in GUIDED"),
            _ if !self.conduct.armed || self.height.on_ground() => Some("on the ground"),
            None => Some("not in the square"),
            Some(_) if !height_m.is_nan() && !height::is_flyable(height_m) => Some("below the ground"),
            Some(_) => None,
        };
        if let Some(why) = refused {
            self.refused("reposition", &format!("reposition refused: {why}"), now);
            return DENIED;
        }
        let speed = f64::from(ask.params[0]);
        if speed > 0.0 && !self.set_autopilot(|autopilot| autopilot.speed_mps = speed) {
            self.refused("reposition", "reposition: its speed is out of range and not taken", now);
        }
        self.enter(Mode::Guided, now);
        self.loss_of_link.settle();
        self.follow_target(GuidedTarget::at(place, (!height_m.is_nan()).then_some(height_m)));
        ACCEPTED
    }

    pub(super) fn change_speed(&mut self, kind: f32, mps: f32, now: Duration) -> MavResult {
        // No change, and the speed that it booted with.
        if mps == -1.0 && (GROUND_SPEEDS.contains(&kind) || CLIMB_SPEEDS.contains(&kind)) {
            return ACCEPTED;
        }
        let own = self.sim.scenario().autopilot.clone();
        let (speed, taken) = match kind {
            kind if GROUND_SPEEDS.contains(&kind) => {
                let speed = if mps == -2.0 { own.speed_mps } else { mps.into() };
                (speed, self.set_autopilot(|autopilot| autopilot.speed_mps = speed))
            }
            kind if CLIMB_SPEEDS.contains(&kind) => {
                let speed = if mps == -2.0 { own.climb_mps } else { mps.into() };
                (speed, self.set_autopilot(|autopilot| autopilot.climb_mps = speed))
            }
            _ => (f64::NAN, false),
        };
        if taken {
            return ACCEPTED;
        }
        let limit = self.top_speed_mps() as f32;
        self.refused("speed", &format!("speed {speed} refused: above 0, up to {limit} m/s"), now);
        DENIED
    }

    /// Changes how it flies by itself, if what comes out is within the ranges; whether it is.
    pub(super) fn set_autopilot(&mut self, change: impl FnOnce(&mut Autopilot)) -> bool {
        let mut settings = self.settings.clone();
        change(&mut settings.autopilot);
        let taken = is_flyable(&settings);
        if taken {
            self.settings = settings;
        }
        taken
    }

    /// A point of the local frame, north and east in metres, as a point of the paper's; `None` where there are
    /// walls and it is not between them, and where it is too far to be flown to.
    pub(super) fn inside(&self, ne: [f32; 2]) -> Option<Vector2<f64>> {
        let scenario = self.sim.scenario();
        let metres = scenario.scale.metres_per_unit;
        if !scenario.dynamics.walls {
            let far = ne.iter().any(|metres| !(-FAR_M..=FAR_M).contains(metres));
            return (!far).then(|| scenario.scale.paper_from_ned(ne));
        }
        let r = scenario.scale.paper_from_ned(ne);
        // Degrees on the wire are worth a centimetre.
        let slack = 0.05 / metres;
        let inside = |x: f64| (-slack..=1.0 + slack).contains(&x);
        (inside(r.x) && inside(r.y)).then(|| r.map(|x| x.clamp(0.0, 1.0)))
    }

    /// The point nearest to that one to which it can fly, paper x/y.
    pub(super) fn nearest(&self, ne: [f32; 2]) -> Vector2<f64> {
        let scenario = self.sim.scenario();
        let near = ne.map(|metres| if metres.is_nan() { 0.0 } else { metres.clamp(-FAR_M, FAR_M) });
        let r = scenario.scale.paper_from_ned(near);
        if scenario.dynamics.walls { r.map(|x| x.clamp(0.0, 1.0)) } else { r }
    }

    /// Who flies the interval that begins now, and how.
    pub(super) fn control(&mut self, now: Duration) -> Control {
        let (state, dynamics) = (self.sim.world().uav, self.sim.scenario().dynamics.clone());
        let brake = Control::Onboard(guidance::brake(state, &dynamics));
        if self.height.on_ground() && self.conduct.climbing.is_none() {
            let starts = self.conduct.mode == Mode::Auto && self.conduct.armed && !self.plan.is_over();
            if !starts {
                return Control::Parked;
            }
            let cruise = self.sim.scenario().scale.altitude_m;
            self.climb(self.mission_height().filter(|height| *height > 0.0).unwrap_or(cruise));
        }
        if !self.conduct.armed {
            return Control::Onboard(Vector2::zeros());
        }
        if self.conduct.climbing.is_some() {
            return brake;
        }
        let speed = self.settings.autopilot.speed_mps / self.sim.scenario().scale.mps_per_speed();
        let target = match self.conduct.mode {
            Mode::Guided => match self.conduct.guided {
                Some(target) if target.is_place() || !self.loss_of_link.brakes() => {
                    return Control::Onboard(target.control(state, speed, &dynamics));
                }
                _ if self.conduct.waiting || self.loss_of_link.brakes() => None,
                _ => return Control::Station,
            },
            Mode::Return => Some(self.return_point()).filter(|_| !self.conduct.landing),
            Mode::Auto => self.mission_target(now),
            Mode::Loiter | Mode::Land | Mode::Brake => None,
        };
        target.map_or(brake, |target| Control::Onboard(guidance::approach(state, target, speed, &dynamics)))
    }

    /// Where the vehicle is going by itself, if anywhere, paper x/y.
    pub(super) fn target(&self) -> Option<Vector2<f64>> {
        match self.conduct.mode {
            Mode::Guided => self.conduct.guided.and_then(|target| target.place),
            Mode::Return => Some(self.return_point()),
            Mode::Auto => self.plan.place(&self.site).map(|place| self.nearest(place)),
            Mode::Loiter | Mode::Land | Mode::Brake => None,
        }
    }

    /// Where RTL leads, paper x/y.
    pub(super) fn return_point(&self) -> Vector2<f64> {
        let here = self.sim.world().uav.r;
        let home = self.home();
        let rally = self.rally.iter().filter_map(|item| self.inside(item.north_east(&self.site)));
        let nearer = |a: &Vector2<f64>, b: &Vector2<f64>| (a - here).norm().total_cmp(&(b - here).norm());
        rally.chain([home]).min_by(nearer).unwrap_or(home)
    }

    /// Home, paper x/y: its start, unless a station has set another.
    pub(super) fn home(&self) -> Vector2<f64> {
        self.home.unwrap_or(self.sim.scenario().start)
    }

    /// DO_SET_HOME: here, or a place to which it can fly. The ground is flat: heights count from it as before.
    pub(super) fn set_home(&mut self, ask: &Ask) -> MavResult {
        let here = ask.params[0] == 1.0;
        let place = if here {
            Some(self.sim.world().uav.r)
        } else {
            ask.place.and_then(|place| self.inside(self.site.north_east(place)))
        };
        if place.is_none() {
            return MavResult::MAV_RESULT_DENIED;
        }
        self.home = place;
        MavResult::MAV_RESULT_ACCEPTED
    }

    /// What the motors do about the height in the interval that begins now.
    fn lift(&self) -> Lift {
        let climb = self.settings.autopilot.climb_mps;
        let lands = self.conduct.mode == Mode::Land || self.conduct.landing;
        match (self.conduct, self.conduct.guided) {
            (Conduct { armed: false, .. }, _) => Lift::None,
            (Conduct { climbing: Some(height), .. }, _) => Lift::Towards(height, climb),
            _ if lands => Lift::Towards(0.0, climb),
            (Conduct { mode: Mode::Auto, .. }, _) => {
                self.mission_height().map_or(Lift::Hover, |height| Lift::to(height, climb))
            }
            (Conduct { mode: Mode::Guided, .. }, Some(target)) => {
                if !target.is_place() && self.loss_of_link.brakes() {
                    return Lift::Hover;
                }
                match (target.height_m, target.climb_mps, target.lift) {
                    (Some(height), ..) => Lift::to(height, climb),
                    (None, Some(speed), _) => Lift::at(speed, climb),
                    (None, None, Some(lift)) => {
                        Lift::at(self.height.climb_mps + lift * self.clock.interval_s(), climb)
                    }
                    (None, None, None) => Lift::Hover,
                }
            }
            _ => Lift::Hover,
        }
    }

    /// Height, arrival, turn and touch-down after an interval.
    pub(super) fn rise_and_land(&mut self, now: Duration) {
        let seconds = self.clock.interval_s();
        if self.conduct.mode == Mode::Return && self.is_at(self.return_point()) {
            self.conduct.landing = true;
        }
        let touched = self.height.step(self.lift(), seconds);
        if self.conduct.climbing.is_some_and(|height| self.height.altitude_m >= height) {
            self.conduct.climbing = None;
        }
        if let Some(target) = self.conduct.guided.as_mut() {
            target.advance(&self.sim.scenario().dynamics, seconds);
        }
        self.heading.step(seconds);
        if let Some(speed) = touched {
            self.touch_down(speed, now);
        }
    }

    fn touch_down(&mut self, speed: f64, now: Duration) {
        if self.conduct.armed {
            self.notice("landing", "landed and disarmed", now);
        } else {
            self.conduct.crashed = true;
            let text = format!("crashed at {speed:.0} m/s");
            self.say("landing", MavSeverity::MAV_SEVERITY_EMERGENCY, &text, now);
        }
        self.conduct.armed = false;
        self.conduct.landing = false;
    }

    /// Whether the UAV is within the acceptance radius of a point.
    pub(super) fn is_at(&self, place: Vector2<f64>) -> bool {
        let metres = self.sim.scenario().scale.metres_per_unit;
        (self.sim.world().uav.r - place).norm() * metres <= self.settings.autopilot.acceptance_m
    }

    /// MAV_STATE of the heartbeat.
    pub(super) fn system_status(&self) -> MavState {
        match self.conduct {
            Conduct { armed: false, crashed: true, .. } => MavState::MAV_STATE_EMERGENCY,
            Conduct { armed: false, .. } if !self.height.on_ground() => MavState::MAV_STATE_EMERGENCY,
            Conduct { armed: false, .. } => MavState::MAV_STATE_STANDBY,
            _ if self.loss_of_link.alarmed() => MavState::MAV_STATE_CRITICAL,
            _ => MavState::MAV_STATE_ACTIVE,
        }
    }

    pub(super) fn notice(&mut self, kind: &'static str, text: &str, now: Duration) {
        self.say(kind, MavSeverity::MAV_SEVERITY_NOTICE, text, now);
    }

    /// Says why not; gives the result that fits most refusals.
    pub(super) fn refused(&mut self, kind: &'static str, text: &str, now: Duration) -> MavResult {
        self.say(kind, MavSeverity::MAV_SEVERITY_WARNING, text, now);
        FAILED
    }
}
