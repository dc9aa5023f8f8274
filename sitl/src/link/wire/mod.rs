//! The table "our message, theirs". Knows MAVLink's fields, units and axes; no socket, no physics.
//!
//! | ours | theirs | from | fields |
//! |---|---|---|---|
//! | `Telemetry` position, velocity | LOCAL_POSITION_NED | 1 | x, vx north; y, vy east; z, vz down |
//! | `Telemetry::held` | POSITION_TARGET_LOCAL_NED | 1 | afx north, afy east, m/s²; `time_boot_ms` is *that command's*; mask 3135, or 0x0FFF before the first delivery |
//! | `Telemetry::obstacles` | DEBUG_VECT `OBSTACLE`; of further ones `OBSTACLE_2`, `OBSTACLE_3` ..., the last first | 1 | x north, y east, z radius, m |
//! | `LinkReport` (from tick 1 on) | NAMED_VALUE_FLOAT `SNR_DB`, `TXP`, `OUTAGE` | 68 | dB; 1 or 4; 0 or 1 |
//! | `LinkReport` for any station | RADIO_STATUS | 68 | rssi = 127 + 2 · SNR in dB, within 0..=254 |
//! | `Percept::frame` | image protocol, see [`super::image`] | 1 | PNG |
//! | `Command::power` | COMMAND_LONG 31010 (MAV_CMD_USER_1) to 68 | station | param1 = 1 or 4, param2 = time stamp or 0 |
//! | `Command::accel` | SET_POSITION_TARGET_LOCAL_NED | station | frame 1, mask 3135, afx north, afy east, m/s² |
//!
//! Other setpoints, which no station of ours sends, are in [`setpoint_of`].
//!
//! All time stamps are [`Clock::boot_ms`] of a tick. The messages of a telemetry report travel in
//! this order; a reader takes a POSITION_TARGET_LOCAL_NED only if its sequence number follows that
//! of the LOCAL_POSITION_NED, for its own stamp names another tick.

mod setpoint;

pub use setpoint::{Axes, Refusal, Setpoint, SetpointFrame, setpoint_of};

use super::boot_time::step_ms;
use super::dialect::{self, MavFrame, PositionTargetTypemask};
use super::encoder::Encoder;
use super::messages::command::{CommandInt, CommandLong};
use super::messages::telemetry::{DebugVect, LocalPositionNed, NamedValueFloat, PositionTargetLocalNed};
use super::messages::{Target, View};
use super::packet::Packet;
use super::packet::PacketRef;
use super::{AUTOPILOT, MessageData, RADIO};
use crate::radio::message::{Command, Held, LinkReport, Telemetry};
use crate::scenario::Scenario;
use crate::units::{MAX_OBSTACLES, Tick, TxPower};
use crate::world::obstacles::PerObstacle;

/// MAV_CMD_USER_1, here: transmit power of the station's radio.
pub const CMD_TX_POWER: u16 = 31010;

/// Tick 0 on the vehicle's clock, ms: it booted a second before. So a stamp of 0, which stations
/// without the vehicle's clock send, is never a tick's.
const BOOT_MS: u32 = 1000;

/// type_mask of an acceleration setpoint: position, velocity, yaw and yaw rate ignored.
const MASK_ACCEL: u16 = 3135;
/// type_mask of no setpoint at all.
const MASK_NOTHING: u16 = 0x0FFF;
const MASK_IGNORES_ACCEL: u16 = 64 | 128 | 256;

/// Name of the DEBUG_VECT of the obstacle with this index: `OBSTACLE`, `OBSTACLE_2`, `OBSTACLE_3` ...
fn obstacle_name(index: usize) -> String {
    if index == 0 { "OBSTACLE".into() } else { format!("OBSTACLE_{}", index + 1) }
}

/// The index that such a name means.
fn obstacle_index(name: &str) -> Option<usize> {
    let index = match name.strip_prefix("OBSTACLE")? {
        "" => 0,
        number => number.strip_prefix('_')?.parse::<usize>().ok()?.checked_sub(1)?,
    };
    (index < MAX_OBSTACLES && obstacle_name(index) == name).then_some(index)
}

