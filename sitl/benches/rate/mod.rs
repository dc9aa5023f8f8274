//! A stopwatch for benches: how often a second, as the median of many short samples.
//!
//! Made of the standard library alone: a bench framework among the dev-dependencies would change the
//! features of shared dependencies, and the tests would then compile all of burn a second time.

use std::time::{Duration, Instant};

const SAMPLES: usize = 51;
const SAMPLE: Duration = Duration::from_millis(20);

/// Measures `work`, which does `units` of something a call, and prints the rate in `unit` per second:
/// the median, and the 10th and 90th percentile of the samples. Without cargo's `--bench` flag it only
/// calls `work` once. Gives the median.
pub fn rate(name: &str, unit: &str, units: u64, mut work: impl FnMut()) -> Option<f64> {
    work();
    if !std::env::args().any(|arg| arg == "--bench") {
        return None;
    }
    let mut calls = 1u32;
    while timed(calls, &mut work) < SAMPLE {
        calls *= 2;
    }
    let mut samples: Vec<f64> = (0..SAMPLES)
        .map(|_| f64::from(calls) * units as f64 / timed(calls, &mut work).as_secs_f64())
        .collect();
    samples.sort_by(f64::total_cmp);
    let at = |part: f64| samples[(part * (SAMPLES - 1) as f64).round() as usize];
    println!("{name:<28} {:>12.0} {unit}/s   [{:.0} .. {:.0}]", at(0.5), at(0.1), at(0.9));
    Some(at(0.5))
}

fn timed(calls: u32, work: &mut impl FnMut()) -> Duration {
    let start = Instant::now();
    for _ in 0..calls {
        work();
    }
    start.elapsed()
}
