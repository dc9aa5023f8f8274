//! Controllers of somebody's own, scenes of somebody's own, flights of others: by the real programs.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::path::{Path, PathBuf};

use serde_json::Value;
use tests::program::{self, Finished, Program, workspace};

fn gcs(flags: &[&str]) -> Finished {
    program::run("gcs", flags).unwrap()
}

/// The name of a controller that is this program in Python; `body` is what it does with a `message` that is no
/// hello and no reset.
fn program_in_python(dir: &Path, file: &str, body: &str) -> String {
    let lines: Vec<String> = body.lines().map(|line| format!("        {line}")).collect();
    let text = format!(
        "import json, sys, time\n\
         def say(**answer):\n    print(json.dumps(answer), flush=True)\n\
         flights = 0\n\
         for line in sys.stdin:\n    message = json.loads(line)\n    kind = message['type']\n    \
         if kind == 'hello':\n        hello = message\n        say(version=1)\n    \
         elif kind == 'reset':\n        flights += 1\n    else:\n        tick = message['tick']\n{}\n",
        lines.join("\n")
    );
    let path = dir.join(file);
    std::fs::write(&path, text).unwrap();
    format!("exec:python3 {}", path.display())
}

const EAST: &str = "say(tick=tick, wish=[1, 0], power=1)";

fn episodes(controllers: &str, flags: &[&str]) -> Finished {
    gcs(&[&["episodes", "--controller", controllers, "--episodes", "3", "--json"], flags].concat())
}

