//! The vehicle as its peers meet it; what they can ask for is in the modules below.

mod boot;
mod files;
mod guided;
mod junk;
mod missions;
mod modes;
mod params;
mod rates;
mod signing;
mod telemetry;

use std::net::SocketAddr;

use super::*;
use crate::link::MessageData;
use crate::link::RADIO;
use crate::link::crc::checksum;
use crate::link::decoder::Decoder;
use crate::link::dialect::{self, MavCmd, MavMessage, MavResult, PositionTargetTypemask};
use crate::link::encoder::Encoder;
use crate::link::image::Reassembler;
use crate::link::messages::command::{CommandAck, CommandLong};
use crate::link::messages::status::MessageInterval;
use crate::link::messages::{Target, View};
use crate::link::packet::Packet;
use crate::link::wire::{self, Refusal, TelemetryReader};
use crate::radio::message::{Command, Held};
use crate::scenario::Scenario;
use crate::units::TxPower;

/// A vehicle and one station, back to back.
struct Bench {
    vehicle: Vehicle,
    station: Encoder,
    address: SocketAddr,
    decoder: Decoder,
    now: Duration,
}

impl Bench {
    fn new() -> Self {
        Self::with(Scenario::default(), None)
    }

    fn with(scenario: Scenario, ticks: Option<u64>) -> Self {
        Self {
            vehicle: Vehicle::new(Sim::new(scenario, 1), 7, ticks),
            station: Encoder::new(255, 190),
            address: ([127, 0, 0, 1], 5000).into(),
            decoder: Decoder::default(),
            now: Duration::ZERO,
        }
    }

    /// Sends a message; gives what comes back to this station.
    fn send<M: MessageData>(&mut self, message: &M) -> Vec<Packet> {
        let mut datagram = Vec::new();
        self.station.push(&mut datagram, message);
        self.datagram(&datagram)
    }

    fn datagram(&mut self, bytes: &[u8]) -> Vec<Packet> {
        self.vehicle.datagram(bytes, self.address, self.now);
        self.received()
    }

    fn received(&mut self) -> Vec<Packet> {
        let mut packets = Vec::new();
        while let Some((to, bytes)) = self.vehicle.poll() {
            if to == self.address.into() {
                packets.extend(self.decoder.datagram(&bytes));
            }
        }
        packets
    }

    fn command(&mut self, tick: u64, accel: [f32; 2], power: TxPower) -> Vec<Packet> {
        let datagram = self.encoded(tick, accel, power);
        self.datagram(&datagram)
    }

    /// A command as bytes, not sent yet.
    fn encoded(&mut self, tick: u64, accel: [f32; 2], power: TxPower) -> Vec<u8> {
        let mut datagram = Vec::new();
        let command = Command::new(Tick(tick), accel, power);
        let clock = Clock::new(self.vehicle.sim.scenario());
        wire::push_command(&command, &clock, 7, &mut self.station, &mut datagram);
        datagram
    }

    fn hello(&mut self) -> Vec<Packet> {
        self.send(&dialect::HEARTBEAT_DATA { mavtype: dialect::MavType::MAV_TYPE_GCS, ..Default::default() })
    }
}

fn setpoint(time_boot_ms: u32, afx: f32) -> dialect::SET_POSITION_TARGET_LOCAL_NED_DATA {
    dialect::SET_POSITION_TARGET_LOCAL_NED_DATA {
        time_boot_ms,
        afx,
        type_mask: PositionTargetTypemask::from_bits_retain(3135),
        coordinate_frame: dialect::MavFrame::MAV_FRAME_LOCAL_NED,
        ..Default::default()
    }
}

fn ask(command: MavCmd, param1: f32, target: (u8, u8)) -> dialect::COMMAND_LONG_DATA {
    let (target_system, target_component) = target;
    dialect::COMMAND_LONG_DATA { command, param1, target_system, target_component, ..Default::default() }
}

fn acks(packets: &[Packet]) -> Vec<(u8, dialect::COMMAND_ACK_DATA)> {
    let typed = packets.iter().filter_map(|packet| match packet.message() {
        Some(MavMessage::COMMAND_ACK(ack)) => Some((packet.component, ack)),
        _ => None,
    });
    typed.collect()
}

