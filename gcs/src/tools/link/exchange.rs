//! How long a station's transfers took over the link: all parameters, a mission up, a mission down.
//!
//! Reads the frames that are carried and takes no part. Times are those of the frames at the station: when its
//! request was sent, and when the last answer arrived.

use std::collections::BTreeSet;
use std::time::Duration;

use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::mission::{MissionAck, MissionCount, MissionList};
use crpl_sitl::link::messages::param::{ParamRequestList, ParamValue};
use crpl_sitl::link::packet::Packet;
use crpl_sitl::radio::air::{CarriedFrame, FrameFate, Way};

/// Message ids of lists of mission items that are asked for.
const MISSION_REQUEST_LIST: u32 = 43;

/// Transfers under way, and those that ended.
#[derive(Debug, Default)]
pub struct Exchanges {
    params: Option<ParamTransfer>,
    upload: Option<(Duration, u16)>,
    download: Option<(Duration, u16)>,
    ended: Vec<String>,
}

#[derive(Debug)]
struct ParamTransfer {
    began: Duration,
    arrived: BTreeSet<u16>,
}

impl Exchanges {
    /// A frame's fate is settled.
    pub fn settled(&mut self, frame: &CarriedFrame<Packet>) {
        let arrived = frame.fate == FrameFate::Arrived;
        match frame.way {
            Way::Up => self.asked(frame, arrived),
            Way::Down if arrived => self.answered(frame),
            Way::Down => {}
        }
    }

    /// Transfers that ended since the last call, in words.
    pub fn ended(&mut self) -> Vec<String> {
        std::mem::take(&mut self.ended)
    }

    fn asked(&mut self, frame: &CarriedFrame<Packet>, arrived: bool) {
        let (packet, began) = (&frame.frame, frame.offered);
        if ParamRequestList::of(packet).is_some() {
            self.params.get_or_insert_with(|| ParamTransfer { began, arrived: BTreeSet::new() });
        }
        if let Some(count) = MissionCount::of(packet) {
            self.upload.get_or_insert((began, count.count));
        }
        if packet.id == MISSION_REQUEST_LIST && MissionList::of(packet).is_some() {
            self.download.get_or_insert((began, 0));
        }
        // The station's own acknowledgement ends what it downloads.
        if MissionAck::of(packet).is_some() && arrived {
            let ended = self.download.take();
            self.tell("mission down", ended, frame.offered);
        }
    }

    fn answered(&mut self, frame: &CarriedFrame<Packet>) {
        let packet = &frame.frame;
        if let (Some(transfer), Some(value)) = (&mut self.params, ParamValue::of(packet)) {
            if value.index < value.count {
                transfer.arrived.insert(value.index);
            }
            if transfer.arrived.len() == usize::from(value.count) {
                let took = frame.done.saturating_sub(transfer.began).as_secs_f64();
                self.ended.push(format!("all {} parameters arrived in {took:.2} s", value.count));
                self.params = None;
            }
        }
        if let (Some((_, count)), Some(told)) = (&mut self.download, MissionCount::of(packet)) {
            *count = told.count;
        }
        if MissionAck::of(packet).is_some() {
            let ended = self.upload.take();
            self.tell("mission up", ended, frame.done);
        }
    }

    fn tell(&mut self, what: &str, transfer: Option<(Duration, u16)>, end: Duration) {
        if let Some((began, count)) = transfer {
            let took = end.saturating_sub(began).as_secs_f64();
            self.ended.push(format!("{what}: {count} items in {took:.2} s"));
        }
    }
}
