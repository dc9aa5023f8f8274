//! A camera that shakes, told and taken out by what moves both halves alike.

use nalgebra::Vector2;

use super::{Estimate, Filtered, Interval, LEAST_DIFFERENCES, LatentObserver, POOR};

/// Least correlation of both halves' second differences from which the camera is said to shake.
const SHAKEN: f64 = 0.7;

/// A second difference so many times the median's size is no shake: a body that was lost, a wall.
const OUTLIER: f64 = 4.0;

/// What a straight line may explain of z_u's readings, in variances of one, while z_u still stands; one that stands
/// stays below in 2,999 of 3,000 cases (2 degrees of freedom).
const STANDING: f64 = 16.0;

/// Frames of z_u that are worth keeping for [`steadied`].
pub const STEADY_MEMORY: usize = 100;

/// Both halves from a camera that shakes; `None` where it does not, or that is not yet known.
///
/// A shake moves both bodies alike, and nothing else does: it is told by the correlation of their second
/// differences. z_u moves evenly or stands, so its way through all frames that are kept says by how much each frame is
/// off, and z_c is corrected by as much of that as is shake and not z_u's own error.
#[must_use]
pub fn steadied(c: &LatentObserver, u: &LatentObserver) -> Option<(Estimate, Estimate)> {
    let mut recent = c.recent(c.window);
    let variance = shake(c, u, &recent)?;
    let all = u.recent(u.memory);
    let Filtered { filter, since, .. } = u.filtered(&all)?;
    let way = u.within_reach(&filter);
    let way = u.standing(&all[since..], way, variance).unwrap_or(way);
    for (back, interval) in recent.iter_mut().rev().enumerate() {
        let Some(seen) = &mut interval.seen else { continue };
        let own = c.noise(*seen).powi(2);
        // As far as z_u's way is known, and the frame shows z_u near it.
        let other = all.len().checked_sub(back + 1).filter(|k| *k >= since).and_then(|k| all[k].seen);
        let steady = other.and_then(|other| {
            let error = u.noise(other).powi(2);
            let off = other.y - (way.y - way.v * back as f64);
            (off.norm_squared() <= POOR * (variance + error)).then_some((off, error))
        });
        let left = match steady {
            Some((off, error)) => {
                let share = variance / (variance + error);
                seen.y -= off * share;
                share * error
            }
            None => variance,
        };
        seen.sigma_scale = (own + left).sqrt() / c.motion.noise;
    }
    let steady = LatentObserver { last: recent.into(), ..c.clone() };
    Some((steady.estimate()?, way))
}

/// Variance of a coordinate by the camera's shake, latent units squared; `None` if it does not shake.
fn shake(c: &LatentObserver, u: &LatentObserver, recent: &[Interval]) -> Option<f64> {
    if !(c.motion.lost && u.motion.lost) {
        return None;
    }
    let other = u.recent(c.window);
    let each = recent.windows(3).rev().zip(other.windows(3).rev());
    let pairs: Vec<[Vector2<f64>; 2]> =
        each.filter_map(|(a, b)| Some([c.second_difference(a)?, u.second_difference(b)?])).collect();
    let median = |half: usize| {
        let mut sizes: Vec<f64> = pairs.iter().map(|pair| pair[half].norm_squared()).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).copied()
    };
    let bounds = [median(0)?, median(1)?].map(|size| OUTLIER * OUTLIER * size);
    let within = |pair: &&[Vector2<f64>; 2]| (0..2).all(|k| pair[k].norm_squared() <= bounds[k]);
    let kept: Vec<_> = pairs.iter().filter(within).collect();
    let sum = |f: fn(&[Vector2<f64>; 2]) -> f64| kept.iter().map(|pair| f(pair)).sum::<f64>();
    let (both, of_c, of_u) =
        (sum(|[c, u]| c.dot(u)), sum(|[c, _]| c.norm_squared()), sum(|[_, u]| u.norm_squared()));
    let shaken = kept.len() >= LEAST_DIFFERENCES && both > SHAKEN * (of_c * of_u).sqrt();
    // A second difference of white noise has six times its variance, in each of two axes.
    (shaken && both > 0.0).then(|| both / (12.0 * kept.len() as f64))
}

impl LatentObserver {
    /// The place of a half if it stands still: the mean of the readings near `way`, each by its own error and the
    /// camera's `shake`, a variance. `None` if a straight line fits them better than a half that stands would let it.
    fn standing(&self, intervals: &[Interval], way: Estimate, shake: f64) -> Option<Estimate> {
        let near = intervals.iter().rev().enumerate().filter_map(|(back, interval)| {
            let (seen, back) = (interval.seen?, back as f64);
            let error = shake + self.noise(seen).powi(2);
            let off = seen.y - (way.y - way.v * back);
            (off.norm_squared() <= POOR * error).then_some((back, seen.y, 1.0 / error))
        });
        let near: Vec<(f64, Vector2<f64>, f64)> = near.collect();
        if near.len() < LEAST_DIFFERENCES {
            return None;
        }
        let weights: f64 = near.iter().map(|(_, _, w)| w).sum();
        let when = near.iter().map(|(back, _, w)| w * back).sum::<f64>() / weights;
        let mean = near.iter().map(|(_, y, w)| y * *w).sum::<Vector2<f64>>() / weights;
        let lever: f64 = near.iter().map(|(back, _, w)| w * (back - when).powi(2)).sum();
        let slope =
            near.iter().map(|(back, y, w)| (y - mean) * (w * (back - when))).sum::<Vector2<f64>>() / lever;
        let explained = slope.norm_squared() * lever;
        let total: f64 = near.iter().map(|(_, y, w)| w * (y - mean).norm_squared()).sum();
        let each = (total - explained) / (2 * near.len() - 4) as f64;
        (explained <= STANDING * each).then(|| Estimate { y: mean, v: Vector2::zeros() })
    }
}
