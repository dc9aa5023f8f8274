//! Propulsion power of a rotary-wing UAV (Sec. IV-A6; Zeng, Xu and Zhang, 2019).

use crate::scenario::Propulsion;

/// P(V) in watts at `speed` m/s:
/// P0 (1 + 3V²/U_tip²) + P_i (sqrt(1 + x²) - x)^½ + ½ d0 ρ s A V³, with x = V²/(2 v0²).
///
/// The induced term is written as 1/(sqrt(1 + x²) + x), which does not cancel at high speed.
#[must_use]
pub fn propulsion_power(speed: f64, p: &Propulsion) -> f64 {
    let v2 = speed * speed;
    let x = v2 / (2.0 * p.hover_induced_velocity * p.hover_induced_velocity);
    let profile = p.blade_profile_power * (1.0 + 3.0 * v2 / (p.tip_speed * p.tip_speed));
    let induced = p.induced_power * (1.0 / ((1.0 + x * x).sqrt() + x)).sqrt();
    let parasite = 0.5 * p.fuselage_drag_ratio * p.air_density * p.rotor_solidity * p.rotor_area * v2 * speed;
    profile + induced + parasite
}
