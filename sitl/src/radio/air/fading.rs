//! Chance in a channel: small-scale fading by time slot, and shadowing by place.
//!
//! Both are functions of (seed, link) and of the slot or the place, never of what was drawn before.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector2;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crate::units::noise::{Noise, Stream};

/// Small-scale fading of the received power.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Fading {
    /// None.
    None,
    /// Rician, with a factor K that grows from the horizon to the zenith, linear in dB: M. M. Azari et al., IEEE
    /// Trans. Commun. 66(1), 2018, K = a e^(b θ).
    Rician {
        /// K at the horizon, dB.
        horizon_db: f64,
        /// K at the zenith, dB.
        zenith_db: f64,
    },
}

impl Fading {
    /// The Rician factor K, linear, at an elevation in rad; `None` where nothing fades.
    #[must_use]
    pub fn factor(&self, elevation: f64) -> Option<f64> {
        match *self {
            Self::None => None,
            Self::Rician { horizon_db, zenith_db } => {
                let part = (elevation / (PI / 2.0)).clamp(0.0, 1.0);
                Some(10f64.powf((horizon_db + part * (zenith_db - horizon_db)) / 10.0))
            }
        }
    }

    /// What fading adds to the received power in a slot, dB; the mean of the power is that without fading.
    #[must_use]
    pub fn gain_db(&self, elevation: f64, noise: &Noise, slot: u64) -> f64 {
        let Some(k) = self.factor(elevation) else { return 0.0 };
        let mut rng = noise.generator(Stream::Fading, slot);
        let [x, y]: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
        let scatter = (0.5 / (k + 1.0)).sqrt();
        let direct = (k / (k + 1.0)).sqrt();
        20.0 * (direct + scatter * x).hypot(scatter * y).max(1e-9).log10()
    }
}

/// Shadowing that is correlated in space.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Shadowing {
    /// Standard deviation, dB. 0 is none.
    pub sigma_db: f64,
    /// Distance at which the correlation has fallen to 1/e, m.
    pub distance_m: f64,
}

impl Default for Shadowing {
    fn default() -> Self {
        Self { sigma_db: 0.0, distance_m: 50.0 }
    }
}

/// Plane waves of which a field is the sum.
const WAVES: usize = 256;

/// A Gaussian field over the ground with mean 0, variance 1 and correlation e^(-d / distance): M. Gudmundson,
/// Electron. Lett. 27(23), 1991. It is the sum of plane waves with that spectrum, so it is a function of
/// seed and place alone.
#[derive(Debug, Clone)]
pub struct ShadowField {
    waves: Vec<(Vector2<f64>, f64)>,
}

impl ShadowField {
    /// The field number `index` of a seed.
    #[must_use]
    pub fn new(noise: &Noise, index: u64, distance_m: f64) -> Self {
        let mut rng = noise.generator(Stream::Shadow, index);
        let waves = (0..WAVES).map(|_| {
            let [part, turn, phase]: [f64; 3] = std::array::from_fn(|_| rng.random());
            // The inverse of the spectrum's distribution 1 - (1 + (k d)²)^(-1/2).
            let k = ((1.0 - part).powi(-2) - 1.0).sqrt() / distance_m;
            let (sin, cos) = (TAU * turn).sin_cos();
            (Vector2::new(k * cos, k * sin), TAU * phase)
        });
        Self { waves: waves.collect() }
    }

    /// Its value at a place, north and east in metres.
    #[must_use]
    pub fn at(&self, place: Vector2<f64>) -> f64 {
        let sum: f64 = self.waves.iter().map(|(k, phase)| (k.dot(&place) + phase).cos()).sum();
        sum * (2.0 / WAVES as f64).sqrt()
    }
}

/// The standard normal distribution function, to 1e-7: Abramowitz and Stegun, 26.2.17.
#[must_use]
pub fn normal_distribution(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * x.abs());
    let sum = [1.330_274_429, -1.821_255_978, 1.781_477_937, -0.356_563_782, 0.319_381_530]
        .iter()
        .fold(0.0, |sum, b| (sum + b) * t);
    let above = (-x * x / 2.0).exp() / TAU.sqrt() * sum;
    if x < 0.0 { above } else { 1.0 - above }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_has_variance_one_and_gudmundson_s_correlation() {
        let step = Vector2::new(50.0, 0.0);
        let (mut square, mut product, count) = (0.0, 0.0, 20_000);
        for seed in 0..count {
            let field = ShadowField::new(&Noise::new(seed), 0, 50.0);
            let place = Vector2::new(seed as f64, 7.0);
            square += field.at(place).powi(2);
            product += field.at(place) * field.at(place + step);
        }
        let [variance, correlation] = [square, product].map(|sum| sum / count as f64);
        assert!((variance - 1.0).abs() < 0.03, "{variance}");
        assert!((correlation - (-1f64).exp()).abs() < 0.03, "{correlation}");
    }

    #[test]
    fn fading_keeps_the_mean_and_spreads_as_rice_says() {
        let fading = Fading::Rician { horizon_db: 5.0, zenith_db: 15.0 };
        let (noise, count) = (Noise::new(1), 50_000_u64);
        for (elevation, k_db) in [(0.0, 5.0), (PI / 4.0, 10.0), (PI / 2.0, 15.0)] {
            let k = fading.factor(elevation).unwrap();
            assert!((10.0 * k.log10() - k_db).abs() < 1e-9);
            let power = |slot| 10f64.powf(fading.gain_db(elevation, &noise, slot) / 10.0);
            let (mut sum, mut square) = (0.0, 0.0);
            for slot in 0..count {
                sum += power(slot);
                square += power(slot).powi(2);
            }
            let mean = sum / count as f64;
            // Variance of the power: (1 + 2 K) / (1 + K)².
            let variance = square / count as f64 - mean * mean;
            assert!((mean - 1.0).abs() < 0.01, "{mean}");
            assert!((variance / ((1.0 + 2.0 * k) / (1.0 + k).powi(2)) - 1.0).abs() < 0.05, "{variance}");
        }
        assert_eq!(Fading::None.gain_db(0.3, &noise, 5), 0.0);
    }

    #[test]
    fn the_normal_distribution_is_the_tables() {
        for (x, p) in [(0.0, 0.5), (1.0, 0.841_344_7), (-1.96, 0.024_997_9), (3.0, 0.998_650_1)] {
            assert!((normal_distribution(x) - p).abs() < 2e-7, "{x}");
        }
    }
}
