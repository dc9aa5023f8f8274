//! The watch page in Chromium: a live flight to its end by two pages at once, `flight.html` from a file, golden
//! pictures of the field, axe-core, and the frame rate as a number to read.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::PathBuf;

use tempfile::TempDir;
use tests::browser;
use tests::program::{self, Program};

/// What is printed before the page's address.
const ADDRESS: &str = "watch: ";

#[test]
fn two_pages_watch_a_flight_to_its_end_scrub_it_and_stay_apart() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let args = ["demo", "--watch", "--watch-stay", "--out", out.to_str().unwrap()];
    let demo = Program::start("gcs", &args, None).unwrap();
    let said = browser::script("live.cjs", &[address(&demo), "2".into()]).unwrap().good().unwrap();
    print!("{said}");
    let compressed = said.split(" bytes, ").nth(1).unwrap().split(' ').next().unwrap();
    assert!(compressed.parse::<usize>().unwrap() < 300_000, "{said}");
    demo.interrupt().unwrap();
    demo.wait().unwrap().good().unwrap();
}

#[test]
fn a_page_with_the_token_steers_after_a_confirmation_and_shows_the_answer() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let (_sitl, vehicle) = program::sitl(&["--pace", "realtime"]).unwrap();
    let connect = format!("udpout:{vehicle}");
    // A flight that lasts longer than any browser takes to start.
    let args = ["fly", "--connect", &connect, "--watch", "--control", "--ticks", "2000", "--out"];
    let args: Vec<&str> = args.into_iter().chain(out.to_str()).collect();
    let fly = Program::start("gcs", &args, None).unwrap();
    print!("{}", browser::script("control.cjs", &[address(&fly)]).unwrap().good().unwrap());
}

#[test]
fn flight_html_plays_from_a_file_and_draws_the_golden_pictures() {
    let dir = tempfile::tempdir().unwrap();
    let flight = flight(&dir);
    // Pictures of a failure stay to be looked at.
    let out = tempfile::tempdir().unwrap().keep();
    let said = browser::script("recorded.cjs", &[flight, browser::folder().join("golden"), out.clone()]);
    print!("{}", said.unwrap().good().unwrap());
    fs::remove_dir_all(out).unwrap();
}

#[test]
fn a_field_whose_up_is_not_north_stands_north_up_and_turns_back_by_a_key() {
    let dir = tempfile::tempdir().unwrap();
    let out = tempfile::tempdir().unwrap().keep();
    print!("{}", browser::script("north.cjs", &[flight(&dir), out.clone()]).unwrap().good().unwrap());
    fs::remove_dir_all(out).unwrap();
}

#[test]
fn axe_finds_no_serious_fault_in_either_theme_at_any_width() {
    let dir = tempfile::tempdir().unwrap();
    print!("{}", browser::script("accessible.cjs", &[flight(&dir)]).unwrap().good().unwrap());
}

#[test]
fn eight_vehicles_play_at_speed_20() {
    let dir = tempfile::tempdir().unwrap();
    print!("{}", browser::script("frames.cjs", &[flight(&dir)]).unwrap().good().unwrap());
}

/// Where the program serves its page, as it says.
fn address(program: &Program) -> String {
    program.logs(ADDRESS).unwrap();
    let so_far = program.so_far();
    so_far.lines().find_map(|line| line.strip_prefix(ADDRESS)).unwrap().trim().into()
}

/// `flight.html` of CRPL's flight of the demo, flown into `dir`.
fn flight(dir: &TempDir) -> PathBuf {
    let out = dir.path().join("run");
    // The golden pictures are of this flight; another world model flies another.
    let demo = ["demo", "--checkpoint", "centroid", "--out", out.to_str().unwrap()];
    program::run("gcs", &demo).unwrap().good().unwrap();
    out.join("crpl/flight.html")
}
