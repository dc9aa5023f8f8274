//! Exploratory flights: random accelerations that keep the UAV over the field, recorded picture by picture.
//!
//! [`Explorer`] chooses the acceleration from what the vehicle reports, so it flies a `Sim` in process and any
//! vehicle over a link alike. [`collect`] records whole episodes of `Sim`. Positions go into the recording's
//! `truth` folder, which no training opens.

use std::path::Path;

use crpl_sitl::Sim;
use crpl_sitl::camera::{CameraConfig, Film};
use crpl_sitl::radio::message::{Command, Telemetry};
use crpl_sitl::scenario::{Obstacle, Scenario};
use crpl_sitl::sim::Control;
use crpl_sitl::units::{Scale, TxPower};
use crpl_sitl::world::dynamics::State;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::numeric::tensors::TensorError;
use crate::world_model::dataset::{EDGE_BAND, OBSTACLE_SPEED, START_SPEED, direction};
use crate::world_model::recording::{RecordedEpisode, RecordingFormat, Step, Truth};

/// What is recorded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExplorationConfig {
    /// Episodes.
    pub episodes: usize,
    /// Pictures an episode.
    pub pictures: usize,
    /// Cameras by name or file, each with the share of the episodes that it records.
    pub cameras: Vec<(String, f64)>,
    /// Share of the episodes that begin within 0.04 of an edge, where the frame cuts the UAV's disc.
    pub edge: f64,
    /// Share of the episodes that begin at rest.
    pub rest: f64,
    /// Share of the episodes in which the obstacle stands still.
    pub still: f64,
    /// Standard deviation of the measured SNR's error, dB.
    pub snr_noise_db: f64,
    /// Share of the episodes whose base station stands anywhere; else it is the scenario's.
    pub other_stations: f64,
}

impl ExplorationConfig {
    /// The recording in a line, for a card.
    #[must_use]
    pub fn in_words(&self) -> String {
        let cameras: Vec<String> =
            self.cameras.iter().map(|(name, share)| format!("{name} {:.0} %", 100.0 * share)).collect();
        format!(
            "a recording: {} episodes of {} pictures, cameras {}, SNR with {} dB of error",
            self.episodes,
            self.pictures,
            cameras.join(", "),
            self.snr_noise_db
        )
    }
}

impl Default for ExplorationConfig {
    fn default() -> Self {
        Self {
            episodes: 720,
            pictures: 102,
            cameras: vec![("clean".into(), 0.2), ("hard".into(), 0.8)],
            edge: 0.25,
            rest: 0.3,
            still: 0.3,
            snr_noise_db: 0.5,
            other_stations: 0.25,
        }
    }
}

/// Chooses accelerations: uniform, but back towards the field where the UAV could not stop before its edge.
#[derive(Debug, Clone)]
pub struct Explorer {
    /// a_max, units per interval².
    a_max: f64,
    scale: Scale,
}

/// Distance from the field's edge at which the UAV must be able to stop, units.
const RESERVE: f64 = 0.01;

impl Explorer {
    /// For a vehicle of this scenario.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        Self { a_max: scenario.dynamics.a_max, scale: scenario.scale }
    }

    /// The next acceleration, share of a_max.
    pub fn next(&self, telemetry: &Telemetry, rng: &mut impl Rng) -> Vector2<f64> {
        let r = self.scale.paper_from_ned(telemetry.position);
        let v = self.scale.paper_from_ned_velocity(telemetry.velocity);
        Vector2::from_fn(|axis, _| {
            let free = rng.random_range(-1.0..=1.0);
            // Where it comes to rest if it brakes from the next interval on.
            let next = v[axis] + self.a_max * free;
            let stop = r[axis] + next + next * next.abs() / (2.0 * self.a_max);
            if stop < RESERVE {
                rng.random_range(0.5..=1.0)
            } else if stop > 1.0 - RESERVE {
                rng.random_range(-1.0..=-0.5)
            } else {
                free
            }
        })
    }
}

/// Records all episodes into a folder, in a format; `done` is called after each.
///
/// # Errors
/// If a file cannot be written.
pub fn collect(
    config: &ExplorationConfig,
    cameras: &[CameraConfig],
    scenario: &Scenario,
    seed: u64,
    (dir, format): (&Path, RecordingFormat),
    done: impl Fn() + Sync,
) -> Result<(), TensorError> {
    let all: Vec<usize> = (0..config.episodes).collect();
    collect_some(config, cameras, scenario, seed, (dir, format), &all, done)
}

