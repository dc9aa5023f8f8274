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
//! | flight | speeds with accelerations fed forward, at 20 Hz, mask 3079 | the same |
//! | end | mode BRAKE, LAND or RTL | mode HOLD, LAND or RTL |
//!
//! A vehicle that flies already is brought to its height by position setpoints. One that leaves its mode by
//! itself or by an operator's hand, from its arming on, gets no more setpoints; its texts tell which of both it
//! was. A flight that fails asks for BRAKE or HOLD until that is acknowledged. The link's round trip is
//! measured by TIMESYNC; a link that is too slow is refused.

use std::collections::VecDeque;
use std::time::Duration;

use clap::ValueEnum;
use crpl_sitl::Scenario;
use crpl_sitl::link::boot_time::BootTime;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{
    ATTITUDE_DATA, BATTERY_STATUS_DATA, COMMAND_LONG_DATA, GLOBAL_POSITION_INT_DATA, GPS_RAW_INT_DATA,
    LOCAL_POSITION_NED_DATA, MavCmd, MavFrame, MavMessage, MavSeverity, PositionTargetTypemask,
    SET_POSITION_TARGET_LOCAL_NED_DATA, STATUSTEXT_DATA, SYS_STATUS_DATA,
};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::service::{RequestDataStream, Timesync};
use crpl_sitl::link::messages::telemetry::{GlobalPositionInt, LocalPositionNed};
use crpl_sitl::link::messages::{Target, View};
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::{AUTOPILOT, MessageData, RADIO};
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::vehicle::geodesy::{Home, Site};

use super::Foreign;
use super::field::WhenOver;
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

