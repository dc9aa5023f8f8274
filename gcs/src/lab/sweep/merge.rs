//! `gcs merge`: the shares of a sweep become the sweep, as if one run had flown it.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};

use super::folder::Folder;
use super::plan::Shard;

/// Flags of `gcs merge`.
#[derive(Debug, clap::Args)]
pub struct Merge {
    /// Folders of all shares.
    #[arg(required = true, value_name = "DIR")]
    shares: Vec<PathBuf>,
    /// Folder of the whole.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON line per point and controller.
    #[arg(long)]
    json: bool,
}

/// Runs `gcs merge`.
pub fn run(args: &Merge) -> Result<()> {
    let shares = args.shares.iter().map(|dir| Folder::open(dir)).collect::<Result<Vec<_>>>()?;
    check(&shares)?;
    let mut episodes = Vec::new();
    for share in &shares {
        let finished = share.finished()?;
        episodes.extend(finished.with_context(|| {
            format!("{} is not finished: run its share {} again", share.dir().display(), share.shard)
        })?);
    }
    let first = shares.first().context("no share")?;
    let whole = Folder::begin(&args.out, first.plan.clone(), Shard::WHOLE)?;
    let episodes = whole.finish(episodes)?;
    super::show(&whole, &episodes, args.json)
}

/// Whether these are the shares of one sweep, each once.
fn check(shares: &[Folder]) -> Result<()> {
    let Some(first) = shares.first() else { bail!("no share") };
    for (n, share) in shares.iter().enumerate() {
        let (dir, before) = (share.dir().display(), &shares[..n]);
        if let Some(difference) = first.plan.difference(&share.plan)? {
            bail!("{} and {dir} are of different sweeps: {difference}", first.dir().display());
        }
        if share.shard.of != first.shard.of {
            let (a, b) = (first.shard, share.shard);
            bail!("{} is share {a} and {dir} is share {b}: of different numbers", first.dir().display());
        }
        if let Some(twin) = before.iter().find(|b| b.shard == share.shard) {
            bail!("{} and {dir} both hold share {}", twin.dir().display(), share.shard);
        }
    }
    let of = first.shard.of;
    let is_there = |number: &u64| shares.iter().any(|s| s.shard.number == *number);
    let missing: Vec<String> = (1..=of).filter(|n| !is_there(n)).map(|n| format!("{n}/{of}")).collect();
    if !missing.is_empty() {
        bail!("missing: share {}", missing.join(", "));
    }
    Ok(())
}
