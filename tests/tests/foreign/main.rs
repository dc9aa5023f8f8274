//! CRPL on autopilots that are not ours: copies of ArduCopter and PX4 that refuse, wait, lag and time
//! out as the real ones do. Whole flights without a clock, and the real program over TCP and UDP.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

mod endings;

use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use crpl_gcs::flight::FlightEnd;
use crpl_gcs::flight::foreign::Foreign;
use crpl_gcs::flight::foreign::field::{FieldFrame, WhenOver};
use crpl_gcs::flight::foreign::guide::{self, Guide, GuideEvent};
use crpl_gcs::station::Station;
use crpl_gcs::station::models::Models;
use crpl_gcs::station::pilot::Controller;
use crpl_sitl::Scenario;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{COMMAND_LONG_DATA, MavCmd};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::command::CommandAck;
use crpl_sitl::link::messages::telemetry::LocalPositionNed;
use crpl_sitl::link::packet::Packet;
use crpl_sitl::sim::metric::{FlightOutcome, Metric};
use crpl_sitl::vehicle::geodesy::Site;
use tests::fake_autopilot::{Autopilot, Served, Stack};
use tests::fake_params::FakeParams;
use tests::program::{self, Program};

const STACKS: [(Stack, guide::ForeignStack, &str); 2] = [
    (Stack::ArduPilot, guide::ForeignStack::Ardupilot, "ardupilot"),
    (Stack::Px4, guide::ForeignStack::Px4, "px4"),
];

const CONFIG: &str = "configs/foreign.toml";

fn scenario() -> Scenario {
    Scenario::load(&program::workspace().join(CONFIG)).unwrap()
}

/// One whole flight on the vehicle's clock. `meddle` may touch the vehicle, at each time in seconds.
struct Story {
    autopilot: Autopilot,
    station: Station,
    said: Vec<String>,
    end: GuideEvent,
    setpoints_per_s: f64,
}

fn story(stacks: (Stack, guide::ForeignStack), meddle: impl FnMut(f64, &mut Autopilot, &Guide)) -> Story {
    story_of(Autopilot::new(stacks.0, [-7.0, 21.0], true), stacks.1, meddle)
}

fn story_of(
    autopilot: Autopilot,
    stack: guide::ForeignStack,
    meddle: impl FnMut(f64, &mut Autopilot, &Guide),
) -> Story {
    story_with(autopilot, Foreign::new(stack), meddle)
}

fn story_with(
    mut autopilot: Autopilot,
    how: Foreign,
    mut meddle: impl FnMut(f64, &mut Autopilot, &Guide),
) -> Story {
    let scenario = scenario();
    let models = Models::load(None, None).unwrap();
    let mut station = models.station(Controller::Crpl, &scenario).unwrap();
    let mut guide = Guide::new(scenario.clone(), &how, scenario.horizon);
    let (mut said, mut flying) = (Vec::new(), None);
    for k in 0_u32..30_000 {
        let now = Duration::from_millis(10) * k;
        guide.datagram(&autopilot.advance(now.as_secs_f64(), 1.0), now);
        meddle(now.as_secs_f64(), &mut autopilot, &guide);
        if guide.due() > now {
            continue;
        }
        autopilot.datagram(&guide.poll(now));
        while let Some(event) = guide.take() {
            match event {
                GuideEvent::Say(text) => said.push(text),
                GuideEvent::TakeControl(_) | GuideEvent::Located(_) => {}
                GuideEvent::Percept(percept) => {
                    flying.get_or_insert(now);
                    let command = station.handle(&percept);
                    autopilot.datagram(&guide.fly(&command, now));
                }
                GuideEvent::Over(percept) => station.finish(&percept),
                end => {
                    let flown = flying.map_or(f64::INFINITY, |from| (now - from).as_secs_f64());
                    let setpoints_per_s = autopilot.accelerations as f64 / flown;
                    return Story { autopilot, station, said, end, setpoints_per_s };
                }
            }
        }
    }
    panic!("the flight hangs: {said:?}");
}

