//! The sequence numbers with which frames leave on a link whose receivers count losses by them.
//!
//! A router does not send every frame of a sender to every link: what has a target goes where that lives. By
//! the sender's own numbers such a frame counts as lost. Here it leaves no gap, and what was lost on its way to
//! the router still does. A frame that cannot be numbered anew, because it is signed or its message is unknown,
//! ends that for its sender: from then on its frames leave as they came.

use std::collections::BTreeMap;

use crpl_sitl::link::packet::PacketRef;

use super::history::MAX_SOURCES;

/// The numbers on one link.
#[derive(Debug, Default)]
pub(super) struct Numbers {
    /// Frames of each system and component that were not sent here, modulo 256; `None`: it is not counted.
    withheld: BTreeMap<(u8, u8), Option<u8>>,
}

impl Numbers {
    /// A frame is not sent here.
    pub fn withhold(&mut self, frame: &PacketRef<'_>) {
        if let Some(Some(count)) = self.count(frame) {
            *count = count.wrapping_add(1);
        }
    }

    /// The frame as it leaves here, if that is not how it came.
    pub fn renumbered(&mut self, frame: &PacketRef<'_>) -> Option<Vec<u8>> {
        let count = self.count(frame)?;
        let withheld = (*count)?;
        let numbered = frame.with_sequence(frame.sequence.wrapping_sub(withheld));
        if numbered.is_none() {
            *count = None;
        }
        numbered.filter(|_| withheld > 0)
    }

