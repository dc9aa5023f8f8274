//! `gcs sensitivity`: the paper's claims over the values that it omits.
//!
//! Each world is Scenario 2 with other omitted values, inside the ranges of `OMITTED`: one at a time at the ends of
//! its range, then joint draws. In each, Algorithm 1 makes CRPL's policies anew and RCC and UCC are tuned anew, all
//! for the world's lowest bandwidth; then they fly Fig. 6's and Fig. 7's hardest points. What comes out is how often
//! each claim gets each verdict.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::{self, File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use crpl_model::planning::config::OptimiseConfig;
use crpl_sitl::Scenario;
use crpl_sitl::program::columns;
use crpl_sitl::program::progress;
use crpl_sitl::program::shard::Shard;
use crpl_sitl::program::terminal::StopSignal;
use crpl_sitl::units::noise::{Noise, Stream};
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::lab::Contender;
use crate::lab::attempts::{Begun, Quiet, optimise_for};
use crate::lab::report::claims;
use crate::lab::report::rows::VerdictRow;
use crate::lab::report::verdict::Verdict;
use crate::lab::sweep::axis::SweepPoint;
use crate::lab::sweep::episode::SweepEpisode;
use crate::lab::sweep::plan::{Overrides, SweepFile, SweepModels, SweepPlan};
use crate::lab::tune::tuned;
use crate::station::models::Models;
use crate::station::pilot::Controller;
use crate::station::pilot::laws::Tunable;

/// Flags of `gcs sensitivity`.
#[derive(Debug, clap::Args)]
pub struct Sensitivity {
    /// Worlds in which all omitted values are drawn together, beside the 26 in which one is at an end of its range
    #[arg(long, value_name = "N", default_value_t = 200)]
    draws: u64,
    /// Seed of the draws
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Flights per controller and point
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(2..))]
    episodes: u64,
    /// Laws of RCC and of UCC that are drawn in each world, to tune them
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = clap::value_parser!(u64).range(4..))]
    laws: u64,
    /// Parameters of Algorithm 1 that differ from the defaults (TOML)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Only every Nth world, from the Ith on: I/N
    #[arg(long, value_name = "I/N", default_value_t = Shard::WHOLE)]
    shard: Shard,
    /// Folder of the results; worlds that are there are not flown again
    #[arg(long, value_name = "DIR", default_value = "runs/sensitivity")]
    out: PathBuf,
    /// Fly nothing: the table of what the folder holds
    #[arg(long)]
    table: bool,
}

/// First seed of its flights.
const FIRST_SEED: u64 = 700_000;

/// What a world is made of: CRPL's and the simulator's.
#[derive(Debug, Clone)]
struct Recipe {
    scenario: Scenario,
    config: OptimiseConfig,
    lowest_b_dt: f64,
}

/// A value that the paper omits.
struct Omitted {
    key: &'static str,
    range: [f64; 2],
    set: fn(&mut Recipe, f64),
}

/// All of them, with the ranges in which the paper's text still makes sense (docs/choices.md).
const OMITTED: [Omitted; 13] = [
    Omitted { key: "channel.noise_power", range: [0.8, 1.2], set: |w, x| w.scenario.channel.noise_power = x },
    Omitted {
        key: "obstacle.radius",
        range: [0.08, 0.12],
        set: |w, x| w.scenario.obstacles.iter_mut().for_each(|o| o.radius = x),
    },
    Omitted { key: "uav_radius", range: [0.01, 0.03], set: |w, x| w.scenario.uav_radius = x },
    Omitted {
        key: "channel.blockage_softness",
        range: [0.01, 0.03],
        set: |w, x| w.scenario.channel.blockage_softness = x,
    },
    Omitted { key: "safety.softness", range: [0.01, 0.03], set: |w, x| w.scenario.safety.softness = x },
    Omitted {
        key: "disturbance.gust_scale",
        range: [0.15, 0.4],
        set: |w, x| w.scenario.disturbance.gust_scale = x,
    },
    Omitted { key: "lowest radio.b_dt", range: [2.45, 2.75], set: |w, x| w.lowest_b_dt = x },
    Omitted { key: "cost.goal", range: [0.02, 0.12], set: |w, x| w.scenario.cost.goal = x },
    Omitted { key: "cost.motion", range: [3e-5, 3e-4], set: |w, x| w.scenario.cost.motion = x },
    Omitted { key: "cost.power", range: [3e-6, 3e-5], set: |w, x| w.scenario.cost.power = x },
    Omitted { key: "alpha", range: [2.0, 5.0], set: |w, x| w.config.objective.alpha = x },
    Omitted { key: "beta", range: [200.0, 1000.0], set: |w, x| w.config.objective.beta = x },
    // K comes in blocks of 32.
    Omitted {
        key: "rollouts",
        range: [32.0, 128.0],
        set: |w, x| w.config.rollouts = 32 * (x / 32.0).round() as usize,
    },
];

