//! Bytes of both sides in, through the radio, datagrams for both sides out. Knows no socket and no clock.

use std::time::Duration;

use crpl_sitl::link::RADIO;
use crpl_sitl::link::boot_time::BootTime;
use crpl_sitl::link::dialect::{LINK_NODE_STATUS_DATA, NAMED_VALUE_FLOAT_DATA, RADIO_STATUS_DATA};
use crpl_sitl::link::encoder::{DATAGRAM, Encoder};
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::telemetry::LocalPositionNed;
use crpl_sitl::link::packet::{Packet, PacketRef};
use crpl_sitl::link::splitter::Splitter;
use crpl_sitl::radio::air::{Air, AirReport, CarriedFrame, FrameFate, Way};

use super::exchange::Exchanges;
use super::place::Whereabouts;
use super::summary::{LinkSummary, late_command};

/// The system id of a SiK radio, '3', as its firmware sends it.
const SIK_SYSTEM: u8 = 51;
/// How often the radio tells its state.
const STATUS_PERIOD: Duration = Duration::from_secs(1);

/// What makes time pass for the radio.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LinkClock {
    /// The wall's clock
    Wall,
    /// The vehicle's own, by LOCAL_POSITION_NED: for `sitl` in lockstep, which waits for what is on the way
    Vehicle,
}

/// What the radio tells of itself.
#[derive(Debug, Clone, Copy, Default)]
pub struct Tells {
    /// RADIO_STATUS, and SNR_DB as NAMED_VALUE_FLOAT.
    pub status: bool,
    /// LINK_NODE_STATUS, which pymavlink does not know and would count as lost.
    pub node: bool,
}

/// Frames that leave on one side.
#[derive(Debug, Default)]
struct OutBatch {
    bytes: Vec<u8>,
    /// Where datagrams end, but for the last.
    ends: Vec<usize>,
}

impl OutBatch {
    fn push(&mut self, frame: &[u8]) {
        let begin = self.ends.last().copied().unwrap_or(0);
        if self.bytes.len() > begin && self.bytes.len() - begin + frame.len() > DATAGRAM {
            self.ends.push(self.bytes.len());
        }
        self.bytes.extend_from_slice(frame);
    }

    /// Hands out the datagrams.
    fn flush(&mut self, mut each: impl FnMut(&[u8])) {
        let mut begin = 0;
        let last = self.bytes.len();
        for end in self.ends.drain(..).chain([last]) {
            if end > begin {
                each(&self.bytes[begin..end]);
            }
            begin = end;
        }
        self.bytes.clear();
    }
}

/// A radio that carries frames.
#[derive(Debug)]
pub struct Carrier {
    air: Air<Packet>,
    whereabouts: Whereabouts,
    clock: LinkClock,
    /// The radio's time.
    now: Duration,
    boot: BootTime,
    /// The vehicle's time at the radio's time 0.
    began: Option<Duration>,
    tells: Tells,
    encoders: [Encoder; 2],
    next_status: Duration,
    out: [OutBatch; 2],
    settled: Vec<CarriedFrame<Packet>>,
    summary: LinkSummary,
    exchanges: Exchanges,
    late: Duration,
    words: Vec<String>,
}

impl Carrier {
    /// A radio with the vehicle where `whereabouts` says. Commands that come later than `late` are told.
    #[must_use]
    pub fn new(
        air: Air<Packet>,
        whereabouts: Whereabouts,
        clock: LinkClock,
        tells: Tells,
        late: Duration,
    ) -> Self {
        let mut carrier = Self {
            air,
            whereabouts,
            clock,
            now: Duration::ZERO,
            boot: BootTime::default(),
            began: None,
            tells,
            encoders: [(); 2].map(|()| Encoder::new(SIK_SYSTEM, RADIO)),
            next_status: STATUS_PERIOD,
            out: [OutBatch::default(), OutBatch::default()],
            settled: Vec::new(),
            summary: LinkSummary::default(),
            exchanges: Exchanges::default(),
            late,
            words: Vec::new(),
        };
        carrier.set_place();
        carrier
    }

