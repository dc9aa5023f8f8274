//! The mission protocol: lists up and down, by both item forms. Knows messages and what makes an item
//! good; how items are flown is in [`plan`].
//!
//! As with ArduPilot, item 0 of a mission is home: whatever is uploaded there is answered, on
//! download, with the vehicle's own home, and flying begins with item 1. Without a mission the list is
//! home alone.
//!
//! | asked, of the autopilot | answered to the asker |
//! |---|---|
//! | MISSION_REQUEST_LIST | MISSION_COUNT; fences and rally points: 0; another type: ACK UNSUPPORTED |
//! | MISSION_REQUEST_INT, MISSION_REQUEST | MISSION_ITEM_INT, MISSION_ITEM; past the end: ACK INVALID_SEQUENCE |
//! | MISSION_COUNT | MISSION_REQUEST_INT of each item, then ACK ACCEPTED or the first item's fault; 0 clears |
//! | more than 700 items | ACK NO_SPACE |
//! | the same while another station uploads | ACK DENIED |
//! | MISSION_WRITE_PARTIAL_LIST | requests of those items; beyond the list: ACK INVALID_SEQUENCE |
//! | an item that nobody asked for | ACK ERROR |
//! | an item out of turn | the request for the right one, again |
//! | MISSION_CLEAR_ALL | ACK ACCEPTED, of fences and rally points too: there are none |
//! | MISSION_SET_CURRENT, DO_SET_MISSION_CURRENT | MISSION_CURRENT to all; an item that is not there: ACK INVALID_SEQUENCE, DENIED |
//! | uploads of fences and rally points, MISSION_REQUEST_PARTIAL_LIST | ACK UNSUPPORTED |
//! | MISSION_ACK | nothing; one that says other than ACCEPTED ends the asker's upload |
//!
//! An item that does not come is asked for again each second, in turn as MISSION_REQUEST_INT and as
//! MISSION_REQUEST, which older stations wait for; after five times the upload ends with
//! OPERATION_CANCELLED and the old mission stays.

use std::time::Duration;

use super::Vehicle;
use super::modes::Mode;
use super::plan::{Fault, StoredItem, StoredMission};
use crate::link::dialect::{self, MavMissionResult, MavMissionType, MavResult};
use crate::link::messages::View;
use crate::link::messages::mission::{
    self, MissionAck, MissionCount, MissionItem, MissionPartialList, MissionRequest, MissionSetCurrent, Place,
};
use crate::link::packet::Packet;
use crate::link::{AUTOPILOT, MessageData, PeerId};

/// The longest mission.
const MAX_ITEMS: u16 = 700;
/// How long an item is waited for.
const PATIENCE: Duration = Duration::from_secs(1);
/// How often it is asked for again.
const MAX_TRIES: u32 = 5;

const MISSION: MavMissionType = MavMissionType::MAV_MISSION_TYPE_MISSION;
const ACCEPTED: MavMissionResult = MavMissionResult::MAV_MISSION_ACCEPTED;

/// A mission on its way up.
#[derive(Debug, Clone)]
pub(super) struct MissionUpload {
    from: PeerId,
    asker: (u8, u8),
    /// The list that it will be: the old items where a partial upload leaves them.
    items: Vec<StoredItem>,
    /// The item that is asked for.
    next: u16,
    /// One behind the last.
    end: u16,
    tries: u32,
    due: Duration,
}

impl MissionUpload {
    /// When the item is asked for again.
    pub fn due(&self) -> Duration {
        self.due
    }
}

/// The lists that a vehicle could have.
fn mission_type(number: u8) -> Option<MavMissionType> {
    match number {
        0 => Some(MISSION),
        1 => Some(MavMissionType::MAV_MISSION_TYPE_FENCE),
        2 => Some(MavMissionType::MAV_MISSION_TYPE_RALLY),
        _ => None,
    }
}

