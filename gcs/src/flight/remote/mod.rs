//! The vehicle as the ground station hears it: datagrams to percepts, commands to datagrams.
//!
//! A state machine without socket and clock. A percept is handed out once, when its report and its
//! frame are both there, in the order of ticks; parts that came before a repeat are kept, so a
//! path that loses datagrams only delays. Stamps and the frame's own tick keep late parts of
//! earlier ticks out. On a slow radio a frame may come when newer reports are there already:
//! [`Remote::heard`] says how late it is.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use crpl_sitl::Scenario;
use crpl_sitl::camera::Frame;
use crpl_sitl::link::AUTOPILOT;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{self, MavSeverity};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::image::{self, Reassembler};
use crpl_sitl::link::latents;
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::splitter::Counts;
use crpl_sitl::link::wire::{self, Clock, TelemetryReader};
use crpl_sitl::radio::message::{Command, Percept, SentLatents, Telemetry};
use crpl_sitl::units::Tick;

use crate::tools::fleet::{Fleet, FlightMode, News};
use crate::tools::identity::Identity;
use crate::tools::texts::Texts;

/// Something worth acting on.
#[derive(Debug, Clone, PartialEq)]
pub enum RemoteEvent {
    /// A percept, complete, newer than all before.
    Percept(Percept),
    /// The vehicle has sent the report of the newest percept again: it misses our command.
    Repeat(Tick),
    /// STATUSTEXT: severity 0 (emergency) to 7 (debug), text.
    Text(u8, String),
    /// What the vehicle's heartbeats tell.
    News(News),
    /// The vehicle has left GUIDED for this mode: somebody else flies it.
    LeftGuided(FlightMode),
    /// The vehicle's time has gone back from one tick to another: it has booted anew.
    Rebooted(Tick, Tick),
}

/// The far end of the link.
#[derive(Debug)]
pub struct Remote {
    clock: Clock,
    decoder: Decoder,
    reports: TelemetryReader,
    images: Reassembler,
    station: Encoder,
    system: u8,
    /// Reports in a row that are older than the newest.
    older: u32,
    /// Of the percepts to come.
    waiting: BTreeMap<Tick, Telemetry>,
    /// Of the percept to come.
    frame: Option<(Tick, Frame, Option<SentLatents>)>,
    newest: Option<Tick>,
    command: Option<Command>,
    /// Repeats since the newest percept.
    repeats: u32,
    fleet: Fleet,
    texts: Texts,
    identity: Identity,
    /// Whether the vehicle says where on the map it is.
    on_map: bool,
}

/// Old reports in a row after which the vehicle's time has gone back: fewer may be late ones.
const REBOOT: u32 = 3;
/// ArduCopter's mode BRAKE, and MAV_MODE_FLAG_CUSTOM_MODE_ENABLED.
const BRAKE: [f32; 2] = [1.0, 17.0];

/// Reports that wait for their frames.
const MOST_WAITING: usize = 64;

/// Repeats without a new percept after which the frames are asked for again.
const PICTURES_MISSING: u32 = 5;

impl Remote {
    /// The vehicle `system`, which flies this scenario; `station` writes to it.
    #[must_use]
    pub fn new(scenario: &Scenario, system: u8, station: Encoder) -> Self {
        Self {
            clock: Clock::new(scenario),
            decoder: Decoder::default(),
            reports: TelemetryReader::default(),
            images: Reassembler::default(),
            station,
            system,
            older: 0,
            waiting: BTreeMap::new(),
            frame: None,
            newest: None,
            command: None,
            repeats: 0,
            fleet: Fleet::default(),
            texts: Texts::default(),
            identity: Identity::default(),
            on_map: false,
        }
    }

    /// With the heartbeats of this program.
    #[must_use]
    pub fn speaking_as(self, identity: Identity) -> Self {
        Self { identity, ..self }
    }

    /// Whether the vehicle says where on the map it is.
    #[must_use]
    pub fn is_on_map(&self) -> bool {
        self.on_map
    }

    /// With those who were heard before: a change of mode since then is news.
    #[must_use]
    pub fn knowing(self, fleet: Fleet) -> Self {
        Self { fleet, ..self }
    }

    /// A datagram has arrived.
    pub fn datagram(&mut self, bytes: &[u8], now: Duration) -> Vec<RemoteEvent> {
        let packets = self.decoder.datagram(bytes);
        let mut events = Vec::new();
        for packet in &packets {
            if self.system == packet.system {
                self.packet(packet, now, &mut events);
            }
        }
        events
    }

