//! The mission protocol, and missions in flight.

use nalgebra::Vector2;

use super::*;
use crate::link::dialect::{MavFrame, MavMissionResult as Result_, MavMissionType, MissionState};
use crate::vehicle::modes::Mode;

const FENCE: MavMissionType = MavMissionType::MAV_MISSION_TYPE_FENCE;
const MISSION: MavMissionType = MavMissionType::MAV_MISSION_TYPE_MISSION;
const RALLY: MavMissionType = MavMissionType::MAV_MISSION_TYPE_RALLY;
const ALL: MavMissionType = MavMissionType::MAV_MISSION_TYPE_ALL;
const TARGET: (u8, u8) = (7, 1);

/// The result of the only answer, which is addressed to the asker.
fn result(packets: &[Packet]) -> Option<(Result_, MavMissionType)> {
    packets.iter().find_map(|packet| match packet.message()? {
        MavMessage::MISSION_ACK(ack) => {
            assert_eq!((ack.target_system, ack.target_component), (255, 190));
            Some((ack.mavtype, ack.mission_type))
        }
        _ => None,
    })
}

/// The item that is asked for, and whether by MISSION_REQUEST_INT.
fn wanted(packets: &[Packet]) -> Option<(u16, bool)> {
    packets.iter().find_map(|packet| match packet.message()? {
        MavMessage::MISSION_REQUEST_INT(request) => Some((request.seq, true)),
        MavMessage::MISSION_REQUEST(request) => Some((request.seq, false)),
        _ => None,
    })
}

fn count(count: u16, mission_type: MavMissionType) -> dialect::MISSION_COUNT_DATA {
    let (target_system, target_component) = TARGET;
    dialect::MISSION_COUNT_DATA { count, target_system, target_component, mission_type, opaque_id: 0 }
}

fn list(mission_type: MavMissionType) -> dialect::MISSION_REQUEST_LIST_DATA {
    let (target_system, target_component) = TARGET;
    dialect::MISSION_REQUEST_LIST_DATA { target_system, target_component, mission_type }
}

/// An item at a point of the paper's square.
fn item(seq: u16, command: MavCmd, place: [f64; 2], params: [f32; 2]) -> dialect::MISSION_ITEM_INT_DATA {
    let ne = Scenario::default().scale.ned_from_paper(Vector2::from(place));
    let [x, y] = geodesy::latitude_longitude(ne);
    dialect::MISSION_ITEM_INT_DATA {
        param1: params[0],
        param2: params[1],
        x,
        y,
        z: 50.0,
        seq,
        command,
        target_system: 7,
        target_component: 1,
        frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        autocontinue: 1,
        ..Default::default()
    }
}

fn waypoint(seq: u16, place: [f64; 2]) -> dialect::MISSION_ITEM_INT_DATA {
    item(seq, MavCmd::MAV_CMD_NAV_WAYPOINT, place, [0.0; 2])
}

/// Uploads; gives the result.
fn upload(bench: &mut Bench, items: &[dialect::MISSION_ITEM_INT_DATA]) -> Result_ {
    let mut reply = bench.send(&count(items.len() as u16, MISSION));
    loop {
        if let Some((result, _)) = result(&reply) {
            return result;
        }
        let (seq, _) = wanted(&reply).expect("a request or an acknowledgement");
        reply = bench.send(&items[usize::from(seq)]);
    }
}

fn download(bench: &mut Bench) -> Vec<dialect::MISSION_ITEM_INT_DATA> {
    let reply = bench.send(&list(MISSION));
    let Some(MavMessage::MISSION_COUNT(count)) = reply[0].message() else { panic!("a count") };
    let items = (0..count.count).map(|seq| {
        let ask = dialect::MISSION_REQUEST_INT_DATA {
            seq,
            target_system: 7,
            target_component: 1,
            mission_type: MISSION,
        };
        match bench.send(&ask)[0].message() {
            Some(MavMessage::MISSION_ITEM_INT(item)) => item,
            other => panic!("an item, not {other:?}"),
        }
    });
    items.collect()
}

fn greeted() -> Bench {
    let mut bench = Bench::new();
    bench.hello();
    bench
}

