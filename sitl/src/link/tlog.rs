//! The telemetry log of ground stations: before each frame, the microseconds since 1970, 8 bytes,
//! most significant first. `mavlogdump.py` and every ground station read it.

use std::io::{self, Write};
use std::time::{SystemTime, UNIX_EPOCH};

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

    /// Appends a frame that was sent or received at `time`. Times never go back in the file.
    pub fn frame(&mut self, raw: &[u8], time: SystemTime) -> io::Result<()> {
        let since = time.duration_since(UNIX_EPOCH).unwrap_or_default();
        self.last_us = self.last_us.max(since.as_micros() as u64);
        self.sink.write_all(&self.last_us.to_be_bytes())?;
        self.sink.write_all(raw)
    }

    /// Hands everything to the file.
    pub fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_frame_follows_its_time_and_time_never_goes_back() {
        let mut bytes = Vec::new();
        let mut tlog = Tlog::new(&mut bytes);
        tlog.frame(&[0xFD, 1], UNIX_EPOCH + Duration::from_micros(0x0102)).unwrap();
        tlog.frame(&[0xFD, 2], UNIX_EPOCH + Duration::from_micros(0x0101)).unwrap();
        assert_eq!(bytes, [0, 0, 0, 0, 0, 0, 1, 2, 0xFD, 1, 0, 0, 0, 0, 0, 0, 1, 2, 0xFD, 2]);
    }
}
