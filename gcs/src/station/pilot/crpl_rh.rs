//! CRPL in receding horizon: π_s is re-optimised in flight, from the present belief, every few
//! intervals, and at every interval rollouts that open with other motions are tried beside it; power is
//! `crpl-bw`'s.
//!
//! What it gains on a policy that was optimised once: it plans for the gusts that there were, and for
//! obstacles that move, one or two, whose speed it reads from the pictures.

use crpl_model::planning::algorithm1::{Here, Receding};
use crpl_model::planning::policy::{Policies, features};
use crpl_model::world_model::{HeadsAt, WorldModel};
use crpl_sitl::Scenario;
use crpl_sitl::units::{Motion, Tick, TxPower};

use super::crpl_bw::{needed, power, snr_at_low};
use super::track::Track;
use crate::station::belief::Latents;

/// Share of the SNR that a packet needs at which a lookahead counts as connected: its smooth outage of
/// slope 3 is one half there and a quarter at the SNR itself (our choice).
const SOFT: f64 = 0.75;

/// γ that counts as connected in a lookahead, given that crpl-bw's power follows the bandwidth.
#[must_use]
pub fn connected(scenario: &Scenario) -> f64 {
    let snr_min = scenario.channel.snr_min;
    snr_min.max(SOFT * needed(scenario.radio.packet_bits, scenario))
}

/// The policy under way, and where the obstacles were.
#[derive(Debug, Clone)]
pub struct CrplRh {
    receding: Receding,
    policies: Policies,
    tracks: Vec<Track>,
}

impl CrplRh {
    /// Takes off with `policies`, of which `receding` has the motion.
    #[must_use]
    pub fn new(receding: Receding, policies: Policies) -> Self {
        Self { receding, policies, tracks: Vec::new() }
    }

    /// Motion and power for the interval that begins. Sees latents and the time; the scenario lends
    /// the horizon, v_max and the radio's own constants.
    pub fn decide(
        &mut self,
        tick: Tick,
        heads: &HeadsAt,
        world: &WorldModel,
        now: Latents,
        scenario: &Scenario,
    ) -> (Motion, TxPower) {
        let here = self.here(tick, now);
        let remaining = scenario.horizon.saturating_sub(tick.0) as usize;
        self.receding.at(tick.0, &here, remaining);
        let motion = self.receding.better(&here, remaining).unwrap_or_else(|| {
            self.policies.motion.clone_from(self.receding.motion());
            let v_max = scenario.dynamics.v_max as f32;
            let x = features(now.y_c, now.y_c_before, self.receding.told(), world.scale as f32, v_max);
            Motion::nearest(self.policies.mean_motion(&x))
        });
        (motion, power(snr_at_low(heads, now, scenario), needed(scenario.radio.packet_bits, scenario)))
    }

    /// The belief to plan from: the obstacles with their speeds.
    fn here(&mut self, tick: Tick, now: Latents) -> Here {
        self.tracks.resize_with(now.y_u.len(), Track::default);
        let followed = self.tracks.iter_mut().zip(now.y_u.iter()).map(|(track, y_u)| {
            track.follow(tick, *y_u);
            track.last_two(*y_u)
        });
        Here { y_c: [now.y_c, now.y_c_before], y_u: followed.collect() }
    }
}
