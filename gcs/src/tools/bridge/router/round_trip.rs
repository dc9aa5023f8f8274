//! Requests and their answers, which tell what a link takes for a round trip.

use std::time::Duration;

use crpl_sitl::link::messages::command::CommandAck;
use crpl_sitl::link::messages::service::{Ping, Timesync};
use crpl_sitl::link::messages::{Target, View};
use crpl_sitl::link::packet::PacketRef;
use crpl_sitl::link::wire;

use super::{LinkId, Router};

/// Requests whose answers are waited for, to time them.
const PENDING: usize = 64;

/// A request whose answer will tell a link's round trip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Asked {
    /// TIMESYNC or PING, by message and its time stamp.
    Time(u32, u64),
    /// A command for a system.
    Command(u16, u8),
}

impl Router {
    /// Times requests and their answers: what a link and those behind it take for a round trip.
    pub(super) fn time(&mut self, from: LinkId, frame: &PacketRef<'_>, now: Duration) {
        let (asked, is_request) = if let Some(sync) = Timesync::of(*frame) {
            (Asked::Time(frame.id, sync.ts1 as u64), sync.tc1 == 0)
        } else if let Some(ping) = Ping::of(*frame) {
            // A request asks everybody, an answer names the asker.
            (Asked::Time(frame.id, ping.time_usec), ping.target == Target::default())
        } else if let Some(ask) = wire::ask_of(*frame) {
            (Asked::Command(ask.command, ask.target.system), true)
        } else if let Some(ack) = CommandAck::of(*frame) {
            (Asked::Command(ack.command, frame.system), false)
        } else {
            return;
        };
        if is_request {
            self.pending.retain(|(other, ..)| *other != asked);
            if self.pending.len() == PENDING {
                self.pending.remove(0);
            }
            self.pending.push((asked, from, now));
        } else if let Some(at) = self.pending.iter().position(|&(other, by, _)| other == asked && by != from)
        {
            let (_, _, since) = self.pending.swap_remove(at);
            if let Some(link) = self.links.get_mut(&from) {
                link.counters.round_trip.add(now.saturating_sub(since));
            }
        }
    }
}
