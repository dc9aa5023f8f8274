//! The folder of a sweep: `sweep.toml` says what it is, `episodes.part.csv` holds what is flown so far;
//! at the end `episodes.csv`, `episodes.parquet` and `points.csv` hold the result.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use crpl_sitl::program::files::write_whole;
use crpl_sitl::program::shard::Shard;
use serde::{Deserialize, Serialize};

use super::axis::SweepPoint;
use super::episode::{self, SweepEpisode};
use super::journal::Journal;
use super::plan::SweepPlan;
use super::{figure, table};
use crate::tools::parquet;

/// What `sweep.toml` says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SweepManifest {
    hash: String,
    shard: String,
    revision: String,
    plan: SweepPlan,
}

/// A sweep's folder, which belongs to a plan and one of its shards.
#[derive(Debug, Clone)]
pub struct Folder {
    dir: PathBuf,
    /// What is flown.
    pub plan: SweepPlan,
    /// Which shard of it.
    pub shard: Shard,
    /// Revision at which it was begun.
    revision: String,
}

/// How far a folder is.
#[derive(Debug)]
pub enum Progress {
    /// All episodes, in order.
    Finished(Vec<SweepEpisode>),
    /// These so far.
    Begun(Journal, Vec<SweepEpisode>),
}

impl Folder {
    /// Begins a folder, or resumes one of the same plan and shard, at whatever revision it was begun: the plan
    /// names all that decides the numbers.
    ///
    /// # Errors
    /// The folder holds another sweep, or cannot be written.
    pub fn begin(dir: &Path, plan: SweepPlan, shard: Shard) -> Result<Self> {
        let folder = Self { dir: dir.into(), plan, shard, revision: crate::revision().into() };
        if folder.path("sweep.toml").exists() {
            let there = Self::open(dir)?;
            if let Some(difference) = folder.plan.difference(&there.plan)? {
                bail!(
                    "{} holds another sweep: {difference} there; choose another --out or remove it",
                    dir.display()
                );
            }
            if there.shard != shard {
                bail!("{} holds shard {}, not {shard}", dir.display(), there.shard);
            }
            return Ok(there);
        }
        std::fs::create_dir_all(dir).with_context(|| format!("creating {}", dir.display()))?;
        folder.write_manifest()?;
        Ok(folder)
    }

    /// Opens a folder as it is.
    ///
    /// # Errors
    /// The folder holds no sweep, or its manifest was changed.
    pub fn open(dir: &Path) -> Result<Self> {
        let path = dir.join("sweep.toml");
        let name = path.display();
        let text = std::fs::read_to_string(&path)
            .with_context(|| format!("{} is not a sweep's folder: reading {name}", dir.display()))?;
        let manifest: SweepManifest = toml::from_str(&text).with_context(|| format!("reading {name}"))?;
        if manifest.hash != manifest.plan.hash()? {
            bail!("{name}: was changed after it was written: its hash is not {}", manifest.hash);
        }
        let shard = manifest.shard.parse().map_err(|e| anyhow::anyhow!("{name}: shard {e}"))?;
        Ok(Self { dir: dir.into(), plan: manifest.plan, shard, revision: manifest.revision })
    }

    /// Where it lies.
    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// What is there already.
    ///
    /// # Errors
    /// A table that does not read, or has lines of another sweep.
    pub fn progress(&self) -> Result<Progress> {
        if let Some(episodes) = self.finished()? {
            return Ok(Progress::Finished(episodes));
        }
        let (journal, episodes) = Journal::open(&self.part(), self.plan.axis_count())?;
        self.check_belong(&episodes, &self.part())?;
        Ok(Progress::Begun(journal, episodes))
    }

