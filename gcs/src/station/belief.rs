//! What the station believes: the latents of the last frames, and what became of its commands.
//!
//! The latents come from frames, and their speed from the actions that the vehicle says it flew, by
//! the learned predictor; the ledger from those reports alone. Neither knows the vehicle's position.

use std::collections::BTreeMap;

use crpl_model::predictor::observer::{self, Estimate, LatentObserver};
use crpl_model::world_model::WorldModel;
use crpl_sitl::camera::{COLOURS, Frame};
use crpl_sitl::radio::Fates;
use crpl_sitl::radio::message::{Command, Held};
use crpl_sitl::scenario::Rule;
use crpl_sitl::units::Tick;
use crpl_sitl::world::obstacles::PerObstacle;
use nalgebra::Vector2;

use super::flight_log::ActionLog;
use super::seen::{BeliefConfig, Heard};
use super::sighting::Sighting;

/// Missed percepts beyond which the gap's length no longer matters: longer than any window. So many reports and
/// commands are remembered.
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
    /// Tick of the newest frame.
    seen: Option<Tick>,
    /// Estimates at the newest frame: of the UAV, and of each obstacle.
    estimates: Option<(Estimate, Vec<Estimate>)>,
    latents: Latents,
    config: BeliefConfig,
    ledger: Ledger,
    heard: ActionLog,
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
            uncontrollable: (0..seen)
                .map(|_| LatentObserver::new(u.clone(), window).remembering(observer::STEADY_MEMORY))
                .collect(),
            seen: None,
            estimates: None,
            latents: Latents { y_u: (0..seen).map(|_| [0.0; 2]).collect(), ..Latents::default() },
            ledger: Ledger::new(config.rule),
            config,
            heard: ActionLog::default(),
        }
    }

    /// Takes in a frame and what was heard with it.
    pub fn observe(&mut self, world: &WorldModel, heard: &Heard, frame: &Frame) {
        self.hear(heard);
        self.see(heard.tick, &Sighting::of(world, frame, self.config.obstacles));
    }

    /// Takes in what was heard, with or without a frame. A report that is older than the newest tells nothing new.
    pub fn hear(&mut self, heard: &Heard) {
        if self.heard.newest().is_none_or(|newest| heard.tick > newest.tick) {
            self.heard.add(*heard);
            self.ledger.hear(heard);
        }
    }

    /// Takes in what the frame of a tick shows, which may have come late: [`Belief::latents_at`] brings it up to
    /// date. A frame that is older than the newest is left out.
    pub fn see(&mut self, tick: Tick, sighting: &Sighting) {
        let flown = match self.seen {
            None => Vec::new(),
            Some(seen) if tick <= seen => return,
            Some(seen) => {
                let gap = (tick.0 - seen.0).min(MAX_MISSED);
                (tick.0 - gap..tick.0).map(|k| self.normalised(self.heard.flown(Tick(k)))).collect()
            }
        };
        let still = vec![Vector2::zeros(); flown.len()];
        for (observer, u) in self.uncontrollable.iter_mut().zip(&sighting.u) {
            observer.observe(*u, &still);
        }
        self.controllable.observe(sighting.c, &flown);
        if let Some((c, u)) = self.estimate() {
            self.latents = latents(c, &u);
            self.estimates = Some((c, u));
        }
        self.seen = Some(tick);
    }

    /// The UAV and each obstacle at the newest frame; `None` before the first.
    fn estimate(&self) -> Option<(Estimate, Vec<Estimate>)> {
        let mut u = self.uncontrollable.iter().map(LatentObserver::estimate).collect::<Option<Vec<_>>>()?;
        // A camera that shakes moves all bodies alike: the first obstacle tells by how much.
        let steady =
            self.uncontrollable.first().and_then(|first| observer::steadied(&self.controllable, first));
        match (steady, u.first_mut()) {
            (Some((c, way)), Some(first)) => {
                *first = way;
                Some((c, u))
            }
            _ => Some((self.controllable.estimate()?, u)),
        }
    }

    /// Normalised acceleration.
    fn normalised(&self, held: Option<Held>) -> Vector2<f64> {
        held.map_or(Vector2::zeros(), |held| {
            self.config.scale.paper_from_ned_acceleration(held.accel) / self.config.limits.a_max
        })
    }

    /// The normalised accelerations of the intervals from `from` to `now`: what the vehicle says it flew, and after
    /// its newest report what it flies if the radio goes on as it was there.
    #[must_use]
    pub fn actions(&self, from: Tick, now: Tick) -> Vec<Vector2<f64>> {
        let first = from.0.max(now.0.saturating_sub(MAX_MISSED));
        (first..now.0).map(|k| self.normalised(self.heard.expected(Tick(k)))).collect()
    }

    /// The newest latents; zeros before the first frame.
    #[must_use]
    pub fn latents(&self) -> Latents {
        self.latents
    }

    /// The latents at the start of tick `now`: those of the newest frame, and if it is older than that, what the
    /// predictor makes of it and of the actions since then.
    #[must_use]
    pub fn latents_at(&self, now: Tick) -> Latents {
        let (Some(seen), Some((c, u))) = (self.seen, &self.estimates) else { return self.latents };
        if seen >= now {
            return self.latents;
        }
        let flown = self.actions(seen, now);
        let still = vec![Vector2::zeros(); flown.len()];
        let u: Vec<_> =
            self.uncontrollable.iter().zip(u).map(|(observer, u)| observer.ahead(*u, &still)).collect();
        latents(self.controllable.ahead(*c, &flown), &u)
    }

    /// Tick of the newest frame.
    #[must_use]
    pub fn seen(&self) -> Option<Tick> {
        self.seen
    }

    /// The UAV and each obstacle at the newest frame; `None` before the first.
    #[must_use]
    pub fn estimates(&self) -> Option<(Estimate, &[Estimate])> {
        self.estimates.as_ref().map(|(c, u)| (*c, u.as_slice()))
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

    /// A command goes out.
    pub fn send(&mut self, command: &Command) {
        self.ledger.send(command.tick);
        self.heard.send(command);
    }
}

