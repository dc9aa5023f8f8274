//! Setpoints as tutorials send them.

use nalgebra::Vector2;

use super::*;
use crate::link::dialect::{
    MavFrame, SET_POSITION_TARGET_GLOBAL_INT_DATA, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use crate::scenario::{Action, Rule};

const POSITION: u16 = 0x0DF8;
const VELOCITY: u16 = 0x0DC7;
const POSITION_AND_VELOCITY: u16 = 0x0DC0;
const VELOCITY_AND_ACCELERATION: u16 = 0x0C07;
const YAW: u16 = 0x09FF;

/// A vehicle in the middle of a large free field.
fn bench() -> Bench {
    let scenario = Scenario { start: Vector2::new(0.5, 0.5), obstacles: Vec::new(), ..Scenario::default() };
    let mut bench = Bench::with(scenario, None);
    bench.hello();
    bench
}

fn local(
    mask: u16,
    frame: MavFrame,
    position: [f32; 3],
    velocity: [f32; 3],
) -> SET_POSITION_TARGET_LOCAL_NED_DATA {
    let ([x, y, z], [vx, vy, vz]) = (position, velocity);
    SET_POSITION_TARGET_LOCAL_NED_DATA {
        x,
        y,
        z,
        vx,
        vy,
        vz,
        type_mask: PositionTargetTypemask::from_bits_retain(mask),
        coordinate_frame: frame,
        target_system: 7,
        target_component: 1,
        ..Default::default()
    }
}

fn fly(bench: &mut Bench, intervals: usize) {
    for _ in 0..intervals {
        bench.now += Duration::from_millis(400);
        bench.vehicle.advance(bench.now);
    }
}

/// North, east, up, m.
fn place(bench: &Bench) -> [f64; 3] {
    let [north, east] = bench.vehicle.sim.telemetry().position.map(f64::from);
    [north, east, bench.vehicle.height.altitude_m]
}

/// North, east, up, m/s.
fn speed(bench: &Bench) -> [f64; 3] {
    let [north, east] = bench.vehicle.sim.telemetry().velocity.map(f64::from);
    [north, east, bench.vehicle.height.climb_mps]
}

fn near(found: [f64; 3], expected: [f64; 3]) -> bool {
    found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.1)
}

/// No tutorial's script moved the vehicle: "acceleration only, mask 3135".
#[test]
fn a_position_is_flown_to_in_every_frame() {
    let east = std::f32::consts::FRAC_PI_2;
    for (frame, sent, expected) in [
        (MavFrame::MAV_FRAME_LOCAL_NED, [300.0, 200.0, -80.0], [300.0, 200.0, 80.0]),
        (MavFrame::MAV_FRAME_LOCAL_OFFSET_NED, [30.0, -20.0, 10.0], [280.0, 230.0, 90.0]),
        (MavFrame::MAV_FRAME_BODY_NED, [30.0, 10.0, 10.0], [240.0, 280.0, 90.0]),
        (MavFrame::MAV_FRAME_BODY_OFFSET_NED, [30.0, 10.0, 10.0], [240.0, 280.0, 90.0]),
        (MavFrame::MAV_FRAME_BODY_FRD, [30.0, 10.0, 10.0], [240.0, 280.0, 90.0]),
    ] {
        let mut bench = bench();
        let yaw = SET_POSITION_TARGET_LOCAL_NED_DATA {
            yaw: east,
            ..local(YAW, MavFrame::MAV_FRAME_LOCAL_NED, [0.0; 3], [0.0; 3])
        };
        bench.send(&yaw);
        fly(&mut bench, 5);
        assert!((bench.vehicle.heading.degrees() - 90.0).abs() < 1e-4);
        bench.send(&local(POSITION, frame, sent, [f32::NAN; 3]));
        assert!(bench.vehicle.ready(), "in lockstep it is the clock, as an acceleration is");
        fly(&mut bench, 60);
        assert!(near(place(&bench), expected), "{frame:?}: {:?}", place(&bench));
        assert!(near(speed(&bench), [0.0; 3]), "and stays");
    }
}

