//! UCC, the unconstrained communication controller: a geometric margin instead of a probabilistic
//! constraint, power by the SNR that was measured. Sees the present alone.

use crpl_sitl::Scenario;
use crpl_sitl::units::{Motion, TxPower};

use super::reactive::{Present, Trigger, look_ahead};

/// How far it extrapolates, intervals (our choice).
const STEPS: u32 = 8;

/// The margin that it keeps, units (our choice; p_coll there is 0.198).
const MARGIN: f64 = 0.028;

/// UCC with its power trigger.
#[derive(Debug, Clone, Default)]
pub struct Ucc {
    trigger: Trigger,
}

impl Ucc {
    /// Motion and power for the interval that begins.
    pub fn decide(&mut self, now: &Present, scenario: &Scenario) -> (Motion, TxPower) {
        let power = self.trigger.next(now.link, scenario.channel.snr_min);
        (look_ahead(now, STEPS, MARGIN, scenario), power)
    }
}
