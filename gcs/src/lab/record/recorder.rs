//! The station that explores and records: percept in, command out, whole episodes to the disk.
//!
//! An episode ends after its number of pictures, and at a gap: a picture that did not come, or an interval whose
//! acceleration the vehicle does not tell. A state machine without socket and clock, so it flies in process and
//! over a link alike.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use crpl_model::numeric::tensors::TensorError;
use crpl_model::world_model::exploration::Explorer;
use crpl_model::world_model::recording::{RecordedEpisode, RecordingFormat, Step, Truth};
use crpl_sitl::Scenario;
use crpl_sitl::radio::message::{Command, Held, Percept, Telemetry};
use crpl_sitl::units::TxPower;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::{Rng, RngExt};

use crate::flight::Crew;
use crate::lab::crew::level;
use crate::lab::record::folder::RecordingFolder;
use crate::lab::record::show::RecordingShow;
use crate::watch::feed::Feed;

/// Fewest pictures of an episode that a gap has cut: three at the shortest of the long lags of the training's recipe.
const SHORTEST: usize = 21;

/// What is recorded.
#[derive(Debug, Clone)]
pub struct RecordingPlan {
    /// Episodes that the folder holds at the end.
    pub episodes: usize,
    /// Pictures of an episode without a gap, at least 3.
    pub pictures: usize,
    /// Seed of the actions.
    pub seed: u64,
    /// How pictures are stored.
    pub format: RecordingFormat,
}

/// Flies exploratory actions and records what comes back.
#[derive(Debug)]
pub struct Recorder {
    scenario: Scenario,
    plan: RecordingPlan,
    folder: RecordingFolder,
    explorer: Explorer,
    before: Option<Telemetry>,
    /// Whether the vehicle has told an acceleration since it was met: until then it flies none.
    has_flown: bool,
    open: Recorded,
    /// Whole episodes that are not on the disk yet.
    whole: Vec<Recorded>,
    failed: Option<String>,
    /// Tells who watches, if anybody can.
    show: Option<RecordingShow>,
    decided: Option<(Percept, Command)>,
}

/// An episode and what only evaluation may know of it.
#[derive(Debug)]
struct Recorded {
    episode: RecordedEpisode,
    truth: Truth,
}

impl Recorded {
    fn begin(scenario: &Scenario) -> Self {
        let episode = RecordedEpisode {
            frames: Vec::new(),
            actions: Vec::new(),
            steps: Vec::new(),
            a_max: scenario.dynamics.a_max,
            base_station: Some(scenario.channel.base_station),
        };
        Self { episode, truth: Truth::default() }
    }

    fn save(&self, plan: &RecordingPlan, dir: &Path, index: usize) -> Result<(), TensorError> {
        self.truth.save(dir, index)?;
        self.episode.save_as(plan.format, dir, index)
    }
}

impl Recorder {
    /// A station for a vehicle that flies in this scenario.
    #[must_use]
    pub fn new(scenario: &Scenario, plan: RecordingPlan, folder: RecordingFolder) -> Self {
        Self {
            explorer: Explorer::new(scenario),
            open: Recorded::begin(scenario),
            scenario: scenario.clone(),
            plan,
            folder,
            before: None,
            has_flown: false,
            whole: Vec::new(),
            failed: None,
            show: None,
            decided: None,
        }
    }

    /// The same, told to who watches `feed`.
    #[must_use]
    pub fn shown_on(mut self, feed: &Feed) -> Self {
        let show = RecordingShow::begin(feed, &self.scenario, self.plan.seed);
        show.counted(self.folder.next(), self.plan.episodes);
        self.show = Some(show);
        self
    }

