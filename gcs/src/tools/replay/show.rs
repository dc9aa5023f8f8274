//! What a page shows of a replay.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crpl_sitl::Scenario;
use crpl_sitl::radio::message::{Command, Telemetry};
use crpl_sitl::sim::record::Record;
use serde_json::Value;

use super::recording::ReplayedRecording;
use super::reports::report;
use crate::tools::spotter::Spotter;
use crate::watch::feed::{Feed, ShownVehicle, WatchEvent};
use crate::watch::narrator::{Narrator, SeenScene, StationSight};
use crate::watch::watcher::hello;
use crate::watch::{Shown, document};

/// The number of the only vehicle of records.
const VEHICLE: u32 = 1;

/// Tells a feed of a replay.
#[derive(Debug)]
pub enum ReplayShow {
    /// The lines of the `flight.html` beside the log, at their times.
    Lines {
        /// Where they go.
        feed: Feed,
        /// What is left.
        lines: VecDeque<(Duration, String)>,
    },
    /// Records, with pictures where there are some.
    Told(Box<ToldRecords>),
    /// What the messages tell.
    Spotted {
        /// Where it goes.
        feed: Feed,
        /// Who listens.
        spotter: Box<Spotter>,
    },
}

impl ReplayShow {
    /// Of the lines of the page beside a log, if there is one.
    #[must_use]
    pub fn beside(log: &Path, feed: &Feed) -> Option<Self> {
        let html = std::fs::read_to_string(log.with_file_name("flight.html")).ok()?;
        Some(Self::Lines { feed: feed.clone(), lines: timed(document::lines_of(&html)?) })
    }

    /// Of records.
    #[must_use]
    pub fn of_records(records: &[Record], scenario: &Scenario, feed: &Feed) -> Self {
        Self::Told(Box::new(ToldRecords::new(records, scenario, feed, None)))
    }

    /// Of a recording.
    #[must_use]
    pub fn of_recording(recording: ReplayedRecording, feed: &Feed) -> Self {
        let (records, scenario) = (recording.records.clone(), recording.scenario.clone());
        Self::Told(Box::new(ToldRecords::new(&records, &scenario, feed, Some(recording))))
    }

    /// Of messages; buildings of the map, as GeoJSON.
    #[must_use]
    pub fn of_messages(feed: &Feed, buildings: Option<Value>) -> Self {
        let spotter = Box::new(Spotter::new(feed.clone(), "gcs replay", false, buildings));
        Self::Spotted { feed: feed.clone(), spotter }
    }

    /// This was sent so long after the beginning.
    pub fn play(&mut self, after: Duration, bytes: &[u8]) {
        match self {
            Self::Lines { feed, lines } => {
                while let Some((_, line)) = lines.pop_front_if(|(due, _)| *due <= after) {
                    feed.repeat(&line);
                }
            }
            Self::Told(told) => told.play(after),
            Self::Spotted { spotter, .. } => spotter.datagram(bytes, after),
        }
    }

    /// Tells what is left, and the end.
    pub fn finish(&mut self) {
        let feed = match self {
            Self::Lines { feed, lines } => {
                lines.drain(..).for_each(|(_, line)| feed.repeat(&line));
                return;
            }
            Self::Told(told) => {
                told.play(Duration::MAX);
                told.narrator.finish();
                &told.feed
            }
            Self::Spotted { feed, .. } => feed,
        };
        feed.send(&WatchEvent::End { reason: "over".into(), summary: Value::Null });
    }
}

/// Records as the vehicle told them and as they were flown.
#[derive(Debug)]
pub struct ToldRecords {
    feed: Feed,
    narrator: Narrator,
    /// Each with its time and the number of the interval that it begins.
    sights: VecDeque<(Duration, usize, StationSight)>,
    recording: Option<ReplayedRecording>,
}

impl ToldRecords {
    fn new(
        records: &[Record],
        scenario: &Scenario,
        feed: &Feed,
        recording: Option<ReplayedRecording>,
    ) -> Self {
        let name = if recording.is_some() { "recording" } else { "record" };
        let vehicle = ShownVehicle { id: VEHICLE, name: name.into(), controller: None };
        let shown = Shown { program: "gcs replay".into(), vehicles: vec![vehicle], ..Shown::default() };
        let mut first = hello(scenario, &shown);
        if let WatchEvent::Hello { ticks, .. } = &mut first {
            *ticks = records.last().map(|last| last.tick.0 + 1);
        }
        feed.send(&first);
        let narrator = Narrator::new(vec![feed.clone()], VEHICLE, scenario, None);
        Self { feed: feed.clone(), narrator, sights: sights(records, scenario).into(), recording }
    }

    fn play(&mut self, after: Duration) {
        while let Some((_, n, mut sight)) = self.sights.pop_front_if(|(due, ..)| *due <= after) {
            let frame = self.recording.as_ref().filter(|_| sight.command.is_some());
            let frame = frame.and_then(|recording| recording.frame(n));
            sight.scene =
                frame.map(|frame| SeenScene { frame: Arc::new(frame), belief: None, foresight: None });
            self.narrator.tell(sight);
        }
    }
}

/// What a station saw at the beginning of each interval, and at the end.
fn sights(records: &[Record], scenario: &Scenario) -> Vec<(Duration, usize, StationSight)> {
    let time = |tick: u64| {
        Duration::try_from_secs_f64(tick as f64 * scenario.scale.interval_s).unwrap_or(Duration::MAX)
    };
    let mut before: Option<&Record> = None;
    let mut all = Vec::new();
    for (n, record) in records.iter().enumerate() {
        let follows = before.filter(|before| before.tick.next() == record.tick);
        let accel = scenario.scale.ned_from_paper_acceleration(record.wish * scenario.dynamics.a_max);
        all.push((
            time(record.tick.0),
            n,
            StationSight {
                telemetry: follows.map_or_else(|| begin(record, scenario), |before| report(before, scenario)),
                command: Some(Command::new(record.tick, accel, record.power)),
                records: before.cloned().into_iter().collect(),
                scene: None,
            },
        ));
        before = Some(record);
    }
    if let Some(last) = before {
        let telemetry = report(last, scenario);
        let sight = StationSight { telemetry, command: None, records: vec![last.clone()], scene: None };
        all.push((time(last.tick.0.saturating_add(1)), records.len(), sight));
    }
    all
}

/// What the vehicle reported at the beginning of an interval that follows no other.
fn begin(record: &Record, scenario: &Scenario) -> Telemetry {
    let scale = &scenario.scale;
    Telemetry {
        tick: record.tick,
        position: scale.ned_from_paper(record.r),
        velocity: scale.ned_from_paper_velocity(record.v),
        held: None,
        link: None,
        ..report(record, scenario)
    }
}

/// Lines with the time of the flight at which each was told: an interval's own line at its end, all others when their
/// interval begins.
fn timed(lines: Vec<String>) -> VecDeque<(Duration, String)> {
    let (mut now, mut interval_s) = (0.0_f64, Scenario::default().scale.interval_s);
    let mut told = VecDeque::new();
    for line in lines {
        let value: Value = serde_json::from_str(&line).unwrap_or_default();
        if let Some(seconds) = value["dt_s"].as_f64() {
            interval_s = seconds;
        }
        let at = value["arrived"].as_u64().or(value["tick"].as_u64());
        let ended = u64::from(value["kind"] == "tick");
        now = at.map_or(now, |tick| now.max((tick + ended) as f64 * interval_s));
        told.push_back((Duration::try_from_secs_f64(now).unwrap_or_default(), line));
    }
    told
}
