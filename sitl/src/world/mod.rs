//! The ground truth: a UAV, obstacles and a base station in the unit square.
//!
//! Knows the physics of the paper's Sec. IV-A and nothing of packets, controllers or protocols.

pub mod channel;
pub mod contact;
pub mod dynamics;
pub mod energy;
pub mod obstacles;
pub mod safety;

pub use crate::units::noise;
use nalgebra::Vector2;

use crate::camera::{self, Body, Frame, Poses};
use crate::scenario::Scenario;
use crate::units::{Snr, TxPower};
use dynamics::State;
use obstacles::{Obstacles, PerObstacle};

/// State of the world between two control intervals.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    /// The controllable entity.
    pub uav: State,
    /// The uncontrollable entities, in the scenario's order.
    pub obstacles: PerObstacle<State>,
}

impl World {
    /// The world at tick 0 of a flight.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        let obstacles = scenario.obstacles.iter().map(|o| State { r: o.position, v: o.velocity });
        Self { uav: State::at_rest(scenario.start), obstacles: obstacles.collect() }
    }

    /// One control interval: normalised acceleration `a`, velocity disturbance `gust`.
    pub fn step(&mut self, a: Vector2<f64>, gust: Vector2<f64>, scenario: &Scenario) {
        self.uav = dynamics::step(self.uav, a, gust, &scenario.dynamics);
        self.step_obstacles(scenario);
    }

    /// The obstacles move on alone, each through the others.
    pub fn step_obstacles(&mut self, scenario: &Scenario) {
        for (state, obstacle) in self.obstacles.iter_mut().zip(&scenario.obstacles) {
            *state = dynamics::step_obstacle(*state, obstacle.margin);
        }
    }

    /// Where the obstacles are, paper units.
    #[must_use]
    pub fn obstacles(&self) -> Obstacles {
        self.obstacles.iter().map(|o| o.r).collect()
    }

    /// What the camera sees of this world.
    #[must_use]
    pub fn poses(&self, scenario: &Scenario) -> Poses {
        let body = |state: &State, radius| Body { position: state.r, velocity: state.v, radius };
        let obstacles = self.obstacles.iter().zip(&scenario.obstacles);
        Poses {
            uav: body(&self.uav, scenario.uav_radius),
            obstacles: obstacles.map(|(state, obstacle)| body(state, obstacle.radius)).collect(),
        }
    }

    /// The clean frame of this world: discs on black, before any effect of the camera.
    #[must_use]
    pub fn frame(&self, scenario: &Scenario) -> Frame {
        camera::render_all(self.uav.r, &self.obstacles(), scenario)
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

#[cfg(test)]
mod tests;
