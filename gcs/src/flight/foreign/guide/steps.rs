//! The steps of a flight on a foreign vehicle, from its first words to the control interval that is due.

use std::time::Duration;

use crpl_sitl::link::dialect::MavCmd;

use super::super::FlightPlan;
use super::super::limits::{LimitReader, VehicleLimits};
use super::super::scene::ForeignScene;
use super::leaving::REASONS;
use super::{ForeignStack, Guide, GuideEvent, GuidePhase, PATIENCE, RESTART, ReportedPlace};
use crate::flight::FlightEnd;

/// Setpoints before OFFBOARD: PX4 wants more than a second of them.
const PRESTREAM: Duration = Duration::from_millis(1500);
/// How long the vehicle may not say where it is, in wall time.
const SILENCE: Duration = Duration::from_secs(3);
/// How long a vehicle is asked to hold its place when a flight has failed.
const LAST_ASKED: Duration = Duration::from_secs(10);
/// How often it is said what is waited for.
const TOLD_AGAIN: Duration = Duration::from_secs(10);
/// Longest round trip of a link over which a flight begins, s of the vehicle's time.
const LONGEST_TRIP: f64 = 1.0;
/// How long their measurement is waited for: not every vehicle answers.
const TRIP_WAIT: Duration = Duration::from_secs(3);
/// Above its origin, m, an armed vehicle flies.
const AIRBORNE_M: f32 = 1.5;
/// How far it goes ahead only if it was set.
const CLOCK_SET: Duration = Duration::from_secs(600);
/// How far the vehicle may leave the paper's square, in its units: there the camera sees it no more.
const FENCE: f64 = 0.1;
/// At the height, m, and at rest, m/s: good enough to begin.
const NEAR_M: f64 = 0.7;
const SLOW_MPS: f64 = 0.3;

impl Guide {
    /// Goes on where it can.
    pub(super) fn step(&mut self, now: Duration) {
        let long = Duration::from_secs(1_000_000);
        let patience = match self.phase {
            GuidePhase::Flying | GuidePhase::Done | GuidePhase::Left => long,
            GuidePhase::Braking if self.failing.is_some() => LAST_ASKED,
            _ => PATIENCE,
        };
        if now.saturating_sub(self.since) > self.wall(patience) {
            return self.too_long(now);
        }
        match self.phase {
            GuidePhase::Left if now.saturating_sub(self.since) >= REASONS => return self.judge(now),
            GuidePhase::Left => return,
            // Where it is does not matter for this.
            GuidePhase::Braking => {
                return self.ask_once(
                    MavCmd::MAV_CMD_DO_SET_MODE,
                    &self.foreign.stack.last_mode(self.last),
                    now,
                );
            }
            _ => {}
        }
        self.tell_waiting(now);
        let Some(place) = self.place.filter(|_| self.known()) else { return };
        if self.phase != GuidePhase::Done && now.saturating_sub(place.at) > SILENCE {
            let why = format!("the vehicle has not said where it is for {} s", SILENCE.as_secs());
            return self.fail_held(FlightEnd::LinkLost, why, now);
        }
        match self.phase {
            GuidePhase::Waiting => {
                let Some(limits) = self.limits.as_ref().map(LimitReader::done) else { return };
                let Some(limits) = limits.cloned() else { return };
                let measures = self.first_trip.is_none_or(|at| now.saturating_sub(at) < self.wall(TRIP_WAIT));
                if self.round_trip().is_none() && measures {
                    return;
                }
                if let Some(trip) = self.round_trip().filter(|trip| *trip > LONGEST_TRIP) {
                    let why = format!(
                        "the link's round trip is {trip:.2} s, and no flight begins above {LONGEST_TRIP} s"
                    );
                    return self.fail(FlightEnd::LinkLost, why);
                }
                self.ground = place.position;
                let armed = self.system.and_then(|id| self.fleet.get(id)).is_some_and(|v| v.armed);
                if armed && place.position[2] < -AIRBORNE_M {
                    self.airborne = true;
                    self.ground[2] = 0.0;
                    self.say(format!("it flies already, {:.1} m above its origin", -place.position[2]));
                }
                if !self.agrees(&limits, &place) {
                    return;
                }
                let next = if self.foreign.stack == ForeignStack::Px4 {
                    GuidePhase::Prestream
                } else {
                    GuidePhase::Mode
                };
                self.enter(next, now);
            }
            // In wall time, as PX4's simulator counts it.
            GuidePhase::Prestream if now.saturating_sub(self.since) >= PRESTREAM => {
                self.enter(GuidePhase::Mode, now)
            }
            GuidePhase::Mode => self.ask_once(MavCmd::MAV_CMD_DO_SET_MODE, &self.control_mode(), now),
            GuidePhase::Arm => self.ask_once(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[1.0], now),
            GuidePhase::Climb => self.climb(&place, now),
            GuidePhase::Approach => self.approach(&place, now),
            GuidePhase::Flying => self.tick(&place, now),
            GuidePhase::Prestream | GuidePhase::Braking | GuidePhase::Left | GuidePhase::Done => {}
        }
    }

