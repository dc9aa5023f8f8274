use crpl_sitl::link::dialect::{self, MavCmd};
use crpl_sitl::link::encoder::{DATAGRAM, Encoder};
use proptest::prelude::*;

use super::*;

const NOW: Duration = Duration::from_secs(100);

/// A component with its own sequence numbers.
pub(super) struct Sender(Encoder);

impl Sender {
    pub fn new(system: u8, component: u8) -> Self {
        Self(Encoder::new(system, component))
    }

    pub fn heartbeat(&mut self) -> Vec<u8> {
        let mut out = Vec::new();
        self.0.push(&mut out, &dialect::HEARTBEAT_DATA::default());
        out
    }

    pub fn command(&mut self, command: MavCmd, system: u8, component: u8) -> Vec<u8> {
        let mut out = Vec::new();
        let ask = dialect::COMMAND_LONG_DATA {
            command,
            target_system: system,
            target_component: component,
            ..Default::default()
        };
        self.0.push(&mut out, &ask);
        out
    }

    pub fn attitude(&mut self) -> Vec<u8> {
        let mut out = Vec::new();
        self.0.push(&mut out, &dialect::ATTITUDE_DATA { roll: 0.1, ..Default::default() });
        out
    }

    pub fn position(&mut self) -> Vec<u8> {
        let mut out = Vec::new();
        self.0.push(&mut out, &dialect::LOCAL_POSITION_NED_DATA { vz: 0.1, ..Default::default() });
        out
    }

    fn setpoint(&mut self, system: u8) -> Vec<u8> {
        let mut out = Vec::new();
        let setpoint =
            dialect::SET_POSITION_TARGET_LOCAL_NED_DATA { target_system: system, ..Default::default() };
        self.0.push(&mut out, &setpoint);
        out
    }
}

/// What came out of a router, in order.
pub(super) fn out(router: &mut Router) -> Vec<(LinkId, Vec<u8>)> {
    let mut out = Vec::new();
    router.flush(|id, bytes| {
        out.push((id, bytes.to_vec()));
        true
    });
    out
}

pub(super) fn send(router: &mut Router, from: LinkId, bytes: &[u8]) -> Vec<LinkId> {
    router.receive(from, bytes, NOW, |_| {});
    out(router)
        .into_iter()
        .map(|(id, sent)| {
            assert_eq!(sent, bytes, "byte for byte");
            id
        })
        .collect()
}

/// A vehicle (1, components 1 and 68), another (2), and two stations.
fn routed() -> (Router, [LinkId; 4]) {
    let mut router = Router::default();
    let links = ["vehicle", "other", "station", "watcher"].map(|name| router.add(name.into()));
    for (link, system, component) in [(0, 1, 1), (0, 1, 68), (1, 2, 1), (2, 255, 190)] {
        router.receive(links[link], &Sender::new(system, component).heartbeat(), NOW, |_| {});
    }
    out(&mut router);
    (router, links)
}

#[test]
fn a_broadcast_reaches_every_link_but_its_own() {
    let (mut router, [vehicle, other, station, watcher]) = routed();
    let mut sender = Sender::new(1, 1);
    sender.heartbeat();
    assert_eq!(send(&mut router, vehicle, &sender.heartbeat()), [other, station, watcher]);
}

#[test]
fn a_targeted_message_goes_only_where_its_target_lives() {
    let (mut router, [vehicle, other, station, _]) = routed();
    let mut sender = Sender::new(255, 190);
    sender.heartbeat();
    let hold = MavCmd::MAV_CMD_DO_SET_MODE;
    assert_eq!(send(&mut router, station, &sender.command(hold, 1, 1)), [vehicle]);
    assert_eq!(send(&mut router, station, &sender.command(hold, 2, 0)), [other]);
    assert_eq!(send(&mut router, station, &sender.command(hold, 9, 1)), []);
    // A component that nobody has heard may be about to speak, where its system is.
    assert_eq!(send(&mut router, station, &sender.command(hold, 2, 154)), [other]);
    assert_eq!(send(&mut router, station, &sender.command(hold, 0, 0)).len(), 3);
}

