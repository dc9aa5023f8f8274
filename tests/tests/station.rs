//! `gcs param`, `gcs mission` and `gcs replay` as people type them, against the real `sitl`.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use std::io::Read;
use std::net::{SocketAddr, TcpListener};
use std::path::Path;

use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{GLOBAL_POSITION_INT_DATA, LOCAL_POSITION_NED_DATA};
use crpl_sitl::link::encoder::Encoder;
use tests::program::{self, Finished, PATIENCE, Program};
use tests::relay::Relay;

fn gcs(address: SocketAddr, args: &[&str]) -> Finished {
    let connect = format!("udpout:{address}");
    let args = [&args[..1], &["--connect", &connect], &args[1..]].concat();
    program::run("gcs", &args).unwrap()
}

fn good(address: SocketAddr, args: &[&str]) -> String {
    gcs(address, args).good().unwrap()
}

/// One line that holds each of `words`, and a non-zero exit.
fn refused(finished: &Finished, words: &[&str]) {
    let errors: Vec<_> = finished.stderr.lines().filter(|line| line.starts_with("error: ")).collect();
    assert!(!finished.status.success() && errors.len() == 1, "{finished:?}");
    for word in words {
        assert!(errors[0].contains(word), "no {word} in {errors:?}");
    }
}

#[test]
fn parameters_are_listed_read_set_saved_and_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let (_sitl, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let list = good(address, &["param", "list"]);
    assert!(list.lines().any(|line| line == "SCALE_UNIT_M     500"), "{list}");
    let set = good(address, &["param", "set", "RATE_ATTITUDE", "10"]);
    assert!(set.starts_with("RATE_ATTITUDE    10 (was 4)"), "{set}");
    assert_eq!(good(address, &["param", "get", "RATE_ATTITUDE"]).trim(), "RATE_ATTITUDE    10");
    assert_eq!(
        good(address, &["param", "--component", "68", "get", "RADIO_TXP"]).trim(),
        "RADIO_TXP        1"
    );

    let file = folder.path().join("vehicle.param");
    let file = file.to_str().unwrap();
    good(address, &["param", "save", file]);
    // All but what counts on meanwhile.
    let still = |text: &str| -> Vec<String> {
        text.lines().filter(|line| !line.starts_with("STAT_")).map(str::to_owned).collect()
    };
    assert_eq!(still(&std::fs::read_to_string(file).unwrap()), still(&good(address, &["param", "list"])));
    std::fs::write(file, "RATE_ATTITUDE 5\nSCALE_UNIT_M 500\n").unwrap();
    let loaded = good(address, &["param", "load", file]);
    assert!(loaded.contains("1 set, 1 as they were, 0 refused"), "{loaded}");
    std::fs::write(file, "NO_SUCH 5\n").unwrap();
    refused(&gcs(address, &["param", "load", file]), &["1 of 1 parameters were not set"]);
    refused(&gcs(address, &["param", "set", "SCALE_UNIT_M", "1"]), &["SCALE_UNIT_M", "500"]);
    refused(
        &gcs(address, &["param", "set", "RATE_ATTITUDE", "nan"]),
        &["RATE_ATTITUDE", "`nan` is no number"],
    );
    refused(&gcs(address, &["param", "--sysid", "9", "list"]), &["no vehicle 9; heard: 1"]);
}

/// Five heartbeats are missing: that is said, as is their return, and the flight goes on to its end.
#[test]
fn a_link_is_lost_and_regained_in_words_and_the_flight_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (sitl, address) = program::sitl(&["--pace", "realtime", "--ticks", "25"]).unwrap();
    let (connect, out) = (format!("udpout:{address}"), folder.path().to_str().unwrap());
    let args = ["fly", "--connect", &connect, "--controller", "rcc", "--ticks", "25", "--out", out];
    let flight = Program::start("gcs", &args, None).unwrap();
    flight.logs("vehicle 1 found: ArduPilot, GUIDED, armed").unwrap();
    sitl.signal("-STOP").unwrap();
    flight.logs("vehicle 1: link lost, five heartbeats are missing").unwrap();
    sitl.signal("-CONT").unwrap();
    flight.logs("vehicle 1: link regained after").unwrap();
    flight.wait().unwrap().good().unwrap();
    sitl.wait().unwrap().good().unwrap();
}