/// GLOBAL_RELATIVE_ALT and its old integer twin.
const FRAMES_RELATIVE_ALT: [u8; 2] = [3, 6];
/// GLOBAL_TERRAIN_ALT and its old integer twin: the ground is level.
const FRAMES_TERRAIN_ALT: [u8; 2] = [10, 11];
/// GLOBAL and its old integer twin.
const FRAMES_SEA: [u8; 2] = [0, 5];

/// Ticks as milliseconds since the vehicle booted, and the constants that its messages carry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clock {
    interval_s: f64,
    radii_m: PerObstacle<f32>,
}

impl Clock {
    /// The clock of a flight.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        let scale = &scenario.scale;
        let radii_m = scenario.obstacles.iter().map(|o| (o.radius * scale.metres_per_unit) as f32);
        Self { interval_s: scale.interval_s, radii_m: radii_m.collect() }
    }

    /// `time_boot_ms` of a tick.
    #[must_use]
    pub fn boot_ms(&self, tick: Tick) -> u32 {
        tick.to_boot_ms(self.interval_s).wrapping_add(BOOT_MS)
    }

    /// The tick with this `time_boot_ms`, or `None` if it is no tick's.
    #[must_use]
    pub fn tick(&self, boot_ms: u32) -> Option<Tick> {
        boot_ms.checked_sub(BOOT_MS).and_then(|ms| Tick::from_boot_ms(ms, self.interval_s))
    }

    /// The same where the milliseconds may have come round, after 49.7 days: of the ticks with this
    /// `time_boot_ms` the one nearest to `current`.
    #[must_use]
    pub fn tick_near(&self, boot_ms: u32, current: Tick) -> Option<Tick> {
        let interval_ms = self.interval_s * 1e3;
        let now_ms = (current.0 as f64 * interval_ms).round();
        // The shorter way round.
        let ahead = boot_ms.wrapping_sub(self.boot_ms(current)) as i32;
        let ms = now_ms + f64::from(ahead);
        let tick = Tick((ms / interval_ms).round().max(0.0) as u64);
        (ms >= 0.0 && self.boot_ms(tick) == boot_ms).then_some(tick)
    }

    /// The tick with this `time_boot_ms` that a vehicle has which was at `before`: its milliseconds may have come
    /// round meanwhile, or its clock may have begun anew.
    #[must_use]
    pub fn tick_after(&self, boot_ms: u32, before: Option<Tick>) -> Option<Tick> {
        match before.filter(|&before| step_ms(self.boot_ms(before), boot_ms).is_some()) {
            Some(before) => self.tick_near(boot_ms, before),
            None => self.tick(boot_ms),
        }
    }

    /// Length of a control interval, seconds.
    #[must_use]
    pub fn interval_s(&self) -> f64 {
        self.interval_s
    }
}

/// Appends a report: autopilot's messages, then from tick 1 on the radio's. `vertical` is z and vz of
/// the local frame, down, m and m/s.
pub fn push_telemetry(
    report: &Telemetry,
    clock: &Clock,
    vertical: [f32; 2],
    autopilot: &mut Encoder,
    radio: &mut Encoder,
    datagram: &mut Vec<u8>,
) {
    push_position(report, clock, vertical, autopilot, datagram);
    push_held(report, clock, autopilot, datagram);
    push_obstacles(report, clock, autopilot, datagram);
    if let Some(link) = report.link {
        push_link_values(&link, clock.boot_ms(report.tick), radio, datagram);
        push_radio_status(&link, radio, datagram);
    }
}