#[test]
fn a_component_on_another_link_than_its_autopilot_is_found_there() {
    let (mut router, [vehicle, other, station, _]) = routed();
    router.receive(other, &Sender::new(1, 154).heartbeat(), NOW, |_| {});
    out(&mut router);
    let mut sender = Sender::new(255, 190);
    sender.heartbeat();
    let hold = MavCmd::MAV_CMD_DO_SET_MODE;
    assert_eq!(send(&mut router, station, &sender.command(hold, 1, 154)), [other]);
    assert_eq!(send(&mut router, station, &sender.command(hold, 1, 68)), [vehicle]);
    assert_eq!(send(&mut router, station, &sender.command(hold, 1, 0)), [vehicle, other]);
}

#[test]
fn a_key_never_leaves() {
    let (mut router, [_, _, station, _]) = routed();
    let mut bytes = Vec::new();
    let setup = dialect::SETUP_SIGNING_DATA { secret_key: [7; 32], target_system: 0, ..Default::default() };
    let mut encoder = Encoder::new(255, 190);
    encoder.push(&mut bytes, &dialect::HEARTBEAT_DATA::default());
    bytes.clear();
    encoder.push(&mut bytes, &setup);
    let mut logged = 0;
    router.receive(station, &bytes, NOW, |_| logged += 1);
    assert_eq!((out(&mut router), logged, router.signing_kept()), (vec![], 0, 1));
}

#[test]
fn the_same_bytes_pass_once_and_a_like_frame_later_passes_again() {
    let (mut router, [vehicle, other, ..]) = routed();
    let mut sender = Sender::new(1, 1);
    sender.heartbeat();
    let frame = sender.heartbeat();
    assert_eq!(send(&mut router, vehicle, &frame).len(), 3);
    assert_eq!(send(&mut router, vehicle, &frame).len(), 0, "the same path");
    assert_eq!(send(&mut router, other, &frame).len(), 0, "another path");
    router.receive(vehicle, &frame, NOW + COPY_WITHIN, |_| {});
    // The link that has brought an echo is asked whether the sender lives there: this frame is withheld from it.
    assert_eq!(out(&mut router).len(), 2, "a sender without sequence numbers");
}

#[test]
fn routers_in_a_ring_carry_a_frame_round_once() {
    let (mut a, mut b) = (Router::default(), Router::default());
    let vehicle = a.add("vehicle".into());
    let ring_a = [a.add("left".into()), a.add("right".into())];
    let ring_b = [b.add("left".into()), b.add("right".into())];
    let station = b.add("station".into());
    let mut sender = Sender::new(1, 1);
    let unknown = |sender: &mut Sender| {
        let mut frame = sender.heartbeat();
        frame[9] = 0x7F;
        frame
    };
    for k in 0..50 {
        let bytes = if k % 2 == 0 { sender.heartbeat() } else { unknown(&mut sender) };
        let now = NOW + Duration::from_millis(k * 10);
        a.receive(vehicle, &bytes, now, |_| {});
        let (mut arrived, mut hops) = (0, 0);
        loop {
            let (from_a, from_b) = (out(&mut a), out(&mut b));
            if from_a.is_empty() && from_b.is_empty() {
                break;
            }
            hops += 1;
            assert!(hops < 5, "frames go round and round");
            for (id, bytes) in from_a {
                if let Some(side) = ring_a.iter().position(|&link| link == id) {
                    b.receive(ring_b[side], &bytes, now, |_| {});
                }
            }
            for (id, bytes) in from_b {
                match ring_b.iter().position(|&link| link == id) {
                    Some(side) => a.receive(ring_a[side], &bytes, now, |_| {}),
                    None => arrived += usize::from(id == station),
                }
            }
        }
        assert_eq!(arrived, 1, "frame {k}");
    }
}

#[test]
fn gaps_are_losses_and_a_late_frame_is_none() {
    let mut router = Router::default();
    let link = router.add("vehicle".into());
    let mut sender = Sender::new(1, 1);
    let frames: Vec<_> = (0..300).map(|_| sender.heartbeat()).collect();
    for (k, frame) in frames.iter().enumerate() {
        // 9 to 12 never come, 20 comes late, and the numbers wrap.
        match k {
            9..=12 | 20 => continue,
            22 => router.receive(link, &frames[20], NOW, |_| {}),
            _ => {}
        }
        router.receive(link, frame, NOW, |_| {});
    }
    let counters = router.links().next().unwrap().2.clone();
    assert_eq!((counters.received(), counters.missing, counters.late), (296, 5, 1));
    assert_eq!(counters.lost(), 4);
    assert_eq!(counters.duplicates, 0);
}

