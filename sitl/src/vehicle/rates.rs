//! How often each peer gets what: the vehicle's answers to SET_MESSAGE_INTERVAL,
//! GET_MESSAGE_INTERVAL, REQUEST_MESSAGE and REQUEST_DATA_STREAM. Rates belong to the peer that asked.
//!
//! | asked | answered |
//! |---|---|
//! | SET_MESSAGE_INTERVAL -1, 0 (the default rate), 20 ms to 2147 s | ACCEPTED |
//! | another interval, not a number, an unknown message | DENIED |
//! | a percept's message, at -1 | DENIED: it goes with every control interval, and from now on with nothing else |
//! | a percept's message, faster than the control interval | ACCEPTED: beside the percept |
//! | a percept's message, slower | ACCEPTED: the percept has it as often already |
//! | DATA_TRANSMISSION_HANDSHAKE (130) | frames: 0 with every control interval, -1 none, else at least so far apart |
//! | HEARTBEAT | ACCEPTED at 0 and 1 s, else DENIED |
//! | GET_MESSAGE_INTERVAL | MESSAGE_INTERVAL (us, -1 for none), then ACCEPTED; unknown: 0, then DENIED |
//! | REQUEST_MESSAGE | ACCEPTED, then the message; unknown: DENIED; the radio's before tick 1: TEMPORARILY_REJECTED |
//! | REQUEST_DATA_STREAM | the group's streams, at most 50 Hz; percepts stay |

use std::collections::BTreeMap;
use std::time::Duration;

use super::Vehicle;
use super::commands::IMAGE;
use super::messages::{self, Goes, ROWS, Row};
use crate::link::dialect::{self, MavResult};
use crate::link::{AUTOPILOT, PeerId};

/// The shortest interval of a stream: 50 Hz.
const SHORTEST_US: f32 = 20_000.0;
/// The rates of a stream, Hz: from the longest interval that MESSAGE_INTERVAL can tell to the shortest.
const RATES_HZ: std::ops::RangeInclusive<f32> = 1e6 / i32::MAX as f32..=1e6 / SHORTEST_US;
const HEARTBEAT_US: i32 = 1_000_000;

/// The streams of a peer.
#[derive(Debug, Clone, Default)]
pub(super) struct Rates {
    streams: BTreeMap<u32, RateStream>,
}

#[derive(Debug, Clone, Copy)]
struct RateStream {
    every: Duration,
    due: Duration,
}

impl Rates {
    /// Sends a message so often from now on, or no longer.
    pub fn set(&mut self, id: u32, every: Option<Duration>, now: Duration) {
        match every {
            Some(every) => self.streams.insert(id, RateStream { every, due: now }),
            None => self.streams.remove(&id),
        };
    }

    /// The interval of a message.
    pub fn every(&self, id: u32) -> Option<Duration> {
        self.streams.get(&id).map(|stream| stream.every)
    }

    /// When the next message is due.
    pub fn due(&self) -> Option<Duration> {
        self.streams.values().map(|stream| stream.due).min()
    }

    /// The messages that are due. What a busy machine has missed is left out, not made up for.
    pub fn take_due(&mut self, now: Duration) -> Vec<u32> {
        let mut due = Vec::new();
        for (&id, stream) in self.streams.iter_mut().filter(|(_, stream)| stream.due <= now) {
            due.push(id);
            stream.due = (stream.due + stream.every).max(now + stream.every / 2);
        }
        due
    }
}

/// The interval of so many messages a second, within [`RATES_HZ`]; none for 0, and for what is no number.
fn interval(hz: f64) -> Option<Duration> {
    let (least, most) = (f64::from(*RATES_HZ.start()), f64::from(*RATES_HZ.end()));
    (hz > 0.0).then(|| Duration::from_secs_f64(1.0 / hz.clamp(least, most)))
}

impl Vehicle {
    /// Whether a stream can have this rate, Hz; 0 is none.
    pub(super) fn takes_rate(hz: f32) -> bool {
        hz == 0.0 || RATES_HZ.contains(&hz)
    }

    /// Gives a peer the streams that it need not ask for.
    pub(super) fn set_default_rates(&mut self, address: PeerId, now: Duration) {
        for row in ROWS {
            let every = self.default_interval(row);
            if let Some(peer) = self.peers.get_mut(&address) {
                peer.rates.set(row.id, every, now);
            }
        }
    }

    /// The interval of a message that nobody has set; none in lockstep.
    fn default_interval(&self, row: &Row) -> Option<Duration> {
        match row.goes {
            Goes::Stream(..) if self.period.is_some() => interval(self.default_hz(row.id)),
            _ => None,
        }
    }

    /// The default rate of a message in real time, Hz: the table's, or what was set since.
    pub(super) fn default_hz(&self, id: u32) -> f64 {
        let of_table = ROWS.iter().find_map(|row| match row.goes {
            Goes::Stream(hz, _) if row.id == id => Some(hz),
            _ => None,
        });
        self.default_hz.get(&id).copied().or(of_table).unwrap_or(0.0)
    }

    /// Sets a message's default rate, and its rate for every peer.
    pub(super) fn set_default_hz(&mut self, id: u32, hz: f64, now: Duration) {
        self.default_hz.insert(id, hz);
        if self.period.is_some() {
            for peer in self.peers.values_mut() {
                peer.rates.set(id, interval(hz), now);
            }
        }
    }

