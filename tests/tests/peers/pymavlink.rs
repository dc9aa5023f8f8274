//! `sitl` as a stranger meets it: pymavlink flies it, in real time, over UDP.

use tests::{program, python};

/// Runs a script against a vehicle of its own.
fn agrees(script: &str) {
    let (_sitl, address) = program::sitl(&["--pace", "realtime", "--speedup", "4"]).unwrap();
    let said = python::script(script, &[address.to_string()]).unwrap().good().unwrap();
    assert!(said.ends_with("ok"), "{said}");
}

/// Heartbeat, position, a push north, the transmit power by command and by parameter, and a picture
/// whose red disc lies where the vehicle says that it is.
#[test]
fn pymavlink_flies_north_and_sees_the_uav() {
    agrees("fly_north.py");
}

/// Every parameter of both components, read and set; what is no value, or no parameter, changes nothing.
#[test]
fn pymavlink_reads_and_sets_parameters() {
    agrees("params.py");
}

/// Acknowledgements, requests, rates; and silence towards what is meant for others.
#[test]
fn pymavlink_is_answered() {
    agrees("commands.py");
}

/// A mission goes up, comes down again, is flown to its end; what cannot be flown is refused.
#[test]
fn pymavlink_has_a_mission_flown() {
    agrees("missions.py");
}
