//! Recorded episodes: pictures, the accelerations that were flown, what the radio measured. All that the learned
//! encoder is trained on; no position is in them.
//!
//! A folder with one file an episode, `episode-00000.safetensors`:
//!
//! | tensor | shape | meaning |
//! |---|---|---|
//! | `frames` | u8 `[n, 100, 100, 3]` | pictures, one an interval; rows from the top, RGB |
//! | `actions` | f32 `[n-1, 2]` | acceleration flown between a picture and the next, share of a_max; x is along a row, y down a column |
//! | `snr_db` | f32 `[n]` | measured SNR at the picture's time, dB; NaN where none was measured |
//! | `power` | f32 `[n]` | transmit power at that time, the paper's unit; the gain is `snr_db` less its decibels |
//! | `outage` | u8 `[n]` | 1 where the interval before the picture was an outage |
//! | `contact` | u8 `[n]` | 1 where the UAV touched the obstacle in the interval before the picture |
//! | `time_s` | f64 `[n]` | time stamps, s |
//!
//! and in its metadata `format` = `crpl-recording/1`, `a_max` in sides of the picture per interval², and, where it is
//! known, `base_station` = `x,y` in sides of the picture.
//! Instead of such a file an episode may be a folder `episode-00000` with pictures `00000.png` and so on, 100x100
//! RGB, `steps.csv` (columns `frame,time_s,action_x,action_y,snr_db,power,outage,contact`), `a_max.txt`, and
//! `base_station.txt` where it is known: [`crate::world_model::picture_folder`].
//!
//! Where the true positions are known they are in `truth/episode-00000.safetensors` (`uav`, `obstacle` f64
//! `[n, 2]`, picture sides). Evaluation alone opens that folder.

use std::collections::HashMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crpl_sitl::camera::{CHANNELS, Frame, SIDE};
use nalgebra::Vector2;

use crate::numeric::tensors::{self, Reader, TensorError, Writer, write_all};
use crate::world_model::picture_folder::{self, FolderEpisode};

pub use crate::world_model::picture_folder::Step;

/// What the metadata's `format` must say.
pub const RECORDING_FORMAT: &str = "crpl-recording/1";

/// Folder of the true positions, where they are known.
pub const TRUTH: &str = "truth";

/// Bytes of a picture.
const PICTURE: usize = SIDE * SIDE * CHANNELS;

/// Name of an episode's file.
#[must_use]
pub fn episode_name(index: usize) -> String {
    format!("{}.safetensors", folder_name(index))
}

/// Name of an episode's folder.
fn folder_name(index: usize) -> String {
    format!("episode-{index:05}")
}

/// The files and folders of the episodes in a folder, in the order of their names.
///
/// # Errors
/// If the folder cannot be read.
pub fn episode_paths(dir: &Path) -> Result<Vec<PathBuf>, TensorError> {
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(TensorError::file(dir))? {
        let path = entry.map_err(TensorError::file(dir))?.path();
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        let Some(name) = name.strip_prefix("episode-") else { continue };
        if name.ends_with(".safetensors") || (!name.contains('.') && path.is_dir()) {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// How the pictures of an episode are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum RecordingFormat {
    /// One safetensors file an episode
    #[default]
    Safetensors,
    /// A folder an episode: PNG pictures and steps.csv
    Png,
}

/// One episode in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedEpisode {
    /// Pictures.
    pub frames: Vec<Frame>,
    /// Accelerations between them, share of a_max; one less.
    pub actions: Vec<Vector2<f32>>,
    /// The radio and the time at each picture.
    pub steps: Vec<Step>,
    /// a_max, picture sides per interval².
    pub a_max: f64,
    /// The base station, picture sides, where it is known.
    pub base_station: Option<Vector2<f64>>,
}

/// True positions of an episode, picture sides: for evaluation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Truth {
    /// The UAV.
    pub uav: Vec<Vector2<f64>>,
    /// The obstacle.
    pub obstacle: Vec<Vector2<f64>>,
}

