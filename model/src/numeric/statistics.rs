//! Quantiles, means and 95 % intervals: Wilson's for shares, order statistics for quantiles, the bootstrap for
//! means and the rest. No interval leaves the range of its values.
//!
//! Knows no files. Where chance has no generator as its argument it comes from a fixed seed, so equal
//! values give equal intervals.

use crpl_sitl::world::noise::{Noise, Stream};
use rand::{Rng, RngExt};
use serde::Serialize;

/// Quantile `p` in [0, 1] of `values`, by the nearest rank; NaN of nothing.
#[must_use]
pub fn quantile(values: &[f64], p: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = (p * (sorted.len().max(1) - 1) as f64).round() as usize;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}

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

/// Bootstrap resamples of a ratio.
pub const RESAMPLES: usize = 2000;

/// A mean over episodes with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Mean {
    /// Mean.
    pub mean: f64,
    /// 95 % interval of the mean, or of the ratio of means: bootstrap percentiles.
    pub ci: [f64; 2],
    /// Standard deviation of the values (of the resampled ratios, for a ratio).
    #[serde(skip)]
    pub sd: f64,
}

impl Mean {
    /// Of these values. Where all are equal, the interval has no width and says nothing of other episodes.
    #[must_use]
    pub fn of(values: &[f64]) -> Self {
        Resamples::of(values.len()).mean(values)
    }

    /// Whether all values were equal.
    #[must_use]
    pub fn is_constant(&self) -> bool {
        self.sd == 0.0
    }

    /// Half the width of the interval.
    #[must_use]
    pub fn half_width(&self) -> f64 {
        (self.ci[1] - self.ci[0]) / 2.0
    }
}

fn mean_and_sd(values: &[f64]) -> (f64, f64) {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, variance.sqrt())
}

/// Which episodes each resample takes: the same for every controller and metric, so pairs stay pairs.
#[derive(Debug, Clone)]
pub struct Resamples {
    picks: Vec<u32>,
    episodes: usize,
}

impl Resamples {
    /// [`RESAMPLES`] draws with replacement from `episodes` episodes.
    #[must_use]
    pub fn of(episodes: usize) -> Self {
        let mut rng = Noise::new(0).generator(Stream::Evaluation, episodes as u64);
        let most = u32::try_from(episodes).unwrap_or(u32::MAX);
        let number = if most == 0 { 0 } else { RESAMPLES * episodes };
        Self { picks: (0..number).map(|_| rng.random_range(0..most)).collect(), episodes }
    }

    /// The mean of these values with the 2.5th and 97.5th percentile of the resampled means; of another number
    /// of values than the resamples have, without an interval.
    #[must_use]
    pub fn mean(&self, values: &[f64]) -> Mean {
        // Equal values have no spread, and rounding must not give them one.
        if let Some(first) = values.first().filter(|first| values.iter().all(|v| v == *first)) {
            return Mean { mean: *first, ci: [*first, *first], sd: 0.0 };
        }
        let (mean, sd) = mean_and_sd(values);
        if values.len() != self.episodes || values.is_empty() {
            return Mean { mean, ci: [mean, mean], sd };
        }
        let n = self.episodes as f64;
        let sum = |picks: &[u32]| picks.iter().map(|i| values[*i as usize]).sum::<f64>();
        let means: Vec<f64> = self.picks.chunks_exact(self.episodes).map(|picks| sum(picks) / n).collect();
        Mean { mean, ci: [quantile(&means, 0.025), quantile(&means, 0.975)], sd }
    }

