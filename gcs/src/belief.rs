//! What the station believes: the latents of the last pictures, and what became of its commands.
//!
//! The latents come from pictures alone; the ledger from what the vehicle says it flies. Neither
//! knows the physics.

use std::collections::BTreeMap;

use model::world_model::WorldModel;
use sitl::camera::Frame;
use sitl::msg::Telemetry;
use sitl::radio::Fates;
use sitl::scenario::Rule;
use sitl::units::Tick;

/// The latest latents in plane coordinates: M = 2 pictures.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Latents {
    /// y_c of the newest picture.
    pub y_c: [f32; 2],
    /// y_c one interval earlier.
    pub y_c_before: [f32; 2],
    /// y_u of the newest picture.
    pub y_u: [f32; 2],
}

/// Latent history and ledger.
#[derive(Debug, Clone)]
pub struct Belief {
    newest: Option<(Tick, Latents)>,
    ledger: Ledger,
}

impl Belief {
    /// Nothing seen, nothing sent.
    #[must_use]
    pub fn new(rule: Rule) -> Self {
        Self { newest: None, ledger: Ledger::new(rule) }
    }

    /// Takes in a picture and the report that came with it.
    pub fn observe(&mut self, world: &WorldModel, telemetry: &Telemetry, frame: &Frame) {
        let latent = world.encode(frame);
        let (y_c, y_u) = (world.y_c(&latent), world.y_u(&latent));
        let y_c_before = match self.newest {
            // Pictures may be missing in real time: the speed is then the mean over the gap.
            Some((tick, then)) if telemetry.tick > tick => {
                let gap = (telemetry.tick.0 - tick.0) as f32;
                std::array::from_fn(|i| y_c[i] - (y_c[i] - then.y_c[i]) / gap)
            }
            Some((_, then)) => then.y_c_before,
            None => y_c,
        };
        self.newest = Some((telemetry.tick, Latents { y_c, y_c_before, y_u }));
        self.ledger.hear(telemetry);
    }

    /// The newest latents; zeros before the first picture.
    #[must_use]
    pub fn latents(&self) -> Latents {
        self.newest.map(|(_, latents)| latents).unwrap_or_default()
    }

    /// The ledger.
    #[must_use]
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// The ledger, to write down what is sent and heard.
    pub fn ledger_mut(&mut self) -> &mut Ledger {
        &mut self.ledger
    }
}

/// What became of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    Waiting,
    Lost,
}

/// Every command's fate, told from the tick of the command that the vehicle says it flies.
#[derive(Debug, Clone)]
pub struct Ledger {
    rule: Rule,
    open: BTreeMap<Tick, Fate>,
    flown: Option<Tick>,
    counts: Fates,
}

impl Ledger {
    /// An empty ledger of a link with this rule.
    #[must_use]
    pub fn new(rule: Rule) -> Self {
        Self { rule, open: BTreeMap::new(), flown: None, counts: Fates::default() }
    }

    /// A command for `tick` goes out. A repeat changes nothing.
    pub fn send(&mut self, tick: Tick) {
        if self.flown.is_none_or(|flown| tick > flown) && !self.open.contains_key(&tick) {
            self.counts.sent += 1;
            self.open.insert(tick, Fate::Waiting);
        }
    }

    /// The vehicle's report at the start of a tick tells of the interval before it.
    pub fn hear(&mut self, telemetry: &Telemetry) {
        let held = telemetry.held.map(|held| held.tick);
        if let Some(held) = held.filter(|held| self.flown.is_none_or(|flown| *held > flown)) {
            let later = self.open.split_off(&held.next());
            let settled = std::mem::replace(&mut self.open, later);
            for (tick, fate) in settled {
                match fate {
                    _ if tick == held && tick.next() == telemetry.tick => self.counts.delivered += 1,
                    _ if tick == held => self.counts.delayed += 1,
                    Fate::Waiting => self.counts.superseded += 1,
                    Fate::Lost => self.counts.lost += 1,
                }
            }
            self.flown = Some(held);
        }
        // Rule `drop`: what was on the air in an outage is gone, unless the vehicle flies it yet.
        if self.rule == Rule::Drop
            && telemetry.link.is_some_and(|link| link.outage)
            && let Some((_, fate)) = self.open.range_mut(..telemetry.tick).next_back()
        {
            *fate = Fate::Lost;
        }
    }

    /// The counts so far; what still waits counts as lost, as it would if the flight ended now.
    #[must_use]
    pub fn fates(&self) -> Fates {
        Fates { lost: self.counts.lost + self.open.len() as u64, ..self.counts }
    }
}

#[cfg(test)]
mod tests {
    use sitl::msg::{Held, LinkReport, TxPower};

    use super::*;

    fn report(tick: u64, held: Option<u64>, outage: bool) -> Telemetry {
        Telemetry {
            tick: Tick(tick),
            position: [0.0; 2],
            velocity: [0.0; 2],
            obstacle: [0.0; 2],
            held: held.map(|t| Held { tick: Tick(t), accel: [0.0; 2] }),
            link: Some(LinkReport { snr_db: 0.0, power: TxPower::Low, outage }),
        }
    }

    fn story(rule: Rule, reports: &[(u64, Option<u64>, bool)]) -> Fates {
        let mut ledger = Ledger::new(rule);
        for (tick, held, outage) in reports {
            ledger.send(Tick(tick - 1));
            ledger.send(Tick(tick - 1));
            ledger.hear(&report(*tick, *held, *outage));
        }
        ledger.fates()
    }

    #[test]
    fn a_dropped_command_is_lost_and_a_queued_one_superseded() {
        let reports = [(1, Some(0), false), (2, Some(0), true), (3, Some(0), true), (4, Some(3), false)];
        let drop = story(Rule::Drop, &reports);
        assert_eq!(drop, Fates { sent: 4, delivered: 2, lost: 2, ..Fates::default() });
        let queue = story(Rule::Queue, &reports);
        assert_eq!(queue, Fates { sent: 4, delivered: 2, superseded: 2, ..Fates::default() });
    }

    #[test]
    fn a_command_flown_later_is_delayed() {
        let mut ledger = Ledger::new(Rule::Queue);
        ledger.send(Tick(0));
        ledger.hear(&report(1, None, true));
        ledger.hear(&report(2, Some(0), false));
        assert_eq!(ledger.fates(), Fates { sent: 1, delayed: 1, ..Fates::default() });
    }
}
