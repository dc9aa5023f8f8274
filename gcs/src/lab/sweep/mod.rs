//! Sweeps: the paper's Figs. 6 and 7, and any other key of a scenario against the five metrics.
//!
//! ```text
//! configs/sweep_*.toml --> SweepPlan --> (point, controller, seed) --> SweepEpisode --> journal --> Folder --> table
//! ```
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`axis`] | one key or two, with their values | flying |
//! | [`plan`] | what is flown, resolved, with a hash; its shards | flying |
//! | [`episode`] | one flight as a line of a table | other flights |
//! | [`journal`] | finished episodes, safe against any end of the process | what they mean |
//! | [`folder`] | files of a sweep, begun or finished | flying |
//! | [`table`] | means, intervals, ratios | files |
//! | [`figure`] | curves of a metric, a family of them where there are two axes | files of a sweep |
//! | [`merge`] | shards to one sweep | flying |
//!
//! A unit of work is a point, a controller and a seed; its result depends on the plan and on these alone, so
//! neither threads, nor shards, nor interruptions change a byte.

pub mod axis;
pub mod episode;
pub mod figure;
pub mod folder;
pub mod journal;
pub mod merge;
pub mod plan;
pub mod table;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use crpl_model::world_model::checkpoint;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::files::fingerprint;
use crpl_sitl::program::shard::Shard;
use crpl_sitl::program::terminal::{self, Signal, StopSignal};
use crpl_sitl::program::{columns, progress};
use rayon::prelude::*;

use crate::lab::{Contender, policies};
use crate::station::models::{MismatchRule, ModelFiles, Models, PolicyUse};
use crate::station::pilot::own::AnswerTally;
use crate::station::pilot::{Controller, ControllerParser};
use crate::watch::feed::{Feed, WatchEvent};
use crate::watch::{WatchFlags, WatchPage};
use axis::{SweepAxis, SweepPoint};
use episode::SweepEpisode;
use folder::{Folder, Progress};
use journal::Journal;
use plan::{Overrides, SweepFile, SweepModels, SweepPlan, SweepPolicies, UncoveredPoint};
use table::TableRow;

/// Flags of `gcs sweep`.
#[derive(Debug, clap::Args)]
pub struct Sweep {
    /// Sweep file (TOML): name, axis, points, [second], controllers, episodes, first_seed, [scenario]
    #[arg(long, value_name = "FILE", required_unless_present = "axis")]
    config: Option<PathBuf>,
    /// A key of the scenario and its values, a list or FROM:TO:COUNT, such as goal[1]=0.3,0.5 or radio.b_dt=2.5:5:6; twice: each value of one meets each of the other
    #[arg(long, value_name = "KEY=VALUES", conflicts_with = "points")]
    axis: Vec<SweepAxis>,
    /// Without a file, the scenario: TOML file or preset [default: demo]
    #[arg(long, value_name = "FILE|NAME", conflicts_with = "config")]
    scenario: Option<String>,
    #[command(flatten)]
    camera: CameraFlag,
    /// Override the file's points
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    points: Option<Vec<f64>>,
    /// Override the file's number of flights per point and controller
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    episodes: Option<u64>,
    /// Override the file's first seed
    #[arg(long, value_name = "N")]
    first_seed: Option<u64>,
    /// Override the file's controllers
    #[arg(long, value_parser = ControllerParser, value_name = "LIST", value_delimiter = ',')]
    controller: Option<Vec<Controller>>,
    /// Fly only shard I of N, every Nth seed; `gcs merge` joins the shards
    #[arg(long, value_name = "I/N", default_value = "1/1")]
    shard: Shard,
    /// Number of threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    #[command(flatten)]
    models: ModelFiles,
    /// Folder of the results; an interrupted sweep resumes there [default: runs/NAME]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    watch: WatchFlags,
    /// Print one JSON line per point and controller
    #[arg(long)]
    json: bool,
}