    /// The flight is over: writes what is left. Gives the number of episodes in the folder, and what could not be
    /// written.
    pub fn land(&mut self) -> (usize, Option<String>) {
        if !self.is_done() {
            self.close();
        }
        self.sent();
        if let Some(show) = self.show.take() {
            show.end();
        }
        (self.folder.next(), self.failed.clone())
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &RecordingFolder {
        &self.folder
    }

    /// Index of the episode that is open.
    fn index(&self) -> usize {
        self.folder.next() + self.whole.len()
    }

    /// Whether a report follows the one before it, by an acceleration that is known.
    fn continues(&self, now: &Telemetry) -> bool {
        let follows = self.before.is_some_and(|before| before.tick.next() == now.tick);
        follows && (now.held.is_some() || !self.has_flown)
    }

    fn add(&mut self, percept: &Percept) {
        let now = &percept.telemetry;
        let before = self.before.filter(|before| before.tick.next() == now.tick);
        let flown = now.held.map_or(Vector2::zeros(), |held| self.share(held));
        let power = self.power(self.index());
        let scale = &self.scenario.scale;
        let Recorded { episode, truth } = &mut self.open;
        if let Some(last) = episode.steps.last_mut() {
            episode.actions.push(flown);
            // The radio measured at the interval's beginning, where the picture before this one was taken.
            if let Some(link) = now.link {
                (last.snr_db, last.power) = (link.snr_db, link.power.level() as f32);
            }
        }
        episode.frames.push((*percept.frame).clone());
        episode.steps.push(Step {
            time_s: now.tick.0 as f64 * scale.interval_s,
            snr_db: f32::NAN,
            power: power.level() as f32,
            outage: now.link.is_some_and(|link| link.outage),
            contact: before.is_some_and(|before| before.contact(now, &self.scenario).obstacle.is_some()),
        });
        truth.uav.push(scale.paper_from_ned(now.position));
        truth.obstacle.extend(now.obstacles(scale).iter().next());
    }

    /// What the vehicle flew, share of a_max: it cuts what is beyond.
    fn share(&self, held: Held) -> Vector2<f32> {
        let a = self.scenario.scale.paper_from_ned_acceleration(held.accel) / self.scenario.dynamics.a_max;
        a.map(|a| a.clamp(-1.0, 1.0) as f32)
    }

    /// Ends the open episode; one that is too short is dropped.
    fn close(&mut self) {
        let whole = std::mem::replace(&mut self.open, Recorded::begin(&self.scenario));
        let pictures = whole.episode.frames.len();
        if pictures >= SHORTEST.min(self.plan.pictures) {
            self.whole.push(whole);
        } else if pictures > 0 {
            tracing::warn!("{pictures} pictures before a gap are too few for an episode: dropped");
        }
    }

    /// The chance of an episode, or of one of its ticks: (index, word).
    fn chance(&self, index: usize, tick: u64) -> impl Rng {
        let purpose = (4 << 32) | ((index as u64) << 16) | (tick & 0xffff);
        Noise::new(self.plan.seed).generator(Stream::Data, purpose)
    }

    /// The transmit power of an episode.
    fn power(&self, index: usize) -> TxPower {
        if self.chance(index, 0xffff).random() { TxPower::High } else { TxPower::Low }
    }

    fn write(&mut self) -> Result<()> {
        for whole in std::mem::take(&mut self.whole) {
            let (index, dir) = (self.folder.next(), self.folder.dir());
            whole.save(&self.plan, dir, index).with_context(|| format!("episode {index}"))?;
            tracing::info!("episode {index}: {} pictures", whole.episode.frames.len());
            self.folder.count();
            if let Some(show) = &self.show {
                show.counted(self.folder.next(), self.plan.episodes);
                show.log("info", &format!("episode {index}: {} pictures", whole.episode.frames.len()));
            }
        }
        Ok(())
    }
}

impl Crew for Recorder {
    fn command(&mut self, percept: &Percept) -> Command {
        let now = &percept.telemetry;
        if !self.continues(now) {
            self.close();
        }
        self.add(percept);
        self.before = Some(*now);
        self.has_flown |= now.held.is_some();
        let (index, k) = (self.index(), self.open.episode.frames.len() as u64);
        let wish = self.explorer.next(now, &mut self.chance(index, k)) * self.scenario.dynamics.a_max;
        let accel = self.scenario.scale.ned_from_paper_acceleration(wish);
        if self.open.episode.frames.len() == self.plan.pictures {
            self.close();
        }
        let command = Command::new(now.tick, accel, self.power(index));
        self.decided = self.show.is_some().then(|| (percept.clone(), command));
        command
    }

    fn begin(&mut self) -> Result<Option<PathBuf>> {
        self.folder.begin(&self.scenario)?;
        Ok(None)
    }

    fn sent(&mut self) {
        if let (Some(show), Some((percept, command))) = (&mut self.show, self.decided.take()) {
            show.saw(&percept, command);
        }
        if self.failed.is_none()
            && let Err(error) = self.write()
        {
            tracing::error!("{error:#}");
            self.failed = Some(format!("{error:#}"));
        }
    }

    fn heard(&mut self, severity: u8, text: &str) {
        if let Some(show) = &self.show {
            show.log(level(severity), &format!("vehicle: {text}"));
        }
    }

    fn link(&mut self, counters: &serde_json::Value) {
        if let Some(show) = &self.show {
            show.link(counters);
        }
    }

