//! A flight from the disk: a run folder, a file of records, or the log of a flight with `sitl`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use crpl_sitl::Scenario;
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::tlog::TlogReader;
use crpl_sitl::link::wire::{Clock, TelemetryReader};
use crpl_sitl::program::flight_log::{CONFIG, MANIFEST, RECORDS};
use crpl_sitl::radio::message::{Command, Telemetry};
use crpl_sitl::sim::record::Record;

/// A flight on the disk.
#[derive(Debug)]
pub struct FlownFlight {
    /// Where it is.
    pub path: PathBuf,
    /// In which world it took place.
    pub scenario: Scenario,
    /// Its intervals.
    pub records: Vec<Record>,
    /// Who flew; `unknown` where nobody has said so.
    pub controller: String,
    /// Seed of the gusts, if it is known.
    pub seed: Option<u64>,
}

/// Reads a flight. `scenario` is that of a file without one beside it.
///
/// # Errors
/// There is no flight, or its scenario is not known.
pub fn flight(path: &Path, scenario: Option<&Scenario>) -> Result<FlownFlight> {
    let dir = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new(".")) };
    let file = if path.is_dir() { dir.join(RECORDS) } else { path.into() };
    if !file.exists() {
        bail!("{} holds no flight: there is no {}", path.display(), file.display());
    }
    let config = dir.join(CONFIG);
    let scenario = match scenario {
        Some(scenario) => scenario.clone(),
        None if config.exists() => Scenario::load(&config)?,
        None => bail!(
            "{}: in which scenario was it? There is no {CONFIG} beside it: give --scenario",
            path.display()
        ),
    };
    let bytes = std::fs::read(&file).with_context(|| format!("reading {}", file.display()))?;
    let is_log = file.extension().is_some_and(|extension| extension == "tlog");
    let records = if is_log { of_log(&bytes, &scenario) } else { of_lines(&bytes) };
    let records = records.with_context(|| format!("reading {}", file.display()))?;
    let (controller, seed) = manifest(&dir.join(MANIFEST));
    Ok(FlownFlight { path: path.into(), scenario, records, controller, seed })
}

/// Who flew, and with which seed, as far as that is known.
fn manifest(path: &Path) -> (String, Option<u64>) {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let manifest: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let controller = manifest["controller"].as_str().unwrap_or("unknown");
    (controller.into(), manifest["seed"].as_u64())
}

fn of_lines(bytes: &[u8]) -> Result<Vec<Record>> {
    let text = std::str::from_utf8(bytes)?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines.map(|(n, line)| serde_json::from_str(line).with_context(|| format!("line {}", n + 1))).collect()
}

/// The intervals between the reports of the first vehicle in a log. A log does not say which command was lost: what
/// was flown stands for what was asked.
fn of_log(bytes: &[u8], scenario: &Scenario) -> Result<Vec<Record>> {
    let (clock, mut reader) = (Clock::new(scenario), TelemetryReader::default());
    let mut reports: Vec<Telemetry> = Vec::new();
    for frame in TlogReader::new(bytes) {
        let Some(report) = reader.push(&Packet::from(frame.packet), &clock) else { continue };
        // A report that comes again is no new interval.
        if reports.last().is_none_or(|last| report.tick > last.tick) {
            reports.push(report);
        }
    }
    if reports.len() < 2 {
        bail!("no two reports of sitl in this scenario are in it");
    }
    let record = |pair: &[Telemetry]| {
        let (before, after) = (&pair[0], &pair[1]);
        let accel = after.held.map_or([0.0; 2], |held| held.accel);
        let power = after.link.map(|link| link.power).unwrap_or_default();
        Record::new(before, &Command::new(before.tick, accel, power), after, scenario)
    };
    Ok(reports.windows(2).map(record).collect())
}