fn texts(packets: &[Packet]) -> Vec<String> {
    let texts = packets.iter().filter_map(|packet| match packet.message() {
        Some(MavMessage::STATUSTEXT(text)) => Some(text.text.to_str().unwrap().to_owned()),
        _ => None,
    });
    texts.collect()
}

fn ids(packets: &[Packet]) -> Vec<(u8, u32)> {
    packets.iter().map(|packet| (packet.component, packet.id)).collect()
}

#[test]
fn a_new_peer_is_greeted_by_heartbeats_then_the_report() {
    let mut bench = Bench::new();
    assert!(bench.datagram(b"junk").is_empty(), "junk makes nobody a peer");
    let found = ids(&bench.hello());
    assert_eq!(found[..5], [(1, 0), (68, 0), (1, 32), (1, 85), (1, 250)]);
    assert_eq!(bench.vehicle.tally().packets.garbage_bytes, 4);
}

#[test]
fn a_station_that_begins_with_mavlink_1_is_greeted_too() {
    let mut bench = Bench::new();
    let mut heartbeat = vec![0xFE, 9, 0, 255, 190, 0, 0, 0, 0, 0, 6, 8, 0, 4, 3];
    let crc = checksum(&heartbeat[1..], dialect::HEARTBEAT_DATA::EXTRA_CRC);
    heartbeat.extend(crc.to_le_bytes());
    assert_eq!(ids(&bench.datagram(&heartbeat))[..2], [(1, 0), (68, 0)]);
}

#[test]
fn reports_flow_to_every_peer_and_pictures_to_those_who_asked() {
    let mut bench = Bench::new();
    bench.hello();
    bench.vehicle.advance(bench.now);
    assert!(!bench.received().iter().any(|p| p.is::<dialect::ENCAPSULATED_DATA_DATA>()));

    let request = dialect::DATA_TRANSMISSION_HANDSHAKE_DATA {
        mavtype: dialect::MavlinkDataStreamType::MAVLINK_DATA_STREAM_IMG_PNG,
        ..Default::default()
    };
    let mut images = Reassembler::default();
    let first = bench.send(&request).iter().find_map(|p| images.push(p));
    assert_eq!(first, Some((Tick(1), bench.vehicle.sim.frame())));

    bench.vehicle.advance(bench.now);
    let percept = bench.vehicle.sim.percept();
    let (mut reports, clock) = (TelemetryReader::default(), Clock::new(bench.vehicle.sim.scenario()));
    let packets = bench.received();
    let report = packets.iter().find_map(|p| reports.push(p, &clock));
    let frame = packets.iter().find_map(|p| images.push(p));
    assert_eq!(report, Some(percept.telemetry));
    assert_eq!(frame, Some((Tick(2), (*percept.frame).clone())));

    let stopped = bench.send(&dialect::DATA_TRANSMISSION_HANDSHAKE_DATA::default());
    assert_eq!(ids(&stopped), [(1, 130)]);
    bench.vehicle.advance(bench.now);
    assert!(!bench.received().iter().any(|p| p.is::<dialect::ENCAPSULATED_DATA_DATA>()));
}

#[test]
fn each_component_counts_its_frames_for_each_peer() {
    let mut bench = Bench::new();
    let mut packets = bench.hello();
    let request = dialect::DATA_TRANSMISSION_HANDSHAKE_DATA {
        mavtype: dialect::MavlinkDataStreamType::MAVLINK_DATA_STREAM_IMG_PNG,
        ..Default::default()
    };
    packets.extend(bench.send(&request));
    for k in 0..20 {
        packets.extend(bench.command(k, [1.0, 0.0], TxPower::High));
        bench.vehicle.advance(bench.now);
        // Another peer's traffic leaves no gaps in ours.
        let other = SocketAddr::from(([127, 0, 0, 1], 6000));
        let mut datagram = Vec::new();
        Encoder::new(254, 1).push(&mut datagram, &dialect::HEARTBEAT_DATA::default());
        bench.vehicle.datagram(&datagram, other, bench.now);
        packets.extend(bench.received());
        // Repeats go out in another order, and are numbered in it.
        for _ in 0..3 {
            bench.vehicle.send_percept();
            packets.extend(bench.received());
        }
    }
    for component in [1, 68] {
        let sequence: Vec<u8> =
            packets.iter().filter(|p| p.component == component).map(|p| p.sequence).collect();
        let expected: Vec<u8> = (0..sequence.len()).map(|k| k as u8).collect();
        assert_eq!(sequence, expected, "component {component}");
        assert!(packets.iter().all(|p| p.system == 7));
    }
}

