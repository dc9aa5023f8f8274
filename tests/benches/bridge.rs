//! How many messages a second `gcs bridge` carries on loopback without losing one, beside MAVProxy in
//! the same run. One message a datagram in, as vehicles send; at most a window of messages is under
//! way, so that what is measured is the router and not the room in a socket.
//!
//! `cargo bench -p tests --bench bridge`

#![expect(clippy::disallowed_methods, reason = "a benchmark")]
#![expect(clippy::unwrap_used, reason = "a bench fails by panicking")]

use std::net::UdpSocket;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crpl_sitl::link::dialect::{ATTITUDE_DATA, HEARTBEAT_DATA};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::splitter::Splitter;
use tests::program::{self, Program};
use tests::python;

/// Messages under way at most.
const WINDOW: u64 = 64;
/// How long each router is measured.
const LENGTH: Duration = Duration::from_secs(5);
/// After this a message counts as lost.
const LOST: Duration = Duration::from_millis(500);

struct Score {
    carried: u64,
    lost: u64,
    seconds: f64,
}

impl Score {
    fn print(&self, name: &str) {
        let rate = self.carried as f64 / self.seconds;
        println!("{name:<12} {rate:>10.0} messages/s, {} carried, {} lost", self.carried, self.lost);
    }
}

/// Sends through a router from `vehicle` to `station` for a while.
fn measure(vehicle: &UdpSocket, station: UdpSocket, length: Duration) -> Score {
    let (heard, stop) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
    let (count, ended) = (Arc::clone(&heard), Arc::clone(&stop));
    station.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    let sink = std::thread::spawn(move || {
        let (mut buffer, mut splitter) = (vec![0; 65_536], Splitter::default());
        while !ended.load(Ordering::Relaxed) {
            let Ok(length) = station.recv(&mut buffer) else { continue };
            let mut frames = 0;
            splitter.split(&buffer[..length], |frame| frames += u64::from(frame.id == 30));
            count.fetch_add(frames, Ordering::Release);
        }
    });
    let (mut encoder, mut sent, mut lost) = (Encoder::new(1, 1), 0_u64, 0_u64);
    let mut datagram = Vec::new();
    // A heartbeat first: routers pass on those whom they know.
    encoder.push(&mut datagram, &HEARTBEAT_DATA::default());
    vehicle.send(&datagram).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    let start = Instant::now();
    while start.elapsed() < length {
        let mut waiting = Instant::now();
        while sent - lost - heard.load(Ordering::Acquire) >= WINDOW {
            std::thread::yield_now();
            if waiting.elapsed() > LOST {
                lost = sent - heard.load(Ordering::Acquire);
                waiting = Instant::now();
            }
        }
        datagram.clear();
        encoder.push(&mut datagram, &ATTITUDE_DATA { time_boot_ms: sent as u32, ..Default::default() });
        vehicle.send(&datagram).unwrap();
        sent += 1;
    }
    let seconds = start.elapsed().as_secs_f64();
    std::thread::sleep(LOST);
    stop.store(true, Ordering::Relaxed);
    sink.join().unwrap();
    let carried = heard.load(Ordering::Acquire);
    Score { carried, lost: sent - carried, seconds }
}

/// A vehicle's socket that sends to `to`.
fn vehicle(to: &str) -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.connect(to).unwrap();
    socket
}

fn main() {
    let length =
        if std::env::args().any(|arg| arg == "--bench") { LENGTH } else { Duration::from_millis(50) };
    let station = UdpSocket::bind("127.0.0.1:0").unwrap();
    let out = format!("udpout:{}", station.local_addr().unwrap());
    let args = ["bridge", "--connect", "udpin:127.0.0.1:0", "--forward", &out, "--every", "0"];
    let bridge = Program::start("gcs", &args, None).unwrap();
    let address = bridge.line("vehicle: listening on udpin:").unwrap();
    let ours = measure(&vehicle(&address), station, length);
    ours.print("gcs bridge");
    drop(bridge);

    let station = UdpSocket::bind("127.0.0.1:0").unwrap();
    // A port that is free now; MAVProxy does not tell one that it chose itself.
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut command: Command = python::tool("mavproxy.py").unwrap();
    command
        .args(["--master", &format!("udpin:127.0.0.1:{port}")])
        .args(["--out", &station.local_addr().unwrap().to_string()])
        .args(["--daemon", "--default-modules", "", "--logfile", "/dev/null", "--nowait"])
        .current_dir(program::workspace().join("target"));
    let mavproxy = Program::spawn("mavproxy", command).unwrap();
    std::thread::sleep(Duration::from_secs(4));
    let theirs = measure(&vehicle(&format!("127.0.0.1:{port}")), station, length);
    theirs.print("MAVProxy");
    drop(mavproxy);
    println!("gcs bridge / MAVProxy: {:.0}", ours.carried as f64 / theirs.carried.max(1) as f64);
}
