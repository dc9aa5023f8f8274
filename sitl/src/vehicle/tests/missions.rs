//! The mission protocol of a vehicle without missions.

use super::*;
use crate::link::dialect::{MavMissionResult, MavMissionType};

fn unsupported(packets: &[Packet]) -> Option<MavMissionType> {
    let [packet] = packets else { return None };
    match packet.message()? {
        MavMessage::MISSION_ACK(ack) => {
            assert_eq!((ack.target_system, ack.target_component), (255, 190));
            (ack.mavtype == MavMissionResult::MAV_MISSION_UNSUPPORTED).then_some(ack.mission_type)
        }
        _ => None,
    }
}

const FENCE: MavMissionType = MavMissionType::MAV_MISSION_TYPE_FENCE;
const MISSION: MavMissionType = MavMissionType::MAV_MISSION_TYPE_MISSION;

#[test]
fn every_list_is_empty() {
    let mut bench = Bench::new();
    bench.hello();
    for mission_type in [MISSION, FENCE, MavMissionType::MAV_MISSION_TYPE_RALLY] {
        let (target_system, target_component) = (7, 1);
        let ask = dialect::MISSION_REQUEST_LIST_DATA { target_system, target_component, mission_type };
        let reply = bench.send(&ask);
        let Some(MavMessage::MISSION_COUNT(count)) = reply[0].message() else { panic!("a count") };
        assert_eq!((count.count, count.mission_type), (0, mission_type));
        assert_eq!((count.target_system, count.target_component), (255, 190));
        assert!(bench.send(&dialect::MISSION_REQUEST_LIST_DATA { target_component: 42, ..ask }).is_empty());
    }
    let all = MavMissionType::MAV_MISSION_TYPE_ALL;
    let ask = dialect::MISSION_REQUEST_LIST_DATA { target_system: 7, target_component: 0, mission_type: all };
    assert!(unsupported(&bench.send(&ask)).is_some());
}

#[test]
fn everything_else_is_unsupported_and_said_so_at_once() {
    let mut bench = Bench::new();
    bench.hello();
    let (target_system, target_component) = (7, 1);
    let count = dialect::MISSION_COUNT_DATA {
        count: 3,
        target_system,
        target_component,
        mission_type: FENCE,
        opaque_id: 0,
    };
    assert_eq!(unsupported(&bench.send(&count)), Some(FENCE));
    let item = dialect::MISSION_ITEM_INT_DATA {
        target_system,
        target_component,
        mission_type: FENCE,
        ..Default::default()
    };
    assert_eq!(unsupported(&bench.send(&item)), Some(FENCE));
    let item = dialect::MISSION_ITEM_DATA { target_system, target_component, ..Default::default() };
    assert_eq!(unsupported(&bench.send(&item)), Some(MISSION));
    let next =
        dialect::MISSION_REQUEST_INT_DATA { seq: 0, target_system, target_component, mission_type: FENCE };
    assert_eq!(unsupported(&bench.send(&next)), Some(FENCE));
    let next = dialect::MISSION_REQUEST_DATA { seq: 0, target_system, target_component, mission_type: FENCE };
    assert_eq!(unsupported(&bench.send(&next)), Some(FENCE));
    let clear = dialect::MISSION_CLEAR_ALL_DATA { target_system, target_component, mission_type: FENCE };
    assert_eq!(unsupported(&bench.send(&clear)), Some(FENCE));
    let part = dialect::MISSION_WRITE_PARTIAL_LIST_DATA {
        start_index: 0,
        end_index: 1,
        target_system,
        target_component,
        mission_type: FENCE,
    };
    assert_eq!(unsupported(&bench.send(&part)), Some(FENCE));
    let current = dialect::MISSION_SET_CURRENT_DATA { seq: 1, target_system, target_component };
    assert_eq!(unsupported(&bench.send(&current)), Some(MISSION));
    let ack = dialect::MISSION_ACK_DATA { target_system, target_component, ..Default::default() };
    assert!(bench.send(&ack).is_empty(), "two that acknowledge each other never end");
}
