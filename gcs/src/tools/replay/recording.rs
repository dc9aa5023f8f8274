//! A recording of `gcs record` as flights: one record an interval, and the picture at its beginning.

use std::path::Path;

use anyhow::{Context, Result, bail};
use crpl_model::world_model::recording::{Recording, TRUTH, Truth, episode_paths};
use crpl_sitl::Scenario;
use crpl_sitl::camera::Frame;
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::{Tick, TxPower};
use crpl_sitl::world::obstacles::Obstacles;
use nalgebra::Vector2;

/// The episodes of a recording, one after the other, with an interval left out between them.
#[derive(Debug)]
pub struct ReplayedRecording {
    recording: Recording,
    /// The vehicle's world.
    pub scenario: Scenario,
    /// All intervals.
    pub records: Vec<Record>,
    /// Of each interval, the episode and the picture at its beginning.
    pictures: Vec<(usize, usize)>,
}

/// Whether a folder holds a recording.
#[must_use]
pub fn is_recording(dir: &Path) -> bool {
    dir.is_dir() && episode_paths(dir).is_ok_and(|paths| !paths.is_empty())
}

impl ReplayedRecording {
    /// Reads a folder of `gcs record`.
    ///
    /// # Errors
    /// It does not read, or says nowhere where the vehicle was.
    pub fn open(dir: &Path) -> Result<Self> {
        let recording = Recording::open(dir, None)?;
        let scenario = scenario(dir)?;
        let (mut records, mut pictures) = (Vec::new(), Vec::new());
        for (index, episode) in recording.episodes().iter().enumerate() {
            let truth = Truth::load(dir, index)
                .context("a replay tells where the vehicle was, which this recording does not")?;
            let length = episode.len().min(truth.uav.len());
            let first = records.last().map_or(0, |last: &Record| last.tick.0 + 2);
            for k in 0..length.saturating_sub(1) {
                let (step, next) = (&episode.steps[k], &episode.steps[k + 1]);
                let (r, r_next) = (truth.uav[k], truth.uav[k + 1]);
                let obstacles = obstacles(&truth, k + 1, &scenario);
                let flown = episode.actions.get(k).map_or(Vector2::zeros(), |a| a.map(f64::from));
                let tick = Tick(first + k as u64);
                records.push(Record {
                    tick,
                    r,
                    v: if k == 0 { r_next - r } else { r - truth.uav[k - 1] },
                    wish: flown,
                    power: if step.power > 1.0 { TxPower::High } else { TxPower::Low },
                    snr_db: step.snr_db,
                    outage: next.outage,
                    flown_tick: Some(tick),
                    flown,
                    r_next,
                    v_next: r_next - r,
                    p_coll: obstacles.collision_probability(r_next, &scenario),
                    obstacles,
                    collided: next.contact,
                    edge: r_next.iter().any(|x| *x <= 0.0 || *x >= 1.0),
                });
                pictures.push((index, k));
            }
        }
        if records.is_empty() {
            bail!("{}: no episode in it has two pictures", dir.display());
        }
        Ok(Self { recording, scenario, records, pictures })
    }

    /// The picture at the beginning of an interval.
    #[must_use]
    pub fn frame(&self, record: usize) -> Option<Frame> {
        let (episode, k) = *self.pictures.get(record)?;
        self.recording.episodes().get(episode)?.frame(k).ok()
    }
}

/// Where the obstacles were at a picture: the first as it was told, others where the scenario has them.
fn obstacles(truth: &Truth, k: usize, scenario: &Scenario) -> Obstacles {
    let mut all: Obstacles = scenario.obstacles.iter().map(|obstacle| obstacle.position).collect();
    if let (Some(first), Some(told)) = (all.first_mut(), truth.obstacle.get(k)) {
        *first = *told;
    }
    all
}

/// The world of the first flight that was recorded, else the paper's.
fn scenario(dir: &Path) -> Result<Scenario> {
    let Ok(inside) = std::fs::read_dir(dir.join(TRUTH)) else { return Ok(Scenario::default()) };
    let is_scenario = |path: &std::path::PathBuf| path.extension().is_some_and(|end| end == "toml");
    let first = inside.filter_map(|entry| Some(entry.ok()?.path())).filter(is_scenario).min();
    first.map_or_else(|| Ok(Scenario::default()), |path| Ok(Scenario::load(&path)?))
}
