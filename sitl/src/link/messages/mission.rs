//! The mission protocol.

use super::{Target, View};
use crate::link::packet::PacketRef;
use crate::link::{MessageData, dialect};

views! {
    /// A request for a list's length, or to clear it.
    MissionList = MISSION_REQUEST_LIST_DATA | MISSION_CLEAR_ALL_DATA {
        /// Whom it is for.
        0 => target: Target,
        /// MAV_MISSION_TYPE.
        2 => mission_type: u8,
    }

    /// How many items there are.
    MissionCount = MISSION_COUNT_DATA {
        /// The number.
        0 => count: u16,
        /// Whom it is for.
        2 => target: Target,
        /// MAV_MISSION_TYPE.
        4 => mission_type: u8,
        /// A number that changes with the list.
        5 => opaque_id: u32,
    }

    /// A request for one item.
    MissionRequest = MISSION_REQUEST_INT_DATA | MISSION_REQUEST_DATA {
        /// Which.
        0 => seq: u16,
        /// Whom it is for.
        2 => target: Target,
        /// MAV_MISSION_TYPE.
        4 => mission_type: u8,
    }

    /// That a part of the list will be sent, or is asked for.
    MissionPartialList = MISSION_WRITE_PARTIAL_LIST_DATA | MISSION_REQUEST_PARTIAL_LIST_DATA {
        /// The first item.
        0 => first: i16,
        /// The last item; of a request, -1 is the list's end.
        2 => last: i16,
        /// Whom it is for.
        4 => target: Target,
        /// MAV_MISSION_TYPE.
        6 => mission_type: u8,
    }

    /// An item. See [`MissionItem::with_place`] for the two forms of its place.
    MissionItem = MISSION_ITEM_INT_DATA | MISSION_ITEM_DATA {
        /// param1 to param4.
        0 => params: [f32; 4],
        /// The bytes of x and y: integers in MISSION_ITEM_INT, 1e-7 degrees or 1e-4 m.
        16 => place: [i32; 2],
        /// Height, m.
        24 => z: f32,
        /// Its number.
        28 => seq: u16,
        /// MAV_CMD.
        30 => command: u16,
        /// Whom it is for.
        32 => target: Target,
        /// MAV_FRAME.
        34 => frame: u8,
        /// 1 if it is the current one.
        35 => current: u8,
        /// 1 if the next one follows by itself.
        36 => autocontinue: u8,
        /// MAV_MISSION_TYPE.
        37 => mission_type: u8,
    }

    /// The end of an exchange.
    MissionAck = MISSION_ACK_DATA {
        /// Whom it is for.
        0 => target: Target,
        /// MAV_MISSION_RESULT.
        2 => result: u8,
        /// MAV_MISSION_TYPE.
        3 => mission_type: u8,
        /// A number that changes with the list.
        4 => opaque_id: u32,
    }

    /// Which item the vehicle goes on with.
    MissionSetCurrent = MISSION_SET_CURRENT_DATA {
        /// Its number.
        0 => seq: u16,
        /// Whom it is for.
        2 => target: Target,
    }
}

/// x and y of an item.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    /// 1e-7 degrees, or 1e-4 m in a local frame.
    Integers([i32; 2]),
    /// Degrees or metres.
    Floats([f32; 2]),
}

impl MissionItem {
    /// The item of a MISSION_ITEM_INT or MISSION_ITEM, and its place in that message's form.
    #[must_use]
    pub fn with_place<'a>(packet: impl Into<PacketRef<'a>>) -> Option<(Self, Place)> {
        let packet = packet.into();
        let item = Self::of(packet)?;
        let place = if packet.id == dialect::MISSION_ITEM_DATA::ID {
            Place::Floats(item.place.map(|bits| f32::from_bits(bits as u32)))
        } else {
            Place::Integers(item.place)
        };
        Some((item, place))
    }
}

/// Whom a message of the mission protocol is for, and its MAV_MISSION_TYPE; `None` for other messages.
#[must_use]
pub fn address_of<'a>(packet: impl Into<PacketRef<'a>>) -> Option<(Target, u8)> {
    let packet = packet.into();
    let from_station = MissionList::of(packet)
        .map(|list| (list.target, list.mission_type))
        .or_else(|| MissionCount::of(packet).map(|count| (count.target, count.mission_type)))
        .or_else(|| MissionRequest::of(packet).map(|request| (request.target, request.mission_type)))
        .or_else(|| MissionPartialList::of(packet).map(|part| (part.target, part.mission_type)));
    from_station
        .or_else(|| MissionItem::of(packet).map(|item| (item.target, item.mission_type)))
        .or_else(|| MissionAck::of(packet).map(|ack| (ack.target, ack.mission_type)))
        .or_else(|| MissionSetCurrent::of(packet).map(|current| (current.target, 0)))
}