/// One world and what came out in it: a line of the journal.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Outcome {
    /// Number of the world.
    world: u64,
    /// What distinguishes it, or `joint`.
    what: String,
    /// The omitted values that differ from ours.
    values: BTreeMap<String, f64>,
    /// Why CRPL has no policy there; empty if it has one.
    refused: String,
    /// Claim and verdict.
    verdicts: Vec<(String, String)>,
}

/// The values of world `n`; `None` beyond the last.
fn world(n: u64, draws: u64, seed: u64) -> Option<(String, Vec<(usize, f64)>)> {
    let ends = 2 * OMITTED.len() as u64;
    if n < ends {
        let omitted = (n / 2) as usize;
        let end = OMITTED[omitted].range[(n % 2) as usize];
        return Some((format!("{} = {end}", OMITTED[omitted].key), vec![(omitted, end)]));
    }
    (n < ends + draws).then(|| {
        let mut rng = Noise::new(seed).generator(Stream::Worlds, n);
        let values = OMITTED.iter().enumerate().map(|(i, o)| {
            let x = rng.random_range(o.range[0].ln()..o.range[1].ln()).exp();
            (i, format!("{x:.3e}").parse().unwrap_or(x))
        });
        ("joint".into(), values.collect())
    })
}

/// Runs the subcommand.
///
/// # Errors
/// A file that cannot be read or written, a signal.
pub fn run(args: &Sensitivity) -> Result<()> {
    fs::create_dir_all(&args.out).with_context(|| format!("creating {}", args.out.display()))?;
    let mut done = read(&args.out)?;
    if !args.table {
        fly(args, &mut done)?;
    }
    let text = table(&done);
    let path = args.out.join("table.txt");
    fs::write(&path, &text).with_context(|| format!("writing {}", path.display()))?;
    let (words, rows) = text.split_once('\n').unwrap_or_default();
    let width = columns::width();
    crpl_sitl::out!("{}{}", columns::wrapped(words, 2, width), columns::folded(rows, &COLUMNS, width));
    Ok(())
}

