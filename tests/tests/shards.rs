//! What many machines make in shards is, merged, what one makes: sweeps over two axes, random worlds, training data.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use tests::program::{self, Finished};

fn run(program: &str, flags: &[&str]) -> Finished {
    program::run(program, flags).unwrap()
}

/// All files below a folder, by their paths in it; of a figure's PDF the name alone, as its tables have no order.
fn files(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![dir.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let is_pdf = path.extension().is_some_and(|ending| ending == "pdf");
                let bytes = if is_pdf { Vec::new() } else { std::fs::read(&path).unwrap() };
                found.insert(path.strip_prefix(dir).unwrap().into(), bytes);
            }
        }
    }
    found
}

fn assert_same(got: &Path, want: &Path) {
    let (got, want) = (files(got), files(want));
    let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&got), names(&want));
    for (name, bytes) in &want {
        assert!(got[name] == *bytes, "{} differs", name.display());
    }
}

/// Runs a command whole and in three shards, merges the shards, and gives merged and whole folder.
fn whole_and_merged(dir: &Path, [program, merger]: [&str; 2], flags: &[&str]) -> [PathBuf; 2] {
    let make = |name: &str, more: &[&str]| {
        let out = dir.join(name);
        run(program, &[flags, &["--out", out.to_str().unwrap()], more].concat()).good().unwrap();
        out
    };
    let whole = make("whole", &[]);
    let shards = ["1/3", "2/3", "3/3"].map(|shard| make(&shard.replace('/', "-"), &["--shard", shard]));
    let merged = dir.join("merged");
    let mut merge: Vec<&str> = vec!["merge"];
    // In any order.
    merge.extend([2, 0, 1].map(|n| shards[n].to_str().unwrap()));
    merge.extend(["--out", merged.to_str().unwrap()]);
    run(merger, &merge).good().unwrap();
    let refused = run(merger, &["merge", merge[1], merge[2], "--out", dir.join("refused").to_str().unwrap()]);
    assert!(refused.stderr.contains("missing: shard 2/3"), "{}", refused.stderr);
    [merged, whole]
}

#[test]
fn a_sweep_over_two_axes_is_one_table_and_a_figure() {
    let dir = tempfile::tempdir().unwrap();
    let flags = [
        "sweep",
        "--scenario",
        "demo",
        "--axis",
        "goal[1]=0.4:0.5:2",
        "--axis",
        "radio.b_dt=2.75,4",
        "--controller",
        "rcc,ucc",
        "--episodes",
        "5",
    ];
    let [merged, whole] = whole_and_merged(dir.path(), ["gcs", "gcs"], &flags);
    assert_same(&merged, &whole);
    let found = files(&whole);
    let named = |ending: &str| found.keys().filter(|name| name.to_string_lossy().ends_with(ending)).count();
    assert_eq!((named(".svg"), named(".png"), named("_points.csv")), (1, 1, 1), "{:?}", found.keys());
    let table = String::from_utf8(found[Path::new("points.csv")].clone()).unwrap();
    let points: Vec<Vec<&str>> =
        table.lines().map(|line| line.split(',').skip(1).take(3).collect()).collect();
    assert_eq!(points[0], ["x", "y", "controller"]);
    assert_eq!(points[1..3], [["0.4", "2.75", "rcc"], ["0.4", "2.75", "ucc"]]);
    assert_eq!((points.len(), &points[8][..]), (9, &["0.5", "4", "ucc"][..]));

    // What is there is not flown again, and a report knows two axes.
    let again = run("gcs", &[&flags[..], &["--out", whole.to_str().unwrap()]].concat()).good().unwrap();
    assert!(again.contains("goal[1] and radio.b_dt") && again.contains("the figure"), "{again}");
    let report = run("gcs", &["report", whole.to_str().unwrap()]).good().unwrap();
    assert!(report.contains("over goal[1] and radio.b_dt"), "{report}");
    let third = run("gcs", &[&flags[..], &["--axis", "uav_radius=0.02"]].concat());
    assert!(third.stderr.contains("one axis or two"), "{}", third.stderr);
}

/// Algorithm 1 in a moment; its policies are worth nothing.
const QUICK: &str = "attempts = 1\nrollouts = 32\nhorizon = 10\nstarts = 32\nwarm_iterations = [1, 1, 1]\n\
                     stage1_iterations = 2\nlast_iterations = 2\naveraged_iterations = 1\ncomparison_rollouts = 32\n\
                     stage2_rollouts = 32\nstage2_iterations = 2\ncheck_flights = 2\n";

#[test]
fn random_worlds_in_shards_are_one_table() {
    let dir = tempfile::tempdir().unwrap();
    let config = dir.path().join("quick.toml");
    std::fs::write(&config, QUICK).unwrap();
    let flags = ["optimise", "--random", "5", "--seed", "7", "--config", config.to_str().unwrap()];
    let [merged, whole] = whole_and_merged(dir.path(), ["gcs", "gcs"], &flags);
    assert_same(&merged, &whole);
    assert_eq!(std::fs::read_to_string(whole.join("worlds.jsonl")).unwrap().lines().count(), 5);

    // A run that was stopped goes on: its last line may be torn.
    let rows = whole.join("worlds.jsonl");
    let text = std::fs::read_to_string(&rows).unwrap();
    std::fs::write(&rows, &text[..text.len() - 9]).unwrap();
    let said = run("gcs", &[&flags[..], &["--out", whole.to_str().unwrap()]].concat()).good().unwrap();
    assert!(said.contains("5 worlds of seed 7"), "{said}");
    assert_same(&whole, &merged);
    let other = run("gcs", &["optimise", "--random", "6", "--out", whole.to_str().unwrap()]);
    assert!(other.stderr.contains("holds other worlds"), "{}", other.stderr);
}

#[test]
fn training_data_in_shards_is_one_folder() {
    let states = "[data]\nepisodes = 5\nedge_episodes = 2\n[predictor]\nepisodes = 3\n";
    let pictures = "[learned.recording]\nepisodes = 4\npictures = 5\n";
    for (config, more) in [(states, vec![]), (pictures, vec![]), (pictures, vec!["--format", "png"])] {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("small.toml");
        std::fs::write(&file, config).unwrap();
        let flags = [&["collect", "--config", file.to_str().unwrap()], &more[..]].concat();
        let [merged, whole] = whole_and_merged(dir.path(), ["model", "model"], &flags);
        assert_same(&merged, &whole);
        let again = run("model", &["merge", "whole", "--out", "x"]);
        assert!(!again.status.success());
    }
}
