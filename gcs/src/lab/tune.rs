//! `gcs tune`: the numbers of RCC and UCC, searched as hard as CRPL's policies are.
//!
//! Aim and constraint are the controller's own: the least mean d_f, of RCC with a mean largest collision
//! probability of at most δ1 (CRPL's constraint), of both without a collision in 1 - δ1 of the flights. Rounds of
//! successive halving: laws drawn at random, then neighbours of the best, each round on fewer laws and more seeds.
//! The flights are those of every table (same vehicle, radio and gusts), without frames, which neither reads.

use std::path::PathBuf;

use anyhow::{Context, Result};
use crpl_model::numeric::statistics::Mean;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::columns;
use crpl_sitl::program::files::write_whole;
use crpl_sitl::program::progress;
use crpl_sitl::program::terminal::StopSignal;
use crpl_sitl::radio::message::Command;
use crpl_sitl::sim::metric::{FlightOutcome, FlightScore, Metric};
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::noise::{Noise, Stream};
use crpl_sitl::{Scenario, Sim};
use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::Serialize;

use crate::station::pilot::laws::{LawFile, Provenance, Tunable};
use crate::station::pilot::reactive::{Law, Present, Reactive, Task};

/// Flags of `gcs tune`.
#[derive(Debug, clap::Args)]
pub struct Tune {
    /// Controller to tune
    #[arg(long, value_enum)]
    controller: Tunable,
    /// Worlds to tune in, TOML files or presets; the aim is the mean over them
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values = ["demo", "lowest-bandwidth", "gusty"])]
    scenario: Vec<String>,
    #[command(flatten)]
    camera: CameraFlag,
    /// First of the consecutive training seeds
    #[arg(long, value_name = "N", default_value_t = FIRST_TRAINING)]
    first_seed: u64,
    /// Laws drawn at random in the first round
    #[arg(long, value_name = "N", default_value_t = 512, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    laws: u64,
    /// Flights of the last round, in each world
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(8..=1_000_000))]
    flights: u64,
    /// Seed of the search
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Folder for CONTROLLER.toml and the table of sensitivity
    #[arg(long, value_name = "DIR", default_value = "runs/tune")]
    out: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// First seed of the flights that laws are tuned on: far from those of every table.
const FIRST_TRAINING: u64 = 5_000_000;

/// A law on one set of flights.
#[derive(Debug, Clone, Serialize)]
struct Tried {
    law: Law,
    /// Mean d_f of each world, over the untuned law's: what the search lowers, averaged.
    aim: f64,
    /// Whether it keeps its controller's constraint in every world.
    holds: bool,
    /// Of each world.
    worlds: Vec<LawInWorld>,
}

/// A law in one world.
#[derive(Debug, Clone, Copy, Serialize)]
struct LawInWorld {
    d_f: Mean,
    risk: Mean,
    t_out: Mean,
    e_comm: Mean,
    j: Mean,
    reached: f64,
    clear: f64,
}

/// One flight of a reactive controller, scored.
fn fly(law: &Law, scenario: &Scenario, seed: u64) -> Option<FlightScore> {
    let mut pilot = Reactive::new(law.clone(), Task::of(scenario));
    let mut sim = Sim::new(scenario.clone(), seed);
    let mut records = Vec::with_capacity(scenario.horizon as usize);
    let mut before = sim.telemetry();
    for _ in 0..scenario.horizon {
        if sim.is_fallen() {
            break;
        }
        let (motion, power) = pilot.decide(&Present::of(&before, &scenario.scale));
        let accel = scenario.scale.ned_from_paper_acceleration(scenario.dynamics.a_max * motion.vector());
        let command = Command::new(before.tick, accel, power);
        sim.handle(command);
        sim.advance();
        let after = sim.telemetry();
        records.push(Record::new(&before, &command, &after, scenario));
        before = after;
    }
    FlightScore::of(&records, scenario)
}

fn measure(law: &Law, scenario: &Scenario, first_seed: u64, flights: u64) -> LawInWorld {
    let scores: Vec<FlightScore> = (first_seed..first_seed + flights)
        .into_par_iter()
        .filter_map(|seed| fly(law, scenario, seed))
        .collect();
    let mean = |m: Metric| Mean::of(&scores.iter().map(|s| s[m]).collect::<Vec<_>>());
    let share = |is: &dyn Fn(&FlightScore) -> bool| {
        scores.iter().filter(|s| is(s)).count() as f64 / scores.len().max(1) as f64
    };
    LawInWorld {
        d_f: mean(Metric::TerminalDistance),
        risk: mean(Metric::CollisionProbability),
        t_out: mean(Metric::Outages),
        e_comm: mean(Metric::TransmitEnergy),
        j: mean(Metric::StageCost),
        reached: share(&|s| s.is(FlightOutcome::Reached)),
        clear: share(&|s| s[Metric::Collisions] == 0.0),
    }
}

/// The worlds, the controller, and what its untuned law reaches.
struct Search {
    controller: Tunable,
    worlds: Vec<Scenario>,
    first_seed: u64,
    stop: StopSignal,
}

