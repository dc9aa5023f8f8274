//! The reactive controllers RCC and UCC: a PD wish, a look-ahead at constant speed, and power that follows the SNR
//! that was measured. They see the present alone.
//!
//! RCC, the reactive constrained controller, keeps CRPL's collision constraint along the look-ahead; UCC, the
//! unconstrained communication controller, a geometric margin. `rcc` and `ucc` fly the numbers that `gcs tune`
//! found; `rcc-paper` and `ucc-paper` those of the simplest reading of the paper.

use crpl_sitl::Scenario;
use crpl_sitl::radio::message::Telemetry;
use crpl_sitl::scenario::Safety;
use crpl_sitl::units::{Motion, Scale, Snr, TxPower};
use crpl_sitl::world::dynamics::limit_speed;
use crpl_sitl::world::obstacles::Obstacles;
use crpl_sitl::world::safety;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

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

/// Every number of a reactive controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Law {
    /// Gain on r_g - r, 1/interval².
    pub position_gain: f64,
    /// Gain on -v, 1/interval.
    pub velocity_gain: f64,
    /// How far it extrapolates, intervals.
    pub steps: u32,
    /// The clearance that it keeps, units; left out, that at which p_coll = δ1.
    pub margin: Option<f64>,
    /// Intervals below γ_min after which the power is raised.
    pub raise_after: u32,
    /// Intervals in which low power would have reached `headroom` γ_min, after which it is lowered again.
    pub lower_after: u32,
    /// See `lower_after`.
    pub headroom: f64,
}

impl Law {
    /// RCC in the simplest reading of the paper (all of it our choice).
    pub const RCC_PAPER: Self = Self {
        position_gain: 0.03,
        velocity_gain: 0.24,
        steps: 12,
        margin: None,
        raise_after: 2,
        lower_after: 8,
        headroom: 1.2,
    };

    /// UCC in the simplest reading of the paper; p_coll at its margin is 0.198 (all of it our choice).
    pub const UCC_PAPER: Self = Self { steps: 8, margin: Some(0.028), ..Self::RCC_PAPER };

    /// The same with three significant digits: numbers that can be typed.
    #[must_use]
    pub fn rounded(self) -> Self {
        let three = |x: f64| format!("{x:.2e}").parse().unwrap_or(x);
        Self {
            position_gain: three(self.position_gain),
            velocity_gain: three(self.velocity_gain),
            margin: self.margin.map(three),
            headroom: three(self.headroom),
            ..self
        }
    }

    /// What is out of range, in words.
    ///
    /// # Errors
    /// The first key that is.
    pub fn check(&self) -> Result<(), String> {
        let real = |key: &str, x: f64, most: f64| match (0.0..=most).contains(&x) {
            true => Ok(()),
            false => Err(format!("{key} = {x}: must lie in [0, {most}]")),
        };
        real("position_gain", self.position_gain, 100.0)?;
        real("velocity_gain", self.velocity_gain, 100.0)?;
        real("margin", self.margin.unwrap_or(0.0), 1.0)?;
        real("headroom", self.headroom, 1000.0)?;
        match (1..=1000).contains(&self.steps) {
            true => Ok(()),
            false => Err(format!("steps = {}: must lie in [1, 1000]", self.steps)),
        }
    }
}

/// A reactive controller with its power trigger.
#[derive(Debug, Clone)]
pub struct Reactive {
    law: Law,
    task: Task,
    trigger: Trigger,
}

impl Reactive {
    /// The controller of `task` by `law`, at low power.
    #[must_use]
    pub fn new(law: Law, task: Task) -> Self {
        Self { law, task, trigger: Trigger::default() }
    }

    /// Motion and power for the interval that begins.
    pub fn decide(&mut self, now: &Present) -> (Motion, TxPower) {
        let power = self.trigger.next(now.link, self.task.snr_min, &self.law);
        (look_ahead(now, &self.law, &self.task), power)
    }
}

/// Clearance at which p_coll = δ1: d_min + τ_c ln((1 - δ1)/δ1).
#[must_use]
pub fn constrained_clearance(safety: &Safety) -> f64 {
    let delta = safety.collision_tolerance;
    safety.d_min + safety.softness * ((1.0 - delta) / delta).ln()
}

/// PD wish: (k_p (r_g - r) - k_v v)/a_max, scaled so that no component exceeds 1 (our choice).
#[must_use]
pub fn pd(now: &Present, law: &Law, task: &Task) -> Vector2<f64> {
    let a = (law.position_gain * (task.goal - now.r) - law.velocity_gain * now.v) / task.limits.a_max;
    a / a.amax().max(1.0)
}

/// The action nearest to the PD wish among those that keep the law's clearance for its steps at the speed they lead
/// to; if none does, the one that keeps most. Walls are not looked at.
#[must_use]
pub fn look_ahead(now: &Present, law: &Law, task: &Task) -> Motion {
    let wish = pd(now, law, task);
    let least = law.margin.unwrap_or_else(|| constrained_clearance(&task.safety));
    let score = |motion: Motion| {
        let a = motion.vector();
        let v = limit_speed(now.v + task.limits.a_max * a, task.limits.v_max);
        let margin = (1..=law.steps)
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

/// SNR-triggered power: high after some intervals below γ_min, low again after some in which low power would have
/// done (delays are our choice).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Trigger {
    below: u32,
    above: u32,
    high: bool,
}

impl Trigger {
    /// The power for the next interval.
    pub fn next(&mut self, link: Option<(Snr, TxPower)>, snr_min: f64, law: &Law) -> TxPower {
        if let Some((snr, power)) = link {
            self.below = if snr.0 < snr_min { self.below + 1 } else { 0 };
            self.above = if snr.0 / power.level() >= law.headroom * snr_min { self.above + 1 } else { 0 };
        }
        if !self.high && self.below >= law.raise_after {
            self.high = true;
        } else if self.high && self.above >= law.lower_after {
            self.high = false;
        }
        if self.high { TxPower::High } else { TxPower::Low }
    }
}
