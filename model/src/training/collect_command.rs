//! `model collect` and `model merge`: exploratory flights as training data, on one machine or shared among many.
//!
//! An episode is a function of the configuration and its number alone. A shard records every Nth; merged, the shards
//! are the folder that one run writes, byte for byte.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use crpl_sitl::Scenario;
use crpl_sitl::program::progress;
use crpl_sitl::program::shard::Shard;

use crate::training::flags::ConfigFlags;
use crate::training::{learned, recipe};
use crate::world_model::config::{LearnedTraining, TrainConfig};
use crate::world_model::dataset::{self, Episode};
use crate::world_model::exploration;
use crate::world_model::recording::{RecordingFormat, TRUTH, episode_paths};

/// Says which shard a folder holds; written last, so it also says that the shard is whole. A whole recording has none.
const SHARD: &str = "shard.txt";

/// The configuration beside the episodes.
const CONFIG: &str = "config.toml";

/// Flags of `model collect`.
#[derive(Debug, clap::Args)]
pub struct Collect {
    #[command(flatten)]
    config: ConfigFlags,
    /// Folder for episodes.safetensors and config.toml
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How a recording's pictures are stored
    #[arg(long, value_enum, default_value = "safetensors")]
    format: RecordingFormat,
    /// Only shard I of N, every Nth episode; `model merge` joins the shards
    #[arg(long, value_name = "I/N", default_value_t = Shard::WHOLE)]
    shard: Shard,
}

/// Flags of `model merge`.
#[derive(Debug, clap::Args)]
pub struct MergeShards {
    /// Folders of all shards
    #[arg(required = true, value_name = "DIR")]
    shards: Vec<PathBuf>,
    /// Folder of the whole data
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Runs `model collect`.
///
/// # Errors
/// A configuration that does not read, and files that cannot be written.
pub fn collect(args: &Collect) -> Result<()> {
    let config = args.config.resolve()?;
    let note = args.out.join(SHARD);
    if note.exists() {
        fs::remove_file(&note).with_context(|| format!("removing {}", note.display()))?;
    }
    match &config.learned {
        Some(part) => record(&config, part, args)?,
        None => states(&config, args)?,
    }
    if args.shard != Shard::WHOLE {
        fs::write(&note, format!("{}\n", args.shard))
            .with_context(|| format!("writing {}", note.display()))?;
    }
    Ok(())
}

/// Episodes as states, from which training draws the pictures.
fn states(config: &TrainConfig, args: &Collect) -> Result<()> {
    ensure!(args.format == RecordingFormat::default(), "--format png: the configuration has no [learned]");
    let all = recipe::collect(config, &Scenario::default());
    let mine = |(n, episode)| args.shard.has(n as u64).then_some(episode);
    let episodes: Vec<Episode> = all.into_iter().enumerate().filter_map(mine).collect();
    dataset::save(&episodes, &args.out)?;
    write_config(config, &args.out)?;
    let (n, steps) = (episodes.len(), config.data.steps);
    crpl_sitl::outln!("{n} episodes of {steps} actions in {}", args.out.display());
    Ok(())
}

/// Exploratory flights as a recording.
fn record(config: &TrainConfig, part: &LearnedTraining, args: &Collect) -> Result<()> {
    let recording = &part.recording;
    let cameras = learned::recipe::cameras(recording)?;
    let mine: Vec<usize> = (0..recording.episodes).filter(|n| args.shard.has(*n as u64)).collect();
    let bar = progress::bar("recording", mine.len() as u64);
    let place = (args.out.as_path(), args.format);
    exploration::collect_some(recording, &cameras, &Scenario::default(), config.seed, place, &mine, || {
        bar.inc(1);
    })?;
    bar.finish();
    write_config(config, &args.out)?;
    let (n, pictures) = (mine.len(), recording.pictures);
    crpl_sitl::outln!("{n} episodes of {pictures} pictures in {}", args.out.display());
    Ok(())
}

fn write_config(config: &TrainConfig, dir: &Path) -> Result<()> {
    let path = dir.join(CONFIG);
    fs::create_dir_all(dir).with_context(|| format!("making {}", dir.display()))?;
    fs::write(&path, toml::to_string(config)?).with_context(|| format!("writing {}", path.display()))
}

/// A shard's folder.
struct ShardFolder {
    dir: PathBuf,
    shard: Shard,
    config: String,
}

impl ShardFolder {
    fn open(dir: &Path) -> Result<Self> {
        let config = read(&dir.join(CONFIG))?;
        let note = dir.join(SHARD);
        ensure!(note.exists(), "{} is no finished shard: it has no {SHARD}", dir.display());
        let shard = read(&note)?.trim().parse();
        let shard = shard.map_err(|error| anyhow::anyhow!("{}: {error}", note.display()))?;
        Ok(Self { dir: dir.to_owned(), shard, config })
    }
}

fn read(path: &Path) -> Result<String> {
    fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))
}

