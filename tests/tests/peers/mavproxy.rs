//! MAVProxy without a window, told what to do on its stdin and on its command line.

use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Instant;

use tests::program::{self, PATIENCE, Program};
use tests::python;

/// MAVProxy's own default modules but for `terrain`, which asks for height maps of the real Earth.
const MODULES: &str = "log,signing,wp,rally,fence,ftp,param,relay,tuneopt,arm,mode,calibration,rc,auxopt,misc,\
                       cmdlong,battery,output,adsb,layout";

/// Starts MAVProxy on the vehicle at `address`; its log goes to `folder`.
pub fn start(address: SocketAddr, folder: &Path, flags: &[&str]) -> Program {
    let mut command = python::tool("mavproxy.py").unwrap();
    command.args(["--master", &format!("udpout:{address}"), "--default-modules", MODULES, "--aircraft=test"]);
    command.arg("--state-basedir").arg(folder).args(flags).current_dir(folder);
    Program::converse("mavproxy.py", command).unwrap()
}

/// Nothing that MAVProxy has met so far was beyond it.
fn untroubled(mavproxy: &Program) {
    let all = mavproxy.so_far();
    assert!(!all.contains("Traceback") && !all.contains("breach"), "{all}");
}

/// Waits for its orderly end. Its exit code is 1 however well that went, and while it unloads its modules
/// its other threads may still stumble over what is gone already.
fn ended(mavproxy: Program) {
    let all = mavproxy.wait().unwrap().stdout;
    assert!(all.contains("Unloading module link"), "{all}");
}

/// The number that stands behind some words.
fn number(line: &str, before: &str) -> u64 {
    let (_, rest) = line.split_once(before).unwrap_or_else(|| panic!("no `{before}` in {line:?}"));
    let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().unwrap_or_else(|_| panic!("no number after `{before}` in {line:?}"))
}

/// The only file of this name under a folder.
fn file(folder: &Path, name: &str) -> PathBuf {
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.file_name().is_some_and(|found| found == name) {
                return path;
            }
        }
    }
    panic!("MAVProxy wrote no {name}")
}

/// It finds the vehicle and its radio, gets every parameter, sets one, changes the mode, has what a map
/// needs, and its own log of all that is whole: no bad data, no message lost.
#[test]
fn mavproxy_takes_it_for_a_copter() {
    let folder = tempfile::tempdir().unwrap();
    let (_sitl, address) = program::sitl(&["--pace", "realtime", "--speed", "4"]).unwrap();
    let mut mavproxy = start(address, folder.path(), &[]);
    mavproxy.hears("Detected vehicle 1:1 on link 0").unwrap();
    mavproxy.hears("Mode GUIDED").unwrap();
    mavproxy.hears("Detected vehicle 1:68 on link 0").unwrap();
    let received = number(&mavproxy.hears("Received ").unwrap(), "Received ");
    let saved = number(&mavproxy.hears("Saved ").unwrap(), "Saved ");
    let lines = fs::read_to_string(file(folder.path(), "mav.parm")).unwrap().lines().count() as u64;
    assert!(received > 20 && received == saved && saved == lines, "{received}, {saved}, {lines} parameters");

    mavproxy.tell("param set RATE_ATTITUDE 10").unwrap();
    for (tell, hears) in [
        ("mode GUIDED", "Got COMMAND_ACK: DO_SET_MODE: ACCEPTED"),
        ("arm throttle", "Got COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED"),
        ("long 31289", "command : 31289, result : 3"),
        ("wp list", "Requesting "),
    ] {
        mavproxy.tell(tell).unwrap();
        mavproxy.hears(hears).unwrap();
    }
    // It sets parameters in its own time.
    let deadline = Instant::now() + PATIENCE;
    loop {
        mavproxy.tell("param fetch RATE_ATTITUDE").unwrap();
        if mavproxy.hears("RATE_ATTITUDE = ").unwrap().ends_with("= 10.0000000") {
            break;
        }
        assert!(Instant::now() < deadline, "RATE_ATTITUDE does not change");
    }
    // What a map and a head-up display are drawn from.
    for (message, says) in [
        ("GLOBAL_POSITION_INT", "lat : 473999878, lon : 85462575, alt : 588000, relative_alt : 100000"),
        ("HOME_POSITION", "latitude : 473999878, longitude : 85462575, altitude : 488000"),
        ("ATTITUDE", "roll : 0.0"),
        ("SYS_STATUS", "voltage_battery : 14800"),
        ("BATTERY_STATUS", "battery_remaining : 100"),
        ("EXTENDED_SYS_STATE", "landed_state : 2"),
        ("SYSTEM_TIME", "time_boot_ms"),
        ("LOCAL_POSITION_NED", "x : 250.0, y : 50.0, z : -100.0"),
    ] {
        mavproxy.tell(&format!("status {message}")).unwrap();
        let line = mavproxy.hears(&format!(": {message} {{")).unwrap();
        assert!(line.contains(says), "{line}");
    }
    mavproxy.tell("link").unwrap();
    let link = mavproxy.hears("link 1 OK").unwrap();
    assert!(link.contains(" 0 lost, 0.0% loss"), "{link}");
    untroubled(&mavproxy);
    mavproxy.hang_up();
    ended(mavproxy);

    let tlog = file(folder.path(), "flight.tlog");
    let dump = python::mavlogdump(&tlog).unwrap();
    assert!(dump.contains("GLOBAL_POSITION_INT") && !dump.contains("BAD_DATA"), "{dump}");
    let loss = python::mavloss(&tlog).unwrap();
    assert!(loss.contains(" packets, 0 lost 0.0%"), "{loss}");
}

/// As on a companion computer: no terminal, the work on the command line, ended by a signal.
#[test]
fn mavproxy_runs_as_a_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let (_sitl, address) = program::sitl(&["--pace", "realtime", "--speed", "4"]).unwrap();
    let flags = ["--daemon", "--non-interactive", "--cmd", "set heartbeat 2; link"];
    let mut mavproxy = start(address, folder.path(), &flags);
    mavproxy.hears("link 1 OK").unwrap();
    mavproxy.hears("Mode GUIDED").unwrap();
    mavproxy.hears("Received ").unwrap();
    untroubled(&mavproxy);
    mavproxy.interrupt().unwrap();
    ended(mavproxy);
    let loss = python::mavloss(&file(folder.path(), "flight.tlog")).unwrap();
    assert!(loss.contains(" packets, 0 lost 0.0%"), "{loss}");
}
