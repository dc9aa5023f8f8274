//! Flags to a running vehicle: what `sitl` and `gcs sitl` share.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::{Parser, ValueEnum};

use crate::link::endpoint::{Direction, Endpoint};
use crate::scenario::Scenario;
use crate::shell::{Ended, Shell};
use crate::sim::Sim;
use crate::vehicle::Vehicle;

/// Who decides when a control interval passes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Pace {
    /// A timer, from the first setpoint on.
    Realtime,
    /// The arrival of the setpoint for this tick.
    Lockstep,
}

/// A UAV simulator that speaks MAVLink 2 over UDP, renders its camera and puts a radio in the way.
///
/// Listens on 14550 unless told otherwise. If a ground station such as QGroundControl listens there,
/// let sitl speak first: --listen udpout:127.0.0.1:14550.
#[derive(Debug, Clone, Parser)]
#[command(name = "sitl", version)]
pub struct Args {
    /// Scenario file (TOML); what it leaves out keeps the paper's values
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The paper's scenario: 1, obstacle beside the direct path, or 2, in it [default: the file's, or 2]
    #[arg(long, value_name = "1|2", value_parser = clap::value_parser!(u8).range(1..=2))]
    pub scenario: Option<u8>,
    /// udpin:HOST:PORT to listen (port 0: any free one), udpout:HOST:PORT to speak first
    #[arg(long, value_name = "ENDPOINT", default_value = "udpin:127.0.0.1:14550")]
    pub listen: Endpoint,
    /// Real time, or one tick per setpoint
    #[arg(long, value_enum, default_value = "realtime")]
    pub pace: Pace,
    /// How many times faster than real time
    #[arg(long, value_name = "X", default_value = "1", value_parser = parse_speedup)]
    pub speedup: f64,
    /// Seed of the disturbance
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// End after N control intervals [default: fly on]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub ticks: Option<u64>,
    /// MAVLink system id of the vehicle
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=254))]
    pub sysid: u8,
}

fn parse_speedup(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() && x > 0.0 => Ok(x),
        _ => Err("must be a number above 0".into()),
    }
}

impl Args {
    /// The flight's parameters: the file's, then `--scenario`.
    pub fn scenario(&self) -> Result<Scenario> {
        let mut scenario = match &self.config {
            Some(path) => Scenario::load(path)?,
            None => Scenario::default(),
        };
        if let Some(number) = self.scenario {
            scenario.set_number(number)?;
        }
        Ok(scenario)
    }
}

/// Flies until the last tick or Ctrl-C. The first line on stdout names the address.
pub async fn run(args: Args) -> Result<()> {
    let scenario = args.scenario()?;
    let period = Duration::try_from_secs_f64(scenario.scale.interval_s / args.speedup)
        .context("the control interval divided by --speedup")?
        .max(Duration::from_micros(1));
    let (socket, peer) = args.listen.open().await?;
    let local = socket.local_addr().context("reading the socket's address")?;
    match args.listen.direction {
        Direction::In => say(&format!("listening on udpin:{local}")),
        Direction::Out => say(&format!("sending to {} from port {}", args.listen, local.port())),
    }
    tracing::info!(scenario = scenario.name, seed = args.seed, pace = ?args.pace, "waiting for a ground station");

    let vehicle = Vehicle::new(Sim::new(scenario, args.seed), args.sysid, args.ticks);
    let mut shell = Shell::new(socket, vehicle, peer);
    let ended = match args.pace {
        Pace::Lockstep => shell.lockstep().await,
        Pace::Realtime => shell.real_time(period).await,
    };
    let vehicle = shell.vehicle();
    let (tick, fates) = (vehicle.sim().tick().0, vehicle.sim().fates());
    tracing::info!("{}", vehicle.tally());
    say(&match ended {
        Ended::Over { acknowledged: true } => format!("flight over after {tick} ticks"),
        Ended::Over { acknowledged: false } => {
            format!("flight over after {tick} ticks; no station confirmed the last percept")
        }
        Ended::Interrupted => format!("interrupted at tick {tick}"),
    });
    say(&format!(
        "commands: {} sent, {} delivered, {} delayed, {} superseded, {} lost",
        fates.sent, fates.delivered, fates.delayed, fates.superseded, fates.lost
    ));
    Ok(())
}

/// A line on stdout at once, even into a pipe. A reader that has gone away is no reason to stop.
fn say(line: &str) {
    use std::io::Write;
    let mut stdout = std::io::stdout().lock();
    let _ = writeln!(stdout, "{line}").and_then(|()| stdout.flush());
}

/// The whole program: parses the flags, logs to stderr, flies, and tells an error in one line.
#[must_use]
pub fn main() -> ExitCode {
    let args = match Args::try_parse() {
        Ok(args) => args,
        Err(error) => return usage(&error),
    };
    log();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let flown = runtime.context("starting the runtime").and_then(|runtime| runtime.block_on(run(args)));
    outcome(flown)
}

/// Logs to stderr, from level info on unless RUST_LOG says otherwise; colours on a terminal only.
pub fn log() {
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "info".into()),
        )
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
}

/// What a program's work came to: success, or its error in one line.
#[must_use]
pub fn outcome(done: Result<()>) -> ExitCode {
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", one_line(&error));
            ExitCode::FAILURE
        }
    }
}

/// An error and its causes in one line: each said once, without a parser's picture of the place.
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

/// Prints help or version as clap does, and a wrong flag in one line; gives the exit code.
#[must_use]
pub fn usage(error: &clap::Error) -> ExitCode {
    if !error.use_stderr() {
        let _ = error.print();
        return ExitCode::SUCCESS;
    }
    let text = error.render().to_string();
    let first = text.lines().take_while(|line| !line.is_empty()).map(str::trim);
    eprintln!("{} (see --help)", first.collect::<Vec<_>>().join(" "));
    ExitCode::from(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(flags: &[&str]) -> Result<Args, clap::Error> {
        Args::try_parse_from([&["sitl"], flags].concat())
    }

    #[test]
    fn the_defaults_fly_scenario_2_in_real_time() {
        let args = parse(&[]).unwrap();
        assert_eq!(args.listen.to_string(), "udpin:127.0.0.1:14550");
        assert_eq!(args.pace, Pace::Realtime);
        assert_eq!(args.scenario().unwrap().number(), Some(2));
    }

    #[test]
    fn an_error_is_one_line_that_names_file_key_and_place() {
        let path = std::env::temp_dir().join(format!("sitl-{}.toml", std::process::id()));
        std::fs::write(&path, "[radio]\nbandwith = 1\n").unwrap();
        let error = Args { config: Some(path.clone()), ..parse(&[]).unwrap() }.scenario().unwrap_err();
        std::fs::remove_file(&path).unwrap();
        let line = one_line(&error);
        let start = format!(
            "reading {}: TOML parse error at line 2, column 1: unknown field `bandwith`",
            path.display()
        );
        assert!(line.starts_with(&start) && !line.contains('\n'), "{line}");

        let error = Args { config: Some(path), ..parse(&[]).unwrap() }.scenario().unwrap_err();
        assert_eq!(one_line(&error).matches("No such file").count(), 1);
    }

    #[test]
    fn nonsense_is_refused() {
        for flags in [
            ["--scenario", "3"],
            ["--listen", "tcp:1"],
            ["--speedup", "0"],
            ["--speedup", "nan"],
            ["--ticks", "0"],
            ["--sysid", "0"],
            ["--pace", "fast"],
        ] {
            assert!(parse(&flags).is_err(), "{flags:?}");
        }
    }
}
