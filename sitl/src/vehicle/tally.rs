//! What the vehicle counts of the messages addressed to it.

use std::collections::BTreeMap;

use super::Vehicle;
use crate::link::signing::Rejection;
use crate::link::splitter::Counts;
use crate::link::wire::Refusal;

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

impl Vehicle {
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
}
