//! `gcs mission`: missions of any MAVLink vehicle, uploaded, downloaded and cleared.
//!
//! | module | what it is |
//! |---|---|
//! | [`item`] | a waypoint or another item, and its bytes |
//! | [`exchange`] | upload, download, clear; lost packets are asked for again |
//! | [`mod@file`] | QGroundControl's `.plan`, and `QGC WPL 110` text |

#![expect(deprecated, reason = "vehicles still use what the standard has superseded")]

pub mod exchange;
pub mod file;
pub mod item;

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Subcommand;

use crate::tools::fleet::Stack;
use crate::tools::session::{LinkFlags, Session};
use exchange::{Clear, Download, Upload};
use file::MissionPlan;

/// Flags of `gcs mission`.
#[derive(Debug, Clone, clap::Args)]
pub struct Missions {
    #[command(flatten)]
    link: LinkFlags,
    #[command(subcommand)]
    action: MissionAction,
}

#[derive(Debug, Clone, Subcommand)]
enum MissionAction {
    /// Upload a mission file
    Upload {
        /// .plan (QGroundControl) or `QGC WPL 110` text
        file: PathBuf,
    },
    /// Download the vehicle's mission to a file
    Download {
        /// .plan (QGroundControl); with any other ending `QGC WPL 110` text
        file: PathBuf,
    },
    /// Clear the vehicle's mission
    Clear,
}

/// Does what was asked and prints it.
///
/// # Errors
/// The file cannot be read or written, no vehicle answers, or the vehicle refuses the mission.
pub async fn run(args: Missions) -> Result<()> {
    // What is wrong with the file is said before anybody is asked.
    let plan = match &args.action {
        MissionAction::Upload { file } => Some(file::read(file)?),
        _ => None,
    };
    let mut session = Session::open(&args.link).await?;
    let target = session.target();
    // ArduPilot's item 0 is home.
    let ardupilot = session.vehicle().is_some_and(|vehicle| vehicle.mode.stack == Stack::ArduPilot);
    match args.action {
        MissionAction::Upload { file } => {
            let plan = plan.unwrap_or_default();
            let items = plan.items_for(ardupilot);
            if items.is_empty() {
                bail!("{}: no item in it; `gcs mission clear` clears a mission", file.display());
            }
            let count = items.len();
            session.run(&mut Upload::new(items, target)).await?;
            println!("{count} items uploaded to vehicle {}", target.0);
        }
        MissionAction::Download { file } => {
            let items = session.run(&mut Download::new(target)).await?;
            let count = items.len();
            MissionPlan::downloaded(items, ardupilot).write(&file)?;
            println!("{count} items in {}", file.display());
        }
        MissionAction::Clear => {
            session.run(&mut Clear::new(target)).await?;
            println!("vehicle {} has no mission any more", target.0);
        }
    }
    session.close().await;
    Ok(())
}
