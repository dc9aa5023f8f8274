//! `model`: makes the training data and the world model, and measures it.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::{Parser, Subcommand};
use crpl_model::encoder::module::Backend;
use crpl_model::evaluation;
use crpl_model::training::flags::ConfigFlags;
use crpl_model::training::learned::device::EncoderDevice;
use crpl_model::training::recipe::{self, Run};
use crpl_model::training::show::StageShow;
use crpl_model::training::{ablation_command, collect_command, learned, predictors};
use crpl_model::world_model::WorldModel;
use crpl_model::world_model::recording::Recording;
use crpl_sitl::program::columns;
use crpl_sitl::program::page::WatchFlags;
use crpl_sitl::program::page::feed::WatchEvent;
use crpl_sitl::program::terminal;
use crpl_sitl::program::timing::Stopwatch;

/// Train and evaluate CRPL's world model.
#[derive(Debug, Parser)]
#[command(name = "model", version, max_term_width = 100)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Fly random actions and record the episodes
    Collect(collect_command::Collect),
    /// Join the shards of `collect`, as if one run had recorded them
    Merge(collect_command::MergeShards),
    /// Train the world model and write its checkpoint
    Train(Train),
    /// Train the MLP and LSTM predictors on the latents of a world model; of the training parameters, [networks] counts
    Predictors(NetworksOf),
    /// Fine-tune a learned world model on a recording of a new camera
    Adapt(Adapt),
    /// Train with one ingredient of the recipe changed at a time and print the errors
    Ablate(ablation_command::Ablate),
    /// Print an encoder's errors with degraded cameras and in difficult states
    Robustness(ablation_command::Robustness),
    /// Evaluate a world model on held-out frames and draw the paper's Fig. 3
    Evaluate(evaluation::command::Evaluate),
}

/// Examples below the help of each command.
const EXAMPLES: &[(&str, &[&str])] = &[
    ("collect", &["model collect --config configs/learned.toml --out runs/data"]),
    ("merge", &["model merge runs/data-1 runs/data-2 --out runs/data"]),
    ("train", &["model train --quick", "model train --config configs/learned.toml --data runs/data --watch"]),
    ("predictors", &["model predictors --out runs/networks"]),
    ("adapt", &["model adapt --recording runs/recording --out runs/adapted"]),
    ("ablate", &["model ablate --only mix", "model ablate --config configs/learned.toml --data runs/data"]),
    ("robustness", &["model robustness learned centroid", "model robustness runs/model --json"]),
    ("evaluate", &["model evaluate", "model evaluate --checkpoint runs/model --camera hard"]),
];

