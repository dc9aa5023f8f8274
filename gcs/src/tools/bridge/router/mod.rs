//! Which frame goes where. Bytes of a link in, datagrams of links out; no socket, no clock.
//!
//! The rules, for a frame of system S and component C that comes in on link L:
//!
//! 1. It never goes back to L, nor to a link on which S/C itself was heard a moment ago: no loops. A copy
//!    tells where S/C lives, too (`history.rs`).
//! 2. The same bytes a second time, on any link, are dropped: redundant paths give one copy.
//! 3. A message without target, or for system 0, goes to every other link.
//! 4. One for a system goes where that component was heard; if it was heard nowhere, where its system
//!    was; if that was not heard either, nowhere.
//! 5. SETUP_SIGNING holds a key and is never passed on.
//! 6. While a flight controls the vehicle, setpoints from other links are not forwarded
//!    ([`Router::take_control`]).
//!
//! Frames leave byte for byte as they came, so unknown messages, both versions and signatures pass. The one
//! exception is asked for by a link's rules: sequence numbers without the gaps that rule 4 makes (`numbers.rs`).
//! What one link sends in a burst leaves in as few datagrams as it fits in; frames that came in one
//! datagram are not parted if one datagram holds them.

mod control;
mod history;
mod link;
mod numbers;
mod outbox;
mod reach;
mod round_trip;
pub mod rules;
mod source;

use std::collections::BTreeMap;
use std::time::Duration;

use crpl_sitl::link::packet::PacketRef;
use crpl_sitl::link::splitter::Splitter;

use super::counters::Counters;
use history::{CopyVerdict, History, LinkSet};
use link::{Link, SentAs};
use numbers::Numbers;
use outbox::Outbox;
use round_trip::Asked;
use rules::{Budget, LinkRules};
use source::Source;

/// A peer of the bridge: one socket, one TCP connection, or one of the peers of a listening socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkId(pub u32);

/// After this time the same bytes are no copy, unless [`Router::copies_within`] says another: paths over
/// mobile networks are seconds slow at times.
pub const COPY_WITHIN: Duration = Duration::from_secs(10);

/// Messages that the router treats by their id.
mod id {
    pub const SET_MODE: u32 = 11;
    pub const MANUAL_CONTROL: u32 = 69;
    pub const RC_CHANNELS_OVERRIDE: u32 = 70;
    pub const SET_ATTITUDE_TARGET: u32 = 82;
    pub const SET_POSITION_TARGET_LOCAL_NED: u32 = 84;
    pub const SET_POSITION_TARGET_GLOBAL_INT: u32 = 86;
    pub const SETUP_SIGNING: u32 = 256;
}

/// What the router has to tell those who run it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Notice {
    /// A system and component was heard on a link for the first time.
    Found(LinkId, u8, u8),
    /// A setpoint from this link was not forwarded, the first since [`Router::take_control`].
    SetpointSuppressed(LinkId),
    /// Somebody on this link changes the vehicle's mode.
    ModeChange(LinkId),
}

/// A MAVLink router.
#[derive(Debug)]
pub struct Router {
    links: BTreeMap<LinkId, Link>,
    /// What links that are gone have carried, by their names.
    closed: BTreeMap<String, Counters>,
    history: History,
    copies_within: Duration,
    /// Two routers of a ring must not withhold the same frames.
    salt: u64,
    next_link: u32,
    next_group: u64,
    pending: Vec<(Asked, LinkId, Duration)>,
    /// The controlled system, and the link that controls it.
    control: Option<(u8, LinkId)>,
    /// The system that was controlled last.
    vehicle: Option<u8>,
    suppressed_setpoints: u64,
    /// Commands from other links that would change the controlled vehicle's mode, until they are answered.
    mode_asked: Vec<(u16, LinkId)>,
    notices: Vec<Notice>,
    signing_kept: u64,
}

impl Default for Router {
    fn default() -> Self {
        Self {
            links: BTreeMap::new(),
            closed: BTreeMap::new(),
            history: History::default(),
            copies_within: COPY_WITHIN,
            salt: 0,
            next_link: 0,
            next_group: 0,
            pending: Vec::new(),
            control: None,
            vehicle: None,
            suppressed_setpoints: 0,
            mode_asked: Vec::new(),
            notices: Vec::new(),
            signing_kept: 0,
        }
    }
}

impl Router {
    /// A router beside others in a ring, each of which has another `salt`.
    #[must_use]
    pub fn salted(salt: u64) -> Self {
        Self { salt, ..Self::default() }
    }

    /// A link that has heard nothing yet.
    pub fn add(&mut self, name: String) -> LinkId {
        self.add_with(name, LinkRules::default())
    }