    fn packet(&mut self, packet: &Packet, now: Duration, events: &mut Vec<RemoteEvent>) {
        self.on_map |= packet.is::<dialect::GLOBAL_POSITION_INT_DATA>();
        if let Some(report) = self.reports.push(packet, &self.clock) {
            self.older = if Some(report.tick) < self.newest { self.older + 1 } else { 0 };
            if let Some(newest) = self.newest.filter(|_| self.older == REBOOT) {
                events.push(RemoteEvent::Rebooted(newest, report.tick));
            }
            if self.newest == Some(report.tick) {
                events.push(RemoteEvent::Repeat(report.tick));
            } else if self.newest < Some(report.tick) {
                self.waiting.insert(report.tick, report);
                while self.waiting.len() > MOST_WAITING {
                    self.waiting.pop_first();
                }
            }
        } else if let Some((tick, frame)) = self.images.push(packet) {
            if self.newest < Some(tick) {
                self.frame = Some((tick, frame, None));
            }
        } else if let Some(sent) = latents::of(packet, &self.clock) {
            if self.newest < Some(sent.tick) {
                self.frame = Some((sent.tick, Frame::black(), Some(sent)));
            }
        } else if packet.is::<dialect::STATUSTEXT_DATA>() {
            let said = self.texts.packet(packet).into_iter();
            events.extend(said.map(|said| RemoteEvent::Text(said.severity, said.text)));
        } else if packet.is::<dialect::HEARTBEAT_DATA>() {
            for news in self.fleet.packet(packet, now) {
                events.push(RemoteEvent::News(news));
                if let News::Mode(_, before, after) = news
                    && before.takes_setpoints()
                    && !after.takes_setpoints()
                {
                    events.push(RemoteEvent::LeftGuided(after));
                }
            }
        }
        events.extend(self.complete().map(RemoteEvent::Percept));
    }

    /// The percept, if both of its parts are there.
    fn complete(&mut self) -> Option<Percept> {
        let (tick, ..) = self.frame.as_ref()?;
        let telemetry = self.waiting.get(tick).copied()?;
        let (tick, frame, latents) = self.frame.take()?;
        self.waiting = self.waiting.split_off(&tick.next());
        self.newest = Some(telemetry.tick);
        self.repeats = 0;
        Some(Percept { telemetry, frame: Arc::new(frame), latents: latents.map(Arc::new) })
    }

    /// The datagram of a command: power and setpoint, so that none comes without the other.
    pub fn command(&mut self, command: &Command) -> Vec<u8> {
        self.command = Some(*command);
        let mut datagram = Vec::new();
        wire::push_command(command, &self.clock, self.system, &mut self.station, &mut datagram);
        datagram
    }

    /// What to send when something is missing: the newest command, and the request for frames if
    /// they do not flow. Every other time twice: a path that loses each n-th datagram must not lose
    /// the same one for ever.
    pub fn repeat(&mut self) -> Vec<Vec<u8>> {
        self.repeats += 1;
        let mut datagrams = Vec::new();
        for _ in 0..1 + self.repeats % 2 {
            if self.command.is_none() || self.repeats > PICTURES_MISSING {
                datagrams.push(self.image_request());
            }
            if let Some(command) = self.command {
                datagrams.push(self.command(&command));
            }
        }
        datagrams
    }

    /// The datagram that confirms the last percept of a flight.
    pub fn acknowledgement(&mut self, tick: Tick) -> Vec<u8> {
        let mut datagram = Vec::new();
        wire::push_setpoint(tick, [0.0; 2], &self.clock, self.system, &mut self.station, &mut datagram);
        datagram
    }

    /// The datagram that asks the vehicle to brake, and to stay where it comes to a stop.
    pub fn brake(&mut self) -> Vec<u8> {
        let [flag, mode] = BRAKE;
        let command = dialect::COMMAND_LONG_DATA {
            target_system: self.system,
            target_component: AUTOPILOT,
            command: dialect::MavCmd::MAV_CMD_DO_SET_MODE,
            param1: flag,
            param2: mode,
            ..Default::default()
        };
        let mut datagram = Vec::new();
        self.station.push(&mut datagram, &command);
        datagram
    }

    /// What writes to the vehicle.
    pub fn encoder(&mut self) -> &mut Encoder {
        &mut self.station
    }

    /// The station's heartbeat.
    pub fn heartbeat(&mut self) -> Vec<u8> {
        let mut datagram = Vec::new();
        self.identity.push_heartbeat(&mut self.station, &mut datagram);
        datagram
    }

    /// A STATUSTEXT of the station, at most 50 bytes.
    pub fn text(&mut self, severity: MavSeverity, text: &str) -> Vec<u8> {
        let mut datagram = Vec::new();
        let message = dialect::STATUSTEXT_DATA { severity, text: text.into(), ..Default::default() };
        self.station.push(&mut datagram, &message);
        datagram
    }

    /// The request for a stream of frames.
    pub fn image_request(&mut self) -> Vec<u8> {
        let mut datagram = Vec::new();
        image::push_request(&mut self.station, &mut datagram);
        datagram
    }

    /// Whether the link is lost by now, as news if it has just become so.
    pub fn poll(&mut self, now: Duration) -> Vec<News> {
        self.fleet.poll(now)
    }

    /// Whether the vehicle was heard and its heartbeats are missing.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.fleet.is_lost(self.system)
    }

    /// The vehicle's system id.
    #[must_use]
    pub fn system(&self) -> u8 {
        self.system
    }

    /// Tick of the newest report, whose frame may still be on its way.
    #[must_use]
    pub fn heard(&self) -> Option<Tick> {
        self.waiting.last_key_value().map(|(tick, _)| *tick).max(self.newest)
    }

    /// Tick of the newest complete percept.
    #[must_use]
    pub fn newest(&self) -> Option<Tick> {
        self.newest
    }

    /// What arrived so far.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.decoder.counts()
    }

    /// Rejected reports (another scenario's clock, values that are not finite) and rejected frames.
    #[must_use]
    pub fn rejected_messages(&self) -> u64 {
        self.reports.malformed() + self.images.rejected()
    }
}

#[cfg(test)]
mod tests;
