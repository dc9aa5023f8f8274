//! CRPL in receding horizon: π_s is re-optimised in flight, from the present belief, every few
//! intervals; power is `crpl-bw`'s.
//!
//! What it gains on a policy that was optimised once: it plans for the gusts that there were, and for
//! an obstacle that moves, whose speed it reads from the pictures.

use model::optimise::{Here, Receding};
use model::policy::{Policies, features};
use model::world_model::{HeadsAt, WorldModel};
use sitl::Scenario;
use sitl::msg::{Motion, TxPower};
use sitl::units::Tick;

use super::crpl_bw::{needed, power, snr_at_low};
use crate::belief::Latents;

/// Pictures from which the obstacle's speed is read.
const WINDOW: usize = 8;

/// The policy under way, and where the obstacle was.
#[derive(Debug, Clone)]
pub struct CrplRh {
    receding: Receding,
    policies: Policies,
    track: Vec<(Tick, [f32; 2])>,
}

impl CrplRh {
    /// Takes off with `policies`, of which `receding` has the motion.
    #[must_use]
    pub fn new(receding: Receding, policies: Policies) -> Self {
        Self { receding, policies, track: Vec::new() }
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
        self.follow(tick, now.y_u);
        let speed = slope(&self.track);
        let here = Here {
            y_c: [now.y_c, now.y_c_before],
            y_u: [now.y_u, std::array::from_fn(|i| now.y_u[i] - speed[i])],
        };
        let remaining = scenario.horizon.saturating_sub(tick.0);
        self.receding.at(tick.0, &here, remaining as usize);
        self.policies.motion.clone_from(self.receding.motion());
        let v_max = scenario.dynamics.v_max as f32;
        let x = features(now.y_c, now.y_c_before, self.receding.told(), world.scale as f32, v_max);
        let motion = Motion::nearest(self.policies.mean_motion(&x));
        (motion, power(snr_at_low(heads, now, scenario), needed(scenario.radio.packet_bits, scenario)))
    }

    /// Adds the newest place; after a turn, what came before it says nothing more.
    fn follow(&mut self, tick: Tick, y_u: [f32; 2]) {
        if let ([.., (t1, b), (t2, c)], speed) = (self.track.as_slice(), slope(&self.track))
            && t2 > t1
        {
            let gap = (tick.0 - t2.0) as f32;
            let moved: [f32; 2] = std::array::from_fn(|i| y_u[i] - c[i]);
            let turned = (0..2).any(|i| {
                let (was, is) = (gap * speed[i], moved[i]);
                was * is < 0.0 && (was - is).abs() > TURN * (was.abs() + (c[i] - b[i]).abs())
            });
            if turned {
                self.track.drain(..self.track.len() - 1);
            }
        }
        self.track.push((tick, y_u));
        if self.track.len() > WINDOW {
            self.track.remove(0);
        }
    }
}

/// A step against the former speed, this large beside it, is a turn and no noise of the encoder.
const TURN: f32 = 0.9;

/// Least-squares slope per interval; zero of fewer than two points.
fn slope(track: &[(Tick, [f32; 2])]) -> [f32; 2] {
    let n = track.len() as f32;
    let mean_t = track.iter().map(|(t, _)| t.0 as f32).sum::<f32>() / n;
    let spread: f32 = track.iter().map(|(t, _)| (t.0 as f32 - mean_t).powi(2)).sum();
    if track.len() < 2 || spread == 0.0 {
        return [0.0; 2];
    }
    std::array::from_fn(|i| {
        let mean_y = track.iter().map(|(_, y)| y[i]).sum::<f32>() / n;
        track.iter().map(|(t, y)| (t.0 as f32 - mean_t) * (y[i] - mean_y)).sum::<f32>() / spread
    })
}
