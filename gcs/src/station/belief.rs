//! What the station believes: the latents of the last frames, and what became of its commands.
//!
//! The latents come from frames, and their speed from the actions that the vehicle says it flew, by
//! the learned predictor; the ledger from those reports alone. Neither knows the vehicle's position.

use std::collections::BTreeMap;

use crpl_model::predictor::observer::LatentObserver;
use crpl_model::world_model::WorldModel;
use crpl_sitl::camera::{COLOURS, Frame};
use crpl_sitl::radio::Fates;
use crpl_sitl::radio::message::Held;
use crpl_sitl::scenario::Rule;
use crpl_sitl::units::Tick;
use crpl_sitl::world::obstacles::PerObstacle;
use nalgebra::Vector2;

use super::seen::{BeliefConfig, Heard};

/// Missed percepts beyond which the gap's length no longer matters: longer than any window.
const MAX_MISSED: u64 = 100;

/// What the observer makes of the last frames, in plane coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Latents {
    /// y_c at the newest frame.
    pub y_c: [f32; 2],
    /// y_c one interval earlier.
    pub y_c_before: [f32; 2],
    /// y_u of each obstacle at the newest frame; at most [`COLOURS`] are told apart.
    pub y_u: PerObstacle<[f32; 2]>,
}

impl Latents {
    /// y_u of the first obstacle, beside which policies are made; zeros in a world without any.
    #[must_use]
    pub fn first_y_u(&self) -> [f32; 2] {
        self.y_u.first().copied().unwrap_or_default()
    }
}

/// Latent history and ledger.
#[derive(Debug, Clone)]
pub struct Belief {
    controllable: LatentObserver,
    /// Of each obstacle that the frames tell apart.
    uncontrollable: Vec<LatentObserver>,
    /// Report that came with the newest frame.
    newest: Option<Heard>,
    latents: Latents,
    config: BeliefConfig,
    ledger: Ledger,
}

impl Belief {
    /// Nothing seen, nothing sent.
    #[must_use]
    pub fn new(world: &WorldModel, config: BeliefConfig) -> Self {
        let [c, u] = world.motions(config.limits.v_max, config.gust_std);
        let seen = config.obstacles.min(COLOURS);
        let window = config.window.max(world.least_window());
        Self {
            controllable: LatentObserver::new(c, window),
            uncontrollable: (0..seen).map(|_| LatentObserver::new(u.clone(), window)).collect(),
            newest: None,
            latents: Latents { y_u: (0..seen).map(|_| [0.0; 2]).collect(), ..Latents::default() },
            ledger: Ledger::new(config.rule),
            config,
        }
    }

    /// Takes in a frame and what was heard with it.
    pub fn observe(&mut self, world: &WorldModel, heard: &Heard, frame: &Frame) {
        let flown = self.flown(heard);
        let still = vec![Vector2::zeros(); flown.len()];
        let seen = match self.uncontrollable.len() {
            0 | 1 => vec![world.see(frame)],
            _ => frame.one_obstacle_each().iter().map(|frame| world.see(frame)).collect(),
        };
        for (observer, [_, u]) in self.uncontrollable.iter_mut().zip(&seen) {
            observer.observe(*u, &still);
        }
        if let Some([c, _]) = seen.first() {
            self.controllable.observe(*c, &flown);
        }
        let narrow = |y: Vector2<f64>| [y.x as f32, y.y as f32];
        let y_u = self.uncontrollable.iter().map(|u| Some(narrow(u.estimate()?.y))).collect::<Option<_>>();
        if let (Some(c), Some(y_u)) = (self.controllable.estimate(), y_u) {
            self.latents = Latents { y_c: narrow(c.y), y_c_before: narrow(c.before()), y_u };
        }
        self.newest = Some(*heard);
        self.ledger.hear(heard);
    }

    /// Normalised accelerations of the intervals since the newest frame, oldest first: what the
    /// vehicle says it flew, not what was sent. A command is flown from its own tick on.
    fn flown(&self, heard: &Heard) -> Vec<Vector2<f64>> {
        let Some(before) = self.newest else { return Vec::new() };
        let gap = heard.tick.0.saturating_sub(before.tick.0).min(MAX_MISSED);
        let normalised =
            |held: Held| self.config.scale.paper_from_ned_acceleration(held.accel) / self.config.limits.a_max;
        (heard.tick.0 - gap..heard.tick.0)
            .map(|tick| {
                let flown = heard.held.filter(|held| held.tick.0 <= tick).or(before.held);
                flown.map_or(Vector2::zeros(), normalised)
            })
            .collect()
    }

    /// The newest latents; zeros before the first frame.
    #[must_use]
    pub fn latents(&self) -> Latents {
        self.latents
    }

