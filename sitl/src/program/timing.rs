//! What a run costs: how late control intervals begin, and the processor's time. Knows durations, not
//! vehicles.

use std::fmt;
use std::time::{Duration, Instant};

/// Parts that each power of two is cut into: a value is known within 3 %.
const PARTS: usize = 32;
/// Enough places for any number of microseconds in 64 bits.
const PLACES: usize = PARTS * 60;

/// A histogram of durations, from a microsecond up, in at most 15 KiB.
///
/// A place holds the durations above its lower bound up to its upper bound, whole microseconds, and
/// powers of two are among the bounds.
#[derive(Debug, Clone, Default)]
pub struct Histogram {
    /// As many places as the longest duration needs.
    counts: Vec<u64>,
    total: u64,
    sum: Duration,
    largest: Duration,
}

impl Histogram {
    /// Adds a duration.
    pub fn add(&mut self, duration: Duration) {
        let place = place(duration);
        if place >= self.counts.len() {
            self.counts.resize(place + 1, 0);
        }
        self.counts[place] += 1;
        self.total += 1;
        self.sum = self.sum.saturating_add(duration);
        self.largest = self.largest.max(duration);
    }

    /// Adds all of another.
    pub fn merge(&mut self, other: &Self) {
        self.counts.resize(self.counts.len().max(other.counts.len()), 0);
        for (mine, theirs) in self.counts.iter_mut().zip(&other.counts) {
            *mine += theirs;
        }
        self.total += other.total;
        self.sum = self.sum.saturating_add(other.sum);
        self.largest = self.largest.max(other.largest);
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.total
    }

    /// All together.
    #[must_use]
    pub fn sum(&self) -> Duration {
        self.sum
    }

    /// How many are not longer than a bound: exact for 2^k µs, else for the next place's end below it.
    #[must_use]
    pub fn at_most(&self, bound: Duration) -> u64 {
        let us = u64::try_from(bound.as_micros()).unwrap_or(u64::MAX);
        self.counts.iter().take(place_of(us)).sum()
    }

    /// A duration that this part, 0 to 1, of all do not exceed, too long by 3 % at most; 0 without any.
    #[must_use]
    pub fn percentile(&self, part: f64) -> Duration {
        let rank = (part * self.total as f64).ceil().max(1.0) as u64;
        let mut seen = 0;
        for (place, &count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= rank {
                return Duration::from_micros(bound(place + 1)).min(self.largest);
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

/// Where a duration is counted: with those up to a whole microsecond above its place's lower bound.
fn place(duration: Duration) -> usize {
    let begun = duration.as_nanos().div_ceil(1000).saturating_sub(1);
    place_of(u64::try_from(begun).unwrap_or(u64::MAX))
}

/// The place whose lower bound is the last one not above `us`.
fn place_of(us: u64) -> usize {
    let parts = PARTS as u64;
    if us < parts {
        return us as usize;
    }
    // Bits above the five that tell parts apart.
    let shift = u64::from(us.ilog2() - parts.ilog2());
    ((shift << parts.ilog2()) + (us >> shift)) as usize
}

/// The lower bound of a place, µs.
fn bound(place: usize) -> u64 {
    let (shift, part) = (place / PARTS, place % PARTS);
    match shift {
        0 => part as u64,
        _ if place >= PLACES => u64::MAX,
        _ => ((PARTS + part) as u64) << (shift - 1),
    }
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
    fn quantiles_bound_what_was_added() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.percentile(0.5), Duration::ZERO);
        for us in [1, 3, 3, 900] {
            histogram.add(Duration::from_micros(us));
        }
        for (part, us) in [(0.25, 1), (0.75, 3), (1.0, 900)] {
            assert_eq!(histogram.percentile(part), Duration::from_micros(us), "{part}");
        }
        assert_eq!(histogram.sum(), Duration::from_micros(907));
        histogram.add(Duration::from_secs(3600));
        assert_eq!(histogram.percentile(1.0), Duration::from_secs(3600));
    }

    #[test]
    fn what_a_power_of_two_bounds_is_counted_to_the_nanosecond() {
        for k in 0..40 {
            let limit = Duration::from_micros(1 << k);
            let mut histogram = Histogram::default();
            histogram.add(limit);
            assert_eq!(histogram.at_most(limit), 1, "{k}");
            histogram.add(limit + Duration::from_nanos(1));
            assert_eq!(histogram.at_most(limit), 1, "{k}");
        }
    }

    #[test]
    fn any_duration_has_a_place() {
        let mut histogram = Histogram::default();
        for duration in [Duration::ZERO, Duration::from_micros(1), Duration::MAX] {
            histogram.add(duration);
        }
        assert_eq!((histogram.count(), histogram.largest()), (3, Duration::MAX));
        assert_eq!(histogram.counts.len(), PLACES);
        for us in [1, 31, 32, 33, 63, 64, 1000, 123_456, 1 << 62] {
            let place = place(Duration::from_micros(us));
            assert!(bound(place) < us && us <= bound(place + 1), "{us}");
            assert!(bound(place + 1) as f64 <= us as f64 * 1.04, "{us}");
        }
    }
}
