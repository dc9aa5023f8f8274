//! Obstacles that move, one and two: CRPL in receding horizon copes with them from pictures alone, in
//! process and over UDP.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use std::path::{Path, PathBuf};

use crpl_gcs::lab::run;
use crpl_gcs::lab::{self, Contender};
use crpl_gcs::station::models::Models;
use crpl_gcs::station::pilot::Controller;
use crpl_sitl::sim::metric::{FlightScore, Metric};
use crpl_sitl::units::Tick;
use crpl_sitl::world::noise::{Noise, Stream};
use crpl_sitl::world::obstacles::Obstacles;
use crpl_sitl::{Scenario, Sim, camera};
use nalgebra::Vector2;
use tests::program;

const FLIGHTS: u64 = 4;

fn config(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs").join(name)
}

fn fly(controller: Controller, name: &str) -> Vec<FlightScore> {
    let scenario = Scenario::load(&config(name)).unwrap();
    let contender = Contender::new(&Models::load(None, None).unwrap(), controller, &scenario).unwrap();
    (0..FLIGHTS).map(|seed| contender.fly(seed).unwrap()).collect()
}

fn riskiest(flights: &[FlightScore]) -> f64 {
    flights.iter().map(|flight| flight[Metric::CollisionProbability]).fold(0.0, f64::max)
}

/// Means over 20 flights: p_coll 0.01 and 0.02, d_f 0.01 and 0.02. The limits here are wide: contact is 0.5.
#[test]
fn crpl_rh_goes_round_what_flies_into_crpl() {
    for name in ["moving_fast.toml", "two_obstacles.toml"] {
        let flights = fly(Controller::CrplRh, name);
        assert!(riskiest(&flights) < 0.2, "{name}: {flights:?}");
        let far = flights.iter().map(|flight| flight[Metric::TerminalDistance]).fold(0.0, f64::max);
        assert!(far < 0.1, "{name}: {flights:?}");
        let blind = fly(Controller::Crpl, name);
        assert!(riskiest(&blind) > 0.4, "{name} asks nothing: {blind:?}");
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
        let frame = camera::render_all(uav, &Obstacles { first, second: Some(second) }, &scenario);
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

/// The second obstacle and its picture cross the link, and the record tells of it.
#[test]
fn two_obstacles_over_udp_are_those_in_process() {
    let scenario = Scenario::load(&config("two_obstacles.toml")).unwrap();
    let mut station = Models::load(None, None).unwrap().station(Controller::CrplRh, &scenario).unwrap();
    let (ticks, folder) = (30, tempfile::tempdir().unwrap());
    lab::fly(&mut Sim::new(scenario, 5), &mut station, ticks);
    let here = folder.path().join("here.jsonl");
    run::write_records(&here, station.records()).unwrap();

    let config = config("two_obstacles.toml");
    let (config, out) = (config.to_str().unwrap(), folder.path().join("run"));
    let sitl = ["--pace", "lockstep", "--config", config, "--seed", "5", "--ticks", "30"];
    let (sitl, address) = program::sitl(&sitl).unwrap();
    let connect = format!("udpout:{address}");
    let fly = ["fly", "--connect", &connect, "--config", config, "--controller", "crpl-rh", "--ticks", "30"];
    program::run("gcs", &[fly.as_slice(), &["--out", out.to_str().unwrap()]].concat())
        .unwrap()
        .good()
        .unwrap();
    sitl.wait().unwrap().good().unwrap();

    let read = |path: &Path| std::fs::read_to_string(path).unwrap();
    let flown = read(&out.join("record.jsonl"));
    assert_eq!(flown, read(&here));
    assert!(flown.lines().count() == 30 && flown.lines().all(|line| line.contains("second_obstacle")));
    let plot = read(&out.join("path.svg"));
    assert!(plot.contains("#46825A"), "the plot shows one obstacle");
}
