//! `gcs mission`: missions, fences and rally points of any MAVLink vehicle, uploaded, downloaded and cleared.
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

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use crpl_sitl::link::dialect::{HOME_POSITION_DATA, MavMessage};

use crate::tools::fleet::Stack;
use crate::tools::session::{LinkFlags, Session};
use crate::tools::texts::{SaidText, Texts};
use exchange::{Clear, Download, ListKind, Upload};
use file::MissionPlan;
use item::Item;

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
        /// Leave out the fence and the rally points of a .plan
        #[arg(long)]
        mission_only: bool,
    },
    /// Download the vehicle's mission to a file
    Download {
        /// .plan (QGroundControl), with fence and rally points; with any other ending `QGC WPL 110` text
        file: PathBuf,
    },
    /// Clear the vehicle's mission
    Clear {
        /// Clear the fence and the rally points, too
        #[arg(long)]
        all: bool,
    },
}

/// How long a vehicle is listened to that finds fault with a mission after it has accepted it, as PX4 does.
const SECOND_THOUGHTS: Duration = Duration::from_millis(1500);

/// Does what was asked and prints it.
///
/// # Errors
/// A file that does not read, no vehicle, and a transfer that the vehicle refuses.
pub async fn run(args: Missions) -> Result<()> {
    // What is wrong with the file is said before anybody is asked.
    let plan = match &args.action {
        MissionAction::Upload { file, .. } => Some(file::read(file)?),
        _ => None,
    };
    let mut session = Session::open(&args.link).await?;
    let target = session.target();
    // ArduPilot's item 0 is home.
    let ardupilot = session.vehicle().is_some_and(|vehicle| vehicle.mode.stack == Stack::ArduPilot);
    match args.action {
        MissionAction::Upload { file, mission_only } => {
            let mut plan = plan.unwrap_or_default();
            if mission_only {
                plan = MissionPlan { home: plan.home, items: plan.items, ..MissionPlan::default() };
            }
            upload(&mut session, &plan, ardupilot).await.with_context(|| file.display().to_string())?;
        }
        MissionAction::Download { file } => download(&mut session, &file, ardupilot).await?,
        MissionAction::Clear { all } => {
            let kind = if all { ListKind::All } else { ListKind::Mission };
            session.run(&mut Clear::of(kind, target)).await?;
            crpl_sitl::outln!("vehicle {} has no {kind} any more", target.0);
        }
    }
    session.close().await;
    Ok(())
}

/// Uploads each list that the file has; what came before a list that is refused is said.
async fn upload(session: &mut Session, plan: &MissionPlan, ardupilot: bool) -> Result<()> {
    let target = session.target();
    let lists = [
        (ListKind::Mission, plan.items_for(ardupilot)?),
        (ListKind::Fence, plan.fence.clone()),
        (ListKind::Rally, plan.rally.clone()),
    ];
    if lists.iter().all(|(_, items)| items.is_empty()) {
        bail!("no item in it; `gcs mission clear` clears a mission");
    }
    for (kind, items) in lists.into_iter().filter(|(_, items)| !items.is_empty()) {
        let count = items.len();
        let told = || match kind {
            ListKind::Mission => "its mission is not uploaded".to_owned(),
            _ => format!("its {kind} is not uploaded (--mission-only leaves it out)"),
        };
        session.run(&mut Upload::of(kind, items, target)).await.with_context(told)?;
        if kind == ListKind::Mission {
            crpl_sitl::outln!("{count} items uploaded to vehicle {}", target.0);
            second_thoughts(session).await?;
        } else {
            crpl_sitl::outln!("{kind}: {count} items uploaded to vehicle {}", target.0);
        }
    }
    Ok(())
}

/// PX4 accepts a mission, and then says in words that it will not fly it.
async fn second_thoughts(session: &mut Session) -> Result<()> {
    if session.vehicle().is_none_or(|vehicle| vehicle.mode.stack != Stack::Px4) {
        return Ok(());
    }
    let mut texts = Texts::default();
    let heard = session.listen(SECOND_THOUGHTS).await?;
    let mut said: Vec<SaidText> = heard.iter().flat_map(|packet| texts.packet(packet)).collect();
    said.extend(texts.unfinished());
    for SaidText { text, .. } in said {
        let lower = text.to_lowercase();
        if lower.contains("mission") && ["reject", "invalid", "not valid"].iter().any(|w| lower.contains(w)) {
            bail!("the vehicle will not fly it: {text}");
        }
    }
    Ok(())
}

/// Downloads the mission, and for a plan the other lists as far as the vehicle has them.
async fn download(session: &mut Session, file: &Path, ardupilot: bool) -> Result<()> {
    let target = session.target();
    let items = session.run(&mut Download::new(target)).await?;
    let count = items.len();
    let mut plan = MissionPlan::downloaded(items, ardupilot);
    if plan.home.is_none() && count > 0 {
        plan.home = home(session).await?;
    }
    if file.extension().is_some_and(|end| end == "plan") {
        for (kind, list) in [(ListKind::Fence, &mut plan.fence), (ListKind::Rally, &mut plan.rally)] {
            match session.run(&mut Download::of(kind, target)).await {
                Ok(items) => *list = items,
                Err(error) => tracing::warn!("{kind}: not downloaded: {error:#}"),
            }
        }
    }
    plan.write(file)?;
    crpl_sitl::outln!("{count} items in {}", file.display());
    Ok(())
}

/// Where the vehicle's home is, if it says so.
async fn home(session: &mut Session) -> Result<Option<Item>> {
    let packet = session.request::<HOME_POSITION_DATA>().await?;
    let Some(MavMessage::HOME_POSITION(home)) = packet.and_then(|packet| packet.message()) else {
        return Ok(None);
    };
    let [x, y] = [home.latitude, home.longitude].map(|v| f64::from(v) / 1e7);
    let z = home.altitude as f32 / 1e3;
    Ok(Some(Item { frame: 0, command: 16, current: true, autocontinue: true, params: [0.0; 4], x, y, z }))
}