    /// The message with this number, if there is something to tell.
    pub(super) fn requested(
        &self,
        number: f32,
        component: u8,
        now: Duration,
    ) -> Result<&'static Row, MavResult> {
        let row = row(number, component).ok_or(MavResult::MAV_RESULT_DENIED)?;
        if row.ready(&self.state(now)) { Ok(row) } else { Err(MavResult::MAV_RESULT_TEMPORARILY_REJECTED) }
    }

    /// SET_MESSAGE_INTERVAL.
    pub(super) fn set_interval(
        &mut self,
        [number, us]: [f32; 2],
        component: u8,
        from: PeerId,
        now: Duration,
    ) -> MavResult {
        let control = self.control_interval();
        if number == IMAGE && component == AUTOPILOT {
            return self.set_image_interval(us, control, from);
        }
        let Some(row) = row(number, component) else { return MavResult::MAV_RESULT_DENIED };
        let every = match us {
            0.0 => self.default_interval(row),
            // What was beside the percept ends; the percept goes on.
            -1.0 if row.goes == Goes::Percept => {
                if let Some(peer) = self.peers.get_mut(&from) {
                    peer.rates.set(row.id, None, now);
                }
                return MavResult::MAV_RESULT_DENIED;
            }
            -1.0 => None,
            us if (SHORTEST_US..i32::MAX as f32).contains(&us) => {
                Some(Duration::from_secs_f64(f64::from(us) / 1e6))
            }
            _ => return MavResult::MAV_RESULT_DENIED,
        };
        if row.goes == Goes::Heartbeat {
            let same = us == 0.0 || us == HEARTBEAT_US as f32;
            return if same { MavResult::MAV_RESULT_ACCEPTED } else { MavResult::MAV_RESULT_DENIED };
        }
        let every = every.filter(|&every| row.goes != Goes::Percept || every < control);
        if let Some(peer) = self.peers.get_mut(&from) {
            peer.rates.set(row.id, every, now);
        }
        MavResult::MAV_RESULT_ACCEPTED
    }

    /// The rate of frames: with every control interval, or with each so many.
    fn set_image_interval(&mut self, us: f32, control: Duration, from: PeerId) -> MavResult {
        let every = match us {
            0.0 => Some(1),
            -1.0 => None,
            us if (1.0..i32::MAX as f32).contains(&us) => {
                Some((f64::from(us) / 1e6 / control.as_secs_f64() - 1e-6).ceil().max(1.0) as u64)
            }
            _ => return MavResult::MAV_RESULT_DENIED,
        };
        if let Some(peer) = self.peers.get_mut(&from) {
            peer.images = every;
        }
        MavResult::MAV_RESULT_ACCEPTED
    }

    fn image_interval_us(&self, from: PeerId) -> i32 {
        let every = self.peers.get(&from).and_then(|peer| peer.images);
        let us = every.map(|every| every as u128 * self.control_interval().as_micros());
        us.map_or(-1, |us| i32::try_from(us).unwrap_or(i32::MAX))
    }

    /// GET_MESSAGE_INTERVAL: tells the interval; gives the result to acknowledge.
    pub(super) fn tell_interval(&mut self, number: f32, component: u8, from: PeerId) -> MavResult {
        let is_image = number == IMAGE && component == AUTOPILOT;
        let row = row(number, component);
        let message_id = row.map_or(number as u16, |row| row.id as u16);
        let interval_us = match row {
            _ if is_image => self.image_interval_us(from),
            Some(row) => self.interval_us(row, from),
            None => 0,
        };
        let Some(peer) = self.peers.get_mut(&from) else { return MavResult::MAV_RESULT_FAILED };
        let mut datagram = Vec::new();
        peer.encoder(component)
            .push(&mut datagram, &dialect::MESSAGE_INTERVAL_DATA { interval_us, message_id });
        self.outbox.push_back((from, datagram));
        if row.is_some() || is_image { MavResult::MAV_RESULT_ACCEPTED } else { MavResult::MAV_RESULT_DENIED }
    }

    fn interval_us(&self, row: &Row, peer: PeerId) -> i32 {
        let stream = self.peers.get(&peer).and_then(|peer| peer.rates.every(row.id));
        match (row.goes, stream) {
            (Goes::Heartbeat, _) => HEARTBEAT_US,
            (_, Some(every)) => whole_us(every),
            (Goes::Percept, None) => whole_us(self.control_interval()),
            (_, None) => -1,
        }
    }

    /// The control interval on the wall; in lockstep, where the wall has none, the vehicle's.
    fn control_interval(&self) -> Duration {
        self.period.unwrap_or_else(|| Duration::from_secs_f64(self.clock.interval_s()))
    }

    /// REQUEST_DATA_STREAM: so many messages a second of each stream of a group; 0 stops them.
    pub(super) fn set_group(&mut self, group: u8, hz: f64, from: PeerId, now: Duration) {
        let Some(peer) = self.peers.get_mut(&from) else { return };
        for row in ROWS {
            if let Goes::Stream(_, member_of) = row.goes
                && member_of.is(group)
            {
                peer.rates.set(row.id, interval(hz), now);
            }
        }
    }
}

/// An interval as MESSAGE_INTERVAL tells it, µs: the longest that it can where it is longer.
fn whole_us(every: Duration) -> i32 {
    i32::try_from(every.as_micros()).unwrap_or(i32::MAX)
}

/// The row that a command's parameter names.
fn row(number: f32, component: u8) -> Option<&'static Row> {
    let id = number as u32;
    (id as f32 == number).then(|| messages::row(id, component)).flatten()
}