/// It was met by silence, though the docs promised words.
#[test]
fn a_position_on_earth_is_flown_to_at_its_height() {
    let [lat_int, lon_int] = geodesy::latitude_longitude([300.0, 200.0]);
    for (frame, alt) in [
        (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 80.0),
        (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT, 80.0),
        (MavFrame::MAV_FRAME_GLOBAL_TERRAIN_ALT_INT, 80.0),
        (MavFrame::MAV_FRAME_GLOBAL_INT, 568.0),
    ] {
        let mut bench = bench();
        bench.send(&SET_POSITION_TARGET_GLOBAL_INT_DATA {
            lat_int,
            lon_int,
            alt,
            type_mask: PositionTargetTypemask::from_bits_retain(POSITION),
            coordinate_frame: frame,
            ..Default::default()
        });
        fly(&mut bench, 60);
        assert!(near(place(&bench), [300.0, 200.0, 80.0]), "{frame:?}: {:?}", place(&bench));
    }
    let mut bench = bench();
    let message = SET_POSITION_TARGET_GLOBAL_INT_DATA {
        type_mask: PositionTargetTypemask::from_bits_retain(POSITION),
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_ENU,
        ..Default::default()
    };
    assert_eq!(texts(&bench.send(&message)), ["setpoint refused: its frame is not flown"]);
}

#[test]
fn a_velocity_is_flown_until_the_next_setpoint() {
    let mut bench = bench();
    bench.send(&local(VELOCITY, MavFrame::MAV_FRAME_LOCAL_NED, [f32::NAN; 3], [4.0, -3.0, -1.0]));
    fly(&mut bench, 5);
    assert!(near(speed(&bench), [4.0, -3.0, 1.0]), "{:?}", speed(&bench));
    fly(&mut bench, 30);
    assert!(near(speed(&bench), [4.0, -3.0, 1.0]), "{:?}", speed(&bench));
    // A height beside a velocity of the plane, as PX4 takes it.
    let level = local(0x0DC0 | 0b10_0011, MavFrame::MAV_FRAME_LOCAL_NED, [0.0, 0.0, -120.0], [0.0, 2.0, 9.0]);
    bench.send(&level);
    fly(&mut bench, 10);
    assert!(near(speed(&bench), [0.0, 2.0, 0.0]), "{:?}", speed(&bench));
    assert!((bench.vehicle.height.altitude_m - 120.0).abs() < 1e-9);
    bench.send(&local(VELOCITY, MavFrame::MAV_FRAME_LOCAL_NED, [0.0; 3], [0.0; 3]));
    fly(&mut bench, 5);
    assert!(near(speed(&bench), [0.0; 3]));
    bench.send(&setpoint(0, 5.0));
    fly(&mut bench, 1);
    assert!(speed(&bench)[0] > 1.0, "an acceleration is held again");
    assert!(bench.vehicle.sim.telemetry().held.is_some());
}

#[test]
fn a_velocity_of_the_body_goes_where_it_looks() {
    let mut bench = bench();
    let yaw = dialect::COMMAND_LONG_DATA { param3: 1.0, ..ask(MavCmd::MAV_CMD_CONDITION_YAW, 90.0, (7, 1)) };
    assert_eq!(acks(&bench.send(&yaw))[0].1.result, MavResult::MAV_RESULT_ACCEPTED);
    fly(&mut bench, 5);
    bench.send(&local(VELOCITY, MavFrame::MAV_FRAME_BODY_NED, [0.0; 3], [5.0, 0.0, 0.0]));
    fly(&mut bench, 5);
    assert!(near(speed(&bench), [0.0, 5.0, 0.0]), "{:?}", speed(&bench));
    let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 33.0, (7, 1)));
    let told = reply.iter().find_map(|packet| match packet.message() {
        Some(MavMessage::GLOBAL_POSITION_INT(position)) => Some(position.hdg),
        _ => None,
    });
    assert_eq!(told, Some(9000));
}

#[test]
fn a_position_with_a_velocity_moves_on_and_a_velocity_with_an_acceleration_grows() {
    let frame = MavFrame::MAV_FRAME_LOCAL_NED;
    let mut moving = bench();
    moving.send(&local(POSITION_AND_VELOCITY, frame, [260.0, 250.0, -100.0], [2.0, 0.0, 0.0]));
    fly(&mut moving, 50);
    assert!(near(speed(&moving), [2.0, 0.0, 0.0]), "{:?}", speed(&moving));
    assert!((place(&moving)[0] - (260.0 + 2.0 * 20.0)).abs() < 2.0, "{:?}", place(&moving));

    let mut faster = bench();
    let message = SET_POSITION_TARGET_LOCAL_NED_DATA {
        afx: 0.5,
        ..local(VELOCITY_AND_ACCELERATION, frame, [0.0; 3], [1.0, 0.0, 0.0])
    };
    faster.send(&message);
    fly(&mut faster, 10);
    assert!((speed(&faster)[0] - 3.0).abs() < 0.3, "{:?}", speed(&faster));

    let mut rising = bench();
    let message = SET_POSITION_TARGET_LOCAL_NED_DATA { afz: -1.0, ..setpoint(0, 0.0) };
    rising.send(&message);
    fly(&mut rising, 5);
    assert!((speed(&rising)[2] - 2.0).abs() < 1e-9, "{:?}", speed(&rising));
}

