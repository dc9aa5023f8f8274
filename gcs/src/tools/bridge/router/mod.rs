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

mod history;
mod numbers;
pub mod rules;

use std::collections::BTreeMap;
use std::time::Duration;

use crpl_sitl::link::encoder::DATAGRAM;
use crpl_sitl::link::messages::command::CommandAck;
use crpl_sitl::link::messages::service::{Ping, Timesync};
use crpl_sitl::link::messages::{Target, View};
use crpl_sitl::link::packet::PacketRef;
use crpl_sitl::link::sequence::Sequence;
use crpl_sitl::link::splitter::{Counts, Splitter};
use crpl_sitl::link::wire;

use super::counters::Counters;
use history::{CopyVerdict, History, LinkSet, MAX_SOURCES};
use numbers::Numbers;
use rules::{Budget, LinkRules};

/// A peer of the bridge: one socket, one TCP connection, or one of the peers of a listening socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkId(pub u32);

/// After this time the same bytes are no copy, unless [`Router::copies_within`] says another: paths over
/// mobile networks are seconds slow at times.
pub const COPY_WITHIN: Duration = Duration::from_secs(10);
/// A source that was not heard on a link for this long may have moved away from it.
const LIVES_HERE: Duration = Duration::from_secs(5);
/// A link that brings a copy of what it was sent is either the way to its sender or a ring. So many frames,
/// the next and then every other one, are withheld from it: one that comes all the same tells that its sender lives there.
const WITHHELD: u8 = 12;
/// An echo is asked about again after this time.
const DOUBT_AGAIN: Duration = Duration::from_secs(60);
/// Frames in a row with one number after which their sender does not count.
const STILL: u8 = 4;
/// So many numbers after a sender's newest, a frame may be its next.
const NEXT: u8 = 8;
/// Requests whose answers are waited for, to time them.
const PENDING: usize = 64;

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

/// Somebody who sends on a link.
#[derive(Debug, Clone)]
struct Source {
    heard: Duration,
    sequence: Sequence,
    number: u8,
    /// Frames in a row with this number, and whether another number came before.
    still: u8,
    moved: bool,
    /// Frames of it that never came.
    lost: u64,
}

impl Source {
    fn new(now: Duration) -> Self {
        Self { heard: now, sequence: Sequence::default(), number: 0, still: 0, moved: false, lost: 0 }
    }

    /// Whether it counts its frames on, so that the same bytes twice are a copy.
    fn counts(&self) -> bool {
        self.moved && self.still < STILL
    }

    /// Whether a frame with this number may be the next one, even if some got lost.
    fn precedes(&self, number: u8) -> bool {
        (1..=NEXT).contains(&number.wrapping_sub(self.number))
    }

    fn numbered(&mut self, number: u8) {
        let same = self.still > 0 && number == self.number;
        self.moved |= self.still > 0 && !same;
        self.still = if same { self.still.saturating_add(1) } else { 1 };
        self.number = number;
    }
}

/// Bytes on their way out.
#[derive(Debug, Default)]
struct Outbox {
    bytes: Vec<u8>,
    /// Where datagrams end, but for the last: after how many bytes and frames.
    ends: Vec<(usize, u64)>,
    /// The datagram being routed, and where its frames begin: after how many bytes and frames.
    group: (u64, usize, u64),
    frames: u64,
}

impl Outbox {
    fn push(&mut self, frame: &[u8], group: u64) {
        let begin = self.ends.last().map_or(0, |end| end.0);
        if self.group.0 != group {
            self.group = (group, self.bytes.len(), self.frames);
        }
        let all = (self.bytes.len(), self.frames);
        if all.0 - begin + frame.len() > DATAGRAM && all.0 > begin {
            // Moves the whole group into the next datagram, if it is not this datagram already.
            let end = if self.group.1 > begin { (self.group.1, self.group.2) } else { all };
            self.ends.push(end);
            // The group may be too long for a datagram of its own.
            if all.0 - end.0 + frame.len() > DATAGRAM && all.0 > end.0 {
                self.ends.push(all);
            }
        }
        self.bytes.extend_from_slice(frame);
        self.frames += 1;
    }
}

/// Whether a sender lives on a link, or only its frames go round.
#[derive(Debug, Clone, Copy)]
struct Doubt {
    asked: Duration,
    withheld: u8,
}

#[derive(Debug)]
struct Link {
    name: String,
    rules: LinkRules,
    place: Option<u8>,
    splitter: Splitter,
    /// What came on an earlier connection of this name.
    earlier: Counts,
    sources: BTreeMap<(u8, u8), Source>,
    /// Senders whose copies came of what was sent here.
    doubts: BTreeMap<(u8, u8), Doubt>,
    out: Outbox,
    budget: Budget,
    numbers: Numbers,
    counters: Counters,
}