impl RecordedEpisode {
    /// Writes the episode's file.
    ///
    /// # Errors
    /// If the numbers of pictures, actions and steps do not fit, or the file cannot be written.
    pub fn save(&self, dir: &Path, index: usize) -> Result<(), TensorError> {
        let path = dir.join(episode_name(index));
        let n = self.frames.len();
        self.check(&path)?;
        std::fs::create_dir_all(dir).map_err(TensorError::file(dir))?;
        let mut out = Writer::default();
        out.u8(
            "frames",
            &[n, SIDE, SIDE, CHANNELS],
            self.frames.iter().flat_map(|f| f.rgb().iter().copied()),
        );
        out.f32("actions", &[n - 1, 2], self.actions.iter().flat_map(|a| [a.x, a.y]));
        out.f32("snr_db", &[n], self.steps.iter().map(|s| s.snr_db));
        out.f32("power", &[n], self.steps.iter().map(|s| s.power));
        out.u8("outage", &[n], self.steps.iter().map(|s| u8::from(s.outage)));
        out.u8("contact", &[n], self.steps.iter().map(|s| u8::from(s.contact)));
        out.f64("time_s", &[n], self.steps.iter().map(|s| s.time_s));
        let mut about = HashMap::from([
            ("format".to_owned(), RECORDING_FORMAT.to_owned()),
            ("a_max".to_owned(), format!("{}", self.a_max)),
        ]);
        if let Some(s) = self.base_station {
            about.insert("base_station".to_owned(), format!("{},{}", s.x, s.y));
        }
        write_all(&path, &out.bytes_about(Some(about))?)
    }

    /// Writes the episode in a format.
    ///
    /// # Errors
    /// As [`RecordedEpisode::save`].
    pub fn save_as(&self, format: RecordingFormat, dir: &Path, index: usize) -> Result<(), TensorError> {
        if format == RecordingFormat::Safetensors {
            return self.save(dir, index);
        }
        let path = dir.join(folder_name(index));
        self.check(&path)?;
        let Self { frames, actions, steps, a_max, base_station } = self.clone();
        FolderEpisode { actions, steps, a_max, base_station }.save(&frames, &path)
    }

    fn check(&self, path: &Path) -> Result<(), TensorError> {
        let n = self.frames.len();
        if n < 3 || self.actions.len() + 1 != n || self.steps.len() != n {
            let message = format!("{n} pictures, {} actions, {} steps", self.actions.len(), self.steps.len());
            return Err(TensorError::Format { path: path.into(), message });
        }
        Ok(())
    }
}

impl Truth {
    /// Writes the positions beside the recording in `dir`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, dir: &Path, index: usize) -> Result<(), TensorError> {
        let dir = dir.join(TRUTH);
        std::fs::create_dir_all(&dir).map_err(TensorError::file(&dir))?;
        let mut out = Writer::default();
        for (name, track) in [("uav", &self.uav), ("obstacle", &self.obstacle)] {
            out.f64(name, &[track.len(), 2], track.iter().flat_map(|r| [r.x, r.y]));
        }
        write_all(&dir.join(episode_name(index)), &out.bytes()?)
    }

    /// Reads what [`Truth::save`] wrote.
    ///
    /// # Errors
    /// If the file is missing or holds something else.
    pub fn load(dir: &Path, index: usize) -> Result<Self, TensorError> {
        let path = dir.join(TRUTH).join(episode_name(index));
        let bytes = tensors::read(&path)?;
        let from = Reader::new(&bytes, path)?;
        let track = |name: &str| -> Result<Vec<Vector2<f64>>, TensorError> {
            let count = from.shape(name)?.first().copied().unwrap_or(0);
            Ok(from.f64(name, &[count, 2])?.chunks_exact(2).map(|r| Vector2::new(r[0], r[1])).collect())
        };
        Ok(Self { uav: track("uav")?, obstacle: track("obstacle")? })
    }
}

