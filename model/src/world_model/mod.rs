//! The learned world model as one value: encoder, predictors, risk and channel heads, probe.
//!
//! What the ground station and Algorithm 1 hold. Knows how to read a frame and to look ahead;
//! knows no physics, no link and no policy.

pub mod card;
pub mod checkpoint;
pub mod config;
pub mod dataset;
pub mod exploration;
pub mod learned;
pub mod picture_folder;
pub mod recording;
pub mod sight;
pub mod stages;

use crpl_sitl::Scenario;
use crpl_sitl::camera::Frame;
use nalgebra::Vector2;
use rayon::prelude::*;

pub use crate::encoder::infer::Latent;
pub use crate::encoder::probe::{Affine, Probe};
use crate::encoder::weights::{LATENT, on_plane, vector};
pub use crate::heads::networks::{Heads, StationHeads};
use crate::predictor::Predictor;
use crate::predictor::linear::{Linear, Plane, PlaneLinear};
use crate::predictor::observer::{LatentReading, MotionModel};
use crate::world_model::card::Card;
use crate::world_model::sight::{FrameEncoder, LatentPlanes};

/// M of the learned encoder: more frames cost time and buy nothing in gusts (our choice).
const LEARNED_WINDOW: usize = 20;

/// Everything that was learned of the world.
#[derive(Debug, Clone)]
pub struct WorldModel {
    /// Frame to latents.
    pub encoder: FrameEncoder,
    /// E_c `[16][2]`, orthonormal columns: z_c = E_c y_c.
    pub plane_c: [[f32; 2]; LATENT],
    /// E_u `[16][2]`, orthonormal columns: z_u = E_u y_u.
    pub plane_u: [[f32; 2]; LATENT],
    /// S, latent units of z_c per unit of length.
    pub scale: f64,
    /// Ψ of both halves, in all dimensions.
    pub linear: Linear,
    /// Predicts the controllable half, in plane coordinates.
    pub predictor: Predictor,
    /// Collision risk and channel gain.
    pub heads: Heads,
    /// Plane coordinates to positions, for metrics, plots and walls.
    pub probe: Probe,
    /// Where it comes from and what was measured.
    pub card: Card,
}

impl WorldModel {
    /// z_c and z_u of one frame.
    #[must_use]
    pub fn encode(&self, frame: &Frame) -> Latent {
        self.encoder.encode(frame, &self.planes(), self.scale)
    }

    /// What the observer reads of one frame: y_c and y_u, each with its sigma_scale.
    #[must_use]
    pub fn see(&self, frame: &Frame) -> [LatentReading; 2] {
        self.encoder.see(frame, &self.planes(), self.scale)
    }

    /// The latents of many frames, drawn and encoded on all cores; order and bits as one by one.
    #[must_use]
    pub fn encode_all<T: Sync>(&self, scenes: &[T], draw: impl Fn(&T) -> Frame + Sync) -> Vec<Latent> {
        scenes.par_iter().map(|scene| self.encode(&draw(scene))).collect()
    }

    /// E_c and E_u.
    fn planes(&self) -> LatentPlanes {
        [self.plane_c, self.plane_u]
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

    /// The risk and channel heads for a scenario: its base station, radii, d_min, τ_c and G0. For keys that the
    /// channel head was not trained for, see [`StationHeads::untrained`].
    #[must_use]
    pub fn station_heads(&self, scenario: &Scenario) -> StationHeads {
        self.heads.at(scenario.channel.base_station, &self.probe).scaled_to(scenario)
    }

    /// The linear predictor of the controllable half, plane coordinates.
    #[must_use]
    pub fn controllable(&self) -> PlaneLinear {
        self.linear.controllable(&plane(&self.plane_c))
    }

    /// The linear predictor of the uncontrollable half, plane coordinates.
    #[must_use]
    pub fn uncontrollable(&self) -> PlaneLinear {
        self.linear.uncontrollable(&plane(&self.plane_u))
    }

    /// Frames from which the observer tells place and speed where a scenario asks for fewer: two frames of the centroid
    /// encoder are exact, those of the learned one are not.
    #[must_use]
    pub fn least_window(&self) -> usize {
        match self.encoder {
            FrameEncoder::Centroid(_) => 2,
            FrameEncoder::Learned(_) => LEARNED_WINDOW,
        }
    }

    /// How both halves move, for the observer: controllable and uncontrollable. `v_max` and `gust_std` (the
    /// disturbance's standard deviation) in units per interval.
    #[must_use]
    pub fn motions(&self, v_max: f64, gust_std: f64) -> [MotionModel; 2] {
        // The probe's matrix is units per latent unit.
        let scale_u = 1.0 / (self.probe.u.matrix.norm() / std::f64::consts::SQRT_2).max(1e-9);
        let uncontrollable = Predictor::Linear(self.uncontrollable());
        let lost = self.encoder.learned().is_some();
        [
            MotionModel { lost, ..MotionModel::new(self.predictor.clone(), self.scale, v_max, gust_std) },
            MotionModel { lost, ..MotionModel::new(uncontrollable, scale_u, f64::INFINITY, 0.0) },
        ]
    }

    /// Plane coordinates whose decoded places are these, paper units; zeros where the probe is singular.
    #[must_use]
    pub fn latents_at(&self, uav: Vector2<f64>, obstacle: Vector2<f64>) -> ([f32; 2], [f32; 2]) {
        let plane = |map: &Affine, r| map.invert(r).map_or([0.0; 2], |y| [y.x as f32, y.y as f32]);
        (plane(&self.probe.c, uav), plane(&self.probe.u, obstacle))
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
