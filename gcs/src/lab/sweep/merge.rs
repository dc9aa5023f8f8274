//! `gcs merge`: the shards of a sweep, or of random worlds, become the whole, as if one run had made it.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use crpl_sitl::program::shard::Shard;

use super::folder::Folder;
use crate::lab::random::{self, RandomFolder};

/// Flags of `gcs merge`.
#[derive(Debug, clap::Args)]
pub struct Merge {
    /// Folders of all shards
    #[arg(required = true, value_name = "DIR")]
    shards: Vec<PathBuf>,
    /// Folder of the whole
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON line per point and controller
    #[arg(long)]
    json: bool,
}

/// Runs `gcs merge`.
///
/// # Errors
/// Folders that are not all shards of one sweep, and files that cannot be written.
pub fn run(args: &Merge) -> Result<()> {
    if args.shards.iter().any(|dir| RandomFolder::is_one(dir)) {
        return random::merge(&args.shards, &args.out, args.json);
    }
    let folders = args.shards.iter().map(|dir| Folder::open(dir)).collect::<Result<Vec<_>>>()?;
    check(&folders)?;
    let mut episodes = Vec::new();
    for folder in &folders {
        let finished = folder.finished()?;
        episodes.extend(finished.with_context(|| {
            format!("{} is not finished: fly its shard {} again", folder.dir().display(), folder.shard)
        })?);
    }
    let first = folders.first().context("no shard")?;
    let whole = Folder::begin(&args.out, first.plan.clone(), Shard::WHOLE)?;
    let episodes = whole.finish(episodes)?;
    super::show(&whole, &episodes, args.json)
}

/// Whether these are the shards of one sweep, each once.
fn check(folders: &[Folder]) -> Result<()> {
    let Some(first) = folders.first() else { bail!("no shard") };
    for folder in folders {
        if let Some(difference) = first.plan.difference(&folder.plan)? {
            let (a, b) = (first.dir().display(), folder.dir().display());
            bail!("{a} and {b} are of different sweeps: {difference}");
        }
    }
    let named: Vec<(String, Shard)> =
        folders.iter().map(|folder| (folder.dir().display().to_string(), folder.shard)).collect();
    Shard::lack(&named).map_or(Ok(()), |lack| bail!(lack))
}
