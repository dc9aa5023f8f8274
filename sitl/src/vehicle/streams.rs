//! What the vehicle sends unasked: heartbeats, the percept of each tick, streams, texts.

use std::time::Duration;

use super::conduct::Mode;
use super::messages::{self, Row, VehicleState};
use super::missions::MissionUpload;
use super::{Peer, TEXT_PAUSE, Vehicle};
use crate::link::dialect::{self, MavSeverity};
use crate::link::encoder::DATAGRAM;
use crate::link::{AUTOPILOT, MessageData, PeerId, image, wire};

/// No row of the table is longer, bytes.
const LONGEST: usize = 280;

impl Vehicle {
    /// A second has passed on the wall: all components say that they are there.
    pub fn beat(&mut self) {
        self.forget_silent();
        for address in self.addresses() {
            self.heartbeat(address);
        }
        for (&address, peer) in &mut self.peers {
            let mut datagram = Vec::new();
            peer.camera.push(&mut datagram, &messages::camera_heartbeat());
            self.outbox.push_back((address, datagram));
        }
    }

    /// Sends this tick's percept to all. Each time the datagrams go out in another order, so a path
    /// that loses every n-th of them does not lose the same one for ever. They are numbered in the
    /// order in which they go: a frame behind its successor would count as lost everywhere.
    pub fn send_percept(&mut self) {
        for address in self.addresses() {
            let picture = if self.picture_is_due(address) { image::datagram_count(self.png()) } else { 0 };
            let parts = 1 + picture;
            for k in 0..parts {
                let datagram = match (self.sendings + k) % parts {
                    0 => self.telemetry_datagram(address),
                    part => self.image_datagram(address, part - 1),
                };
                self.outbox.push_back((address, datagram));
            }
        }
        self.sendings += 1;
    }

    /// From here on the vehicle is in real time, a control interval each `period` on the wall: all
    /// peers, those to come too, have the default streams.
    pub fn start_streams(&mut self, period: Duration, now: Duration) {
        self.period = Some(period);
        for address in self.addresses() {
            self.set_default_rates(address, now);
        }
    }

    /// When [`Vehicle::stream`] has something to send next, on the clock of `now`.
    #[must_use]
    pub fn next_stream(&self) -> Option<Duration> {
        let streams = self.peers.values().filter_map(|peer| peer.rates.due());
        streams.chain(self.upload.as_ref().map(MissionUpload::due)).min()
    }

    /// Sends every stream that is due, and what an unfinished upload waits for.
    pub fn stream(&mut self, now: Duration) {
        self.now = now;
        self.meter.measure(now);
        self.upload_timer(now);
        let state = self.state(now);
        for (&address, peer) in &mut self.peers {
            let mut datagram = Vec::new();
            for id in peer.rates.take_due(now) {
                let Some(row) = messages::row(id, AUTOPILOT) else { continue };
                row.push(&state, peer.encoder(row.component), &mut datagram);
                if datagram.len() > DATAGRAM - LONGEST {
                    self.outbox.push_back((address, std::mem::take(&mut datagram)));
                }
            }
            if !datagram.is_empty() {
                self.outbox.push_back((address, datagram));
            }
        }
    }

    /// What messages are made of, now.
    pub(super) fn state(&self, now: Duration) -> VehicleState {
        let scenario = self.sim.scenario();
        let flown = self.sim.flown() * scenario.dynamics.a_max;
        VehicleState {
            conduct: self.conduct,
            height: self.height,
            heading: self.heading,
            site: self.site,
            shots: self.shots.status(&self.clock, self.sim.tick()),
            fence: self.fence.status(self.fence_action),
            system_status: self.system_status(),
            mission: self.plan.status(self.conduct.mode == Mode::Auto),
            launch: self.launch(),
            target: self.target(),
            scale: scenario.scale,
            traffic: self.meter.status(&self.tally().packets, now),
            home: scenario.scale.ned_from_paper(self.home()),
            accel: scenario.scale.ned_from_paper_acceleration(flown),
            battery: self.battery,
            fates: self.sim.fates(),
            report: self.sim.telemetry(),
            clock: self.clock,
            system: self.system,
            unix: self.epoch.map(|epoch| epoch + now),
        }
    }

    /// Sends one message to one peer.
    pub(super) fn send_message(&mut self, row: &Row, to: PeerId, now: Duration) {
        let state = self.state(now);
        let Some(peer) = self.peers.get_mut(&to) else { return };
        let mut datagram = Vec::new();
        row.push(&state, peer.encoder(row.component), &mut datagram);
        self.outbox.push_back((to, datagram));
    }