impl ForeignStack {
    /// DO_SET_MODE's first three parameters at the end: BRAKE, LAND or RTL; PX4's AUTO with LOITER, which its
    /// stations call Hold, LAND or RTL.
    fn last_mode(self, over: WhenOver) -> [f32; 3] {
        match (self, over) {
            (Self::Ardupilot, WhenOver::Hold) => [1.0, 17.0, 0.0],
            (Self::Ardupilot, WhenOver::Land) => [1.0, 9.0, 0.0],
            (Self::Ardupilot, WhenOver::Rtl) => [1.0, 6.0, 0.0],
            (Self::Px4, WhenOver::Hold) => [1.0, 4.0, 3.0],
            (Self::Px4, WhenOver::Land) => [1.0, 4.0, 6.0],
            (Self::Px4, WhenOver::Rtl) => [1.0, 4.0, 5.0],
        }
    }
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
/// How long a vehicle is asked to hold its place when a flight has failed.
const LAST_ASKED: Duration = Duration::from_secs(10);
/// How long a vehicle that has left its mode is listened to: its texts may come behind its heartbeat.
const REASONS: Duration = Duration::from_millis(1500);
/// How old a text may be that tells why a mode was left.
const TEXT_COUNTS: Duration = Duration::from_secs(5);
/// How often it is said what is waited for.
const TOLD_AGAIN: Duration = Duration::from_secs(10);
/// Longest round trip of a link over which a flight begins, s of the vehicle's time; measured so often.
const LONGEST_TRIP: f64 = 1.0;
const TRIPS: usize = 3;
const TRIP_EVERY: Duration = Duration::from_millis(300);
/// How long it is waited for them: not every vehicle answers.
const TRIP_WAIT: Duration = Duration::from_secs(3);
/// Above its origin, m, an armed vehicle flies.
const AIRBORNE_M: f32 = 1.5;
/// Texts of a vehicle that acts by itself.
const FAILSAFES: [&str; 8] = ["failsafe", "crash", "fence", "battery", "glitch", "ekf", "gps", "disarming"];
/// Messages that a log of the flight wants, and how often, µs.
const LOGGED: [(u32, f32); 5] = [
    (ATTITUDE_DATA::ID, 250_000.0),
    (GLOBAL_POSITION_INT_DATA::ID, 250_000.0),
    (GPS_RAW_INT_DATA::ID, 500_000.0),
    (SYS_STATUS_DATA::ID, 1_000_000.0),
    (BATTERY_STATUS_DATA::ID, 1_000_000.0),
];
/// How far back the vehicle's clock goes only if it has started anew.
const RESTART: Duration = Duration::from_secs(2);
/// How far it goes ahead only if it was set.
const CLOCK_SET: Duration = Duration::from_secs(600);
/// How far the vehicle may leave the paper's square, in its units: there the camera sees it no more.
const FENCE: f64 = 0.1;
/// At the height, m, and at rest, m/s: good enough to begin.
const NEAR_M: f64 = 0.7;
const SLOW_MPS: f64 = 0.3;

/// type_mask: speed and acceleration.
const MASK_SPEED: u16 = 0x0C07;
/// type_mask: position alone.
const MASK_POSITION: u16 = 0x0DF8;
const STREAM_ALL: u8 = 0;
const STREAM_POSITION: u8 = 6;

/// Something for the shell.
#[derive(Debug)]
pub enum GuideEvent {
    /// For the log.
    Say(String),
    /// From now on this program alone sends setpoints to this system.
    TakeControl(u8),
    /// Latitude and longitude of the field's (0, 0), degrees.
    Located([f64; 2]),
    /// A control interval begins: [`Guide::fly`] wants a command.
    Percept(Percept),
    /// The last interval has ended; no command is wanted.
    Over(Percept),
    /// The vehicle stands and keeps its place; the end.
    Holding,
    /// The vehicle has left its mode by an operator's hand, and why.
    TakenOver(String),
    /// The vehicle has left its mode by itself, and why.
    Failsafe(String),
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
    /// It has left its mode.
    Left,
    Done,
}

/// Where the vehicle is, m and m/s in the field's frame: up, right, down, which are north, east, down unless the
/// field is turned.
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
    /// Where the local frame lies on Earth.
    site: Option<Site>,
    boot: BootTime,
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
    /// The newest complaint of the vehicle, and when it came.
    complaint: String,
    complained: Duration,
    texts: Texts,
    /// The mode that it is left in.
    last: WhenOver,
    /// Why it holds its place, if not because the flight is over.
    failing: Option<(FlightEnd, String)>,
    /// Why it has left its mode, by its heartbeat.
    left: String,
    /// It flew when it was found.
    airborne: bool,
    /// A command to the newest percept has not come yet, and is late.
    undecided: bool,
    late: bool,
    /// Round trips, s of the vehicle's time, newest last, and when the next is measured.
    trips: VecDeque<f64>,
    next_trip: Duration,
    first_trip: Option<Duration>,
    told: Duration,
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
            site: None,
            boot: BootTime::default(),
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
            complained: Duration::ZERO,
            texts: Texts::default(),
            last: WhenOver::Hold,
            failing: None,
            left: String::new(),
            airborne: false,
            undecided: false,
            late: false,
            trips: VecDeque::new(),
            next_trip: Duration::ZERO,
            first_trip: None,
            told: Duration::ZERO,
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
            let boot = self.boot.at(time_boot_ms);
            let [position, velocity] = [position, velocity].map(|v| self.foreign.field.from_ned(v));
            let place = ReportedPlace { position, velocity, boot, at: now };
            let finite = place.position.iter().chain(&place.velocity).all(|v| v.is_finite());
            // What was overtaken on its way is older than what is known.
            if finite && self.place.is_none_or(|known| boot >= known.boot || boot + RESTART < known.boot) {
                self.place = Some(place);
            }
        } else if let Some(told) = GlobalPositionInt::of(packet).filter(|_| packet.component == AUTOPILOT) {
            self.site =
                self.place.and_then(|place| site(&told, self.foreign.field.to_ned(horizontal(&place))));
        } else if let Some((severity, text)) = self.texts.packet(packet) {
            if severity <= MavSeverity::MAV_SEVERITY_WARNING as u8 {
                self.complaint.clone_from(&text);
                self.complained = now;
            }
            self.say(format!("vehicle: {text}"));
        } else if let Some(sync) = Timesync::of(packet).filter(|sync| sync.tc1 != 0) {
            self.measured(sync.ts1, now);
        }
    }

    /// A TIMESYNC has come back; `asked` is our own stamp, ns.
    fn measured(&mut self, asked: i64, now: Duration) {
        let Some(asked) = u64::try_from(asked).ok().map(Duration::from_nanos) else { return };
        let Some(trip) = now.checked_sub(asked).filter(|trip| *trip < PATIENCE) else { return };
        self.trips.push_back(trip.as_secs_f64() * self.foreign.speed);
        self.trips.drain(..self.trips.len().saturating_sub(TRIPS));
    }

    /// The shortest of the last round trips, s of the vehicle's time, once there are enough.
    #[must_use]
    pub fn round_trip(&self) -> Option<f64> {
        (self.trips.len() == TRIPS).then(|| self.trips.iter().copied().fold(f64::INFINITY, f64::min))
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
                if self.has_control() && !mode.takes_setpoints() {
                    self.leave(news.to_string(), now);
                }
            }
            News::Armed(id, false)
                if Some(id) == self.system
                    && matches!(self.phase, GuidePhase::Climb | GuidePhase::Flying) =>
            {
                self.leave(news.to_string(), now);
            }
            _ => self.say(news.to_string()),
        }
    }

    fn request_streams(&mut self, system: u8, now: Duration) {
        let params = [LOCAL_POSITION_NED_DATA::ID as f32, REPORT_US];
        let request = CommandRequest::new(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, params, (system, AUTOPILOT));
        self.commands.request(request, now);
        for (id, every) in LOGGED {
            let params = [id as f32, every];
            let command = MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL;
            self.commands.request(CommandRequest::new(command, params, (system, AUTOPILOT)), now);
        }
    }

    /// Whether it has taken its mode from us and not left it.
    fn has_control(&self) -> bool {
        matches!(self.phase, GuidePhase::Arm | GuidePhase::Climb | GuidePhase::Flying)
    }

    /// It has left its mode: from now on it gets no setpoint. Its texts will tell why.
    fn leave(&mut self, why: String, now: Duration) {
        let complaint = (std::mem::take(&mut self.complaint), self.complained);
        self.enter(GuidePhase::Left, now);
        (self.complaint, self.complained) = complaint;
        self.left = why;
    }

    /// By whom its mode was left.
    fn judge(&mut self, now: Duration) {
        let lower = self.complaint.to_lowercase();
        let counts = now.saturating_sub(self.complained) < TEXT_COUNTS + REASONS;
        if counts && FAILSAFES.iter().any(|word| lower.contains(word)) {
            self.phase = GuidePhase::Done;
            let why = format!("{}; it says: {}", self.left, self.complaint);
            self.events.push_back(GuideEvent::Failsafe(why));
        } else {
            let why = std::mem::take(&mut self.left);
            self.taken_over(&why);
        }
    }

    /// The flight ends so, once the vehicle holds its place or does not answer.
    fn fail_held(&mut self, how: FlightEnd, why: String, now: Duration) {
        if matches!(self.phase, GuidePhase::Climb | GuidePhase::Flying | GuidePhase::Arm) {
            self.say(format!("{why}: it is asked to hold its place"));
            self.enter(GuidePhase::Braking, now);
            self.failing = Some((how, why));
        } else {
            self.fail(how, why);
        }
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
        if let Some(system) = self.system.filter(|_| now >= self.next_trip) {
            self.next_trip = now + self.wall(TRIP_EVERY);
            self.first_trip.get_or_insert(now);
            let target = Target { system, component: AUTOPILOT };
            let sync = Timesync { tc1: 0, ts1: now.as_nanos() as i64, target };
            self.station.push_view(&mut datagram, &sync);
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
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL
                if request.params[0] != LOCAL_POSITION_NED_DATA::ID as f32 => {}
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
            (GuidePhase::Mode, MavCmd::MAV_CMD_DO_SET_MODE) => {
                self.enter(if self.airborne { GuidePhase::Climb } else { GuidePhase::Arm }, now);
                self.events.extend(self.system.map(GuideEvent::TakeControl));
            }
            (GuidePhase::Arm, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM) => self.enter(GuidePhase::Climb, now),
            (GuidePhase::Braking, MavCmd::MAV_CMD_DO_SET_MODE) => match self.failing.take() {
                Some((how, why)) => self.fail(how, format!("{why}; it holds its place")),
                None => {
                    self.phase = GuidePhase::Done;
                    self.events.push_back(GuideEvent::Holding);
                }
            },
            _ => {}
        }
    }

    /// Goes on where it can.
    fn step(&mut self, now: Duration) {
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
                self.announce();
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
        let complaint = self.complaint_text();
        let why = format!("{what}, {} s long{complaint}", PATIENCE.as_secs());
        self.fail_held(FlightEnd::LinkLost, why, now);
    }

    /// What keeps it from going on.
    fn obstacle(&self) -> &'static str {
        match self.phase {
            GuidePhase::Waiting if self.system.is_none() || !self.known() => "no vehicle heard",
            GuidePhase::Waiting => {
                "the vehicle does not say where it is (LOCAL_POSITION_NED); without GPS or a position it cannot"
            }
            GuidePhase::Mode | GuidePhase::Prestream => "the vehicle does not take its mode",
            GuidePhase::Arm => "the vehicle does not arm",
            GuidePhase::Climb => "the vehicle does not reach its height",
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
            GuidePhase::Waiting | GuidePhase::Mode | GuidePhase::Arm | GuidePhase::Climb
        );
        if waits && now.saturating_sub(self.since.max(self.told)) >= TOLD_AGAIN {
            self.told = now;
            self.say(format!("still waiting: {}{}", self.obstacle(), self.complaint_text()));
        }
    }

    /// Says before the vehicle moves where it will fly.
    fn announce(&mut self) {
        self.say(super::FlightPlan::of(&self.scenario, self.foreign.field).to_string());
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

    /// Down, m: where it flies.
    fn height(&self) -> f64 {
        f64::from(self.ground[2]) - self.scenario.scale.altitude_m
    }

    fn climb(&mut self, place: &ReportedPlace, now: Duration) {
        if self.foreign.stack == ForeignStack::Ardupilot && !self.airborne {
            let altitude = self.scenario.scale.altitude_m as f32;
            self.ask_once(MavCmd::MAV_CMD_NAV_TAKEOFF, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, altitude], now);
        }
        let near = (f64::from(place.position[2]) - self.height()).abs() < NEAR_M;
        let slow = place.velocity.iter().all(|v| f64::from(v.abs()) < SLOW_MPS);
        if near && slow {
            self.enter(GuidePhase::Flying, now);
            let scene = ForeignScene::new(self.scenario.clone(), horizontal(place));
            let origin = self.foreign.field.to_ned(scene.origin());
            let earth = self.site.map(|site| site.latitude_longitude(origin).map(|e7| f64::from(e7) * 1e-7));
            self.events.extend(earth.map(GuideEvent::Located));
            self.scene = Some(scene);
            self.next_tick = place.boot;
            self.say("at its height: CRPL flies".into());
            self.tick(place, now);
        }
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
        if outside > FENCE {
            let metres = outside * self.scenario.scale.metres_per_unit;
            self.say(format!("{metres:.0} m outside the field, out of the camera's sight: it is stopped"));
        }
        if over && outside <= FENCE {
            self.last = self.foreign.over;
        }
        if outside > FENCE || over {
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

    /// The station's answer to the newest percept; the datagram that brings it.
    pub fn fly(&mut self, command: &Command, now: Duration) -> Vec<u8> {
        let mut datagram = Vec::new();
        let (Some(scene), Some(system)) = (self.scene.as_mut(), self.system) else { return datagram };
        (self.undecided, self.late) = (false, false);
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

    /// The controller decides nothing any more.
    pub fn controller_failed(&mut self, now: Duration) {
        self.fail_held(FlightEnd::LinkLost, "the controller has failed".into(), now);
    }

    /// Makes the vehicle stay where it is: [`GuideEvent::Holding`] once it has acknowledged that. Whether there
    /// is anything to wait for.
    pub fn let_go(&mut self, now: Duration) -> bool {
        let flies = self.has_control() || self.phase == GuidePhase::Braking;
        if self.has_control() {
            self.enter(GuidePhase::Braking, now);
            // A mode that was asked for before is answered before.
            self.failing = None;
        }
        flies
    }

    /// Whether the vehicle's heartbeats are missing.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.system.is_some_and(|system| self.fleet.is_lost(system))
    }

    /// Whether its motors may turn.
    #[must_use]
    pub fn is_armed(&self) -> bool {
        self.system.and_then(|system| self.fleet.get(system)).is_some_and(|vehicle| vehicle.armed)
    }

    /// A heartbeat, and who is heard: all that is left to do when the flight is over.
    pub fn idle(&mut self, now: Duration) -> Vec<u8> {
        let mut datagram = Vec::new();
        if now >= self.next_beat {
            self.foreign.identity.push_heartbeat(&mut self.station, &mut datagram);
            self.next_beat = now + Duration::from_secs(1);
        }
        let _ = self.fleet.poll(now);
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
            GuidePhase::Prestream | GuidePhase::Mode | GuidePhase::Arm | GuidePhase::Climb
                if px4 || (self.airborne && self.phase == GuidePhase::Climb) =>
            {
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
                let wish = if self.late { self.tracker.against(dt) } else { self.wish };
                let asked = self.tracker.step(wish, velocity, room, dt);
                [message.vx, message.vy] = asked.velocity.map(|v| v as f32);
                [message.afx, message.afy] = asked.accel.map(|a| a as f32);
                message.vz = hold_height(f64::from(place.position[2]), self.height()) as f32;
                MASK_SPEED
            }
            _ => return,
        };
        message.type_mask = PositionTargetTypemask::from_bits_retain(mask);
        self.foreign.field.turn(&mut message);
        self.station.push(datagram, &message);
    }
}

