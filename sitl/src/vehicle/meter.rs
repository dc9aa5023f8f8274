//! Traffic with all peers together, for LINK_NODE_STATUS. Knows bytes and frames, not peers.

use std::time::Duration;

use crate::link::sequence::SequenceTracker;
use crate::link::splitter::Counts;
use crate::link::{dialect, signing};

/// Over which rates are measured.
const WINDOW: Duration = Duration::from_secs(1);

/// What has gone through.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Meter {
    frames_sent: u64,
    bytes: Bytes,
    /// Frames that others sent and that did not come, by their sequence numbers.
    lost: u64,
    /// The beginning of the present window, and the bytes before it.
    since: (Duration, Bytes),
    /// Bytes a second in the last window.
    rate: Bytes,
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Bytes {
    sent: u64,
    received: u64,
}

impl Meter {
    /// A datagram goes out.
    pub fn sent(&mut self, datagram: &[u8]) {
        self.frames_sent += signing::frames(datagram).count() as u64;
        self.bytes.sent += datagram.len() as u64;
    }

    /// A datagram has come.
    pub fn received(&mut self, datagram: &[u8]) {
        self.bytes.received += datagram.len() as u64;
    }

    /// A frame has come: how many are missing before it, or that it was missing itself.
    pub fn numbered(&mut self, heard: SequenceTracker) {
        self.lost += heard.missing;
        self.lost = self.lost.saturating_sub(heard.late.into());
    }

    /// Closes the window if it is full.
    pub fn measure(&mut self, now: Duration) {
        let (begun, before) = self.since;
        let length = now.saturating_sub(begun);
        if length < WINDOW {
            return;
        }
        let rate = |now: u64, then: u64| ((now - then) as f64 / length.as_secs_f64()) as u64;
        self.rate = Bytes {
            sent: rate(self.bytes.sent, before.sent),
            received: rate(self.bytes.received, before.received),
        };
        self.since = (now, self.bytes);
    }

    /// LINK_NODE_STATUS. Buffers are the system's and not known here: 0 % used.
    pub fn status(&self, counts: &Counts, now: Duration) -> dialect::LINK_NODE_STATUS_DATA {
        let wide = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
        let bad = counts.bad_crc + counts.truncated + counts.incompatible;
        dialect::LINK_NODE_STATUS_DATA {
            timestamp: now.as_millis() as u64,
            tx_rate: wide(self.rate.sent),
            rx_rate: wide(self.rate.received),
            messages_sent: wide(self.frames_sent),
            messages_received: wide(counts.frames),
            messages_lost: wide(self.lost),
            rx_parse_err: u16::try_from(bad).unwrap_or(u16::MAX),
            ..Default::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_those_of_the_last_second() {
        let mut meter = Meter::default();
        meter.received(&[0; 3000]);
        meter.measure(Duration::from_millis(900));
        assert_eq!(meter.rate, Bytes::default());
        meter.measure(Duration::from_millis(1500));
        assert_eq!(meter.rate.received, 2000);
        meter.measure(Duration::from_millis(3000));
        assert_eq!(meter.rate.received, 0);
        assert_eq!(meter.status(&Counts::default(), Duration::ZERO).messages_sent, 0);
    }
}
