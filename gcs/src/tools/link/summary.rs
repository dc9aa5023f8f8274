//! What a link has carried, for people and for Prometheus: by message kind, with commands in words.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::Duration;

use crpl_sitl::link::dialect::MavMessage;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::command::{CommandInt, CommandLong, SetMode};
use crpl_sitl::link::packet::Packet;
use crpl_sitl::program::timing::Histogram;
use crpl_sitl::radio::air::{AirReport, CarriedFrame, FrameFate, Way};

use serde_json::Value;

use super::ledger::name_of;
use crate::tools::bridge::counters::export;

/// Widths of the table's columns.
pub const COLUMNS: [usize; 11] = [38, 9, 11, 8, 8, 8, 8, 10, 10, 10, 9];

/// One kind of message on one way.
#[derive(Debug, Clone, Default)]
struct KindRow {
    sent: u64,
    bytes: u64,
    noise: u64,
    outage: u64,
    queue_full: u64,
    delay: Histogram,
    air_time: Duration,
}

impl KindRow {
    fn add(&mut self, frame: &CarriedFrame<Packet>) {
        self.sent += 1;
        self.bytes += frame.bytes as u64;
        self.air_time += frame.air_time;
        match frame.fate {
            FrameFate::Arrived => self.delay.add(frame.delay()),
            FrameFate::Noise => self.noise += 1,
            FrameFate::Outage => self.outage += 1,
            FrameFate::QueueFull => self.queue_full += 1,
        }
    }

    fn merge(&mut self, other: &Self) {
        self.sent += other.sent;
        self.bytes += other.bytes;
        self.noise += other.noise;
        self.outage += other.outage;
        self.queue_full += other.queue_full;
        self.delay.merge(&other.delay);
        self.air_time += other.air_time;
    }

    fn lost(&self) -> u64 {
        self.noise + self.outage + self.queue_full
    }
}

/// All kinds on both ways.
#[derive(Debug, Clone, Default)]
pub struct LinkSummary {
    kinds: BTreeMap<(Way, u32), KindRow>,
}

impl LinkSummary {
    /// A frame's fate is settled.
    pub fn add(&mut self, frame: &CarriedFrame<Packet>) {
        self.kinds.entry((frame.way, frame.frame.id)).or_default().add(frame);
    }

    /// Both ways together, or each kind of message too.
    #[must_use]
    pub fn table(&self, kinds: bool, lasted: Duration) -> String {
        let mut text = format!(
            "{:<38} {:>8} {:>10} {:>7} {:>7} {:>7} {:>7} {:>9} {:>9} {:>9} {:>8}\n",
            "way, message",
            "sent",
            "bytes",
            "lost",
            "noise",
            "outage",
            "queue",
            "p50 ms",
            "p95 ms",
            "p99 ms",
            "on air"
        );
        for way in Way::BOTH {
            let rows = || self.kinds.range((way, 0)..=(way, u32::MAX));
            line(&mut text, way.name(), &self.all(way), lasted);
            for ((_, id), row) in rows().filter(|_| kinds) {
                let name = match name_of(*id) {
                    "unknown" => format!("  {id}"),
                    name => format!("  {name}"),
                };
                line(&mut text, &name, row, lasted);
            }
        }
        text
    }

    /// What was offered and lost on each way, by name.
    #[must_use]
    pub fn by_name(&self) -> Value {
        let counts = Way::BOTH.into_iter().flat_map(|way| {
            let all = self.all(way);
            let counts = [("sent", all.sent), ("lost", all.lost()), ("bytes", all.bytes)];
            counts.map(|(what, count)| (format!("{} {what}", way.name()), count.into()))
        });
        Value::Object(counts.collect())
    }

    /// All kinds of one way together.
    fn all(&self, way: Way) -> KindRow {
        let mut all = KindRow::default();
        self.kinds.range((way, 0)..=(way, u32::MAX)).for_each(|(_, row)| all.merge(row));
        all
    }