/// Flies so many intervals; the items that were reached and the currents that were told.
fn fly(bench: &mut Bench, intervals: usize) -> (Vec<u16>, Vec<u16>) {
    let (mut reached, mut currents) = (Vec::new(), Vec::new());
    for _ in 0..intervals {
        bench.now += Duration::from_millis(400);
        bench.vehicle.advance(bench.now);
        for packet in bench.received() {
            match packet.message() {
                Some(MavMessage::MISSION_ITEM_REACHED(item)) => reached.push(item.seq),
                Some(MavMessage::MISSION_CURRENT(current)) => currents.push(current.seq),
                _ => {}
            }
        }
    }
    (reached, currents)
}

fn start(bench: &mut Bench) -> Vec<Packet> {
    bench.send(&ask(MavCmd::MAV_CMD_MISSION_START, 0.0, TARGET))
}

/// The acknowledgement of a whole mission was lost: the station sends its last item again.
#[test]
fn a_last_item_that_comes_again_is_accepted_again() {
    let mut bench = greeted();
    let items = [waypoint(0, [0.5, 0.5]), waypoint(1, [0.2, 0.8])];
    let accepted = upload(&mut bench, &items);
    assert_eq!(accepted, Result_::MAV_MISSION_ACCEPTED);
    assert_eq!(result(&bench.send(&items[1])), Some((accepted, MISSION)));
    assert_eq!(result(&bench.send(&items[0])), Some((Result_::MAV_MISSION_ERROR, MISSION)));
}

#[test]
fn at_first_the_mission_is_home_alone_and_the_other_lists_are_empty() {
    let mut bench = greeted();
    for (mission_type, items) in [(MISSION, 1), (FENCE, 0), (RALLY, 0)] {
        let ask = list(mission_type);
        let reply = bench.send(&ask);
        let Some(MavMessage::MISSION_COUNT(count)) = reply[0].message() else { panic!("a count") };
        assert_eq!((count.count, count.mission_type), (items, mission_type));
        assert_eq!((count.target_system, count.target_component), (255, 190));
        assert!(bench.send(&dialect::MISSION_REQUEST_LIST_DATA { target_component: 42, ..ask }).is_empty());
    }
    let unsupported =
        result(&bench.send(&dialect::MISSION_REQUEST_LIST_DATA { mission_type: ALL, ..list(ALL) }));
    assert_eq!(unsupported.map(|found| found.0), Some(Result_::MAV_MISSION_UNSUPPORTED));
}

#[test]
fn a_mission_comes_back_as_it_went_up_with_home_first() {
    let mut bench = greeted();
    let up = [
        waypoint(0, [0.5, 0.5]),
        item(1, MavCmd::MAV_CMD_NAV_TAKEOFF, [0.1, 0.5], [0.0; 2]),
        waypoint(2, [0.2, 0.8]),
        item(3, MavCmd::MAV_CMD_NAV_LOITER_TIME, [0.9, 0.5], [2.5, 0.0]),
        item(4, MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH, [0.0, 0.0], [0.0; 2]),
    ];
    assert_eq!(upload(&mut bench, &up), Result_::MAV_MISSION_ACCEPTED);
    let down = download(&mut bench);
    let back = |item: &dialect::MISSION_ITEM_INT_DATA| dialect::MISSION_ITEM_INT_DATA {
        target_system: 255,
        target_component: 190,
        current: u8::from(item.seq == 1),
        ..item.clone()
    };
    assert_eq!(down[1..], up[1..].iter().map(back).collect::<Vec<_>>());
    let home = geodesy::latitude_longitude([250.0, 50.0]);
    assert_eq!(([down[0].x, down[0].y], down[0].z), (home, 488.0), "the start, whatever was sent");

    let float = dialect::MISSION_REQUEST_DATA {
        seq: 2,
        target_system: 7,
        target_component: 1,
        mission_type: MISSION,
    };
    let Some(MavMessage::MISSION_ITEM(float)) = bench.send(&float)[0].message() else { panic!("an item") };
    assert!((f64::from(float.x) - f64::from(up[2].x) / 1e7).abs() < 4e-6, "a float's width");

    let past = dialect::MISSION_REQUEST_INT_DATA {
        seq: 5,
        target_system: 7,
        target_component: 1,
        mission_type: MISSION,
    };
    assert_eq!(result(&bench.send(&past)), Some((Result_::MAV_MISSION_INVALID_SEQUENCE, MISSION)));
    let clear =
        dialect::MISSION_CLEAR_ALL_DATA { target_system: 7, target_component: 1, mission_type: MISSION };
    assert_eq!(result(&bench.send(&clear)), Some((Result_::MAV_MISSION_ACCEPTED, MISSION)));
    assert_eq!(download(&mut bench).len(), 1, "home stays");
}

