//! Latents without an encoder: what the frames of the true positions would give if encoding had no
//! error. CRPL on them shows, beside CRPL on frames, what the encoder costs in closed loop.

use std::sync::Arc;

use crpl_model::planning::policy::Policies;
use crpl_model::world_model::WorldModel;
use crpl_sitl::units::{Motion, TxPower};
use nalgebra::Vector2;

use super::crpl::Crpl;
use super::reactive::Present;
use crate::station::belief::Latents;

/// CRPL that sees true positions. For measurements alone.
#[derive(Debug, Clone)]
pub struct CrplExactLatents {
    crpl: Crpl,
    world: Arc<WorldModel>,
    memory: LastLatents,
}

impl CrplExactLatents {
    /// CRPL on the exact latents of `world`.
    #[must_use]
    pub fn new(crpl: Crpl, world: Arc<WorldModel>) -> Self {
        Self { crpl, world, memory: LastLatents::default() }
    }

    /// π_s and π_p.
    pub(super) fn policies(&self) -> &Arc<Policies> {
        self.crpl.policies()
    }

    /// The executed actions of π_s and π_p.
    pub fn decide(&mut self, now: &Present) -> (Motion, TxPower) {
        self.crpl.decide(self.memory.latents(&self.world, now))
    }
}

/// y_c of the interval before: M = 2.
#[derive(Debug, Clone, Default)]
pub struct LastLatents {
    before: Option<[f32; 2]>,
}

impl LastLatents {
    /// The latents whose probe tells exactly these positions.
    pub fn latents(&mut self, world: &WorldModel, now: &Present) -> Latents {
        let plane = |y: Option<Vector2<f64>>| y.map_or([0.0; 2], |y| [y.x as f32, y.y as f32]);
        let y_c = plane(world.probe.c.invert(now.r));
        let y_c_before = self.before.replace(y_c).unwrap_or(y_c);
        let y_u = now.obstacles.iter().map(|place| plane(world.probe.u.invert(*place))).collect();
        Latents { y_c, y_c_before, y_u }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crpl_model::encoder::BuiltIn;
    use crpl_sitl::{Scenario, camera};

    #[test]
    fn they_are_what_the_encoder_sees() {
        let world = WorldModel::built_in(BuiltIn::Centroid).unwrap();
        let scenario = Scenario::default();
        let obstacle = scenario.obstacle().position;
        let mut memory = LastLatents::default();
        let mut before = None;
        for r in [Vector2::new(0.3, 0.7), Vector2::new(0.33, 0.69)] {
            let obstacles = [obstacle].into();
            let exact = memory.latents(&world, &Present { r, v: Vector2::zeros(), obstacles, link: None });
            let seen = world.encode(&camera::render(r, obstacle, &scenario));
            // A hundredth of the frame is one pixel; the latents' scale is S units a side.
            let px =
                |a: [f32; 2], b: [f32; 2]| 100.0 * f64::from((a[0] - b[0]).hypot(a[1] - b[1])) / world.scale;
            assert!(px(exact.y_c, world.y_c(&seen)) < 0.2);
            assert_eq!(exact.y_c_before, before.unwrap_or(exact.y_c));
            before = Some(exact.y_c);
        }
    }
}
