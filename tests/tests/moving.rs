//! Obstacles that move, one to three: CRPL in receding horizon copes with two from frames alone, in
//! process and over UDP; a third one is a TOML.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use std::path::{Path, PathBuf};

use crpl_gcs::lab::run_folder;
use crpl_gcs::lab::{self, Contender};
use crpl_gcs::station::models::{MismatchRule, Models};
use crpl_gcs::station::pilot::Controller;
use crpl_sitl::sim::metric::{FlightOutcome, FlightScore, Metric};
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::Tick;
use crpl_sitl::world::noise::{Noise, Stream};
use crpl_sitl::{Scenario, Sim, camera};
use nalgebra::Vector2;
use tests::program;

const FLIGHTS: u64 = 4;

/// The shipped models; crpl flies its policies in worlds that they were not made for.
fn models() -> Models {
    Models { mismatch: MismatchRule::Allow, ..Models::load(None, None).unwrap() }
}

fn config(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs").join(name)
}

fn fly(controller: Controller, name: &str) -> Vec<FlightScore> {
    let scenario = Scenario::load(&config(name)).unwrap();
    let contender = Contender::new(&models(), controller, &scenario).unwrap();
    (0..FLIGHTS).map(|seed| contender.fly(seed).unwrap()).collect()
}

fn riskiest(flights: &[FlightScore]) -> f64 {
    flights.iter().map(|flight| flight[Metric::CollisionProbability]).fold(0.0, f64::max)
}

/// The limits here are wide: contact is 0.5. A policy that takes the obstacles for standing ones shows that there is
/// something to go round.
#[test]
fn crpl_rh_goes_round_what_flies_into_crpl() {
    for name in ["moving_fast.toml", "two_obstacles.toml"] {
        let flights = fly(Controller::CrplRh, name);
        assert!(riskiest(&flights) < 0.2, "{name}: {flights:?}");
        let far = flights.iter().map(|flight| flight[Metric::TerminalDistance]).fold(0.0, f64::max);
        assert!(far < 0.1, "{name}: {flights:?}");
        let blind = fly(Controller::Crpl, name);
        let (seen, unseen) = (riskiest(&flights), riskiest(&blind));
        assert!(
            unseen > 0.3 && unseen > 2.0 * seen,
            "{name} asks nothing: {unseen} where crpl-rh has {seen}"
        );
    }
}

/// Wherever the two are, also over each other and under the UAV: the error of each reading, px.
#[test]
fn two_obstacles_are_read_as_well_as_one() {
    let scenario = Scenario::load(&config("two_obstacles.toml")).unwrap();
    let world = Models::load(None, None).unwrap().world;
    let (noise, mut draw) = (Noise::new(1), 0);
    let mut near = |centre: Vector2<f64>, spread: f64, margin: f64| {
        draw += 1;
        let place = centre + spread * noise.normal(Stream::Evaluation, Tick(draw));
        place.map(|x| x.clamp(margin, 1.0 - margin))
    };
    let mut errors: [Vec<f64>; 3] = Default::default();
    for n in 0..200 {
        let middle = Vector2::new(0.5, 0.5);
        let (uav, first) = (near(middle, 0.25, 0.05), near(middle, 0.25, 0.12));
        // Every other pair overlaps.
        let second = if n % 2 == 0 { near(middle, 0.25, 0.12) } else { near(first, 0.05, 0.12) };
        let frame = camera::render_all(uav, &[first, second].into(), &scenario);
        let [one, other] = frame.one_obstacle_each().map(|frame| world.encode(&frame));
        for (errors, off) in errors.iter_mut().zip([
            world.uav(&one) - uav,
            world.obstacle(&one) - first,
            world.obstacle(&other) - second,
        ]) {
            errors.push(100.0 * off.norm());
        }
    }
    for (name, errors) in ["UAV", "first obstacle", "second obstacle"].iter().zip(&mut errors) {
        errors.sort_by(f64::total_cmp);
        let (p90, most) = (errors[errors.len() * 9 / 10], errors[errors.len() - 1]);
        println!("{name}: 90th percentile {p90:.3} px, largest {most:.3} px");
        assert!(p90 < 0.15 && most < 1.0, "{name}: 90th percentile {p90} px, largest {most} px");
    }
}

