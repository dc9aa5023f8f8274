//! What an encoder is worth case by case: every camera with a name, fresh pictures of the same scenes' kind.
//!
//! Positions are decoded as a ground station does it, with the model's own probe (for the learned encoder plain
//! geometry): nothing is fitted to a case. Errors are l1 in px, in picture coordinates.

use crpl_sitl::camera::cases::{CASES, Placement};
use crpl_sitl::camera::{Body, CameraConfig, Film, Poses, SIDE};
use crpl_sitl::program::columns;
use crpl_sitl::scenario::Scenario;
use crpl_sitl::units::Tick;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::encoder::probe::r_squared;
use crate::encoder::weights::LATENT;
use crate::numeric::statistics::quantile;
use crate::world_model::WorldModel;
use crate::world_model::dataset::{EDGE_BAND, OBSTACLE_SPEED, START_SPEED, direction};

/// Error beyond which a body is lost, px.
pub const LOST_PX: f64 = 3.0;

/// Pictures of one drawn camera: the next ones show other colours and another ground.
const PER_CAMERA: usize = 6;

/// The UAV is within this distance of the obstacle's rim in the case `over`, units.
const OVER: f64 = 0.06;

/// Errors in one case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HardRow {
    /// Name of the camera.
    pub case: String,
    /// What is hard about it.
    pub about: String,
    /// UAV, 90 % quantile.
    pub z_c_p90_px: f64,
    /// Obstacle, 90 % quantile.
    pub z_u_p90_px: f64,
    /// UAV, median.
    pub z_c_p50_px: f64,
    /// Obstacle, median.
    pub z_u_p50_px: f64,
    /// Share of the pictures in which either body is more than 3 px off.
    pub lost: f64,
    /// The same of the UAV alone.
    pub lost_c: f64,
    /// The same of the obstacle alone.
    pub lost_u: f64,
    /// Median error of the UAV's decoded place: column, row; what a constant offset would be.
    pub offset_c_px: [f64; 2],
    /// The same of the obstacle's.
    pub offset_u_px: [f64; 2],
}

/// Errors and leakage over all cases.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HardReport {
    /// A row a case.
    pub hard: Vec<HardRow>,
    /// R² of the obstacle's place from z_c by an affine map, on the camera `hard`.
    pub leak_c_to_u: f64,
    /// R² of the UAV's place from z_u.
    pub leak_u_to_c: f64,
}

/// One picture's outcome.
struct ReadPicture {
    errors: [Vector2<f64>; 2],
    truth: [Vector2<f64>; 2],
    z: [[f32; LATENT]; 2],
}

/// Measures all cases, `count` pictures each.
#[must_use]
pub fn measure(model: &WorldModel, count: usize, scenario: &Scenario, noise: &Noise) -> HardReport {
    let mut leaks = [0.0; 2];
    let rows = CASES
        .iter()
        .enumerate()
        .map(|(n, case)| {
            let Ok(config) = case.config() else { return row(case.name, case.about, &[]) };
            let looks = looks(model, n, (case.placement, &config), count, scenario, noise);
            if case.name == "hard" {
                let of = |body: usize| looks.iter().map(|l| l.z[body]).collect::<Vec<_>>();
                let at = |body: usize| looks.iter().map(|l| l.truth[body]).collect::<Vec<_>>();
                leaks = [r_squared(&of(0), &at(1)), r_squared(&of(1), &at(0))];
            }
            row(case.name, case.about, &looks)
        })
        .collect();
    HardReport { hard: rows, leak_c_to_u: leaks[0], leak_u_to_c: leaks[1] }
}

/// Errors with one more camera, bodies anywhere whole.
#[must_use]
pub fn of_camera(
    model: &WorldModel,
    name: &str,
    config: &CameraConfig,
    count: usize,
    scenario: &Scenario,
    noise: &Noise,
) -> HardRow {
    row(name, "as given", &looks(model, CASES.len(), (Placement::Whole, config), count, scenario, noise))
}

