//! CRPL with packetised predictive control: a packet carries the next actions too, and an outage
//! flies them instead of the last one.
//!
//! The plan is what π_s would do along the latent rollout without disturbance, as long as the
//! predicted rate affords: a packet of n actions has L_pkt + (n - 1) L_a bits. Power is `crpl-bw`'s for
//! one action; where the rollout runs into a shadow that no power reaches, it is raised while it can
//! still buy more of the plan that leads through.

use model::policy::Policies;
use model::world_model::{HeadsAt, WorldModel};
use nalgebra::Vector2;
use sitl::Scenario;
use sitl::msg::{Motion, Plan, TxPower};
use sitl::world::dynamics::limit_speed;

use super::crpl_bw::{HEADROOM, needed, power, snr_at_low};
use super::{Decision, crpl};
use crate::belief::Latents;

/// Motion, power and plan for the interval that begins. Sees latents alone; the scenario lends the
/// radio's own constants and the limits of motion.
#[must_use]
pub fn decide(
    policies: &Policies,
    heads: &HeadsAt,
    world: &WorldModel,
    now: Latents,
    scenario: &Scenario,
) -> Decision {
    let steps = rollout(policies, heads, world, now, scenario);
    let needed = needed(scenario.radio.packet_bits, scenario);
    let low = steps[0].snr_at_low;
    let further = |power: TxPower| affordable(low * power.level(), scenario);
    // The last interval in sight in which even high power may fail.
    let wanted = steps.iter().rposition(|s| s.snr_at_low * TxPower::High.level() < HEADROOM * needed);
    let mut power = power(low, needed);
    if wanted.is_some_and(|k| k > further(power)) && further(TxPower::High) > further(power) {
        power = TxPower::High;
    }
    let mut motions = steps.iter().map(|step| step.motion).take(1 + further(power));
    let motion = motions.next().unwrap_or(Motion::Coast);
    Decision { motion, power, next: motions.collect() }
}

/// An interval of the rollout.
struct Step {
    motion: Motion,
    /// γ at a_p = 1.
    snr_at_low: f64,
}

/// How many actions beyond its first a packet may carry at this SNR.
fn affordable(snr: f64, scenario: &Scenario) -> usize {
    (1..=Plan::MOST)
        .take_while(|&n| snr >= HEADROOM * needed(scenario.radio.bits(n), scenario))
        .last()
        .unwrap_or(0)
}

/// This interval and the [`Plan::MOST`] after it under π_s, as the predictor and the channel head
/// foresee them.
fn rollout(
    policies: &Policies,
    heads: &HeadsAt,
    world: &WorldModel,
    now: Latents,
    scenario: &Scenario,
) -> [Step; 1 + Plan::MOST] {
    let psi = world.reduced();
    let wide = |y: [f32; 2]| Vector2::from(y.map(f64::from));
    let reach = world.scale * scenario.dynamics.v_max;
    let (mut y_c, mut before, mut y_u) = (wide(now.y_c), wide(now.y_c_before), wide(now.y_u));
    let mut u_before = y_u;
    std::array::from_fn(|_| {
        let single = |y: Vector2<f64>| [y.x as f32, y.y as f32];
        let here = Latents { y_c: single(y_c), y_c_before: single(before), y_u: single(y_u), ..now };
        let (motion, _) = crpl::decide(policies, world, here, scenario);
        let step = limit_speed(psi.step_c(y_c, before, motion.vector()) - y_c, reach);
        (y_c, before) = (y_c + step, y_c);
        (y_u, u_before) = (psi.step_u(y_u, u_before), y_u);
        Step { motion, snr_at_low: snr_at_low(heads, here, scenario) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_is_as_long_as_the_rate_affords() {
        let mut scenario = Scenario::default();
        scenario.radio.b_dt = 4.0;
        // One further action: 7 bits, γ = 2^(7/4) - 1 = 2.36; two: 10 bits, 4.66.
        assert_eq!(affordable(HEADROOM * 2.35, &scenario), 0);
        assert_eq!(affordable(HEADROOM * 2.37, &scenario), 1);
        assert_eq!(affordable(HEADROOM * 4.7, &scenario), 2);
        assert_eq!(affordable(1e9, &scenario), Plan::MOST);
    }

    #[test]
    fn the_first_motion_is_crpls_own() {
        let world = WorldModel::embedded().unwrap();
        let (policies, scenario) = (Policies::shipped(2).unwrap(), Scenario::default());
        let heads = world.heads_at(scenario.channel.base_station);
        for k in 0..40 {
            let y = 0.2 * k as f32 - 4.0;
            let now = Latents { y_c: [y, 0.3 * y], y_c_before: [y - 0.2, 0.3 * y], ..Latents::default() };
            let (motion, _) = crpl::decide(&policies, &world, now, &scenario);
            assert_eq!(rollout(&policies, &heads, &world, now, &scenario)[0].motion, motion, "y_c {y}");
        }
    }
}
