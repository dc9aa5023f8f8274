//! Flags to a running vehicle: what `sitl` and `gcs sitl` share.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::{Parser, ValueEnum};

use crate::link::endpoint::{Direction, Endpoint, Transport};
use crate::link::links::Links;
use crate::link::param_file::{self, Entry};
use crate::link::signing::{Policy, Signing, Store};
use crate::program::fleet;
use crate::program::shell::{Ended, Shell};
use crate::program::timing::{Histogram, Stats, Stopwatch};
use crate::scenario::Scenario;
use crate::vehicle::Vehicle;

/// Who decides when a control interval passes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Pace {
    /// A timer, from the first setpoint on.
    Realtime,
    /// The arrival of the setpoint for this tick.
    Lockstep,
}

/// A UAV simulator that speaks MAVLink 2 over UDP and TCP, renders its camera and puts a radio in the
/// way.
///
/// Listens on 14550 unless told otherwise. If a ground station such as QGroundControl listens there,
/// let sitl speak first: --connect udpout:127.0.0.1:14550.
#[derive(Debug, Clone, Parser)]
#[command(name = "sitl", version)]
pub struct Args {
    /// Scenario file (TOML); what it leaves out keeps the paper's values
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The paper's scenario: 1, obstacle beside the direct path, or 2, in it [default: the file's, or 2]
    #[arg(long, value_name = "1|2", value_parser = clap::value_parser!(u8).range(1..=2))]
    pub scenario: Option<u8>,
    /// udpin:HOST:PORT or tcpin:HOST:PORT (port 0: any free one); may be repeated [default:
    /// udpin:127.0.0.1:14550, unless there is a --connect]
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<Endpoint>,
    /// udpout:HOST:PORT or tcpout:HOST:PORT, to speak first; may be repeated
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<Endpoint>,
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
    /// MAVLink system id of the vehicle, or of the first
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    pub sysid: u8,
    /// So many vehicles in this process: system ids, seeds and ports count up, obstacles differ
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    pub instances: u8,
    /// All vehicles behind the same endpoints, told apart by their system ids
    #[arg(long)]
    pub shared: bool,
    /// Boot with the parameters of a file (.param: NAME VALUE)
    #[arg(long, value_name = "FILE")]
    pub params: Option<PathBuf>,
    /// Write all parameters that can be set to a file at the end
    #[arg(long, value_name = "FILE")]
    pub save_params: Option<PathBuf>,
    /// File with the key of message signing and its timestamps; a key that comes by SETUP_SIGNING is
    /// kept there. With --instances it is the key of all, and vehicle N keeps its own in FILE.N
    #[arg(long, value_name = "FILE")]
    pub signing_key: Option<PathBuf>,
    /// Whether unsigned messages are refused
    #[arg(long, value_enum, default_value = "optional")]
    pub signing: SigningPolicy,
    /// Print at the end how late control intervals began, and the processor's time
    #[arg(long)]
    pub stats: bool,
}

/// What becomes of unsigned messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SigningPolicy {
    /// They are taken.
    Optional,
    /// They are refused, once there is a key.
    Required,
}

impl From<SigningPolicy> for Policy {
    fn from(policy: SigningPolicy) -> Self {
        match policy {
            SigningPolicy::Optional => Self::Optional,
            SigningPolicy::Required => Self::Required,
        }
    }
}

