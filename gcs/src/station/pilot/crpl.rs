//! CRPL in flight: the two optimised policies on the latents of the last two frames.

use std::sync::Arc;

use crpl_model::planning::policy::{Policies, features};
use crpl_sitl::units::{Motion, TxPower};

use crate::station::belief::Latents;
use crate::station::seen::MotionLimits;

/// π_s and π_p, and the scales of their inputs.
#[derive(Debug, Clone)]
pub struct Crpl {
    policies: Arc<Policies>,
    latent_scale: f32,
    v_max: f32,
}

impl Crpl {
    /// The policies in the latents of a world model with `latent_scale` S, latent units per unit of
    /// length.
    #[must_use]
    pub fn new(policies: Arc<Policies>, latent_scale: f64, limits: MotionLimits) -> Self {
        Self { policies, latent_scale: latent_scale as f32, v_max: limits.v_max as f32 }
    }

    /// π_s and π_p.
    pub(super) fn policies(&self) -> &Arc<Policies> {
        &self.policies
    }

    /// The executed actions of π_s and π_p.
    #[must_use]
    pub fn decide(&self, now: Latents) -> (Motion, TxPower) {
        let x = features(now.y_c, now.y_c_before, now.first_y_u(), self.latent_scale, self.v_max);
        self.policies.act(&x)
    }
}
