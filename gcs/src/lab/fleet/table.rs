//! `gcs fleet`: outage, terminal distance, risk and collisions against the number of vehicles.

use std::fmt::Write;
use std::path::PathBuf;

use anyhow::{Context, Result};
use crpl_model::evaluation::chart::{self, Chart, Legend, Series, Sheet, Style};
use crpl_model::numeric::statistics::{Mean, wilson};
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::columns;
use crpl_sitl::program::progress;
use crpl_sitl::program::terminal::{StopSignal, folder, positive};
use crpl_sitl::scenario::presets;
use crpl_sitl::sim::metric::{FlightOutcome, Metric};
use rayon::prelude::*;
use serde::Serialize;

use super::scheduler::Scheduler;
use super::{FleetPlan, FleetScore, fly};
use crate::lab::{Contender, policies};
use crate::station::models::ModelFiles;
use crate::station::pilot::Controller;

/// Flags of `gcs fleet`.
#[derive(Debug, clap::Args)]
#[command(after_help = presets::table())]
pub struct FleetFlags {
    /// Scenario: TOML file or preset
    #[arg(long, value_name = "FILE|NAME", default_value = "demo")]
    scenario: String,
    #[command(flatten)]
    camera: CameraFlag,
    /// Numbers of vehicles
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values = ["1", "2", "4", "8"], value_parser = clap::value_parser!(u8).range(1..=32))]
    vehicles: Vec<u8>,
    /// How they share the bandwidth
    #[arg(long, value_enum, value_name = "LIST", value_delimiter = ',', default_values = ["tdma", "round-robin", "predicted"])]
    scheduler: Vec<Scheduler>,
    /// Controllers to fly
    #[arg(long, value_enum, value_name = "LIST", value_delimiter = ',', default_values = ["crpl"])]
    controller: Vec<Controller>,
    /// B dt of all vehicles together, bits per interval and bit/s/Hz [default: four times the scenario's]
    #[arg(long, value_name = "X", value_parser = positive)]
    bandwidth: Option<f64>,
    /// Intervals between two pairs that leave
    #[arg(long, value_name = "N", default_value_t = 10)]
    headway: u64,
    /// Let vehicles fly through each other: by default they keep clear by their reports
    #[arg(long)]
    no_separation: bool,
    /// Draw the other vehicles as obstacles in each camera
    #[arg(long)]
    drawn: bool,
    /// Flights per row
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..))]
    episodes: u64,
    /// First of the consecutive seeds
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_seed: u64,
    #[command(flatten)]
    models: ModelFiles,
    /// Folder for fleet.csv and the figure
    #[arg(long, value_name = "DIR", value_parser = folder)]
    out: Option<PathBuf>,
    /// Print one JSON line per row
    #[arg(long)]
    json: bool,
}

/// One number of vehicles under one scheduler.
#[derive(Debug, Clone, Serialize)]
pub struct FleetRow {
    /// Who flew.
    pub controller: Controller,
    /// How they shared.
    pub scheduler: Scheduler,
    /// N.
    pub vehicles: u8,
    /// Flights.
    pub episodes: u64,
    /// Vehicles that ended in their goal region, of all.
    pub reached: [u64; 2],
    /// Its 95 % Wilson interval.
    pub reached_ci: [f64; 2],
    /// Share of a vehicle's intervals in which no command got through.
    pub outage: Mean,
    /// d_f.
    pub d_f: Mean,
    /// Largest probability of a collision with the obstacle.
    pub p_coll: Mean,
    /// Collisions of two vehicles in a flight.
    pub collisions: Mean,
    /// Mean power level of a slot.
    pub power: Mean,
}

