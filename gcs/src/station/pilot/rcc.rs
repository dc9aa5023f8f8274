//! RCC, the reactive constrained controller: CRPL's collision constraint along a straight
//! extrapolation, power by the SNR that was measured. Sees the present alone.

use crpl_sitl::Scenario;
use crpl_sitl::units::{Motion, TxPower};

use super::reactive::{Present, Trigger, look_ahead};

/// How far it extrapolates, intervals (our choice).
const STEPS: u32 = 12;

/// RCC with its power trigger.
#[derive(Debug, Clone, Default)]
pub struct Rcc {
    trigger: Trigger,
}

impl Rcc {
    /// Motion and power for the interval that begins.
    pub fn decide(&mut self, now: &Present, scenario: &Scenario) -> (Motion, TxPower) {
        let power = self.trigger.next(now.link, scenario.channel.snr_min);
        (look_ahead(now, STEPS, clearance_needed(scenario), scenario), power)
    }
}

/// Clearance at which p_coll = δ1: d_min + τ_c ln((1 - δ1)/δ1).
fn clearance_needed(scenario: &Scenario) -> f64 {
    let (safety, delta) = (&scenario.safety, scenario.safety.collision_tolerance);
    safety.d_min + safety.softness * ((1.0 - delta) / delta).ln()
}
