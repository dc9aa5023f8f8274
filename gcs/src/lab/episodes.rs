//! Many flights in process on consecutive seeds, every frame rendered and encoded, controllers
//! paired by the same gusts.

use anyhow::Result;
use crpl_sitl::Scenario;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::columns;
use crpl_sitl::program::progress;
use crpl_sitl::program::terminal::StopSignal;
use crpl_sitl::scenario::presets;
use crpl_sitl::sim::metric::{FlightOutcome, FlightScore, Metric, PerMetric};
use rayon::prelude::*;
use serde::Serialize;

use crate::lab::aired::table::{self, AirFlags};
use crate::lab::sweep::table::ratio_cell;
use crate::lab::{Contender, policies};
use crate::station::models::{ModelFiles, PolicyOrigin};
use crate::station::pilot::own::AnswerTally;
use crate::station::pilot::{Controller, ControllerParser};
use crpl_model::numeric::statistics::{Interval, Mean, Resamples, wilson};

/// Flags of `gcs episodes`.
#[derive(Debug, clap::Args)]
#[command(after_help = presets::table())]
pub struct Episodes {
    /// Scenario: TOML file or preset
    #[arg(long, value_name = "FILE|NAME", default_value = "demo")]
    scenario: String,
    #[command(flatten)]
    camera: CameraFlag,
    /// Flights per controller
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    episodes: u64,
    /// First of the consecutive seeds
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_seed: u64,
    /// Controllers to fly
    #[arg(long, value_parser = ControllerParser, value_name = "LIST", value_delimiter = ',', default_values = ["crpl", "rcc", "ucc"])]
    controller: Vec<Controller>,
    #[command(flatten)]
    air: AirFlags,
    #[command(flatten)]
    models: ModelFiles,
    /// Print one JSON line per controller
    #[arg(long)]
    json: bool,
}

/// One controller over all seeds.
#[derive(Debug, Clone, Serialize)]
pub struct EpisodesRow {
    /// Who flew.
    pub controller: Controller,
    /// The scenario's name.
    pub scenario: String,
    /// Flights.
    pub episodes: u64,
    /// First seed.
    pub first_seed: u64,
    /// How many of them differ from each other in any metric: 1 where nothing is left to chance.
    pub distinct: u64,
    /// Share of flights that ended in the goal region.
    pub reached: f64,
    /// Its 95 % Wilson interval; of one flight alone it is [0, 1].
    pub reached_ci: Interval,
    /// Flights that ended with the UAV's centre within 0.02 of a wall.
    pub at_wall: u64,
    /// Means.
    #[serde(flatten)]
    pub metrics: PerMetric<Mean>,
    /// Ratios of means to crpl's on the same seeds, if crpl flew before it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ratio_to_crpl: Option<PerMetric<Mean>>,
    /// Share of flights that pass below the obstacle (smaller y at its x).
    pub below: f64,
    /// Where the controller's policies come from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy: Option<PolicyOrigin>,
    /// How a controller of somebody's own has answered; `None` for another.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub answers: Option<AnswerTally>,
}

/// Runs the subcommand.
///
/// # Errors
/// A scenario or model that does not read, a controller without policies, a signal.
pub fn run(args: &Episodes) -> Result<()> {
    let scenario = args.camera.scenario(&args.scenario)?;
    let mut models = args.models.load()?;
    policies::cover(&mut models, &args.controller, &scenario, args.models.optimise)?;
    if !args.air.is_gate() {
        let seeds = (args.first_seed, args.episodes);
        return table::run(&args.air, &models, &scenario, &args.controller, seeds, args.json);
    }
    let stop = StopSignal::listen()?;
    let bar = progress::bar("flights", args.episodes * args.controller.len() as u64);
    let mut crpl: Option<Vec<FlightScore>> = None;
    for controller in &args.controller {
        let contender = Contender::new(&models, *controller, &scenario)?;
        let flights: Vec<FlightScore> = (args.first_seed..args.first_seed + args.episodes)
            .into_par_iter()
            .filter(|_| stop.get().is_none())
            .map(|seed| {
                let scored = contender.fly(seed);
                bar.inc(1);
                scored
            })
            .collect::<Result<_>>()?;
        if let Some(signal) = stop.get() {
            bar.finish_and_clear();
            let (done, all) = (flights.len(), args.episodes);
            let what = format!("{controller} has flown {done} of {all}, which are discarded");
            return Err(signal.exit(&what).into());
        }
        let row = EpisodesRow {
            policy: contender.policy().cloned(),
            answers: contender.answers(),
            ratio_to_crpl: crpl.as_deref().and_then(|crpl| ratios(&flights, crpl)),
            ..row(*controller, &scenario, args.first_seed, &flights)
        };
        bar.suspend(|| show(&row, args.json))?;
        if *controller == Controller::Crpl {
            crpl = Some(flights);
        }
    }
    bar.finish_and_clear();
    Ok(())
}