    fn is_done(&self) -> bool {
        self.failed.is_some() || self.index() >= self.plan.episodes
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use crpl_model::world_model::recording::Recording;
    use crpl_sitl::Sim;
    use crpl_sitl::units::Tick;

    use super::*;

    fn recorder(dir: &Path, episodes: usize, pictures: usize) -> Recorder {
        let plan = RecordingPlan { episodes, pictures, seed: 5, format: RecordingFormat::default() };
        let folder = RecordingFolder::claim(dir, false, false).unwrap();
        Recorder::new(&Scenario::default(), plan, folder)
    }

    /// Flies until all is there; `heard` may lose or change what arrives.
    fn fly(recorder: &mut Recorder, heard: impl Fn(&mut Percept) -> bool) -> Vec<Vector2<f32>> {
        let (mut sim, mut flown) = (Sim::new(Scenario::default(), 2), Vec::new());
        recorder.begin().unwrap();
        while !recorder.is_done() {
            let mut percept = sim.percept();
            if heard(&mut percept) {
                sim.handle(recorder.command(&percept));
                recorder.sent();
            }
            sim.transmit();
            flown.push(sim.flown().map(|a| a as f32));
            sim.step();
        }
        assert_eq!(recorder.land().1, None);
        flown
    }

    #[test]
    fn what_was_flown_and_measured_is_recorded_beside_its_picture() {
        let dir = tempfile::tempdir().unwrap();
        let flown = fly(&mut recorder(dir.path(), 2, 30), |_| true);
        let recording = Recording::open(dir.path(), None).unwrap();
        assert_eq!(recording.episodes().len(), 2);
        let mut again = Sim::new(Scenario::default(), 2);
        for (first, episode) in [0, 30].into_iter().zip(recording.episodes()) {
            assert_eq!(episode.len(), 30);
            for (recorded, flown) in episode.actions.iter().zip(&flown[first..]) {
                assert!((recorded - flown).norm() < 1e-6);
            }
            assert!(
                episode.steps[29].snr_db.is_nan() && episode.steps[..29].iter().all(|s| s.snr_db.is_finite())
            );
            let step = episode.steps[0];
            let power = if step.power > 1.0 { TxPower::High } else { TxPower::Low };
            if first == 0 {
                let snr = again.world().snr(power, again.scenario()).to_db() as f32;
                assert_eq!((step.snr_db, episode.frame(0).unwrap()), (snr, again.frame()));
                again.advance();
            }
        }
        let truth = Truth::load(dir.path(), 1).unwrap();
        assert_eq!((truth.uav.len(), truth.obstacle.len()), (30, 30));
    }

    #[test]
    fn before_the_first_command_the_recorded_action_is_zero() {
        let dir = tempfile::tempdir().unwrap();
        let mut recorder = recorder(dir.path(), 1, 30);
        fly(&mut recorder, |percept| {
            if percept.telemetry.tick < Tick(4) {
                percept.telemetry.held = None;
            }
            true
        });
        let episode = &Recording::open(dir.path(), None).unwrap().episodes()[0].actions.clone();
        assert!(episode[..3].iter().all(|a| *a == Vector2::zeros()) && episode[3] != Vector2::zeros());
    }

    #[test]
    fn a_gap_cuts_an_episode_and_too_short_a_piece_is_dropped() {
        let dir = tempfile::tempdir().unwrap();
        fly(&mut recorder(dir.path(), 2, 30), |percept| ![5, 30].contains(&percept.telemetry.tick.0));
        let recording = Recording::open(dir.path(), None).unwrap();
        let of = |n: usize| (recording.episodes()[n].steps[0].time_s, recording.episodes()[n].len());
        let interval = Scenario::default().scale.interval_s;
        assert_eq!([of(0), of(1)], [(6.0 * interval, 24), (31.0 * interval, 30)]);
    }

    #[test]
    fn an_interval_that_the_vehicle_flew_by_itself_is_a_gap() {
        let dir = tempfile::tempdir().unwrap();
        fly(&mut recorder(dir.path(), 1, 30), |percept| {
            if percept.telemetry.tick == Tick(10) {
                percept.telemetry.held = None;
            }
            true
        });
        let recording = Recording::open(dir.path(), None).unwrap();
        assert_eq!(recording.episodes()[0].steps[0].time_s, 10.0 * Scenario::default().scale.interval_s);
    }

    #[test]
    fn a_flight_that_ends_early_keeps_what_is_long_enough() {
        let dir = tempfile::tempdir().unwrap();
        let mut recorder = recorder(dir.path(), 9, 30);
        recorder.begin().unwrap();
        let mut sim = Sim::new(Scenario::default(), 2);
        for _ in 0..55 {
            let Percept { telemetry, frame, .. } = sim.percept();
            sim.handle(recorder.command(&Percept { telemetry, frame: Arc::clone(&frame), latents: None }));
            recorder.sent();
            sim.advance();
        }
        assert_eq!(recorder.land(), (2, None));
        let recording = Recording::open(dir.path(), None).unwrap();
        assert_eq!(recording.episodes().iter().map(|e| e.len()).collect::<Vec<_>>(), [30, 25]);
    }
}
