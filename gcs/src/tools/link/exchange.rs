//! How long a station's transfers took over the link: all parameters, a mission up, a mission down.
//!
//! Reads the frames that are carried and takes no part. Times are those of the frames at the station: when its
//! request was sent, and when the last answer arrived.

use std::collections::BTreeSet;
use std::time::Duration;

use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::mission::{MissionAck, MissionCount, MissionItem, MissionList};
use crpl_sitl::link::messages::param::{ParamRequestList, ParamValue};
use crpl_sitl::link::packet::Packet;
use crpl_sitl::radio::air::{CarriedFrame, FrameFate, Way};

/// Message ids of lists of mission items that are asked for.
const MISSION_REQUEST_LIST: u32 = 43;

/// Transfers under way, and those that ended.
#[derive(Debug, Default)]
pub struct Exchanges {
    params: Option<ListDownload>,
    mission: Option<ListDownload>,
    upload: Option<(Duration, u16)>,
    ended: Vec<String>,
}

/// A list that the station fetches: it is whole when each of its entries has arrived, in whatever order.
#[derive(Debug)]
struct ListDownload {
    began: Duration,
    count: Option<u16>,
    arrived: BTreeSet<u16>,
}

impl ListDownload {
    fn new(began: Duration) -> Self {
        Self { began, count: None, arrived: BTreeSet::new() }
    }

    /// An entry has arrived, of a list of this length if it tells it.
    fn add(&mut self, index: u16, count: Option<u16>) {
        self.count = count.or(self.count);
        self.arrived.insert(index);
    }

    /// The length of the list, once it is whole.
    fn whole(&self) -> Option<u16> {
        let count = self.count?;
        (self.arrived.range(..count).count() == usize::from(count)).then_some(count)
    }
}

impl Exchanges {
    /// A frame's fate is settled.
    pub fn settled(&mut self, frame: &CarriedFrame<Packet>) {
        let arrived = frame.fate == FrameFate::Arrived;
        match frame.way {
            Way::Up => self.asked(frame),
            Way::Down if arrived => self.answered(frame),
            Way::Down => {}
        }
    }

    /// Transfers that ended since the last call, in words.
    pub fn ended(&mut self) -> Vec<String> {
        std::mem::take(&mut self.ended)
    }

    fn asked(&mut self, frame: &CarriedFrame<Packet>) {
        let (packet, began) = (&frame.frame, frame.offered);
        if ParamRequestList::of(packet).is_some() {
            self.params.get_or_insert_with(|| ListDownload::new(began));
        }
        if let Some(count) = MissionCount::of(packet) {
            self.upload.get_or_insert((began, count.count));
        }
        if packet.id == MISSION_REQUEST_LIST && MissionList::of(packet).is_some() {
            self.mission.get_or_insert_with(|| ListDownload::new(began));
        }
    }

    fn answered(&mut self, frame: &CarriedFrame<Packet>) {
        let packet = &frame.frame;
        if let (Some(params), Some(value)) = (&mut self.params, ParamValue::of(packet)) {
            params.add(value.index, Some(value.count));
        }
        if let (Some(mission), Some(told)) = (&mut self.mission, MissionCount::of(packet)) {
            mission.count = Some(told.count);
        }
        if let (Some(mission), Some(item)) = (&mut self.mission, MissionItem::of(packet)) {
            mission.add(item.seq, None);
        }
        if let Some(params) = self.params.take_if(|params| params.whole().is_some()) {
            self.tell("parameters down", params.whole(), params.began, frame.done);
        }
        if let Some(mission) = self.mission.take_if(|mission| mission.whole().is_some()) {
            self.tell("mission down", mission.whole(), mission.began, frame.done);
        }
        if MissionAck::of(packet).is_some()
            && let Some((began, count)) = self.upload.take()
        {
            self.tell("mission up", Some(count), began, frame.done);
        }
    }

    fn tell(&mut self, what: &str, count: Option<u16>, began: Duration, end: Duration) {
        let took = end.saturating_sub(began).as_secs_f64();
        self.ended.push(format!("{what}: {} entries in {took:.2} s", count.unwrap_or_default()));
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::decoder::Decoder;
    use crpl_sitl::link::encoder::Encoder;

    use super::*;

    /// The frame of a message that arrives, or not, half a second after it was sent.
    fn frame(way: Way, second: u64, arrives: bool, message: &impl View) -> CarriedFrame<Packet> {
        let mut bytes = Vec::new();
        Encoder::new(1, 1).push_view(&mut bytes, message);
        let frame = Decoder::default().datagram(&bytes).remove(0);
        let offered = Duration::from_secs(second);
        CarriedFrame {
            way,
            kind: frame.id,
            bytes: bytes.len(),
            offered,
            on_air: Some(offered),
            air_time: Duration::ZERO,
            done: offered + Duration::from_millis(500),
            packets: 1,
            snr_db: 0.0,
            fate: if arrives { FrameFate::Arrived } else { FrameFate::Noise },
            frame,
        }
    }

    fn value(index: u16) -> ParamValue {
        ParamValue { value: [0; 4], count: 2, index, name: "A".into(), kind: 9 }
    }

    #[test]
    fn a_list_took_from_its_first_request_to_its_last_entry() {
        let mut exchanges = Exchanges::default();
        let target = (1, 1).into();
        exchanges.settled(&frame(Way::Up, 1, false, &ParamRequestList { target }));
        exchanges.settled(&frame(Way::Up, 3, true, &ParamRequestList { target }));
        for (second, index, arrives) in [(4, 1, true), (5, 0, false), (6, 1, true), (7, 0, true)] {
            assert!(exchanges.ended().is_empty(), "{second}");
            exchanges.settled(&frame(Way::Down, second, arrives, &value(index)));
        }
        assert_eq!(exchanges.ended(), ["parameters down: 2 entries in 6.50 s"]);
        exchanges.settled(&frame(Way::Down, 9, true, &value(0)));
        assert!(exchanges.ended().is_empty(), "a value that nobody's list is about");
    }

    #[test]
    fn missions_are_told_both_ways() {
        let mut exchanges = Exchanges::default();
        let target = (1, 1).into();
        let count = MissionCount { count: 0, target, mission_type: 0, opaque_id: 0 };
        exchanges.settled(&frame(Way::Up, 1, true, &MissionCount { count: 4, ..count }));
        let ack = MissionAck { target, result: 0, mission_type: 0, opaque_id: 0 };
        exchanges.settled(&frame(Way::Down, 3, true, &ack));
        assert_eq!(exchanges.ended(), ["mission up: 4 entries in 2.50 s"]);
        exchanges.settled(&frame(Way::Up, 4, true, &MissionList { target, mission_type: 0 }));
        exchanges.settled(&frame(Way::Down, 5, true, &count));
        assert_eq!(exchanges.ended(), ["mission down: 0 entries in 1.50 s"]);
    }
}
