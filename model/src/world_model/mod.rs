//! The learned world model as one value: encoder, predictors, risk and channel heads, probe.
//!
//! What the ground station and Algorithm 1 hold. Knows how to read a picture and to look ahead;
//! knows no physics, no link and no policy.

pub mod checkpoint;
pub mod config;
pub mod dataset;

use std::path::Path;

use crpl_sitl::camera::Frame;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::encoder::infer::Encoder;
pub use crate::encoder::infer::Latent;
pub use crate::encoder::probe::{Affine, Probe};
use crate::encoder::weights::{LATENT, on_plane, vector};
use crate::evaluation::Metrics;
pub use crate::heads::networks::{Heads, HeadsAt};
use crate::predictor::linear::{Linear, Plane, Reduced};
use crate::predictor::observer::{self, Motion, Seen};
use crate::world_model::checkpoint::CheckpointError;
use crate::world_model::config::TrainConfig;

/// Everything that was learned of the world.
#[derive(Debug, Clone)]
pub struct WorldModel {
    /// Picture to latents.
    pub encoder: Encoder,
    /// E_c [16][2], orthonormal columns: z_c = E_c y_c.
    pub plane_c: [[f32; 2]; LATENT],
    /// E_u [16][2], orthonormal columns: z_u = E_u y_u.
    pub plane_u: [[f32; 2]; LATENT],
    /// S, latent units of z_c per unit of length.
    pub scale: f64,
    /// Ψ of both halves.
    pub predictor: Linear,
    /// Collision risk and channel gain.
    pub heads: Heads,
    /// Plane coordinates to positions, for metrics, plots and walls.
    pub probe: Probe,
    /// Where it comes from and what was measured.
    pub card: Card,
}

/// What a checkpoint says of itself; equal for equal seeds (time and revision stand in card.md).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Card {
    /// `crpl-world-model/1`
    pub format: String,
    /// Backend that trained it: flex or ndarray.
    pub backend: String,
    /// Everything that decides its bytes.
    pub config: TrainConfig,
    /// Measured on held-out frames at the end of training.
    pub metrics: Metrics,
}

impl WorldModel {
    /// Reads `model.safetensors` and `config.json` in `dir`.
    pub fn load(dir: &Path) -> Result<Self, CheckpointError> {
        checkpoint::load(dir)
    }

    /// Writes `model.safetensors` and `config.json` into `dir`, which is made if it is not there.
    pub fn save(&self, dir: &Path) -> Result<(), CheckpointError> {
        checkpoint::save(self, dir)
    }

    /// The model that ships with the program, trained by `model train`.
    pub fn embedded() -> Result<Self, CheckpointError> {
        checkpoint::embedded()
    }

    /// z_c and z_u of one picture.
    #[must_use]
    pub fn encode(&self, frame: &Frame) -> Latent {
        self.encoder.encode(frame)
    }

    /// What the observer reads of one picture: y_c and y_u, each with its doubt.
    #[must_use]
    pub fn see(&self, frame: &Frame) -> [Seen; 2] {
        let features = self.encoder.features(frame);
        let doubt = observer::doubt(features.missing[0]);
        let latent = self.encoder.read(features);
        [Seen { y: vector(self.y_c(&latent)), doubt }, vector(self.y_u(&latent)).into()]
    }

    /// y_c = E_c' z_c.
    #[must_use]
    pub fn y_c(&self, latent: &Latent) -> [f32; 2] {
        on_plane(&self.plane_c, &latent.z_c)
    }

    /// y_u = E_u' z_u.
    #[must_use]
    pub fn y_u(&self, latent: &Latent) -> [f32; 2] {
        on_plane(&self.plane_u, &latent.z_u)
    }

    /// The risk and channel heads for a base station at `station`, paper units.
    #[must_use]
    pub fn heads_at(&self, station: Vector2<f64>) -> HeadsAt {
        self.heads.at(station, &self.probe)
    }

    /// The predictors in plane coordinates.
    #[must_use]
    pub fn reduced(&self) -> Reduced {
        self.predictor.reduced(&plane(&self.plane_c), &plane(&self.plane_u))
    }

    /// How both halves move, for the observer: controllable and uncontrollable. `v_max` and `kick` (the
    /// disturbance's standard deviation) in units per interval.
    #[must_use]
    pub fn motions(&self, v_max: f64, kick: f64) -> [Motion; 2] {
        let psi = self.reduced();
        // The probe's matrix is units per latent unit.
        let scale_u = 1.0 / (self.probe.u.matrix.norm() / std::f64::consts::SQRT_2).max(1e-9);
        [Motion::controllable(&psi, self.scale, v_max, kick), Motion::uncontrollable(&psi, scale_u)]
    }

    /// Where the model sees the UAV, paper units (probe; for plots and metrics).
    #[must_use]
    pub fn uav(&self, latent: &Latent) -> Vector2<f64> {
        self.probe.c.apply(vector(self.y_c(latent)))
    }

    /// Where the model sees the obstacle, paper units (probe; for plots and metrics).
    #[must_use]
    pub fn obstacle(&self, latent: &Latent) -> Vector2<f64> {
        self.probe.u.apply(vector(self.y_u(latent)))
    }
}

/// E in f64.
#[must_use]
pub fn plane(e: &[[f32; 2]; LATENT]) -> Plane {
    Plane::from_fn(|k, axis| f64::from(e[k][axis]))
}
