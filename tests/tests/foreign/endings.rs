//! How a flight on a foreign autopilot ends if nobody wanted it to, and what is said when it does not begin.

use std::net::UdpSocket;

use crpl_gcs::flight::FlightEnd;
use crpl_gcs::flight::foreign::guide::{self, GuideEvent};
use tests::fake_autopilot::{Autopilot, Served, Stack};
use tests::program::{self, Program};

use super::{Story, story, story_of};

/// A flight in whose middle something happens to the vehicle, once.
fn story_in_flight(stacks: (Stack, guide::ForeignStack), mut what: impl FnMut(&mut Autopilot)) -> Story {
    let mut done = false;
    story(stacks, |_, autopilot, _| {
        if !done && autopilot.accelerations > 100 {
            done = true;
            what(autopilot);
        }
    })
}

const COPTER: (Stack, guide::ForeignStack) = (Stack::ArduPilot, guide::ForeignStack::Ardupilot);
const PX4: (Stack, guide::ForeignStack) = (Stack::Px4, guide::ForeignStack::Px4);

/// Report A10: failsafes were "the operator has taken over". The vehicle says which one it was, and long texts come
/// in parts.
#[test]
fn a_failsafe_of_radio_battery_fence_or_gps_is_told_and_not_the_operator_s_doing() {
    const RTL: [u32; 2] = [6, 4 << 16 | 5 << 24];
    const LAND: [u32; 2] = [9, 4 << 16 | 6 << 24];
    for (stacks, text, mode) in [
        (COPTER, "Radio Failsafe", RTL[0]),
        (COPTER, "Battery 1 low 10.20V used 1800 mAh", RTL[0]),
        (COPTER, "Battery Failsafe", RTL[0]),
        (COPTER, "Fence Breached", 17),
        (COPTER, "GCS Failsafe", RTL[0]),
        (COPTER, "EKF Failsafe: changed to LAND Mode", LAND[0]),
        (COPTER, "GPS Glitch or Compass error", LAND[0]),
        (
            COPTER,
            "The vehicle changes to LAND because of what its estimate of its place says: EKF variance",
            LAND[0],
        ),
        (PX4, "Manual control lost", RTL[1]),
        (PX4, "Failsafe activated: Autopilot disengaged, switching to Return", RTL[1]),
        (PX4, "Connection to ground control station lost", RTL[1]),
        (PX4, "No valid position estimate", LAND[1]),
        (PX4, "Low battery level, return advised", RTL[1]),
    ] {
        let story = story_in_flight(stacks, |autopilot| {
            autopilot.set_mode(mode);
            autopilot.shout(text);
        });
        let GuideEvent::Failsafe(why) = &story.end else { panic!("{text}: {:?}", story.end) };
        assert!(why.contains(text), "{why}");
    }
    assert_eq!(FlightEnd::Failsafe.exit_code(), Some(8));
}

/// Of the same kind: a vehicle that changes its mode without a text, in distress by its heartbeat.
#[test]
fn a_vehicle_in_distress_acts_by_itself_even_if_it_says_nothing() {
    let story = story_in_flight(COPTER, |autopilot| {
        autopilot.set_mode(6);
        autopilot.distress = true;
    });
    let GuideEvent::Failsafe(why) = &story.end else { panic!("{:?}", story.end) };
    assert!(why.contains("GUIDED to RTL; its heartbeat says that it is in distress"), "{why}");
    // In distress since long, but an operator's hand.
    let mut begun = None;
    let mut taken = false;
    let story = story_of(Autopilot::new(COPTER.0, [-7.0, 21.0], true), COPTER.1, |now, autopilot, _| {
        autopilot.distress = true;
        if autopilot.accelerations > 100 && now > *begun.get_or_insert(now) + 8.0 && !taken {
            taken = true;
            autopilot.set_mode(5);
        }
    });
    assert!(matches!(story.end, GuideEvent::TakenOver(_)), "{:?}", story.end);
}

/// Report A10: a crash with a forced disarming was "the operator has taken over", exit code 0.
#[test]
fn motors_that_stop_in_the_air_are_a_crash() {
    for (stacks, text) in [(COPTER, "Crash: Disarming: AngErr=89>30, Accel=1.9<3.0"), (COPTER, ""), (PX4, "")]
    {
        let story = story_in_flight(stacks, |autopilot| {
            autopilot.disarm();
            if !text.is_empty() {
                autopilot.shout(text);
            }
        });
        let GuideEvent::Crashed(why) = &story.end else { panic!("{text}: {:?}", story.end) };
        assert!(
            why.contains("disarmed") && why.contains("m above the ground") && why.contains(text),
            "{why}"
        );
    }
    // A mode of its own first, and disarmed while it is still high.
    let story = story_in_flight(COPTER, |autopilot| {
        autopilot.set_mode(9);
        autopilot.disarm();
    });
    assert!(matches!(story.end, GuideEvent::Crashed(_)), "{:?}", story.end);
    assert_eq!(FlightEnd::Crashed.exit_code(), Some(10));
}

