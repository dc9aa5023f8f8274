//! ArduCopter and PX4 as far as a station that flies accelerations meets them, built from what the
//! real ones send, answer and refuse (ArduCopter 4.7-dev and PX4 1.18-beta, their simulators).
//!
//! | | ArduCopter | PX4 |
//! |---|---|---|
//! | unasked | heartbeats | heartbeats, LOCAL_POSITION_NED, GLOBAL_POSITION_INT |
//! | mode | GUIDED once the EKF has a position | OFFBOARD after more than 1 s of setpoints, else TEMPORARILY_REJECTED |
//! | arming | FAILED and a text until its checks pass | accepted |
//! | takeoff | NAV_TAKEOFF, armed and in GUIDED | by position setpoints |
//! | speed with acceleration | a loop of its own, with a learned part | the same |
//! | acceleration | follows with a lag of 0.35 s, tilt-limited to 3.5 m/s² | the same up to 6 m/s², drag 1/s, sinks slowly |
//! | everything ignored, or one axis | stops | refused with a text; holds |
//! | not a number | poisons the controller for good | treated as absent |
//! | silence | 3 s, then brakes | 1 s, then RTL |
//! | texts of more than 50 bytes | several STATUSTEXT with one id | the same |
//! | attitude, battery, GPS | when asked for | when asked for |
//! | a restart | STABILIZE, disarmed, no stream, its clock at 0 | Hold, disarmed, its clock at 0 |
//! | without GPS | no LOCAL_POSITION_NED; GUIDED is refused | the same |
//!
//! A state machine: time is an argument. [`Served`] puts it on a socket.

mod served;

use std::collections::{BTreeMap, VecDeque};

use crpl_sitl::link::MessageData;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{
    ATTITUDE_DATA, BATTERY_STATUS_DATA, GLOBAL_POSITION_INT_DATA, GPS_RAW_INT_DATA, HEARTBEAT_DATA,
    LOCAL_POSITION_NED_DATA, MavAutopilot, MavModeFlag, MavResult, MavSeverity, MavState, MavType,
    STATUSTEXT_DATA, SYS_STATUS_DATA,
};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::command::CommandLong;
use crpl_sitl::link::messages::param::{ParamRequestList, ParamRequestRead, ParamSet};
use crpl_sitl::link::messages::service::Timesync;
use crpl_sitl::link::messages::setpoint::SetPositionTargetLocalNed;
use crpl_sitl::vehicle::geodesy::Site;

use crate::fake_params::FakeParams;
pub use served::Served;

/// Whom it copies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stack {
    /// ArduCopter.
    ArduPilot,
    /// PX4.
    Px4,
}

const GUIDED: u32 = 4;
const OFFBOARD: u32 = 6 << 16;
/// AUTO.LOITER, AUTO.RTL.
const PX4_HOLD: u32 = 4 << 16 | 3 << 24;
const PX4_RTL: u32 = 4 << 16 | 5 << 24;
/// Step of the dynamics, s.
const STEP: f64 = 0.005;
/// Length of ArduCopter's checks after its start, s.
const CHECKS: f64 = 4.0;

/// What the controller follows.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Wish {
    /// Motors off, or on and waiting.
    Ground,
    /// North, east, down, m/s².
    Accel([f64; 3]),
    /// Speed, and acceleration fed forward.
    Speed([f64; 3], [f64; 3]),
    Position([f64; 3]),
    /// Brakes and stays.
    Stop,
}

