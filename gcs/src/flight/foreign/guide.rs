//! From the ground to CRPL's goal on a foreign autopilot: streams, mode, arming, climb, setpoints in
//! time. A state machine without socket and clock.
//!
//! | step | ArduCopter | PX4 |
//! |---|---|---|
//! | streams | SET_MESSAGE_INTERVAL, else REQUEST_DATA_STREAM | the same; it sends most unasked |
//! | before the mode | | position setpoints for 1.5 s: OFFBOARD is refused without |
//! | mode | DO_SET_MODE(1, 4), GUIDED | DO_SET_MODE(1, 6), OFFBOARD |
//! | arm | COMPONENT_ARM_DISARM 1, again until its checks pass | the same |
//! | climb | NAV_TAKEOFF | position setpoints above the start |
//! | flight | accelerations at 20 Hz, mask 3135 | the same |
//! | end | mode BRAKE | mode HOLD |
//!
//! A vehicle that leaves its mode by itself or by an operator's hand gets no more setpoints.

use std::collections::VecDeque;
use std::time::Duration;

use clap::ValueEnum;
use crpl_sitl::Scenario;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{
    COMMAND_LONG_DATA, LOCAL_POSITION_NED_DATA, MavCmd, MavFrame, MavMessage, MavSeverity,
    PositionTargetTypemask, SET_POSITION_TARGET_LOCAL_NED_DATA, STATUSTEXT_DATA,
};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::service::RequestDataStream;
use crpl_sitl::link::messages::telemetry::LocalPositionNed;
use crpl_sitl::link::messages::{Target, View};
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::{AUTOPILOT, MessageData, RADIO};
use crpl_sitl::radio::message::{Command, Percept};

use super::Foreign;
use super::scene::ForeignScene;
use super::tracking::{Tracker, hold_height};
use crate::flight::FlightEnd;
use crate::tools::command::{CommandQueue, CommandRequest, CommandResult};
use crate::tools::fleet::{self, Fleet, News};

/// The autopilot whose protocol a foreign vehicle follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ForeignStack {
    /// ArduCopter, flown in GUIDED
    Ardupilot,
    /// PX4, flown in OFFBOARD
    Px4,
}

/// Setpoints in the vehicle's time: PX4 wants more than 2 a second, ArduCopter one in 3 s; the height
/// is held through them, too.
const SETPOINT: Duration = Duration::from_millis(50);
/// Time between position reports that is asked for, µs.
const REPORT_US: f32 = 50_000.0;
/// Setpoints before OFFBOARD: PX4 wants more than a second of them.
const PRESTREAM: Duration = Duration::from_millis(1500);
/// How long a refused mode or arming waits before it is asked for again: checks take their time.
const AGAIN: Duration = Duration::from_secs(1);
/// How long one step may take, in the vehicle's time.
const PATIENCE: Duration = Duration::from_secs(90);
/// How long the vehicle may not say where it is, in wall time.
const SILENCE: Duration = Duration::from_secs(3);
/// How far back the vehicle's clock goes only if it has started anew.
const RESTART: Duration = Duration::from_secs(2);
/// How far the vehicle may leave the paper's square, in its units: there the camera sees it no more.
const FENCE: f64 = 0.1;
/// At the height, m, and at rest, m/s: good enough to begin.
const NEAR_M: f64 = 0.7;
const SLOW_MPS: f64 = 0.3;

/// type_mask: acceleration alone.
const MASK_ACCEL: u16 = 0x0C3F;
/// type_mask: position alone.
const MASK_POSITION: u16 = 0x0DF8;
const STREAM_ALL: u8 = 0;
const STREAM_POSITION: u8 = 6;
const MODE_BRAKE: f32 = 17.0;

