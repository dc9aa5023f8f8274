//! The finished episodes of a sweep that is still running: a table that only grows, a line at a time.
//!
//! Whatever ends the process, the lines stay; a last line that was cut is dropped and flown again.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, bail};

use super::episode::{self, SweepEpisode};

/// How often the lock is tried, every 50 ms.
const PATIENCE: u32 = 20;

/// An open journal. Only one process may hold it.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: Mutex<File>,
}

impl Journal {
    /// Opens or begins a journal of a sweep over so many axes, and gives the episodes that stand in it.
    ///
    /// # Errors
    /// The file cannot be read or written, or is no journal.
    pub fn open(path: &Path, axes: usize) -> Result<(Self, Vec<SweepEpisode>)> {
        let name = path.display();
        let mut file = OpenOptions::new()
            .read(true)
            .append(true)
            .create(true)
            .open(path)
            .with_context(|| format!("opening {name}"))?;
        lock(&file, path)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).with_context(|| format!("reading {name}"))?;
        let whole = bytes.iter().rposition(|b| *b == b'\n').map_or(0, |last| last + 1);
        file.set_len(whole as u64).with_context(|| format!("cutting the torn end off {name}"))?;
        file.seek(SeekFrom::End(0)).with_context(|| format!("reading {name}"))?;
        let episodes = if whole == 0 {
            file.write_all(&episode::line(SweepEpisode::head(axes)))
                .with_context(|| format!("writing {name}"))?;
            Vec::new()
        } else {
            SweepEpisode::read(&bytes[..whole]).with_context(|| name.to_string())?
        };
        Ok((Self { path: path.into(), file: Mutex::new(file) }, episodes))
    }

    /// Writes an episode down, in one write.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn add(&self, episode: &SweepEpisode) -> Result<()> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.write_all(&episode.line()).with_context(|| format!("writing {}", self.path.display()))
    }

    /// Removes the journal, once its episodes stand elsewhere.
    ///
    /// # Errors
    /// The file cannot be removed.
    pub fn remove(self) -> Result<()> {
        std::fs::remove_file(&self.path).with_context(|| format!("removing {}", self.path.display()))
    }
}

/// Keeps other processes out. One that was killed just now may hold the lock for a moment longer.
fn lock(file: &File, path: &Path) -> Result<()> {
    for _ in 0..PATIENCE {
        match file.try_lock() {
            Ok(()) => return Ok(()),
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(50)),
            Err(TryLockError::Error(error)) => {
                return Err(error).with_context(|| format!("locking {}", path.display()));
            }
        }
    }
    bail!("{}: another process is writing it", path.display())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::sweep::axis::SweepPoint;
    use crpl_sitl::sim::metric::PerMetric;

    use crate::station::pilot::Controller;

    fn episode(seed: u64) -> SweepEpisode {
        let metrics = PerMetric::from_fn(|m| 0.1 * (m as usize + 1) as f64 / (seed + 1) as f64);
        let outcomes = [true, true, false];
        SweepEpisode { point: SweepPoint::on(2.5), controller: Controller::Rcc, seed, metrics, outcomes }
    }

    #[test]
    fn a_journal_goes_on_where_it_was_cut_at_any_byte() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.csv");
        let (journal, none) = Journal::open(&path, 1).unwrap();
        assert!(none.is_empty());
        (0..3).for_each(|seed| journal.add(&episode(seed)).unwrap());
        drop(journal);
        let whole = std::fs::read(&path).unwrap();
        for cut in 0..=whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let (journal, kept) = Journal::open(&path, 1).unwrap();
            (kept.len() as u64..3).for_each(|seed| journal.add(&episode(seed)).unwrap());
            drop(journal);
            assert_eq!(std::fs::read(&path).unwrap(), whole, "cut at {cut}");
        }
    }

    #[test]
    fn two_processes_cannot_write_one_journal() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.csv");
        let _held = Journal::open(&path, 1).unwrap();
        let error = Journal::open(&path, 1).unwrap_err().to_string();
        assert!(error.ends_with("another process is writing it"), "{error}");
    }

    #[test]
    fn a_line_that_is_none_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.csv");
        let error = |table: &[u8]| {
            std::fs::write(&path, table).unwrap();
            crpl_sitl::program::terminal::one_line(&Journal::open(&path, 1).unwrap_err())
        };
        let said =
            error(&[&episode::line(SweepEpisode::head(1))[..], &episode(0).line(), b"nonsense\n"].concat());
        let columns = SweepEpisode::head(1).count();
        assert!(said.ends_with(&format!("journal.csv: line 3: 1 columns instead of {columns}")), "{said}");
        assert!(error(b"a,b\n").ends_with("line 1 is not the head of a table of episodes"));
    }
}