/// Parameters and missions come through whole where every fifth datagram is lost.
#[test]
fn a_path_that_loses_a_fifth_costs_patience_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (_sitl, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let relay = Relay::to(address, 5).unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    good(address, &["param", "save", &path("direct.param")]);
    good(relay.address(), &["param", "save", &path("lossy.param")]);
    let names = |name: &str| -> Vec<String> {
        let text = std::fs::read_to_string(path(name)).unwrap();
        text.lines().map(|line| line.split_whitespace().next().unwrap().to_owned()).collect()
    };
    assert_eq!(names("lossy.param"), names("direct.param"));
    assert!(names("lossy.param").len() > 40);
    std::fs::write(path("up.waypoints"), MISSION).unwrap();
    good(relay.address(), &["mission", "upload", &path("up.waypoints")]);
    good(relay.address(), &["mission", "download", &path("down.waypoints")]);
    assert_eq!(places(&std::fs::read_to_string(path("down.waypoints")).unwrap()), places(MISSION));
    let (seen, lost) = relay.counts();
    assert!(lost > 10 && lost * 5 <= seen, "{lost} of {seen} lost");
}

/// With the vehicle's key it answers; without, and with another, it does not.
#[test]
fn a_vehicle_that_wants_signatures_answers_to_its_key_alone() {
    let folder = tempfile::tempdir().unwrap();
    let key = |name: &str, passphrase: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, format!("passphrase = \"{passphrase}\"\n")).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let vehicle = key("vehicle", "under the apple tree");
    let args = ["--pace", "realtime", "--signing", "required", "--signing-key", &vehicle];
    let (_sitl, address) = program::sitl(&args).unwrap();
    let (ours, other) = (key("ours", "under the apple tree"), key("other", "under the pear tree"));
    let value = good(address, &["param", "--signing-key", &ours, "get", "SCALE_UNIT_M"]);
    assert_eq!(value.trim(), "SCALE_UNIT_M     500");
    // Once more, as the timestamps must go on from where they were.
    good(address, &["param", "--signing-key", &ours, "get", "SCALE_UNIT_M"]);
    for stranger in [
        &["param", "--timeout", "2", "list"][..],
        &["param", "--signing-key", &other, "--timeout", "2", "list"],
    ] {
        // Report G15: a wrong key and a missing one were "is sitl running there?".
        let word = if stranger.contains(&"--signing-key") { "is the key in" } else { "--signing-key" };
        refused(&gcs(address, stranger), &["no vehicle heard", word]);
    }
}

/// Home, and two places north of it at the height of its flights.
const MISSION: &str = "QGC WPL 110\n\
    0\t1\t0\t16\t0\t0\t0\t0\t47.39774200\t8.54559400\t488\t1\n\
    1\t0\t3\t16\t0\t0\t0\t0\t47.39864000\t8.54559400\t100\t1\n\
    2\t0\t3\t16\t0\t0\t0\t0\t47.39999000\t8.54700000\t100\t1\n";

/// The places of a WPL mission, without its head and home, which the vehicle knows better.
fn places(text: &str) -> Vec<(String, String)> {
    let rows = text.lines().skip(2).map(|line| line.split('\t').collect::<Vec<_>>());
    rows.map(|row| (row[8].to_owned(), row[9].to_owned())).collect()
}

/// One key for a fleet, each vehicle with its own file; a bridge with the key serves tools without.
#[test]
fn a_fleet_shares_a_key_and_a_bridge_ends_the_signed_path() {
    let folder = tempfile::tempdir().unwrap();
    let key = |name: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, "passphrase = \"under the apple tree\"\n").unwrap();
        path.to_str().unwrap().to_owned()
    };
    let fleet = key("fleet.toml");
    let signed = ["--pace", "realtime", "--signing", "required", "--signing-key", &fleet];
    let (sitl, address) = program::sitl(&[&signed[..], &["--instances", "2", "--shared"]].concat()).unwrap();
    let ours = key("ours.toml");
    for system in ["1", "2"] {
        let asked = ["param", "--sysid", system, "--signing-key", &ours, "get", "SCALE_UNIT_M"];
        assert_eq!(good(address, &asked).trim(), "SCALE_UNIT_M     500");
    }
    refused(&gcs(address, &["param", "--timeout", "2", "list"]), &["no vehicle heard"]);

    let (master, bridges) = (format!("udpout:{address}"), key("bridge.toml"));
    let args = ["bridge", "--connect", &master, "--forward", "udpin:127.0.0.1:0", "--signing-key", &bridges];
    let bridge = Program::start("gcs", &args, None).unwrap();
    let out: SocketAddr = bridge.line("forward: listening on udpin:").unwrap().parse().unwrap();
    let value = good(out, &["param", "--sysid", "2", "get", "SCALE_UNIT_M"]);
    assert_eq!(value.trim(), "SCALE_UNIT_M     500");
    for program in [sitl, bridge] {
        program.interrupt().unwrap();
        program.wait().unwrap().good().unwrap();
    }
    for file in ["fleet.1.toml", "fleet.2.toml", "bridge.toml"] {
        let text = std::fs::read_to_string(folder.path().join(file)).unwrap();
        assert!(text.contains("clean = true"), "{file}");
    }
}

