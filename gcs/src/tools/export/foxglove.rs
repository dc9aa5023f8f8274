//! A flight as an MCAP log, which Foxglove opens: places as `foxglove.LocationFix`, poses in the local frame
//! as `foxglove.PoseInFrame` (x east, y north, z up), the pictures received as `foxglove.CompressedImage`, and the
//! records as they are; messages are JSON.

use anyhow::Result;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

use super::mcap::McapLog;
use super::track::FlightTrack;

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

fn picture_schema() -> Value {
    json!({
        "title": "foxglove.CompressedImage", "type": "object",
        "properties": {
            "timestamp": stamp_schema(), "frame_id": { "type": "string" },
            "data": { "type": "string", "contentEncoding": "base64" }, "format": { "type": "string" },
        },
    })
}

/// The schema of messages like this one.
fn schema_of(title: &str, message: &Value) -> Value {
    let kind = |value: &Value| match value {
        Value::Bool(_) => json!({ "type": "boolean" }),
        Value::Number(_) => json!({ "type": "number" }),
        Value::Array(_) => json!({ "type": "array" }),
        _ => json!({}),
    };
    let keys = message.as_object().into_iter().flatten();
    let properties: serde_json::Map<_, _> = keys.map(|(key, value)| (key.clone(), kind(value))).collect();
    json!({ "title": title, "type": "object", "properties": properties })
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
    fn nanoseconds(&self, time_s: f64) -> u64 {
        self.track.begins_us * 1000 + (time_s * 1e9) as u64
    }

    fn put(&mut self, channel: u16, time_s: f64, json: &str) {
        let time = self.nanoseconds(time_s);
        self.file.message(channel, time, json.as_bytes());
    }

    fn stamp(&self, time_s: f64) -> Value {
        let time = self.nanoseconds(time_s);
        json!({ "sec": time / 1_000_000_000, "nsec": time % 1_000_000_000 })
    }

    fn vehicle(&mut self, system: u8) {
        let track = self.track;
        let locations =
            self.channel(&format!("/vehicle_{system}/location"), "foxglove.LocationFix", &location_schema());
        let poses = self.channel(&format!("/vehicle_{system}/pose"), "foxglove.PoseInFrame", &pose_schema());
        for sample in track.samples.iter().filter(|sample| sample.system == system) {
            let stamp = self.stamp(sample.time_s);
            let [latitude, longitude] = sample.place;
            let location = json!({
                "timestamp": stamp, "frame_id": "earth",
                "latitude": latitude, "longitude": longitude, "altitude": sample.heights_m[0],
                "position_covariance": vec![0.0; 9], "position_covariance_type": 0,
            });
            self.put(locations, sample.time_s, &location.to_string());
            let [north, east] = sample.local_m;
            if north.is_finite() && east.is_finite() {
                let pose = json!({
                    "timestamp": stamp, "frame_id": "local",
                    "pose": {
                        "position": { "x": east, "y": north, "z": sample.heights_m[1] },
                        "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
                    },
                });
                self.put(poses, sample.time_s, &pose.to_string());
            }
        }
    }

    /// The records with the names and units that `record.jsonl` has.
    fn records(&mut self) -> Result<()> {
        let track = self.track;
        if track.records.is_empty() {
            return Ok(());
        }
        let schema = schema_of("crpl.Record", &serde_json::to_value(&track.records[0])?);
        let channel = self.channel("/record", "crpl.Record", &schema);
        for (record, sample) in track.records.iter().zip(&track.samples) {
            self.put(channel, sample.time_s, &serde_json::to_string(record)?);
        }
        Ok(())
    }

    fn pictures(&mut self) {
        let track = self.track;
        if track.pictures.is_empty() {
            return;
        }
        let channel = self.channel("/vehicle_1/picture", "foxglove.CompressedImage", &picture_schema());
        for (time_s, png) in &track.pictures {
            let (stamp, data) = (self.stamp(*time_s), STANDARD.encode(png));
            let image = json!({ "timestamp": stamp, "frame_id": "camera", "data": data, "format": "png" });
            self.put(channel, *time_s, &image.to_string());
        }
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
    log.pictures();
    log.records()?;
    Ok(log.file.finish())
}
