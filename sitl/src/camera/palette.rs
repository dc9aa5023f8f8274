//! Colours of the bodies: those of the configuration, or drawn for each flight.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::config::{CameraConfig, Palette, Rgb};

/// The colours of one flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Colours {
    pub uav: Rgb,
    pub obstacle: Rgb,
    pub obstacle_2: Rgb,
}

/// Least distance in RGB of a body's colour from the ground and from another body's, with [`Palette::Any`].
const APART: f32 = 0.45;
/// Least distance of a distractor's colour from the bodies', and from the ground.
const DISTRACTOR_APART: [f32; 2] = [0.5, 0.3];
/// Draws until the last one is taken though it is too near. A ground and three bodies leave room.
const TRIES: usize = 10_000;

impl Colours {
    pub fn draw(config: &CameraConfig, ground: f32, rng: &mut ChaCha8Rng) -> Self {
        match config.colours {
            Palette::Given => {
                Self { uav: config.uav, obstacle: config.obstacle, obstacle_2: config.obstacle_2 }
            }
            Palette::Family => Self::family(rng),
            Palette::Any => Self::any([ground; 3], rng),
        }
    }

    /// One channel strong, the others weak.
    fn family(rng: &mut ChaCha8Rng) -> Self {
        let mut between = |low: f32, high: f32| rng.random_range(low..high);
        Self {
            uav: [between(0.7, 1.0), between(0.0, 0.45), between(0.0, 0.35)],
            obstacle: [between(0.0, 0.35), between(0.0, 0.45), between(0.7, 1.0)],
            obstacle_2: [between(0.0, 0.35), between(0.7, 1.0), between(0.0, 0.45)],
        }
    }

    fn any(ground: Rgb, rng: &mut ChaCha8Rng) -> Self {
        let uav = draw_apart(&[(ground, APART)], rng);
        let obstacle = draw_apart(&[(ground, APART), (uav, APART)], rng);
        let obstacle_2 = draw_apart(&[(ground, APART), (uav, APART), (obstacle, APART)], rng);
        Self { uav, obstacle, obstacle_2 }
    }

    /// The colour of the obstacle with this index.
    pub fn of_obstacle(&self, index: usize) -> Rgb {
        if index == 1 { self.obstacle_2 } else { self.obstacle }
    }

    /// A colour that is neither the bodies' nor the ground's.
    pub fn other(&self, ground: f32, rng: &mut ChaCha8Rng) -> Rgb {
        let [bodies, from_ground] = DISTRACTOR_APART;
        draw_apart(&[(self.uav, bodies), (self.obstacle, bodies), ([ground; 3], from_ground)], rng)
    }
}

/// A colour at least so far from each of these.
fn draw_apart(others: &[(Rgb, f32)], rng: &mut ChaCha8Rng) -> Rgb {
    let mut colour = Rgb::default();
    for _ in 0..TRIES {
        colour = rng.random();
        if others.iter().all(|(other, least)| distance(colour, *other) > *least) {
            break;
        }
    }
    colour
}

fn distance(a: Rgb, b: Rgb) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
}