/// The demo's own vehicle has the key, too.
#[test]
fn a_signed_demo_flies_as_an_unsigned_one() {
    let folder = tempfile::tempdir().unwrap();
    let key = folder.path().join("key.toml");
    std::fs::write(&key, "passphrase = \"under the apple tree\"\n").unwrap();
    let flown = |out: &str, more: &[&str]| {
        let out = folder.path().join(out);
        let args = ["demo", "--controller", "rcc", "--out", out.to_str().unwrap()];
        program::run("gcs", &[&args[..], more].concat()).unwrap().good().unwrap();
        std::fs::read(out.join("rcc/record.jsonl")).unwrap()
    };
    let plain = flown("plain", &[]);
    for k in 0..2 {
        assert_eq!(flown(&format!("signed-{k}"), &["--signing-key", key.to_str().unwrap()]), plain);
    }
}

/// A WPL mission up and down again, as a plan too, and away.
#[test]
fn missions_go_up_and_come_down() {
    let folder = tempfile::tempdir().unwrap();
    let (_sitl, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("up.waypoints"), MISSION).unwrap();
    let said = good(address, &["mission", "upload", &path("up.waypoints")]);
    assert!(said.contains("3 items uploaded to vehicle 1"), "{said}");
    good(address, &["mission", "download", &path("down.plan")]);
    let plan: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(path("down.plan")).unwrap()).unwrap();
    assert_eq!(plan["fileType"], "Plan");
    good(address, &["mission", "upload", &path("down.plan")]);
    good(address, &["mission", "download", &path("down.waypoints")]);
    assert_eq!(places(&std::fs::read_to_string(path("down.waypoints")).unwrap()), places(MISSION));
    good(address, &["mission", "clear"]);
    good(address, &["mission", "download", &path("none.waypoints")]);
    assert!(places(&std::fs::read_to_string(path("none.waypoints")).unwrap()).is_empty());
    std::fs::write(path("bad.waypoints"), "QGC WPL 110\n0 1 0\n").unwrap();
    refused(&gcs(address, &["mission", "upload", &path("bad.waypoints")]), &["bad.waypoints", "line 2"]);
}

/// What a watcher hears of a replay: how many positions, local and on the map. Over TCP, which loses
/// nothing to a watcher that has to wait for the processor.
fn watched(file: &Path, speed: &str) -> (usize, usize) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let out = format!("tcpout:{}", listener.local_addr().unwrap());
    let args = ["replay", file.to_str().unwrap(), "--forward", &out, "--speed", speed];
    let replay = Program::start("gcs", &args, None).unwrap();
    let (mut stream, _) = listener.accept().unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let (mut decoder, mut buffer, mut heard) = (Decoder::of_stream(), vec![0; 65_536], (0, 0));
    while heard.0 < 100 {
        let length = stream.read(&mut buffer).unwrap();
        assert!(length > 0, "the replay ended after {heard:?}");
        for packet in decoder.datagram(&buffer[..length]) {
            heard.0 += usize::from(packet.is::<LOCAL_POSITION_NED_DATA>());
            heard.1 += usize::from(packet.is::<GLOBAL_POSITION_INT_DATA>());
            assert_ne!(packet.system, 255, "a station's own messages stay out");
        }
    }
    replay.wait().unwrap().good().unwrap();
    heard
}

#[test]
fn a_flight_is_replayed_from_its_log_and_from_its_record() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["demo", "--controller", "rcc", "--out", folder.path().to_str().unwrap()];
    program::run("gcs", &args).unwrap().good().unwrap();
    let run = folder.path().join("rcc");
    assert!(watched(&run.join("flight.tlog"), "1").0 >= 100);
    assert_eq!(watched(&run.join("record.jsonl"), "20"), (100, 100));
}

/// All bytes that a replay of a file sends to a watcher, and what the program says.
fn replayed(file: &Path) -> (Vec<u8>, Finished) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let out = format!("tcpout:{}", listener.local_addr().unwrap());
    let args = ["replay", file.to_str().unwrap(), "--forward", &out, "--speed", "1000", "--all"];
    let replay = Program::start("gcs", &args, None).unwrap();
    let (mut stream, _) = listener.accept().unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    (bytes, replay.wait().unwrap())
}

