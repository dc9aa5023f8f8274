//! The mission protocol, and missions in flight.

use nalgebra::Vector2;

use super::*;
use crate::link::dialect::{MavFrame, MavMissionResult as Result_, MavMissionType, MissionState};
use crate::vehicle::conduct::Mode;

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
    assert_eq!(result(&bench.send(&items[0])), None, "a copy that was late is no error");
    assert_eq!(result(&bench.send(&waypoint(2, [0.2, 0.8]))), Some((Result_::MAV_MISSION_ERROR, MISSION)));
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
    assert_eq!(wanted(&bench.send(&float(0, 0.0, 0.0))), Some((1, false)), "it has answered the old one");
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
        (at(MAV_CMD_NAV_FOLLOW, [0.0; 2]), Result_::MAV_MISSION_UNSUPPORTED),
        (
            dialect::MISSION_ITEM_INT_DATA { frame: MavFrame::MAV_FRAME_BODY_FRD, ..good[1].clone() },
            Result_::MAV_MISSION_UNSUPPORTED_FRAME,
        ),
        (at(MAV_CMD_NAV_WAYPOINT, [-1.0, 0.0]), Result_::MAV_MISSION_INVALID_PARAM1),
        (at(MAV_CMD_NAV_WAYPOINT, [0.0, f32::INFINITY]), Result_::MAV_MISSION_INVALID_PARAM2),
        (at(MAV_CMD_DO_CHANGE_SPEED, [1.0, 51.0]), Result_::MAV_MISSION_INVALID_PARAM2),
        (at(MAV_CMD_DO_CHANGE_SPEED, [1.0, f32::NAN]), Result_::MAV_MISSION_INVALID_PARAM2),
        (
            dialect::MISSION_ITEM_INT_DATA { x: 900_000_001, ..good[1].clone() },
            Result_::MAV_MISSION_INVALID_PARAM5_X,
        ),
        (
            dialect::MISSION_ITEM_INT_DATA { y: -1_800_000_001, ..good[1].clone() },
            Result_::MAV_MISSION_INVALID_PARAM6_Y,
        ),
        (
            dialect::MISSION_ITEM_INT_DATA { z: f32::INFINITY, ..good[1].clone() },
            Result_::MAV_MISSION_INVALID_PARAM7,
        ),
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
}