/// The same, of these episodes alone.
///
/// # Errors
/// If a file cannot be written.
pub fn collect_some(
    config: &ExplorationConfig,
    cameras: &[CameraConfig],
    scenario: &Scenario,
    seed: u64,
    (dir, format): (&Path, RecordingFormat),
    episodes: &[usize],
    done: impl Fn() + Sync,
) -> Result<(), TensorError> {
    episodes.par_iter().copied().try_for_each(|index| {
        let (episode, truth) = record(config, cameras, scenario, seed, index as u64);
        episode.save_as(format, dir, index)?;
        truth.save(dir, index)?;
        done();
        Ok(())
    })
}

/// Episode `index`: a function of the arguments alone.
#[must_use]
pub fn record(
    config: &ExplorationConfig,
    cameras: &[CameraConfig],
    scenario: &Scenario,
    seed: u64,
    index: u64,
) -> (RecordedEpisode, Truth) {
    let mut rng = Noise::new(seed).generator(Stream::Data, (3 << 32) | index);
    let scenario = drawn(config, scenario, &mut rng);
    let camera = pick(config, cameras, &mut rng);
    let flight_seed = rng.random();
    let film = Film::new(&camera, flight_seed);
    let mut sim = Sim::new(scenario.clone(), flight_seed);
    let at_rest = rng.random::<f64>() < config.rest;
    let speed = if at_rest { 0.0 } else { START_SPEED * rng.random::<f64>() };
    sim.place(State { r: scenario.start, v: direction(&mut rng) * speed });
    let explorer = Explorer::new(&scenario);
    let power = if rng.random() { TxPower::Low } else { TxPower::High };

    let mut episode = RecordedEpisode {
        frames: vec![],
        actions: vec![],
        steps: vec![],
        a_max: scenario.dynamics.a_max,
        base_station: Some(scenario.channel.base_station),
    };
    let mut truth = Truth::default();
    for k in 0..config.pictures {
        let telemetry = sim.telemetry();
        let shake = film.shake(telemetry.tick) / crpl_sitl::camera::SIDE as f64;
        episode.frames.push(film.frame(telemetry.tick, &sim.world().poses(&scenario)));
        truth.uav.push(sim.world().uav.r + shake);
        truth.obstacle.push(sim.world().obstacles()[0] + shake);
        let error: f64 = StandardNormal.sample(&mut rng);
        let snr = sim.world().snr(power, &scenario).to_db() + config.snr_noise_db * error;
        episode.steps.push(Step {
            time_s: k as f64 * scenario.scale.interval_s,
            snr_db: snr as f32,
            power: power.level() as f32,
            outage: telemetry.link.is_some_and(|link| link.outage),
            contact: sim.contact().obstacle.is_some(),
        });
        if k + 1 == config.pictures {
            break;
        }
        let a = explorer.next(&telemetry, &mut rng);
        sim.set_control(Control::Onboard(a));
        sim.handle(Command::new(telemetry.tick, [0.0, 0.0], power));
        sim.advance();
        episode.actions.push(a.map(|a| a as f32));
    }
    (episode, truth)
}

/// The world of an episode.
fn drawn(config: &ExplorationConfig, base: &Scenario, rng: &mut impl Rng) -> Scenario {
    let mut scenario = base.clone();
    let mut start = Vector2::new(rng.random(), rng.random());
    if rng.random::<f64>() < config.edge {
        let axis = rng.random_range(0..2);
        let depth = EDGE_BAND * rng.random::<f64>();
        start[axis] = if rng.random() { depth } else { 1.0 - depth };
    }
    scenario.start = start;
    let anywhere = Vector2::new(rng.random(), rng.random());
    if rng.random::<f64>() < config.other_stations {
        scenario.channel.base_station = anywhere;
    }
    let Obstacle { margin, radius, .. } = base.obstacles.first().cloned().unwrap_or_default();
    let place = Vector2::from_fn(|_, _| margin + (1.0 - 2.0 * margin) * rng.random::<f64>());
    let stands = rng.random::<f64>() < config.still;
    let velocity = direction(rng) * if stands { 0.0 } else { OBSTACLE_SPEED };
    scenario.obstacles = vec![Obstacle { position: place, velocity, radius, margin }];
    scenario
}

/// One of the cameras, by their shares.
fn pick(config: &ExplorationConfig, cameras: &[CameraConfig], rng: &mut impl Rng) -> CameraConfig {
    let total: f64 = config.cameras.iter().map(|(_, share)| share).sum();
    let mut left = total * rng.random::<f64>();
    for ((_, share), camera) in config.cameras.iter().zip(cameras) {
        left -= share;
        if left < 0.0 {
            return camera.clone();
        }
    }
    cameras.last().cloned().unwrap_or_default()
}
