//! The telemetry log of ground stations: before each frame, the microseconds since 1970, 8 bytes,
//! most significant first. `mavlogdump.py` and every ground station read it.

use std::io::{self, Write};
use std::time::{SystemTime, UNIX_EPOCH};

use super::packet::Header;
use super::{MessageData, dialect, signing};

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
    /// The file cannot be written.
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
    /// The file cannot be written.
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
    /// The file cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
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
}
