//! What ends a flight, or marks it: it is said, written down, and told by the exit code.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]
#![expect(clippy::disallowed_methods, reason = "it waits for real programs, and not for ever")]

use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use crpl_sitl::Scenario;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{COMMAND_LONG_DATA, HEARTBEAT_DATA, MavCmd, MavMessage};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::wire::{self, Clock};
use crpl_sitl::units::Tick;
use serde_json::Value;
use tests::program::{self, Finished, Program};

/// A vehicle in real time, five times as fast as the clock: an interval takes 80 ms.
fn slow_vehicle(listen: &str) -> (Program, SocketAddr) {
    let args = ["--listen", listen, "--scenario", "2", "--pace", "realtime", "--speed", "5"];
    let sitl = Program::start("sitl", &args, None).unwrap();
    let address = sitl.line("listening on udpin:").unwrap().parse().unwrap();
    (sitl, address)
}

/// `gcs fly` with RCC, which needs no policy, until so many intervals are on the disk.
fn flying(address: SocketAddr, out: &Path, intervals: usize) -> Program {
    let connect = format!("udpout:{address}");
    let args = ["fly", "--connect", &connect, "--controller", "rcc", "--out", out.to_str().unwrap()];
    let gcs = Program::start("gcs", &args, None).unwrap();
    let deadline = Instant::now() + program::PATIENCE;
    while lines(out) < intervals {
        assert!(Instant::now() < deadline, "{}", gcs.so_far());
        std::thread::sleep(Duration::from_millis(20));
    }
    gcs
}

fn lines(out: &Path) -> usize {
    std::fs::read_to_string(out.join("record.jsonl")).map_or(0, |text| text.lines().count())
}

fn manifest(out: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(out.join("run.json")).unwrap()).unwrap()
}

/// The end of a flight that did not go to its last tick: the code, `run.json` and the table say so, and all
/// intervals that were flown are there.
fn assert_ended(finished: &Finished, code: i32, how: &str, out: &Path) {
    assert_eq!(finished.status.code(), Some(code), "{}\n{}", finished.stdout, finished.stderr);
    let run = manifest(out);
    assert_eq!(run["ended"]["how"], how, "{run}");
    assert!(!run["ended"]["why"].as_str().unwrap().is_empty(), "{run}");
    let flown = lines(out);
    assert!((5..100).contains(&flown), "{flown} intervals");
    assert_eq!(run["summary"]["ticks"], flown, "{run}");
    let said = format!("rcc: ended after {flown} intervals, {how}: ");
    assert!(finished.stdout.contains(&said), "{}", finished.stdout);
    for line in std::fs::read_to_string(out.join("record.jsonl")).unwrap().lines() {
        let record: Value = serde_json::from_str(line).unwrap();
        let place = |key: &str| [0, 1].map(|axis| record[key][axis].as_f64().unwrap());
        let [from, to] = [place("r"), place("r_next")];
        let moved = (from[0] - to[0]).hypot(from[1] - to[1]);
        assert!(moved < 0.05, "a record that teleports: {line}");
    }
}

#[test]
fn gcs_fly_ends_when_the_vehicle_reboots() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("flight");
    let (first, address) = slow_vehicle("udpin:127.0.0.1:0");
    let gcs = flying(address, &out, 8);
    drop(first);
    let (_second, _) = slow_vehicle(&format!("udpin:{address}"));
    let finished = gcs.wait().unwrap();
    assert_ended(&finished, 5, "rebooted", &out);
    assert!(finished.stderr.contains("its time went back from tick"), "{}", finished.stderr);
}

#[test]
fn gcs_fly_ends_when_another_station_s_setpoint_is_flown() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("flight");
    let (_sitl, address) = slow_vehicle("udpin:127.0.0.1:0");
    let gcs = flying(address, &out, 8);
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let clock = Clock::new(&Scenario::default());
    let mut station = Encoder::new(254, 190);
    for tick in 8..100 {
        let mut datagram = Vec::new();
        wire::push_setpoint(Tick(tick), [1.25, -2.5], &clock, 1, &mut station, &mut datagram);
        socket.send_to(&datagram, address).unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
    let finished = gcs.wait().unwrap();
    assert_ended(&finished, 6, "foreign setpoint", &out);
    assert!(finished.stderr.contains("setpoints from another peer, 254/190"), "{}", finished.stderr);
}

