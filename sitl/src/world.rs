//! The ground truth: a UAV, an obstacle and a base station in the unit square.
//!
//! Knows the physics of the paper's Section IV-A and nothing of packets, controllers or protocols.

pub mod channel;
pub mod dynamics;
pub mod energy;
pub mod noise;
pub mod safety;

use nalgebra::Vector2;

use crate::msg::TxPower;
use crate::scenario::Scenario;
use crate::units::Snr;
use dynamics::State;

/// State of the world between two control intervals.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    /// The controllable entity.
    pub uav: State,
    /// The uncontrollable entity.
    pub obstacle: State,
}

impl World {
    /// The world at tick 0 of a flight.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        Self {
            uav: State::at_rest(scenario.start),
            obstacle: State { r: scenario.obstacle.position, v: scenario.obstacle.velocity },
        }
    }

    /// One control interval: normalised acceleration `a`, velocity disturbance `kick`.
    pub fn step(&mut self, a: Vector2<f64>, kick: Vector2<f64>, scenario: &Scenario) {
        self.uav = dynamics::step(self.uav, a, kick, &scenario.dynamics);
        self.obstacle = dynamics::step_obstacle(self.obstacle, scenario.obstacle.margin);
    }

    /// Received SNR at transmit power `power`.
    #[must_use]
    pub fn snr(&self, power: TxPower, scenario: &Scenario) -> Snr {
        let gain = channel::gain(self.uav.r, self.obstacle.r, scenario.obstacle.radius, &scenario.channel);
        channel::snr(gain, power.level(), &scenario.channel)
    }

    /// Boundary distance between UAV and obstacle.
    #[must_use]
    pub fn clearance(&self, scenario: &Scenario) -> f64 {
        safety::clearance(self.uav.r, self.obstacle.r, scenario.uav_radius, scenario.obstacle.radius)
    }
}
