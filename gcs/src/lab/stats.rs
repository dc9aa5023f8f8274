//! Means over episodes with 95 % intervals, and ratios of paired means by bootstrap.
//!
//! Knows no controllers and no files. Chance comes from a fixed seed, so equal values give equal
//! intervals.

use crpl_sitl::world::noise::{Noise, Stream};
use rand::RngExt;
use serde::Serialize;

/// Bootstrap resamples of a ratio.
pub const RESAMPLES: usize = 2000;

/// z of a two-sided 95 % interval.
const Z95: f64 = 1.96;

/// A mean over episodes with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Mean {
    /// Mean.
    pub mean: f64,
    /// 95 % interval of the mean: normal for a mean, bootstrap percentiles for a ratio of means.
    pub ci: [f64; 2],
    /// Standard deviation of the values (of the resampled ratios, for a ratio).
    #[serde(skip)]
    pub sd: f64,
}

impl Mean {
    /// Of these values; an interval of zero width for one value.
    #[must_use]
    pub fn of(values: &[f64]) -> Self {
        let (mean, sd) = mean_and_sd(values);
        let half = Z95 * sd / (values.len().max(1) as f64).sqrt();
        Self { mean, ci: [mean - half, mean + half], sd }
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
        let mut ratios: Vec<f64> = self
            .picks
            .chunks_exact(self.episodes)
            .map(|picks| {
                let sum =
                    picks.iter().fold([0.0; 2], |sum, i| [sum[0] + a[*i as usize], sum[1] + b[*i as usize]]);
                ratio(sum[0], sum[1])
            })
            .collect();
        let (_, sd) = mean_and_sd(&ratios);
        ratios.sort_by(f64::total_cmp);
        let last = ratios.len() - 1;
        let at = |q: f64| ratios[(q * last as f64).round() as usize];
        Some(Mean { mean: ratio(a.iter().sum(), b.iter().sum()), ci: [at(0.025), at(0.975)], sd })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_shrinks_with_the_root_of_the_number() {
        let few: Vec<f64> = (0..100).map(|k| f64::from(k % 2)).collect();
        let many: Vec<f64> = (0..10_000).map(|k| f64::from(k % 2)).collect();
        assert!((Mean::of(&few).half_width() / Mean::of(&many).half_width() - 10.0).abs() < 0.1);
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
        // Against a constant the ratio is the mean itself, whose interval is known.
        let a: Vec<f64> = (0..400).map(|k| f64::from((k * 7919) % 401)).collect();
        let (normal, ratio) = (Mean::of(&a), Resamples::of(400).ratio(&a, &[1.0; 400], 0.0).unwrap());
        assert!((ratio.half_width() / normal.half_width() - 1.0).abs() < 0.08, "{ratio:?} {normal:?}");
    }

    #[test]
    fn a_small_denominator_is_held_at_its_floor() {
        let ratio = Resamples::of(4).ratio(&[8.0; 4], &[0.0; 4], 1.0).unwrap();
        assert_eq!((ratio.mean, ratio.ci), (8.0, [8.0, 8.0]));
        assert!(Resamples::of(4).ratio(&[1.0; 3], &[1.0; 4], 1.0).is_none());
    }
}