/// Ratios of means on the same seeds; `None` of flights that are all the same.
fn ratios(flights: &[FlightScore], crpl: &[FlightScore]) -> Option<PerMetric<Mean>> {
    let resamples = Resamples::of(flights.len());
    let values = |flights: &[FlightScore], m: Metric| flights.iter().map(|f| f[m]).collect::<Vec<_>>();
    PerMetric::try_from_fn(|m| resamples.ratio(&values(flights, m), &values(crpl, m), m.floor()))
}

fn row(controller: Controller, scenario: &Scenario, first_seed: u64, flights: &[FlightScore]) -> EpisodesRow {
    let mean = |metric: Metric| Mean::of(&flights.iter().map(|f| f[metric]).collect::<Vec<_>>());
    let count = |outcome: FlightOutcome| flights.iter().filter(|f| f.is(outcome)).count() as u64;
    let share = |outcome: FlightOutcome| count(outcome) as f64 / flights.len().max(1) as f64;
    let mut scores: Vec<Vec<u64>> =
        flights.iter().map(|f| Metric::ALL.iter().map(|m| f[*m].to_bits()).collect()).collect();
    scores.sort_unstable();
    scores.dedup();
    let distinct = scores.len() as u64;
    let reached_ci = match distinct {
        1 => [0.0, 1.0],
        _ => wilson(count(FlightOutcome::Reached) as usize, flights.len()),
    };
    EpisodesRow {
        distinct,
        reached_ci,
        controller,
        scenario: scenario.name.clone(),
        episodes: flights.len() as u64,
        first_seed,
        reached: share(FlightOutcome::Reached),
        at_wall: count(FlightOutcome::AtWall),
        metrics: PerMetric::from_fn(mean),
        below: share(FlightOutcome::Below),
        ratio_to_crpl: None,
        policy: None,
        answers: None,
    }
}

/// A mean with its interval; where all of several flights have the same value, that is said in its place.
fn cell(mean: &Mean, distinct: u64) -> String {
    match (mean.is_constant(), distinct) {
        (_, 1) => format!("{:.4}", mean.mean),
        (true, _) => format!("{:.4} in every flight", mean.mean),
        (false, _) => format!("{:.4} [{:.4}, {:.4}]", mean.mean, mean.ci[0], mean.ci[1]),
    }
}

fn show(row: &EpisodesRow, json: bool) -> Result<()> {
    if json {
        crpl_sitl::outln!("{}", serde_json::to_string(row)?);
        return Ok(());
    }
    let width = columns::width();
    let say = |line: String, indent| crpl_sitl::out!("{}", columns::wrapped(&line, indent, width));
    say(
        format!(
            "{}, {}, {} flights from seed {}",
            row.controller, row.scenario, row.episodes, row.first_seed
        ),
        2,
    );
    let of_all = |share: f64| format!("{:.0} of {}", share * row.episodes as f64, row.episodes);
    if row.distinct == 1 && row.episodes > 1 {
        let all = row.episodes;
        say(
            format!(
                "  all {all} flights are the same flight, as nothing in them is left to chance: no intervals"
            ),
            4,
        );
    }
    let ci = match row.distinct {
        1 => String::new(),
        _ => format!(" [{:.3}, {:.3}]", row.reached_ci[0], row.reached_ci[1]),
    };
    let (reached, below) = (of_all(row.reached), of_all(row.below));
    let reached = format!("  reached {:.3}{ci} ({reached}), at a wall {}", row.reached, row.at_wall);
    say(format!("{reached}, below the obstacle {:.3} ({below})", row.below), 4);
    for (metric, mean) in row.metrics.iter() {
        crpl_sitl::outln!("  {:<14}{}", metric.symbol(), cell(mean, row.distinct));
    }
    if let Some(ratios) = row.ratio_to_crpl.filter(|_| row.distinct > 1) {
        let cells: Vec<String> =
            Metric::compared().map(|m| format!("{} {}", m.symbol(), ratio_cell(&ratios[m]))).collect();
        for (n, some) in cells.chunks(3).enumerate() {
            say(format!("  {:<14}{}", if n == 0 { "over crpl" } else { "" }, some.join(", ")), 16);
        }
    }
    if let Some(mismatch) = row.policy.as_ref().and_then(PolicyOrigin::mismatch) {
        let does = if row.controller.flies_policies() { "flies" } else { "begins its search with" };
        say(format!("  {does} a policy of another world: {mismatch}"), 4);
    }
    if let Some(told) = row.answers.as_ref().and_then(AnswerTally::told) {
        say(format!("  {told}"), 4);
    }
    Ok(())
}