#[test]
fn a_command_is_flown_in_its_tick_and_a_late_repeat_changes_nothing() {
    let mut bench = Bench::new();
    bench.command(0, [5.0, 0.0], TxPower::High);
    assert!(bench.vehicle.ready());
    bench.vehicle.advance(bench.now);
    let report = bench.vehicle.sim.telemetry();
    assert_eq!(report.held.map(|h| (h.tick, h.accel)), Some((Tick(0), [5.0, 0.0])));
    assert_eq!(report.link.map(|l| l.power), Some(TxPower::High));

    bench.command(1, [0.0, 5.0], TxPower::Low);
    bench.command(0, [5.0, 0.0], TxPower::High);
    assert_eq!(bench.vehicle.sim.power(), TxPower::Low, "an older stamp does not undo a newer one");
    bench.vehicle.advance(bench.now);
    let held = bench.vehicle.sim.telemetry().held;
    assert_eq!(held.map(|h| (h.tick, h.accel)), Some((Tick(1), [0.0, 5.0])));
    bench.command(1, [0.0, 5.0], TxPower::Low);
    assert!(!bench.vehicle.ready(), "a repeat of the last tick's command is no command for this one");
    assert_eq!(bench.vehicle.tally().stale, 2);
    assert_eq!(bench.vehicle.sim.fates().sent, 2);
}

#[test]
fn a_setpoint_without_the_vehicles_clock_means_now() {
    let mut bench = Bench::new();
    for (k, stamp) in [0, 0, 123_457, 0].into_iter().enumerate() {
        bench.send(&setpoint(stamp, k as f32));
        assert!(bench.vehicle.ready(), "stamp {stamp}");
        bench.vehicle.advance(bench.now);
        let held = bench.vehicle.sim.telemetry().held.map(|h| (h.tick, h.accel[0]));
        assert_eq!(held, Some((Tick(k as u64), k as f32)));
    }
}

#[test]
fn a_bad_setpoint_is_refused_in_words_and_the_next_good_one_obeyed() {
    let mut bench = Bench::new();
    bench.hello();
    let reply = bench.send(&setpoint(0, f32::NAN));
    assert_eq!(texts(&reply), ["setpoint refused: not finite"]);
    assert!(!bench.vehicle.ready());
    assert!(texts(&bench.send(&setpoint(0, f32::NAN))).is_empty(), "once a second is enough");
    bench.now += Duration::from_secs(2);
    assert_eq!(texts(&bench.send(&setpoint(0, f32::INFINITY))).len(), 1);
    assert_eq!(bench.vehicle.tally().refused.get(&Refusal::NotFinite), Some(&3));
    bench.send(&setpoint(0, 1.0));
    assert!(bench.vehicle.ready());
}

#[test]
fn messages_for_others_are_left_to_them() {
    let mut bench = Bench::new();
    bench.hello();
    let other = dialect::SET_POSITION_TARGET_LOCAL_NED_DATA { target_system: 9, ..setpoint(0, 1.0) };
    bench.send(&other);
    assert!(!bench.vehicle.ready());
    assert!(bench.send(&ask(MavCmd::MAV_CMD_USER_1, 4.0, (9, 68))).is_empty());
    assert!(bench.send(&ask(MavCmd::MAV_CMD_USER_1, 4.0, (7, 42))).is_empty());
    assert_eq!(bench.vehicle.sim.power(), TxPower::Low);
}