/// Report A10: `frames_lost` of a flight counted the gaps of other stations.
#[test]
fn frames_of_the_vehicle_that_are_lost_are_told_from_a_station_s() {
    let (mut router, [vehicle, _, station, _]) = routed();
    router.take_control(Some((1, station)));
    let (mut autopilot, mut other) = (Sender::new(1, 1), Sender::new(254, 190));
    for k in 0..20 {
        let (ours, theirs) = (autopilot.attitude(), other.heartbeat());
        if k != 7 {
            router.receive(vehicle, &ours, NOW, |_| {});
        }
        if k % 3 == 0 {
            router.receive(vehicle, &theirs, NOW, |_| {});
        }
    }
    router.take_control(None);
    assert_eq!(router.vehicle_lost(), 1);
    assert!(router.counters(vehicle).unwrap().lost() > 10);
}

#[test]
fn an_answer_tells_its_link_s_round_trip() {
    let (mut router, [vehicle, _, station, _]) = routed();
    let mut asker = Sender::new(255, 190);
    asker.heartbeat();
    let ask = asker.command(MavCmd::MAV_CMD_USER_1, 1, 68);
    router.receive(station, &ask, NOW, |_| {});
    let mut ack = Vec::new();
    let mut radio = Encoder::new(1, 68);
    radio.push(&mut ack, &dialect::HEARTBEAT_DATA::default());
    ack.clear();
    radio.push_ack(&mut ack, 31010, dialect::MavResult::MAV_RESULT_ACCEPTED, (255, 190));
    router.receive(vehicle, &ack, NOW + Duration::from_millis(3), |_| {});
    let trip = &router.counters(vehicle).unwrap().round_trip;
    assert_eq!((trip.count(), trip.largest()), (1, Duration::from_millis(3)));
}

#[test]
fn a_held_vehicle_is_flown_from_one_link_and_its_mode_changed_from_any() {
    let (mut router, [vehicle, _, pilot, watcher]) = routed();
    router.notices();
    router.take_control(Some((1, pilot)));
    let mut stranger = Sender::new(254, 190);
    assert_eq!(send(&mut router, watcher, &stranger.setpoint(1)), []);
    assert_eq!(send(&mut router, watcher, &stranger.setpoint(0)), []);
    let said = router.notices();
    assert_eq!(said, [Notice::Found(watcher, 254, 190), Notice::SetpointSuppressed(watcher)], "once");
    assert_eq!(send(&mut router, watcher, &stranger.setpoint(2)).len(), 1, "another vehicle's");
    let mut flown = Sender::new(255, 190);
    flown.heartbeat();
    assert_eq!(send(&mut router, pilot, &flown.setpoint(1)), [vehicle]);
    let mode = stranger.command(MavCmd::MAV_CMD_DO_SET_MODE, 1, 1);
    assert_eq!(send(&mut router, watcher, &mode), [vehicle]);
    assert_eq!(router.suppressed_setpoints(), 2);
    let (mut autopilot, mut ack) = (Encoder::new(1, 1), Vec::new());
    autopilot.push(&mut ack, &dialect::HEARTBEAT_DATA::default());
    for result in [dialect::MavResult::MAV_RESULT_DENIED, dialect::MavResult::MAV_RESULT_ACCEPTED] {
        assert!(!router.notices().iter().any(|n| matches!(n, Notice::ModeChange(_))), "nothing accepted yet");
        let mode = stranger.command(MavCmd::MAV_CMD_DO_SET_MODE, 1, 1);
        send(&mut router, watcher, &mode);
        ack.clear();
        autopilot.push_ack(&mut ack, 176, result, (254, 190));
        send(&mut router, vehicle, &ack);
    }
    let said = router.notices();
    assert_eq!(said, [Notice::ModeChange(watcher)]);
    router.take_control(None);
    assert_eq!(send(&mut router, watcher, &stranger.setpoint(1)), [vehicle]);
}

