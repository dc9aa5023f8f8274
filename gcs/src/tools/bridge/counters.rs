//! What a link has carried, for people and for Prometheus.

use std::fmt::Write;
use std::time::Duration;

use crpl_sitl::link::sequence::SequenceTracker;
use crpl_sitl::link::splitter::Counts;
use crpl_sitl::program::timing::Histogram;
use serde_json::Value;

/// Counters of one link since it began.
#[derive(Debug, Clone, Default)]
pub struct Counters {
    /// Frames that came in, good and bad.
    pub frames: Counts,
    /// Bytes that came in.
    pub received_bytes: u64,
    /// Frames that were missing when a later one of their sender came.
    pub missing: u64,
    /// Those of them that came after all: overtaken on the way.
    pub late: u64,
    /// Frames that came a second time.
    pub duplicates: u64,
    /// Frames refused for their signatures, or for having none.
    pub refused: u64,
    /// Frames sent.
    pub sent_frames: u64,
    /// Bytes sent.
    pub sent_bytes: u64,
    /// Datagrams that the system would not send.
    pub send_errors: u64,
    /// Frames that a filter of the link kept back, in either direction.
    pub filtered: u64,
    /// Frames that were not sent because the link's rate was used up.
    pub limited: u64,
    /// From a request that was passed on to its answer on this link: commands, TIMESYNC, PING.
    pub round_trip: Histogram,
    /// When the last good frame came, on the router's clock.
    pub last_heard: Option<Duration>,
}

impl Counters {
    /// Good frames of both versions.
    #[must_use]
    pub fn received(&self) -> u64 {
        self.frames.frames + self.frames.mavlink1
    }

    /// Adds all that another link has carried.
    pub fn merge(&mut self, other: &Self) {
        self.frames = self.frames.plus(other.frames);
        for (mine, theirs) in [
            (&mut self.received_bytes, other.received_bytes),
            (&mut self.missing, other.missing),
            (&mut self.late, other.late),
            (&mut self.duplicates, other.duplicates),
            (&mut self.refused, other.refused),
            (&mut self.sent_frames, other.sent_frames),
            (&mut self.sent_bytes, other.sent_bytes),
            (&mut self.send_errors, other.send_errors),
            (&mut self.filtered, other.filtered),
            (&mut self.limited, other.limited),
        ] {
            *mine += theirs;
        }
        self.round_trip.merge(&other.round_trip);
        self.last_heard = self.last_heard.max(other.last_heard);
    }

    /// What a frame's sequence number has told.
    pub fn numbered(&mut self, heard: SequenceTracker) {
        self.missing += heard.missing;
        self.late += u64::from(heard.late);
    }

    /// Frames that never came.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.missing - self.late
    }

    /// Part of the frames sent to this link that were lost on the way, in [0, 1].
    #[must_use]
    pub fn loss(&self) -> f64 {
        let lost = self.lost() as f64;
        if lost == 0.0 { 0.0 } else { lost / (lost + self.received() as f64) }
    }
}

/// Buckets for Prometheus: up to 1 µs, 2 µs and so on, to 8 s.
const BUCKETS: u32 = 24;

/// The lines of a Prometheus histogram in seconds.
pub fn export(histogram: &Histogram, out: &mut String, name: &str, label: &str) {
    let comma = if label.is_empty() { "" } else { "," };
    for bound in (0..BUCKETS).map(|k| Duration::from_micros(1 << k)) {
        let (le, below) = (bound.as_secs_f64(), histogram.at_most(bound));
        let _ = writeln!(out, "{name}_bucket{{{label}{comma}le=\"{le}\"}} {below}");
    }
    let total = histogram.count();
    let _ = writeln!(out, "{name}_bucket{{{label}{comma}le=\"+Inf\"}} {total}");
    let braces = if label.is_empty() { String::new() } else { format!("{{{label}}}") };
    let _ = writeln!(out, "{name}_sum{braces} {}", histogram.sum().as_secs_f64());
    let _ = writeln!(out, "{name}_count{braces} {total}");
}

/// A link as it is shown.
#[derive(Debug)]
pub struct LinkRow<'a> {
    /// Its endpoint, and its peer's address.
    pub name: &'a str,
    /// Who was heard on it.
    pub systems: Vec<(u8, u8)>,
    /// What it carried.
    pub counters: &'a Counters,
}

