//! The ground truth: a UAV, an obstacle or two and a base station in the unit square.
//!
//! Knows the physics of the paper's Sec. IV-A and nothing of packets, controllers or protocols.

pub mod channel;
pub mod dynamics;
pub mod energy;
pub mod noise;
pub mod obstacles;
pub mod safety;

use nalgebra::Vector2;

use crate::scenario::{Obstacle, Scenario};
use crate::units::{Snr, TxPower};
use dynamics::State;
use obstacles::Obstacles;

/// State of the world between two control intervals.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    /// The controllable entity.
    pub uav: State,
    /// The uncontrollable entity.
    pub obstacle: State,
    /// A second one, in a scenario that has one.
    pub second_obstacle: Option<State>,
}

impl World {
    /// The world at tick 0 of a flight.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        let first = |o: &Obstacle| State { r: o.position, v: o.velocity };
        Self {
            uav: State::at_rest(scenario.start),
            obstacle: first(&scenario.obstacle),
            second_obstacle: scenario.second_obstacle.as_ref().map(first),
        }
    }

    /// One control interval: normalised acceleration `a`, velocity disturbance `kick`.
    pub fn step(&mut self, a: Vector2<f64>, kick: Vector2<f64>, scenario: &Scenario) {
        self.uav = dynamics::step(self.uav, a, kick, &scenario.dynamics);
        self.step_obstacles(scenario);
    }

    /// The obstacles move on alone, each through the other.
    pub fn step_obstacles(&mut self, scenario: &Scenario) {
        self.obstacle = dynamics::step_obstacle(self.obstacle, scenario.obstacle.margin);
        if let (Some(state), Some(second)) = (&mut self.second_obstacle, &scenario.second_obstacle) {
            *state = dynamics::step_obstacle(*state, second.margin);
        }
    }

    /// Where the obstacles are.
    #[must_use]
    pub fn obstacles(&self) -> Obstacles {
        Obstacles { first: self.obstacle.r, second: self.second_obstacle.map(|o| o.r) }
    }

    /// Received SNR at transmit power `power`.
    #[must_use]
    pub fn snr(&self, power: TxPower, scenario: &Scenario) -> Snr {
        channel::snr(self.obstacles().gain(self.uav.r, scenario), power.level(), &scenario.channel)
    }

    /// Boundary distance between UAV and the nearest obstacle.
    #[must_use]
    pub fn clearance(&self, scenario: &Scenario) -> f64 {
        self.obstacles().clearance(self.uav.r, scenario)
    }
}
