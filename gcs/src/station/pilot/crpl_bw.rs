//! CRPL that knows the bandwidth: π_s as it ships, and power for the rate that the packet needs.
//!
//! π_p is trained at γ_min and sees no bandwidth. Here γ_min rises to the SNR at which an interval
//! just carries the packet, γ_out = 2^(L/(B Δt)) - 1, and stage 2 is solved anew, exactly: power
//! moves nothing, so its objective λ_p Σ E(a_p²) - w ln(P_comm - 1 + δ2) falls apart into one choice an
//! interval, and with a sharp outage (α → ∞) that choice is a threshold in the predicted gain. No
//! training run, for any bandwidth, packet and noise power.

use std::sync::Arc;

use crpl_model::planning::policy::Policies;
use crpl_model::world_model::StationHeads;
use crpl_sitl::units::{Motion, TxPower};
use crpl_sitl::world::channel::outage_snr;

use super::crpl::Crpl;
use crate::station::belief::Latents;
use crate::station::seen::RadioConstants;

/// Factor on the SNR that is needed: what the channel head may be wrong by (our choice).
pub const HEADROOM: f64 = 1.08;

/// π_s, and the power of stage 2 solved for this radio.
#[derive(Debug, Clone)]
pub struct CrplBw {
    crpl: Crpl,
    power: MatchedPower,
}

impl CrplBw {
    /// CRPL's motion with matched power.
    #[must_use]
    pub fn new(crpl: Crpl, power: MatchedPower) -> Self {
        Self { crpl, power }
    }

    /// π_s and π_p; of them π_s flies.
    pub(super) fn policies(&self) -> &Arc<Policies> {
        self.crpl.policies()
    }

    /// How it chooses the power.
    pub(super) fn rule(&self) -> MatchedRule {
        self.power.rule()
    }

    /// The motion of π_s; the smallest power that carries the packet.
    #[must_use]
    pub fn decide(&self, now: Latents) -> (Motion, TxPower) {
        let (motion, _) = self.crpl.decide(now);
        (motion, self.power.decide(now))
    }
}

/// The power that carries a packet at a predicted SNR.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchedRule {
    needed: f64,
}

impl MatchedRule {
    /// `needed`: max(γ_min, γ_out), linear.
    #[must_use]
    pub fn new(needed: f64) -> Self {
        Self { needed }
    }

    /// The power at a predicted SNR at a_p = 1, linear.
    #[must_use]
    pub fn for_snr(self, snr_at_low: f64) -> TxPower {
        power(snr_at_low, self.needed)
    }
}

/// The smallest transmit power that carries a packet, as the channel head predicts.
#[derive(Debug, Clone)]
pub struct MatchedPower {
    heads: Arc<StationHeads>,
    radio: RadioConstants,
}

impl MatchedPower {
    /// For the channel head of one base station and its radio.
    #[must_use]
    pub fn new(heads: Arc<StationHeads>, radio: RadioConstants) -> Self {
        Self { heads, radio }
    }

    /// The rule, without the head that predicts the SNR.
    pub(super) fn rule(&self) -> MatchedRule {
        MatchedRule::new(needed(&self.radio))
    }

    /// The power for this interval.
    #[must_use]
    pub fn decide(&self, now: Latents) -> TxPower {
        power(self.snr_at_low(now), needed(&self.radio))
    }

    /// γ at a_p = 1 as the channel head predicts it for this interval, linear.
    fn snr_at_low(&self, now: Latents) -> f64 {
        let gain = |y_u: &[f32; 2]| f64::from(self.heads.log_gain(now.y_c, *y_u)).exp();
        // That of the obstacle which blocks most.
        let gain = now.y_u.iter().map(gain).fold(f64::INFINITY, f64::min);
        gain * TxPower::Low.level() / self.radio.noise_power
    }
}

/// max(γ_min, γ_out) for this radio's packet, linear.
#[must_use]
pub fn needed(radio: &RadioConstants) -> f64 {
    radio.snr_min.max(outage_snr(radio.b_dt, radio.packet_bits).0)
}

/// High where low power does not reach `needed` and high power may: the minimiser of stage 2.
#[must_use]
pub fn power(snr_at_low: f64, needed: f64) -> TxPower {
    let enough = snr_at_low >= HEADROOM * needed;
    let hopeless = snr_at_low * TxPower::High.level() * HEADROOM < needed;
    if enough || hopeless { TxPower::Low } else { TxPower::High }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_power_that_carries_the_packet() {
        let mut radio = RadioConstants { b_dt: 2.0, packet_bits: 4.0, noise_power: 1.0, snr_min: 1.0 };
        // 2^(4/2) - 1 = 3
        assert!((needed(&radio) - 3.0).abs() < 1e-12);
        radio.b_dt = 8.0;
        assert_eq!(needed(&radio), radio.snr_min);
        for (snr, want) in [(4.0, TxPower::Low), (3.1, TxPower::High), (0.76, TxPower::High)] {
            assert_eq!(power(snr, 3.0), want, "snr {snr}");
        }
        assert_eq!(power(0.6, 3.0), TxPower::Low, "a packet that fails at both powers is not worth one");
    }
}
