//! `gcs record` on the real `sitl`: what it writes, how it goes on, how it ends.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use std::path::Path;

use crpl_gcs::flight::Crew;
use crpl_gcs::lab::record::folder::RecordingFolder;
use crpl_gcs::lab::record::recorder::{Recorder, RecordingPlan};
use crpl_model::world_model::recording::{Recording, RecordingFormat, TRUTH, Truth, episode_name};
use crpl_sitl::{Scenario, Sim};
use tests::program::{self, Program};

/// Gusts, and a bandwidth at which packets fail.
const CONFIG: &str = "[radio]\nb_dt = 2.5\n\n[disturbance]\nsigma_c = 0.005\n";
const EPISODES: usize = 2;
const PICTURES: usize = 30;

/// Starts a vehicle in lockstep; gives it and the flags by which a recording meets it.
fn vehicle(folder: &Path) -> (Program, Vec<String>) {
    let config = folder.join("scenario.toml");
    std::fs::write(&config, CONFIG).unwrap();
    let world = ["--scenario", config.to_str().unwrap(), "--camera", "hard"];
    let flags = [&["--pace", "lockstep", "--seed", "7"][..], &world].concat();
    let (sitl, address) = program::sitl(&flags).unwrap();
    let connect = format!("udpout:{address}");
    let flags = [&["record", "--connect", &connect, "--seed", "5"][..], &world].concat();
    (sitl, flags.into_iter().map(str::to_owned).collect())
}

fn with(flags: &[String], more: &[&str]) -> Vec<String> {
    flags.iter().map(String::as_str).chain(more.iter().copied()).map(str::to_owned).collect()
}

/// The same vehicle and the same actions, without a link.
fn in_process(dir: &Path) {
    let mut scenario = Scenario::from_toml(CONFIG).unwrap();
    scenario.film_with("hard").unwrap();
    let plan = RecordingPlan {
        episodes: EPISODES,
        pictures: PICTURES,
        seed: 5,
        format: RecordingFormat::Safetensors,
    };
    let folder = RecordingFolder::claim(dir, false, false).unwrap();
    let mut recorder = Recorder::new(&scenario, plan, folder);
    let mut sim = Sim::new(scenario, 7);
    recorder.begin().unwrap();
    while !recorder.is_done() {
        sim.handle(recorder.command(&sim.percept()));
        recorder.sent();
        sim.advance();
    }
    assert_eq!(recorder.land(), (EPISODES, None));
}

#[test]
fn a_recording_over_udp_is_the_recording_in_process_and_goes_on_where_it_ended() {
    let folder = tempfile::tempdir().unwrap();
    let [direct, linked] = ["direct", "linked"].map(|name| folder.path().join(name));
    in_process(&direct);
    let (_sitl, flags) = vehicle(folder.path());
    let out = linked.to_str().unwrap();
    let record = |more: &[&str]| {
        let flags = with(&flags, &["--out", out, "--pictures", "30"]);
        program::run("gcs", &with(&flags, more)).unwrap()
    };
    let said = record(&["--episodes", "2"]).good().unwrap();
    assert!(said.contains(&format!("2 episodes in {out}")), "{said}");
    let names: Vec<String> = (0..EPISODES).map(episode_name).collect();
    let read = |dir: &Path, name: &str| std::fs::read(dir.join(name)).unwrap();
    for name in &names {
        assert!(read(&linked, name) == read(&direct, name), "{name} differs");
        let truth = Path::new(TRUTH).join(name);
        assert_eq!(read(&linked, truth.to_str().unwrap()), read(&direct, truth.to_str().unwrap()));
    }
    let steps = Recording::open(&linked, None).unwrap();
    let outages = steps.episodes().iter().flat_map(|e| &e.steps).filter(|step| step.outage).count();
    assert!(outages > 0, "this radio fails at times");

    let refused = record(&["--episodes", "3"]);
    assert!(
        refused.stderr.contains("holds a recording already (episode-00000.safetensors)"),
        "{}",
        refused.stderr
    );
    let before = read(&linked, &names[1]);
    record(&["--episodes", "3", "--resume"]).good().unwrap();
    assert_eq!(Recording::open(&linked, None).unwrap().episodes().len(), 3);
    assert_eq!(read(&linked, &names[1]), before);
    assert_eq!(Truth::load(&linked, 2).unwrap().uav.len(), PICTURES);
    record(&["--episodes", "1", "--overwrite"]).good().unwrap();
    assert_eq!(Recording::open(&linked, None).unwrap().episodes().len(), 1);
}

#[test]
fn an_interrupted_recording_keeps_its_episodes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("kept");
    let (_sitl, flags) = vehicle(folder.path());
    let flags = with(&flags, &["--out", out.to_str().unwrap(), "--episodes", "1000", "--pictures", "30"]);
    let gcs = Program::start("gcs", &flags, None).unwrap();
    gcs.logs("episode 1: 30 pictures").unwrap();
    gcs.interrupt().unwrap();
    let ended = gcs.wait().unwrap();
    assert_eq!(ended.status.code(), Some(130), "{}", ended.stderr);
    assert!(Recording::open(&out, None).unwrap().episodes().len() >= 2);
    let told: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("run.json")).unwrap()).unwrap();
    assert_eq!(told["ended"]["how"], "interrupted", "{told}");
}

#[test]
fn the_demo_flies_over_an_aerial_photograph() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let flags = ["demo", "--camera", "photo", "--controller", "crpl,rcc", "--json", "--out", out];
    let printed = program::run("gcs", &flags).unwrap().good().unwrap();
    let report: serde_json::Value = serde_json::from_str(&printed).unwrap();
    let flights = report["flights"].as_array().unwrap();
    assert_eq!(flights.len(), 2, "{report}");
    assert!(flights.iter().all(|flight| flight["ended"]["how"] == "over"), "{report}");
    let config = std::fs::read_to_string(folder.path().join("rcc").join("config.toml")).unwrap();
    assert!(config.contains("shipped:photo"), "{config}");
}
