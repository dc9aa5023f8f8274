//! The Python package `crpl`: its wheel is built, its tests and examples run, and its types are right.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;

use tests::program::{self, Program, profile_folder, workspace};
use tests::python;

/// The folder with the installed package, of a wheel that is built once.
fn site() -> PathBuf {
    static SITE: OnceLock<PathBuf> = OnceLock::new();
    SITE.get_or_init(|| {
        let python = python::package_environment().unwrap().join("python");
        let target = profile_folder().unwrap().parent().unwrap().to_path_buf();
        let folder = target.join("python-package/wheel");
        std::fs::remove_dir_all(&folder).or_else(|e| if folder.exists() { Err(e) } else { Ok(()) }).unwrap();
        let mut build = Command::new(&python);
        build.args(["-m", "maturin", "build", "--release", "--locked", "--offline", "--manifest-path"]);
        build.arg(workspace().join("gcs/python/Cargo.toml")).arg("--out").arg(&folder);
        run("maturin", build.env("CARGO_TARGET_DIR", &target).env_remove("RUSTFLAGS"));
        let wheel = std::fs::read_dir(&folder).unwrap().next().unwrap().unwrap().path();
        let name = wheel.file_name().unwrap().to_string_lossy().into_owned();
        assert!(name.contains("-cp311-abi3-"), "{name}: not for every later Python");
        let site = folder.join("site");
        let mut install = Command::new(&python);
        install.args(["-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target"]);
        run("pip", install.arg(&site).arg(wheel));
        site
    })
    .clone()
}

fn run(name: &str, command: &mut Command) -> String {
    let output = command.output().unwrap();
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{name} ended with {}\n{out}{err}", output.status);
    out.into_owned()
}

/// Python with the package, from the workspace's root.
fn package(args: &[&str]) -> String {
    let mut command = Command::new(python::package_environment().unwrap().join("python"));
    command.args(args).current_dir(workspace()).env("PYTHONPATH", site()).env("PYTHONDONTWRITEBYTECODE", "1");
    command.env("CRPL_GCS", program::path("gcs").unwrap()).env("SITL", program::path("sitl").unwrap());
    command.env("CRPL_CACHE", profile_folder().unwrap().join("no-policies"));
    Program::spawn(args[0], command).unwrap().wait().unwrap().good().unwrap()
}

#[test]
fn its_own_tests_pass() {
    let out = package(&["-m", "pytest", "-q", "-p", "no:cacheprovider", "gcs/python/tests"]);
    assert!(out.contains(" passed") && !out.contains("skipped"), "{out}");
}

#[test]
fn its_types_are_right() {
    let site = site().join("crpl");
    assert!(site.join("py.typed").is_file() && site.join("_crpl.pyi").is_file());
    package(&["-m", "mypy", "--config-file", "gcs/python/pyproject.toml", "gcs/python/package/crpl"]);
}

#[test]
fn a_controller_in_python_is_scored_beside_crpl() {
    let out = package(&["examples/python/pid.py", "4"]);
    assert!(
        ["pd", "crpl", "rcc"].iter().all(|name| out.contains(name)) && out.contains("p_coll_max"),
        "{out}"
    );
}

#[test]
fn the_companion_behind_sitl_is_tested() {
    let out = package(&["-m", "pytest", "-q", "-p", "no:cacheprovider", "examples/python/test_companion.py"]);
    assert!(out.contains("1 passed"), "{out}");
}