impl Vehicle {
    /// Answers a message of the mission protocol; leaves any other alone.
    pub(super) fn mission(&mut self, packet: &Packet, asker: (u8, u8), from: PeerId, now: Duration) {
        let Some((target, list)) = mission::address_of(packet) else { return };
        if !target.is(self.system, AUTOPILOT) {
            return;
        }
        if let Some(ack) = MissionAck::of(packet) {
            return self.upload_ended(ack.result, asker, from);
        }
        if mission_type(list) != Some(MISSION) {
            return self.other_list(packet, list, asker, from);
        }
        if let Some(MissionRequest { seq, .. }) = MissionRequest::of(packet) {
            let as_int = packet.is::<dialect::MISSION_REQUEST_INT_DATA>();
            self.tell_item(seq, as_int, asker, from);
        } else if let Some(MissionCount { count, .. }) = MissionCount::of(packet) {
            self.upload(0, count, Vec::new(), asker, from, now);
        } else if let Some((item, place)) = MissionItem::with_place(packet) {
            self.item(&item, place, asker, from, now);
        } else if let Some(MissionSetCurrent { seq, .. }) = MissionSetCurrent::of(packet) {
            if !self.set_current(seq, now) {
                let result = MavMissionResult::MAV_MISSION_INVALID_SEQUENCE;
                self.mission_ack(result, MISSION, asker, from);
            }
        } else if packet.is::<dialect::MISSION_REQUEST_LIST_DATA>() {
            // Home is there before any mission is. DroneKit waits for it.
            let count = self.plan.items().len().max(1) as u16;
            self.tell_count(count, MISSION, asker, from);
        } else if packet.is::<dialect::MISSION_CLEAR_ALL_DATA>() {
            self.install(Vec::new());
            self.mission_ack(ACCEPTED, MISSION, asker, from);
        } else if packet.is::<dialect::MISSION_WRITE_PARTIAL_LIST_DATA>()
            && let Some(MissionPartialList { first, last, .. }) = MissionPartialList::of(packet)
        {
            let items = self.plan.items().to_vec();
            if first < 0 || last < first || last as usize >= items.len() {
                let result = MavMissionResult::MAV_MISSION_INVALID_SEQUENCE;
                return self.mission_ack(result, MISSION, asker, from);
            }
            self.upload(first as u16, last as u16 + 1, items, asker, from, now);
        } else {
            self.mission_ack(MavMissionResult::MAV_MISSION_UNSUPPORTED, MISSION, asker, from);
        }
    }

    /// Fences and rally points: there are none, and there can be none.
    fn other_list(&mut self, packet: &Packet, list: u8, asker: (u8, u8), from: PeerId) {
        match (mission_type(list), packet.id) {
            (Some(list), dialect::MISSION_REQUEST_LIST_DATA::ID) => self.tell_count(0, list, asker, from),
            (Some(list), dialect::MISSION_CLEAR_ALL_DATA::ID) => {
                self.mission_ack(ACCEPTED, list, asker, from)
            }
            // 255, all lists.
            (None, dialect::MISSION_CLEAR_ALL_DATA::ID) if list == u8::MAX => {
                self.install(Vec::new());
                self.mission_ack(ACCEPTED, MavMissionType::MAV_MISSION_TYPE_ALL, asker, from);
            }
            (list, _) => {
                let list = list.unwrap_or_default();
                self.mission_ack(MavMissionResult::MAV_MISSION_UNSUPPORTED, list, asker, from);
            }
        }
    }

    fn tell_count(&mut self, count: u16, mission_type: MavMissionType, asker: (u8, u8), to: PeerId) {
        let (target_system, target_component) = asker;
        let opaque_id = if mission_type == MISSION { self.plan.id() } else { 0 };
        let count =
            dialect::MISSION_COUNT_DATA { count, target_system, target_component, mission_type, opaque_id };
        self.reply(to, &count);
    }

    fn tell_item(&mut self, seq: u16, as_int: bool, asker: (u8, u8), to: PeerId) {
        let home = (seq == 0).then(|| StoredItem::home(self.launch()));
        let Some(item) = home.or_else(|| self.plan.items().get(usize::from(seq)).copied()) else {
            return self.mission_ack(MavMissionResult::MAV_MISSION_INVALID_SEQUENCE, MISSION, asker, to);
        };
        let current = u8::from(seq == self.plan.current());
        if as_int {
            self.reply(to, &item.as_int(seq, current, asker));
        } else {
            self.reply(to, &item.as_float(seq, current, asker));
        }
    }

    /// MISSION_COUNT or MISSION_WRITE_PARTIAL_LIST: items `first..end` will come.
    fn upload(
        &mut self,
        first: u16,
        end: u16,
        items: Vec<StoredItem>,
        asker: (u8, u8),
        from: PeerId,
        now: Duration,
    ) {
        if self.upload.as_ref().is_some_and(|upload| (upload.from, upload.asker) != (from, asker)) {
            return self.mission_ack(MavMissionResult::MAV_MISSION_DENIED, MISSION, asker, from);
        }
        self.uploaded = None;
        if end > MAX_ITEMS {
            return self.mission_ack(MavMissionResult::MAV_MISSION_NO_SPACE, MISSION, asker, from);
        }
        if first == end {
            self.install(Vec::new());
            return self.mission_ack(ACCEPTED, MISSION, asker, from);
        }
        self.upload =
            Some(MissionUpload { from, asker, items, next: first, end, tries: 0, due: now + PATIENCE });
        self.request_item();
    }

    fn request_item(&mut self) {
        let Some(&MissionUpload { from, asker, next: seq, tries, .. }) = self.upload.as_ref() else { return };
        let ((target_system, target_component), mission_type) = (asker, MISSION);
        if tries % 2 == 0 {
            let request =
                dialect::MISSION_REQUEST_INT_DATA { seq, target_system, target_component, mission_type };
            self.reply(from, &request);
        } else {
            let request =
                dialect::MISSION_REQUEST_DATA { seq, target_system, target_component, mission_type };
            self.reply(from, &request);
        }
    }

