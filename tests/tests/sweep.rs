//! Sweeps by the real program: whatever ends it, whoever flies a shard, the bytes are the same; and
//! tools that share no code with us read the result.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::path::{Path, PathBuf};
use std::process::Command;

use crpl_gcs::lab::sweep::episode::SweepEpisode;
use crpl_sitl::sim::metric::Metric;
use tests::program::{self, Finished, Program, workspace};
use tests::python;

/// Flags of a small sweep, with pictures rendered and encoded like in a large one.
const SMALL: [&str; 8] = [
    "--config",
    "configs/sweep_bandwidth.toml",
    "--points",
    "2.5,4",
    "--episodes",
    "7",
    "--controller",
    "crpl,rcc,ucc",
];

fn gcs(flags: &[&str]) -> Finished {
    program::run("gcs", flags).unwrap()
}

fn sweep(out: &Path, flags: &[&str]) -> Finished {
    gcs(&[&["sweep", "--out", out.to_str().unwrap()], &SMALL[..], flags].concat())
}

/// Names and bytes of all files in a folder.
fn bytes(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<_> = std::fs::read_dir(dir)
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            (path.file_name().unwrap().to_str().unwrap().to_owned(), std::fs::read(path).unwrap())
        })
        .collect();
    files.sort();
    files
}

fn assert_same(got: &Path, want: &Path) {
    let (got, want) = (bytes(got), bytes(want));
    let names = |files: &[(String, Vec<u8>)]| files.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&want), ["episodes.csv", "episodes.parquet", "points.csv", "sweep.toml"]);
    assert_eq!(names(&got), names(&want));
    for ((name, got), (_, want)) in got.iter().zip(&want) {
        assert!(got == want, "{name} differs");
    }
}

#[test]
fn three_shares_merged_are_one_run() {
    let dir = tempfile::tempdir().unwrap();
    let whole = dir.path().join("whole");
    sweep(&whole, &["--threads", "2"]).good().unwrap();
    let shards: Vec<PathBuf> = (1..=3)
        .map(|n| {
            let out = dir.path().join(format!("shard-{n}"));
            sweep(&out, &["--shard", &format!("{n}/3"), "--threads", "1"]).good().unwrap();
            out
        })
        .collect();
    let merged = dir.path().join("merged");
    let [one, two, three] = [0, 1, 2].map(|n| shards[n].to_str().unwrap());
    gcs(&["merge", three, one, two, "--out", merged.to_str().unwrap()]).good().unwrap();
    assert_same(&merged, &whole);

    let merge = |dirs: &[&str]| {
        let out = dir.path().join("refused");
        let finished = gcs(&[&["merge", "--out", out.to_str().unwrap()], dirs].concat());
        assert!(!finished.status.success());
        finished.stderr
    };
    assert_eq!(merge(&[one, three]), "error: missing: shard 2/3");
    assert_eq!(merge(&[one, two, three, two]), format!("error: {two} and {two} both hold shard 2/3"));
    let other = dir.path().join("other");
    sweep(&other, &["--shard", "2/3", "--first-seed", "5"]).good().unwrap();
    let other = other.to_str().unwrap();
    assert_eq!(
        merge(&[one, other, three]),
        format!("error: {one} and {other} are of different sweeps: first_seed = 300000 and 5")
    );
    std::fs::rename(shards[1].join("episodes.csv"), shards[1].join("episodes.part.csv")).unwrap();
    assert_eq!(merge(&[one, two, three]), format!("error: {two} is not finished: fly its shard 2/3 again"));
}

#[test]
fn a_sweep_that_was_killed_goes_on_without_loss() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, cut) = (dir.path().join("whole"), dir.path().join("cut"));
    sweep(&whole, &[]).good().unwrap();

    // Killed without warning as soon as a few episodes are written down.
    let flags = [&["sweep", "--out", cut.to_str().unwrap()], &SMALL[..]].concat();
    let program = Program::start("gcs", &flags, None).unwrap();
    let part = cut.join("episodes.part.csv");
    let lines = || std::fs::read_to_string(&part).map_or(0, |text| text.lines().count());
    while lines() < 4 && !cut.join("episodes.csv").exists() {
        std::thread::yield_now();
    }
    drop(program);
    // A machine that loses power can leave half a line, too.
    if let Ok(mut text) = std::fs::read_to_string(&part) {
        let torn = text.trim_end().len() - 3;
        text.truncate(torn);
        std::fs::write(&part, text).unwrap();
    }
    sweep(&cut, &[]).good().unwrap();
    assert_same(&cut, &whole);
}

/// A git repository in `folder` with one empty commit, and a copy of `gcs` in it.
fn repository(folder: &Path) -> PathBuf {
    git(folder, &["init", "-q"]);
    commit(folder);
    let program = folder.join("gcs");
    std::fs::copy(program::path("gcs").unwrap(), &program).unwrap();
    program
}

fn commit(folder: &Path) {
    let author = ["-c", "user.name=x", "-c", "user.email=x", "-c", "commit.gpgsign=false"];
    git(folder, &[&author[..], &["commit", "-q", "--allow-empty", "-m", "x"]].concat());
}

