//! Small sweeps as tables that are reviewed when they change, and RCC and UCC against the statistics of a study
//! that shares no code with us.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use crpl_gcs::lab::Contender;
use crpl_gcs::station::models::Models;
use crpl_gcs::station::pilot::Controller;
use crpl_model::numeric::statistics::Mean;
use crpl_sitl::Scenario;
use crpl_sitl::sim::metric::{FlightScore, Metric};
use serde::Deserialize;
use tests::golden::read;
use tests::program;

/// Runs the command that stands in the table's first line, and compares what it prints.
fn assert_golden(name: &str) {
    let path = program::workspace().join("tests/golden").join(name);
    let golden = std::fs::read_to_string(&path).unwrap();
    let (command, table) = golden.split_once('\n').unwrap();
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().unwrap();
    let flags: Vec<&str> = command.strip_prefix("# gcs ").unwrap().split(' ').chain(["--out", out]).collect();
    let said = program::run("gcs", &flags).unwrap().good().unwrap();
    let (now, _) = said.split_once("\n\nepisodes.csv").unwrap();
    let path = path.display();
    assert_eq!(
        now,
        table.trim_end(),
        "\n{path} is no longer what its first line prints; now:\n{command}\n{now}"
    );
}

// One line of a flight that goes another way changes these tables. The networks and rollouts in f32 give
// the same bits at every vector width; the world in f64 calls the platform's exp, ln and pow, so a C library that
// rounds them otherwise may need tables of its own.
#[test]
fn the_bandwidth_sweep_in_small() {
    assert_golden("sweep_bandwidth.txt");
}

#[test]
fn the_disturbance_sweep_in_small() {
    assert_golden("sweep_sigma.txt");
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Calibration {
    #[expect(dead_code, reason = "for the reader of the file")]
    doc: String,
    rows: Vec<Published>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Published {
    episodes: u32,
    b_dt: f64,
    gust_std: f64,
    controller: Controller,
    d_f: Option<f64>,
    e_comm: Option<f64>,
    t_out: Option<f64>,
    p_coll_max: Option<f64>,
}

impl Published {
    /// Each figure that was published, with half the unit of its last digit.
    fn figures(&self) -> impl Iterator<Item = (Metric, f64, f64)> {
        [
            (Metric::TerminalDistance, self.d_f, 0.0005),
            (Metric::TransmitEnergy, self.e_comm, 0.5),
            (Metric::Outages, self.t_out, 0.05),
            (Metric::CollisionProbability, self.p_coll_max, 0.0005),
        ]
        .into_iter()
        .filter_map(|(metric, figure, rounding)| Some((metric, figure?, rounding)))
    }
}

/// Two samples of one distribution differ by more than this many standard errors once in 370 times, and
/// here are 21 figures that hang together.
const SIGMAS: f64 = 3.0;

/// Flights of each row here.
const FLIGHTS: u64 = 200;

#[test]
fn reactive_controllers_agree_with_the_calibration_study() {
    let models = Models::load(None, None).unwrap();
    let calibration: Calibration = read("calibration").unwrap();
    std::thread::scope(|scope| {
        for row in &calibration.rows {
            scope.spawn(|| assert_agrees(row, &models));
        }
    });
}

fn assert_agrees(row: &Published, models: &Models) {
    let mut scenario = Scenario::default();
    scenario.radio.b_dt = row.b_dt;
    scenario.disturbance.sigma_c = row.gust_std / scenario.disturbance.gust_scale;
    let contender = Contender::new(models, row.controller, &scenario).unwrap();
    let flights: Vec<FlightScore> = (0..FLIGHTS).map(|seed| contender.fly(200_000 + seed).unwrap()).collect();
    for (metric, published, rounding) in row.figures() {
        let here = Mean::of(&flights.iter().map(|flight| flight[metric]).collect::<Vec<_>>());
        let error = here.sd * (1.0 / FLIGHTS as f64 + 1.0 / f64::from(row.episodes)).sqrt();
        let apart = (here.mean - published).abs();
        assert!(
            apart <= SIGMAS * error + rounding,
            "{} at B dt {}, gusts {}, {}: {} here, {published} published, {:.1} standard errors",
            row.controller,
            row.b_dt,
            row.gust_std,
            metric.key(),
            here.mean,
            apart / error
        );
    }
}
