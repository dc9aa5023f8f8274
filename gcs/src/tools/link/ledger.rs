//! The ledger of a link: one row a frame, with what became of it, as Parquet.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use crpl_sitl::link::packet::{Packet, message_name};
use crpl_sitl::radio::air::CarriedFrame;

use crate::tools::parquet::{Column, ParquetFile, Values};

/// Rows of a row group.
const GROUP: usize = 1 << 16;

/// A row: times in ns since the link began.
#[derive(Debug, Clone)]
struct LedgerRow {
    way: &'static str,
    message: &'static str,
    id: u32,
    source: [u8; 3],
    bytes: usize,
    offered: Duration,
    on_air: Option<Duration>,
    air_time: Duration,
    done: Duration,
    packets: u32,
    snr_db: f64,
    fate: &'static str,
}

/// A message's name, or `unknown`.
pub(super) fn name_of(id: u32) -> &'static str {
    message_name(id).unwrap_or("unknown")
}

impl From<&CarriedFrame<Packet>> for LedgerRow {
    fn from(frame: &CarriedFrame<Packet>) -> Self {
        let packet = &frame.frame;
        Self {
            way: frame.way.name(),
            message: name_of(packet.id),
            id: packet.id,
            source: [packet.system, packet.component, packet.sequence],
            bytes: frame.bytes,
            offered: frame.offered,
            on_air: frame.on_air,
            air_time: frame.air_time,
            done: frame.done,
            packets: frame.packets,
            snr_db: frame.snr_db,
            fate: frame.fate.name(),
        }
    }
}

/// Writes rows as they come.
#[derive(Debug)]
pub struct FrameLedger<W: Write + Send> {
    file: ParquetFile<W>,
    rows: Vec<LedgerRow>,
}

impl FrameLedger<BufWriter<File>> {
    /// A ledger in a file; `notes` are pairs of key and value that say what it is of.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(path: &Path, notes: &[(&str, &str)]) -> Result<Self> {
        let file = File::create(path).with_context(|| format!("creating {}", path.display()))?;
        Self::new(BufWriter::new(file), notes)
    }
}

impl<W: Write + Send> FrameLedger<W> {
    /// A ledger without rows.
    ///
    /// # Errors
    /// Writing fails.
    pub fn new(out: W, notes: &[(&str, &str)]) -> Result<Self> {
        Ok(Self { file: ParquetFile::new(out, &columns(&[]), notes)?, rows: Vec::new() })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// Writing fails.
    pub fn push(&mut self, frame: &CarriedFrame<Packet>) -> Result<()> {
        self.rows.push(frame.into());
        if self.rows.len() < GROUP {
            return Ok(());
        }
        self.write()
    }

    fn write(&mut self) -> Result<()> {
        if !self.rows.is_empty() {
            self.file.push(&columns(&self.rows))?;
            self.rows.clear();
        }
        Ok(())
    }

    /// Writes what is left, and the end.
    ///
    /// # Errors
    /// Writing fails.
    pub fn close(mut self) -> Result<()> {
        self.write()?;
        self.file.close()
    }
}

fn nanos(time: Duration) -> i64 {
    i64::try_from(time.as_nanos()).unwrap_or(i64::MAX)
}

fn columns(rows: &[LedgerRow]) -> Vec<Column<'static>> {
    let integers = |value: fn(&LedgerRow) -> i64| Values::Integers(rows.iter().map(value).collect());
    let texts = |value: fn(&LedgerRow) -> &'static str| Values::Texts(rows.iter().map(value).collect());
    let columns = [
        ("way", texts(|row| row.way)),
        ("message", texts(|row| row.message)),
        ("id", integers(|row| row.id.into())),
        ("system", integers(|row| row.source[0].into())),
        ("component", integers(|row| row.source[1].into())),
        ("sequence", integers(|row| row.source[2].into())),
        ("bytes", integers(|row| row.bytes as i64)),
        ("offered_ns", integers(|row| nanos(row.offered))),
        // A frame that was never on the air has -1.
        ("on_air_ns", integers(|row| row.on_air.map_or(-1, nanos))),
        ("air_time_ns", integers(|row| nanos(row.air_time))),
        ("done_ns", integers(|row| nanos(row.done))),
        ("packets", integers(|row| row.packets.into())),
        ("snr_db", Values::Reals(rows.iter().map(|row| row.snr_db).collect())),
        ("fate", texts(|row| row.fate)),
    ];
    columns.map(|(name, values)| Column { name, values }).into()
}
