use std::collections::VecDeque;
use std::net::SocketAddr;
use std::time::Duration;

use crpl_sitl::Sim;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::command::CommandLong;
use crpl_sitl::units::{Motion, TxPower};
use crpl_sitl::vehicle::Vehicle;
use proptest::prelude::*;

use super::*;

const TICKS: u64 = 60;

fn scenario() -> Scenario {
    let mut scenario = Scenario::default();
    scenario.disturbance.sigma_c = 0.005;
    scenario.radio.b_dt = 2.5;
    scenario
}

fn remote(system: u8) -> Remote {
    Remote::new(&scenario(), system, Encoder::new(255, 190))
}

/// A pilot whose choice depends on every byte that it sees, so that no difference stays hidden.
fn pilot(percept: &Percept) -> Command {
    let report = format!("{:?}", percept.telemetry);
    let digest = report.bytes().chain(percept.frame.rgb().iter().copied());
    let hash = digest.fold(0_u64, |hash, byte| hash.wrapping_mul(31).wrapping_add(byte.into()));
    let scenario = scenario();
    let motion = Motion::ALL[(hash % 5) as usize].vector() * scenario.dynamics.a_max;
    let accel = scenario.scale.ned_from_paper_acceleration(motion);
    Command::new(percept.telemetry.tick, accel, TxPower::ALL[(hash / 5 % 2) as usize])
}

/// All percepts of a flight in process, the last one included, and the fates of its commands.
fn direct() -> (Vec<Percept>, crpl_sitl::radio::Fates) {
    let mut sim = Sim::new(scenario(), 3);
    let mut percepts = Vec::new();
    for _ in 0..TICKS {
        percepts.push(sim.percept());
        sim.handle(pilot(&sim.percept()));
        sim.advance();
    }
    percepts.push(sim.percept());
    (percepts, sim.fates())
}

/// What happens to the k-th datagram on its way, both directions counted together.
enum Fate {
    Arrives,
    Lost,
    Twice,
    /// Again, much later.
    Late,
}

/// The same flight in lockstep through datagrams that meet `fate`.
fn through(fate: impl Fn(u64) -> Fate) -> (Vec<Percept>, crpl_sitl::radio::Fates) {
    let station: SocketAddr = ([127, 0, 0, 1], 1).into();
    let now = Duration::ZERO;
    let mut vehicle = Vehicle::new(Sim::new(scenario(), 3), 9, Some(TICKS));
    let mut remote = remote(9);
    let mut percepts: Vec<Percept> = Vec::new();
    let mut late: VecDeque<(bool, Vec<u8>)> = VecDeque::new();
    let mut down: VecDeque<Vec<u8>> = [remote.heartbeat(), remote.image_request()].into();
    let mut count = 0;
    for _ in 0..100_000 {
        let up: Vec<_> = std::iter::from_fn(|| vehicle.poll()).map(|(_, bytes)| (true, bytes)).collect();
        let mut way: Vec<_> = up.into_iter().chain(down.drain(..).map(|bytes| (false, bytes))).collect();
        if way.is_empty() {
            // Both shells' timers.
            vehicle.send_percept();
            down.extend(remote.repeat());
            continue;
        }
        if late.len() > 20 {
            way.extend(late.pop_front());
        }
        for (is_up, bytes) in way {
            count += 1;
            let copies = match fate(count) {
                Fate::Arrives => 1,
                Fate::Lost => 0,
                Fate::Twice => 2,
                Fate::Late => {
                    late.push_back((is_up, bytes.clone()));
                    1
                }
            };
            for _ in 0..copies {
                if !is_up {
                    vehicle.datagram(&bytes, station, now);
                    if vehicle.ready() {
                        vehicle.advance(now);
                    }
                    continue;
                }
                for event in remote.datagram(&bytes, now) {
                    match event {
                        RemoteEvent::Percept(percept) => {
                            down.push_back(remote.command(&pilot(&percept)));
                            percepts.push(percept);
                        }
                        RemoteEvent::Repeat(_) => down.extend(remote.repeat()),
                        RemoteEvent::Rebooted(..) => panic!("late parts are no reboot"),
                        RemoteEvent::Text(..) | RemoteEvent::News(_) | RemoteEvent::LeftGuided(_) => {}
                    }
                }
            }
        }
        if vehicle.acknowledged() {
            return (percepts, vehicle.sim().fates());
        }
    }
    panic!("the flight hangs at tick {}", percepts.len());
}

#[test]
fn lockstep_through_bytes_is_the_flight_in_process() {
    assert_eq!(through(|_| Fate::Arrives), direct());
}

#[test]
fn lost_datagrams_delay_lockstep_but_change_nothing() {
    let direct = direct();
    for n in 2..=9 {
        assert_eq!(through(|k| if k % n == 0 { Fate::Lost } else { Fate::Arrives }), direct, "every {n}th");
    }
}

