//! What RCC and UCC share: a PD wish, a look-ahead at constant speed, and power that follows the SNR
//! that was measured.

use crpl_sitl::Scenario;
use crpl_sitl::radio::message::Telemetry;
use crpl_sitl::scenario::Safety;
use crpl_sitl::units::{Motion, Scale, Snr, TxPower};
use crpl_sitl::world::dynamics::limit_speed;
use crpl_sitl::world::obstacles::Obstacles;
use crpl_sitl::world::safety;
use nalgebra::Vector2;

use crate::station::seen::MotionLimits;

/// All that a reactive controller may see: the present state, and the radio one interval ago.
/// Paper units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Present {
    /// r_k
    pub r: Vector2<f64>,
    /// v_k
    pub v: Vector2<f64>,
    /// r_u,k, of each obstacle
    pub obstacles: Obstacles,
    /// γ and a_p of the interval that just ended; `None` at the start.
    pub link: Option<(Snr, TxPower)>,
}

impl Present {
    /// From the vehicle's report.
    #[must_use]
    pub fn of(telemetry: &Telemetry, scale: &Scale) -> Self {
        Self {
            r: scale.paper_from_ned(telemetry.position),
            v: scale.paper_from_ned_velocity(telemetry.velocity),
            obstacles: telemetry.obstacles(scale),
            link: telemetry.link.map(|l| (Snr::from_db(f64::from(l.snr_db)), l.power)),
        }
    }
}

/// What a reactive controller is told before a flight. Paper units.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// r_g
    pub goal: Vector2<f64>,
    /// Limits of the UAV's motion.
    pub limits: MotionLimits,
    /// Collision probability and its tolerance.
    pub safety: Safety,
    /// γ_min, linear.
    pub snr_min: f64,
    /// R_u, units.
    pub uav_radius: f64,
    /// R_o of each obstacle, units.
    pub obstacle_radii: Vec<f64>,
}

impl Task {
    /// That of a scenario.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        Self {
            goal: scenario.goal,
            limits: MotionLimits::of(scenario),
            safety: scenario.safety.clone(),
            snr_min: scenario.channel.snr_min,
            uav_radius: scenario.uav_radius,
            obstacle_radii: scenario.obstacles.iter().map(|o| o.radius).collect(),
        }
    }

    /// Boundary distance between a UAV at `r` and the nearest obstacle, units.
    fn clearance(&self, r: Vector2<f64>, obstacles: &Obstacles) -> f64 {
        obstacles
            .iter()
            .zip(&self.obstacle_radii)
            .map(|(centre, radius)| safety::clearance(r, *centre, self.uav_radius, *radius))
            .fold(f64::INFINITY, f64::min)
    }
}

/// PD wish: (0.03 (r_g - r) - 0.24 v)/a_max, scaled so that no component exceeds 1 (our choice).
#[must_use]
pub fn pd(now: &Present, task: &Task) -> Vector2<f64> {
    let a = (0.03 * (task.goal - now.r) - 0.24 * now.v) / task.limits.a_max;
    a / a.amax().max(1.0)
}

/// The action nearest to the PD wish among those that keep `least` clearance for `steps` intervals
/// at the speed they lead to; if none does, the one that keeps most. Walls are not looked at.
#[must_use]
pub fn look_ahead(now: &Present, steps: u32, least: f64, task: &Task) -> Motion {
    let wish = pd(now, task);
    let score = |motion: Motion| {
        let a = motion.vector();
        let v = limit_speed(now.v + task.limits.a_max * a, task.limits.v_max);
        let margin = (1..=steps)
            .map(|j| task.clearance(now.r + f64::from(j) * v, &now.obstacles))
            .fold(f64::INFINITY, f64::min);
        let cost = (a - wish).norm_squared();
        if margin >= least { cost } else { 100.0 - 100.0 * margin + 0.001 * cost }
    };
    let mut best = (Motion::Coast, score(Motion::Coast));
    for motion in &Motion::ALL[1..] {
        let s = score(*motion);
        if s < best.1 {
            best = (*motion, s);
        }
    }
    best.0
}

/// SNR-triggered power: high after 2 intervals below γ_min, low again after 8 in which low power
/// would have reached 1.2 γ_min (delays are our choice).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Trigger {
    below: u32,
    above: u32,
    high: bool,
}

impl Trigger {
    /// The power for the next interval.
    pub fn next(&mut self, link: Option<(Snr, TxPower)>, snr_min: f64) -> TxPower {
        if let Some((snr, power)) = link {
            self.below = if snr.0 < snr_min { self.below + 1 } else { 0 };
            self.above = if snr.0 / power.level() >= 1.2 * snr_min { self.above + 1 } else { 0 };
        }
        if !self.high && self.below >= 2 {
            self.high = true;
        } else if self.high && self.above >= 8 {
            self.high = false;
        }
        if self.high { TxPower::High } else { TxPower::Low }
    }
}
