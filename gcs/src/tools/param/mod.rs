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
/// The file cannot be read or written, no vehicle answers, or the vehicle refuses a name or a value.
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
                println!("{param}");
            }
        }
        ParamAction::Get { names } => {
            for name in names {
                println!("{}", session.run(&mut Read::new(name, target, encoding)?).await?);
            }
        }
        ParamAction::Set { name, value } => {
            let before = session.run(&mut Read::new(name, target, encoding)?).await?;
            let value = Number::parse(&value, before.kind).with_context(|| before.name.clone())?;
            let set = set(&mut session, &before, value, encoding).await?;
            println!("{set} (was {})", before.value);
        }
        ParamAction::Load { .. } => load(&mut session, &wanted.unwrap_or_default(), encoding).await?,
        ParamAction::Save { file } => {
            let params = session.run(&mut List::new(target, encoding)).await?;
            file::write(&file, &params, target)?;
            println!("{} parameters in {}", params.len(), file.display());
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
async fn set(session: &mut Session, param: &Param, value: Number, encoding: Encoding) -> Result<Param> {
    let target = session.target();
    match session.run(&mut Set::new(param, value, target, encoding)?).await? {
        Written::Taken(param) => Ok(param),
        Written::Kept(param) => {
            bail!("vehicle {} refused {} = {value} and keeps {}", target.0, param.name, param.value)
        }
    }
}

async fn load(session: &mut Session, wanted: &[file::Line], encoding: Encoding) -> Result<()> {
    let known = session.run(&mut List::new(session.target(), encoding)).await?;
    let (mut changed, mut same, mut refused) = (0, 0, 0);
    for line in wanted {
        let Some(param) = known.iter().find(|param| param.name == line.name) else {
            println!("{}: the vehicle has no such parameter (line {})", line.name, line.number);
            refused += 1;
            continue;
        };
        let done = match Number::parse(&line.value, param.kind) {
            Ok(value) if value == param.value => {
                same += 1;
                continue;
            }
            Ok(value) => set(session, param, value, encoding).await,
            Err(error) => Err(anyhow::Error::new(error).context(line.name.clone())),
        };
        match done {
            Ok(set) => {
                println!("{set} (was {})", param.value);
                changed += 1;
            }
            Err(error) => {
                println!("{} (line {})", crpl_sitl::program::terminal::one_line(&error), line.number);
                refused += 1;
            }
        }
    }
    println!("{changed} set, {same} as they were, {refused} refused");
    if refused > 0 {
        bail!("{refused} of {} parameters were not set", wanted.len());
    }
    Ok(())
}