/// Report A10: a restart in flight was "the operator has taken over", exit code 0.
#[test]
fn a_restart_in_flight_is_a_restart() {
    for stacks in [COPTER, PX4] {
        let story = story_in_flight(stacks, Autopilot::restart);
        let GuideEvent::Failed(FlightEnd::Rebooted, why) = &story.end else { panic!("{:?}", story.end) };
        assert!(why.contains("has started anew in flight"), "{why}");
    }
    assert_eq!(FlightEnd::Rebooted.exit_code(), Some(5));
}

/// Report A10: 90 s of silence without GPS.
#[test]
fn without_gps_it_is_said_every_ten_seconds_what_is_waited_for() {
    let mut autopilot = Autopilot::new(Stack::ArduPilot, [0.0; 2], false);
    autopilot.blind = true;
    let story = story_of(autopilot, guide::ForeignStack::Ardupilot, |now, autopilot, _| {
        if now > 15.0 && now < 15.02 {
            autopilot.shout("PreArm: GPS 1: Bad fix");
        }
    });
    let GuideEvent::Failed(_, why) = &story.end else { panic!("{:?}", story.end) };
    assert!(why.contains("does not say where it is") && why.contains("GPS 1: Bad fix"), "{why}");
    let waiting =
        story.said.iter().filter(|said| said.contains("still waiting: the vehicle does not say where"));
    assert!(waiting.count() >= 7, "{:?}", story.said);
}

/// Report A10: a foreign flight's log had no attitude, no battery and no GPS.
#[test]
fn a_foreign_flight_asks_for_what_its_log_needs() {
    for stacks in [COPTER, PX4] {
        let story = story(stacks, |_, _, _| {});
        let asked: Vec<u32> = story.autopilot.logged.keys().copied().collect();
        for (id, name) in [(30, "ATTITUDE"), (24, "GPS_RAW_INT"), (1, "SYS_STATUS"), (147, "BATTERY_STATUS")]
        {
            assert!(asked.contains(&id), "{name}: {asked:?}");
        }
    }
    // And has it, to the disk.
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(Autopilot::new(Stack::ArduPilot, [3.0, -4.0], false), 8.0).unwrap();
    let out = folder.path().join("flight");
    let endpoint = served.endpoint(Stack::ArduPilot);
    let args =
        ["fly", "--vehicle", "ardupilot", "--connect", &endpoint, "--speed", "8", "--ticks", "20", "--out"];
    program::run("gcs", &[&args[..], &[out.to_str().unwrap()]].concat()).unwrap().good().unwrap();
    let info = program::run("gcs", &["tlog", "info", out.join("flight.tlog").to_str().unwrap()]);
    let info = info.unwrap().good().unwrap();
    for name in ["ATTITUDE", "GPS_RAW_INT", "SYS_STATUS", "BATTERY_STATUS", "LOCAL_POSITION_NED"] {
        assert!(info.contains(name), "{name}: {info}");
    }
}

/// Report A10: a wrong key was "no vehicle heard".
#[test]
fn a_wrong_or_missing_key_is_told_on_a_foreign_flight() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for name in ["theirs", "ours"] {
        program::run("gcs", &["key", "new", &file(name)]).unwrap().good().unwrap();
    }
    let (theirs, ours) = (file("theirs"), file("ours"));
    for (key, words) in [
        (&["--signing-key", &ours][..], "packets have come whose signatures do not fit the key"),
        (&[], "its packets are signed: it may want signatures (--signing-key)"),
    ] {
        let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let vehicle = format!("udpout:127.0.0.1:{port}");
        let args =
            ["--connect", &vehicle, "--pace", "realtime", "--signing-key", &theirs, "--signing", "required"];
        let sitl = Program::start("sitl", &args, None).unwrap();
        let station = format!("udpin:127.0.0.1:{port}");
        let args = ["fly", "--vehicle", "ardupilot", "--connect", &station, "--speed", "15", "--out"];
        let out = file(&format!("flight-{}", key.len()));
        let finished = program::run("gcs", &[&args[..], &[&out], key].concat()).unwrap();
        assert_eq!(finished.status.code(), Some(1), "{}", finished.stderr);
        assert!(finished.stderr.contains(words), "{}", finished.stderr);
        sitl.interrupt().unwrap();
        sitl.wait().unwrap();
    }
}
