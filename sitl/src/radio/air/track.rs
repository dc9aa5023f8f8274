//! Where a vehicle was, by time: a CSV of `time,x,y,z`, in seconds and metres north, east and down.
//!
//! A place holds until the next one, as a radio knows it, so a replay meets the losses of the flight.

use std::fmt::Write;
use std::path::Path;
use std::time::Duration;

/// The first line.
const HEAD: &str = "time,x,y,z";

/// A recorded geometry.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GeometryTrack {
    /// By rising time: north, east, down, m.
    points: Vec<(Duration, [f64; 3])>,
}

/// Why something is no track.
#[derive(Debug, thiserror::Error)]
pub enum TrackError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// The first line is another.
    #[error("the first line must be {HEAD}")]
    Head,
    /// A line is wrong.
    #[error("line {line}: {why}")]
    Line {
        /// Its number, from 1.
        line: usize,
        /// What is wrong.
        why: &'static str,
    },
    /// There is no line.
    #[error("no place is in it")]
    Empty,
}

impl GeometryTrack {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read or is no track.
    pub fn load(path: &Path) -> Result<Self, TrackError> {
        Self::parse(&std::fs::read_to_string(path)?)
    }

    /// Reads a text.
    ///
    /// # Errors
    /// It is no track.
    pub fn parse(text: &str) -> Result<Self, TrackError> {
        let mut lines = text.lines().zip(1..);
        if lines.next().map(|(head, _)| head.trim()) != Some(HEAD) {
            return Err(TrackError::Head);
        }
        let mut track = Self::default();
        for (text, line) in lines.filter(|(text, _)| !text.trim().is_empty()) {
            let error = |why| TrackError::Line { line, why };
            let numbers: Vec<f64> = text
                .split(',')
                .map_while(|part| part.trim().parse().ok())
                .filter(|x: &f64| x.is_finite())
                .collect();
            let [time, x, y, z] = numbers[..] else { return Err(error("not four numbers")) };
            let time = Duration::try_from_secs_f64(time).map_err(|_| error("a time below 0"))?;
            if track.points.last().is_some_and(|(last, _)| *last > time) {
                return Err(error("a time before the last one"));
            }
            track.points.push((time, [x, y, z]));
        }
        if track.points.is_empty() { Err(TrackError::Empty) } else { Ok(track) }
    }

    /// The vehicle is here from `time` on. A place before the last one's time is left out.
    pub fn push(&mut self, time: Duration, place: [f64; 3]) {
        if self.points.last().is_none_or(|(last, known)| *last <= time && *known != place) {
            self.points.push((time, place));
        }
    }

    /// Where it was: north, east, down, m; before the first place, that.
    #[must_use]
    pub fn at(&self, time: Duration) -> Option<[f64; 3]> {
        let after = self.points.partition_point(|(from, _)| *from <= time);
        self.points.get(after.saturating_sub(1)).map(|(_, place)| *place)
    }

    /// When it is somewhere else next, after `time`.
    #[must_use]
    pub fn next_after(&self, time: Duration) -> Option<Duration> {
        let after = self.points.partition_point(|(from, _)| *from <= time);
        self.points.get(after).map(|(from, _)| *from)
    }

    /// The CSV. Every number comes back as it is.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text = format!("{HEAD}\n");
        for (time, [x, y, z]) in &self.points {
            let _ = writeln!(text, "{}.{:09},{x},{y},{z}", time.as_secs(), time.subsec_nanos());
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "time,x,y,z\n0,1,2,-3\n1.5,4,5,-6\n\n2, 7, 8, -9\n";

    #[test]
    fn a_place_holds_until_the_next() {
        let track = GeometryTrack::parse(TEXT).unwrap();
        for (time, x) in [(0.0, 1.0), (1.4, 1.0), (1.5, 4.0), (1.9, 4.0), (99.0, 7.0)] {
            assert_eq!(track.at(Duration::from_secs_f64(time)).unwrap()[0], x, "{time}");
        }
        assert_eq!(track.next_after(Duration::ZERO), Some(Duration::from_millis(1500)));
        assert_eq!(track.next_after(Duration::from_secs(2)), None);
    }

    #[test]
    fn a_csv_comes_back_as_it_was() {
        let mut track = GeometryTrack::default();
        track.push(Duration::from_nanos(123), [0.1 + 0.2, f64::from(1.1_f32), -1e-7]);
        track.push(Duration::from_secs(5), [1.0; 3]);
        track.push(Duration::from_secs(6), [1.0; 3]);
        track.push(Duration::from_secs(4), [2.0; 3]);
        assert_eq!(track.points.len(), 2, "neither a repetition nor the past");
        assert_eq!(GeometryTrack::parse(&track.to_csv()).unwrap(), track);
    }

    #[test]
    fn what_is_no_track_is_told_by_its_line() {
        for (text, told) in [
            ("a,b\n", "first line"),
            ("time,x,y,z\n", "no place"),
            ("time,x,y,z\n1,2,3\n", "line 2: not four numbers"),
            ("time,x,y,z\n1,2,3,nan\n", "line 2: not four numbers"),
            ("time,x,y,z\n-1,2,3,4\n", "line 2: a time below 0"),
            ("time,x,y,z\n2,2,3,4\n1,2,3,4\n", "line 3: a time before"),
        ] {
            let error = GeometryTrack::parse(text).unwrap_err().to_string();
            assert!(error.contains(told), "{text:?}: {error}");
        }
    }
}
