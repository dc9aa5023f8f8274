//! The telemetry log of ground stations: before each frame, the microseconds since 1970, 8 bytes,
//! most significant first. `mavlogdump.py` and every ground station read it.
//!
//! A frame is read as it stands: a log holds messages that the dialect lacks or has otherwise, and their
//! checksums fit nothing that is known today. What is no frame is stepped over and counted.

use std::io::{self, Write};
use std::time::{SystemTime, UNIX_EPOCH};

use super::crc::{checksum, crc_extra};
use super::packet::{Header, PacketRef};
use super::{MessageData, dialect, signing};

/// Bytes of a time stamp.
const STAMP: usize = 8;
/// Stamps of one file that are further apart, µs, are no stamps: 100 years.
const AGE: u64 = 100 * 366 * 86_400 * 1_000_000;

/// Writes a tlog.
#[derive(Debug)]
pub struct Tlog<W> {
    sink: W,
    last_us: u64,
}

impl<W: Write> Tlog<W> {
    /// A log that is written to `sink`.
    pub fn new(sink: W) -> Self {
        Self { sink, last_us: 0 }
    }

    /// Appends the frames of a datagram that we made ourselves.
    ///
    /// # Errors
    /// The sink cannot be written.
    pub fn datagram(&mut self, bytes: &[u8], time: SystemTime) -> io::Result<()> {
        for frame in signing::frames(bytes) {
            self.frame(frame, time)?;
        }
        Ok(())
    }

    /// Appends a frame that was sent or received at `time`. Times never go back in the file. A
    /// signature is left out, and SETUP_SIGNING, which holds a key, never enters it.
    ///
    /// # Errors
    /// The sink cannot be written.
    pub fn frame(&mut self, raw: &[u8], time: SystemTime) -> io::Result<()> {
        if Header::of(raw).is_some_and(|header| header.id == dialect::SETUP_SIGNING_DATA::ID) {
            return Ok(());
        }
        let since = time.duration_since(UNIX_EPOCH).unwrap_or_default();
        self.last_us = self.last_us.max(since.as_micros() as u64);
        self.sink.write_all(&self.last_us.to_be_bytes())?;
        self.sink.write_all(&signing::strip(raw))
    }

    /// What it is written to.
    pub fn sink(&mut self) -> &mut W {
        &mut self.sink
    }

    /// Hands everything to the file.
    ///
    /// # Errors
    /// The sink cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}

/// A frame of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LogFrame<'a> {
    /// Where its stamp begins in the file.
    pub at: usize,
    /// When, µs since 1970.
    pub time_us: u64,
    /// The frame, byte for byte; `known` tells whether its checksum is that of a known message.
    pub packet: PacketRef<'a>,
}

/// What a log holds beside whole frames of known messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct LogCounts {
    /// Frames, good and bad.
    pub frames: u64,
    /// Frames of messages that the dialect lacks.
    pub unknown: u64,
    /// Frames of a known message whose checksum does not fit: damaged, or of another dialect.
    pub bad_crc: u64,
    /// Bytes that belong to no frame.
    pub skipped: u64,
    /// Bytes of a frame at the end that is cut off, as a crash leaves it.
    pub cut: u64,
}

/// Reads a log that lies in memory. An iterator; afterwards [`TlogReader::counts`].
#[derive(Debug, Clone)]
pub struct TlogReader<'a> {
    bytes: &'a [u8],
    at: usize,
    counts: LogCounts,
}

impl<'a> TlogReader<'a> {
    /// From the beginning.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, counts: LogCounts::default() }
    }

    /// What was read so far.
    #[must_use]
    pub fn counts(&self) -> LogCounts {
        self.counts
    }

    /// Stamp and frame at a place, if a frame may stand there.
    fn frame_at(&self, at: usize) -> Option<(u64, &'a [u8], Header)> {
        let rest = self.bytes.get(at..)?;
        let time = u64::from_be_bytes(*rest.first_chunk()?);
        let header = Header::of(&rest[STAMP..])?;
        Some((time, rest.get(STAMP..STAMP + header.whole)?, header))
    }

    /// Whether something that can follow a frame of this time stands there.
    fn goes_on(&self, at: usize, time: u64) -> bool {
        let rest = self.bytes.get(at..).unwrap_or_default();
        let Some(next) = rest.first_chunk().map(|stamp| u64::from_be_bytes(*stamp)) else {
            return rest.is_empty() || rest.len() < STAMP;
        };
        rest.get(STAMP).is_none_or(|magic| matches!(magic, 0xFD | 0xFE)) && next.abs_diff(time) < AGE
    }
}

/// Whether a frame's checksum fits; `None` if the message is not known.
fn fits(raw: &[u8], header: &Header) -> Option<bool> {
    let extra = crc_extra(header.id)?;
    let (checked, rest) = (&raw[1..header.checked], &raw[header.checked..]);
    Some(rest.starts_with(&checksum(checked, extra).to_le_bytes()))
}

impl<'a> Iterator for TlogReader<'a> {
    type Item = LogFrame<'a>;

