use proptest::prelude::*;

use super::*;
use crate::link::decoder::Decoder;

fn clock() -> Clock {
    Clock::new(&Scenario::default())
}

fn packets(report: &Telemetry) -> Vec<Packet> {
    let mut datagram = Vec::new();
    let (mut autopilot, mut radio) = (Encoder::new(7, AUTOPILOT), Encoder::new(7, RADIO));
    push_telemetry(report, &clock(), [-100.0, 0.0], &mut autopilot, &mut radio, &mut datagram);
    Decoder::default().datagram(&datagram)
}

fn read(packets: &[Packet]) -> Vec<Telemetry> {
    let mut reader = TelemetryReader::default();
    packets.iter().filter_map(|packet| reader.push(packet, &clock())).collect()
}

fn report(tick: u64) -> Telemetry {
    Telemetry {
        tick: Tick(tick),
        position: [250.1, 50.2],
        velocity: [-1.5, 12.25],
        obstacles: [[225.0, 250.0]].into(),
        held: Some(Held { tick: Tick(tick - 1), accel: [10.9375, -0.0] }),
        link: Some(LinkReport { snr_db: -3.21, power: TxPower::High, outage: true }),
    }
}

#[test]
fn every_obstacle_of_the_scenario_arrives() {
    let clock_of = |count: usize| {
        let mut scenario = Scenario::default();
        scenario.obstacles = vec![scenario.obstacle().clone(); count];
        Clock::new(&scenario)
    };
    let of = |count: usize, tick: u64| Telemetry {
        obstacles: (0..count).map(|n| [225.0 + n as f32, 250.5]).collect(),
        ..report(tick)
    };
    let packets = |report: &Telemetry, clock: &Clock| {
        let mut datagram = Vec::new();
        let (mut autopilot, mut radio) = (Encoder::new(7, AUTOPILOT), Encoder::new(7, RADIO));
        push_telemetry(report, clock, [-100.0, 0.0], &mut autopilot, &mut radio, &mut datagram);
        Decoder::default().datagram(&datagram)
    };
    let heard = |sent: &[Packet], clock: &Clock| {
        let mut reader = TelemetryReader::default();
        (sent.iter().filter_map(|p| reader.push(p, clock)).collect::<Vec<_>>(), reader.malformed())
    };
    for count in 0..=MAX_OBSTACLES {
        let (clock, sent) = (clock_of(count), of(count, 9));
        assert_eq!(heard(&packets(&sent, &clock), &clock), (vec![sent], 0), "{count}");
        // The first report, without a radio's, too.
        let first = Telemetry { tick: Tick(0), held: None, link: None, ..sent };
        assert_eq!(heard(&packets(&first, &clock), &clock), (vec![first], 0), "{count}");
    }
    // A station and a vehicle that disagree on the number hear nothing of each other, and count it.
    for (vehicle, station) in [(2, 1), (1, 2), (3, 2), (1, 3)] {
        let sent = packets(&of(vehicle, 9), &clock_of(vehicle));
        assert_eq!(heard(&sent, &clock_of(station)), (vec![], 1), "{vehicle} and {station}");
    }
}

/// After 49.7 days in flight the stamps begin at 0 again, and no report was read any more.
#[test]
fn reports_are_read_on_when_the_stamps_come_round() {
    let round = 2_u64.pow(32) / 400;
    let ticks = [round - 100, round - 2, round - 1, round, round + 1, round, round + 9_000, round + 18_000];
    let mut reader = TelemetryReader::default();
    for tick in ticks {
        let sent = report(tick);
        let heard: Vec<_> =
            packets(&sent).iter().filter_map(|packet| reader.push(packet, &clock())).collect();
        assert_eq!(heard, [sent], "{tick}");
    }
    // A vehicle that has booted anew, two hours later, begins with its first tick.
    let sent = report(3);
    let heard: Vec<_> = packets(&sent).iter().filter_map(|packet| reader.push(packet, &clock())).collect();
    assert_eq!((heard, reader.malformed()), (vec![sent], 0));
}

