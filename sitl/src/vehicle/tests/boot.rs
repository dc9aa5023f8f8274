//! How a flight begins, and begins anew.

use super::*;
use crate::link::messages::mission::MissionCount;

fn result(packets: &[Packet]) -> Option<MavResult> {
    acks(packets).first().map(|(_, ack)| ack.result)
}

fn set(bench: &mut Bench, name: &str, param_value: f32) {
    bench.send(&dialect::PARAM_SET_DATA {
        param_value,
        target_system: 7,
        target_component: 1,
        param_id: name.into(),
        param_type: dialect::MavParamType::MAV_PARAM_TYPE_REAL32,
    });
}

/// Nothing reset the vehicle between two scripts, and what takes effect at boot never did.
#[test]
fn a_reboot_is_a_fresh_flight_with_the_parameters_of_the_boot() {
    let mut bench = Bench::new();
    bench.hello();
    set(&mut bench, "START_N", 100.0);
    for k in 0..20 {
        bench.command(k, [5.0, 5.0], TxPower::High);
        bench.vehicle.advance(bench.now);
    }
    bench.received();
    assert_eq!(
        result(&bench.send(&ask(MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 2.0, (7, 1)))),
        Some(MavResult::MAV_RESULT_DENIED)
    );
    assert_eq!(bench.vehicle.sim.tick(), Tick(20));
    let reply = bench.send(&ask(MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0, (7, 1)));
    assert_eq!(result(&reply), Some(MavResult::MAV_RESULT_ACCEPTED));
    assert_eq!(texts(&reply), ["rebooted"]);
    assert_eq!((bench.vehicle.sim.tick(), bench.vehicle.begun()), (Tick(0), false));
    assert_eq!(bench.vehicle.sim.telemetry().position, [100.0, 50.0]);
    assert_eq!(bench.vehicle.sim.fates().sent, 0);
    bench.command(0, [5.0, 0.0], TxPower::Low);
    assert!(bench.vehicle.ready(), "and flies again");
}

#[test]
fn home_and_protocol_version_are_told_on_their_own_commands() {
    let mut bench = Bench::new();
    bench.hello();
    assert_eq!(ids(&bench.send(&ask(MavCmd::MAV_CMD_GET_HOME_POSITION, 0.0, (7, 1)))), [(1, 77), (1, 242)]);
    let version = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_PROTOCOL_VERSION, 1.0, (7, 1)));
    assert_eq!(ids(&version), [(1, 77), (1, 300)]);
}

#[test]
fn on_the_ground_it_is_disarmed_until_somebody_arms_it_and_takes_off() {
    let mut bench = Bench::new();
    bench.vehicle.set_start(Start { on_ground: true, home: None });
    bench.hello();
    assert!(!bench.vehicle.conduct.armed && bench.vehicle.height.on_ground());
    bench.send(&setpoint(0, 5.0));
    bench.vehicle.advance(bench.now);
    assert_eq!(bench.vehicle.sim.telemetry().velocity, [0.0; 2]);
    let here = dialect::COMMAND_LONG_DATA {
        param5: f32::NAN,
        param6: f32::NAN,
        param7: 50.0,
        ..ask(MavCmd::MAV_CMD_DO_REPOSITION, -1.0, (7, 1))
    };
    let denied = Some(MavResult::MAV_RESULT_DENIED);
    assert_eq!(result(&bench.send(&here)), denied, "what is not flown is not accepted");
    bench.send(&ask(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0, (7, 1)));
    let takeoff =
        dialect::COMMAND_LONG_DATA { param7: 20.0, ..ask(MavCmd::MAV_CMD_NAV_TAKEOFF, 0.0, (7, 1)) };
    assert_eq!(result(&bench.send(&takeoff)), Some(MavResult::MAV_RESULT_ACCEPTED));
    for _ in 0..12 {
        bench.vehicle.advance(bench.now);
    }
    assert_eq!(bench.vehicle.height.altitude_m, 20.0);
    bench.send(&ask(MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0, (7, 1)));
    assert!(!bench.vehicle.conduct.armed && bench.vehicle.height.on_ground(), "after a reboot as well");
}

