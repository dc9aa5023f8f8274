//! `gcs replay`: a flight that is over, again on the wire, for any ground station to watch.
//!
//! A tlog is sent frame by frame, byte for byte, as far apart as the frames came, also frames whose checksums
//! fit no message that is known today; a clock that was set in flight is no pause. A `record.jsonl` is
//! told as the vehicle told it: its report, its place on the map and its heartbeat. Commands that a
//! station sent are left out of a tlog unless they are wanted: nobody is to fly by them. Keys
//! (SETUP_SIGNING) are never sent. A folder of `gcs record` is told as records are, one episode after the other.
//!
//! | module | what it is |
//! |---|---|
//! | [`recording`] | a recording as records |
//! | [`reports`] | a record as the vehicle's report |
//! | [`show`] | what a page shows of a replay |

#![expect(clippy::disallowed_methods, reason = "a shell: it sends at the recorded times")]

pub mod recording;
pub mod reports;
pub mod show;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use crpl_sitl::Scenario;
use crpl_sitl::link::dialect::{
    GLOBAL_POSITION_INT_DATA, GPS_RAW_INT_DATA, GpsFixType, HEARTBEAT_DATA, MavAutopilot, MavModeFlag,
    MavState, MavType, SETUP_SIGNING_DATA,
};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::status::Heartbeat;
use crpl_sitl::link::tlog::LogFrame;
use crpl_sitl::link::wire::{self, Clock};
use crpl_sitl::link::{AUTOPILOT, MessageData, RADIO, STATION_SYSTEM};
use crpl_sitl::program::progress;
use crpl_sitl::program::terminal::{interrupted, speed};
use crpl_sitl::radio::message::Telemetry;
use crpl_sitl::sim::record::Record;
use crpl_sitl::vehicle::geodesy;
use serde_json::Value;
use tokio::time::{Instant, sleep_until};

use crate::tools::bridge::hub::Hub;
use crate::tools::tlog;
use crate::watch::WatchFlags;
use crate::watch::feed::Feed;
use crate::watch::map::MapFlags;
pub use reports::report;

use recording::ReplayedRecording;
use show::ReplayShow;

/// A pause that is longer is announced.
const LONG: Duration = Duration::from_secs(10);
/// No flight lasts longer, s: 100 years.
const LONGEST_RECORD_S: f64 = 3.2e9;
/// MAV_TYPE_GCS.
const GCS: u8 = 6;

/// Flags of `gcs replay`.
#[derive(Debug, Clone, clap::Args)]
pub struct Replay {
    /// Run folder, or a file of one: flight.tlog or record.jsonl; a folder of `gcs record`; or the tlog of any
    /// vehicle
    #[arg(value_name = "RUN")]
    file: PathBuf,
    /// Endpoints to send to: udpout:HOST:PORT, or udpin, tcpout, tcpin; repeatable
    #[arg(long, value_name = "ENDPOINT", num_args = 1.., required_unless_present = "watch")]
    forward: Vec<Endpoint>,
    #[command(flatten)]
    watch: WatchFlags,
    #[command(flatten)]
    map: MapFlags,
    /// Speed relative to the recorded flight
    #[arg(long, value_name = "X", default_value = "1", value_parser = speed)]
    speed: f64,
    /// Sign all messages with the key in this file: TOML with `key` (64 hexadecimal digits) or `passphrase`
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// Also send the ground stations' messages
    #[arg(long)]
    all: bool,
}

/// What is sent, and when after the beginning.
pub type Script = Vec<(Duration, Vec<u8>)>;

/// Sends the file to its end.
///
/// # Errors
/// A log that does not read, and an endpoint that cannot be opened.
pub async fn run(args: Replay) -> Result<()> {
    let source = ReplaySource::open(&args.file)?;
    let script = source.script(args.all)?;
    let mut interrupted = pin!(interrupted());
    let mut hub = Hub::default();
    hub.local();
    if let Some(path) = &args.signing_key {
        hub.sign_with(path)?;
    }
    for endpoint in &args.forward {
        crpl_sitl::outln!("forward: {}", hub.open(endpoint).await?);
    }
    let buildings = args.map.load()?;
    let page = args.watch.open()?;
    let mut shown = page.as_ref().map(|page| source.show(page.feed(), buildings)).transpose()?;
    // A port of ours has no listener before one has spoken to it.
    if !args.forward.is_empty() && !args.forward.iter().any(Endpoint::speaks_at_once) {
        crpl_sitl::outln!("waiting for a connection");
        while hub.router().links().count() < 2 {
            tokio::select! {
                () = hub.turn() => {}
                _ = &mut interrupted => return Ok(()),
            }
        }
    }
    let lasted = script.last().map_or(Duration::ZERO, |(after, _)| *after);
    let line = progress::live("replay", lasted.as_secs());
    let start = Instant::now();
    for (after, bytes) in &script {
        line.set_position(after.as_secs());
        let due =
            start.checked_add(after.div_f64(args.speed)).context("the log lasts too long at this speed")?;
        let pause = due.saturating_duration_since(Instant::now());
        if pause > LONG {
            tracing::info!("the log has a pause here: {:.0} s until the next message", pause.as_secs_f64());
        }
        while Instant::now() < due {
            tokio::select! {
                () = hub.turn() => {}
                () = sleep_until(due) => {}
                _ = &mut interrupted => return Ok(()),
            }
            while hub.take().is_some() {}
            hub.notices();
        }
        hub.broadcast(bytes).await;
        if let Some(shown) = &mut shown {
            shown.play(*after, bytes);
        }
    }
    line.finish_and_clear();
    hub.close().await;
    crpl_sitl::outln!("{} datagrams of {:.1} s sent", script.len(), lasted.as_secs_f64());
    if let Some(mut page) = page {
        shown.iter_mut().for_each(ReplayShow::finish);
        page.leave().await;
    }
    Ok(())
}