/// Flies what is missing of this shard and writes each world down.
fn fly(args: &Sensitivity, done: &mut Vec<Outcome>) -> Result<()> {
    let config = match &args.config {
        Some(path) => {
            let reading = || format!("reading {}", path.display());
            toml::from_str(&fs::read_to_string(path).with_context(reading)?).with_context(reading)?
        }
        None => OptimiseConfig { attempts: 2, check_flights: 300, ..OptimiseConfig::default() },
    };
    let models = Models::load(None, None)?;
    let stop = StopSignal::listen()?;
    let path = args.out.join(format!("worlds-{}-of-{}.jsonl", args.shard.number, args.shard.of));
    let opening = || format!("opening {}", path.display());
    let mut file: File = OpenOptions::new().create(true).append(true).open(&path).with_context(opening)?;
    let all = 2 * OMITTED.len() as u64 + args.draws;
    let mine: Vec<u64> =
        (0..all).filter(|n| args.shard.has(*n) && done.iter().all(|o| o.world != *n)).collect();
    let bar = progress::bar("worlds", mine.len() as u64);
    for n in mine {
        let Some((what, values)) = world(n, args.draws, args.seed) else { continue };
        let outcome = one(args, &models, &config, (n, what, &values), &stop)?;
        let line = serde_json::to_string(&outcome)? + "\n";
        file.write_all(line.as_bytes()).with_context(|| format!("writing {}", path.display()))?;
        done.push(outcome);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}

/// One world: policies, laws, flights, verdicts.
fn one(
    args: &Sensitivity,
    models: &Models,
    config: &OptimiseConfig,
    (n, what, values): (u64, String, &[(usize, f64)]),
    stop: &StopSignal,
) -> Result<Outcome> {
    let mut recipe =
        Recipe { scenario: Scenario::default(), config: config.clone(), lowest_b_dt: LOWEST_B_DT };
    values.iter().for_each(|(i, x)| (OMITTED[*i].set)(&mut recipe, *x));
    let Recipe { mut scenario, config, lowest_b_dt } = recipe;
    scenario.name = what.clone();
    scenario.radio.b_dt = lowest_b_dt;
    let mut outcome = Outcome {
        world: n,
        what,
        values: values.iter().map(|(i, x)| (OMITTED[*i].key.to_owned(), *x)).collect(),
        refused: String::new(),
        verdicts: Vec::new(),
    };
    scenario.disturbance.sigma_c = STUDIES[0].2;
    if let Err(error) = scenario.check() {
        outcome.refused = error.to_string();
        return Ok(outcome);
    }
    let made = optimise_for(&models.world, &scenario, &config, 1, Begun::default(), &mut Quiet)?;
    if let Some(signal) = stop.get() {
        bail!(signal.exit("the worlds so far are kept; the same command goes on"));
    }
    if let Err(refused) = made.flown.verdict() {
        outcome.refused = refused.to_string();
        return Ok(outcome);
    }
    let mut gusty = scenario.clone();
    gusty.disturbance.sigma_c = STUDIES[1].2;
    let mut models = models.clone();
    for controller in [Tunable::Rcc, Tunable::Ucc] {
        let worlds = vec![scenario.clone(), gusty.clone()];
        let law = tuned(controller, worlds, args.laws, 200, StopSignal::listen()?)?;
        models.laws.set(controller, law);
    }
    for (name, x, sigma_c) in STUDIES {
        let mut here = scenario.clone();
        here.disturbance.sigma_c = sigma_c;
        let contenders = [
            Contender::with_policies(&models.world, &Arc::new(made.policies.clone()), &here),
            Contender::new(&models, Controller::Rcc, &here)?,
            Contender::new(&models, Controller::Ucc, &here)?,
        ];
        let seeds = FIRST_SEED..FIRST_SEED + args.episodes;
        let mut episodes = Vec::new();
        for contender in &contenders {
            let flown: Result<Vec<SweepEpisode>> = seeds
                .clone()
                .into_par_iter()
                .map(|seed| SweepEpisode::fly(contender, SweepPoint::on(x), seed))
                .collect();
            episodes.extend(flown?);
        }
        let plan = plan(name, x, args.episodes)?;
        for (claim, quantity) in claims::of_sweep(name).filter(|(_, q)| !q.points().is_empty()) {
            let ours = quantity.measure(claim.who, &plan, &episodes);
            let row = VerdictRow::of_sweep(name, &claim, quantity, ours);
            if let Some(verdict) = row.verdict() {
                outcome
                    .verdicts
                    .push((format!("{} (paper {})", row.quantity, row.paper), verdict.words().into()));
            }
        }
    }
    Ok(outcome)
}

/// The lowest B Δt where it is not the omitted value that changes.
const LOWEST_B_DT: f64 = 2.5;

/// Sweeps of the paper, their hardest points, and σ_c there.
const STUDIES: [(&str, f64, f64); 2] = [("bandwidth", 2.5, 0.005), ("sigma", 0.01, 0.01)];

/// A plan of one point.
fn plan(name: &str, x: f64, episodes: u64) -> Result<SweepPlan> {
    let text = format!(
        "name = \"{name}\"\naxis = \"radio.b_dt\"\npoints = [{x}]\ncontrollers = [\"crpl\", \"rcc\", \"ucc\"]\n\
         episodes = {episodes}\nfirst_seed = {FIRST_SEED}\n"
    );
    SweepFile::parse(&text)?.resolve(&Overrides::default(), |_| Ok(SweepModels::default()))
}

/// All worlds of the journals in a folder.
fn read(dir: &Path) -> Result<Vec<Outcome>> {
    let mut all: Vec<Outcome> = Vec::new();
    let mut paths: Vec<PathBuf> = fs::read_dir(dir)
        .with_context(|| format!("reading {}", dir.display()))?
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.extension().is_some_and(|ending| ending == "jsonl"))
        .collect();
    paths.sort();
    for path in paths {
        let text = fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
        // A run that was killed leaves half a line at the end, which is flown again.
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        for (n, line) in whole.lines().enumerate() {
            let at = || format!("{}, line {}", path.display(), n + 1);
            let outcome: Outcome = serde_json::from_str(line).with_context(at)?;
            if all.iter().all(|o| o.world != outcome.world) {
                all.push(outcome);
            }
        }
    }
    all.sort_by_key(|o| o.world);
    Ok(all)
}

