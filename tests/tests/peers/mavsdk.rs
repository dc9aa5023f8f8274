//! MAVSDK-Python, whose C++ library finds its own way to connect, arm and fly.

use tests::{program, python};

/// Runs a script against a vehicle of its own.
fn agrees(script: &str) {
    let (_sitl, address) = program::sitl(&["--pace", "realtime", "--speed", "4"]).unwrap();
    let said = python::script(script, &[address.to_string()]).unwrap().good().unwrap();
    assert!(said.ends_with("ok"), "{said}");
}

/// Discovery, health, telemetry, parameters, arming, and a flight by acceleration setpoints.
#[test]
fn mavsdk_flies_north_in_offboard() {
    agrees("mavsdk_north.py");
}

/// A mission, up and down, flown, paused; then it returns.
#[test]
fn mavsdk_has_a_mission_flown() {
    agrees("mavsdk_mission.py");
}
