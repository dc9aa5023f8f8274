//! The simulated vehicle as MAVLink peers see it: an autopilot (component 1) and its radio (68).
//!
//! A state machine around [`Sim`]: datagrams go in, datagrams come out, the caller says when a
//! control interval passes and what time it is. Knows no socket and no clock. It begins in GUIDED mode,
//! armed and in the air or disarmed on the ground, with ArduCopter's mode numbers.
//!
//! | module | what it is |
//! |---|---|
//! | `commands` | what is answered: setpoints, commands, image requests |
//! | `battery`, `geodesy`, `heading`, `height` | energy spent; where on Earth, how tilted; where it looks; up and down |
//! | `boot` | how it begins, and begins anew |
//! | `camera` | the camera protocol: pictures on command |
//! | `failsafe` | silence, counted in control intervals, and what follows it |
//! | `fence` | areas that it must not leave or enter |
//! | `files` | that there are none |
//! | `guidance` | braking, and going to a point |
//! | `guided` | places, velocities and heights that GUIDED follows |
//! | `messages` | every message that can be asked for, one row each |
//! | `meter` | traffic, for LINK_NODE_STATUS |
//! | `missions`, `plan` | the mission protocol; a mission as it is flown |
//! | `modes` | mode, arming, takeoff, landing, who flies an interval |
//! | `params` | the parameter tables of both components |
//! | `rates` | SET_MESSAGE_INTERVAL, GET_MESSAGE_INTERVAL, REQUEST_MESSAGE, REQUEST_DATA_STREAM |
//! | `streams` | what is sent unasked: heartbeats, percepts, streams, texts |
//!
//! Each peer has its own sequence numbers, as each link of an autopilot has. Reports go to every
//! peer that has spoken; frames to those that asked for them by the image protocol.

#![expect(deprecated, reason = "ground stations still use what the standard has superseded")]

mod battery;
mod boot;
mod camera;
mod commands;
mod failsafe;
mod fence;
mod files;
pub mod geodesy;
mod guidance;
mod guided;
mod heading;
mod height;
mod messages;
mod meter;
mod missions;
mod modes;
pub mod params;
mod plan;
mod rates;
mod streams;
#[cfg(test)]
mod tests;

pub use boot::Start;
pub use params::ParamError;

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use crate::link::decoder::Decoder;
use crate::link::dialect::{self, MavSeverity};
use crate::link::encoder::Encoder;
use crate::link::messages::View;
use crate::link::messages::service::SetupSigning;
use crate::link::packet::Packet;
use crate::link::sequence::{Sequence, SequenceTracker};
use crate::link::signing::{self, Key, Origin, Policy, Rejection, Signing};
use crate::link::splitter::Counts;
use crate::link::wire::{Clock, Refusal};
use crate::link::{AUTOPILOT, CAMERA, PeerId, RADIO};
use crate::scenario::{Action, Scenario};
use crate::sim::Sim;
use crate::sim::record::Record;
use crate::units::Tick;
use crate::world::contact::Contact;
use battery::Battery;
use camera::Shots;
use failsafe::LossOfLink;
use fence::Fence;
use geodesy::Site;
use guided::WaitingTarget;
use heading::Heading;
use height::Height;
use meter::Meter;
use missions::{FinishedUpload, MissionUpload};
use modes::Conduct;
use plan::{StoredItem, StoredMission};
use rates::Rates;

/// Peers that are served at a time. Of those that are silent, the one silent for longest makes room for a new one.
pub const MAX_PEERS: usize = 64;
/// How long a peer is silent before it makes room: stations send heartbeats each second.
const SILENT: Duration = Duration::from_secs(3);
/// How long a UDP peer is silent in real time before it is forgotten, as `gcs bridge` and mavp2p do: whoever is
/// there sends a heartbeat each second, and a program that begins anew comes from another port each time.
const FORGOTTEN: Duration = Duration::from_secs(60);
/// Systems and components behind one peer whose sequence numbers are followed.
const MAX_SENDERS: usize = 32;
/// Least time between two texts of one kind.
const TEXT_PAUSE: Duration = Duration::from_secs(1);

