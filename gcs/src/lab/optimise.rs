//! `gcs optimise`: Algorithm 1 on a trained world model, shown as it runs, resumable.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use crpl_model::planning::algorithm1::{
    self, Comparison, OptimiseOutcome, OptimiseProgress, OptimiseWatch, PassingSide,
};
use crpl_model::planning::config::{Attempt, OptimiseConfig, OptimiseError};
use crpl_model::planning::plant::{ObjectiveEstimate, RolloutLimits};
use crpl_model::planning::policy::Policies;
use crpl_model::world_model::{StationHeads, WorldModel};
use crpl_sitl::Scenario;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::columns;
use crpl_sitl::program::files::write_whole;
use crpl_sitl::program::progress;
use crpl_sitl::program::shard::Shard;
use crpl_sitl::program::terminal::StopSignal;
use crpl_sitl::scenario::presets;
use indicatif::ProgressBar;
use serde::{Deserialize, Serialize};

use crate::lab::attempts::{AttemptWatch, Begun, Optimised, Quiet, optimise_for};
use crate::lab::check::{ConstraintCheck, one_obstacle};
use crate::lab::random::{self, RandomPlan};
use crate::station::models::Models;

/// Flags of `gcs optimise`.
#[derive(Debug, clap::Args)]
#[command(after_help = presets::table())]
pub struct Optimise {
    /// Scenario: TOML file or preset
    #[arg(long, value_name = "FILE|NAME", default_value = "demo")]
    scenario: String,
    #[command(flatten)]
    camera: CameraFlag,
    /// Parameters of Algorithm 1 that differ from the defaults (TOML)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Seed of weights, rollouts and starts
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// World model: a folder, or `learned` or `centroid`, which are built in [default: learned]
    #[arg(long, value_name = "DIR")]
    checkpoint: Option<PathBuf>,
    /// Folder for the policies [default: runs/policy], or with --random for the table of worlds [default: none]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Resume an interrupted run
    #[arg(long)]
    resume: bool,
    /// Optimise once with each limit of the rollout (plain, clip, walls), print the results and write nothing
    #[arg(long, conflicts_with = "resume")]
    compare_limits: bool,
    /// Optimise for N random scenarios instead, drawn by --seed, and print how many of the solvable ones are solved;
    /// writes no policies. Start, goal and base station lie in 0.08 to 0.92, the obstacle in 0.25 to 0.75 with a radius
    /// of 0.05 to 0.15, B dt in 2.5 to 6
    #[arg(long, value_name = "N", conflicts_with_all = ["scenario", "resume", "compare_limits"])]
    random: Option<u64>,
    /// With --random, only shard I of N, every Nth world; `gcs merge` joins the shards' --out
    #[arg(long, value_name = "I/N", default_value = "1/1", requires = "random")]
    shard: Shard,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Progress on disk, with all that decides where it leads.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Saved {
    seed: u64,
    world: String,
    scenario: Scenario,
    config: OptimiseConfig,
    /// The attempt under way.
    attempt: Attempt,
    progress: Option<OptimiseProgress>,
}

/// What stands beside the policies.
#[derive(Debug, Serialize)]
pub struct PolicyManifest<'a> {
    scenario: &'a Scenario,
    seed: u64,
    revision: &'static str,
    config: &'a OptimiseConfig,
    /// Attempts that it took: [`OptimiseConfig::attempt`].
    attempts: usize,
    /// Keys for which the gain in the rollouts was the simulator's equation, because the channel head was trained
    /// with other values.
    exact_gain_for: Vec<&'static str>,
    outcome: &'a OptimiseOutcome,
    /// The chance constraints as closed-loop flights measure them.
    flown: &'a ConstraintCheck,
}

impl<'a> PolicyManifest<'a> {
    /// That of a finished optimisation.
    #[must_use]
    pub fn of(scenario: &'a Scenario, seed: u64, config: &'a OptimiseConfig, made: &'a Optimised) -> Self {
        let Optimised { outcome, flown, attempts, .. } = made;
        let exact_gain_for = StationHeads::untrained(scenario);
        let (revision, attempts) = (crate::revision(), *attempts);
        Self { scenario, seed, revision, config, attempts, exact_gain_for, outcome, flown }
    }
}