/// A number above 0.
pub fn parse_speedup(text: &str) -> Result<f64, String> {
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

impl Args {
    /// Where to listen and to whom to speak: what was asked for, or the default.
    fn endpoints(&self) -> Vec<Endpoint> {
        let asked: Vec<Endpoint> = self.listen.iter().chain(&self.connect).cloned().collect();
        if !asked.is_empty() {
            return asked;
        }
        let local = "127.0.0.1".to_owned();
        vec![Endpoint { transport: Transport::Udp, direction: Direction::In, host: local, port: 14_550 }]
    }

    /// Each vehicle that was asked for.
    fn vehicles(&self, scenario: &Scenario) -> Result<Vec<Vehicle>> {
        let most = usize::from(u8::MAX - self.sysid) + 1;
        let count = usize::from(self.instances);
        anyhow::ensure!(
            count <= most.min(fleet::MOST),
            "--instances {count} from --sysid {}: system ids end at 255",
            self.sysid
        );
        let (params, path) = match &self.params {
            Some(path) => (read_params(path)?, path.display().to_string()),
            None => (Vec::new(), String::new()),
        };
        let vehicles = (0..count).map(|index| {
            let scenario = fleet::scenario(scenario, self.seed, index);
            let seed = self.seed.wrapping_add(index as u64);
            Vehicle::boot(&scenario, seed, self.sysid + index as u8, self.ticks, &params)
                .with_context(|| path.clone())
        });
        vehicles.collect()
    }

    /// The vehicles behind their endpoints, shared or each its own.
    async fn shells(&self, scenario: &Scenario) -> Result<Vec<Shell>> {
        let (vehicles, endpoints) = (self.vehicles(scenario)?, self.endpoints());
        if self.shared || vehicles.len() == 1 {
            return Ok(vec![Shell::over(Links::open(&endpoints).await?, vehicles)]);
        }
        let mut shells = Vec::with_capacity(vehicles.len());
        for (index, vehicle) in vehicles.into_iter().enumerate() {
            let own = fleet::endpoints(&endpoints, index).context("--instances: ports end at 65535")?;
            shells.push(Shell::over(Links::open(&own).await?, vec![vehicle]));
        }
        Ok(shells)
    }

    /// Key and timestamps of each vehicle, and their files; none without a key.
    fn signing(&self) -> Result<Vec<(Signing, Store)>> {
        let policy = Policy::from(self.signing);
        let Some(path) = &self.signing_key else {
            anyhow::ensure!(policy == Policy::Optional, "--signing required needs --signing-key FILE");
            return Ok(Vec::new());
        };
        let shared = Store::new(path);
        let keys = (0..self.instances).map(|index| {
            let several = self.instances > 1;
            let store = if several { shared.of_system(self.sysid + index) } else { shared.clone() };
            let signing = store.load_or(&shared, policy)?;
            let has_key = signing.is_on() || policy == Policy::Optional;
            anyhow::ensure!(has_key, "--signing required: there is no key in {}", path.display());
            Ok((signing, store))
        });
        keys.collect()
    }
}

/// Flies until the last tick or Ctrl-C. The first line on stdout names the address.
pub async fn run(args: Args) -> Result<()> {
    let scenario = args.scenario()?;
    let period = Duration::try_from_secs_f64(scenario.scale.interval_s / args.speedup)
        .context("the control interval divided by --speedup")?
        .max(Duration::from_micros(1));
    let mut shells = args.shells(&scenario).await?;
    let mut keys = args.signing()?.into_iter();
    for shell in &mut shells {
        let vehicles = shell.vehicles().len();
        shell.keep_signing(keys.by_ref().take(vehicles));
    }
    for line in shells.iter().flat_map(Shell::describe) {
        say(&line);
    }
    tracing::info!(scenario = scenario.name, seed = args.seed, pace = ?args.pace, "waiting for a ground station");

    let stopwatch = Stopwatch::default();
    let mut flights = tokio::task::JoinSet::new();
    for (index, mut shell) in shells.into_iter().enumerate() {
        flights.spawn(async move {
            let ended = match args.pace {
                Pace::Lockstep => shell.lockstep().await,
                Pace::Realtime => shell.real_time(period).await,
            };
            shell.save_signing(true);
            (index, ended, shell)
        });
    }
    let mut flown = flights.join_all().await;
    flown.sort_by_key(|(index, ..)| *index);
    for (_, ended, shell) in &flown {
        tell(*ended, shell, args.instances > 1);
    }
    if let (Some(path), Some((.., shell))) = (&args.save_params, flown.first()) {
        let text = param_file::write(shell.vehicle().settable_params());
        std::fs::write(path, text).with_context(|| format!("writing {}", path.display()))?;
    }
    if args.stats {
        let (wall, cpu) = stopwatch.elapsed();
        say(&format!("stats: {}", stats(flown.iter().map(|(.., shell)| shell), wall, cpu)));
    }
    Ok(())
}

fn read_params(path: &Path) -> Result<Vec<Entry>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    param_file::parse(&text).with_context(|| path.display().to_string())
}