    /// MISSION_ITEM_INT or MISSION_ITEM.
    fn item(&mut self, sent: &MissionItem, place: Place, asker: (u8, u8), from: PeerId, now: Duration) {
        let expected = self.upload.as_ref().filter(|upload| (upload.from, upload.asker) == (from, asker));
        let Some(expected) = expected.map(|upload| upload.next) else {
            // The station sends its last item again where our acknowledgement of all was lost.
            if self.uploaded == Some((from, asker, sent.seq)) {
                return self.mission_ack(ACCEPTED, MISSION, asker, from);
            }
            return self.mission_ack(MavMissionResult::MAV_MISSION_ERROR, MISSION, asker, from);
        };
        let (seq, item) = (sent.seq, StoredItem::of(sent, place));
        if seq != expected {
            return self.request_item();
        }
        let fault = if seq == 0 { None } else { self.fault(&item).err() };
        let Some(upload) = self.upload.as_mut() else { return };
        if let Some(Fault { result, why }) = fault {
            self.upload = None;
            self.refused("mission", &format!("mission item {seq} refused: {why}"), now);
            return self.mission_ack(result, MISSION, asker, from);
        }
        match upload.items.get_mut(usize::from(seq)) {
            Some(old) => *old = item,
            None => upload.items.push(item),
        }
        (upload.next, upload.tries, upload.due) = (seq + 1, 0, now + PATIENCE);
        if upload.next < upload.end {
            return self.request_item();
        }
        let items = std::mem::take(&mut upload.items);
        if let Err(Fault { result, why }) = StoredMission::check(&items) {
            self.upload = None;
            self.refused("mission", &format!("mission refused: {why}"), now);
            return self.mission_ack(result, MISSION, asker, from);
        }
        self.notice("mission", &format!("mission of {} items", items.len()), now);
        self.install(items);
        self.uploaded = Some((from, asker, seq));
        self.mission_ack(ACCEPTED, MISSION, asker, from);
    }

    fn install(&mut self, items: Vec<StoredItem>) {
        (self.upload, self.uploaded) = (None, None);
        self.plan = StoredMission::new(items);
    }

    /// The station has given up its upload.
    fn upload_ended(&mut self, result: u8, asker: (u8, u8), from: PeerId) {
        let is_theirs = |upload: &MissionUpload| (upload.from, upload.asker) == (from, asker);
        if result != ACCEPTED as u8 && self.upload.as_ref().is_some_and(is_theirs) {
            self.upload = None;
        }
    }

    /// Asks again for an item that did not come, or gives up.
    pub(super) fn upload_timer(&mut self, now: Duration) {
        let Some(upload) = self.upload.as_mut().filter(|upload| upload.due <= now) else { return };
        upload.tries += 1;
        upload.due = now + PATIENCE;
        if upload.tries <= MAX_TRIES {
            return self.request_item();
        }
        let (asker, from) = (upload.asker, upload.from);
        self.upload = None;
        self.mission_ack(MavMissionResult::MAV_MISSION_OPERATION_CANCELLED, MISSION, asker, from);
    }

    /// Goes on with this item; 0, home, means the first. Whether there is such an item.
    fn set_current(&mut self, seq: u16, now: Duration) -> bool {
        let exists = self.plan.go_to(seq.max(1));
        if exists {
            self.tell_current(now);
        }
        exists
    }

    /// MAV_CMD_DO_SET_MISSION_CURRENT: an item, or -1 for the one that is current; whether jumps count
    /// anew.
    pub(super) fn current_command(&mut self, [seq, reset]: [f32; 2], now: Duration) -> MavResult {
        let seq = if seq == -1.0 { f32::from(self.plan.current()) } else { seq };
        if reset == 1.0 {
            self.plan.reset();
        }
        if seq.fract() == 0.0
            && (0.0..=f32::from(u16::MAX)).contains(&seq)
            && self.set_current(seq as u16, now)
        {
            MavResult::MAV_RESULT_ACCEPTED
        } else {
            MavResult::MAV_RESULT_DENIED
        }
    }

    fn mission_ack(
        &mut self,
        result: MavMissionResult,
        mission_type: MavMissionType,
        asker: (u8, u8),
        to: PeerId,
    ) {
        let (target_system, target_component) = asker;
        let opaque_id = if mission_type == MISSION { self.plan.id() } else { 0 };
        let ack = dialect::MISSION_ACK_DATA {
            target_system,
            target_component,
            mavtype: result,
            mission_type,
            opaque_id,
        };
        self.reply(to, &ack);
    }

    /// MISSION_CURRENT to all.
    pub(super) fn tell_current(&mut self, now: Duration) {
        let current = self.plan.status(self.conduct.mode == Mode::Auto);
        self.tell_all(&current);
        tracing::debug!(seq = current.seq, ?now, "mission");
    }

    /// Whether there is anything to fly.
    pub(super) fn has_mission(&self) -> bool {
        self.plan.items().len() > 1
    }
}