/// The mode of the vehicle's next heartbeat.
fn mode(address: SocketAddr) -> u32 {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let (mut datagram, mut decoder, mut buffer) = (Vec::new(), Decoder::default(), [0; 2048]);
    Encoder::new(253, 190).push(&mut datagram, &HEARTBEAT_DATA::default());
    socket.send_to(&datagram, address).unwrap();
    loop {
        let length = socket.recv(&mut buffer).unwrap();
        for packet in decoder.datagram(&buffer[..length]) {
            if let Some(MavMessage::HEARTBEAT(beat)) = packet.message().filter(|_| packet.component == 1) {
                return beat.custom_mode;
            }
        }
    }
}

#[test]
fn gcs_fly_writes_what_was_flown_on_sigint_sigterm_and_sighup() {
    for (signal, code) in [("-INT", 130), ("-TERM", 143), ("-HUP", 129)] {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("flight");
        let (_sitl, address) = slow_vehicle("udpin:127.0.0.1:0");
        let gcs = flying(address, &out, 6);
        assert_eq!(manifest(&out)["ended"], Value::Null, "it flies");
        gcs.signal(signal).unwrap();
        assert_ended(&gcs.wait().unwrap(), code, "interrupted", &out);
        assert_eq!(mode(address), 17, "it brakes");
    }
}

#[test]
fn gcs_fly_ends_when_an_operator_changes_the_mode() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("flight");
    let (_sitl, address) = slow_vehicle("udpin:127.0.0.1:0");
    let gcs = flying(address, &out, 6);
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut datagram = Vec::new();
    let command = COMMAND_LONG_DATA {
        target_system: 1,
        target_component: 1,
        command: MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH,
        ..Default::default()
    };
    Encoder::new(254, 190).push(&mut datagram, &command);
    socket.send_to(&datagram, address).unwrap();
    assert_ended(&gcs.wait().unwrap(), 4, "taken over", &out);
}

/// N10: the flight goes on to its last tick, and the program says that its files are not whole.
#[test]
fn gcs_fly_on_a_full_disk_flies_to_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("flight");
    let (_sitl, address) = program::sitl(&["--pace", "lockstep", "--ticks", "100"]).unwrap();
    let gcs = program::path("gcs").unwrap();
    let mut command = Command::new("bash");
    let script = "trap '' XFSZ; ulimit -f 16; exec \"$@\"";
    command.args(["-c", script, "bash"]).arg(gcs);
    command
        .args(["fly", "--controller", "rcc", "--connect", &format!("udpout:{address}"), "--out"])
        .arg(&out);
    let finished = Program::spawn("gcs", command).unwrap().wait().unwrap();
    assert_eq!(finished.status.code(), Some(7), "{}\n{}", finished.stdout, finished.stderr);
    assert!(finished.stdout.contains("of 100"), "{}", finished.stdout);
    assert!(finished.stderr.contains("messages are passed on all the same"), "{}", finished.stderr);
}

/// And a router passes on what it can no longer log.
#[test]
fn gcs_bridge_on_a_full_disk_goes_on_routing() {
    let folder = tempfile::tempdir().unwrap();
    let (out, tlog) = (folder.path().join("flight"), folder.path().join("bridge.tlog"));
    let (_sitl, address) = program::sitl(&["--pace", "lockstep", "--ticks", "100"]).unwrap();
    let mut command = Command::new("bash");
    let script = "trap '' XFSZ; ulimit -f 16; exec \"$@\"";
    command.args(["-c", script, "bash"]).arg(program::path("gcs").unwrap());
    command.args(["bridge", "--connect", &format!("udpout:{address}"), "--forward", "udpin:127.0.0.1:0"]);
    command.arg("--tlog").arg(&tlog);
    let bridge = Program::spawn("gcs bridge", command).unwrap();
    let forward = bridge.line("forward: listening on udpin:").unwrap();
    let connect = format!("udpout:{forward}");
    let fly = ["fly", "--connect", &connect, "--controller", "rcc", "--out", out.to_str().unwrap()];
    program::run("gcs", &fly).unwrap().good().unwrap();
    assert_eq!(lines(&out), 100);
    bridge.logs("messages are passed on all the same").unwrap();
    assert_eq!(bridge.so_far().matches("the tlog ends here").count(), 1, "said once");
}

