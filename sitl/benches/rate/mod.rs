//! A stopwatch for benches: how often a second, as the median of many short samples.
//!
//! Made of the standard library alone: a bench framework among the dev-dependencies would change the
//! features of shared dependencies, and the tests would then compile all of burn a second time.

#![expect(clippy::disallowed_methods, reason = "a benchmark")]

use std::time::{Duration, Instant};

const SAMPLES: usize = 51;
const SAMPLE: Duration = Duration::from_millis(20);

/// Measures `work`, which does `units` of something a call, and prints the rate in `unit` per second:
/// the median, and the 10th and 90th percentile of the samples. Without cargo's `--bench` flag it only
/// calls `work` once.
#[allow(dead_code, reason = "each bench is a program of its own, and not all use it")]
pub fn rate(name: &str, unit: &str, units: u64, mut work: impl FnMut()) {
    work();
    if !std::env::args().any(|arg| arg == "--bench") {
        return;
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
}

/// The same for several kinds of work that do the same `units`, sample by sample in turn, so that what
/// else the machine does meets all alike. Gives how fast each is beside the first: the median over the
/// rounds.
#[allow(dead_code, reason = "each bench is a program of its own, and not all compare")]
pub fn compare(unit: &str, units: u64, works: &mut [(&str, &mut dyn FnMut())]) -> Vec<f64> {
    works.iter_mut().for_each(|(_, work)| work());
    if !std::env::args().any(|arg| arg == "--bench") {
        return Vec::new();
    }
    let mut rounds: Vec<Vec<f64>> = Vec::new();
    for _ in 0..SAMPLES {
        let each = works.iter_mut().map(|(_, work)| units as f64 / timed(1, work).as_secs_f64());
        rounds.push(each.collect());
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let ratios = (0..works.len()).map(|k| median(rounds.iter().map(|round| round[k] / round[0]).collect()));
    let ratios: Vec<f64> = ratios.collect();
    for (k, (name, _)) in works.iter().enumerate() {
        let rate = median(rounds.iter().map(|round| round[k]).collect());
        println!("{name:<28} {rate:>12.0} {unit}/s   {:.2} of the first", ratios[k]);
    }
    ratios
}

fn timed(calls: u32, work: &mut (impl FnMut() + ?Sized)) -> Duration {
    let start = Instant::now();
    for _ in 0..calls {
        work();
    }
    start.elapsed()
}
