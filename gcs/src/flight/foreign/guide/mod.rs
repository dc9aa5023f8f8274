//! From the ground to CRPL's goal on a foreign autopilot: streams, mode, arming, climb, setpoints in
//! time. A state machine without socket and clock.
//!
//! | step | ArduCopter | PX4 |
//! |---|---|---|
//! | limits | PARAM_REQUEST_READ of what it allows | the same |
//! | streams | SET_MESSAGE_INTERVAL, else REQUEST_DATA_STREAM | the same; it sends most unasked |
//! | before the mode | | position setpoints for 1.5 s: OFFBOARD is refused without |
//! | mode | DO_SET_MODE(1, 4), GUIDED | DO_SET_MODE(1, 6), OFFBOARD |
//! | arm | COMPONENT_ARM_DISARM 1, again until its checks pass | the same |
//! | climb | NAV_TAKEOFF | position setpoints above the start |
//! | flight | speeds with accelerations fed forward, at 20 Hz, mask 3079 | the same |
//! | end | mode BRAKE, LAND or RTL | mode HOLD, LAND or RTL |
//!
//! A vehicle that flies already is brought to its height by position setpoints. One that leaves its mode by
//! itself or by an operator's hand, from its arming on, gets no more setpoints; its texts, its state, its height and
//! its clock tell which of both it was. A flight that fails asks for BRAKE or HOLD until that is acknowledged. The link's round trip is
//! measured by TIMESYNC; a link that is too slow is refused.
//!
//! | file | what it is |
//! |---|---|
//! | `requests` | what it is asked for, and its answers |
//! | `steps` | the steps, and what they wait for |
//! | `setpoints` | what is sent in time |
//! | `leaving` | who has ended the flight: an operator, the vehicle itself, a restart |
//! | `words` | commands as people call them |

mod leaving;
mod requests;
mod setpoints;
mod steps;
mod words;

pub use super::stack::ForeignStack;

use std::collections::VecDeque;
use std::time::Duration;

use clap::ValueEnum;
use crpl_sitl::Scenario;
use crpl_sitl::link::AUTOPILOT;
use crpl_sitl::link::boot_time::BootTime;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{MavCmd, PARAM_VALUE_DATA};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::service::Timesync;
use crpl_sitl::link::messages::telemetry::{GlobalPositionInt, LocalPositionNed};
use crpl_sitl::link::messages::{Target, View};
use crpl_sitl::link::packet::{Packet, PacketRef};
use crpl_sitl::radio::message::Percept;
use crpl_sitl::vehicle::geodesy::{Home, Site};

use super::Foreign;
use super::field::WhenOver;
use super::limits::LimitReader;
use super::scene::ForeignScene;
use super::tracking::Tracker;
use crate::flight::FlightEnd;
use crate::tools::command::CommandQueue;
use crate::tools::fleet::{self, Fleet, News};
use crate::tools::texts::Texts;
use leaving::LeavingEvidence;

/// How long one step may take, in the vehicle's time.
const PATIENCE: Duration = Duration::from_secs(90);
/// How far apart round trips are measured.
const TRIP_EVERY: Duration = Duration::from_millis(300);
/// How far back the vehicle's clock goes only if it has started anew.
const RESTART: Duration = Duration::from_secs(2);

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
    /// Its motors have stopped in the air, and why.
    Crashed(String),
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
    /// To the scenario's start, in a field that lies where it was laid.
    Approach,
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
    /// Reads what the vehicle allows, until it has.
    limits: Option<LimitReader>,
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
    /// What tells by whom its mode was left, and why it does not answer.
    evidence: LeavingEvidence,
    /// It flew when it was found.
    airborne: bool,
    /// A command to the newest percept has not come yet, and is late.
    undecided: bool,
    late: bool,
    /// It has left its height, and brakes until the interval is over.
    astray: bool,
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
            limits: None,
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
            evidence: LeavingEvidence::default(),
            airborne: false,
            undecided: false,
            late: false,
            astray: false,
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
                self.watch_state(now);
                self.evidence.signed |= PacketRef::from(&packet).signed();
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
            let restarted = self.place.is_some_and(|known| boot + RESTART < known.boot);
            if finite && (restarted || self.place.is_none_or(|known| boot >= known.boot)) {
                self.place = Some(place);
            }
            if restarted && self.phase == GuidePhase::Left {
                self.evidence.rebooted = true;
            }
        } else if let Some(limits) = self.limits.as_mut().filter(|_| packet.is::<PARAM_VALUE_DATA>()) {
            limits.packet(packet, now);
        } else if let Some(told) = GlobalPositionInt::of(packet).filter(|_| packet.component == AUTOPILOT) {
            self.site =
                self.place.and_then(|place| site(&told, self.foreign.field.to_ned(horizontal(&place))));
        } else if let Some(sync) = Timesync::of(packet).filter(|sync| sync.tc1 != 0) {
            // A companion of the same system may answer, too, by another clock.
            if packet.component == AUTOPILOT {
                self.measured(&sync, now);
            }
        } else {
            let said = self.texts.packet(packet);
            said.into_iter().for_each(|said| self.heard_text(said, now));
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
                self.limits = Some(LimitReader::new(self.foreign.stack, id));
            }
            News::Mode(id, _, mode) if Some(id) == self.system => {
                self.say(news.to_string());
                if self.has_control() && !mode.takes_setpoints() {
                    self.leave(news.to_string(), now);
                }
            }
            News::Armed(id, false) if Some(id) == self.system => {
                self.say(news.to_string());
                self.disarmed(news.to_string(), now);
            }
            _ => self.say(news.to_string()),
        }
    }

    fn say(&mut self, text: String) {
        self.events.push_back(GuideEvent::Say(text));
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
        if let Some(limits) = &mut self.limits {
            limits.poll(now, &mut self.station, &mut datagram);
        }
        self.step(now);
        self.commands.poll(now, &mut self.station, &mut datagram);
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
