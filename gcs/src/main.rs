//! `gcs`: flies a UAV from camera frames.

mod examples;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Result, bail};
use clap::{Parser, Subcommand};
use crpl_gcs::flight::foreign::field::{FieldFrame, WhenOver};
use crpl_gcs::flight::foreign::guide::ForeignStack;
use crpl_gcs::flight::foreign::{self, FlightPlan, Foreign};
use crpl_gcs::flight::{self, Options, world};
use crpl_gcs::lab::crew::LoggedStation;
use crpl_gcs::lab::demo::{self, DemoFlight};
use crpl_gcs::lab::run_folder::{self, RunFolder, RunManifest};
use crpl_gcs::lab::summary::{self, Summary};
use crpl_gcs::lab::sweep::{self, merge};
use crpl_gcs::lab::{
    bound, check, episodes, fleet, flown, optimise, policies, record, report, scenarios, sensitivity, tune,
};
use crpl_gcs::station::models::ModelFiles;
use crpl_gcs::station::pilot::{Controller, ControllerParser};
use crpl_gcs::tools::identity::Identity;
use crpl_gcs::tools::{bridge, encode, export, key, link, mission, param, replay, tlog};
use crpl_gcs::watch::map::MapFlags;
use crpl_gcs::watch::{Shown, SteerFlags, WatchFlags, WatchPage};
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::cli::Pace;
use crpl_sitl::program::columns;
use crpl_sitl::program::terminal::{self, ExitWith, folder, positive, speed};
use crpl_sitl::scenario::presets;

/// A ground station that flies a UAV from camera frames over MAVLink: CRPL and its baselines.
#[derive(Debug, Parser)]
#[command(name = "gcs", version, max_term_width = 100)]
struct GcsArgs {
    #[command(subcommand)]
    command: GcsCommand,
}

#[derive(Debug, Subcommand)]
enum GcsCommand {
    /// Start a simulated vehicle and fly it with each controller, with equal gusts
    Demo(Demo),
    /// Fly an already running vehicle
    Fly(Fly),
    /// Fly exploratory actions on a running vehicle and record pictures to learn from
    Record(record::RecordFlags),
    /// Fly many seeds in process and print means with confidence intervals
    Episodes(episodes::Episodes),
    /// Fly several vehicles on one base station, whose bandwidth they share
    Fleet(fleet::table::FleetFlags),
    /// Optimise CRPL's two policies for a scenario (Algorithm 1)
    Optimise(optimise::Optimise),
    /// Measure how often flights of a policy keep each chance constraint
    Check(check::Check),
    /// Bound what any controller can reach: the oracle's value, and others beside it
    Bound(bound::Bound),
    /// Measure the paper's claims over the values that it omits
    Sensitivity(sensitivity::Sensitivity),
    /// Search the numbers of RCC or UCC on training seeds
    Tune(tune::Tune),
    /// Fly a sweep: the paper's metrics against one key of the scenario
    Sweep(sweep::Sweep),
    /// List, draw, check and begin scenarios
    Scenario(scenarios::Scenarios),
    /// Print the numbers of flights on the disk, whoever flew them
    Score(flown::Score),
    /// Put flights on the disk side by side: one table, one picture
    Compare(flown::Compare),
    /// Join the shards of a sweep
    Merge(merge::Merge),
    /// Draw the paper's figures: HTML page, SVG, PNG, CSV and text
    Report(report::Report),
    /// Route MAVLink between a vehicle and several tools, and count packets
    Bridge(bridge::Bridge),
    /// Put a radio between a vehicle and its tools: slow and lossy as its geometry says
    Link(link::RadioLink),
    /// Encode a vehicle's pictures beside it and send their latents: a companion's half of CRPL
    Encode(encode::EncodeFlags),
    /// List, read, set, load and save a vehicle's parameters
    Param(param::Params),
    /// Upload, download and clear a vehicle's mission
    Mission(mission::Missions),
    /// Send a recorded flight to whoever watches
    Replay(replay::Replay),
    /// Write a flight as a table, a track on a map, or a log for Foxglove
    Export(export::ExportArgs),
    /// Look into telemetry logs, cut and merge them
    Tlog(tlog::TlogArgs),
    /// Make keys of message signing, and tell them apart
    Key(key::KeyArgs),
    /// Run the simulated vehicle: the same program as `sitl`
    Sitl(crpl_sitl::program::cli::Args),
}

