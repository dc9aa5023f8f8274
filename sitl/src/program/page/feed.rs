//! The feed: one JSON line an event, kept in a bounded history that any number of readers follow at their own pace.
//!
//! Who writes never waits for who reads. A reader holds no more than its place in the history; one that stands
//! still costs nothing, and what left the history meanwhile is lost to it. docs/watch.md lists the kinds of lines.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::Serialize;
use serde_json::Value;
use tokio::sync::watch;

/// Version of the lines.
pub const VERSION: u32 = 1;

/// Bytes of the history.
const CAPACITY: usize = 48 << 20;

/// A limit of the flight, as the page draws it.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ShownLimits {
    /// δ1
    pub delta: f64,
    /// γ_min, dB.
    pub gamma_min_db: f64,
    /// δ2
    pub eta: f64,
    /// L_pkt, bits an interval: a smaller rate is an outage.
    pub rate_min: f64,
}

/// A vehicle that is shown.
#[derive(Debug, Clone, Serialize)]
pub struct ShownVehicle {
    /// Its number in all other lines.
    pub id: u32,
    /// Its name.
    pub name: String,
    /// Who flies it, if that is known.
    pub controller: Option<String>,
}

/// In which coordinates positions are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ShownFrame {
    /// The paper's unit square, x and y as in the records.
    Square,
    /// Metres east and north of an origin.
    Local,
}

/// A line of the feed.
#[derive(Debug, Clone, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum WatchEvent {
    /// What is shown; again when a vehicle appears.
    Hello {
        /// [`VERSION`].
        version: u32,
        /// In one line.
        title: String,
        /// The command.
        program: String,
        /// Of the program's sources.
        revision: String,
        /// Seed of the gusts, if it is known.
        seed: Option<u64>,
        /// Of all positions.
        frame: ShownFrame,
        /// The scenario, if there is one.
        scenario: Option<Value>,
        /// Who flies.
        vehicles: Vec<ShownVehicle>,
        /// The constraints, if there is a scenario.
        limits: Option<ShownLimits>,
        /// Intervals of the flight, if that is known.
        ticks: Option<u64>,
        /// Seconds of an interval.
        dt_s: f64,
        /// Whether the page may steer.
        control: bool,
    },
    /// The SNR everywhere.
    Field {
        /// Whose.
        vehicle: u32,
        /// Since when.
        tick: u64,
        /// a_p
        power: f64,
        /// Cells a side.
        n: usize,
        /// dB, row by row from y = 0.
        snr_db: Vec<f64>,
    },
    /// An interval as it was flown: the keys of a record, `vehicle` and `rate`.
    Tick(Value),
    /// What the station believes at a tick, and what its model expects from there on.
    Belief(Box<ShownBelief>),
    /// A frame as the station received it.
    Picture {
        /// Whose.
        vehicle: u32,
        /// When.
        tick: u64,
        /// Base 64.
        png: String,
    },
    /// What became of a command.
    Command {
        /// Whose.
        vehicle: u32,
        /// Its own tick.
        tick: u64,
        /// Normalised acceleration, x and y.
        wish: [f64; 2],
        /// a_p
        power: f64,
        /// delivered, delayed, superseded or lost.
        fate: &'static str,
        /// Tick of the report that told it.
        arrived: Option<u64>,
    },
    /// Counters of a link.
    Link {
        /// Whose.
        vehicle: u32,
        /// When.
        tick: u64,
        /// By name.
        counters: Value,
    },
    /// A line of the log.
    Log {
        /// info, warn or error.
        level: &'static str,
        /// Since the beginning.
        time_s: f64,
        /// What.
        text: String,
    },
    /// How far a long computation is.
    Progress {
        /// Units of work that are done.
        done: u64,
        /// Of how many.
        total: u64,
        /// Which.
        text: String,
    },
    /// A point of a curve that grows.
    Curve {
        /// Which curve.
        name: String,
        /// Where.
        x: f64,
        /// What.
        y: f64,
    },
    /// A point of a sweep.
    Point {
        /// The swept key's value.
        x: f64,
        /// Who flew.
        controller: String,
        /// Which metric.
        metric: String,
        /// Its mean.
        value: f64,
        /// Lower end of the interval.
        low: f64,
        /// Upper end.
        high: f64,
    },
    /// Where on Earth the local frame is.
    Geo {
        /// Latitude and longitude of the origin, degrees.
        origin: [f64; 2],
        /// From north to the frame's up, degrees clockwise.
        heading: f64,
        /// GeoJSON, if there are any.
        #[serde(skip_serializing_if = "Option::is_none")]
        buildings: Option<Value>,
    },
    /// Nothing more comes.
    End {
        /// Why.
        reason: String,
        /// Metrics by name.
        summary: Value,
    },
}