/// Runs the subcommand.
///
/// # Errors
/// A scenario or model that does not read, a controller without policies, a file that cannot be written, a signal.
pub fn run(args: &FleetFlags) -> Result<()> {
    let scenario = args.camera.scenario(&args.scenario)?;
    let mut models = args.models.load()?;
    policies::cover(&mut models, &args.controller, &scenario, args.models.optimise)?;
    let heads = models.world.station_heads(&scenario);
    let b_dt = args.bandwidth.unwrap_or(4.0 * scenario.radio.b_dt);
    let stop = StopSignal::listen()?;
    let rows = args.controller.len() * args.scheduler.len() * args.vehicles.len();
    let bar = progress::bar("flights", args.episodes * rows as u64);
    if !args.json {
        let (n, first) = (args.episodes, args.first_seed);
        let words = format!("{}, shared B dt {b_dt}, {n} flights from seed {first}", scenario.name);
        crpl_sitl::out!("{}", columns::wrapped(&words, 2, columns::width()));
        put(&head());
    }
    let mut all = Vec::new();
    for controller in &args.controller {
        let contender = Contender::new(&models, *controller, &scenario)?;
        for scheduler in &args.scheduler {
            for vehicles in &args.vehicles {
                let plan = FleetPlan {
                    vehicles: usize::from(*vehicles),
                    scheduler: *scheduler,
                    b_dt,
                    headway: args.headway,
                    separate: !args.no_separation,
                    drawn: args.drawn,
                };
                let flights: Vec<FleetScore> = (args.first_seed..args.first_seed + args.episodes)
                    .into_par_iter()
                    .filter(|_| stop.get().is_none())
                    .map(|seed| {
                        let score = fly(&contender, &heads, &plan, seed);
                        bar.inc(1);
                        score
                    })
                    .collect::<Result<_>>()?;
                if let Some(signal) = stop.get() {
                    bar.finish_and_clear();
                    return Err(signal.exit("the flights of this row are discarded").into());
                }
                let row = row(*controller, &plan, *vehicles, &flights);
                bar.suspend(|| show(&row, args.json))?;
                all.push(row);
            }
        }
    }
    bar.finish_and_clear();
    args.out.as_ref().map_or(Ok(()), |dir| save(dir, &all))
}

fn row(controller: Controller, plan: &FleetPlan, vehicles: u8, flights: &[FleetScore]) -> FleetRow {
    let of_all = |of: &dyn Fn(&FleetScore) -> f64| Mean::of(&flights.iter().map(of).collect::<Vec<_>>());
    let mean = |metric: Metric| {
        of_all(&|fleet| {
            fleet.flights.iter().map(|f| f[metric]).sum::<f64>() / fleet.flights.len().max(1) as f64
        })
    };
    let each = || flights.iter().flat_map(|fleet| &fleet.flights);
    let reached = each().filter(|flight| flight.is(FlightOutcome::Reached)).count();
    FleetRow {
        controller,
        scheduler: plan.scheduler,
        vehicles,
        episodes: flights.len() as u64,
        reached: [reached as u64, each().count() as u64],
        reached_ci: wilson(reached, each().count()),
        outage: of_all(&|fleet| {
            let share =
                |f: &crpl_sitl::sim::metric::FlightScore| f[Metric::Outages] / (f.ticks as f64).max(1.0);
            fleet.flights.iter().map(share).sum::<f64>() / fleet.flights.len().max(1) as f64
        }),
        d_f: mean(Metric::TerminalDistance),
        p_coll: mean(Metric::CollisionProbability),
        collisions: of_all(&|fleet| fleet.collisions as f64),
        power: of_all(&|fleet| fleet.power),
    }
}

/// Widths of the columns of the table.
const COLUMNS: [usize; 9] = [8, 12, 3, 9, 22, 21, 7, 15, 7];

fn put(line: &str) {
    crpl_sitl::out!("{}", columns::folded_line(line, &COLUMNS, columns::width()));
}

fn head() -> String {
    format!(
        "{:<8} {:<11} {:>2} {:>8} {:>21} {:>20} {:>6} {:>14} {:>6}",
        "flies", "scheduler", "N", "reached", "outage", "d_f", "p_coll", "collisions", "power"
    )
}

