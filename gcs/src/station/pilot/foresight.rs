//! How a controller goes on from a tick: for who looks ahead beside it. No controller reads it.

use std::sync::Arc;

use crpl_model::planning::policy::Policies;
use crpl_sitl::units::TxPower;

use super::Pilot;
use super::crpl_bw;

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

/// The rule of [`crpl_bw`] on a predicted SNR.
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
        crpl_bw::power(snr_at_low, self.needed)
    }
}

impl Pilot {
    /// The policies that it flies now; `None` for a controller without any.
    #[must_use]
    pub fn foresight(&self) -> Option<Foresight> {
        let fixed = |policies: &Arc<Policies>, power| {
            Some(Foresight { policies: policies.clone(), reported_obstacle: None, power })
        };
        match self {
            Self::Crpl(crpl) => fixed(crpl.policies(), PowerRule::Policy),
            Self::CrplBw(crpl) => fixed(crpl.policies(), PowerRule::Matched(crpl.rule())),
            Self::CrplExactLatents(crpl) => fixed(crpl.policies(), PowerRule::Policy),
            Self::CrplRh(crpl) => Some(crpl.foresight()),
            Self::Apc(_) | Self::ApcPaper(_) | Self::Reactive(_) => None,
        }
    }
}
