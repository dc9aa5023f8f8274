//! `gcs export`: what others read in it.

use tests::{program, python};

#[test]
fn a_flight_is_read_by_duckdb_gpxpy_and_the_reference_reader_of_mcap() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("flight");
    let (out, run) = (out.to_str().unwrap(), dir.path().join("flight/rcc"));
    let gcs = |args: &[&str]| program::run("gcs", args).unwrap();
    gcs(&["demo", "--controller", "rcc", "--out", out]).good().unwrap();
    let run = run.to_str().unwrap();
    for format in ["csv", "parquet", "gpx", "geojson", "mcap"] {
        let said = gcs(&["export", run, "--to", format]).good().unwrap();
        assert!(said.starts_with("100 positions of 40.0 s in "), "{said}");
    }
    let said = python::script("read_export.py", &[run]).unwrap().good().unwrap();
    let expected = [
        "table: 100 rows, 0 differences",
        "gpx: 100 points, 39.6 s",
        "geojson: LineString of 100, True",
        "mcap: 400 messages, 400 told, 4 topics, red at the UAV's place in 100 pictures",
    ];
    assert_eq!(said.lines().collect::<Vec<_>>(), expected);

    // The example for Rerun is run with a stand-in for Rerun's library.
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/python/to_rerun.py");
    let said = python::script("to_rerun.py", &[example, run]).unwrap().good().unwrap();
    assert_eq!(said.trim_end(), format!("100 intervals in {run}/flight.rrd\n100 100 True"));

    // The tlog of a lockstep flight holds the flight's own time, and its places.
    let tlog = format!("{run}/flight.tlog");
    let said = gcs(&["export", &tlog, "--to", "csv", "--out", &format!("{run}/tlog.csv")]).good().unwrap();
    let seconds: f64 = said.split(" of ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((39.0..=41.0).contains(&seconds), "{said}");

    // A folder of several flights is none; a file is not replaced unasked.
    let refused = gcs(&["export", out, "--to", "csv"]);
    assert!(refused.stderr.contains("rcc") && !refused.status.success(), "{}", refused.stderr);
    let refused = gcs(&["export", run, "--to", "csv"]);
    assert!(refused.stderr.contains("--overwrite") && !refused.status.success(), "{}", refused.stderr);
    let refused = gcs(&["export", run, "--to", "rrd"]);
    assert!(refused.stderr.contains("to_rerun.py") && !refused.status.success(), "{}", refused.stderr);
}
