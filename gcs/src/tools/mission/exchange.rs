//! The mission protocol from the station's side: upload, download, clear, of each of its three lists. No
//! socket, no clock.
//!
//! In an upload the vehicle asks, by MISSION_REQUEST_INT or the older MISSION_REQUEST, and both are
//! answered by MISSION_ITEM_INT, as the standard wants it. In a download we ask.

use std::time::Duration;

use crpl_sitl::link::dialect::{MISSION_CLEAR_ALL_DATA, MISSION_REQUEST_DATA};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::mission::{MissionAck, MissionCount, MissionList, MissionRequest};
use crpl_sitl::link::messages::{Target, View};
use crpl_sitl::link::packet::Packet;

use super::item::Item;
use crate::tools::retry::Question;
use crate::tools::session::Exchange;

const ACCEPTED: u8 = 0;

/// A list of the mission protocol: MAV_MISSION_TYPE.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ListKind {
    /// What is flown.
    Mission = 0,
    /// The geofence.
    Fence = 1,
    /// Rally points.
    Rally = 2,
    /// All three: to clear them.
    All = 255,
}

impl std::fmt::Display for ListKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Mission => "mission",
            Self::Fence => "fence",
            Self::Rally => "rally points",
            Self::All => "mission, fence and rally points",
        })
    }
}

/// Who talks to whom about what.
#[derive(Debug, Clone, Copy)]
struct Talk {
    vehicle: (u8, u8),
    /// Whoever asks, by its newest question.
    us: (u8, u8),
    kind: ListKind,
}

impl Talk {
    fn about(kind: ListKind, vehicle: (u8, u8)) -> Self {
        Self { vehicle, us: (0, 0), kind }
    }

    /// Whether a packet is the vehicle's, for us, and about this list.
    fn is(&self, packet: &Packet, target: Target, kind: u8) -> bool {
        (packet.system, packet.component) == self.vehicle
            && target.is(self.us.0, self.us.1)
            && kind == self.kind as u8
    }

    /// The result in a MISSION_ACK for us.
    fn ack(&self, packet: &Packet) -> Option<u8> {
        let ack = MissionAck::of(packet)?;
        self.is(packet, ack.target, ack.mission_type).then_some(ack.result)
    }

    fn list(&self) -> MissionList {
        MissionList { target: self.vehicle.into(), mission_type: self.kind as u8 }
    }
}

/// MAV_MISSION_RESULT in words.
fn refusal(result: u8) -> String {
    let words = match result {
        1 => "the vehicle says ERROR",
        2 => "the coordinate frame is not supported",
        3 => "the command of an item is not supported",
        4 => "the mission is too long for the vehicle",
        5 => "an item has an invalid value",
        6 => "an item has an invalid param1",
        7 => "an item has an invalid param2",
        8 => "an item has an invalid param3",
        9 => "an item has an invalid param4",
        10 => "an item has an invalid latitude or x",
        11 => "an item has an invalid longitude or y",
        12 => "an item has an invalid height",
        13 => "an item came out of sequence",
        14 => "the vehicle takes no missions now",
        15 => "the vehicle cancelled",
        _ => return format!("the vehicle refuses with result {result}"),
    };
    words.into()
}

/// Gives the vehicle a list.
#[derive(Debug)]
pub struct Upload {
    items: Vec<Item>,
    talk: Talk,
    /// The item that was asked for last.
    asked: Option<u16>,
    question: Question<()>,
}

impl Upload {
    /// These items of a mission, to this system and component.
    #[must_use]
    pub fn new(items: Vec<Item>, target: (u8, u8)) -> Self {
        Self::of(ListKind::Mission, items, target)
    }

    /// The same of another list.
    #[must_use]
    pub fn of(kind: ListKind, items: Vec<Item>, target: (u8, u8)) -> Self {
        Self { items, talk: Talk::about(kind, target), asked: None, question: Question::default() }
    }
}

impl Exchange for Upload {
    type Output = ();