/// One autopilot with its vehicle.
#[derive(Debug)]
pub struct Autopilot {
    stack: Stack,
    /// The vehicle's own time, s.
    time: f64,
    mode: u32,
    armed: bool,
    position: [f64; 3],
    velocity: [f64; 3],
    accel: [f64; 3],
    wish: Wish,
    /// When the newest setpoint came, on the vehicle's clock, and since when they have come in a row.
    setpoint: Option<(f64, f64)>,
    stream_period: Option<f64>,
    next_report: f64,
    next_beat: f64,
    /// Poisoned by a number that was none.
    pub poisoned: bool,
    /// Whether a setpoint time-out has fired.
    pub starved: bool,
    /// Setpoints taken as accelerations.
    pub accelerations: u64,
    /// Levels of transmit power that its radio was told.
    pub powers: Vec<f32>,
    radio: Option<Encoder>,
    encoder: Encoder,
    decoder: Decoder,
    out: Vec<u8>,
    /// Delay of the link each way, s, and of every other datagram more than that.
    delay: [f64; 2],
    /// What is under way to the vehicle and from it, by the time of its arrival.
    inbox: VecDeque<(f64, Vec<u8>)>,
    outbox: VecDeque<(f64, Vec<u8>)>,
    under_way: u64,
    /// Of the speed loop: what it has learned of drag.
    learned: [f64; 3],
    /// The largest level speed that it has flown, m/s.
    pub fastest: f64,
    /// The heights between which it has flown, m.
    pub heights: [f64; 2],
    /// Commands for a mode that get lost: so many.
    pub deaf_to_modes: u32,
    /// What its clock is ahead of the time since it started, ms: one that runs for 49.7 days begins at 0 again.
    pub clock_ahead_ms: u32,
    /// Its parameters.
    pub params: FakeParams,
    /// When it was started last, on its own clock.
    booted: f64,
    /// Its heartbeats say that it is in distress.
    pub distress: bool,
    /// It does not know where it is.
    pub blind: bool,
    /// Other messages that it was asked for: every so many seconds, and when next.
    pub logged: BTreeMap<u32, (f64, f64)>,
    /// Of its long texts.
    texts: u16,
}

impl Autopilot {
    /// On the ground at `position` (north, east), just started; with a radio component or without.
    #[must_use]
    pub fn new(stack: Stack, position: [f64; 2], radio: bool) -> Self {
        let px4 = stack == Stack::Px4;
        Self {
            stack,
            time: 0.0,
            mode: if px4 { PX4_HOLD } else { 0 },
            armed: false,
            position: [position[0], position[1], 0.0],
            velocity: [0.0; 3],
            accel: [0.0; 3],
            wish: Wish::Ground,
            setpoint: None,
            stream_period: px4.then_some(0.02),
            next_report: 0.0,
            next_beat: 0.0,
            poisoned: false,
            starved: false,
            accelerations: 0,
            powers: Vec::new(),
            radio: radio.then(|| Encoder::new(1, 68)),
            encoder: Encoder::new(1, 1),
            decoder: Decoder::default(),
            out: Vec::new(),
            delay: [0.0; 2],
            inbox: VecDeque::new(),
            outbox: VecDeque::new(),
            under_way: 0,
            learned: [0.0; 3],
            fastest: 0.0,
            heights: [f64::INFINITY, f64::NEG_INFINITY],
            deaf_to_modes: 0,
            clock_ahead_ms: 0,
            params: if px4 { FakeParams::px4() } else { FakeParams::ardupilot() },
            booted: 0.0,
            distress: false,
            blind: false,
            logged: BTreeMap::new(),
            texts: 0,
        }
    }

    /// Behind a link that takes `delay` seconds each way, and `more` in addition for every other datagram; none
    /// overtakes another.
    #[must_use]
    pub fn delayed(mut self, delay: f64, more: f64) -> Self {
        self.delay = [delay, more];
        self
    }

    /// In the air already, armed, in GUIDED or Hold, that many metres high.
    #[must_use]
    pub fn airborne(mut self, height: f64) -> Self {
        (self.armed, self.position[2], self.wish) = (true, -height, Wish::Stop);
        (self.time, self.next_report, self.next_beat) = (CHECKS, CHECKS, CHECKS);
        if self.stack == Stack::ArduPilot {
            self.mode = GUIDED;
        }
        self
    }

    /// Says a text, as failsafes do.
    pub fn shout(&mut self, text: &str) {
        self.say(MavSeverity::MAV_SEVERITY_CRITICAL, text);
    }

    /// Says no longer where it is.
    pub fn hush(&mut self) {
        self.stream_period = None;
    }

    /// Motors off.
    pub fn disarm(&mut self) {
        self.armed = false;
    }

