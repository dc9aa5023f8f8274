//! A scenario seen through the encoder: what Algorithm 1 knows of it. The only place state that draws
//! frames.

use crpl_sitl::scenario::{Cost, Obstacle};
use crpl_sitl::world::dynamics::limit_speed;
use crpl_sitl::world::noise::{Noise, Stream};
use crpl_sitl::world::obstacles::PerObstacle;
use crpl_sitl::world::safety;
use crpl_sitl::{Scenario, camera};
use nalgebra::Vector2;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::numeric::kernel::{LANES, Lane, ZERO};
use crate::planning::area::Area;
use crate::planning::config::{HeadSource, OptimiseConfig, OptimiseError};
use crate::planning::exact::{Exact, Quantity};
use crate::planning::head::Head;
use crate::planning::plant::{Draws, Edge, Objective, Plant};
use crate::planning::scope;
use crate::world_model::sight::FrameEncoder;
use crate::world_model::{StationHeads, WorldModel, checkpoint};

/// What the world model must provide: plane coordinates of UAV and obstacle at these places, paper units.
pub type Encode<'a> = dyn Fn(Vector2<f64>, Vector2<f64>) -> ([f32; 2], [f32; 2]) + Sync + 'a;

/// A belief to plan from: plane coordinates, each now and one interval ago.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanningState {
    /// y_c
    pub y_c: [[f32; 2]; 2],
    /// y_u of each obstacle
    pub y_u: PerObstacle<[[f32; 2]; 2]>,
}

/// A scenario seen through the encoder: start pairs, obstacle places.
#[derive(Debug, Clone)]
pub struct PlanningProblem {
    pub(super) plant: Plant,
    /// Fingerprint of the world model.
    pub(super) world: String,
    /// (y_c at 0, y_c at -1)
    starts: Vec<([f32; 2], [f32; 2])>,
    /// y_u where the obstacle stands.
    pub(super) obstacle: [f32; 2],
    /// y_u of the displaced obstacles, seen from start to goal: `[to the left, to the right][displacement]`; the
    /// UAV then passes right, left.
    pub(super) displaced: [Vec<[f32; 2]>; 2],
    /// gust_std / a_max
    wind: f32,
    /// The weakest gusts of a rollout over these.
    wind_least: f32,
    /// The SNR that a packet of the scenario needs, linear.
    required_snr: f64,
    /// δ1 and δ2 of the scenario.
    tolerances: [f64; 2],
    /// Weights of its stage cost.
    cost: Cost,
}

/// Standard deviations of the collision probability's softness by which a start must be clear of the obstacle.
const CLEAR_START: f64 = 3.0;

impl PlanningProblem {
    /// The scenario as `world` sees it.
    ///
    /// # Errors
    /// If a head is not a 4-64-64-1 network.
    pub fn of(
        world: &WorldModel,
        scenario: &Scenario,
        config: &OptimiseConfig,
        seed: u64,
    ) -> Result<Self, OptimiseError> {
        let plant = plant(world, scenario, config)?;
        let encode = |uav: Vector2<f64>, obstacle: Vector2<f64>| match world.encoder {
            FrameEncoder::Centroid(_) => {
                let latent = world.encode(&camera::render(uav, obstacle, scenario));
                (world.y_c(&latent), world.y_u(&latent))
            }
            // One picture of it is off by a tenth of a pixel, two are off in speed by as much an interval. Its plane
            // is the picture's: no picture is needed.
            FrameEncoder::Learned(_) => world.latents_at(uav, obstacle),
        };
        let world = checkpoint::planning_fingerprint(world)?;
        Ok(Self { world, ..Self::new(plant, &encode, scenario, config, seed) })
    }

