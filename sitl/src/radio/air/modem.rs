//! Frames through the air: a state machine that queues, sends, loses, repeats and delays them.
//!
//! [`Air`] opens no socket and reads no clock. Frames are offered at a time, and come out at the time at which they
//! arrive, or with the reason why they never will. Whether a packet is lost is a function of (seed, link, way, time
//! slot, kind, number of the kind in the slot) and of the SNR there, so a heartbeat more changes the fate of no other
//! frame in the same slot.

use std::collections::VecDeque;
use std::time::Duration;

use nalgebra::Vector3;
use rand::RngExt;

use super::blockage::DiscObstacle;
use super::channel::{AirChannel, LinkBudget, Way, mix};
use super::config::{AirRadio, Duplex, Modem, RadioError};
use crate::units::noise::Stream;

/// Nanoseconds since the radio was switched on.
type Nanos = u64;

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FrameFate {
    /// It arrived.
    Arrived,
    /// Noise or fading destroyed it, and every repetition.
    Noise,
    /// The SNR was below what the slowest rate needs.
    Outage,
    /// It found no room in the queue.
    QueueFull,
}

impl FrameFate {
    /// The word of tables and ledgers.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Arrived => "arrived",
            Self::Noise => "noise",
            Self::Outage => "outage",
            Self::QueueFull => "queue full",
        }
    }
}

/// A frame whose fate is settled. Times are since the radio was switched on.
#[derive(Debug, Clone, PartialEq)]
pub struct CarriedFrame<T> {
    /// The frame.
    pub frame: T,
    /// Its way.
    pub way: Way,
    /// What the user called its kind, such as a message id.
    pub kind: u32,
    /// Its length.
    pub bytes: usize,
    /// When it was offered.
    pub offered: Duration,
    /// When it was first on the air.
    pub on_air: Option<Duration>,
    /// How long it was on the air, with all repetitions.
    pub air_time: Duration,
    /// When it arrived, or was given up.
    pub done: Duration,
    /// Packets that were sent, with repetitions.
    pub packets: u32,
    /// SNR when it was last sent, dB; when it found no room, that of the moment.
    pub snr_db: f64,
    /// What became of it.
    pub fate: FrameFate,
}

impl<T> CarriedFrame<T> {
    /// From the offer to the arrival.
    #[must_use]
    pub fn delay(&self) -> Duration {
        self.done.saturating_sub(self.offered)
    }
}

/// What one end's radio tells of a way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AirReport {
    /// Received power and noise in the slot.
    pub budget: LinkBudget,
    /// Free part of the sender's queue, in [0, 1].
    pub room: f64,
    /// Frames lost so far, for whatever reason.
    pub lost: u64,
    /// Frames that arrived so far.
    pub arrived: u64,
    /// Bytes that arrived so far.
    pub arrived_bytes: u64,
}

/// A radio between one vehicle and one station.
#[derive(Debug)]
pub struct Air<T> {
    channel: AirChannel,
    place: Vector3<f64>,
    slot: Nanos,
    lanes: [Lane<T>; 2],
}

/// One way.
#[derive(Debug)]
struct Lane<T> {
    way: Way,
    queue: VecDeque<CarriedFrame<T>>,
    queued_bytes: usize,
    sending: Option<Sending<T>>,
    /// When the sender is free for the next frame.
    free: Nanos,
    /// When its last packet ends.
    on_air_until: Nanos,
    /// Frames that arrive later, in order.
    arriving: VecDeque<CarriedFrame<T>>,
    /// Lost frames, in order of their ends.
    lost: VecDeque<CarriedFrame<T>>,
    last_arrival: Nanos,
    draws: KindDraws,
    budget: Option<(Nanos, Vector3<f64>, LinkBudget)>,
    counts: [u64; 3],
}

/// The frame whose turn it is.
#[derive(Debug)]
struct Sending<T> {
    frame: CarriedFrame<T>,
    /// Frames that share its packet.
    joined: Vec<CarriedFrame<T>>,
    /// All of them together.
    bytes: usize,
    /// Packets that have not got through.
    left: u32,
    /// Repetitions of this packet.
    repeats: u32,
    phase: Phase,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Not before this time.
    Ready(Nanos),
    /// Until this time, with this end.
    OnAir(Nanos, FrameFate),
}

