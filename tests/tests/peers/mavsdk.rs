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

/// Takeoff, offboard by position and body velocity, a place on Earth, a fence that holds, and a picture.
#[test]
fn mavsdk_flies_by_actions_and_setpoints_inside_a_fence() {
    let (_sitl, address) = program::sitl(&["--speed", "4", "--open", "--on-ground"]).unwrap();
    let said = python::script("mavsdk_guided.py", &[address.to_string()]).unwrap().good().unwrap();
    assert!(said.ends_with("ok"), "{said}");
}
