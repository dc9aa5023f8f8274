//! What the vehicle sends unasked: heartbeats, the percept of each tick, texts.

use std::net::SocketAddr;
use std::time::Duration;

use super::{TEXT_PAUSE, Vehicle};
use crate::link::dialect::{self, MavAutopilot, MavModeFlag, MavSeverity, MavState, MavType};
use crate::link::{image, wire};

/// ArduCopter's number of GUIDED.
const MODE_GUIDED: u32 = 4;
/// Armed, guided, stabilised, manual input and custom mode, as ArduCopter in GUIDED says.
const BASE_MODE: u8 = 217;

impl Vehicle {
    /// A second has passed on the wall: both components say that they are there.
    pub fn beat(&mut self) {
        for address in self.addresses() {
            self.heartbeat(address);
        }
    }

    /// Sends this tick's percept to all. Each time the datagrams go out in another order, so a path
    /// that loses every n-th of them does not lose the same one for ever.
    pub fn send_percept(&mut self) {
        for address in self.addresses() {
            let mut datagrams = vec![self.telemetry_datagram(address)];
            datagrams.extend(self.image_datagrams(address));
            let turn = self.sendings % datagrams.len();
            datagrams.rotate_left(turn);
            self.outbox.extend(datagrams.into_iter().map(|bytes| (address, bytes)));
        }
        self.sendings += 1;
    }

    /// The first words to a new peer. Routers forward to a component only once they heard it.
    pub(super) fn greet(&mut self, address: SocketAddr) {
        self.heartbeat(address);
        let report = self.telemetry_datagram(address);
        self.outbox.push_back((address, report));
    }

    /// Sends this tick's picture to one peer, if it has asked for pictures.
    pub(super) fn send_image(&mut self, address: SocketAddr) {
        let datagrams = self.image_datagrams(address);
        self.outbox.extend(datagrams.into_iter().map(|bytes| (address, bytes)));
    }

    /// Says something to all peers, at most once a second of each kind.
    pub(super) fn say(&mut self, kind: &'static str, severity: MavSeverity, text: &str, now: Duration) {
        if self.said.get(kind).is_some_and(|&last| now < last + TEXT_PAUSE) {
            return;
        }
        self.said.insert(kind, now);
        let message = dialect::STATUSTEXT_DATA { severity, text: text.into(), ..Default::default() };
        for (&address, peer) in &mut self.peers {
            let mut datagram = Vec::new();
            peer.autopilot.push(&mut datagram, &message);
            self.outbox.push_back((address, datagram));
        }
    }

    fn addresses(&self) -> Vec<SocketAddr> {
        self.peers.keys().copied().collect()
    }

    fn heartbeat(&mut self, address: SocketAddr) {
        let Some(peer) = self.peers.get_mut(&address) else { return };
        let autopilot = dialect::HEARTBEAT_DATA {
            custom_mode: MODE_GUIDED,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
            base_mode: MavModeFlag::from_bits_retain(BASE_MODE),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        };
        // Clients must not take the radio for a vehicle, hence this type.
        let radio = dialect::HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            ..autopilot.clone()
        };
        let mut datagram = Vec::new();
        peer.autopilot.push(&mut datagram, &autopilot);
        peer.radio.push(&mut datagram, &radio);
        self.outbox.push_back((address, datagram));
    }

    fn telemetry_datagram(&mut self, address: SocketAddr) -> Vec<u8> {
        let mut datagram = Vec::new();
        if let Some(peer) = self.peers.get_mut(&address) {
            let report = self.sim.telemetry();
            wire::push_telemetry(&report, &self.clock, &mut peer.autopilot, &mut peer.radio, &mut datagram);
        }
        datagram
    }

    fn image_datagrams(&mut self, address: SocketAddr) -> Vec<Vec<u8>> {
        let Some(peer) = self.peers.get_mut(&address).filter(|peer| peer.images) else { return Vec::new() };
        let sim = &self.sim;
        let png = self.png.get_or_insert_with(|| {
            image::png_from_frame(&sim.frame(), sim.tick())
                .expect("a frame has the picture's size and memory takes every byte")
        });
        image::datagrams(png, &mut peer.autopilot)
    }
}