/// How often a kind has drawn in the slot.
#[derive(Debug, Default)]
struct KindDraws {
    slot: u64,
    kinds: Vec<(u32, u64)>,
}

impl KindDraws {
    /// The number of the kind's next draw in a slot.
    fn next(&mut self, slot: u64, kind: u32) -> u64 {
        if self.slot != slot {
            self.slot = slot;
            self.kinds.clear();
        }
        if let Some((_, count)) = self.kinds.iter_mut().find(|(known, _)| *known == kind) {
            *count += 1;
            return *count;
        }
        self.kinds.push((kind, 0));
        0
    }
}

fn nanos(time: Duration) -> Nanos {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

fn from_seconds(seconds: f64) -> Nanos {
    (seconds * 1e9).round() as Nanos
}

impl<T> Air<T> {
    /// A radio that was just switched on, with the vehicle at the origin on the ground; link number `link` of a seed.
    ///
    /// # Errors
    /// The file of the buildings is wrong.
    pub fn new(radio: AirRadio, seed: u64, link: u64) -> Result<Self, RadioError> {
        let slot = from_seconds(radio.slot_s).max(1);
        let channel = AirChannel::new(radio, seed, link)?;
        Ok(Self { channel, place: Vector3::zeros(), slot, lanes: Way::BOTH.map(Lane::new) })
    }

    /// The radio.
    #[must_use]
    pub fn radio(&self) -> &AirRadio {
        self.channel.radio()
    }

    /// The vehicle is at `place` from now on: north, east and height above the ground, m.
    pub fn set_place(&mut self, place: [f64; 3]) {
        self.place = Vector3::from(place);
    }

    /// The station is at `place`: north and east, and the height of the ground there, m.
    pub fn set_base(&mut self, place: [f64; 3]) {
        self.channel.set_base(place);
        for lane in &mut self.lanes {
            lane.budget = None;
        }
    }

    /// The station transmits at this level from now on, an index of its `powers_dbm`; the highest where there is no
    /// such level.
    pub fn set_power(&mut self, level: usize) {
        self.channel.set_power(level);
        for lane in &mut self.lanes {
            lane.budget = None;
        }
    }

    /// The upright cylinders stand here from now on.
    pub fn set_discs(&mut self, discs: Vec<DiscObstacle>) {
        self.channel.set_discs(discs);
        for lane in &mut self.lanes {
            lane.budget = None;
        }
    }

    /// Bytes that wait for their turn or are on the air.
    #[must_use]
    pub fn waiting(&self, way: Way) -> usize {
        self.lanes[way as usize].queued_bytes
    }

    /// A frame is handed to the sender of its way. Call [`Air::poll`] up to `now` first.
    pub fn offer(&mut self, now: Duration, way: Way, kind: u32, bytes: usize, frame: T) {
        let snr_db = self.budget(now, way).snr_db();
        let modem = self.modem(way);
        let room = modem.queue_bytes;
        let offered = CarriedFrame {
            frame,
            way,
            kind,
            bytes,
            offered: now,
            on_air: None,
            air_time: Duration::ZERO,
            done: now,
            packets: 0,
            snr_db,
            fate: FrameFate::QueueFull,
        };
        let lane = &mut self.lanes[way as usize];
        // A frame that is longer than the whole queue may still go if it is alone.
        if lane.queued_bytes > 0 && lane.queued_bytes + bytes > room {
            lane.lost.push_back(offered);
            return;
        }
        lane.queued_bytes += bytes;
        lane.queue.push_back(offered);
    }

    /// Goes on to `now`, and hands out every frame whose fate is settled by then, in order of time.
    pub fn poll(&mut self, now: Duration, mut each: impl FnMut(CarriedFrame<T>)) {
        let now = nanos(now);
        while let Some((time, way)) = self.next_step().filter(|(time, _)| *time <= now) {
            // What arrives before it comes out before it.
            self.release(time, &mut each);
            self.step(way, time);
        }
        self.release(now, &mut each);
    }

    /// When [`Air::poll`] has something to do next, if nothing more is offered.
    #[must_use]
    pub fn next_event(&self) -> Option<Duration> {
        let settled = self.lanes.iter().filter_map(Lane::next_settled);
        let next = self.next_step().map(|(time, _)| time).into_iter().chain(settled).min();
        next.map(Duration::from_nanos)
    }

    /// What the receiver of a way has now.
    pub fn report(&mut self, now: Duration, way: Way) -> AirReport {
        let budget = self.budget(now, way);
        let room = self.modem(way).queue_bytes.max(1);
        let lane = &self.lanes[way as usize];
        let [arrived, arrived_bytes, lost] = lane.counts;
        let used = lane.queued_bytes as f64 / room as f64;
        AirReport { budget, room: (1.0 - used).clamp(0.0, 1.0), lost, arrived, arrived_bytes }
    }

    /// Received power and noise of a way at a time.
    pub fn budget(&mut self, now: Duration, way: Way) -> LinkBudget {
        self.budget_at(nanos(now), way)
    }

    fn budget_at(&mut self, now: Nanos, way: Way) -> LinkBudget {
        let slot = now / self.slot;
        match self.lanes[way as usize].budget {
            Some((known, place, budget)) if known == slot && place == self.place => budget,
            _ => {
                let budget = self.channel.budget(way, self.place, slot);
                self.lanes[way as usize].budget = Some((slot, self.place, budget));
                budget
            }
        }
    }

    fn modem(&self, way: Way) -> &Modem {
        match way {
            Way::Up => &self.radio().up,
            Way::Down => &self.radio().down,
        }
    }

    /// The next beginning or end of a packet.
    fn next_step(&self) -> Option<(Nanos, Way)> {
        let steps = Way::BOTH.into_iter().filter_map(|way| Some((self.step_time(way)?, way)));
        // Of two that may begin, the one that has waited longer.
        steps.min_by_key(|(time, way)| (*time, self.lanes[*way as usize].on_air_until, *way))
    }

    fn step_time(&self, way: Way) -> Option<Nanos> {
        let lane = &self.lanes[way as usize];
        let ready = match &lane.sending {
            Some(Sending { phase: Phase::OnAir(end, _), .. }) => return Some(*end),
            Some(Sending { phase: Phase::Ready(time), .. }) => *time,
            None => nanos(lane.queue.front()?.offered).max(lane.free),
        };
        Some(self.window(way, ready.max(self.other_ends(way))))
    }

    /// Until when the other way was or is on the air, where only one may be.
    fn other_ends(&self, way: Way) -> Nanos {
        match self.radio().duplex {
            Duplex::Shared => self.lanes[1 - way as usize].on_air_until,
            Duplex::Full | Duplex::Slots { .. } => 0,
        }
    }

    /// When a way may send a packet, from `time` on: in its own window, if the packet ends in it. One that is longer
    /// than a window begins with it.
    fn window(&self, way: Way, time: Nanos) -> Nanos {
        let Some((begins, length, round)) = self.windows(way, time) else { return time };
        let latest = begins + length.saturating_sub(self.next_air_time(way));
        match time {
            _ if time <= begins => begins,
            _ if time <= latest => time,
            _ => begins + round,
        }
    }

    /// How long the next packet of a way takes at its slowest rate, so that no report of an SNR moves it.
    fn next_air_time(&self, way: Way) -> Nanos {
        let lane = &self.lanes[way as usize];
        let (bytes, left) = match (&lane.sending, lane.queue.front()) {
            (Some(sending), _) => (sending.bytes, Some(sending.left)),
            (None, Some(frame)) => (frame.bytes, None),
            (None, None) => return 0,
        };
        let modem = self.modem(way);
        let left = left.unwrap_or_else(|| modem.packets(bytes));
        modem.air_time(modem.packet(bytes, left), f64::NEG_INFINITY, self.radio().bandwidth_hz)
    }

    fn step(&mut self, way: Way, now: Nanos) {
        match self.lanes[way as usize].sending.take() {
            Some(sending) if matches!(sending.phase, Phase::OnAir(..)) => self.end_packet(way, sending, now),
            Some(sending) => self.begin_packet(way, sending, now),
            None => {
                if let Some(sending) = self.next_frames(way, now) {
                    self.begin_packet(way, sending, now);
                }
            }
        }
    }

    /// The frame whose turn it is, and those that go in its packet.
    fn next_frames(&mut self, way: Way, now: Nanos) -> Option<Sending<T>> {
        let frame = self.lanes[way as usize].queue.pop_front()?;
        let left = self.modem(way).packets(frame.bytes);
        let (mut bytes, mut joined) = (frame.bytes, Vec::new());
        while let Some(next) = self.lanes[way as usize].queue.front()
            && self.modem(way).joins(bytes + next.bytes)
            && nanos(next.offered) <= now
            && self.fits(way, bytes + next.bytes, now)
        {
            bytes += next.bytes;
            joined.extend(self.lanes[way as usize].queue.pop_front());
        }
        Some(Sending { frame, joined, bytes, left, repeats: 0, phase: Phase::Ready(now) })
    }

    /// Whether a packet that begins now ends in the window.
    fn fits(&self, way: Way, bytes: usize, now: Nanos) -> bool {
        let length = self.modem(way).air_time(bytes, f64::NEG_INFINITY, self.radio().bandwidth_hz);
        self.windows(way, now).is_none_or(|(begins, window, _)| now + length <= begins + window)
    }

    /// Of half duplex, where this round's window of a way begins, its length, and that of a round.
    fn windows(&self, way: Way, time: Nanos) -> Option<(Nanos, Nanos, Nanos)> {
        let Duplex::Slots { up_s, down_s, guard_s } = self.radio().duplex else { return None };
        let [up, down, guard] = [up_s, down_s, guard_s].map(from_seconds);
        let (start, length) = match way {
            Way::Up => (0, up),
            Way::Down => (up + guard, down),
        };
        let round = (up + down + 2 * guard).max(1);
        Some((time - time % round + start, length, round))
    }

    fn begin_packet(&mut self, way: Way, mut sending: Sending<T>, now: Nanos) {
        let snr_db = self.budget_at(now, way).snr_db();
        let bandwidth = self.radio().bandwidth_hz;
        let modem = self.modem(way);
        let bytes = modem.packet(sending.bytes, sending.left);
        let row = modem.rate.row(snr_db, bandwidth);
        let loss = modem.error.loss(snr_db, row, bandwidth, 8.0 * (bytes + modem.overhead_bytes) as f64);
        let length = modem.air_time(bytes, snr_db, bandwidth);
        let fate = match loss > 0.0 && self.draw(way, now, sending.frame.kind) < loss {
            false => FrameFate::Arrived,
            true if snr_db < row.snr_db => FrameFate::Outage,
            true => FrameFate::Noise,
        };
        for frame in std::iter::once(&mut sending.frame).chain(&mut sending.joined) {
            frame.on_air.get_or_insert(Duration::from_nanos(now));
            // Of a packet that frames share, each has its part.
            let part =
                if sending.bytes == frame.bytes { 1.0 } else { frame.bytes as f64 / sending.bytes as f64 };
            frame.air_time += Duration::from_nanos((length as f64 * part).round() as Nanos);
            frame.packets += 1;
            frame.snr_db = snr_db;
        }
        sending.phase = Phase::OnAir(now + length, fate);
        let lane = &mut self.lanes[way as usize];
        lane.on_air_until = now + length;
        lane.sending = Some(sending);
    }

    /// A number in [0, 1) for the next packet of a kind.
    fn draw(&mut self, way: Way, now: Nanos, kind: u32) -> f64 {
        let slot = now / self.slot;
        let count = self.lanes[way as usize].draws.next(slot, kind);
        let which = mix([self.channel.link() << 1 | way as u64, slot, kind.into(), count]);
        self.channel.noise().generator(Stream::Packets, which).random()
    }

    fn end_packet(&mut self, way: Way, mut sending: Sending<T>, now: Nanos) {
        let Phase::OnAir(_, fate) = sending.phase else { return };
        let modem = self.modem(way);
        let next = now + from_seconds(modem.gap_s);
        let again = now + from_seconds(modem.retry_s);
        let retries = modem.retries;
        if fate == FrameFate::Arrived && sending.left > 1 {
            sending.left -= 1;
            sending.repeats = 0;
            sending.phase = Phase::Ready(next);
        } else if fate != FrameFate::Arrived && sending.repeats < retries {
            sending.repeats += 1;
            sending.phase = Phase::Ready(again.max(next));
        } else {
            self.lanes[way as usize].free = next;
            for mut frame in std::iter::once(sending.frame).chain(sending.joined) {
                frame.fate = fate;
                let delay = if fate == FrameFate::Arrived { self.latency(way, &frame, now) } else { 0 };
                self.lanes[way as usize].finish(frame, now + delay);
            }
            return;
        }
        self.lanes[way as usize].sending = Some(sending);
    }

    /// From the end on the air to the arrival.
    fn latency(&mut self, way: Way, frame: &CarriedFrame<T>, now: Nanos) -> Nanos {
        let (kind, bits) = (frame.kind, 10.0 * frame.bytes as f64);
        let modem = self.modem(way);
        let (mut seconds, jitter) = (modem.latency_s, modem.jitter_s);
        if modem.serial_baud > 0.0 {
            seconds += 2.0 * bits / modem.serial_baud;
        }
        if jitter > 0.0 {
            seconds -= jitter * (1.0 - self.draw(way, now, kind)).ln();
        }
        from_seconds(seconds)
    }

    /// Hands out what is settled by `now`, in order of time.
    fn release(&mut self, now: Nanos, each: &mut impl FnMut(CarriedFrame<T>)) {
        loop {
            let next =
                self.lanes.iter().enumerate().filter_map(|(k, lane)| Some((lane.next_settled()?, k))).min();
            let Some((_, lane)) = next.filter(|(time, _)| *time <= now) else { return };
            if let Some(frame) = self.lanes[lane].pop_settled() {
                each(frame);
            }
        }
    }
}

impl<T> Lane<T> {
    fn new(way: Way) -> Self {
        Self {
            way,
            queue: VecDeque::new(),
            queued_bytes: 0,
            sending: None,
            free: 0,
            on_air_until: 0,
            arriving: VecDeque::new(),
            lost: VecDeque::new(),
            last_arrival: 0,
            draws: KindDraws::default(),
            budget: None,
            counts: [0; 3],
        }
    }

    /// The frame leaves the queue, and is settled at `done`.
    fn finish(&mut self, mut frame: CarriedFrame<T>, done: Nanos) {
        debug_assert_eq!(frame.way, self.way);
        self.queued_bytes = self.queued_bytes.saturating_sub(frame.bytes);
        if frame.fate != FrameFate::Arrived {
            frame.done = Duration::from_nanos(done);
            self.lost.push_back(frame);
            return;
        }
        // Frames do not overtake each other.
        self.last_arrival = self.last_arrival.max(done);
        frame.done = Duration::from_nanos(self.last_arrival);
        self.arriving.push_back(frame);
    }

    fn next_settled(&self) -> Option<Nanos> {
        let fronts = [self.lost.front(), self.arriving.front()];
        fronts.into_iter().flatten().map(|frame| nanos(frame.done)).min()
    }

    fn pop_settled(&mut self) -> Option<CarriedFrame<T>> {
        let done = |frames: &VecDeque<CarriedFrame<T>>| frames.front().map_or(Duration::MAX, |f| f.done);
        let frame = if done(&self.lost) <= done(&self.arriving) {
            self.lost.pop_front()
        } else {
            self.arriving.pop_front()
        }?;
        if frame.fate == FrameFate::Arrived {
            self.counts[0] += 1;
            self.counts[1] += frame.bytes as u64;
        } else {
            self.counts[2] += 1;
        }
        Some(frame)
    }
}

impl Modem {
    /// Packets that a frame takes.
    fn packets(&self, bytes: usize) -> u32 {
        match self.packet_bytes {
            0 => 1,
            most => u32::try_from(bytes.div_ceil(most).max(1)).unwrap_or(u32::MAX),
        }
    }

    /// Bytes of a frame in the packet before which `left` are to go, with it.
    fn packet(&self, bytes: usize, left: u32) -> usize {
        match self.packet_bytes {
            0 => bytes,
            most if self.full_packets || left > 1 => most,
            most => bytes - most * (self.packets(bytes) as usize - 1),
        }
    }

    /// Whether frames of so many bytes together share a packet.
    fn joins(&self, bytes: usize) -> bool {
        self.join && bytes <= self.packet_bytes
    }

    /// How long a packet is on the air.
    fn air_time(&self, bytes: usize, snr_db: f64, bandwidth_hz: f64) -> Nanos {
        let bits = 8.0 * (bytes + self.overhead_bytes) as f64;
        from_seconds(self.overhead_s + bits / self.rate.row(snr_db, bandwidth_hz).bps)
    }
}

#[cfg(test)]
mod tests;
