//! The mission protocol from the station's side: upload, download, clear. No socket, no clock.
//!
//! In an upload the vehicle asks, by MISSION_REQUEST_INT or the older MISSION_REQUEST, and both are
//! answered by MISSION_ITEM_INT, as the standard wants it. In a download we ask.

use std::time::Duration;

use crpl_sitl::link::dialect::{
    MISSION_ACK_DATA, MISSION_CLEAR_ALL_DATA, MISSION_COUNT_DATA, MISSION_REQUEST_DATA,
    MISSION_REQUEST_LIST_DATA,
};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::mission::{MissionAck, MissionCount, MissionRequest};
use crpl_sitl::link::messages::{Target, View};
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::{STATION_COMPONENT, STATION_SYSTEM};

use super::item::Item;
use crate::tools::retry::Question;
use crate::tools::session::Exchange;

const ACCEPTED: u8 = 0;

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

/// Whether a packet is from the vehicle and its target is us.
fn is_ours(packet: &Packet, vehicle: (u8, u8), target: Target) -> bool {
    (packet.system, packet.component) == vehicle && target.is(STATION_SYSTEM, STATION_COMPONENT)
}

/// The result in a MISSION_ACK for us about a flight mission.
fn ack_of(packet: &Packet, vehicle: (u8, u8)) -> Option<u8> {
    let ack = MissionAck::of(packet)?;
    (is_ours(packet, vehicle, ack.target) && ack.mission_type == 0).then_some(ack.result)
}

/// Gives the vehicle a mission.
#[derive(Debug)]
pub struct Upload {
    items: Vec<Item>,
    target: (u8, u8),
    /// The item that was asked for last.
    asked: Option<u16>,
    question: Question<()>,
}

impl Upload {
    /// These items, to this system and component.
    #[must_use]
    pub fn new(items: Vec<Item>, target: (u8, u8)) -> Self {
        Self { items, target, asked: None, question: Question::default() }
    }
}

impl Exchange for Upload {
    type Output = ();

    fn packet(&mut self, packet: &Packet, now: Duration) {
        if let Some(result) = ack_of(packet, self.target).filter(|_| self.question.retry.asked()) {
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
            .filter(|ask| is_ours(packet, self.target, ask.target) && ask.mission_type == 0)
            .filter(|ask| usize::from(ask.seq) < self.items.len());
        if let Some(ask) = asked {
            self.asked = Some(ask.seq);
            self.question.retry.go_on(now);
        }
    }

    fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        let silence = || match self.asked {
            None => "no answer to a mission".into(),
            Some(sequence) => format!("no answer to item {sequence} of {}", self.items.len()),
        };
        if !self.question.fires(now, silence) {
            return;
        }
        match self.asked {
            None => {
                let count = MISSION_COUNT_DATA {
                    count: self.items.len() as u16,
                    target_system: self.target.0,
                    target_component: self.target.1,
                    ..Default::default()
                };
                station.push(datagram, &count);
            }
            Some(sequence) => {
                let item = self.items[usize::from(sequence)].to_message(sequence, self.target);
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

/// Asks the vehicle for its mission.
#[derive(Debug)]
pub struct Download {
    target: (u8, u8),
    count: Option<u16>,
    items: Vec<Item>,
    question: Question<()>,
    /// Whether the vehicle knows only the older request.
    old: bool,
    thanked: bool,
}

impl Download {
    /// Of this system and component.
    #[must_use]
    pub fn new(target: (u8, u8)) -> Self {
        let question = Question::default();
        Self { target, count: None, items: Vec::new(), question, old: false, thanked: false }
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
        let count = MissionCount::of(packet)
            .filter(|count| is_ours(packet, self.target, count.target) && count.mission_type == 0);
        if let Some(MissionCount { count, .. }) = count {
            if self.count.is_none() {
                self.count = Some(count);
                self.question.retry.go_on(now);
            }
        } else if let Some(result) = ack_of(packet, self.target) {
            // The standard's way out for a vehicle that knows no integers.
            if self.count.is_some() && !self.old && result != ACCEPTED {
                self.old = true;
                self.question.retry.go_on(now);
            } else {
                self.question.answered(Err(refusal(result)));
            }
        } else if let Some((sent, item)) = Item::of(packet)
            && is_ours(packet, self.target, sent.target)
            && self.count.is_some()
            && usize::from(sent.seq) == self.items.len()
        {
            self.items.push(item);
            self.question.retry.go_on(now);
        }
    }

    fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        let (target_system, target_component) = self.target;
        if self.whole() {
            if !self.thanked {
                self.thanked = true;
                let ack = MISSION_ACK_DATA { target_system, target_component, ..Default::default() };
                station.push(datagram, &ack);
            }
            return;
        }
        let seq = self.items.len() as u16;
        let silence = || match self.count {
            None => "no answer to a request for the mission".into(),
            Some(of) => format!("item {seq} of {of} does not come"),
        };
        if !self.question.fires(now, silence) {
            return;
        }
        match self.count {
            None => {
                let ask = MISSION_REQUEST_LIST_DATA { target_system, target_component, ..Default::default() };
                station.push(datagram, &ask);
            }
            Some(_) => {
                let ask = MissionRequest { seq, target: self.target.into(), mission_type: 0 };
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

/// Takes the vehicle's mission away.
#[derive(Debug)]
pub struct Clear {
    target: (u8, u8),
    question: Question<()>,
}

impl Clear {
    /// Of this system and component.
    #[must_use]
    pub fn new(target: (u8, u8)) -> Self {
        Self { target, question: Question::default() }
    }
}

impl Exchange for Clear {
    type Output = ();

    fn packet(&mut self, packet: &Packet, _now: Duration) {
        if let Some(result) = ack_of(packet, self.target).filter(|_| self.question.retry.asked()) {
            self.question.answered(if result == ACCEPTED { Ok(()) } else { Err(refusal(result)) });
        }
    }

    fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        if self.question.fires(now, || "no answer to clearing the mission".into()) {
            let (target_system, target_component) = self.target;
            let ask = MISSION_CLEAR_ALL_DATA { target_system, target_component, ..Default::default() };
            station.push(datagram, &ask);
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
    use crpl_sitl::link::MessageData;
    use crpl_sitl::link::decoder::Decoder;
    use crpl_sitl::link::dialect::{MISSION_ITEM_INT_DATA, MISSION_REQUEST_INT_DATA};
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