    /// Encodes what Algorithm 1 needs of a scenario. `plant`'s goal and corners are
    /// replaced by the encoded ones.
    #[must_use]
    pub fn new(
        mut plant: Plant,
        encode: &Encode<'_>,
        scenario: &Scenario,
        config: &OptimiseConfig,
        seed: u64,
    ) -> Self {
        let place = encode;
        let there = scenario.obstacle().position;
        plant.goal = place(scenario.goal, there).0;
        plant.corners = [place(Vector2::zeros(), there).0, place(Vector2::repeat(1.0), there).0];
        let corner = |x: f64, y: f64| place(scenario.start, Vector2::new(x, y)).1;
        let corners = |o: &Obstacle| {
            let (near, far) = (o.margin, 1.0 - o.margin);
            (corner(near, near), [corner(far, near), corner(near, far)])
        };
        let area = |o: &Obstacle| {
            let (origin, ends) = corners(o);
            Area::new(origin, ends)
        };
        plant.areas = scenario.obstacles.iter().map(area).collect();
        plant.limits = config.limits;
        let noise = Noise::new(seed);
        let starts = (0..config.starts as u64)
            .into_par_iter()
            .map(|n| {
                let mut rng = noise.generator(Stream::Start, n);
                let mut normal = |s: f64| {
                    let (x, y): (f64, f64) =
                        (StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng));
                    s * Vector2::new(x, y)
                };
                let r = start(scenario, || normal(config.start_spread[0]));
                let v = limit_speed(normal(config.start_spread[1]), scenario.dynamics.v_max);
                (place(r, there).0, place(r - v, there).0)
            })
            .collect();
        // Latents are affine in the obstacle's place, so that it can be displaced out of the frame.
        let displaced = {
            let (here, o) = (place(scenario.start, there).1, scenario.obstacle());
            let (origin, ends) = corners(o);
            let width = (1.0 - 2.0 * o.margin) as f32;
            let way = scenario.goal - scenario.start;
            let left = Vector2::new(-way.y, way.x) / way.norm().max(f64::MIN_POSITIVE);
            [1.0, -1.0].map(|sign| {
                let shift = |d: &f64| {
                    let by = (sign * *d * left).map(|x| x as f32) / width;
                    std::array::from_fn(|i| {
                        here[i] + (ends[0][i] - origin[i]) * by.x + (ends[1][i] - origin[i]) * by.y
                    })
                };
                config.displacements.iter().map(shift).collect()
            })
        };
        Self {
            obstacle: place(scenario.start, there).1,
            displaced,
            starts,
            wind: (config.gust_std.max(config.gust_factor * scenario.disturbance.gust_std())
                / scenario.dynamics.a_max) as f32,
            wind_least: config.gust_least as f32,
            world: String::new(),
            required_snr: scope::required_snr(scenario),
            tolerances: [scenario.safety.collision_tolerance, scenario.safety.outage_tolerance],
            cost: scenario.cost.clone(),
            plant,
        }
    }

    /// `base` with what the scenario asks for: the weights of its stage cost, the SNR that a packet needs times
    /// `headroom`, and the smaller of the scenario's and the base's tolerances.
    #[must_use]
    pub fn objective(&self, base: &Objective, headroom: f64) -> Objective {
        Objective {
            cost: self.cost.clone(),
            snr_min: headroom * self.required_snr,
            collision_tolerance: base.collision_tolerance.min(self.tolerances[0]),
            outage_tolerance: base.outage_tolerance.min(self.tolerances[1]),
            ..base.clone()
        }
    }

    /// The learned world with this scenario's goal.
    #[must_use]
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Rollouts that all begin at `state`, gusts by (seed, index).
    #[must_use]
    pub fn draws_from(
        &self,
        state: &PlanningState,
        noise: &Noise,
        index: u64,
        rollouts: usize,
        horizon: usize,
    ) -> Vec<Draws> {
        let lanes = |y: [f32; 2]| y.map(|v| [v; LANES]);
        (0..(rollouts / LANES) as u64)
            .map(|block| {
                let mut rng = noise.generator(Stream::Batches, (index << 16) | block);
                let mut lane = || -> Lane {
                    std::array::from_fn(|_| {
                        let z: f64 = StandardNormal.sample(&mut rng);
                        self.wind * z as f32
                    })
                };
                Draws {
                    start: state.y_c.map(lanes),
                    obstacles: state.y_u.iter().map(|y_u| y_u.map(lanes)).collect(),
                    reported_obstacle: Some(self.obstacle),
                    wind: (0..horizon).map(|_| [lane(), lane()]).collect(),
                    beyond: 0,
                    opening: Vec::new(),
                }
            })
            .collect()
    }

    /// Common random rollouts number `index`: equal for equal (seed, index), whoever asks.
    #[must_use]
    pub fn draws(
        &self,
        noise: &Noise,
        stream: Stream,
        index: u64,
        rollouts: usize,
        y_u: [f32; 2],
        horizon: usize,
    ) -> Vec<Draws> {
        let fixed = [[y_u[0]; LANES], [y_u[1]; LANES]];
        (0..(rollouts / LANES) as u64)
            .into_par_iter()
            .map(|block| {
                let mut rng = noise.generator(stream, (index << 16) | block);
                let mut start = [[ZERO; 2]; 2];
                for l in 0..LANES {
                    let (now, before) = self.starts[rng.random_range(0..self.starts.len())];
                    for i in 0..2 {
                        start[0][i][l] = now[i];
                        start[1][i][l] = before[i];
                    }
                }
                let strength: Lane = match self.wind_least {
                    1.0 => [self.wind; LANES],
                    least => std::array::from_fn(|_| self.wind * rng.random_range(least..=1.0)),
                };
                let mut lane = || -> Lane {
                    std::array::from_fn(|l| {
                        let z: f64 = StandardNormal.sample(&mut rng);
                        strength[l] * z as f32
                    })
                };
                let wind = (0..horizon).map(|_| [lane(), lane()]).collect();
                let obstacles = vec![[fixed, fixed]];
                Draws { start, obstacles, reported_obstacle: None, wind, beyond: 0, opening: Vec::new() }
            })
            .collect()
    }
}