    /// mean(a) / max(mean(b), floor) with the 2.5th and 97.5th percentile of the resampled ratios.
    /// `a` and `b` belong to the same episodes in the same order; of another length than the
    /// resamples, there is no ratio.
    #[must_use]
    pub fn ratio(&self, a: &[f64], b: &[f64], floor: f64) -> Option<Mean> {
        if self.episodes == 0 || a.len() != self.episodes || b.len() != self.episodes {
            return None;
        }
        let n = self.episodes as f64;
        let ratio = |a: f64, b: f64| (a / n) / (b / n).max(floor);
        let ratios: Vec<f64> = self
            .picks
            .chunks_exact(self.episodes)
            .map(|picks| {
                let sum =
                    picks.iter().fold([0.0; 2], |sum, i| [sum[0] + a[*i as usize], sum[1] + b[*i as usize]]);
                ratio(sum[0], sum[1])
            })
            .collect();
        let (_, sd) = mean_and_sd(&ratios);
        let ci = [quantile(&ratios, 0.025), quantile(&ratios, 0.975)];
        Some(Mean { mean: ratio(a.iter().sum(), b.iter().sum()), ci, sd })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_values_have_no_mean_and_no_panic() {
        let none = Mean::of(&[]);
        assert!(none.mean.is_nan() || none.mean == 0.0, "{none:?}");
    }

    #[test]
    fn wilson_is_the_textbooks() {
        // 81 of 263: 0.2553 to 0.3662 (Newcombe 1998).
        let [low, high] = wilson(81, 263);
        assert!((low - 0.2553).abs() < 1e-4 && (high - 0.3662).abs() < 1e-4, "{low} {high}");
        assert!(wilson(10, 10)[1] > 0.999_999 && wilson(10, 10)[0] < 0.8);
    }

    #[test]
    fn wilsons_formula_at_small_numbers() {
        for (hits, n, low, high) in
            [(3, 4, 0.3006418401, 0.9544127397), (0, 10, 0.0, 0.2775328030), (0, 0, 0.0, 0.7934506882)]
        {
            let is = wilson(hits, n);
            assert!((is[0] - low).abs() < 1e-9 && (is[1] - high).abs() < 1e-9, "{hits} of {n}: {is:?}");
        }
    }

    #[test]
    fn a_quantile_is_the_value_of_the_nearest_rank() {
        let of = |p| quantile(&[4.0, 1.0, 3.0, 2.0, 5.0], p);
        assert_eq!([0.0, 0.3, 0.4, 0.5, 1.0].map(of), [1.0, 2.0, 3.0, 3.0, 5.0]);
        assert!(quantile(&[], 0.5).is_nan());
        // Of 0 to 399: p ± Z sqrt(p (1 - p) / 400), kept in [0, 1], times 399.
        let values: Vec<f64> = (0..400).map(f64::from).collect();
        for (p, interval) in
            [(0.5, [180.0, 219.0]), (0.9, [347.0, 371.0]), (1e-3, [0.0, 2.0]), (0.999, [397.0, 399.0])]
        {
            assert_eq!(of_quantile(&values, p), interval, "{p}");
        }
    }

    #[test]
    fn the_deviation_is_the_samples() {
        let Mean { mean, sd, .. } = Mean::of(&[1.0, 2.0, 6.0]);
        assert!((mean - 3.0).abs() < 1e-12 && (sd - 7.0_f64.sqrt()).abs() < 1e-12, "{mean} {sd}");
        assert!(!Mean::of(&[1.0, 2.0, 6.0]).is_constant());
    }

    #[test]
    fn other_numbers_of_values_than_the_resamples_have_no_interval() {
        let four = Resamples::of(4);
        let Mean { mean, ci, .. } = four.mean(&[1.0, 3.0]);
        assert_eq!((mean, ci), (2.0, [2.0, 2.0]));
        assert!(four.ratio(&[1.0; 3], &[1.0; 4], 1.0).is_none());
        assert!(four.ratio(&[1.0; 4], &[1.0; 3], 1.0).is_none());
        assert!(Resamples::of(0).ratio(&[], &[], 1.0).is_none());
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

    #[test]
    fn an_interval_shrinks_with_the_root_of_the_number() {
        let few: Vec<f64> = (0..100).map(|k| f64::from(k % 2)).collect();
        let many: Vec<f64> = (0..10_000).map(|k| f64::from(k % 2)).collect();
        let shrunk = Mean::of(&few).half_width() / Mean::of(&many).half_width();
        assert!((shrunk - 10.0).abs() < 1.0, "{shrunk}");
        assert_eq!(Mean::of(&[3.0]), Mean { mean: 3.0, ci: [3.0, 3.0], sd: 0.0 });
    }

    #[test]
    fn pairing_takes_out_what_both_share() {
        // b varies a hundredfold, a is always twice b: the ratio is known exactly.
        let b: Vec<f64> = (1..=100).map(f64::from).collect();
        let a: Vec<f64> = b.iter().map(|b| 2.0 * b).collect();
        let ratio = Resamples::of(100).ratio(&a, &b, 0.0).unwrap();
        assert!((ratio.mean - 2.0).abs() < 1e-12 && ratio.sd < 1e-12, "{ratio:?}");
        // Shuffled, the pairs are gone and the interval is wide.
        let mut shuffled = a.clone();
        shuffled.rotate_left(37);
        let ratio = Resamples::of(100).ratio(&shuffled, &b, 0.0).unwrap();
        assert!(ratio.ci[0] < 1.8 && ratio.ci[1] > 2.2, "{ratio:?}");
    }

    #[test]
    fn a_bootstrap_interval_covers_as_the_normal_one_does() {
        let a: Vec<f64> = (0..400).map(|k| f64::from((k * 7919) % 401)).collect();
        let (mean, ratio) = (Mean::of(&a), Resamples::of(400).ratio(&a, &[1.0; 400], 0.0).unwrap());
        // Against a constant the ratio is the mean itself.
        assert_eq!(mean.ci, ratio.ci);
        let normal = Z * mean.sd / 20.0;
        assert!((mean.half_width() / normal - 1.0).abs() < 0.08, "{mean:?} {normal}");
    }

    /// N7: an interval of outages that reached below 0.
    #[test]
    fn no_interval_leaves_the_range_of_its_values() {
        let mut rng = Noise::new(9).generator(Stream::Evaluation, 1);
        for n in 1..60 {
            let values: Vec<f64> = (0..n).map(|_| f64::from(rng.random_range(0..5_u8) / 4)).collect();
            let Mean { mean, ci: [low, high], .. } = Mean::of(&values);
            assert!(
                (0.0..=mean).contains(&low) && (mean..=1.0).contains(&high),
                "{low} {mean} {high}: {values:?}"
            );
        }
        for value in [0.0, 0.0128, 9125.7] {
            assert!(Mean::of(&[value; 100]).is_constant() && Mean::of(&[value; 100]).mean == value);
        }
    }

    #[test]
    fn a_small_denominator_is_held_at_its_floor() {
        let ratio = Resamples::of(4).ratio(&[8.0; 4], &[0.0; 4], 1.0).unwrap();
        assert_eq!((ratio.mean, ratio.ci), (8.0, [8.0, 8.0]));
    }
}