#[test]
fn crpl_reaches_its_goal_on_both() {
    for (fake, stack, name) in STACKS {
        let story = story((fake, stack), |_, _, _| {});
        assert!(matches!(story.end, GuideEvent::Holding), "{name}: {:?} {:?}", story.end, story.said);
        let score = story.station.score().unwrap();
        assert!(score.is(FlightOutcome::Reached), "{name}: {score:?}");
        assert!(score[Metric::CollisionProbability] < 0.2, "{name}: {score:?}");
        assert_eq!(score.ticks, scenario().horizon);
        assert!(!story.autopilot.poisoned && !story.autopilot.starved, "{name}");
        // PX4 wants more than two setpoints a second.
        assert!(story.setpoints_per_s > 10.0, "{name}: {}", story.setpoints_per_s);
        let height = -story.autopilot.position()[2];
        assert!((height - scenario().scale.altitude_m).abs() < 1.0, "{name} ends at {height} m");
        // The radio hears a level with every command.
        assert_eq!(story.autopilot.powers.len() as u64, score.ticks, "{name}");
    }
}

#[test]
fn what_the_autopilots_refuse_is_asked_again_and_told() {
    let said = story((Stack::ArduPilot, guide::ForeignStack::Ardupilot), |_, _, _| {}).said.join("\n");
    assert!(said.contains("vehicle 1 found: ArduPilot, STABILIZE, disarmed"), "{said}");
    assert!(said.contains("arming failed: Arm: Accels calibrating"), "{said}");
}

#[test]
fn a_pilot_s_hand_ends_the_setpoints() {
    for ((fake, stack, name), mode, word) in
        [(STACKS[0], 5, "GUIDED to LOITER"), (STACKS[1], 3 << 16, "OFFBOARD to POSCTL")]
    {
        let (mut taken, mut after) = (None, None);
        let story = story((fake, stack), |now, autopilot, _| {
            if taken.is_none() && autopilot.accelerations > 100 {
                taken = Some(now);
                autopilot.set_mode(mode);
            }
            if taken.is_some_and(|at| now > at + 1.5) {
                after.get_or_insert(autopilot.accelerations);
            }
        });
        let GuideEvent::TakenOver(why) = &story.end else { panic!("{name}: {:?}", story.end) };
        assert!(why.contains(word), "{name}: {why}");
        assert_eq!(after.unwrap_or(story.autopilot.accelerations), story.autopilot.accelerations, "{name}");
    }
}

/// Report A1: from 0.15 s of delay the flight was unstable, and from 0.2 s ArduCopter flew through the obstacle.
#[test]
fn a_radio_s_delay_and_jitter_keep_the_flight_stable() {
    let limit = scenario().dynamics.v_max * scenario().scale.mps_per_speed();
    for (fake, stack, name) in STACKS {
        for (delay, more) in [(0.1, 0.0), (0.15, 0.0), (0.2, 0.0), (0.3, 0.0), (0.0, 0.3)] {
            let autopilot = Autopilot::new(fake, [-7.0, 21.0], true).delayed(delay, more);
            let story = story_of(autopilot, stack, |_, _, _| {});
            let what = format!("{name}, {delay} s and {more} s: {:?} {:?}", story.end, story.said);
            assert!(matches!(story.end, GuideEvent::Holding), "{what}");
            let score = story.station.score().unwrap();
            assert!(score.is(FlightOutcome::Reached), "{what} {score:?}");
            assert!(score[Metric::CollisionProbability] < 0.2, "{what} {score:?}");
            assert!(story.autopilot.fastest < 1.25 * limit, "{what}: {} m/s", story.autopilot.fastest);
            let [low, high] = story.autopilot.heights.map(|h| (h - scenario().scale.altitude_m).abs());
            assert!(low < 1.5 && high < 1.5, "{what}: heights {:?}", story.autopilot.heights);
        }
    }
}

/// Report A1: a link beyond what is stable is refused before the vehicle moves.
#[test]
fn a_link_of_seconds_is_refused_on_the_ground() {
    // Every other datagram 0.8 s late, and none overtaken: all are nearly as late.
    for (delay, more, trip) in [(0.8, 0.0, "1.6"), (0.0, 0.8, "1.5")] {
        let autopilot = Autopilot::new(Stack::ArduPilot, [0.0; 2], false).delayed(delay, more);
        let story = story_of(autopilot, guide::ForeignStack::Ardupilot, |_, _, _| {});
        let GuideEvent::Failed(_, why) = &story.end else { panic!("{:?}", story.end) };
        assert!(why.contains(&format!("the link's round trip is {trip}")), "{why}");
        assert_eq!(story.autopilot.position()[2], 0.0);
    }
}

