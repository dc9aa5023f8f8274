//! RCC, the reactive constrained controller: CRPL's collision constraint along a straight
//! extrapolation, power by the SNR that was measured. Sees the present alone.

use crpl_sitl::units::{Motion, TxPower};

use super::reactive::{Present, Task, Trigger, look_ahead};

/// How far it extrapolates, intervals (our choice).
const STEPS: u32 = 12;

/// RCC with its power trigger.
#[derive(Debug, Clone)]
pub struct Rcc {
    task: Task,
    trigger: Trigger,
}

impl Rcc {
    /// The controller of `task`, at low power.
    #[must_use]
    pub fn new(task: Task) -> Self {
        Self { task, trigger: Trigger::default() }
    }

    /// Motion and power for the interval that begins.
    pub fn decide(&mut self, now: &Present) -> (Motion, TxPower) {
        let power = self.trigger.next(now.link, self.task.snr_min);
        (look_ahead(now, STEPS, clearance_needed(&self.task), &self.task), power)
    }
}

/// Clearance at which p_coll = δ1: d_min + τ_c ln((1 - δ1)/δ1).
fn clearance_needed(task: &Task) -> f64 {
    let (safety, delta) = (&task.safety, task.safety.collision_tolerance);
    safety.d_min + safety.softness * ((1.0 - delta) / delta).ln()
}