    /// A link with rules of its own. One whose name is taken gets a number behind it; one whose name was that
    /// of a link that is gone counts on.
    pub fn add_with(&mut self, name: String, rules: LinkRules) -> LinkId {
        let id = LinkId(self.next_link);
        self.next_link += 1;
        let name = self.unique(name);
        let counters = self.closed.remove(&name).unwrap_or_default();
        let taken = self.links.values().fold(LinkSet::default(), |set, l| set.with(LinkSet::of(l.place)));
        let link = Link {
            name,
            rules,
            place: taken.free(),
            splitter: Splitter::default(),
            earlier: counters.frames,
            sources: BTreeMap::new(),
            doubts: BTreeMap::new(),
            out: Outbox::default(),
            budget: Budget::default(),
            numbers: Numbers::default(),
            counters,
        };
        self.links.insert(id, link);
        id
    }

    fn unique(&self, name: String) -> String {
        let taken = |name: &str| self.links.values().any(|link| link.name == name);
        let mut unique = name.clone();
        for number in 2_u32.. {
            if !taken(&unique) {
                break;
            }
            unique = format!("{name} #{number}");
        }
        unique
    }

    /// Forgets a link and everybody behind it, but not what it has carried: peers of one listening endpoint
    /// are counted together once they are gone.
    pub fn remove(&mut self, id: LinkId) {
        let Some(link) = self.links.remove(&id) else { return };
        let name = match link.name.split_once(" < ") {
            Some((endpoint, _)) => format!("{endpoint} < closed"),
            None => link.name,
        };
        self.closed.entry(name).or_default().merge(&link.counters);
    }

    /// For how long the same bytes are copies, [`COPY_WITHIN`] if nothing is said; zero passes all on.
    pub fn copies_within(&mut self, within: Duration) {
        self.copies_within = within;
    }

    /// What has happened since the last call.
    pub fn notices(&mut self) -> Vec<Notice> {
        std::mem::take(&mut self.notices)
    }

    /// Bytes have come in on `from`. Calls `seen` with each frame that is passed on, for a log.
    pub fn receive(&mut self, from: LinkId, bytes: &[u8], now: Duration, mut seen: impl FnMut(&[u8])) {
        let Some(link) = self.links.get_mut(&from) else { return };
        link.counters.received_bytes += bytes.len() as u64;
        let mut splitter = std::mem::take(&mut link.splitter);
        self.next_group += 1;
        splitter.split(bytes, |frame| {
            if self.route(from, &frame, now) {
                seen(frame.raw);
            }
        });
        if let Some(link) = self.links.get_mut(&from) {
            link.counters.frames = link.earlier.plus(splitter.counts());
            link.splitter = splitter;
        }
    }

    /// Passes a frame on; whether it was no copy and may be logged.
    fn route(&mut self, from: LinkId, frame: &PacketRef<'_>, now: Duration) -> bool {
        if !self.accepts(from, frame) || !self.is_new(from, frame, now) {
            return false;
        }
        let is_key = frame.id == id::SETUP_SIGNING;
        self.signing_kept += u64::from(is_key);
        if is_key || self.suppresses_setpoint(from, frame) {
            self.send(from, frame, &[], now);
            return false;
        }
        self.time(from, frame, now);
        let mut targets = self.targets(from, frame, now);
        self.withhold(&mut targets, frame);
        self.send(from, frame, &targets, now);
        true
    }

    /// Sends a frame to these links, and to no other.
    fn send(&mut self, from: LinkId, frame: &PacketRef<'_>, targets: &[LinkId], now: Duration) {
        let (key, group) = (self.key(frame), self.next_group);
        let (mut sent, mut others) = (LinkSet::default(), Vec::new());
        for (id, link) in self.links.iter_mut().filter(|(id, _)| **id != from) {
            if !targets.contains(id) {
                if link.rules.renumber {
                    link.numbers.withhold(frame);
                }
                continue;
            }
            let Some(SentAs(other)) = link.offer(frame, group, now) else { continue };
            sent = sent.with(LinkSet::of(link.place));
            others.extend(other);
        }
        self.history.sent(key, sent);
        for raw in others {
            self.history.sent_as(key, &raw, now);
        }
    }

    /// Whether the link's filter lets a frame in.
    fn accepts(&mut self, from: LinkId, frame: &PacketRef<'_>) -> bool {
        let Some(link) = self.links.get_mut(&from) else { return false };
        let accepts = link.rules.accepts(frame.id);
        link.counters.filtered += u64::from(!accepts);
        accepts
    }

    /// Under what name the frames of a sender are remembered: what could not be checked may be junk.
    fn key(&self, frame: &PacketRef<'_>) -> history::SourceKey {
        let source = (frame.system, frame.component);
        let known = frame.known || self.links.values().any(|link| link.sources.contains_key(&source));
        known.then_some(source)
    }