impl Search {
    /// Flies `law` in every world; d_f is compared with `base`.
    fn fly(&self, law: &Law, flights: u64, base: Option<&Tried>) -> Tried {
        let worlds: Vec<LawInWorld> =
            self.worlds.iter().map(|world| measure(law, world, self.first_seed, flights)).collect();
        let ratio =
            |(n, world): (usize, &LawInWorld)| world.d_f.mean / base.map_or(1.0, |b| b.worlds[n].d_f.mean);
        let aim = worlds.iter().enumerate().map(ratio).sum::<f64>() / worlds.len().max(1) as f64;
        let holds = worlds.iter().zip(&self.worlds).all(|(world, scenario)| {
            let delta = scenario.safety.collision_tolerance;
            let constrained = self.controller == Tunable::Rcc;
            world.clear >= 1.0 - delta && (!constrained || world.risk.mean <= delta)
        });
        Tried { law: law.clone(), aim, holds, worlds }
    }

    /// The best of `laws` drawn laws and their descendants on `flights` flights in each world, and how many were
    /// tried. Wide and shallow first, then around the best.
    fn best(&self, laws: u64, flights: u64, seed: u64) -> Result<(Tried, u64)> {
        let mut rng = Noise::new(seed).generator(Stream::Worlds, 1 << 40);
        let part = |part: u64| (flights / part).max(8);
        let few = |n: u64| (n as usize).max(4);
        let mut drawn: Vec<Law> = (1..laws).map(|_| draw(self.controller, &mut rng)).collect();
        drawn.push(self.controller.paper());
        let mut tried = drawn.len() as u64;
        let mut best = self.round(&drawn, part(40), few(laws / 16))?;
        for (share, children, keep) in [(20, 6, laws / 32), (8, 5, laws / 64), (4, 4, laws / 128)] {
            let mut next: Vec<Law> = best.iter().map(|t| t.law.clone()).collect();
            for parent in &best {
                next.extend((0..children).map(|_| near(&parent.law, &mut rng)));
            }
            tried += (next.len() - best.len()) as u64;
            best = self.round(&next, part(share), few(keep))?;
        }
        let finalists: Vec<Law> = best.into_iter().map(|t| t.law).collect();
        let last = self.round(&finalists, flights, finalists.len())?;
        Ok((last.into_iter().next().context("no law was tried")?, tried))
    }

    /// The best `keep` of `laws`, those that keep the constraint first.
    fn round(&self, laws: &[Law], flights: u64, keep: usize) -> Result<Vec<Tried>> {
        let base = self.fly(&self.controller.paper(), flights, None);
        let bar = progress::bar("laws", laws.len() as u64);
        let mut tried = Vec::with_capacity(laws.len());
        for law in laws {
            if let Some(signal) = self.stop.get() {
                return Err(signal.exit("the search is discarded").into());
            }
            tried.push(self.fly(law, flights, Some(&base)));
            bar.inc(1);
        }
        bar.finish_and_clear();
        tried.sort_by(|a, b| (!a.holds).cmp(&!b.holds).then(a.aim.total_cmp(&b.aim)));
        tried.truncate(keep);
        Ok(tried)
    }
}

/// The best law for some worlds, found as `gcs tune` finds it.
///
/// # Errors
/// A signal.
pub fn tuned(
    controller: Tunable,
    worlds: Vec<Scenario>,
    laws: u64,
    flights: u64,
    stop: StopSignal,
) -> Result<Law> {
    let search = Search { controller, worlds, first_seed: FIRST_TRAINING, stop };
    Ok(search.best(laws, flights, 0)?.0.law)
}

/// A law drawn from the whole range: gains and margin on logarithmic scales.
fn draw(controller: Tunable, rng: &mut impl Rng) -> Law {
    let mut between = |low: f64, high: f64| (rng.random_range(low.ln()..high.ln())).exp();
    let (position_gain, velocity_gain) = (between(0.01, 0.4), between(0.1, 1.2));
    let margin = (controller == Tunable::Ucc).then(|| between(0.01, 0.08));
    let headroom = between(1.0, 2.5);
    Law {
        position_gain,
        velocity_gain,
        steps: rng.random_range(2..=24),
        margin,
        raise_after: rng.random_range(1..=4),
        lower_after: rng.random_range(1..=16),
        headroom,
    }
    .rounded()
}

/// A law near another.
fn near(law: &Law, rng: &mut impl Rng) -> Law {
    let mut by = |x: f64| x * rng.random_range(-0.25..0.25f64).exp();
    let mut next = Law {
        position_gain: by(law.position_gain),
        velocity_gain: by(law.velocity_gain),
        margin: law.margin.map(&mut by),
        headroom: by(law.headroom).max(1.0),
        ..law.clone()
    };
    let mut shift =
        |n: u32, by: i64, least: i64| (i64::from(n) + rng.random_range(-by..=by)).max(least) as u32;
    next.steps = shift(law.steps, 2, 1);
    next.raise_after = shift(law.raise_after, 1, 1);
    next.lower_after = shift(law.lower_after, 2, 1);
    next.rounded()
}

