//! The radio for everything and a companion's encoder as users meet them: the real programs, over UDP.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use std::net::SocketAddr;
use std::path::Path;

use crpl_sitl::sim::record::Record;
use tests::program::{self, Program};

/// A flight of CRPL on the vehicle at an endpoint: its records.
fn flown(endpoint: SocketAddr, folder: &Path, ticks: &str) -> Vec<Record> {
    let (connect, out) = (format!("udpout:{endpoint}"), folder.to_str().unwrap());
    let args = ["fly", "--connect", &connect, "--controller", "crpl", "--ticks", ticks, "--out", out];
    program::run("gcs", &args).unwrap().good().unwrap();
    let text = std::fs::read_to_string(folder.join("record.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Latents from beside the vehicle steer it as its pictures do.
#[test]
fn a_companion_s_latents_fly_the_flight_of_the_pictures() {
    const TICKS: &str = "25";
    let folder = tempfile::tempdir().unwrap();
    let lockstep = || program::sitl(&["--pace", "lockstep", "--ticks", TICKS, "--seed", "3"]).unwrap();
    let (_sitl, vehicle) = lockstep();
    let pictures = flown(vehicle, &folder.path().join("pictures"), TICKS);
    let (_sitl, vehicle) = lockstep();
    let vehicle = format!("udpout:{vehicle}");
    let args = ["encode", "--vehicle", &vehicle, "--ground", "udpin:127.0.0.1:0", "--bits", "12"];
    let companion = Program::start("gcs", &args, None).unwrap();
    let ground = companion.line("ground: listening on udpin:").unwrap();
    let latents = flown(ground.parse().unwrap(), &folder.path().join("latents"), TICKS);
    assert_eq!((pictures.len(), latents.len()), (25, 25));
    for (a, b) in pictures.iter().zip(&latents) {
        assert!((a.r_next - b.r_next).norm() < 0.02, "{:?}: {} {}", a.tick, a.r_next, b.r_next);
    }
    companion.interrupt().unwrap();
    let told = companion.wait().unwrap().good().unwrap();
    assert!(told.contains("pictures encoded"), "{told}");
}

/// In real time only liveness is promised: the flight goes through a radio that carries every frame.
#[test]
fn a_flight_goes_through_a_radio_that_carries_everything() {
    let folder = tempfile::tempdir().unwrap();
    let (_sitl, vehicle) = program::sitl(&["--pace", "realtime", "--radio", "wifi"]).unwrap();
    let records = flown(vehicle, &folder.path().join("wifi"), "8");
    assert!(records.iter().any(|record| record.flown_tick.is_some()), "a command has arrived");
}

#[test]
fn a_radio_for_everything_is_refused_in_lockstep_and_by_a_wrong_name() {
    let refused = |args: &[&str]| {
        let finished = program::run("sitl", &[&["--listen", "udpin:127.0.0.1:0"], args].concat()).unwrap();
        assert_eq!(finished.status.code(), Some(1));
        finished.stderr
    };
    let told = refused(&["--radio", "all", "--pace", "lockstep"]);
    assert!(told.contains("--radio all: needs --pace realtime"), "{told}");
    let told = refused(&["--radio", "sik"]);
    assert!(told.contains("`sik` is neither a radio file nor one of perfect"), "{told}");
}

/// The table has a row for each radio, downlink and controller, and the same again from the same seeds.
#[test]
fn episodes_over_a_radio_for_everything_are_a_table_that_comes_again() {
    let table = || {
        let args = [
            "episodes",
            "--radio",
            "all",
            "--picture-intervals",
            "0.5,3",
            "--downlink",
            "picture,latent,telemetry",
            "--controller",
            "crpl,rcc",
            "--episodes",
            "2",
        ];
        program::run("gcs", &args).unwrap().good().unwrap()
    };
    let first = table();
    // Reports alone are nothing for CRPL.
    assert_eq!(first.lines().filter(|line| line.contains("/2")).count(), 2 * 5, "{first}");
    assert_eq!(first, table());
}

#[test]
fn a_fleet_leaves_a_table_a_csv_and_a_figure() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let args = ["fleet", "--vehicles", "1,2", "--episodes", "2", "--controller", "rcc", "--out", out];
    let table = program::run("gcs", &args).unwrap().good().unwrap();
    assert_eq!(table.lines().filter(|line| line.starts_with("rcc")).count(), 2 * 3, "{table}");
    let csv = std::fs::read_to_string(folder.path().join("fleet.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 2 * 3);
    assert!(folder.path().join("fleet.svg").exists() && folder.path().join("fleet.png").exists());
}
