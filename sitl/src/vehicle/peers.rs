//! Who the vehicle talks to: each peer with its decoder, its sequence numbers and its rates; how it becomes one,
//! makes room and is forgotten.

use std::time::Duration;

use super::Vehicle;
use super::rates::Rates;
use crate::link::decoder::Decoder;
use crate::link::dialect::MavSeverity;
use crate::link::encoder::Encoder;
use crate::link::packet::Packet;
use crate::link::sequence::{Sequence, SequenceTracker};
use crate::link::signing::{Origin, Rejection};
use crate::link::{AUTOPILOT, CAMERA, PeerId, RADIO};

/// Peers that are served at a time. Of those that are silent, the one silent for longest makes room for a new one.
pub const MAX_PEERS: usize = 64;
/// How long a peer is silent before it makes room: stations send heartbeats each second.
const SILENT: Duration = Duration::from_secs(3);
/// How long a UDP peer is silent in real time before it is forgotten, as `gcs bridge` and mavp2p do: whoever is
/// there sends a heartbeat each second, and a program that begins anew comes from another port each time.
const FORGOTTEN: Duration = Duration::from_secs(60);
/// Systems and components behind one peer whose sequence numbers are followed.
const MAX_SENDERS: usize = 32;

/// Somebody to talk to.
#[derive(Debug)]
pub(super) struct Peer {
    pub decoder: Decoder,
    pub autopilot: Encoder,
    pub radio: Encoder,
    pub camera: Encoder,
    /// Frames: with each so many control intervals.
    pub images: Option<u64>,
    /// By which message it was asked for the mission item that it sent: MISSION_REQUEST_INT or the older one.
    pub asked_by_int: Option<bool>,
    pub rates: Rates,
    /// Named by configuration: never makes room for others.
    pub fixed: bool,
    pub heard: Duration,
    /// The sequence numbers of each system and component.
    pub sequences: Vec<((u8, u8), Sequence)>,
}

impl Peer {
    pub fn new(system: u8, now: Duration) -> Self {
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

    /// What the number of a frame tells.
    pub fn number(&mut self, packet: &Packet) -> SequenceTracker {
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
    pub fn encoder(&mut self, component: u8) -> &mut Encoder {
        match component {
            RADIO => &mut self.radio,
            CAMERA => &mut self.camera,
            _ => &mut self.autopilot,
        }
    }
}

impl Vehicle {
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
            match self.signing.check(packet, stamp) {
                Ok(origin) => self.take(packet, origin, from, now),
                Err(rejection) => self.tell_rejected(rejection, from),
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
            .filter_map(|packet| match self.signing.check(&packet, stamp) {
                Ok(origin) => Some((packet, origin)),
                Err(rejection) => {
                    self.tell_rejected(rejection, from);
                    None
                }
            })
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

    /// Says once of each kind that packets are refused: who is refused hears nothing else.
    fn tell_rejected(&mut self, rejection: Rejection, from: PeerId) {
        let (kind, text) = match rejection {
            Rejection::Unsigned => ("unsigned", "packets refused: unsigned"),
            Rejection::Signature => ("signature", "packets refused: wrong signature"),
            Rejection::Old => ("old", "packets refused: signed over a minute ago"),
            // Redundant paths bring copies.
            Rejection::Replayed => return,
        };
        if !self.told.contains(kind) {
            tracing::warn!("{text}, from {from}; said once");
        }
        self.say_once(kind, MavSeverity::MAV_SEVERITY_WARNING, text);
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
    pub(super) fn forget_silent(&mut self) {
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
}
