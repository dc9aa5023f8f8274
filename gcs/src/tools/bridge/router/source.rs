//! Somebody who sends on a link: when it was heard, how it counts, what of it got lost.

use std::time::Duration;

use crpl_sitl::link::sequence::Sequence;

/// Frames in a row with one number after which their sender does not count.
const STILL: u8 = 4;
/// So many numbers after a sender's newest, a frame may be its next.
const NEXT: u8 = 8;

/// Somebody who sends on a link.
#[derive(Debug, Clone)]
pub struct Source {
    pub heard: Duration,
    pub sequence: Sequence,
    pub number: u8,
    /// Frames in a row with this number, and whether another number came before.
    pub still: u8,
    pub moved: bool,
    /// Frames of it that never came.
    pub lost: u64,
}

impl Source {
    pub fn new(now: Duration) -> Self {
        Self { heard: now, sequence: Sequence::default(), number: 0, still: 0, moved: false, lost: 0 }
    }

    /// Whether it counts its frames on, so that the same bytes twice are a copy.
    pub fn counts(&self) -> bool {
        self.moved && self.still < STILL
    }

    /// Whether a frame with this number may be the next one, even if some got lost.
    pub fn precedes(&self, number: u8) -> bool {
        (1..=NEXT).contains(&number.wrapping_sub(self.number))
    }

    pub fn numbered(&mut self, number: u8) {
        let same = self.still > 0 && number == self.number;
        self.moved |= self.still > 0 && !same;
        self.still = if same { self.still.saturating_add(1) } else { 1 };
        self.number = number;
    }
}