/// Pictures of case `n`.
fn looks(
    model: &WorldModel,
    n: usize,
    (placement, config): (Placement, &CameraConfig),
    count: usize,
    scenario: &Scenario,
    noise: &Noise,
) -> Vec<ReadPicture> {
    let films = count.div_ceil(PER_CAMERA);
    let looks = (0..films).into_par_iter().flat_map_iter(|film| {
        let mut rng = noise.generator(Stream::Evaluation, (1 << 40) | ((n as u64) << 20) | film as u64);
        let camera = Film::new(config, rng.random());
        let radius = scenario.obstacle().radius * camera.obstacle_scale();
        (0..PER_CAMERA.min(count - film * PER_CAMERA))
            .map(|k| {
                let [uav, obstacle] = place(placement, radius, scenario, &mut rng);
                let speed = START_SPEED * rng.random::<f64>();
                let body = |position, velocity, radius| Body { position, velocity, radius };
                let poses = Poses {
                    uav: body(uav, direction(&mut rng) * speed, scenario.uav_radius),
                    obstacles: [body(
                        obstacle,
                        direction(&mut rng) * OBSTACLE_SPEED,
                        scenario.obstacle().radius,
                    )]
                    .into_iter()
                    .collect(),
                };
                let tick = Tick(20 * k as u64);
                let latent = model.encode(&camera.frame(tick, &poses));
                let shake = camera.shake(tick) / SIDE as f64;
                let truth = [uav + shake, obstacle + shake];
                let errors = [model.uav(&latent) - truth[0], model.obstacle(&latent) - truth[1]];
                let px = SIDE as f64;
                ReadPicture { errors: errors.map(|e| e * px), truth, z: [latent.z_c, latent.z_u] }
            })
            .collect::<Vec<_>>()
    });
    looks.collect()
}

/// Where both bodies are, as the case wants it.
fn place(placement: Placement, radius: f64, scenario: &Scenario, rng: &mut impl Rng) -> [Vector2<f64>; 2] {
    let margin = scenario.obstacle().margin;
    loop {
        let uav = Vector2::new(rng.random::<f64>(), rng.random::<f64>());
        let obstacle = Vector2::from_fn(|_, _| margin + (1.0 - 2.0 * margin) * rng.random::<f64>());
        let depth = uav.iter().map(|x| x.min(1.0 - x)).fold(1.0, f64::min);
        let good = match placement {
            Placement::Anywhere => true,
            Placement::Whole => depth >= EDGE_BAND,
            Placement::Cut => depth < EDGE_BAND,
            Placement::Over => depth >= EDGE_BAND && (uav - obstacle).norm() < radius + OVER,
        };
        if good {
            return [uav, obstacle];
        }
    }
}

fn row(case: &str, about: &str, looks: &[ReadPicture]) -> HardRow {
    let l1 = |body: usize| looks.iter().map(|l| l.errors[body].abs().sum()).collect::<Vec<f64>>();
    let (c, u) = (l1(0), l1(1));
    let share = |lost: &dyn Fn(usize) -> bool| {
        (0..looks.len()).filter(|n| lost(*n)).count() as f64 / looks.len().max(1) as f64
    };
    let offset = |body: usize| {
        [0, 1].map(|axis| quantile(&looks.iter().map(|l| l.errors[body][axis]).collect::<Vec<_>>(), 0.5))
    };
    HardRow {
        case: case.into(),
        about: about.into(),
        z_c_p90_px: quantile(&c, 0.9),
        z_u_p90_px: quantile(&u, 0.9),
        z_c_p50_px: quantile(&c, 0.5),
        z_u_p50_px: quantile(&u, 0.5),
        lost: share(&|n| c[n] > LOST_PX || u[n] > LOST_PX),
        lost_c: share(&|n| c[n] > LOST_PX),
        lost_u: share(&|n| u[n] > LOST_PX),
        offset_c_px: offset(0),
        offset_u_px: offset(1),
    }
}

impl HardReport {
    /// The rows for people; no wider than `width`.
    #[must_use]
    pub fn table(&self, width: Option<usize>) -> String {
        let mut out = format!(
            "{:<46} {:>6} {:>6} {:>7} {:>13}\n",
            "camera (l1, px, 90 %)", "z_c", "z_u", "lost", "offset of z_c"
        );
        for r in &self.hard {
            let name = format!("{} ({})", r.case, r.about);
            let name: String = name.chars().take(46).collect();
            let lost = 100.0 * r.lost;
            let [x, y] = r.offset_c_px;
            out += &format!(
                "{name:<46} {:>6.2} {:>6.2} {lost:>5.1} % {x:>+6.2} {y:>+6.2}\n",
                r.z_c_p90_px, r.z_u_p90_px
            );
        }
        let leaks = format!(
            "leakage R²: z_c of the obstacle {:.4}, z_u of the UAV {:.4}\n",
            self.leak_c_to_u, self.leak_u_to_c
        );
        columns::folded(&out, &[46, 7, 7, 8, 14], width) + &columns::wrapped(&leaks, 2, width)
    }
}
