//! Mode, arming, takeoff and landing.

use nalgebra::Vector2;

use super::*;
use crate::scenario::CollisionAction;
use crate::vehicle::conduct::Mode;

/// Result, and the text if there is one.
fn told(bench: &mut Bench, ask: &impl MessageData) -> (Option<MavResult>, Option<String>) {
    bench.now += Duration::from_secs(2);
    let reply = bench.send(ask);
    (acks(&reply).first().map(|(_, ack)| ack.result), texts(&reply).into_iter().next())
}

fn long(command: MavCmd, param1: f32, param2: f32, param7: f32) -> dialect::COMMAND_LONG_DATA {
    dialect::COMMAND_LONG_DATA { param2, param7, ..ask(command, param1, (7, 1)) }
}

fn mode(number: f32) -> dialect::COMMAND_LONG_DATA {
    long(MavCmd::MAV_CMD_DO_SET_MODE, 1.0, number, 0.0)
}

fn arm(arm: f32, force: f32) -> dialect::COMMAND_LONG_DATA {
    long(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, arm, force, 0.0)
}

/// Mode, armed and status of the next heartbeat.
fn heartbeat(bench: &mut Bench) -> (u32, bool, dialect::MavState) {
    bench.vehicle.beat();
    let packets = bench.received();
    let found = packets.iter().filter(|packet| packet.component == 1).find_map(|packet| packet.message());
    let Some(MavMessage::HEARTBEAT(beat)) = found else { panic!("a heartbeat") };
    let armed = beat.base_mode.contains(dialect::MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
    (beat.custom_mode, armed, beat.system_status)
}

/// So many intervals pass; gives what is said.
fn pass(bench: &mut Bench, intervals: usize) -> Vec<String> {
    let mut said = Vec::new();
    for _ in 0..intervals {
        bench.now += Duration::from_millis(400);
        bench.vehicle.advance(bench.now);
        said.extend(texts(&bench.received()));
    }
    said
}

const ACCEPTED: Option<MavResult> = Some(MavResult::MAV_RESULT_ACCEPTED);
const DENIED: Option<MavResult> = Some(MavResult::MAV_RESULT_DENIED);
const FAILED: Option<MavResult> = Some(MavResult::MAV_RESULT_FAILED);
const ACTIVE: dialect::MavState = dialect::MavState::MAV_STATE_ACTIVE;
const CRITICAL: dialect::MavState = dialect::MavState::MAV_STATE_CRITICAL;
const STANDBY: dialect::MavState = dialect::MavState::MAV_STATE_STANDBY;

/// A vehicle on its way north, faster than nothing.
fn moving() -> Bench {
    let mut bench = Bench::new();
    bench.hello();
    bench.send(&setpoint(0, 5.0));
    pass(&mut bench, 6);
    assert!(bench.vehicle.sim.world().uav.v.norm() > 0.0);
    bench
}

#[test]
fn it_is_armed_and_cannot_be_disarmed_in_the_air() {
    let mut bench = Bench::new();
    bench.hello();
    assert_eq!(told(&mut bench, &arm(1.0, 0.0)), (ACCEPTED, None));
    let (result, text) = told(&mut bench, &arm(0.0, 0.0));
    assert_eq!((result, text.as_deref()), (FAILED, Some("disarming refused: in the air")));
    for odd in [7.5, -1.0, f32::NAN] {
        assert_eq!(told(&mut bench, &arm(odd, 0.0)).0, DENIED, "{odd}");
    }
    assert_eq!(heartbeat(&mut bench), (4, true, ACTIVE));
}

#[test]
fn forced_to_disarm_in_the_air_it_falls_and_never_flies_again() {
    let mut bench = moving();
    let (result, text) = told(&mut bench, &arm(0.0, 21_196.0));
    assert_eq!((result, text.as_deref()), (ACCEPTED, Some("motors off in the air: falling")));
    assert_eq!(heartbeat(&mut bench), (4, false, dialect::MavState::MAV_STATE_EMERGENCY));
    let speed = bench.vehicle.sim.world().uav.v;
    bench.send(&setpoint(0, -5.0));
    let said = pass(&mut bench, 5);
    assert_eq!(bench.vehicle.sim.world().uav.v, speed, "without motors it keeps its speed: {said:?}");
    let said = pass(&mut bench, 10);
    assert!(said.iter().any(|text| text.starts_with("crashed at 4")), "{said:?}");
    assert!(bench.vehicle.height.on_ground());
    let place = bench.vehicle.sim.world().uav.r;
    pass(&mut bench, 5);
    assert_eq!((bench.vehicle.sim.world().uav.r, bench.vehicle.sim.world().uav.v), (place, Vector2::zeros()));
    assert_eq!(told(&mut bench, &arm(1.0, 0.0)).0, FAILED);
    assert_eq!(told(&mut bench, &arm(1.0, 21_196.0)).0, FAILED);
}

#[test]
fn modes_are_arducopters_and_others_are_denied() {
    let mut bench = Bench::new();
    bench.hello();
    assert_eq!(told(&mut bench, &mode(4.0)), (ACCEPTED, None), "it is in GUIDED");
    let flags = long(MavCmd::MAV_CMD_DO_SET_MODE, 209.0, 5.0, 0.0);
    assert_eq!(told(&mut bench, &flags).0, ACCEPTED, "other flags may be set too");
    assert_eq!(heartbeat(&mut bench), (5, true, ACTIVE));
    let (result, text) = told(&mut bench, &mode(2.0));
    assert_eq!((result, text.as_deref()), (DENIED, Some("mode 2 refused: only 3, 4, 5, 6, 9, 17")));
    let (result, text) = told(&mut bench, &mode(3.0));
    assert_eq!((result, text.as_deref()), (FAILED, Some("AUTO refused: there is no mission")));
    for (p1, p2) in [(0.0, 4.0), (1.0, f32::NAN), (f32::NAN, 4.0), (1.0, 4.5)] {
        let odd = long(MavCmd::MAV_CMD_DO_SET_MODE, p1, p2, 0.0);
        assert_eq!(told(&mut bench, &odd).0, DENIED, "{p1} {p2}");
    }
}

/// The old message, which is acknowledged by its own number.
#[test]
fn set_mode_is_answered_too() {
    let mut bench = Bench::new();
    bench.hello();
    for (custom_mode, result) in [(17, MavResult::MAV_RESULT_ACCEPTED), (1, MavResult::MAV_RESULT_DENIED)] {
        let base_mode = dialect::MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
        let reply = bench.send(&dialect::SET_MODE_DATA { custom_mode, target_system: 7, base_mode });
        let ack = reply.iter().find_map(CommandAck::of).unwrap();
        assert_eq!((ack.command, ack.result), (11, result as u8));
    }
}

#[test]
fn brake_stops_and_a_setpoint_counts_again_in_guided_only() {
    let mut bench = moving();
    assert_eq!(told(&mut bench, &mode(17.0)).1.as_deref(), Some("mode BRAKE"));
    bench.send(&setpoint(0, 5.0));
    assert!(bench.vehicle.ready(), "in lockstep it is the clock all the same");
    pass(&mut bench, 20);
    assert_eq!(bench.vehicle.sim.world().uav.v, Vector2::zeros());
    assert_eq!((bench.vehicle.tally().ignored, bench.vehicle.sim.telemetry().held), (1, None));
    told(&mut bench, &mode(4.0));
    pass(&mut bench, 3);
    assert_eq!(bench.vehicle.sim.world().uav.v, Vector2::zeros(), "the old action is not flown again");
    bench.send(&setpoint(0, 5.0));
    pass(&mut bench, 1);
    assert!(bench.vehicle.sim.world().uav.v.norm() > 0.0);
}

#[test]
fn landing_disarms_and_takeoff_needs_arming() {
    let mut bench = moving();
    assert_eq!(told(&mut bench, &long(MavCmd::MAV_CMD_NAV_LAND, 0.0, 0.0, 0.0)).0, ACCEPTED);
    let said = pass(&mut bench, 51);
    assert_eq!(said.last().map(String::as_str), Some("landed and disarmed"));
    assert_eq!(heartbeat(&mut bench), (9, false, STANDBY));
    let takeoff = |height| long(MavCmd::MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, height);
    assert_eq!(told(&mut bench, &arm(1.0, 0.0)).0, FAILED, "LAND does not take off");
    told(&mut bench, &mode(4.0));
    assert_eq!(told(&mut bench, &takeoff(100.0)).0, FAILED, "not armed");
    assert_eq!(told(&mut bench, &arm(1.0, 0.0)).0, ACCEPTED);
    bench.send(&setpoint(0, 5.0));
    pass(&mut bench, 3);
    assert_eq!(bench.vehicle.sim.world().uav.v, Vector2::zeros(), "on the ground nothing is flown");
    assert_eq!(told(&mut bench, &arm(0.0, 0.0)).0, ACCEPTED, "on the ground it may");
    told(&mut bench, &arm(1.0, 0.0));
    assert_eq!(told(&mut bench, &takeoff(100.0)).0, ACCEPTED);
    pass(&mut bench, 50);
    assert_eq!((bench.vehicle.height.altitude_m, bench.vehicle.conduct.climbing), (100.0, None));
    bench.send(&setpoint(0, 5.0));
    pass(&mut bench, 1);
    assert!(bench.vehicle.sim.world().uav.v.norm() > 0.0);
}

/// A takeoff to 10 m was denied: the vehicle flew at one height.
#[test]
fn a_takeoff_climbs_to_the_height_that_it_names() {
    let mut bench = Bench::new();
    bench.hello();
    let takeoff = |height| long(MavCmd::MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, height);
    assert_eq!(told(&mut bench, &takeoff(100.0)), (ACCEPTED, None), "it is there");
    for bad in [f32::NAN, f32::INFINITY, -1.0, 0.0, 1e30] {
        assert_eq!(told(&mut bench, &takeoff(bad)).0, DENIED, "{bad}");
    }
    let (target_system, target_component, command) = (7, 1, MavCmd::MAV_CMD_NAV_TAKEOFF);
    let mut int = dialect::COMMAND_INT_DATA {
        z: 100.0,
        command,
        target_system,
        target_component,
        frame: dialect::MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT,
        ..Default::default()
    };
    assert_eq!(told(&mut bench, &int), (ACCEPTED, None));
    int.frame = dialect::MavFrame::MAV_FRAME_GLOBAL;
    assert_eq!(told(&mut bench, &int).0, DENIED, "100 m above the sea is below the ground");
    assert_eq!(told(&mut bench, &takeoff(90.0)).0, ACCEPTED, "in the air it goes there");
    pass(&mut bench, 10);
    assert_eq!(bench.vehicle.height.altitude_m, 90.0);
    told(&mut bench, &mode(5.0));
    assert_eq!(told(&mut bench, &takeoff(50.0)).0, FAILED, "not in LOITER");

    told(&mut bench, &mode(9.0));
    pass(&mut bench, 60);
    told(&mut bench, &mode(4.0));
    told(&mut bench, &arm(1.0, 0.0));
    assert_eq!(told(&mut bench, &takeoff(10.0)).0, ACCEPTED);
    pass(&mut bench, 4);
    assert_eq!((bench.vehicle.height.altitude_m, bench.vehicle.height.climb_mps), (8.0, 5.0));
    pass(&mut bench, 6);
    assert_eq!((bench.vehicle.height.altitude_m, bench.vehicle.conduct.climbing), (10.0, None));
}

#[test]
fn rtl_flies_to_the_start_and_lands_there() {
    let mut bench = moving();
    pass(&mut bench, 10);
    let start = bench.vehicle.sim.scenario().start;
    assert!((bench.vehicle.sim.world().uav.r - start).norm() > 0.1);
    assert_eq!(told(&mut bench, &long(MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH, 0.0, 0.0, 0.0)).0, ACCEPTED);
    let said = pass(&mut bench, 150);
    assert_eq!(said.last().map(String::as_str), Some("landed and disarmed"));
    assert!((bench.vehicle.sim.world().uav.r - start).norm() * 500.0 < 5.0);
}

#[test]
fn a_reposition_flies_to_its_point_until_the_next_setpoint() {
    let mut bench = moving();
    let target = Vector2::new(0.15, 0.35);
    let ne = bench.vehicle.sim.scenario().scale.ned_from_paper(target);
    let [x, y] = geodesy::latitude_longitude(ne);
    let go = |x, y| dialect::COMMAND_INT_DATA {
        x,
        y,
        command: MavCmd::MAV_CMD_DO_REPOSITION,
        target_system: 7,
        target_component: 1,
        z: 30.0,
        frame: dialect::MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        ..Default::default()
    };
    assert_eq!(told(&mut bench, &go(x, y + 1_000_000)).0, DENIED, "east of the square");
    let below = dialect::COMMAND_INT_DATA { z: -30.0, ..go(x, y) };
    assert_eq!(told(&mut bench, &below).0, DENIED, "below the ground");
    assert_eq!(told(&mut bench, &go(x, y)).0, ACCEPTED);
    pass(&mut bench, 100);
    assert!((bench.vehicle.sim.world().uav.r - target).norm() < 1e-3);
    assert_eq!(bench.vehicle.height.altitude_m, 30.0, "its height is flown");
    let sea = dialect::COMMAND_INT_DATA {
        x: i32::MAX,
        y: i32::MAX,
        z: 488.0 + 40.0,
        frame: dialect::MavFrame::MAV_FRAME_GLOBAL_INT,
        ..go(0, 0)
    };
    assert_eq!(told(&mut bench, &sea).0, ACCEPTED, "here, above the sea");
    pass(&mut bench, 10);
    assert!((bench.vehicle.sim.world().uav.r - target).norm() < 1e-3);
    assert_eq!(bench.vehicle.height.altitude_m, 40.0);
    bench.send(&setpoint(0, 5.0));
    pass(&mut bench, 1);
    assert!(bench.vehicle.sim.world().uav.v.norm() > 0.0);
    told(&mut bench, &mode(17.0));
    assert_eq!(told(&mut bench, &go(x, y)).0, DENIED, "BRAKE stays BRAKE without the flag");
    let change = dialect::COMMAND_INT_DATA { param2: 1.0, ..go(x, y) };
    assert_eq!(told(&mut bench, &change).0, ACCEPTED);
    assert_eq!(bench.vehicle.conduct.mode, Mode::Guided);
}

#[test]
fn a_speed_is_taken_within_the_limit() {
    let mut bench = Bench::new();
    bench.hello();
    for (kind, mps, result) in [
        (1.0, 10.0, ACCEPTED),
        (0.0, 50.0, ACCEPTED),
        (1.0, 51.0, DENIED),
        (1.0, 0.0, DENIED),
        (1.0, f32::NAN, DENIED),
        (1.0, 1e-30, DENIED),
        (2.0, 10.0, ACCEPTED),
        (2.0, -5.0, DENIED),
        (4.0, 10.0, DENIED),
        (1.0, -1.0, ACCEPTED),
    ] {
        let change = long(MavCmd::MAV_CMD_DO_CHANGE_SPEED, kind, mps, 0.0);
        assert_eq!(told(&mut bench, &change).0, result, "{kind} {mps}");
    }
    let autopilot = &bench.vehicle.settings.autopilot;
    assert_eq!((autopilot.speed_mps, autopilot.climb_mps), (50.0, 10.0), "-1 changes nothing");
    let default = long(MavCmd::MAV_CMD_DO_CHANGE_SPEED, 1.0, -2.0, 0.0);
    assert_eq!(told(&mut bench, &default).0, ACCEPTED);
    assert_eq!(bench.vehicle.settings.autopilot.speed_mps, 20.0);
}

mod failsafes {
    use super::*;
    use crate::scenario::Action;

    fn silent(setpoint: Action, station: Action) -> Bench {
        let mut scenario = Scenario::default();
        scenario.failsafe.setpoint_action = setpoint;
        scenario.failsafe.station_action = station;
        scenario.radio.rule = crate::scenario::Rule::Ideal;
        let mut bench = Bench::with(scenario, None);
        bench.hello();
        assert!(pass(&mut bench, 5).is_empty(), "nothing is missed before the first setpoint");
        bench.send(&setpoint_of(1.0));
        bench
    }

    fn setpoint_of(afx: f32) -> dialect::SET_POSITION_TARGET_LOCAL_NED_DATA {
        setpoint(0, afx)
    }

    #[test]
    fn hold_goes_on_for_ever_and_says_so() {
        let mut bench = silent(Action::Hold, Action::Hold);
        assert!(pass(&mut bench, 8).is_empty(), "3 s are 7.5 intervals after the first");
        assert_eq!(pass(&mut bench, 1), ["no setpoint for 3 s: goes on"]);
        assert_eq!(heartbeat(&mut bench), (4, true, ACTIVE));
        assert_eq!(pass(&mut bench, 30), ["no station for 5 s: goes on"]);
        let held = bench.vehicle.sim.telemetry().held;
        assert_eq!(held.map(|held| held.accel), Some([1.0, 0.0]), "the paper's rule");
    }

    #[test]
    fn brake_stops_in_guided_and_the_next_setpoint_is_flown() {
        let mut bench = silent(Action::Brake, Action::Hold);
        let said = pass(&mut bench, 9);
        assert_eq!(said, ["failsafe: no setpoint for 3 s: brakes"]);
        assert_eq!(heartbeat(&mut bench), (4, true, CRITICAL));
        pass(&mut bench, 10);
        assert_eq!(bench.vehicle.sim.world().uav.v, Vector2::zeros());
        bench.send(&setpoint_of(1.0));
        assert_eq!(pass(&mut bench, 1), ["setpoint heard again", "station heard again"]);
        assert!(bench.vehicle.sim.world().uav.v.norm() > 0.0);
        assert_eq!(heartbeat(&mut bench), (4, true, ACTIVE));
    }

    #[test]
    fn return_goes_home_until_somebody_asks_for_another_mode() {
        let mut bench = silent(Action::Return, Action::Hold);
        let said = pass(&mut bench, 9);
        assert_eq!(said, ["failsafe: no setpoint for 3 s: returns", "mode RTL"]);
        assert_eq!(heartbeat(&mut bench), (6, true, CRITICAL));
        bench.send(&setpoint_of(1.0));
        pass(&mut bench, 1);
        assert_eq!(heartbeat(&mut bench).0, 6, "a setpoint is no change of mode");
        told(&mut bench, &mode(4.0));
        assert_eq!(heartbeat(&mut bench), (4, true, ACTIVE));
    }

    #[test]
    fn a_lost_station_is_met_in_every_mode() {
        for (action, number) in [(Action::Brake, 17), (Action::Return, 6)] {
            let mut bench = silent(Action::Hold, action);
            told(&mut bench, &mode(5.0));
            let said = pass(&mut bench, 14);
            assert!(said[0].starts_with("failsafe: no station for 5 s"), "{said:?}");
            assert_eq!(heartbeat(&mut bench), (number, true, CRITICAL));
            let other = dialect::HEARTBEAT_DATA {
                mavtype: dialect::MavType::MAV_TYPE_QUADROTOR,
                ..Default::default()
            };
            bench.send(&other);
            assert!(pass(&mut bench, 1).is_empty(), "another vehicle is no station");
            bench.hello();
            assert_eq!(pass(&mut bench, 1), ["station heard again"]);
            assert_eq!(heartbeat(&mut bench), (number, true, ACTIVE), "the mode stays");
        }
    }

    #[test]
    fn an_outage_is_silence_whatever_is_sent() {
        let mut scenario = Scenario::default();
        scenario.failsafe.setpoint_action = Action::Brake;
        let mut bench = Bench::with(scenario, None);
        bench.hello();
        bench.send(&setpoint_of(1.0));
        pass(&mut bench, 1);
        let mut deaf = bench.vehicle.sim.scenario().clone();
        deaf.radio.b_dt = 1e-3;
        bench.vehicle.sim = Sim::new(deaf, 1);
        let mut said = Vec::new();
        for _ in 0..8 {
            bench.send(&setpoint_of(1.0));
            said.extend(pass(&mut bench, 1));
        }
        assert!(said.contains(&"failsafe: no setpoint for 3 s: brakes".to_owned()), "{said:?}");
    }

    #[test]
    fn the_walls_seconds_count_for_stations_in_real_time() {
        let mut bench = silent(Action::Hold, Action::Brake);
        // Ten times real time: 5 s on the wall are 125 intervals.
        bench.vehicle.start_streams(Duration::from_millis(40), bench.now);
        assert!(!pass(&mut bench, 120).iter().any(|text| text.contains("station")));
        assert!(pass(&mut bench, 10).iter().any(|text| text.contains("failsafe: no station for 5 s")));
    }
}

/// A vehicle beside the obstacle that flies east by itself, through it; gives what is said with its severity.
fn through_the_obstacle(action: CollisionAction, intervals: usize) -> (Bench, Vec<(String, MavSeverity)>) {
    let mut scenario = Scenario { start: Vector2::new(0.3, 0.45), ..Scenario::default() };
    scenario.safety.collision_action = action;
    let mut bench = Bench::with(scenario, None);
    bench.hello();
    bench.send(&setpoint(0, 10.0));
    let east = dialect::SET_POSITION_TARGET_LOCAL_NED_DATA { afy: 10.0, ..setpoint(0, 0.0) };
    bench.send(&dialect::SET_POSITION_TARGET_LOCAL_NED_DATA { time_boot_ms: 400, ..east });
    let mut said = Vec::new();
    for _ in 0..intervals {
        bench.vehicle.advance(bench.now);
        said.extend(bench.received().iter().filter_map(|packet| match packet.message() {
            Some(MavMessage::STATUSTEXT(text)) => {
                Some((text.text.to_str().unwrap().to_owned(), text.severity))
            }
            _ => None,
        }));
    }
    (bench, said)
}

#[test]
fn a_collision_and_the_edge_are_said_once_a_contact_however_fast_time_passes() {
    let (bench, said) = through_the_obstacle(CollisionAction::Continue, 60);
    let severities = |word: &str| {
        said.iter().filter(|(text, _)| text.starts_with(word)).map(|(_, s)| *s).collect::<Vec<_>>()
    };
    assert_eq!(severities("collision with obstacle 1 before tick "), [MavSeverity::MAV_SEVERITY_CRITICAL]);
    assert_eq!(severities("edge of the field before tick "), [MavSeverity::MAV_SEVERITY_WARNING]);
    let tally = bench.vehicle.tally();
    assert_eq!((tally.collisions, tally.edge_contacts), (1, 1));
    assert!(tally.to_string().ends_with("; 1 collisions, 1 edge contacts"), "{tally}");
    assert!(bench.vehicle.conduct.armed && !bench.vehicle.over());
}

#[test]
fn a_vehicle_that_falls_at_a_collision_disarms_and_its_flight_is_over_on_the_ground() {
    let (mut bench, said) = through_the_obstacle(CollisionAction::Fall, 40);
    let texts: Vec<&str> =
        said.iter().map(|(text, _)| text.as_str()).filter(|text| !text.starts_with("no s")).collect();
    let at = texts.iter().position(|text| text.starts_with("collision")).unwrap();
    let [fall, crash, over, ..] = texts[at + 1..] else { panic!("{texts:?}") };
    assert_eq!(fall, "motors off in the air: falling");
    assert!(crash.starts_with("crashed at ") && over.starts_with("flight over after "), "{texts:?}");
    assert!(over.ends_with(" ticks: collision"), "{over}");
    assert!(bench.vehicle.over() && bench.vehicle.height.on_ground());
    assert_eq!(heartbeat(&mut bench), (4, false, dialect::MavState::MAV_STATE_EMERGENCY));
}