fn rows(finished: Finished) -> Vec<Value> {
    let text = finished.good().unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn the_pid_of_the_examples_is_scored_beside_crpl_on_the_same_gusts() {
    let pid = format!("exec:python3 {}", workspace().join("examples/pid.py").display());
    let rows = rows(episodes(&format!("crpl,{pid}"), &[]));
    assert_eq!(rows[1]["controller"], pid.as_str());
    assert_eq!(
        rows[1]["answers"],
        serde_json::json!({ "asked": 300, "timed_out": 0, "junk": 0, "crashed": 0 })
    );
    assert!(rows[1]["ratio_to_crpl"]["d_f"]["mean"].as_f64().unwrap() > 0.0);
    assert_eq!(rows[1]["collisions"]["mean"], 0.0);
}

#[test]
fn a_program_sees_what_crpl_sees_and_the_truth_only_under_another_name() {
    let dir = tempfile::tempdir().unwrap();
    let told = dir.path().join("told.jsonl");
    let body = format!(
        "open({:?}, 'a').write(json.dumps([hello, message]) + '\\n')\n{EAST}",
        told.to_str().unwrap()
    );
    let name = program_in_python(dir.path(), "spy.py", &body);
    for (name, sees) in [(name.clone(), "percept"), (name.replace("exec:", "exec-truth:"), "truth")] {
        let rows = rows(gcs(&[
            "episodes",
            "--controller",
            &name,
            "--episodes",
            "1",
            "--json",
            "--set",
            "horizon=5",
        ]));
        assert_eq!(rows[0]["controller"], name.as_str());
        let text = std::fs::read_to_string(&told).unwrap();
        std::fs::remove_file(&told).unwrap();
        let last: Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
        assert_eq!(last[0]["sees"], sees);
        assert_eq!(last[0]["scenario"].is_object(), sees == "truth");
        assert_eq!(last[1]["state"].is_object(), sees == "truth");
        assert!(last[1]["belief"]["position"][0].is_f64() && last[1]["link"]["snr_db"].is_f64(), "{last}");
    }
}

#[test]
fn a_late_answer_is_counted_and_the_command_before_it_flown_on() {
    let dir = tempfile::tempdir().unwrap();
    // It answers to interval 2 once interval 3 has begun.
    let body = format!(
        "if tick == 2:\n    later = json.loads(sys.stdin.readline())\n    {EAST}\n    tick = later['tick']\n{EAST}"
    );
    let name = program_in_python(dir.path(), "late.py", &body);
    let finished =
        gcs(&["episodes", "--controller", &name, "--episodes", "1", "--json", "--set", "horizon=8"]);
    assert!(finished.stderr.contains("interval 2: no answer within"), "{}", finished.stderr);
    let rows = rows(finished);
    assert_eq!(rows[0]["answers"]["timed_out"], 1, "{}", rows[0]);
}

#[test]
fn silence_junk_and_a_crash_end_a_flight_with_their_line() {
    let dir = tempfile::tempdir().unwrap();
    for (file, body, timeout, part) in [
        ("silent.py", "pass", "0.2", "no answer in 5 intervals on end"),
        ("junk.py", "print('hello there', flush=True)", "60", "`hello there`"),
        ("crash.py", "sys.exit(3)", "60", "interval 0: the program has ended (exit status: 3)"),
        ("wish.py", "say(tick=tick, wish=[1, 0], power=2)", "60", "transmit power 2 is neither 1 nor 4"),
    ] {
        let name = program_in_python(dir.path(), file, body);
        let finished = episodes(&name, &["--exec-timeout", timeout]);
        assert!(!finished.status.success(), "{file}");
        assert!(finished.stderr.contains(part), "{file}: {}", finished.stderr);
    }
    let finished = episodes("exec:/nowhere/at/all", &[]);
    assert!(!finished.status.success() && finished.stderr.contains("/nowhere/at/all"), "{}", finished.stderr);
    let finished = episodes("exec:python3 -c pass", &[]);
    assert!(finished.stderr.contains("no answer to hello"), "{}", finished.stderr);
}

#[test]
fn a_crash_in_a_flight_over_a_link_has_an_exit_code_and_a_run_folder() {
    let dir = tempfile::tempdir().unwrap();
    let body = format!("if tick == 6:\n    sys.exit(1)\n{EAST}");
    let name = program_in_python(dir.path(), "crash.py", &body);
    let out = dir.path().join("out");
    let finished = gcs(&["demo", "--controller", &name, "--out", out.to_str().unwrap()]);
    assert_eq!(finished.status.code(), Some(9), "{}", finished.stderr);
    let run: Value =
        serde_json::from_slice(&std::fs::read(out.join("exec-crash/run.json")).unwrap()).unwrap();
    assert_eq!(run["ended"]["how"], "no controller");
    assert_eq!(run["summary"]["answers"]["crashed"], 1);
    assert_eq!(std::fs::read_to_string(out.join("exec-crash/record.jsonl")).unwrap().lines().count(), 6);
}

#[test]
fn a_sweep_with_a_program_is_the_same_whole_or_in_shards() {
    let dir = tempfile::tempdir().unwrap();
    let name = program_in_python(dir.path(), "east.py", EAST);
    let sweep = |out: &str, flags: &[&str]| {
        let out = dir.path().join(out);
        let fixed =
            ["sweep", "--config", "configs/sweep_bandwidth.toml", "--points", "2.5,4", "--episodes", "4"];
        let who = format!("crpl,{name}");
        let own = ["--controller", who.as_str(), "--out", out.to_str().unwrap()];
        gcs(&[&fixed[..], &own[..], flags].concat()).good().unwrap();
        out
    };
    let whole = sweep("whole", &[]);
    let shards: Vec<PathBuf> = ["1/2", "2/2"].map(|s| sweep(&s.replace('/', "of"), &["--shard", s])).into();
    let merged = dir.path().join("merged");
    let [one, two] = [shards[0].to_str().unwrap(), shards[1].to_str().unwrap()];
    gcs(&["merge", one, two, "--out", merged.to_str().unwrap()]).good().unwrap();
    let read = |dir: &Path| std::fs::read(dir.join("episodes.csv")).unwrap();
    assert_eq!(read(&whole), read(&merged));
    assert!(String::from_utf8(read(&whole)).unwrap().contains(&name));
}

#[test]
fn what_the_vehicle_writes_down_is_what_the_station_does() {
    let dir = tempfile::tempdir().unwrap();
    let [there, here] = ["vehicle", "station"].map(|name| dir.path().join(name).to_str().unwrap().to_owned());
    let flags = [
        "--listen",
        "udpin:127.0.0.1:0",
        "--pace",
        "lockstep",
        "--ticks",
        "100",
        "--seed",
        "3",
        "--out",
        &there,
    ];
    let sitl = Program::start("sitl", &flags, None).unwrap();
    let address = sitl.line("listening on udpin:").unwrap();
    let endpoint = format!("udpout:{address}");
    let flown = gcs(&["fly", "--connect", &endpoint, "--controller", "rcc", "--out", &here, "--json"]);
    let summary: Value = serde_json::from_str(&flown.good().unwrap()).unwrap();
    sitl.wait().unwrap().good().unwrap();
    let read = |dir: &str| std::fs::read(Path::new(dir).join("record.jsonl")).unwrap();
    assert!(read(&there) == read(&here), "the records differ");

    // A folder, its records and its log are one flight.
    let log = format!("{here}/flight.tlog");
    let scored = gcs(&["score", &there, &here, &log, "--json"]).good().unwrap();
    let scored: Value = serde_json::from_str(&scored).unwrap();
    for flight in scored["flights"].as_array().unwrap() {
        for key in ["d_f", "t_out", "e_comm", "p_coll_max"] {
            let (got, want) = (flight["score"][key].as_f64(), summary["flights"][0][key].as_f64());
            assert!(got.is_some() && got == want, "{key}: {got:?} {want:?} {flight}");
        }
    }
    let picture = dir.path().join("picture");
    let compared = gcs(&["compare", &here, &there, "--out", picture.to_str().unwrap()]).good().unwrap();
    assert!(compared.contains("[1] rcc") && compared.contains("[2] unknown"), "{compared}");
    assert!(picture.join("compare.svg").exists());
}

#[test]
fn a_scene_of_ones_own_is_begun_checked_drawn_and_changed() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mine.toml");
    let file = file.to_str().unwrap();
    gcs(&["scenario", "new", file, "--set", "obstacle[0].position[0]=0.55"]).good().unwrap();
    gcs(&["scenario", "check", file]).good().unwrap();
    let out = dir.path().join("drawn");
    let drawn = gcs(&["scenario", "show", file, "--out", out.to_str().unwrap()]).good().unwrap();
    assert!(drawn.contains("straight to the goal") && out.join("scenario.png").exists(), "{drawn}");
    assert!(gcs(&["scenario", "list"]).good().unwrap().contains("elsewhere"));
    std::fs::write(file, "horizn = 3\n[radio]\nb_dt = -1.0\n").unwrap();
    let bad = gcs(&["scenario", "check", file]);
    assert!(!bad.status.success() && bad.stdout.contains("horizn") && bad.stdout.contains("radio.b_dt = -1"));
    let refused = gcs(&["episodes", "--set", "radio.b_dt=-1"]);
    assert!(refused.stderr.contains("radio.b_dt = -1: must lie in [1e-6, 1e9]"), "{}", refused.stderr);
    let sweep = gcs(&["demo", "--scenario", "configs/sweep_bandwidth.toml"]);
    assert!(sweep.stderr.contains("this is a sweep"), "{}", sweep.stderr);
}

