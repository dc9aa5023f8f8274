//! What the camera is told of the world: where the bodies are, how fast, how large.

use nalgebra::Vector2;

use crate::units::PerObstacle;

/// A disc of the world, at the frame's time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Body {
    /// Its centre, paper units.
    pub position: Vector2<f64>,
    /// Its velocity, units per control interval.
    pub velocity: Vector2<f64>,
    /// Its radius, units.
    pub radius: f64,
}

/// What the camera sees.
#[derive(Debug, Clone, PartialEq)]
pub struct Poses {
    /// The UAV.
    pub uav: Body,
    /// The obstacles.
    pub obstacles: PerObstacle<Body>,
}
