//! Signing, by its rules.

use super::*;
use crate::link::decoder::Decoder;
use crate::link::encoder::Encoder;

const NOW: u64 = 4_000_000_000;

fn key() -> Key {
    Key::of_passphrase("hello")
}

fn signing(policy: Policy) -> Signing {
    Signing::new(Some(key()), policy)
}

fn heartbeats(count: usize) -> Vec<u8> {
    let (mut encoder, mut datagram) = (Encoder::new(255, 190), Vec::new());
    for _ in 0..count {
        encoder.push(&mut datagram, &dialect::HEARTBEAT_DATA::default());
    }
    datagram
}

fn packet(datagram: &[u8]) -> Packet {
    let mut packets = Decoder::default().datagram(datagram);
    assert_eq!(packets.len(), 1);
    packets.remove(0)
}

/// A heartbeat signed at that time.
fn signed(at: u64) -> Packet {
    packet(&signing(Policy::Optional).sign(heartbeats(1), 3, at)[0])
}

#[test]
fn a_signature_is_what_pymavlink_makes() {
    // pymavlink 2.4.50: HEARTBEAT(6, 8, 0, 0, 0, 3) of 255/190 with seq 7, link 3, timestamp 123456789
    // and sha256("hello") as the key.
    let expected = from_text("fd09010007ffbe000000000000000608000003f8610315cd5b07000084cdd2f9227a");
    let mut encoder = Encoder::new(255, 190);
    let mut datagram = Vec::new();
    for _ in 0..8 {
        datagram.clear();
        let message = dialect::HEARTBEAT_DATA {
            mavtype: dialect::MavType::MAV_TYPE_GCS,
            autopilot: dialect::MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: dialect::MavModeFlag::empty(),
            system_status: dialect::MavState::MAV_STATE_UNINIT,
            custom_mode: 0,
            mavlink_version: 3,
        };
        encoder.push(&mut datagram, &message);
    }
    assert_eq!(signing(Policy::Optional).sign(datagram, 3, 123_456_789), [expected]);
}

fn from_text(hex: &str) -> Vec<u8> {
    (0..hex.len() / 2).map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).unwrap()).collect()
}

#[test]
fn a_signed_frame_is_good_once_and_a_changed_one_never() {
    let mut ours = signing(Policy::Required);
    let frame = signed(NOW);
    assert_eq!(ours.check(&frame, NOW), Ok(Origin::Signed));
    assert_eq!(ours.check(&frame, NOW), Err(Rejection::Replayed));
    assert_eq!(ours.check(&signed(NOW - 1), NOW), Err(Rejection::Replayed));
    for at in [12, frame.raw.len() - 13, frame.raw.len() - 8, frame.raw.len() - 1] {
        let mut changed = signed(NOW + 1);
        changed.raw[at] ^= 1;
        assert_eq!(ours.check(&changed, NOW), Err(Rejection::Signature), "byte {at}");
    }
    let mut other = Signing::new(Some(Key::of_passphrase("other")), Policy::Optional);
    assert_eq!(other.check(&frame, NOW), Err(Rejection::Signature), "optional is not anything goes");
    assert_eq!((ours.accepted(), ours.rejected()[&Rejection::Replayed]), (1, 2));
}

#[test]
fn a_minute_is_the_limit_and_a_wrong_signature_moves_no_time() {
    let mut ours = signing(Policy::Required);
    assert_eq!(ours.check(&signed(NOW - MINUTE - 1), NOW), Err(Rejection::Old));
    assert_eq!(ours.check(&signed(NOW - MINUTE), NOW), Ok(Origin::Signed));
    let mut forged = signed(NOW + 100 * MINUTE);
    let last = forged.raw.len() - 1;
    forged.raw[last] ^= 1;
    assert_eq!(ours.check(&forged, NOW), Err(Rejection::Signature));
    assert_eq!(ours.check(&signed(NOW), NOW), Ok(Origin::Signed));
}

#[test]
fn required_refuses_the_unsigned_but_not_the_modem() {
    let plain = packet(&heartbeats(1));
    let mut datagram = Vec::new();
    Encoder::new(1, 68).push(&mut datagram, &dialect::RADIO_STATUS_DATA::default());
    let radio = packet(&datagram);
    let mut ours = signing(Policy::Required);
    assert_eq!(ours.check(&plain, NOW), Err(Rejection::Unsigned));
    assert_eq!(ours.check(&radio, NOW), Ok(Origin::Unsigned));
    ours.set_policy(Policy::Optional);
    assert_eq!(ours.check(&plain, NOW), Ok(Origin::Unsigned));
    let mut keyless = Signing::new(None, Policy::Required);
    assert!(!keyless.is_required());
    assert_eq!(keyless.check(&signed(NOW), NOW), Ok(Origin::Unsigned), "nothing to check it with");
}