#[derive(Debug, clap::Args)]
#[command(after_help = presets::table())]
struct Demo {
    /// Scenario: TOML file or preset
    #[arg(long, value_name = "FILE|NAME", default_value = "demo")]
    scenario: String,
    #[command(flatten)]
    camera: CameraFlag,
    #[command(flatten)]
    models: ModelFiles,
    /// Controllers to fly, in this order
    #[arg(long, value_parser = ControllerParser, value_name = "LIST", value_delimiter = ',', default_values = ["crpl", "rcc"])]
    controller: Vec<Controller>,
    /// Seed of the gusts
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// What makes a control interval pass
    #[arg(long, value_enum, default_value = "lockstep")]
    pace: Pace,
    /// Speed relative to real time, with --pace realtime
    #[arg(long, value_name = "X", default_value = "1", value_parser = speed)]
    speed: f64,
    /// Sign all messages with the key in this file: TOML with `key` (64 hexadecimal digits) or `passphrase`.
    /// The vehicle refuses unsigned messages and stores its own key in FILE.1
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// Folder for the run folders, one per controller [default: runs/demo, or runs/demo-2 ... where that is taken]
    #[arg(long, value_name = "DIR", value_parser = folder)]
    out: Option<PathBuf>,
    /// Replace the flights that are in these folders
    #[arg(long)]
    overwrite: bool,
    /// Forward the flights to this endpoint, such as udpout:HOST:PORT; repeatable
    #[arg(long, value_name = "ENDPOINT", num_args = 1..)]
    forward: Vec<Endpoint>,
    #[command(flatten)]
    watch: WatchFlags,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
#[command(after_help = presets::table())]
struct Fly {
    /// Scenario: TOML file or preset, which must be the vehicle's [default: the vehicle's own, or foreign for a
    /// foreign autopilot]
    #[arg(long, value_name = "FILE|NAME")]
    scenario: Option<String>,
    #[command(flatten)]
    camera: CameraFlag,
    #[command(flatten)]
    models: ModelFiles,
    /// Endpoint of the vehicle: udpout:HOST:PORT if it listens, udpin:HOST:PORT to wait for it; or
    /// tcpout, tcpin
    #[arg(long, value_name = "ENDPOINT")]
    connect: Endpoint,
    /// Kind of vehicle; a foreign autopilot is armed and takes off
    #[arg(long, value_enum, default_value = "sitl")]
    vehicle: VehicleKind,
    /// System id of the vehicle [default: the only one on the link; of a foreign one, the first that is heard]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    sysid: Option<u8>,
    /// Height of a foreign vehicle's flight above its start, m [default: the scenario's]
    #[arg(help_heading = "Foreign vehicles", long, value_name = "METRES", value_parser = positive)]
    altitude: Option<f64>,
    /// Side of the square that a foreign vehicle flies in, m [default: the scenario's]
    #[arg(help_heading = "Foreign vehicles", long, value_name = "METRES", value_parser = positive)]
    field: Option<f64>,
    /// Where the upper edge of a foreign vehicle's field lies, degrees clockwise from north
    #[arg(help_heading = "Foreign vehicles", long, value_name = "DEGREES", default_value = "0", allow_negative_numbers = true, value_parser = degrees)]
    heading: f64,
    /// Lower left corner of a foreign vehicle's field, metres north and east of the vehicle's own origin; it flies to
    /// the field's start first [default: the field lies so that its start is where the vehicle is]
    #[arg(help_heading = "Foreign vehicles", long, value_name = "NORTH,EAST", allow_hyphen_values = true, value_parser = place)]
    origin: Option<[f32; 2]>,
    /// How far above or below its height a foreign vehicle may come before it is stopped, m [default: 5, or half of
    /// its height]
    #[arg(help_heading = "Foreign vehicles", long, value_name = "METRES", value_parser = positive)]
    vertical_limit: Option<f64>,
    /// What a foreign vehicle does when its flight is over
    #[arg(help_heading = "Foreign vehicles", long, value_enum, default_value = "hold")]
    end: WhenOver,
    /// Say where a foreign vehicle would fly, and end
    #[arg(help_heading = "Foreign vehicles", long)]
    dry_run: bool,
    /// Fly a foreign vehicle higher than 50 m, further than 150 m or faster than 10 m/s
    #[arg(help_heading = "Foreign vehicles", long)]
    yes: bool,
    /// Speed of a foreign vehicle's simulator relative to real time
    #[arg(help_heading = "Foreign vehicles", long, value_name = "X", default_value = "1", value_parser = speed)]
    speed: f64,
    /// Sign all messages with the key in this file: TOML with `key` (64 hexadecimal digits) or `passphrase`
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// How long to wait for the vehicle, for its first report, and for any next one
    #[arg(long, value_name = "SECONDS", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    timeout: u64,
    /// Who flies
    #[command(flatten)]
    identity: Identity,
    /// Controller to fly
    #[arg(long, value_parser = ControllerParser, default_value = "crpl")]
    controller: Controller,
    /// Stop after N control intervals [default: the scenario's horizon]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    ticks: Option<u64>,
    /// Run folder [default: runs/flight, or runs/flight-2 ... where that is taken]
    #[arg(long, value_name = "DIR", value_parser = folder)]
    out: Option<PathBuf>,
    /// Replace the flight that is in this folder
    #[arg(long)]
    overwrite: bool,
    /// Forward the flight to this endpoint, such as udpout:HOST:PORT; an operator there can take over by a
    /// change of mode; repeatable
    #[arg(long, value_name = "ENDPOINT", num_args = 1..)]
    forward: Vec<Endpoint>,
    #[command(flatten)]
    watch: SteerFlags,
    #[command(flatten)]
    map: MapFlags,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A flag's value: a direction.
fn degrees(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if (-360.0..=360.0).contains(&x) => Ok(x),
        _ => Err("must be a number of degrees from -360 to 360".into()),
    }
}

/// A flag's value: metres north and east.
fn place(text: &str) -> Result<[f32; 2], String> {
    let metres = |part: &str| part.trim().parse().ok().filter(|x: &f32| x.abs() <= 1e5);
    let place = text.split_once(',').and_then(|(north, east)| Some([metres(north)?, metres(east)?]));
    place.ok_or_else(|| "must be metres north and east of the vehicle's origin, such as 20,-5".into())
}

/// The autopilot whose protocol a vehicle follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum VehicleKind {
    /// The simulator of this project
    Sitl,
    /// ArduCopter, flown in GUIDED
    Ardupilot,
    /// PX4, flown in OFFBOARD
    Px4,
}