/// Report A2: BRAKE, RTL, LAND or LOITER of another station during the climb were ignored.
#[test]
fn a_mode_that_is_changed_during_the_climb_ends_the_flight() {
    for mode in [17, 6, 9, 5] {
        let mut taken = None;
        let story = story((Stack::ArduPilot, guide::ForeignStack::Ardupilot), |now, autopilot, _| {
            if taken.is_none() && autopilot.position()[2] < -3.0 {
                taken = Some(now);
                autopilot.set_mode(mode);
            }
        });
        assert!(matches!(story.end, GuideEvent::TakenOver(_)), "{mode}: {:?}", story.end);
        assert_eq!(story.autopilot.accelerations, 0, "{mode}");
        assert_eq!(story.autopilot.mode(), mode);
    }
}

/// Report A6: a field whose upper edge is not north, and another end than BRAKE.
#[test]
fn a_field_lies_as_it_is_told_and_the_flight_ends_as_it_is_told() {
    for (fake, stack, name) in STACKS {
        for (over, mode) in
            [(WhenOver::Land, [9, 4 << 16 | 6 << 24]), (WhenOver::Rtl, [6, 4 << 16 | 5 << 24])]
        {
            let (field, start) = (FieldFrame::heading(90.0), [-7.0, 21.0]);
            let how = Foreign { field, over, ..Foreign::new(stack) };
            let story = story_with(Autopilot::new(fake, start, true), how, |_, _, _| {});
            assert!(matches!(story.end, GuideEvent::Holding), "{name}: {:?} {:?}", story.end, story.said);
            let score = story.station.score().unwrap();
            assert!(score.is(FlightOutcome::Reached), "{name}: {score:?}");
            // Right is south, up is east.
            let scenario = scenario();
            let way = (scenario.goal - scenario.start) * scenario.scale.metres_per_unit;
            let [north, east, _] = story.autopilot.position();
            let missed = (north - (start[0] - way.x)).hypot(east - (start[1] + way.y));
            assert!(missed < 4.0, "{name}: {missed} m from the goal");
            assert_eq!(story.autopilot.mode(), mode[usize::from(fake == Stack::Px4)], "{name}");
            assert!(
                story.said.iter().any(|text| text.contains("up is 90 degrees")),
                "{name}: {:?}",
                story.said
            );
        }
    }
}

/// The milliseconds of a vehicle that has run for 49.7 days begin at 0 again: that is no restart.
#[test]
fn a_flight_goes_on_when_the_vehicle_s_stamps_come_round() {
    let mut autopilot = Autopilot::new(Stack::ArduPilot, [-7.0, 21.0], true);
    autopilot.clock_ahead_ms = u32::MAX - 40_000;
    let story = story_of(autopilot, guide::ForeignStack::Ardupilot, |_, _, _| {});
    assert!(matches!(story.end, GuideEvent::Holding), "{:?} {:?}", story.end, story.said);
    let score = story.station.score().unwrap();
    assert!(score.is(FlightOutcome::Reached) && score.ticks == scenario().horizon, "{score:?}");
}

/// A clock that is set by months in flight was followed, interval by interval.
#[test]
fn a_clock_that_is_set_in_flight_ends_it() {
    let story = story((Stack::ArduPilot, guide::ForeignStack::Ardupilot), |_, autopilot, _| {
        if autopilot.accelerations > 100 {
            autopilot.clock_ahead_ms = 2_000_000_000;
        }
    });
    let GuideEvent::Failed(FlightEnd::Rebooted, why) = &story.end else { panic!("{:?}", story.end) };
    assert!(why.contains("clock was set"), "{why}");
}

