//! DroneKit, in its maintained fork: the scripts that people have.

use tests::{program, python};

/// Ready, its parameters, modes, a push by setpoints, and a mission that it uploads.
#[test]
fn dronekit_flies_north_and_a_mission() {
    let (_sitl, address) = program::sitl(&["--pace", "realtime", "--speed", "4"]).unwrap();
    let said = python::script("dronekit_flight.py", &[address.to_string()]).unwrap().good().unwrap();
    assert!(said.ends_with("ok"), "{said}");
}