/// A vehicle in flight.
#[derive(Debug)]
pub struct Vehicle {
    sim: Sim,
    clock: Clock,
    system: u8,
    ticks: Option<u64>,
    /// The scenario with what was set since: what the vehicle itself goes by.
    settings: Scenario,
    conduct: Conduct,
    height: Height,
    heading: Heading,
    /// How it begins, and begins anew.
    start: Start,
    site: Site,
    /// A setpoint that waits for the radio's next interval.
    waiting_target: Option<WaitingTarget>,
    /// The newest setpoint of that kind.
    newest_target: Option<Tick>,
    loss_of_link: LossOfLink,
    plan: StoredMission,
    fence: Fence,
    fence_action: Action,
    rally: Vec<StoredItem>,
    shots: Shots,
    upload: Option<MissionUpload>,
    uploaded: Option<FinishedUpload>,
    battery: Battery,
    peers: BTreeMap<PeerId, Peer>,
    outbox: VecDeque<(PeerId, Vec<u8>)>,
    /// Datagrams of the outbox that are signed already.
    signed: VecDeque<(PeerId, Vec<u8>)>,
    signing: Signing,
    meter: Meter,
    /// Memory for the packets of a datagram.
    scratch: Vec<Packet>,
    /// The newest `now`.
    now: Duration,
    /// `now` at the last control interval.
    advanced: Duration,
    /// This tick's frame, once somebody wanted it.
    png: Option<Vec<u8>>,
    /// How often this tick's percept has been sent to all.
    sendings: usize,
    /// Who sent the newest setpoint: its peer, system and component.
    commander: Option<(PeerId, (u8, u8))>,
    begun: bool,
    ready: bool,
    acknowledged: bool,
    /// Newest time stamp of a power command, boot ms.
    newest_power: Option<f32>,
    /// What it touched in the interval that just ended.
    contact: Contact,
    said: BTreeMap<&'static str, Duration>,
    /// The control interval on the wall's clock; `None` in lockstep.
    period: Option<Duration>,
    /// Default rates that were changed, Hz by message.
    default_hz: BTreeMap<u32, f64>,
    /// Since 1970 when `now` was zero, if anybody knows.
    epoch: Option<Duration>,
    tally: Tally,
    /// The intervals since [`Vehicle::take_records`], if they are kept.
    records: Option<Vec<Record>>,
}

/// What the vehicle made of the messages addressed to it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Tally {
    /// Frames, and what was none.
    pub packets: Counts,
    /// Setpoints taken.
    pub setpoints: u64,
    /// Setpoints older than the newest one: late or repeated.
    pub stale: u64,
    /// Good setpoints that came in another mode than GUIDED.
    pub ignored: u64,
    /// Collisions with an obstacle: contacts, not intervals.
    pub collisions: u64,
    /// Contacts with the field's edge.
    pub edge_contacts: u64,
    /// Setpoints not taken.
    pub refused: BTreeMap<Refusal, u64>,
    /// Commands that it does not know.
    pub unsupported: u64,
    /// Frames with a right signature.
    pub signed: u64,
    /// Frames refused for their signature, or for having none.
    pub unsigned: BTreeMap<Rejection, u64>,
}

impl Tally {
    /// The sum of both.
    #[must_use]
    pub fn plus(mut self, other: &Self) -> Self {
        self.packets = self.packets.plus(other.packets);
        self.setpoints += other.setpoints;
        self.stale += other.stale;
        self.ignored += other.ignored;
        self.collisions += other.collisions;
        self.edge_contacts += other.edge_contacts;
        self.unsupported += other.unsupported;
        self.signed += other.signed;
        for (&refusal, count) in &other.refused {
            *self.refused.entry(refusal).or_default() += count;
        }
        for (&rejection, count) in &other.unsigned {
            *self.unsigned.entry(rejection).or_default() += count;
        }
        self
    }
}