    fn packet(&mut self, packet: &Packet, now: Duration) {
        if let Some(result) = self.talk.ack(packet).filter(|_| self.question.retry.asked()) {
            let at =
                self.asked.map_or(String::new(), |seq| format!(" (item {seq} was the last one asked for)"));
            let done = if result == ACCEPTED { Ok(()) } else { Err(refusal(result) + &at) };
            // ACCEPTED before all items were asked for is another exchange's.
            if result != ACCEPTED || usize::from(self.asked.unwrap_or(0)) + 1 >= self.items.len() {
                self.question.answered(done);
            }
            return;
        }
        let asked = MissionRequest::of(packet)
            .filter(|ask| self.talk.is(packet, ask.target, ask.mission_type))
            .filter(|ask| usize::from(ask.seq) < self.items.len());
        if let Some(ask) = asked {
            self.asked = Some(ask.seq);
            self.question.retry.go_on(now);
        }
    }

    fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        self.talk.us = station.source();
        let silence = || match self.asked {
            None => format!("no answer to a {}", self.talk.kind),
            Some(sequence) => format!("no answer to item {sequence} of {}", self.items.len()),
        };
        if !self.question.fires(now, silence) {
            return;
        }
        match self.asked {
            None => {
                let count = MissionCount {
                    count: self.items.len() as u16,
                    target: self.talk.vehicle.into(),
                    mission_type: self.talk.kind as u8,
                    opaque_id: 0,
                };
                station.push_view(datagram, &count);
            }
            Some(sequence) => {
                let mut item = self.items[usize::from(sequence)].to_message(sequence, self.talk.vehicle);
                item.mission_type = self.talk.kind as u8;
                station.push_view(datagram, &item);
            }
        }
    }

    fn due(&self) -> Option<Duration> {
        Some(self.question.retry.due())
    }

    fn outcome(&mut self) -> Option<Result<(), String>> {
        self.question.take()
    }
}

/// Asks the vehicle for a list.
#[derive(Debug)]
pub struct Download {
    talk: Talk,
    count: Option<u16>,
    items: Vec<Item>,
    question: Question<()>,
    /// Whether the vehicle knows only the older request.
    old: bool,
    thanked: bool,
}

impl Download {
    /// The mission of this system and component.
    #[must_use]
    pub fn new(target: (u8, u8)) -> Self {
        Self::of(ListKind::Mission, target)
    }

    /// Another list of it.
    #[must_use]
    pub fn of(kind: ListKind, target: (u8, u8)) -> Self {
        let question = Question::default();
        Self {
            talk: Talk::about(kind, target),
            count: None,
            items: Vec::new(),
            question,
            old: false,
            thanked: false,
        }
    }

    fn whole(&self) -> bool {
        self.count == Some(self.items.len() as u16)
    }
}

impl Exchange for Download {
    type Output = Vec<Item>;

    fn packet(&mut self, packet: &Packet, now: Duration) {
        if !self.question.retry.asked() || self.whole() {
            return;
        }
        let count =
            MissionCount::of(packet).filter(|count| self.talk.is(packet, count.target, count.mission_type));
        if let Some(MissionCount { count, .. }) = count {
            if self.count.is_none() {
                self.count = Some(count);
                self.question.retry.go_on(now);
            }
        } else if let Some(result) = self.talk.ack(packet) {
            // The standard's way out for a vehicle that knows no integers.
            if self.count.is_some() && !self.old && result != ACCEPTED {
                self.old = true;
                self.question.retry.go_on(now);
            } else {
                self.question.answered(Err(refusal(result)));
            }
        } else if let Some((sent, item)) = Item::of(packet)
            && self.talk.is(packet, sent.target, sent.mission_type)
            && self.count.is_some()
            && usize::from(sent.seq) == self.items.len()
        {
            self.items.push(item);
            self.question.retry.go_on(now);
        }
    }

    fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        self.talk.us = station.source();
        let (target, mission_type) = (self.talk.vehicle.into(), self.talk.kind as u8);
        if self.whole() {
            if !self.thanked {
                self.thanked = true;
                let ack = MissionAck { target, result: ACCEPTED, mission_type, opaque_id: 0 };
                station.push_view(datagram, &ack);
            }
            return;
        }
        let seq = self.items.len() as u16;
        let silence = || match self.count {
            None => format!("no answer to a request for the {}", self.talk.kind),
            Some(of) => format!("item {seq} of {of} does not come"),
        };
        if !self.question.fires(now, silence) {
            return;
        }
        match self.count {
            None => station.push_view(datagram, &self.talk.list()),
            Some(_) => {
                let ask = MissionRequest { seq, target, mission_type };
                if self.old {
                    station.push_payload::<MISSION_REQUEST_DATA>(datagram, &ask.payload());
                } else {
                    station.push_view(datagram, &ask);
                }
            }
        }
    }

    fn due(&self) -> Option<Duration> {
        Some(self.question.retry.due())
    }

    fn outcome(&mut self) -> Option<Result<Vec<Item>, String>> {
        if self.thanked {
            return Some(Ok(std::mem::take(&mut self.items)));
        }
        self.question.take().map(|answer| answer.map(|()| Vec::new()))
    }
}

