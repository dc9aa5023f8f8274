//! What a station knows, told as lines of the feed. Runs beside the flight or after it, never in its way.

use std::collections::BTreeMap;
use std::sync::Arc;

use crpl_model::numeric::kernel::LANES;
use crpl_model::planning::config::OptimiseConfig;
use crpl_model::planning::outlook::{Outlook, OutlookStart};
use crpl_model::planning::problem::{PlanningProblem, PlanningState};
use crpl_model::world_model::{Affine, WorldModel};
use crpl_sitl::Scenario;
use crpl_sitl::camera::Frame;
use crpl_sitl::radio::message::{Command, Telemetry};
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::{Snr, Tick, TxPower};
use crpl_sitl::world::channel;
use crpl_sitl::world::noise::Noise;
use crpl_sitl::world::obstacles::Obstacles;
use nalgebra::{Matrix2, Vector2};
use serde_json::json;

use crate::station::belief::{Belief, CommandFate, Ledger};
use crate::station::pilot::foresight::{Foresight, PowerRule};
use crate::station::seen::Heard;
use crate::watch::feed::{Feed, ShownBelief, WatchEvent, rounded};
use crate::watch::picture;

/// Cells of a field's side.
const CELLS: usize = 48;

/// Intervals of an outlook: as many as the paper predicts.
const HORIZON: usize = 100;

/// Members of an outlook that are drawn; all of them count in its probabilities.
const DRAWN: usize = 8;

/// What a station knows at one tick.
#[derive(Debug, Clone)]
pub struct StationSight {
    /// The vehicle's report.
    pub telemetry: Telemetry,
    /// The answer to it; `None` to the last report of a flight.
    pub command: Option<Command>,
    /// The intervals that have ended since the last sight.
    pub records: Vec<Record>,
    /// What was seen and believed; `None` where it was left out.
    pub scene: Option<SeenScene>,
}

/// What is seen and believed at one tick.
#[derive(Debug, Clone)]
pub struct SeenScene {
    /// The picture as it was received.
    pub frame: Arc<Frame>,
    /// What the station makes of it, if it does.
    pub belief: Option<Belief>,
    /// How its controller goes on.
    pub foresight: Option<Foresight>,
}

/// Tells one vehicle's flight to feeds.
#[derive(Debug)]
pub struct Narrator {
    feeds: Vec<Feed>,
    vehicle: u32,
    scenario: Scenario,
    /// `None` where nobody believes anything.
    world: Option<Arc<WorldModel>>,
    /// `None` where the world model says nothing of the scenario.
    problem: Option<PlanningProblem>,
    noise: Noise,
    ledger: Ledger,
    sent: BTreeMap<Tick, Command>,
    field: Option<(Obstacles, TxPower)>,
}

impl Narrator {
    /// Of vehicle number `vehicle`.
    #[must_use]
    pub fn new(feeds: Vec<Feed>, vehicle: u32, scenario: &Scenario, world: Option<&Arc<WorldModel>>) -> Self {
        Self {
            feeds,
            vehicle,
            scenario: scenario.clone(),
            world: world.cloned(),
            problem: None,
            noise: Noise::new(0),
            ledger: Ledger::new(scenario.radio.rule),
            sent: BTreeMap::new(),
            field: None,
        }
    }

    fn send(&self, event: &WatchEvent) {
        Feed::send_to(&self.feeds, event);
    }

    /// Tells a sight.
    pub fn tell(&mut self, sight: StationSight) {
        let tick = sight.telemetry.tick.0;
        sight.records.iter().for_each(|record| self.interval(record));
        for (sent, fate) in self.ledger.hear(&Heard::from(&sight.telemetry)) {
            self.settled(sent, fate, Some(tick));
        }
        let Some(command) = sight.command else { return };
        self.ledger.send(command.tick);
        self.sent.insert(command.tick, command);
        self.field(tick, &sight.telemetry, command.power);
        let Some(scene) = sight.scene else { return };
        if let Some(picture) = picture(self.vehicle, tick, &scene.frame) {
            self.send(&picture);
        }
        if let Some(belief) = self.belief(tick, &scene) {
            self.send(&WatchEvent::Belief(Box::new(belief)));
        }
    }

    /// The flight is over: what was not heard of is lost.
    pub fn finish(&mut self) {
        let open: Vec<Tick> = self.sent.keys().copied().collect();
        open.into_iter().for_each(|tick| self.settled(tick, CommandFate::Lost, None));
    }

    /// The record's own keys, the vehicle and the rate.
    fn interval(&self, record: &Record) {
        let snr = Snr::from_db(f64::from(record.snr_db));
        let rate = channel::bits(self.scenario.radio.b_dt, snr);
        let Ok(mut line) = serde_json::to_value(record) else { return };
        line["vehicle"] = self.vehicle.into();
        line["rate"] = json!(rounded(rate, 4));
        self.send(&WatchEvent::Tick(line));
    }

    fn settled(&mut self, sent: Tick, fate: CommandFate, arrived: Option<u64>) {
        let Some(command) = self.sent.remove(&sent) else { return };
        let scale = &self.scenario.scale;
        let wish = scale.paper_from_ned_acceleration(command.accel) / self.scenario.dynamics.a_max;
        self.send(&WatchEvent::Command {
            vehicle: self.vehicle,
            tick: sent.0,
            wish: [rounded(wish.x, 4), rounded(wish.y, 4)],
            power: command.power.level(),
            fate: fate.name(),
            arrived,
        });
    }

