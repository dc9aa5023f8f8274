//! A flight as a table, one row a position: CSV and Parquet of the same columns.

use anyhow::Result;
use crpl_sitl::sim::record::Record;

use super::track::{FlightTrack, TrackSample};
use crate::tools::parquet::{self, Column, Values};

fn columns(track: &FlightTrack) -> Vec<Column<'static>> {
    let real = |name, of: &dyn Fn(&TrackSample) -> f64| Column {
        name,
        values: Values::Reals(track.samples.iter().map(of).collect()),
    };
    let mut columns = vec![
        real("time_s", &|s| s.time_s),
        Column {
            name: "system",
            values: Values::Integers(track.samples.iter().map(|s| s.system.into()).collect()),
        },
        real("latitude_deg", &|s| s.place[0]),
        real("longitude_deg", &|s| s.place[1]),
        real("altitude_m", &|s| s.heights_m[0]),
        real("height_m", &|s| s.heights_m[1]),
        real("north_m", &|s| s.local_m[0]),
        real("east_m", &|s| s.local_m[1]),
        real("north_mps", &|s| s.velocity_mps[0]),
        real("east_mps", &|s| s.velocity_mps[1]),
        real("down_mps", &|s| s.velocity_mps[2]),
    ];
    if !track.records.is_empty() {
        columns.extend(of_records(&track.records));
    }
    columns
}

/// What a record tells beside the place.
fn of_records(records: &[Record]) -> Vec<Column<'static>> {
    let real = |name, of: &dyn Fn(&Record) -> f64| Column {
        name,
        values: Values::Reals(records.iter().map(of).collect()),
    };
    let flag = |name, of: &dyn Fn(&Record) -> bool| Column {
        name,
        values: Values::Booleans(records.iter().map(of).collect()),
    };
    vec![
        Column { name: "tick", values: Values::Integers(records.iter().map(|r| r.tick.0 as i64).collect()) },
        real("x", &|r| r.r_next.x),
        real("y", &|r| r.r_next.y),
        real("wish_x", &|r| r.wish.x),
        real("wish_y", &|r| r.wish.y),
        real("flown_x", &|r| r.flown.x),
        real("flown_y", &|r| r.flown.y),
        real("power", &|r| r.power.level()),
        real("snr_db", &|r| r.snr_db.into()),
        real("p_coll", &|r| r.p_coll),
        flag("outage", &|r| r.outage),
        flag("collided", &|r| r.collided),
        flag("edge", &|r| r.edge),
    ]
}

/// As Parquet.
pub fn parquet(track: &FlightTrack) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let begins = track.begins_us.to_string();
    parquet::write(&mut bytes, &columns(track), &[("begins_us", &begins), ("revision", crate::revision())])?;
    Ok(bytes)
}

/// As comma-separated values; what is not known is empty.
pub fn csv(track: &FlightTrack) -> String {
    let columns = columns(track);
    let head: Vec<&str> = columns.iter().map(|column| column.name).collect();
    let rows = (0..track.samples.len()).map(|n| {
        let cells: Vec<String> = columns.iter().map(|column| column.values.cell(n)).collect();
        cells.join(",") + "\n"
    });
    std::iter::once(head.join(",") + "\n").chain(rows).collect()
}
