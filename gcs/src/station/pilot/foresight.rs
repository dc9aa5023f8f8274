//! How a controller goes on from a tick: for who looks ahead beside it. No controller reads it.

use std::sync::Arc;

use crpl_model::planning::policy::Policies;

use super::crpl_bw::MatchedRule;

/// The policies that a controller flies at a tick.
#[derive(Debug, Clone)]
pub struct Foresight {
    /// π_s and π_p.
    pub policies: Arc<Policies>,
    /// The y_u that π_s reads, if it is not the first obstacle's own.
    pub reported_obstacle: Option<[f32; 2]>,
    /// Who chooses the power.
    pub power: PowerRule,
}

/// Who chooses the power.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PowerRule {
    /// π_p
    Policy,
    /// The smallest that carries a packet.
    Matched(MatchedRule),
}
