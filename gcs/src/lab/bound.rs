//! `gcs bound`: what no controller can beat, and how far each is from it.
//!
//! Two values of the start state by dynamic programming with the equations and the gusts' statistics: with the
//! chance constraints as penalties, which is what APC flies, and without them and with every packet delivered, which
//! bounds J of controllers that break a constraint too. Both carry the lattice's own error; APC's flights show it.

use anyhow::{Result, bail};
use crpl_model::numeric::statistics::{Interval, Mean, quantile};
use crpl_sitl::Scenario;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::columns;
use crpl_sitl::program::progress;
use crpl_sitl::program::terminal::StopSignal;
use crpl_sitl::program::timing::Stopwatch;
use crpl_sitl::scenario::presets;
use crpl_sitl::sim::metric::{FlightScore, Metric};
use crpl_sitl::units::Tick;
use crpl_sitl::world::obstacles::Obstacles;
use rayon::prelude::*;
use serde::Serialize;

use crate::lab::{Contender, policies};
use crate::station::models::{ModelFiles, Models};
use crate::station::pilot::apc::Apc;
use crate::station::pilot::apc::stage::Constraints;
use crate::station::pilot::apc::value::{Solution, ValueConfig};
use crate::station::pilot::reactive::Present;
use crate::station::pilot::{Controller, ControllerParser};

/// Flags of `gcs bound`.
#[derive(Debug, clap::Args)]
#[command(after_help = presets::table())]
pub struct Bound {
    /// Scenario: TOML file or preset
    #[arg(long, value_name = "FILE|NAME", default_value = "demo")]
    scenario: String,
    #[command(flatten)]
    camera: CameraFlag,
    /// Controllers beside APC
    #[arg(long, value_parser = ControllerParser, value_name = "LIST", value_delimiter = ',', default_values = ["crpl", "rcc", "ucc"])]
    controller: Vec<Controller>,
    /// Flights per controller
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(2..))]
    episodes: u64,
    /// First of the consecutive seeds
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_seed: u64,
    #[command(flatten)]
    models: ModelFiles,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The bounds of a scenario, and who comes near.
#[derive(Debug, Serialize)]
struct BoundReport {
    scenario: String,
    episodes: u64,
    first_seed: u64,
    /// Value of the start with the constraints as penalties, the terminal cost in it.
    constrained: f64,
    /// J of the start without constraints and losses.
    unconstrained: f64,
    /// Time to solve for it, s.
    solve_s: f64,
    /// One decision of APC, ms.
    decision_ms: f64,
    rows: Vec<BoundRow>,
}