#[test]
fn a_home_moves_the_start_on_earth_and_turns_the_vehicle() {
    let mut bench = Bench::new();
    let home = "-35.363261,149.165230,584,353".parse().unwrap();
    bench.vehicle.set_start(Start { on_ground: false, home: Some(home) });
    bench.hello();
    let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 33.0, (7, 1)));
    let Some(MavMessage::GLOBAL_POSITION_INT(told)) = reply[1].message() else { panic!("a position") };
    assert!((told.lat + 353_632_610).abs() <= 1 && (told.lon - 1_491_652_300).abs() <= 1, "{told:?}");
    assert_eq!((told.alt, told.relative_alt, told.hdg), (684_000, 100_000, 35_300));
    assert_eq!(bench.vehicle.sim.telemetry().position, [250.0, 50.0], "the local frame is the paper's");
}

/// The 17th peer made the others lose their rates.
#[test]
fn one_peer_too_many_is_refused_until_another_is_silent() {
    let mut bench = Bench::new();
    let heartbeat = |bench: &mut Bench, port: u16, seconds: u64| {
        let mut datagram = Vec::new();
        Encoder::new(255, 190).push(&mut datagram, &dialect::HEARTBEAT_DATA::default());
        let from = SocketAddr::from(([127, 0, 0, 1], port));
        bench.vehicle.datagram(&datagram, from, Duration::from_secs(seconds));
        bench.vehicle.peers.contains_key(&from.into())
    };
    for port in 0..MAX_PEERS as u16 {
        assert!(heartbeat(&mut bench, 1000 + port, 0));
    }
    assert!(!heartbeat(&mut bench, 5000, 1), "all others speak");
    assert_eq!(bench.vehicle.peers.len(), MAX_PEERS);
    for port in 1..MAX_PEERS as u16 {
        heartbeat(&mut bench, 1000 + port, 2);
    }
    assert!(heartbeat(&mut bench, 5000, 3), "the first has been silent");
    assert!(!bench.vehicle.peers.contains_key(&SocketAddr::from(([127, 0, 0, 1], 1000)).into()));
}

/// `sitl` grew by 101 KiB a minute: a program that began anew came from another port each time, and every peer
/// that had ever been was kept, and sent to.
#[test]
fn who_has_gone_is_forgotten_in_real_time_and_told_why() {
    let peer = |k: u16| PeerId::from(SocketAddr::from(([127, 0, 0, 1], 1000 + k)));
    for real_time in [true, false] {
        let mut bench = Bench::new();
        if real_time {
            bench.vehicle.start_streams(Duration::from_millis(400), bench.now);
        }
        bench.vehicle.connected(peer(500), bench.now);
        let mut datagram = Vec::new();
        Encoder::new(255, 190).push(&mut datagram, &dialect::HEARTBEAT_DATA::default());
        let (mut most, mut told) = (0, 0);
        for second in 0..300_u64 {
            let now = Duration::from_secs(second);
            // One that stays, and every 30 s one that comes, says a word, and goes.
            bench.vehicle.datagram(&datagram, peer(0), now);
            if second % 30 == 0 {
                bench.vehicle.datagram(&datagram, peer(1 + second as u16 / 30), now);
            }
            bench.vehicle.stream(now);
            bench.vehicle.beat();
            most = most.max(bench.vehicle.peers.len());
            while let Some((to, bytes)) = bench.vehicle.poll() {
                let said = texts(&Decoder::default().datagram(&bytes));
                let why = said.iter().any(|text| text.contains("silent for 60 s"));
                assert!(!why || ![peer(0), peer(500)].contains(&to), "{to} is there");
                told += usize::from(why);
            }
        }
        assert!([peer(0), peer(500)].iter().all(|stays| bench.vehicle.peers.contains_key(stays)));
        if real_time {
            assert!(most <= 5 && told == 8, "{most} peers at once, {told} told");
        } else {
            assert_eq!((most, told), (12, 0), "in lockstep all may think");
        }
        assert_eq!(bench.vehicle.tally().packets.frames, 310, "what they have sent counts on");
    }
}

