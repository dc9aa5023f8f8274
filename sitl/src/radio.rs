//! The radio gate: a command gets through in this interval, or the vehicle holds its last action.
//!
//! Knows packets and fates, not geometry: whether the interval carried a packet is an argument.
//!
//! | fate | what happened |
//! |---|---|
//! | delivered | flown in the first interval after it was computed |
//! | delayed | flown later: it waited (rule `queue`) or came late to the transmitter |
//! | superseded | never flown: a newer command took its place before it got through |
//! | lost | never flown: dropped in an outage (rule `drop`), or still waiting when the flight ended |

use serde::{Deserialize, Serialize};

use crate::msg::{Command, Held, Plan, TxPower};
use crate::scenario::Rule;
use crate::units::Tick;

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

/// Transmitter of the base station and receiver of the vehicle, back to back.
#[derive(Debug, Clone)]
pub struct Gate {
    rule: Rule,
    power: TxPower,
    newest: Option<Tick>,
    pending: Option<Command>,
    received: Option<Command>,
    held: Option<Held>,
    fates: Fates,
}

impl Gate {
    /// A gate with low power and nothing heard yet.
    #[must_use]
    pub fn new(rule: Rule) -> Self {
        Self {
            rule,
            power: TxPower::Low,
            newest: None,
            pending: None,
            received: None,
            held: None,
            fates: Fates::default(),
        }
    }

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

    /// The plan of the packet that waits; an empty one if none does.
    #[must_use]
    pub fn waiting_plan(&self) -> Plan {
        self.pending.map(|packet| packet.plan).unwrap_or_default()
    }

    /// One control interval: the waiting packet gets through unless there is an outage, and the
    /// vehicle flies what it knows of this interval from the newest packet that tells of it.
    pub fn transmit(&mut self, now: Tick, outage: bool) {
        let blocked = outage && self.rule != Rule::Ideal;
        match (self.pending.take(), blocked) {
            (None, _) => {}
            (Some(packet), false) => {
                self.received = Some(self.received.map_or(packet, |older| packet.over(&older)));
                if packet.tick == now {
                    self.fates.delivered += 1;
                } else {
                    self.fates.delayed += 1;
                }
            }
            (Some(packet), true) if self.rule == Rule::Queue => self.pending = Some(packet),
            (Some(_), true) => self.fates.lost += 1,
        }
        self.held = self.received.map(|packet| Held { tick: packet.tick, accel: packet.accel_at(now) });
    }

    /// Forgets the held command and the one that waits, whose fate is then lost: the vehicle no longer
    /// takes commands of the station.
    pub fn release(&mut self) {
        self.fates.lost += u64::from(self.pending.take().is_some());
        (self.received, self.held) = (None, None);
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

    fn held_tick(gate: &Gate) -> Option<u64> {
        gate.held().map(|h| h.tick.0)
    }

    #[test]
    fn drop_holds_the_last_action_until_a_new_packet_arrives() {
        let mut gate = Gate::new(Rule::Drop);
        for (tick, outage, flown) in [(0, false, 0), (1, true, 0), (2, true, 0), (3, false, 3)] {
            gate.submit(command(tick));
            gate.transmit(Tick(tick), outage);
            assert_eq!(held_tick(&gate), Some(flown), "tick {tick}");
        }
        assert_eq!(gate.fates(), Fates { sent: 4, delivered: 2, lost: 2, ..Fates::default() });
    }

    #[test]
    fn an_outage_flies_the_plan_and_then_holds_its_last_action() {
        let mut gate = Gate::new(Rule::Drop);
        let mut planned = command(0);
        planned.plan.push([0.25, 0.0]);
        planned.plan.push([0.5, 0.0]);
        gate.submit(planned);
        assert_eq!(gate.waiting_plan(), planned.plan);
        for (tick, accel) in [(0, 0.0), (1, 0.25), (2, 0.5), (3, 0.5)] {
            gate.transmit(Tick(tick), tick > 0);
            assert_eq!(gate.held(), Some(Held { tick: Tick(0), accel: [accel, 0.0] }), "tick {tick}");
            gate.submit(command(tick + 1));
        }
        gate.transmit(Tick(4), false);
        assert_eq!(gate.held(), Some(Held { tick: Tick(4), accel: [4.0, 0.0] }));
    }

    #[test]
    fn a_short_plan_leaves_the_rest_of_a_longer_one() {
        let (mut long, mut short) = (command(0), command(1));
        for x in [10.0, 20.0, 30.0, 40.0] {
            long.plan.push([x, 0.0]);
        }
        short.plan.push([2.5, 0.0]);
        let mut gate = Gate::new(Rule::Drop);
        gate.submit(long);
        gate.transmit(Tick(0), false);
        gate.submit(short);
        for (tick, x) in [(1, 1.0), (2, 2.5), (3, 30.0), (4, 40.0), (5, 40.0)] {
            gate.transmit(Tick(tick), false);
            assert_eq!(gate.held(), Some(Held { tick: Tick(1), accel: [x, 0.0] }), "tick {tick}");
        }
    }

    #[test]
    fn queue_delays_a_packet_that_nothing_newer_replaces() {
        let mut gate = Gate::new(Rule::Queue);
        gate.submit(command(0));
        gate.transmit(Tick(0), true);
        gate.transmit(Tick(1), false);
        assert_eq!(held_tick(&gate), Some(0));
        assert_eq!(gate.fates(), Fates { sent: 1, delayed: 1, ..Fates::default() });
    }

    #[test]
    fn queue_supersedes_a_packet_when_a_newer_one_comes() {
        let mut gate = Gate::new(Rule::Queue);
        gate.submit(command(0));
        gate.transmit(Tick(0), true);
        gate.submit(command(1));
        gate.transmit(Tick(1), false);
        assert_eq!(held_tick(&gate), Some(1));
        assert_eq!(gate.fates(), Fates { sent: 2, delivered: 1, superseded: 1, ..Fates::default() });
    }

    #[test]
    fn a_repeat_is_not_a_second_packet_and_a_stale_one_is_ignored() {
        let mut gate = Gate::new(Rule::Drop);
        gate.submit(command(4));
        gate.submit(command(4));
        gate.transmit(Tick(4), true);
        gate.submit(command(4));
        gate.submit(Command { power: TxPower::High, ..command(3) });
        gate.transmit(Tick(5), false);
        assert_eq!((held_tick(&gate), gate.power()), (None, TxPower::Low));
        assert_eq!(gate.fates(), Fates { sent: 1, lost: 1, ..Fates::default() });
    }

    #[test]
    fn a_released_command_is_lost_and_not_held() {
        let mut gate = Gate::new(Rule::Ideal);
        gate.submit(command(0));
        gate.transmit(Tick(0), false);
        gate.submit(command(1));
        gate.release();
        gate.transmit(Tick(1), false);
        assert_eq!(gate.held(), None);
        assert_eq!(gate.fates(), Fates { sent: 2, delivered: 1, lost: 1, ..Fates::default() });
    }

    #[test]
    fn an_ideal_link_has_no_outage() {
        let mut gate = Gate::new(Rule::Ideal);
        gate.submit(command(0));
        gate.transmit(Tick(0), true);
        assert_eq!(gate.fates().delivered, 1);
    }
}
