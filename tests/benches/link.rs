//! What `gcs link --radio perfect` costs on loopback: 100,000 messages a second, and how much later each comes than
//! without it. Ten messages a datagram, as autopilots send them in a burst.
//!
//! `cargo bench -p tests --bench link`

#![expect(clippy::disallowed_methods, reason = "a benchmark")]
#![expect(clippy::unwrap_used, reason = "a bench fails by panicking")]

use std::net::UdpSocket;
use std::time::{Duration, Instant};

use crpl_sitl::link::dialect::HEARTBEAT_DATA;
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::service::Ping;
use crpl_sitl::link::splitter::Splitter;
use crpl_sitl::program::timing::Histogram;
use tests::program::Program;

/// Messages a second.
const RATE: u32 = 100_000;
/// Messages of a datagram.
const GROUP: u32 = 10;
/// How long it is measured.
const LENGTH: Duration = Duration::from_secs(5);

struct Delays {
    sent: u64,
    heard: Histogram,
}

impl Delays {
    fn print(&self, name: &str) {
        let lost = self.sent - self.heard.count();
        let us = |part| self.heard.percentile(part).as_micros();
        println!(
            "{name:<24} {} sent, {lost} lost, delay p50 {} us, p99 {} us, longest {} us",
            self.sent,
            us(0.5),
            us(0.99),
            self.heard.largest().as_micros()
        );
    }
}

/// Sends stamped messages from `vehicle` at the rate, and reads them at `station`.
fn measure(vehicle: &UdpSocket, station: UdpSocket, length: Duration) -> Delays {
    let start = Instant::now();
    station.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    let reader = std::thread::spawn(move || {
        let (mut buffer, mut splitter, mut heard) =
            (vec![0; 65_536], Splitter::default(), Histogram::default());
        while let Ok(length) = station.recv(&mut buffer) {
            let now = start.elapsed();
            splitter.split(&buffer[..length], |frame| {
                if let Some(ping) = Ping::of(frame) {
                    heard.add(now.saturating_sub(Duration::from_nanos(ping.time_usec)));
                }
            });
        }
        heard
    });
    let (mut encoder, mut datagram, mut sent) = (Encoder::new(1, 1), Vec::new(), 0_u64);
    encoder.push(&mut datagram, &HEARTBEAT_DATA::default());
    vehicle.send(&datagram).unwrap();
    std::thread::sleep(Duration::from_millis(200));
    let begins = start.elapsed();
    while start.elapsed() - begins < length {
        let due = begins + Duration::from_secs(1) * (sent as u32) / RATE;
        while start.elapsed() < due {
            std::hint::spin_loop();
        }
        datagram.clear();
        for _ in 0..GROUP {
            let time_usec = start.elapsed().as_nanos() as u64;
            encoder.push_view(&mut datagram, &Ping { time_usec, seq: 0, target: (0, 0).into() });
        }
        vehicle.send(&datagram).unwrap();
        sent += u64::from(GROUP);
    }
    Delays { sent, heard: reader.join().unwrap() }
}

fn pair() -> (UdpSocket, UdpSocket) {
    [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap()).into()
}

fn main() {
    let length =
        if std::env::args().any(|arg| arg == "--bench") { LENGTH } else { Duration::from_millis(50) };
    let (vehicle, station) = pair();
    vehicle.connect(station.local_addr().unwrap()).unwrap();
    let direct = measure(&vehicle, station, length);
    direct.print("without a link");

    let (vehicle, station) = pair();
    let ground = format!("udpout:{}", station.local_addr().unwrap());
    let ends =
        ["link", "--vehicle", "udpin:127.0.0.1:0", "--ground", &ground, "--radio", "perfect", "--quiet"];
    let link = Program::start("gcs", &ends, None).unwrap();
    vehicle.connect(link.line("vehicle: listening on udpin:").unwrap()).unwrap();
    let through = measure(&vehicle, station, length);
    through.print("gcs link --radio perfect");
    link.interrupt().unwrap();
    println!("{}", link.wait().unwrap().good().unwrap().trim_end());
    let added = through.heard.percentile(0.99).saturating_sub(direct.heard.percentile(0.99));
    println!("added at p99: {} us", added.as_micros());
}