fn latents(c: Estimate, u: &[Estimate]) -> Latents {
    let narrow = |y: Vector2<f64>| [y.x as f32, y.y as f32];
    Latents { y_c: narrow(c.y), y_c_before: narrow(c.before()), y_u: u.iter().map(|u| narrow(u.y)).collect() }
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
    use crpl_model::encoder::BuiltIn;

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

    /// A frame that comes late, and reports without one: the belief is where the UAV is now.
    #[test]
    fn a_late_frame_is_rolled_forward_by_the_actions_flown() {
        let world = WorldModel::embedded().unwrap();
        let scenario = Scenario::default();
        let mut belief = Belief::new(&world, BeliefConfig::of(&scenario));
        let (mut r, mut v) = (Vector2::new(0.3, 0.7), Vector2::zeros());
        let mut frames = Vec::new();
        let mut held = None;
        for tick in 0..30u64 {
            frames.push(crpl_sitl::camera::render(r, scenario.obstacle().position, &scenario));
            belief.hear(&Heard { held, ..report(tick, None, false) });
            // Every third frame arrives, five intervals late.
            if tick >= 5 && tick % 3 == 0 {
                let old = Tick(tick - 5);
                belief.see(old, &Sighting::of(&world, &frames[old.0 as usize], 1));
            }
            let truth = world.encode(frames.last().unwrap());
            if tick > 12 {
                let off =
                    |y: [f32; 2], z: [f32; 2]| f64::from((y[0] - z[0]).hypot(y[1] - z[1])) / world.scale;
                let now = belief.latents_at(Tick(tick));
                assert!(off(now.y_c, world.y_c(&truth)) < 1e-3, "tick {tick}: {now:?}");
                assert!(off(now.y_u[0], world.y_u(&truth)) < 1e-3, "tick {tick}: {now:?}");
                assert!(off(belief.latents().y_c, world.y_c(&truth)) > 5e-3, "tick {tick}: it moves");
            }
            let a =
                Vector2::new((tick as f64 * 0.5).sin(), (tick as f64 * 0.4).cos()) * scenario.dynamics.a_max;
            let accel = scenario.scale.ned_from_paper_acceleration(a);
            belief.send(&Command::new(Tick(tick), accel, TxPower::Low));
            held = Some(Held { tick: Tick(tick), accel });
            v += scenario.scale.paper_from_ned_acceleration(accel);
            r += v;
        }
        // An old frame changes nothing.
        let now = belief.latents();
        belief.see(Tick(3), &Sighting::of(&world, &frames[3], 1));
        assert_eq!(belief.latents(), now);
    }

    /// Flies by hand with gaps: places obey the actions that are reported as held.
    #[test]
    fn the_speed_is_right_under_held_actions_and_missed_percepts() {
        let world = WorldModel::built_in(BuiltIn::Centroid).unwrap();
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
