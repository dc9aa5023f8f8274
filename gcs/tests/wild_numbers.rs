//! What a vehicle sends may hold any number. None of them stops the station: not its tools, not a flight.

use std::time::Duration;

use crpl_gcs::flight::foreign::Foreign;
use crpl_gcs::flight::foreign::guide::{ForeignStack, Guide, GuideEvent};
use crpl_gcs::flight::remote::Remote;
use crpl_gcs::tools::command::{CommandQueue, CommandRequest};
use crpl_gcs::tools::fleet::Fleet;
use crpl_gcs::tools::link::carrier::{Carrier, LinkClock, Tells};
use crpl_gcs::tools::link::place::Whereabouts;
use crpl_gcs::tools::mission::exchange::{Clear, Download, Upload};
use crpl_gcs::tools::mission::file;
use crpl_gcs::tools::param::exchange::{List, Read};
use crpl_gcs::tools::param::value::Encoding;
use crpl_gcs::tools::session::Exchange;
use crpl_sitl::Scenario;
use crpl_sitl::link::crc::{checksum, crc_extra};
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::MavCmd;
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::command::{CommandAck, CommandLong};
use crpl_sitl::link::messages::param::ParamValue;
use crpl_sitl::link::messages::service::Timesync;
use crpl_sitl::link::messages::status::Heartbeat;
use crpl_sitl::link::messages::telemetry::{DebugVect, GlobalPositionInt, LocalPositionNed, NamedValueFloat};
use crpl_sitl::link::messages::{Target, View};
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::splitter::Splitter;
use crpl_sitl::radio::air::{Air, AirRadio, Way};
use crpl_sitl::radio::message::Command;
use crpl_sitl::units::TxPower;
use proptest::prelude::*;

const STATION: (u8, u8) = (255, 190);
const VEHICLE: (u8, u8) = (1, 1);

/// Messages of a vehicle that the station looks into.
const IDS: [u32; 27] = [
    0, 1, 2, 22, 24, 30, 32, 33, 39, 40, 42, 44, 46, 47, 51, 73, 77, 85, 109, 111, 130, 131, 148, 250, 251,
    253, 345,
];

fn frame(sequence: u8, id: u32, payload: &[u8]) -> Vec<u8> {
    let [id0, id1, id2, _] = id.to_le_bytes();
    let mut frame = vec![0xFD, payload.len() as u8, 0, 0, sequence, VEHICLE.0, VEHICLE.1, id0, id1, id2];
    frame.extend_from_slice(payload);
    let crc = checksum(&frame[1..], crc_extra(id).unwrap_or(0));
    frame.extend(crc.to_le_bytes());
    frame
}

fn packet(sequence: u8, id: u32, payload: &[u8]) -> Packet {
    Decoder::default().datagram(&frame(sequence, id, payload)).remove(0)
}

/// Any float: common ones, those at the ends of what integers and times hold, and those that are none.
fn wild() -> impl Strategy<Value = f32> {
    let ends = [0.0, -1.0, 1e-45, 5e-20, 1e19, 1e38, 4_294_967_300.0, f32::MAX, f32::NAN, f32::INFINITY];
    prop_oneof![
        any::<u32>().prop_map(f32::from_bits),
        (-300_i16..600).prop_map(f32::from),
        prop::sample::select(ends.to_vec()),
    ]
}

fn stamp() -> impl Strategy<Value = u32> {
    prop_oneof![any::<u32>(), (0..100_u32).prop_map(|k| 1000 + 400 * k), Just(u32::MAX), Just(0)]
}

