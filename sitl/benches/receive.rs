//! What comes in, and how fast it is answered: frames a second of the whole receive path beside the bare
//! `mavlink` crate in the same run (the aim is 0.9 of it), the round trip of a TIMESYNC over loopback (the
//! aim is a 99th percentile of 1 ms), and control intervals over loopback in lockstep.

#![expect(clippy::disallowed_methods, reason = "a benchmark")]

mod rate;

use std::hint::black_box;
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{self, MavMessage};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::image::{self, Reassembler};
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::service::Timesync;
use crpl_sitl::link::wire::{self, Clock, TelemetryReader};
use crpl_sitl::program::shell::Shell;
use crpl_sitl::program::timing::Histogram;
use crpl_sitl::radio::message::Command;
use crpl_sitl::units::TxPower;
use crpl_sitl::vehicle::Vehicle;
use crpl_sitl::{Scenario, Sim};
use mavlink::{MavlinkReader, Message};

const MESSAGES: usize = 60_000;
const ROUND_TRIPS: usize = 20_000;
const TICKS: u64 = 5_000;
/// Long enough for a busy machine; reached only if something is broken.
const PATIENCE: Duration = Duration::from_secs(5);

fn main() {
    receive();
    if std::env::args().any(|arg| arg == "--bench") {
        round_trip();
        for pictures in [false, true] {
            lockstep(pictures);
        }
    }
}

/// What a vehicle hears on a busy link: one frame a datagram, half of it for others.
fn traffic() -> Vec<Vec<u8>> {
    let (mut station, mut other) = (Encoder::new(255, 190), Encoder::new(2, 1));
    let clock = Clock::new(&Scenario::default());
    let datagrams = (0..MESSAGES).map(|k| {
        let mut datagram = Vec::new();
        let (x, ms) = (k as f32, k as u32);
        match k % 6 {
            0 => station.push(&mut datagram, &dialect::HEARTBEAT_DATA::default()),
            1 | 3 => {
                let tick = crpl_sitl::units::Tick(0);
                wire::push_setpoint(tick, [x.sin(), x.cos()], &clock, 1, &mut station, &mut datagram);
            }
            2 => other.push(
                &mut datagram,
                &dialect::ATTITUDE_DATA { time_boot_ms: ms, roll: x, pitch: x, yaw: x, ..Default::default() },
            ),
            4 => other.push(
                &mut datagram,
                &dialect::GLOBAL_POSITION_INT_DATA {
                    lat: k as i32,
                    lon: 7,
                    alt: 9,
                    hdg: 1,
                    ..Default::default()
                },
            ),
            _ => other.push(
                &mut datagram,
                &dialect::LOCAL_POSITION_NED_DATA { time_boot_ms: ms, x, y: x, z: x, vx: x, vy: x, vz: x },
            ),
        }
        datagram
    });
    datagrams.collect()
}

fn receive() {
    let datagrams = traffic();
    // One reader over all of it: one a datagram would cost the crate an allocation each.
    let stream = datagrams.concat();
    let mut bare = || {
        let mut reader = MavlinkReader::new(&stream[..]);
        for _ in 0..MESSAGES {
            let version = mavlink::MavlinkVersion::V2;
            let (_, message) = reader.read_message::<MavMessage>(version).expect("a good frame");
            black_box(message.message_id());
        }
    };
    let mut decoded = || {
        let (mut decoder, mut packets) = (Decoder::default(), Vec::new());
        for datagram in &datagrams {
            decoder.datagram_into(datagram, &mut packets);
            black_box(&packets);
            packets.clear();
        }
        assert_eq!(decoder.counts().frames, MESSAGES as u64);
    };
    let from: SocketAddr = ([127, 0, 0, 1], 5000).into();
    let mut handled = || {
        let mut vehicle = Vehicle::new(Sim::new(Scenario::default(), 1), 1, None);
        for datagram in &datagrams {
            vehicle.datagram(datagram, from, Duration::ZERO);
        }
        assert_eq!(vehicle.tally().packets.frames, MESSAGES as u64);
        black_box(vehicle);
    };
    rate::compare(
        "frames",
        MESSAGES as u64,
        &mut [
            ("bare crate, typed", &mut bare),
            ("decoder", &mut decoded),
            ("vehicle, whole receive path", &mut handled),
        ],
    );
}