    fn count(&mut self, frame: &PacketRef<'_>) -> Option<&mut Option<u8>> {
        let source = (frame.system, frame.component);
        if self.withheld.len() >= MAX_SOURCES && !self.withheld.contains_key(&source) {
            return None;
        }
        Some(self.withheld.entry(source).or_insert(Some(0)))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use crpl_sitl::link::dialect::MavCmd;
    use crpl_sitl::link::sequence::Sequence;
    use crpl_sitl::link::splitter::Splitter;

    use super::super::rules::LinkRules;
    use super::super::tests::{Sender, out};
    use super::super::{LinkId, Router};
    use super::*;

    const NOW: Duration = Duration::from_secs(100);

    /// A receiver as MAVProxy is one: it counts what is missing by the numbers of each sender.
    #[derive(Default)]
    struct Receiver {
        senders: BTreeMap<(u8, u8), Sequence>,
        received: u64,
        missing: u64,
    }

    impl Receiver {
        fn takes(&mut self, link: LinkId, sent: Vec<(LinkId, Vec<u8>)>) {
            for (_, bytes) in sent.into_iter().filter(|(to, _)| *to == link) {
                Splitter::of_stream().split(&bytes, |packet| {
                    let sequence = self.senders.entry((packet.system, packet.component)).or_default();
                    self.received += 1;
                    self.missing += sequence.next(packet.sequence).missing;
                });
            }
        }
    }

    /// A vehicle (1, components 1 and 68), a station that flies it, and one that looks on, by these rules.
    fn routed(rules: LinkRules) -> (Router, [LinkId; 3]) {
        let mut router = Router::default();
        let [vehicle, station] = ["vehicle", "station"].map(|name| router.add(name.into()));
        let watcher = router.add_with("watcher".into(), rules);
        (router, [vehicle, station, watcher])
    }

    fn renumbered() -> LinkRules {
        LinkRules { renumber: true, ..LinkRules::default() }
    }

    /// What a receiver makes of a flight in which each interval brings a command to the radio and an answer, and
    /// every `lost`th attitude gets lost on its way to the router.
    fn heard(rules: LinkRules, lost: u64) -> Receiver {
        let (mut router, [vehicle, station, watcher]) = routed(rules);
        let (mut autopilot, mut radio, mut pilot) =
            (Sender::new(1, 1), Sender::new(1, 68), Sender::new(255, 190));
        let mut receiver = Receiver::default();
        for k in 1..=600_u64 {
            let now = NOW + Duration::from_millis(100 * k);
            let mut arrivals = vec![
                (station, pilot.command(MavCmd::MAV_CMD_USER_1, 1, 68)),
                (vehicle, radio.command(MavCmd::MAV_CMD_USER_1, 255, 190)),
                (vehicle, radio.heartbeat()),
            ];
            let attitude = autopilot.attitude();
            if !k.is_multiple_of(lost) {
                arrivals.push((vehicle, attitude));
            }
            if k.is_multiple_of(10) {
                arrivals.push((station, pilot.heartbeat()));
            }
            for (from, bytes) in arrivals {
                router.receive(from, &bytes, now, |_| {});
                receiver.takes(watcher, out(&mut router));
            }
        }
        receiver
    }

    /// Report V19: MAVProxy behind a flight told 37 to 41 % of loss on a perfect link.
    #[test]
    fn who_looks_on_over_a_perfect_link_counts_no_loss() {
        let plain = heard(LinkRules::default(), u64::MAX);
        assert!(plain.missing > 1000, "frames that went elsewhere were {} gaps", plain.missing);
        let watcher = heard(renumbered(), u64::MAX);
        assert_eq!((watcher.received, watcher.missing), (plain.received, 0));
    }

    #[test]
    fn what_is_lost_on_its_way_to_the_router_is_still_a_loss() {
        assert_eq!(heard(renumbered(), 7).missing, 600 / 7);
    }

    #[test]
    fn what_a_link_s_filter_holds_back_is_no_loss_either() {
        let watcher = heard(LinkRules { drop: vec![30], ..renumbered() }, u64::MAX);
        assert_eq!(watcher.missing, 0);
    }

    /// A frame whose checksum nobody here can make anew leaves as it came, and so do all behind it.
    #[test]
    fn an_unknown_message_ends_it_for_its_sender() {
        let (mut router, [vehicle, station, watcher]) = routed(renumbered());
        let mut sender = Sender::new(1, 1);
        router.receive(station, &Sender::new(255, 190).heartbeat(), NOW, |_| {});
        let mut send = |bytes: &[u8]| {
            router.receive(vehicle, bytes, NOW, |_| {});
            out(&mut router).into_iter().find(|(to, _)| *to == watcher).map(|(_, sent)| sent)
        };
        assert!(send(&sender.heartbeat()).is_some());
        assert_eq!(send(&sender.command(MavCmd::MAV_CMD_USER_1, 255, 190)), None);
        let next = sender.heartbeat();
        assert_eq!(send(&next).map(|sent| sent[4]), Some(next[4] - 1));
        let mut unknown = sender.heartbeat();
        unknown[9] = 0x7F;
        for frame in [unknown, sender.heartbeat()] {
            assert_eq!(send(&frame), Some(frame));
        }
    }

    /// A frame that went out with another number, and comes back by a ring, is a copy all the same.
    #[test]
    fn nothing_circulates_by_its_new_number() {
        let (mut router, [vehicle, station, watcher]) = routed(renumbered());
        let mut sender = Sender::new(1, 1);
        router.receive(station, &Sender::new(255, 190).heartbeat(), NOW, |_| {});
        router.receive(vehicle, &sender.heartbeat(), NOW, |_| {});
        router.receive(vehicle, &sender.command(MavCmd::MAV_CMD_USER_1, 255, 190), NOW, |_| {});
        out(&mut router);
        let frame = sender.heartbeat();
        router.receive(vehicle, &frame, NOW, |_| {});
        let sent = out(&mut router).into_iter().find(|(to, _)| *to == watcher).unwrap().1;
        assert_ne!(sent, frame);
        router.receive(vehicle, &sent, NOW, |_| {});
        assert_eq!(out(&mut router), []);
        router.receive(watcher, &sent, NOW, |_| {});
        assert_eq!(out(&mut router), []);
    }
}