prop_compose! {
    fn any_report()(
        tick in 0..1_000_000_u64,
        values in prop::array::uniform9(prop::num::f32::NORMAL | prop::num::f32::ZERO),
        behind in prop::option::of(0..100_u64),
        high: bool,
        outage: bool,
    ) -> Telemetry {
        let [x, y, vx, vy, ox, oy, ax, ay, snr_db] = values;
        let power = if high { TxPower::High } else { TxPower::Low };
        Telemetry {
            tick: Tick(tick),
            position: [x, y],
            velocity: [vx, vy],
            obstacles: [[ox, oy]].into(),
            held: behind.map(|b| Held { tick: Tick(tick.saturating_sub(b)), accel: [ax, ay] }),
            link: (tick > 0).then_some(LinkReport { snr_db, power, outage }),
        }
    }
}

proptest! {
    #[test]
    fn a_report_arrives_to_the_last_bit(report in any_report()) {
        let found = read(&packets(&report));
        // Debug text tells -0 from 0, which == does not.
        prop_assert_eq!(format!("{:?}", found), format!("{:?}", [report]));
    }

    #[test]
    fn a_command_arrives_to_the_last_bit(
        tick in 0..1_000_000_u64,
        accel in prop::array::uniform2(prop::num::f32::NORMAL | prop::num::f32::ZERO),
        high: bool,
    ) {
        let power = if high { TxPower::High } else { TxPower::Low };
        let command = Command::new(Tick(tick), accel, power);
        let mut datagram = Vec::new();
        push_command(&command, &clock(), 7, &mut Encoder::new(255, 190), &mut datagram);
        let [first, second] = &Decoder::default().datagram(&datagram)[..] else { panic!("two messages") };
        let ask = ask_of(first).unwrap();
        prop_assert_eq!(ask.command, CMD_TX_POWER);
        prop_assert_eq!(ask.target, Target { system: 7, component: RADIO });
        prop_assert_eq!(TxPower::from_level(ask.params[0]), Ok(power));
        prop_assert_eq!(ask.params[1], clock().boot_ms(Tick(tick)) as f32);
        let (target, setpoint) = setpoint_of(second).unwrap();
        prop_assert_eq!(target, Target { system: 7, component: AUTOPILOT });
        let setpoint = setpoint.unwrap();
        let flown = setpoint.level_acceleration().unwrap();
        prop_assert_eq!(flown.map(f32::to_bits), accel.map(f32::to_bits));
        prop_assert_eq!(clock().tick(setpoint.stamp_ms), Some(Tick(tick)));
    }

    #[test]
    fn packets_full_of_junk_never_panic(
        id in prop::sample::select(vec![32_u32, 84, 85, 86, 76, 75, 250, 251, 130, 131, 23, 20]),
        payload in prop::collection::vec(any::<u8>(), 0..=255),
    ) {
        let mut raw = vec![0xFD, payload.len() as u8, 0, 0, 0, 1, 1, id as u8, 0, 0];
        raw.extend_from_slice(&payload);
        raw.extend([0, 0]);
        let packet = Packet { system: 1, component: 1, sequence: 0, id, raw: raw[..].into() };
        let _ = setpoint_of(&packet);
        let _ = ask_of(&packet);
        let _ = packet.message();
        prop_assert!(TelemetryReader::default().push(&packet, &clock()).is_none());
    }
}

#[test]
fn a_report_with_a_message_missing_is_none_and_no_two_are_mixed() {
    let (first, second) = (packets(&report(5)), packets(&report(6)));
    for missing in 0..6 {
        let mut found = first.clone();
        found.remove(missing);
        assert_eq!(read(&found), []);
        assert_eq!(read(&[&found[..], &second].concat()), [report(6)], "without message {missing}");
    }
    // The first report's beginning, the second one's end.
    for cut in 1..6 {
        assert_eq!(read(&[&first[..cut], &second[cut..]].concat()), [], "cut at {cut}");
    }
}

#[test]
fn stamps_of_another_clock_name_no_tick() {
    let clock = clock();
    assert_eq!(clock.tick(clock.boot_ms(Tick(0))), Some(Tick(0)));
    assert_eq!(clock.tick(0), None);
    assert_eq!(clock.tick(clock.boot_ms(Tick(3)) + 1), None);
}