    /// Counts a frame and learns where its sender lives, of a copy, too. Whether it is none.
    fn is_new(&mut self, from: LinkId, frame: &PacketRef<'_>, now: Duration) -> bool {
        let source = (frame.system, frame.component);
        let key = self.key(frame);
        let Some(link) = self.links.get_mut(&from) else { return false };
        // The first frames of a sender tell nothing about how it counts.
        let counts = key.is_none() || link.sources.get(&source).is_some_and(Source::counts);
        let place = LinkSet::of(link.place);
        let verdict = self.history.judge(key, frame.raw, place, counts, now, self.copies_within);
        link.counters.last_heard = Some(now);
        link.counters.duplicates += u64::from(verdict != CopyVerdict::New);
        // What comes back by a ring with the number that it had on another link does not follow its sender's newest
        // frame. A frame that does may have the bytes of an older one by chance: heartbeats are all alike.
        let follows = link.sources.get(&source).is_some_and(|known| known.precedes(frame.sequence));
        if !follows && self.history.was_sent_as(key, frame.raw, now, self.copies_within) {
            link.counters.duplicates += u64::from(verdict == CopyVerdict::New);
            return false;
        }
        let knows = link.sources.contains_key(&source);
        if verdict == (CopyVerdict::Copy { echo: true }) && !knows {
            link.doubt(source, now);
        } else if frame.known || (knows && verdict == CopyVerdict::New) {
            let (entry, new) = link.source(source, now);
            entry.heard = now;
            entry.numbered(frame.sequence);
            let heard = entry.sequence.next(frame.sequence);
            entry.lost = (entry.lost + heard.missing).saturating_sub(u64::from(heard.late));
            link.counters.numbered(heard);
            if new {
                self.notices.push(Notice::Found(from, source.0, source.1));
            }
        }
        verdict == CopyVerdict::New
    }

    /// Hands out everything that is to be sent: datagrams that fit a network's packets. `send` gives whether
    /// it was sent; only then it counts so.
    pub fn flush(&mut self, mut send: impl FnMut(LinkId, &[u8]) -> bool) {
        for (&id, Link { out, counters, .. }) in &mut self.links {
            let mut begin = (0, 0);
            for end in out.ends.drain(..).chain([(out.bytes.len(), out.frames)]) {
                if end.0 == begin.0 {
                    continue;
                }
                if send(id, &out.bytes[begin.0..end.0]) {
                    counters.sent_frames += end.1 - begin.1;
                    counters.sent_bytes += (end.0 - begin.0) as u64;
                } else {
                    counters.send_errors += 1;
                }
                begin = end;
            }
            out.bytes.clear();
            out.frames = 0;
        }
    }

    /// Frames of a link were refused for their signatures.
    pub fn refused(&mut self, id: LinkId, frames: u64) {
        if let Some(link) = self.links.get_mut(&id) {
            link.counters.refused += frames;
        }
    }

    /// A datagram that counts as sent could not be sent after all.
    pub fn not_sent(&mut self, id: LinkId, datagram: &[u8]) {
        let mut frames = 0;
        Splitter::default().split(datagram, |_| frames += 1);
        if let Some(link) = self.links.get_mut(&id) {
            link.counters.send_errors += 1;
            link.counters.sent_frames = link.counters.sent_frames.saturating_sub(frames);
            link.counters.sent_bytes = link.counters.sent_bytes.saturating_sub(datagram.len() as u64);
        }
    }

    /// A link's endpoint and peer.
    #[must_use]
    pub fn name(&self, id: LinkId) -> &str {
        self.links.get(&id).map_or("a link that is gone", |link| link.name.as_str())
    }

    /// Name, systems heard, and counters of each link.
    pub fn links(&self) -> impl Iterator<Item = (&str, Vec<(u8, u8)>, &Counters)> {
        self.links
            .values()
            .map(|link| (link.name.as_str(), link.sources.keys().copied().collect(), &link.counters))
    }

    /// Name and counters of the links that are gone.
    pub fn closed(&self) -> impl Iterator<Item = (&str, &Counters)> {
        self.closed.iter().map(|(name, counters)| (name.as_str(), counters))
    }

    /// SETUP_SIGNING messages that were not passed on.
    #[must_use]
    pub fn signing_kept(&self) -> u64 {
        self.signing_kept
    }

    /// Counters of a link.
    #[must_use]
    pub fn counters(&self, id: LinkId) -> Option<&Counters> {
        self.links.get(&id).map(|link| &link.counters)
    }
}

#[cfg(test)]
mod ring_tests;
#[cfg(test)]
mod tests;