/// Appends LOCAL_POSITION_NED; `z` and `vz` down.
pub fn push_position(
    report: &Telemetry,
    clock: &Clock,
    [z, vz]: [f32; 2],
    autopilot: &mut Encoder,
    datagram: &mut Vec<u8>,
) {
    let ([x, y], [vx, vy]) = (report.position, report.velocity);
    let time_boot_ms = clock.boot_ms(report.tick);
    let position = dialect::LOCAL_POSITION_NED_DATA { time_boot_ms, x, y, z, vx, vy, vz };
    autopilot.push(datagram, &position);
}

/// Appends POSITION_TARGET_LOCAL_NED.
pub fn push_held(report: &Telemetry, clock: &Clock, autopilot: &mut Encoder, datagram: &mut Vec<u8>) {
    let (stamp, [afx, afy], mask) = match report.held {
        Some(held) => (clock.boot_ms(held.tick), held.accel, MASK_ACCEL),
        None => (clock.boot_ms(report.tick), [0.0; 2], MASK_NOTHING),
    };
    let target = dialect::POSITION_TARGET_LOCAL_NED_DATA {
        time_boot_ms: stamp,
        afx,
        afy,
        type_mask: PositionTargetTypemask::from_bits_retain(mask),
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        ..Default::default()
    };
    autopilot.push(datagram, &target);
}

/// Appends a DEBUG_VECT for each obstacle, `OBSTACLE` last: the first report of a flight ends with it.
pub fn push_obstacles(report: &Telemetry, clock: &Clock, autopilot: &mut Encoder, datagram: &mut Vec<u8>) {
    let time_usec = u64::from(clock.boot_ms(report.tick)) * 1000;
    for (n, ([x, y], z)) in
        report.obstacles.iter().copied().zip(clock.radii_m.iter().copied()).enumerate().rev()
    {
        let name = obstacle_name(n).as_str().into();
        autopilot.push(datagram, &dialect::DEBUG_VECT_DATA { time_usec, x, y, z, name });
    }
}

/// Appends NAMED_VALUE_FLOAT `SNR_DB`, `TXP` and `OUTAGE`.
pub fn push_link_values(link: &LinkReport, time_boot_ms: u32, radio: &mut Encoder, datagram: &mut Vec<u8>) {
    let values = [
        ("SNR_DB", link.snr_db),
        ("TXP", link.power.level() as f32),
        ("OUTAGE", f32::from(u8::from(link.outage))),
    ];
    for (name, value) in values {
        radio.push(datagram, &dialect::NAMED_VALUE_FLOAT_DATA { time_boot_ms, value, name: name.into() });
    }
}

/// Appends RADIO_STATUS.
pub fn push_radio_status(link: &LinkReport, radio: &mut Encoder, datagram: &mut Vec<u8>) {
    // 255 is "unknown" in the standard.
    let status = dialect::RADIO_STATUS_DATA {
        rssi: (127.0 + 2.0 * link.snr_db).round().clamp(0.0, 254.0) as u8,
        remrssi: 255,
        txbuf: 100,
        noise: 255,
        remnoise: 255,
        ..Default::default()
    };
    radio.push(datagram, &status);
}

/// Puts the messages of a report together again.
#[derive(Debug, Clone, Default)]
pub struct TelemetryReader {
    open: Option<Open>,
    /// Of the newest report that has begun.
    newest: Option<Tick>,
    malformed: u64,
}

/// A report of which some messages have come.
#[derive(Debug, Clone)]
struct Open {
    system: u8,
    sequence: u8,
    boot_ms: u32,
    tick: Tick,
    position: [f32; 2],
    velocity: [f32; 2],
    held: Option<Option<Held>>,
    obstacles: PerObstacle<Option<[f32; 2]>>,
    snr_db: Option<f32>,
    power: Option<TxPower>,
    outage: Option<bool>,
}