#[test]
fn frames_of_one_datagram_stay_together() {
    let mut router = Router::default();
    let (from, to) = (router.add("vehicle".into()), router.add("station".into()));
    let mut sender = Sender::new(1, 1);
    let mut sent = Vec::new();
    for pairs in 1..200 {
        let datagram: Vec<u8> = (0..1 + pairs % 3).flat_map(|_| sender.heartbeat()).collect();
        router.receive(from, &datagram, NOW, |_| {});
        sent.push(datagram);
    }
    let arrived = out(&mut router);
    assert!(arrived.len() < 10 && arrived.iter().all(|(id, bytes)| *id == to && bytes.len() <= DATAGRAM));
    let mut rest = sent.into_iter();
    for (_, mut bytes) in arrived {
        while !bytes.is_empty() {
            let next = rest.next().unwrap();
            assert!(bytes.starts_with(&next), "a datagram was parted");
            bytes.drain(..next.len());
        }
    }
    assert!(rest.next().is_none());
}

#[derive(Debug, Clone)]
enum Act {
    Broadcast,
    Command(u8),
    Junk(Vec<u8>),
}

proptest! {
    #[test]
    fn every_frame_comes_out_once_where_it_should_and_junk_nowhere(
        acts in prop::collection::vec((0usize..4, prop_oneof![
            3 => Just(Act::Broadcast),
            3 => (0u8..4).prop_map(Act::Command),
            1 => prop::collection::vec(0u8..0xFD, 0..60).prop_map(Act::Junk),
        ]), 1..120)
    ) {
        let mut router = Router::default();
        let links: Vec<_> = (0..4).map(|k| router.add(k.to_string())).collect();
        let mut senders: Vec<_> = (1..=4).map(|k| Sender::new(k, 1)).collect();
        for (link, sender) in links.iter().zip(&mut senders) {
            router.receive(*link, &sender.heartbeat(), NOW, |_| {});
        }
        out(&mut router);
        let mut expected: Vec<Vec<u8>> = vec![Vec::new(); 4];
        for (from, act) in &acts {
            let (bytes, to): (_, Vec<usize>) = match act {
                Act::Broadcast => (senders[*from].heartbeat(), (0..4).filter(|to| to != from).collect()),
                Act::Command(to) => {
                    let ask = senders[*from].command(MavCmd::MAV_CMD_USER_1, to + 1, 1);
                    (ask, [usize::from(*to)].into_iter().filter(|to| to != from).collect())
                }
                Act::Junk(junk) => (junk.clone(), vec![]),
            };
            router.receive(links[*from], &bytes, NOW, |_| {});
            for to in to {
                expected[to].extend(&bytes);
            }
        }
        let mut arrived: Vec<Vec<u8>> = vec![Vec::new(); 4];
        for (id, bytes) in out(&mut router) {
            arrived[id.0 as usize].extend(bytes);
        }
        prop_assert_eq!(arrived, expected);
        let lost: u64 = router.links().map(|(_, _, c)| c.lost() + c.duplicates).sum();
        prop_assert_eq!(lost, 0);
    }

    #[test]
    fn junk_never_panics(
        junk in prop::collection::vec((0u32..3, prop::collection::vec(
            prop_oneof![Just(0xFDu8), Just(0xFE), Just(0), any::<u8>()], 0..400)), 1..8)
    ) {
        let mut router = Router::default();
        for k in 0..2 {
            router.add(k.to_string());
        }
        for (link, junk) in &junk {
            router.receive(LinkId(*link), junk, NOW, |_| {});
        }
        router.flush(|_, datagram| {
            assert!(datagram.len() <= DATAGRAM);
            true
        });
    }
}

/// Report G13: a broadcast that the system refused was told as "sent 20".
#[test]
fn what_could_not_be_sent_counts_as_no_frame_sent() {
    let (mut router, [vehicle, other, station, watcher]) = routed();
    let before = [other, station, watcher].map(|id| router.counters(id).unwrap().sent_frames);
    let mut sender = Sender::new(1, 1);
    sender.heartbeat();
    router.receive(vehicle, &sender.heartbeat(), NOW, |_| {});
    router.flush(|id, _| id != other);
    let after = [other, station, watcher].map(|id| router.counters(id).unwrap());
    assert_eq!(after.map(|c| c.send_errors), [1, 0, 0]);
    assert_eq!(after.map(|c| c.sent_frames), [before[0], before[1] + 1, before[2] + 1]);
    // Told later, by a socket that had taken it.
    router.receive(vehicle, &sender.attitude(), NOW, |_| {});
    router.flush(|_, _| true);
    let sent = router.counters(station).unwrap().sent_frames;
    router.not_sent(station, &sender.attitude());
    let counters = router.counters(station).unwrap();
    assert_eq!((counters.sent_frames, counters.send_errors), (sent - 1, 1));
}
