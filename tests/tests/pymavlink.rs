//! `sitl` as a stranger meets it: pymavlink flies it, in real time, over UDP.

use tests::{program, python};

/// Heartbeat, position, a push north, the transmit power by command and by parameter, and a picture
/// whose red disc lies where the vehicle says that it is.
#[test]
fn pymavlink_flies_north_and_sees_the_uav() {
    let (_sitl, address) = program::sitl(&["--pace", "realtime", "--speedup", "4"]).unwrap();
    let said = python::script("fly_north.py", &[address.to_string()]).unwrap().good().unwrap();
    assert!(said.ends_with("ok"), "{said}");
}