impl TelemetryReader {
    /// Takes a packet of the vehicle; hands out a report when its last message has come.
    pub fn push(&mut self, packet: &Packet, clock: &Clock) -> Option<Telemetry> {
        let known = match packet.id {
            dialect::LOCAL_POSITION_NED_DATA::ID => {
                self.open = Open::begin(packet, clock, self.newest);
                self.newest = self.open.as_ref().map(|open| open.tick).or(self.newest);
                self.open.is_some()
            }
            dialect::POSITION_TARGET_LOCAL_NED_DATA::ID
            | dialect::DEBUG_VECT_DATA::ID
            | dialect::NAMED_VALUE_FLOAT_DATA::ID => {
                let open = self.open.as_mut().filter(|open| open.system == packet.system)?;
                open.add(packet, clock).is_some()
            }
            _ => return None,
        };
        if !known {
            self.malformed += 1;
            self.open = None;
        }
        let report = self.open.as_ref()?.complete()?;
        self.open = None;
        Some(report)
    }

    /// Messages that did not fit: another flight's clock, a value that is not finite.
    #[must_use]
    pub fn malformed(&self) -> u64 {
        self.malformed
    }
}

impl Open {
    fn begin(packet: &Packet, clock: &Clock, before: Option<Tick>) -> Option<Self> {
        let LocalPositionNed { time_boot_ms, position: [x, y, _], velocity: [vx, vy, _] } =
            LocalPositionNed::of(packet)?;
        Some(Self {
            system: packet.system,
            sequence: packet.sequence,
            boot_ms: time_boot_ms,
            tick: clock.tick_after(time_boot_ms, before)?,
            position: finite([x, y])?,
            velocity: finite([vx, vy])?,
            held: None,
            obstacles: clock.radii_m.iter().map(|_| None).collect(),
            snr_db: None,
            power: None,
            outage: None,
        })
    }

    /// `None` if the message does not belong to this report.
    fn add(&mut self, packet: &Packet, clock: &Clock) -> Option<()> {
        if let Some(target) = PositionTargetLocalNed::of(packet) {
            if packet.sequence != self.sequence.wrapping_add(1) {
                return None;
            }
            self.held = Some(if target.type_mask & MASK_IGNORES_ACCEL == 0 {
                let [north, east, _] = target.acceleration;
                Some(Held {
                    tick: clock.tick_after(target.time_boot_ms, Some(self.tick))?,
                    accel: finite([north, east])?,
                })
            } else {
                None
            });
        } else if let Some(DebugVect { time_usec, vector: [x, y, _], name }) = DebugVect::of(packet) {
            let Some(index) = obstacle_index(&name.lossy()) else { return Some(()) };
            if time_usec != u64::from(self.boot_ms) * 1000 {
                return None;
            }
            // A vehicle with another number of obstacles flies another scenario.
            *self.obstacles.get_mut(index)? = Some(finite([x, y])?);
            if index == 0 && self.obstacles.contains(&None) {
                return None;
            }
        } else if let Some(NamedValueFloat { time_boot_ms, value, name }) = NamedValueFloat::of(packet) {
            let name = name.lossy();
            if !matches!(&*name, "SNR_DB" | "TXP" | "OUTAGE") {
                return Some(());
            }
            if time_boot_ms != self.boot_ms || !value.is_finite() {
                return None;
            }
            match &*name {
                "SNR_DB" => self.snr_db = Some(value),
                "TXP" => self.power = Some(TxPower::from_level(value).ok()?),
                _ => self.outage = Some(value != 0.0),
            }
        }
        Some(())
    }

    fn complete(&self) -> Option<Telemetry> {
        let link = match (self.snr_db, self.power, self.outage) {
            (Some(snr_db), Some(power), Some(outage)) => Some(LinkReport { snr_db, power, outage }),
            _ if self.tick == Tick(0) => None,
            _ => return None,
        };
        Some(Telemetry {
            tick: self.tick,
            position: self.position,
            velocity: self.velocity,
            obstacles: self.obstacles.iter().copied().collect::<Option<_>>()?,
            held: self.held?,
            link,
        })
    }
}

fn finite<const N: usize>(values: [f32; N]) -> Option<[f32; N]> {
    values.iter().all(|value| value.is_finite()).then_some(values)
}