#[test]
fn a_place_outside_the_field_is_flown_to_its_edge_and_that_is_said() {
    let mut bench = bench();
    let said =
        texts(&bench.send(&local(POSITION, MavFrame::MAV_FRAME_LOCAL_NED, [250.0, 900.0, -100.0], [0.0; 3])));
    assert_eq!(said, ["setpoint outside the field: flown to its edge"]);
    fly(&mut bench, 80);
    assert!(near(place(&bench), [250.0, 500.0, 100.0]), "{:?}", place(&bench));
}

#[test]
fn silence_after_a_place_is_no_loss_and_after_a_velocity_it_is() {
    let mut scenario = bench().vehicle.sim.scenario().clone();
    scenario.failsafe.setpoint_action = Action::Brake;
    for (mask, moves) in [(POSITION, true), (VELOCITY, false)] {
        let mut bench = Bench::with(scenario.clone(), None);
        bench.hello();
        bench.send(&local(mask, MavFrame::MAV_FRAME_LOCAL_NED, [450.0, 250.0, -100.0], [5.0, 0.0, 0.0]));
        fly(&mut bench, 20);
        assert_eq!(speed(&bench)[0] > 1.0, moves, "{:?}", speed(&bench));
    }
}

#[test]
fn an_outage_loses_a_position_as_it_loses_an_acceleration() {
    for (rule, moves) in [(Rule::Drop, false), (Rule::Ideal, true)] {
        let mut scenario = bench().vehicle.sim.scenario().clone();
        (scenario.radio.b_dt, scenario.radio.rule) = (1e-3, rule);
        let mut bench = Bench::with(scenario, None);
        bench.hello();
        bench.send(&local(POSITION, MavFrame::MAV_FRAME_LOCAL_NED, [450.0, 250.0, -100.0], [0.0; 3]));
        fly(&mut bench, 5);
        assert_eq!(speed(&bench)[0] > 1.0, moves, "{rule:?}");
    }
}

/// DroneKit's `simple_goto`: the answer was ERROR, without a word.
#[test]
fn a_mission_item_with_current_2_is_flown_at_once_and_with_3_its_height() {
    let mut bench = bench();
    let [x, y] = geodesy::latitude_longitude([300.0, 200.0]).map(|degrees| (f64::from(degrees) / 1e7) as f32);
    let item = |current, z| dialect::MISSION_ITEM_DATA {
        x,
        y,
        z,
        current,
        command: MavCmd::MAV_CMD_NAV_WAYPOINT,
        target_system: 7,
        target_component: 1,
        frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT,
        ..Default::default()
    };
    let result = |packets: &[Packet]| {
        packets.iter().find_map(|packet| match packet.message() {
            Some(MavMessage::MISSION_ACK(ack)) => Some(ack.mavtype),
            _ => None,
        })
    };
    assert_eq!(result(&bench.send(&item(2, 60.0))), Some(dialect::MavMissionResult::MAV_MISSION_ACCEPTED));
    fly(&mut bench, 60);
    let [north, east, up] = place(&bench);
    assert!((north - 300.0).hypot(east - 200.0) < 1.0 && up == 60.0, "{:?}", place(&bench));
    bench.send(&item(3, 70.0));
    fly(&mut bench, 10);
    assert_eq!(bench.vehicle.height.altitude_m, 70.0);
    bench.send(&ask(MavCmd::MAV_CMD_DO_PAUSE_CONTINUE, 0.0, (7, 1)));
    bench.now += Duration::from_secs(2);
    let reply = bench.send(&item(2, 60.0));
    assert_eq!(result(&reply), Some(dialect::MavMissionResult::MAV_MISSION_ERROR));
    assert_eq!(texts(&reply), ["guided item refused: not in GUIDED"]);
}

/// After 2^32 ms the stamps begin anew, and the flight stood still.
#[test]
fn lockstep_goes_on_after_the_stamps_come_round() {
    let mut scenario = Scenario::default();
    scenario.scale.interval_s = 1000.0 * 2_f64.powi(-5);
    let clock = Clock::new(&scenario);
    let last = 2_u64.pow(32) / 31_250;
    for tick in [last - 1, last, last + 1, 10 * last, 10 * last + 7] {
        let stamp = clock.boot_ms(Tick(tick));
        assert_eq!(clock.tick_near(stamp, Tick(tick)), Some(Tick(tick)), "{tick}");
        assert_eq!(clock.tick_near(stamp, Tick(tick + 3)), Some(Tick(tick)), "{tick}");
    }
    assert_eq!(clock.tick_near(0, Tick(0)), None);
    assert_eq!(clock.tick_near(clock.boot_ms(Tick(0)), Tick(0)), Some(Tick(0)));
}
