//! `gcs tlog`: what is in a telemetry log, a part of one, several as one. Frames stay byte for byte as they are;
//! messages that hold a key (SETUP_SIGNING) are left out of what is written.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use crpl_sitl::link::dialect::SETUP_SIGNING_DATA;
use crpl_sitl::link::tlog::{LogCounts, LogFrame, TlogReader};
use crpl_sitl::link::{MessageData, message_name};
use serde::Serialize;

/// A pause that is longer is no pause: the clock was set.
const CLOCK_SET: Duration = Duration::from_secs(3600);

/// Flags of `gcs tlog`.
#[derive(Debug, Clone, clap::Args)]
pub struct TlogArgs {
    #[command(subcommand)]
    action: TlogAction,
}

#[derive(Debug, Clone, Subcommand)]
enum TlogAction {
    /// Print what a log holds: senders, messages, duration, damage
    Info {
        /// The log
        file: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Write a part of a log to another file
    Cut {
        /// The log
        file: PathBuf,
        /// Seconds after the log's beginning at which the part begins
        #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
        from: f64,
        /// Seconds after the log's beginning at which the part ends [default: the log's end]
        #[arg(long, value_name = "SECONDS")]
        to: Option<f64>,
        /// Only frames of this system
        #[arg(long, value_name = "N")]
        sysid: Option<u8>,
        /// File to write, which must not be there yet
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Write several logs as one, in the order of their stamps
    Merge {
        /// The logs
        #[arg(required = true, num_args = 2..)]
        files: Vec<PathBuf>,
        /// File to write, which must not be there yet
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
}

/// Does what was asked.
///
/// # Errors
/// A file that cannot be read or written, or is no log.
pub fn run(args: &TlogArgs) -> Result<()> {
    match &args.action {
        TlogAction::Info { file, json } => {
            let bytes = read(file)?;
            let info = TlogInfo::of(&bytes);
            known(file, &info.counts)?;
            if *json {
                crpl_sitl::outln!("{}", serde_json::to_string(&info)?);
            } else {
                crpl_sitl::out!("{}", info.text());
            }
        }
        TlogAction::Cut { file, from, to, sysid, out } => {
            let bytes = read(file)?;
            let (frames, counts) = timed(&bytes);
            known(file, &counts)?;
            let part = from.max(0.0)..to.unwrap_or(f64::INFINITY);
            let wanted = |(after, frame): &&(Duration, LogFrame<'_>)| {
                part.contains(&after.as_secs_f64()) && sysid.is_none_or(|id| id == frame.packet.system)
            };
            if !frames.iter().any(|frame| wanted(&frame)) {
                let lasts = frames.last().map_or(0.0, |(after, _)| after.as_secs_f64());
                bail!("{}: no frame in that part; the log lasts {lasts:.1} s", file.display());
            }
            write(out, frames.iter().filter(wanted).map(|(_, frame)| frame))?;
        }
        TlogAction::Merge { files, out } => {
            let logs = files.iter().map(|file| read(file)).collect::<Result<Vec<_>>>()?;
            let mut all = Vec::new();
            for (file, bytes) in files.iter().zip(&logs) {
                let mut reader = TlogReader::new(bytes);
                all.extend(reader.by_ref());
                known(file, &reader.counts())?;
            }
            // Stable: frames of equal stamps stay in the order of the files.
            all.sort_by_key(|frame| frame.time_us);
            write(out, all.iter())?;
        }
    }
    Ok(())
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("reading {}", path.display()))
}

/// An error if a file holds no frame at all.
fn known(path: &Path, counts: &LogCounts) -> Result<()> {
    if counts.frames == 0 {
        bail!("{}: no MAVLink frame in it; is this a tlog?", path.display());
    }
    Ok(())
}

fn write<'a>(path: &Path, frames: impl Iterator<Item = &'a LogFrame<'a>>) -> Result<()> {
    if path.exists() {
        bail!("{}: there is a file of this name", path.display());
    }
    let (mut bytes, mut count) = (Vec::new(), 0_u64);
    for frame in frames.filter(|frame| frame.packet.id != SETUP_SIGNING_DATA::ID) {
        bytes.extend(frame.time_us.to_be_bytes());
        bytes.extend_from_slice(frame.packet.raw);
        count += 1;
    }
    std::fs::write(path, bytes).with_context(|| format!("writing {}", path.display()))?;
    crpl_sitl::outln!("{count} frames in {}", path.display());
    Ok(())
}

/// The frames of a log with the time after its beginning. Where the clock was set, time goes on without a pause.
#[must_use]
pub fn timed(bytes: &[u8]) -> (Vec<(Duration, LogFrame<'_>)>, LogCounts) {
    let mut reader = TlogReader::new(bytes);
    let (mut after, mut last, mut frames) = (Duration::ZERO, None, Vec::new());
    for frame in reader.by_ref() {
        let step = last.map_or(Duration::ZERO, |last| pause(last, frame.time_us).unwrap_or_default());
        after += step;
        last = Some(frame.time_us);
        frames.push((after, frame));
    }
    (frames, reader.counts())
}

/// The time between two stamps, µs; `None` if the clock was set between them.
fn pause(before: u64, now: u64) -> Option<Duration> {
    let step = now.checked_sub(before).map(Duration::from_micros)?;
    (step <= CLOCK_SET).then_some(step)
}

/// What a log holds.
#[derive(Debug, Clone, Default, Serialize)]
pub struct TlogInfo {
    /// From the first frame to the last, s, without the jumps of a clock.
    pub seconds: f64,
    /// Stamp of the first frame, s since 1970.
    pub begins: f64,
    /// How often the clock was set.
    pub clock_set: u64,
    /// Frames by system and component.
    pub senders: BTreeMap<String, u64>,
    /// Frames by message.
    pub messages: BTreeMap<String, u64>,
    /// Frames good and bad, and what is none.
    #[serde(flatten)]
    pub counts: LogCounts,
}

impl TlogInfo {
    /// Of a log's bytes.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        let (frames, counts) = timed(bytes);
        let mut info = Self { counts, ..Self::default() };
        let mut last = None;
        for (after, frame) in &frames {
            info.seconds = after.as_secs_f64();
            info.clock_set += u64::from(last.is_some_and(|before| pause(before, frame.time_us).is_none()));
            last = Some(frame.time_us);
            let packet = &frame.packet;
            *info.senders.entry(format!("{}/{}", packet.system, packet.component)).or_default() += 1;
            let name = message_name(packet.id).map_or_else(|| packet.id.to_string(), str::to_owned);
            *info.messages.entry(name).or_default() += 1;
        }
        info.begins = frames.first().map_or(0.0, |(_, frame)| frame.time_us as f64 / 1e6);
        info
    }

    fn text(&self) -> String {
        let LogCounts { frames, unknown, bad_crc, skipped, cut } = self.counts;
        let mut text = format!("{frames} frames in {:.1} s\n", self.seconds);
        for (count, what) in [
            (bad_crc, "frames with a checksum that does not fit: damaged, or of another dialect"),
            (unknown, "frames of messages that the dialect lacks"),
            (skipped, "bytes between frames"),
            (cut, "bytes of a last frame that is cut off"),
            (self.clock_set, "times the clock was set"),
        ] {
            if count > 0 {
                let _ = writeln!(text, "{count} {what}");
            }
        }
        for (title, rows) in [("system/component", &self.senders), ("message", &self.messages)] {
            let _ = writeln!(text, "\n{title:<32} {:>9} {:>9}", "frames", "/s");
            for (name, count) in rows {
                // A log of one moment has no rates.
                let rate = (self.seconds > 0.0).then(|| format!("{:.1}", *count as f64 / self.seconds));
                let rate = rate.unwrap_or_else(|| "-".into());
                let _ = writeln!(text, "{name:<32} {count:>9} {rate:>9}");
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use std::time::UNIX_EPOCH;

    use crpl_sitl::link::dialect::HEARTBEAT_DATA;
    use crpl_sitl::link::encoder::Encoder;
    use crpl_sitl::link::tlog::Tlog;

    use super::*;

    /// A log with a heartbeat of this system at each of these times, s.
    fn log(system: u8, times: &[u64]) -> Vec<u8> {
        let (mut encoder, mut bytes) = (Encoder::new(system, 1), Vec::new());
        let mut tlog = Tlog::new(&mut bytes);
        for seconds in times {
            let mut frame = Vec::new();
            encoder.push(&mut frame, &HEARTBEAT_DATA::default());
            tlog.frame(&frame, UNIX_EPOCH + Duration::from_secs(*seconds)).unwrap();
        }
        bytes
    }

    #[test]
    fn a_clock_that_was_set_in_flight_is_no_pause_of_53_years() {
        let bytes = log(1, &[5, 6, 1_700_000_000, 1_700_000_001]);
        let after: Vec<_> = timed(&bytes).0.iter().map(|(after, _)| after.as_secs()).collect();
        assert_eq!(after, [0, 1, 1, 2]);
        let info = TlogInfo::of(&bytes);
        assert_eq!((info.clock_set, info.seconds), (1, 2.0));
        assert!(info.text().contains("1 times the clock was set"), "{}", info.text());
        assert_eq!((info.senders["1/1"], info.messages["HEARTBEAT"]), (4, 4));
    }

    /// One frame was told as 1000000.0 a second.
    #[test]
    fn a_log_of_one_moment_has_no_rates() {
        let text = TlogInfo::of(&log(1, &[10])).text();
        assert!(text.contains("HEARTBEAT") && !text.contains("1000000"), "{text}");
    }

    #[test]
    fn logs_are_cut_and_merged_byte_for_byte() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("a"), log(1, &[10, 12, 14])).unwrap();
        std::fs::write(path("b"), log(2, &[11, 13])).unwrap();
        let merge = TlogAction::Merge { files: vec![path("a"), path("b")], out: path("ab") };
        run(&TlogArgs { action: merge.clone() }).unwrap();
        let merged = read(&path("ab")).unwrap();
        let systems: Vec<_> = TlogReader::new(&merged).map(|frame| frame.packet.system).collect();
        assert_eq!(systems, [1, 2, 1, 2, 1]);
        assert!(run(&TlogArgs { action: merge }).is_err(), "a log is never replaced");
        let cut = |sysid, from, to, name: &str| {
            let action = TlogAction::Cut { file: path("ab"), from, to, sysid, out: path(name) };
            run(&TlogArgs { action }).unwrap();
            read(&path(name)).unwrap()
        };
        assert_eq!(cut(Some(1), 0.0, None, "ones"), log(1, &[10, 12, 14]));
        assert_eq!(cut(None, 1.0, Some(3.0), "middle").len(), merged.len() / 5 * 2);
        let none = TlogAction::Cut { file: path("ab"), from: 9.0, to: None, sysid: None, out: path("none") };
        let error = run(&TlogArgs { action: none }).unwrap_err().to_string();
        assert!(error.contains("no frame in that part; the log lasts 4.0 s"), "{error}");
        assert!(!path("none").exists(), "an empty log is none");
        std::fs::write(path("text"), "no log").unwrap();
        let info = TlogAction::Info { file: path("text"), json: false };
        assert!(run(&TlogArgs { action: info }).unwrap_err().to_string().contains("is this a tlog?"));
    }
}
