//! Flights against our own vehicle on a socket.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::units::{Tick, TxPower};
use crpl_sitl::vehicle::Vehicle;
use crpl_sitl::{Scenario, Sim};
use tokio::net::UdpSocket;

use super::*;

const TICKS: u64 = 30;
const TIMEOUT: Duration = Duration::from_secs(60);

fn endpoint(text: &str) -> Endpoint {
    text.parse().unwrap()
}

fn station(percept: &Percept) -> Command {
    let [north, east] = percept.telemetry.position;
    let power = if percept.telemetry.tick.0.is_multiple_of(3) { TxPower::High } else { TxPower::Low };
    Command::new(percept.telemetry.tick, [(north * 7.0).sin(), (east * 7.0).cos()], power)
}

fn direct() -> Vec<Percept> {
    let mut sim = Sim::new(Scenario::default(), 3);
    let mut percepts = vec![sim.percept()];
    for k in 0..TICKS as usize {
        sim.handle(station(&percepts[k]));
        sim.advance();
        percepts.push(sim.percept());
    }
    percepts
}

/// A vehicle on a free port; gives its address.
async fn vehicle(lockstep: bool) -> SocketAddr {
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let address = socket.local_addr().unwrap();
    let vehicle = Vehicle::new(Sim::new(Scenario::default(), 3), 1, Some(TICKS));
    tokio::spawn(async move {
        let mut shell = crpl_sitl::program::shell::Shell::new(socket, vehicle, None);
        if lockstep { shell.lockstep().await } else { shell.real_time(Duration::from_millis(10)).await }
    });
    address
}

/// A relay to `vehicle` that loses every n-th datagram; gives the address to connect to.
async fn relay(vehicle: SocketAddr, n: u64) -> SocketAddr {
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let address = socket.local_addr().unwrap();
    tokio::spawn(async move {
        let (mut buffer, mut station, mut count) = (vec![0; 65_536], None, 0_u64);
        while let Ok((length, from)) = socket.recv_from(&mut buffer).await {
            count += 1;
            let to = if from == vehicle {
                station
            } else {
                station = Some(from);
                Some(vehicle)
            };
            if let Some(to) = to.filter(|_| !count.is_multiple_of(n)) {
                let _ = socket.send_to(&buffer[..length], to).await;
            }
        }
    });
    address
}

async fn flown(address: SocketAddr, options: &Options) -> (Vec<Percept>, Flight) {
    let mut percepts = Vec::new();
    let connect = endpoint(&format!("udpout:{address}"));
    let scenario = Scenario::default();
    let mut crew = |percept: &Percept| {
        percepts.push(percept.clone());
        station(percept)
    };
    let flight = fly(&connect, &scenario, options, &mut crew);
    let flight = tokio::time::timeout(TIMEOUT, flight).await.unwrap().unwrap();
    percepts.extend(flight.last.clone());
    (percepts, flight)
}

/// A crew with a tlog.
struct Logging(PathBuf);

impl Crew for Logging {
    fn command(&mut self, percept: &Percept) -> Command {
        station(percept)
    }

    fn begin(&mut self) -> Result<Option<PathBuf>> {
        Ok(Some(self.0.clone()))
    }
}

fn options() -> Options {
    Options { ticks: Some(TICKS), ..Options::default() }
}

#[tokio::test]
async fn lockstep_over_udp_is_the_flight_in_process() {
    let (percepts, flight) = flown(vehicle(true).await, &options()).await;
    assert_eq!(percepts, direct());
    assert_eq!(flight.ended, FlightEnd::Over);
    assert_eq!(flight.latencies_us.len(), TICKS as usize);
    assert_eq!(flight.rejected_messages, 0);
}

#[tokio::test]
async fn lockstep_over_a_lossy_path_is_the_flight_in_process() {
    let address = relay(vehicle(true).await, 7).await;
    let (percepts, _) = flown(address, &options()).await;
    assert_eq!(percepts, direct());
}

#[tokio::test]
async fn real_time_flies_to_its_end() {
    let (percepts, _) = flown(vehicle(false).await, &options()).await;
    assert_eq!(percepts.last().map(|p| p.telemetry.tick), Some(Tick(TICKS)));
}

#[tokio::test]
async fn the_log_holds_both_directions() {
    let path = std::env::temp_dir().join(format!("fly-{}.tlog", std::process::id()));
    let connect = endpoint(&format!("udpout:{}", vehicle(true).await));
    let flight = fly(&connect, &Scenario::default(), &options(), &mut Logging(path.clone())).await;
    assert_eq!(flight.unwrap().ended, FlightEnd::Over);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    let (mut at, mut systems, mut last) = (0, std::collections::BTreeSet::new(), 0);
    while at < bytes.len() {
        let time = u64::from_be_bytes(bytes[at..at + 8].try_into().unwrap());
        assert!(time >= last && bytes[at + 8] == 0xFD);
        last = time;
        systems.insert(bytes[at + 13]);
        at += 8 + 12 + usize::from(bytes[at + 9]);
    }
    assert_eq!(systems.into_iter().collect::<Vec<_>>(), [1, 255]);
}

#[tokio::test]
async fn nobody_there_is_said_in_one_line() {
    let silent = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let connect = endpoint(&format!("udpout:{}", silent.local_addr().unwrap()));
    let options = Options { timeout: Duration::from_millis(200), ..Options::default() };
    let mut crew = station;
    let scenario = Scenario::default();
    let flight = fly(&connect, &scenario, &options, &mut crew);
    let error = flight.await.unwrap_err().to_string();
    assert!(error.starts_with(&format!("{connect}: no vehicle heard for 1 s")), "{error}");
}

#[tokio::test]
async fn a_link_that_falls_silent_is_told_with_its_tick() {
    let target = vehicle(true).await;
    let cut = relay(target, u64::MAX).await;
    let options = Options { timeout: Duration::from_secs(1), ..Options::default() };
    // The vehicle's flight is over after its last tick, and then it falls silent.
    let connect = endpoint(&format!("udpout:{cut}"));
    let scenario = Scenario::default();
    let mut crew = station;
    let flight = fly(&connect, &scenario, &options, &mut crew);
    let flight = tokio::time::timeout(TIMEOUT, flight).await.unwrap().unwrap();
    assert_eq!(flight.ended, FlightEnd::LinkLost);
    let (what, tick) = flight.why.rsplit_once(' ').unwrap();
    assert!(what.ends_with("vehicle 1 sent no new percept for 1 s after tick"), "{what}");
    assert!(tick.parse::<u64>().unwrap() <= TICKS, "{tick}");
}