/// Message id and payload: anything, or a message whose form is right and whose numbers are anything.
fn sent() -> impl Strategy<Value = (u32, Vec<u8>)> {
    let threes = || prop::array::uniform3(wild());
    let target = Target { system: STATION.0, component: STATION.1 };
    let bytes = prop::collection::vec(prop_oneof![any::<u8>(), Just(0), Just(255), Just(1)], 1..60);
    prop_oneof![
        2 => (prop::sample::select(&IDS[..]), bytes),
        2 => (stamp(), threes(), threes()).prop_map(|(time_boot_ms, position, velocity)| {
            (32, LocalPositionNed { time_boot_ms, position, velocity }.payload().to_vec())
        }),
        1 => (stamp(), any::<[i32; 2]>(), any::<[i32; 2]>(), any::<[i16; 3]>(), any::<u16>()).prop_map(
            |(time_boot_ms, place, heights, velocity, heading)| {
                (33, GlobalPositionInt { time_boot_ms, place, heights, velocity, heading }.payload().to_vec())
            }
        ),
        1 => (stamp(), threes(), "OBSTACLE(_[0-9]{1,3})?").prop_map(|(ms, vector, name)| {
            let name = name[..name.len().min(10)].into();
            (250, DebugVect { time_usec: u64::from(ms) * 1000, vector, name }.payload().to_vec())
        }),
        1 => (stamp(), wild(), prop::sample::select(vec!["SNR_DB", "TXP", "OUTAGE"])).prop_map(
            |(time_boot_ms, value, name)| {
                (251, NamedValueFloat { time_boot_ms, value, name: name.into() }.payload().to_vec())
            }
        ),
        1 => (any::<[u8; 4]>(), any::<u16>(), any::<u16>(), any::<u8>()).prop_map(|(value, count, index, kind)| {
            (22, ParamValue { value, count, index, name: "RATE_GPS".into(), kind }.payload().to_vec())
        }),
        1 => (any::<i64>(), prop_oneof![any::<i64>(), 0..10_000_000_000_i64]).prop_map(move |(tc1, ts1)| {
            (111, Timesync { tc1, ts1, target }.payload().to_vec())
        }),
        1 => (any::<u16>(), any::<u8>(), any::<u8>(), any::<i32>()).prop_map(
            move |(command, result, progress, result_param2)| {
                let ack = CommandAck { command, result, progress, result_param2, target };
                (77, ack.payload().to_vec())
            }
        ),
    ]
}

fn trimmed(payload: &[u8]) -> &[u8] {
    &payload[..payload.iter().rposition(|&byte| byte != 0).map_or(1, |last| last + 1)]
}

/// A tool that asks and waits for answers.
fn asks(mut exchange: impl Exchange, packets: &[Packet]) {
    let (mut station, mut now) = (Encoder::new(STATION.0, STATION.1), Duration::ZERO);
    for packet in packets {
        let mut datagram = Vec::new();
        exchange.poll(now, &mut station, &mut datagram);
        assert!(datagram.len() < 1 << 20);
        exchange.packet(packet, now);
        now += Duration::from_millis(300);
        if exchange.outcome().is_some() {
            return;
        }
        let _ = exchange.due();
    }
}

fn text_of_a_mission() -> &'static str {
    "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t47.4\t8.5\t488\t1\n1\t0\t3\t16\t0\t0\t0\t0\t47.4\t8.5\t20\t1\n"
}

proptest! {
    #[test]
    fn no_number_of_a_vehicle_stops_a_tool(sent in prop::collection::vec(sent(), 1..60), seconds in 0..10_000_u64) {
        let packets: Vec<Packet> =
            sent.iter().enumerate().map(|(k, (id, payload))| packet(k as u8, *id, trimmed(payload))).collect();
        for encoding in [Encoding::CCast, Encoding::Bytewise] {
            asks(List::new(VEHICLE, encoding), &packets);
            asks(Read::new("RATE_GPS".into(), VEHICLE, encoding).unwrap(), &packets);
        }
        let items = file::parse(text_of_a_mission()).unwrap().items_for(true).unwrap();
        asks(Upload::new(items, VEHICLE), &packets);
        asks(Download::new(VEHICLE), &packets);
        asks(Clear::new(VEHICLE), &packets);

        let (mut fleet, mut queue) = (Fleet::default(), CommandQueue::default());
        let mut station = Encoder::new(STATION.0, STATION.1);
        let scenario = Scenario::default();
        let mut remote = Remote::new(&scenario, VEHICLE.0, Encoder::new(STATION.0, STATION.1));
        let air = Air::new(AirRadio::named("sik-57").unwrap(), 1, 0).unwrap();
        let place = Whereabouts::new(None, None, [0.0; 3], None);
        let late = Duration::from_secs(1);
        let mut carrier = Carrier::new(air, place, LinkClock::Vehicle, Tells::default(), late);
        let mut splitter = Splitter::default();
        queue.request(CommandRequest::new(MavCmd::MAV_CMD_DO_SET_MODE, [1.0, 4.0], VEHICLE), Duration::ZERO);
        let mut now = Duration::from_secs(seconds);
        for (k, packet) in packets.iter().enumerate() {
            for news in fleet.packet(packet, now) {
                let _ = news.to_string();
            }
            queue.packet(packet, now);
            queue.poll(now, &mut station, &mut Vec::new());
            let (id, payload) = &sent[k];
            let bytes = frame(k as u8, *id, trimmed(payload));
            let _ = remote.datagram(&bytes, now);
            carrier.receive(Way::Down, &mut splitter, &bytes, now);
            carrier.advance(now);
            carrier.flush(|_, _| {});
            now += Duration::from_millis(200);
        }
        let _ = (queue.take(), remote.poll(now), carrier.reports(), carrier.words());
    }
}

