//! `gcs merge`: the shards of a sweep become the sweep, as if one run had flown it.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};

use super::folder::Folder;
use super::plan::Shard;

/// Flags of `gcs merge`.
#[derive(Debug, clap::Args)]
pub struct Merge {
    /// Folders of all shards
    #[arg(required = true, value_name = "DIR")]
    shards: Vec<PathBuf>,
    /// Folder of the whole sweep
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON line per point and controller
    #[arg(long)]
    json: bool,
}

/// Runs `gcs merge`.
///
/// # Errors
/// The shards are not those of one sweep, one of them is not finished, or a file cannot be read or written.
pub fn run(args: &Merge) -> Result<()> {
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
    for (n, folder) in folders.iter().enumerate() {
        let (dir, before) = (folder.dir().display(), &folders[..n]);
        if let Some(difference) = first.plan.difference(&folder.plan)? {
            bail!("{} and {dir} are of different sweeps: {difference}", first.dir().display());
        }
        if folder.shard.of != first.shard.of {
            let (a, b) = (first.shard, folder.shard);
            bail!("{} is shard {a} and {dir} is shard {b}: of different numbers", first.dir().display());
        }
        if let Some(twin) = before.iter().find(|b| b.shard == folder.shard) {
            bail!("{} and {dir} both hold shard {}", twin.dir().display(), folder.shard);
        }
    }
    let of = first.shard.of;
    let is_there = |number: &u64| folders.iter().any(|f| f.shard.number == *number);
    let missing: Vec<String> = (1..=of).filter(|n| !is_there(n)).map(|n| format!("{n}/{of}")).collect();
    if !missing.is_empty() {
        bail!("missing: shard {}", missing.join(", "));
    }
    Ok(())
}