fn cell(mean: &Mean, decimals: usize) -> String {
    format!("{:.*} [{:.*}, {:.*}]", decimals, mean.mean, decimals, mean.ci[0], decimals, mean.ci[1])
}

fn show(row: &FleetRow, json: bool) -> Result<()> {
    if json {
        crpl_sitl::outln!("{}", serde_json::to_string(row)?);
        return Ok(());
    }
    put(&format!(
        "{:<8} {:<11} {:>2} {:>8} {:>21} {:>20} {:>6.3} {:>14} {:>6.2}",
        row.controller.to_string(),
        row.scheduler.name(),
        row.vehicles,
        format!("{}/{}", row.reached[0], row.reached[1]),
        cell(&row.outage, 3),
        cell(&row.d_f, 3),
        row.p_coll.mean,
        cell(&row.collisions, 1),
        row.power.mean
    ));
    Ok(())
}

/// Writes `fleet.csv`, and the figure of outage, d_f and collisions against N.
fn save(dir: &std::path::Path, rows: &[FleetRow]) -> Result<()> {
    std::fs::create_dir_all(dir).with_context(|| format!("making {}", dir.display()))?;
    let mut csv = String::from("controller,scheduler,vehicles,episodes,reached,flights");
    for key in ["outage", "d_f", "p_coll", "collisions", "power"] {
        let _ = write!(csv, ",{key},{key}_low,{key}_high");
    }
    csv.push('\n');
    for row in rows {
        let FleetRow { controller, scheduler, vehicles, episodes, reached, .. } = row;
        let _ = write!(
            csv,
            "{controller},{},{vehicles},{episodes},{},{}",
            scheduler.name(),
            reached[0],
            reached[1]
        );
        for mean in [&row.outage, &row.d_f, &row.p_coll, &row.collisions, &row.power] {
            let _ = write!(csv, ",{},{},{}", mean.mean, mean.ci[0], mean.ci[1]);
        }
        csv.push('\n');
    }
    let path = dir.join("fleet.csv");
    std::fs::write(&path, csv).with_context(|| format!("writing {}", path.display()))?;
    let panels = [
        panel("share of intervals without a command", rows, |row| &row.outage, Legend::Below),
        panel("d_f", rows, |row| &row.d_f, Legend::None),
        panel("collisions of vehicles in a flight", rows, |row| &row.collisions, Legend::None),
    ];
    chart::save(Sheet { charts: &panels, columns: 3 }, dir, "fleet")?;
    Ok(())
}

fn panel(title: &str, rows: &[FleetRow], of: impl Fn(&FleetRow) -> &Mean, legend: Legend) -> Chart {
    let mut kinds: Vec<(Controller, Scheduler)> = Vec::new();
    for row in rows {
        if !kinds.contains(&(row.controller, row.scheduler)) {
            kinds.push((row.controller, row.scheduler));
        }
    }
    let curve = |(n, (controller, scheduler)): (usize, &(Controller, Scheduler))| {
        let mine: Vec<(f64, &Mean)> = rows
            .iter()
            .filter(|row| (row.controller, row.scheduler) == (*controller, *scheduler))
            .map(|row| (f64::from(row.vehicles), of(row)))
            .collect();
        let points = mine.iter().map(|(x, mean)| (*x, mean.mean)).collect();
        let band = mine.iter().map(|(x, mean)| (*x, mean.ci[0], mean.ci[1])).collect();
        let name = format!("{controller}, {}", scheduler.name());
        Series { band, ..Series::line(name, n, points).styled(Style::Dotted) }
    };
    Chart {
        title: title.into(),
        x: "vehicles".into(),
        series: kinds.iter().enumerate().map(curve).collect(),
        legend,
        panel: true,
        ..Chart::default()
    }
}