/// A start near the scenario's, clear of the edge and of the obstacle; the scenario's own if there is none.
fn start(scenario: &Scenario, mut offset: impl FnMut() -> Vector2<f64>) -> Vector2<f64> {
    let least = scenario.safety.d_min + CLEAR_START * scenario.safety.softness;
    let inside = scenario.safety.edge_margin + CLEAR_START * scenario.safety.softness;
    let is_clear = |r: &Vector2<f64>| {
        let o = scenario.obstacle();
        r.iter().all(|x| (inside..=1.0 - inside).contains(x))
            && safety::clearance(*r, o.position, scenario.uav_radius, o.radius) >= least
    };
    let drawn = std::iter::repeat_with(|| scenario.start + offset()).take(20).find(is_clear);
    drawn.unwrap_or(scenario.start)
}

/// The learned world in plane coordinates; base station and noise power folded into the heads.
fn plant(world: &WorldModel, scenario: &Scenario, config: &OptimiseConfig) -> Result<Plant, OptimiseError> {
    let (collision, gain) = match config.heads {
        HeadSource::Learned => learned_heads(world, scenario)?,
        HeadSource::Exact => [Quantity::CollisionLogit, Quantity::LogGain]
            .map(|quantity| Head::exact(Exact::new(quantity, world.probe, scenario.clone())))
            .into(),
    };
    Ok(Plant {
        predictor: world.predictor.clone(),
        uncontrollable: world.uncontrollable(),
        scale: world.scale as f32,
        v_max: scenario.dynamics.v_max as f32,
        corners: [[f32::NEG_INFINITY; 2], [f32::INFINITY; 2]],
        edge: edge(world.scale, scenario, config),
        areas: Vec::new(),
        limits: config.limits,
        goal: [0.0; 2],
        collision,
        gain,
    })
}

/// The edge's risk in latent units of `scale` a unit of length.
fn edge(scale: f64, scenario: &Scenario, config: &OptimiseConfig) -> Option<Edge> {
    let margin = scenario.safety.edge_margin;
    (margin > 0.0)
        .then_some(Edge { margin: (scale * margin) as f32, softness: (scale * config.edge_softness) as f32 })
}

/// The world model's heads of risk and gain, the noise power folded in. Where the scenario's channel has another
/// shape than that of the training data, the gain is the simulator's equation.
fn learned_heads(world: &WorldModel, scenario: &Scenario) -> Result<(Head, Head), OptimiseError> {
    let StationHeads { collision, mut gain, sight } = world.station_heads(scenario);
    if let Some(last) = gain.layers.last_mut() {
        last.b.iter_mut().for_each(|b| *b -= (scenario.channel.noise_power as f32).ln());
    }
    let gain = if StationHeads::untrained(scenario).is_empty() {
        Head::new(gain, Some(sight)).ok_or(OptimiseError::Head("gain"))?
    } else {
        Head::exact(Exact::new(Quantity::LogGain, world.probe, scenario.clone()))
    };
    Ok((Head::new(collision, None).ok_or(OptimiseError::Head("collision"))?, gain))
}

#[cfg(test)]
mod tests;