/// What is replayed.
enum ReplaySource {
    /// A tlog or a file of records.
    Log(PathBuf),
    /// A folder of `gcs record`.
    Recording(Box<ReplayedRecording>),
}

impl ReplaySource {
    fn open(path: &Path) -> Result<Self> {
        if recording::is_recording(path) {
            let recording =
                ReplayedRecording::open(path).with_context(|| format!("reading {}", path.display()))?;
            return Ok(Self::Recording(Box::new(recording)));
        }
        Ok(Self::Log(log_of(path, &["flight.tlog", "record.jsonl"])?))
    }

    fn script(&self, all: bool) -> Result<Script> {
        let path = match self {
            Self::Log(path) => path,
            Self::Recording(recording) => return told(&recording.records, &recording.scenario),
        };
        let bytes = std::fs::read(path).with_context(|| format!("reading {}", path.display()))?;
        let name = || path.display().to_string();
        let script = if is_record(path) {
            from_records(&String::from_utf8_lossy(&bytes), &scenario_beside(path)?).with_context(name)?
        } else {
            from_tlog(&bytes, all).with_context(name)?
        };
        if script.is_empty() {
            bail!("{}: nothing in it to send", path.display());
        }
        Ok(script)
    }

    fn show(self, feed: &Feed, buildings: Option<Value>) -> Result<ReplayShow> {
        let path = match self {
            Self::Log(path) => path,
            Self::Recording(recording) => return Ok(ReplayShow::of_recording(*recording, feed)),
        };
        if let Some(show) = ReplayShow::beside(&path, feed) {
            return Ok(show);
        }
        if !is_record(&path) {
            return Ok(ReplayShow::of_messages(feed, buildings));
        }
        let text = std::fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
        Ok(ReplayShow::of_records(&records(&text)?, &scenario_beside(&path)?, feed))
    }
}

/// Whether a file is one of records.
fn is_record(path: &Path) -> bool {
    path.extension().is_some_and(|end| end == "jsonl")
}

/// The frames of a tlog. What is none is told and left out, as is an end that is cut off.
///
/// # Errors
/// There is no frame in it.
pub fn from_tlog(bytes: &[u8], all: bool) -> Result<Script> {
    let (frames, counts) = tlog::timed(bytes);
    if counts.frames == 0 {
        bail!("no MAVLink frame; is this a tlog?");
    }
    for (count, what) in [
        (counts.bad_crc, "frames with a checksum that does not fit: sent as they are"),
        (counts.skipped, "bytes between frames: left out"),
        (counts.cut, "bytes of a last frame that is cut off: left out"),
    ] {
        if count > 0 {
            tracing::warn!("{count} {what}");
        }
    }
    let is_station = |frame: &LogFrame<'_>| {
        frame.packet.system == STATION_SYSTEM
            || Heartbeat::of(frame.packet).is_some_and(|beat| beat.kind == GCS)
    };
    let stations: BTreeSet<(u8, u8)> = frames
        .iter()
        .filter(|(_, frame)| is_station(frame))
        .map(|(_, frame)| (frame.packet.system, frame.packet.component))
        .collect();
    let wanted = |frame: &LogFrame<'_>| {
        let sender = (frame.packet.system, frame.packet.component);
        frame.packet.id != SETUP_SIGNING_DATA::ID && (all || !stations.contains(&sender))
    };
    let frames = frames.iter().filter(|(_, frame)| wanted(frame));
    Ok(frames.map(|(after, frame)| (*after, frame.packet.raw.to_vec())).collect())
}

/// The records of a run folder's `record.jsonl`.
///
/// # Errors
/// A line is no record; the error names it.
pub fn records(text: &str) -> Result<Vec<Record>> {
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines.map(|(k, line)| serde_json::from_str(line).with_context(|| format!("line {}", k + 1))).collect()
}

