//! `gcs link` as tools meet it: the real programs, over UDP, behind a radio.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime};

use crpl_sitl::link::dialect::{COMMAND_LONG_DATA, HEARTBEAT_DATA, MavAutopilot, MavType};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::telemetry::LocalPositionNed;
use crpl_sitl::link::tlog::Tlog;
use tests::program::{self, Program};
use tests::python;

/// `gcs link` between the vehicle at an address and a port of the system's choice.
fn link(vehicle: SocketAddr, args: &[&str]) -> (Program, SocketAddr) {
    let vehicle = format!("udpout:{vehicle}");
    let ends = ["link", "--vehicle", &vehicle, "--ground", "udpin:127.0.0.1:0", "--summary"];
    let link = Program::start("gcs", &[&ends[..], args].concat(), None).unwrap();
    let ground = link.line("ground: listening on udpin:").unwrap();
    (link, ground.parse().unwrap())
}

/// All that it printed, after Ctrl-C.
fn end(link: Program) -> String {
    link.interrupt().unwrap();
    link.wait().unwrap().good().unwrap()
}

/// The column of a row of the table, in percent or ms.
fn number(table: &str, row: &str, column: usize) -> f64 {
    let line = table.lines().find(|line| line.split_whitespace().next() == Some(row));
    let line = line.unwrap_or_else(|| panic!("no row {row} in\n{table}"));
    let word = line.split_whitespace().nth(column).unwrap();
    word.trim_end_matches('%').parse().unwrap_or_else(|_| panic!("{word} in\n{table}"))
}

/// Each of these begins a line that ends with a time.
#[track_caller]
fn tells(told: &str, what: &[&str]) {
    for what in what {
        assert!(
            told.lines().any(|line| line.starts_with(what) && line.ends_with(" s")),
            "no {what} in\n{told}"
        );
    }
}

/// 19 km from its station a SiK radio loses a good part of all packets. Lists and missions still end, and the table
/// says how long they took.
#[test]
fn parameters_and_missions_complete_at_the_edge_of_range() {
    let (_sitl, vehicle) = program::sitl(&["--pace", "realtime"]).unwrap();
    let (link, ground) = link(vehicle, &["--radio", "sik-57", "--base", "250,-19000,0", "--seed", "4"]);
    let said = python::script("link_edge.py", &[ground.to_string()]).unwrap().good().unwrap();
    assert!(said.ends_with("ok"), "{said}");
    let told = end(link);
    println!("{told}");
    tells(&told, &["parameters down: ", "mission up: 6 entries in ", "mission down: 6 entries in "]);
    // The air, not a full queue, is what the edge of range is about.
    assert!(number(&told, "down", 3) - number(&told, "down", 6) > 5.0, "{told}");
}

/// The same for MAVSDK, whose user asks again when it has given up.
#[test]
fn mavsdk_has_a_mission_go_up_and_down_at_the_edge_of_range() {
    let (_sitl, vehicle) = program::sitl(&["--pace", "realtime"]).unwrap();
    let (link, ground) = link(vehicle, &["--radio", "sik-57", "--base", "250,-18000,0", "--seed", "4"]);
    let said = python::script("link_mavsdk.py", &[ground.to_string()]).unwrap().good().unwrap();
    assert!(said.ends_with("ok"), "{said}");
    let told = end(link);
    println!("{told}");
    tells(&told, &["mission up: 6 entries in ", "mission down: 6 entries in "]);
}

/// MAVProxy over the same radio, slow and within its range: it asks again for items, and not for a lost acknowledgement.
#[test]
fn mavproxy_has_parameters_and_a_mission_over_a_slow_radio() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.waypoints");
    let item = |seq, latitude| format!("{seq}\t0\t3\t16\t0\t0\t0\t0\t{latitude}\t8.5456\t100\t1\n");
    let items: String = (0..3).map(|seq| item(seq, 47.4 + 0.001 * f64::from(seq))).collect();
    std::fs::write(&plan, format!("QGC WPL 110\n{items}")).unwrap();
    let (_sitl, vehicle) = program::sitl(&["--pace", "realtime"]).unwrap();
    let (link, ground) = link(vehicle, &["--radio", "sik-57", "--base", "250,-3000,0", "--seed", "4"]);
    let mut command = python::tool("mavproxy.py").unwrap();
    command.args([
        "--master",
        &format!("udpout:{ground}"),
        "--default-modules",
        "wp,param",
        "--aircraft=test",
    ]);
    command.arg("--state-basedir").arg(folder.path()).current_dir(folder.path());
    let mut mavproxy = Program::converse("mavproxy.py", command).unwrap();
    for (say, hears) in [
        (None, " parameters to "),
        (Some(format!("wp load {}", plan.display())), "MISSION_ACK: TYPE_MISSION: ACCEPTED"),
        (Some("wp list".into()), "Saved 3 waypoints"),
    ] {
        if let Some(say) = say {
            mavproxy.tell(&say).unwrap();
        }
        mavproxy.hears(hears).unwrap();
    }
    mavproxy.tell("exit").unwrap();
    let told = end(link);
    println!("{told}");
    tells(&told, &["parameters down: ", "mission up: 3 entries in ", "mission down: 3 entries in "]);
}

fn flown(endpoint: &str, folder: &Path) -> String {
    let args = ["fly", "--connect", endpoint, "--scenario", "demo", "--out"];
    program::run("gcs", &[&args[..], &[folder.to_str().unwrap()]].concat()).unwrap().good().unwrap();
    std::fs::read_to_string(folder.join("record.jsonl")).unwrap()
}

fn lockstep() -> (Program, SocketAddr) {
    program::sitl(&["--pace", "lockstep", "--scenario", "demo", "--seed", "5", "--ticks", "100"]).unwrap()
}

