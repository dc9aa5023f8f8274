//! How far a reading of the votes is off, as told from how far they lie apart: learned without labels.
//!
//! A body that obeys its predictor has p_{k+2d} - 2 p_{k+d} + p_k = y, what the actions add. With independent
//! errors of variance σ² in each coordinate the difference has 6 σ². Sorted by the spread of the votes, the differences
//! of a recording that was not trained on give σ as a function of the spread.

use crate::encoder::votes::BODIES;
use crate::numeric::statistics::quantile;
use crate::numeric::tensors::{Reader, TensorError, Writer};

/// Points of each function.
pub const KNOTS: usize = 8;

/// Smallest σ, px: below it a float's own rounding and the rim of a pixel count.
const LEAST_PX: f64 = 0.01;

/// Median of |e| for a standard normal e.
const MEDIAN: f64 = 0.6745;

/// σ of both bodies as functions of the votes' spread.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadingNoise {
    /// Root of the spread and σ, px, in rising order of the first.
    knots: [[[f32; 2]; KNOTS]; BODIES],
}

/// A second difference of a body's readings, px, both axes, and the largest root of the spread among its pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpreadSample {
    /// Root of the spread, px.
    pub spread_px: f64,
    /// The difference less what the actions add, px.
    pub difference_px: [f64; 2],
}

impl Default for ReadingNoise {
    /// Before anything was learned: 0.3 px throughout.
    fn default() -> Self {
        Self { knots: [std::array::from_fn(|k| [k as f32, 0.3]); BODIES] }
    }
}

impl ReadingNoise {
    /// From the differences of both bodies. The median of each group of equal size counts: an error of several pixels
    /// is a lost body and no noise. σ rises with the spread.
    #[must_use]
    pub fn fit(samples: [&[SpreadSample]; BODIES]) -> Self {
        let mut out = Self::default();
        for (knots, samples) in out.knots.iter_mut().zip(samples) {
            let mut samples = samples.to_vec();
            if samples.len() < KNOTS {
                continue;
            }
            samples.sort_by(|a, b| a.spread_px.total_cmp(&b.spread_px));
            let mut least = LEAST_PX;
            for (n, knot) in knots.iter_mut().enumerate() {
                let group = &samples[n * samples.len() / KNOTS..(n + 1) * samples.len() / KNOTS];
                let spreads: Vec<f64> = group.iter().map(|s| s.spread_px).collect();
                let errors: Vec<f64> = group.iter().flat_map(|s| s.difference_px.map(f64::abs)).collect();
                least = (quantile(&errors, 0.5) / MEDIAN / 6.0f64.sqrt()).max(least);
                *knot = [quantile(&spreads, 0.5) as f32, least as f32];
            }
        }
        out
    }

    /// σ of a coordinate of body `body`, px, where the votes have this spread, px².
    #[must_use]
    pub fn sigma_px(&self, body: usize, spread: f32) -> f64 {
        let (knots, spread) = (&self.knots[body], spread.max(0.0).sqrt());
        let after = knots.partition_point(|k| k[0] <= spread);
        let sigma = match (after.checked_sub(1).map(|n| knots[n]), knots.get(after)) {
            (None, _) => knots[0][1],
            // Beyond the last group it rises as the spread does.
            (Some([x, y]), None) => y * (spread / x.max(1e-3)).max(1.0),
            (Some([x0, y0]), Some([x1, y1])) => y0 + (y1 - y0) * (spread - x0) / (x1 - x0).max(1e-6),
        };
        f64::from(sigma)
    }

    /// For the disk.
    pub fn put(&self, out: &mut Writer) {
        out.f32("votes.noise", &[BODIES, KNOTS, 2], self.knots.iter().flatten().flatten().copied());
    }

    /// From the disk.
    ///
    /// # Errors
    /// If the tensor is missing or has another shape.
    pub fn get(from: &Reader<'_>) -> Result<Self, TensorError> {
        let v = from.f32("votes.noise", &[BODIES, KNOTS, 2])?;
        let at = |body: usize, n: usize| [v[(body * KNOTS + n) * 2], v[(body * KNOTS + n) * 2 + 1]];
        Ok(Self { knots: std::array::from_fn(|body| std::array::from_fn(|n| at(body, n))) })
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::world::noise::{Noise, Stream};
    use rand::RngExt;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    #[test]
    fn it_finds_the_noise_behind_differences_and_lost_bodies_do_not_count() {
        let mut rng = Noise::new(1).generator(Stream::Evaluation, 0);
        let samples: Vec<SpreadSample> = (0..8000)
            .map(|n| {
                let spread = 1.0 + 3.0 * rng.random::<f64>();
                let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
                let mut difference = || 0.1 * spread * (normal() - 2.0 * normal() + normal());
                let difference_px = [difference(), difference()];
                let lost = n % 25 == 0;
                SpreadSample {
                    spread_px: spread,
                    difference_px: difference_px.map(|d| if lost { 40.0 } else { d }),
                }
            })
            .collect();
        let noise = ReadingNoise::fit([&samples, &samples]);
        for spread in [1.3f32, 2.0, 3.0, 3.7] {
            let found = noise.sigma_px(0, spread * spread);
            assert!((found / (0.1 * f64::from(spread)) - 1.0).abs() < 0.15, "{found} at {spread}");
        }
        assert!(noise.sigma_px(1, 64.0) > 0.7, "beyond what was seen it rises");
        let mut out = Writer::default();
        noise.put(&mut out);
        let bytes = out.bytes().unwrap();
        assert_eq!(ReadingNoise::get(&Reader::new(&bytes, "x".into()).unwrap()).unwrap(), noise);
    }
}