/// The log to read in a run folder; a file is itself.
///
/// # Errors
/// A folder that holds no flight.
pub fn log_of(path: &Path, wanted: &[&str]) -> Result<PathBuf> {
    if !path.is_dir() {
        return Ok(path.into());
    }
    if let Some(file) = wanted.iter().map(|name| path.join(name)).find(|file| file.is_file()) {
        return Ok(file);
    }
    let is_run = |dir: &PathBuf| wanted.iter().any(|name| dir.join(name).is_file());
    let inside = std::fs::read_dir(path).with_context(|| format!("reading {}", path.display()))?;
    let mut runs: Vec<PathBuf> = inside.filter_map(|entry| Some(entry.ok()?.path())).filter(is_run).collect();
    runs.sort();
    let names: Vec<String> = runs.iter().map(|dir| dir.display().to_string()).collect();
    match names.as_slice() {
        [] => bail!("{}: no flight in it (none of {})", path.display(), wanted.join(", ")),
        [..] => bail!("{}: it holds several run folders; name one: {}", path.display(), names.join(", ")),
    }
}

/// The scenario that a run folder holds beside its records, else the paper's.
///
/// # Errors
/// It does not read.
pub fn scenario_beside(path: &Path) -> Result<Scenario> {
    let beside = path.with_file_name("config.toml");
    if beside.is_file() {
        return Ok(Scenario::load(&beside)?);
    }
    tracing::info!("no config.toml beside {}: the paper's scale", path.display());
    Ok(Scenario::default())
}

/// The records of a flight, told as the vehicle told them.
///
/// # Errors
/// A line is no record.
pub fn from_records(text: &str, scenario: &Scenario) -> Result<Script> {
    told(&records(text)?, scenario)
}

fn told(records: &[Record], scenario: &Scenario) -> Result<Script> {
    let clock = Clock::new(scenario);
    let (mut autopilot, mut radio) = (Encoder::new(1, AUTOPILOT), Encoder::new(1, RADIO));
    let mut script = Script::new();
    let mut next_beat = 0.0;
    for (k, record) in records.iter().enumerate() {
        let seconds = record.tick.0 as f64 * scenario.scale.interval_s;
        if seconds > LONGEST_RECORD_S {
            bail!("line {}: tick {} is no flight's", k + 1, record.tick.0);
        }
        let report = report(record, scenario);
        let mut datagram = Vec::new();
        if seconds >= next_beat {
            next_beat = seconds + 1.0;
            push_heartbeat(&mut autopilot, &mut datagram);
        }
        push_place(&report, &clock, scenario, &mut autopilot, &mut datagram);
        let vertical = [-scenario.scale.altitude_m as f32, 0.0];
        wire::push_telemetry(&report, &clock, vertical, &mut autopilot, &mut radio, &mut datagram);
        script.push((Duration::from_secs_f64(seconds), datagram));
    }
    Ok(script)
}

/// As ArduCopter in GUIDED, armed and in the air.
fn push_heartbeat(autopilot: &mut Encoder, datagram: &mut Vec<u8>) {
    let message = HEARTBEAT_DATA {
        custom_mode: 4,
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
        base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_GUIDED_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED,
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    };
    autopilot.push(datagram, &message);
}

/// Where a map shows it, as GLOBAL_POSITION_INT and as GPS_RAW_INT, from which tracks are drawn.
pub fn push_place(
    report: &Telemetry,
    clock: &Clock,
    scenario: &Scenario,
    autopilot: &mut Encoder,
    datagram: &mut Vec<u8>,
) {
    let [lat, lon] = geodesy::latitude_longitude(report.position);
    let [vx, vy] = report.velocity.map(|v| (v * 100.0).round() as i16);
    let height_mm = scenario.scale.altitude_m * 1e3;
    let message = GLOBAL_POSITION_INT_DATA {
        time_boot_ms: clock.boot_ms(report.tick),
        lat,
        lon,
        alt: (geodesy::HOME[2] * 1e3 + height_mm).round() as i32,
        relative_alt: height_mm.round() as i32,
        vx,
        vy,
        vz: 0,
        hdg: u16::MAX,
    };
    autopilot.push(datagram, &message);
    let fix = GPS_RAW_INT_DATA {
        time_usec: u64::from(message.time_boot_ms) * 1000,
        lat,
        lon,
        alt: message.alt,
        eph: u16::MAX,
        epv: u16::MAX,
        vel: f64::from(report.velocity[0].hypot(report.velocity[1]) * 100.0) as u16,
        cog: u16::MAX,
        fix_type: GpsFixType::GPS_FIX_TYPE_3D_FIX,
        satellites_visible: 12,
        ..Default::default()
    };
    autopilot.push(datagram, &fix);
}