    /// The time of the radio, at a time of the wall.
    fn time(&self, wall: Duration) -> Duration {
        match self.clock {
            LinkClock::Wall => wall.max(self.now),
            LinkClock::Vehicle => self.now,
        }
    }

    /// Bytes have come for a way, from a peer whose splitter this is: from the station's side for the way up.
    pub fn receive(&mut self, way: Way, splitter: &mut Splitter, bytes: &[u8], wall: Duration) {
        self.advance(wall);
        splitter.split(bytes, |frame| self.offer(way, &frame));
        if self.clock == LinkClock::Vehicle {
            self.run_down();
        }
        self.carry_to(self.now);
    }

    fn offer(&mut self, way: Way, frame: &PacketRef<'_>) {
        if way == Way::Down {
            self.listen(frame);
        }
        self.air.offer(self.now, way, frame.id, frame.raw.len(), (*frame).into());
    }

    /// Takes time and place from what the vehicle tells.
    fn listen(&mut self, frame: &PacketRef<'_>) {
        if self.clock == LinkClock::Vehicle
            && let Some(told) = LocalPositionNed::of(*frame)
        {
            let told = self.boot.at(told.time_boot_ms);
            let since = told.saturating_sub(*self.began.get_or_insert(told));
            self.carry_to(since);
        }
        self.whereabouts.hear(frame, self.now);
    }

    fn set_place(&mut self) {
        if let Some([north, east, down]) = self.whereabouts.track().at(self.now) {
            self.air.set_place([north, east, -down]);
        }
    }

    /// The wall's time has passed.
    pub fn advance(&mut self, wall: Duration) {
        self.carry_to(self.time(wall));
    }

    /// Lets all that is on its way arrive: the vehicle's clock stands still until it has.
    pub fn run_down(&mut self) {
        while let Some(next) = self.air.next_event() {
            self.carry_to(next);
        }
    }

    /// Goes on to a time of the radio, past each change of place and each report on the way.
    fn carry_to(&mut self, time: Duration) {
        loop {
            let moved = self.whereabouts.track().next_after(self.now);
            let report = self.next_report();
            let Some(next) = moved.into_iter().chain(report).min().filter(|next| *next <= time) else {
                break;
            };
            self.poll(next);
            if moved == Some(next) {
                self.set_place();
            }
            if report == Some(next) {
                self.report();
                self.next_status = next + STATUS_PERIOD;
            }
        }
        self.poll(time);
    }

    fn poll(&mut self, time: Duration) {
        self.now = self.now.max(time);
        let first = self.settled.len();
        let Self { air, settled, out, .. } = self;
        air.poll(self.now, |frame| {
            if frame.fate == FrameFate::Arrived {
                out[frame.way as usize].push(&frame.frame.raw);
            }
            settled.push(frame);
        });
        for frame in &self.settled[first..] {
            self.summary.add(frame);
            self.exchanges.settled(frame);
            self.words.extend(late_command(frame, self.late));
        }
        self.words.extend(self.exchanges.ended());
    }

    /// Each end's radio tells its user of the link, as SiK's firmware does.
    fn report(&mut self) {
        let [up, down] = self.reports();
        for (way, here, there) in [(Way::Up, &up, &down), (Way::Down, &down, &up)] {
            let (batch, encoder) = (&mut self.out[way as usize], &mut self.encoders[way as usize]);
            let mut bytes = Vec::new();
            if self.tells.status {
                encoder.push(&mut bytes, &radio_status(here, there));
                let time_boot_ms = (self.now.as_millis() & u128::from(u32::MAX)) as u32;
                let value = here.budget.snr_db() as f32;
                let snr = NAMED_VALUE_FLOAT_DATA { time_boot_ms, value, name: "SNR_DB".into() };
                encoder.push(&mut bytes, &snr);
            }
            if self.tells.node {
                encoder.push(&mut bytes, &node_status(self.now, here, there));
            }
            batch.push(&bytes);
        }
    }

