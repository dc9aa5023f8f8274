//! CRPL in receding horizon: π_s is re-optimised in flight, from the present belief, every few
//! intervals, and at every interval rollouts that open with other motions are tried beside it; power is
//! `crpl-bw`'s.
//!
//! What it gains on a policy that was optimised once: it plans for the gusts that there were, and for
//! obstacles that move, one or two, whose speed it reads from the frames.

use std::sync::Arc;

use anyhow::Result;
use crpl_model::planning::config::OptimiseConfig;
use crpl_model::planning::policy::{Policies, features};
use crpl_model::planning::problem::{PlanningProblem, PlanningState};
use crpl_model::planning::receding::{Receding, RecedingConfig};
use crpl_sitl::Scenario;
use crpl_sitl::units::{Motion, Tick, TxPower};

use super::crpl_bw::{MatchedPower, needed};
use super::foresight::{Foresight, PowerRule};
use super::track::Track;
use crate::station::belief::Latents;
use crate::station::models::Models;
use crate::station::seen::{MotionLimits, RadioConstants};

/// Share of the SNR that a packet needs at which a lookahead counts as connected: its smooth outage of
/// slope 3 is one half there and a quarter at the SNR itself (our choice).
const SOFT: f64 = 0.75;

/// γ that counts as connected in a lookahead, given that the power follows the bandwidth; linear.
fn connected(radio: &RadioConstants) -> f64 {
    radio.snr_min.max(SOFT * needed(radio))
}

/// Algorithm 1 in flight, with one start and the lookahead's threshold of this radio. `scenario` is the
/// planning problem as Algorithm 1 has it before a flight; nothing of it is read in flight.
///
/// # Errors
/// Policies that the heads of the world model do not fit.
pub fn receding(models: &Models, scenario: &Scenario, policies: &Policies) -> Result<Receding> {
    let config = OptimiseConfig { starts: 1, ..OptimiseConfig::default() };
    let problem = PlanningProblem::of(&models.world, scenario, &config, 0)?;
    let mut budget = RecedingConfig::default();
    budget.lookahead.snr_min = connected(&RadioConstants::of(scenario));
    Ok(Receding::new(problem, config.objective, budget, policies.motion.clone()))
}

/// The policy under way, and where the obstacles were.
#[derive(Debug, Clone)]
pub struct CrplRh {
    receding: Receding,
    policies: Policies,
    power: MatchedPower,
    latent_scale: f32,
    v_max: f32,
    horizon: u64,
    tracks: Vec<Track>,
}

impl CrplRh {
    /// Starts with `policies`, whose motion policy `receding` re-optimises over the rest of `horizon`
    /// intervals. `latent_scale` is S, latent units per unit of length.
    #[must_use]
    pub fn new(
        receding: Receding,
        policies: Policies,
        power: MatchedPower,
        latent_scale: f64,
        limits: MotionLimits,
        horizon: u64,
    ) -> Self {
        Self {
            receding,
            policies,
            power,
            latent_scale: latent_scale as f32,
            v_max: limits.v_max as f32,
            horizon,
            tracks: Vec::new(),
        }
    }

    /// The policy that is under way; the rollouts that are tried beside it are not in it.
    pub(super) fn foresight(&self) -> Foresight {
        let motion = self.receding.motion().clone();
        Foresight {
            policies: Arc::new(Policies { motion, ..self.policies.clone() }),
            reported_obstacle: Some(self.receding.reported_obstacle()),
            power: PowerRule::Matched(self.power.rule()),
        }
    }

    /// Motion and power for interval `tick`.
    pub fn decide(&mut self, tick: Tick, now: Latents) -> (Motion, TxPower) {
        let state = self.planning_state(tick, now);
        let remaining = self.horizon.saturating_sub(tick.0) as usize;
        self.receding.at(tick.0, &state, remaining);
        let motion = self.receding.better(&state, remaining).unwrap_or_else(|| {
            self.policies.motion.clone_from(self.receding.motion());
            let reported = self.receding.reported_obstacle();
            let x = features(now.y_c, now.y_c_before, reported, self.latent_scale, self.v_max);
            Motion::nearest(self.policies.mean_motion(&x))
        });
        (motion, self.power.decide(now))
    }

    /// The belief to plan from: the obstacles with their speeds.
    fn planning_state(&mut self, tick: Tick, now: Latents) -> PlanningState {
        self.tracks.resize_with(now.y_u.len(), Track::default);
        let followed = self.tracks.iter_mut().zip(now.y_u.iter()).map(|(track, y_u)| {
            track.follow(tick, *y_u);
            track.last_two(*y_u)
        });
        PlanningState { y_c: [now.y_c, now.y_c_before], y_u: followed.collect() }
    }
}
