//! The radio gate: a command gets through in this interval, or the vehicle holds its last action.
//!
//! Knows packets and fates, not geometry: the SNR of the interval is an argument.
//!
//! | fate | what happened |
//! |---|---|
//! | delivered | flown in the first interval after it was computed |
//! | delayed | flown later: it waited (rule `queue`) or came late to the transmitter |
//! | superseded | never flown: a newer command took its place before it got through |
//! | lost | never flown: dropped in an outage (rule `drop`), or still waiting when the flight ended |

pub mod air;
pub mod message;

use serde::{Deserialize, Serialize};

use crate::radio::message::{Command, Held, LinkReport};
use crate::scenario::{Radio, Rule};
use crate::units::{Snr, Tick, TxPower};
use crate::world::channel;

/// How many commands met which fate. The last four sum to `sent` once the flight has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Fates {
    /// Commands handed to the transmitter.
    pub sent: u64,
    /// Flown in the interval for which they were computed.
    pub delivered: u64,
    /// Flown later.
    pub delayed: u64,
    /// Replaced by a newer one before they got through.
    pub superseded: u64,
    /// Dropped in an outage.
    pub lost: u64,
}

/// Transmitter of the base station and receiver of the vehicle, back to back. By default its power is
/// low and it has heard nothing yet.
#[derive(Debug, Clone, Default)]
pub struct Gate {
    power: TxPower,
    newest: Option<Tick>,
    pending: Option<Command>,
    held: Option<Held>,
    fates: Fates,
}

impl Gate {
    /// Sets the transmitter's power. It is the station's own, so no packet is needed.
    pub fn set_power(&mut self, power: TxPower) {
        self.power = power;
    }

    /// The transmitter's power.
    #[must_use]
    pub fn power(&self) -> TxPower {
        self.power
    }

    /// Hands a command to the transmitter. A repeat of one that is waiting replaces it; one that is
    /// older than the newest, or whose fate is settled, is ignored.
    pub fn submit(&mut self, command: Command) {
        match self.newest {
            Some(newest) if command.tick < newest => return,
            Some(newest) if command.tick == newest => {
                if let Some(waiting) = self.pending.as_mut() {
                    *waiting = command;
                    self.power = command.power;
                }
                return;
            }
            _ => {}
        }
        self.newest = Some(command.tick);
        self.power = command.power;
        self.fates.sent += 1;
        if self.pending.replace(command).is_some() {
            self.fates.superseded += 1;
        }
    }

    /// The command that waits for the next interval.
    #[must_use]
    pub fn pending(&self) -> Option<Command> {
        self.pending
    }

    /// Control interval `now` at SNR `snr`: decides whether there is an outage, R Δt < L_pkt, never under
    /// [`Rule::Ideal`]. Without one the waiting packet gets through, and the vehicle holds its command
    /// from now on; in one its fate is as [`Radio::rule`] says.
    pub fn transmit(&mut self, now: Tick, snr: Snr, radio: &Radio) -> LinkReport {
        let outage = radio.rule != Rule::Ideal && channel::outage(radio.b_dt, snr, radio.packet_bits);
        match self.pending.take() {
            None => {}
            Some(packet) if !outage => self.deliver(packet, now),
            Some(packet) if radio.rule == Rule::Queue => self.pending = Some(packet),
            Some(_) => self.fates.lost += 1,
        }
        LinkReport { snr_db: snr.to_db() as f32, power: self.power, outage }
    }

    /// Control interval `now` where another radio decides: what was submitted has arrived, and is held from now
    /// on. The report is that radio's.
    pub fn receive(&mut self, now: Tick, snr: Snr, outage: bool) -> LinkReport {
        if let Some(packet) = self.pending.take() {
            self.deliver(packet, now);
        }
        LinkReport { snr_db: snr.to_db() as f32, power: self.power, outage }
    }

    fn deliver(&mut self, packet: Command, now: Tick) {
        self.held = Some(Held { tick: packet.tick, accel: packet.accel });
        if packet.tick == now {
            self.fates.delivered += 1;
        } else {
            self.fates.delayed += 1;
        }
    }

    /// Forgets the held command and the one that waits, whose fate is then lost: the vehicle no longer
    /// takes commands of the station.
    pub fn release(&mut self) {
        self.fates.lost += u64::from(self.pending.take().is_some());
        self.held = None;
    }

    /// What the vehicle flew in the interval that just ended.
    #[must_use]
    pub fn held(&self) -> Option<Held> {
        self.held
    }

