//! Flags to a running vehicle: what `sitl` and `gcs sitl` share.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use clap::{Parser, ValueEnum};
use tokio::sync::watch;

use crate::link::endpoint::{Endpoint, HostPort};
use crate::link::links::Links;
use crate::link::param_file::{self, Entry};
use crate::link::signing::{Policy, Signing, Store};
use crate::program::air::{self, AirGap};
use crate::program::camera::CameraFlag;
use crate::program::common::Examples;
use crate::program::files;
use crate::program::fleet;
use crate::program::flight_log::FlightLog;
use crate::program::shell::{Ended, LINKS, Shell};
use crate::program::terminal::{ExitWith, Signals, folder, positive, say, speed};
use crate::program::timing::{Histogram, Stats, Stopwatch};
use crate::scenario::{Rule, Scenario, presets};
use crate::vehicle::geodesy::Home;
use crate::vehicle::{Start, Vehicle};

/// The exit code of a flight that could not be written down.
const NOT_WRITTEN: u8 = 7;
/// The longest control interval on the wall: a timer has no time beyond some ages.
const LONGEST_PERIOD: Duration = Duration::from_secs(365 * 86_400);

/// What makes a control interval pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Pace {
    /// A timer, from the first setpoint on
    Realtime,
    /// The arrival of the setpoint for this interval
    Lockstep,
}

/// Examples below the help.
pub const EXAMPLES: Examples = &[(
    "sitl",
    &[
        "sitl --pace lockstep --ticks 100",
        "sitl --scenario gusty --pace realtime --speed 5",
        "sitl --connect udpout:127.0.0.1:14550 --open --on-ground",
        "sitl --instances 4 --radio wifi",
    ],
)];

/// A UAV simulator that speaks MAVLink 2 over UDP and TCP, renders its camera and models its radio link.
///
/// Listens on udpin:127.0.0.1:14550 by default. If a ground station such as QGroundControl already listens on
/// that port, connect to it: --connect udpout:127.0.0.1:14550.
#[derive(Debug, Clone, Parser)]
#[command(name = "sitl", version, max_term_width = 100, after_help = presets::table())]
pub struct Args {
    /// Scenario: TOML file or preset
    #[arg(long, value_name = "FILE|NAME", default_value = "demo")]
    pub scenario: String,
    /// Another camera than the scenario's
    #[command(flatten)]
    pub camera: CameraFlag,
    /// Listen on udpin:HOST:PORT or tcpin:HOST:PORT (port 0: any free port); repeatable [default:
    /// udpin:127.0.0.1:14550 without --connect]
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<Endpoint>,
    /// Connect to udpout:HOST:PORT or tcpout:HOST:PORT; repeatable
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<Endpoint>,
    /// What makes a control interval pass
    #[arg(long, value_enum, default_value = "realtime")]
    pub pace: Pace,
    /// Speed relative to real time, with --pace realtime
    #[arg(long, value_name = "X", default_value = "1", value_parser = speed)]
    pub speed: f64,
    /// Seed of the gusts
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// What the radio carries: setpoints (the paper's gate); all, the scenario's radio for everything that is said
    /// and heard; or a radio's preset or file, for everything. With --pace realtime
    #[arg(long, value_name = "setpoints|all|FILE|NAME", default_value = air::SETPOINTS)]
    pub radio: String,
    /// Bandwidth of --radio all: intervals that a picture takes from the start
    #[arg(long, value_name = "X", default_value = "1", value_parser = positive)]
    pub picture_intervals: f64,
    /// Stop after N control intervals [default: never]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub ticks: Option<u64>,
    /// MAVLink system id of the (first) vehicle
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    pub sysid: u8,
    /// Number of vehicles: system ids, seeds and ports count up from the first vehicle's; obstacles are placed
    /// at random
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    pub instances: u8,
    /// All vehicles share the endpoints and are told apart by their system ids
    #[arg(long)]
    pub shared: bool,
    /// Load parameters from a file at start (.param: NAME VALUE)
    #[arg(long, value_name = "FILE")]
    pub params: Option<PathBuf>,
    /// Save all settable parameters to a file at the end
    #[arg(long, value_name = "FILE")]
    pub save_params: Option<PathBuf>,
    /// File of the signing key and its timestamps; a key received by SETUP_SIGNING is stored there. With
    /// --instances, all vehicles start with this key and vehicle N stores its own in FILE.N
    #[arg(long, value_name = "FILE")]
    pub signing_key: Option<PathBuf>,
    /// Whether unsigned messages are accepted [default: as long as there is no key]
    #[arg(long, value_enum)]
    pub signing: Option<SigningPolicy>,
    /// Begin on the ground, disarmed: arm, then take off
    #[arg(long)]
    pub on_ground: bool,
    /// Where the vehicle starts, as in ArduPilot's simulator: degrees, degrees, m above the sea, degrees
    #[arg(long, value_name = "LAT,LON,ALT,HEADING", allow_hyphen_values = true)]
    pub home: Option<Home>,
    /// Fly anywhere: no walls, no obstacles, no packet loss, and the start at the local origin
    #[arg(long)]
    pub open: bool,
    /// Write the flight down, whoever flies: record.jsonl, run.json and config.toml, for `gcs score` and `gcs
    /// compare`. With --instances, vehicle N has DIR/N
    #[arg(long, value_name = "DIR", value_parser = folder)]
    pub out: Option<PathBuf>,
    /// Replace the flight that is in this folder
    #[arg(long, requires = "out")]
    pub overwrite: bool,
    /// Print timing statistics at the end: delay of control intervals, CPU time
    #[arg(long)]
    pub stats: bool,
}