#[test]
fn an_item_out_of_turn_is_asked_for_again_and_a_repeat_does_no_harm() {
    let mut bench = greeted();
    let items = [waypoint(0, [0.5, 0.5]), waypoint(1, [0.2, 0.8]), waypoint(2, [0.3, 0.8])];
    bench.send(&count(3, MISSION));
    assert_eq!(wanted(&bench.send(&items[2])), Some((0, true)));
    assert_eq!(wanted(&bench.send(&items[0])), Some((1, true)));
    assert!(bench.send(&items[0]).is_empty(), "it is in: asked again, each copy would bring two more");
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

/// One doubled datagram doubled all requests that followed it, and every doubled one doubled them again.
#[test]
fn doubled_items_do_not_multiply_requests() {
    let mut bench = greeted();
    let items: Vec<_> = (0..40).map(|seq| waypoint(seq, [0.2, 0.6])).collect();
    let (mut asked, mut acks) = (0, Vec::new());
    let mut replies = bench.send(&count(40, MISSION));
    while !replies.is_empty() {
        let mut next = Vec::new();
        for reply in &replies {
            acks.extend(result(std::slice::from_ref(reply)));
            let Some((seq, _)) = wanted(std::slice::from_ref(reply)) else { continue };
            asked += 1;
            next.extend(bench.send(&items[usize::from(seq)]));
            next.extend(bench.send(&items[usize::from(seq)]));
        }
        replies = next;
    }
    assert_eq!(asked, 40);
    // The copy of the last item is answered as the item is.
    assert_eq!(acks, [(Result_::MAV_MISSION_ACCEPTED, MISSION); 2]);
}

/// DroneKit knows MISSION_REQUEST alone: each item waited a second for it.
#[test]
fn a_station_that_answers_the_old_request_waits_once_and_never_again() {
    let mut bench = greeted();
    let items: Vec<_> = (0..10).map(|seq| waypoint(seq, [0.2, 0.6])).collect();
    let (begun, mut reply) = (bench.now, bench.send(&count(10, MISSION)));
    while result(&reply).is_none() {
        reply = match wanted(&reply) {
            Some((seq, false)) => bench.send(&items[usize::from(seq)]),
            _ => {
                bench.now = bench.vehicle.next_stream().unwrap();
                bench.vehicle.stream(bench.now);
                bench.received()
            }
        };
    }
    assert_eq!(bench.now - begun, Duration::from_secs(1));
    assert_eq!(wanted(&bench.send(&count(2, MISSION))), Some((0, false)), "nor in the next upload");
}

/// MAVSDK refuses MISSION_REQUEST with UNSUPPORTED, and waits for MISSION_REQUEST_INT.
#[test]
fn a_station_that_refuses_the_old_request_is_asked_by_the_new_one() {
    let mut bench = greeted();
    bench.send(&count(2, MISSION));
    bench.now = bench.vehicle.next_stream().unwrap();
    bench.vehicle.stream(bench.now);
    assert_eq!(wanted(&bench.received()), Some((0, false)));
    let refusal = dialect::MISSION_ACK_DATA {
        target_system: 7,
        target_component: 1,
        mavtype: Result_::MAV_MISSION_UNSUPPORTED,
        ..Default::default()
    };
    assert_eq!(wanted(&bench.send(&refusal)), Some((0, true)));
    assert_eq!(wanted(&bench.send(&waypoint(0, [0.5, 0.5]))), Some((1, true)));
    bench.send(&refusal);
    assert!(bench.vehicle.upload.is_none(), "a refusal of the new one is the end");
}

/// MISSION_CURRENT came 1,622 times a second.
#[test]
fn a_jump_loop_in_place_does_not_flood() {
    let mut bench = greeted();
    let items = [
        waypoint(0, [0.5, 0.5]),
        waypoint(1, [0.1, 0.5]),
        waypoint(2, [0.1, 0.5]),
        item(3, MavCmd::MAV_CMD_DO_JUMP, [0.0; 2], [1.0, -1.0]),
    ]
    .map(|item| dialect::MISSION_ITEM_INT_DATA { z: 100.0, ..item });
    upload(&mut bench, &items);
    start(&mut bench);
    let (reached, currents) = fly(&mut bench, 50);
    assert!((40..=50).contains(&reached.len()), "{} reached", reached.len());
    assert!(currents.len() <= 110, "{} told", currents.len());
}

/// Of 26 real mission files none was taken: all of them lie elsewhere.
#[test]
fn a_mission_outside_the_field_is_kept_and_flown_to_the_edge() {
    let mut bench = greeted();
    let items = [waypoint(0, [0.5, 0.5]), waypoint(1, [-40.0, 0.6]), waypoint(2, [0.3, 0.7])];
    bench.send(&count(3, MISSION));
    bench.send(&items[0]);
    bench.send(&items[1]);
    let said = texts(&bench.send(&items[2]));
    assert_eq!(said, ["mission: 1 items outside, flown to the edge", "mission of 3 items"]);
    assert_eq!(download(&mut bench)[1].y, items[1].y, "it is told as it came");
    start(&mut bench);
    let (reached, _) = fly(&mut bench, 100);
    assert_eq!(reached, [1, 2]);
}

#[test]
fn a_mission_without_walls_is_flown_wherever_it_leads() {
    let mut scenario = Scenario { obstacles: Vec::new(), ..Scenario::default() };
    scenario.dynamics.walls = false;
    let mut bench = Bench::with(scenario, None);
    bench.hello();
    let items = [waypoint(0, [0.5, 0.5]), waypoint(1, [-2.0, 0.6])];
    assert_eq!(upload(&mut bench, &items), Result_::MAV_MISSION_ACCEPTED);
    start(&mut bench);
    fly(&mut bench, 200);
    let uav = bench.vehicle.sim.world().uav;
    assert!((uav.r - Vector2::new(-2.0, 0.6)).norm() < 1e-3, "{uav:?}");
    assert_eq!(bench.vehicle.tally().edge_contacts, 0, "there is no edge");
}

#[test]
fn the_heights_of_a_mission_are_flown() {
    let mut bench = greeted();
    let [home, mut high, mut sea, mut same] =
        [waypoint(0, [0.5, 0.5]), waypoint(1, [0.2, 0.6]), waypoint(2, [0.2, 0.7]), waypoint(3, [0.2, 0.8])];
    high.z = 140.0;
    (sea.frame, sea.z) = (MavFrame::MAV_FRAME_GLOBAL_INT, 488.0 + 60.0);
    same.z = 0.0;
    upload(&mut bench, &[home, high, sea, same]);
    start(&mut bench);
    let mut heights = Vec::new();
    for _ in 0..120 {
        let (reached, _) = fly(&mut bench, 1);
        heights.extend(reached.iter().map(|seq| (*seq, bench.vehicle.height.altitude_m)));
    }
    // The radius of acceptance, and the interval in which the next item began.
    let near = |k: usize, height: f64| (heights[k].1 - height).abs() <= 5.0 + 2.0;
    assert!(heights.len() == 3 && near(0, 140.0) && near(1, 60.0) && near(2, 60.0), "{heights:?}");
    assert_eq!(bench.vehicle.height.altitude_m, 60.0, "the height is reached to the end");
}

/// Camera and servo commands stand in nearly every real mission file.
#[test]
fn commands_for_what_the_vehicle_lacks_are_kept_told_and_passed() {
    let mut bench = greeted();
    let items = [
        waypoint(0, [0.5, 0.5]),
        item(1, MavCmd::MAV_CMD_DO_SET_CAM_TRIGG_DIST, [0.0; 2], [25.0, 0.0]),
        item(2, MavCmd::MAV_CMD_NAV_SPLINE_WAYPOINT, [0.2, 0.6], [0.0; 2]),
        item(3, MavCmd::MAV_CMD_DO_SET_ROI_LOCATION, [0.9, 0.9], [0.0; 2]),
        item(4, MavCmd::MAV_CMD_DO_CHANGE_SPEED, [0.0; 2], [1.0, -1.0]),
        item(5, MavCmd::MAV_CMD_NAV_LOITER_TURNS, [0.2, 0.7], [3.0, 0.0]),
        item(6, MavCmd::MAV_CMD_DO_LAND_START, [0.0; 2], [0.0; 2]),
    ];
    assert_eq!(upload(&mut bench, &items), Result_::MAV_MISSION_ACCEPTED);
    let commands: Vec<_> = download(&mut bench)[1..].iter().map(|item| item.command).collect();
    assert_eq!(commands, items[1..].iter().map(|item| item.command).collect::<Vec<_>>());
    start(&mut bench);
    assert_eq!(fly(&mut bench, 100).0, [2, 5]);
    assert_eq!(bench.vehicle.plan.status(true).mission_state, MissionState::MISSION_STATE_COMPLETE);
}

/// MISSION_SET_CURRENT 0 was told as 1.
#[test]
fn home_can_be_made_current_and_auto_goes_on_to_the_first() {
    let mut bench = greeted();
    upload(&mut bench, &[waypoint(0, [0.5, 0.5]), waypoint(1, [0.2, 0.6])]);
    let reply =
        bench.send(&dialect::MISSION_SET_CURRENT_DATA { seq: 0, target_system: 7, target_component: 1 });
    let Some(MavMessage::MISSION_CURRENT(current)) = reply[0].message() else { panic!("a current") };
    assert_eq!(current.seq, 0);
    start(&mut bench);
    assert_eq!(fly(&mut bench, 60).0, [1]);
}

fn upload_list(bench: &mut Bench, items: &[dialect::MISSION_ITEM_INT_DATA], list: MavMissionType) -> Result_ {
    let mut reply = bench.send(&count(items.len() as u16, list));
    loop {
        if let Some((result, mission_type)) = result(&reply) {
            assert_eq!(mission_type, list);
            return result;
        }
        let (seq, _) = wanted(&reply).expect("a request or an acknowledgement");
        let item = items[usize::from(seq)].clone();
        reply = bench.send(&dialect::MISSION_ITEM_INT_DATA { mission_type: list, ..item });
    }
}

/// A fence around the field's middle third.
fn fence() -> [dialect::MISSION_ITEM_INT_DATA; 4] {
    let corners = [[0.05, 0.3], [0.05, 0.7], [0.4, 0.7], [0.4, 0.3]];
    let corner = |(seq, place): (usize, [f64; 2])| {
        let command = MavCmd::MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION;
        item(seq as u16, command, place, [4.0, 0.0])
    };
    let mut corners = corners.into_iter().enumerate().map(corner);
    std::array::from_fn(|_| corners.next().unwrap())
}

#[test]
fn a_fence_goes_up_and_down_and_a_broken_one_leaves_the_old() {
    let mut bench = greeted();
    assert_eq!(upload_list(&mut bench, &fence(), FENCE), Result_::MAV_MISSION_ACCEPTED);
    assert_eq!(upload_list(&mut bench, &fence()[..3], FENCE), Result_::MAV_MISSION_INVALID_PARAM1);
    assert_eq!(upload_list(&mut bench, &[waypoint(0, [0.1, 0.1])], FENCE), Result_::MAV_MISSION_UNSUPPORTED);
    for (seq, item) in fence().iter().enumerate() {
        let ask = dialect::MISSION_REQUEST_INT_DATA {
            seq: seq as u16,
            target_system: 7,
            target_component: 1,
            mission_type: FENCE,
        };
        let Some(MavMessage::MISSION_ITEM_INT(told)) = bench.send(&ask)[0].message() else { panic!() };
        assert_eq!((told.x, told.y, told.command, told.mission_type), (item.x, item.y, item.command, FENCE));
    }
    assert_eq!(download(&mut bench).len(), 1, "the mission is another list");
    let clear = dialect::MISSION_CLEAR_ALL_DATA { target_system: 7, target_component: 1, mission_type: ALL };
    bench.send(&clear);
    assert!(!bench.vehicle.fence.is_set());
}

#[test]
fn a_fence_is_kept_by_braking_and_by_a_return() {
    for (action, modes) in [(0.0, [Mode::Guided; 2]), (1.0, [Mode::Brake; 2]), (2.0, [Mode::Return; 2])] {
        let mut bench = greeted();
        upload_list(&mut bench, &fence(), FENCE);
        bench.send(&dialect::PARAM_SET_DATA {
            param_value: action,
            target_system: 7,
            target_component: 1,
            param_id: "FENCE_ACTION".into(),
            param_type: dialect::MavParamType::MAV_PARAM_TYPE_INT32,
        });
        bench.send(&setpoint(0, 5.0));
        let mut farthest = 0.0_f64;
        for _ in 0..40 {
            bench.vehicle.advance(bench.now);
            farthest = farthest.max(bench.vehicle.sim.world().uav.r.y);
        }
        assert!(modes.contains(&bench.vehicle.conduct.mode), "{action}");
        let said = texts(&bench.received());
        assert!(said.iter().any(|text| text.starts_with("failsafe: at the fence")), "{said:?}");
        assert_eq!(farthest <= 0.7, action != 0.0, "{action}: {farthest}");
    }
}

#[test]
fn rtl_lands_at_a_rally_point_that_is_nearer_than_home() {
    let mut bench = greeted();
    let rally = item(0, MavCmd::MAV_CMD_NAV_RALLY_POINT, [0.3, 0.7], [0.0; 2]);
    assert_eq!(upload_list(&mut bench, &[rally], RALLY), Result_::MAV_MISSION_ACCEPTED);
    bench.send(&setpoint(0, 5.0));
    bench.send(&dialect::SET_POSITION_TARGET_LOCAL_NED_DATA { afy: 8.0, ..setpoint(0, 8.0) });
    fly(&mut bench, 12);
    bench.send(&ask(MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH, 0.0, TARGET));
    fly(&mut bench, 150);
    let uav = bench.vehicle.sim.world().uav;
    assert!((uav.r - Vector2::new(0.3, 0.7)).norm() * 500.0 < 5.0, "{uav:?}");
    assert!(!bench.vehicle.conduct.armed);
}
