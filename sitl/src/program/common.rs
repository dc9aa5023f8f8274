//! Flags and subcommands that `sitl`, `gcs` and `model` share: how much is logged, completions, manual pages.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Arg, ArgAction, ArgMatches, Command, builder::EnumValueParser, value_parser};
use clap_complete::Shell;

use super::log::{LogChoice, LogFormat};

/// Heading of the shared flags in the help.
const HEADING: &str = "Log";

/// Example command lines of each subcommand; of a program without any, under its own name.
pub type Examples = &'static [(&'static str, &'static [&'static str])];

/// Headings of flags in the help. A flag's name means the same in all commands.
const HEADINGS: [(&str, &[&str]); 5] = [
    ("Scenario", &["scenario", "camera", "set"]),
    (
        "Trained models",
        &["checkpoint", "networks", "policy", "gains", "policy_mismatch", "optimise", "exec_timeout"],
    ),
    (
        "Network",
        &[
            "connect",
            "listen",
            "forward",
            "sysid",
            "component",
            "signing_key",
            "signing",
            "timeout",
            "role",
            "source_system",
            "source_component",
            "metrics",
        ],
    ),
    ("Page", &["watch", "watch_stay", "control", "buildings"]),
    ("Output", &["out", "overwrite", "format", "ledger", "tlog", "summary", "every", "stats", "json"]),
];

/// The flags of a command and of its subcommands under their headings.
fn with_headings(command: Command) -> Command {
    let command = command.mut_args(|arg| {
        let names = |(_, names): &&(&str, &[&str])| names.contains(&arg.get_id().as_str());
        match HEADINGS.iter().find(names) {
            Some((heading, _)) if arg.get_help_heading().is_none() && !arg.is_positional() => {
                arg.help_heading(*heading)
            }
            _ => arg,
        }
    });
    let names: Vec<String> = command.get_subcommands().map(|sub| sub.get_name().to_owned()).collect();
    names.iter().fold(command, |command, name| command.mut_subcommand(name, with_headings))
}

/// A command with examples below its help.
fn with_examples(command: Command, examples: &[&str]) -> Command {
    let before = command.get_after_help().map(|text| format!("{}\n\n", text.to_string().trim_end()));
    let lines: String = examples.iter().map(|example| format!("\n  {example}")).collect();
    command.after_help(format!("{}Examples:{lines}", before.unwrap_or_default()))
}

/// What is wrong with a program's examples: commands without one, and lines that do not parse.
#[must_use]
pub fn wrong_examples(program: Command, examples: Examples) -> Vec<String> {
    let commands: Vec<String> = match program.get_subcommands().next() {
        None => vec![program.get_name().to_owned()],
        Some(_) => program.get_subcommands().map(|sub| sub.get_name().to_owned()).collect(),
    };
    let has = |name: &String| examples.iter().any(|(of, lines)| of == name && !lines.is_empty());
    let mut wrong: Vec<String> =
        commands.into_iter().filter(|name| !has(name)).map(|name| format!("{name}: no example")).collect();
    let program = with_common(program, examples);
    for line in examples.iter().flat_map(|(_, lines)| *lines) {
        // One quoted word at most.
        let mut parts = line.split('"');
        let mut words: Vec<&str> = parts.next().unwrap_or_default().split_whitespace().collect();
        words.extend(parts.next());
        words.extend(parts.next().unwrap_or_default().split_whitespace());
        if let Err(error) = program.clone().try_get_matches_from(words) {
            wrong.push(format!("{line}: {error}"));
        }
    }
    wrong
}