/// Report A7: a slow controller left the vehicle without a setpoint for 3 s, at 8.8 m/s.
#[test]
fn a_late_decision_keeps_the_setpoints_coming_and_the_vehicle_brakes() {
    let scenario = scenario();
    let models = Models::load(None, None).unwrap();
    let mut station = models.station(Controller::Crpl, &scenario).unwrap();
    let mut autopilot = Autopilot::new(Stack::ArduPilot, [0.0; 2], false);
    let stack = guide::ForeignStack::Ardupilot;
    let how = Foreign::new(stack);
    let mut guide = Guide::new(scenario.clone(), &how, scenario.horizon);
    // The fifth decision takes six seconds.
    let (mut asked, mut held, mut during) = (0, None, None);
    let (mut slowest, mut after) = (f64::INFINITY, 0);
    for k in 0_u32..6_000 {
        let now = Duration::from_millis(10) * k;
        guide.datagram(&autopilot.advance(now.as_secs_f64(), 1.0), now);
        if let Some((since, percept)) = held.take_if(|(since, _)| now > *since + Duration::from_secs(6)) {
            let _: Duration = since;
            during = Some(autopilot.accelerations - during.unwrap_or(0));
            slowest = autopilot.speed();
            autopilot.datagram(&guide.fly(&station.handle(&percept), now));
        }
        autopilot.datagram(&guide.poll(now));
        while let Some(event) = guide.take() {
            let GuideEvent::Percept(percept) = event else { continue };
            asked += 1;
            if asked == 5 {
                during = Some(autopilot.accelerations);
                held = Some((now, percept));
            } else {
                after += u32::from(asked > 5);
                autopilot.datagram(&guide.fly(&station.handle(&percept), now));
            }
        }
    }
    assert!(during.unwrap() > 60, "{during:?} setpoints in 6 s");
    assert!(slowest < 0.3, "{slowest} m/s");
    assert!(after > 3, "the flight goes on: {after}");
}

/// Report A9: "takeoff failed" for 90 s on a vehicle that flew already.
#[test]
fn a_vehicle_that_flies_already_is_brought_to_its_height() {
    let autopilot = Autopilot::new(Stack::ArduPilot, [2.0, 3.0], true).airborne(6.0);
    let story = story_of(autopilot, guide::ForeignStack::Ardupilot, |_, _, _| {});
    assert!(matches!(story.end, GuideEvent::Holding), "{:?} {:?}", story.end, story.said);
    assert!(story.station.score().unwrap().is(FlightOutcome::Reached));
    assert!(story.said.iter().any(|said| said.contains("it flies already, 6.0 m")), "{:?}", story.said);
}

/// Report A8: three seconds of silence ended the flight without BRAKE.
#[test]
fn a_vehicle_that_no_longer_says_where_it_is_is_told_to_hold_its_place() {
    let story = story((Stack::ArduPilot, guide::ForeignStack::Ardupilot), |_, autopilot, _| {
        if autopilot.accelerations > 100 {
            autopilot.hush();
        }
    });
    let GuideEvent::Failed(_, why) = &story.end else { panic!("{:?}", story.end) };
    assert!(why.contains("has not said where it is for 3 s; it holds its place"), "{why}");
    assert_eq!(story.autopilot.mode(), 17);
}

/// Report A5: Ctrl-C sent BRAKE once, which got lost in 5 of 7 runs.
#[test]
fn ctrl_c_asks_for_brake_until_it_is_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    for signal in ["-INT", "-TERM"] {
        let served = Served::start(Autopilot::new(Stack::ArduPilot, [3.0, -4.0], false), 8.0).unwrap();
        let (endpoint, out) = (served.endpoint(Stack::ArduPilot), folder.path().join(signal));
        let out = out.to_str().unwrap();
        let args = ["fly", "--vehicle", "ardupilot", "--connect", &endpoint, "--speed", "8", "--out", out];
        let gcs = Program::start("gcs", &args, None).unwrap();
        gcs.logs("at its height: CRPL flies").unwrap();
        served.with(|autopilot| autopilot.deaf_to_modes = 2);
        gcs.signal(signal).unwrap();
        let finished = gcs.wait().unwrap();
        assert!(finished.stderr.contains("the vehicle holds its place"), "{}", finished.stderr);
        assert_eq!(served.with(|autopilot| autopilot.mode()), 17);
    }
}