impl Link {
    /// Whether a source was heard here of late: its frames have no business here.
    fn is_home_of(&self, source: (u8, u8), now: Duration) -> bool {
        self.sources.get(&source).is_some_and(|s| now.saturating_sub(s.heard) < LIVES_HERE)
    }

    /// Whether it is still in doubt.
    fn is_doubted(&self, source: (u8, u8)) -> bool {
        self.doubts.get(&source).is_some_and(|doubt| doubt.withheld < WITHHELD)
    }

    /// Sends, unless the link's filter or rate is against it; in which bytes, if the link has numbers of its own.
    fn offer(&mut self, frame: &PacketRef<'_>, group: u64, now: Duration) -> Option<SentAs> {
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
    fn doubt(&mut self, source: (u8, u8), now: Duration) {
        if self.doubts.len() >= MAX_SOURCES {
            self.doubts.clear();
        }
        let doubt = self.doubts.entry(source).or_insert(Doubt { asked: now, withheld: 0 });
        if now.saturating_sub(doubt.asked) > DOUBT_AGAIN {
            *doubt = Doubt { asked: now, withheld: 0 };
        }
    }

    /// The entry of a sender; whether it is new. The one silent for longest makes room.
    fn source(&mut self, key: (u8, u8), now: Duration) -> (&mut Source, bool) {
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
struct SentAs(Option<Vec<u8>>);

/// A request whose answer will tell a link's round trip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Asked {
    /// TIMESYNC or PING, by message and its time stamp.
    Time(u32, u64),
    /// A command for a system.
    Command(u16, u8),
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

    /// From now on only `by` sends setpoints to system `vehicle`; `None` ends that.
    pub fn take_control(&mut self, control: Option<(u8, LinkId)>) {
        self.vehicle = control.map(|(vehicle, _)| vehicle).or(self.vehicle);
        self.control = control;
        self.suppressed_setpoints = 0;
        self.mode_asked.clear();
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

    /// The links to which a frame goes.
    fn targets(&self, from: LinkId, frame: &PacketRef<'_>, now: Duration) -> Vec<LinkId> {
        let source = (frame.system, frame.component);
        let Target { system, component } = frame.target();
        let reach = if system == 0 { Reach::All } else { self.reach(system, component) };
        let wanted = |link: &Link| match reach {
            Reach::All => true,
            Reach::System => link.sources.keys().any(|&(s, _)| s == system),
            Reach::Component => link.sources.contains_key(&(system, component)),
        };
        let rules = self.links.get(&from).map(|link| &link.rules);
        let goes = |link: &Link| {
            if rules.is_some_and(|rules| rules.joins(&link.rules)) {
                return false;
            }
            let one_of = |holds: &dyn Fn(&Link) -> bool| {
                let mut joined = self.links.values().filter(|l| l.rules.joins(&link.rules));
                holds(link) || link.rules.group.is_some() && joined.any(holds)
            };
            one_of(&wanted) && !one_of(&|l| l.is_home_of(source, now))
        };
        self.links.iter().filter(|&(&id, link)| id != from && goes(link)).map(|(&id, _)| id).collect()
    }

    /// Every other frame goes to no link on which its sender may live, as long as it goes anywhere.
    fn withhold(&mut self, targets: &mut Vec<LinkId>, frame: &PacketRef<'_>) {
        let source = (frame.system, frame.component);
        let certain = |id: &LinkId| self.links.get(id).is_some_and(|link| !link.is_doubted(source));
        if !targets.iter().all(certain)
            && targets.iter().any(certain)
            && (self.is_fresh_doubt(targets, source) || history::fingerprint(self.salt, frame.raw) & 1 == 1)
        {
            targets.retain(certain);
            let doubts = self.links.values_mut().filter_map(|link| link.doubts.get_mut(&source));
            doubts.for_each(|doubt| doubt.withheld = doubt.withheld.saturating_add(1));
        }
    }

    /// Whether one of these links is in doubt of late: the next frame is withheld at once.
    fn is_fresh_doubt(&self, targets: &[LinkId], source: (u8, u8)) -> bool {
        let mut doubts = targets.iter().filter_map(|id| self.links.get(id)?.doubts.get(&source));
        doubts.any(|doubt| doubt.withheld == 0)
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

    fn reach(&self, system: u8, component: u8) -> Reach {
        let known =
            component != 0 && self.links.values().any(|link| link.sources.contains_key(&(system, component)));
        if known { Reach::Component } else { Reach::System }
    }

    /// Whether this packet is a setpoint that the flight in control suppresses.
    fn suppresses_setpoint(&mut self, from: LinkId, frame: &PacketRef<'_>) -> bool {
        let Some((vehicle, pilot)) = self.control else { return false };
        let Target { system, .. } = frame.target();
        if let Some(ack) = CommandAck::of(*frame).filter(|_| frame.system == vehicle) {
            self.mode_answered(&ack);
        }
        if from == pilot || (system != vehicle && system != 0) {
            return false;
        }
        if let Some(command) = mode_command(frame) {
            self.mode_asked.retain(|&(other, _)| other != command);
            self.mode_asked.push((command, from));
            return false;
        }
        let flies = matches!(
            frame.id,
            id::SET_POSITION_TARGET_LOCAL_NED
                | id::SET_POSITION_TARGET_GLOBAL_INT
                | id::SET_ATTITUDE_TARGET
                | id::MANUAL_CONTROL
                | id::RC_CHANNELS_OVERRIDE
        );
        if flies {
            if self.suppressed_setpoints == 0 {
                self.notices.push(Notice::SetpointSuppressed(from));
            }
            self.suppressed_setpoints += 1;
        }
        flies
    }

    /// An operator's mode change counts once the vehicle has accepted it.
    fn mode_answered(&mut self, ack: &CommandAck) {
        const ACCEPTED: u8 = 0;
        const IN_PROGRESS: u8 = 5;
        let Some(at) = self.mode_asked.iter().position(|&(asked, _)| asked == ack.command) else { return };
        let (_, by) = self.mode_asked.swap_remove(at);
        if matches!(ack.result, ACCEPTED | IN_PROGRESS) {
            self.notices.push(Notice::ModeChange(by));
        }
    }

    /// Times requests and their answers: what a link and those behind it take for a round trip.
    fn time(&mut self, from: LinkId, frame: &PacketRef<'_>, now: Duration) {
        let (asked, is_request) = if let Some(sync) = Timesync::of(*frame) {
            (Asked::Time(frame.id, sync.ts1 as u64), sync.tc1 == 0)
        } else if let Some(ping) = Ping::of(*frame) {
            // A request asks everybody, an answer names the asker.
            (Asked::Time(frame.id, ping.time_usec), ping.target == Target::default())
        } else if let Some(ask) = wire::ask_of(*frame) {
            (Asked::Command(ask.command, ask.target.system), true)
        } else if let Some(ack) = CommandAck::of(*frame) {
            (Asked::Command(ack.command, frame.system), false)
        } else {
            return;
        };
        if is_request {
            self.pending.retain(|(other, ..)| *other != asked);
            if self.pending.len() == PENDING {
                self.pending.remove(0);
            }
            self.pending.push((asked, from, now));
        } else if let Some(at) = self.pending.iter().position(|&(other, by, _)| other == asked && by != from)
        {
            let (_, _, since) = self.pending.swap_remove(at);
            if let Some(link) = self.links.get_mut(&from) {
                link.counters.round_trip.add(now.saturating_sub(since));
            }
        }
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

    /// Setpoints suppressed since [`Router::take_control`].
    #[must_use]
    pub fn suppressed_setpoints(&self) -> u64 {
        self.suppressed_setpoints
    }

    /// Frames of the controlled vehicle that never came: gaps of other stations are none of the flight's.
    #[must_use]
    pub fn vehicle_lost(&self) -> u64 {
        let sources = self.links.values().flat_map(|link| &link.sources);
        sources.filter(|((system, _), _)| Some(*system) == self.vehicle).map(|(_, source)| source.lost).sum()
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

/// How far a message goes.
#[derive(Debug, Clone, Copy)]
enum Reach {
    All,
    System,
    Component,
}

/// The command with which a frame takes the vehicle out of the mode in which it is flown from here:
/// a mode, a way home, down or up, a place, a mission, or its motors off.
fn mode_command(frame: &PacketRef<'_>) -> Option<u16> {
    const NAV_RETURN_TO_LAUNCH: u16 = 20;
    const NAV_LAND: u16 = 21;
    const NAV_TAKEOFF: u16 = 22;
    const DO_SET_MODE: u16 = 176;
    const DO_REPOSITION: u16 = 192;
    const DO_PAUSE_CONTINUE: u16 = 193;
    const MISSION_START: u16 = 300;
    const COMPONENT_ARM_DISARM: u16 = 400;
    const COMMANDS: [u16; 7] = [
        NAV_RETURN_TO_LAUNCH,
        NAV_LAND,
        NAV_TAKEOFF,
        DO_SET_MODE,
        DO_REPOSITION,
        DO_PAUSE_CONTINUE,
        MISSION_START,
    ];
    // Some vehicles answer the old message as they answer the command.
    if frame.id == id::SET_MODE {
        return Some(DO_SET_MODE);
    }
    let wire::Ask { command, params: [first, ..], .. } = wire::ask_of(*frame)?;
    let disarms = command == COMPONENT_ARM_DISARM && first == 0.0;
    (disarms || COMMANDS.contains(&command)).then_some(command)
}

#[cfg(test)]
mod ring_tests;
#[cfg(test)]
mod tests;
