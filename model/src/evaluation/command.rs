//! `model evaluate`: the accuracy of a world model, printed, drawn and written to files.

use std::path::{Path, PathBuf};

use crate::evaluation::figures;
use crate::evaluation::report::{self, ReportConfig};
use crate::evaluation::rollout::RolloutStart;
use crate::predictor::{Networks, PREDICTORS};
use crate::world_model::{WorldModel, checkpoint};
use anyhow::{Context, Result, bail};
use crpl_sitl::Scenario;
use crpl_sitl::program::{columns, progress};

/// Flags of `model evaluate`.
#[derive(Debug, clap::Args)]
pub struct Evaluate {
    /// Seed of the frames and flights
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// World model: a folder, or `learned` or `centroid`, which are built in [default: learned]
    #[arg(long, value_name = "DIR")]
    checkpoint: Option<PathBuf>,
    /// Folder of other networks, written by `model predictors` [default: those beside the world model]
    #[arg(long, value_name = "DIR")]
    networks: Option<PathBuf>,
    /// Number of trajectories from each of the three start conditions
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(10..=100_000))]
    trajectories: u64,
    /// Number of frames for the probes and the heads
    #[arg(long, value_name = "N", default_value_t = 6000, value_parser = clap::value_parser!(u64).range(100..=1_000_000))]
    frames: u64,
    /// Camera of the trajectories: TOML file or clean, texture, hard, or another name of docs/camera.md
    #[arg(long, value_name = "FILE|NAME", default_value = "clean")]
    camera: String,
    /// Number of frames in the observer's window
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(2..=50))]
    window: u64,
    /// Folder for the results and figures
    #[arg(long, value_name = "DIR", default_value = "runs/evaluate")]
    out: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// If the world model does not read or a file cannot be written.
pub fn run(args: &Evaluate) -> Result<()> {
    let (model, networks) = load(args.checkpoint.as_deref(), args.networks.as_deref())?;
    let config = ReportConfig {
        seed: args.seed,
        trajectories: args.trajectories as usize,
        frames: args.frames as usize,
        window: args.window as usize,
        camera: args.camera.clone(),
    };
    std::fs::create_dir_all(&args.out).with_context(|| format!("creating {}", args.out.display()))?;
    let bar = progress::bar("rollouts", 2 * RolloutStart::ALL.len() as u64 * args.trajectories);
    let mut scenario = Scenario::default();
    scenario.film_with(&args.camera)?;
    let measured = report::measure(&model, &networks, &config, &scenario, || bar.inc(1));
    bar.finish_and_clear();
    figures::draw(&measured, &args.out)?;
    let about = serde_json::json!({
        "config": config,
        "world_model": checkpoint::fingerprint(&model)?,
        "checkpoint": args.checkpoint,
        "networks": args.networks,
        "revision": crate::revision(),
        "command": std::env::args().collect::<Vec<_>>(),
        "intervals": "95 %: Wilson for shares, order statistics for quantiles, bootstrap for heads",
    });
    write(&args.out.join("run.json"), &about)?;
    let results = serde_json::to_value(&measured.report)?;
    write(&args.out.join("evaluation.json"), &results)?;
    if args.json {
        crpl_sitl::outln!("{results:#}");
    } else {
        crpl_sitl::out!("{}", measured.report.table(columns::width()));
        crpl_sitl::outln!("figures and results in {}", args.out.display());
    }
    Ok(())
}

/// The world model and the networks that were trained on its latents.
fn load(dir: Option<&Path>, others: Option<&Path>) -> Result<(WorldModel, Networks)> {
    let model = match dir {
        Some(dir) => WorldModel::named(dir)?,
        None => WorldModel::embedded()?,
    };
    let dir = others.or(dir);
    let networks = match dir {
        Some(dir) => Networks::named(dir)?,
        None => Networks::embedded()?,
    };
    let here = checkpoint::planning_fingerprint(&model)?;
    if networks.world != here {
        let place = dir.map_or("embedded".into(), |d| d.display().to_string());
        bail!("{place}/{PREDICTORS} was trained on world model {}, and this is {here}", networks.world);
    }
    Ok((model, networks))
}

fn write(path: &Path, value: &serde_json::Value) -> Result<()> {
    std::fs::write(path, format!("{value:#}\n")).with_context(|| format!("writing {}", path.display()))
}
