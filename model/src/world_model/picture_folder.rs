//! An episode as a folder that people and other programs write: pictures and a table.
//!
//! | file | what is in it |
//! |---|---|
//! | `00000.png`, `00001.png`, ... | pictures, 100x100 RGB of 8 bits |
//! | `steps.csv` | a line with the names of [`COLUMNS`], then a line a picture |
//! | `a_max.txt` | a_max, sides of the picture per interval² |
//! | `base_station.txt` | `x,y`, sides of the picture; missing where it is not known |
//!
//! `frame` counts the pictures from 0. The action of a line, a share of a_max from -1 to 1, is flown between its
//! picture and the next; the last line has none. `snr_db` is empty where nothing was measured. Time stamps grow.
//! `outage` and `contact` are 0 or 1.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use crpl_sitl::camera::Frame;
use crpl_sitl::link::image::{picture_from_png, png_from_frame};
use crpl_sitl::units::Tick;
use nalgebra::Vector2;

use crate::numeric::tensors::{TensorError, read, write_all};

/// File of the table.
pub const STEPS: &str = "steps.csv";

/// Its columns.
pub const COLUMNS: [&str; 8] =
    ["frame", "time_s", "action_x", "action_y", "snr_db", "power", "outage", "contact"];

const A_MAX: &str = "a_max.txt";
const BASE_STATION: &str = "base_station.txt";

/// Largest share of a_max, with room for rounding.
const LARGEST_ACTION: f32 = 1.001;

/// What one interval of a recording holds besides its picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Time stamp, s.
    pub time_s: f64,
    /// SNR, dB; NaN where none was measured.
    pub snr_db: f32,
    /// Transmit power.
    pub power: f32,
    /// Whether the interval before was an outage.
    pub outage: bool,
    /// Whether the UAV touched the obstacle in the interval before.
    pub contact: bool,
}

/// All of an episode but its pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct FolderEpisode {
    /// Accelerations between the pictures, share of a_max; one less.
    pub actions: Vec<Vector2<f32>>,
    /// The radio and the time at each picture.
    pub steps: Vec<Step>,
    /// a_max, picture sides per interval².
    pub a_max: f64,
    /// The base station, picture sides, where it is known.
    pub base_station: Option<Vector2<f64>>,
}

fn wrong(path: &Path, message: String) -> TensorError {
    TensorError::Format { path: path.into(), message }
}

/// The file of picture `k`.
fn picture_path(dir: &Path, k: usize) -> PathBuf {
    dir.join(format!("{k:05}.png"))
}

/// Reads picture `k` of an episode's folder.
///
/// # Errors
/// The file is missing, or no PNG of 100x100 RGB of 8 bits.
pub fn read_picture(dir: &Path, k: usize) -> Result<Frame, TensorError> {
    let path = picture_path(dir, k);
    let decoded = picture_from_png(&read(&path)?);
    decoded.map(|(_, frame)| frame).map_err(|error| wrong(&path, error.to_string()))
}

impl FolderEpisode {
    /// Writes an episode as the folder `dir`, in place of one that is there. The folder appears when it is whole.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn save(&self, frames: &[Frame], dir: &Path) -> Result<(), TensorError> {
        let part = dir.with_extension("part");
        for old in [&part, dir].into_iter().filter(|old| old.exists()) {
            std::fs::remove_dir_all(old).map_err(TensorError::file(old))?;
        }
        std::fs::create_dir_all(&part).map_err(TensorError::file(&part))?;
        for (k, frame) in frames.iter().enumerate() {
            let path = picture_path(&part, k);
            let png = png_from_frame(frame, Tick(k as u64)).map_err(|e| wrong(&path, e.to_string()))?;
            write_all(&path, &png)?;
        }
        write_all(&part.join(A_MAX), format!("{}\n", self.a_max).as_bytes())?;
        if let Some(s) = self.base_station {
            write_all(&part.join(BASE_STATION), format!("{},{}\n", s.x, s.y).as_bytes())?;
        }
        write_all(&part.join(STEPS), self.table().as_bytes())?;
        std::fs::rename(&part, dir).map_err(TensorError::file(dir))
    }

    fn table(&self) -> String {
        let rows = self.steps.iter().enumerate().map(|(k, step)| {
            let action = self.actions.get(k).map_or(",".into(), |a| format!("{},{}", a.x, a.y));
            let snr = if step.snr_db.is_nan() { String::new() } else { step.snr_db.to_string() };
            let Step { time_s, power, outage, contact, .. } = *step;
            format!("{k},{time_s},{action},{snr},{power},{},{}\n", u8::from(outage), u8::from(contact))
        });
        format!("{}\n", COLUMNS.join(",")) + &rows.collect::<String>()
    }

    /// Reads the folder `dir`, and looks whether all of its pictures are there.
    ///
    /// # Errors
    /// The first thing that is wrong: file, line, column.
    pub fn load(dir: &Path) -> Result<Self, TensorError> {
        let path = dir.join(STEPS);
        let (mut actions, mut steps) = (Vec::new(), Vec::new());
        for row in rows(&path, &text(&path)?)? {
            if row.number::<usize>(0)? != steps.len() {
                return Err(row.wrong(0, &format!("expected {}", steps.len())));
            }
            let step = row.step()?;
            if steps.last().is_some_and(|before: &Step| step.time_s <= before.time_s) {
                return Err(row.wrong(1, "is not after the line before"));
            }
            if !row.is_last {
                actions.push(row.action()?);
            }
            steps.push(step);
        }
        if steps.len() < 3 {
            return Err(wrong(&path, format!("{} pictures; an episode has at least 3", steps.len())));
        }
        if let Some(missing) = (0..steps.len()).map(|k| picture_path(dir, k)).find(|path| !path.is_file()) {
            return Err(wrong(&missing, format!("is missing, and {} has a line for it", path.display())));
        }
        Ok(Self { actions, steps, a_max: a_max(dir)?, base_station: base_station(dir)? })
    }
}