    /// Starts anew, on the ground: what it was asked for is forgotten.
    pub fn restart(&mut self) {
        (self.booted, self.armed, self.wish, self.setpoint) = (self.time, false, Wish::Ground, None);
        (self.position[2], self.velocity, self.accel) = (0.0, [0.0; 3], [0.0; 3]);
        self.logged.clear();
        self.mode = if self.stack == Stack::Px4 { PX4_HOLD } else { 0 };
        if self.stack == Stack::ArduPilot {
            self.stream_period = None;
        }
    }

    /// Since it was started, s.
    fn up(&self) -> f64 {
        self.time - self.booted
    }

    /// When something that is sent now arrives.
    fn arrives(&mut self, last: Option<f64>) -> f64 {
        self.under_way += 1;
        let [delay, more] = self.delay;
        let due = self.time + delay + more * (self.under_way % 2) as f64;
        last.map_or(due, |last| due.max(last))
    }

    /// North, east, down, m.
    #[must_use]
    pub fn position(&self) -> [f64; 3] {
        self.position
    }

    /// Whether its motors may turn.
    #[must_use]
    pub fn is_armed(&self) -> bool {
        self.armed
    }

    /// A gust that lifts it by so many metres.
    pub fn lift(&mut self, metres: f64) {
        self.position[2] -= metres;
    }

    /// Level, m/s.
    #[must_use]
    pub fn speed(&self) -> f64 {
        self.velocity[0].hypot(self.velocity[1])
    }

    /// HEARTBEAT.custom_mode.
    #[must_use]
    pub fn mode(&self) -> u32 {
        self.mode
    }

    /// A pilot's hand changes the mode.
    pub fn set_mode(&mut self, mode: u32) {
        self.mode = mode;
        self.wish = Wish::Stop;
    }

    fn controlled(&self) -> bool {
        self.mode == if self.stack == Stack::Px4 { OFFBOARD } else { GUIDED }
    }

    /// Goes on to `time` (seconds of the vehicle's clock); gives what it sends meanwhile. `factor` is
    /// how much faster than the wall its clock runs: PX4 stretches its time-outs by it.
    pub fn advance(&mut self, time: f64, factor: f64) -> Vec<u8> {
        let mut arrived = Vec::new();
        while self.time + STEP <= time {
            self.time += STEP;
            while self.inbox.front().is_some_and(|(due, _)| *due <= self.time) {
                if let Some((_, bytes)) = self.inbox.pop_front() {
                    self.hear(&bytes);
                }
            }
            self.watch(factor);
            self.fly();
            self.report();
            if !self.out.is_empty() {
                let due = self.arrives(self.outbox.back().map(|(due, _)| *due));
                let out = std::mem::take(&mut self.out);
                self.outbox.push_back((due, out));
            }
            while self.outbox.front().is_some_and(|(due, _)| *due <= self.time) {
                arrived.extend(self.outbox.pop_front().into_iter().flat_map(|(_, bytes)| bytes));
            }
        }
        arrived
    }

    /// Setpoint time-outs.
    fn watch(&mut self, factor: f64) {
        let Some((newest, _)) = self.setpoint else { return };
        let silent = self.time - newest;
        match self.stack {
            Stack::ArduPilot
                if self.controlled()
                    && matches!(self.wish, Wish::Accel(_) | Wish::Speed(..))
                    && silent > 3.0 =>
            {
                self.wish = Wish::Stop;
                self.starved = true;
            }
            Stack::Px4 if silent > factor => {
                self.setpoint = None;
                if self.controlled() && self.armed {
                    self.set_mode(PX4_RTL);
                    self.starved = true;
                    self.say(MavSeverity::MAV_SEVERITY_CRITICAL, "Failsafe activated");
                }
            }
            _ => {}
        }
    }