    /// The SNR everywhere, if something has changed it.
    fn field(&mut self, tick: u64, telemetry: &Telemetry, power: TxPower) {
        let obstacles = telemetry.obstacles(&self.scenario.scale);
        if self.field.as_ref() == Some(&(obstacles, power)) {
            return;
        }
        let at = |cell: usize| (cell as f64 + 0.5) / CELLS as f64;
        let snr = |row: usize, column: usize| {
            let gain = obstacles.gain(Vector2::new(at(column), at(row)), &self.scenario);
            rounded(channel::snr(gain, power.level(), &self.scenario.channel).to_db(), 1)
        };
        let snr_db = (0..CELLS * CELLS).map(|cell| snr(cell / CELLS, cell % CELLS)).collect();
        let (vehicle, power_level) = (self.vehicle, power.level());
        self.send(&WatchEvent::Field { vehicle, tick, power: power_level, n: CELLS, snr_db });
        self.field = Some((obstacles, power));
    }

    fn belief(&mut self, tick: u64, scene: &SeenScene) -> Option<ShownBelief> {
        let (world, believed) = (self.world.clone()?, scene.belief.as_ref()?);
        let (estimate, u) = believed.estimates()?;
        let certainty = believed.controllable().certainty()?;
        let probe = world.probe;
        let sigma = deviations(&probe.c, &certainty.y);
        let obstacles = u.iter().map(|u| shown(&probe.u, u.y, 4));
        let mut belief = ShownBelief {
            vehicle: self.vehicle,
            tick,
            position: shown(&probe.c, estimate.y, 4),
            sigma: sigma.map(|s| rounded(s, 6)),
            obstacles: obstacles.collect(),
            lost: certainty.disagrees,
            fan: Vec::new(),
            snr_db: Vec::new(),
            outage: Vec::new(),
            risk: Vec::new(),
        };
        let y_u = u.iter().map(|u| [u.y, u.before()].map(narrow)).collect();
        let still = Matrix2::zeros();
        let start = OutlookStart {
            state: PlanningState { y_c: [estimate.y, estimate.before()].map(narrow), y_u },
            spread: [certainty.y, if certainty.moving { certainty.v } else { still }],
            reported_obstacle: scene.foresight.as_ref().and_then(|foresight| foresight.reported_obstacle),
        };
        if let Some(foresight) = scene.foresight.as_ref().filter(|_| !u.is_empty()) {
            self.look_ahead(&world, tick, foresight, &start, &mut belief);
        }
        Some(belief)
    }

    /// Adds the rollout under the controller's policy.
    fn look_ahead(
        &mut self,
        world: &WorldModel,
        tick: u64,
        foresight: &Foresight,
        start: &OutlookStart,
        belief: &mut ShownBelief,
    ) {
        if self.problem.is_none() {
            // The scenario's own gusts, not those that a policy is hardened by.
            let config =
                OptimiseConfig { starts: 1, gust_std: 0.0, gust_factor: 1.0, ..OptimiseConfig::default() };
            self.problem = PlanningProblem::of(world, &self.scenario, &config, 0).ok();
        }
        let Some(problem) = &self.problem else { return };
        let motion = &foresight.policies.motion;
        let outlook = problem.outlook(motion, start, &self.noise, tick, HORIZON);
        let place = |y: [f32; 2]| shown(&world.probe.c, Vector2::new(y[0].into(), y[1].into()), 3);
        belief.fan = (0..DRAWN).map(|m| outlook.y_c.iter().map(|y| place(y[m])).collect()).collect();
        let mean = |values: &[f32; LANES]| values.iter().map(|v| f64::from(*v)).sum::<f64>() / LANES as f64;
        belief.risk = outlook.risk.iter().map(|p| rounded(mean(p), 4)).collect();
        let radio = &self.scenario.radio;
        for (gain, power) in outlook.gain.iter().zip(powers(foresight, &outlook)) {
            let snr = |gain: f32| Snr(f64::from(gain) * power.level());
            let lost = gain.iter().filter(|g| channel::outage(radio.b_dt, snr(**g), radio.packet_bits));
            belief.outage.push(rounded(lost.count() as f64 / LANES as f64, 3));
            belief.snr_db.push(rounded(snr(gain[0]).to_db(), 2));
        }
    }
}

/// The power in each interval, as the controller chooses it on the mean path.
fn powers(foresight: &Foresight, outlook: &Outlook) -> Vec<TxPower> {
    let steps = outlook.features.iter().zip(&outlook.gain);
    steps
        .map(|(features, gain)| match foresight.power {
            PowerRule::Policy => foresight.policies.act(features).1,
            PowerRule::Matched(rule) => rule.for_snr(f64::from(gain[0])),
        })
        .collect()
}

fn narrow(y: Vector2<f64>) -> [f32; 2] {
    [y.x as f32, y.y as f32]
}

/// A place of the plane in the unit square.
fn shown(map: &Affine, y: Vector2<f64>, digits: i32) -> [f64; 2] {
    let r = map.apply(y);
    [rounded(r.x, digits), rounded(r.y, digits)]
}

/// Standard deviations along x and y of a place whose plane coordinates have this covariance.
fn deviations(map: &Affine, covariance: &Matrix2<f64>) -> [f64; 2] {
    let there = map.matrix * covariance * map.matrix.transpose();
    [there[(0, 0)], there[(1, 1)]].map(|variance| variance.max(0.0).sqrt())
}
