//! What `sitl`, `gcs` and `model` do alike at a terminal: flags, version, log, output, errors, exit codes
//! and signals.
//!
//! Exit codes: 0 for success, 1 for an error, 2 for wrong flags, 128 and the signal's number after a signal; a
//! program may have further ones ([`ExitWith`]). Results go to stdout, the log and errors to stderr; an error
//! takes one line.

use std::future::Future;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Command, Parser};

use super::common::{self, Examples};
use super::renamed;
use crate::link::endpoint::Endpoint;

/// A whole program: parses the flags, starts the log, does `work`, and tells an error. `revision` is that of
/// the program, for `--version`; the examples stand below the help.
pub fn main<P: Parser>(revision: &str, examples: Examples, work: impl FnOnce(P) -> Result<()>) -> ExitCode {
    let program = common::with_common(P::command(), examples);
    let parsed = program.clone().try_get_matches().and_then(|matches| {
        let is_ours = matches!(matches.subcommand_name(), Some("completions" | "man"));
        // Completions and manual pages need none of the program's own flags.
        let args = if is_ours { None } else { Some(P::from_arg_matches(&matches)?) };
        Ok((args, matches))
    });
    let (args, matches) = match parsed {
        Ok(parsed) => parsed,
        Err(error) => return usage(&program, revision, &error, std::env::args().skip(1)),
    };
    common::log_choice(&matches).begin();
    let done = match args {
        Some(args) => work(args),
        None => common::pages(&program, &matches).unwrap_or(Ok(())),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let line = one_line(&error);
            complain(&format!("error: {line}"));
            let exit = error.downcast_ref::<ExitWith>();
            // Who reads JSON reads one document: the results, if there were any, else the error.
            if !TOLD.load(Ordering::Relaxed) && std::env::args().any(|arg| arg == "--json") {
                say(&serde_json::json!({ "error": line }).to_string());
            }
            exit.map_or(ExitCode::FAILURE, |exit| exit.code.into())
        }
    }
}

/// Whether this program has printed a result.
static TOLD: AtomicBool = AtomicBool::new(false);

/// Prints a part of a result to stdout. A reader that has gone away ends the program quietly; a result that
/// cannot be written, on a full disk for one, ends it with an error.
pub fn print(text: std::fmt::Arguments<'_>) {
    TOLD.store(true, Ordering::Relaxed);
    let mut stdout = std::io::stdout().lock();
    let Err(error) = stdout.write_fmt(text).and_then(|()| stdout.flush()) else { return };
    if error.kind() == std::io::ErrorKind::BrokenPipe {
        std::process::exit(0);
    }
    eprintln!("error: writing to stdout: {error}");
    std::process::exit(1);
}

/// `print!` that does not panic: [`print`](crate::program::terminal::print).
#[macro_export]
macro_rules! out {
    ($($arg:tt)*) => { $crate::program::terminal::print(format_args!($($arg)*)) };
}

/// `println!` that does not panic: [`print`](crate::program::terminal::print).
#[macro_export]
macro_rules! outln {
    () => { $crate::out!("\n") };
    ($($arg:tt)*) => { $crate::program::terminal::print(format_args!("{}\n", format_args!($($arg)*))) };
}

/// An end of a program with an exit code of its own.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{why}")]
pub struct ExitWith {
    /// The exit code.
    pub code: u8,
    /// What has happened, in one line.
    pub why: String,
}

/// What asks a program to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signal {
    /// SIGHUP: the terminal was closed.
    Hangup,
    /// SIGINT: Ctrl-C.
    Interrupt,
    /// SIGTERM, as `docker stop` and service managers send it.
    Terminate,
}

impl Signal {
    /// The exit code of a program that it has ended: 128 and the signal's number.
    #[must_use]
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Hangup => 129,
            Self::Interrupt => 130,
            Self::Terminate => 143,
        }
    }

    /// The end of a program by this signal, and what was done until then.
    #[must_use]
    pub fn exit(self, what: &str) -> ExitWith {
        ExitWith { code: self.exit_code(), why: format!("{self}: {what}") }
    }
}

impl std::fmt::Display for Signal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Hangup => "SIGHUP",
            Self::Interrupt => "SIGINT",
            Self::Terminate => "SIGTERM",
        })
    }
}

/// Runs `work` to its end, with sockets and timers.
///
/// # Errors
/// Those of `work`, and a system that gives no timers.
pub fn block_on<T>(work: impl Future<Output = Result<T>>) -> Result<T> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    runtime.context("starting the runtime")?.block_on(work)
}

