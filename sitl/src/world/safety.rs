//! Distance between the bodies, and the ground-truth collision probability.

use nalgebra::Vector2;

use super::channel::sigmoid;

/// Boundary distance d(Ω_c, Ω_u) = |r_c - r_u| - R_o - R_u of Eq. (21), units; negative when the discs overlap.
#[must_use]
pub fn clearance(uav: Vector2<f64>, obstacle: Vector2<f64>, uav_radius: f64, obstacle_radius: f64) -> f64 {
    (uav - obstacle).norm() - obstacle_radius - uav_radius
}

/// p_coll = sigmoid((d_min - clearance) / τ_c): one half at contact (our choice of shape).
#[must_use]
pub fn collision_probability(clearance: f64, d_min: f64, softness: f64) -> f64 {
    sigmoid((d_min - clearance) / softness)
}
