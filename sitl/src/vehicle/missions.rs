//! The mission protocol of a vehicle without missions: it says so at once, so that no ground station
//! waits. The capabilities name no mission either.
//!
//! | asked, of the autopilot | answered to the asker |
//! |---|---|
//! | MISSION_REQUEST_LIST of missions, fences or rally points | MISSION_COUNT 0 |
//! | MISSION_REQUEST_LIST of another type | MISSION_ACK UNSUPPORTED |
//! | an upload (MISSION_COUNT, MISSION_WRITE_PARTIAL_LIST, items), a download's next item, MISSION_CLEAR_ALL, MISSION_SET_CURRENT | MISSION_ACK UNSUPPORTED |
//! | MISSION_ACK | nothing |

use std::net::SocketAddr;

use mavlink::MessageData;

use super::Vehicle;
use crate::link::AUTOPILOT;
use crate::link::decoder::Packet;
use crate::link::dialect::{self, MavMissionResult, MavMissionType};
use crate::link::wire::Target;

/// Where a mission message has its target's system and component, and its mission type if any.
struct Layout {
    target: usize,
    kind: Option<usize>,
}

fn layout(id: u32) -> Option<Layout> {
    let (target, kind) = match id {
        dialect::MISSION_REQUEST_LIST_DATA::ID | dialect::MISSION_CLEAR_ALL_DATA::ID => (0, Some(2)),
        dialect::MISSION_COUNT_DATA::ID
        | dialect::MISSION_REQUEST_DATA::ID
        | dialect::MISSION_REQUEST_INT_DATA::ID => (2, Some(4)),
        dialect::MISSION_REQUEST_PARTIAL_LIST_DATA::ID | dialect::MISSION_WRITE_PARTIAL_LIST_DATA::ID => {
            (4, Some(6))
        }
        dialect::MISSION_ITEM_DATA::ID | dialect::MISSION_ITEM_INT_DATA::ID => (32, Some(37)),
        dialect::MISSION_SET_CURRENT_DATA::ID => (2, None),
        _ => return None,
    };
    Some(Layout { target, kind })
}

/// The lists that a vehicle could have.
fn mission_type(number: u8) -> Option<MavMissionType> {
    match number {
        0 => Some(MavMissionType::MAV_MISSION_TYPE_MISSION),
        1 => Some(MavMissionType::MAV_MISSION_TYPE_FENCE),
        2 => Some(MavMissionType::MAV_MISSION_TYPE_RALLY),
        _ => None,
    }
}

impl Vehicle {
    /// Answers a message of the mission protocol; leaves any other alone.
    pub(super) fn mission(&mut self, packet: &Packet, asker: (u8, u8), from: SocketAddr) {
        let Some(Layout { target, kind }) = layout(packet.id) else { return };
        let fields = packet.fields();
        let target = Target { system: fields.u8(target), component: fields.u8(target + 1) };
        if !target.is(self.system, AUTOPILOT) {
            return;
        }
        let (target_system, target_component) = asker;
        let list = mission_type(kind.map_or(0, |at| fields.u8(at)));
        match list {
            Some(mission_type) if packet.is::<dialect::MISSION_REQUEST_LIST_DATA>() => {
                let count = dialect::MISSION_COUNT_DATA {
                    count: 0,
                    target_system,
                    target_component,
                    mission_type,
                    opaque_id: 0,
                };
                self.reply(from, &count);
            }
            _ => {
                let ack = dialect::MISSION_ACK_DATA {
                    target_system,
                    target_component,
                    mavtype: MavMissionResult::MAV_MISSION_UNSUPPORTED,
                    mission_type: list.unwrap_or_default(),
                    opaque_id: 0,
                };
                self.reply(from, &ack);
            }
        }
    }
}