/// What became of the flights of a shell, by the vehicles' names if there are several.
fn tell(ended: Ended, shell: &Shell, several: bool) {
    for vehicle in shell.vehicles() {
        let (tick, fates) = (vehicle.sim().tick().0, vehicle.sim().fates());
        let name = if several { format!("vehicle {}: ", vehicle.system()) } else { String::new() };
        tracing::info!("{name}{}", vehicle.tally());
        say(&match ended {
            Ended::Over { acknowledged: true } => format!("{name}flight over after {tick} ticks"),
            Ended::Over { acknowledged: false } => {
                format!("{name}flight over after {tick} ticks; no station confirmed the last percept")
            }
            Ended::Interrupted => format!("{name}interrupted at tick {tick}"),
        });
        say(&format!(
            "{name}commands: {} sent, {} delivered, {} delayed, {} superseded, {} lost",
            fates.sent, fates.delivered, fates.delayed, fates.superseded, fates.lost
        ));
    }
}

/// What the run of these shells has cost.
pub fn stats<'a>(shells: impl Iterator<Item = &'a Shell>, wall: Duration, cpu: Option<Duration>) -> Stats {
    let mut stats = Stats { vehicles: 0, lateness: Histogram::default(), intervals: 0, wall, cpu };
    for shell in shells {
        stats.vehicles += shell.vehicles().len();
        stats.intervals += shell.vehicles().iter().map(|vehicle| vehicle.sim().tick().0).sum::<u64>();
        stats.lateness.merge(shell.lateness());
    }
    stats
}

/// A line on stdout at once, even into a pipe. A reader that has gone away is no reason to stop.
fn say(line: &str) {
    use std::io::Write;
    let mut stdout = std::io::stdout().lock();
    let _ = writeln!(stdout, "{line}").and_then(|()| stdout.flush());
}

/// Returns on Ctrl-C, or when asked to end (SIGTERM), as `docker stop` and service managers do.
pub async fn interrupted() {
    #[cfg(unix)]
    {
        let terminate = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate());
        if let Ok(mut terminate) = terminate {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => {}
                _ = terminate.recv() => {}
            }
            return;
        }
    }
    let _ = tokio::signal::ctrl_c().await;
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
        assert_eq!(args.endpoints()[0].to_string(), "udpin:127.0.0.1:14550");
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
    fn endpoints_are_what_was_asked_for() {
        let args = parse(&["--listen", "udp::14550", "--connect", "tcp:127.0.0.1:1", "--listen", "tcpin::0"]);
        let told: Vec<String> = args.unwrap().endpoints().iter().map(Endpoint::to_string).collect();
        assert_eq!(told, ["udpin:127.0.0.1:14550", "tcpin:127.0.0.1:0", "tcpout:127.0.0.1:1"]);
    }

    #[test]
    fn what_does_not_go_together_is_said_in_one_line() {
        let error = |flags: &[&str]| {
            let args = parse(flags).unwrap();
            let vehicles = args.vehicles(&Scenario::default()).map(drop);
            vehicles.and(args.signing().map(drop)).unwrap_err().to_string()
        };
        assert!(error(&["--sysid", "2", "--instances", "255"]).contains("system ids end at 255"));
        assert!(error(&["--signing", "required"]).contains("needs --signing-key"));
        let flags = ["--signing", "required", "--signing-key", "/nowhere/key"];
        assert_eq!(error(&flags), "--signing required: there is no key in /nowhere/key");
        let flags = ["--instances", "2", "--signing", "required", "--signing-key", "/nowhere/key"];
        assert_eq!(error(&flags), "--signing required: there is no key in /nowhere/key");

        let path = std::env::temp_dir().join(format!("sitl-{}.param", std::process::id()));
        let file = path.to_str().unwrap();
        for (text, what) in [
            ("WP_SPEED x\n", "line 1: `WP_SPEED x` is no parameter: expected a name and a number"),
            ("WP_SPEED 10\nNO_SUCH 1\n", "line 2: there is no parameter NO_SUCH"),
            ("WP_SPEED -1\n", "line 1: WP_SPEED = -1 is out of range"),
        ] {
            std::fs::write(&path, text).unwrap();
            let args = parse(&["--params", file]).unwrap();
            let error = args.vehicles(&Scenario::default()).unwrap_err();
            assert_eq!(one_line(&error), format!("{file}: {what}"));
        }
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn nonsense_is_refused() {
        for flags in [
            ["--scenario", "3"],
            ["--listen", "tcp:1"],
            ["--connect", "serial:/dev/ttyUSB0"],
            ["--instances", "0"],
            ["--instances", "256"],
            ["--signing", "maybe"],
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
