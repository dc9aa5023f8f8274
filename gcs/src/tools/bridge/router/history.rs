//! Which frame is a copy: the last frames of each source, the links on which each was heard, and those to
//! which it went.
//!
//! The nth time that a link brings some bytes is a copy of the nth time that another brought them. A second
//! time on one link is one as well, but for a sender that never counts its frames on: all its heartbeats are
//! the same bytes.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hasher};
use std::time::Duration;

/// Frames of a source whose copies are recognised; below 256, at which sequence numbers come again.
const REMEMBERED: usize = 128;
/// Sources that are remembered; the one silent for longest makes room.
pub(super) const MAX_SOURCES: usize = 1024;

/// Links, as bits by their places. A link beyond the last place is in no set.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct LinkSet(u128);

impl LinkSet {
    /// Places for links.
    pub const PLACES: u8 = 128;

    /// The link at this place alone.
    pub fn of(place: Option<u8>) -> Self {
        Self(place.map_or(0, |place| 1 << place))
    }

    /// Both together.
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    fn holds(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// The first place that is free in it.
    pub fn free(self) -> Option<u8> {
        let place = self.0.trailing_ones() as u8;
        (place < Self::PLACES).then_some(place)
    }
}

/// What a frame is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CopyVerdict {
    /// It comes for the first time, and is to be passed on.
    New,
    /// It came before; whether it went out on the very link that brings it now.
    Copy { echo: bool },
}

/// A frame that was passed on.
#[derive(Debug, Clone, Copy, Default)]
struct Passed {
    came: Duration,
    heard: LinkSet,
    sent: LinkSet,
}

/// The last frames of a source. Fingerprints apart: every frame is compared with all of them.
#[derive(Debug, Clone, Default)]
struct Past {
    prints: Vec<u64>,
    passed: Vec<Passed>,
    next: usize,
    newest: Duration,
}

impl Past {
    fn copies(&self, print: u64, since: Duration) -> Vec<usize> {
        // Without an early end, so that several are compared at once.
        if !self.prints.iter().fold(false, |found, &seen| found | (seen == print)) {
            return Vec::new();
        }
        let fresh = |&at: &usize| self.prints[at] == print && self.passed[at].came > since;
        let mut found: Vec<usize> = (0..self.prints.len()).filter(fresh).collect();
        found.sort_by_key(|&at| self.passed[at].came);
        found
    }

    fn push(&mut self, print: u64, passed: Passed) {
        self.newest = passed.came;
        if self.prints.len() < REMEMBERED {
            self.next = self.prints.len();
            self.prints.push(print);
            self.passed.push(passed);
        } else {
            self.next = (self.next + 1) % REMEMBERED;
            (self.prints[self.next], self.passed[self.next]) = (print, passed);
        }
    }
}

/// Somebody whose frames are remembered: system and component, or `None` for all who have sent nothing that
/// could be checked.
pub(super) type SourceKey = Option<(u8, u8)>;

/// What has passed of late.
#[derive(Debug, Clone, Default)]
pub(super) struct History {
    sources: BTreeMap<SourceKey, Past>,
    /// The same frames in the bytes in which they went to links with numbers of their own.
    renumbered: BTreeMap<SourceKey, Past>,
}

impl History {
    /// Judges a frame that has come on `link`, and remembers it. `counts`: whether its sender numbers its
    /// frames, so that no two are alike.
    pub fn judge(
        &mut self,
        key: SourceKey,
        raw: &[u8],
        link: LinkSet,
        counts: bool,
        now: Duration,
        within: Duration,
    ) -> CopyVerdict {
        self.make_room(&key);
        let past = self.sources.entry(key).or_default();
        let print = fingerprint(0, raw);
        if !within.is_zero() {
            let copies = past.copies(print, now.saturating_sub(within));
            if let Some(&of) = copies.iter().find(|&&at| !past.passed[at].heard.holds(link)) {
                let passed = &mut past.passed[of];
                passed.heard = passed.heard.with(link);
                return CopyVerdict::Copy { echo: passed.sent.holds(link) };
            }
            if counts && !copies.is_empty() {
                return CopyVerdict::Copy { echo: false };
            }
        }
        past.push(print, Passed { came: now, heard: link, sent: LinkSet::default() });
        CopyVerdict::New
    }

    /// The newest frame of a source went to these links.
    pub fn sent(&mut self, key: SourceKey, to: LinkSet) {
        if let Some(past) = self.sources.get_mut(&key)
            && let Some(passed) = past.passed.get_mut(past.next)
        {
            passed.sent = to;
        }
    }

    /// A frame of a source went to a link in other bytes than it came.
    pub fn sent_as(&mut self, key: SourceKey, raw: &[u8], now: Duration) {
        if self.sources.contains_key(&key) {
            let past = self.renumbered.entry(key).or_default();
            past.push(fingerprint(0, raw), Passed { came: now, ..Passed::default() });
        }
    }

    /// Whether these bytes were sent so of late.
    pub fn was_sent_as(&self, key: SourceKey, raw: &[u8], now: Duration, within: Duration) -> bool {
        let past = self.renumbered.get(&key);
        past.is_some_and(|past| !past.copies(fingerprint(0, raw), now.saturating_sub(within)).is_empty())
    }

    /// How many sources are remembered.
    #[cfg(test)]
    pub fn sources(&self) -> usize {
        self.sources.len()
    }

    fn make_room(&mut self, key: &SourceKey) {
        if self.sources.len() >= MAX_SOURCES
            && !self.sources.contains_key(key)
            && let Some(oldest) = self.sources.iter().min_by_key(|(_, past)| past.newest).map(|(k, _)| *k)
        {
            self.sources.remove(&oldest);
            self.renumbered.remove(&oldest);
        }
    }
}

/// What tells a frame from others. Nobody gains by unequal ones that collide: a forger could simply send
/// a frame of his own.
pub(super) fn fingerprint(salt: u64, raw: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    hasher.write_u64(salt);
    hasher.write(raw);
    hasher.finish()
}
