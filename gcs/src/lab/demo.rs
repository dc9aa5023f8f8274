//! Controllers side by side against a `sitl` of one's own, over UDP on a free port.
//!
//! Each flight has its own vehicle with the same seed, so every controller meets the same gusts.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use crpl_sitl::Scenario;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::link::signing::{Policy, Store};
use crpl_sitl::program::cli::Pace;
use tokio::io::{AsyncBufReadExt, BufReader, Lines};
use tokio::process::{Child, ChildStdout, Command};
use tokio::time::timeout;

use crate::flight::{self, FlightEnd, Options};
use crate::lab::crew::{Landed, LoggedStation};
use crate::lab::run_folder::{RunFolder, RunManifest};
use crate::station::models::Models;
use crate::station::pilot::Controller;
use crate::watch::Shown;
use crate::watch::feed::Feed;

/// How long a vehicle may take to start, and to end after its last tick.
const PATIENCE: Duration = Duration::from_secs(20);

/// This program's file; where there is no /proc, as in a root that holds nothing else, the name that it was called by.
fn this_program() -> Result<PathBuf> {
    let called = || std::env::args_os().next().map(PathBuf::from);
    std::env::current_exe().or_else(|error| called().ok_or(error)).context("finding this program")
}

/// A `sitl` process that ends with us.
struct VehicleProcess {
    child: Child,
    stdout: Lines<BufReader<ChildStdout>>,
    endpoint: Endpoint,
}

impl VehicleProcess {
    async fn start(config: &Path, flight: &DemoFlight<'_>) -> Result<Self> {
        let program = this_program()?;
        let pace = match flight.pace {
            Pace::Lockstep => "lockstep",
            Pace::Realtime => "realtime",
        };
        let signing = flight.signing_key.map(vehicle_key).transpose()?;
        let signing = signing.iter().flat_map(|path| {
            [OsStr::new("--signing"), OsStr::new("required"), OsStr::new("--signing-key"), path.as_os_str()]
        });
        let mut child = Command::new(program)
            .args(["sitl", "--listen", "udpin:127.0.0.1:0", "--pace", pace])
            .args(["--seed", &flight.seed.to_string(), "--ticks", &flight.scenario.horizon.to_string()])
            .args(["--speed", &flight.speed.to_string()])
            .arg("--scenario")
            .arg(config)
            .args(signing)
            .env("RUST_LOG", "warn")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .context("starting the vehicle")?;
        let stdout = child.stdout.take().context("reading from the vehicle")?;
        let mut stdout = BufReader::new(stdout).lines();
        let line = timeout(PATIENCE, stdout.next_line()).await.context("the vehicle does not start")??;
        let Some(address) = line.as_deref().and_then(|l| l.strip_prefix("listening on udpin:")) else {
            bail!("the vehicle did not start: it said {line:?}");
        };
        let endpoint = format!("udpout:{address}").parse()?;
        Ok(Self { child, stdout, endpoint })
    }

    /// Waits for its end; a vehicle that fails fails the demo.
    async fn end(mut self) -> Result<()> {
        while timeout(PATIENCE, self.stdout.next_line()).await.context("the vehicle does not end")??.is_some()
        {
        }
        let status = timeout(PATIENCE, self.child.wait()).await.context("the vehicle does not end")??;
        if !status.success() {
            bail!("the vehicle ended with {status}");
        }
        Ok(())
    }
}

/// The vehicle's own file beside the station's: the same key, and timestamps that go on.
fn vehicle_key(path: &Path) -> Result<PathBuf> {
    let ours = Store::new(path);
    let wanted = ours.load(Policy::Required)?;
    ensure!(wanted.is_on(), "--signing-key: there is no key in {}", path.display());
    let theirs = ours.of_system(1);
    // The vehicle is the demo's own: it follows when the station's key is another one than before.
    if !theirs.load(Policy::Required)?.shares_key_with(&wanted) {
        theirs.save(&wanted, true)?;
    }
    Ok(theirs.path().to_path_buf())
}

/// One flight to fly.
#[derive(Debug, Clone, Copy)]
pub struct DemoFlight<'a> {
    /// Who flies.
    pub controller: Controller,
    /// Where.
    pub scenario: &'a Scenario,
    /// Seed of the disturbance.
    pub seed: u64,
    /// Who decides when an interval passes.
    pub pace: Pace,
    /// Speed relative to real time, where the pace is real time.
    pub speed: f64,
    /// File with the key of message signing, if the flight is signed.
    pub signing_key: Option<&'a Path>,
    /// Under which names it is shown.
    pub shown: &'a Shown,
    /// Where others watch, if they can.
    pub live: Option<&'a Feed>,
    /// Endpoints that watch the flight.
    pub forward: &'a [Endpoint],
}

/// The scenario as a file for the vehicle, which is removed with this.
struct ScenarioFile(PathBuf);

impl ScenarioFile {
    fn write(scenario: &Scenario, controller: Controller) -> Result<Self> {
        let name = format!("crpl-demo-{}-{}.toml", std::process::id(), controller.file_name());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, toml::to_string(scenario)?)
            .with_context(|| format!("writing {}", path.display()))?;
        Ok(Self(path))
    }
}

impl Drop for ScenarioFile {
    fn drop(&mut self) {
        // It is in the system's folder of such files, and small.
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Starts a vehicle, flies it, and leaves the run folder `dir`.
///
/// # Errors
/// A vehicle that does not start, a controller without policies, a folder that holds another flight.
pub async fn fly(models: &Models, flight: &DemoFlight<'_>, dir: &Path, overwrite: bool) -> Result<Landed> {
    let (scenario, seed) = (flight.scenario, Some(flight.seed));
    let station = models.station(flight.controller, scenario)?;
    let manifest = RunManifest::new(flight.controller, seed, station.policy().cloned());
    let folder = RunFolder::claim(dir, overwrite, scenario, manifest)?;
    let mut crew = LoggedStation::new(station, folder, flight.controller, seed)
        .shown_as(flight.shown.clone(), flight.live.cloned());
    let config = ScenarioFile::write(scenario, flight.controller)?;
    let vehicle = VehicleProcess::start(&config.0, flight).await?;
    let options = Options {
        ticks: Some(scenario.horizon),
        system: Some(1),
        signing_key: flight.signing_key.map(Path::to_path_buf),
        forward: flight.forward.to_vec(),
        ..Options::default()
    };
    let flown = flight::fly(&vehicle.endpoint, scenario, &options, &mut crew).await?;
    if flown.ended == FlightEnd::Over {
        vehicle.end().await?;
    }
    Ok(crew.land(&flown))
}