/// Widths of the columns of [`table`].
const COLUMNS: [usize; 1 + Verdict::ALL.len()] = {
    let mut room = [13; 1 + Verdict::ALL.len()];
    room[0] = 58;
    room
};

/// How often each claim came out how.
fn table(done: &[Outcome]) -> String {
    let mut claims: Vec<(&str, [usize; Verdict::ALL.len()])> = Vec::new();
    for (claim, verdict) in done.iter().flat_map(|o| &o.verdicts) {
        let row = match claims.iter().position(|(name, _)| name == claim) {
            Some(at) => &mut claims[at],
            None => {
                claims.push((claim, [0; Verdict::ALL.len()]));
                let last = claims.len() - 1;
                &mut claims[last]
            }
        };
        if let Some(at) = Verdict::ALL.iter().position(|v| v.words() == verdict) {
            row.1[at] += 1;
        }
    }
    let refused = done.iter().filter(|o| !o.refused.is_empty()).count();
    let joint = done.iter().filter(|o| o.what == "joint").count();
    let mut out = format!(
        "{} worlds: {} with one omitted value at an end of its range, {joint} joint draws; in {refused} of them no \
         policy passes its check\n",
        done.len(),
        done.len() - joint
    );
    let _ = write!(out, "{:<58}", "claim");
    Verdict::ALL.iter().for_each(|v| {
        let _ = write!(out, "{:>13}", v.short());
    });
    out.push('\n');
    for (claim, counts) in claims {
        let _ = write!(out, "{claim:<58}");
        counts.iter().for_each(|n| {
            let _ = write!(out, "{n:>13}");
        });
        out.push('\n');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_omitted_value_has_a_world_at_each_end_and_draws_lie_between() {
        for n in 0..2 * OMITTED.len() as u64 {
            let (what, values) = world(n, 3, 0).unwrap();
            assert!(what.starts_with(OMITTED[(n / 2) as usize].key) && values.len() == 1, "{what}");
        }
        let first = 2 * OMITTED.len() as u64;
        for n in first..first + 3 {
            let (_, values) = world(n, 3, 0).unwrap();
            assert!(values.iter().all(|(i, x)| (OMITTED[*i].range[0]..=OMITTED[*i].range[1]).contains(x)));
            assert_eq!(values.len(), OMITTED.len());
        }
        assert!(world(first + 3, 3, 0).is_none());
    }

    #[test]
    fn verdicts_are_counted_and_worlds_without_a_policy_told() {
        let outcome = |world, refused: &str, verdicts: &[(&str, Verdict)]| Outcome {
            world,
            what: "joint".into(),
            values: BTreeMap::new(),
            refused: refused.into(),
            verdicts: verdicts.iter().map(|(c, v)| ((*c).to_owned(), v.words().to_owned())).collect(),
        };
        let text = table(&[
            outcome(0, "", &[("a", Verdict::Agrees), ("b", Verdict::Contradicts)]),
            outcome(1, "", &[("a", Verdict::Agrees), ("b", Verdict::Weaker)]),
            outcome(2, "no", &[]),
        ]);
        assert!(
            text.starts_with("3 worlds: 0 with one") && text.contains("in 1 of them no policy"),
            "{text}"
        );
        let row = |name: &str| text.lines().find(|l| l.starts_with(name)).unwrap().split_whitespace().skip(1);
        assert_eq!(row("a ").collect::<Vec<_>>(), ["2", "0", "0", "0", "0"]);
        assert_eq!(row("b ").collect::<Vec<_>>(), ["0", "0", "1", "0", "1"]);
    }
}