/// Something for the shell.
#[derive(Debug)]
pub enum GuideEvent {
    /// For the log.
    Say(String),
    /// From now on this program alone sends setpoints to this system.
    TakeControl(u8),
    /// A control interval begins: [`Guide::fly`] wants a command.
    Percept(Percept),
    /// The last interval has ended; no command is wanted.
    Over(Percept),
    /// The vehicle stands and keeps its place; the end.
    Holding,
    /// The vehicle has left its mode, and why.
    TakenOver(String),
    /// It cannot go on, how that counts once it flies, and why.
    Failed(FlightEnd, String),
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum GuidePhase {
    /// For the vehicle's heartbeat and its position.
    Waiting,
    Prestream,
    Mode,
    Arm,
    Climb,
    Flying,
    Braking,
    Done,
}

/// Where the vehicle is, m and m/s in its local frame: north, east, down.
#[derive(Debug, Clone, Copy)]
struct ReportedPlace {
    position: [f32; 3],
    velocity: [f32; 3],
    /// When it was said, on the vehicle's own clock.
    boot: Duration,
    /// When it came, wall time.
    at: Duration,
}

/// A flight on a foreign vehicle.
#[derive(Debug)]
pub struct Guide {
    scenario: Scenario,
    foreign: Foreign,
    ticks: u64,
    phase: GuidePhase,
    /// Since when, wall time.
    since: Duration,
    station: Encoder,
    decoder: Decoder,
    fleet: Fleet,
    commands: CommandQueue,
    system: Option<u8>,
    place: Option<ReportedPlace>,
    /// Where it stood before it climbed.
    ground: [f32; 3],
    scene: Option<ForeignScene>,
    tracker: Tracker,
    /// What CRPL has asked for, north, east, m/s².
    wish: [f64; 2],
    next_beat: Duration,
    next_setpoint: Duration,
    /// The place that the tracker has seen last, on the vehicle's clock.
    tracked: Option<Duration>,
    /// When the next control interval begins, on the vehicle's clock: a simulator that a busy machine
    /// holds up is waited for.
    next_tick: Duration,
    retry: Option<Duration>,
    asked: Option<MavCmd>,
    /// The newest complaint of the vehicle.
    complaint: String,
    events: VecDeque<GuideEvent>,
}

impl Guide {
    /// A flight of so many control intervals that has not begun.
    #[must_use]
    pub fn new(scenario: Scenario, foreign: &Foreign, ticks: u64) -> Self {
        let v_max = scenario.dynamics.v_max * scenario.scale.mps_per_speed();
        Self {
            scenario,
            foreign: *foreign,
            ticks,
            phase: GuidePhase::Waiting,
            since: Duration::ZERO,
            station: foreign.identity.encoder(foreign.system.unwrap_or(1)),
            decoder: Decoder::default(),
            fleet: Fleet::paced(foreign.speed),
            commands: CommandQueue::default(),
            system: foreign.system,
            place: None,
            ground: [0.0; 3],
            scene: None,
            tracker: Tracker::new(v_max),
            wish: [0.0; 2],
            next_beat: Duration::ZERO,
            next_setpoint: Duration::ZERO,
            tracked: None,
            next_tick: Duration::ZERO,
            retry: None,
            asked: None,
            complaint: String::new(),
            events: VecDeque::new(),
        }
    }

    /// What has happened.
    pub fn take(&mut self) -> Option<GuideEvent> {
        self.events.pop_front()
    }

    /// When [`Guide::poll`] has something to do next, wall time.
    #[must_use]
    pub fn due(&self) -> Duration {
        let mut due = self.next_beat.min(self.next_setpoint);
        if self.phase == GuidePhase::Flying && self.place.is_some_and(|place| place.boot >= self.next_tick) {
            due = Duration::ZERO;
        }
        [self.commands.due(), self.retry].into_iter().flatten().fold(due, Duration::min)
    }

    /// A datagram of the vehicle has come.
    pub fn datagram(&mut self, bytes: &[u8], now: Duration) {
        for packet in self.decoder.datagram(bytes) {
            for news in self.fleet.packet(&packet, now) {
                self.news(news, now);
            }
            self.commands.packet(&packet, now);
            if Some(packet.system) == self.system {
                self.packet(&packet, now);
            }
        }
    }

    fn packet(&mut self, packet: &Packet, now: Duration) {
        let place = LocalPositionNed::of(packet).filter(|_| packet.component == AUTOPILOT);
        if let Some(LocalPositionNed { time_boot_ms, position, velocity }) = place {
            let boot = Duration::from_millis(time_boot_ms.into());
            let place = ReportedPlace { position, velocity, boot, at: now };
            let finite = place.position.iter().chain(&place.velocity).all(|v| v.is_finite());
            // What was overtaken on its way is older than what is known.
            if finite && self.place.is_none_or(|known| boot >= known.boot || boot + RESTART < known.boot) {
                self.place = Some(place);
            }
        } else if packet.is::<STATUSTEXT_DATA>()
            && let Some(MavMessage::STATUSTEXT(message)) = packet.message()
        {
            let text = message.text.to_str().unwrap_or_default().to_owned();
            if message.severity as u8 <= MavSeverity::MAV_SEVERITY_WARNING as u8 {
                self.complaint.clone_from(&text);
            }
            self.say(format!("vehicle: {text}"));
        }
    }