    fn fly(&mut self) {
        let on_ground = self.position[2] >= -0.01;
        let px4 = self.stack == Stack::Px4;
        let (limit, drag) = if px4 { (6.0, 1.0) } else { (3.5, 0.0) };
        let mut asked = match self.wish {
            Wish::Ground => return,
            Wish::Accel(accel) => accel,
            Wish::Speed(speed, accel) => std::array::from_fn(|k| {
                let error = speed[k] - self.velocity[k];
                self.learned[k] = (self.learned[k] + 1.0 * error * STEP).clamp(-2.0, 2.0);
                accel[k] + 2.0 * error + self.learned[k]
            }),
            Wish::Stop => self.velocity.map(|v| -1.5 * v),
            Wish::Position(target) => std::array::from_fn(|k| {
                let speed = (0.8 * (target[k] - self.position[k])).clamp(-2.5, 2.5);
                2.0 * (speed - self.velocity[k])
            }),
        };
        if self.poisoned {
            asked = [limit; 3];
        }
        let level = asked[0].hypot(asked[1]);
        if level > limit {
            asked = [asked[0] * limit / level, asked[1] * limit / level, asked[2]];
        }
        // PX4 held by accelerations alone sinks slowly.
        let sink = if px4 && matches!(self.wish, Wish::Accel(_)) { 0.05 } else { 0.0 };
        for k in 0..3 {
            self.accel[k] += (asked[k] - self.accel[k]) * STEP / 0.35;
            let drag = if k < 2 && !matches!(self.wish, Wish::Position(_)) { drag } else { 0.0 };
            let extra = if k == 2 { sink } else { 0.0 };
            self.velocity[k] += (self.accel[k] - drag * self.velocity[k] + extra) * STEP;
            self.position[k] += self.velocity[k] * STEP;
        }
        self.fastest = self.fastest.max(self.velocity[0].hypot(self.velocity[1]));
        if self.accelerations > 0 {
            let height = -self.position[2];
            self.heights = [self.heights[0].min(height), self.heights[1].max(height)];
        }
        if self.position[2] > 0.0 {
            self.position[2] = 0.0;
            self.velocity = if on_ground { [0.0; 3] } else { self.velocity };
            self.velocity[2] = 0.0;
        }
    }

    fn report(&mut self) {
        if self.time >= self.next_beat {
            self.next_beat = self.time + 1.0;
            self.beat();
        }
        self.report_logged();
        let Some(period) = self.stream_period.filter(|_| !self.blind) else { return };
        if self.time >= self.next_report {
            self.next_report = self.time + period;
            let [x, y, z] = self.position.map(|v| v as f32);
            let [vx, vy, vz] = self.velocity.map(|v| v as f32);
            let time_boot_ms = self.clock_ahead_ms.wrapping_add((self.up() * 1e3) as u32);
            let message = LOCAL_POSITION_NED_DATA { time_boot_ms, x, y, z, vx, vy, vz };
            self.encoder.push(&mut self.out, &message);
            let [lat, lon] = Site::default().latitude_longitude([x, y]);
            let relative_alt = (-z * 1e3) as i32;
            let message =
                GLOBAL_POSITION_INT_DATA { time_boot_ms, lat, lon, relative_alt, ..Default::default() };
            self.encoder.push(&mut self.out, &message);
        }
    }

    /// What a log wants, as far as it was asked for.
    fn report_logged(&mut self) {
        let (now, up) = (self.time, self.up());
        let due: Vec<u32> =
            self.logged.iter().filter(|(_, (_, next))| *next <= now).map(|(&id, _)| id).collect();
        for id in due {
            if let Some((every, next)) = self.logged.get_mut(&id) {
                *next = now + *every;
            }
            let (encoder, out) = (&mut self.encoder, &mut self.out);
            match id {
                ATTITUDE_DATA::ID => {
                    encoder
                        .push(out, &ATTITUDE_DATA { time_boot_ms: (up * 1e3) as u32, ..Default::default() });
                }
                GPS_RAW_INT_DATA::ID => encoder.push(out, &GPS_RAW_INT_DATA::default()),
                SYS_STATUS_DATA::ID => encoder.push(out, &SYS_STATUS_DATA::default()),
                BATTERY_STATUS_DATA::ID => encoder.push(out, &BATTERY_STATUS_DATA::default()),
                _ => {}
            }
        }
    }

