//! A flight as an MCAP log, which Foxglove opens: places as `foxglove.LocationFix`, poses in the local frame
//! as `foxglove.PoseInFrame` (x east, y north, z up), and the records as they are; messages are JSON.

use anyhow::Result;
use serde_json::{Value, json};

use super::mcap::McapLog;
use super::track::{FlightTrack, TrackSample};

/// The parts of Foxglove's schemas that are used here.
fn location_schema() -> Value {
    json!({
        "title": "foxglove.LocationFix", "type": "object",
        "properties": {
            "timestamp": stamp_schema(), "frame_id": { "type": "string" },
            "latitude": { "type": "number" }, "longitude": { "type": "number" }, "altitude": { "type": "number" },
            "position_covariance": { "type": "array", "items": { "type": "number" } },
            "position_covariance_type": { "type": "integer" },
        },
    })
}

fn pose_schema() -> Value {
    let numbers = |names: &[&str]| -> Value {
        let each = names.iter().map(|name| ((*name).to_owned(), json!({ "type": "number" })));
        json!({ "type": "object", "properties": each.collect::<serde_json::Map<_, _>>() })
    };
    json!({
        "title": "foxglove.PoseInFrame", "type": "object",
        "properties": {
            "timestamp": stamp_schema(), "frame_id": { "type": "string" },
            "pose": {
                "type": "object",
                "properties": { "position": numbers(&["x", "y", "z"]), "orientation": numbers(&["x", "y", "z", "w"]) },
            },
        },
    })
}

fn stamp_schema() -> Value {
    json!({ "type": "object", "properties": { "sec": { "type": "integer" }, "nsec": { "type": "integer" } } })
}

/// A log that is written.
struct Log<'a> {
    file: McapLog,
    track: &'a FlightTrack,
}

impl Log<'_> {
    fn channel(&mut self, topic: &str, name: &str, schema: &Value) -> u16 {
        self.file.channel(topic, name, &schema.to_string())
    }

    /// Nanoseconds since 1970.
    fn nanoseconds(&self, sample: &TrackSample) -> u64 {
        self.track.begins_us * 1000 + (sample.time_s * 1e9) as u64
    }

    fn put(&mut self, channel: u16, sample: &TrackSample, json: &str) {
        let time = self.nanoseconds(sample);
        self.file.message(channel, time, json.as_bytes());
    }

    fn vehicle(&mut self, system: u8) {
        let track = self.track;
        let locations =
            self.channel(&format!("/vehicle_{system}/location"), "foxglove.LocationFix", &location_schema());
        let poses = self.channel(&format!("/vehicle_{system}/pose"), "foxglove.PoseInFrame", &pose_schema());
        for sample in track.samples.iter().filter(|sample| sample.system == system) {
            let time = self.nanoseconds(sample);
            let stamp = json!({ "sec": time / 1_000_000_000, "nsec": time % 1_000_000_000 });
            let [latitude, longitude] = sample.place;
            let location = json!({
                "timestamp": stamp, "frame_id": "earth",
                "latitude": latitude, "longitude": longitude, "altitude": sample.heights_m[0],
                "position_covariance": vec![0.0; 9], "position_covariance_type": 0,
            });
            self.put(locations, sample, &location.to_string());
            let [north, east] = sample.local_m;
            if north.is_finite() && east.is_finite() {
                let pose = json!({
                    "timestamp": stamp, "frame_id": "local",
                    "pose": {
                        "position": { "x": east, "y": north, "z": sample.heights_m[1] },
                        "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
                    },
                });
                self.put(poses, sample, &pose.to_string());
            }
        }
    }

    /// The records with the names and units that `record.jsonl` has.
    fn records(&mut self) -> Result<()> {
        let track = self.track;
        if track.records.is_empty() {
            return Ok(());
        }
        let channel =
            self.channel("/record", "crpl.Record", &json!({ "title": "crpl.Record", "type": "object" }));
        for (record, sample) in track.records.iter().zip(&track.samples) {
            self.put(channel, sample, &serde_json::to_string(record)?);
        }
        Ok(())
    }
}

/// The flight as MCAP.
pub fn mcap(track: &FlightTrack) -> Result<Vec<u8>> {
    let mut log = Log { file: McapLog::new(&format!("gcs {}", crate::revision())), track };
    if let Some(scenario) = &track.scenario {
        log.file.metadata("scenario", &[("config.toml", &toml::to_string(scenario)?)]);
    }
    for system in track.systems() {
        log.vehicle(system);
    }
    log.records()?;
    Ok(log.file.finish())
}