impl VehicleKind {
    fn foreign(self) -> Option<ForeignStack> {
        match self {
            Self::Sitl => None,
            Self::Ardupilot => Some(ForeignStack::Ardupilot),
            Self::Px4 => Some(ForeignStack::Px4),
        }
    }
}

async fn demo(args: Demo) -> Result<()> {
    let scenario = args.camera.scenario(&args.scenario)?;
    let mut models = args.models.load()?;
    policies::cover(&mut models, &args.controller, &scenario, args.models.optimise)?;
    let out = run_folder::fresh(args.out.as_deref(), "runs/demo")?;
    let page = args.watch.open()?;
    let mut shown = Shown { program: "gcs demo".into(), seed: Some(args.seed), ..Shown::default() };
    let mut flights = Vec::new();
    let mut exit = None;
    for controller in args.controller {
        shown.add(controller);
        let flight = DemoFlight {
            controller,
            scenario: &scenario,
            seed: args.seed,
            pace: args.pace,
            speed: args.speed,
            signing_key: args.signing_key.as_deref(),
            shown: &shown,
            live: page.as_ref().map(WatchPage::feed),
            forward: &args.forward,
        };
        let dir = out.join(controller.file_name());
        let landed = demo::fly(&models, &flight, &dir, args.overwrite).await?;
        flights.extend(landed.summary);
        exit = landed.exit;
        if exit.is_some() {
            break;
        }
    }
    let ended = report_flights(&flights, &out, args.json, exit);
    close(page, &flights, &ended).await;
    ended
}

