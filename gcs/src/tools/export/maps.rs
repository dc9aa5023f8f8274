//! A flight on a map: GPX and GeoJSON.

use anyhow::{Context, Result};
use crpl_sitl::vehicle::geodesy;
use geo_types::Point;
use gpx::{Gpx, GpxVersion, Track, TrackSegment, Waypoint};
use serde_json::{Value, json};
use time::OffsetDateTime;

use super::track::{FlightTrack, TrackSample};

/// One track a vehicle, with height, speed and time.
pub fn gpx(track: &FlightTrack) -> Result<Vec<u8>> {
    let mut file = Gpx {
        version: GpxVersion::Gpx11,
        creator: Some(format!("gcs {}", crate::revision())),
        ..Gpx::default()
    };
    for system in track.systems() {
        let of_system = track.samples.iter().filter(|sample| sample.system == system);
        let points = of_system.map(|sample| waypoint(track, sample)).collect::<Result<Vec<_>>>()?;
        let name = Some(format!("vehicle {system}"));
        file.tracks.push(Track { name, segments: vec![TrackSegment { points }], ..Track::default() });
    }
    let mut bytes = Vec::new();
    gpx::write(&file, &mut bytes).context("writing GPX")?;
    Ok(bytes)
}

fn waypoint(track: &FlightTrack, sample: &TrackSample) -> Result<Waypoint> {
    let [latitude, longitude] = sample.place;
    let mut point = Waypoint::new(Point::new(longitude, latitude));
    point.elevation = Some(sample.heights_m[0]);
    let nanoseconds = i128::from(track.begins_us) * 1000 + (sample.time_s * 1e9) as i128;
    point.time = Some(OffsetDateTime::from_unix_timestamp_nanos(nanoseconds).context("a stamp")?.into());
    Ok(point)
}

/// Tracks as lines; of a run folder also base station, goal, obstacles at the end, and places of outage.
pub fn geojson(track: &FlightTrack) -> String {
    let mut features = Vec::new();
    for system in track.systems() {
        let of_system: Vec<&TrackSample> = track.samples.iter().filter(|s| s.system == system).collect();
        let places: Vec<Value> =
            of_system.iter().map(|s| json!([s.place[1], s.place[0], s.heights_m[0]])).collect();
        let times: Vec<f64> = of_system.iter().map(|s| s.time_s).collect();
        let properties = json!({ "name": format!("vehicle {system}"), "times_s": times });
        // A line has two ends; one place is a point.
        let geometry = match places.as_slice() {
            [one] => json!({ "type": "Point", "coordinates": one }),
            _ => json!({ "type": "LineString", "coordinates": places }),
        };
        features.push(feature(geometry, properties));
    }
    features.extend(world(track));
    let outages = track.records.iter().zip(&track.samples).filter(|(record, _)| record.outage);
    features.extend(outages.map(|(record, sample)| {
        point(sample.place, json!({ "name": "outage", "tick": record.tick.0, "snr_db": record.snr_db }))
    }));
    json!({ "type": "FeatureCollection", "features": features }).to_string() + "\n"
}

/// Base station, goal, and the obstacles where the flight left them.
fn world(track: &FlightTrack) -> Vec<Value> {
    let Some(scenario) = &track.scenario else { return Vec::new() };
    let place = |r| geodesy::latitude_longitude(scenario.scale.ned_from_paper(r)).map(|x| f64::from(x) / 1e7);
    let unit = scenario.scale.metres_per_unit;
    let mut features = vec![
        point(place(scenario.channel.base_station), json!({ "name": "base station" })),
        point(place(scenario.goal), json!({ "name": "goal", "radius_m": scenario.goal_radius * unit })),
    ];
    if let Some(last) = track.records.last() {
        features.extend(last.obstacles.each(scenario).map(|(centre, obstacle)| {
            point(place(centre), json!({ "name": "obstacle", "radius_m": obstacle.radius * unit }))
        }));
    }
    features
}

fn point([latitude, longitude]: [f64; 2], properties: Value) -> Value {
    feature(json!({ "type": "Point", "coordinates": [longitude, latitude] }), properties)
}

fn feature(geometry: Value, properties: Value) -> Value {
    json!({ "type": "Feature", "geometry": geometry, "properties": properties })
}
