//! `gcs`: flies a UAV from pictures.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use crpl_gcs::flight::foreign::guide::Stack;
use crpl_gcs::flight::foreign::{self, Foreign};
use crpl_gcs::flight::{self, Options};
use crpl_gcs::lab::demo::{self, Flight};
use crpl_gcs::lab::episodes::{self, Episodes};
use crpl_gcs::lab::report;
use crpl_gcs::lab::run::{self, Summary};
use crpl_gcs::lab::sweep::{self, merge};
use crpl_gcs::lab::{check, optimise};
use crpl_gcs::station::models::Models;
use crpl_gcs::station::pilot::Controller;
use crpl_gcs::tools::outs::{self, Out};
use crpl_sitl::Scenario;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::program::cli::Pace;

/// A ground station that flies a UAV from pictures: CRPL and its baselines over MAVLink.
#[derive(Debug, Parser)]
#[command(name = "gcs", version)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Start a vehicle and fly it over UDP, once by each controller, with the same gusts.
    Demo(Demo),
    /// Fly a vehicle that is there.
    Fly(Fly),
    /// Fly many seeds in process, pictures rendered and encoded, and print means with intervals.
    Episodes(Episodes),
    /// Optimise CRPL's two policies in latent space for a scenario (Algorithm 1)
    Optimise(optimise::Optimise),
    /// Count how many closed-loop flights of a policy keep each chance constraint
    Check(check::Check),
    /// Fly a sweep: one key of the scenario against the paper's metrics, controllers paired by seeds.
    Sweep(sweep::Sweep),
    /// Join the shares of a sweep.
    Merge(merge::Merge),
    /// Draw the paper's figures: one page, SVG, PNG, CSV and text.
    Report(report::Report),
    /// Share a vehicle among tools: a MAVLink router with counters.
    Bridge(crpl_gcs::tools::bridge::Bridge),
    /// List, read, set, load and save a vehicle's parameters.
    Param(crpl_gcs::tools::param::Params),
    /// Upload, download and clear a vehicle's mission.
    Mission(crpl_gcs::tools::mission::Missions),
    /// Send a flight that is over to whoever watches, from its tlog or its record.
    Replay(crpl_gcs::tools::replay::Replay),
    /// Run the vehicle: the same program as `sitl`.
    Sitl(crpl_sitl::program::cli::Args),
}

/// What is flown, and by which trained things.
#[derive(Debug, clap::Args)]
struct Task {
    /// Scenario file (TOML); what it leaves out keeps the paper's values.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The paper's scenario: puts the obstacle beside (1) or in (2) the direct path.
    #[arg(long, value_name = "1|2", value_parser = clap::value_parser!(u8).range(1..=2))]
    scenario: Option<u8>,
    /// Folder of a world model; without it the one that ships with the program.
    #[arg(long, value_name = "DIR")]
    checkpoint: Option<PathBuf>,
    /// File with CRPL's policies; without it those that ship with the program.
    #[arg(long, value_name = "FILE")]
    policy: Option<PathBuf>,
}

impl Task {
    fn scenario(&self, or: impl FnOnce() -> Result<Scenario>) -> Result<Scenario> {
        let mut scenario = match &self.config {
            Some(path) => Scenario::load(path)?,
            None => or()?,
        };
        if let Some(number) = self.scenario {
            // A file's own name tells more than the number that it has already.
            if scenario.number() != Some(number) {
                scenario.set_number(number)?;
            }
        }
        Ok(scenario)
    }

    fn models(&self) -> Result<Models> {
        Models::load(self.checkpoint.as_deref(), self.policy.clone())
    }
}

