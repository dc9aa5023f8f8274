//! The mission protocol: lists up and down, by both item forms. Knows messages and what makes an item
//! good; how items are flown is in [`plan`], what a fence encloses in [`super::fence`].
//!
//! As with ArduPilot, item 0 of a mission is home: whatever is uploaded there is answered, on
//! download, with the vehicle's own home, and flying begins with item 1. Without a mission the list is
//! home alone. Fences (mission type 1) and rally points (2, NAV_RALLY_POINT 5100) are lists of their own.
//!
//! | asked, of the autopilot | answered to the asker |
//! |---|---|
//! | MISSION_REQUEST_LIST | MISSION_COUNT; another type: ACK UNSUPPORTED |
//! | MISSION_REQUEST_INT, MISSION_REQUEST | MISSION_ITEM_INT, MISSION_ITEM; past the end: ACK INVALID_SEQUENCE |
//! | MISSION_COUNT | MISSION_REQUEST_INT of each item, then ACK ACCEPTED or the first item's fault; 0 clears |
//! | more than 700 items | ACK NO_SPACE |
//! | the same while another station uploads | ACK DENIED |
//! | MISSION_WRITE_PARTIAL_LIST | requests of those items; beyond the list: ACK INVALID_SEQUENCE |
//! | an item that nobody asked for | ACK ERROR |
//! | an item that is in already | nothing, also for a second after the upload: the timer asks again; the last one of a finished upload: ACK ACCEPTED |
//! | an item ahead of its turn | the request for the right one, again |
//! | an item with current 2 or 3, as DroneKit's `simple_goto` sends it | flown in GUIDED: to its point and height, or to its height; ACK ACCEPTED, or its fault |
//! | MISSION_CLEAR_ALL | ACK ACCEPTED; type 255 clears all lists |
//! | MISSION_SET_CURRENT, DO_SET_MISSION_CURRENT | MISSION_CURRENT to all; an item that is not there: ACK INVALID_SEQUENCE, DENIED; 0 is home, from which AUTO goes on to the first |
//! | MISSION_REQUEST_PARTIAL_LIST | ACK UNSUPPORTED |
//! | MISSION_ACK | nothing; one that says other than ACCEPTED ends the asker's upload, but a refusal of MISSION_REQUEST: then it is asked by MISSION_REQUEST_INT |
//!
//! An item that does not come is asked for again each second, in turn as MISSION_REQUEST_INT and as
//! MISSION_REQUEST, which older stations wait for. What a station has answered once is how it is asked from then
//! on. After five times the upload ends with OPERATION_CANCELLED and the old list stays.

use std::time::Duration;

use super::conduct::Mode;
use super::fence::{self, Fence};
use super::guided::GuidedTarget;
use super::item::{Fault, StoredItem, list_id};
use super::plan::StoredMission;
use super::{Vehicle, height};
use crate::link::dialect::{self, MavMissionResult, MavMissionType, MavResult};
use crate::link::messages::View;
use crate::link::messages::mission::{
    self, MissionAck, MissionCount, MissionItem, MissionPartialList, MissionRequest, MissionSetCurrent, Place,
};
use crate::link::packet::Packet;
use crate::link::{AUTOPILOT, PeerId};

/// The longest mission.
const MAX_ITEMS: u16 = 700;
/// How long an item is waited for.
const PATIENCE: Duration = Duration::from_secs(1);
/// For how long after an upload a copy of one of its items may be on its way.
const LATE: Duration = Duration::from_secs(1);
/// How often it is asked for again.
const MAX_TRIES: u32 = 5;

const MISSION: MavMissionType = MavMissionType::MAV_MISSION_TYPE_MISSION;
const FENCE: MavMissionType = MavMissionType::MAV_MISSION_TYPE_FENCE;
const RALLY: MavMissionType = MavMissionType::MAV_MISSION_TYPE_RALLY;
const NAV_RALLY_POINT: u16 = 5100;
/// `current` of an item that is flown at once in GUIDED, and of one whose height is.
const GUIDED_ITEM: u8 = 2;
const GUIDED_HEIGHT: u8 = 3;
const ACCEPTED: MavMissionResult = MavMissionResult::MAV_MISSION_ACCEPTED;

/// A list on its way up.
#[derive(Debug, Clone)]
pub(super) struct MissionUpload {
    list: MavMissionType,
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
    /// Whether it was last asked for by MISSION_REQUEST_INT.
    by_int: bool,
}