/// Runs `gcs sweep`.
///
/// # Errors
/// A sweep file or model that does not read, a point without policies, a folder of another sweep, a signal.
pub fn run(args: &Sweep) -> Result<()> {
    if let Some(threads) = args.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into());
        pool.build_global().context("starting the threads")?;
    }
    let mut models = args.models.load()?;
    let flags = Overrides {
        points: args.points.clone(),
        axes: args.axis.clone(),
        episodes: args.episodes,
        first_seed: args.first_seed,
        controllers: args.controller.clone(),
        camera: args.camera.clone(),
        ..overrides(&args.models)
    };
    anyhow::ensure!(args.axis.len() <= 2, "--axis: a sweep has one axis or two, not {}", args.axis.len());
    let file = match &args.config {
        Some(config) => SweepFile::load(config)?,
        None => SweepFile::over(&args.axis, args.scenario.as_deref().unwrap_or("demo"))?,
    };
    let plan = resolve(file, &flags, &mut models)?;
    let dir = args.out.clone().unwrap_or_else(|| default_folder(&plan.name, args.shard));
    let folder = Folder::begin(&dir, plan, args.shard)?;
    let page = args.watch.open()?;
    if let Some(page) = &page {
        let scenario = serde_json::to_value(&folder.plan.scenario).ok();
        let hello = WatchEvent::computation("gcs sweep", crate::revision(), &folder.plan.name, scenario);
        page.feed().send(&hello);
    }
    let episodes = complete_shown(&folder, &models, page.as_ref().map(WatchPage::feed))?;
    show(&folder, &episodes, args.json)?;
    if let Some(page) = page {
        table::rows(&folder.plan, &episodes).iter().for_each(|row| row.tell(page.feed()));
        terminal::block_on(async {
            page.close("over", serde_json::Value::Null).await;
            Ok(())
        })?;
    }
    Ok(())
}

/// What the flags of the trained models say of a sweep's policies.
#[must_use]
pub fn overrides(files: &ModelFiles) -> Overrides {
    let policies = match (files.optimise, files.policy_mismatch) {
        (true, _) => Some(SweepPolicies::Optimised),
        (_, MismatchRule::Allow) => Some(SweepPolicies::Fixed),
        _ => None,
    };
    Overrides { policies, ..Overrides::default() }
}

/// The plan of a file, with the trained things that will fly it; `models` will know the policies of all
/// points.
///
/// # Errors
/// As [`SweepFile::resolve`]; a point without policies.
pub fn resolve(file: SweepFile, flags: &Overrides, models: &mut Models) -> Result<SweepPlan> {
    file.resolve(flags, |plan| {
        if plan.policies == SweepPolicies::Fixed {
            models.mismatch = MismatchRule::Allow;
        }
        let fly_policies = plan.controllers.iter().any(|c| c.flies_policies());
        let begin_with_them = plan.controllers.contains(&Controller::CrplRh);
        let (mut all, mut uncovered) = (String::new(), Vec::new());
        for point in plan.grid().into_iter().filter(|_| fly_policies || begin_with_them) {
            let scenario = plan.scenario_at(point)?;
            let at = || plan.at(point);
            let optimise = plan.policies == SweepPolicies::Optimised;
            policies::cover(models, &plan.controllers, &scenario, optimise).with_context(at)?;
            let origin = models.policies(&scenario, PolicyUse::Begin).with_context(at)?.origin;
            all += &origin.fingerprint;
            if let Some(mismatch) = origin.mismatch().filter(|_| fly_policies) {
                let SweepPoint { x, y } = point;
                uncovered.push(UncoveredPoint { x, y, policy: origin.source, mismatch });
            }
        }
        for own in plan.controllers.iter().filter_map(|c| c.own()) {
            all += &own.fingerprint();
        }
        let policy = fingerprint(all.as_bytes());
        Ok(SweepModels { world_model: checkpoint::fingerprint(&models.world)?, policy, uncovered })
    })
}

fn default_folder(name: &str, shard: Shard) -> PathBuf {
    let folder = Path::new("runs").join(name);
    if shard == Shard::WHOLE { folder } else { folder.join(format!("{}-of-{}", shard.number, shard.of)) }
}

/// Flies what is missing, writes the results, and gives all episodes in order.
///
/// # Errors
/// A flight without an interval, a file that cannot be written, a signal.
pub fn complete(folder: &Folder, models: &Models) -> Result<Vec<SweepEpisode>> {
    complete_shown(folder, models, None)
}

