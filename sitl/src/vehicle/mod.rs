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
//! | `conduct` | mode, motors, what is followed |
//! | `failsafe` | silence, counted in control intervals, and what follows it |
//! | `fence` | areas that it must not leave or enter |
//! | `files` | that there are none, nor logs |
//! | `guidance` | braking, and going to a point |
//! | `guided` | places, velocities and heights that GUIDED follows |
//! | `interval` | one control interval: radio, who flies, what was touched |
//! | `messages` | every message that can be asked for, one row each |
//! | `meter` | traffic, for LINK_NODE_STATUS |
//! | `missions`, `item`, `plan` | the mission protocol; an item of a list; a mission as it is flown |
//! | `modes` | commands of mode, arming, takeoff, landing, who flies an interval |
//! | `params` | the parameter tables of both components |
//! | `peers` | who is spoken to, and who is forgotten |
//! | `rates` | SET_MESSAGE_INTERVAL, GET_MESSAGE_INTERVAL, REQUEST_MESSAGE, REQUEST_DATA_STREAM |
//! | `streams` | what is sent unasked: heartbeats, percepts, streams, texts |
//! | `tally` | what was made of the messages |
//!
//! Each peer has its own sequence numbers, as each link of an autopilot has. Reports go to every
//! peer that has spoken; frames to those that asked for them by the image protocol.

#![expect(deprecated, reason = "ground stations still use what the standard has superseded")]

mod battery;
mod boot;
mod camera;
mod commands;
mod conduct;
mod failsafe;
mod fence;
mod files;
pub mod geodesy;
mod guidance;
mod guided;
mod heading;
mod height;
mod interval;
mod item;
mod messages;
mod meter;
mod missions;
mod modes;
pub mod params;
mod peers;
mod plan;
mod rates;
mod streams;
mod tally;
#[cfg(test)]
mod tests;

pub use boot::Start;
pub use params::ParamError;
pub use peers::MAX_PEERS;
pub use tally::Tally;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use nalgebra::Vector2;

use crate::link::dialect::{self, MavSeverity};
use crate::link::messages::View;
use crate::link::messages::service::SetupSigning;
use crate::link::packet::Packet;
use crate::link::signing::{self, Key, Origin, Policy, Signing};
use crate::link::wire::Clock;
use crate::link::{AUTOPILOT, PeerId};
use crate::scenario::{Action, Scenario};
use crate::sim::Sim;
use crate::sim::record::Record;
use crate::units::Tick;
use crate::world::contact::Contact;
use battery::Battery;
use camera::Shots;
use conduct::Conduct;
use failsafe::LossOfLink;
use fence::Fence;
use geodesy::Site;
use guided::WaitingTarget;
use heading::Heading;
use height::Height;
use item::StoredItem;
use meter::Meter;
use missions::{FinishedUpload, MissionUpload};
use peers::Peer;
use plan::StoredMission;

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
    /// Where RTL leads, paper x/y, if a station has set that; else its start.
    home: Option<Vector2<f64>>,
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
    /// What is said once a flight.
    told: BTreeSet<&'static str>,
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
            home: None,
            newest_power: None,
            contact: Contact::default(),
            said: BTreeMap::new(),
            told: BTreeSet::new(),
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

    /// The simulator inside.
    #[must_use]
    pub fn sim(&self) -> &Sim {
        &self.sim
    }

    /// The vehicle's clock, ns since it booted: in real time it goes on between control intervals.
    fn boot_ns(&self, now: Duration) -> u64 {
        let at_tick = u64::from(self.clock.boot_ms(self.sim.tick())) * 1_000_000;
        let Some(period) = self.period else { return at_tick };
        let part = (now.saturating_sub(self.advanced).as_secs_f64() / period.as_secs_f64()).min(1.0);
        at_tick + (part * self.clock.interval_s() * 1e9) as u64
    }
}
