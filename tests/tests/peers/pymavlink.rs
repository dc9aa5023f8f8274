//! `sitl` as a stranger meets it: pymavlink flies it, in real time, over UDP.

use std::fs;

use tests::{program, python};

/// Runs a script against a vehicle of its own.
fn agrees(script: &str) {
    let (_sitl, address) = program::sitl(&["--pace", "realtime", "--speed", "4"]).unwrap();
    let said = python::script(script, &[address.to_string()]).unwrap().good().unwrap();
    assert!(said.ends_with("ok"), "{said}");
}

/// Heartbeat, position, a push north, the transmit power by command and by parameter, and a picture
/// whose red disc lies where the vehicle says that it is.
#[test]
fn pymavlink_flies_north_and_sees_the_uav() {
    agrees("radio_and_camera.py");
}

/// The example does what it prints, and the frame that it saves is a PNG.
#[test]
fn the_pymavlink_example_flies_north() {
    let folder = tempfile::tempdir().unwrap();
    let frame = folder.path().join("frame.png");
    let (_sitl, address) = program::sitl(&["--pace", "realtime", "--speed", "4"]).unwrap();
    let args = [address.to_string().into(), frame.clone().into_os_string()];
    let said = python::script("../../examples/fly_north.py", &args).unwrap().good().unwrap();
    for step in ["at north 250.0 m", "pushed: north 2", "braked: north 2", "at power 4", "frame in"] {
        assert!(said.contains(step), "{said}");
    }
    assert!(fs::read(frame).unwrap().starts_with(b"\x89PNG"));
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

/// No tutorial's script moved the vehicle. These do: takeoff, positions, velocities, on Earth and in the body's
/// frame, and a reboot.
#[test]
fn pymavlink_flies_by_positions_and_velocities_anywhere() {
    let home = "-35.363261,149.165230,584,353";
    let flags = ["--speed", "8", "--open", "--on-ground", "--home", home];
    let (_sitl, address) = program::sitl(&flags).unwrap();
    let said = python::script("setpoints.py", &[address.to_string()]).unwrap().good().unwrap();
    assert!(said.ends_with("ok"), "{said}");
}

/// What `sitl` answers to sixty messages is what docs/probes.md says, beside what ArduCopter and PX4 answer.
#[test]
fn pymavlink_probes_the_vehicle() {
    let (_sitl, address) = program::sitl(&["--open"]).unwrap();
    let said = python::script("probes.py", &[address.to_string()]).unwrap().good().unwrap();
    let page = fs::read_to_string(program::workspace().join("docs/probes.md")).unwrap();
    let table = page.split_once("| | what is asked |").unwrap().1;
    let told = said.split_once("| | what is asked |").unwrap().1;
    for (wanted, told) in table.trim().lines().zip(told.trim().lines()) {
        assert_eq!(told, wanted);
    }
    assert_eq!(table.trim().lines().count(), told.trim().lines().count());
}

/// A mission goes up, comes down again, is flown to its end; what cannot be flown is refused.
#[test]
fn pymavlink_has_a_mission_flown() {
    agrees("missions.py");
}

/// A vehicle without a key is given one, signs, and answers nobody who does not; after a restart it
/// still knows the key, and what it heard before. The key itself is nowhere but in its file.
#[test]
fn pymavlink_and_the_vehicle_sign() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (key_file, frame, params) = (at("key.toml"), at("frame"), at("saved.param"));
    let key: String = (0u8..32).map(|byte| format!("{:02x}", byte.wrapping_mul(37) ^ 0xA5)).collect();
    // The script sets SIGN_REQUIRED the first time; a restart needs the flag.
    for (again, policy) in [(&[][..], "optional"), (&["again"][..], "required")] {
        let flags =
            ["--speed", "4", "--signing-key", &key_file, "--signing", policy, "--save-params", &params];
        let (sitl, address) = program::sitl(&flags).unwrap();
        let address = address.to_string();
        let args = [&[address.as_str(), &key, &frame], again].concat();
        let said = python::script("signing.py", &args).unwrap().good().unwrap();
        assert!(said.ends_with("ok"), "{said}");
        sitl.interrupt().unwrap();
        let ended = sitl.wait().unwrap();
        for refused in ["unsigned", "wrong signature", "replayed", "too old"] {
            assert!(ended.stderr.contains(&format!("refused: {refused}")), "{}", ended.stderr);
        }
        let params = fs::read_to_string(&params).unwrap();
        let told = [ended.stdout, ended.stderr, params].concat().to_lowercase();
        assert!(!told.contains(&key), "the key is told:\n{told}");
    }
    assert!(fs::read_to_string(&key_file).unwrap().contains(&key));
}