async fn fly(args: Fly) -> Result<()> {
    let mut models = args.models.load()?;
    let out = run_folder::fresh(args.out.as_deref(), "runs/flight")?;
    let mut options = Options {
        ticks: args.ticks,
        system: args.sysid,
        signing_key: args.signing_key,
        forward: args.forward,
        timeout: Duration::from_secs(args.timeout),
        identity: args.identity,
        steering: None,
    };
    let foreign = args.vehicle.foreign().map(|stack| Foreign {
        stack,
        system: args.sysid,
        speed: args.speed,
        identity: args.identity,
        field: FieldFrame::heading(args.heading),
        origin: args.origin,
        vertical_limit: args.vertical_limit,
        over: args.end,
    });
    if foreign.is_some() && args.watch.control {
        bail!(
            "--control: a foreign vehicle is steered by an operator's station, or by `gcs bridge --control`"
        );
    }
    let (mut session, scenario) = match &foreign {
        Some(how) => {
            let mut scenario = args.camera.scenario(args.scenario.as_deref().unwrap_or("foreign"))?;
            scenario.scale.altitude_m = args.altitude.unwrap_or(scenario.scale.altitude_m);
            scenario.scale.metres_per_unit = args.field.unwrap_or(scenario.scale.metres_per_unit);
            let plan = FlightPlan::of(&scenario, how);
            if args.dry_run {
                crpl_sitl::outln!("{plan}");
                return Ok(());
            }
            if !args.yes && plan.is_large() {
                bail!("{plan}: give --yes if it may, or --altitude, --field and another --scenario");
            }
            (None, scenario)
        }
        None => {
            let met = world::meet(&options, &args.connect, args.scenario.as_deref(), &args.camera).await?;
            (Some(met.0), met.1)
        }
    };
    if policies::cover(&mut models, &[args.controller], &scenario, args.models.optimise)?
        && let Some(old) = session.take()
    {
        // The link has been left alone meanwhile: what waits in it is old.
        old.close().await;
        let mut again = options.find(&args.connect).await?;
        world::agree(&mut again, Some(scenario.clone())).await?;
        session = Some(again);
    }
    let station = models.station(args.controller, &scenario)?;
    let manifest = RunManifest::new(args.controller, None, station.policy().cloned());
    let folder = RunFolder::claim(&out, args.overwrite, &scenario, manifest)?;
    let buildings = args.map.load()?;
    let (page, requests) = args.watch.open()?;
    let shown = Shown { control: requests.is_some(), buildings, ..Shown::one("gcs fly", args.controller) };
    options.steering = requests;
    let live = page.as_ref().map(|page| page.feed().clone());
    let mut crew = LoggedStation::new(station, folder, args.controller, None).shown_as(shown, live);
    options.ticks = Some(args.ticks.unwrap_or(scenario.horizon));
    let flown = match (foreign, session) {
        (Some(how), _) => {
            let flown;
            (flown, crew) = foreign::fly(&args.connect, &scenario, &how, &options, crew).await?;
            flown
        }
        (None, Some(session)) => flight::fly_on(session, &scenario, &options, &mut crew).await?,
        (None, None) => flight::fly(&args.connect, &scenario, &options, &mut crew).await?,
    };
    let landed = crew.land(&flown);
    if landed.summary.is_none() && landed.exit.is_none() {
        bail!("the flight ended before its first interval");
    }
    let flights: Vec<Summary> = landed.summary.into_iter().collect();
    let ended = report_flights(&flights, &landed.dir, args.json, landed.exit);
    close(page, &flights, &ended).await;
    ended
}

