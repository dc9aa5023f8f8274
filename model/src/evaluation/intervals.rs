//! 95 % intervals: Wilson's for shares, order statistics for quantiles, the bootstrap for the rest.

use rand::{Rng, RngExt};

use crate::encoder::probe::quantile;

/// Standard normal deviate of a two-sided 95 % interval.
const Z: f64 = 1.959_964;

/// Low and high end.
pub type Interval = [f64; 2];

/// Wilson's score interval of a share `hits` of `n`.
#[must_use]
pub fn wilson(hits: usize, n: usize) -> Interval {
    let (n, p) = (n.max(1) as f64, hits as f64 / n.max(1) as f64);
    let centre = (p + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
    let half = Z / (1.0 + Z * Z / n) * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    // Exact where rounding would leave the share itself outside.
    [(centre - half).clamp(0.0, p), (centre + half).clamp(p, 1.0)]
}

/// Interval of the quantile `p` from the order statistics: no assumption about the distribution.
#[must_use]
pub fn of_quantile(values: &[f64], p: f64) -> Interval {
    let half = Z * (p * (1.0 - p) / values.len().max(1) as f64).sqrt();
    [quantile(values, (p - half).max(0.0)), quantile(values, (p + half).min(1.0))]
}

/// Percentile bootstrap of `statistic`, which gets the indices of a resample of `n`.
pub fn bootstrap(n: usize, rng: &mut impl Rng, statistic: impl Fn(&[usize]) -> f64) -> Interval {
    const RESAMPLES: usize = 400;
    let draws: Vec<f64> = (0..RESAMPLES)
        .map(|_| statistic(&(0..n).map(|_| rng.random_range(0..n.max(1))).collect::<Vec<_>>()))
        .collect();
    [quantile(&draws, 0.025), quantile(&draws, 0.975)]
}

#[cfg(test)]
mod tests {
    use crpl_sitl::world::noise::{Noise, Stream};

    use super::*;

    #[test]
    fn wilson_is_the_textbooks() {
        // 81 of 263: 0.2553 to 0.3662 (Newcombe 1998).
        let [low, high] = wilson(81, 263);
        assert!((low - 0.2553).abs() < 1e-4 && (high - 0.3662).abs() < 1e-4, "{low} {high}");
        assert!(wilson(10, 10)[1] > 0.999_999 && wilson(10, 10)[0] < 0.8);
    }

    #[test]
    fn intervals_cover_the_truth_about_as_often_as_they_say() {
        let mut rng = Noise::new(5).generator(Stream::Evaluation, 0);
        let (mut quantiles, mut means) = (0, 0);
        for _ in 0..200 {
            let values: Vec<f64> = (0..300).map(|_| rng.random::<f64>()).collect();
            let [low, high] = of_quantile(&values, 0.9);
            quantiles += usize::from((low..=high).contains(&0.9));
            let mean = |picks: &[usize]| picks.iter().map(|&n| values[n]).sum::<f64>() / 300.0;
            let [low, high] = bootstrap(300, &mut rng, mean);
            means += usize::from((low..=high).contains(&0.5));
        }
        assert!(quantiles >= 180 && means >= 180, "{quantiles} and {means} of 200");
    }
}
