//! CRPL on autopilots that are not ours: copies of ArduCopter and PX4 that refuse, wait, lag and time
//! out as the real ones do. Whole flights without a clock, and the real program over TCP and UDP.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use std::time::Duration;

use crpl_gcs::flight::foreign::Foreign;
use crpl_gcs::flight::foreign::guide::{self, Guide, GuideEvent};
use crpl_gcs::station::Station;
use crpl_gcs::tools::identity::Identity;
use crpl_gcs::station::models::Models;
use crpl_gcs::station::pilot::Controller;
use crpl_sitl::Scenario;
use crpl_sitl::sim::metric::{FlightOutcome, Metric};
use tests::fake_autopilot::{Autopilot, Served, Stack};
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

fn story(stacks: (Stack, guide::ForeignStack), mut meddle: impl FnMut(f64, &mut Autopilot, &Guide)) -> Story {
    let scenario = scenario();
    let models = Models::load(None, None).unwrap();
    let mut station = models.station(Controller::Crpl, &scenario).unwrap();
    let mut autopilot = Autopilot::new(stacks.0, [-7.0, 21.0], true);
    let how = Foreign { stack: stacks.1, system: None, speed: 1.0, identity: Identity::default() };
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
                GuideEvent::TakeControl(_) => {}
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
            "--json",
        ];
        let printed = Program::start("gcs", &args, None).unwrap().wait().unwrap().good().unwrap();
        let report: serde_json::Value = serde_json::from_str(&printed).unwrap();
        assert_eq!(report["flights"][0]["reached"], true, "{name}: {report}");
        assert_eq!(report["flights"][0]["taken_over"], false, "{name}: {report}");
        let hold = if name == "px4" { 4 << 16 | 3 << 24 } else { 17 };
        assert_eq!(served.with(|autopilot| autopilot.mode()), hold, "{name} holds its place");
        assert!(served.with(|autopilot| !autopilot.poisoned), "{name}");
    }
}
