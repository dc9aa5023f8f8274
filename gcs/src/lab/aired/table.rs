//! `gcs episodes --radio`: what becomes of each controller where the radio carries everything.

use anyhow::{Context, Result, ensure};
use crpl_model::numeric::statistics::{Mean, quantile, wilson};
use crpl_sitl::Scenario;
use crpl_sitl::link::latents;
use crpl_sitl::program::terminal::{StopSignal, positive};
use crpl_sitl::program::{air, columns, progress};
use crpl_sitl::radio::air::AirRadio;
use crpl_sitl::sim::metric::{FlightOutcome, FlightScore, Metric, PerMetric};
use rayon::prelude::*;
use serde::Serialize;

use super::{AirPlan, AirTally, Downlink};
use crate::lab::Contender;
use crate::station::models::Models;
use crate::station::pilot::Controller;

/// Flags of a radio that carries everything.
#[derive(Debug, Clone, clap::Args)]
pub struct AirFlags {
    /// What the radio carries: setpoints (the paper's gate); all, the scenario's radio for everything; or a radio's
    /// preset or file, for everything
    #[arg(long, value_name = "setpoints|all|FILE|NAME", default_value = air::SETPOINTS)]
    pub radio: String,
    /// What the vehicle sends of its camera, with a radio for everything
    #[arg(long, value_enum, value_name = "LIST", value_delimiter = ',', default_values = ["picture", "latent"])]
    pub downlink: Vec<Downlink>,
    /// Bandwidth of --radio all: intervals that a picture takes from the start
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = positive, default_values = ["1"])]
    pub picture_intervals: Vec<f64>,
    /// Width of a latent's number, bits
    #[arg(long, value_name = "BITS", default_value_t = 10, value_parser = clap::value_parser!(u8).range(4..=16))]
    pub latent_bits: u8,
}

impl AirFlags {
    /// Whether the radio carries setpoints alone.
    #[must_use]
    pub fn is_gate(&self) -> bool {
        self.radio == air::SETPOINTS
    }

    /// The radios to fly over, each with its name in the table.
    ///
    /// # Errors
    /// No such radio; a picture that cannot be encoded.
    fn radios(&self, scenario: &Scenario) -> Result<Vec<(String, AirRadio)>> {
        if self.radio != "all" {
            return Ok(vec![("-".into(), AirRadio::named(&self.radio)?)]);
        }
        let radios = self.picture_intervals.iter().map(|intervals| {
            let radio = air::radio(&self.radio, scenario, *intervals)?.context("the scenario's radio")?;
            Ok((format!("{intervals}"), radio))
        });
        radios.collect()
    }
}

/// One controller over one radio.
#[derive(Debug, Clone, Serialize)]
pub struct AirRow {
    /// Intervals that a picture takes from the start; `-` where the radio's file says how fast it is.
    pub picture: String,
    /// What the vehicle sends of its camera.
    pub downlink: Downlink,
    /// Who flew.
    pub controller: Controller,
    /// Flights.
    pub episodes: u64,
    /// Flights that ended in the goal region.
    pub reached: u64,
    /// Its 95 % Wilson interval.
    pub reached_ci: [f64; 2],
    /// Means.
    #[serde(flatten)]
    pub metrics: PerMetric<Mean>,
    /// Median and 95th percentile of the age of what a decision goes by, intervals.
    pub age: [f64; 2],
    /// Mean of the intervals without a decision.
    pub silent: f64,
    /// Bits a second that the vehicle and the station put on the air.
    pub bits_per_s: [f64; 2],
}