/// Report A3: whoever took over behind `--forward` lost the vehicle in that moment, even the answer to his command.
#[test]
fn who_takes_over_behind_a_flight_keeps_the_vehicle() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(Autopilot::new(Stack::ArduPilot, [3.0, -4.0], false), 8.0).unwrap();
    let operator = UdpSocket::bind("127.0.0.1:0").unwrap();
    operator.set_read_timeout(Some(program::PATIENCE)).unwrap();
    let endpoint = served.endpoint(Stack::ArduPilot);
    let forward = format!("udpout:{}", operator.local_addr().unwrap());
    let out = folder.path().join("flight");
    let args = ["fly", "--vehicle", "ardupilot", "--connect", &endpoint, "--speed", "8"];
    let args = [&args[..], &["--out", out.to_str().unwrap(), "--forward", &forward]].concat();
    let gcs = Program::start("gcs", &args, None).unwrap();
    gcs.logs("at its height: CRPL flies").unwrap();
    let (mut decoder, mut encoder, mut buffer) = (Decoder::default(), Encoder::new(254, 190), [0; 65_536]);
    let mut ask = Vec::new();
    let loiter = COMMAND_LONG_DATA {
        command: MavCmd::MAV_CMD_DO_SET_MODE,
        param1: 1.0,
        param2: 5.0,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    };
    encoder.push(&mut ask, &loiter);
    let mut hear = |wanted: &mut dyn FnMut(&Packet, SocketAddr) -> bool| loop {
        let (length, from) = operator.recv_from(&mut buffer).unwrap();
        if decoder.datagram(&buffer[..length]).iter().any(|packet| wanted(packet, from)) {
            return;
        }
    };
    hear(&mut |packet, from| {
        operator.send_to(&ask, from).unwrap();
        packet.system == 1
    });
    hear(&mut |packet, _| {
        CommandAck::of(packet).is_some_and(|ack| ack.command == 176 && ack.target.system == 254)
    });
    gcs.logs("messages are passed on until").unwrap();
    let mut places = 0;
    hear(&mut |packet, _| {
        places += u32::from(LocalPositionNed::of(packet).is_some());
        places > 50
    });
    served.with(Autopilot::disarm);
    let finished = gcs.wait().unwrap();
    assert_eq!(finished.status.code(), Some(4), "{}", finished.stderr);
    assert_eq!(served.with(|autopilot| autopilot.mode()), 5);
}

/// Report A11: parameters that a switch brings needed a second load of the same file.
#[test]
fn parameters_behind_switches_are_loaded_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(Autopilot::new(Stack::ArduPilot, [0.0, 0.0], false), 1.0).unwrap();
    let file = folder.path().join("rangefinder.param");
    std::fs::write(&file, "RNGFND1_MIN,0.5\nRNGFND1_MAX,9\nRNGFND1_TYPE,8\nWPNAV_SPEED,300\n").unwrap();
    let endpoint = served.endpoint(Stack::ArduPilot);
    let args = ["param", "--connect", &endpoint, "load", file.to_str().unwrap()];
    let said = program::run("gcs", &args).unwrap().good().unwrap();
    assert!(said.contains("4 set, 0 as they were, 0 refused"), "{said}");
}

/// Report A6: a configuration of the project's own climbed to 100 m and flew 390 m away, without a word.
#[test]
fn a_large_flight_needs_a_yes_and_says_where_it_goes() {
    let large = ["fly", "--vehicle", "ardupilot", "--connect", "udpout:127.0.0.1:9", "--scenario"];
    let refused = program::run("gcs", &[&large[..], &["configs/scenario2.toml"]].concat()).unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        refused.stderr.contains("would climb to 100 m") && refused.stderr.contains("--yes"),
        "{refused:?}"
    );
    let dry =
        program::run("gcs", &[&large[..], &["foreign", "--dry-run", "--altitude", "7"]].concat()).unwrap();
    assert!(dry.good().unwrap().contains("would climb to 7 m and fly in a square of 60 m"));
}