/// Obstacles and their picture cross the link, and the records tell of all of them.
fn over_udp_as_in_process(config: &Path, controller: Controller, obstacles: usize) {
    let scenario = Scenario::load(config).unwrap();
    let mut station = models().station(controller, &scenario).unwrap();
    let (ticks, folder) = (30, tempfile::tempdir().unwrap());
    lab::fly(&mut Sim::new(scenario, 5), &mut station, ticks);
    let here = folder.path().join("here.jsonl");
    run_folder::write_records(&here, station.records()).unwrap();

    let (config, out, controller) =
        (config.to_str().unwrap(), folder.path().join("run"), controller.to_string());
    let sitl = ["--pace", "lockstep", "--scenario", config, "--seed", "5", "--ticks", "30"];
    let (sitl, address) = program::sitl(&sitl).unwrap();
    let connect = format!("udpout:{address}");
    let fly =
        ["fly", "--connect", &connect, "--scenario", config, "--controller", &controller, "--ticks", "30"];
    program::run("gcs", &[fly.as_slice(), &["--out", out.to_str().unwrap()]].concat())
        .unwrap()
        .good()
        .unwrap();
    sitl.wait().unwrap().good().unwrap();

    let read = |path: &Path| std::fs::read_to_string(path).unwrap();
    let flown = read(&out.join("record.jsonl"));
    assert_eq!(flown, read(&here));
    assert_eq!(flown.lines().count(), 30);
    for line in flown.lines() {
        let record: Record = serde_json::from_str(line).unwrap();
        assert_eq!(record.obstacles.len(), obstacles, "{line}");
    }
    let plot = read(&out.join("path.svg"));
    assert!(plot.contains("rgb(70,130,90)"), "the plot shows one obstacle");
}

#[test]
fn two_obstacles_over_udp_are_those_in_process() {
    over_udp_as_in_process(&config("two_obstacles.toml"), Controller::CrplRh, 2);
}

/// World, radio, risk, wire, records and figures hold any number; what pictures tell apart is CRPL's limit.
#[test]
fn a_third_obstacle_is_a_toml() {
    let text = "[[obstacle]]\n[[obstacle]]\nposition = [0.3, 0.75]\nradius = 0.05\n\
                [[obstacle]]\nposition = [0.75, 0.6]\nradius = 0.06\nvelocity = [0.0, 0.002]\n";
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("three.toml");
    std::fs::write(&file, text).unwrap();
    for controller in [Controller::Apc, Controller::Rcc] {
        over_udp_as_in_process(&file, controller, 3);
    }
    let models = Models::load(None, None).unwrap();
    let scenario = Scenario::load(&file).unwrap();
    let flown = Contender::new(&models, Controller::Apc, &scenario).unwrap().fly(0).unwrap();
    assert!(flown[Metric::CollisionProbability] < 0.5 && flown.is(FlightOutcome::Reached), "{flown:?}");
    let error = Contender::new(&models, Controller::CrplRh, &scenario).err().unwrap().to_string();
    assert!(error.contains("3 obstacles") && error.contains("1 to 2"), "{error}");
}

#[test]
fn a_flight_without_obstacles_is_a_free_one() {
    let scenario = Scenario::from_toml("obstacle = []").unwrap();
    let models = Models::load(None, None).unwrap();
    for controller in [Controller::Apc, Controller::Rcc, Controller::Ucc] {
        let flown = Contender::new(&models, controller, &scenario).unwrap().fly(0).unwrap();
        let p_coll = flown[Metric::CollisionProbability];
        assert!(flown.is(FlightOutcome::Reached) && p_coll == 0.0, "{controller}: {flown:?}");
    }
    assert!(Contender::new(&models, Controller::Crpl, &scenario).is_err());
}