/// Whether unsigned messages are accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SigningPolicy {
    /// Accept them
    Optional,
    /// Refuse them
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

impl Args {
    /// Where to listen and to whom to speak: what was asked for, or the default.
    fn endpoints(&self) -> Vec<Endpoint> {
        let asked: Vec<Endpoint> = self.listen.iter().chain(&self.connect).cloned().collect();
        if !asked.is_empty() {
            return asked;
        }
        let local = "127.0.0.1".to_owned();
        vec![Endpoint::UdpIn(HostPort { host: local, port: 14_550 })]
    }

    /// The scenario, opened if that was asked for.
    fn scenario(&self) -> Result<Scenario> {
        let mut scenario = self.camera.scenario(&self.scenario)?;
        if self.radio != air::SETPOINTS {
            // What the radio for everything has carried passes no second gate.
            scenario.radio.rule = Rule::Ideal;
        }
        Ok(if self.open { scenario.open() } else { scenario })
    }

    /// The radio of each vehicle, if it carries everything.
    fn airs(&self, scenario: &Scenario) -> Result<Vec<AirGap>> {
        let Some(radio) = air::radio(&self.radio, scenario, self.picture_intervals)? else {
            return Ok(Vec::new());
        };
        anyhow::ensure!(
            self.pace == Pace::Realtime,
            "--radio {}: needs --pace realtime, as in lockstep the vehicle waits for what is lost; `gcs episodes \
             --radio` flies in process",
            self.radio
        );
        (0..u64::from(self.instances)).map(|n| AirGap::new(radio.clone(), scenario, self.seed, n)).collect()
    }