#[test]
fn power_is_set_by_command_and_every_repeat_is_acknowledged() {
    let mut bench = Bench::new();
    bench.hello();
    for (level, result, power) in [
        (4.0, MavResult::MAV_RESULT_ACCEPTED, TxPower::High),
        (4.0, MavResult::MAV_RESULT_ACCEPTED, TxPower::High),
        (2.0, MavResult::MAV_RESULT_DENIED, TxPower::High),
        (f32::NAN, MavResult::MAV_RESULT_DENIED, TxPower::High),
        (1.0, MavResult::MAV_RESULT_ACCEPTED, TxPower::Low),
    ] {
        let reply = bench.send(&ask(MavCmd::MAV_CMD_USER_1, level, (7, 68)));
        let [(component, ack)] = &acks(&reply)[..] else { panic!("one acknowledgement") };
        assert_eq!((*component, ack.result), (68, result), "level {level}");
        assert_eq!((ack.target_system, ack.target_component), (255, 190));
        assert_eq!(bench.vehicle.sim.power(), power);
    }
}

#[test]
fn unknown_commands_are_answered_unsupported() {
    let mut bench = Bench::new();
    bench.hello();
    // The dialect has no name for this one, so it is written by hand.
    let target = Target { system: 7, component: 1 };
    let mut datagram = Vec::new();
    bench.station.push_view(
        &mut datagram,
        &CommandLong { params: [0.0; 7], command: 31_289, target, confirmation: 0 },
    );
    let reply = bench.datagram(&datagram);
    let ack = reply.iter().find_map(CommandAck::of).unwrap();
    assert_eq!((ack.command, ack.result), (31_289, MavResult::MAV_RESULT_UNSUPPORTED as u8));
    assert_eq!(ack.target, Target { system: 255, component: 190 });
}

#[test]
fn the_version_is_told_on_request() {
    let mut bench = Bench::new();
    bench.hello();
    let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 148.0, (7, 1)));
    assert_eq!(ids(&reply), [(1, 77), (1, 148)]);
    let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 333.0, (7, 1)));
    assert_eq!(acks(&reply)[0].1.result, MavResult::MAV_RESULT_DENIED);
}

#[test]
fn power_is_the_radios_parameter_too() {
    let mut bench = Bench::new();
    bench.hello();
    let set = |param_value, target_component| dialect::PARAM_SET_DATA {
        param_value,
        target_system: 7,
        target_component,
        param_id: "RADIO_TXP".into(),
        param_type: dialect::MavParamType::MAV_PARAM_TYPE_REAL32,
    };
    let echo = |packets: Vec<Packet>| {
        packets.iter().find_map(|p| match p.message() {
            Some(MavMessage::PARAM_VALUE(value)) => Some((p.component, value.param_value)),
            _ => None,
        })
    };
    for (value, told) in [(4.0, 4.0), (f32::NAN, 4.0), (3.0, 4.0), (1.0, 1.0)] {
        assert_eq!(echo(bench.send(&set(value, 68))), Some((68, told)), "set to {value}");
    }
    assert_eq!(echo(bench.send(&set(4.0, 1))), None, "the autopilot has no such parameter");
    let list = dialect::PARAM_REQUEST_LIST_DATA { target_system: 7, target_component: 68 };
    assert_eq!(echo(bench.send(&list)), Some((68, 1.0)));
    let read = dialect::PARAM_REQUEST_READ_DATA {
        param_index: -1,
        target_system: 7,
        target_component: 68,
        param_id: "RADIO_TXP".into(),
    };
    assert_eq!(echo(bench.send(&read)), Some((68, 1.0)));
}

#[test]
fn the_last_percept_waits_for_its_acknowledgement_and_takes_no_command() {
    let mut bench = Bench::with(Scenario::default(), Some(2));
    for k in 0..2 {
        bench.command(k, [1.0, 0.0], TxPower::Low);
        bench.vehicle.advance(bench.now);
    }
    assert!(bench.vehicle.over() && !bench.vehicle.acknowledged());
    bench.command(1, [1.0, 0.0], TxPower::Low);
    assert!(!bench.vehicle.acknowledged(), "an older stamp confirms nothing");
    bench.command(2, [1.0, 0.0], TxPower::Low);
    assert!(bench.vehicle.acknowledged() && !bench.vehicle.ready());
    assert_eq!(bench.vehicle.sim.fates().sent, 2);
}

