//! What the claim rests on: baselines as good as their gains can be, a bound that nobody passes, an edge that CRPL
//! keeps off, and claims counted over the values that the paper omits.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::path::Path;

use serde_json::Value;
use tests::program;

fn gcs(args: &[&str]) -> String {
    program::run("gcs", args).unwrap().good().unwrap()
}

fn lines(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The `[law]` of a file of `gcs tune`.
fn law(path: &Path) -> String {
    let text = std::fs::read_to_string(path).unwrap();
    let law = text.split("[law]").nth(1).unwrap().split("[found]").next().unwrap();
    law.trim().to_owned()
}

#[test]
fn the_shipped_gains_are_what_tune_finds() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().unwrap();
    for controller in ["rcc", "ucc"] {
        let said = gcs(&["tune", "--controller", controller, "--out", out]);
        assert!(said.contains("position_gain x 0.5"), "{said}");
        let name = format!("{controller}.toml");
        let shipped = program::workspace().join("configs").join(&name);
        assert_eq!(law(&dir.path().join(&name)), law(&shipped), "{controller}");
    }
}

#[test]
fn gains_of_ones_own_fly_as_rcc_and_leave_the_untuned_ones_alone() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("mine.toml");
    let text = std::fs::read_to_string(program::workspace().join("configs/rcc.toml")).unwrap();
    let mine: Vec<&str> =
        text.lines().map(|l| if l.starts_with("steps") { "steps = 3" } else { l }).collect();
    std::fs::write(&path, mine.join("\n")).unwrap();
    let fly = |more: &[&str]| {
        let base = ["episodes", "--controller", "rcc,rcc-paper,ucc", "--episodes", "4", "--json"];
        lines(&gcs(&[&base[..], more].concat()))
    };
    let (shipped, own) = (fly(&[]), fly(&["--gains", path.to_str().unwrap()]));
    assert_ne!(shipped[0]["j"], own[0]["j"]);
    assert_eq!(shipped[1..], own[1..]);
}

#[test]
fn nobody_is_better_than_the_oracle_at_what_the_oracle_optimises() {
    let args =
        ["bound", "--episodes", "40", "--first-seed", "7000", "--controller", "crpl,rcc,rcc-paper", "--json"];
    let bounds = &lines(&gcs(&args))[0];
    let rows = bounds["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 4);
    assert_eq!((rows[0]["controller"].as_str(), rows[0]["keeps"].as_bool()), (Some("apc"), Some(true)));
    for row in &rows[1..] {
        // The whole interval of what it costs more than APC on the same seeds.
        assert!(row["more"]["ci"][0].as_f64().unwrap() > 0.0, "{row}");
    }
    let number = |key: &str| bounds[key].as_f64().unwrap();
    assert!(number("unconstrained") < number("constrained"));
    let j = rows.iter().map(|row| row["j"]["mean"].as_f64().unwrap());
    assert!(j.fold(f64::INFINITY, f64::min) > number("unconstrained"));
}

#[test]
fn crpl_reaches_the_goal_without_the_edge_and_without_losing_the_link() {
    let args = ["episodes", "--controller", "crpl", "--episodes", "60", "--first-seed", "424242", "--json"];
    let row = &lines(&gcs(&args))[0];
    assert_eq!(row["edge_contacts"]["mean"], 0.0);
    assert_eq!(row["t_out"]["mean"], 0.0);
    assert_eq!(row["reached"], 1.0);
    // It does not leave the goal region on the far side.
    assert!(row["overshoot"]["ci"][1].as_f64().unwrap() < 0.05);
}

#[test]
fn claims_are_counted_over_the_values_that_the_paper_omits() {
    let dir = tempfile::tempdir().unwrap();
    let config = dir.path().join("short.toml");
    std::fs::write(
        &config,
        "warm_iterations = [2, 2, 2]\nstage1_iterations = 2\nlast_iterations = 2\nstage2_iterations = 2\n\
         comparison_rollouts = 32\ncheck_flights = 8\nattempts = 1\nstarts = 32\n",
    )
    .unwrap();
    let out = dir.path().join("worlds");
    // 26 worlds with one value at an end, and one joint draw: the 27th.
    let args = [
        "sensitivity",
        "--draws",
        "1",
        "--shard",
        "27/27",
        "--config",
        config.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    let said = gcs(&args);
    assert!(
        said.starts_with("1 worlds: 0 with one omitted value at an end of its range, 1 joint draws"),
        "{said}"
    );
    // So short a search passes no check, and what is refused does not fly.
    assert!(said.contains("in 1 of them no policy"), "{said}");
    assert_eq!(gcs(&args), said, "the world is not flown again");
    let journal = std::fs::read_to_string(out.join("worlds-27-of-27.jsonl")).unwrap();
    assert_eq!(journal.lines().count(), 1);
    let values = &lines(&journal)[0]["values"];
    assert_eq!(values.as_object().unwrap().len(), 13, "{values}");
}
