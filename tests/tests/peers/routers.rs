//! A router between `gcs` and `sitl`: both ends go on as if it were not there.

use std::fs;
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;

use tests::program::{self, Program};

use super::mavproxy;

/// A port of the system's choice for a program that must be told one.
fn free_address() -> SocketAddr {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

fn lockstep() -> (Program, SocketAddr) {
    program::sitl(&["--pace", "lockstep", "--scenario", "demo", "--ticks", "100"]).unwrap()
}

/// The records of CRPL's flight, from pictures, of the vehicle behind `address`.
fn flown_through(address: SocketAddr, folder: &Path) -> String {
    let out = folder.join("run");
    let connect = format!("udpout:{address}");
    let args = ["fly", "--connect", &connect, "--scenario", "demo", "--out", out.to_str().unwrap()];
    program::run("gcs", &args).unwrap().good().unwrap();
    let records = fs::read_to_string(out.join("record.jsonl")).unwrap();
    assert_eq!(records.lines().count(), 100);
    records
}

fn flown_directly(folder: &Path) -> String {
    let (_sitl, address) = lockstep();
    flown_through(address, &folder.join("direct"))
}

/// MAVProxy repacks nothing, but it knows neither of the two and asks questions of its own.
#[test]
fn through_mavproxy_it_is_the_same_flight() {
    let folder = tempfile::tempdir().unwrap();
    let (sitl, address) = lockstep();
    let out = free_address();
    let flags = ["--daemon", "--non-interactive", "--out", &format!("udpin:{out}")];
    let mut router = mavproxy::start(address, folder.path(), &flags);
    router.hears("Detected vehicle 1:68").unwrap();
    assert_eq!(flown_through(out, folder.path()), flown_directly(folder.path()));
    let said = sitl.wait().unwrap().good().unwrap();
    assert!(said.contains("flight over after 100 ticks"), "{said}");
}