    /// In Prometheus' text format, version 0.0.4; `reports` are those of the ways up and down.
    #[must_use]
    pub fn prometheus(&self, reports: [AirReport; 2]) -> String {
        type Value = fn(&KindRow) -> f64;
        type Gauge = fn(&AirReport) -> f64;
        let counters: [(&str, &str, Value); 6] = [
            ("frames", "Frames offered to the radio.", |row| row.sent as f64),
            ("bytes", "Bytes offered to the radio.", |row| row.bytes as f64),
            ("lost_noise_frames", "Frames that noise destroyed.", |row| row.noise as f64),
            ("lost_outage_frames", "Frames lost without a usable SNR.", |row| row.outage as f64),
            ("lost_queue_frames", "Frames that found no room.", |row| row.queue_full as f64),
            ("air_seconds", "Time on the air.", |row| row.air_time.as_secs_f64()),
        ];
        let mut out = String::new();
        let label =
            |way: Way, id: u32| format!("way=\"{}\",message=\"{}\",id=\"{id}\"", way.name(), name_of(id));
        for (name, help, value) in counters {
            let name = format!("mavlink_link_{name}_total");
            let _ = writeln!(out, "# HELP {name} {help}\n# TYPE {name} counter");
            for ((way, id), row) in &self.kinds {
                let _ = writeln!(out, "{name}{{{}}} {}", label(*way, *id), value(row));
            }
        }
        let gauges: [(&str, &str, Gauge); 3] = [
            ("snr_db", "SNR at the receiver, dB.", |report| report.budget.snr_db()),
            ("rssi_dbm", "Received power, dBm.", |report| report.budget.rssi_dbm),
            ("queue_room_ratio", "Free part of the sender's queue.", |report| report.room),
        ];
        for (name, help, value) in gauges {
            let name = format!("mavlink_link_{name}");
            let _ = writeln!(out, "# HELP {name} {help}\n# TYPE {name} gauge");
            for (way, report) in Way::BOTH.iter().zip(&reports) {
                let _ = writeln!(out, "{name}{{way=\"{}\"}} {}", way.name(), value(report));
            }
        }
        let name = "mavlink_link_delay_seconds";
        let _ = writeln!(out, "# HELP {name} From the offer to the arrival.\n# TYPE {name} histogram");
        for ((way, id), row) in &self.kinds {
            export(&row.delay, &mut out, name, &label(*way, *id));
        }
        out
    }
}

fn line(text: &mut String, name: &str, row: &KindRow, lasted: Duration) {
    let percent = |part: u64| format!("{:.1}%", 100.0 * part as f64 / row.sent.max(1) as f64);
    let ms = |part: f64| match row.delay.count() {
        0 => "-".to_owned(),
        _ => format!("{:.1}", 1e3 * row.delay.percentile(part).as_secs_f64()),
    };
    let on_air = 100.0 * row.air_time.as_secs_f64() / lasted.as_secs_f64().max(1e-9);
    let _ = writeln!(
        text,
        "{name:<38} {:>8} {:>10} {:>7} {:>7} {:>7} {:>7} {:>9} {:>9} {:>9} {:>7.1}%",
        row.sent,
        row.bytes,
        percent(row.lost()),
        percent(row.noise),
        percent(row.outage),
        percent(row.queue_full),
        ms(0.5),
        ms(0.95),
        ms(0.99),
        on_air
    );
}

/// A command that was lost or came later than `late`, in words.
#[must_use]
pub fn late_command(frame: &CarriedFrame<Packet>, late: Duration) -> Option<String> {
    let name = command_name(&frame.frame)?;
    let at = frame.offered.as_secs_f64();
    if frame.fate != FrameFate::Arrived {
        return Some(format!("{name} of {at:.2} s was lost: {}", frame.fate.name()));
    }
    let delay = frame.delay();
    (delay > late).then(|| format!("{name} of {at:.2} s arrived {:.2} s later", delay.as_secs_f64()))
}

/// What a frame commands, if it does.
fn command_name(packet: &Packet) -> Option<String> {
    if SetMode::of(packet).is_some() {
        return Some("SET_MODE".into());
    }
    let long = CommandLong::of(packet).map(|command| command.command);
    let number = long.or_else(|| CommandInt::of(packet).map(|command| command.command))?;
    // The dialect has no name for some.
    let named = match packet.message() {
        Some(MavMessage::COMMAND_LONG(command)) => format!("{:?}", command.command),
        Some(MavMessage::COMMAND_INT(command)) => format!("{:?}", command.command),
        _ => format!("command {number}"),
    };
    Some(named.trim_start_matches("MAV_CMD_").to_owned())
}
