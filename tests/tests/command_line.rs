//! The command line of the three programs: words that have changed, presets, versions.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use crpl_sitl::program::renamed::RENAMED;
use crpl_sitl::scenario::presets;
use tests::{program, python};

/// Exit code and stderr of a command that is refused.
fn refused(command: &str, args: &[&str]) -> (Option<i32>, String) {
    let mut words = command.split(' ');
    let name = words.next().unwrap();
    let args: Vec<&str> = words.chain(args.iter().copied()).collect();
    let finished = program::run(name, &args).unwrap();
    (finished.status.code(), finished.stderr)
}

#[test]
fn an_old_word_is_refused_with_the_new_one() {
    for renamed in RENAMED {
        for command in renamed.commands {
            let told = refused(command, &[renamed.old, "2"]);
            let expected = format!("error: {} is now {} (see --help)", renamed.old, renamed.new);
            assert_eq!(told, (Some(2), expected), "{command} {}", renamed.old);
        }
    }
    for command in ["gcs demo", "gcs fly --connect udpout:127.0.0.1:9"] {
        let (code, told) = refused(command, &["--out", "udpout:127.0.0.1:14551"]);
        assert!(code == Some(2) && told.contains("--forward ENDPOINT"), "{command}: {told}");
    }
}

#[test]
fn an_unknown_scenario_is_answered_with_the_presets() {
    for command in ["sitl", "gcs demo", "gcs episodes", "gcs optimise", "gcs check"] {
        let (code, told) = refused(command, &["--scenario", "gutsy"]);
        assert_eq!(code, Some(1), "{command}");
        assert!(told.contains("`gutsy`") && told.ends_with(&presets::names()), "{command}: {told}");
    }
}

#[test]
fn versions_name_the_revision() {
    for name in ["sitl", "gcs", "model"] {
        let printed = program::run(name, &["--version"]).unwrap().good().unwrap();
        let start = format!("{name} {} (", env!("CARGO_PKG_VERSION"));
        assert!(printed.starts_with(&start) && printed.trim_end().ends_with(')'), "{printed}");
    }
}

/// Help that a terminal of 80 columns shows without breaking its lines, and each default once.
#[test]
fn help_fits_80_columns() {
    let gcs = "demo fly record episodes optimise check sweep merge report bridge link param mission replay export sitl tlog key";
    let model = "collect train predictors adapt ablate robustness evaluate";
    let commands = [("sitl", ""), ("gcs", gcs), ("model", model)];
    for (name, subcommands) in commands {
        for sub in
            std::iter::once("").chain(subcommands.split(' ')).filter(|s| name != "sitl" || s.is_empty())
        {
            let mut command = std::process::Command::new(program::path(name).unwrap());
            command.args(Some(sub).filter(|s| !s.is_empty())).arg("--help").env("COLUMNS", "80");
            let help = program::Program::spawn(name, command).unwrap().wait().unwrap().good().unwrap();
            for line in help.lines() {
                assert!(line.chars().count() <= 80, "{name} {sub}: {line:?}");
                assert!(line.matches("[default").count() <= 1, "{name} {sub}: {line:?}");
            }
        }
    }
}

#[test]
fn a_mistyped_word_is_answered_with_what_was_meant() {
    for (command, wrong, meant) in [
        ("gcs", "dmeo", "did you mean demo?"),
        ("gcs demo", "--contrler=rcc", "did you mean --controller?"),
        ("gcs demo", "--controller=crp", "did you mean crpl"),
        ("sitl", "--sede=1", "did you mean --seed?"),
        ("model", "evalute", "evaluate?"),
    ] {
        let (code, told) = refused(command, &[wrong]);
        assert!(code == Some(2) && told.contains(meant), "{command} {wrong}: {told}");
        assert_eq!(told.lines().count(), 1, "{told}");
    }
}

#[test]
fn completions_and_manual_pages_come_with_the_programs() {
    let dir = tempfile::tempdir().unwrap();
    for (name, page) in [("sitl", "sitl.1"), ("gcs", "gcs-demo.1"), ("model", "model-train.1")] {
        for shell in ["bash", "zsh", "fish"] {
            let text = program::run(name, &["completions", shell]).unwrap().good().unwrap();
            assert!(text.contains(name) && text.contains("quiet"), "{name} {shell}");
        }
        let out = dir.path().join(name);
        program::run(name, &["man", "--out", out.to_str().unwrap()]).unwrap().good().unwrap();
        assert!(std::fs::read_to_string(out.join(page)).unwrap().contains(".SH OPTIONS"), "{page}");
    }
}

/// First use, F2: 14 lines with module paths, microseconds and `severity=6` before a 0.1 s demo's table.
#[test]
fn the_log_is_short_quiet_or_json() {
    let dir = tempfile::tempdir().unwrap();
    let demo = |flags: &[&str], out: &str| {
        let out = dir.path().join(out);
        let args = [&["demo", "--controller", "rcc", "--out", out.to_str().unwrap()], flags].concat();
        let finished = program::run("gcs", &args).unwrap();
        assert!(finished.status.success(), "{}", finished.stderr);
        finished.stderr
    };
    let told = demo(&[], "plain");
    assert!(told.contains("vehicle: outage begins") && told.contains("WARN"), "{told}");
    for word in ["crpl_", "::", "severity"] {
        assert!(!told.contains(word), "{word}: {told}");
    }
    assert_eq!(demo(&["-q"], "quiet"), "");
    let lines = demo(&["--log", "json"], "json");
    assert!(!lines.is_empty());
    for line in lines.lines() {
        let event: serde_json::Value = serde_json::from_str(line).unwrap();
        assert!(event["level"].is_string() && event["message"].is_string(), "{line}");
    }
    assert!(demo(&["-v"], "verbose").contains("DEBUG"));
}

#[test]
fn nothing_that_is_printed_is_wider_than_the_terminal() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let out = out.to_str().unwrap();
    let flown = program::run("gcs", &["demo", "--controller", "crpl,rcc,ucc", "--out", out]).unwrap();
    flown.good().unwrap();
    let runs = ["crpl", "rcc", "ucc"].map(|name| format!("{out}/{name}"));
    let few = ["--controller", "crpl,rcc", "--episodes", "2"];
    let commands = [
        [&["score"], &runs.each_ref().map(String::as_str)[..]].concat(),
        vec!["scenario", "list"],
        vec!["scenario", "show", "narrow"],
        [&["episodes"], &few[..]].concat(),
        [&["fleet", "--vehicles", "2"], &few[..]].concat(),
    ];
    let gcs = program::path("gcs").unwrap();
    for columns in ["80", "60"] {
        for command in &commands {
            let args = [&[columns, gcs.to_str().unwrap()], &command[..]].concat();
            let said = python::script("in_terminal.py", &args).unwrap().good().unwrap();
            assert_eq!(said.trim_end(), "True, exit status 0", "{columns}: {command:?}");
        }
    }
}