fn git(folder: &Path, args: &[&str]) -> String {
    let output = Command::new("git").arg("-C").arg(folder).args(args).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

#[test]
fn the_revision_is_that_of_the_build_wherever_the_program_lies() {
    let dir = tempfile::tempdir().unwrap();
    let mut command = Command::new(repository(dir.path()));
    command.current_dir(dir.path()).args(["demo", "--controller", "rcc", "--out", "run"]);
    Program::spawn("gcs", command).unwrap().wait().unwrap().good().unwrap();
    let run = std::fs::read_to_string(dir.path().join("run/rcc/run.json")).unwrap();
    let run: serde_json::Value = serde_json::from_str(&run).unwrap();
    assert_eq!(run["revision"], crpl_gcs::revision());
    assert_ne!(run["revision"], *git(dir.path(), &["rev-parse", "HEAD"]));
    if let Some(head) = crpl_gcs::revision().get(..40) {
        git(workspace(), &["cat-file", "-e", head]);
    }
}

#[test]
fn a_commit_does_not_stop_a_sweep_from_going_on() {
    let dir = tempfile::tempdir().unwrap();
    let (program, out) = (repository(dir.path()), dir.path().join("sweep"));
    let run = || {
        let mut command = Command::new(&program);
        command.current_dir(workspace()).args(["sweep", "--out", out.to_str().unwrap()]).args(SMALL);
        Program::spawn("gcs", command).unwrap().wait().unwrap().good().unwrap();
        bytes(&out)
    };
    let whole = run();
    // What a sweep leaves that was stopped in its middle.
    let episodes = std::fs::read_to_string(out.join("episodes.csv")).unwrap();
    let half: String = episodes.lines().take(20).map(|line| format!("{line}\n")).collect();
    std::fs::write(out.join("episodes.part.csv"), half).unwrap();
    for name in ["episodes.csv", "episodes.parquet", "points.csv"] {
        std::fs::remove_file(out.join(name)).unwrap();
    }
    commit(dir.path());
    assert!(run() == whole);
}

#[test]
fn a_folder_of_another_sweep_is_not_touched() {
    let dir = tempfile::tempdir().unwrap();
    sweep(dir.path(), &[]).good().unwrap();
    let before = bytes(dir.path());
    let refused = sweep(dir.path(), &["--first-seed", "1"]);
    assert!(!refused.status.success());
    let error = refused.stderr;
    assert!(error.contains("holds another sweep: first_seed = 1 and 300000 there"), "{error}");
    assert!(bytes(dir.path()) == before);
}

#[test]
fn gnu_parallel_flies_the_same_sweep() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, shared) = (dir.path().join("whole"), dir.path().join("shared"));
    sweep(&whole, &[]).good().unwrap();
    let mut command = Command::new(workspace().join("docs/scaling/parallel.sh"));
    command
        .current_dir(workspace())
        .env("GCS", program::path("gcs").unwrap())
        .env("HOME", dir.path())
        .args([SMALL[1], "3"])
        .arg(&shared)
        .args(&SMALL[2..]);
    let output = Program::spawn("parallel.sh", command).unwrap().wait().unwrap();
    output.good().unwrap();
    assert_same(&shared.join("whole"), &whole);
}

#[test]
fn duckdb_reads_in_the_parquet_what_the_csv_says() {
    let dir = tempfile::tempdir().unwrap();
    sweep(dir.path(), &[]).good().unwrap();
    let said = python::script("read_parquet.py", &[dir.path()]).unwrap().good().unwrap();
    let columns = SweepEpisode::head(1).count();
    assert_eq!(said, format!("42 rows, {columns} columns, 0 differences, sweep.toml inside"));
}

#[test]
fn a_report_is_one_page_that_needs_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    sweep(dir.path(), &[]).good().unwrap();
    let said = gcs(&["report", dir.path().to_str().unwrap()]).good().unwrap();
    // Claims of the paper, judged by the numbers; one that was not flown is said to be so.
    assert!(said.contains("d_f: rcc over crpl at 2.5") && said.contains("not flown"), "{said}");
    let report = dir.path().join("report");
    let names: Vec<String> = bytes(&report).into_iter().map(|(name, _)| name).collect();
    let tables = ["bandwidth.csv", "bandwidth.pdf", "bandwidth.png", "bandwidth.svg", "bandwidth.txt"];
    let others = ["bandwidth_points.csv", "index.html", "redraw.py", "verdicts.csv"];
    assert_eq!(names, [&tables[..], &others].concat());
    let page = std::fs::read_to_string(report.join("index.html")).unwrap();
    assert_eq!(page.matches("role=\"img\"").count(), Metric::of_paper().count());
    assert_eq!(page.matches("<script").count(), 1, "that which sorts the tables");
    for outside in [" src=", "<img", "<link", "url(", "@import"] {
        assert!(!page.contains(outside), "{outside}");
    }
    let points = std::fs::read(dir.path().join("points.csv")).unwrap();
    assert!(std::fs::read(report.join("bandwidth.csv")).unwrap() == points);

    let refused = gcs(&["report", "configs"]);
    assert!(!refused.status.success());
    assert!(refused.stderr.starts_with("error: configs is not a sweep's folder"), "{}", refused.stderr);
    assert!(!workspace().join("configs/report").exists());
}
