//! The Python peers, which share none of our mistakes: a virtual environment that the tests make
//! themselves, once, and the scripts of `tests/python`.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::program::{Finished, Program, checked, profile_folder};

/// The packages, each with its version and the hashes of its wheels.
const REQUIREMENTS: &str = include_str!("../python/requirements.txt");

/// What builds and tests the Python package.
const PACKAGE_REQUIREMENTS: &str = include_str!("../python/requirements-package.txt");

/// What stands beside the system's PyTorch.
const TORCH_REQUIREMENTS: &str = include_str!("../python/requirements-torch.txt");

/// The interpreter that sees the system's packages; another one in front of it in PATH may not.
const SYSTEM_PYTHON: &str = "/usr/bin/python3";

/// The folder of the environment's programs. Made at the first call and kept beside the build; other
/// tests and other processes wait meanwhile.
///
/// # Errors
/// The environment cannot be made.
pub fn environment() -> Result<PathBuf> {
    made("python", "python3", &[], REQUIREMENTS)
}

/// An environment with maturin, pytest and what the Python package `crpl` depends on. The package itself is not in it.
///
/// # Errors
/// The environment cannot be made.
pub fn package_environment() -> Result<PathBuf> {
    made("python-package", "python3", &[], PACKAGE_REQUIREMENTS)
}

/// The same with the system's PyTorch, and ONNX Runtime: for [`torch_script`]. A machine without
/// PyTorch is told what to install.
///
/// # Errors
/// The environment cannot be made.
pub fn torch_environment() -> Result<PathBuf> {
    let found = Command::new(SYSTEM_PYTHON).args(["-c", "import torch, numpy, venv, ensurepip"]).output();
    if !found.is_ok_and(|output| output.status.success()) {
        bail!(
            "{SYSTEM_PYTHON} lacks PyTorch or venv: apt-get install --no-install-recommends python3-torch python3-venv"
        );
    }
    made("python-torch", SYSTEM_PYTHON, &["--system-site-packages"], TORCH_REQUIREMENTS)
}

/// The virtual environment `name` beside the build, made of `requirements`.
fn made(name: &str, python: &str, flags: &[&str], requirements: &str) -> Result<PathBuf> {
    let profile = profile_folder()?;
    let home = profile.parent().context("the profile's folder has no parent")?.join(name);
    fs::create_dir_all(&home).with_context(|| format!("making {}", home.display()))?;
    let lock = File::create(home.join("lock")).context("making the environment's lock")?;
    lock.lock().context("waiting for the environment's lock")?;

    let (venv, made) = (home.join("venv"), home.join("made-of.txt"));
    if !fs::read_to_string(&made).is_ok_and(|text| text == requirements) {
        let list = home.join("requirements.txt");
        fs::write(&list, requirements).context("writing the requirements")?;
        checked(Command::new(python).args(["-m", "venv", "--clear"]).args(flags).arg(&venv))?;
        checked(
            Command::new(venv.join("bin/python"))
                .args(["-m", "pip", "install", "--quiet", "--no-input", "--disable-pip-version-check"])
                // What is imported is compiled then; MAVLink's dialects are 90 MB, of which one is used.
                .args(["--no-deps", "--no-compile", "-r"])
                .arg(&list),
        )?;
        fs::write(&made, requirements).context("noting what the environment is made of")?;
    }
    Ok(venv.join("bin"))
}

/// Runs `tests/python/NAME` to its end.
///
/// # Errors
/// The environment cannot be made, or the script does not end in time.
pub fn script<A: AsRef<std::ffi::OsStr>>(name: &str, args: &[A]) -> Result<Finished> {
    run_in(&environment()?, name, args)
}

/// Runs `tests/python/NAME`, which needs PyTorch or ONNX Runtime, to its end.
///
/// # Errors
/// The environment cannot be made, or the script does not end in time.
pub fn torch_script<A: AsRef<std::ffi::OsStr>>(name: &str, args: &[A]) -> Result<Finished> {
    run_in(&torch_environment()?, name, args)
}

fn run_in<A: AsRef<std::ffi::OsStr>>(bin: &Path, name: &str, args: &[A]) -> Result<Finished> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("python").join(name);
    let mut command = Command::new(bin.join("python"));
    command.arg("-u").arg(script).args(args);
    Program::spawn(name, command)?.wait()
}

/// A program that came with a package, such as `mavproxy.py`, to be given its arguments.
///
/// # Errors
/// The environment cannot be made.
pub fn tool(name: &str) -> Result<Command> {
    let bin = environment()?;
    let mut command = Command::new(bin.join("python"));
    command.arg("-u").arg(bin.join(name));
    Ok(command)
}

/// What pymavlink's own `mavlogdump.py` prints of a tlog, and what it complains of.
///
/// # Errors
/// The tool fails.
pub fn mavlogdump(tlog: &Path) -> Result<String> {
    read_log("mavlogdump.py", tlog)
}

/// What pymavlink's own `mavloss.py` prints of a tlog: the gaps in each sender's sequence. (It counts
/// right; `mavlogdump.py --show-loss` takes its own second reading of the file for a gap.)
///
/// # Errors
/// The tool fails.
pub fn mavloss(tlog: &Path) -> Result<String> {
    read_log("mavloss.py", tlog)
}

fn read_log(name: &str, tlog: &Path) -> Result<String> {
    let mut command = tool(name)?;
    command.arg(tlog);
    let finished = Program::spawn(name, command)?.wait()?;
    let complaints = finished.stderr.clone();
    Ok(finished.good()? + &complaints)
}