#[cfg(test)]
mod tests {
    use std::time::UNIX_EPOCH;

    use crpl_sitl::link::decoder::Decoder;
    use crpl_sitl::link::tlog::Tlog;
    use crpl_sitl::link::wire::TelemetryReader;
    use crpl_sitl::radio::message::Command;
    use crpl_sitl::units::{Motion, TxPower};
    use crpl_sitl::{Sim, units::Tick};

    use super::*;

    fn tlog() -> (Vec<u8>, Vec<Vec<u8>>) {
        let (mut vehicle, mut station) = (Encoder::new(1, 1), Encoder::new(255, 190));
        let (mut bytes, mut frames) = (Vec::new(), Vec::new());
        let mut log = Tlog::new(&mut bytes);
        for k in 0..4_u64 {
            let mut frame = Vec::new();
            let sender = if k == 2 { &mut station } else { &mut vehicle };
            sender.push(&mut frame, &HEARTBEAT_DATA::default());
            log.frame(&frame, UNIX_EPOCH + Duration::from_millis(1000 + 250 * k)).unwrap();
            frames.push(frame);
        }
        (bytes, frames)
    }

    #[test]
    fn a_tlog_is_sent_as_it_was_without_the_station() {
        let (bytes, frames) = tlog();
        let script = from_tlog(&bytes, false).unwrap();
        let times: Vec<_> = script.iter().map(|(after, _)| after.as_millis()).collect();
        assert_eq!(times, [0, 250, 750]);
        assert_eq!(script[2].1, frames[3]);
        assert_eq!(from_tlog(&bytes, true).unwrap().len(), 4);
    }

    #[test]
    fn a_tlog_that_is_cut_or_none_is_told() {
        let (bytes, _) = tlog();
        for cut in 1..9 {
            assert_eq!(from_tlog(&bytes[..bytes.len() - cut], true).unwrap().len(), 3);
        }
        let error = from_tlog(b"this is a text file, of course", false).unwrap_err().to_string();
        assert_eq!(error, "no MAVLink frame; is this a tlog?");
    }

    /// Report G3: one frame of a message that was redefined since, and nothing was sent.
    #[test]
    fn a_frame_whose_checksum_is_unknown_is_sent_byte_for_byte() {
        let (mut bytes, mut frames) = tlog();
        bytes[20] ^= 1;
        frames[0][12] ^= 1;
        let script = from_tlog(&bytes, true).unwrap();
        assert_eq!(script.into_iter().map(|(_, frame)| frame).collect::<Vec<_>>(), frames);
    }

    #[test]
    fn records_tell_what_the_vehicle_told() {
        let scenario = Scenario::default();
        let mut sim = Sim::new(scenario.clone(), 3);
        let (mut lines, mut told) = (String::new(), Vec::new());
        for k in 0..20 {
            let motion = Motion::ALL[k % 5].vector() * scenario.dynamics.a_max;
            let accel = scenario.scale.ned_from_paper_acceleration(motion);
            let command = Command::new(Tick(k as u64), accel, TxPower::High);
            let before = sim.telemetry();
            sim.handle(command);
            sim.advance();
            let record = Record::new(&before, &command, &sim.telemetry(), &scenario);
            lines += &(serde_json::to_string(&record).unwrap() + "\n");
            told.push(sim.telemetry());
        }
        let script = from_records(&lines, &scenario).unwrap();
        let (mut decoder, mut reader) = (Decoder::default(), TelemetryReader::default());
        let clock = Clock::new(&scenario);
        let again: Vec<_> = script
            .iter()
            .flat_map(|(_, bytes)| decoder.datagram(bytes))
            .filter_map(|packet| reader.push(&packet, &clock))
            .collect();
        assert_eq!(again.len(), told.len());
        for (a, b) in again.iter().zip(&told) {
            assert_eq!((a.tick, a.link, a.held.map(|h| h.tick)), (b.tick, b.link, b.held.map(|h| h.tick)));
            for (x, y) in a.position.iter().zip(b.position) {
                assert!((x - y).abs() < 1e-3);
            }
        }
        assert_eq!(script[5].0, Duration::from_secs_f64(2.0));
        let error =
            crpl_sitl::program::terminal::one_line(&from_records("{\"tick\":1}", &scenario).unwrap_err());
        assert!(error.starts_with("line 1: missing field"), "{error}");
        let first = lines.lines().next().unwrap().to_owned();
        for tick in [u64::MAX, 1 << 63] {
            let late = first.replace("\"tick\":0,", &format!("\"tick\":{tick},"));
            let error = from_records(&late, &scenario).unwrap_err().to_string();
            assert_eq!(error, format!("line 1: tick {tick} is no flight's"));
        }
    }
}