/// Report G3: nothing was sent of a log with one frame of a message that was redefined since, or one stray byte;
/// and a clock that was set after the start made it wait for 53 years.
#[test]
fn a_real_log_with_damage_is_replayed_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let (mut log, mut frames, mut encoder) = (Vec::new(), Vec::new(), Encoder::new(1, 1));
    for k in 0..50_u64 {
        let mut frame = Vec::new();
        encoder.push(&mut frame, &GLOBAL_POSITION_INT_DATA { lat: k as i32, alt: 7, ..Default::default() });
        if k == 20 {
            frame[12] ^= 1;
        }
        // The clock is set at the 10th frame.
        let time = if k < 10 { k } else { 1_700_000_000 + k };
        log.extend((time * 1_000_000).to_be_bytes());
        log.extend_from_slice(&frame);
        if k == 30 {
            log.push(0x55);
        }
        frames.extend(frame);
    }
    let file = folder.path().join("damaged.tlog");
    std::fs::write(&file, &log).unwrap();
    let (sent, said) = replayed(&file);
    assert_eq!(sent, frames);
    assert!(said.status.success(), "{said:?}");
    for word in ["1 frames with a checksum that does not fit", "1 bytes between frames"] {
        assert!(said.stderr.contains(word), "no {word} in {}", said.stderr);
    }
    let info = program::run("gcs", &["tlog", "info", "--json", file.to_str().unwrap()]).unwrap();
    let info: serde_json::Value = serde_json::from_str(&info.good().unwrap()).unwrap();
    assert_eq!((&info["frames"], &info["bad_crc"], &info["clock_set"]), (&50.into(), &1.into(), &1.into()));
}

/// Report G4: the log of a lockstep flight lasted 0.04 s and held no place on the map.
#[test]
fn a_lockstep_log_lasts_as_long_as_its_flight_and_shows_it_on_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["demo", "--controller", "rcc", "--out", folder.path().to_str().unwrap()];
    program::run("gcs", &args).unwrap().good().unwrap();
    let log = folder.path().join("rcc/flight.tlog");
    let info = program::run("gcs", &["tlog", "info", "--json", log.to_str().unwrap()]).unwrap();
    let info: serde_json::Value = serde_json::from_str(&info.good().unwrap()).unwrap();
    let seconds = info["seconds"].as_f64().unwrap();
    assert!((38.0..45.0).contains(&seconds), "{seconds} s of a flight of 40 s");
    for message in ["GLOBAL_POSITION_INT", "GPS_RAW_INT"] {
        assert!(info["messages"][message].as_u64().unwrap() >= 100, "{message}: {info}");
    }
}

/// Reports G5 and G6: a fence that is dropped is said, and the files that people have are read.
#[test]
fn plans_and_texts_as_people_have_them_are_uploaded_or_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let (_sitl, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let path = folder.path().join("file");
    let upload = |text: &str, more: &[&str]| {
        std::fs::write(&path, text).unwrap();
        gcs(address, &[&["mission", "upload", path.to_str().unwrap()][..], more].concat())
    };
    let comment = MISSION.replace("110\n", "110\n# comment as pymavlink and ArduPilot have it\n");
    assert!(upload(&comment, &[]).good().unwrap().contains("3 items uploaded"));
    let plan = |height: &str, items: &str| {
        format!(
            r#"{{"fileType":"Plan","version":1,"geoFence":{{"version":2,"circles":[{{"circle":{{"center":
            [47.3977,8.5456],"radius":100}},"inclusion":true,"version":1}}],"polygons":[]}},
            "rallyPoints":{{"version":2,"points":[[47.3977,8.5456,50]]}},"mission":{{"version":2,
            "plannedHomePosition":[47.397742,8.545594,{height}],"items":[{items}]}}}}"#
        )
    };
    let item = r#"{"type":"SimpleItem","command":16,"frame":3,"autoContinue":true,"doJumpId":1,
        "params":[0,0,0,null,47.3990,8.5460,100]}"#;
    let only = upload(&plan("null", item), &["--mission-only"]).good().unwrap();
    assert!(only.contains("2 items uploaded") && !only.contains("fence"), "{only}");
    for text in [plan("488", item), plan("488", "")] {
        let finished = upload(&text, &[]);
        let said = format!("{} {}", finished.stdout, finished.stderr);
        assert!(
            said.contains("fence: 1 items uploaded") || said.contains("its fence is not uploaded"),
            "{said}"
        );
        assert_eq!(finished.status.success(), said.contains("rally points: 1 items uploaded"), "{said}");
    }
}