    fn next(&mut self) -> Option<LogFrame<'a>> {
        let begin = self.at;
        while self.at < self.bytes.len() {
            let found = self.frame_at(self.at).filter(|(time, raw, header)| {
                fits(raw, header) == Some(true) || self.goes_on(self.at + STAMP + raw.len(), *time)
            });
            let Some((time_us, raw, header)) = found else {
                self.at += 1;
                continue;
            };
            let (at, fits) = (self.at, fits(raw, &header));
            self.counts.skipped += (at - begin) as u64;
            self.counts.frames += 1;
            self.counts.unknown += u64::from(fits.is_none());
            self.counts.bad_crc += u64::from(fits == Some(false));
            self.at += STAMP + raw.len();
            return Some(LogFrame {
                at,
                time_us,
                packet: PacketRef::new(raw, header.id, fits == Some(true)),
            });
        }
        let left = (self.at - begin) as u64;
        let rest = &self.bytes[begin.min(self.bytes.len())..];
        if self.counts.frames > 0 && rest.get(STAMP).is_none_or(|magic| matches!(magic, 0xFD | 0xFE)) {
            self.counts.cut += left;
        } else {
            self.counts.skipped += left;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_datagram_is_split_into_its_frames() {
        let mut datagram = Vec::new();
        let mut encoder = crate::link::encoder::Encoder::new(1, 1);
        for _ in 0..3 {
            encoder.push(&mut datagram, &dialect::HEARTBEAT_DATA::default());
        }
        let mut bytes = Vec::new();
        Tlog::new(&mut bytes).datagram(&datagram, UNIX_EPOCH).unwrap();
        assert_eq!(bytes.len(), datagram.len() + 3 * 8);
        let frame = datagram.len() / 3;
        assert_eq!(bytes[8..8 + frame], datagram[..frame]);
        assert_eq!(bytes[16 + frame..16 + 2 * frame], datagram[frame..2 * frame]);
    }

    /// A log of so many frames, a second apart, and the frames.
    fn log(count: u64) -> (Vec<u8>, Vec<Vec<u8>>) {
        let mut encoder = crate::link::encoder::Encoder::new(1, 1);
        let (mut bytes, mut frames) = (Vec::new(), Vec::new());
        let mut tlog = Tlog::new(&mut bytes);
        for k in 0..count {
            let mut frame = Vec::new();
            encoder.push(&mut frame, &dialect::HEARTBEAT_DATA { custom_mode: 7, ..Default::default() });
            tlog.frame(&frame, UNIX_EPOCH + Duration::from_secs(1_700_000_000 + k)).unwrap();
            frames.push(frame);
        }
        (bytes, frames)
    }

    fn read(bytes: &[u8]) -> (Vec<Vec<u8>>, LogCounts) {
        let mut reader = TlogReader::new(bytes);
        let frames = reader.by_ref().map(|frame| frame.packet.raw.to_vec()).collect();
        (frames, reader.counts())
    }

    #[test]
    fn a_frame_whose_checksum_fits_nothing_is_read_as_it_stands() {
        let (mut bytes, mut frames) = log(5);
        let one = bytes.len() / 5;
        bytes[one + 20] ^= 1;
        frames[1][12] ^= 1;
        let (found, counts) = read(&bytes);
        assert_eq!(found, frames);
        assert_eq!((counts.frames, counts.bad_crc, counts.skipped), (5, 1, 0));
    }

    #[test]
    fn stray_bytes_cost_no_frame() {
        let (bytes, frames) = log(6);
        let one = bytes.len() / 6;
        for junk in [&[0x55][..], &[0xFD; 3], b"this is no frame", &[0; 40]] {
            let spoilt = [&bytes[..2 * one], junk, &bytes[2 * one..]].concat();
            let (found, counts) = read(&spoilt);
            assert_eq!(found, frames, "{junk:?}");
            assert_eq!(counts.skipped, junk.len() as u64, "{junk:?}");
        }
    }

    #[test]
    fn an_end_that_is_cut_off_is_told() {
        let (bytes, frames) = log(4);
        for cut in 1..bytes.len() / 4 {
            let (found, counts) = read(&bytes[..bytes.len() - cut]);
            assert_eq!(found, frames[..3]);
            assert_eq!((counts.cut, counts.skipped), ((bytes.len() / 4 - cut) as u64, 0), "{cut}");
        }
    }

    #[test]
    fn a_frame_follows_its_time_and_time_never_goes_back() {
        let mut bytes = Vec::new();
        let mut tlog = Tlog::new(&mut bytes);
        tlog.frame(&[0xFD, 1], UNIX_EPOCH + Duration::from_micros(0x0102)).unwrap();
        tlog.frame(&[0xFD, 2], UNIX_EPOCH + Duration::from_micros(0x0101)).unwrap();
        let mut setup_signing = [0; 12];
        (setup_signing[0], setup_signing[8]) = (0xFD, 1);
        tlog.frame(&setup_signing, UNIX_EPOCH).unwrap();
        assert_eq!(bytes, [0, 0, 0, 0, 0, 0, 1, 2, 0xFD, 1, 0, 0, 0, 0, 0, 0, 1, 2, 0xFD, 2]);
    }

    proptest::proptest! {
        #[test]
        fn junk_never_panics_and_no_byte_is_lost_sight_of(
            junk in proptest::collection::vec(proptest::prelude::any::<u8>(), 0..300), at in 0usize..5
        ) {
            let (bytes, _) = log(4);
            let at = at * bytes.len() / 4;
            let spoilt = [&bytes[..at], &junk, &bytes[at..]].concat();
            let (found, counts) = read(&spoilt);
            let in_frames: usize = found.iter().map(|frame| STAMP + frame.len()).sum();
            proptest::prop_assert_eq!(in_frames as u64 + counts.skipped + counts.cut, spoilt.len() as u64);
        }
    }
}
