//! The folder of one flight as the vehicle knows it: `sitl --out DIR`, whoever flies.
//!
//! `config.toml` (the resolved scenario), `record.jsonl` (a line per interval) and `run.json` are those of a run
//! folder of `gcs fly`; of a flight in lockstep `record.jsonl` is the same, byte for byte. What cannot be written
//! is said once and stops no flight.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use crate::program::files::write_whole;
use crate::scenario::Scenario;
use crate::sim::record::Record;

/// The resolved scenario.
pub const CONFIG: &str = "config.toml";
/// A line per control interval.
pub const RECORDS: &str = "record.jsonl";
/// How the flight was made, and how it has ended.
pub const MANIFEST: &str = "run.json";

/// The line of a record, with its end.
///
/// # Errors
/// None that a record has: all its values have a JSON form.
pub fn write_line(lines: &mut Vec<u8>, record: &Record) -> std::io::Result<()> {
    serde_json::to_writer(&mut *lines, record)?;
    lines.push(b'\n');
    Ok(())
}

/// The folder of a flight that is under way.
#[derive(Debug)]
pub struct FlightLog {
    dir: PathBuf,
    records: Option<File>,
    manifest: Value,
    failed: Option<String>,
}

impl FlightLog {
    /// Makes the folder of a flight that begins; one that holds a flight is refused, unless it may be overwritten.
    ///
    /// # Errors
    /// The folder holds another flight, or cannot be written.
    pub fn begin(dir: &Path, overwrite: bool, scenario: &Scenario, seed: u64) -> Result<Self> {
        let there = [CONFIG, RECORDS, MANIFEST].into_iter().find(|file| dir.join(file).exists());
        if let Some(file) = there.filter(|_| !overwrite) {
            bail!("{} holds a flight already ({file}): choose another --out, or --overwrite", dir.display());
        }
        let failed = |name: &str| format!("writing {}", dir.join(name).display());
        std::fs::create_dir_all(dir).with_context(|| format!("creating {}", dir.display()))?;
        std::fs::write(dir.join(CONFIG), toml::to_string(scenario)?).with_context(|| failed(CONFIG))?;
        let records = File::create(dir.join(RECORDS)).with_context(|| failed(RECORDS))?;
        let manifest = json!({
            "controller": "unknown",
            "seed": seed,
            "revision": crate::revision(),
            "version": env!("CARGO_PKG_VERSION"),
            "command": std::env::args().collect::<Vec<_>>(),
            "policy": null,
            "ended": null,
            "summary": null,
        });
        let log = Self { dir: dir.into(), records: Some(records), manifest, failed: None };
        log.write_manifest()?;
        Ok(log)
    }

    /// Writes these intervals; they are in the file when this returns.
    pub fn append(&mut self, records: &[Record]) {
        let Some(file) = self.records.as_mut().filter(|_| !records.is_empty()) else { return };
        let mut lines = Vec::new();
        let made = records.iter().try_for_each(|record| write_line(&mut lines, record));
        if let Err(error) = made.and_then(|()| file.write_all(&lines)) {
            self.records = None;
            self.fail(RECORDS, &error.into());
        }
    }

    /// Writes down how the flight has ended. What could not be written since the beginning, in one line.
    #[must_use]
    pub fn finish(mut self, how: &str, tick: u64) -> Option<String> {
        self.manifest["ended"] = json!({ "how": how, "tick": tick, "why": "" });
        if let Err(error) = self.write_manifest() {
            self.fail(MANIFEST, &error);
        }
        self.failed
    }

    fn write_manifest(&self) -> Result<()> {
        let path = self.dir.join(MANIFEST);
        let text = serde_json::to_string_pretty(&self.manifest)? + "\n";
        write_whole(&path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))
    }

    fn fail(&mut self, file: &str, error: &anyhow::Error) {
        tracing::error!("{file} in {}: {error:#}", self.dir.display());
        self.failed.get_or_insert_with(|| format!("{file} in {}: {error:#}", self.dir.display()));
    }
}
