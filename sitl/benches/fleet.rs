//! 255 vehicles in one process, in real time, without pictures: how late their control intervals begin,
//! and what they cost. Each has its own socket and hears a setpoint in every interval and a heartbeat
//! every second; the station that sends them is in this process too, so the processor's time is theirs
//! and its. The aim is to keep up on two cores.

#![expect(clippy::disallowed_methods, reason = "a benchmark")]

use std::net::UdpSocket;
use std::time::{Duration, Instant};

use crpl_sitl::link::dialect;
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::links::Links;
use crpl_sitl::link::wire::{self, Clock};
use crpl_sitl::program::shell::{LINKS, Shell};
use crpl_sitl::program::timing::Stopwatch;
use crpl_sitl::program::{cli, fleet};
use crpl_sitl::units::Tick;
use crpl_sitl::vehicle::Vehicle;
use crpl_sitl::{Scenario, Sim};

const PERIOD: Duration = Duration::from_millis(400);
const TICKS: u64 = 50;

fn main() {
    if !std::env::args().any(|arg| arg == "--bench") {
        return;
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    runtime.expect("a runtime").block_on(run());
}

async fn run() {
    let base = Scenario::default();
    let (mut shells, mut addresses) = (Vec::new(), Vec::new());
    for index in 0..fleet::MAX_VEHICLES {
        let sim = Sim::new(fleet::scenario(&base, 1, index), index as u64);
        let vehicle = Vehicle::new(sim, index as u8 + 1, Some(TICKS));
        let endpoint = "udpin:127.0.0.1:0".parse().expect("an endpoint");
        let links = Links::open(&[endpoint], LINKS).await.expect("a free port");
        let shell = Shell::over(links, vec![vehicle]);
        let told = shell.describe().remove(0);
        addresses.push(told.trim_start_matches("listening on udpin:").to_owned());
        shells.push(shell);
    }
    std::thread::spawn(move || station(&addresses));
    let stopwatch = Stopwatch::default();
    let mut flights = tokio::task::JoinSet::new();
    for mut shell in shells {
        flights.spawn(async move {
            shell.real_time(PERIOD).await;
            shell
        });
    }
    let flown = flights.join_all().await;
    let (wall, cpu) = stopwatch.elapsed();
    println!("{}", cli::stats(flown.iter(), wall, cpu));
}

/// Talks to all vehicles for as long as the process lives.
fn station(addresses: &[String]) {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    socket.set_nonblocking(true).expect("a socket that does not wait");
    let (clock, mut station) = (Clock::new(&Scenario::default()), Encoder::new(255, 190));
    let (mut buffer, mut due) = (vec![0; 65_536], Instant::now());
    for round in 0.. {
        for (index, address) in addresses.iter().enumerate() {
            let mut datagram = Vec::new();
            if round % 5 == 0 {
                station.push(&mut datagram, &dialect::HEARTBEAT_DATA::default());
            }
            // A stamp that is no tick's means now.
            let (tick, system) = (Tick(u64::MAX / 2), index as u8 + 1);
            wire::push_setpoint(tick, [1.0, 0.5], &clock, system, &mut station, &mut datagram);
            let _ = socket.send_to(&datagram, address);
            while socket.recv(&mut buffer).is_ok() {}
        }
        due += PERIOD / 2;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
}