#[test]
fn a_stream_is_greeted_at_once_may_cut_its_frames_anywhere_and_is_gone_when_it_ends() {
    let mut bench = Bench::new();
    let peer = bench.address.into();
    bench.vehicle.connected(peer, bench.now);
    assert_eq!(ids(&bench.received())[..2], [(1, 0), (68, 0)]);
    let mut bytes = Vec::new();
    bench.station.push(&mut bytes, &dialect::TIMESYNC_DATA { ts1: 9, ..Default::default() });
    let mut replies = Vec::new();
    for part in bytes.chunks(3) {
        replies.extend(bench.datagram(part));
    }
    assert_eq!(ids(&replies), [(1, 111)]);
    bench.vehicle.closed(peer);
    bench.vehicle.beat();
    assert!(bench.received().is_empty());
    assert_eq!(bench.vehicle.tally().packets.frames, 1);
}

#[test]
fn a_crowd_of_peers_stays_bounded_and_a_named_one_stays() {
    let mut bench = Bench::new();
    let named = SocketAddr::from(([127, 0, 0, 1], 14_550));
    bench.vehicle.add_peer(named, Duration::ZERO);
    let mut datagram = Vec::new();
    Encoder::new(255, 190).push(&mut datagram, &dialect::HEARTBEAT_DATA::default());
    for k in 0..100_u16 {
        let from = SocketAddr::from(([127, 0, 0, 1], 1000 + k));
        bench.vehicle.datagram(&datagram, from, Duration::from_millis(k.into()));
    }
    assert_eq!(bench.vehicle.peers.len(), MAX_PEERS);
    assert!(bench.vehicle.peers.contains_key(&named.into()));
    assert_eq!(bench.vehicle.tally().packets.frames, 100);
}

#[test]
fn a_picture_comes_on_request_and_at_its_rate() {
    let mut bench = Bench::new();
    bench.hello();
    let pictures = |packets: &[Packet]| packets.iter().filter(|p| p.id == 130).count();
    let one = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 130.0, (7, 1)));
    assert_eq!((acks(&one)[0].1.result, pictures(&one)), (MavResult::MAV_RESULT_ACCEPTED, 1));
    bench.vehicle.advance(bench.now);
    assert_eq!(pictures(&bench.received()), 0, "one is one");
    for (us, told, count) in [(0.0, 400_000, 12), (1.5e6, 1_600_000, 3), (1.2e6, 1_200_000, 4), (-1.0, -1, 0)]
    {
        let set = dialect::COMMAND_LONG_DATA {
            param2: us,
            ..ask(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, 130.0, (7, 1))
        };
        assert_eq!(acks(&bench.send(&set))[0].1.result, MavResult::MAV_RESULT_ACCEPTED);
        let get = bench.send(&ask(MavCmd::MAV_CMD_GET_MESSAGE_INTERVAL, 130.0, (7, 1)));
        assert_eq!(MessageInterval::of(&get[0]).unwrap().interval_us, told);
        let mut seen = 0;
        for _ in 0..12 {
            bench.vehicle.advance(bench.now);
            seen += pictures(&bench.received());
        }
        assert!(seen.abs_diff(count) <= 1, "{us}: {seen}");
    }
    let bad = dialect::COMMAND_LONG_DATA {
        param2: f32::NAN,
        ..ask(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, 130.0, (7, 1))
    };
    assert_eq!(acks(&bench.send(&bad))[0].1.result, MavResult::MAV_RESULT_DENIED);
}

#[test]
fn a_ping_to_all_is_answered_to_the_asker_and_an_answer_is_not() {
    let mut bench = Bench::new();
    bench.hello();
    let ping = dialect::PING_DATA { time_usec: 77, seq: 3, target_system: 0, target_component: 0 };
    let reply = bench.send(&ping);
    let Some(MavMessage::PING(pong)) = reply[0].message() else { panic!("an answer") };
    assert_eq!((pong.time_usec, pong.seq), (77, 3));
    assert_eq!((pong.target_system, pong.target_component), (255, 190));
    assert!(bench.send(&dialect::PING_DATA { target_system: 7, target_component: 1, ..ping }).is_empty());
}