    /// What the receivers of the ways up and down have.
    pub fn reports(&mut self) -> [AirReport; 2] {
        Way::BOTH.map(|way| self.air.report(self.now, way))
    }

    /// When something happens next by itself, on the wall's clock.
    #[must_use]
    pub fn next_event(&self) -> Option<Duration> {
        if self.clock == LinkClock::Vehicle {
            return None;
        }
        let moved = self.whereabouts.track().next_after(self.now);
        self.air.next_event().into_iter().chain(moved).chain(self.next_report()).min()
    }

    fn next_report(&self) -> Option<Duration> {
        (self.tells.status || self.tells.node).then_some(self.next_status)
    }

    /// Hands out the datagrams that leave for the receiver of each way.
    pub fn flush(&mut self, mut each: impl FnMut(Way, &[u8])) {
        for way in Way::BOTH {
            self.out[way as usize].flush(|datagram| each(way, datagram));
        }
    }

    /// Frames whose fate was settled since the last call.
    pub fn settled(&mut self) -> std::vec::Drain<'_, CarriedFrame<Packet>> {
        self.settled.drain(..)
    }

    /// What is to be told in words, since the last call.
    pub fn words(&mut self) -> Vec<String> {
        std::mem::take(&mut self.words)
    }

    /// What was carried.
    #[must_use]
    pub fn summary(&self) -> &LinkSummary {
        &self.summary
    }

    /// Where the vehicle is and was.
    #[must_use]
    pub fn whereabouts(&self) -> &Whereabouts {
        &self.whereabouts
    }

    /// The radio's time.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.now
    }
}

/// A power in dBm on SiK's scale, 1.9 (dBm + 127): `MAVLink_report`, Firmware/radio/mavlink.c, and the data sheet of
/// its receiver.
fn sik_scale(dbm: f64) -> u8 {
    (1.9 * (dbm + 127.0)).round().clamp(0.0, 254.0) as u8
}

fn wrapping(count: u64) -> u16 {
    (count & u64::from(u16::MAX)) as u16
}

fn radio_status(here: &AirReport, there: &AirReport) -> RADIO_STATUS_DATA {
    RADIO_STATUS_DATA {
        rssi: sik_scale(here.budget.rssi_dbm),
        remrssi: sik_scale(there.budget.rssi_dbm),
        // The room of what this end sends.
        txbuf: (100.0 * there.room).round() as u8,
        noise: sik_scale(here.budget.noise_dbm),
        remnoise: sik_scale(there.budget.noise_dbm),
        rxerrors: wrapping(here.lost),
        fixed: 0,
    }
}