/// One controller beside the bound.
#[derive(Debug, Serialize)]
struct BoundRow {
    controller: Controller,
    j: Mean,
    /// J and the terminal cost.
    j_t: Mean,
    /// That less APC's on the same seeds.
    more: Mean,
    d_f: Mean,
    risk: Mean,
    /// Whether P_safe and the mean of the largest collision probability keep δ1, and the share of intervals in
    /// outage δ2.
    keeps: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// A scenario or model that does not read, a controller without policies, a signal.
pub fn run(args: &Bound) -> Result<()> {
    let scenario = args.camera.scenario(&args.scenario)?;
    let mut models = args.models.load()?;
    policies::cover(&mut models, &args.controller, &scenario, args.models.optimise)?;
    let stop = StopSignal::listen()?;
    let config = ValueConfig::default();
    let unconstrained = Solution::of(&scenario, Constraints::Ignored, &config).of_start();
    let stopwatch = Stopwatch::default();
    let apc = Apc::new(&scenario);
    let solve_s = stopwatch.seconds().0;
    let decision_ms = decision(&apc, &scenario);
    let all: Vec<Controller> = std::iter::once(Controller::Apc)
        .chain(args.controller.iter().copied().filter(|c| *c != Controller::Apc))
        .collect();
    let bar = progress::bar("flights", args.episodes * all.len() as u64);
    let mut flown: Vec<(Controller, Vec<FlightScore>)> = Vec::new();
    for controller in all {
        let scores = fly(&models, controller, &scenario, args, &stop, &bar)?;
        flown.push((controller, scores));
    }
    bar.finish_and_clear();
    let oracle: Vec<f64> = flown[0].1.iter().map(|s| s[Metric::SettledCost]).collect();
    let rows =
        flown.iter().map(|(controller, scores)| row(*controller, scores, &oracle, &scenario)).collect();
    let bounds = BoundReport {
        scenario: scenario.name.clone(),
        episodes: args.episodes,
        first_seed: args.first_seed,
        constrained: apc.solution().of_start(),
        unconstrained,
        solve_s,
        decision_ms,
        rows,
    };
    if args.json {
        crpl_sitl::outln!("{}", serde_json::to_string(&bounds)?);
    } else {
        crpl_sitl::out!("{}", text(&bounds, columns::width()));
    }
    Ok(())
}

fn fly(
    models: &Models,
    controller: Controller,
    scenario: &Scenario,
    args: &Bound,
    stop: &StopSignal,
    bar: &indicatif::ProgressBar,
) -> Result<Vec<FlightScore>> {
    let contender = Contender::new(models, controller, scenario)?;
    let scores = (args.first_seed..args.first_seed + args.episodes)
        .into_par_iter()
        .filter(|_| stop.get().is_none())
        .map(|seed| {
            bar.inc(1);
            contender.fly(seed)
        })
        .collect::<Result<Vec<_>>>()?;
    match stop.get() {
        Some(signal) => bail!(signal.exit("the flights are discarded")),
        None => Ok(scores),
    }
}

fn row(controller: Controller, scores: &[FlightScore], oracle: &[f64], scenario: &Scenario) -> BoundRow {
    let values = |m: Metric| scores.iter().map(|s| s[m]).collect::<Vec<_>>();
    let (risk, out) = (values(Metric::CollisionProbability), values(Metric::Outages));
    let j_t = values(Metric::SettledCost);
    let more: Vec<f64> = j_t.iter().zip(oracle).map(|(j, best)| j - best).collect();
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let collided =
        scores.iter().filter(|s| s[Metric::Collisions] > 0.0).count() as f64 / scores.len().max(1) as f64;
    let safety = &scenario.safety;
    let keeps = mean(&risk) <= safety.collision_tolerance
        && collided <= safety.collision_tolerance
        && mean(&out) / scenario.horizon as f64 <= safety.outage_tolerance;
    BoundRow {
        controller,
        j: Mean::of(&values(Metric::StageCost)),
        j_t: Mean::of(&j_t),
        more: Mean::of(&more),
        d_f: Mean::of(&values(Metric::TerminalDistance)),
        risk: Mean::of(&risk),
        keeps,
    }
}

/// Median time of a decision along the way from start to goal, ms.
fn decision(apc: &Apc, scenario: &Scenario) -> f64 {
    let obstacles: Obstacles = scenario.obstacles.iter().map(|o| o.position).collect();
    let way = scenario.goal - scenario.start;
    let times: Vec<f64> = (0..100u64)
        .map(|n| {
            let r = scenario.start + way * (n as f64 / 100.0);
            let now = Present { r, v: 0.02 * way, obstacles, link: None };
            let stopwatch = Stopwatch::default();
            std::hint::black_box(apc.decide(Tick(n.min(scenario.horizon)), &now));
            1e3 * stopwatch.seconds().0
        })
        .collect();
    quantile(&times, 0.5)
}

/// Widths of the columns of [`text`].
const COLUMNS: [usize; 7] = [12, 26, 26, 29, 8, 8, 13];

fn text(b: &BoundReport, width: Option<usize>) -> String {
    use std::fmt::Write;
    let ci = |ci: Interval| format!("[{:.4}, {:.4}]", ci[0], ci[1]);
    let words = format!(
        "{}, {} flights a row from seed {}\n\
         no constraint, no loss: J of any controller is at least {:.4} (lattice)\n\
         APC: value of the start with penalties and terminal cost {:.4} (lattice); solved in {:.1} s, {:.3} ms a decision\n",
        b.scenario, b.episodes, b.first_seed, b.unconstrained, b.constrained, b.solve_s, b.decision_ms
    );
    let mut out = String::new();
    let _ = writeln!(
        out,
        "{:<12}{:>8} {:<17}{:>8} {:<17}{:>9} {:<19}{:>8}{:>8}  constraints",
        "controller", "J", "[95 %]", "J_T", "[95 %]", "less APC", "[95 %]", "d_f", "p_coll"
    );
    for row in &b.rows {
        let _ = writeln!(
            out,
            "{:<12}{:>8.4} {:<17}{:>8.4} {:<17}{:>9.4} {:<19}{:>8.4}{:>8.4}  {}",
            row.controller.to_string(),
            row.j.mean,
            ci(row.j.ci),
            row.j_t.mean,
            ci(row.j_t.ci),
            row.more.mean,
            ci(row.more.ci),
            row.d_f.mean,
            row.risk.mean,
            if row.keeps { "kept" } else { "broken" }
        );
    }
    columns::wrapped(&words, 2, width) + &columns::folded(&out, &COLUMNS, width)
}
