//! Redundant paths and rings: two routers, slow paths between them, in virtual time.

use std::collections::BTreeMap;

use crpl_sitl::link::dialect::MavCmd;

use super::history::MAX_SOURCES;
use super::tests::{Sender, out, send};
use super::*;

/// Two routers with two paths between them; a vehicle at the first, a station at the second.
struct Ring {
    routers: [Router; 2],
    /// Of each router: its two paths, then who is behind it.
    links: [[LinkId; 3]; 2],
    delays: [u64; 2],
    /// Under way, by time in ms: to which router, on which of its links, what.
    air: BTreeMap<u64, Vec<(usize, usize, Vec<u8>)>>,
    /// What came to the vehicle and to the station.
    heard: [Vec<Vec<u8>>; 2],
    hops: usize,
}

impl Ring {
    fn new(delays: [u64; 2]) -> Self {
        let mut routers = [Router::salted(1), Router::salted(2)];
        let links = [0, 1].map(|k: usize| ["left", "right", "own"].map(|name| routers[k].add(name.into())));
        let heard = [Vec::new(), Vec::new()];
        Self { routers, links, delays, air: BTreeMap::new(), heard, hops: 0 }
    }

    fn says(&mut self, at: u64, router: usize, bytes: Vec<u8>) {
        self.air.entry(at).or_default().push((router, 2, bytes));
    }

    fn run(&mut self) {
        while let Some((at, arrivals)) = self.air.pop_first() {
            for (router, link, bytes) in arrivals {
                self.hops += 1;
                let now = NOW + Duration::from_millis(at);
                self.routers[router].receive(self.links[router][link], &bytes, now, |_| {});
                for (id, bytes) in out(&mut self.routers[router]) {
                    match self.links[router].iter().position(|&other| other == id) {
                        Some(2) => self.heard[router].push(bytes),
                        Some(path) => {
                            let due = at + self.delays[path];
                            self.air.entry(due).or_default().push((1 - router, path, bytes));
                        }
                        None => unreachable!("a link of this router"),
                    }
                }
            }
        }
    }
}

const NOW: Duration = Duration::from_secs(100);

/// Report G1: 167 sent, 3,029 received, and a heartbeat that circulated without end.
#[test]
fn nothing_circulates_between_two_routers_whose_paths_are_slow() {
    for delays in [[0, 0], [250, 300], [300, 250], [20, 900], [2000, 2500], [4000, 100]] {
        let mut ring = Ring::new(delays);
        let (mut vehicle, mut station) = (Sender::new(1, 1), Sender::new(255, 190));
        let mut sent = [0, 0];
        for k in 0..200 {
            ring.says(k * 100, 0, vehicle.heartbeat());
            sent[1] += 1;
            if k % 10 == 0 {
                ring.says(k * 100, 1, station.heartbeat());
                sent[0] += 1;
            }
            if k % 50 == 49 {
                ring.says(k * 100, 1, station.command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1, 1));
                sent[0] += 1;
            }
        }
        ring.run();
        for (heard, sent) in ring.heard.iter().zip(sent) {
            let mut splitter = Splitter::default();
            let mut count = 0;
            heard.iter().for_each(|bytes| splitter.split(bytes, |_| count += 1));
            assert_eq!(count, sent, "paths of {delays:?} ms");
        }
        // Each frame once from its sender and once over each path; and the echoes of the beginning.
        assert!(ring.hops < 3 * (sent[0] + sent[1]) + 100, "{} hops over {delays:?} ms", ring.hops);
    }
}

/// Report G2: a link that hears the vehicle 20 ms later than another never got a command.
#[test]
fn commands_take_every_path_on_which_the_vehicle_is_heard_first_or_later() {
    let mut router = Router::default();
    let [deaf, good, station] = ["deaf", "good", "station"].map(|name| router.add(name.into()));
    let (mut vehicle, mut sender) = (Sender::new(1, 1), Sender::new(255, 190));
    let mut commands = BTreeMap::new();
    for k in 0..100 {
        let now = NOW + Duration::from_millis(70 * k);
        let frame = vehicle.heartbeat();
        router.receive(deaf, &frame, now, |_| {});
        router.receive(good, &frame, now + Duration::from_millis(20), |_| {});
        out(&mut router);
        let ask = sender.command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1, 1);
        router.receive(station, &ask, now + Duration::from_millis(21), |_| {});
        for (id, _) in out(&mut router) {
            *commands.entry(id).or_insert(0) += 1;
        }
    }
    assert_eq!(commands.get(&deaf), Some(&100));
    assert!(commands[&good] >= 99, "{commands:?}: all but the first, before which it was no copy");
}

/// Links of a group are one way in all: no frame crosses, and what one has heard all have.
#[test]
fn a_group_shares_what_it_hears_and_passes_nothing_between_its_links() {
    let mut router = Router::default();
    let group = || LinkRules { group: Some("radio".into()), ..LinkRules::default() };
    let [left, right] = ["left", "right"].map(|name| router.add_with(name.into(), group()));
    let station = router.add("station".into());
    let (mut vehicle, mut sender) = (Sender::new(1, 1), Sender::new(255, 190));
    assert_eq!(send(&mut router, left, &vehicle.heartbeat()), [station]);
    let ask = sender.command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1, 1);
    assert_eq!(send(&mut router, station, &ask), [left, right]);
}