/// Report A6: what the vehicle allows by its own parameters and fence was not looked at.
#[test]
fn a_flight_beyond_the_vehicle_s_own_limits_is_refused_before_it_is_armed() {
    let (copter, px4) = (FakeParams::ardupilot(), FakeParams::px4());
    let fenced = copter.clone().with("FENCE_ENABLE", 1.0);
    for (at, params, why) in [
        (
            0,
            copter.clone().with("WPNAV_SPEED", 150.0),
            "largest speed is 2.0 m/s, above the vehicle's WPNAV_SPEED of 1.5",
        ),
        (0, copter.clone().renamed().with("WP_SPD", 1.5), "above the vehicle's WP_SPD of 1.5 m/s"),
        (0, copter.clone().with("WPNAV_ACCEL", 10.0), "above the vehicle's WPNAV_ACCEL of 0.1 m/s²"),
        (0, fenced.clone().with("FENCE_ALT_MAX", 12.0), "above the vehicle's FENCE_ALT_MAX of 12.0 m"),
        (0, fenced.with("FENCE_RADIUS", 30.0), "above the vehicle's FENCE_RADIUS of 30.0 m"),
        (1, px4.clone().with("MPC_XY_VEL_MAX", 1.0), "above the vehicle's MPC_XY_VEL_MAX of 1.0 m/s"),
        (1, px4.clone().with("MPC_TILTMAX_AIR", 0.5), "above the vehicle's MPC_TILTMAX_AIR of 0.5 degrees"),
        (1, px4.clone().with("GF_MAX_VER_DIST", 9.0), "above the vehicle's GF_MAX_VER_DIST of 9.0 m"),
        (1, px4.with("GF_MAX_HOR_DIST", 20.0), "above the vehicle's GF_MAX_HOR_DIST of 20.0 m"),
    ] {
        let (fake, stack, _) = STACKS[at];
        let mut autopilot = Autopilot::new(fake, [-7.0, 21.0], true);
        autopilot.params = params;
        let mut armed = false;
        let story = story_of(autopilot, stack, |_, autopilot, _| armed |= autopilot.is_armed());
        let GuideEvent::Failed(_, told) = &story.end else { panic!("{why}: {:?}", story.end) };
        assert!(told.contains(why) && told.contains("before the vehicle is armed"), "{why}: {told}");
        assert!(!armed, "{why}");
        assert!(
            story.said.iter().any(|said| said.contains("the vehicle's own limits: ")),
            "{:?}",
            story.said
        );
    }
}

#[test]
fn a_fence_that_is_off_and_limits_that_nobody_tells_stop_no_flight() {
    let off = FakeParams::ardupilot().with("FENCE_ALT_MAX", 1.0).with("FENCE_RADIUS", 1.0);
    for (params, word) in
        [(off, "no fence"), (FakeParams::ardupilot().silent(), "the vehicle does not tell its limits")]
    {
        let mut autopilot = Autopilot::new(Stack::ArduPilot, [-7.0, 21.0], true);
        autopilot.params = params;
        let story = story_of(autopilot, guide::ForeignStack::Ardupilot, |_, _, _| {});
        assert!(matches!(story.end, GuideEvent::Holding), "{word}: {:?}", story.end);
        assert!(story.said.iter().any(|said| said.contains(word)), "{word}: {:?}", story.said);
    }
}

#[test]
fn a_field_lies_at_its_origin_and_the_vehicle_flies_to_its_start_first() {
    for (fake, stack, name) in STACKS {
        let how = Foreign { origin: Some([-20.0, 10.0]), ..Foreign::new(stack) };
        let start = scenario().scale.ned_from_paper(scenario().start);
        let start = [f64::from(start[0]) - 20.0, f64::from(start[1]) + 10.0];
        let mut began = None;
        let story = story_with(Autopilot::new(fake, [-7.0, 21.0], true), how, |_, autopilot, _| {
            if autopilot.accelerations == 1 {
                began.get_or_insert(autopilot.position());
            }
        });
        assert!(matches!(story.end, GuideEvent::Holding), "{name}: {:?} {:?}", story.end, story.said);
        assert!(story.station.score().unwrap().is(FlightOutcome::Reached), "{name}");
        let [north, east, _] = began.unwrap();
        assert!(
            (north - start[0]).hypot(east - start[1]) < 1.0,
            "{name} began at {north}, {east}: {start:?}"
        );
    }
}