    /// The UAV's observer.
    #[must_use]
    pub fn controllable(&self) -> &LatentObserver {
        &self.controllable
    }

    /// Each obstacle's observer.
    #[must_use]
    pub fn uncontrollable(&self) -> &[LatentObserver] {
        &self.uncontrollable
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
pub enum CommandFate {
    /// Flown from its own interval on.
    Delivered,
    /// Flown later.
    Delayed,
    /// A newer one was flown before it.
    Superseded,
    /// Lost on the air.
    Lost,
}

impl CommandFate {
    /// Its name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Delivered => "delivered",
            Self::Delayed => "delayed",
            Self::Superseded => "superseded",
            Self::Lost => "lost",
        }
    }
}

/// What a command waits for.
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

    /// The vehicle's report at the start of a tick tells of the interval before it: the commands whose fate is known
    /// by now.
    pub fn hear(&mut self, heard: &Heard) -> Vec<(Tick, CommandFate)> {
        let mut told = Vec::new();
        let held = heard.held.map(|held| held.tick);
        if let Some(held) = held.filter(|held| self.flown.is_none_or(|flown| *held > flown)) {
            let later = self.open.split_off(&held.next());
            let settled = std::mem::replace(&mut self.open, later);
            for (tick, fate) in settled {
                let fate = match fate {
                    _ if tick == held && tick.next() == heard.tick => CommandFate::Delivered,
                    _ if tick == held => CommandFate::Delayed,
                    Fate::Waiting => CommandFate::Superseded,
                    Fate::Lost => CommandFate::Lost,
                };
                match fate {
                    CommandFate::Delivered => self.counts.delivered += 1,
                    CommandFate::Delayed => self.counts.delayed += 1,
                    CommandFate::Superseded => self.counts.superseded += 1,
                    CommandFate::Lost => self.counts.lost += 1,
                }
                told.push((tick, fate));
            }
            self.flown = Some(held);
        }
        // Rule `drop`: what was on the air in an outage is gone, unless the vehicle flies it yet.
        if self.rule == Rule::Drop
            && heard.link.is_some_and(|link| link.outage)
            && let Some((_, fate)) = self.open.range_mut(..heard.tick).next_back()
        {
            *fate = Fate::Lost;
        }
        told
    }

    /// The counts so far; what still waits counts as lost, as it would if the flight ended now.
    #[must_use]
    pub fn fates(&self) -> Fates {
        Fates { lost: self.counts.lost + self.open.len() as u64, ..self.counts }
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::Scenario;
    use crpl_sitl::radio::message::LinkReport;
    use crpl_sitl::units::TxPower;

    use super::*;

    fn report(tick: u64, held: Option<u64>, outage: bool) -> Heard {
        Heard {
            tick: Tick(tick),
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

    /// Flies by hand with gaps: places obey the actions that are reported as held.
    #[test]
    fn the_speed_is_right_under_held_actions_and_missed_percepts() {
        let world = WorldModel::embedded().unwrap();
        let mut scenario = Scenario::default();
        scenario.observer.window = 10;
        let mut belief = Belief::new(&world, BeliefConfig::of(&scenario));
        let (mut r, mut v) = (Vector2::new(0.3, 0.6), Vector2::new(0.004, -0.002));
        let mut held: Option<Held> = None;
        for tick in 0..25u64 {
            // An outage from 8 to 14: the command of tick 7 is held all through; percepts 18, 19 are missed.
            let lost = (8..14).contains(&tick);
            if ![18, 19].contains(&tick) {
                let frame = crpl_sitl::camera::render(r, scenario.obstacle().position, &scenario);
                belief.observe(&world, &Heard { held, ..report(tick, None, lost) }, &frame);
                let a =
                    Vector2::new((tick as f64).sin(), (tick as f64 * 0.6).cos()) * scenario.dynamics.a_max;
                let accel = scenario.scale.ned_from_paper_acceleration(a);
                held = if lost { held } else { Some(Held { tick: Tick(tick), accel }) };
            }
            let a = held.map_or(Vector2::zeros(), |h| scenario.scale.paper_from_ned_acceleration(h.accel));
            v += a;
            r += v;
        }
        let frame = crpl_sitl::camera::render(r, scenario.obstacle().position, &scenario);
        belief.observe(&world, &Heard { held, ..report(25, None, false) }, &frame);
        let Latents { y_c, y_c_before, .. } = belief.latents();
        let seen = [0, 1].map(|i| f64::from(y_c[i] - y_c_before[i]) / world.scale);
        let off = (Vector2::from(seen) - v).norm();
        assert!(off < 1e-4, "{seen:?} instead of {v}, off by {off}");
    }
}