/// Appends a command: power first, so that it is set when the setpoint arrives, wherever a stream is
/// cut.
pub fn push_command(
    command: &Command,
    clock: &Clock,
    system: u8,
    station: &mut Encoder,
    datagram: &mut Vec<u8>,
) {
    let power = dialect::COMMAND_LONG_DATA {
        param1: command.power.level() as f32,
        param2: clock.boot_ms(command.tick) as f32,
        command: dialect::MavCmd::MAV_CMD_USER_1,
        target_system: system,
        target_component: RADIO,
        ..Default::default()
    };
    station.push(datagram, &power);
    push_setpoint(command.tick, command.accel, clock, system, station, datagram);
}

/// Appends a setpoint alone.
pub fn push_setpoint(
    tick: Tick,
    accel: [f32; 2],
    clock: &Clock,
    system: u8,
    station: &mut Encoder,
    datagram: &mut Vec<u8>,
) {
    let setpoint = dialect::SET_POSITION_TARGET_LOCAL_NED_DATA {
        time_boot_ms: clock.boot_ms(tick),
        afx: accel[0],
        afy: accel[1],
        type_mask: PositionTargetTypemask::from_bits_retain(MASK_ACCEL),
        target_system: system,
        target_component: AUTOPILOT,
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        ..Default::default()
    };
    station.push(datagram, &setpoint);
}

/// What a height counts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Above {
    /// The sea.
    Sea,
    /// The ground at home, which is level.
    Home,
}

impl Above {
    /// What the heights of a MAV_FRAME of the globe count from; `None` for other frames.
    #[must_use]
    pub fn of_frame(frame: u8) -> Option<Self> {
        match frame {
            frame if FRAMES_SEA.contains(&frame) => Some(Self::Sea),
            frame if FRAMES_RELATIVE_ALT.contains(&frame) || FRAMES_TERRAIN_ALT.contains(&frame) => {
                Some(Self::Home)
            }
            _ => None,
        }
    }
}

/// Whether latitude and longitude, degrees, are a place.
fn on_globe([latitude, longitude]: &[f64; 2]) -> bool {
    latitude.abs() <= 90.0 && longitude.abs() <= 180.0
}

/// A COMMAND_LONG or COMMAND_INT, read from its bytes: the dialect refuses commands it has no name
/// for, and a vehicle must answer those too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ask {
    /// MAV_CMD.
    pub command: u16,
    /// param1 to param4.
    pub params: [f32; 4],
    /// param5 and param6, or x and y, as latitude and longitude in degrees; `None` unless both are
    /// there, in a frame of the globe, and a place on it.
    pub place: Option<[f64; 2]>,
    /// Whether the place is where it is: param5 and param6 are not numbers, or the greatest integers.
    pub stays: bool,
    /// param7 or z, m.
    pub height: f32,
    /// What it counts from: home in a COMMAND_LONG, as with ArduCopter; `None` in a frame that is not
    /// of the globe.
    pub above: Option<Above>,
    /// To whom.
    pub target: Target,
}

/// The command in a packet.
#[must_use]
pub fn ask_of<'a>(packet: impl Into<PacketRef<'a>>) -> Option<Ask> {
    let packet = packet.into();
    if let Some(CommandLong { params, command, target, .. }) = CommandLong::of(packet) {
        let [param1, param2, param3, param4, x, y, height] = params;
        let place = Some([x, y].map(f64::from)).filter(on_globe);
        let (params, above) = ([param1, param2, param3, param4], Some(Above::Home));
        return Some(Ask { command, params, place, stays: x.is_nan() && y.is_nan(), height, above, target });
    }
    let CommandInt { params, place, z: height, command, target, frame, .. } = CommandInt::of(packet)?;
    let above = Above::of_frame(frame);
    let degrees = above.map(|_| place.map(|v| f64::from(v) / 1e7)).filter(on_globe);
    Some(Ask { command, params, place: degrees, stays: place == [i32::MAX; 2], height, above, target })
}

#[cfg(test)]
mod tests;
