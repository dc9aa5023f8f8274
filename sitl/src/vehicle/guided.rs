//! GUIDED beside the acceleration that a radio packet holds: places, velocities, their combinations, heights and
//! yaw, as ArduCopter's GUIDED takes them. Knows setpoints and where the vehicle is, no messages.
//!
//! | asked | flown |
//! |---|---|
//! | acceleration of the plane alone | as in the paper: the gate's held command ([`crate::radio`]) |
//! | a place | straight there at WP_SPEED, and stays |
//! | a velocity | that velocity, until the next setpoint |
//! | an acceleration that is not the paper's (in a body frame, up, beside others) | changes the velocity |
//! | a place and a velocity | the place moves on at the velocity, and is followed |
//! | down: a place, a velocity, an acceleration | the height, at CLIMB_SPEED at most; nothing: the height stays |
//! | yaw, yaw rate | turns |
//!
//! A place outside the field is flown to the field's edge, and that is said. The radio treats all setpoints
//! alike: in an outage they are lost, or wait, as its rule says.

use std::time::Duration;

use nalgebra::Vector2;

use super::{Vehicle, guidance};
use crate::link::dialect::MavSeverity;
use crate::link::wire::{Setpoint, SetpointFrame};
use crate::scenario::{Dynamics, Rule};
use crate::units::Tick;
use crate::world::dynamics::{State, limit_speed};

/// What GUIDED follows. Paper units in the plane, SI upwards; what is not asked for is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct GuidedTarget {
    /// Paper x/y.
    pub place: Option<Vector2<f64>>,
    /// Units an interval.
    pub velocity: Option<Vector2<f64>>,
    /// Normalised: 1 is the actuators' most.
    pub accel: Option<Vector2<f64>>,
    /// Above the ground at home, m.
    pub height_m: Option<f64>,
    /// Up, m/s.
    pub climb_mps: Option<f64>,
    /// Up, m/s².
    pub lift: Option<f64>,
}

impl GuidedTarget {
    /// To a place and a height.
    pub fn at(place: Option<Vector2<f64>>, height_m: Option<f64>) -> Self {
        Self { place, height_m, ..Self::default() }
    }

    /// Whether it leads somewhere and is done there: nothing is missed when no further setpoint comes.
    pub fn is_place(&self) -> bool {
        self.velocity.is_none() && self.accel.is_none() && self.climb_mps.is_none() && self.lift.is_none()
    }

    /// The normalised acceleration that follows it, at `speed` units an interval on the way to a place.
    pub fn control(&self, state: State, speed: f64, dynamics: &Dynamics) -> Vector2<f64> {
        let way = self.place.map(|place| guidance::approach_velocity(state, place, speed, dynamics));
        match (way, self.velocity, self.accel) {
            (None, None, Some(accel)) => accel,
            (way, velocity, _) => {
                guidance::follow(state, way.unwrap_or_default() + velocity.unwrap_or_default(), dynamics)
            }
        }
    }

    /// An interval of so many seconds begins: what moves, moves on.
    pub fn advance(&mut self, dynamics: &Dynamics, seconds: f64) {
        if let (Some(velocity), Some(accel)) = (self.velocity.as_mut(), self.accel) {
            *velocity = limit_speed(*velocity + accel * dynamics.a_max, dynamics.v_max);
        }
        if let (Some(place), Some(velocity)) = (self.place.as_mut(), self.velocity) {
            *place += velocity;
        }
        if let (Some(climb), Some(lift)) = (self.climb_mps.as_mut(), self.lift) {
            *climb += lift * seconds;
        }
        if let (Some(height), Some(climb)) = (self.height_m.as_mut(), self.climb_mps) {
            *height += climb * seconds;
        }
    }
}

/// A setpoint on its way through the radio.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WaitingTarget {
    pub tick: Tick,
    pub target: GuidedTarget,
    /// Yaw, rad, and its rate, rad/s.
    pub turn: [Option<f64>; 2],
}

impl Vehicle {
    /// A setpoint that is no acceleration of the plane alone, for the interval `tick`.
    pub(super) fn guide(&mut self, setpoint: &Setpoint, tick: Tick, now: Duration) {
        if self.newest_target.is_some_and(|newest| tick < newest) {
            return;
        }
        self.newest_target = Some(tick);
        let target = self.target_of(setpoint, now);
        let turn = self.turn_of(setpoint);
        self.waiting_target = Some(WaitingTarget { tick, target, turn });
    }

