//! The folder of one flight: `config.toml` (the resolved scenario), `record.jsonl`, `flight.tlog`, the figure `path`
//! (`.svg`, `.pdf`, `.png`, its points as CSV), `flight.html` (the flight as a page) and `run.json` (seed, revision,
//! command line, policy, end and summary).
//!
//! A folder holds one flight. It is made when the flight begins, grows with it, and says in `run.json` how the
//! flight has ended; while that is `null`, it has not. What cannot be written, on a full disk for one, is said
//! once and stops no flight.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use crpl_model::evaluation::chart;
use crpl_sitl::Scenario;
use crpl_sitl::program::files::write_whole;
use crpl_sitl::program::flight_log;
use crpl_sitl::sim::metric::Metric;
use crpl_sitl::sim::record::Record;
use serde::Serialize;

use crate::flight::FlightEnd;
use crate::lab::figures::FlightPath;
use crate::lab::summary::{FlightEnded, Summary};
use crate::station::models::PolicyOrigin;
use crate::station::pilot::Controller;

/// `run.json`: how the result was made.
#[derive(Debug, Clone, Serialize)]
pub struct RunManifest {
    /// Who flies.
    pub controller: Controller,
    /// Seed of the gusts; `None` if another process started the vehicle.
    pub seed: Option<u64>,
    revision: &'static str,
    version: &'static str,
    command: Vec<String>,
    /// Where the controller's policies come from, and where the scenario leaves their world.
    policy: Option<PolicyOrigin>,
    /// `None` while it flies.
    ended: Option<FlightEnded>,
    /// `None` if no interval was flown.
    summary: Option<Summary>,
}

impl RunManifest {
    /// That of a flight that begins.
    #[must_use]
    pub fn new(controller: Controller, seed: Option<u64>, policy: Option<PolicyOrigin>) -> Self {
        Self {
            controller,
            seed,
            revision: crate::revision(),
            version: env!("CARGO_PKG_VERSION"),
            command: std::env::args().collect(),
            policy,
            ended: None,
            summary: None,
        }
    }
}

impl RunManifest {
    /// Whether policies of another world fly.
    fn is_mismatched(&self) -> bool {
        let differs = self.policy.as_ref().is_some_and(|policy| !policy.differences.is_empty());
        differs && self.controller.flies_policies()
    }
}

/// The files of a flight.
const FILES: [&str; 9] = [
    "config.toml",
    "run.json",
    "record.jsonl",
    "flight.tlog",
    "path.svg",
    "path.pdf",
    "path.png",
    "path_points.csv",
    "flight.html",
];

/// Fresh folders that are tried.
const TRIES: usize = 10_000;

/// The folder of one flight.
#[derive(Debug)]
pub struct RunFolder {
    dir: PathBuf,
    overwrite: bool,
    manifest: RunManifest,
    scenario: Scenario,
    records: Option<File>,
    written: usize,
    failed: Option<String>,
}

/// `wanted`, if given; else the first of `base`, `base-2`, `base-3` ... that holds nothing.
///
/// # Errors
/// There are too many.
pub fn fresh(wanted: Option<&Path>, base: &str) -> Result<PathBuf> {
    if let Some(wanted) = wanted {
        return Ok(wanted.into());
    }
    let is_free = |dir: &PathBuf| std::fs::read_dir(dir).map_or(true, |mut there| there.next().is_none());
    let names = std::iter::once(base.to_owned()).chain((2..TRIES).map(|n| format!("{base}-{n}")));
    names
        .map(PathBuf::from)
        .find(is_free)
        .with_context(|| format!("{base}: every folder of this name is taken"))
}

impl RunFolder {
    /// A folder for a flight that has not begun; nothing is touched yet.
    ///
    /// # Errors
    /// The folder holds another flight, and is not to be overwritten.
    pub fn claim(dir: &Path, overwrite: bool, scenario: &Scenario, manifest: RunManifest) -> Result<Self> {
        if let Some(file) = FILES.iter().find(|file| dir.join(file).exists()).filter(|_| !overwrite) {
            bail!("{} holds a flight already ({file}): choose another --out, or --overwrite", dir.display());
        }
        let (dir, scenario) = (dir.into(), scenario.clone());
        Ok(Self { dir, overwrite, manifest, scenario, records: None, written: 0, failed: None })
    }

