//! UCC, the unconstrained communication controller: a geometric margin instead of a probabilistic
//! constraint, power by the SNR that was measured. Sees the present alone.

use crpl_sitl::units::{Motion, TxPower};

use super::reactive::{Present, Task, Trigger, look_ahead};

/// How far it extrapolates, intervals (our choice).
const STEPS: u32 = 8;

/// The margin that it keeps, units (our choice; p_coll there is 0.198).
const MARGIN: f64 = 0.028;

/// UCC with its power trigger.
#[derive(Debug, Clone)]
pub struct Ucc {
    task: Task,
    trigger: Trigger,
}

impl Ucc {
    /// The controller of `task`, at low power.
    #[must_use]
    pub fn new(task: Task) -> Self {
        Self { task, trigger: Trigger::default() }
    }

    /// Motion and power for the interval that begins.
    pub fn decide(&mut self, now: &Present) -> (Motion, TxPower) {
        let power = self.trigger.next(now.link, self.task.snr_min);
        (look_ahead(now, STEPS, MARGIN, &self.task), power)
    }
}