impl std::fmt::Display for Tally {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} setpoints, {} stale, {} in other modes", self.setpoints, self.stale, self.ignored)?;
        for (refusal, count) in &self.refused {
            write!(f, ", {count} x {refusal}")?;
        }
        write!(f, "; {} unsupported commands; {}", self.unsupported, self.packets)?;
        if self.signed > 0 || !self.unsigned.is_empty() {
            write!(f, "; {} signed", self.signed)?;
        }
        for (rejection, count) in &self.unsigned {
            write!(f, ", {count} refused: {rejection}")?;
        }
        if self.collisions + self.edge_contacts > 0 {
            write!(f, "; {} collisions, {} edge contacts", self.collisions, self.edge_contacts)?;
        }
        Ok(())
    }
}

/// Somebody to talk to.
#[derive(Debug)]
struct Peer {
    decoder: Decoder,
    autopilot: Encoder,
    radio: Encoder,
    camera: Encoder,
    /// Frames: with each so many control intervals.
    images: Option<u64>,
    /// By which message it was asked for the mission item that it sent: MISSION_REQUEST_INT or the older one.
    asked_by_int: Option<bool>,
    rates: Rates,
    /// Named by configuration: never makes room for others.
    fixed: bool,
    heard: Duration,
    /// The sequence numbers of each system and component.
    sequences: Vec<((u8, u8), Sequence)>,
}

impl Peer {
    fn new(system: u8, now: Duration) -> Self {
        Self {
            decoder: Decoder::default(),
            autopilot: Encoder::new(system, AUTOPILOT),
            radio: Encoder::new(system, RADIO),
            camera: Encoder::new(system, CAMERA),
            images: None,
            asked_by_int: None,
            rates: Rates::default(),
            fixed: false,
            heard: now,
            sequences: Vec::new(),
        }
    }
}

impl Peer {
    /// What the number of a frame tells.
    fn number(&mut self, packet: &Packet) -> SequenceTracker {
        let from = (packet.system, packet.component);
        if let Some((_, known)) = self.sequences.iter_mut().find(|(sender, _)| *sender == from) {
            return known.next(packet.sequence);
        }
        let mut sequence = Sequence::default();
        let heard = sequence.next(packet.sequence);
        if self.sequences.len() < MAX_SENDERS {
            self.sequences.push((from, sequence));
        }
        heard
    }

    /// The component that speaks to this peer: radio or camera, else the autopilot.
    fn encoder(&mut self, component: u8) -> &mut Encoder {
        match component {
            RADIO => &mut self.radio,
            CAMERA => &mut self.camera,
            _ => &mut self.autopilot,
        }
    }
}

impl Vehicle {
    /// A vehicle with this system id whose flight ends after `ticks` intervals, if given.
    #[must_use]
    pub fn new(sim: Sim, system: u8, ticks: Option<u64>) -> Self {
        Self {
            clock: Clock::new(sim.scenario()),
            settings: sim.scenario().clone(),
            conduct: Conduct::flying(),
            height: Height::hovering(sim.scenario().scale.altitude_m),
            heading: Heading::at(0.0),
            start: Start::default(),
            site: Site::default(),
            waiting_target: None,
            newest_target: None,
            loss_of_link: LossOfLink::default(),
            plan: StoredMission::default(),
            fence: Fence::default(),
            fence_action: Action::Brake,
            rally: Vec::new(),
            shots: Shots::default(),
            upload: None,
            uploaded: None,
            sim,
            system,
            ticks,
            battery: Battery::default(),
            peers: BTreeMap::new(),
            outbox: VecDeque::new(),
            signed: VecDeque::new(),
            signing: Signing::new(None, Policy::Required),
            meter: Meter::default(),
            scratch: Vec::new(),
            now: Duration::ZERO,
            advanced: Duration::ZERO,
            png: None,
            sendings: 0,
            commander: None,
            begun: false,
            ready: false,
            acknowledged: false,
            newest_power: None,
            contact: Contact::default(),
            said: BTreeMap::new(),
            period: None,
            default_hz: BTreeMap::new(),
            epoch: None,
            tally: Tally::default(),
            records: None,
        }
    }

    /// Keeps a record of every interval from now on, whoever flies.
    pub fn keep_records(&mut self) {
        self.records.get_or_insert_default();
    }