    /// The first words to a new peer. Routers forward to a component only once they heard it.
    pub(super) fn greet(&mut self, address: PeerId) {
        self.heartbeat(address);
        let report = self.telemetry_datagram(address);
        self.outbox.push_back((address, report));
    }

    /// Whether a peer gets the frame of this tick.
    fn picture_is_due(&self, address: PeerId) -> bool {
        let every = self.peers.get(&address).and_then(|peer| peer.images);
        every.is_some_and(|every| self.sim.tick().0.is_multiple_of(every))
    }

    /// Sends this tick's frame to one peer.
    pub(super) fn send_image(&mut self, address: PeerId) {
        for index in 0..image::datagram_count(self.png()) {
            let datagram = self.image_datagram(address, index);
            self.outbox.push_back((address, datagram));
        }
    }

    /// Says something to all peers, at most once a second of each kind.
    pub(super) fn say(&mut self, kind: &'static str, severity: MavSeverity, text: &str, now: Duration) {
        if self.said.get(kind).is_some_and(|&last| now < last + TEXT_PAUSE) {
            return;
        }
        self.said.insert(kind, now);
        self.tell_text(severity, text);
    }

    /// Says something to all peers, once of its kind.
    pub(super) fn say_once(&mut self, kind: &'static str, severity: MavSeverity, text: &str) {
        if self.told.insert(kind) {
            self.tell_text(severity, text);
        }
    }

    /// Says something to all peers, however often.
    pub(super) fn tell_text(&mut self, severity: MavSeverity, text: &str) {
        self.tell_all(&dialect::STATUSTEXT_DATA { severity, text: text.into(), ..Default::default() });
    }

    /// Says something to one peer.
    pub(super) fn tell_one(&mut self, address: PeerId, severity: MavSeverity, text: &str) {
        let Some(peer) = self.peers.get_mut(&address) else { return };
        let text = dialect::STATUSTEXT_DATA { severity, text: text.into(), ..Default::default() };
        let mut datagram = Vec::new();
        peer.autopilot.push(&mut datagram, &text);
        self.outbox.push_back((address, datagram));
    }

    /// Sends a message of the autopilot to all peers.
    pub(super) fn tell_all<M: MessageData>(&mut self, message: &M) {
        for (&address, peer) in &mut self.peers {
            let mut datagram = Vec::new();
            peer.autopilot.push(&mut datagram, message);
            self.outbox.push_back((address, datagram));
        }
    }

    /// Where it returns to: latitude and longitude, 1e-7 degrees.
    pub(super) fn launch(&self) -> [i32; 2] {
        let scenario = self.sim.scenario();
        self.site.latitude_longitude(scenario.scale.ned_from_paper(self.home()))
    }

    pub(super) fn addresses(&self) -> Vec<PeerId> {
        self.peers.keys().copied().collect()
    }

    fn heartbeat(&mut self, address: PeerId) {
        let told = messages::autopilot_heartbeat(&self.conduct, self.system_status());
        let Some(peer) = self.peers.get_mut(&address) else { return };
        let mut datagram = Vec::new();
        peer.autopilot.push(&mut datagram, &told);
        peer.radio.push(&mut datagram, &messages::radio_heartbeat());
        self.outbox.push_back((address, datagram));
    }

    fn telemetry_datagram(&mut self, address: PeerId) -> Vec<u8> {
        let mut datagram = Vec::new();
        if let Some(peer) = self.peers.get_mut(&address) {
            let (report, vertical) = (self.sim.telemetry(), self.height.ned());
            let Peer { autopilot, radio, .. } = peer;
            wire::push_telemetry(&report, &self.clock, vertical, autopilot, radio, &mut datagram);
        }
        datagram
    }

    fn image_datagram(&mut self, address: PeerId, index: usize) -> Vec<u8> {
        self.png();
        let (Some(peer), Some(png)) = (self.peers.get_mut(&address), &self.png) else { return Vec::new() };
        image::datagram(png, index, &mut peer.autopilot)
    }

    /// This tick's frame, encoded once.
    fn png(&mut self) -> &[u8] {
        let sim = &self.sim;
        self.png.get_or_insert_with(|| {
            image::png_from_frame(&sim.frame(), sim.tick())
                .expect("a frame has the PNG's size and memory takes every byte")
        })
    }
}