/// A vehicle on a port of its own in a thread of its own; gives its address.
fn vehicle(lockstep: bool) -> SocketAddr {
    let (sender, address) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        runtime.expect("a runtime").block_on(async move {
            let socket = tokio::net::UdpSocket::bind("127.0.0.1:0").await.expect("a free port");
            sender.send(socket.local_addr().expect("an address")).expect("somebody who asked");
            let ticks = lockstep.then_some(TICKS);
            let mut shell =
                Shell::new(socket, Vehicle::new(Sim::new(Scenario::default(), 1), 1, ticks), None);
            if lockstep {
                shell.lockstep().await;
            } else {
                shell.real_time(Duration::from_millis(400)).await;
            }
        });
    });
    address.recv().expect("a vehicle")
}

fn socket(to: SocketAddr) -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    socket.connect(to).expect("an address");
    socket.set_read_timeout(Some(PATIENCE)).expect("a timeout");
    socket
}

fn round_trip() {
    let socket = socket(vehicle(false));
    let (mut station, mut decoder) = (Encoder::new(255, 190), Decoder::default());
    let (mut trips, mut buffer) = (Histogram::default(), vec![0; 65_536]);
    for k in 1..=ROUND_TRIPS {
        let mut datagram = Vec::new();
        let ping = dialect::TIMESYNC_DATA { ts1: k as i64, ..Default::default() };
        station.push(&mut datagram, &ping);
        let start = Instant::now();
        socket.send(&datagram).expect("loopback takes a datagram");
        'answer: loop {
            let length = socket.recv(&mut buffer).expect("an answer");
            for packet in decoder.datagram(&buffer[..length]) {
                if Timesync::of(&packet).is_some_and(|sync| sync.ts1 == k as i64) {
                    break 'answer;
                }
            }
        }
        trips.add(start.elapsed());
    }
    let [p50, p99, p999] = [0.5, 0.99, 0.999].map(|part| trips.percentile(part).as_micros());
    println!(
        "TIMESYNC round trip, µs      p50 {p50}, p99 {p99}, p99.9 {p999}, max {}",
        trips.largest().as_micros()
    );
}

fn lockstep(pictures: bool) {
    let socket = socket(vehicle(true));
    let clock = Clock::new(&Scenario::default());
    let (mut station, mut decoder) = (Encoder::new(255, 190), Decoder::default());
    let (mut reports, mut images) = (TelemetryReader::default(), Reassembler::default());
    let mut buffer = vec![0; 65_536];
    let mut datagram = Vec::new();
    if pictures {
        image::push_request(&mut station, &mut datagram);
    } else {
        station.push(&mut datagram, &dialect::HEARTBEAT_DATA::default());
    }
    socket.send(&datagram).expect("loopback takes a datagram");
    let start = Instant::now();
    let (mut reported, mut seen, mut next) = (None, None, 0);
    while next < TICKS {
        let length = socket.recv(&mut buffer).expect("a percept");
        for packet in decoder.datagram(&buffer[..length]) {
            if let Some(report) = reports.push(&packet, &clock) {
                reported = Some(report.tick.0);
            }
            if let Some((tick, _)) = images.push(&packet) {
                seen = Some(tick.0);
            }
        }
        if reported == Some(next) && (!pictures || seen == Some(next)) {
            let command = Command::new(crpl_sitl::units::Tick(next), [1.0, 0.0], TxPower::High);
            datagram.clear();
            wire::push_command(&command, &clock, 1, &mut station, &mut datagram);
            socket.send(&datagram).expect("loopback takes a datagram");
            next += 1;
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    let factor = TICKS as f64 * clock.interval_s() / seconds;
    let name = if pictures { "lockstep, pictures" } else { "lockstep, no pictures" };
    println!("{name:<28} {factor:>12.0} times real time, {:.0} intervals/s", TICKS as f64 / seconds);
}