/// A folder of recorded episodes, the pictures left on the disk.
#[derive(Debug)]
pub struct Recording {
    episodes: Vec<EpisodeIndex>,
    /// a_max, picture sides per interval², the same for all episodes.
    pub a_max: f64,
}

/// One episode without its pictures.
#[derive(Debug)]
pub struct EpisodeIndex {
    path: PathBuf,
    /// Where the pictures begin in the file; `None` in a folder of pictures.
    begin: Option<u64>,
    /// Accelerations flown, share of a_max.
    pub actions: Vec<Vector2<f32>>,
    /// Radio and time at each picture.
    pub steps: Vec<Step>,
    /// The base station, picture sides, where it is known.
    pub base_station: Option<Vector2<f64>>,
}

impl EpisodeIndex {
    /// Number of pictures.
    #[must_use]
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether it has no picture; none that was read is.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Picture `k`.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn frame(&self, k: usize) -> Result<Frame, TensorError> {
        let Some(begin) = self.begin else { return picture_folder::read_picture(&self.path, k) };
        let mut bytes = vec![0; PICTURE];
        let read = |bytes: &mut [u8]| {
            let mut file = File::open(&self.path)?;
            file.seek(SeekFrom::Start(begin + (k * PICTURE) as u64))?;
            file.read_exact(bytes)
        };
        read(&mut bytes).map_err(TensorError::file(&self.path))?;
        let wrong = || TensorError::Format { path: self.path.clone(), message: "a picture is cut".into() };
        Frame::from_rgb(bytes).ok_or_else(wrong)
    }

    /// What the actions contribute to p_{k+2d} - 2 p_{k+d} + p_k, in units of a_max per interval²: the action
    /// between picture n and n+1 changes the step after it.
    #[must_use]
    pub fn response(&self, k: usize, d: usize) -> Vector2<f32> {
        (1..2 * d).map(|j| self.actions[k + j] * (d - d.abs_diff(j)) as f32).sum()
    }

    /// Measured gain at picture `k`, dB and a constant; `None` where nothing was measured.
    #[must_use]
    pub fn gain_db(&self, k: usize) -> Option<f32> {
        let Step { snr_db, power, .. } = self.steps[k];
        let gain = snr_db - 10.0 * power.log10();
        gain.is_finite().then_some(gain)
    }
}

impl Recording {
    /// Reads the episodes of a folder, in the order of their names. `limit` bounds their number.
    ///
    /// # Errors
    /// If there is no episode, or one is not what it should be: the error names the file and what is wrong.
    pub fn open(dir: &Path, limit: Option<usize>) -> Result<Self, TensorError> {
        let mut paths = episode_paths(dir)?;
        paths.truncate(limit.unwrap_or(usize::MAX));
        let mut episodes = Vec::with_capacity(paths.len());
        let mut a_max = None;
        for path in paths {
            let (episode, own) = if path.is_dir() { read_folder(&path)? } else { read_episode(&path)? };
            if *a_max.get_or_insert(own) != own {
                let message = format!("a_max is {own}, in the episodes before it another");
                return Err(TensorError::Format { path, message });
            }
            episodes.push(episode);
        }
        match a_max {
            Some(a_max) => Ok(Self { episodes, a_max }),
            None => {
                let message = "no episode-*.safetensors is there, and no folder episode-*".into();
                Err(TensorError::Format { path: dir.into(), message })
            }
        }
    }

    /// Where the base station stood in most episodes.
    #[must_use]
    pub fn usual_station(&self) -> Option<Vector2<f64>> {
        let mut counts: Vec<(Option<Vector2<f64>>, usize)> = Vec::new();
        for episode in &self.episodes {
            match counts.iter_mut().find(|(station, _)| *station == episode.base_station) {
                Some((_, count)) => *count += 1,
                None => counts.push((episode.base_station, 1)),
            }
        }
        counts.into_iter().max_by_key(|(_, count)| *count).and_then(|(station, _)| station)
    }

    /// The episodes.
    #[must_use]
    pub fn episodes(&self) -> &[EpisodeIndex] {
        &self.episodes
    }
}

