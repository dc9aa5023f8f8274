//! The controllers: one file each, and one `match` that hands out what each may see.
//!
//! | controller | before the flight | at every interval |
//! |---|---|---|
//! | [`crpl`] | policies, limits of motion | latents |
//! | [`crpl_bw`] | the same, channel head, radio constants | latents |
//! | [`crpl_rh`] | the same, Algorithm 1's planning problem, horizon | tick, latents |
//! | [`crpl_exact_latents`] | as `crpl` | true present state (for measurements) |
//! | [`apc`] | the whole scenario: the oracle knows the equations | tick, true present state |
//! | [`apc_paper`] | the same | true present state |
//! | [`own`]: exec | goal, limits, radii, radio constants | tick, latents, picture, what was heard |
//! | [`own`]: exec-truth | the whole scenario | the same, true present state |
//! | [`reactive`]: rcc, ucc | goal, limits, safety, radii, γ_min | true present state, last measured SNR |
//!
//! To add a controller: its file, and here a variant of [`Controller`], of [`Pilot`], and one arm each in
//! [`Pilot::load`] and [`Pilot::decide`].

pub mod apc;
pub mod apc_paper;
pub mod crpl;
pub mod crpl_bw;
pub mod crpl_exact_latents;
pub mod crpl_rh;
pub mod foresight;
pub mod laws;
pub mod own;
pub mod reactive;
pub mod track;

use std::str::FromStr;
use std::sync::Arc;

use anyhow::{Result, bail, ensure};
use clap::ValueEnum;
use clap::builder::{EnumValueParser, PossibleValue, TypedValueParser};
use crpl_model::planning::policy::Policies;
use crpl_model::world_model::StationHeads;
use crpl_sitl::Scenario;
use crpl_sitl::camera::Frame;
use crpl_sitl::radio::message::Telemetry;
use crpl_sitl::units::{Motion, Scale, Tick, TxPower};
use serde::{Deserialize, Serialize};

use crate::station::belief::Belief;
use crate::station::models::{ChosenPolicies, Models, PolicyOrigin, PolicyUse};
use crate::station::seen::{Heard, MotionLimits, RadioConstants};
use foresight::{Foresight, PowerRule};
use own::Own;
use own::name::{OwnController, OwnKind, OwnNameError};
use own::protocol::OwnSight;
use reactive::{Law, Present, Reactive, Task};

/// The controllers by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, ValueEnum, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Controller {
    /// Predictive control in latent space, from frames alone
    Crpl,
    /// CRPL with the power that the bandwidth needs
    CrplBw,
    /// CRPL on the latents of the true positions: what the encoder costs
    CrplExactLatents,
    /// CRPL re-optimised in flight, with the power of crpl-bw
    CrplRh,
    /// Analytical predictive control: the oracle, from telemetry and the equations
    Apc,
    /// Reactive constrained control, from present telemetry, tuned
    Rcc,
    /// Unconstrained communication control, from present telemetry, tuned
    Ucc,
    /// The simplest analytical predictive control: obstacles stand, no gusts
    ApcPaper,
    /// Reactive constrained control with untuned gains
    RccPaper,
    /// Unconstrained communication control with untuned gains
    UccPaper,
    /// One of somebody's own, by its name
    #[value(skip)]
    Own(OwnController),
}

/// A name that no controller has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ControllerError {
    /// Neither built in nor of a form for others.
    #[error("no controller is called {0:?}")]
    Unknown(String),
    /// The form for others, but not right.
    #[error(transparent)]
    Own(#[from] OwnNameError),
}

impl FromStr for Controller {
    type Err = ControllerError;

    fn from_str(text: &str) -> Result<Self, ControllerError> {
        match OwnController::parse(text)? {
            Some(own) => Ok(Self::Own(own)),
            None => {
                let built_in = <Self as ValueEnum>::from_str(text, false);
                built_in.map_err(|_| ControllerError::Unknown(text.into()))
            }
        }
    }
}

impl TryFrom<String> for Controller {
    type Error = ControllerError;

    fn try_from(text: String) -> Result<Self, ControllerError> {
        text.parse()
    }
}