/// Report G10: lines for the radio and for another vehicle were set on the autopilot.
#[test]
fn a_parameter_file_s_lines_go_to_their_own_components() {
    let folder = tempfile::tempdir().unwrap();
    let (_sitl, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let file = folder.path().join("two.params");
    let lines =
        "# Vehicle-Id Component-Id Name Value Type\n1\t1\tRATE_ATTITUDE\t7\t9\n1\t68\tRADIO_TXP\t4\t6\n";
    std::fs::write(&file, lines).unwrap();
    let loaded = good(address, &["param", "load", file.to_str().unwrap()]);
    assert!(loaded.contains("2 set, 0 as they were, 0 refused"), "{loaded}");
    assert_eq!(
        good(address, &["param", "--component", "68", "get", "RADIO_TXP"]).trim(),
        "RADIO_TXP        4"
    );
    std::fs::write(&file, format!("{lines}2\t1\tRATE_ATTITUDE\t11\t9\n")).unwrap();
    let finished = gcs(address, &["param", "load", file.to_str().unwrap()]);
    assert!(finished.stdout.contains("1 parameters are for system 2"), "{finished:?}");
    refused(&finished, &["1 of 3 parameters were not set"]);
    assert_eq!(good(address, &["param", "get", "RATE_ATTITUDE"]).trim(), "RATE_ATTITUDE    7");
}

/// Report G14: a result that cannot be written was a panic, and an error with `--json` no JSON.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_stdout_is_an_error_and_no_panic() {
    let (_sitl, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let connect = format!("udpout:{address}");
    let folder = tempfile::tempdir().unwrap();
    let demo = ["demo", "--controller", "rcc", "--json", "--out", folder.path().to_str().unwrap()];
    for args in [&["param", "--connect", &connect, "list"][..], &demo] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let mut command = std::process::Command::new(program::path("gcs").unwrap());
        command.args(args).current_dir(program::workspace()).stdout(full);
        let output = command.output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("error: writing to stdout: No space left"), "{said}");
    }
    let missing = program::run("gcs", &["demo", "--json", "--scenario", "no-such-file.toml"]).unwrap();
    let error: serde_json::Value = serde_json::from_str(&missing.stdout).unwrap();
    assert!(error["error"].as_str().unwrap().contains("no-such-file.toml"), "{error}");
}

/// Report V13: a mistyped name of the key's file left the vehicle unsigned without a word.
#[test]
fn a_key_file_that_is_not_there_is_said_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("mistyped").to_str().unwrap().to_owned();
    let args = ["--listen", "udpin:127.0.0.1:0", "--signing-key", &missing];
    refused(
        &program::run("sitl", &[&args[..], &["--signing", "required"]].concat()).unwrap(),
        &["no key in"],
    );
    let (sitl, _) = program::sitl(&["--pace", "realtime", "--signing-key", &missing]).unwrap();
    sitl.logs("unsigned until SETUP_SIGNING brings one").unwrap();
}

/// Item 6: a key is made, told from others, and never shown.
#[test]
fn a_key_is_made_and_known_by_its_fingerprint_alone() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let run = |args: &[&str]| program::run("gcs", &[&["key"][..], args].concat()).unwrap();
    let made = run(&["new", &file("one")]).good().unwrap();
    run(&["new", &file("two")]).good().unwrap();
    let text = std::fs::read_to_string(file("one")).unwrap();
    let key = text.lines().find_map(|line| line.strip_prefix("key = ")).unwrap().trim_matches('"').to_owned();
    assert_eq!(key.len(), 64);
    let shown = run(&["show-fingerprint", &file("one")]).good().unwrap();
    assert_eq!(shown, made);
    assert!(!shown.contains(&key[..16]) && !key.contains(&shown[..16]));
    assert_ne!(run(&["show-fingerprint", &file("two")]).good().unwrap()[..16], shown[..16]);
    refused(&run(&["new", &file("one")]), &["never replaced"]);
    refused(&run(&["show-fingerprint", &file("none")]), &["no such file"]);
    // Nor does a program that uses it say it, however much it logs.
    let vehicle = file("vehicle");
    std::fs::copy(file("one"), &vehicle).unwrap();
    let args = ["--pace", "realtime", "--signing", "required", "--signing-key", &vehicle];
    let (sitl, address) = program::sitl(&args).unwrap();
    let mut command = std::process::Command::new(program::path("gcs").unwrap());
    let connect = format!("udpout:{address}");
    command.args(["param", "--connect", &connect, "--signing-key", &file("one"), "get", "SCALE_UNIT_M"]);
    let output = command.env("RUST_LOG", "trace").output().unwrap();
    assert!(output.status.success());
    let said = String::from_utf8_lossy(&output.stderr).into_owned() + &sitl.so_far();
    assert!(!said.contains(&key), "the key is in the log");
}
