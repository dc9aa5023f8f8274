//! Flies CRPL in Scenario 2 in this process, without a network, and prints the flight's metrics.
//!
//! `cargo run --release -p crpl-gcs --example fly_in_process`

use anyhow::{Context, Result};
use crpl_gcs::station::models::Models;
use crpl_gcs::station::pilot::Controller;
use crpl_sitl::{Scenario, Sim};

/// Equal seeds give equal gusts, and so equal flights.
const SEED: u64 = 0;

fn main() -> Result<()> {
    let mut scenario = Scenario::numbered(2)?;
    scenario.radio.b_dt = 2.75; // little bandwidth: behind the obstacle, low power loses packets
    scenario.disturbance.sigma_c = 0.005;

    // The vehicle with its world, and the station with the models that ship with the crate.
    let mut sim = Sim::new(scenario.clone(), SEED);
    let mut station = Models::load(None, None)?.station(Controller::Crpl, &scenario)?;

    for _ in 0..scenario.horizon {
        let command = station.handle(&sim.percept()); // frame and telemetry in, motion and power out
        sim.handle(command); // over the simulated radio, which may lose it
        sim.advance();
    }
    station.finish(&sim.percept());

    let score = station.score().context("no interval was flown")?;
    for (metric, value) in score.metrics.iter() {
        println!("{:<8} {:>8}  {}", metric.symbol(), metric.show(*value), metric.title());
    }
    Ok(())
}