#[test]
fn old_stations_send_floats_and_answer_old_requests() {
    let mut bench = greeted();
    let Some((0, true)) = wanted(&bench.send(&count(2, MISSION))) else { panic!("the first, by INT") };
    let float = |seq, x: f32, y: f32| dialect::MISSION_ITEM_DATA {
        x,
        y,
        seq,
        command: MavCmd::MAV_CMD_NAV_WAYPOINT,
        target_system: 7,
        target_component: 1,
        frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT,
        ..Default::default()
    };
    bench.now += Duration::from_millis(1100);
    bench.vehicle.stream(bench.now);
    assert_eq!(wanted(&bench.received()), Some((0, false)), "no answer: by the old message");
    assert_eq!(wanted(&bench.send(&float(0, 0.0, 0.0))), Some((1, true)));
    let [x, y] = geodesy::latitude_longitude([400.0, 100.0]).map(|degrees| (f64::from(degrees) / 1e7) as f32);
    assert_eq!(result(&bench.send(&float(1, x, y))), Some((Result_::MAV_MISSION_ACCEPTED, MISSION)));
    start(&mut bench);
    fly(&mut bench, 60);
    let [north, east] = bench.vehicle.sim.telemetry().position;
    assert!((north - 400.0).hypot(east - 100.0) < 1.0, "{north} {east}");
}

#[test]
fn each_fault_has_its_code_and_leaves_the_old_mission() {
    let mut bench = greeted();
    let good = [waypoint(0, [0.5, 0.5]), waypoint(1, [0.2, 0.8])];
    assert_eq!(upload(&mut bench, &good), Result_::MAV_MISSION_ACCEPTED);
    let at = |command, params| item(1, command, [0.2, 0.8], params);
    use MavCmd::*;
    for (bad, code) in [
        (at(MAV_CMD_NAV_SPLINE_WAYPOINT, [0.0; 2]), Result_::MAV_MISSION_UNSUPPORTED),
        (
            dialect::MISSION_ITEM_INT_DATA { frame: MavFrame::MAV_FRAME_BODY_FRD, ..good[1].clone() },
            Result_::MAV_MISSION_UNSUPPORTED_FRAME,
        ),
        (at(MAV_CMD_NAV_WAYPOINT, [-1.0, 0.0]), Result_::MAV_MISSION_INVALID_PARAM1),
        (at(MAV_CMD_NAV_WAYPOINT, [0.0, f32::INFINITY]), Result_::MAV_MISSION_INVALID_PARAM2),
        (at(MAV_CMD_DO_CHANGE_SPEED, [1.0, 51.0]), Result_::MAV_MISSION_INVALID_PARAM2),
        (at(MAV_CMD_DO_CHANGE_SPEED, [1.0, f32::NAN]), Result_::MAV_MISSION_INVALID_PARAM2),
        (waypoint(1, [0.5, 1.2]), Result_::MAV_MISSION_INVALID_PARAM5_X),
        (waypoint(1, [1.2, 0.5]), Result_::MAV_MISSION_INVALID_PARAM6_Y),
        (waypoint(1, [0.5, 0.45]), Result_::MAV_MISSION_INVALID_PARAM5_X),
        (at(MAV_CMD_DO_JUMP, [9.0, 1.0]), Result_::MAV_MISSION_INVALID_PARAM1),
    ] {
        assert_eq!(upload(&mut bench, &[good[0].clone(), bad.clone()]), code, "{bad:?}");
        assert_eq!(download(&mut bench).len(), 2);
    }
    assert_eq!(result(&bench.send(&count(701, MISSION))), Some((Result_::MAV_MISSION_NO_SPACE, MISSION)));
    assert_eq!(result(&bench.send(&good[1])), Some((Result_::MAV_MISSION_ERROR, MISSION)), "nobody asked");
    let current = dialect::MISSION_SET_CURRENT_DATA { seq: 2, target_system: 7, target_component: 1 };
    assert_eq!(result(&bench.send(&current)), Some((Result_::MAV_MISSION_INVALID_SEQUENCE, MISSION)));
    let jump = ask(MAV_CMD_DO_SET_MISSION_CURRENT, 2.0, TARGET);
    assert_eq!(acks(&bench.send(&jump))[0].1.result, MavResult::MAV_RESULT_DENIED);
    assert_eq!(result(&bench.send(&count(3, FENCE))), Some((Result_::MAV_MISSION_UNSUPPORTED, FENCE)));
}