/// What each link has carried, by its name: for a page.
#[must_use]
pub fn by_name(rows: &[LinkRow<'_>]) -> Value {
    let counts = rows.iter().flat_map(|row| {
        let c = row.counters;
        let counts = [("received", c.received()), ("sent", c.sent_frames), ("lost", c.lost())];
        counts.map(|(what, count)| (format!("{} {what}", row.name), count.into()))
    });
    Value::Object(counts.collect())
}

/// Widths of the columns of [`table`].
pub const COLUMNS: [usize; 10] = [40, 10, 8, 10, 8, 8, 7, 7, 10, 16];

/// A table for people: one line a link, rates over the last `period`.
#[must_use]
pub fn table(rows: &[LinkRow<'_>], before: &[(u64, u64)], period: Duration) -> String {
    let mut text = format!(
        "{:<40} {:>9} {:>7} {:>9} {:>7} {:>7} {:>6} {:>6} {:>9}  heard\n",
        "link", "received", "/s", "sent", "/s", "lost", "loss", "copies", "trip p99"
    );
    let seconds = period.as_secs_f64();
    for (k, row) in rows.iter().enumerate() {
        let c = row.counters;
        let (received, sent) = before.get(k).copied().unwrap_or_default();
        let rate = |now: u64, then: u64| now.saturating_sub(then) as f64 / seconds;
        let trip = match c.round_trip.count() {
            0 => "-".into(),
            _ => format!("{:.2} ms", c.round_trip.percentile(0.99).as_secs_f64() * 1e3),
        };
        let mut systems: Vec<_> = row.systems.iter().map(|(s, c)| format!("{s}/{c}")).collect();
        if systems.len() > 6 {
            let more = systems.len() - 6;
            systems.truncate(6);
            systems.push(format!("and {more} more"));
        }
        let _ = writeln!(
            text,
            "{:<40} {:>9} {:>7.0} {:>9} {:>7.0} {:>7} {:>5.1}% {:>6} {:>9}  {}",
            row.name,
            c.received(),
            rate(c.received(), received),
            c.sent_frames,
            rate(c.sent_frames, sent),
            c.lost(),
            100.0 * c.loss(),
            c.duplicates,
            trip,
            systems.join(" ")
        );
    }
    text
}

/// All counters in Prometheus' text format, version 0.0.4. `forward` is the time in the bridge.
#[must_use]
pub fn prometheus(rows: &[LinkRow<'_>], forward: &Histogram, now: Duration) -> String {
    type Value = fn(&Counters) -> f64;
    let counters: [(&str, &str, Value); 15] = [
        ("received_frames", "Good frames received.", |c| c.received() as f64),
        ("received_bytes", "Bytes received.", |c| c.received_bytes as f64),
        ("missing_frames", "Frames not there when a later one of their sender came.", |c| c.missing as f64),
        ("late_frames", "Missing frames that came after all; the rest is lost.", |c| c.late as f64),
        ("duplicate_frames", "Frames received a second time.", |c| c.duplicates as f64),
        ("refused_frames", "Frames refused for their signatures.", |c| c.refused as f64),
        ("bad_crc_frames", "Frames with a wrong checksum.", |c| c.frames.bad_crc as f64),
        ("truncated_frames", "Frames that ended too early.", |c| c.frames.truncated as f64),
        ("unknown_frames", "Frames of messages that the dialect lacks.", |c| c.frames.unknown as f64),
        ("garbage_bytes", "Bytes between frames.", |c| c.frames.garbage_bytes as f64),
        ("sent_frames", "Frames sent.", |c| c.sent_frames as f64),
        ("sent_bytes", "Bytes sent.", |c| c.sent_bytes as f64),
        ("send_errors", "Datagrams that could not be sent.", |c| c.send_errors as f64),
        ("filtered_frames", "Frames that a filter kept back.", |c| c.filtered as f64),
        ("limited_frames", "Frames beyond the link's rate.", |c| c.limited as f64),
    ];
    let mut out = String::new();
    let label = |row: &LinkRow<'_>| format!("link=\"{}\"", row.name.replace(['\\', '"'], "_"));
    for (name, help, value) in counters {
        let name = format!("mavlink_bridge_{name}_total");
        let _ = writeln!(out, "# HELP {name} {help}\n# TYPE {name} counter");
        for row in rows {
            let _ = writeln!(out, "{name}{{{}}} {}", label(row), value(row.counters));
        }
    }
    let name = "mavlink_bridge_silent_seconds";
    let _ = writeln!(out, "# HELP {name} Time since the last good frame.\n# TYPE {name} gauge");
    for row in rows {
        if let Some(heard) = row.counters.last_heard {
            let _ = writeln!(out, "{name}{{{}}} {}", label(row), now.saturating_sub(heard).as_secs_f64());
        }
    }
    let name = "mavlink_bridge_round_trip_seconds";
    let _ = writeln!(out, "# HELP {name} From a request to its answer.\n# TYPE {name} histogram");
    for row in rows {
        export(&row.counters.round_trip, &mut out, name, &label(row));
    }
    let name = "mavlink_bridge_forward_seconds";
    let _ = writeln!(out, "# HELP {name} From reading a burst to having sent it.\n# TYPE {name} histogram");
    export(forward, &mut out, name, "");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_export_has_a_type_for_each_metric_and_a_line_for_each_link() {
        let mut counters = Counters { missing: 2, late: 1, ..Counters::default() };
        counters.frames.frames = 3;
        counters.last_heard = Some(Duration::from_secs(1));
        counters.round_trip.add(Duration::from_micros(2));
        let rows = [LinkRow { name: "udpin:127.0.0.1:14550", systems: vec![(1, 1)], counters: &counters }];
        let text = prometheus(&rows, &Histogram::default(), Duration::from_secs(3));
        let line = "mavlink_bridge_missing_frames_total{link=\"udpin:127.0.0.1:14550\"} 2";
        assert!(text.lines().any(|l| l == line), "{text}");
        assert!(text.contains("round_trip_seconds_bucket{link=\"udpin:127.0.0.1:14550\",le=\"0.000002\"} 1"));
        assert!(text.contains("mavlink_bridge_silent_seconds{link=\"udpin:127.0.0.1:14550\"} 2"));
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            let name = line.split(['{', ' ']).next().unwrap();
            let base = name.trim_end_matches("_bucket").trim_end_matches("_sum").trim_end_matches("_count");
            assert!(text.contains(&format!("# TYPE {base} ")), "{line}");
        }
        assert_eq!(counters.loss(), 0.25);
        assert!(table(&rows, &[], Duration::from_secs(1)).contains("1/1"));
    }
}