/// An episode in a folder of pictures.
fn read_folder(path: &Path) -> Result<(EpisodeIndex, f64), TensorError> {
    let FolderEpisode { actions, steps, a_max, base_station } = FolderEpisode::load(path)?;
    Ok((EpisodeIndex { path: path.into(), begin: None, actions, steps, base_station }, a_max))
}

/// An episode's small tensors and the place of its pictures.
fn read_episode(path: &Path) -> Result<(EpisodeIndex, f64), TensorError> {
    let wrong = |message: String| TensorError::Format { path: path.into(), message };
    let bytes = tensors::read(path)?;
    let from = Reader::new(&bytes, path.into())?;
    let about = from.metadata(&bytes)?;
    let said = |key: &str| about.get(key).cloned().unwrap_or_default();
    if said("format") != RECORDING_FORMAT {
        return Err(wrong(format!("format is `{}`, expected `{RECORDING_FORMAT}`", said("format"))));
    }
    let a_max: f64 = said("a_max").parse().map_err(|_| wrong(format!("a_max is `{}`", said("a_max"))))?;
    if !(a_max.is_finite() && a_max > 0.0) {
        return Err(wrong(format!("a_max is {a_max}")));
    }
    let base_station = match about.get("base_station") {
        None => None,
        Some(text) => {
            let told = || wrong(format!("base_station is `{text}`, expected `x,y`"));
            Some(picture_folder::place(text).ok_or_else(told)?)
        }
    };
    let n = from.shape("frames")?.first().copied().unwrap_or(0);
    if n < 3 {
        return Err(wrong(format!("{n} pictures; an episode has at least 3")));
    }
    let begin = from.place("frames", &[n, SIDE, SIDE, CHANNELS], &bytes)?;
    let actions = from.f32("actions", &[n - 1, 2])?;
    let snr = from.f32_or_nan("snr_db", &[n])?;
    let (power, outage) = (from.f32("power", &[n])?, from.u8("outage", &[n])?);
    let (time, contact) = (from.f64("time_s", &[n])?, from.u8("contact", &[n])?);
    let step = |k: usize| Step {
        time_s: time[k],
        snr_db: snr[k],
        power: power[k],
        outage: outage[k] != 0,
        contact: contact[k] != 0,
    };
    let actions = actions.chunks_exact(2).map(|a| Vector2::new(a[0], a[1])).collect();
    let steps = (0..n).map(step).collect();
    Ok((EpisodeIndex { path: path.into(), begin: Some(begin as u64), actions, steps, base_station }, a_max))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode() -> RecordedEpisode {
        let picture = |k: usize| {
            Frame::from_rgb((0..PICTURE).map(|n| (n * 7 + k * 31) as u8).collect()).expect("its length fits")
        };
        RecordedEpisode {
            frames: (0..6).map(picture).collect(),
            actions: (0..5).map(|k| Vector2::new(k as f32 * 0.1, -0.2)).collect(),
            steps: (0..6)
                .map(|k| Step {
                    time_s: 0.05 * f64::from(k),
                    snr_db: 9.0 + k as f32,
                    power: 4.0,
                    outage: k == 2,
                    contact: k == 3,
                })
                .collect(),
            a_max: 3.5e-3,
            base_station: Some(Vector2::new(0.5, 0.05)),
        }
    }

    #[test]
    fn an_episode_survives_the_disk_and_the_pictures_stay_there() {
        let dir = tempfile::tempdir().unwrap();
        let mut second = episode();
        second.steps[1].snr_db = f32::NAN;
        episode().save(dir.path(), 0).unwrap();
        second.save(dir.path(), 1).unwrap();
        let read = Recording::open(dir.path(), None).unwrap();
        assert_eq!((read.episodes().len(), read.a_max), (2, 3.5e-3));
        let (first, other) = (&read.episodes()[0], &read.episodes()[1]);
        assert_eq!(first.base_station, episode().base_station);
        assert_eq!((&first.actions, &first.steps), (&episode().actions, &episode().steps));
        assert_eq!(first.frame(4).unwrap(), episode().frames[4]);
        assert!((first.gain_db(3).unwrap() - (12.0 - 6.0206)).abs() < 1e-4);
        assert_eq!(other.gain_db(1), None);
        assert_eq!(Recording::open(dir.path(), Some(1)).unwrap().episodes().len(), 1);
    }

    #[test]
    fn a_folder_of_pictures_and_a_file_of_tensors_are_the_same_episode() {
        let dir = tempfile::tempdir().unwrap();
        let mut wanted = episode();
        wanted.steps[4].snr_db = 1.0 / 3.0;
        for (index, format) in [RecordingFormat::Png, RecordingFormat::Safetensors].into_iter().enumerate() {
            wanted.save_as(format, dir.path(), index).unwrap();
            wanted.save_as(format, dir.path(), index).unwrap();
        }
        let read = Recording::open(dir.path(), None).unwrap();
        assert_eq!((read.episodes().len(), read.a_max), (2, wanted.a_max));
        for episode in read.episodes() {
            assert_eq!((&episode.actions, &episode.steps), (&wanted.actions, &wanted.steps));
            assert_eq!(episode.base_station, wanted.base_station);
            let frames: Vec<Frame> = (0..episode.len()).map(|k| episode.frame(k).unwrap()).collect();
            assert_eq!(frames, wanted.frames);
        }
    }

    #[test]
    fn equal_episodes_are_equal_files() {
        let dir = tempfile::tempdir().unwrap();
        for index in 0..8 {
            episode().save(dir.path(), index).unwrap();
        }
        let bytes = |index| std::fs::read(dir.path().join(episode_name(index))).unwrap();
        assert!((1..8).all(|index| bytes(index) == bytes(0)));
        assert_eq!(Recording::open(dir.path(), None).unwrap().a_max, episode().a_max);
    }

    #[test]
    fn the_response_is_what_the_actions_add_to_a_second_difference() {
        let dir = tempfile::tempdir().unwrap();
        episode().save(dir.path(), 0).unwrap();
        let read = Recording::open(dir.path(), None).unwrap();
        let (mut r, mut v, mut track) = (Vector2::new(0.0f32, 0.0), Vector2::new(0.3, 0.1), Vec::new());
        track.push(r);
        for a in episode().actions {
            v += a;
            r += v;
            track.push(r);
        }
        for (k, d) in [(0, 1), (1, 1), (0, 2), (1, 2)] {
            let wanted = track[k + 2 * d] - 2.0 * track[k + d] + track[k];
            assert!((read.episodes()[0].response(k, d) - wanted).norm() < 1e-5);
        }
    }

    #[test]
    fn what_is_no_recording_is_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let said = |dir: &Path| Recording::open(dir, None).unwrap_err().to_string();
        assert!(said(dir.path()).ends_with("no episode-*.safetensors is there, and no folder episode-*"));
        let path = dir.path().join(episode_name(3));
        std::fs::write(&path, b"hello").unwrap();
        assert!(said(dir.path()).contains("episode-00003.safetensors: not a safetensors file"));
        let mut out = Writer::default();
        out.f32("actions", &[1, 2], [0.0, 0.0]);
        std::fs::write(&path, out.bytes().unwrap()).unwrap();
        assert!(said(dir.path()).contains("format is ``, expected `crpl-recording/1`"));
        let mut short = episode();
        short.actions.pop();
        assert!(
            short.save(dir.path(), 3).unwrap_err().to_string().contains("6 pictures, 4 actions, 6 steps")
        );
    }

    #[test]
    fn the_truth_lies_apart() {
        let dir = tempfile::tempdir().unwrap();
        let truth =
            Truth { uav: vec![Vector2::new(0.25, 0.5); 3], obstacle: vec![Vector2::new(0.75, 0.125); 3] };
        truth.save(dir.path(), 2).unwrap();
        assert_eq!(Truth::load(dir.path(), 2).unwrap(), truth);
        assert!(Recording::open(dir.path(), None).is_err());
    }
}
