//! The radio channel: path loss, blockage by the obstacle, SNR, rate and outage (Sec. IV-A3, IV-A4).

use nalgebra::Vector2;

use crate::scenario::Channel;
use crate::units::Snr;

/// 1 / (1 + e^-x).
#[must_use]
pub fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// |h_LOS|² = G0 d^-α_PL (Sec. IV-A3), with d kept above a floor.
#[must_use]
pub fn los_gain(uav: Vector2<f64>, channel: &Channel) -> f64 {
    let d = (uav - channel.base_station).norm().max(channel.distance_floor);
    channel.reference_gain * d.powf(-channel.path_loss_exponent)
}

/// Distance of the obstacle's centre to the segment from base station to UAV, units.
#[must_use]
pub fn distance_to_sight_line(uav: Vector2<f64>, obstacle: Vector2<f64>, base_station: Vector2<f64>) -> f64 {
    let (sight, offset) = (uav - base_station, obstacle - base_station);
    let t = (sight.dot(&offset) / sight.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    (offset - t * sight).norm()
}

/// Blockage probability p_k = sigmoid((R_o - d_seg) / τ_b), smooth as in Sec. IV-A3 (our choice of shape).
#[must_use]
pub fn blockage(uav: Vector2<f64>, obstacle: Vector2<f64>, radius: f64, channel: &Channel) -> f64 {
    let d = distance_to_sight_line(uav, obstacle, channel.base_station);
    sigmoid((radius - d) / channel.blockage_softness)
}

/// |h|² = ((1 - p) + κ p) |h_LOS|², Sec. IV-A3.
#[must_use]
pub fn gain(uav: Vector2<f64>, obstacle: Vector2<f64>, radius: f64, channel: &Channel) -> f64 {
    let p = blockage(uav, obstacle, radius, channel);
    ((1.0 - p) + channel.nlos_attenuation * p) * los_gain(uav, channel)
}

/// γ = |h|² a_p / P_n, Eq. (12), Sec. II-B3.
#[must_use]
pub fn snr(gain: f64, power: f64, channel: &Channel) -> Snr {
    Snr(gain * power / channel.noise_power)
}

/// Bits that one interval carries, R Δt = B Δt log2(1 + γ), Sec. IV-A4.
#[must_use]
pub fn bits(b_dt: f64, snr: Snr) -> f64 {
    b_dt * (1.0 + snr.0).log2()
}

/// Outage: R Δt < L_pkt, strictly (Sec. IV-A4).
#[must_use]
pub fn outage(b_dt: f64, snr: Snr, packet_bits: f64) -> bool {
    bits(b_dt, snr) < packet_bits
}

/// The SNR at which an interval just carries a packet, γ_out = 2^(L/(B Δt)) - 1.
#[must_use]
pub fn outage_snr(b_dt: f64, packet_bits: f64) -> Snr {
    Snr((packet_bits / b_dt).exp2() - 1.0)
}