/// Prints help or version as clap does, the version with the revision; a wrong flag in one line.
fn usage(
    program: &Command,
    revision: &str,
    error: &clap::Error,
    args: impl Iterator<Item = String>,
) -> ExitCode {
    if error.kind() == ErrorKind::DisplayVersion {
        say(&format!("{} ({})", error.to_string().trim_end(), revision));
        return ExitCode::SUCCESS;
    }
    if !error.use_stderr() {
        // A reader that has gone away wants no help.
        let _ = error.print();
        return ExitCode::SUCCESS;
    }
    complain(&format!("{} (see --help)", complaint(program, error, args)));
    ExitCode::from(2)
}

/// What is wrong with `args`, in one line.
fn complaint(program: &Command, error: &clap::Error, args: impl Iterator<Item = String>) -> String {
    if let Some((_, ContextValue::String(unknown))) = error
        .context()
        .find(|(kind, _)| matches!(kind, ContextKind::InvalidArg | ContextKind::InvalidSubcommand))
        && let Some(new) = renamed::replacement(&command_of(program, args), unknown)
    {
        return format!("error: {unknown} is now {new}");
    }
    let text = error.render().to_string();
    let first: Vec<&str> = text.lines().take_while(|line| !line.is_empty()).map(str::trim).collect();
    first.join(" ") + &suggestion(error)
}

/// What was perhaps meant.
fn suggestion(error: &clap::Error) -> String {
    let kinds = [ContextKind::SuggestedArg, ContextKind::SuggestedSubcommand, ContextKind::SuggestedValue];
    let meant: Vec<String> = kinds
        .iter()
        .filter_map(|kind| error.get(*kind))
        .flat_map(|value| match value {
            ContextValue::String(word) => vec![word.clone()],
            ContextValue::Strings(words) => words.clone(),
            _ => Vec::new(),
        })
        .collect();
    if meant.is_empty() { String::new() } else { format!("; did you mean {}?", meant.join(" or ")) }
}

/// The program's name and the subcommand's, if `args` name one.
fn command_of(program: &Command, mut args: impl Iterator<Item = String>) -> String {
    let name = program.get_name();
    match args.find_map(|arg| program.find_subcommand(arg)) {
        Some(command) => format!("{name} {}", command.get_name()),
        None => name.to_owned(),
    }
}

/// An error and its causes in one line: each said once, without a parser's drawing of the place.
#[must_use]
pub fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain() {
        let text = cause.to_string();
        let drawn =
            |part: &&str| part.trim_start_matches(|c: char| c.is_ascii_digit() || c == ' ').starts_with('|');
        let text: Vec<&str> = text.lines().filter(|part| !part.is_empty() && !drawn(part)).collect();
        let text = text.join(": ");
        if !line.contains(&text) {
            line.push_str(if line.is_empty() { "" } else { ": " });
            line.push_str(&text);
        }
    }
    line
}

/// Writes a line to stdout at once, even into a pipe. A closed pipe is no reason to stop.
pub fn say(line: &str) {
    let mut stdout = std::io::stdout().lock();
    let _ = writeln!(stdout, "{}", line.trim_end()).and_then(|()| stdout.flush());
}

/// The signals that ask the program to end, from the moment on at which they are listened to: one that comes
/// while nobody waits is kept.
#[derive(Debug)]
pub struct Signals {
    #[cfg(unix)]
    kinds: [(Signal, tokio::signal::unix::Signal); 3],
}

impl Signals {
    /// Listens from now on.
    ///
    /// # Errors
    /// The system gives no signals.
    #[cfg(unix)]
    pub fn listen() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        let kinds = [
            (Signal::Interrupt, signal(SignalKind::interrupt())?),
            (Signal::Terminate, signal(SignalKind::terminate())?),
            (Signal::Hangup, signal(SignalKind::hangup())?),
        ];
        Ok(Self { kinds })
    }

    /// Listens, where there is Ctrl-C alone.
    ///
    /// # Errors
    /// None.
    #[cfg(not(unix))]
    pub fn listen() -> std::io::Result<Self> {
        Ok(Self {})
    }

    /// The next signal.
    #[cfg(unix)]
    pub async fn next(&mut self) -> Signal {
        let [interrupt, terminate, hangup] = &mut self.kinds;
        tokio::select! {
            _ = interrupt.1.recv() => interrupt.0,
            _ = terminate.1.recv() => terminate.0,
            _ = hangup.1.recv() => hangup.0,
        }
    }

    /// The next signal.
    #[cfg(not(unix))]
    pub async fn next(&mut self) -> Signal {
        let _ = tokio::signal::ctrl_c().await;
        Signal::Interrupt
    }
}

