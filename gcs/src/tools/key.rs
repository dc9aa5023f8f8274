//! `gcs key`: keys of message signing. The key itself is written into its file and nowhere else.

use std::path::PathBuf;

use anyhow::{Context, Result, anyhow, bail};
use clap::Subcommand;
use crpl_sitl::link::signing::{Key, Policy, Signing, Store};

/// Flags of `gcs key`.
#[derive(Debug, Clone, clap::Args)]
pub struct KeyArgs {
    #[command(subcommand)]
    action: KeyAction,
}

#[derive(Debug, Clone, Subcommand)]
enum KeyAction {
    /// Make a random key in a new file, which only its owner can read
    New {
        /// File for `--signing-key`
        file: PathBuf,
    },
    /// Print what tells a key from others, and gives nothing of it away
    ShowFingerprint {
        /// File of `--signing-key`
        file: PathBuf,
    },
}

/// Does what was asked.
///
/// # Errors
/// A file that is there already, or that cannot be read or written, or holds no key.
pub fn run(args: &KeyArgs) -> Result<()> {
    match &args.action {
        KeyAction::New { file } => {
            if file.exists() {
                bail!("{}: there is a file of this name; a key is never replaced", file.display());
            }
            let mut bytes = [0; 32];
            getrandom::fill(&mut bytes)
                .map_err(|error| anyhow!("the system gives no random bytes: {error}"))?;
            let key = Key::new(bytes).context("the system gives no random bytes")?;
            let fingerprint = key.fingerprint();
            Store::new(file).save(&Signing::new(Some(key), Policy::Required), true)?;
            crpl_sitl::outln!("{fingerprint}  {}", file.display());
        }
        KeyAction::ShowFingerprint { file } => {
            if !file.is_file() {
                bail!("{}: no such file", file.display());
            }
            let signing = Store::new(file).load(Policy::Required)?;
            let fingerprint = signing.fingerprint();
            let fingerprint = fingerprint.with_context(|| format!("{}: no key in it", file.display()))?;
            crpl_sitl::outln!("{fingerprint}  {}", file.display());
        }
    }
    Ok(())
}
