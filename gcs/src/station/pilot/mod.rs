//! Who decides: one controller a file, and one `match` that hands out what each may see.

pub mod apc;
pub mod crpl;
pub mod crpl_bw;
pub mod crpl_exact_latents;
pub mod crpl_rh;
pub mod rcc;
pub mod reactive;
pub mod track;
pub mod ucc;

use std::sync::Arc;

use clap::ValueEnum;
use crpl_model::planning::policy::Policies;
use crpl_model::world_model::{HeadsAt, WorldModel};
use crpl_sitl::Scenario;
use crpl_sitl::radio::message::Telemetry;
use crpl_sitl::units::{Motion, TxPower};
use serde::{Deserialize, Serialize};

use crate::station::belief::Belief;
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
            Self::CrplRh => "crpl-rh",
            Self::Apc => "apc",
            Self::Rcc => "rcc",
            Self::Ucc => "ucc",
        })
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
    /// Motion and power for the interval that begins.
    pub fn decide(
        &mut self,
        world: &WorldModel,
        belief: &Belief,
        telemetry: &Telemetry,
        scenario: &Scenario,
    ) -> (Motion, TxPower) {
        match self {
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
        }
    }
}