/// Writes a line to stderr. A closed pipe is no reason to stop.
fn complain(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Waits for a signal that asks the program to end. Where a signal must not be lost before this is waited for,
/// [`Signals`] listens earlier.
pub async fn interrupted() -> Signal {
    if let Ok(mut signals) = Signals::listen() {
        return signals.next().await;
    }
    let _ = tokio::signal::ctrl_c().await;
    Signal::Interrupt
}

/// A signal that has come by now, for work that has no runtime: the first is taken here, the second ends the
/// program as the system does it.
#[derive(Debug, Clone)]
pub struct StopSignal(std::sync::Arc<std::sync::OnceLock<Signal>>);

impl StopSignal {
    /// Listens from now on.
    ///
    /// # Errors
    /// The system gives no signals.
    pub fn listen() -> Result<Self> {
        let seen = std::sync::Arc::new(std::sync::OnceLock::new());
        let flag = std::sync::Arc::clone(&seen);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build();
        let runtime = runtime.context("listening for signals")?;
        std::thread::spawn(move || {
            let signal = runtime.block_on(interrupted());
            // Nothing else sets it.
            let _ = flag.set(signal);
            let second = runtime.block_on(interrupted());
            std::process::exit(second.exit_code().into());
        });
        Ok(Self(seen))
    }

    /// The signal, if one has come.
    #[must_use]
    pub fn get(&self) -> Option<Signal> {
        self.0.get().copied()
    }
}

/// A flag's value: a number above 0.
///
/// # Errors
/// The text is no such number.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() && x > 0.0 => Ok(x),
        _ => Err("must be a number above 0".into()),
    }
}

/// A flag's value: a speed relative to real time, by which times are divided.
///
/// # Errors
/// The text is no number from 1e-6 to 1e9.
pub fn speed(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if (1e-6..=1e9).contains(&x) => Ok(x),
        _ => Err("must be a number above 0: from 1e-6 to 1e9".into()),
    }
}

/// A flag's value: a time, 0 to a day.
///
/// # Errors
/// The text is no such number of seconds.
pub fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if (0.0..=86_400.0).contains(&x) => Ok(x),
        _ => Err("must be a number of seconds from 0 to 86400".into()),
    }
}

/// A flag's value: a folder. An endpoint in its place, as `--out` once took it, is an error.
///
/// # Errors
/// The text is an endpoint.
pub fn folder(text: &str) -> Result<PathBuf, String> {
    match text.parse::<Endpoint>() {
        Ok(_) => Err("must be a folder; endpoints are now given by --forward ENDPOINT".into()),
        Err(_) => Ok(text.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scenario;
    use crate::program::cli::Args;

    fn complaint_about(args: &[&str]) -> String {
        let error = Args::try_parse_from([&["sitl"], args].concat()).unwrap_err();
        complaint(&<Args as clap::CommandFactory>::command(), &error, args.iter().map(ToString::to_string))
    }

    #[test]
    fn old_words_name_the_new_ones_and_others_are_clap_s() {
        for args in [&["--config", "x.toml"][..], &["--config=x.toml"], &["--seed", "1", "--config"]] {
            assert_eq!(complaint_about(args), "error: --config is now --scenario FILE|NAME", "{args:?}");
        }
        assert_eq!(complaint_about(&["--speedup", "2"]), "error: --speedup is now --speed X");
        let line = complaint_about(&["--sped", "2"]);
        assert_eq!(line, "error: unexpected argument '--sped' found; did you mean --speed?");
        let line = complaint_about(&["--speed", "0"]);
        assert!(line.contains("--speed <X>") && line.contains("must be a number above 0"), "{line}");
    }

    /// `gcs replay --speed 1e-300` panicked: a time divided by it is none.
    #[test]
    fn speeds_and_times_are_what_a_duration_holds() {
        for text in ["1e-300", "1e300", "0", "-1", "nan", "inf", "x"] {
            let is_time = ["0", "1e-300"].contains(&text);
            assert!(speed(text).is_err() && seconds(text).is_ok() == is_time, "{text}");
        }
        assert_eq!((speed("1e-6"), speed("1e9"), seconds("0")), (Ok(1e-6), Ok(1e9), Ok(0.0)));
    }

    #[test]
    fn an_error_is_one_line_that_names_file_key_and_place() {
        let path = std::env::temp_dir().join(format!("sitl-{}.toml", std::process::id()));
        std::fs::write(&path, "[radio]\nbandwith = 1\n").unwrap();
        let error = Scenario::load(&path).unwrap_err().into();
        std::fs::remove_file(&path).unwrap();
        let line = one_line(&error);
        let start = format!(
            "reading {}: TOML parse error at line 2, column 1: unknown field `bandwith`",
            path.display()
        );
        assert!(line.starts_with(&start) && !line.contains('\n'), "{line}");

        let error = Scenario::load(&path).unwrap_err();
        assert_eq!(one_line(&error.into()).matches("No such file").count(), 1);
    }

    #[test]
    fn folders_are_no_endpoints() {
        for path in ["runs/flight", "/tmp/x:y", "C:\\runs", "runs/12:30"] {
            assert_eq!(folder(path), Ok(path.into()));
        }
        assert!(folder("udpout:127.0.0.1:14550").unwrap_err().contains("--forward"));
    }
}
