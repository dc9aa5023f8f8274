//! Chance as an argument: a number depends only on (seed, stream, tick), never on who asked before.
//!
//! So every controller meets the same gust in the same interval, and any run can be repeated.

use nalgebra::Vector2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::units::Tick;

/// What a random number is for. The number of a stream is part of every published result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stream {
    /// The disturbance w_k of the UAV's speed.
    Wind = 1,
    /// Start conditions.
    Start = 2,
    /// Training data.
    Data = 3,
    /// Initial weights.
    Weights = 4,
    /// Mini-batches and rollouts.
    Batches = 5,
    /// Evaluation draws.
    Evaluation = 6,
    /// Pixel noise of harder cameras.
    Camera = 7,
    /// Random scenarios.
    Worlds = 8,
    /// What the camera of a flight is like: colours, ground, strengths of its effects.
    Look = 9,
    /// Shake of the camera.
    Shake = 10,
    /// Noise of the pixels.
    Grain = 11,
    /// Whether a packet of a radio is lost.
    Packets = 12,
    /// Small-scale fading of a radio channel.
    Fading = 13,
    /// Shadowing of a radio channel.
    Shadow = 14,
}

/// Words of the key stream set aside for each tick; a draw of two normals needs four, rarely more.
const WORDS_PER_TICK: u128 = 64;

/// Source of all chance in a flight.
#[derive(Debug, Clone)]
pub struct Noise {
    base: ChaCha8Rng,
}

impl Noise {
    /// The chance that belongs to `seed`.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { base: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// A generator of its own for (stream, index), to draw as much from as one likes.
    #[must_use]
    pub fn generator(&self, stream: Stream, index: u64) -> ChaCha8Rng {
        let mut rng = self.base.clone();
        // The low half numbers the purpose, the high half the index.
        rng.set_stream(stream as u64 | (index << 8));
        rng.set_word_pos(0);
        rng
    }

    /// Two standard normal deviates for this stream and tick.
    #[must_use]
    pub fn normal(&self, stream: Stream, tick: Tick) -> Vector2<f64> {
        let mut rng = self.base.clone();
        rng.set_stream(stream as u64);
        rng.set_word_pos(u128::from(tick.0) * WORDS_PER_TICK);
        Vector2::new(StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_of_asking_does_not_matter() {
        let noise = Noise::new(7);
        let late = noise.normal(Stream::Wind, Tick(50));
        let _ = noise.normal(Stream::Wind, Tick(3));
        assert_eq!(noise.normal(Stream::Wind, Tick(50)), late);
        assert_ne!(noise.normal(Stream::Start, Tick(50)), late);
        assert_ne!(Noise::new(8).normal(Stream::Wind, Tick(50)), late);
    }

    #[test]
    fn deviates_are_standard_normal() {
        let noise = Noise::new(1);
        let draws: Vec<f64> =
            (0..20_000).flat_map(|k| noise.normal(Stream::Wind, Tick(k)).data.0[0]).collect();
        let mean = draws.iter().sum::<f64>() / draws.len() as f64;
        let var = draws.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / draws.len() as f64;
        assert!(mean.abs() < 0.02 && (var - 1.0).abs() < 0.03, "mean {mean}, variance {var}");
    }
}
