//! `gcs record`: exploratory flights over a link, as episodes that `model train` learns from.

pub mod folder;
pub mod recorder;
pub mod show;

use std::path::PathBuf;

use anyhow::{Context, Result};
use crpl_model::world_model::recording::RecordingFormat;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::files::write_whole;
use crpl_sitl::program::terminal::folder as folder_flag;
use serde::Serialize;

use crate::flight::{self, Options, world};
use crate::lab::crew::exit_of;
use crate::lab::record::folder::{MANIFEST, RecordingFolder};
use crate::lab::record::recorder::{Recorder, RecordingPlan};
use crate::lab::run_folder;
use crate::lab::summary::FlightEnded;
use crate::watch::WatchFlags;

/// Flags of `gcs record`.
#[derive(Debug, clap::Args)]
pub struct RecordFlags {
    /// Scenario: TOML file or preset, which must be the vehicle's [default: the vehicle's own]
    #[arg(long, value_name = "FILE|NAME")]
    scenario: Option<String>,
    #[command(flatten)]
    camera: CameraFlag,
    /// Endpoint of the vehicle: udpout:HOST:PORT if it listens, udpin:HOST:PORT to wait for it; or
    /// tcpout, tcpin
    #[arg(long, value_name = "ENDPOINT")]
    connect: Endpoint,
    /// System id of the vehicle [default: the only one on the link]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    sysid: Option<u8>,
    /// Sign all messages with the key in this file: TOML with `key` (64 hexadecimal digits) or `passphrase`
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// Stop when the folder holds N episodes
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// Pictures of an episode; a gap ends one early
    #[arg(long, value_name = "K", default_value_t = 102, value_parser = clap::value_parser!(u32).range(3..60000))]
    pictures: u32,
    /// Seed of the actions
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// How pictures are stored
    #[arg(long, value_enum, default_value = "safetensors")]
    format: RecordingFormat,
    /// Folder of the recording [default: runs/recording, or runs/recording-2 ... where that is taken]
    #[arg(long, value_name = "DIR", value_parser = folder_flag)]
    out: Option<PathBuf>,
    /// Go on after the episodes that are in this folder
    #[arg(long, conflicts_with = "overwrite")]
    resume: bool,
    /// Replace the recording that is in this folder
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    watch: WatchFlags,
}

/// `run.json`: how the last flight of a recording was made.
#[derive(Debug, Serialize)]
struct RecordingManifest {
    seed: u64,
    pictures: u32,
    /// Episodes in the folder.
    episodes: usize,
    revision: &'static str,
    version: &'static str,
    command: Vec<String>,
    ended: FlightEnded,
}

/// Records until all episodes are there, or an event ends the flight.
///
/// # Errors
/// A folder that holds a recording, no vehicle, a flight that ended early.
pub async fn run(args: RecordFlags) -> Result<()> {
    let out = run_folder::fresh(args.out.as_deref(), "runs/recording")?;
    let folder = RecordingFolder::claim(&out, args.overwrite, args.resume)?;
    let episodes = args.episodes as usize;
    if folder.next() >= episodes {
        println!("{} episodes are in {} already", folder.next(), out.display());
        return Ok(());
    }
    let options = Options { system: args.sysid, signing_key: args.signing_key.clone(), ..Options::default() };
    let met = world::meet(&options, &args.connect, args.scenario.as_deref(), &args.camera).await?;
    let (session, scenario) = met;
    let pictures = args.pictures as usize;
    let plan = RecordingPlan { episodes, pictures, seed: args.seed, format: args.format };
    let page = args.watch.open()?;
    let mut recorder = Recorder::new(&scenario, plan, folder);
    if let Some(page) = &page {
        recorder = recorder.shown_on(page.feed());
    }
    let flight = flight::fly_on(session, &scenario, &options, &mut recorder).await?;
    let (count, failed) = recorder.land();
    let manifest = RecordingManifest {
        seed: args.seed,
        pictures: args.pictures,
        episodes: count,
        revision: crate::revision(),
        version: env!("CARGO_PKG_VERSION"),
        command: std::env::args().collect(),
        ended: FlightEnded::of(&flight),
    };
    let path = out.join(MANIFEST);
    let text = serde_json::to_string_pretty(&manifest)? + "\n";
    write_whole(&path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))?;
    println!("{count} episodes in {}", out.display());
    let exit = exit_of(&flight, failed);
    if let Some(page) = page {
        let reason = exit.as_ref().map_or("over", |exit| &exit.why);
        page.close(reason, serde_json::json!({ "episodes": count })).await;
    }
    exit.map_or(Ok(()), |exit| Err(exit.into()))
}
