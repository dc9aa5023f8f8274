//! Discs that drift over the ground and are neither UAV nor obstacle.

use std::f64::consts::TAU;

use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::config::{CameraConfig, Rgb};
use super::frame::SIDE;
use super::palette::Colours;
use super::poses::Body;
use crate::units::Tick;

/// Where a distractor turns back: its centre's distance from the picture's edge, px.
const TURN_PX: f64 = 4.0;
/// Least distance from the edge at which one starts, px.
const START_PX: f64 = 5.0;

/// One of them, lengths in px.
#[derive(Debug, Clone, Copy)]
pub(super) struct Distractor {
    start: Vector2<f64>,
    velocity: Vector2<f64>,
    radius: f64,
    pub colour: Rgb,
}

impl Distractor {
    pub fn draw_all(
        config: &CameraConfig,
        colours: &Colours,
        ground: f32,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Self> {
        let distractors = config.distractors;
        let count = distractors.count.draw_whole(rng);
        let mut one = |_| {
            let [x, y, turn]: [f64; 3] = rng.random();
            let place = |share: f64| START_PX + share * (SIDE as f64 - 2.0 * START_PX);
            let (sin, cos) = (TAU * turn).sin_cos();
            Self {
                start: Vector2::new(place(x), place(y)),
                velocity: distractors.speed.draw(rng) * Vector2::new(cos, sin),
                radius: distractors.radius.draw(rng),
                colour: colours.other(ground, rng),
            }
        };
        (0..count).map(&mut one).collect()
    }

    /// Where it is at `tick`, px, and how fast, px per interval.
    pub fn at(&self, tick: Tick) -> Body {
        let axes = [0, 1].map(|n| reflected(self.start[n], self.velocity[n], tick.0 as f64));
        let [(x, vx), (y, vy)] = axes;
        Body { position: Vector2::new(x, y), velocity: Vector2::new(vx, vy), radius: self.radius }
    }
}

/// Place and speed of what goes to and fro between the edges, after `time`.
fn reflected(start: f64, speed: f64, time: f64) -> (f64, f64) {
    let way = SIDE as f64 - 2.0 * TURN_PX;
    let gone = (start - TURN_PX + speed * time).rem_euclid(2.0 * way);
    if gone > way { (TURN_PX + 2.0 * way - gone, -speed) } else { (TURN_PX + gone, speed) }
}
