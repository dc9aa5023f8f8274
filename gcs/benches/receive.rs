//! How many messages a second the ground station's receive path takes in, beside the bare crate in
//! the same run, over the same bytes: what `sitl` sends while it flies.
//!
//! `cargo bench -p gcs --bench receive`

#![expect(clippy::disallowed_methods, reason = "a benchmark")]
#![expect(clippy::unwrap_used, reason = "a bench fails by panicking")]

use std::hint::black_box;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use crpl_gcs::flight::remote::Remote;
use crpl_gcs::tools::bridge::router::Router;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::MavMessage;
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::radio::message::Command;
use crpl_sitl::units::{Tick, TxPower};
use crpl_sitl::vehicle::Vehicle;
use crpl_sitl::{Scenario, Sim};
use mavlink::{MavlinkReader, MavlinkVersion};

const SAMPLES: usize = 31;

/// The datagrams of a flight of 200 intervals, pictures and all, and how many frames they hold.
fn flight() -> (Vec<Vec<u8>>, u64) {
    let scenario = Scenario::default();
    let station: SocketAddr = ([127, 0, 0, 1], 1).into();
    let mut vehicle = Vehicle::new(Sim::new(scenario.clone(), 3), 1, None);
    let mut remote = Remote::new(&scenario, 1, Encoder::new(255, 190));
    let mut sent = Vec::new();
    vehicle.datagram(&remote.image_request(), station, Duration::ZERO);
    for k in 0..200 {
        sent.extend(std::iter::from_fn(|| vehicle.poll()).map(|(_, bytes)| bytes));
        let accel = [(k as f32).sin(), (k as f32).cos()];
        let command = remote.command(&Command::new(Tick(k), accel, TxPower::High));
        vehicle.datagram(&command, station, Duration::ZERO);
        vehicle.advance(Duration::ZERO);
    }
    let mut decoder = Decoder::default();
    let frames = sent.iter().map(|bytes| decoder.datagram(bytes).len() as u64).sum();
    (sent, frames)
}

/// Frames a second, the median of many samples.
fn rate(name: &str, frames: u64, mut work: impl FnMut()) -> f64 {
    work();
    if !std::env::args().any(|arg| arg == "--bench") {
        return 1.0;
    }
    let mut samples: Vec<f64> = (0..SAMPLES)
        .map(|_| {
            let start = Instant::now();
            work();
            frames as f64 / start.elapsed().as_secs_f64()
        })
        .collect();
    samples.sort_by(f64::total_cmp);
    println!("{name:<52} {:>12.0} messages/s", samples[SAMPLES / 2]);
    samples[SAMPLES / 2]
}

fn main() {
    let (datagrams, frames) = flight();
    // One reader over all of it: one a datagram would cost the crate an allocation each.
    let stream = datagrams.concat();
    let bare = rate("the mavlink crate alone, typed", frames, || {
        let mut reader = MavlinkReader::new(&stream[..]);
        for _ in 0..frames {
            black_box(reader.read_message::<MavMessage>(MavlinkVersion::V2).unwrap());
        }
    });
    let typed = rate("gcs: decoder, typed", frames, || {
        let mut decoder = Decoder::default();
        for packet in datagrams.iter().flat_map(|bytes| decoder.datagram(bytes)) {
            black_box(packet.message().unwrap());
        }
    });
    let flown = rate("gcs: datagrams to percepts, pictures decoded", frames, || {
        let mut remote = Remote::new(&Scenario::default(), 1, Encoder::new(255, 190));
        for bytes in &datagrams {
            black_box(remote.datagram(bytes, Duration::ZERO));
        }
    });
    let routed = rate("gcs: router, one link to three", frames, || {
        let mut router = Router::default();
        let links: Vec<_> = (0..4).map(|k| router.add(k.to_string())).collect();
        for bytes in &datagrams {
            router.receive(links[0], bytes, Duration::ZERO, |_| {});
            router.flush(|_, datagram| {
                black_box(datagram);
                true
            });
        }
    });
    for (name, rate) in [("decoder", typed), ("percepts", flown), ("router", routed)] {
        println!("{name} / bare crate: {:.2}", rate / bare);
    }
}