    fn beat(&mut self) {
        let px4 = self.stack == Stack::Px4;
        let mut base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
        base_mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, self.armed);
        let message = HEARTBEAT_DATA {
            custom_mode: self.mode,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: if px4 {
                MavAutopilot::MAV_AUTOPILOT_PX4
            } else {
                MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA
            },
            base_mode,
            system_status: match (self.distress, self.armed) {
                (true, _) => MavState::MAV_STATE_CRITICAL,
                (false, true) => MavState::MAV_STATE_ACTIVE,
                (false, false) => MavState::MAV_STATE_STANDBY,
            },
            mavlink_version: 3,
        };
        self.encoder.push(&mut self.out, &message);
        if let Some(radio) = &mut self.radio {
            let autopilot = MavAutopilot::MAV_AUTOPILOT_INVALID;
            radio.push(&mut self.out, &HEARTBEAT_DATA { autopilot, ..Default::default() });
        }
    }

    fn say(&mut self, severity: MavSeverity, text: &str) {
        const LENGTH: usize = 50;
        if text.len() <= LENGTH {
            let message = STATUSTEXT_DATA { severity, text: text.into(), ..Default::default() };
            return self.encoder.push(&mut self.out, &message);
        }
        self.texts += 1;
        // A text that fills its last part ends with an empty one.
        for part in 0..=text.len() / LENGTH {
            let end = text.len().min((part + 1) * LENGTH);
            let text = text.get(part * LENGTH..end).unwrap_or_default().into();
            let message = STATUSTEXT_DATA { severity, text, id: self.texts, chunk_seq: part as u8 };
            self.encoder.push(&mut self.out, &message);
        }
    }

    /// A datagram has been sent to it.
    pub fn datagram(&mut self, bytes: &[u8]) {
        let due = self.arrives(self.inbox.back().map(|(due, _)| *due));
        if due <= self.time {
            return self.hear(bytes);
        }
        self.inbox.push_back((due, bytes.to_vec()));
    }

    fn hear(&mut self, bytes: &[u8]) {
        for packet in self.decoder.datagram(bytes) {
            if let Some(ask) = CommandLong::of(&packet) {
                self.command(&ask, (packet.system, packet.component));
            } else if let Some(target) = SetPositionTargetLocalNed::of(&packet) {
                self.target(&target);
            } else if let Some(ask) = ParamRequestRead::of(&packet).filter(|ask| ask.target.system <= 1) {
                self.params.answer(&ask, &mut self.encoder, &mut self.out);
            } else if ParamRequestList::of(&packet).is_some_and(|ask| ask.target.system <= 1) {
                self.params.list(&mut self.encoder, &mut self.out);
            } else if let Some(asked) = ParamSet::of(&packet).filter(|asked| asked.target.system <= 1) {
                self.params.set(&asked, &mut self.encoder, &mut self.out);
            } else if let Some(sync) = Timesync::of(&packet).filter(|sync| sync.tc1 == 0) {
                let target = (packet.system, packet.component).into();
                let answer = Timesync { tc1: (self.up() * 1e9) as i64 + 1, ts1: sync.ts1, target };
                self.encoder.push_view(&mut self.out, &answer);
            }
        }
    }

    fn command(&mut self, ask: &CommandLong, asker: (u8, u8)) {
        let CommandLong { params, command, target, .. } = *ask;
        if target.system > 1 {
            return;
        }
        if let Some(radio) = self.radio.as_mut().filter(|_| target.component == 68) {
            self.powers.push(params[0]);
            return radio.push_ack(&mut self.out, command, MavResult::MAV_RESULT_ACCEPTED, asker);
        }
        if command == 176 && self.deaf_to_modes > 0 {
            self.deaf_to_modes -= 1;
            return;
        }
        let result = match command {
            176 => self.mode_asked(params),
            400 => self.arm(params[0] == 1.0),
            22 => self.take_off(params[6]),
            511 if params[0] == 32.0 && self.stack == Stack::Px4 => MavResult::MAV_RESULT_ACCEPTED,
            511 if params[0] == 32.0 => {
                self.stream_period = Some(f64::from(params[1]) / 1e6);
                MavResult::MAV_RESULT_ACCEPTED
            }
            511 => {
                let every = f64::from(params[1]) / 1e6;
                self.logged.insert(params[0] as u32, (every, self.time));
                MavResult::MAV_RESULT_ACCEPTED
            }
            _ => MavResult::MAV_RESULT_UNSUPPORTED,
        };
        self.encoder.push_ack(&mut self.out, command, result, asker);
    }

    fn mode_asked(&mut self, params: [f32; 7]) -> MavResult {
        let (main, sub) = (params[1] as u32, params[2] as u32);
        if params[0] as u32 & 1 == 0 {
            return MavResult::MAV_RESULT_DENIED;
        }
        match self.stack {
            Stack::ArduPilot if self.up() < CHECKS / 2.0 => MavResult::MAV_RESULT_FAILED,
            Stack::ArduPilot if self.blind && main == GUIDED => {
                self.say(
                    MavSeverity::MAV_SEVERITY_WARNING,
                    "Mode change to GUIDED failed: requires position",
                );
                MavResult::MAV_RESULT_FAILED
            }
            Stack::ArduPilot => {
                self.mode = main;
                if self.armed && self.position[2] < -0.5 {
                    self.wish = Wish::Stop;
                }
                MavResult::MAV_RESULT_ACCEPTED
            }
            Stack::Px4 if main == 6 => {
                let streamed = self.setpoint.is_some_and(|(newest, first)| newest - first > 1.0);
                if !streamed {
                    let text = "Switching to Offboard is currently not available";
                    self.say(MavSeverity::MAV_SEVERITY_WARNING, text);
                    return MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
                }
                self.mode = OFFBOARD;
                MavResult::MAV_RESULT_ACCEPTED
            }
            Stack::Px4 => {
                self.set_mode(main << 16 | sub << 24);
                MavResult::MAV_RESULT_ACCEPTED
            }
        }
    }

    fn arm(&mut self, arm: bool) -> MavResult {
        let flying = self.position[2] < -0.5;
        if !arm && flying {
            return MavResult::MAV_RESULT_FAILED;
        }
        if arm && self.stack == Stack::ArduPilot && self.up() < CHECKS {
            self.say(MavSeverity::MAV_SEVERITY_CRITICAL, "Arm: Accels calibrating");
            return MavResult::MAV_RESULT_FAILED;
        }
        self.armed = arm;
        MavResult::MAV_RESULT_ACCEPTED
    }

    fn take_off(&mut self, height: f32) -> MavResult {
        if self.stack == Stack::Px4 || !self.armed || !self.controlled() {
            return MavResult::MAV_RESULT_FAILED;
        }
        self.wish = Wish::Position([self.position[0], self.position[1], -f64::from(height)]);
        MavResult::MAV_RESULT_ACCEPTED
    }

    fn target(&mut self, asked: &SetPositionTargetLocalNed) {
        let mask = asked.type_mask;
        let (position, accel) = (asked.position.map(f64::from), asked.acceleration.map(f64::from));
        if asked.target.system > 1 || asked.coordinate_frame != 1 {
            return self.say(MavSeverity::MAV_SEVERITY_WARNING, "SET_POSITION_TARGET_LOCAL_NED invalid");
        }
        let speed = asked.velocity.map(f64::from);
        let (has_position, has_accel) = (mask & 0b111 == 0, mask & 0b1_1100_0000 == 0);
        let has_speed = mask & 0b11_1000 == 0;
        if self.stack == Stack::Px4 && !has_position && !has_accel {
            return self.say(MavSeverity::MAV_SEVERITY_WARNING, "SET_POSITION_TARGET_LOCAL_NED invalid");
        }
        let first = self.setpoint.map_or(self.time, |(_, first)| first);
        self.setpoint = Some((self.time, first));
        if !self.controlled() || !self.armed {
            return;
        }
        // ArduCopter takes setpoints in the air alone.
        if self.stack == Stack::ArduPilot && self.position[2] > -0.5 {
            return;
        }
        self.wish = if has_accel {
            let finite = accel.iter().chain(&speed).all(|a| a.is_finite());
            self.poisoned |= !finite && self.stack == Stack::ArduPilot;
            self.accelerations += 1;
            match finite {
                true if has_speed => Wish::Speed(speed, accel),
                true => Wish::Accel(accel),
                false => Wish::Stop,
            }
        } else if has_position {
            Wish::Position(position)
        } else {
            Wish::Stop
        };
    }
}