    /// The fates so far; a packet still waiting counts as lost, as it would if the flight ended now.
    #[must_use]
    pub fn fates(&self) -> Fates {
        Fates { lost: self.fates.lost + u64::from(self.pending.is_some()), ..self.fates }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(tick: u64) -> Command {
        Command::new(Tick(tick), [tick as f32, 0.0], TxPower::Low)
    }

    /// Interval `tick` at half the SNR that just carries a packet, or at twice that.
    fn transmit(gate: &mut Gate, rule: Rule, tick: u64, weak: bool) -> LinkReport {
        let radio = Radio { rule, ..Radio::default() };
        let threshold = channel::outage_snr(radio.b_dt, radio.packet_bits);
        let snr = Snr(threshold.0 * if weak { 0.5 } else { 2.0 });
        gate.transmit(Tick(tick), snr, &radio)
    }

    fn held_tick(gate: &Gate) -> Option<u64> {
        gate.held().map(|h| h.tick.0)
    }

    #[test]
    fn drop_holds_the_last_action_until_a_new_packet_arrives() {
        let mut gate = Gate::default();
        for (tick, outage, flown) in [(0, false, 0), (1, true, 0), (2, true, 0), (3, false, 3)] {
            gate.submit(command(tick));
            transmit(&mut gate, Rule::Drop, tick, outage);
            let held = Held { tick: Tick(flown), accel: [flown as f32, 0.0] };
            assert_eq!(gate.held(), Some(held), "tick {tick}");
        }
        assert_eq!(gate.fates(), Fates { sent: 4, delivered: 2, lost: 2, ..Fates::default() });
    }

    #[test]
    fn queue_delays_a_packet_that_nothing_newer_replaces() {
        let mut gate = Gate::default();
        gate.submit(command(0));
        transmit(&mut gate, Rule::Queue, 0, true);
        transmit(&mut gate, Rule::Queue, 1, false);
        assert_eq!(held_tick(&gate), Some(0));
        assert_eq!(gate.fates(), Fates { sent: 1, delayed: 1, ..Fates::default() });
    }

    #[test]
    fn queue_supersedes_a_packet_when_a_newer_one_comes() {
        let mut gate = Gate::default();
        gate.submit(command(0));
        transmit(&mut gate, Rule::Queue, 0, true);
        gate.submit(command(1));
        transmit(&mut gate, Rule::Queue, 1, false);
        assert_eq!(held_tick(&gate), Some(1));
        assert_eq!(gate.fates(), Fates { sent: 2, delivered: 1, superseded: 1, ..Fates::default() });
    }

    #[test]
    fn a_repeat_is_not_a_second_packet_and_a_stale_one_is_ignored() {
        let mut gate = Gate::default();
        gate.submit(command(4));
        gate.submit(command(4));
        transmit(&mut gate, Rule::Drop, 4, true);
        gate.submit(command(4));
        gate.submit(Command { power: TxPower::High, ..command(3) });
        transmit(&mut gate, Rule::Drop, 5, false);
        assert_eq!((held_tick(&gate), gate.power()), (None, TxPower::Low));
        assert_eq!(gate.fates(), Fates { sent: 1, lost: 1, ..Fates::default() });
    }

    #[test]
    fn a_repeat_replaces_the_one_that_waits_with_its_power() {
        let mut gate = Gate::default();
        gate.submit(command(4));
        gate.submit(Command { power: TxPower::High, accel: [9.0, 0.0], ..command(4) });
        assert_eq!(gate.power(), TxPower::High);
        transmit(&mut gate, Rule::Drop, 4, false);
        assert_eq!(gate.held(), Some(Held { tick: Tick(4), accel: [9.0, 0.0] }));
        assert_eq!(gate.fates(), Fates { sent: 1, delivered: 1, ..Fates::default() });
    }

    #[test]
    fn what_still_waits_counts_as_lost_beside_what_was() {
        let mut gate = Gate::default();
        gate.submit(command(0));
        transmit(&mut gate, Rule::Drop, 0, true);
        gate.submit(command(1));
        assert_eq!(gate.fates(), Fates { sent: 2, lost: 2, ..Fates::default() });
    }

    #[test]
    fn a_released_command_is_lost_and_not_held() {
        let mut gate = Gate::default();
        gate.submit(command(0));
        transmit(&mut gate, Rule::Ideal, 0, false);
        gate.submit(command(1));
        gate.release();
        transmit(&mut gate, Rule::Ideal, 1, false);
        assert_eq!(gate.held(), None);
        assert_eq!(gate.fates(), Fates { sent: 2, delivered: 1, lost: 1, ..Fates::default() });
    }

    #[test]
    fn an_ideal_link_has_no_outage() {
        let mut gate = Gate::default();
        gate.submit(command(0));
        assert!(!transmit(&mut gate, Rule::Ideal, 0, true).outage);
        assert_eq!(gate.fates().delivered, 1);
    }

    #[test]
    fn the_report_tells_snr_power_and_outage() {
        let mut gate = Gate::default();
        let radio = Radio { b_dt: 4.0, packet_bits: 4.0, ..Radio::default() };
        gate.submit(Command { power: TxPower::High, ..command(0) });
        // At γ = 1 the interval carries 4 bits, which is just enough.
        let report = gate.transmit(Tick(0), Snr(1.0), &radio);
        assert_eq!(report, LinkReport { snr_db: 0.0, power: TxPower::High, outage: false });
        assert_eq!(held_tick(&gate), Some(0));
        // An interval without a packet has a report too.
        gate.set_power(TxPower::Low);
        let report = gate.transmit(Tick(1), Snr(0.1), &radio);
        assert_eq!(report, LinkReport { snr_db: -10.0, power: TxPower::Low, outage: true });
        assert_eq!(held_tick(&gate), Some(0));
        let longer = Radio { packet_bits: 4.5, ..radio };
        assert!(gate.transmit(Tick(2), Snr(1.0), &longer).outage);
    }
}