    /// Makes the folder, without the files of a flight that is overwritten, and writes what is known before the
    /// flight. Gives the file of the tlog.
    ///
    /// # Errors
    /// The folder or a file cannot be written.
    pub fn begin(&mut self) -> Result<PathBuf> {
        std::fs::create_dir_all(&self.dir).with_context(|| format!("creating {}", self.dir.display()))?;
        for file in FILES.into_iter().filter(|_| self.overwrite) {
            let path = self.dir.join(file);
            if path.exists() {
                std::fs::remove_file(&path).with_context(|| format!("removing {}", path.display()))?;
            }
        }
        let path = self.dir.join("config.toml");
        std::fs::write(&path, toml::to_string(&self.scenario)?)
            .with_context(|| format!("writing {}", path.display()))?;
        self.write_manifest()?;
        let path = self.dir.join("record.jsonl");
        self.records = Some(File::create(&path).with_context(|| format!("creating {}", path.display()))?);
        Ok(self.dir.join("flight.tlog"))
    }

    /// Where it is.
    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Appends the records that are not written yet; each line is in the file when this returns.
    pub fn record(&mut self, records: &[Record]) {
        let stamped = self.manifest.is_mismatched();
        let Some(file) = &mut self.records else { return };
        let mut lines = Vec::new();
        let made = records
            .iter()
            .skip(self.written)
            .try_for_each(|record| write_record(&mut lines, record, stamped));
        self.written = records.len();
        if let Err(error) = made.and_then(|()| file.write_all(&lines)) {
            self.records = None;
            self.fail("record.jsonl", &error.into());
        }
    }

    /// Writes the flight as a page.
    pub fn page(&mut self, html: &str) {
        let path = self.dir.join("flight.html");
        if let Err(error) = write_whole(&path, html.as_bytes()) {
            self.fail("flight.html", &error.into());
        }
    }

    /// Writes the plot and the end. What could not be written since the beginning, in one line.
    pub fn finish(
        mut self,
        ended: FlightEnded,
        summary: Option<Summary>,
        records: &[Record],
    ) -> Option<String> {
        self.record(records);
        if let Some(summary) = &summary {
            let d_f = summary.score[Metric::TerminalDistance];
            let (controller, name) = (summary.controller, &self.scenario.name);
            let mut title = format!("{controller}, {name}, d_f {d_f:.3}");
            if ended.how != FlightEnd::Over {
                title += &format!(", {}", ended.how.key());
            }
            if self.manifest.is_mismatched() {
                title += ", policy of another world";
            }
            let path = FlightPath { title, records, scenario: &self.scenario, panel: false };
            if let Err(error) = chart::save(&path.chart(), &self.dir, "path") {
                self.fail("path", &error.into());
            }
        }
        (self.manifest.ended, self.manifest.summary) = (Some(ended), summary);
        if let Err(error) = self.write_manifest() {
            self.fail("run.json", &error);
        }
        self.failed
    }

    fn write_manifest(&self) -> Result<()> {
        let path = self.dir.join("run.json");
        let text = serde_json::to_string_pretty(&self.manifest)? + "\n";
        write_whole(&path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))
    }

    fn fail(&mut self, file: &str, error: &anyhow::Error) {
        tracing::error!("{file} in {}: {error:#}", self.dir.display());
        self.failed.get_or_insert_with(|| format!("{file} in {}: {error:#}", self.dir.display()));
    }
}

/// One line; `stamped`: flown by policies of another world, which the line then says.
fn write_record(lines: &mut Vec<u8>, record: &Record, stamped: bool) -> std::io::Result<()> {
    if stamped {
        let mut line = serde_json::to_value(record)?;
        line["policy_mismatch"] = true.into();
        serde_json::to_writer(&mut *lines, &line)?;
        lines.push(b'\n');
        Ok(())
    } else {
        flight_log::write_line(lines, record)
    }
}

/// Writes records as JSON, one line per interval.
///
/// # Errors
/// The file cannot be written.
pub fn write_records(path: &Path, records: &[Record]) -> Result<()> {
    let mut lines = Vec::new();
    records
        .iter()
        .try_for_each(|record| write_record(&mut lines, record, false))
        .and_then(|()| std::fs::write(path, &lines))
        .with_context(|| format!("writing {}", path.display()))
}
