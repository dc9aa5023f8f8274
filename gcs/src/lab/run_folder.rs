//! The folder of one flight: `config.toml` (the resolved scenario), `record.jsonl`, `flight.tlog`, `path.svg`,
//! `path.png`, and `run.json` (seed, revision, command line and summary).

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use crpl_model::evaluation::chart;
use crpl_sitl::Scenario;
use crpl_sitl::sim::metric::Metric;
use crpl_sitl::sim::record::Record;
use serde::Serialize;

use crate::lab::figures::FlightPath;
use crate::lab::summary::Summary;
use crate::station::pilot::Controller;

/// `run.json`: how the result was made.
#[derive(Debug, Serialize)]
struct RunManifest<'a> {
    controller: Controller,
    seed: Option<u64>,
    revision: &'static str,
    version: &'static str,
    command: Vec<String>,
    summary: &'a Summary,
}

/// The folder of one flight.
#[derive(Debug, Clone)]
pub struct RunFolder {
    dir: PathBuf,
}

impl RunFolder {
    /// Makes the folder and writes the resolved scenario, before the flight begins.
    ///
    /// # Errors
    /// The folder or the file cannot be written.
    pub fn begin(dir: &Path, scenario: &Scenario) -> Result<Self> {
        std::fs::create_dir_all(dir).with_context(|| format!("creating {}", dir.display()))?;
        let folder = Self { dir: dir.into() };
        let path = folder.config();
        std::fs::write(&path, toml::to_string(scenario)?)
            .with_context(|| format!("writing {}", path.display()))?;
        Ok(folder)
    }

    /// The resolved scenario.
    #[must_use]
    pub fn config(&self) -> PathBuf {
        self.dir.join("config.toml")
    }

    /// The log of all packets.
    #[must_use]
    pub fn tlog(&self) -> PathBuf {
        self.dir.join("flight.tlog")
    }

    /// Writes records, plot and manifest after the flight.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn finish(&self, summary: &Summary, records: &[Record], scenario: &Scenario) -> Result<()> {
        write_records(&self.dir.join("record.jsonl"), records)?;
        let d_f = summary.score[Metric::TerminalDistance];
        let title = format!("{}, {}, d_f {d_f:.3}", summary.controller, scenario.name);
        let path = FlightPath { title, records, scenario, size: FlightPath::ALONE };
        chart::save(&path, &self.dir, "path")?;
        let manifest = RunManifest {
            controller: summary.controller,
            seed: summary.seed,
            revision: crate::revision(),
            version: env!("CARGO_PKG_VERSION"),
            command: std::env::args().collect(),
            summary,
        };
        let path = self.dir.join("run.json");
        let text = serde_json::to_string_pretty(&manifest)? + "\n";
        std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))
    }
}

/// Writes records as JSON, one line per interval.
///
/// # Errors
/// The file cannot be written.
pub fn write_records(path: &Path, records: &[Record]) -> Result<()> {
    let context = || format!("writing {}", path.display());
    let mut file = std::io::BufWriter::new(std::fs::File::create(path).with_context(context)?);
    for record in records {
        serde_json::to_writer(&mut file, record).with_context(context)?;
        file.write_all(b"\n").with_context(context)?;
    }
    file.flush().with_context(context)
}