    fn known(&self) -> bool {
        self.system.is_some_and(|system| self.fleet.get(system).is_some())
    }

    fn too_long(&mut self, now: Duration) {
        if let Some((how, why)) = self.failing.take() {
            return self.fail(how, format!("{why}; it did not answer when it was asked to hold its place"));
        }
        let what = self.obstacle();
        let (complaint, hint) = (self.complaint_text(), self.signature_hint());
        let why = format!("{what}, {} s long{complaint}{hint}", PATIENCE.as_secs());
        self.fail_held(FlightEnd::LinkLost, why, now);
    }

    /// What keeps it from going on.
    fn obstacle(&self) -> &'static str {
        match self.phase {
            GuidePhase::Waiting if self.system.is_none() || !self.known() => "no vehicle heard",
            GuidePhase::Waiting if self.place.is_some() => {
                "its parameters and its answers to TIMESYNC are waited for"
            }
            GuidePhase::Waiting => {
                "the vehicle does not say where it is (LOCAL_POSITION_NED); without GPS or a position it cannot"
            }
            GuidePhase::Mode | GuidePhase::Prestream => "the vehicle does not take its mode",
            GuidePhase::Arm => "the vehicle does not arm",
            GuidePhase::Climb => "the vehicle does not reach its height",
            GuidePhase::Approach => "the vehicle does not reach its start",
            _ => "the vehicle does not hold its place",
        }
    }

    fn complaint_text(&self) -> String {
        if self.complaint.is_empty() { String::new() } else { format!("; it says: {}", self.complaint) }
    }

    /// Says now and then what is waited for.
    fn tell_waiting(&mut self, now: Duration) {
        let waits = matches!(
            self.phase,
            GuidePhase::Waiting
                | GuidePhase::Mode
                | GuidePhase::Arm
                | GuidePhase::Climb
                | GuidePhase::Approach
        );
        if waits && now.saturating_sub(self.since.max(self.told)) >= TOLD_AGAIN {
            self.told = now;
            let (complaint, hint) = (self.complaint_text(), self.signature_hint());
            self.say(format!("still waiting: {}{complaint}{hint}", self.obstacle()));
        }
    }

    /// Says before the vehicle moves where it will fly and what it allows. Whether it allows that.
    fn agrees(&mut self, limits: &VehicleLimits, place: &ReportedPlace) -> bool {
        let plan = self.plan();
        self.say(plan.to_string());
        self.say(limits.to_string());
        // Where it stands when it is armed is its home; one that flies already is near its origin, as far as known.
        let home = if self.airborne { [0.0; 2] } else { [place.position[0], place.position[1]] };
        let refusals = limits.refusals(&plan, self.reach(home, place));
        if refusals.is_empty() {
            return true;
        }
        let why = format!("{}: the flight is refused before the vehicle is armed", refusals.join("; "));
        self.fail(FlightEnd::LinkLost, why);
        false
    }

    fn plan(&self) -> FlightPlan {
        FlightPlan::of(&self.scenario, &self.foreign)
    }

    /// The paper's (0, 0) in the field's axes about the vehicle's origin: up, right, m.
    fn origin(&self, place: &ReportedPlace) -> [f32; 2] {
        match self.foreign.origin {
            Some([north, east]) => {
                let [up, right, _] = self.foreign.field.from_ned([north, east, 0.0]);
                [up, right]
            }
            None => ForeignScene::origin_at_start(&self.scenario, [place.position[0], place.position[1]]),
        }
    }

    /// From `home` to the farthest corner of the field, m.
    fn reach(&self, home: [f32; 2], place: &ReportedPlace) -> f64 {
        let (origin, side) = (self.origin(place), self.scenario.scale.metres_per_unit);
        let far = |axis: usize| {
            let low = f64::from(origin[axis] - home[axis]);
            low.abs().max((low + side).abs())
        };
        far(0).hypot(far(1))
    }

    /// Where it begins: up, right, m.
    pub(super) fn start(&self) -> [f32; 2] {
        let Some([north, east]) = self.foreign.origin else { return [self.ground[0], self.ground[1]] };
        let [up, right, _] = self.foreign.field.from_ned([north, east, 0.0]);
        let start = self.scenario.scale.ned_from_paper(self.scenario.start);
        [up + start[0], right + start[1]]
    }

    fn control_mode(&self) -> [f32; 2] {
        match self.foreign.stack {
            ForeignStack::Ardupilot => [1.0, 4.0],
            ForeignStack::Px4 => [1.0, 6.0],
        }
    }

    /// Down, m: where it flies.
    pub(super) fn height(&self) -> f64 {
        f64::from(self.ground[2]) - self.scenario.scale.altitude_m
    }

    fn climb(&mut self, place: &ReportedPlace, now: Duration) {
        if self.foreign.stack == ForeignStack::Ardupilot && !self.airborne {
            let altitude = self.scenario.scale.altitude_m as f32;
            self.ask_once(MavCmd::MAV_CMD_NAV_TAKEOFF, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, altitude], now);
        }
        let near = (f64::from(place.position[2]) - self.height()).abs() < NEAR_M;
        let slow = place.velocity.iter().all(|v| f64::from(v.abs()) < SLOW_MPS);
        if near && slow && self.foreign.origin.is_some() {
            self.enter(GuidePhase::Approach, now);
            self.say("at its height: it flies to its start".into());
        } else if near && slow {
            self.begin(place, now);
        }
    }

    fn approach(&mut self, place: &ReportedPlace, now: Duration) {
        let [up, right] = self.start();
        let away = f64::from(place.position[0] - up).hypot(f64::from(place.position[1] - right));
        let slow = place.velocity.iter().all(|v| f64::from(v.abs()) < SLOW_MPS);
        if away < NEAR_M && slow {
            self.begin(place, now);
        }
    }

    /// The flight proper begins here.
    fn begin(&mut self, place: &ReportedPlace, now: Duration) {
        self.enter(GuidePhase::Flying, now);
        let scene = ForeignScene::at(self.scenario.clone(), self.origin(place));
        let origin = self.foreign.field.to_ned(scene.origin());
        let earth = self.site.map(|site| site.latitude_longitude(origin).map(|e7| f64::from(e7) * 1e-7));
        self.events.extend(earth.map(GuideEvent::Located));
        self.scene = Some(scene);
        self.next_tick = place.boot;
        self.say("at its height: CRPL flies".into());
        self.tick(place, now);
    }

    /// Begins the control interval that is due on the vehicle's clock.
    fn tick(&mut self, place: &ReportedPlace, now: Duration) {
        if place.boot + RESTART < self.next_tick.saturating_sub(self.period()) {
            return self.fail(FlightEnd::Rebooted, "the vehicle has started anew in flight".into());
        }
        if place.boot > self.next_tick + CLOCK_SET {
            return self.fail(FlightEnd::Rebooted, "the vehicle's clock was set in flight".into());
        }
        if let Some(trip) = self.round_trip().filter(|trip| *trip > 2.0 * LONGEST_TRIP) {
            let why = format!("the link's round trip has grown to {trip:.2} s");
            return self.fail_held(FlightEnd::LinkLost, why, now);
        }
        // At once, and not with the next interval: that one ends the flight.
        let away = (f64::from(place.position[2]) - self.height()).abs();
        if away > self.plan().vertical_limit_m && !std::mem::replace(&mut self.astray, true) {
            self.say(format!("{away:.1} m from its height: it is stopped"));
        }
        let period = self.period();
        let Some(scene) = self.scene.as_mut().filter(|_| place.boot >= self.next_tick) else { return };
        if self.undecided {
            // The controller is not ready: an interval passes without it, and the vehicle brakes meanwhile.
            scene.skip();
            self.next_tick += period;
            if !std::mem::replace(&mut self.late, true) {
                self.say("the controller's decision is late: the vehicle brakes until it is there".into());
            }
            return;
        }
        let ([north, east, _], [vn, ve, _]) = (place.position, place.velocity);
        self.next_tick += period;
        while place.boot >= self.next_tick {
            scene.skip();
            self.next_tick += period;
        }
        let percept = scene.percept([north, east], [vn, ve]);
        let (outside, over) = (scene.outside(), scene.tick().0 >= self.ticks);
        let is_astray = self.astray;
        if outside > FENCE {
            let metres = outside * self.scenario.scale.metres_per_unit;
            self.say(format!("{metres:.0} m outside the field, out of the camera's sight: it is stopped"));
        }
        if over && outside <= FENCE && !is_astray {
            self.last = self.foreign.over;
        }
        if outside > FENCE || is_astray || over {
            self.wish = [0.0; 2];
            self.enter(GuidePhase::Braking, now);
            self.events.push_back(GuideEvent::Over(percept));
        } else {
            self.undecided = true;
            self.events.push_back(GuideEvent::Percept(percept));
        }
    }

    /// A control interval on the vehicle's clock.
    fn period(&self) -> Duration {
        Duration::from_secs_f64(self.scenario.scale.interval_s)
    }
}