/// Runs the subcommand.
///
/// # Errors
/// A world that does not read, a file that cannot be written, a signal.
pub fn run(args: &Tune) -> Result<()> {
    let worlds = args.scenario.iter().map(|name| args.camera.scenario(name)).collect::<Result<_>>()?;
    let search = Search {
        controller: args.controller,
        worlds,
        first_seed: args.first_seed,
        stop: StopSignal::listen()?,
    };
    let (winner, tried) = search.best(args.laws, args.flights, args.seed)?;
    let winner = &winner;
    let paper = search.fly(&args.controller.paper(), args.flights, None);
    let file = LawFile {
        controller: args.controller,
        law: winner.law.clone(),
        found: Provenance {
            command: std::env::args().collect::<Vec<_>>().join(" "),
            revision: crate::revision().into(),
            scenarios: args.scenario.clone(),
            first_seed: args.first_seed,
            flights: args.flights,
            tried,
            d_f: mean_d_f(winner),
            d_f_paper: mean_d_f(&paper),
        },
    };
    std::fs::create_dir_all(&args.out).with_context(|| format!("creating {}", args.out.display()))?;
    let path = args.out.join(format!("{}.toml", args.controller.name()));
    write_whole(&path, toml::to_string(&file)?.as_bytes())
        .with_context(|| format!("writing {}", path.display()))?;
    let around = sensitivity(&search, winner, args.flights.min(400));
    let table = table(&args.scenario, &paper, winner, &around);
    let path_table = args.out.join(format!("{}.txt", args.controller.name()));
    write_whole(&path_table, table.as_bytes())
        .with_context(|| format!("writing {}", path_table.display()))?;
    if args.json {
        crpl_sitl::outln!("{}", serde_json::json!({"law": file, "paper": paper, "tuned": winner}));
    } else {
        crpl_sitl::out!("{}", columns::folded(&table, &COLUMNS, columns::width()));
        crpl_sitl::outln!("{} laws tried; {}", file.found.tried, path.display());
    }
    Ok(())
}

fn mean_d_f(tried: &Tried) -> f64 {
    tried.worlds.iter().map(|w| w.d_f.mean).sum::<f64>() / tried.worlds.len().max(1) as f64
}

/// The tuned law with one number changed at a time.
fn sensitivity(search: &Search, winner: &Tried, flights: u64) -> Vec<(String, Tried)> {
    let base = &winner.law;
    let mut around: Vec<(String, Law)> = vec![("as tuned".into(), base.clone())];
    for by in [0.5, 0.8, 1.25, 2.0] {
        let scaled = |x: f64| x * by;
        around.push((
            format!("position_gain x {by}"),
            Law { position_gain: scaled(base.position_gain), ..base.clone() },
        ));
        around.push((
            format!("velocity_gain x {by}"),
            Law { velocity_gain: scaled(base.velocity_gain), ..base.clone() },
        ));
        if let Some(margin) = base.margin {
            around.push((format!("margin x {by}"), Law { margin: Some(scaled(margin)), ..base.clone() }));
        }
    }
    for steps in [4, 8, 12, 16, 24] {
        around.push((format!("steps {steps}"), Law { steps, ..base.clone() }));
    }
    for raise_after in [1, 2, 3] {
        around.push((format!("raise_after {raise_after}"), Law { raise_after, ..base.clone() }));
    }
    for lower_after in [2, 8, 16] {
        around.push((format!("lower_after {lower_after}"), Law { lower_after, ..base.clone() }));
    }
    around.into_iter().map(|(name, law)| (name, search.fly(&law, flights, None))).collect()
}

/// Widths of the columns of [`table`].
const COLUMNS: [usize; 9] = [22, 18, 25, 8, 7, 7, 8, 8, 6];

/// Untuned, tuned, and what each number does, world by world.
fn table(worlds: &[String], paper: &Tried, winner: &Tried, around: &[(String, Tried)]) -> String {
    use std::fmt::Write;
    let mut out = String::new();
    let mut row = |name: &str, tried: &Tried| {
        for (world, m) in worlds.iter().zip(&tried.worlds) {
            let _ = writeln!(
                out,
                "{name:<22}{world:<18}{:>8.4} [{:.4}, {:.4}]{:>8.4}{:>7.2}{:>7.1}{:>8.4}{:>8.3}{:>6}",
                m.d_f.mean,
                m.d_f.ci[0],
                m.d_f.ci[1],
                m.risk.mean,
                m.t_out.mean,
                m.e_comm.mean,
                m.j.mean,
                m.reached,
                if tried.holds { "yes" } else { "no" }
            );
        }
    };
    row("paper", paper);
    row("tuned", winner);
    around.iter().for_each(|(name, tried)| row(name, tried));
    let head = format!(
        "{:<22}{:<18}{:>8} {:<16}{:>8}{:>7}{:>7}{:>8}{:>8}{:>6}\n",
        "law", "world", "d_f", "[95 %]", "p_coll", "T_out", "E_comm", "J", "reached", "holds"
    );
    head + &out
}