impl From<Controller> for String {
    fn from(controller: Controller) -> Self {
        controller.to_string()
    }
}

/// Reads `--controller`: the built-in names, and those of somebody's own.
#[derive(Debug, Clone)]
pub struct ControllerParser;

impl TypedValueParser for ControllerParser {
    type Value = Controller;

    fn parse_ref(
        &self,
        command: &clap::Command,
        argument: Option<&clap::Arg>,
        value: &std::ffi::OsStr,
    ) -> Result<Controller, clap::Error> {
        match value.to_str().map(OwnController::parse) {
            Some(Ok(Some(own))) => Ok(Controller::Own(own)),
            Some(Err(error)) => {
                let message = format!("--controller: {error}\n");
                Err(clap::Error::raw(clap::error::ErrorKind::ValueValidation, message).with_cmd(command))
            }
            _ => EnumValueParser::<Controller>::new().parse_ref(command, argument, value),
        }
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        let built_in = Controller::value_variants().iter().filter_map(ValueEnum::to_possible_value);
        let own = [
            ("exec:COMMAND", "A program of your own, by lines of JSON (docs/own-controller.md)"),
            ("exec-truth:COMMAND", "The same, and it sees the true state"),
            ("mavlink:ENDPOINT", "A station of your own, by MAVLink"),
        ];
        let own = own.into_iter().map(|(name, about)| PossibleValue::new(name).help(about));
        Some(Box::new(built_in.chain(own)))
    }
}

impl Controller {
    /// Its name where there is little room.
    #[must_use]
    pub fn label(self) -> String {
        match self {
            Self::Own(own) => own.label(),
            built_in => built_in.to_string(),
        }
    }

    /// One of somebody's own.
    #[must_use]
    pub fn own(self) -> Option<OwnController> {
        match self {
            Self::Own(own) => Some(own),
            _ => None,
        }
    }

    /// Its name as a part of a file's name.
    #[must_use]
    pub fn file_name(self) -> String {
        let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' };
        self.label().chars().map(plain).collect()
    }

    /// Whether it flies optimised policies, which must cover the scenario.
    #[must_use]
    pub fn flies_policies(self) -> bool {
        matches!(self, Self::Crpl | Self::CrplBw | Self::CrplExactLatents)
    }
}

impl std::fmt::Display for Controller {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Own(own) => f.write_str(own.name()),
            _ => f.write_str(self.to_possible_value().as_ref().map_or("", |value| value.get_name())),
        }
    }
}

/// A controller with its state.
#[derive(Debug, Clone)]
pub enum Pilot {
    /// See [`crpl`].
    Crpl(crpl::Crpl),
    /// See [`crpl_bw`].
    CrplBw(crpl_bw::CrplBw),
    /// See [`crpl_exact_latents`].
    CrplExactLatents(crpl_exact_latents::CrplExactLatents),
    /// See [`crpl_rh`].
    CrplRh(Box<crpl_rh::CrplRh>),
    /// See [`apc`].
    Apc(Box<apc::Apc>),
    /// See [`apc_paper`].
    ApcPaper(Box<apc_paper::ApcPaper>),
    /// See [`own`].
    Own(Box<Own>),
    /// See [`reactive`].
    Reactive(Reactive),
}

