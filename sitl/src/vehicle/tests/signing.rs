//! Message signing, as peers meet it.

use super::*;
use crate::link::signing::Rejection;
use crate::link::signing::{self, Key, Policy};

const PLACE: usize = 2;

/// A vehicle whose clock stands at a time when signing had begun.
fn bench() -> Bench {
    let mut bench = Bench::new();
    bench.vehicle.set_epoch(Some(Duration::from_secs(1_800_000_000)));
    bench.vehicle.signing_mut().set_policy(Policy::Optional);
    bench
}

/// ArduCopter and PX4 refuse the unsigned from then on; they were still taken.
#[test]
fn after_a_key_has_come_the_unsigned_are_refused_unless_somebody_wished_otherwise() {
    let (mut bench, mut ours) = (Bench::new(), station());
    bench.vehicle.set_epoch(Some(Duration::from_secs(1_800_000_000)));
    bench.hello();
    bench.send(&setpoint(0, 1.0));
    assert!(bench.vehicle.ready(), "without a key everything is heard");
    bench.vehicle.advance(bench.now);
    bench.send(&setup(key().bytes()));
    bench.send(&setpoint(0, 1.0));
    bench.send(&setup([3; 32]));
    assert!(!bench.vehicle.ready(), "nor is another key, unsigned");
    assert_eq!(bench.vehicle.tally().unsigned[&Rejection::Unsigned], 2);
    let mut push = Vec::new();
    bench.station.push(&mut push, &setpoint(0, 1.0));
    let push = sign(&mut ours, push);
    bench.datagram(&push);
    assert!(bench.vehicle.ready());
}

fn setup(secret_key: [u8; 32]) -> dialect::SETUP_SIGNING_DATA {
    dialect::SETUP_SIGNING_DATA { initial_timestamp: 5, target_system: 7, target_component: 1, secret_key }
}

fn key() -> Key {
    Key::of_passphrase("hello")
}

/// The station's own side of signing.
fn station() -> Signing {
    Signing::new(Some(key()), Policy::Optional)
}

fn sign(signing: &mut Signing, datagram: Vec<u8>) -> Vec<u8> {
    let now = signing::timestamp(Duration::from_secs(1_800_000_000));
    signing.sign(datagram, 0, now).remove(0)
}

fn heartbeat(bench: &mut Bench) -> Vec<u8> {
    let mut datagram = Vec::new();
    bench.station.push(&mut datagram, &dialect::HEARTBEAT_DATA::default());
    datagram
}

fn all_signed(packets: &[Packet]) -> bool {
    !packets.is_empty() && packets.iter().all(|packet| packet.raw[PLACE] == 1)
}

#[test]
fn a_first_key_comes_from_anybody_and_then_everything_is_signed() {
    let mut bench = bench();
    assert!(!all_signed(&bench.hello()));
    bench.send(&setup(key().bytes()));
    bench.vehicle.advance(bench.now);
    let packets = bench.received();
    assert!(all_signed(&packets));
    let (mut theirs, now) = (Signing::new(Some(key()), Policy::Required), bench.vehicle.stamp());
    assert!(packets.iter().all(|packet| theirs.check(packet, now) == Ok(Origin::Signed)));
    bench.send(&setpoint(0, 1.0));
    assert!(bench.vehicle.ready(), "optional: the unsigned are heard");
}

#[test]
fn another_key_needs_the_old_one_and_zeros_turn_it_off() {
    let (mut bench, mut ours) = (bench(), station());
    bench.hello();
    bench.send(&setup(key().bytes()));
    let other = setup([3; 32]);
    bench.now += Duration::from_secs(2);
    let refused = bench.send(&other);
    assert!(texts(&refused).contains(&"signing: unsigned key refused".to_owned()));
    assert!(bench.vehicle.signing.is_on());
    let mut datagram = Vec::new();
    bench.station.push(&mut datagram, &setup([0; 32]));
    bench.now += Duration::from_secs(2);
    let datagram = sign(&mut ours, datagram);
    assert_eq!(texts(&bench.datagram(&datagram)), ["signing: off"]);
    assert!(!bench.vehicle.signing.is_on());
}

#[test]
fn required_hears_nothing_unsigned_and_makes_nobody_a_peer_of_it() {
    let (mut bench, mut ours) = (bench(), station());
    bench.vehicle.set_signing(Signing::new(Some(key()), Policy::Required));
    assert!(bench.hello().is_empty());
    let old = {
        let mut old = vec![0xFE, 9, 0, 255, 190, 0, 0, 0, 0, 0, 6, 8, 0, 4, 3];
        let crc = checksum(&old[1..], dialect::HEARTBEAT_DATA::EXTRA_CRC);
        old.extend(crc.to_le_bytes());
        old
    };
    assert!(bench.datagram(&old).is_empty(), "MAVLink 1 least of all");
    let datagram = heartbeat(&mut bench);
    let signed = sign(&mut ours, datagram);
    assert!(all_signed(&bench.datagram(&signed)));
    let replayed = bench.vehicle.tally();
    bench.datagram(&signed);
    assert_eq!(bench.vehicle.tally().unsigned[&Rejection::Replayed], 1);
    assert_eq!(replayed.unsigned[&Rejection::Unsigned], 1);
    let mut push = Vec::new();
    bench.station.push(&mut push, &setpoint(0, 1.0));
    bench.datagram(&push);
    assert!(!bench.vehicle.ready());
    let push = sign(&mut ours, push);
    bench.datagram(&push);
    assert!(bench.vehicle.ready());
    let text = bench.vehicle.tally().to_string();
    assert!(text.contains("2 signed, 2 refused: unsigned, 1 refused: replayed"), "{text}");
}

#[test]
fn a_key_for_another_system_is_none_of_ours() {
    let mut bench = bench();
    bench.hello();
    bench.send(&dialect::SETUP_SIGNING_DATA { target_system: 9, ..setup(key().bytes()) });
    assert!(!bench.vehicle.signing.is_on());
}

/// Whoever was refused heard nothing, and neither did anybody else.
#[test]
fn refused_packets_are_told_once_with_their_reason() {
    let (mut bench, mut ours) = (bench(), station());
    bench.hello();
    bench.send(&setup(key().bytes()));
    bench.vehicle.signing_mut().set_policy(Policy::Required);
    let mut other = Signing::new(Some(Key::of_passphrase("goodbye")), Policy::Optional);
    let said = |bench: &mut Bench, datagram: &[u8]| texts(&bench.datagram(datagram));
    let unsigned = heartbeat(&mut bench);
    assert_eq!(said(&mut bench, &unsigned), ["packets refused: unsigned"]);
    let wrong = heartbeat(&mut bench);
    let wrong = sign(&mut other, wrong);
    assert_eq!(said(&mut bench, &wrong), ["packets refused: wrong signature"]);
    let good = heartbeat(&mut bench);
    let good = sign(&mut ours, good);
    assert_eq!(said(&mut bench, &good), [""; 0]);
    let old = heartbeat(&mut bench);
    let minutes_ago = signing::timestamp(Duration::from_secs(1_799_999_000));
    let old = station().sign(old, 3, minutes_ago).remove(0);
    assert_eq!(said(&mut bench, &old), ["packets refused: signed over a minute ago"]);
    bench.now += Duration::from_secs(60);
    let unsigned = heartbeat(&mut bench);
    assert_eq!(said(&mut bench, &unsigned), [""; 0], "once");
}