/// Runs the subcommand.
///
/// # Errors
/// Files that cannot be read or written, a scenario that Algorithm 1 cannot plan for, and policies that do not
/// pass the check.
pub fn run(args: &Optimise) -> Result<()> {
    let config = match &args.config {
        Some(path) => {
            let text =
                std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
            toml::from_str(&text).with_context(|| format!("reading {}", path.display()))?
        }
        None => OptimiseConfig::default(),
    };
    config.check()?;
    let world = Models::load(args.checkpoint.as_deref(), None)?.world;
    if let Some(worlds) = args.random {
        let plan = RandomPlan::new(&world, config, worlds, args.seed)?;
        return random::run(&world, &plan, args.shard, args.out.as_deref(), args.json);
    }
    let scenario = args.camera.scenario(&args.scenario)?;
    one_obstacle(&scenario)?;
    if args.compare_limits {
        return compare_limits(&world, &scenario, &config, args);
    }
    let out = args.out.clone().unwrap_or_else(|| "runs/policy".into());
    std::fs::create_dir_all(&out).with_context(|| format!("creating {}", out.display()))?;
    let name = scenario.number().map_or("policy".to_owned(), |n| format!("policy_s{n}"));
    let saved = out.join(format!("{name}.progress.json"));
    let mut run = Saved {
        seed: args.seed,
        world: crpl_model::world_model::checkpoint::planning_fingerprint(&world)?,
        scenario: scenario.clone(),
        config: config.clone(),
        attempt: Attempt::default(),
        progress: None,
    };
    let begun = if args.resume { read_progress(&saved, &mut run)? } else { Begun::default() };

    let mut show = Show::new(&config, Some((saved.clone(), run)));
    let made = optimise_for(&world, &scenario, &config, args.seed, begun, &mut show)?;
    show.bar.finish_and_clear();
    let kept = if made.flown.holds() { name } else { format!("{name}.rejected") };
    write(&out, &kept, &made.policies, &PolicyManifest::of(&scenario, args.seed, &config, &made))?;
    if saved.exists() {
        std::fs::remove_file(&saved).with_context(|| format!("removing {}", saved.display()))?;
    }
    let Optimised { outcome, flown, attempts, wall_s, .. } = &made;
    if args.json {
        let line = serde_json::json!({"scenario": scenario.name, "seed": args.seed, "outcome": outcome,
            "flown": flown, "attempts": attempts, "wall_s": wall_s, "out": out});
        crpl_sitl::outln!("{line:#}");
    } else {
        let o = outcome;
        crpl_sitl::outln!(
            "P_safe {:.4}, P_comm {:.4} at full power, J {:.4}",
            o.motion.p_safe,
            o.motion.p_comm,
            o.motion.j
        );
        crpl_sitl::outln!("P_comm {:.4} as executed, mean power {:.3}", o.p_comm_executed, o.mean_power);
        crpl_sitl::out!("{}", columns::wrapped(&flown.to_string(), 2, columns::width()));
        let file = out.join(format!("{kept}.safetensors"));
        crpl_sitl::outln!("{wall_s:.1} s, attempt {attempts}; {}", file.display());
    }
    flown.verdict()
}

/// Optimises once for each of [`RolloutLimits`] and prints what they are worth, in latent rollouts and in flight.
fn compare_limits(
    world: &Arc<WorldModel>,
    scenario: &Scenario,
    config: &OptimiseConfig,
    args: &Optimise,
) -> Result<()> {
    if !args.json {
        put("limits     J right   J left    margin             P_safe   P_safe flown  d_f flown");
    }
    for limits in [RolloutLimits::Plain, RolloutLimits::Clip, RolloutLimits::Walls] {
        let config = OptimiseConfig { limits, ..config.clone() };
        let config = OptimiseConfig { attempts: 1, ..config };
        let made = optimise_for(world, scenario, &config, args.seed, Begun::default(), &mut Quiet)?;
        let (outcome, flown) = (&made.outcome, &made.flown);
        let c = &outcome.comparison;
        if args.json {
            crpl_sitl::outln!(
                "{}",
                serde_json::json!({"limits": limits, "outcome": outcome, "flown": flown})
            );
        } else {
            put(&format!(
                "{:<9} {:>8.4}  {:>8.4}  {:+.4} +- {:.4}  {:>8.4}   {:>8.4}      {:.4}",
                format!("{limits:?}").to_lowercase(),
                c.right.j,
                c.left.j,
                c.margin,
                c.margin_se,
                outcome.motion.p_safe,
                flown.safe.share,
                flown.d_f
            ));
        }
    }
    Ok(())
}

/// Prints a row of the table of [`compare_limits`].
fn put(line: &str) {
    crpl_sitl::out!("{}", columns::folded_line(line, &[9, 10, 11, 20, 9, 15, 11], columns::width()));
}

/// The progress of the same run, `None` if there is none; one of another run is an error.
fn read_progress(path: &Path, run: &mut Saved) -> Result<Begun> {
    let text = match std::fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Begun::default()),
        Err(error) => bail!("reading {}: {error}", path.display()),
    };
    let mut found: Saved =
        serde_json::from_str(&text).with_context(|| format!("reading {}", path.display()))?;
    let (attempt, progress) = (found.attempt, found.progress.take());
    found.attempt = run.attempt;
    if found != *run {
        bail!(
            "{}: the unfinished run there has another seed, scenario, config or world model; \
             run without --resume",
            path.display()
        );
    }
    Ok((attempt, progress))
}