    /// Each vehicle that was asked for.
    fn vehicles(&self, scenario: &Scenario) -> Result<Vec<Vehicle>> {
        let most = usize::from(u8::MAX - self.sysid) + 1;
        let count = usize::from(self.instances);
        anyhow::ensure!(
            count <= most.min(fleet::MAX_VEHICLES),
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
            let mut vehicle = Vehicle::boot(&scenario, seed, self.sysid + index as u8, self.ticks, &params)
                .with_context(|| path.clone())?;
            vehicle.set_start(Start { on_ground: self.on_ground, home: self.home });
            if let Some(policy) = self.signing {
                vehicle.signing_mut().set_policy(policy.into());
            }
            Ok(vehicle)
        });
        vehicles.collect()
    }

    /// The vehicles behind their endpoints, shared or each its own.
    async fn shells(&self, scenario: &Scenario) -> Result<Vec<Shell>> {
        let (vehicles, endpoints) = (self.vehicles(scenario)?, self.endpoints());
        let mut airs = self.airs(scenario)?;
        if self.shared || vehicles.len() == 1 {
            let mut shell = Shell::over(Links::open(&endpoints, LINKS).await?, vehicles);
            shell.through_the_air(airs);
            return Ok(vec![shell]);
        }
        let mut shells = Vec::with_capacity(vehicles.len());
        for (index, vehicle) in vehicles.into_iter().enumerate() {
            let own = fleet::endpoints(&endpoints, index).context("--instances: ports end at 65535")?;
            let mut shell = Shell::over(Links::open(&own, LINKS).await?, vec![vehicle]);
            shell.through_the_air(airs.drain(..airs.len().min(1)).collect());
            shells.push(shell);
        }
        Ok(shells)
    }

    /// A folder for each vehicle's flight, if there is to be one.
    fn keep_logs(&self, shells: &mut [Shell]) -> Result<()> {
        let Some(out) = &self.out else { return Ok(()) };
        for shell in shells {
            let log = |vehicle: &Vehicle| {
                let several = self.instances > 1;
                let dir = if several { out.join(vehicle.system().to_string()) } else { out.clone() };
                let sim = vehicle.sim();
                FlightLog::begin(&dir, self.overwrite, sim.scenario(), sim.seed())
            };
            let logs = shell.vehicles().iter().map(log).collect::<Result<Vec<_>>>()?;
            shell.keep_logs(logs);
        }
        Ok(())
    }

    /// Key and timestamps of each vehicle, and their files; none without a key.
    fn signing(&self) -> Result<Vec<(Signing, Store)>> {
        let required = self.signing == Some(SigningPolicy::Required);
        let Some(path) = &self.signing_key else {
            anyhow::ensure!(!required, "--signing required needs --signing-key FILE");
            return Ok(Vec::new());
        };
        let shared = Store::new(path);
        let keys = (0..self.instances).map(|index| {
            let several = self.instances > 1;
            let store = if several { shared.of_system(self.sysid + index) } else { shared.clone() };
            let signing = store.load_or(&shared, Policy::Required)?;
            let has_key = signing.is_on();
            anyhow::ensure!(
                has_key || !required,
                "--signing required: there is no key in {}",
                path.display()
            );
            if !has_key {
                let file = store.path().display();
                tracing::warn!("signing: there is no key in {file}; unsigned until SETUP_SIGNING brings one");
            }
            Ok((signing, store))
        });
        keys.collect()
    }
}