/// Report A1, A6: there was no limit on the height.
#[test]
fn a_vehicle_that_leaves_its_height_is_stopped() {
    for (fake, stack, name) in STACKS {
        let mut blown = false;
        let story = story((fake, stack), |_, autopilot, _| {
            if autopilot.accelerations > 100 && !std::mem::replace(&mut blown, true) {
                autopilot.lift(6.0);
            }
        });
        assert!(matches!(story.end, GuideEvent::Holding), "{name}: {:?}", story.end);
        let told = story.said.iter().any(|said| said.contains("m from its height: it is stopped"));
        assert!(told, "{name}: {:?}", story.said);
        assert!(story.station.score().unwrap().ticks < scenario().horizon, "{name}");
    }
}

#[test]
fn the_wrong_stack_is_told() {
    let story = story((Stack::Px4, guide::ForeignStack::Ardupilot), |_, _, _| {});
    let GuideEvent::Failed(_, why) = &story.end else { panic!("{:?}", story.end) };
    assert_eq!(why, "vehicle 1 found: PX4, LOITER, disarmed, and not what --vehicle ardupilot flies");
}

/// The real program, eight times faster than real time; where the clock decides, only that it arrives.
#[test]
fn gcs_flies_both_over_their_own_transports() {
    let folder = tempfile::tempdir().unwrap();
    let town = folder.path().join("town.geojson");
    let ring = "[[8.5456,47.3977],[8.5457,47.3977],[8.5457,47.3978],[8.5456,47.3977]]";
    std::fs::write(&town, format!(r#"{{"type":"Polygon","coordinates":[{ring}]}}"#)).unwrap();
    for (fake, _, name) in STACKS {
        let served = Served::start(Autopilot::new(fake, [3.0, -4.0], false), 8.0).unwrap();
        let out = folder.path().join(name);
        let (endpoint, out) = (served.endpoint(fake), out.to_str().unwrap());
        let args = [
            "fly",
            "--vehicle",
            name,
            "--connect",
            &endpoint,
            "--scenario",
            CONFIG,
            "--speed",
            "8",
            "--out",
            out,
            "--watch",
            "--buildings",
            town.to_str().unwrap(),
            "--json",
        ];
        let printed = Program::start("gcs", &args, None).unwrap().wait().unwrap().good().unwrap();
        let report: serde_json::Value = serde_json::from_str(&printed).unwrap();
        assert_eq!(report["flights"][0]["reached"], true, "{name}: {report}");
        assert_eq!(report["flights"][0]["taken_over"], false, "{name}: {report}");
        let hold = if name == "px4" { 4 << 16 | 3 << 24 } else { 17 };
        assert_eq!(served.with(|autopilot| autopilot.mode()), hold, "{name} holds its place");
        assert!(served.with(|autopilot| !autopilot.poisoned), "{name}");
        assert_lies_on_earth(&folder.path().join(name));
    }
}

/// The flight's page has the field where the vehicle's local frame is, and the buildings.
fn assert_lies_on_earth(run: &std::path::Path) {
    let html = std::fs::read_to_string(run.join("flight.html")).unwrap();
    let lines = crpl_gcs::watch::document::lines_of(&html).unwrap();
    let lines: Vec<serde_json::Value> =
        lines.iter().map(|line| serde_json::from_str(line).unwrap()).collect();
    let geo = lines.iter().find(|line| line["kind"] == "geo").expect("a geo line");
    assert_eq!(geo["buildings"]["coordinates"][0][0].as_array().map(Vec::len), Some(4), "{geo}");
    let degrees = |k: usize| geo["origin"][k].as_f64().unwrap();
    let [lat, lon] = Site::default().latitude_longitude([0.0; 2]).map(|e7| f64::from(e7) * 1e-7);
    let metres = [degrees(0) - lat, degrees(1) - lon].map(|degrees| degrees.to_radians() * 6.378e6);
    // The field's corner is its start's coordinates away from where the vehicle took off.
    assert!(metres[0].hypot(metres[1]) < 100.0 && metres != [0.0; 2], "{metres:?}");
}
