//! A link of the router: who was heard on it, whether its rules let a frame out, what waits to be sent.

use std::collections::BTreeMap;
use std::time::Duration;

use crpl_sitl::link::packet::PacketRef;
use crpl_sitl::link::splitter::{Counts, Splitter};

use super::super::counters::Counters;
use super::history::MAX_SOURCES;
use super::numbers::Numbers;
use super::outbox::Outbox;
use super::rules::{Budget, LinkRules};
use super::source::Source;

/// A source that was not heard on a link for this long may have moved away from it.
const LIVES_HERE: Duration = Duration::from_secs(5);
/// A link that brings a copy of what it was sent is either the way to its sender or a ring. So many frames,
/// the next and then every other one, are withheld from it: one that comes all the same tells that its sender lives there.
const WITHHELD: u8 = 12;
/// An echo is asked about again after this time.
const DOUBT_AGAIN: Duration = Duration::from_secs(60);

/// Whether a sender lives on a link, or only its frames go round.
#[derive(Debug, Clone, Copy)]
pub struct Doubt {
    pub asked: Duration,
    pub withheld: u8,
}

#[derive(Debug)]
pub struct Link {
    pub name: String,
    pub rules: LinkRules,
    pub place: Option<u8>,
    pub splitter: Splitter,
    /// What came on an earlier connection of this name.
    pub earlier: Counts,
    pub sources: BTreeMap<(u8, u8), Source>,
    /// Senders whose copies came of what was sent here.
    pub doubts: BTreeMap<(u8, u8), Doubt>,
    pub out: Outbox,
    pub budget: Budget,
    pub numbers: Numbers,
    pub counters: Counters,
}

impl Link {
    /// Whether a source was heard here of late: its frames have no business here.
    pub fn is_home_of(&self, source: (u8, u8), now: Duration) -> bool {
        self.sources.get(&source).is_some_and(|s| now.saturating_sub(s.heard) < LIVES_HERE)
    }

    /// Whether it is still in doubt.
    pub fn is_doubted(&self, source: (u8, u8)) -> bool {
        self.doubts.get(&source).is_some_and(|doubt| doubt.withheld < WITHHELD)
    }

    /// Sends, unless the link's filter or rate is against it; in which bytes, if the link has numbers of its own.
    pub fn offer(&mut self, frame: &PacketRef<'_>, group: u64, now: Duration) -> Option<SentAs> {
        let allowed = self.allows(frame, now);
        if !self.rules.renumber {
            return allowed.then(|| self.push(frame.raw, None, group));
        }
        if !allowed {
            self.numbers.withhold(frame);
            return None;
        }
        let renumbered = self.numbers.renumbered(frame);
        Some(self.push(frame.raw, renumbered, group))
    }

    fn push(&mut self, raw: &[u8], renumbered: Option<Vec<u8>>, group: u64) -> SentAs {
        self.out.push(renumbered.as_deref().unwrap_or(raw), group);
        SentAs(renumbered)
    }

    /// Whether the link's filter and rate let a frame out.
    fn allows(&mut self, frame: &PacketRef<'_>, now: Duration) -> bool {
        if !self.rules.sends(frame.id) {
            self.counters.filtered += 1;
            return false;
        }
        if self.rules.rate.is_some_and(|rate| !self.budget.takes(rate, frame, now)) {
            self.counters.limited += 1;
            return false;
        }
        true
    }

    /// A copy has come that went out here before: its sender may live here.
    pub fn doubt(&mut self, source: (u8, u8), now: Duration) {
        if self.doubts.len() >= MAX_SOURCES {
            self.doubts.clear();
        }
        let doubt = self.doubts.entry(source).or_insert(Doubt { asked: now, withheld: 0 });
        if now.saturating_sub(doubt.asked) > DOUBT_AGAIN {
            *doubt = Doubt { asked: now, withheld: 0 };
        }
    }

    /// The entry of a sender; whether it is new. The one silent for longest makes room.
    pub fn source(&mut self, key: (u8, u8), now: Duration) -> (&mut Source, bool) {
        let new = !self.sources.contains_key(&key);
        if new
            && self.sources.len() >= MAX_SOURCES
            && let Some(oldest) = self.sources.iter().min_by_key(|(_, s)| s.heard).map(|(k, _)| *k)
        {
            self.sources.remove(&oldest);
        }
        self.doubts.remove(&key);
        (self.sources.entry(key).or_insert_with(|| Source::new(now)), new)
    }
}

/// The bytes in which a frame was sent, if they are others than those in which it came.
pub struct SentAs(pub Option<Vec<u8>>);