/// In lockstep the vehicle's clock alone makes the radio's time pass, and a lost percept is sent again: a radio in
/// between changes no byte of a flight.
#[test]
fn a_lockstep_flight_through_a_radio_is_the_flight_without_it() {
    let folder = tempfile::tempdir().unwrap();
    let (_direct, address) = lockstep();
    let expected = flown(&format!("udpout:{address}"), &folder.path().join("direct"));
    // Every fiftieth packet is lost. A picture of 10 kB would find no room in a SiK radio's queue.
    let lossy = "retries = 0\nerror = { model = \"waterfall\", per = 0.02, width_db = 1e9 }\n";
    let file = folder.path().join("lossy.toml");
    std::fs::write(&file, format!("extends = \"lte\"\n[up]\n{lossy}[down]\n{lossy}")).unwrap();
    let lossy = ["--radio", file.to_str().unwrap(), "--clock", "vehicle"];
    for (name, radio, lost) in [("perfect", &["--radio", "perfect"][..], 0.0), ("lossy", &lossy, 0.5)] {
        let (sitl, address) = lockstep();
        let (link, ground) = link(address, radio);
        let record = flown(&format!("udpout:{ground}"), &folder.path().join(name));
        assert_eq!(record, expected, "{name}");
        sitl.wait().unwrap().good().unwrap();
        let table = end(link);
        assert!(number(&table, "down", 1) > 100.0 && number(&table, "down", 3) >= lost, "{table}");
    }
}

/// A flight away from its station: 60 s of a vehicle's reports, and a station's commands.
fn write_log(path: &Path) {
    let mut log = Tlog::new(std::fs::File::create(path).unwrap());
    let (mut vehicle, mut station) = (Encoder::new(1, 1), Encoder::new(255, 190));
    for k in 0..600_u32 {
        let mut bytes = Vec::new();
        if k % 10 == 0 {
            let beat = HEARTBEAT_DATA {
                mavtype: MavType::MAV_TYPE_QUADROTOR,
                autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
                ..Default::default()
            };
            vehicle.push(&mut bytes, &beat);
            station.push(&mut bytes, &COMMAND_LONG_DATA { target_system: 1, ..Default::default() });
        }
        let position = [40.0 * k as f32, 0.0, -100.0];
        let report = LocalPositionNed { time_boot_ms: 100 * k, position, velocity: [400.0, 0.0, 0.0] };
        vehicle.push_view(&mut bytes, &report);
        let time = SystemTime::UNIX_EPOCH + Duration::from_millis(1_700_000_000_000 + u64::from(100 * k));
        log.datagram(&bytes, time).unwrap();
    }
    log.flush().unwrap();
}

/// The same seed and the same geometry give the same ledger, byte for byte, also where all cores are busy; from a
/// recorded geometry it is the same again.
#[test]
fn a_log_through_a_radio_gives_the_same_ledger_on_a_busy_machine() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    write_log(Path::new(&path("flight.tlog")));
    let carry = |ledger: &str, more: &[&str]| {
        let (log, ledger) = (path("flight.tlog"), path(ledger));
        let args = ["link", "--traffic", &log, "--radio", "sik-57", "--ledger", &ledger, "--summary"];
        let table = program::run("gcs", &[&args[..], more].concat()).unwrap().good().unwrap();
        (std::fs::read(ledger).unwrap(), table)
    };
    let (first, table) = carry("first", &["--seed", "1", "--record", &path("geometry.csv")]);
    assert!(number(&table, "down", 3) > 5.0 && number(&table, "COMMAND_LONG", 1) == 60.0, "{table}");
    let stop = Arc::new(AtomicBool::new(false));
    let busy: Vec<_> = (0..std::thread::available_parallelism().unwrap().get())
        .map(|_| {
            let stop = Arc::clone(&stop);
            std::thread::spawn(move || while !stop.load(Ordering::Relaxed) {})
        })
        .collect();
    let again = carry("again", &["--seed", "1"]);
    stop.store(true, Ordering::Relaxed);
    busy.into_iter().for_each(|thread| thread.join().unwrap());
    assert!(again.0 == first, "the same seed and geometry");
    assert_eq!(again.1, table);
    let replayed = carry("replayed", &["--seed", "1", "--replay", &path("geometry.csv")]);
    assert!(replayed.0 == first, "from a recorded geometry");
    assert!(carry("other", &["--seed", "2"]).0 != first, "another seed");
}

/// A disk without room for the ledger stops no frame, and the exit code tells.
#[test]
fn a_full_disk_ends_the_ledger_and_not_the_link() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("flight.tlog");
    write_log(&log);
    let args = ["link", "--traffic", log.to_str().unwrap(), "--radio", "perfect", "--ledger", "/dev/full"];
    let finished = program::run("gcs", &args).unwrap();
    assert_eq!(finished.status.code(), Some(1));
    assert!(finished.stderr.contains("writing the ledger"), "{}", finished.stderr);
    assert_eq!(number(&finished.stdout, "down", 1), 660.0);
}

#[test]
fn a_radio_that_is_none_is_told_in_one_line() {
    let refused = |radio: &str| {
        let args =
            ["link", "--vehicle", "udpin:127.0.0.1:0", "--ground", "udpin:127.0.0.1:0", "--radio", radio];
        let finished = program::run("gcs", &args).unwrap();
        assert_eq!(finished.status.code(), Some(1));
        finished.stderr
    };
    assert!(refused("sik").contains("`sik` is neither a radio file nor one of perfect, paper, sik-57"));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("radio.toml");
    std::fs::write(&file, "extends = \"sik-57\"\n[down]\nlatency_s = -1\n").unwrap();
    assert!(refused(file.to_str().unwrap()).contains("down.latency_s is -1, must be in [0, 1e6]"));
}
