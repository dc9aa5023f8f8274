use std::time::{Duration, UNIX_EPOCH};

use crpl_sitl::link::dialect::{GLOBAL_POSITION_INT_DATA, LOCAL_POSITION_NED_DATA};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::tlog::Tlog;
use crpl_sitl::radio::message::Command;
use crpl_sitl::units::{Tick, TxPower};
use crpl_sitl::{Scenario, Sim, sim::record::Record};

use super::*;

/// Ten intervals of the demo's world.
fn flown() -> FlightTrack {
    let scenario = Scenario::default();
    let mut sim = Sim::new(scenario.clone(), 3);
    let mut records = Vec::new();
    for k in 0..10 {
        let (before, command) = (sim.telemetry(), Command::new(Tick(k), [1.0, 0.5], TxPower::High));
        sim.handle(command);
        sim.advance();
        records.push(Record::new(&before, &command, &sim.telemetry(), &scenario));
    }
    FlightTrack::of_records(records, scenario)
}

/// Positions of two vehicles, one of which tells its local position too.
fn tlog() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut log = Tlog::new(&mut bytes);
    for k in 0..6_u64 {
        let mut frames = Vec::new();
        let mut encoder = Encoder::new(1 + (k % 2) as u8, 1);
        if k % 2 == 0 {
            encoder.push(&mut frames, &LOCAL_POSITION_NED_DATA { x: k as f32, y: 2.0, ..Default::default() });
        }
        let place = GLOBAL_POSITION_INT_DATA {
            lat: 473_977_420 + k as i32 * 100,
            lon: 85_455_940,
            alt: 500_000,
            relative_alt: 12_000,
            ..Default::default()
        };
        encoder.push(&mut frames, &place);
        log.datagram(&frames, UNIX_EPOCH + Duration::from_millis(1_700_000_000_000 + 500 * k)).unwrap();
    }
    bytes
}

#[test]
fn a_tlog_of_several_vehicles_is_a_track_of_each() {
    let track = FlightTrack::of_tlog(&tlog()).unwrap();
    assert_eq!((track.systems(), track.samples.len()), (vec![1, 2], 6));
    assert_eq!(track.begins_us, 1_700_000_000_000_000);
    let last = &track.samples[5];
    assert_eq!((last.time_s, last.heights_m), (2.5, [500.0, 12.0]));
    assert!((last.place[0] - 47.397_792).abs() < 1e-9);
    assert_eq!(track.samples[4].local_m, [4.0, 2.0]);
    assert!(last.local_m[0].is_nan());
    let text = String::from_utf8(ExportFormat::Csv.bytes(&track).unwrap()).unwrap();
    assert!(text.starts_with("time_s,system,latitude_deg") && text.lines().count() == 7, "{text}");
    assert!(text.lines().nth(2).unwrap().contains(",12,,,"), "an unknown number is empty: {text}");
}

#[test]
fn records_know_their_world() {
    let track = flown();
    assert_eq!(track.samples.len(), 10);
    assert!((track.samples[0].time_s - 0.4).abs() < 1e-12, "the end of interval 0");
    let csv = String::from_utf8(ExportFormat::Csv.bytes(&track).unwrap()).unwrap();
    assert!(csv.lines().next().unwrap().ends_with("snr_db,p_coll,outage,collided,edge"), "{csv}");
    let map: serde_json::Value =
        serde_json::from_slice(&ExportFormat::Geojson.bytes(&track).unwrap()).unwrap();
    let names: Vec<&str> = map["features"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["properties"]["name"].as_str().unwrap())
        .collect();
    assert_eq!(names[..4], ["vehicle 1", "base station", "goal", "obstacle"]);
}

#[test]
fn a_gpx_track_reads_back() {
    let track = FlightTrack::of_tlog(&tlog()).unwrap();
    let file = gpx::read(ExportFormat::Gpx.bytes(&track).unwrap().as_slice()).unwrap();
    assert_eq!(file.tracks.len(), 2);
    let points = &file.tracks[1].segments[0].points;
    assert_eq!((points.len(), points[2].elevation), (3, Some(500.0)));
    assert!((points[2].point().y() - 47.397_792).abs() < 1e-9);
    assert_eq!(points[0].time.unwrap().format().unwrap(), "2023-11-14T22:13:20.500000000Z");
}

#[test]
fn rerun_s_own_format_is_refused_with_the_way_to_go() {
    let error = ExportFormat::Rrd.bytes(&flown()).unwrap_err().to_string();
    assert!(error.contains("rerun-sdk") && error.contains("examples/python/to_rerun.py"), "{error}");
}