#[test]
fn datagrams_that_come_twice_or_again_much_later_change_nothing() {
    let direct = direct();
    assert_eq!(through(|_| Fate::Twice), direct);
    assert_eq!(through(|k| if k % 3 == 0 { Fate::Late } else { Fate::Arrives }), direct);
    let mixed = |k| match k % 7 {
        0 => Fate::Lost,
        1 | 4 => Fate::Late,
        _ => Fate::Arrives,
    };
    assert_eq!(through(mixed), direct);
}

#[test]
fn the_station_speaks_with_contiguous_numbers_and_to_the_vehicle_it_heard() {
    let station: SocketAddr = ([127, 0, 0, 1], 1).into();
    let mut vehicle = Vehicle::new(Sim::new(scenario(), 3), 9, None);
    let mut remote = remote(9);
    let mut decoder = Decoder::default();
    let mut sent = vec![remote.heartbeat(), remote.image_request()];
    for bytes in &sent {
        vehicle.datagram(bytes, station, Duration::ZERO);
    }
    while let Some((_, bytes)) = vehicle.poll() {
        for event in remote.datagram(&bytes, Duration::ZERO) {
            if let RemoteEvent::Percept(percept) = event {
                sent.push(remote.command(&pilot(&percept)));
            }
        }
    }
    assert_eq!(remote.system(), 9);
    let packets: Vec<Packet> = sent.iter().flat_map(|bytes| decoder.datagram(bytes)).collect();
    let sequence: Vec<u8> = packets.iter().map(|p| p.sequence).collect();
    assert!(sequence.len() >= 4 && sequence.iter().copied().eq(0..sequence.len() as u8), "{sequence:?}");
    assert_eq!(CommandLong::of(&packets[2]).unwrap().target.system, 9, "the command's target");
    assert!(packets.iter().all(|p| (p.system, p.component) == (255, 190)));
}

#[test]
fn leaving_guided_is_told_once_and_only_of_our_vehicle() {
    let mut remote = remote(9);
    let (mut ours, mut other) = (Encoder::new(9, 1), Encoder::new(8, 1));
    let mut heartbeat = |encoder: &mut Encoder, custom_mode| {
        let mut bytes = Vec::new();
        let autopilot = dialect::MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA;
        encoder.push(&mut bytes, &dialect::HEARTBEAT_DATA { custom_mode, autopilot, ..Default::default() });
        let events = remote.datagram(&bytes, Duration::ZERO);
        events.iter().any(|event| matches!(event, RemoteEvent::LeftGuided(mode) if mode.custom == 9))
    };
    for (ours_speaks, mode, left) in [
        (true, 0, false),
        (true, 4, false),
        (false, 4, false),
        (false, 9, false),
        (true, 9, true),
        (true, 9, false),
    ] {
        assert_eq!(heartbeat(if ours_speaks { &mut ours } else { &mut other }, mode), left);
    }
}

#[test]
fn a_link_is_lost_after_five_heartbeats_and_regained() {
    let mut remote = remote(9);
    let mut vehicle = Encoder::new(9, 1);
    let mut heartbeat = |remote: &mut Remote, seconds| {
        let mut bytes = Vec::new();
        vehicle.push(&mut bytes, &dialect::HEARTBEAT_DATA::default());
        remote.datagram(&bytes, Duration::from_secs(seconds))
    };
    assert!(matches!(heartbeat(&mut remote, 0)[..], [RemoteEvent::News(News::Found(9, ..))]));
    assert_eq!(remote.poll(Duration::from_secs(5)), []);
    assert_eq!(remote.poll(Duration::from_secs(6)), [News::Lost(9)]);
    assert!(remote.is_lost());
    assert_eq!(heartbeat(&mut remote, 8), [RemoteEvent::News(News::Regained(9, Duration::from_secs(8)))]);
    assert!(!remote.is_lost());
}

#[test]
fn another_vehicle_on_the_same_link_is_not_ours() {
    let mut ours = remote(4);
    let mut hear = |system| {
        let mut vehicle = Vehicle::new(Sim::new(scenario(), 3), system, None);
        let station: SocketAddr = ([127, 0, 0, 1], 1).into();
        vehicle.datagram(&remote(system).image_request(), station, Duration::ZERO);
        let sent: Vec<_> = std::iter::from_fn(|| vehicle.poll()).collect();
        sent.iter()
            .flat_map(|(_, bytes)| ours.datagram(bytes, Duration::ZERO))
            .filter(|e| matches!(e, RemoteEvent::Percept(_)))
            .count()
    };
    assert_eq!([hear(5), hear(4), hear(5)], [0, 1, 0]);
}

proptest! {
    #[test]
    fn junk_never_panics(junk in prop::collection::vec(any::<u8>(), 0..1500)) {
        let mut remote = remote(9);
        prop_assert!(remote.datagram(&junk, Duration::ZERO).is_empty());
    }
}