/// Exit codes above it are a signal's.
const SIGNAL: u8 = 128;

/// The last line of the page: how the flights have ended.
async fn close(page: Option<WatchPage>, flights: &[Summary], ended: &Result<()>) {
    let Some(mut page) = page else { return };
    let exit = ended.as_ref().err().and_then(|error| error.downcast_ref::<ExitWith>());
    if exit.is_some_and(|exit| exit.code > SIGNAL) {
        page.hurry();
    }
    let reason = ended.as_ref().err().map_or_else(|| "over".into(), terminal::one_line);
    page.close(&reason, summary::by_vehicle(flights)).await;
}

/// Prints what was flown, then ends as the last flight did.
fn report_flights(flights: &[Summary], out: &Path, json: bool, exit: Option<ExitWith>) -> Result<()> {
    if !flights.is_empty() {
        print_flights(flights, json)?;
        if !json {
            crpl_sitl::outln!("records, tlog and plot in {}", out.display());
        }
    }
    exit.map_or(Ok(()), |exit| Err(exit.into()))
}

fn print_flights(flights: &[Summary], json: bool) -> Result<()> {
    if json {
        crpl_sitl::outln!("{}", serde_json::to_string(&serde_json::json!({ "flights": flights }))?);
    } else {
        crpl_sitl::out!("{}", summary::table(flights, columns::width()));
    }
    Ok(())
}

fn main() -> ExitCode {
    terminal::main(crpl_gcs::revision(), examples::EXAMPLES, |args: GcsArgs| match args.command {
        GcsCommand::Demo(args) => terminal::block_on(demo(args)),
        GcsCommand::Fly(args) => terminal::block_on(fly(args)),
        GcsCommand::Record(args) => terminal::block_on(record::run(args)),
        GcsCommand::Bridge(args) => terminal::block_on(bridge::run(args)),
        GcsCommand::Link(args) => terminal::block_on(link::run(args)),
        GcsCommand::Encode(args) => terminal::block_on(encode::run(args)),
        GcsCommand::Param(args) => terminal::block_on(param::run(args)),
        GcsCommand::Mission(args) => terminal::block_on(mission::run(args)),
        GcsCommand::Replay(args) => terminal::block_on(replay::run(args)),
        GcsCommand::Export(args) => export::run(&args),
        GcsCommand::Tlog(args) => tlog::run(&args),
        GcsCommand::Key(args) => key::run(&args),
        GcsCommand::Sitl(args) => terminal::block_on(crpl_sitl::program::cli::run(args)),
        GcsCommand::Episodes(args) => episodes::run(&args),
        GcsCommand::Fleet(args) => fleet::table::run(&args),
        GcsCommand::Optimise(args) => optimise::run(&args),
        GcsCommand::Check(args) => check::run(&args),
        GcsCommand::Bound(args) => bound::run(&args),
        GcsCommand::Sensitivity(args) => sensitivity::run(&args),
        GcsCommand::Tune(args) => tune::run(&args),
        GcsCommand::Sweep(args) => sweep::run(&args),
        GcsCommand::Merge(args) => merge::run(&args),
        GcsCommand::Scenario(args) => scenarios::run(&args),
        GcsCommand::Score(args) => flown::score(&args),
        GcsCommand::Compare(args) => flown::compare(&args),
        GcsCommand::Report(args) => report::run(&args),
    })
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;
    use crpl_sitl::program::common;

    use super::*;

    #[test]
    fn every_command_has_examples_that_parse() {
        assert_eq!(common::wrong_examples(GcsArgs::command(), examples::EXAMPLES), Vec::<String>::new());
    }
}