/// Texts of a vehicle, of which long ones come in several parts.
#[derive(Debug, Default)]
struct Texts {
    /// Number, severity and what has come of a text that goes on.
    open: Option<(u16, u8, String)>,
}

impl Texts {
    /// A whole text and its severity, if this packet ends one.
    fn packet(&mut self, packet: &Packet) -> Option<(u8, String)> {
        const LENGTH: usize = 50;
        if !packet.is::<STATUSTEXT_DATA>() {
            return None;
        }
        let Some(MavMessage::STATUSTEXT(message)) = packet.message() else { return None };
        let part = message.text.to_str().unwrap_or_default();
        let severity = message.severity as u8;
        if message.id == 0 {
            return Some((severity, part.to_owned()));
        }
        let begun = self.open.take().filter(|(id, ..)| *id == message.id && message.chunk_seq > 0);
        let text = begun.map_or_else(String::new, |(.., text)| text) + part;
        if part.len() < LENGTH {
            return Some((severity, text));
        }
        self.open = Some((message.id, severity, text));
        None
    }
}

/// Up and right in the field.
fn horizontal(place: &ReportedPlace) -> [f32; 2] {
    [place.position[0], place.position[1]]
}

/// Where the local frame lies of a vehicle that is there in it, north and east, m; `None` without a place on Earth.
fn site(told: &GlobalPositionInt, there: [f32; 2]) -> Option<Site> {
    let [latitude, longitude] = told.place.map(|e7| f64::from(e7) * 1e-7);
    let home = Home { latitude, longitude, altitude_m: 0.0, heading: 0.0 };
    (told.place != [0, 0]).then(|| Site::with_home(&home, there))
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