/// Flies until the last tick or a signal. The first line on stdout names the address; from then on no signal is
/// lost.
///
/// # Errors
/// A scenario, parameter file or key that does not read, a file that cannot be written at the end, and an endpoint
/// that cannot be opened.
pub async fn run(args: Args) -> Result<()> {
    let mut signals = Signals::listen().context("listening for signals")?;
    let scenario = args.scenario()?;
    if let Some(path) = &args.save_params {
        writable(path).with_context(|| format!("writing {}", path.display()))?;
    }
    let period = Duration::try_from_secs_f64(scenario.scale.interval_s / args.speed)
        .context("the control interval divided by --speed")?
        .clamp(Duration::from_micros(1), LONGEST_PERIOD);
    let mut shells = args.shells(&scenario).await?;
    let mut keys = args.signing()?.into_iter();
    let (stop, stopping) = watch::channel(false);
    for shell in &mut shells {
        shell.stop_on(stopping.clone());
        let vehicles = shell.vehicles().len();
        shell.keep_signing(keys.by_ref().take(vehicles));
    }
    args.keep_logs(&mut shells)?;
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
            shell.close().await;
            shell.save_signing(true);
            let unwritten = shell.close_logs(ended);
            (index, ended, shell, unwritten)
        });
    }
    let all = flights.join_all();
    tokio::pin!(all);
    let mut flown = loop {
        tokio::select! {
            flown = &mut all => break flown,
            _ = signals.next() => stop.send_replace(true),
        };
    };
    flown.sort_by_key(|(index, ..)| *index);
    for (_, ended, shell, _) in &flown {
        tell(*ended, shell, args.instances > 1);
    }
    if let (Some(path), Some((_, _, shell, _))) = (&args.save_params, flown.first()) {
        let text = param_file::write(shell.vehicle().settable_params());
        std::fs::write(path, text).with_context(|| format!("writing {}", path.display()))?;
    }
    if args.stats {
        let (wall, cpu) = stopwatch.elapsed();
        say(&format!("stats: {}", stats(flown.iter().map(|(_, _, shell, _)| shell), wall, cpu)));
    }
    match flown.into_iter().find_map(|(.., unwritten)| unwritten) {
        Some(why) => Err(ExitWith { code: NOT_WRITTEN, why }.into()),
        None => Ok(()),
    }
}

/// Whether a file can be written, before anything is flown that it is to hold. One that is not there is not made.
fn writable(path: &Path) -> std::io::Result<()> {
    let is_new = !path.exists();
    std::fs::OpenOptions::new().append(true).create(true).open(path)?;
    if is_new { std::fs::remove_file(path) } else { Ok(()) }
}

fn read_params(path: &Path) -> Result<Vec<Entry>> {
    let text = files::read_text(path).with_context(|| format!("reading {}", path.display()))?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::terminal::one_line;

    fn parse(flags: &[&str]) -> Result<Args, clap::Error> {
        Args::try_parse_from([&["sitl"], flags].concat())
    }

    #[test]
    fn the_defaults_fly_the_demo_s_scenario_in_real_time() {
        let args = parse(&[]).unwrap();
        assert_eq!(args.endpoints()[0].to_string(), "udpin:127.0.0.1:14550");
        assert_eq!(args.pace, Pace::Realtime);
        assert_eq!(args.scenario, "demo");
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

    /// It was noticed after the flight.
    #[test]
    fn parameters_that_cannot_be_saved_are_noticed_before_the_flight() {
        let flags = ["--save-params", "/nowhere/at/all.param", "--listen", "udpin:127.0.0.1:0"];
        let error = crate::program::terminal::block_on(run(parse(&flags).unwrap())).unwrap_err();
        assert!(one_line(&error).starts_with("writing /nowhere/at/all.param: "), "{}", one_line(&error));
    }

    #[test]
    fn an_open_world_has_no_walls_and_starts_at_the_origin() {
        let args = parse(&["--open", "--home", "-35.363261,149.165230,584,353", "--on-ground"]).unwrap();
        let scenario = args.scenario().unwrap();
        scenario.check().unwrap();
        assert!(!scenario.dynamics.walls && scenario.obstacles.is_empty());
        let vehicle = &args.vehicles(&scenario).unwrap()[0];
        assert_eq!(vehicle.sim().telemetry().position, [0.0, 0.0]);
    }

    #[test]
    fn nonsense_is_refused() {
        for flags in [
            ["--listen", "tcp:1"],
            ["--instances", "0"],
            ["--instances", "256"],
            ["--signing", "maybe"],
            ["--speed", "0"],
            ["--speed", "nan"],
            ["--ticks", "0"],
            ["--home", "1,2,3"],
            ["--home", "91,0,0,0"],
            ["--sysid", "0"],
            ["--pace", "fast"],
        ] {
            assert!(parse(&flags).is_err(), "{flags:?}");
        }
    }
}