#[test]
fn an_item_out_of_turn_is_asked_for_again_and_a_repeat_does_no_harm() {
    let mut bench = greeted();
    let items = [waypoint(0, [0.5, 0.5]), waypoint(1, [0.2, 0.8]), waypoint(2, [0.3, 0.8])];
    bench.send(&count(3, MISSION));
    assert_eq!(wanted(&bench.send(&items[2])), Some((0, true)));
    assert_eq!(wanted(&bench.send(&items[0])), Some((1, true)));
    assert_eq!(wanted(&bench.send(&items[0])), Some((1, true)));
    bench.send(&items[1]);
    assert_eq!(result(&bench.send(&items[2])), Some((Result_::MAV_MISSION_ACCEPTED, MISSION)));
    assert_eq!(download(&mut bench).len(), 3);
}

#[test]
fn one_station_uploads_at_a_time_and_a_silent_one_is_given_up() {
    let mut bench = greeted();
    bench.send(&count(2, MISSION));
    let (first, own) = (bench.address, Encoder::new(255, 190));
    bench.address.set_port(5001);
    bench.station = own;
    assert_eq!(result(&bench.send(&count(2, MISSION))), Some((Result_::MAV_MISSION_DENIED, MISSION)));
    bench.address = first;
    bench.received();
    let mut told = None;
    for _ in 0..6 {
        assert_eq!(told, None);
        bench.now = bench.vehicle.next_stream().expect("it waits");
        bench.vehicle.stream(bench.now);
        told = result(&bench.received());
    }
    assert_eq!(told, Some((Result_::MAV_MISSION_OPERATION_CANCELLED, MISSION)));
    assert_eq!(bench.vehicle.next_stream(), None);
}

#[test]
fn a_part_can_be_written_anew() {
    let mut bench = greeted();
    let items = [waypoint(0, [0.5, 0.5]), waypoint(1, [0.2, 0.8]), waypoint(2, [0.3, 0.8])];
    upload(&mut bench, &items);
    let part = |start_index, end_index| dialect::MISSION_WRITE_PARTIAL_LIST_DATA {
        start_index,
        end_index,
        target_system: 7,
        target_component: 1,
        mission_type: MISSION,
    };
    for (first, last) in [(1, 3), (-1, 1), (2, 1)] {
        let refused = result(&bench.send(&part(first, last)));
        assert_eq!(refused, Some((Result_::MAV_MISSION_INVALID_SEQUENCE, MISSION)), "{first} {last}");
    }
    assert_eq!(wanted(&bench.send(&part(1, 1))), Some((1, true)));
    let other = waypoint(1, [0.1, 0.1]);
    assert_eq!(result(&bench.send(&other)), Some((Result_::MAV_MISSION_ACCEPTED, MISSION)));
    let down = download(&mut bench);
    assert_eq!((down[1].x, down[2].x), (other.x, items[2].x));
}