/// Report G12: a sender whose number never changes lost 40 of 50 frames.
#[test]
fn a_sender_with_a_constant_number_loses_no_frame() {
    let mut router = Router::default();
    let [vehicle, second, station] = ["vehicle", "second", "station"].map(|name| router.add(name.into()));
    let frame = Sender::new(1, 1).heartbeat();
    let passed = (0..50).map(|_| send(&mut router, vehicle, &frame).contains(&station));
    assert_eq!(passed.filter(|passed| *passed).count(), 50);
    // The same over a second path is one copy each.
    let passed: usize = (0..50).map(|_| send(&mut router, second, &frame).len()).sum();
    assert_eq!(passed, 0);
}

#[test]
fn without_the_rule_of_copies_all_pass() {
    let mut router = Router::default();
    router.copies_within(Duration::ZERO);
    let [vehicle, station] = ["vehicle", "station"].map(|name| router.add(name.into()));
    let mut sender = Sender::new(1, 1);
    sender.heartbeat();
    let frame = sender.heartbeat();
    assert_eq!(send(&mut router, vehicle, &frame), [station]);
    assert_eq!(send(&mut router, vehicle, &frame), [station]);
}

/// Report G16: a peer that invents 32,640 source ids cost 94 MB.
#[test]
fn a_peer_that_invents_sources_is_remembered_within_bounds() {
    let mut router = Router::default();
    let [vehicle, _] = ["vehicle", "station"].map(|name| router.add(name.into()));
    for system in 1..=255 {
        for component in 1..=128 {
            router.receive(vehicle, &Sender::new(system, component).heartbeat(), NOW, |_| {});
            out(&mut router);
        }
    }
    let sources = router.links().next().unwrap().1.len();
    assert_eq!((sources, router.history.sources()), (MAX_SOURCES, MAX_SOURCES));
}

/// Report G17: nothing kept messages off a link, and nothing its rate.
#[test]
fn a_link_gets_what_its_filter_and_its_rate_allow_and_commands_first() {
    let mut router = Router::default();
    let vehicle = router.add("vehicle".into());
    let rules = LinkRules { rate: Some(500.0), drop: vec![30], ..LinkRules::default() };
    let narrow = router.add_with("narrow".into(), rules);
    let deaf = router.add_with("deaf".into(), LinkRules { only: vec![0], ..LinkRules::default() });
    let mute = router.add_with("mute".into(), LinkRules { only_from: vec![0], ..LinkRules::default() });
    let mut sender = Sender::new(1, 1);
    let (mut bytes, mut commands, mut heartbeats) = (0, 0, 0);
    for k in 0..1000 {
        let now = NOW + Duration::from_millis(10 * k);
        let frame = match k % 100 {
            0 => sender.heartbeat(),
            50 => sender.command(MavCmd::MAV_CMD_USER_1, 255, 0),
            k if k % 2 == 0 => sender.attitude(),
            _ => sender.position(),
        };
        router.receive(vehicle, &frame, now, |_| {});
        for (id, datagram) in out(&mut router) {
            let mut splitter = Splitter::default();
            splitter.split(&datagram, |frame| {
                assert!(id != narrow || frame.id != 30, "a filtered message");
                assert!(id != deaf || frame.id == 0, "an unwanted message");
                if id == narrow {
                    bytes += frame.raw.len();
                    heartbeats += usize::from(frame.id == 0);
                    commands += usize::from(frame.id == 76);
                }
            });
        }
        if k == 5 {
            router.receive(narrow, &Sender::new(255, 190).heartbeat(), now, |_| {});
            out(&mut router);
            assert_eq!(send(&mut router, mute, &Sender::new(9, 1).attitude()), []);
        }
    }
    assert!(bytes <= 500 * 12, "{bytes} bytes in 10 s at 500 a second");
    assert_eq!((heartbeats, commands), (10, 10));
    let counters = router.counters(narrow).unwrap();
    assert!(counters.limited > 300 && counters.filtered > 400, "{counters:?}");
}

/// Report A12: the counters of a TCP peer that closes were forgotten.
#[test]
fn what_a_peer_has_carried_is_known_after_it_has_gone() {
    let mut router = Router::default();
    let (first, second) = (router.add("tcpin:x < 1".into()), router.add("tcpout:y".into()));
    let mut sender = Sender::new(1, 1);
    for _ in 0..3 {
        router.receive(first, &sender.heartbeat(), NOW, |_| {});
        router.receive(second, &Sender::new(2, 1).heartbeat(), NOW, |_| {});
    }
    router.remove(first);
    router.remove(second);
    let closed: Vec<_> = router.closed().map(|(name, c)| (name.to_owned(), c.received())).collect();
    assert_eq!(closed, [("tcpin:x < closed".into(), 3), ("tcpout:y".into(), 3)]);
    let again = router.add("tcpout:y".into());
    router.receive(again, &Sender::new(2, 1).heartbeat(), NOW, |_| {});
    assert_eq!(router.counters(again).unwrap().received(), 4, "the same endpoint counts on");
}

/// Report G13: two equal endpoints gave two equal series, and Prometheus refused them all.
#[test]
fn two_equal_endpoints_have_two_names() {
    let mut router = Router::default();
    for _ in 0..3 {
        router.add("udpout:x".into());
    }
    let names: Vec<_> = router.links().map(|(name, ..)| name).collect();
    assert_eq!(names, ["udpout:x", "udpout:x #2", "udpout:x #3"]);
}