#[derive(Debug, clap::Args)]
struct Demo {
    #[command(flatten)]
    task: Task,
    /// Who flies, in turn.
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["crpl", "rcc"])]
    controller: Vec<Controller>,
    /// Seed of the disturbance.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Real time, or one tick per command.
    #[arg(long, value_enum, default_value = "lockstep")]
    pace: Pace,
    /// How many times faster than real time.
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    speedup: f64,
    /// Sign the flight: file with the key, TOML with `key` (64 hexadecimal digits) or `passphrase`; the
    /// vehicle, which then takes nothing unsigned, keeps its own in FILE.1
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// Folder for the run folders, one a controller [default: runs/demo]; or who may watch the flights:
    /// udpout:HOST:PORT and the like, several if given again
    #[arg(long, value_name = "DIR|ENDPOINT")]
    out: Vec<Out>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct Fly {
    #[command(flatten)]
    task: Task,
    /// udpout:HOST:PORT of a vehicle that listens, udpin:HOST:PORT to wait for one that speaks first.
    #[arg(long, value_name = "ENDPOINT")]
    connect: Endpoint,
    /// What is flown: our own vehicle, or a foreign autopilot, which is armed and taken off.
    #[arg(long, value_enum, default_value = "sitl")]
    vehicle: Vehicle,
    /// System id of a foreign vehicle [default: the first that is heard].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    sysid: Option<u8>,
    /// How many times faster than real time a foreign vehicle's simulator runs.
    #[arg(long, value_name = "X", default_value = "1", value_parser = crpl_sitl::program::cli::parse_speedup)]
    speedup: f64,
    /// File with the key of message signing: TOML with `key` (64 hexadecimal digits) or `passphrase`.
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// Who flies.
    #[arg(long, value_enum, default_value = "crpl")]
    controller: Controller,
    /// End after N control intervals [default: the scenario's horizon].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    ticks: Option<u64>,
    /// Run folder [default: runs/flight]; or who may watch the flight, and take it over by a change of
    /// mode: udpout:HOST:PORT and the like, several if given again
    #[arg(long, value_name = "DIR|ENDPOINT")]
    out: Vec<Out>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Whose rules a vehicle follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Vehicle {
    /// Our own
    Sitl,
    /// ArduCopter, flown in GUIDED
    Ardupilot,
    /// PX4, flown in OFFBOARD
    Px4,
}

impl Vehicle {
    fn foreign(self) -> Option<Stack> {
        match self {
            Self::Sitl => None,
            Self::Ardupilot => Some(Stack::Ardupilot),
            Self::Px4 => Some(Stack::Px4),
        }
    }
}

async fn demo(args: Demo) -> Result<()> {
    let scenario = args.task.scenario(demo::scenario)?;
    let models = args.task.models()?;
    let mut flights = Vec::new();
    let (out, outs) = outs::sorted(&args.out, "runs/demo");
    for controller in args.controller {
        let flight = Flight {
            controller,
            scenario: &scenario,
            seed: args.seed,
            pace: args.pace,
            speedup: args.speedup,
            signing_key: args.signing_key.as_deref(),
            outs: &outs,
        };
        let dir = out.join(controller.to_string());
        let Some(summary) = demo::fly(&models, &flight, &dir).await? else { break };
        flights.push(summary);
    }
    report(&flights, args.json)?;
    if !args.json {
        println!("records, tlog and plot in {}", out.display());
    }
    Ok(())
}

async fn fly(args: Fly) -> Result<()> {
    let foreign = args.vehicle.foreign();
    let scenario = args.task.scenario(|| match foreign {
        Some(_) => foreign::scenario(),
        None => Ok(Scenario::default()),
    })?;
    let mut station = args.task.models()?.station(args.controller, &scenario)?;
    let (out, outs) = outs::sorted(&args.out, "runs/flight");
    run::begin(&out, &scenario)?;
    let options = Options {
        ticks: Some(args.ticks.unwrap_or(scenario.horizon)),
        tlog: Some(out.join("flight.tlog")),
        signing_key: args.signing_key,
        outs,
        ..Options::default()
    };
    tracing::info!(controller = %args.controller, scenario = scenario.name, "connecting to {}", args.connect);
    let flown = match foreign {
        Some(stack) => {
            let how = Foreign { stack, system: args.sysid, speedup: args.speedup };
            foreign::fly(&args.connect, &scenario, &how, &options, |p| station.handle(p)).await?
        }
        None => flight::fly(&args.connect, &scenario, &options, |p| station.handle(p)).await?,
    };
    if let Some(last) = &flown.last {
        station.finish(last);
    }
    let summary = Summary::of(args.controller, None, &station, &flown)
        .context("the flight ended before its first interval")?;
    run::end(&out, &summary, station.records(), &scenario)?;
    report(std::slice::from_ref(&summary), args.json)?;
    if !args.json {
        println!("records, tlog and plot in {}", out.display());
    }
    Ok(())
}

fn report(flights: &[Summary], json: bool) -> Result<()> {
    if json {
        println!("{}", serde_json::to_string(&serde_json::json!({ "flights": flights }))?);
    } else {
        print!("{}", run::table(flights));
    }
    Ok(())
}

fn run_command(command: Command) -> Result<()> {
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().context("starting the runtime")?;
    match command {
        Command::Demo(args) => runtime.block_on(demo(args)),
        Command::Fly(args) => runtime.block_on(fly(args)),
        Command::Bridge(args) => runtime.block_on(crpl_gcs::tools::bridge::run(args)),
        Command::Param(args) => runtime.block_on(crpl_gcs::tools::param::run(args)),
        Command::Mission(args) => runtime.block_on(crpl_gcs::tools::mission::run(args)),
        Command::Replay(args) => runtime.block_on(crpl_gcs::tools::replay::run(args)),
        Command::Sitl(args) => runtime.block_on(crpl_sitl::program::cli::run(args)),
        Command::Episodes(args) => episodes::run(&args),
        Command::Optimise(args) => optimise::run(&args),
        Command::Check(args) => check::run(&args),
        Command::Sweep(args) => sweep::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Report(args) => report::run(&args),
    }
}

fn main() -> ExitCode {
    let args = match Args::try_parse() {
        Ok(args) => args,
        Err(error) => return crpl_sitl::program::cli::usage(&error),
    };
    crpl_sitl::program::cli::log();
    crpl_sitl::program::cli::outcome(run_command(args.command))
}
