//! The page in a real browser: the packages of `tests/browser`, installed once beside the build by `npm ci`,
//! and the distribution's Chromium. The scripts look for the browser themselves.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::program::{Finished, Program, checked, profile_folder};

/// The packages, each with its version and the hash of its archive.
const LOCK: &str = include_str!("../browser/package-lock.json");
const PACKAGE: &str = include_str!("../browser/package.json");

/// The folder of the installed packages. Made at the first call and kept beside the build; other tests and
/// other processes wait meanwhile.
///
/// # Errors
/// There is no npm, or it cannot install.
fn packages() -> Result<PathBuf> {
    let profile = profile_folder()?;
    let home = profile.parent().context("the profile's folder has no parent")?.join("browser");
    fs::create_dir_all(&home).with_context(|| format!("making {}", home.display()))?;
    let lock = File::create(home.join("lock")).context("making the packages' lock")?;
    lock.lock().context("waiting for the packages' lock")?;

    let made = home.join("made-of.json");
    if !fs::read_to_string(&made).is_ok_and(|text| text == LOCK) {
        fs::write(home.join("package.json"), PACKAGE).context("writing package.json")?;
        fs::write(home.join("package-lock.json"), LOCK).context("writing package-lock.json")?;
        let flags = ["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error"];
        checked(Command::new("npm").args(flags).current_dir(&home))
            .context("installing the browser tests' packages; npm comes by tests/prepare")?;
        fs::write(&made, LOCK).context("noting what the packages are made of")?;
    }
    Ok(home.join("node_modules"))
}

/// Runs `tests/browser/NAME` to its end.
///
/// # Errors
/// The packages cannot be installed, or the script does not end in time.
pub fn script<A: AsRef<std::ffi::OsStr>>(name: &str, args: &[A]) -> Result<Finished> {
    let script = folder().join(name);
    let mut command = Command::new("node");
    command.arg(script).args(args).env("NODE_PATH", packages()?);
    Program::spawn(name, command)?.wait()
}

/// Where the scripts lie.
#[must_use]
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("browser")
}