#[test]
fn auto_flies_the_items_in_turn_and_tells_each() {
    let mut bench = greeted();
    let items = [
        waypoint(0, [0.5, 0.5]),
        item(1, MavCmd::MAV_CMD_NAV_TAKEOFF, [0.1, 0.5], [0.0; 2]),
        waypoint(2, [0.2, 0.8]),
        item(3, MavCmd::MAV_CMD_DO_CHANGE_SPEED, [0.0; 2], [1.0, 40.0]),
        item(4, MavCmd::MAV_CMD_NAV_WAYPOINT, [0.9, 0.5], [4.0, 2.0]),
        waypoint(5, [0.8, 0.2]),
    ];
    assert_eq!(upload(&mut bench, &items), Result_::MAV_MISSION_ACCEPTED);
    assert_eq!(acks(&start(&mut bench))[0].1.result, MavResult::MAV_RESULT_ACCEPTED);
    bench.send(&setpoint(0, -5.0));
    let (reached, currents) = fly(&mut bench, 150);
    assert_eq!(reached, [1, 2, 4, 5]);
    assert_eq!(currents, [1, 2, 3, 4, 5, 5]);
    let uav = bench.vehicle.sim.world().uav;
    assert!((uav.r - Vector2::new(0.8, 0.2)).norm() < 1e-4, "{uav:?}");
    assert!(uav.v.norm() < 1e-9, "and waits there");
    assert_eq!(bench.vehicle.settings.autopilot.speed_mps, 40.0);
    assert_eq!(bench.vehicle.plan.status(true).mission_state, MissionState::MISSION_STATE_COMPLETE);
    assert_eq!(bench.vehicle.conduct.mode, Mode::Auto);
    let again = ask(MavCmd::MAV_CMD_DO_SET_MISSION_CURRENT, 2.0, TARGET);
    assert_eq!(acks(&bench.send(&again))[0].1.result, MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(fly(&mut bench, 150).0, [2, 4, 5]);
}

#[test]
fn a_mission_can_pause_jump_return_and_take_off() {
    let mut bench = greeted();
    let items = [
        waypoint(0, [0.5, 0.5]),
        waypoint(1, [0.2, 0.6]),
        waypoint(2, [0.2, 0.5]),
        item(3, MavCmd::MAV_CMD_DO_JUMP, [0.0; 2], [1.0, 2.0]),
        item(4, MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH, [0.0; 2], [0.0; 2]),
    ];
    upload(&mut bench, &items);
    // Down first: AUTO takes off by itself once it is armed.
    bench.send(&ask(MavCmd::MAV_CMD_NAV_LAND, 0.0, TARGET));
    fly(&mut bench, 60);
    assert!(bench.vehicle.height.on_ground());
    start(&mut bench);
    fly(&mut bench, 5);
    assert!(bench.vehicle.height.on_ground(), "not armed");
    bench.send(&ask(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0, TARGET));
    let (mut reached, _) = fly(&mut bench, 70);
    bench.send(&ask(MavCmd::MAV_CMD_DO_PAUSE_CONTINUE, 0.0, TARGET));
    fly(&mut bench, 10);
    assert_eq!(bench.vehicle.plan.status(false).mission_state, MissionState::MISSION_STATE_PAUSED);
    let place = bench.vehicle.sim.world().uav.r;
    reached.extend(fly(&mut bench, 10).0);
    assert_eq!(bench.vehicle.sim.world().uav.r, place);
    bench.send(&ask(MavCmd::MAV_CMD_DO_PAUSE_CONTINUE, 1.0, TARGET));
    reached.extend(fly(&mut bench, 150).0);
    assert_eq!(reached, [1, 2, 1, 2, 1, 2, 4]);
    assert!(!bench.vehicle.conduct.armed && bench.vehicle.height.on_ground());
    assert!((bench.vehicle.sim.world().uav.r - Vector2::new(0.1, 0.5)).norm() * 500.0 < 5.0);
}

#[test]
fn a_circle_of_jumps_is_no_hang_and_a_cleared_mission_no_fall() {
    let mut bench = greeted();
    let items = [
        waypoint(0, [0.5, 0.5]),
        item(1, MavCmd::MAV_CMD_DO_CHANGE_SPEED, [0.0; 2], [1.0, 10.0]),
        item(2, MavCmd::MAV_CMD_DO_JUMP, [0.0; 2], [1.0, -1.0]),
    ];
    upload(&mut bench, &items);
    start(&mut bench);
    fly(&mut bench, 3);
    bench.send(&dialect::MISSION_CLEAR_ALL_DATA {
        target_system: 7,
        target_component: 1,
        mission_type: MavMissionType::MAV_MISSION_TYPE_ALL,
    });
    fly(&mut bench, 3);
    assert_eq!(bench.vehicle.sim.world().uav.v, Vector2::zeros());
    assert_eq!(bench.vehicle.height.altitude_m, 100.0);
}
