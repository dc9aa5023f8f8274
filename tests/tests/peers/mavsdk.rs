//! MAVSDK-Python, whose C++ library finds its own way to connect, arm and fly.

use tests::{program, python};

/// Discovery, health, telemetry, parameters, arming, and a flight by acceleration setpoints.
#[test]
fn mavsdk_flies_north_in_offboard() {
    let (_sitl, address) = program::sitl(&["--pace", "realtime", "--speedup", "4"]).unwrap();
    let said = python::script("mavsdk_north.py", &[address.to_string()]).unwrap().good().unwrap();
    assert!(said.ends_with("ok"), "{said}");
}