/// Whose upload was finished last: its list, and its last item.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FinishedUpload {
    list: MavMissionType,
    from: PeerId,
    asker: (u8, u8),
    last: u16,
    at: Duration,
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
        1 => Some(FENCE),
        2 => Some(RALLY),
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
        let Some(list) = mission_type(list) else { return self.other_list(packet, list, asker, from) };
        if let Some(MissionRequest { seq, .. }) = MissionRequest::of(packet) {
            let as_int = packet.is::<dialect::MISSION_REQUEST_INT_DATA>();
            self.tell_item(list, seq, as_int, asker, from);
        } else if let Some(MissionCount { count, .. }) = MissionCount::of(packet) {
            self.upload(list, 0..count, Vec::new(), asker, from, now);
        } else if let Some((item, place)) = MissionItem::with_place(packet) {
            if list == MISSION && matches!(item.current, GUIDED_ITEM | GUIDED_HEIGHT) {
                let result = self.guided_item(&item, place, now);
                self.mission_ack(result, list, asker, from);
            } else {
                self.item(list, &item, place, asker, from, now);
            }
        } else if let Some(MissionSetCurrent { seq, .. }) = MissionSetCurrent::of(packet) {
            if !self.set_current(seq, now) {
                let result = MavMissionResult::MAV_MISSION_INVALID_SEQUENCE;
                self.mission_ack(result, MISSION, asker, from);
            }
        } else if packet.is::<dialect::MISSION_REQUEST_LIST_DATA>() {
            self.tell_count(list, asker, from);
        } else if packet.is::<dialect::MISSION_CLEAR_ALL_DATA>() {
            self.clear(list);
            self.mission_ack(ACCEPTED, list, asker, from);
        } else if packet.is::<dialect::MISSION_WRITE_PARTIAL_LIST_DATA>()
            && let Some(MissionPartialList { first, last, .. }) = MissionPartialList::of(packet)
        {
            let items = self.items(list).to_vec();
            if first < 0 || last < first || last as usize >= items.len() {
                let result = MavMissionResult::MAV_MISSION_INVALID_SEQUENCE;
                return self.mission_ack(result, list, asker, from);
            }
            self.upload(list, first as u16..last as u16 + 1, items, asker, from, now);
        } else {
            self.mission_ack(MavMissionResult::MAV_MISSION_UNSUPPORTED, list, asker, from);
        }
    }

    /// What is asked of all lists at once, or of one that there is not.
    fn other_list(&mut self, packet: &Packet, list: u8, asker: (u8, u8), from: PeerId) {
        if packet.is::<dialect::MISSION_CLEAR_ALL_DATA>() && list == u8::MAX {
            [MISSION, FENCE, RALLY].into_iter().for_each(|list| self.clear(list));
            return self.mission_ack(ACCEPTED, MavMissionType::MAV_MISSION_TYPE_ALL, asker, from);
        }
        self.mission_ack(MavMissionResult::MAV_MISSION_UNSUPPORTED, MISSION, asker, from);
    }

    /// The items of a list.
    fn items(&self, list: MavMissionType) -> &[StoredItem] {
        match list {
            FENCE => self.fence.items(),
            RALLY => &self.rally,
            _ => self.plan.items(),
        }
    }

    fn opaque_id(&self, list: MavMissionType) -> u32 {
        if list == MISSION { self.plan.id() } else { list_id(self.items(list)) }
    }

    fn tell_count(&mut self, list: MavMissionType, asker: (u8, u8), to: PeerId) {
        let (target_system, target_component) = asker;
        // Home is there before any mission is. DroneKit waits for it.
        let least = usize::from(list == MISSION);
        let count = dialect::MISSION_COUNT_DATA {
            count: self.items(list).len().max(least) as u16,
            target_system,
            target_component,
            mission_type: list,
            opaque_id: self.opaque_id(list),
        };
        self.reply(to, &count);
    }

    fn tell_item(&mut self, list: MavMissionType, seq: u16, as_int: bool, asker: (u8, u8), to: PeerId) {
        let home =
            (seq == 0 && list == MISSION).then(|| StoredItem::home(self.launch(), self.site.altitude_m));
        let Some(item) = home.or_else(|| self.items(list).get(usize::from(seq)).copied()) else {
            return self.mission_ack(MavMissionResult::MAV_MISSION_INVALID_SEQUENCE, list, asker, to);
        };
        let current = u8::from(list == MISSION && seq == self.plan.current());
        let told = MissionItem { current, ..item.told(seq, as_int, asker, list) };
        if as_int {
            self.reply_view(to, &told);
        } else {
            self.reply_twin::<dialect::MISSION_ITEM_DATA, _>(to, &told);
        }
    }

    /// MISSION_COUNT or MISSION_WRITE_PARTIAL_LIST: these items will come.
    fn upload(
        &mut self,
        list: MavMissionType,
        range: std::ops::Range<u16>,
        items: Vec<StoredItem>,
        asker: (u8, u8),
        from: PeerId,
        now: Duration,
    ) {
        if self.upload.as_ref().is_some_and(|upload| (upload.from, upload.asker) != (from, asker)) {
            return self.mission_ack(MavMissionResult::MAV_MISSION_DENIED, list, asker, from);
        }
        self.uploaded = None;
        if range.end > MAX_ITEMS {
            return self.mission_ack(MavMissionResult::MAV_MISSION_NO_SPACE, list, asker, from);
        }
        if range.is_empty() {
            self.clear(list);
            return self.mission_ack(ACCEPTED, list, asker, from);
        }
        let (next, end, due) = (range.start, range.end, now + PATIENCE);
        self.upload =
            Some(MissionUpload { list, from, asker, items, next, end, tries: 0, due, by_int: true });
        self.request_item();
    }

    /// Asks for the next item: as the station has answered before, or in turn by either message.
    fn request_item(&mut self) {
        let Some(upload) = self.upload.as_mut() else { return };
        let known = self.peers.get(&upload.from).and_then(|peer| peer.asked_by_int);
        upload.by_int = known.filter(|_| upload.tries < 2).unwrap_or(upload.tries % 2 == 0);
        let (by_int, from) = (upload.by_int, upload.from);
        let request =
            MissionRequest { seq: upload.next, target: upload.asker.into(), mission_type: upload.list as u8 };
        if by_int {
            self.reply_view(from, &request);
        } else {
            self.reply_twin::<dialect::MISSION_REQUEST_DATA, _>(from, &request);
        }
    }

    /// MISSION_ITEM_INT or MISSION_ITEM.
    fn item(
        &mut self,
        list: MavMissionType,
        sent: &MissionItem,
        place: Place,
        asker: (u8, u8),
        from: PeerId,
        now: Duration,
    ) {
        let expected = self
            .upload
            .as_ref()
            .filter(|upload| (upload.from, upload.asker, upload.list) == (from, asker, list));
        let Some(&MissionUpload { next: expected, by_int, .. }) = expected else {
            return self.late_item(list, sent.seq, asker, from, now);
        };
        let (seq, item) = (sent.seq, StoredItem::of(sent, place));
        if seq < expected {
            // A second copy. Asked for again, each copy would bring two more.
            return;
        }
        if seq > expected {
            return self.request_item();
        }
        if let Some(peer) = self.peers.get_mut(&from) {
            peer.asked_by_int = Some(by_int);
        }
        let fault = self.item_fault(list, seq, &item).err();
        let Some(upload) = self.upload.as_mut() else { return };
        if let Some(fault) = fault {
            return self.refuse_upload(&format!("item {seq}"), fault, now);
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
        if let Err(fault) = self.install(list, items, now) {
            return self.refuse_upload("as a whole", fault, now);
        }
        self.upload = None;
        self.uploaded = Some(FinishedUpload { list, from, asker, last: seq, at: now });
        self.mission_ack(ACCEPTED, list, asker, from);
    }

    /// An item that no upload waits for.
    fn late_item(&mut self, list: MavMissionType, seq: u16, asker: (u8, u8), from: PeerId, now: Duration) {
        let theirs = self.uploaded.filter(|done| (done.list, done.from, done.asker) == (list, from, asker));
        match theirs {
            // The station sends its last item again where our acknowledgement of all was lost.
            Some(done) if seq == done.last => self.mission_ack(ACCEPTED, list, asker, from),
            Some(done) if seq < done.last && now < done.at + LATE => {}
            _ => self.mission_ack(MavMissionResult::MAV_MISSION_ERROR, list, asker, from),
        }
    }

    /// What keeps an item out of a list.
    fn item_fault(&self, list: MavMissionType, seq: u16, item: &StoredItem) -> Result<(), Fault> {
        match list {
            FENCE => fence::fault(item),
            RALLY if item.command != NAV_RALLY_POINT => {
                Err(Fault::of(MavMissionResult::MAV_MISSION_UNSUPPORTED, "it is no rally point"))
            }
            RALLY if !item.frame_has_places() => {
                Err(Fault::of(MavMissionResult::MAV_MISSION_UNSUPPORTED_FRAME, "its frame has no places"))
            }
            RALLY => item.place_fault(),
            // Home is the vehicle's own.
            _ if seq == 0 => Ok(()),
            _ => self.fault(item),
        }
    }

    /// Ends the upload by a fault.
    fn refuse_upload(&mut self, what: &str, fault: Fault, now: Duration) {
        let Some(MissionUpload { list, from, asker, .. }) = self.upload.take() else { return };
        let Fault { result, why } = fault;
        self.refused("mission", &format!("{} {what} refused: {why}", name(list)), now);
        self.mission_ack(result, list, asker, from);
    }

    /// Takes a list in place of the old one, and says what will not be flown as it stands there.
    fn install(&mut self, list: MavMissionType, items: Vec<StoredItem>, now: Duration) -> Result<(), Fault> {
        let count = items.len();
        match list {
            FENCE => self.fence = Fence::new(items, |item| item.north_east(&self.site))?,
            RALLY => self.rally = items,
            _ => {
                StoredMission::check(&items)?;
                let outside = self.count_outside(&items);
                if outside > 0 {
                    let text = format!("mission: {outside} items outside, flown to the edge");
                    self.refused("mission outside", &text, now);
                }
                let kept = items.iter().skip(1).filter(|item| item.is_kept_only()).count();
                if kept > 0 {
                    let text = format!("mission: {kept} commands kept and not carried out");
                    self.refused("mission kept", &text, now);
                }
                self.plan = StoredMission::new(items);
            }
        }
        self.notice("mission", &format!("{} of {count} items", name(list)), now);
        Ok(())
    }

    fn clear(&mut self, list: MavMissionType) {
        self.uploaded = None;
        if self.upload.as_ref().is_some_and(|upload| upload.list == list) {
            self.upload = None;
        }
        match list {
            FENCE => self.fence = Fence::default(),
            RALLY => self.rally.clear(),
            _ => self.plan = StoredMission::default(),
        }
    }

    /// An item that is flown at once, without a mission: to its point and height, or to its height alone.
    fn guided_item(&mut self, sent: &MissionItem, place: Place, now: Duration) -> MavMissionResult {
        let item = StoredItem::of(sent, place);
        let height_m = item.height_m(&self.site).map(height::nearest);
        let to = item.place(&self.site).map(|place| (place, self.inside(place)));
        let fault = match to {
            _ if self.conduct.mode != Mode::Guided => {
                Some(Fault::of(MavMissionResult::MAV_MISSION_ERROR, "not in GUIDED"))
            }
            _ if !self.takes_setpoints() => {
                Some(Fault::of(MavMissionResult::MAV_MISSION_ERROR, "on the ground"))
            }
            Some((_, None)) if sent.current == GUIDED_ITEM => {
                Some(Fault::of(MavMissionResult::MAV_MISSION_INVALID_PARAM5_X, "outside"))
            }
            _ => self.fault(&item).err(),
        };
        if let Some(Fault { result, why }) = fault {
            self.refused("guided item", &format!("guided item refused: {why}"), now);
            return result;
        }
        let here = self.sim.world().uav.r;
        let place = to.and_then(|(_, place)| place).filter(|_| sent.current == GUIDED_ITEM);
        self.loss_of_link.settle();
        self.follow_target(GuidedTarget::at(place.or(Some(here)), height_m));
        ACCEPTED
    }

    /// The station has given up its upload.
    fn upload_ended(&mut self, result: u8, asker: (u8, u8), from: PeerId) {
        let is_theirs = |upload: &MissionUpload| (upload.from, upload.asker) == (from, asker);
        if result == ACCEPTED as u8 || !self.upload.as_ref().is_some_and(is_theirs) {
            return;
        }
        // MAVSDK refuses MISSION_REQUEST, so that it is asked by the other message.
        let by_int = self.upload.as_ref().is_some_and(|upload| upload.by_int);
        if result == MavMissionResult::MAV_MISSION_UNSUPPORTED as u8 && !by_int {
            if let Some(peer) = self.peers.get_mut(&from) {
                peer.asked_by_int = Some(true);
            }
            return self.request_item();
        }
        self.upload = None;
    }

    /// Asks again for an item that did not come, or gives up.
    pub(super) fn upload_timer(&mut self, now: Duration) {
        let Some(upload) = self.upload.as_mut().filter(|upload| upload.due <= now) else { return };
        upload.tries += 1;
        upload.due = now + PATIENCE;
        if upload.tries <= MAX_TRIES {
            return self.request_item();
        }
        let (list, asker, from) = (upload.list, upload.asker, upload.from);
        self.upload = None;
        self.mission_ack(MavMissionResult::MAV_MISSION_OPERATION_CANCELLED, list, asker, from);
    }

    /// Goes on with this item; from 0, home, AUTO goes on to the first. Whether there is such an item.
    fn set_current(&mut self, seq: u16, now: Duration) -> bool {
        let exists = self.plan.go_to(seq);
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
        let opaque_id = match mission_type {
            MavMissionType::MAV_MISSION_TYPE_ALL => 0,
            list => self.opaque_id(list),
        };
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

/// What a list is called.
fn name(list: MavMissionType) -> &'static str {
    match list {
        FENCE => "fence",
        RALLY => "rally points",
        _ => "mission",
    }
}
