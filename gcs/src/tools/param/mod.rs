//! `gcs param`: the parameters of any MAVLink vehicle, listed, read, set, loaded and saved.
//!
//! | module | what it is |
//! |---|---|
//! | [`value`] | integers and floats in the four bytes of a parameter, both encodings |
//! | [`exchange`] | list, read, set; lost packets are asked for again |
//! | [`mod@file`] | `.param` and `.params` files |

pub mod exchange;
pub mod file;
pub mod value;

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use crpl_sitl::link::dialect::AUTOPILOT_VERSION_DATA;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::status::AutopilotVersion;

use crate::tools::fleet::Stack;
use crate::tools::session::{LinkFlags, Session};
use exchange::{List, Param, Read, Set, Written};
use value::{Encoding, Number};

/// Flags of `gcs param`.
#[derive(Debug, Clone, clap::Args)]
pub struct Params {
    #[command(flatten)]
    link: LinkFlags,
    #[command(subcommand)]
    action: ParamAction,
}

#[derive(Debug, Clone, Subcommand)]
enum ParamAction {
    /// Print all parameters
    List,
    /// Print some parameters
    Get {
        /// Names of the parameters
        #[arg(required = true)]
        names: Vec<String>,
    },
    /// Set one parameter
    Set {
        /// Name of the parameter
        name: String,
        /// New value; an integer for an integer parameter
        #[arg(allow_negative_numbers = true)]
        value: String,
    },
    /// Set all parameters of a file that differ
    Load {
        /// .param (NAME VALUE) or .params (QGroundControl)
        file: PathBuf,
    },
    /// Save all parameters to a file
    Save {
        /// .param (NAME VALUE) or .params (QGroundControl)
        file: PathBuf,
    },
}

/// Does what was asked and prints it.
///
/// # Errors
/// A file that does not read, no vehicle, and parameters that it refuses.
pub async fn run(args: Params) -> Result<()> {
    // What is wrong with the file is said before anybody is asked.
    let wanted = match &args.action {
        ParamAction::Load { file } => Some(file::read(file)?),
        _ => None,
    };
    let mut session = Session::open(&args.link).await?;
    let encoding = encoding(&mut session).await?;
    let target = session.target();
    match args.action {
        ParamAction::List => {
            for param in session.run(&mut List::new(target, encoding)).await? {
                crpl_sitl::outln!("{param}");
            }
        }
        ParamAction::Get { names } => {
            for name in names {
                crpl_sitl::outln!("{}", session.run(&mut Read::new(name, target, encoding)?).await?);
            }
        }
        ParamAction::Set { name, value } => {
            let before = session.run(&mut Read::new(name, target, encoding)?).await?;
            let value = Number::parse(&value, before.kind).with_context(|| before.name.clone())?;
            let set = set(&mut session, &before, value, target, encoding).await?;
            crpl_sitl::outln!("{set} (was {})", before.value);
        }
        ParamAction::Load { .. } => load(&mut session, &wanted.unwrap_or_default(), encoding).await?,
        ParamAction::Save { file } => {
            let params = session.run(&mut List::new(target, encoding)).await?;
            file::write(&file, &params, target)?;
            crpl_sitl::outln!("{} parameters in {}", params.len(), file.display());
        }
    }
    session.close().await;
    Ok(())
}

/// How the vehicle packs integers: as its capabilities say, or as its flight stack does.
async fn encoding(session: &mut Session) -> Result<Encoding> {
    const PARAM_ENCODE_BYTEWISE: u64 = 16;
    let stack = session.vehicle().map(|vehicle| vehicle.mode.stack);
    let version = session.request::<AUTOPILOT_VERSION_DATA>().await?;
    Ok(match version.and_then(|packet| AutopilotVersion::of(&packet)) {
        Some(AutopilotVersion { capabilities }) if capabilities & PARAM_ENCODE_BYTEWISE != 0 => {
            Encoding::Bytewise
        }
        None if stack == Some(Stack::Px4) => Encoding::Bytewise,
        _ => Encoding::CCast,
    })
}

/// Sets one parameter; an error if the vehicle keeps another value.
async fn set(
    session: &mut Session,
    param: &Param,
    value: Number,
    target: (u8, u8),
    encoding: Encoding,
) -> Result<Param> {
    match session.run_with(&mut Set::new(param, value, target, encoding)?, target).await? {
        Written::Taken(param) => Ok(param),
        Written::Kept(param) => {
            bail!("vehicle {} refused {} = {value} and keeps {}", target.0, param.name, param.value)
        }
    }
}

/// What became of the lines of a file.
#[derive(Debug, Default)]
struct LoadTally {
    changed: usize,
    same: usize,
    refused: usize,
}

async fn load(session: &mut Session, wanted: &[file::Line], encoding: Encoding) -> Result<()> {
    let target = session.target();
    let mut by_component: BTreeMap<(u8, u8), Vec<&file::Line>> = BTreeMap::new();
    for line in wanted {
        by_component.entry(line.of.unwrap_or(target)).or_default().push(line);
    }
    let mut tally = LoadTally::default();
    for (of, lines) in by_component {
        if of.0 != target.0 {
            let (first, count) = (lines[0].number, lines.len());
            crpl_sitl::outln!(
                "{count} parameters are for system {}, and this is {}: see --sysid (line {first} is the first)",
                of.0,
                target.0
            );
            tally.refused += count;
            continue;
        }
        load_component(session, &lines, of, encoding, &mut tally).await?;
    }
    let LoadTally { changed, same, refused } = tally;
    crpl_sitl::outln!("{changed} set, {same} as they were, {refused} refused");
    if refused > 0 {
        bail!("{refused} of {} parameters were not set", wanted.len());
    }
    Ok(())
}

/// Sets the lines of one component. A switch may make the vehicle have more parameters than before, so what it
/// did not have is looked for again as long as something was set.
async fn load_component(
    session: &mut Session,
    lines: &[&file::Line],
    of: (u8, u8),
    encoding: Encoding,
    tally: &mut LoadTally,
) -> Result<()> {
    let mut left: Vec<&file::Line> = lines.to_vec();
    loop {
        let known = session.run_with(&mut List::new(of, encoding), of).await?;
        let (here, missing): (Vec<_>, Vec<_>) =
            left.into_iter().partition(|line| known.iter().any(|param| param.name == line.name));
        let changed = tally.changed;
        for line in here {
            if let Some(param) = known.iter().find(|param| param.name == line.name) {
                load_line(session, line, param, of, encoding, tally).await;
            }
        }
        if missing.is_empty() {
            return Ok(());
        }
        if tally.changed == changed {
            for line in missing {
                crpl_sitl::outln!("{}: the vehicle has no such parameter (line {})", line.name, line.number);
                tally.refused += 1;
            }
            return Ok(());
        }
        left = missing;
    }
}

async fn load_line(
    session: &mut Session,
    line: &file::Line,
    param: &Param,
    of: (u8, u8),
    encoding: Encoding,
    tally: &mut LoadTally,
) {
    let done = match Number::parse(&line.value, param.kind) {
        Ok(value) if value == param.value => {
            tally.same += 1;
            return;
        }
        Ok(value) => set(session, param, value, of, encoding).await,
        Err(error) => Err(anyhow::Error::new(error).context(line.name.clone())),
    };
    match done {
        Ok(set) => {
            crpl_sitl::outln!("{set} (was {})", param.value);
            tally.changed += 1;
        }
        Err(error) => {
            crpl_sitl::outln!("{} (line {})", crpl_sitl::program::terminal::one_line(&error), line.number);
            tally.refused += 1;
        }
    }
}