fn text(path: &Path) -> Result<String, TensorError> {
    String::from_utf8(read(path)?).map_err(|_| wrong(path, "is no text in UTF-8".into()))
}

fn a_max(dir: &Path) -> Result<f64, TensorError> {
    let path = dir.join(A_MAX);
    let text = text(&path)?;
    let value: Option<f64> = text.trim().parse().ok();
    let told = || format!("`{}` is no a_max: sides of the picture per interval²", text.trim());
    value.filter(|a| a.is_finite() && *a > 0.0).ok_or_else(|| wrong(&path, told()))
}

fn base_station(dir: &Path) -> Result<Option<Vector2<f64>>, TensorError> {
    let path = dir.join(BASE_STATION);
    if !path.exists() {
        return Ok(None);
    }
    let text = text(&path)?;
    let told = || format!("`{}` is no base station: expected `x,y`", text.trim());
    place(&text).map(Some).ok_or_else(|| wrong(&path, told()))
}

/// `x,y`.
#[must_use]
pub fn place(text: &str) -> Option<Vector2<f64>> {
    let (x, y) = text.split_once(',')?;
    let place = Vector2::new(x.trim().parse().ok()?, y.trim().parse().ok()?);
    place.iter().all(|v: &f64| v.is_finite()).then_some(place)
}

/// A line of the table with as many fields as it has columns.
struct StepRow<'a> {
    path: &'a Path,
    /// Its number in the file, from 1.
    line: usize,
    fields: Vec<&'a str>,
    is_last: bool,
}