#[test]
fn lost_frames_are_counted_by_their_sequence_numbers() {
    let mut bench = Bench::new();
    bench.hello();
    let mut lost = Vec::new();
    for _ in 0..3 {
        bench.station.push(&mut lost, &dialect::HEARTBEAT_DATA::default());
    }
    bench.hello();
    let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 8.0, (7, 1)));
    let Some(MavMessage::LINK_NODE_STATUS(status)) = reply[1].message() else { panic!("a status") };
    assert_eq!((status.messages_lost, status.messages_received), (3, 3));
    assert!(status.messages_sent > 5);
}

#[test]
fn in_real_time_the_clock_goes_on_between_intervals() {
    let mut bench = Bench::new();
    bench.vehicle.start_streams(Duration::from_millis(400), bench.now);
    bench.hello();
    bench.vehicle.advance(bench.now);
    bench.received();
    bench.now += Duration::from_millis(100);
    let reply = bench.send(&dialect::TIMESYNC_DATA { ts1: 1, ..Default::default() });
    let Some(MavMessage::TIMESYNC(sync)) = reply[0].message() else { panic!("an answer") };
    assert_eq!(sync.tc1, 1_500_000_000);
}

#[test]
fn timesync_is_answered_in_the_vehicles_time() {
    let mut bench = Bench::new();
    bench.hello();
    let reply = bench.send(&dialect::TIMESYNC_DATA { ts1: 99, ..Default::default() });
    let Some(MavMessage::TIMESYNC(sync)) = reply[0].message() else { panic!("an answer") };
    assert_eq!((sync.ts1, sync.tc1), (99, 1_000_000_000));
}

#[test]
fn position_and_velocity_beside_an_acceleration_are_ignored() {
    let mut bench = Bench::with(Scenario::default(), Some(2));
    let clock = Clock::new(bench.vehicle.sim.scenario());
    let message = |tick, afx| dialect::SET_POSITION_TARGET_LOCAL_NED_DATA {
        x: 1.0,
        y: 2.0,
        vx: 3.0,
        vy: 4.0,
        ..setpoint(clock.boot_ms(Tick(tick)), afx)
    };
    for tick in 0..2 {
        bench.send(&message(tick, 5.0 + tick as f32));
        assert!(bench.vehicle.ready(), "tick {tick}");
        bench.vehicle.advance(bench.now);
        let held = bench.vehicle.sim.telemetry().held;
        assert_eq!(held, Some(Held { tick: Tick(tick), accel: [5.0 + tick as f32, 0.0] }));
    }
    bench.send(&message(2, 0.0));
    assert!(bench.vehicle.acknowledged());
}

#[test]
fn a_command_is_the_same_wherever_a_stream_is_cut() {
    let command = |bench: &mut Bench| bench.encoded(0, [1.0, 0.0], TxPower::High);
    let length = command(&mut Bench::new()).len();
    for cut in 1..length {
        let mut bench = Bench::new();
        bench.vehicle.connected(bench.address.into(), bench.now);
        let first = command(&mut bench);
        let (head, tail) = first.split_at(cut);
        for part in [head, tail] {
            assert!(!bench.vehicle.ready(), "before its end, at {cut}");
            bench.datagram(part);
        }
        assert!(bench.vehicle.ready(), "{cut}");
        // A repeat, cut by the end of the interval, is still the command of tick 0.
        let again = command(&mut bench);
        let (head, tail) = again.split_at(cut);
        bench.datagram(head);
        bench.vehicle.advance(bench.now);
        let link = bench.vehicle.sim.telemetry().link;
        assert_eq!(link.map(|l| l.power), Some(TxPower::High), "{cut}");
        bench.datagram(tail);
        assert!(!bench.vehicle.ready(), "{cut}");
        for _ in 0..3 {
            let held = bench.vehicle.sim.telemetry().held;
            assert_eq!(held, Some(Held { tick: Tick(0), accel: [1.0, 0.0] }), "{cut}");
            bench.vehicle.advance(bench.now);
        }
    }
}