    fn news(&mut self, news: News, now: Duration) {
        match news {
            News::Found(id, mode, _) if self.system.is_none_or(|system| system == id) => {
                let expected = match self.foreign.stack {
                    ForeignStack::Ardupilot => fleet::Stack::ArduPilot,
                    ForeignStack::Px4 => fleet::Stack::Px4,
                };
                self.say(news.to_string());
                if mode.stack != expected {
                    let name = self.foreign.stack.to_possible_value();
                    let name = name.as_ref().map_or("?", |name| name.get_name());
                    return self
                        .fail(FlightEnd::LinkLost, format!("{news}, and not what --vehicle {name} flies"));
                }
                self.system = Some(id);
                let station = self.foreign.identity.encoder(id);
                if station.source() != self.station.source() {
                    self.station = station;
                }
                self.request_streams(id, now);
            }
            News::Mode(id, _, mode) if Some(id) == self.system => {
                self.say(news.to_string());
                if self.phase == GuidePhase::Flying && !mode.takes_setpoints() {
                    self.taken_over(&news.to_string());
                }
            }
            News::Armed(id, false) if Some(id) == self.system && self.phase == GuidePhase::Flying => {
                self.taken_over(&news.to_string());
            }
            _ => self.say(news.to_string()),
        }
    }

    fn request_streams(&mut self, system: u8, now: Duration) {
        let params = [LOCAL_POSITION_NED_DATA::ID as f32, REPORT_US];
        let request = CommandRequest::new(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, params, (system, AUTOPILOT));
        self.commands.request(request, now);
    }

    /// Somebody else flies from now on.
    pub fn taken_over(&mut self, why: &str) {
        if self.phase != GuidePhase::Done {
            self.phase = GuidePhase::Done;
            self.events.push_back(GuideEvent::TakenOver(why.into()));
        }
    }

    fn say(&mut self, text: String) {
        self.events.push_back(GuideEvent::Say(text));
    }

    fn fail(&mut self, how: FlightEnd, why: String) {
        if self.phase != GuidePhase::Done {
            self.phase = GuidePhase::Done;
            self.events.push_back(GuideEvent::Failed(how, why));
        }
    }

    fn enter(&mut self, phase: GuidePhase, now: Duration) {
        self.phase = phase;
        self.since = now;
        self.retry = Some(now);
        self.asked = None;
        self.complaint.clear();
    }

    /// A duration of the vehicle's time on the wall's clock.
    fn wall(&self, duration: Duration) -> Duration {
        duration.div_f64(self.foreign.speed)
    }

    /// What is to be sent by now.
    pub fn poll(&mut self, now: Duration) -> Vec<u8> {
        let mut datagram = Vec::new();
        if now >= self.next_beat {
            self.foreign.identity.push_heartbeat(&mut self.station, &mut datagram);
            self.next_beat = now + Duration::from_secs(1);
        }
        for news in self.fleet.poll(now) {
            self.news(news, now);
        }
        while let Some((request, result)) = self.commands.take() {
            self.answered(&request, result, &mut datagram, now);
        }
        self.step(now);
        self.commands.poll(now, &mut self.station, &mut datagram);
        self.setpoint(now, &mut datagram);
        datagram
    }

    fn answered(
        &mut self,
        request: &CommandRequest,
        result: CommandResult,
        datagram: &mut Vec<u8>,
        now: Duration,
    ) {
        match request.command {
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL if result != CommandResult::Accepted => {
                self.say(format!("message interval {result}: asking for data streams"));
                let (system, component) = request.target;
                for (stream, hz) in [(STREAM_POSITION, 20), (STREAM_ALL, 4)] {
                    let target = Target { system, component };
                    self.station
                        .push_view(datagram, &RequestDataStream { rate: hz, target, stream, start: 1 });
                }
            }
            command if self.asked == Some(command) && result != CommandResult::Accepted => {
                let complaint =
                    if self.complaint.is_empty() { String::new() } else { format!(": {}", self.complaint) };
                self.say(format!("{} {result}{complaint}", words(command)));
                self.asked = None;
                self.retry = Some(now + self.wall(AGAIN));
            }
            command if self.asked == Some(command) => self.accepted(command, now),
            _ => {}
        }
    }

    /// The step's command was accepted.
    fn accepted(&mut self, command: MavCmd, now: Duration) {
        match (self.phase, command) {
            (GuidePhase::Mode, MavCmd::MAV_CMD_DO_SET_MODE) => self.enter(GuidePhase::Arm, now),
            (GuidePhase::Arm, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM) => self.enter(GuidePhase::Climb, now),
            (GuidePhase::Braking, MavCmd::MAV_CMD_DO_SET_MODE) => {
                self.phase = GuidePhase::Done;
                self.events.push_back(GuideEvent::Holding);
            }
            _ => {}
        }
    }