/// Runs `model merge`.
///
/// # Errors
/// Folders that are not all shards of one collection, an out folder that holds something, files that cannot be written.
pub fn merge(args: &MergeShards) -> Result<()> {
    let mut folders = args.shards.iter().map(|dir| ShardFolder::open(dir)).collect::<Result<Vec<_>>>()?;
    let named: Vec<(String, Shard)> =
        folders.iter().map(|folder| (folder.dir.display().to_string(), folder.shard)).collect();
    if let Some(lack) = Shard::lack(&named) {
        bail!(lack);
    }
    folders.sort_by_key(|folder| folder.shard.number);
    let Some(first) = folders.first() else { bail!("no shard") };
    if let Some(other) = folders.iter().find(|folder| folder.config != first.config) {
        let (a, b) = (first.dir.display(), other.dir.display());
        bail!("{a} and {b} were collected with different configurations: compare their {CONFIG}");
    }
    let is_empty = fs::read_dir(&args.out).map_or(true, |mut entries| entries.next().is_none());
    ensure!(is_empty, "{} holds something: choose another --out", args.out.display());
    let config: TrainConfig = toml::from_str(&first.config)?;
    let episodes = match &config.learned {
        Some(part) => join_recordings(&folders, part.recording.episodes, &args.out)?,
        None => join_states(&folders, &config, &args.out)?,
    };
    write_config(&config, &args.out)?;
    crpl_sitl::outln!("{episodes} episodes of {} shards in {}", folders.len(), args.out.display());
    Ok(())
}

/// Episodes as states, in the order of one run.
fn join_states(folders: &[ShardFolder], config: &TrainConfig, out: &Path) -> Result<usize> {
    let mut shards = Vec::new();
    for folder in folders {
        shards.push(dataset::load(&folder.dir, config.data.steps)?.into_iter());
    }
    let mut episodes = Vec::new();
    while let Some(episode) = shards.get_mut(episodes.len() % folders.len()).and_then(Iterator::next) {
        episodes.push(episode);
    }
    let wanted = config.data.episodes + config.data.edge_episodes;
    ensure!(episodes.len() == wanted, "{} episodes instead of {wanted}", episodes.len());
    dataset::save(&episodes, out)?;
    Ok(episodes.len())
}

/// Recordings: each episode is files of its own.
fn join_recordings(folders: &[ShardFolder], wanted: usize, out: &Path) -> Result<usize> {
    for folder in folders {
        for place in ["", TRUTH] {
            let (from, to) = (folder.dir.join(place), out.join(place));
            fs::create_dir_all(&to).with_context(|| format!("making {}", to.display()))?;
            for path in episode_paths(&from)? {
                copy(&path, &to)?;
            }
        }
    }
    for place in ["", TRUTH] {
        let there = episode_paths(&out.join(place))?.len();
        ensure!(there == wanted, "{there} episodes instead of {wanted} in {}", out.join(place).display());
    }
    Ok(wanted)
}

/// Copies a file or a folder of files into a folder.
fn copy(from: &Path, into: &Path) -> Result<()> {
    let to = into.join(from.file_name().unwrap_or_default());
    if !from.is_dir() {
        return fs::copy(from, &to).map(drop).with_context(|| format!("copying {}", from.display()));
    }
    fs::create_dir_all(&to).with_context(|| format!("making {}", to.display()))?;
    for entry in fs::read_dir(from).with_context(|| format!("reading {}", from.display()))? {
        copy(&entry?.path(), &to)?;
    }
    Ok(())
}