fn node_status(now: Duration, here: &AirReport, there: &AirReport) -> LINK_NODE_STATUS_DATA {
    let rate = |report: &AirReport| (report.arrived_bytes as f64 / now.as_secs_f64().max(1e-3)) as u32;
    let small = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
    let used = |report: &AirReport| (100.0 * (1.0 - report.room)).round() as u8;
    LINK_NODE_STATUS_DATA {
        timestamp: now.as_millis() as u64,
        tx_buf: used(there),
        rx_buf: used(here),
        tx_rate: rate(there),
        rx_rate: rate(here),
        messages_sent: small(there.arrived + there.lost),
        messages_received: small(here.arrived),
        messages_lost: small(here.lost),
        ..Default::default()
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::decoder::Decoder;
    use crpl_sitl::link::dialect::{COMMAND_LONG_DATA, HEARTBEAT_DATA, MavCmd, MavMessage};
    use crpl_sitl::radio::air::AirRadio;

    use super::super::ledger::FrameLedger;
    use super::*;

    const ALL: Tells = Tells { status: true, node: true };

    fn carrier(radio: &str, clock: LinkClock, tells: Tells) -> Carrier {
        let air = Air::new(AirRadio::named(radio).unwrap(), 3, 0).unwrap();
        Carrier::new(
            air,
            Whereabouts::new(None, None, [10.0, 0.0, 0.0], None),
            clock,
            tells,
            Duration::from_millis(100),
        )
    }

    fn at(seconds: f64) -> Duration {
        Duration::from_secs_f64(seconds)
    }

    fn position(encoder: &mut Encoder, time_boot_ms: u32, north: f32) -> Vec<u8> {
        let mut bytes = Vec::new();
        let position = [north, 0.0, -100.0];
        encoder.push_view(&mut bytes, &LocalPositionNed { time_boot_ms, position, velocity: [0.0; 3] });
        bytes
    }

    fn datagrams(carrier: &mut Carrier) -> [Vec<Vec<u8>>; 2] {
        let mut out = [Vec::new(), Vec::new()];
        carrier.flush(|way, datagram| out[way as usize].push(datagram.to_vec()));
        out
    }

    #[test]
    fn the_perfect_radio_passes_every_byte_on_in_few_datagrams() {
        let mut carrier = carrier("perfect", LinkClock::Wall, Tells::default());
        let (mut encoder, mut splitter, mut all) = (Encoder::new(1, 1), Splitter::default(), Vec::new());
        for _ in 0..200 {
            encoder.push(&mut all, &HEARTBEAT_DATA::default());
        }
        // A message that no dialect knows passes too.
        let mut unknown = all[..21].to_vec();
        unknown[9] = 0x7F;
        all.extend(unknown);
        carrier.receive(Way::Down, &mut splitter, &all, at(0.0));
        let [up, down] = datagrams(&mut carrier);
        assert!(up.is_empty() && down.len() == all.len().div_ceil(1386), "{}", down.len());
        assert!(down.iter().all(|datagram| datagram.len() <= DATAGRAM));
        assert_eq!(down.concat(), all);
        assert_eq!(carrier.settled().len(), 201);
    }

    #[test]
    fn both_ends_hear_the_radio_on_sik_s_scale() {
        let mut carrier = carrier("sik-57", LinkClock::Wall, ALL);
        let (mut encoder, mut splitter) = (Encoder::new(1, 1), Splitter::default());
        carrier.receive(Way::Down, &mut splitter, &position(&mut encoder, 0, 2000.0), at(0.0));
        assert_eq!(carrier.next_event().map(|time| time.as_millis() < 1000), Some(true));
        carrier.advance(at(1.0));
        let sides = datagrams(&mut carrier);
        for way in Way::BOTH {
            let packets = Decoder::default().datagram(&sides[way as usize].concat());
            let own: Vec<_> = packets.iter().filter(|p| (p.system, p.component) == (51, 68)).collect();
            assert_eq!(own.iter().map(|p| p.id).collect::<Vec<_>>(), [109, 251, 8]);
            let Some(MavMessage::RADIO_STATUS(status)) = own[0].message() else { panic!() };
            let [up, down] = carrier.reports();
            let budget = if way == Way::Up { up.budget } else { down.budget };
            assert_eq!(f64::from(status.rssi), (1.9 * (budget.rssi_dbm + 127.0)).round());
            // k T B F of 64 kHz and 9 dB: -116.9 dBm.
            assert_eq!((status.noise, status.txbuf), (19, 100));
            assert!(status.rssi > 40, "{status:?}");
        }
    }

    #[test]
    fn the_radio_s_time_goes_on_when_the_vehicle_s_stamps_come_round() {
        let mut carrier = carrier("perfect", LinkClock::Vehicle, Tells::default());
        let (mut encoder, mut splitter) = (Encoder::new(1, 1), Splitter::default());
        for stamp in [u32::MAX - 399, 0, 400] {
            carrier.receive(Way::Down, &mut splitter, &position(&mut encoder, stamp, 500.0), at(0.0));
        }
        assert_eq!(carrier.now(), at(0.8));
    }

    #[test]
    fn the_vehicle_s_clock_lets_everything_arrive_before_it_goes_on() {
        let mut carrier = carrier("sik-57", LinkClock::Vehicle, Tells::default());
        let (mut encoder, mut splitter) = (Encoder::new(1, 1), Splitter::default());
        for tick in 0..5 {
            let bytes = position(&mut encoder, 1000 + 400 * tick, 500.0);
            // The wall's time is nobody's.
            carrier.receive(Way::Down, &mut splitter, &bytes, at(f64::from(tick % 2)));
            assert_eq!(datagrams(&mut carrier)[1].concat(), bytes, "tick {tick}");
            assert_eq!(carrier.next_event(), None);
        }
        let offered: Vec<_> = carrier.settled().map(|frame| frame.offered.as_millis()).collect();
        assert_eq!(offered, [0, 400, 800, 1200, 1600]);
    }

    #[test]
    fn late_and_lost_commands_are_told_in_words() {
        let command = |carrier: &mut Carrier, seconds| {
            let (mut bytes, mut splitter) = (Vec::new(), Splitter::default());
            let command = MavCmd::MAV_CMD_COMPONENT_ARM_DISARM;
            Encoder::new(255, 190).push(&mut bytes, &COMMAND_LONG_DATA { command, ..Default::default() });
            carrier.receive(Way::Up, &mut splitter, &bytes, at(seconds));
            carrier.advance(at(seconds + 9.0));
            carrier.words()
        };
        let mut far = carrier("satellite", LinkClock::Wall, Tells::default());
        let words = command(&mut far, 0.0);
        assert!(words[0].starts_with("COMPONENT_ARM_DISARM of 0.00 s arrived 0.4"), "{words:?}");
        let mut lost = carrier("sik-57", LinkClock::Wall, Tells::default());
        let (mut encoder, mut splitter) = (Encoder::new(1, 1), Splitter::default());
        lost.receive(Way::Down, &mut splitter, &position(&mut encoder, 0, 9e6), at(0.0));
        assert_eq!(command(&mut lost, 1.0), ["COMPONENT_ARM_DISARM of 1.00 s was lost: outage"]);
        let table = lost.summary().table(true, at(10.0));
        assert!(table.contains("  COMMAND_LONG") && table.contains("100.0%"), "{table}");
        let text = lost.summary().prometheus(lost.air_reports());
        assert!(text.contains(
            "mavlink_link_lost_outage_frames_total{way=\"up\",message=\"COMMAND_LONG\",id=\"76\"} 1"
        ));
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            let name = line.split(['{', ' ']).next().unwrap();
            let base = name.trim_end_matches("_bucket").trim_end_matches("_sum").trim_end_matches("_count");
            assert!(text.contains(&format!("# TYPE {base} ")), "{line}");
        }
    }

    impl Carrier {
        fn air_reports(&self) -> [AirReport; 2] {
            let mut air: Air<()> = Air::new(self.air.radio().clone(), 0, 0).unwrap();
            Way::BOTH.map(|way| air.report(Duration::ZERO, way))
        }
    }

    #[test]
    fn the_same_seed_and_geometry_give_the_same_ledger_byte_for_byte() {
        let ledger = |seed| {
            let air = Air::new(AirRadio::named("lte").unwrap(), seed, 0).unwrap();
            let late = Duration::from_millis(100);
            let mut carrier = Carrier::new(
                air,
                Whereabouts::new(None, None, [10.0, 0.0, 0.0], None),
                LinkClock::Wall,
                Tells::default(),
                late,
            );
            let (mut encoder, mut splitter) = (Encoder::new(1, 1), Splitter::default());
            let mut bytes = Vec::new();
            let mut ledger = FrameLedger::new(&mut bytes, &[]).unwrap();
            for k in 0..500_u32 {
                let report = position(&mut encoder, k, 40.0 * k as f32);
                carrier.receive(Way::Down, &mut splitter, &report, at(f64::from(k) * 0.05));
                carrier.settled().for_each(|frame| ledger.push(&frame).unwrap());
            }
            carrier.run_down();
            carrier.settled().for_each(|frame| ledger.push(&frame).unwrap());
            ledger.close().unwrap();
            bytes
        };
        let first = ledger(1);
        assert!(first.len() > 10_000 && first == ledger(1));
        assert!(first != ledger(2));
    }
}