#[test]
fn what_we_send_is_signed_frame_by_frame_in_time_and_fits_a_datagram() {
    let mut ours = signing(Policy::Optional);
    let mut theirs = signing(Policy::Required);
    let datagrams = ours.sign(heartbeats(60), 0, NOW);
    assert!(datagrams.len() > 1 && datagrams.iter().all(|datagram| datagram.len() <= DATAGRAM));
    let mut decoder = Decoder::default();
    let mut packets = datagrams.iter().flat_map(|datagram| decoder.datagram(datagram));
    assert!(packets.all(|packet| theirs.check(&packet, NOW) == Ok(Origin::Signed)));
    assert_eq!((theirs.accepted(), decoder.counts().frames), (60, 60));
    assert_eq!(Signing::default().sign(heartbeats(2), 0, NOW), [heartbeats(2)]);
}

#[test]
fn a_log_gets_the_frame_without_its_signature() {
    let mut ours = signing(Policy::Optional);
    let datagram = ours.sign(heartbeats(1), 0, NOW).remove(0);
    assert_eq!(strip(&datagram), heartbeats(1));
    assert_eq!(strip(&heartbeats(1)), heartbeats(1));
}

#[test]
fn a_restart_forgets_nothing() {
    let folder = std::env::temp_dir().join(format!("signing-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let store = Store::new(&folder.join("key.toml"));
    assert!(!store.load(Policy::Required).unwrap().is_on(), "no file, no key");
    let mut ours = signing(Policy::Required);
    let frame = signed(NOW);
    ours.check(&frame, NOW).unwrap();
    store.save(&ours, true).unwrap();
    let mut again = store.load(Policy::Required).unwrap();
    assert_eq!(again.check(&frame, NOW), Err(Rejection::Replayed));
    assert_eq!(again.check(&signed(NOW + 1), NOW), Ok(Origin::Signed));
    store.save(&ours, false).unwrap();
    let mut killed = store.load(Policy::Required).unwrap();
    assert_eq!(killed.check(&signed(NOW + UNSAVED), NOW), Err(Rejection::Replayed), "it may have been seen");
    assert_eq!(killed.check(&signed(NOW + UNSAVED + 1), NOW), Ok(Origin::Signed));
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        assert_eq!(std::fs::metadata(store.path()).unwrap().permissions().mode() & 0o777, 0o600);
    }
    for (text, bad) in [
        ("passphrase = \"hello\"\n", false),
        ("key = \"abc\"\n", true),
        ("secret = 1\n", true),
        ("key = \"00\"\npassphrase = \"x\"\n", true),
    ] {
        std::fs::write(store.path(), text).unwrap();
        let loaded = store.load(Policy::Optional);
        assert_eq!(loaded.is_err(), bad, "{text}");
        if let Err(error) = loaded {
            assert!(!error.to_string().contains("abc"), "{error}");
        }
    }
    std::fs::write(store.path(), "passphrase = \"hello\"\n").unwrap();
    assert_eq!(store.load(Policy::Optional).unwrap().key, Some(key()));
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn vehicles_that_share_a_key_keep_their_own_timestamps() {
    let folder = std::env::temp_dir().join(format!("signing-fleet-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let shared = Store::new(&folder.join("key.toml"));
    std::fs::write(shared.path(), "passphrase = \"hello\"\n").unwrap();
    let stores = [1, 2].map(|system| shared.of_system(system));
    assert_eq!(stores[1].path(), folder.join("key.2.toml"));
    assert_eq!(Store::new(Path::new("key")).of_system(2).path(), Path::new("key.2"));
    let [mut one, mut two] = stores.each_ref().map(|store| store.load_or(&shared, Policy::Required).unwrap());
    let frame = signed(NOW);
    one.check(&frame, NOW).unwrap();
    for (store, signing) in stores.iter().zip([&one, &two]) {
        store.save(signing, true).unwrap();
    }
    [one, two] = stores.each_ref().map(|store| store.load_or(&shared, Policy::Required).unwrap());
    assert_eq!(one.check(&frame, NOW), Err(Rejection::Replayed));
    assert_eq!(two.check(&frame, NOW), Ok(Origin::Signed), "it has not heard it yet");
    // A key that one of them got by SETUP_SIGNING stays its own.
    two.set_key(Key::new([7; 32]), 0);
    stores[1].save(&two, true).unwrap();
    let keys = stores.each_ref().map(|store| store.load_or(&shared, Policy::Required).unwrap().key);
    assert_eq!(keys, [Some(key()), Key::new([7; 32])]);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_key_is_never_printed() {
    let text = format!("{:?}", signing(Policy::Required));
    assert!(
        text.contains("Key") && !text.contains(&format!("{:?}", key().0[0])) || key().0[0] == 0,
        "{text}"
    );
    assert!(!text.contains(&to_hex(&key().0)));
}

/// A time stamp of 64 bits in SETUP_SIGNING, and one in the file, overflowed.
#[test]
fn a_time_stamp_beyond_48_bits_is_the_last_one() {
    let mut signing = Signing::new(Key::new([1; 32]), Policy::Optional);
    signing.set_key(Key::new([2; 32]), u64::MAX);
    let mut datagram = Vec::new();
    Encoder::new(1, 1).push(&mut datagram, &dialect::HEARTBEAT_DATA::default());
    for _ in 0..2 {
        assert_eq!(signing.sign(datagram.clone(), 0, 5)[0].len(), datagram.len() + TRAILER);
    }
    assert_eq!(after(u64::MAX, UNSAVED), LAST_STAMP);
}