    /// The target that waits, unless the radio's interval is an outage.
    pub(super) fn target_through(&mut self, outage: bool) -> Option<WaitingTarget> {
        if outage && self.sim.scenario().radio.rule == Rule::Queue {
            return None;
        }
        self.waiting_target.take().filter(|_| !outage)
    }

    /// Follows a target from now on.
    pub(super) fn follow_target(&mut self, target: GuidedTarget) {
        self.leave_station();
        self.conduct.guided = Some(target);
        self.conduct.waiting = false;
        self.begun = true;
    }

    /// Turns as a setpoint asks; one without a yaw stops a turn that has no end.
    pub(super) fn turn(&mut self, [yaw, rate]: [Option<f64>; 2]) {
        match (yaw, rate) {
            (Some(yaw), rate) => self.heading.turn_to(yaw, rate.unwrap_or_default().abs()),
            (None, Some(rate)) => self.heading.turn_at(rate),
            (None, None) => self.heading.stay(),
        }
    }

    pub(super) fn turn_of(&self, setpoint: &Setpoint) -> [Option<f64>; 2] {
        let from = if setpoint.frame == SetpointFrame::Body { self.heading.yaw } else { 0.0 };
        [setpoint.yaw.map(|yaw| from + f64::from(yaw)), setpoint.yaw_rate.map(f64::from)]
    }

    /// A setpoint in the vehicle's own terms.
    fn target_of(&mut self, setpoint: &Setpoint, now: Duration) -> GuidedTarget {
        let scale = self.sim.scenario().scale;
        let a_max = self.sim.scenario().dynamics.a_max;
        let heading = self.heading;
        let level = |level: [f64; 2]| {
            let ne = if setpoint.frame == SetpointFrame::Body { heading.north_east(level) } else { level };
            ne.map(|value| value as f32)
        };
        let place = setpoint.position.level.map(|place| self.place_of(setpoint.frame, place, now));
        let velocity = setpoint.velocity.level.map(|v| scale.paper_from_ned_velocity(level(v)));
        let accel = setpoint.acceleration.level.map(|a| scale.paper_from_ned_acceleration(level(a)) / a_max);
        let v_max = self.sim.scenario().dynamics.v_max;
        GuidedTarget {
            place,
            velocity: velocity.map(|velocity| limit_speed(velocity, v_max)),
            accel: accel.map(|accel| accel.map(|x| x.clamp(-1.0, 1.0))),
            height_m: setpoint.position.down.map(|down| self.height_of(setpoint.frame, -down)),
            climb_mps: setpoint.velocity.down.map(|down| -down),
            lift: setpoint.acceleration.down.map(|down| -down).filter(|lift| *lift != 0.0),
        }
    }

    /// A setpoint's place, paper x/y: the nearest that can be flown to.
    fn place_of(&mut self, frame: SetpointFrame, place: [f64; 2], now: Duration) -> Vector2<f64> {
        let here = self.sim.telemetry().position.map(f64::from);
        let from_here = |[north, east]: [f64; 2]| [(here[0] + north) as f32, (here[1] + east) as f32];
        let ne = match frame {
            SetpointFrame::Local => place.map(|value| value as f32),
            SetpointFrame::Offset => from_here(place),
            SetpointFrame::Body => from_here(self.heading.north_east(place)),
            SetpointFrame::Sea | SetpointFrame::Home => self.site.north_east(place),
        };
        if self.inside(ne).is_none() {
            let text = "setpoint outside the field: flown to its edge";
            self.say("target outside", MavSeverity::MAV_SEVERITY_WARNING, text, now);
        }
        self.nearest(ne)
    }

    /// A setpoint's height above home, m.
    fn height_of(&self, frame: SetpointFrame, up: f64) -> f64 {
        match frame {
            SetpointFrame::Local | SetpointFrame::Home => up,
            SetpointFrame::Offset | SetpointFrame::Body => self.height.altitude_m + up,
            SetpointFrame::Sea => up - self.site.altitude_m,
        }
    }
}