    /// All episodes, if the sweep is finished.
    ///
    /// # Errors
    /// A table that does not read, is not complete, or has lines of another sweep.
    pub fn finished(&self) -> Result<Option<Vec<SweepEpisode>>> {
        let path = self.path("episodes.csv");
        let table = match std::fs::read(&path) {
            Ok(table) => table,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error).with_context(|| format!("reading {}", path.display())),
        };
        let episodes = SweepEpisode::read(&table).with_context(|| path.display().to_string())?;
        self.check_belong(&episodes, &path)?;
        let episodes = self.in_order(episodes);
        episodes.map(Some).with_context(|| format!("{} is not complete", path.display()))
    }

    /// Writes the results; `episodes.csv` comes last, and says that all is there.
    ///
    /// # Errors
    /// An episode is missing, or a file cannot be written.
    pub fn finish(&self, episodes: Vec<SweepEpisode>) -> Result<Vec<SweepEpisode>> {
        let episodes = self.in_order(episodes)?;
        let rows = table::rows(&self.plan, &episodes);
        self.write("points.csv", table::csv(&self.plan, &rows).as_bytes())?;
        if self.plan.second.is_some() {
            figure::save(&self.plan, &rows, &self.dir)?;
        }
        let names: Vec<String> = episodes.iter().map(|e| e.controller.to_string()).collect();
        let mut bytes = Vec::new();
        let manifest = self.manifest()?;
        parquet::write(&mut bytes, &SweepEpisode::columns(&episodes, &names), &[("sweep.toml", &manifest)])?;
        self.write("episodes.parquet", &bytes)?;
        let lines = std::iter::once(episode::line(SweepEpisode::head(self.plan.axis_count())))
            .chain(episodes.iter().map(SweepEpisode::line));
        self.write("episodes.csv", &lines.flatten().collect::<Vec<u8>>())?;
        Ok(episodes)
    }

    /// Point, controller and seed of every episode: points in their order, controllers in theirs, seeds ascending.
    fn units(&self) -> impl Iterator<Item = (SweepPoint, crate::station::pilot::Controller, u64)> {
        let plan = &self.plan;
        plan.grid().into_iter().flat_map(move |point| {
            plan.controllers
                .iter()
                .flat_map(move |c| plan.seeds_of(self.shard).map(move |seed| (point, *c, seed)))
        })
    }

    fn check_belong(&self, episodes: &[SweepEpisode], path: &Path) -> Result<()> {
        let plan = &self.plan;
        let grid = plan.grid();
        let belongs = |e: &SweepEpisode| {
            grid.contains(&e.point)
                && plan.controllers.contains(&e.controller)
                && plan.seeds().contains(&e.seed)
                && self.shard.has(e.seed - plan.first_seed)
        };
        match episodes.iter().position(|e| !belongs(e)) {
            Some(n) => bail!("{}: line {} is not of this sweep", path.display(), n + 2),
            None => Ok(()),
        }
    }

    fn in_order(&self, episodes: Vec<SweepEpisode>) -> Result<Vec<SweepEpisode>> {
        let key = |point: SweepPoint, controller, seed| (point.bits(), controller, seed);
        let mut found: BTreeMap<_, SweepEpisode> =
            episodes.into_iter().map(|e| (key(e.point, e.controller, e.seed), e)).collect();
        let mut next = |(point, controller, seed)| {
            found
                .remove(&key(point, controller, seed))
                .with_context(|| format!("{}, {controller}, seed {seed} is missing", self.plan.at(point)))
        };
        self.units().map(&mut next).collect()
    }

    fn manifest(&self) -> Result<String> {
        let manifest = SweepManifest {
            hash: self.plan.hash()?,
            shard: self.shard.to_string(),
            revision: self.revision.clone(),
            plan: self.plan.clone(),
        };
        Ok(toml::to_string(&manifest)?)
    }

    fn write_manifest(&self) -> Result<()> {
        self.write("sweep.toml", self.manifest()?.as_bytes())
    }

    /// Writes a whole file or none: a reader never sees half of one.
    fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.path(name);
        write_whole(&path, bytes).with_context(|| format!("writing {}", path.display()))
    }

    fn part(&self) -> PathBuf {
        self.path("episodes.part.csv")
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.join(name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::sweep::plan::{Overrides, SweepFile, SweepModels};

    #[test]
    fn a_sweep_goes_on_at_another_revision_of_the_same_code_only() {
        let file = "name = \"small\"\naxis = \"radio.b_dt\"\npoints = [2.5]\ncontrollers = [\"rcc\"]\n";
        let file = SweepFile::parse(file).unwrap();
        let plan = file.resolve(&Overrides::default(), |_| Ok(SweepModels::default())).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let begin = |plan: &SweepPlan| Folder::begin(dir.path(), plan.clone(), Shard::WHOLE);
        begin(&plan).unwrap();
        let path = dir.path().join("sweep.toml");
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace(crate::revision(), "another")).unwrap();
        let folder = begin(&plan).unwrap();
        assert!(folder.manifest().unwrap().contains("revision = \"another\""));
        let other = SweepPlan { code: "another".into(), ..plan };
        let error = begin(&other).unwrap_err().to_string();
        assert!(error.contains("holds another sweep: code = \"another\""), "{error}");
    }
}
