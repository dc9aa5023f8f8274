//! What a run costs: how late control intervals begin, and the processor's time. Knows durations, not
//! vehicles.

use std::fmt;
use std::time::{Duration, Instant};

/// Parts that each power of two is cut into: a value is known within 3 %.
const PARTS: usize = 32;

/// A histogram of durations, from a microsecond up, in constant memory.
#[derive(Debug, Clone)]
pub struct Histogram {
    counts: Vec<u64>,
    total: u64,
    largest: Duration,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: vec![0; PARTS * 60], total: 0, largest: Duration::ZERO }
    }
}

impl Histogram {
    /// Adds a duration.
    pub fn add(&mut self, duration: Duration) {
        self.counts[place(u64::try_from(duration.as_micros()).unwrap_or(u64::MAX))] += 1;
        self.total += 1;
        self.largest = self.largest.max(duration);
    }

    /// Adds all of another.
    pub fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.counts.iter_mut().zip(&other.counts) {
            *mine += theirs;
        }
        self.total += other.total;
        self.largest = self.largest.max(other.largest);
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.total
    }

    /// The duration that this part, 0 to 1, of all do not exceed by more than 3 %.
    #[must_use]
    pub fn percentile(&self, part: f64) -> Duration {
        let rank = (part * self.total as f64).ceil().max(1.0) as u64;
        let mut seen = 0;
        for (place, &count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= rank {
                return Duration::from_micros(value(place)).min(self.largest);
            }
        }
        self.largest
    }

    /// The longest.
    #[must_use]
    pub fn largest(&self) -> Duration {
        self.largest
    }
}

fn place(us: u64) -> usize {
    let parts = PARTS as u64;
    if us < parts {
        return us as usize;
    }
    // Bits above the five that tell parts apart.
    let shift = u64::from(us.ilog2() - parts.ilog2());
    (((shift << parts.ilog2()) + (us >> shift)) as usize).min(PARTS * 60 - 1)
}

/// The smallest value of a place, µs.
fn value(place: usize) -> u64 {
    let (shift, part) = (place / PARTS, place % PARTS);
    if shift == 0 { part as u64 } else { ((PARTS + part) as u64) << (shift - 1) }
}

/// The wall's and the processor's time since it was made.
#[derive(Debug, Clone, Copy)]
pub struct Stopwatch {
    wall: Instant,
    cpu: Option<Duration>,
}

impl Default for Stopwatch {
    #[expect(clippy::disallowed_methods, reason = "the clock of those who measure what a run costs")]
    fn default() -> Self {
        Self { wall: Instant::now(), cpu: cpu_time() }
    }
}

impl Stopwatch {
    /// Time on the wall, and this process's time on all processors, if the system tells it.
    #[must_use]
    pub fn elapsed(&self) -> (Duration, Option<Duration>) {
        let cpu = cpu_time().zip(self.cpu).map(|(now, then)| now.saturating_sub(then));
        (self.wall.elapsed(), cpu)
    }

    /// The same in seconds; 0 s of the processor where the system does not tell.
    #[must_use]
    pub fn seconds(&self) -> (f64, f64) {
        let (wall, cpu) = self.elapsed();
        (wall.as_secs_f64(), cpu.unwrap_or_default().as_secs_f64())
    }
}

/// Time of this process on all processors: user and system, from Linux's /proc in ticks of 10 ms.
fn cpu_time() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The name, in brackets, may hold anything.
    let mut fields = text.rsplit_once(')')?.1.split_whitespace().skip(11);
    let ticks = fields.next()?.parse::<u64>().ok()? + fields.next()?.parse::<u64>().ok()?;
    Some(Duration::from_millis(10 * ticks))
}

/// What a run of some vehicles has cost.
#[derive(Debug, Clone)]
pub struct Stats {
    /// Vehicles.
    pub vehicles: usize,
    /// How late each control interval began; empty in lockstep.
    pub lateness: Histogram,
    /// Control intervals.
    pub intervals: u64,
    /// Time on the wall.
    pub wall: Duration,
    /// Time on all processors.
    pub cpu: Option<Duration>,
}

impl fmt::Display for Stats {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let wall = self.wall.as_secs_f64();
        let plural = if self.vehicles == 1 { "" } else { "s" };
        write!(f, "{} vehicle{plural}, {} intervals in {wall:.1} s", self.vehicles, self.intervals)?;
        if self.lateness.count() > 0 {
            let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
            let [p50, p99] = [0.5, 0.99].map(|part| ms(self.lateness.percentile(part)));
            let max = ms(self.lateness.largest());
            write!(f, "; late by p50 {p50:.2}, p99 {p99:.2}, max {max:.2} ms")?;
        }
        match self.cpu {
            Some(cpu) => {
                let cpu = cpu.as_secs_f64();
                write!(f, "; CPU {cpu:.2} s, {:.1} % of a core", 100.0 * cpu / wall.max(1e-9))
            }
            None => write!(f, "; CPU unknown"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_within_three_percent() {
        let mut histogram = Histogram::default();
        for us in 1..=100_000 {
            histogram.add(Duration::from_micros(us));
        }
        for (part, us) in [(0.5, 50_000.0), (0.99, 99_000.0), (0.001, 100.0)] {
            let found = histogram.percentile(part).as_micros() as f64;
            assert!((found / us - 1.0).abs() < 0.035, "{part}: {found}");
        }
        assert_eq!((histogram.count(), histogram.largest()), (100_000, Duration::from_millis(100)));
        let mut two = histogram.clone();
        two.merge(&histogram);
        assert_eq!((two.count(), two.percentile(0.5)), (200_000, histogram.percentile(0.5)));
    }

    #[test]
    fn any_duration_has_a_place() {
        let mut histogram = Histogram::default();
        for duration in [Duration::ZERO, Duration::from_micros(1), Duration::MAX] {
            histogram.add(duration);
        }
        assert_eq!((histogram.count(), histogram.largest()), (3, Duration::MAX));
        for us in [0, 1, 31, 32, 33, 63, 64, 1000, 123_456] {
            assert!(value(place(us)) <= us && us as f64 <= value(place(us)) as f64 * 1.04, "{us}");
        }
    }
}