    /// Goes on where it can.
    fn step(&mut self, now: Duration) {
        let patience = match self.phase {
            GuidePhase::Flying | GuidePhase::Done => Duration::MAX,
            _ => PATIENCE,
        };
        if now.saturating_sub(self.since) > self.wall(patience.min(Duration::from_secs(1_000_000))) {
            return self.too_long();
        }
        let Some(place) = self.place.filter(|_| self.known()) else { return };
        if self.phase != GuidePhase::Done && now.saturating_sub(place.at) > SILENCE {
            return self.fail(
                FlightEnd::LinkLost,
                format!("the vehicle has not said where it is for {} s", SILENCE.as_secs()),
            );
        }
        match self.phase {
            GuidePhase::Waiting => {
                self.ground = place.position;
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
            GuidePhase::Flying => self.tick(&place, now),
            GuidePhase::Braking => self.ask_once(MavCmd::MAV_CMD_DO_SET_MODE, &self.hold_mode(), now),
            GuidePhase::Prestream | GuidePhase::Done => {}
        }
    }

    fn known(&self) -> bool {
        self.system.is_some_and(|system| self.fleet.get(system).is_some())
    }

    fn too_long(&mut self) {
        let what = match self.phase {
            GuidePhase::Waiting if self.system.is_none() || !self.known() => "no vehicle heard",
            GuidePhase::Waiting => "the vehicle does not say where it is (LOCAL_POSITION_NED)",
            GuidePhase::Mode | GuidePhase::Prestream => "the vehicle does not take its mode",
            GuidePhase::Arm => "the vehicle does not arm",
            GuidePhase::Climb => "the vehicle does not reach its height",
            _ => "the vehicle does not hold its place",
        };
        let complaint =
            if self.complaint.is_empty() { String::new() } else { format!("; it says: {}", self.complaint) };
        self.fail(FlightEnd::LinkLost, format!("{what}, {} s long{complaint}", PATIENCE.as_secs()));
    }

    fn ask_once(&mut self, command: MavCmd, params: &[f32], now: Duration) {
        let Some(system) = self.system else { return };
        if self.asked.is_some() || self.retry.is_none_or(|at| now < at) {
            return;
        }
        self.asked = Some(command);
        self.retry = None;
        let mut all = [0.0; 7];
        all[..params.len()].copy_from_slice(params);
        self.commands.request(CommandRequest { command, params: all, target: (system, AUTOPILOT) }, now);
    }

    fn control_mode(&self) -> [f32; 2] {
        match self.foreign.stack {
            ForeignStack::Ardupilot => [1.0, 4.0],
            ForeignStack::Px4 => [1.0, 6.0],
        }
    }

    /// BRAKE; or AUTO's LOITER, which PX4's stations call Hold.
    fn hold_mode(&self) -> [f32; 3] {
        match self.foreign.stack {
            ForeignStack::Ardupilot => [1.0, MODE_BRAKE, 0.0],
            ForeignStack::Px4 => [1.0, 4.0, 3.0],
        }
    }

    /// Down, m: where it flies.
    fn height(&self) -> f64 {
        f64::from(self.ground[2]) - self.scenario.scale.altitude_m
    }

    fn climb(&mut self, place: &ReportedPlace, now: Duration) {
        if self.foreign.stack == ForeignStack::Ardupilot {
            let altitude = self.scenario.scale.altitude_m as f32;
            self.ask_once(MavCmd::MAV_CMD_NAV_TAKEOFF, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, altitude], now);
        }
        let near = (f64::from(place.position[2]) - self.height()).abs() < NEAR_M;
        let slow = place.velocity.iter().all(|v| f64::from(v.abs()) < SLOW_MPS);
        if near && slow {
            self.enter(GuidePhase::Flying, now);
            self.scene =
                Some(ForeignScene::new(self.scenario.clone(), [place.position[0], place.position[1]]));
            self.next_tick = place.boot;
            self.say("at its height: CRPL flies".into());
            self.events.extend(self.system.map(GuideEvent::TakeControl));
            self.tick(place, now);
        }
    }