/// Takes a list of the vehicle away.
#[derive(Debug)]
pub struct Clear {
    talk: Talk,
    question: Question<()>,
}

impl Clear {
    /// The mission of this system and component.
    #[must_use]
    pub fn new(target: (u8, u8)) -> Self {
        Self::of(ListKind::Mission, target)
    }

    /// Another list of it, or all.
    #[must_use]
    pub fn of(kind: ListKind, target: (u8, u8)) -> Self {
        Self { talk: Talk::about(kind, target), question: Question::default() }
    }
}

impl Exchange for Clear {
    type Output = ();

    fn packet(&mut self, packet: &Packet, _now: Duration) {
        if let Some(result) = self.talk.ack(packet).filter(|_| self.question.retry.asked()) {
            self.question.answered(if result == ACCEPTED { Ok(()) } else { Err(refusal(result)) });
        }
    }

    fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        self.talk.us = station.source();
        if self.question.fires(now, || format!("no answer to clearing the {}", self.talk.kind)) {
            station.push_payload::<MISSION_CLEAR_ALL_DATA>(datagram, &self.talk.list().payload());
        }
    }

    fn due(&self) -> Option<Duration> {
        Some(self.question.retry.due())
    }

    fn outcome(&mut self) -> Option<Result<(), String>> {
        self.question.take()
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::decoder::Decoder;
    use crpl_sitl::link::dialect::{
        MISSION_ACK_DATA, MISSION_COUNT_DATA, MISSION_ITEM_INT_DATA, MISSION_REQUEST_INT_DATA,
        MISSION_REQUEST_LIST_DATA,
    };
    use crpl_sitl::link::{MessageData, STATION_COMPONENT, STATION_SYSTEM};
    use proptest::prelude::*;

    use super::*;

    const VEHICLE: (u8, u8) = (7, 1);
    const US: Target = Target { system: STATION_SYSTEM, component: STATION_COMPONENT };

    fn item(k: u16) -> Item {
        Item {
            frame: [0, 3, 2, 1][usize::from(k % 4)],
            command: 16 + k,
            current: k == 0,
            autocontinue: true,
            params: [f32::from(k), -1.5, 0.0, 7.0],
            x: f64::from(k),
            y: -f64::from(k),
            z: 30.5,
        }
    }

    /// A vehicle's side of the protocol.
    struct Peer {
        encoder: Encoder,
        items: Vec<Item>,
        expected: u16,
        /// Speaks the older messages, as ArduPilot asks in an upload.
        old: bool,
        refuses: Option<u8>,
    }

    impl Default for Peer {
        fn default() -> Self {
            let encoder = Encoder::new(VEHICLE.0, VEHICLE.1);
            Self { encoder, items: Vec::new(), expected: 0, old: false, refuses: None }
        }
    }

    impl Peer {
        fn ack(&mut self, result: u8) -> Vec<u8> {
            self.say::<MISSION_ACK_DATA>(&MissionAck { target: US, result, mission_type: 0, opaque_id: 0 })
        }

        fn ask(&mut self) -> Vec<u8> {
            let ask = MissionRequest { seq: self.items.len() as u16, target: US, mission_type: 0 };
            if self.old {
                self.say::<MISSION_REQUEST_DATA>(&ask)
            } else {
                self.say::<MISSION_REQUEST_INT_DATA>(&ask)
            }
        }

        fn say<M: MessageData>(&mut self, view: &impl View) -> Vec<u8> {
            let mut out = Vec::new();
            self.encoder.push_payload::<M>(&mut out, &view.payload());
            out
        }

        fn hear(&mut self, packet: &Packet) -> Vec<u8> {
            if let Some(result) = self.refuses {
                return self.ack(result);
            }
            match packet.id {
                MISSION_REQUEST_LIST_DATA::ID => {
                    let count = self.items.len() as u16;
                    let count = MissionCount { count, target: US, mission_type: 0, opaque_id: 0 };
                    self.say::<MISSION_COUNT_DATA>(&count)
                }
                MISSION_REQUEST_INT_DATA::ID if self.old => self.ack(3),
                MISSION_REQUEST_DATA::ID | MISSION_REQUEST_INT_DATA::ID => {
                    let seq = MissionRequest::of(packet).unwrap().seq;
                    let item = self.items[usize::from(seq)].to_message(seq, (US.system, US.component));
                    self.say::<MISSION_ITEM_INT_DATA>(&item)
                }
                MISSION_COUNT_DATA::ID => {
                    self.expected = MissionCount::of(packet).unwrap().count;
                    self.items.clear();
                    self.ask()
                }
                MISSION_ITEM_INT_DATA::ID => {
                    let (sent, item) = Item::of(packet).unwrap();
                    if usize::from(sent.seq) == self.items.len() {
                        self.items.push(item);
                    }
                    if self.items.len() == usize::from(self.expected) { self.ack(0) } else { self.ask() }
                }
                MISSION_CLEAR_ALL_DATA::ID => {
                    self.items.clear();
                    self.ack(0)
                }
                id => panic!("message {id}"),
            }
        }
    }

    fn run<E: Exchange>(
        exchange: &mut E,
        peer: &mut Peer,
        mut lost: impl FnMut() -> bool,
    ) -> Result<E::Output, String> {
        let mut station = Encoder::new(US.system, US.component);
        let (mut ours, mut theirs, mut now) = (Decoder::default(), Decoder::default(), Duration::ZERO);
        for _ in 0..10_000 {
            let mut datagram = Vec::new();
            exchange.poll(now, &mut station, &mut datagram);
            if let Some(outcome) = exchange.outcome() {
                return outcome;
            }
            for packet in theirs.datagram(&datagram) {
                if lost() {
                    continue;
                }
                let answer = peer.hear(&packet);
                if !lost() {
                    ours.datagram(&answer).iter().for_each(|packet| exchange.packet(packet, now));
                }
            }
            now = exchange.due().unwrap().max(now + Duration::from_millis(1));
        }
        panic!("the exchange hangs");
    }

    proptest! {
        #[test]
        fn a_mission_goes_up_and_comes_down_over_a_path_that_loses(
            count in 1u16..30, every in 2u32..9, old in any::<bool>()
        ) {
            let items: Vec<_> = (0..count).map(item).collect();
            // The path loses two packets of each 2 * every.
            let mut k = 0;
            let mut lost = || {
                k += 1;
                k % (2 * every) < 2 && every > 2
            };
            let mut peer = Peer { old, ..Peer::default() };
            prop_assert_eq!(run(&mut Upload::new(items.clone(), VEHICLE), &mut peer, &mut lost), Ok(()));
            prop_assert_eq!(&peer.items, &items);
            prop_assert_eq!(run(&mut Download::new(VEHICLE), &mut peer, &mut lost), Ok(items));
            prop_assert_eq!(run(&mut Clear::new(VEHICLE), &mut peer, &mut lost), Ok(()));
            prop_assert_eq!(run(&mut Download::new(VEHICLE), &mut peer, &mut lost), Ok(vec![]));
        }
    }

    #[test]
    fn a_refusal_is_told_in_words() {
        let mut peer = Peer { refuses: Some(4), ..Peer::default() };
        let why = run(&mut Upload::new(vec![item(0)], VEHICLE), &mut peer, || false).unwrap_err();
        assert_eq!(why, "the mission is too long for the vehicle");
        peer.refuses = Some(14);
        let why = run(&mut Clear::new(VEHICLE), &mut peer, || false).unwrap_err();
        assert_eq!(why, "the vehicle takes no missions now");
    }

    #[test]
    fn silence_is_told_in_words() {
        let mut peer = Peer { items: (0..3).map(item).collect(), ..Peer::default() };
        let why = run(&mut Download::new(VEHICLE), &mut peer, || true).unwrap_err();
        assert_eq!(why, "no answer to a request for the mission");
        let mut k = 0;
        let lost = || {
            k += 1;
            k > 4
        };
        let why = run(&mut Download::new(VEHICLE), &mut peer, lost).unwrap_err();
        assert_eq!(why, "item 1 of 3 does not come");
    }
}
