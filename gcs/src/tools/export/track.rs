//! A flight as places in time, from the records of a run folder or from the positions in a tlog.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use crpl_sitl::Scenario;
use crpl_sitl::camera::{Frame, SIDE};
use crpl_sitl::link::image::{frame_from_png, png_from_frame};
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::telemetry::{GlobalPositionInt, LocalPositionNed};
use crpl_sitl::link::tlog::TlogReader;
use crpl_sitl::sim::record::Record;
use crpl_sitl::vehicle::geodesy;
use serde_json::Value;

use crate::tools::{replay, tlog};
use crate::watch::document;

/// Where a vehicle was.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackSample {
    /// Since the beginning of the flight, s.
    pub time_s: f64,
    /// The vehicle's system id.
    pub system: u8,
    /// Latitude and longitude, degrees.
    pub place: [f64; 2],
    /// Above sea level and above home, m.
    pub heights_m: [f64; 2],
    /// North and east of the local origin, m; NaN where a log does not tell.
    pub local_m: [f64; 2],
    /// North, east, down, m/s.
    pub velocity_mps: [f64; 3],
}

/// A flight of one vehicle or several.
#[derive(Debug, Clone, Default)]
pub struct FlightTrack {
    /// When it began, µs since 1970; 0 if nobody knows.
    pub begins_us: u64,
    /// Places in the order of time.
    pub samples: Vec<TrackSample>,
    /// The record that each sample closes; empty for a tlog.
    pub records: Vec<Record>,
    /// The world of the records.
    pub scenario: Option<Scenario>,
    /// The pictures that the station received, in the order of time: s since the beginning, and a PNG whose first row
    /// is the field's upper edge. Empty where there is no `flight.html` beside the records.
    pub pictures: Vec<(f64, Vec<u8>)>,
}

impl FlightTrack {
    /// From a run folder, its record, or a tlog.
    ///
    /// # Errors
    /// There is no flight, or it does not read.
    pub fn open(path: &Path) -> Result<Self> {
        let file = replay::log_of(path, &["record.jsonl", "flight.tlog"])?;
        let bytes = std::fs::read(&file).with_context(|| format!("reading {}", file.display()))?;
        let name = || file.display().to_string();
        let track = if file.extension().is_some_and(|end| end == "jsonl") {
            let scenario = replay::scenario_beside(&file)?;
            let records = replay::records(&String::from_utf8_lossy(&bytes)).with_context(name)?;
            let mut track = Self::of_records(records, scenario);
            track.begins_us = begin_of(&file.with_file_name("flight.tlog"));
            track.pictures = pictures_of(&file.with_file_name("flight.html"), &track);
            track
        } else {
            Self::of_tlog(&bytes).with_context(name)?
        };
        if track.samples.is_empty() {
            bail!("{}: no position in it (GLOBAL_POSITION_INT)", file.display());
        }
        Ok(track)
    }

    /// From records: the place at the end of each interval.
    #[must_use]
    pub fn of_records(records: Vec<Record>, scenario: Scenario) -> Self {
        let height = scenario.scale.altitude_m;
        let sample = |record: &Record| {
            let report = replay::report(record, &scenario);
            let [north, east] = report.velocity.map(f64::from);
            TrackSample {
                time_s: report.tick.0 as f64 * scenario.scale.interval_s,
                system: 1,
                place: degrees(geodesy::latitude_longitude(report.position)),
                heights_m: [geodesy::HOME[2] + height, height],
                local_m: report.position.map(f64::from),
                velocity_mps: [north, east, 0.0],
            }
        };
        Self {
            samples: records.iter().map(sample).collect(),
            records,
            scenario: Some(scenario),
            ..Self::default()
        }
    }

    /// From the positions that a log holds, of each vehicle in it.
    ///
    /// # Errors
    /// It is no log.
    pub fn of_tlog(bytes: &[u8]) -> Result<Self> {
        let (frames, counts) = tlog::timed(bytes);
        if counts.frames == 0 {
            bail!("no MAVLink frame in it; is this a tlog?");
        }
        let mut track = Self { begins_us: frames.first().map_or(0, |(_, f)| f.time_us), ..Self::default() };
        let mut local: BTreeMap<u8, [f64; 2]> = BTreeMap::new();
        for (after, frame) in frames.iter().filter(|(_, frame)| frame.packet.known) {
            let system = frame.packet.system;
            if let Some(LocalPositionNed { position: [north, east, _], .. }) = View::of(frame.packet) {
                local.insert(system, [north, east].map(f64::from));
            }
            let Some(global) = GlobalPositionInt::of(frame.packet) else { continue };
            track.samples.push(TrackSample {
                time_s: after.as_secs_f64(),
                system,
                place: degrees(global.place),
                heights_m: global.heights.map(|mm| f64::from(mm) / 1e3),
                local_m: local.get(&system).copied().unwrap_or([f64::NAN; 2]),
                velocity_mps: global.velocity.map(|cm| f64::from(cm) / 100.0),
            });
        }
        Ok(track)
    }

    /// The systems in it.
    #[must_use]
    pub fn systems(&self) -> Vec<u8> {
        let all: std::collections::BTreeSet<u8> = self.samples.iter().map(|sample| sample.system).collect();
        all.into_iter().collect()
    }
}

fn degrees(place: [i32; 2]) -> [f64; 2] {
    place.map(|x| f64::from(x) / 1e7)
}

/// The pictures inside a `flight.html`; none if there is no such file.
fn pictures_of(path: &Path, track: &FlightTrack) -> Vec<(f64, Vec<u8>)> {
    let html = std::fs::read_to_string(path).unwrap_or_default();
    let interval_s = track.scenario.as_ref().map_or(0.0, |scenario| scenario.scale.interval_s);
    let lines = document::lines_of(&html).unwrap_or_default();
    lines
        .iter()
        .filter_map(|line| picture_of(line))
        .map(|(tick, png)| (tick as f64 * interval_s, png))
        .collect()
}

/// The picture in a line of the feed, if there is one, the right way up: its first row was the field's lower edge.
fn picture_of(line: &str) -> Option<(u64, Vec<u8>)> {
    let line: Value = serde_json::from_str(line).ok().filter(|line: &Value| line["kind"] == "picture")?;
    let (tick, frame) = frame_from_png(&STANDARD.decode(line["png"].as_str()?).ok()?).ok()?;
    let rows = frame.rgb().chunks(3 * SIDE).rev();
    let png = png_from_frame(&Frame::from_rgb(rows.flatten().copied().collect())?, tick).ok()?;
    Some((tick.0, png))
}

/// The first stamp of a log, if there is one.
fn begin_of(path: &Path) -> u64 {
    let bytes = std::fs::read(path).unwrap_or_default();
    TlogReader::new(&bytes).next().map_or(0, |frame| frame.time_us)
}
