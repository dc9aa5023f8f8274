//! What a new user wants first, by README's own commands, from an empty folder: at most three for each.
//!
//! With `GOALS_ROOT=DIR` they run on another machine's file system, by chroot: DIR has the .deb installed, bash and
//! python3, and nothing else is needed (`packaging/check`).
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::io::{Read, Write};
use std::net::{TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::Command;

use tests::program::{self, Program, workspace};

/// The heading of each goal in README, and its commands.
fn goals() -> Vec<(String, Vec<String>)> {
    let text = std::fs::read_to_string(workspace().join("README.md")).unwrap();
    let (_, rest) = text.split_once("<!-- goals -->").unwrap();
    let block = rest.split("```").nth(1).unwrap();
    let mut goals: Vec<(String, Vec<String>)> = Vec::new();
    for line in block.lines().skip(1) {
        match line.strip_prefix("# ") {
            Some(heading) => goals.push((heading.to_owned(), Vec::new())),
            None => goals.last_mut().unwrap().1.push(line.to_owned()),
        }
    }
    goals
}

/// A UDP port that nobody has.
fn free_port() -> String {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port().to_string()
}

/// The commands of the goal whose heading has `word`, run in `dir` by a shell that ends what they leave running.
fn start(word: &str, dir: &Path) -> Program {
    let goals = goals();
    let (heading, commands) = goals.iter().find(|(heading, _)| heading.contains(word)).unwrap();
    assert!((1..=3).contains(&commands.len()), "{heading}: {commands:?}");
    // A command that is alone takes the shell's place, so that it ends with it.
    let alone = if commands.len() == 1 { "exec " } else { "" };
    let text = format!("{alone}{}", commands.join("\n"))
        .replace("14550", &free_port())
        .replace("14551", &free_port());
    let text = format!("trap 'kill $(jobs -p) 2>/dev/null || true' EXIT\n{text}");
    let mut shell = match root() {
        Some(root) => {
            let home = Path::new("/").join(dir.strip_prefix(&root).unwrap());
            let mut shell = Command::new("chroot");
            shell.arg(root).args(["/usr/bin/env", "-i", "-C"]).arg(&home);
            shell.arg(format!("HOME={}", home.display())).args(["PATH=/usr/bin:/bin", "bash"]);
            shell
        }
        None => {
            let programs = program::path("gcs").unwrap();
            let path = std::env::var("PATH").unwrap();
            let mut shell = Command::new("bash");
            shell.env("PATH", format!("{}:{path}", programs.parent().unwrap().display()));
            shell.current_dir(dir).env("HOME", dir);
            shell
        }
    };
    shell.args(["-euo", "pipefail", "-c", &text]);
    Program::spawn(word, shell).unwrap()
}

fn run(word: &str, dir: &Path) -> String {
    start(word, dir).wait().unwrap().good().unwrap()
}

/// The root of the file system that has the installed packages, if it is not this machine's.
fn root() -> Option<PathBuf> {
    std::env::var_os("GOALS_ROOT").map(PathBuf::from)
}

/// An empty folder, but for the examples.
fn empty() -> tempfile::TempDir {
    let (dir, examples) = match root() {
        Some(root) => {
            (tempfile::tempdir_in(root.join("tmp")).unwrap(), "/usr/share/doc/crpl/examples".into())
        }
        None => (tempfile::tempdir().unwrap(), workspace().join("examples")),
    };
    std::os::unix::fs::symlink(examples, dir.path().join("examples")).unwrap();
    dir
}

#[test]
fn there_are_five() {
    assert_eq!(goals().len(), 5, "{:?}", goals());
}

#[test]
fn a_controller_of_ones_own_is_scored_beside_crpl() {
    let said = run("controller", empty().path());
    assert!(said.contains("exec:python3 examples/pid.py") && said.contains("over crpl"), "{said}");
}

#[test]
fn a_scene_of_ones_own_is_flown_by_crpl() {
    let dir = empty();
    let said = run("scene", dir.path());
    assert!(said.contains("straight to the goal") && said.contains("reached the goal"), "{said}");
    assert!(dir.path().join("runs/demo/crpl/record.jsonl").is_file());
    let flown = std::fs::read_to_string(dir.path().join("runs/demo/crpl/config.toml")).unwrap();
    assert!(flown.contains("mine"), "{flown}");
}

#[test]
fn pictures_become_a_data_set() {
    let dir = empty();
    run("Pictures", dir.path());
    let episode = dir.path().join("runs/mine/episode-00000");
    assert!(episode.join("00000.png").is_file() && episode.join("steps.csv").is_file());
}

#[test]
fn a_radio_stands_between_a_vehicle_and_a_station() {
    let said = run("radio", empty().path());
    assert!(said.contains("SYSID_THISMAV"), "{said}");
}

#[test]
fn a_flight_is_watched_in_a_browser() {
    let dir = empty();
    let program = start("browser", dir.path());
    program.logs("watch: http://").unwrap();
    let said = program.so_far();
    let address = said.lines().find_map(|line| line.strip_prefix("watch: http://")).unwrap();
    let host = address.split('/').next().unwrap();
    let mut page = TcpStream::connect(host).unwrap();
    write!(page, "GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    let mut text = String::new();
    page.read_to_string(&mut text).unwrap();
    assert!(text.starts_with("HTTP/1.1 200") && text.contains("<title>"), "{text:.300}");
}