#[test]
fn gcs_fly_takes_the_world_of_the_vehicle_and_refuses_another() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("flight");
    let args = ["--pace", "lockstep", "--scenario", "1", "--ticks", "100"];
    let (_sitl, address) = program::sitl(&args).unwrap();
    let connect = format!("udpout:{address}");
    let fly = ["fly", "--connect", &connect, "--controller", "rcc", "--out", out.to_str().unwrap()];
    let finished = program::run("gcs", &[&fly[..], &["--scenario", "2"]].concat()).unwrap();
    assert_eq!(finished.status.code(), Some(1));
    let what =
        "vehicle 1 flies in another world than --scenario: OBST_N = 225 in the scenario, 150 on the vehicle";
    assert!(finished.stderr.contains(what), "{}", finished.stderr);
    assert!(!out.exists(), "a failed start touches nothing");

    let said = program::run("gcs", &fly).unwrap().good().unwrap();
    assert!(said.starts_with("scenario 1 "), "{said}");
    let config = Scenario::load(&out.join("config.toml")).unwrap();
    assert_eq!(config.obstacle().position.y, 0.30);
}

#[test]
fn gcs_fly_refuses_several_vehicles_and_obeys_sysid() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("flight");
    let args = ["--pace", "realtime", "--speed", "20", "--instances", "3", "--shared"];
    let (_sitl, address) = program::sitl(&args).unwrap();
    let connect = format!("udpout:{address}");
    let fly = ["fly", "--connect", &connect, "--controller", "rcc", "--out", out.to_str().unwrap()];
    let finished = program::run("gcs", &fly).unwrap();
    assert_eq!(finished.status.code(), Some(1), "{}", finished.stdout);
    assert!(
        finished.stderr.contains("vehicles 1, 2, 3 are there: choose one by --sysid"),
        "{}",
        finished.stderr
    );
    let fly = [&fly[..], &["--sysid", "3", "--ticks", "20"]].concat();
    program::run("gcs", &fly).unwrap().good().unwrap();
    let tlog = std::fs::read(out.join("flight.tlog")).unwrap();
    assert!(!tlog.is_empty() && lines(&out) > 0);
}

/// All files below a folder, with their bytes.
fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut all: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .map(|path| (path.clone(), std::fs::read(&path).unwrap()))
        .collect();
    all.sort();
    all
}

/// N11: neither a failed start nor a second flight touches a flight that is there.
#[test]
fn gcs_fly_never_mixes_or_overwrites_flights() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("flight");
    let fly = |flags: &[&str]| {
        let (_sitl, address) = program::sitl(&["--pace", "lockstep", "--ticks", "100"]).unwrap();
        let connect = format!("udpout:{address}");
        let fly = ["fly", "--connect", &connect, "--controller", "rcc", "--ticks", "10"];
        program::run("gcs", &[&fly[..], &["--out", out.to_str().unwrap()], flags].concat()).unwrap()
    };
    fly(&[]).good().unwrap();
    let before = files(&out);
    // Configuration, manifest, record, log, page; the figure in three formats, its points and its script.
    assert_eq!(before.len(), 10, "{:?}", before.iter().map(|(path, _)| path).collect::<Vec<_>>());
    let refused = fly(&[]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(refused.stderr.contains("holds a flight already"), "{}", refused.stderr);
    assert!(files(&out) == before);
    fly(&["--overwrite"]).good().unwrap();
    assert_eq!(files(&out).len(), before.len());
}

#[test]
fn gcs_demo_without_out_takes_a_fresh_folder() {
    let folder = tempfile::tempdir().unwrap();
    let mut said = Vec::new();
    for controller in ["rcc", "ucc"] {
        let args = ["demo", "--controller", controller];
        let gcs = Program::start("gcs", &args, Some(folder.path())).unwrap();
        said.push(gcs.wait().unwrap().good().unwrap());
    }
    assert!(said[0].trim_end().ends_with("records, tlog and plot in runs/demo"), "{}", said[0]);
    assert!(said[1].trim_end().ends_with("records, tlog and plot in runs/demo-2"), "{}", said[1]);
    assert!(folder.path().join("runs/demo-2/ucc/run.json").exists());
    assert!(!folder.path().join("runs/demo/ucc").exists());
}