/// What the station believes; every position in the unit square.
#[derive(Debug, Clone, Serialize)]
pub struct ShownBelief {
    /// Whose.
    pub vehicle: u32,
    /// When.
    pub tick: u64,
    /// Where the UAV is.
    pub position: [f64; 2],
    /// Standard deviation along x and y.
    pub sigma: [f64; 2],
    /// Where the obstacles are.
    pub obstacles: Vec<[f64; 2]>,
    /// Whether the newest frame shows the UAV somewhere else.
    pub lost: bool,
    /// Paths of the rollout's members, the mean first; empty without a policy.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fan: Vec<Vec<[f64; 2]>>,
    /// SNR on the mean path.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub snr_db: Vec<f64>,
    /// Share of the members in outage.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub outage: Vec<f64>,
    /// Mean of the members' collision probability.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub risk: Vec<f64>,
}

impl WatchEvent {
    /// The first line of a long computation; `revision` is that of the program.
    #[must_use]
    pub fn computation(program: &str, revision: &str, title: &str, scenario: Option<Value>) -> Self {
        Self::Hello {
            version: VERSION,
            title: format!("{program}: {title}"),
            program: program.into(),
            revision: revision.into(),
            seed: None,
            frame: ShownFrame::Square,
            scenario,
            vehicles: Vec::new(),
            limits: None,
            ticks: None,
            dt_s: 0.0,
            control: false,
        }
    }

    /// The tick of a picture or a belief.
    fn tick(&self) -> u64 {
        match self {
            Self::Picture { tick, .. } => *tick,
            Self::Belief(belief) => belief.tick,
            _ => 0,
        }
    }

    /// How soon a history that is full forgets it.
    fn weight(&self) -> LineWeight {
        match self {
            Self::Hello { .. } | Self::Geo { .. } | Self::End { .. } => LineWeight::Kept,
            Self::Field { .. } => LineWeight::Field,
            Self::Picture { .. } | Self::Belief(_) => LineWeight::Bulk,
            _ => LineWeight::Line,
        }
    }
}

/// How soon a history that is full forgets a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LineWeight {
    /// First.
    Bulk,
    /// First too; the newest is needed.
    Field,
    /// Last.
    Line,
    /// Never.
    Kept,
}

/// A line and its place in the feed.
#[derive(Debug, Clone)]
pub struct FeedLine {
    /// Counts from 0.
    pub number: u64,
    /// How soon it is forgotten.
    pub weight: LineWeight,
    /// Of a picture or a belief, its tick.
    pub tick: u64,
    /// JSON without a line's end.
    pub text: Arc<str>,
}

#[derive(Debug, Default)]
struct FeedHistory {
    lines: VecDeque<FeedLine>,
    next: u64,
    bytes: usize,
}

impl FeedHistory {
    /// Makes room: pictures, beliefs and fields of the older half go first, then whatever is oldest.
    fn trim(&mut self, capacity: usize) {
        if self.bytes <= capacity {
            return;
        }
        let middle = self.lines.len() / 2;
        let last_field = self.lines.iter().rev().find(|line| line.weight == LineWeight::Field);
        let last_field = last_field.map(|line| line.number);
        let goes = |line: &FeedLine| match line.weight {
            LineWeight::Bulk => true,
            LineWeight::Field => Some(line.number) != last_field,
            LineWeight::Line | LineWeight::Kept => false,
        };
        let before = self.lines.len();
        let mut n = 0;
        self.lines.retain(|line| {
            n += 1;
            n > middle || !goes(line)
        });
        if self.lines.len() == before {
            let drop_to = self.lines.len() / 4;
            let mut n = 0;
            self.lines.retain(|line| {
                n += 1;
                n > drop_to || line.weight == LineWeight::Kept || Some(line.number) == last_field
            });
        }
        self.bytes = self.lines.iter().map(|line| line.text.len()).sum();
    }
}

#[derive(Debug)]
struct FeedShared {
    history: Mutex<FeedHistory>,
    /// Number of the next line.
    news: watch::Sender<u64>,
    capacity: usize,
}

/// The feed of one program; a clone is the same feed.
#[derive(Debug, Clone)]
pub struct Feed(Arc<FeedShared>);

impl Default for Feed {
    fn default() -> Self {
        Self::with_capacity(CAPACITY)
    }
}

impl Feed {
    /// An empty feed that keeps at most about this many bytes.
    #[must_use]
    pub fn with_capacity(capacity: usize) -> Self {
        Self(Arc::new(FeedShared { history: Mutex::default(), news: watch::Sender::new(0), capacity }))
    }

    fn history(&self) -> MutexGuard<'_, FeedHistory> {
        // No line is half written when somebody panics.
        self.0.history.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a line and wakes who reads; waits for nobody.
    pub fn send(&self, event: &WatchEvent) {
        Self::send_to([self], event);
    }