    /// The intervals since the last call, if they are kept.
    pub fn take_records(&mut self) -> Vec<Record> {
        self.records.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// Tells the time since 1970 at which `now` was zero; without it SYSTEM_TIME says 0, unknown.
    pub fn set_epoch(&mut self, epoch: Option<Duration>) {
        self.epoch = epoch;
    }

    /// Sets key, policy and timestamps of signing.
    pub fn set_signing(&mut self, signing: Signing) {
        self.signing = signing;
    }

    /// Key, policy and timestamps of signing.
    pub fn signing_mut(&mut self) -> &mut Signing {
        &mut self.signing
    }

    /// A peer that is spoken to before it has spoken.
    pub fn add_peer(&mut self, address: impl Into<PeerId>, now: Duration) {
        let peer = Peer { fixed: true, ..Peer::new(self.system, now) };
        self.introduce(address.into(), peer, now);
    }

    /// A stream has begun: its peer is spoken to at once, and is gone with it.
    pub fn connected(&mut self, address: PeerId, now: Duration) {
        let peer = Peer { fixed: true, decoder: Decoder::of_stream(), ..Peer::new(self.system, now) };
        self.introduce(address, peer, now);
    }

    /// A stream has ended.
    pub fn closed(&mut self, address: PeerId) {
        self.forget(address);
    }

    fn introduce(&mut self, address: PeerId, peer: Peer, now: Duration) {
        self.peers.insert(address, peer);
        self.set_default_rates(address, now);
        self.greet(address);
    }

    /// A datagram has arrived, or a part of a stream.
    pub fn datagram(&mut self, bytes: &[u8], from: impl Into<PeerId>, now: Duration) {
        let from = from.into();
        self.now = now;
        self.meter.received(bytes);
        let Some(peer) = self.peers.get_mut(&from) else { return self.stranger(bytes, from, now) };
        peer.heard = now;
        let mut packets = std::mem::take(&mut self.scratch);
        peer.decoder.datagram_into(bytes, &mut packets);
        tracing::trace!(%from, "{}", peer.decoder.counts());
        packets.iter().for_each(|packet| self.meter.numbered(peer.number(packet)));
        let stamp = self.stamp();
        for packet in &packets {
            if let Ok(origin) = self.signing.check(packet, stamp) {
                self.take(packet, origin, from, now);
            }
        }
        packets.clear();
        self.scratch = packets;
    }

    /// A datagram of somebody who has not been heard before.
    fn stranger(&mut self, bytes: &[u8], from: PeerId, now: Duration) {
        let mut peer = Peer::new(self.system, now);
        let stamp = self.stamp();
        let packets = peer.decoder.datagram(bytes).into_iter();
        let packets: Vec<(Packet, Origin)> = packets
            .filter_map(|packet| self.signing.check(&packet, stamp).ok().map(|origin| (packet, origin)))
            .collect();
        // Junk makes nobody a peer. MAVLink 1 does: pymavlink begins with it and changes over once it
        // hears MAVLink 2.
        let begins = peer.decoder.counts().mavlink1 > 0 && !self.signing.is_required();
        if packets.is_empty() && !begins {
            self.tally.packets = self.tally.packets.plus(peer.decoder.counts());
            return;
        }
        if !self.make_room(now) {
            self.tally.packets = self.tally.packets.plus(peer.decoder.counts());
            let text = format!("peer refused: {MAX_PEERS} are served");
            return self.say("peer refused", MavSeverity::MAV_SEVERITY_WARNING, &text, now);
        }
        for (packet, _) in &packets {
            self.meter.numbered(peer.number(packet));
        }
        self.introduce(from, peer, now);
        self.say("link up", MavSeverity::MAV_SEVERITY_INFO, &format!("link up: {from}"), now);
        for (packet, origin) in &packets {
            self.take(packet, *origin, from, now);
        }
    }

    /// A frame that signing has nothing against.
    fn take(&mut self, packet: &Packet, origin: Origin, from: PeerId, now: Duration) {
        if packet.is::<dialect::SETUP_SIGNING_DATA>() {
            self.setup_signing(packet, origin, now);
        } else {
            self.packet(packet, from, now);
        }
    }

    /// The next datagram to send, and where to.
    pub fn poll(&mut self) -> Option<(PeerId, Vec<u8>)> {
        if let Some((to, datagram)) = self.signed.pop_front() {
            self.meter.sent(&datagram);
            return Some((to, datagram));
        }
        let (to, datagram) = self.outbox.pop_front()?;
        let stamp = self.stamp();
        let datagrams = self.signing.sign(datagram, to.endpoint as u8, stamp);
        self.signed.extend(datagrams.into_iter().map(|datagram| (to, datagram)));
        let (to, datagram) = self.signed.pop_front()?;
        self.meter.sent(&datagram);
        Some((to, datagram))
    }

    /// Now, in units of signing; 0 if nobody knows.
    fn stamp(&self) -> u64 {
        self.epoch.map_or(0, |epoch| signing::timestamp(epoch + self.now))
    }

    /// SETUP_SIGNING: the first key comes from anybody, any other must be signed with the old one.
    fn setup_signing(&mut self, packet: &Packet, origin: Origin, now: Duration) {
        let Some(SetupSigning { initial_timestamp, target, key }) = SetupSigning::of(packet) else { return };
        let key = Key::new(key);
        if !target.is(self.system, AUTOPILOT) {
            return;
        }
        if self.signing.is_on() && origin != Origin::Signed {
            self.say("signing", MavSeverity::MAV_SEVERITY_WARNING, "signing: unsigned key refused", now);
            return;
        }
        let text = if key.is_some() { "signing: new key" } else { "signing: off" };
        self.signing.set_key(key, initial_timestamp);
        self.say("signing", MavSeverity::MAV_SEVERITY_NOTICE, text, now);
    }

    /// Its system id.
    #[must_use]
    pub fn system(&self) -> u8 {
        self.system
    }

    /// Whether a setpoint for this very tick has arrived.
    #[must_use]
    pub fn ready(&self) -> bool {
        (self.ready || self.sim.is_fallen()) && !self.over()
    }

    /// Whether any setpoint has arrived: the flight begins with the first.
    #[must_use]
    pub fn begun(&self) -> bool {
        self.begun
    }

    /// Whether the flight has had all its intervals, or has ended on the ground after a collision.
    #[must_use]
    pub fn over(&self) -> bool {
        self.ticks.is_some_and(|ticks| self.sim.tick() >= Tick(ticks))
            || self.sim.is_fallen() && self.height.on_ground()
    }

    /// Whether a station has confirmed the last percept, by a setpoint with its time stamp.
    #[must_use]
    pub fn acknowledged(&self) -> bool {
        self.acknowledged
    }

    /// One control interval passes; the percept at its end goes to all peers.
    pub fn advance(&mut self, now: Duration) {
        (self.now, self.advanced) = (now, now);
        let begun = self.records.is_some().then(|| (self.sim.telemetry(), self.sim.asked()));
        let before = self.sim.telemetry().link.is_some_and(|link| link.outage);
        let arrivals = self.arrivals();
        self.sim.transmit();
        let link = self.sim.telemetry().link;
        let after = link.is_some_and(|link| link.outage);
        let target = self.target_through(after);
        self.hear(self.arrivals() > arrivals || target.is_some(), after, now);
        if let Some(WaitingTarget { target, turn, .. }) = target.filter(|_| self.takes_setpoints()) {
            self.follow_target(target);
            self.turn(turn);
        }
        self.keep_fence(now);
        let control = self.control(now);
        self.sim.set_control(control);
        self.sim.step();
        if let (Some(records), Some((report, command))) = (&mut self.records, begun) {
            records.push(Record::new(&report, &command, &self.sim.telemetry(), self.sim.scenario()));
        }
        self.tell_contact(now);
        (self.ready, self.png, self.sendings) = (false, None, 0);
        let power = link.map_or(self.sim.power(), |link| link.power);
        let speed = self.conduct.armed.then(|| self.sim.world().uav.v.norm());
        self.battery.spend(speed, power, self.sim.scenario());
        self.rise_and_land(now);
        let tick = self.sim.tick();
        match (before, after) {
            (false, true) => self.say(
                "outage begins",
                MavSeverity::MAV_SEVERITY_WARNING,
                &format!("outage begins before tick {}", tick.0),
                now,
            ),
            (true, false) => self.say(
                "outage ends",
                MavSeverity::MAV_SEVERITY_NOTICE,
                &format!("outage ends before tick {}", tick.0),
                now,
            ),
            _ => {}
        }
        if self.over() {
            let why = if self.sim.is_fallen() { ": collision" } else { "" };
            let text = format!("flight over after {} ticks{why}", tick.0);
            self.say("flight over", MavSeverity::MAV_SEVERITY_NOTICE, &text, now);
        }
        self.send_percept();
        self.take_shots(now);
    }

    /// Says once for each contact what was touched; the motors of a vehicle that falls stop.
    fn tell_contact(&mut self, now: Duration) {
        let before = std::mem::replace(&mut self.contact, self.sim.contact());
        let (contact, tick) = (self.contact, self.sim.tick().0);
        if let (Some(obstacle), None) = (contact.obstacle, before.obstacle) {
            self.tally.collisions += 1;
            let text = format!("collision with obstacle {} before tick {tick}", obstacle + 1);
            self.tell_text(MavSeverity::MAV_SEVERITY_CRITICAL, &text);
        }
        if contact.edge && !before.edge && self.sim.scenario().dynamics.walls {
            self.tally.edge_contacts += 1;
            let text = format!("edge of the field before tick {tick}");
            self.tell_text(MavSeverity::MAV_SEVERITY_WARNING, &text);
        }
        if self.sim.is_fallen() && self.conduct.armed {
            self.cut_motors(now);
        }
    }

    /// Commands that have got through the radio.
    fn arrivals(&self) -> u64 {
        let fates = self.sim.fates();
        fates.delivered + fates.delayed
    }

    /// The simulator inside.
    #[must_use]
    pub fn sim(&self) -> &Sim {
        &self.sim
    }

    /// What was made of the messages so far.
    #[must_use]
    pub fn tally(&self) -> Tally {
        let packets = self.peers.values().map(|peer| peer.decoder.counts());
        Tally {
            packets: packets.fold(self.tally.packets, Counts::plus),
            signed: self.signing.accepted(),
            unsigned: self.signing.rejected().clone(),
            ..self.tally.clone()
        }
    }

    /// Whether there is room for one more peer, if need be in place of one that says nothing.
    fn make_room(&mut self, now: Duration) -> bool {
        if self.peers.len() < MAX_PEERS {
            return true;
        }
        let silent = |peer: &Peer| !peer.fixed && peer.heard + SILENT <= now;
        let quietest = self.peers.iter().filter(|(_, peer)| silent(peer)).min_by_key(|(_, peer)| peer.heard);
        let Some(address) = quietest.map(|(&address, _)| address) else { return false };
        self.forget(address);
        true
    }

    /// Forgets who has been silent for long. In lockstep nobody is: a station may think for as long as it likes.
    fn forget_silent(&mut self) {
        if self.period.is_none() {
            return;
        }
        let silent = |peer: &Peer| !peer.fixed && peer.heard + FORGOTTEN <= self.now;
        let gone: Vec<PeerId> =
            self.peers.iter().filter(|(_, peer)| silent(peer)).map(|(&address, _)| address).collect();
        for address in gone {
            tracing::debug!("{address} is forgotten: silent for {} s", FORGOTTEN.as_secs());
            self.tell_one(
                address,
                MavSeverity::MAV_SEVERITY_WARNING,
                "silent for 60 s: link down. Send heartbeats",
            );
            self.forget(address);
        }
    }

    fn forget(&mut self, address: PeerId) {
        if let Some(gone) = self.peers.remove(&address) {
            self.tally.packets = self.tally.packets.plus(gone.decoder.counts());
        }
    }

    /// The vehicle's clock, ns since it booted: in real time it goes on between control intervals.
    fn boot_ns(&self, now: Duration) -> u64 {
        let at_tick = u64::from(self.clock.boot_ms(self.sim.tick())) * 1_000_000;
        let Some(period) = self.period else { return at_tick };
        let part = (now.saturating_sub(self.advanced).as_secs_f64() / period.as_secs_f64()).min(1.0);
        at_tick + (part * self.clock.interval_s() * 1e9) as u64
    }
}