/// The program's flags and subcommands with those that all programs have, headings and examples.
#[must_use]
pub fn with_common(program: Command, examples: Examples) -> Command {
    let mut program = with_headings(program);
    for (name, lines) in examples {
        program = match program.find_subcommand(name) {
            Some(_) => program.mut_subcommand(name, |sub| with_examples(sub, lines)),
            None => with_examples(program, lines),
        };
    }
    let quiet = Arg::new("quiet").short('q').long("quiet").help("Log errors alone, and draw no progress");
    let verbose = Arg::new("verbose").short('v').long("verbose").action(ArgAction::Count);
    let log =
        Arg::new("log").long("log").value_name("FORMAT").value_parser(EnumValueParser::<LogFormat>::new());
    let verbose = verbose.help("Log details; -vv everything").conflicts_with("quiet");
    let flags = [
        quiet.action(ArgAction::SetTrue),
        verbose,
        log.default_value("text").hide_possible_values(true).help("Log lines as text, or as json"),
    ];
    let shell = Arg::new("shell").required(true).value_name("SHELL").value_parser(value_parser!(Shell));
    let completions = Command::new("completions").about("Print completions for a shell").arg(shell);
    let out =
        Arg::new("out").long("out").required(true).value_name("DIR").value_parser(value_parser!(PathBuf));
    let man = Command::new("man").about("Write the manual pages into a folder").arg(out).hide(true);
    let is_single = !program.has_subcommands();
    let flags = flags.map(|flag| flag.global(true).help_heading(HEADING));
    program.args(flags).subcommands([completions.hide(is_single), man])
}

/// How much the flags want logged, and how.
#[must_use]
pub fn log_choice(matches: &ArgMatches) -> LogChoice {
    LogChoice {
        quiet: matches.get_flag("quiet"),
        verbose: matches.get_count("verbose"),
        format: matches.get_one("log").copied().unwrap_or_default(),
    }
}

/// Completions or manual pages, if they are asked for; `None`: something else is.
///
/// # Errors
/// A page cannot be written.
pub fn pages(program: &Command, matches: &ArgMatches) -> Option<Result<()>> {
    match matches.subcommand()? {
        ("completions", asked) => {
            let shell = asked.get_one::<Shell>("shell").copied()?;
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut program.clone(), program.get_name(), &mut text);
            crate::out!("{}", String::from_utf8_lossy(&text));
            Some(Ok(()))
        }
        ("man", asked) => Some(write_man(program, asked.get_one::<PathBuf>("out")?)),
        _ => None,
    }
}

/// A page for the program and each of its subcommands.
fn write_man(program: &Command, dir: &Path) -> Result<()> {
    std::fs::create_dir_all(dir).with_context(|| format!("creating {}", dir.display()))?;
    clap_mangen::generate_to(program.clone(), dir)
        .with_context(|| format!("writing into {}", dir.display()))?;
    crate::outln!("manual pages in {}", dir.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, FromArgMatches};

    use super::*;
    use crate::program::cli::Args;

    #[test]
    fn shared_flags_stand_anywhere_and_leave_the_program_s_alone() {
        let program = with_common(Args::command(), &[]);
        let matches =
            program.clone().try_get_matches_from(["sitl", "--seed", "4", "-vv", "--log", "json"]).unwrap();
        assert_eq!(Args::from_arg_matches(&matches).unwrap().seed, 4);
        let choice = log_choice(&matches);
        assert_eq!((choice.quiet, choice.verbose, choice.format), (false, 2, LogFormat::Json));
        assert!(pages(&program, &matches).is_none());
        assert!(program.try_get_matches_from(["sitl", "-q", "-v"]).is_err());
    }

    #[test]
    fn sitl_has_examples_that_parse() {
        assert_eq!(wrong_examples(Args::command(), crate::program::cli::EXAMPLES), Vec::<String>::new());
    }

    #[test]
    fn manual_pages_name_the_program() {
        let dir = std::env::temp_dir().join(format!("sitl-man-{}", std::process::id()));
        write_man(&with_common(Args::command().name("sitl"), &[]), &dir).unwrap();
        let page = std::fs::read_to_string(dir.join("sitl.1")).unwrap();
        std::fs::remove_dir_all(&dir).unwrap();
        assert!(page.contains(".TH sitl 1"), "{page}");
    }
}
