//! What a controller may see, as types: the constants that it is told before a flight, and what reaches
//! the station in flight. Nothing else crosses these types, so a signature says what is seen.

use crpl_sitl::Scenario;
use crpl_sitl::radio::message::{Held, LinkReport, Telemetry};
use crpl_sitl::scenario::Rule;
use crpl_sitl::units::{Scale, Tick};

/// Limits of the UAV's motion (Sec. IV-A).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionLimits {
    /// v_max, units per interval.
    pub v_max: f64,
    /// a_max, units per interval².
    pub a_max: f64,
}

impl MotionLimits {
    /// Those of a scenario.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        Self { v_max: scenario.dynamics.v_max, a_max: scenario.dynamics.a_max }
    }
}

/// Constants of the station's own radio; no geometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadioConstants {
    /// B Δt, bits per interval and unit of spectral efficiency.
    pub b_dt: f64,
    /// L_pkt, bits.
    pub packet_bits: f64,
    /// P_n, in the units of the channel gain times the transmit power.
    pub noise_power: f64,
    /// γ_min, linear.
    pub snr_min: f64,
}

impl RadioConstants {
    /// Those of a scenario.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        Self {
            b_dt: scenario.radio.b_dt,
            packet_bits: scenario.radio.packet_bits,
            noise_power: scenario.channel.noise_power,
            snr_min: scenario.channel.snr_min,
        }
    }
}

/// What the belief is told before a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeliefConfig {
    /// Limits of the UAV's motion.
    pub limits: MotionLimits,
    /// Standard deviation of the gusts' velocity change on each axis, units per interval.
    pub gust_std: f64,
    /// M, frames from which place and speed are estimated.
    pub window: usize,
    /// Number of obstacles in the frames.
    pub obstacles: usize,
    /// Between the paper's units and the link's.
    pub scale: Scale,
    /// What becomes of a packet in an outage.
    pub rule: Rule,
}

impl BeliefConfig {
    /// That of a scenario.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        Self {
            limits: MotionLimits::of(scenario),
            gust_std: scenario.disturbance.gust_std(),
            window: usize::try_from(scenario.observer.window).unwrap_or(usize::MAX),
            obstacles: scenario.obstacles.len(),
            scale: scenario.scale,
            rule: scenario.radio.rule,
        }
    }
}

/// What the station hears of the vehicle beside the frame: no position, no velocity, no obstacle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heard {
    /// The tick that begins now.
    pub tick: Tick,
    /// What the vehicle flew in the interval that just ended; `None` before the first delivery.
    pub held: Option<Held>,
    /// The radio in the interval that just ended; `None` at tick 0.
    pub link: Option<LinkReport>,
}

impl From<&Telemetry> for Heard {
    fn from(telemetry: &Telemetry) -> Self {
        Self { tick: telemetry.tick, held: telemetry.held, link: telemetry.link }
    }
}