fn setpoint(change: impl FnOnce(&mut dialect::SET_POSITION_TARGET_LOCAL_NED_DATA)) -> Packet {
    let mut message = dialect::SET_POSITION_TARGET_LOCAL_NED_DATA {
        afx: 1.0,
        type_mask: PositionTargetTypemask::from_bits_retain(MASK_ACCEL),
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        ..Default::default()
    };
    change(&mut message);
    let mut datagram = Vec::new();
    Encoder::new(255, 190).push(&mut datagram, &message);
    Decoder::default().datagram(&datagram).remove(0)
}

#[test]
fn setpoints_are_taken_or_refused_for_a_reason() {
    let mask = |bits| {
        move |m: &mut dialect::SET_POSITION_TARGET_LOCAL_NED_DATA| {
            m.type_mask = PositionTargetTypemask::from_bits_retain(bits);
        }
    };
    let verdict = |packet: Packet| setpoint_of(&packet).unwrap().1;
    let level = |packet: Packet| verdict(packet).map(|setpoint| setpoint.level_acceleration());
    let good = Ok(Some([1.0, 0.0]));
    assert_eq!(level(setpoint(|_| {})), good);
    assert_eq!(level(setpoint(|m| (m.x, m.yaw) = (f32::NAN, f32::NAN))), good);
    let ignored = setpoint(|m| {
        (m.x, m.y, m.z) = (1.0, 2.0, 3.0);
        (m.vx, m.vy, m.vz) = (4.0, 5.0, 6.0);
    });
    assert_eq!(level(ignored), good, "position and velocity are ignored");
    assert_eq!(level(setpoint(mask(0x3F))), good, "yaw turns, beside it");
    assert_eq!(level(setpoint(mask(MASK_ACCEL | 0xF000))), good, "bits without a meaning");
    assert_eq!(verdict(setpoint(mask(0x0DFF))), Err(Refusal::Empty));
    let one = verdict(setpoint(mask(0x0C7F))).unwrap();
    assert_eq!((one.acceleration.level, one.acceleration.down), (None, Some(0.0)), "x ignores y too");
    assert_eq!(level(setpoint(mask(0))), Ok(None), "a position too");
    assert_eq!(level(setpoint(|m| m.afz = -1.0)), Ok(None), "it leaves the plane");
    assert_eq!(verdict(setpoint(mask(MASK_ACCEL | 512))), Err(Refusal::Force));
    assert_eq!(verdict(setpoint(|m| m.afy = f32::NAN)), Err(Refusal::NotFinite));
    assert_eq!(verdict(setpoint(|m| m.afz = f32::INFINITY)), Err(Refusal::NotFinite));
    let other = setpoint(|m| m.coordinate_frame = MavFrame::MAV_FRAME_LOCAL_ENU);
    assert_eq!(verdict(other), Err(Refusal::Frame));
}

#[test]
#[expect(deprecated, reason = "stations still use the integer twins of the frames")]
fn setpoints_on_earth_have_degrees_and_a_height_from_home_or_the_sea() {
    let verdict = |coordinate_frame, lat_int| {
        let message = dialect::SET_POSITION_TARGET_GLOBAL_INT_DATA {
            lat_int,
            lon_int: 85_000_000,
            alt: 30.0,
            type_mask: PositionTargetTypemask::from_bits_retain(0x0DF8),
            coordinate_frame,
            ..Default::default()
        };
        let mut datagram = Vec::new();
        Encoder::new(255, 190).push(&mut datagram, &message);
        setpoint_of(&Decoder::default().datagram(&datagram).remove(0)).unwrap().1
    };
    for (frame, expected) in [
        (MavFrame::MAV_FRAME_GLOBAL, SetpointFrame::Sea),
        (MavFrame::MAV_FRAME_GLOBAL_INT, SetpointFrame::Sea),
        (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT, SetpointFrame::Home),
        (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, SetpointFrame::Home),
        (MavFrame::MAV_FRAME_GLOBAL_TERRAIN_ALT_INT, SetpointFrame::Home),
    ] {
        let setpoint = verdict(frame, 474_000_000).unwrap();
        assert_eq!(setpoint.frame, expected);
        assert_eq!(setpoint.position, Axes { level: Some([47.4, 8.5]), down: Some(-30.0) });
    }
    assert_eq!(verdict(MavFrame::MAV_FRAME_LOCAL_NED, 0), Err(Refusal::Frame));
    assert_eq!(verdict(MavFrame::MAV_FRAME_GLOBAL_INT, 900_000_001), Err(Refusal::NoPlace));
}