    /// Adds a line to some feeds, which share it.
    pub fn send_to<'a>(feeds: impl IntoIterator<Item = &'a Self>, event: &WatchEvent) {
        let Ok(text) = serde_json::to_string(event) else { return };
        let text: Arc<str> = text.into();
        feeds.into_iter().for_each(|feed| feed.push(text.clone(), event.weight(), event.tick()));
    }

    /// Adds a line that was told before, such as one of a `flight.html`.
    pub fn repeat(&self, line: &str) {
        let Ok(value) = serde_json::from_str::<Value>(line) else { return };
        let weight = match value["kind"].as_str() {
            Some("hello" | "geo" | "end") => LineWeight::Kept,
            Some("field") => LineWeight::Field,
            Some("picture" | "belief") => LineWeight::Bulk,
            _ => LineWeight::Line,
        };
        self.push(line.into(), weight, value["tick"].as_u64().unwrap_or_default());
    }

    fn push(&self, text: Arc<str>, weight: LineWeight, tick: u64) {
        let mut history = self.history();
        let number = history.next;
        history.next += 1;
        history.bytes += text.len();
        history.lines.push_back(FeedLine { number, weight, tick, text });
        history.trim(self.0.capacity);
        drop(history);
        self.0.news.send_replace(number + 1);
    }

    /// Adds a line of the log.
    pub fn log(&self, level: &'static str, time_s: f64, text: impl Into<String>) {
        self.send(&WatchEvent::Log { level, time_s, text: text.into() });
    }

    /// The lines from `number` on that are still known, at most about `bytes` of them, but at least one if there
    /// is one.
    #[must_use]
    pub fn from(&self, number: u64, bytes: usize) -> Vec<FeedLine> {
        let history = self.history();
        let begin = history.lines.partition_point(|line| line.number < number);
        let mut size = 0;
        let mut is_in = |line: &&FeedLine| {
            let fits = size < bytes;
            size += line.text.len();
            fits
        };
        history.lines.range(begin..).take_while(|line| is_in(line)).cloned().collect()
    }

    /// All lines that are still known.
    #[must_use]
    pub fn all(&self) -> Vec<FeedLine> {
        self.from(0, usize::MAX)
    }

    /// Tells when there is news: the number of the next line.
    #[must_use]
    pub fn news(&self) -> watch::Receiver<u64> {
        self.0.news.subscribe()
    }
}

/// `value` with `digits` decimals: short in JSON.
#[must_use]
pub fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(tick: u64) -> WatchEvent {
        WatchEvent::Picture { vehicle: 1, tick, png: "A".repeat(1000) }
    }

    fn end() -> WatchEvent {
        WatchEvent::End { reason: "over".into(), summary: Value::Null }
    }

    #[test]
    fn a_line_names_its_kind_and_readers_begin_where_they_ask() {
        let feed = Feed::default();
        feed.log("info", 0.0, "a");
        feed.log("warn", 1.5, "b");
        let lines: Vec<_> = feed.all().iter().map(|line| line.text.to_string()).collect();
        assert_eq!(lines[1], r#"{"kind":"log","level":"warn","time_s":1.5,"text":"b"}"#);
        assert_eq!(feed.from(1, usize::MAX)[0].number, 1);
        assert_eq!(feed.from(0, 1).len(), 1);
        assert!(feed.from(2, usize::MAX).is_empty());
        assert_eq!(*feed.news().borrow(), 2);
    }

    #[test]
    fn feeds_share_what_is_told_to_all() {
        let feeds = [Feed::default(), Feed::default()];
        feeds[1].log("info", 0.0, "alone");
        Feed::send_to(&feeds, &picture(3));
        let last = |feed: &Feed| feed.all().pop().unwrap();
        assert!(Arc::ptr_eq(&last(&feeds[0]).text, &last(&feeds[1]).text));
        assert_eq!((last(&feeds[0]).number, last(&feeds[1]).number, last(&feeds[0]).tick), (0, 1, 3));
    }

    #[test]
    fn a_full_history_forgets_pictures_before_lines_and_the_hello_never() {
        let feed = Feed::with_capacity(50_000);
        feed.send(&WatchEvent::Geo { origin: [0.0; 2], heading: 0.0, buildings: None });
        for tick in 0..1000 {
            feed.send(&picture(tick));
            feed.log("info", tick as f64, "line");
        }
        feed.send(&end());
        let lines = feed.all();
        assert!(lines.iter().map(|line| line.text.len()).sum::<usize>() <= 50_000);
        assert!(lines[0].text.contains("geo") && lines[lines.len() - 1].text.contains("end"));
        let count = |kind: &str| lines.iter().filter(|line| line.text.contains(kind)).count();
        assert!(count("\"log\"") > count("\"picture\""), "{}", count("\"log\""));
        // A reader that comes late goes on with what there is.
        assert!(!feed.from(7, usize::MAX).is_empty());
    }
}