/// Flies and prints.
///
/// # Errors
/// As [`Contender::new`]; no such radio, a controller on frames without frames, a signal.
pub fn run(
    flags: &AirFlags,
    models: &Models,
    scenario: &Scenario,
    controllers: &[Controller],
    (first_seed, episodes): (u64, u64),
    json: bool,
) -> Result<()> {
    ensure!(
        scenario.obstacles.len() < latents::MAX_VECTORS || !flags.downlink.contains(&Downlink::Latent),
        "latents of {} obstacles do not fit into a message",
        scenario.obstacles.len()
    );
    let radios = flags.radios(scenario)?;
    let stop = StopSignal::listen()?;
    let rows = radios.len() * flags.downlink.len() * controllers.len();
    let bar = progress::bar("flights", episodes * rows as u64);
    if !json {
        let words = format!("{}, {episodes} flights from seed {first_seed}", scenario.name);
        crpl_sitl::out!("{}", columns::wrapped(&words, 2, columns::width()));
        head().lines().for_each(put);
    }
    for (picture, radio) in &radios {
        for downlink in &flags.downlink {
            let plan = AirPlan { radio: radio.clone(), downlink: *downlink, latent_bits: flags.latent_bits };
            for controller in controllers {
                let contender = Contender::new(models, *controller, scenario)?;
                if contender.sees_frames() && *downlink == Downlink::Telemetry {
                    continue;
                }
                let flights: Vec<(FlightScore, AirTally)> = (first_seed..first_seed + episodes)
                    .into_par_iter()
                    .filter(|_| stop.get().is_none())
                    .map(|seed| {
                        let flown = contender.fly_over(&plan, seed);
                        bar.inc(1);
                        flown
                    })
                    .collect::<Result<_>>()?;
                if let Some(signal) = stop.get() {
                    bar.finish_and_clear();
                    return Err(signal.exit("the flights of this row are discarded").into());
                }
                let row = row(picture, *downlink, *controller, scenario, &flights);
                bar.suspend(|| show(&row, json))?;
            }
        }
    }
    bar.finish_and_clear();
    Ok(())
}

fn row(
    picture: &str,
    downlink: Downlink,
    controller: Controller,
    scenario: &Scenario,
    flights: &[(FlightScore, AirTally)],
) -> AirRow {
    let reached = flights.iter().filter(|(score, _)| score.is(FlightOutcome::Reached)).count();
    let ages: Vec<f64> = flights.iter().flat_map(|(_, tally)| tally.ages.iter().copied()).collect();
    let seconds: f64 = flights.iter().map(|(score, _)| score.ticks as f64 * scenario.scale.interval_s).sum();
    let rate = |way: usize| flights.iter().map(|(_, t)| t.bits[way]).sum::<u64>() as f64 / seconds;
    let mean = |metric: Metric| Mean::of(&flights.iter().map(|(score, _)| score[metric]).collect::<Vec<_>>());
    AirRow {
        picture: picture.into(),
        downlink,
        controller,
        episodes: flights.len() as u64,
        reached: reached as u64,
        reached_ci: wilson(reached, flights.len()),
        metrics: PerMetric::from_fn(mean),
        age: [quantile(&ages, 0.5), quantile(&ages, 0.95)],
        silent: flights.iter().map(|(_, t)| t.silent as f64).sum::<f64>() / flights.len().max(1) as f64,
        bits_per_s: [rate(0), rate(1)],
    }
}

/// Widths of the columns of the table.
const COLUMNS: [usize; 12] = [7, 10, 9, 8, 15, 7, 7, 7, 6, 8, 9, 7];

fn put(line: &str) {
    crpl_sitl::out!("{}", columns::folded_line(line, &COLUMNS, columns::width()));
}

fn head() -> String {
    format!(
        "{:>7} {:<9} {:<8} {:>7} {:>14} {:>6} {:>6} {:>6} {:>5} {:>7} {:>8} {:>6}",
        "picture",
        "downlink",
        "flies",
        "reached",
        "of 95 %",
        "d_f",
        "T_out",
        "p_coll",
        "coll",
        "age",
        "down",
        "up"
    ) + &format!(
        "\n{:>7} {:<9} {:<8} {:>7} {:>14} {:>6} {:>6} {:>6} {:>5} {:>7} {:>8} {:>6}",
        "dt", "", "", "", "", "", "dt", "", "", "dt", "bit/s", "bit/s"
    )
}

fn show(row: &AirRow, json: bool) -> Result<()> {
    if json {
        crpl_sitl::outln!("{}", serde_json::to_string(row)?);
        return Ok(());
    }
    let mean = |metric: Metric| row.metrics[metric].mean;
    put(&format!(
        "{:>7} {:<9} {:<8} {:>7} {:>14} {:>6.3} {:>6.2} {:>6.3} {:>5.2} {:>7} {:>8.0} {:>6.0}",
        row.picture,
        row.downlink.name(),
        row.controller.to_string(),
        format!("{}/{}", row.reached, row.episodes),
        format!("[{:.3}, {:.3}]", row.reached_ci[0], row.reached_ci[1]),
        mean(Metric::TerminalDistance),
        mean(Metric::Outages),
        mean(Metric::CollisionProbability),
        mean(Metric::Collisions),
        format!("{:.0}, {:.0}", row.age[0], row.age[1]),
        row.bits_per_s[0],
        row.bits_per_s[1]
    ));
    Ok(())
}
