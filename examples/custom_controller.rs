//! Scores a controller of one's own beside RCC, over the same gusts.
//!
//! `cargo run --release -p crpl-gcs --example custom_controller`
//!
//! To select a controller by `--controller`, add it to `station::pilot` as its head says. For a trial it
//! is enough to answer percepts with commands, as here.

use anyhow::{Context, Result};
use crpl_gcs::lab::Contender;
use crpl_gcs::station::models::Models;
use crpl_gcs::station::pilot::Controller;
use crpl_sitl::radio::message::{Command, Telemetry};
use crpl_sitl::sim::metric::{FlightScore, Metric, PerMetric};
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::{Motion, TxPower};
use crpl_sitl::{Scenario, Sim};
use nalgebra::Vector2;

/// Flights that are averaged; seed N has the same gusts for every controller.
const FLIGHTS: u64 = 20;

/// Flies to the goal by way of a point below the obstacle, and sends with high power only where the base
/// station is far.
struct Detour {
    via: Vector2<f64>,
    goal: Vector2<f64>,
    base_station: Vector2<f64>,
    /// Units of the square.
    far: f64,
}

impl Detour {
    /// Motion and power for the interval that begins.
    fn decide(&self, telemetry: &Telemetry, scenario: &Scenario) -> (Motion, TxPower) {
        let r = scenario.scale.paper_from_ned(telemetry.position);
        let v = scenario.scale.paper_from_ned_velocity(telemetry.velocity);
        let target = if r.x < self.via.x { self.via } else { self.goal };
        // A PD law in units of the largest acceleration; the nearest of the five motions is flown.
        let wish = (0.02 * (target - r) - 0.2 * v) / scenario.dynamics.a_max;
        let is_far = (r - self.base_station).norm() > self.far;
        (Motion::nearest(wish), if is_far { TxPower::High } else { TxPower::Low })
    }
}

/// One flight: percept in, command out, a record for each interval.
fn fly(controller: &Detour, scenario: &Scenario, seed: u64) -> Result<FlightScore> {
    let mut sim = Sim::new(scenario.clone(), seed);
    let mut records = Vec::new();
    for _ in 0..scenario.horizon {
        let before = sim.telemetry();
        let (motion, power) = controller.decide(&before, scenario);
        let accel = scenario.scale.ned_from_paper_acceleration(scenario.dynamics.a_max * motion.vector());
        let command = Command::new(before.tick, accel, power);
        sim.handle(command);
        sim.advance();
        records.push(Record::new(&before, &command, &sim.telemetry(), scenario));
    }
    FlightScore::of(&records, scenario).context("no interval was flown")
}

/// The mean of each metric.
fn mean(scores: &[FlightScore]) -> PerMetric<f64> {
    PerMetric::from_fn(|m| scores.iter().map(|s| s.metrics[m]).sum::<f64>() / scores.len() as f64)
}

fn main() -> Result<()> {
    let mut scenario = Scenario::numbered(2)?;
    scenario.radio.b_dt = 2.75;
    scenario.disturbance.sigma_c = 0.005;

    let detour = Detour {
        via: Vector2::new(0.45, 0.2),
        goal: scenario.goal,
        base_station: scenario.channel.base_station,
        far: 0.7,
    };
    let rcc = Contender::new(&Models::load(None, None)?, Controller::Rcc, &scenario)?;
    let ours = (0..FLIGHTS).map(|seed| fly(&detour, &scenario, seed)).collect::<Result<Vec<_>>>()?;
    let theirs = (0..FLIGHTS).map(|seed| rcc.fly(seed)).collect::<Result<Vec<_>>>()?;

    println!("{:<34} {:>10} {:>10}", format!("mean of {FLIGHTS} flights"), "detour", "rcc");
    let (ours, theirs) = (mean(&ours), mean(&theirs));
    for metric in Metric::ALL {
        println!("{:<34} {:>10.4} {:>10.4}", metric.title(), ours[metric], theirs[metric]);
    }
    Ok(())
}