#[derive(Debug, clap::Args)]
struct Train {
    #[command(flatten)]
    config: ConfigFlags,
    /// Backend of burn, the tensor library
    #[arg(long, value_enum, default_value_t)]
    backend: Backend,
    /// Where the learned encoder is trained; the rest stays on the CPU
    #[arg(long, value_enum, default_value_t)]
    device: EncoderDevice,
    /// Folder written by `model collect` [default: collect new data]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder for the checkpoint
    #[arg(long, value_name = "DIR", default_value = "runs/model")]
    out: PathBuf,
    /// Resume an interrupted run
    #[arg(long)]
    resume: bool,
    /// Use less data: seconds instead of minutes, with lower accuracy
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    watch: WatchFlags,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct NetworksOf {
    /// World model that gives the latents: a folder, or `learned` or `centroid`, which are built in [default: learned]
    #[arg(long, value_name = "DIR")]
    checkpoint: Option<PathBuf>,
    #[command(flatten)]
    config: ConfigFlags,
    /// Folder for the networks and their learning curves
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

#[derive(Debug, clap::Args)]
struct Adapt {
    /// World model to start from: a folder, or `learned`, which is built in
    #[arg(long, value_name = "DIR", default_value = "learned")]
    checkpoint: PathBuf,
    /// Folder of the recording; the last fifth of its episodes tells the noise of a reading and is not trained on
    #[arg(long, value_name = "DIR")]
    recording: PathBuf,
    /// Steps
    #[arg(long, value_name = "N", default_value_t = 300)]
    steps: usize,
    /// Seed of the steps
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Folder for the checkpoint
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

fn main() -> ExitCode {
    terminal::main(crpl_model::revision(), EXAMPLES, |args: Args| match args.command {
        Command::Collect(args) => collect_command::collect(&args),
        Command::Merge(args) => collect_command::merge(&args),
        Command::Train(args) => run(&args),
        Command::Predictors(args) => networks(&args),
        Command::Adapt(args) => adapt(&args),
        Command::Ablate(args) => ablation_command::ablate(&args),
        Command::Robustness(args) => ablation_command::robustness(&args),
        Command::Evaluate(args) => evaluation::command::run(&args),
    })
}

fn run(args: &Train) -> anyhow::Result<()> {
    let mut config = args.config.resolve()?;
    if args.quick {
        config = config.quick();
        tracing::warn!("--quick: less data and fewer steps; these are not the figures of the full recipe");
    }
    anyhow::ensure!(
        config.learned.is_some() || args.device == EncoderDevice::Cpu,
        "--device: the configuration has no [learned], whose encoder alone is trained on a device"
    );
    let page = args.watch.open()?;
    if let Some(page) = &page {
        let title = config.learned.as_ref().map_or("centroid", |_| "learned encoder");
        page.feed().send(&WatchEvent::computation("model train", crpl_model::revision(), title, None));
    }
    let run = Run {
        backend: args.backend,
        device: args.device,
        out: args.out.clone(),
        data: args.data.clone(),
        resume: args.resume,
        stopwatch: Stopwatch::default(),
        feed: page.as_ref().map(|page| page.feed().clone()),
    };
    let trained = recipe::train(&config, &run);
    if let Some(page) = page {
        let reason = trained.as_ref().err().map_or_else(|| "over".into(), ToString::to_string);
        let metrics =
            trained.as_ref().ok().and_then(|(model, _)| serde_json::to_value(&model.card.metrics).ok());
        terminal::block_on(async {
            page.close(&reason, metrics.unwrap_or_default()).await;
            Ok(())
        })?;
    }
    let (model, diagnostics) = trained?;
    let (wall_s, cpu_s) = run.stopwatch.seconds();
    if args.json {
        let out = serde_json::json!({
            "out": args.out,
            "seed": config.seed,
            "backend": args.backend,
            "device": args.device,
            "metrics": model.card.metrics,
            "alarms": diagnostics,
            "quick": args.quick,
            "wall_s": wall_s,
            "cpu_s": cpu_s,
        });
        crpl_sitl::outln!("{out:#}");
    } else {
        let time = format!("{:<44} {wall_s:.1} s wall, {cpu_s:.1} s CPU", "time");
        let rows = model.card.metrics.table() + &diagnostics.table() + &time;
        crpl_sitl::out!("{}", columns::wrapped(&rows, 4, columns::width()));
        crpl_sitl::outln!("checkpoint in {}", args.out.display());
        if args.quick {
            crpl_sitl::outln!("made by --quick: these are not the figures of the full recipe");
        }
    }
    Ok(())
}

fn adapt(args: &Adapt) -> anyhow::Result<()> {
    let stopwatch = Stopwatch::default();
    let model = WorldModel::named(&args.checkpoint)?;
    let recording = Recording::open(&args.recording, None)?;
    let shown = StageShow::begin("adapt", args.steps, None);
    let adapted = learned::adapt::adapt(model, &recording, args.steps, args.seed, &shown)?;
    shown.finish();
    let learned::adapt::Adapted { model, explained } = adapted;
    model.save(&args.out)?;
    println!(
        "the actions explain {explained:.3} of z_c's second differences in episodes that were not trained on"
    );
    anyhow::ensure!(
        explained >= learned::adapt::FOUND,
        "the UAV is not found in these pictures: more episodes or more --steps, or `model train --data`; the model is \
         in {} to be looked at",
        args.out.display()
    );
    println!(
        "{} steps on {} episodes in {:.1} s; in {}",
        args.steps,
        recording.episodes().len(),
        stopwatch.seconds().0,
        args.out.display()
    );
    Ok(())
}

fn networks(args: &NetworksOf) -> anyhow::Result<()> {
    let config = args.config.resolve()?;
    config.check()?;
    let model = match &args.checkpoint {
        Some(dir) => WorldModel::named(dir)?,
        None => WorldModel::embedded()?,
    };
    std::fs::create_dir_all(&args.out).with_context(|| format!("making {}", args.out.display()))?;
    let stopwatch = Stopwatch::default();
    let trained = recipe::networks(&config, &model, None)?;
    predictors::publish(&trained, &args.out)?;
    for (network, curve) in trained.networks.all.iter().zip(&trained.curves) {
        let name = network.kind().name();
        let (last, before) = (curve.last(), curve.iter().rev().nth(curve.len() / 5));
        let px = |p: Option<&predictors::Point>| p.map_or(f64::NAN, |p| p.held_out_px);
        crpl_sitl::outln!(
            "{name:<5} held out, p90: {:.3} px, {:.3} px a fifth earlier",
            px(last),
            px(before)
        );
    }
    if let Some(bounds) = trained.networks.bounds {
        crpl_sitl::outln!("bounded: {}", predictors::in_px(&bounds, &model));
    }
    crpl_sitl::outln!("{:.1} s; in {}", stopwatch.seconds().0, args.out.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;
    use crpl_sitl::program::common;

    #[test]
    fn every_command_has_examples_that_parse() {
        assert_eq!(common::wrong_examples(super::Args::command(), super::EXAMPLES), Vec::<String>::new());
    }
}
