//! The folder of a recording: episodes, `run.json`, and in `truth` what only evaluation opens.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use crpl_model::world_model::recording::{TRUTH, episode_paths};
use crpl_sitl::Scenario;

/// How the recording was made.
pub const MANIFEST: &str = "run.json";

/// A folder to record into.
#[derive(Debug)]
pub struct RecordingFolder {
    dir: PathBuf,
    overwrite: bool,
    next: usize,
}

impl RecordingFolder {
    /// A folder for a flight that has not begun; nothing is touched yet. `resume` goes on after the episodes that
    /// are there.
    ///
    /// # Errors
    /// It holds a recording, and is neither to be overwritten nor to go on.
    pub fn claim(dir: &Path, overwrite: bool, resume: bool) -> Result<Self> {
        let there = if dir.is_dir() { episode_paths(dir)? } else { Vec::new() };
        let next =
            if resume { there.iter().filter_map(|path| index(path)).max().map_or(0, |n| n + 1) } else { 0 };
        let held = there.first().cloned().or_else(|| Some(dir.join(MANIFEST)).filter(|path| path.exists()));
        if let Some(held) = held.filter(|_| !overwrite && !resume) {
            let (dir, file) = (dir.display(), held.file_name().unwrap_or_default().display());
            bail!("{dir} holds a recording already ({file}): choose another --out, --resume or --overwrite");
        }
        Ok(Self { dir: dir.into(), overwrite, next })
    }

    /// Makes the folder, without the recording that is overwritten, and writes the vehicle's world.
    ///
    /// # Errors
    /// A file or folder cannot be written or removed.
    pub fn begin(&self, scenario: &Scenario) -> Result<()> {
        let truth = self.dir.join(TRUTH);
        if self.overwrite && self.dir.is_dir() {
            let old = episode_paths(&self.dir)?;
            for path in old.into_iter().chain([truth.clone(), self.dir.join(MANIFEST)]) {
                remove(&path).with_context(|| format!("removing {}", path.display()))?;
            }
        }
        std::fs::create_dir_all(&truth).with_context(|| format!("creating {}", truth.display()))?;
        let path = truth.join(format!("scenario-{:05}.toml", self.next));
        std::fs::write(&path, toml::to_string(scenario)?)
            .with_context(|| format!("writing {}", path.display()))
    }

    /// Where it is.
    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Index of the next episode.
    #[must_use]
    pub fn next(&self) -> usize {
        self.next
    }

    /// The next episode is there.
    pub fn count(&mut self) {
        self.next += 1;
    }
}

/// The number of an episode's file or folder.
fn index(path: &Path) -> Option<usize> {
    path.file_stem()?.to_str()?.strip_prefix("episode-")?.parse().ok()
}

fn remove(path: &Path) -> std::io::Result<()> {
    if path.is_dir() {
        std::fs::remove_dir_all(path)
    } else if path.exists() {
        std::fs::remove_file(path)
    } else {
        Ok(())
    }
}