impl Pilot {
    /// A controller for `scenario`, and where its policies come from, if it has any. Here the scenario is
    /// taken apart: each controller keeps only what its constructor names.
    ///
    /// # Errors
    /// Policies that are missing, or made in another world model or for another world.
    pub fn load(
        controller: Controller,
        models: &Models,
        scenario: &Scenario,
    ) -> Result<(Self, Option<PolicyOrigin>)> {
        let (limits, radio) = (MotionLimits::of(scenario), RadioConstants::of(scenario));
        let mut origin = None;
        let mut crpl = || -> Result<_> {
            let chosen = models.policies(scenario, PolicyUse::Fly)?;
            origin = Some(chosen.origin);
            Ok(crpl::Crpl::new(Arc::new(chosen.policies), models.world.scale, limits))
        };
        let power = || -> Result<_> {
            let untrained = StationHeads::untrained(scenario);
            ensure!(
                untrained.is_empty(),
                "{controller} reads the gain in flight, and the channel head was trained with other values of {}; \
                 crpl flies here",
                untrained.join(", ")
            );
            Ok(crpl_bw::MatchedPower::new(Arc::new(models.world.station_heads(scenario)), radio))
        };
        let reactive = |law: Law| Self::Reactive(Reactive::new(law, Task::of(scenario)));
        let pilot = match controller {
            Controller::Crpl => Self::Crpl(crpl()?),
            Controller::CrplBw => Self::CrplBw(crpl_bw::CrplBw::new(crpl()?, power()?)),
            Controller::CrplRh => {
                let ChosenPolicies { policies, origin: from } =
                    models.policies(scenario, PolicyUse::Begin)?;
                origin = Some(from);
                let receding = crpl_rh::receding(models, scenario, &policies)?;
                let (scale, horizon) = (models.world.scale, scenario.horizon);
                let crpl = crpl_rh::CrplRh::new(receding, policies, power()?, scale, limits, horizon);
                Self::CrplRh(Box::new(crpl))
            }
            Controller::CrplExactLatents => {
                let world = models.world.clone();
                Self::CrplExactLatents(crpl_exact_latents::CrplExactLatents::new(crpl()?, world))
            }
            Controller::Apc => Self::Apc(Box::new(apc::Apc::new(scenario))),
            Controller::ApcPaper => Self::ApcPaper(Box::new(apc_paper::ApcPaper::new(scenario))),
            Controller::Rcc => reactive(models.laws.rcc.clone()),
            Controller::Ucc => reactive(models.laws.ucc.clone()),
            Controller::RccPaper => reactive(Law::RCC_PAPER),
            Controller::UccPaper => reactive(Law::UCC_PAPER),
            Controller::Own(own) if own.kind == OwnKind::Mavlink => {
                bail!(
                    "{controller} flies a vehicle of the lab: gcs episodes, sweep and bound score it; \
                     `sitl --out DIR` writes down a single flight"
                )
            }
            Controller::Own(own) => Self::Own(Box::new(Own::new(own, models.own, &models.world, scenario)?)),
        };
        Ok((pilot, origin))
    }

    /// Whether it goes by frames; else by the vehicle's reports.
    #[must_use]
    pub fn sees_frames(&self) -> bool {
        matches!(self, Self::Crpl(_) | Self::CrplBw(_) | Self::CrplRh(_))
    }

    /// Whether it may know the equations of motion in flight.
    #[must_use]
    pub fn knows_equations(&self) -> bool {
        matches!(self, Self::Apc(_) | Self::ApcPaper(_) | Self::CrplExactLatents(_))
    }

    /// Motion and power for interval `now`. The only place that hands out information: `belief`
    /// comes from frames, of which `frame` is the one that has just arrived; `telemetry` holds the true state, `scale`
    /// converts it to the paper's units.
    pub fn decide(
        &mut self,
        now: Tick,
        belief: &Belief,
        telemetry: &Telemetry,
        frame: Option<&Frame>,
        scale: &Scale,
    ) -> (Motion, TxPower) {
        let present = || Present::of(telemetry, scale);
        let latents = || belief.latents_at(now);
        match self {
            Self::Crpl(crpl) => crpl.decide(latents()),
            Self::CrplBw(crpl) => crpl.decide(latents()),
            Self::CrplRh(crpl) => crpl.decide(now, latents()),
            Self::CrplExactLatents(crpl) => crpl.decide(&present()),
            Self::Apc(apc) => apc.decide(now, &present()),
            Self::ApcPaper(apc) => apc.decide(&present()),
            Self::Own(own) => own.decide(&OwnSight {
                heard: Heard::from(telemetry),
                latents: latents(),
                frame,
                truth: own.sees_truth().then(present),
            }),
            Self::Reactive(reactive) => reactive.decide(&present()),
        }
    }

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
            Self::Apc(_) | Self::ApcPaper(_) | Self::Reactive(_) | Self::Own(_) => None,
        }
    }
}