#[test]
fn gcs_episodes_on_sigint_says_what_was_flown() {
    let args = ["episodes", "--controller", "rcc", "--episodes", "100000"];
    let gcs = Program::start("gcs", &args, None).unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    gcs.interrupt().unwrap();
    let finished = gcs.wait().unwrap();
    assert_eq!(finished.status.code(), Some(130), "{}", finished.stderr);
    assert!(finished.stderr.contains("of 100000, which are discarded"), "{}", finished.stderr);
}

/// The phases that are over are kept.
#[test]
fn gcs_optimise_on_sigint_keeps_its_progress() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("policy");
    let args = ["optimise", "--seed", "1", "--out", out.to_str().unwrap()];
    let gcs = Program::start("gcs", &args, None).unwrap();
    gcs.logs("no obstacle: ").unwrap();
    gcs.interrupt().unwrap();
    let finished = gcs.wait().unwrap();
    assert_eq!(finished.status.code(), Some(130), "{}", finished.stderr);
    assert!(finished.stderr.contains("--resume goes on"), "{}", finished.stderr);
    assert_eq!(files(&out).len(), 1, "{:?}", files(&out));
}

#[test]
fn gcs_report_on_sigint_leaves_no_empty_folder() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("report");
    let gcs = Program::start("gcs", &["report", "all", "--out", out.to_str().unwrap()], None).unwrap();
    std::thread::sleep(Duration::from_millis(700));
    gcs.interrupt().unwrap();
    let finished = gcs.wait().unwrap();
    assert_eq!(finished.status.code(), Some(130), "{}", finished.stderr);
    assert!(!out.exists() || std::fs::read_dir(&out).unwrap().next().is_some());
}

/// Right after "listening on" Ctrl-C skipped --save-params in 19 of 20 tries; SIGTERM and SIGHUP saved nothing.
#[test]
fn a_signal_as_soon_as_sitl_listens_ends_it_and_saves_the_parameters() {
    let folder = tempfile::tempdir().unwrap();
    for pace in ["realtime", "lockstep"] {
        for (round, signal) in ["-INT", "-TERM", "-HUP", "-INT"].into_iter().enumerate() {
            let saved = folder.path().join(format!("{pace}{round}.param"));
            let flags = ["--pace", pace, "--save-params", saved.to_str().unwrap()];
            let (sitl, _) = program::sitl(&flags).unwrap();
            sitl.signal(signal).unwrap();
            let said = sitl.wait().unwrap().good().unwrap();
            assert!(said.contains("interrupted at tick 0"), "{pace} {signal}: {said}");
            assert!(std::fs::read_to_string(&saved).unwrap().contains("WP_SPEED"), "{pace} {signal}");
        }
    }
}

/// `sitl 2>&1 | head -1` flew on, and panicked at Ctrl-C.
#[test]
fn a_reader_that_has_gone_away_is_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let saved = folder.path().join("saved.param");
    let sitl = program::path("sitl").unwrap();
    // The process says its own number before it becomes `sitl`: said by the shell beside it, it could come second.
    let script = format!(
        "{{ echo $BASHPID; exec '{}' --listen udpin:127.0.0.1:0 --ticks 3 --speed 1000 --save-params '{}'; }} 2>&1 & \
         wait $!; echo $? >&2",
        sitl.display(),
        saved.display()
    );
    let mut command = Command::new("bash");
    command.args(["-c", &script]).stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
    let mut shell = command.spawn().unwrap();
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(shell.stdout.take().unwrap()));
    let pid: u32 = lines.next().unwrap().unwrap().parse().unwrap();
    assert!(lines.any(|line| line.unwrap().contains("listening on")));
    drop(lines);
    let kill = Command::new("kill").args(["-INT", &pid.to_string()]).status().unwrap();
    assert!(kill.success());
    let ended = shell.wait_with_output().unwrap();
    assert_eq!(String::from_utf8_lossy(&ended.stderr).trim(), "0");
    assert!(saved.exists());
}