/// The lines after the header.
fn rows<'a>(path: &'a Path, text: &'a str) -> Result<Vec<StepRow<'a>>, TensorError> {
    let text = text.trim_start_matches('\u{feff}').trim_end();
    let mut lines = text.lines().enumerate().map(|(n, line)| (n + 1, fields(line)));
    let header = lines.next().map(|(_, fields)| fields).unwrap_or_default();
    if header != COLUMNS {
        return Err(wrong(
            path,
            format!("line 1 is `{}`, expected `{}`", header.join(","), COLUMNS.join(",")),
        ));
    }
    let lines: Vec<_> = lines.collect();
    let count = lines.len();
    let row = |(n, (line, fields)): (usize, (usize, Vec<&'a str>))| {
        if fields.len() != COLUMNS.len() {
            let message = format!("line {line} has {} fields, expected {}", fields.len(), COLUMNS.len());
            return Err(wrong(path, message));
        }
        Ok(StepRow { path, line, fields, is_last: n + 1 == count })
    };
    lines.into_iter().enumerate().map(row).collect()
}

fn fields(line: &str) -> Vec<&str> {
    line.split(',').map(str::trim).collect()
}

impl StepRow<'_> {
    fn wrong(&self, column: usize, message: &str) -> TensorError {
        let (line, name, value) = (self.line, COLUMNS[column], self.fields[column]);
        wrong(self.path, format!("line {line}, column {name}: `{value}` {message}"))
    }

    fn number<T: FromStr>(&self, column: usize) -> Result<T, TensorError> {
        self.fields[column].parse().map_err(|_| self.wrong(column, "is no number"))
    }

    /// A number that `is_good`, else an error that says what it `must` be.
    fn checked(&self, column: usize, must: &str, is_good: impl Fn(f32) -> bool) -> Result<f32, TensorError> {
        let value = self.number(column)?;
        if is_good(value) { Ok(value) } else { Err(self.wrong(column, must)) }
    }

    fn flag(&self, column: usize) -> Result<bool, TensorError> {
        match self.fields[column] {
            "0" => Ok(false),
            "1" => Ok(true),
            _ => Err(self.wrong(column, "is neither 0 nor 1")),
        }
    }

    fn action(&self) -> Result<Vector2<f32>, TensorError> {
        let must = "must lie in [-1, 1], the share of a_max";
        let axis = |column| self.checked(column, must, |a| a.abs() <= LARGEST_ACTION);
        Ok(Vector2::new(axis(2)?, axis(3)?))
    }

    fn step(&self) -> Result<Step, TensorError> {
        let time_s: f64 = self.number(1)?;
        if !time_s.is_finite() {
            return Err(self.wrong(1, "is not finite"));
        }
        let snr_db = match self.fields[4] {
            "" => f32::NAN,
            _ => self.checked(4, "is not finite; leave it empty", f32::is_finite)?,
        };
        let power = self.checked(5, "must be above 0", |power| power.is_finite() && power > 0.0)?;
        Ok(Step { time_s, snr_db, power, outage: self.flag(6)?, contact: self.flag(7)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode() -> (FolderEpisode, Vec<Frame>) {
        let step = |k: usize| Step {
            time_s: 0.1 * k as f64,
            snr_db: if k == 1 { f32::NAN } else { 9.7 },
            power: 4.0,
            outage: k == 2,
            contact: k == 1,
        };
        let actions = vec![Vector2::new(0.1, -1.0), Vector2::new(1.0 / 3.0, 0.0)];
        let episode = FolderEpisode {
            actions,
            steps: (0..3).map(step).collect(),
            a_max: 3.5e-3,
            base_station: Some(Vector2::new(0.5, 0.05)),
        };
        (episode, vec![Frame::black(); 3])
    }

    /// What reading says after a file's text was changed.
    fn refused(file: &str, old: &str, new: &str) -> String {
        let dir = tempfile::tempdir().unwrap();
        let dir = dir.path().join("episode-00000");
        let (episode, frames) = episode();
        episode.save(&frames, &dir).unwrap();
        let text = std::fs::read_to_string(dir.join(file)).unwrap();
        assert!(text.contains(old), "{text}");
        std::fs::write(dir.join(file), text.replacen(old, new, 1)).unwrap();
        let said = FolderEpisode::load(&dir).unwrap_err().to_string();
        said.strip_prefix(&format!("{}: ", dir.join(file).display())).unwrap().to_owned()
    }

    #[test]
    fn a_table_that_is_wrong_is_refused_by_file_line_and_column() {
        for (old, new, said) in [
            ("frame,", "picture,", "line 1 is `picture,time_s,"),
            ("1,0.1,", "2,0.1,", "line 3, column frame: `2` expected 1"),
            ("0.2,", "0.1,", "line 4, column time_s: `0.1` is not after the line before"),
            ("0.1,-1,", "5,-1,", "line 2, column action_x: `5` must lie in [-1, 1], the share of a_max"),
            (",-1,", ",up,", "line 2, column action_y: `up` is no number"),
            ("9.7", "inf", "line 2, column snr_db: `inf` is not finite; leave it empty"),
            (",4,", ",0,", "line 2, column power: `0` must be above 0"),
            (",1,0\n", ",true,0\n", "line 4, column outage: `true` is neither 0 nor 1"),
            (",0,0\n", ",0\n", "line 2 has 7 fields, expected 8"),
        ] {
            let told = refused(STEPS, old, new);
            assert!(told.starts_with(said), "{told}");
        }
        assert_eq!(refused(A_MAX, "0.0035", "-1"), "`-1` is no a_max: sides of the picture per interval²");
        assert_eq!(refused(BASE_STATION, ",", " "), "`0.5 0.05` is no base station: expected `x,y`");
    }

    #[test]
    fn a_table_of_a_spreadsheet_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let dir = dir.path().join("episode-00000");
        let (episode, frames) = episode();
        episode.save(&frames, &dir).unwrap();
        let text = std::fs::read_to_string(dir.join(STEPS)).unwrap();
        let text = format!("\u{feff}{}\r\n\r\n", text.trim_end().replace('\n', "\r\n").replace(',', ", "));
        std::fs::write(dir.join(STEPS), text).unwrap();
        let read = FolderEpisode::load(&dir).unwrap();
        assert_eq!((read.actions, read.steps.len()), (episode.actions, 3));
    }

    #[test]
    fn a_picture_that_is_missing_or_of_another_size_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let dir = dir.path().join("episode-00000");
        let (episode, frames) = episode();
        episode.save(&frames, &dir).unwrap();
        std::fs::write(picture_path(&dir, 1), b"no picture").unwrap();
        assert!(read_picture(&dir, 1).unwrap_err().to_string().contains("00001.png: decoding the frame"));
        std::fs::remove_file(picture_path(&dir, 1)).unwrap();
        let said = FolderEpisode::load(&dir).unwrap_err().to_string();
        assert!(
            said.contains("00001.png: is missing, and ") && said.ends_with("has a line for it"),
            "{said}"
        );
    }
}