/// A vehicle that agrees to all and stands in the air, until `wild` says otherwise.
struct Willing {
    guide: Guide,
    vehicle: Encoder,
    now: Duration,
    flies: bool,
    over: bool,
}

impl Willing {
    fn new() -> Self {
        let how = Foreign::new(ForeignStack::Ardupilot);
        let guide = Guide::new(Scenario::default(), &how, 50);
        let vehicle = Encoder::new(VEHICLE.0, VEHICLE.1);
        Self { guide, vehicle, now: Duration::ZERO, flies: false, over: false }
    }

    /// 50 ms pass.
    fn turn(&mut self) {
        self.now += Duration::from_millis(50);
        let height = Scenario::default().scale.altitude_m as f32;
        let mut bytes = Vec::new();
        let beat = Heartbeat {
            custom_mode: 4,
            kind: 2,
            autopilot: 3,
            base_mode: 217,
            system_status: 4,
            mavlink_version: 3,
        };
        self.vehicle.push_view(&mut bytes, &beat);
        let time_boot_ms = 100_000 + self.now.as_millis() as u32;
        let place = LocalPositionNed { time_boot_ms, position: [0.0, 0.0, -height], velocity: [0.0; 3] };
        self.vehicle.push_view(&mut bytes, &place);
        let asked = self.guide.poll(self.now);
        for packet in Decoder::default().datagram(&asked) {
            let target = Target { system: STATION.0, component: STATION.1 };
            if let Some(CommandLong { command, .. }) = CommandLong::of(&packet) {
                let ack = CommandAck { command, result: 0, progress: 0, result_param2: 0, target };
                self.vehicle.push_view(&mut bytes, &ack);
            } else if let Some(sync) = Timesync::of(&packet) {
                self.vehicle.push_view(&mut bytes, &Timesync { tc1: 1, target, ..sync });
            }
        }
        self.hear(&bytes);
    }

    fn hear(&mut self, bytes: &[u8]) {
        self.guide.datagram(bytes, self.now);
        let _ = self.guide.poll(self.now);
        while let Some(event) = self.guide.take() {
            match event {
                GuideEvent::Percept(percept) => {
                    self.flies = true;
                    let command = Command::new(percept.telemetry.tick, [0.1, 0.1], TxPower::Low);
                    let _ = self.guide.fly(&command, self.now);
                }
                GuideEvent::Say(_) | GuideEvent::TakeControl(_) => {}
                _ => self.over = true,
            }
        }
    }
}

#[test]
fn a_willing_vehicle_is_flown() {
    let mut willing = Willing::new();
    for _ in 0..400 {
        willing.turn();
    }
    assert!(willing.flies);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn no_number_of_a_vehicle_stops_the_flight_s_shell(
        sent in prop::collection::vec(sent(), 1..60), first in 0..300_usize,
    ) {
        let mut willing = Willing::new();
        for _ in 0..first {
            willing.turn();
        }
        for (k, (id, payload)) in sent.iter().enumerate() {
            willing.hear(&frame(k as u8, *id, trimmed(payload)));
            if k % 3 == 0 {
                willing.turn();
            }
            if willing.over {
                break;
            }
        }
    }
}