    /// Begins the control interval that is due on the vehicle's clock.
    fn tick(&mut self, place: &ReportedPlace, now: Duration) {
        if place.boot + RESTART < self.next_tick.saturating_sub(self.period()) {
            return self.fail(FlightEnd::Rebooted, "the vehicle has started anew in flight".into());
        }
        let period = self.period();
        let Some(scene) = self.scene.as_mut().filter(|_| place.boot >= self.next_tick) else { return };
        let ([north, east, _], [vn, ve, _]) = (place.position, place.velocity);
        self.next_tick += period;
        while place.boot >= self.next_tick {
            scene.skip();
            self.next_tick += period;
        }
        let percept = scene.percept([north, east], [vn, ve]);
        let (outside, over) = (scene.outside(), scene.tick().0 >= self.ticks);
        if outside > FENCE {
            let metres = outside * self.scenario.scale.metres_per_unit;
            self.say(format!("{metres:.0} m outside the field, out of the camera's sight: it is stopped"));
        }
        if outside > FENCE || over {
            self.wish = [0.0; 2];
            self.enter(GuidePhase::Braking, now);
            self.events.push_back(GuideEvent::Over(percept));
        } else {
            self.events.push_back(GuideEvent::Percept(percept));
        }
    }

    /// A control interval on the vehicle's clock.
    fn period(&self) -> Duration {
        Duration::from_secs_f64(self.scenario.scale.interval_s)
    }

    /// The station's answer to the newest percept; the datagram that brings it.
    pub fn fly(&mut self, command: &Command, now: Duration) -> Vec<u8> {
        let mut datagram = Vec::new();
        let (Some(scene), Some(system)) = (self.scene.as_mut(), self.system) else { return datagram };
        self.wish = scene.pass(command);
        if self.fleet.get(system).is_some_and(|vehicle| vehicle.components.contains(&RADIO)) {
            let power = COMMAND_LONG_DATA {
                param1: command.power.level() as f32,
                command: MavCmd::MAV_CMD_USER_1,
                target_system: system,
                target_component: RADIO,
                ..Default::default()
            };
            self.station.push(&mut datagram, &power);
        }
        self.next_setpoint = now;
        self.setpoint(now, &mut datagram);
        datagram
    }

    /// Makes the vehicle stay where it is, at once.
    pub fn let_go(&mut self, now: Duration) -> Vec<u8> {
        let mut datagram = Vec::new();
        if !matches!(self.phase, GuidePhase::Waiting | GuidePhase::Done) {
            self.enter(GuidePhase::Braking, now);
            self.ask_once(MavCmd::MAV_CMD_DO_SET_MODE, &self.hold_mode(), now);
            self.commands.poll(now, &mut self.station, &mut datagram);
        }
        datagram
    }

    /// The setpoint that is due.
    fn setpoint(&mut self, now: Duration, datagram: &mut Vec<u8>) {
        if now < self.next_setpoint {
            return;
        }
        self.next_setpoint = now + self.wall(SETPOINT).max(Duration::from_millis(4));
        let (Some(system), Some(place)) = (self.system, self.place) else { return };
        let px4 = self.foreign.stack == ForeignStack::Px4;
        let mut message = SET_POSITION_TARGET_LOCAL_NED_DATA {
            time_boot_ms: now.as_millis() as u32,
            coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
            target_system: system,
            target_component: AUTOPILOT,
            ..Default::default()
        };
        let mask = match self.phase {
            GuidePhase::Prestream | GuidePhase::Mode | GuidePhase::Arm | GuidePhase::Climb if px4 => {
                [message.x, message.y] = [self.ground[0], self.ground[1]];
                message.z = self.height() as f32;
                MASK_POSITION
            }
            GuidePhase::Flying | GuidePhase::Braking => {
                let last = self.tracked.replace(place.boot).unwrap_or(place.boot);
                let dt = place.boot.saturating_sub(last).as_secs_f64();
                let velocity = [place.velocity[0], place.velocity[1]].map(f64::from);
                let here = [place.position[0], place.position[1]];
                let room = self.scene.as_ref().map_or([[f64::INFINITY; 2]; 2], |scene| scene.room(here));
                let [north, east] = self.tracker.step(self.wish, velocity, room, dt);
                let (z, vz) = (f64::from(place.position[2]), f64::from(place.velocity[2]));
                message.afx = north as f32;
                message.afy = east as f32;
                message.afz = hold_height(z, vz, self.height()) as f32;
                MASK_ACCEL
            }
            _ => return,
        };
        message.type_mask = PositionTargetTypemask::from_bits_retain(mask);
        self.station.push(datagram, &message);
    }
}

/// A command as people call it.
fn words(command: MavCmd) -> &'static str {
    match command {
        MavCmd::MAV_CMD_DO_SET_MODE => "mode",
        MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => "arming",
        MavCmd::MAV_CMD_NAV_TAKEOFF => "takeoff",
        _ => "command",
    }
}
