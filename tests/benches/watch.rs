//! What watching costs a flight: from a complete frame to its command on the socket, without a page, with a page that
//! nobody reads, and with three readers. Flights in real time, one kind after the other in turn, so that other load
//! on the machine meets all kinds alike. "No page" is flown twice in each turn: the difference of the two is what the
//! machine alone makes, and smaller ones mean nothing.
//!
//! `cargo bench -p tests --bench watch`

#![expect(clippy::disallowed_methods, reason = "a benchmark")]
#![expect(clippy::unwrap_used, reason = "a bench fails by panicking")]

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::Instant;

use crpl_gcs::station::models::Models;
use crpl_gcs::station::pilot::Controller;
use crpl_gcs::watch::Shown;
use crpl_gcs::watch::feed::Feed;
use crpl_gcs::watch::watcher::FlightWatcher;
use crpl_sitl::{Scenario, Sim};
use serde_json::Value;
use tests::program::Program;

/// Flights of each kind.
const FLIGHTS: usize = 5;
/// Intervals of a flight: ten of them lie beyond the 99th percentile.
const INTERVALS: usize = 1000;
/// Speed relative to real time: 50 intervals a second.
const SPEED: &str = "20";

/// Whether there is a page, and who reads it.
const KINDS: [(&str, Option<usize>); 4] = [
    ("no page", None),
    ("no page, again", None),
    ("a page, no reader", Some(0)),
    ("a page, 3 readers", Some(3)),
];

/// Reads all events until the program ends.
fn read_all(host: &str) -> std::thread::JoinHandle<usize> {
    let mut stream = TcpStream::connect(host).unwrap();
    write!(stream, "GET /events HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        // A server that ends is the end of the flight.
        let _ = stream.read_to_end(&mut bytes);
        bytes.len()
    })
}

/// Median and 99th percentile of a flight, ms.
fn fly(out: &Path, readers: Option<usize>) -> [f64; 2] {
    let out = out.to_str().unwrap();
    let mut args = vec!["demo", "--controller", "crpl", "--pace", "realtime", "--speed", SPEED, "--json"];
    let horizon = format!("horizon={INTERVALS}");
    args.extend(["--set", &horizon, "--overwrite", "--out", out]);
    args.extend(readers.map(|_| "--watch"));
    let program = Program::start("gcs", &args, None).unwrap();
    let mut threads = Vec::new();
    if let Some(readers) = readers {
        program.logs("watch: http://").unwrap();
        let so_far = program.so_far();
        let host = so_far.lines().find_map(|line| line.strip_prefix("watch: http://")).unwrap().to_owned();
        threads.extend((0..readers).map(|_| read_all(&host)));
    }
    let told: Value = serde_json::from_str(&program.wait().unwrap().good().unwrap()).unwrap();
    assert!(threads.into_iter().all(|thread| thread.join().unwrap() > 0));
    let latency = &told["flights"][0]["latency_ms"];
    ["p50", "p99"].map(|key| latency[key].as_f64().unwrap())
}

/// What the station's own thread does for a page after each command, us: median and 99th percentile of a flight.
fn copies() -> [f64; 2] {
    let scenario = Scenario::named("demo").unwrap();
    let models = Models::load(None, None).unwrap();
    let mut station = models.station(Controller::Crpl, &scenario).unwrap();
    let shown = Shown::one("bench", Controller::Crpl);
    let mut watcher = FlightWatcher::new(&station, &shown, Some(Feed::default()));
    let mut sim = Sim::new(scenario, 0);
    let mut spent: Vec<f64> = (0..INTERVALS)
        .map(|_| {
            let percept = sim.percept();
            let command = station.handle(&percept);
            let begun = Instant::now();
            watcher.saw(&station, &percept, command);
            let spent = begun.elapsed().as_secs_f64() * 1e6;
            sim.handle(command);
            sim.advance();
            spent
        })
        .collect();
    spent.sort_by(f64::total_cmp);
    [0.5, 0.99].map(|share| spent[(share * INTERVALS as f64) as usize])
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    0.5 * (values[(n - 1) / 2] + values[n / 2])
}

fn main() {
    let [p50, p99] = copies();
    println!("the copy for the page on the station's thread, us: median {p50:.1}  p99 {p99:.1}");
    let dir = std::env::temp_dir().join(format!("crpl-watch-{}", std::process::id()));
    let mut told = KINDS.map(|_| Vec::new());
    for turn in 0..FLIGHTS {
        // Each turn begins with another kind.
        for k in (0..KINDS.len()).map(|k| (turn + k) % KINDS.len()) {
            told[k].push(fly(&dir, KINDS[k].1));
        }
    }
    std::fs::remove_dir_all(&dir).unwrap();
    println!(
        "frame to command, ms, median of {FLIGHTS} flights of {INTERVALS} intervals at {SPEED} times real time"
    );
    let mut first = None;
    for ((name, _), told) in KINDS.iter().zip(&told) {
        let [p50, p99] = [0, 1].map(|i| median(told.iter().map(|flight| flight[i]).collect()));
        let base = *first.get_or_insert(p99);
        let p99s: Vec<String> = told.iter().map(|[_, p99]| format!("{p99:.2}")).collect();
        let change = 100.0 * (p99 / base - 1.0);
        println!("{name:<20} median {p50:.3}  p99 {p99:.3}  p99 {change:+.0} %  each {}", p99s.join(" "));
    }
}