#[test]
fn a_mission_outlives_a_reboot() {
    let mut bench = Bench::new();
    bench.hello();
    bench.vehicle.rally = vec![StoredItem::home([0, 0], 0.0)];
    bench.send(&ask(MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0, (7, 1)));
    let list = dialect::MISSION_REQUEST_LIST_DATA {
        target_system: 7,
        target_component: 1,
        mission_type: dialect::MavMissionType::MAV_MISSION_TYPE_RALLY,
    };
    let reply = bench.send(&list);
    assert_eq!(reply.iter().find_map(MissionCount::of).map(|told| told.count), Some(1));
}

#[test]
fn home_is_set_here_or_there_and_rtl_leads_to_it() {
    let mut bench = Bench::new();
    bench.hello();
    let home = |packets: &[Packet]| {
        packets.iter().find_map(|packet| match packet.message() {
            Some(MavMessage::HOME_POSITION(home)) => {
                Some([home.x, home.y, home.latitude as f32, home.longitude as f32])
            }
            _ => None,
        })
    };
    let began = home(&bench.send(&ask(MavCmd::MAV_CMD_GET_HOME_POSITION, 0.0, (7, 1)))).unwrap();
    assert_eq!(began[..2], [250.0, 50.0]);
    for tick in 0..5 {
        bench.command(tick, [5.0, 0.0], TxPower::Low);
        bench.vehicle.advance(bench.now);
    }
    let [north, east] = bench.vehicle.sim.telemetry().position;
    assert!(north > 250.5);
    let reply = bench.send(&ask(MavCmd::MAV_CMD_DO_SET_HOME, 1.0, (7, 1)));
    assert_eq!(result(&reply), Some(MavResult::MAV_RESULT_ACCEPTED));
    let here = home(&reply).unwrap();
    assert!((here[0] - north).abs() < 0.1 && (here[1] - east).abs() < 0.1 && here[2] > began[2], "{here:?}");

    // Elsewhere, as COMMAND_INT has it; and nowhere, outside the walls, not a number.
    let there = bench.vehicle.site.latitude_longitude([300.0, 200.0]);
    let set = |x: i32, y: i32| dialect::COMMAND_INT_DATA {
        command: MavCmd::MAV_CMD_DO_SET_HOME,
        x,
        y,
        target_system: 7,
        target_component: 1,
        ..Default::default()
    };
    let denied = Some(MavResult::MAV_RESULT_DENIED);
    for [x, y] in [[0, 0], [i32::MAX, i32::MAX], [there[0] + 100_000_000, there[1]]] {
        assert_eq!(result(&bench.send(&set(x, y))), denied, "{x} {y}");
    }
    let nan =
        dialect::COMMAND_LONG_DATA { param5: f32::NAN, ..ask(MavCmd::MAV_CMD_DO_SET_HOME, 0.0, (7, 1)) };
    assert_eq!(result(&bench.send(&nan)), denied);
    let reply = bench.send(&set(there[0], there[1]));
    assert_eq!(result(&reply), Some(MavResult::MAV_RESULT_ACCEPTED));
    let moved = home(&reply).unwrap();
    assert!((moved[0] - 300.0).abs() < 0.1 && (moved[1] - 200.0).abs() < 0.1, "{moved:?}");
    let scale = bench.vehicle.sim.scenario().scale;
    let led = scale.ned_from_paper(bench.vehicle.return_point());
    assert!((led[0] - 300.0).abs() < 0.1 && (led[1] - 200.0).abs() < 0.1, "{led:?}");

    // A reboot begins at the start again.
    bench.send(&ask(MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0, (7, 1)));
    let again = home(&bench.send(&ask(MavCmd::MAV_CMD_GET_HOME_POSITION, 0.0, (7, 1)))).unwrap();
    assert_eq!(again, began);
}
