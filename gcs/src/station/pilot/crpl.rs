//! CRPL in flight: the two optimised policies on the latents of the last two pictures.

use crpl_model::planning::policy::{Policies, features};
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use crpl_sitl::units::{Motion, TxPower};

use crate::station::belief::Latents;

/// The executed actions of π_s and π_p. Sees latents alone; the scenario lends v_max, which scales
/// an input.
#[must_use]
pub fn decide(
    policies: &Policies,
    world: &WorldModel,
    now: Latents,
    scenario: &Scenario,
) -> (Motion, TxPower) {
    let v_max = scenario.dynamics.v_max as f32;
    policies.act(&features(now.y_c, now.y_c_before, now.first_y_u(), world.scale as f32, v_max))
}