fn write(out: &Path, name: &str, policies: &Policies, manifest: &PolicyManifest<'_>) -> Result<()> {
    policies.save(&out.join(format!("{name}.safetensors")))?;
    let path = out.join(format!("{name}.json"));
    let text = serde_json::to_string_pretty(manifest)? + "\n";
    std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))
}

/// Progress bar, log of the phases, saved progress.
pub struct Show {
    bar: ProgressBar,
    config: OptimiseConfig,
    saved: Option<(PathBuf, Saved)>,
    last: Option<(usize, ObjectiveEstimate, f64)>,
    stop: Option<StopSignal>,
}

impl Show {
    fn new(config: &OptimiseConfig, saved: Option<(PathBuf, Saved)>) -> Self {
        let bar = progress::bar("optimising policies", algorithm1::total_iterations(config) as u64);
        // Without signals it cannot be stopped gently.
        let stop = StopSignal::listen().ok();
        Self { bar, config: config.clone(), saved, last: None, stop }
    }

    /// A progress bar alone, for a run that is not resumed.
    #[must_use]
    pub fn unsaved(config: &OptimiseConfig) -> Self {
        Self::new(config, None)
    }
}

impl AttemptWatch for Show {
    fn stop(&self) -> Option<&StopSignal> {
        self.stop.as_ref()
    }

    fn attempt(&mut self, attempt: Attempt, config: &OptimiseConfig) {
        self.bar.set_position(0);
        self.config = config.clone();
        if let Some((_, run)) = &mut self.saved {
            run.attempt = attempt;
        }
        if attempt.number > 0 {
            let o = &config.objective;
            let (safe, comm, snr) = (o.collision_tolerance, o.outage_tolerance, config.snr_headroom);
            self.bar.suspend(|| {
                tracing::info!(
                    "attempt {}: tolerances {safe:.4}, {comm:.4}, SNR times {snr:.2}",
                    attempt.number + 1
                );
            });
        }
    }

    fn flown(&mut self, check: &ConstraintCheck) {
        self.bar.suspend(|| check.to_string().lines().for_each(|line| tracing::info!("{line}")));
    }
}

impl OptimiseWatch for Show {
    fn iteration(&mut self, phase: &str, done: usize, of: usize, e: &ObjectiveEstimate, norm: f64) {
        self.bar.inc(1);
        if done.is_multiple_of(25) || done == of {
            self.bar.set_message(format!(
                "{phase}: J {:.3}, P_safe {:.3}, P_comm {:.3}",
                e.j, e.p_safe, e.p_comm
            ));
        }
        self.last = Some((done, *e, norm));
    }

    fn phase_done(&mut self, phase: &str, progress: &OptimiseProgress) -> Result<(), OptimiseError> {
        self.bar.set_position(progress.iterations(&self.config) as u64);
        if let Some((done, e, norm)) = self.last {
            self.bar.suspend(|| {
                tracing::info!(
                    "{phase}: {done} iterations, J {:.4}, cost {:.4}, P_safe {:.4}, P_comm {:.4}, |grad| {norm:.2e}",
                    e.j, e.cost, e.p_safe, e.p_comm
                );
            });
        }
        let stopped = self.stop.as_ref().is_some_and(|stop| stop.get().is_some());
        let end = |what: String| if stopped { Err(OptimiseError::Progress(what)) } else { Ok(()) };
        let Some((path, run)) = &mut self.saved else { return end("nothing is kept".into()) };
        run.progress = Some(progress.clone());
        let failed = |e: String| OptimiseError::Progress(format!("writing {}: {e}", path.display()));
        let text = serde_json::to_string(run).map_err(|e| failed(e.to_string()))?;
        write_whole(path, text.as_bytes()).map_err(|e| failed(e.to_string()))?;
        end(format!("progress is kept in {}; --resume goes on", path.display()))
    }

    fn compared(&mut self, c: &Comparison) {
        self.bar.suspend(|| {
            tracing::info!(
                "right J {:.4} (P_safe {:.4}, P_comm {:.4}), left J {:.4} (P_safe {:.4}, P_comm {:.4}) \
                 on {} rollouts: margin {:+.4} +- {:.4}, {}",
                c.right.j,
                c.right.p_safe,
                c.right.p_comm,
                c.left.j,
                c.left.p_safe,
                c.left.p_comm,
                c.rollouts,
                c.margin,
                c.margin_se,
                if c.chosen == PassingSide::Right { "right it is" } else { "left it is" }
            );
        });
    }
}
