//! `model ablate` and `model robustness`: what each ingredient of the recipe contributes, and which cameras
//! and states an encoder cannot handle.

use std::io::Write;
use std::path::{Path, PathBuf};

use crate::encoder::BuiltIn;
use crate::encoder::module::Backend;
use crate::evaluation::robustness;
use crate::training::ablation::{ABLATIONS, AblationRow, HEAD};
use crate::training::flags::ConfigFlags;
use crate::training::learned::ablation::{self as learned_ablation, LEARNED_ABLATIONS, LearnedAblationRow};
use crate::training::recipe::{TrainError, without_heads};
use crate::world_model::WorldModel;
use crate::world_model::config::{LearnedTraining, TrainConfig};
use anyhow::Context;
use crpl_sitl::Scenario;
use crpl_sitl::world::noise::Noise;
use serde::Serialize;

/// Flags of `model ablate`.
#[derive(Debug, clap::Args)]
pub struct Ablate {
    #[command(flatten)]
    config: ConfigFlags,
    /// Backend of burn, the tensor library
    #[arg(long, value_enum, default_value_t)]
    backend: Backend,
    /// Number of frames of each kind to evaluate a row on
    #[arg(long, value_name = "N", default_value_t = 2000)]
    frames: usize,
    /// Only rows whose name contains TEXT
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
    /// Recording that the rows of a `[learned]` configuration learn from [default: one is made in --out]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder of the rows of a `[learned]` configuration; rows that are there are not trained again
    #[arg(long, value_name = "DIR", default_value = "runs/ablation")]
    out: PathBuf,
    /// Print one JSON line per row
    #[arg(long)]
    json: bool,
}

/// Flags of `model robustness`.
#[derive(Debug, clap::Args)]
pub struct Robustness {
    /// Folders of checkpoints, or files of training parameters (TOML) to train an encoder with [default: the
    /// built-in model]
    #[arg(value_name = "DIR|FILE")]
    models: Vec<PathBuf>,
    /// Seed of the frames
    #[arg(long, value_name = "N", default_value_t = 1000)]
    seed: u64,
    /// Number of frames or flights per case
    #[arg(long, value_name = "N", default_value_t = 2000)]
    frames: usize,
    /// Backend of burn, the tensor library, for training
    #[arg(long, value_enum, default_value_t)]
    backend: Backend,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `model ablate`.
///
/// # Errors
/// A config that does not read, and a result that cannot be written.
pub fn ablate(args: &Ablate) -> anyhow::Result<()> {
    let config = args.config.resolve()?;
    let wanted = |name: &str| args.only.as_ref().is_none_or(|only| name.contains(only.as_str()));
    if let Some(part) = &config.learned {
        return ablate_learned(args, &config, part, wanted);
    }
    let changes: Vec<_> = ABLATIONS.iter().filter(|change| wanted(change.name)).collect();
    if changes.is_empty() {
        let only = args.only.as_deref().unwrap_or_default();
        anyhow::bail!("--only {only}: no row's name contains it");
    }
    let rows = changes.into_iter().map(|change| change.run(&config, args.backend, args.frames));
    print_rows(args.json, HEAD, rows, AblationRow::line)
}

/// Prints each row as soon as it is there.
fn print_rows<R: Serialize>(
    json: bool,
    head: &str,
    rows: impl Iterator<Item = Result<R, TrainError>>,
    line: impl Fn(&R) -> String,
) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if !json {
        write!(out, "{head}")?;
    }
    for row in rows {
        let row = row?;
        if json {
            writeln!(out, "{}", serde_json::to_string(&row)?)?;
        } else {
            write!(out, "{}", line(&row))?;
        }
        out.flush()?;
    }
    Ok(())
}

/// The same of the learned encoder.
fn ablate_learned(
    args: &Ablate,
    config: &TrainConfig,
    part: &LearnedTraining,
    wanted: impl Fn(&str) -> bool,
) -> anyhow::Result<()> {
    let changes: Vec<_> =
        LEARNED_ABLATIONS.iter().filter(|change| wanted(change.key) || wanted(change.name)).collect();
    if changes.is_empty() {
        let only = args.only.as_deref().unwrap_or_default();
        anyhow::bail!("--only {only}: no row's name contains it");
    }
    let identity =
        format!("{:#}\n", serde_json::json!({ "config": config, "data": args.data, "frames": args.frames }));
    std::fs::create_dir_all(&args.out).with_context(|| format!("making {}", args.out.display()))?;
    let place = args.out.join("run.json");
    match std::fs::read_to_string(&place) {
        Ok(text) if text != identity => {
            anyhow::bail!("{} holds rows of another configuration; take another --out", args.out.display())
        }
        Ok(_) => {}
        Err(_) => {
            std::fs::write(&place, &identity).with_context(|| format!("writing {}", place.display()))?
        }
    }
    let recording = learned_ablation::recording(config, part, args.data.as_deref(), &args.out)?;
    let rows = changes.into_iter().map(|change| change.run(config, part, &recording, &args.out, args.frames));
    print_rows(args.json, &learned_ablation::head(), rows, LearnedAblationRow::line)
}

/// Runs `model robustness`.
///
/// # Errors
/// A checkpoint that does not read, and a result that cannot be written.
pub fn robustness(args: &Robustness) -> anyhow::Result<()> {
    let (scenario, noise) = (Scenario::default(), Noise::new(args.seed));
    let mut models = Vec::new();
    for path in &args.models {
        let name = path.file_stem().unwrap_or(path.as_os_str()).display().to_string();
        models.push((name, load_or_train(path, args.backend)?));
    }
    if models.is_empty() {
        models.push(("shipped".into(), WorldModel::built_in(BuiltIn::Centroid)?));
    }
    let tables: Vec<_> = models
        .iter()
        .map(|(_, model)| robustness::robustness_table(model, args.frames, &scenario, &noise))
        .collect();
    let names: Vec<&str> = models.iter().map(|(name, _)| name.as_str()).collect();
    if args.json {
        let all: Vec<_> = names
            .iter()
            .zip(&tables)
            .map(|(name, hard)| serde_json::json!({ "model": name, "hard": hard }))
            .collect();
        crpl_sitl::outln!("{:#}", serde_json::Value::from(all));
    } else {
        crpl_sitl::out!("{}", robustness::table(&names, &tables));
    }
    Ok(())
}

fn load_or_train(path: &Path, backend: Backend) -> anyhow::Result<WorldModel> {
    if path.is_dir() {
        return Ok(WorldModel::named(path)?);
    }
    let config = TrainConfig::load(path)?;
    let (model, diagnostics) =
        without_heads(&config, backend).with_context(|| format!("training {}", path.display()))?;
    for alarm in diagnostics.alarms(&config.alarms) {
        tracing::warn!("{}: {alarm}", path.display());
    }
    Ok(model)
}