/// Flights of `gcs fly` on a `mavlink:` controller's endpoint, one process after the other: to the lab each is
/// somebody's own station. The rows are those of `rcc` in process, and those of the stations.
fn flown_by_stations(flights: u8) -> Vec<Value> {
    let dir = tempfile::tempdir().unwrap();
    let free = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = free.local_addr().unwrap().port();
    drop(free);
    let own = format!("mavlink:udpin:127.0.0.1:{port}");
    let (who, many) = (format!("rcc,{own}"), flights.to_string());
    let flags = ["episodes", "--controller", &who, "--episodes", &many, "--first-seed", "3", "--json"];
    let scored = Program::start("gcs", &flags, None).unwrap();
    let connect = format!("udpout:127.0.0.1:{port}");
    for flight in 0..flights {
        let out = dir.path().join(flight.to_string());
        gcs(&["fly", "--connect", &connect, "--controller", "rcc", "--out", out.to_str().unwrap()])
            .good()
            .unwrap();
    }
    let rows = rows(scored.wait().unwrap());
    assert_eq!((&rows[0]["controller"], &rows[1]["controller"]), (&"rcc".into(), &own.as_str().into()));
    rows
}

fn are_the_same_flights(rows: &[Value]) {
    for metric in ["d_f", "e_comm", "t_out", "j", "p_coll_max"] {
        assert!(rows[0][metric]["mean"].is_f64(), "{metric}: {}", rows[0]);
        assert_eq!(rows[0][metric], rows[1][metric], "{metric}");
    }
}

#[test]
fn a_station_that_speaks_mavlink_is_scored_as_the_controller_that_it_is() {
    are_the_same_flights(&flown_by_stations(1));
}

#[test]
fn the_last_words_of_a_station_do_not_fly_the_next_flight() {
    are_the_same_flights(&flown_by_stations(2));
}
