//! Who decides: one controller a file, and one `match` that hands out what each may see.

pub mod apc;
pub mod crpl;
pub mod crpl_bw;
pub mod crpl_exact_latents;
pub mod crpl_ppc;
pub mod crpl_rh;
pub mod rcc;
pub mod reactive;
pub mod track;
pub mod ucc;

use std::sync::Arc;

use clap::ValueEnum;
use model::policy::Policies;
use model::world_model::{HeadsAt, WorldModel};
use serde::{Deserialize, Serialize};
use sitl::Scenario;
use sitl::msg::{Motion, Telemetry, TxPower};

use crate::belief::Belief;
use reactive::Present;

/// The controllers by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Controller {
    /// Predictive control in latent space, from pictures alone
    Crpl,
    /// CRPL with the power that the bandwidth needs
    CrplBw,
    /// CRPL on the latents of the true positions: what the encoder costs
    CrplExactLatents,
    /// CRPL whose packets carry the next actions, which an outage flies
    CrplPpc,
    /// CRPL re-optimised in flight, with the power of crpl-bw
    CrplRh,
    /// Analytical predictive control: the oracle, from telemetry and the equations
    Apc,
    /// Reactive constrained control, from present telemetry
    Rcc,
    /// Unconstrained communication control, from present telemetry
    Ucc,
}

impl std::fmt::Display for Controller {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Crpl => "crpl",
            Self::CrplBw => "crpl-bw",
            Self::CrplExactLatents => "crpl-exact-latents",
            Self::CrplPpc => "crpl-ppc",
            Self::CrplRh => "crpl-rh",
            Self::Apc => "apc",
            Self::Rcc => "rcc",
            Self::Ucc => "ucc",
        })
    }
}

/// What a pilot decides for the interval that begins.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Decision {
    /// a_s
    pub motion: Motion,
    /// a_p
    pub power: TxPower,
    /// Motions for the intervals after it, to be flown if no newer packet gets through.
    pub next: Vec<Motion>,
}

impl From<(Motion, TxPower)> for Decision {
    fn from((motion, power): (Motion, TxPower)) -> Self {
        Self { motion, power, next: Vec::new() }
    }
}

/// A controller with its state.
#[derive(Debug, Clone)]
pub enum Pilot {
    /// Sees pictures, through the world model.
    Crpl(Arc<Policies>),
    /// As CRPL, and knows the radio's constants.
    CrplBw(Arc<Policies>, Arc<HeadsAt>),
    /// Sees true positions, and would be CRPL if the encoder had no error. For measurements alone.
    CrplExactLatents(Arc<Policies>, crpl_exact_latents::Memory),
    /// As CRPL, and knows the radio's constants and the limits of motion.
    CrplPpc(Arc<Policies>, Arc<HeadsAt>),
    /// As CRPL, and knows the time, the horizon and the radio's constants.
    CrplRh(Box<crpl_rh::CrplRh>, Arc<HeadsAt>),
    /// Sees present telemetry and the equations.
    Apc,
    /// Sees present telemetry.
    Rcc(rcc::Rcc),
    /// Sees present telemetry.
    Ucc(ucc::Ucc),
}

impl Pilot {
    /// Motion and power for the interval that begins, and motions for those after it.
    pub fn decide(
        &mut self,
        world: &WorldModel,
        belief: &Belief,
        telemetry: &Telemetry,
        scenario: &Scenario,
    ) -> Decision {
        let now = match self {
            Self::CrplPpc(policies, heads) => {
                return crpl_ppc::decide(policies, heads, world, belief.latents(), scenario);
            }
            Self::Crpl(policies) => crpl::decide(policies, world, belief.latents(), scenario),
            Self::CrplBw(policies, heads) => {
                crpl_bw::decide(policies, heads, world, belief.latents(), scenario)
            }
            Self::CrplExactLatents(policies, memory) => {
                let now = memory.latents(world, &Present::of(telemetry, scenario));
                crpl::decide(policies, world, now, scenario)
            }
            Self::CrplRh(crpl, heads) => {
                crpl.decide(telemetry.tick, heads, world, belief.latents(), scenario)
            }
            Self::Apc => apc::decide(&Present::of(telemetry, scenario), scenario),
            Self::Rcc(rcc) => rcc.decide(&Present::of(telemetry, scenario), scenario),
            Self::Ucc(ucc) => ucc.decide(&Present::of(telemetry, scenario), scenario),
        };
        now.into()
    }
}