/// The same, with how far it is for who watches.
fn complete_shown(folder: &Folder, models: &Models, feed: Option<&Feed>) -> Result<Vec<SweepEpisode>> {
    let (journal, mut episodes) = match folder.progress()? {
        Progress::Finished(episodes) => return Ok(episodes),
        Progress::Begun(journal, episodes) => (journal, episodes),
    };
    let stop = StopSignal::listen()?;
    let flown = fly(folder, models, &episodes, &journal, &stop, feed)?;
    episodes.extend(flown);
    let episodes = folder.finish(episodes)?;
    journal.remove()?;
    Ok(episodes)
}

/// Flies every unit that is not in `done`, on all threads, and writes each down as it ends.
fn fly(
    folder: &Folder,
    models: &Models,
    done: &[SweepEpisode],
    journal: &Journal,
    stop: &StopSignal,
    feed: Option<&Feed>,
) -> Result<Vec<SweepEpisode>> {
    let plan = &folder.plan;
    let (grid, mut contenders) = (plan.grid(), Vec::new());
    let total = grid.len() * plan.controllers.len() * plan.seeds_of(folder.shard).count();
    let tell = |done: u64, text: String| {
        if let Some(feed) = feed {
            feed.send(&WatchEvent::Progress { done, total: total as u64, text });
        }
    };
    // A controller may compute for long before its first flight.
    tell(done.len() as u64, "making the controllers".into());
    for point in grid {
        let scenario = plan.scenario_at(point)?;
        for controller in &plan.controllers {
            contenders.push((point, Contender::new(models, *controller, &scenario)?));
        }
    }
    // Seeds outside: slow and quick controllers alternate, so the time left can be told from the first.
    let mut units: Vec<(&(SweepPoint, Contender), u64)> = plan
        .seeds_of(folder.shard)
        .flat_map(|seed| contenders.iter().map(move |contender| (contender, seed)))
        .collect();
    let is_done: std::collections::HashSet<_> =
        done.iter().map(|e| (e.point.bits(), e.controller, e.seed)).collect();
    units
        .retain(|((point, contender), seed)| !is_done.contains(&(point.bits(), contender.controller, *seed)));

    let bar = progress::bar(plan.name.clone(), total as u64);
    bar.inc((total - units.len()) as u64);
    bar.reset_eta();
    let flown: Result<Vec<Option<SweepEpisode>>> = units
        .into_par_iter()
        .with_max_len(1)
        .map(|((point, contender), seed)| {
            if stop.get().is_some() {
                return Ok(None);
            }
            let episode = SweepEpisode::fly(contender, *point, seed)?;
            journal.add(&episode)?;
            bar.inc(1);
            tell(bar.position(), format!("{} at {}", contender.controller, plan.at(*point)));
            Ok(Some(episode))
        })
        .collect();
    bar.finish_and_clear();
    for (point, contender) in &contenders {
        if let Some(told) = contender.answers().as_ref().and_then(AnswerTally::told) {
            tracing::warn!("{}, {}: {told}", plan.at(*point), contender.controller);
        }
    }
    let flown: Vec<SweepEpisode> = flown?.into_iter().flatten().collect();
    let all = done.len() + flown.len();
    if all < total {
        let kept = folder.dir().display();
        let what = format!("{all} of {total} episodes are kept in {kept}; the same command resumes");
        return Err(stop.get().unwrap_or(Signal::Interrupt).exit(&what).into());
    }
    Ok(flown)
}

/// Prints the rows, for people or programs.
///
/// # Errors
/// A row has no JSON form.
pub fn show(folder: &Folder, episodes: &[SweepEpisode], json: bool) -> Result<()> {
    let rows: Vec<TableRow> = table::rows(&folder.plan, episodes);
    if json {
        for row in &rows {
            crpl_sitl::outln!("{}", serde_json::to_string(row)?);
        }
    } else {
        crpl_sitl::out!("{}", table::text(&folder.plan, &rows, columns::width()));
        let figure = folder.plan.second.as_ref().map_or("", |_| "the figure, ");
        crpl_sitl::outln!(
            "\n{figure}episodes.csv, episodes.parquet, points.csv and sweep.toml in {}",
            folder.dir().display()
        );
    }
    Ok(())
}
