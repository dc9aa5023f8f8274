//! What is measured to judge a statement of the paper: [`SweepQuantity`] on the flights of a sweep, with its 95 %
//! interval, [`FlightQuantity`] on single flights without gusts.
//!
//! Knows neither what the paper says of a quantity nor what follows.

use crpl_model::numeric::statistics::{Mean, Resamples, bootstrap};
use crpl_sitl::sim::metric::Metric;
use crpl_sitl::world::noise::{Noise, Stream};

use crate::lab::sweep::episode::SweepEpisode;
use crate::lab::sweep::plan::SweepPlan;
use crate::station::pilot::Controller;

/// Whom a quantity is measured on: one controller, or one and whom it is compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Subject {
    /// Who.
    pub of: Controller,
    /// Compared with whom.
    pub over: Option<Controller>,
}

/// A quantity of a sweep. Points are values of its axis. A metric is its mean over the flights at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SweepQuantity {
    /// Ratio at a point.
    Ratio(Metric, f64),
    /// Median over all points of the ratio.
    MedianRatio(Metric),
    /// Largest ratio of all points.
    LargestRatio(Metric),
    /// Difference at a point.
    Difference(Metric, f64),
    /// Difference of the standard deviations over flights, at a point.
    Spread(Metric, f64),
    /// Ratio in the first metric less that in the second, at a point.
    Separation([Metric; 2], f64),
    /// One controller: the metric at the second point over that at the first.
    Change(Metric, [f64; 2]),
    /// One controller: change from the second to the third point less that from the first to the second.
    Bend(Metric, [f64; 3]),
    /// Ratio at the second point over that at the first.
    Outgrowth(Metric, [f64; 2]),
    /// Distance to the oracle's value less that of the controller compared with, at a point.
    OracleDistance(Metric, f64),
}

/// A quantity of flights in Scenarios 1 and 2: without gusts there is one flight, and no interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FlightQuantity {
    /// Intervals from the first at high power to the need of it: to the first in which low power gives less than
    /// γ_min. Negative if raised after.
    Lead,
    /// Intervals from the last in which high power is needed to the last at high power.
    Overhang,
    /// Intervals in which the SNR is below γ_min.
    Violations,
    /// Intervals at high power: difference.
    HighPower,
    /// Smallest SNR: difference.
    LeastSnr,
    /// y at the obstacle's x, less the obstacle's.
    Side,
    /// Metric: ratio.
    Ratio(Metric),
    /// Distance of a metric to crpl's, less that of the controller compared with.
    Apartness(Metric),
    /// |y at the obstacle's x - start's|, in Scenario 1 less in Scenario 2.
    Detour,
    /// How far a metric's ratio is from 1, in Scenario 1 less in Scenario 2.
    Separation(Metric),
}

/// Mean and standard deviation of the flights in a resample.
type Moments = (f64, f64);

impl SweepQuantity {
    /// Its value, with 95 % bootstrap interval over flights, which stay paired by their seeds. `None` if a point or
    /// a controller was not flown.
    #[must_use]
    pub fn measure(self, who: Subject, plan: &SweepPlan, episodes: &[SweepEpisode]) -> Option<Mean> {
        let Subject { of, over } = who;
        let values = |x: f64, controller: Controller, metric: Metric| -> Option<Vec<f64>> {
            let flights = episodes.iter().filter(|e| e.point.x == x && e.controller == controller);
            let values: Vec<f64> = flights.map(|e| e.metrics[metric]).collect();
            (!values.is_empty()).then_some(values)
        };
        let pair = |metric, x| Some([values(x, of, metric)?, values(x, over?, metric)?]);
        let all = |pairs: &[Option<[Vec<f64>; 2]>]| -> Option<Vec<Vec<f64>>> {
            Some(pairs.iter().cloned().collect::<Option<Vec<_>>>()?.concat())
        };
        let everywhere = |metric| all(&plan.points.iter().map(|x| pair(metric, *x)).collect::<Vec<_>>());
        match self {
            Self::Ratio(metric, x) => {
                let [a, b] = pair(metric, x)?;
                paired_ratio(&a, &b, metric.floor())
            }
            Self::MedianRatio(metric) => resampled(&everywhere(metric)?, |m| median(ratios(metric, m))),
            Self::LargestRatio(metric) => {
                resampled(&everywhere(metric)?, |m| ratios(metric, m).into_iter().fold(f64::NAN, f64::max))
            }
            Self::Difference(metric, x) => resampled(&pair(metric, x)?, |m| m[0].0 - m[1].0),
            Self::Spread(metric, x) => resampled(&pair(metric, x)?, |m| m[0].1 - m[1].1),
            Self::Separation(metrics, x) => resampled(&all(&metrics.map(|m| pair(m, x)))?, |m| {
                ratio(metrics[0], m[0], m[1]) - ratio(metrics[1], m[2], m[3])
            }),
            Self::Change(metric, [from, to]) => {
                paired_ratio(&values(to, of, metric)?, &values(from, of, metric)?, metric.floor())
            }
            Self::Bend(metric, points) => {
                let series: Option<Vec<_>> = points.iter().map(|x| values(*x, of, metric)).collect();
                resampled(&series?, |m| (m[2].0 - m[1].0) - (m[1].0 - m[0].0))
            }
            Self::Outgrowth(metric, [from, to]) => {
                resampled(&all(&[to, from].map(|x| pair(metric, x)))?, |m| {
                    ratio(metric, m[0], m[1]) / ratio(metric, m[2], m[3])
                })
            }
            Self::OracleDistance(metric, x) => {
                let [a, b] = pair(metric, x)?;
                let oracle = values(x, Controller::Apc, metric)?;
                resampled(&[a, b, oracle], |m| (m[0].0 - m[2].0).abs() - (m[1].0 - m[2].0).abs())
            }
        }
    }

    /// The points that it names.
    #[must_use]
    pub fn points(self) -> Vec<f64> {
        match self {
            Self::MedianRatio(_) | Self::LargestRatio(_) => Vec::new(),
            Self::Ratio(_, x)
            | Self::Difference(_, x)
            | Self::Spread(_, x)
            | Self::Separation(_, x)
            | Self::OracleDistance(_, x) => vec![x],
            Self::Change(_, points) | Self::Outgrowth(_, points) => points.to_vec(),
            Self::Bend(_, points) => points.to_vec(),
        }
    }

    /// The value of no difference.
    #[must_use]
    pub fn neutral(self) -> f64 {
        match self {
            Self::Ratio(..)
            | Self::MedianRatio(_)
            | Self::LargestRatio(_)
            | Self::Change(..)
            | Self::Outgrowth(..) => 1.0,
            Self::Difference(..)
            | Self::Spread(..)
            | Self::Separation(..)
            | Self::Bend(..)
            | Self::OracleDistance(..) => 0.0,
        }
    }

    /// Decimals worth printing.
    #[must_use]
    pub fn decimals(self) -> usize {
        match self {
            Self::Difference(m, _) | Self::Spread(m, _) | Self::Bend(m, _) | Self::OracleDistance(m, _) => {
                m.decimals()
            }
            _ => 3,
        }
    }

    /// In words, without a comma.
    #[must_use]
    pub fn describe(self, who: Subject) -> String {
        let Subject { of, over } = who;
        let over = over.map_or(String::new(), |over| over.to_string());
        match self {
            Self::Ratio(m, x) => format!("{}: {of} over {over} at {x}", m.symbol()),
            Self::MedianRatio(m) => format!("{}: {of} over {over} at the median point", m.symbol()),
            Self::LargestRatio(m) => format!("{}: {of} over {over} at its largest point", m.symbol()),
            Self::Difference(m, x) => format!("{}: {of} less {over} at {x}", m.symbol()),
            Self::Spread(m, x) => format!("spread of {}: {of} less {over} at {x}", m.symbol()),
            Self::Separation([a, b], x) => {
                format!("{of} over {over} at {x}: {} less {}", a.symbol(), b.symbol())
            }
            Self::Change(m, [from, to]) => format!("{}: growth of {of} {from} to {to}", m.symbol()),
            Self::Bend(m, [a, b, c]) => {
                format!("{}: {of} change {b} to {c} less {a} to {b}", m.symbol())
            }
            Self::Outgrowth(m, [from, to]) => {
                format!("{}: growth of {of} over {over} {from} to {to}", m.symbol())
            }
            Self::OracleDistance(m, x) => {
                format!("{}: |{of}-apc| less |{over}-apc| at {x}", m.symbol())
            }
        }
    }
}

impl FlightQuantity {
    /// The value of no difference.
    #[must_use]
    pub fn neutral(self) -> f64 {
        if matches!(self, Self::Ratio(_)) { 1.0 } else { 0.0 }
    }

    /// Decimals worth printing.
    #[must_use]
    pub fn decimals(self) -> usize {
        match self {
            Self::Lead | Self::Overhang | Self::Violations | Self::HighPower => 0,
            Self::LeastSnr => 2,
            Self::Side | Self::Ratio(_) | Self::Detour | Self::Separation(_) => 3,
            Self::Apartness(metric) => metric.decimals(),
        }
    }

    /// In words, without a comma.
    #[must_use]
    pub fn describe(self, who: Subject) -> String {
        let Subject { of, over } = who;
        let over = over.map_or(String::new(), |over| over.to_string());
        match self {
            Self::Lead => format!("{of} raises power before need by intervals"),
            Self::Overhang => format!("{of} lowers power after need by intervals"),
            Self::Violations => format!("SNR < γ_min: intervals of {of}"),
            Self::HighPower => format!("intervals at high power: {of} less {over}"),
            Self::LeastSnr => format!("least SNR: {of} less {over}"),
            Self::Side => format!("y abreast: {of} less the obstacle"),
            Self::Ratio(m) => format!("{}: {of} over {over}", m.symbol()),
            Self::Apartness(m) => format!("{}: |{of}-crpl| less |{over}-crpl|", m.symbol()),
            Self::Detour => format!("detour of {of}: Scenario 1 less 2"),
            Self::Separation(m) => {
                format!("|{}: {of} over {over} - 1|: Scenario 1 less 2", m.symbol())
            }
        }
    }
}

/// The ratio in the table of a sweep. Where the denominator counts as its floor, a smaller numerator does too:
/// less than one interval on both sides is no difference.
fn paired_ratio(a: &[f64], b: &[f64], floor: f64) -> Option<Mean> {
    let ratio = Resamples::of(a.len()).ratio(a, b, floor)?;
    let is_floored = b.iter().sum::<f64>() / (b.len() as f64) < floor;
    let floored = |value: f64| if is_floored { value.max(1.0) } else { value };
    Some(Mean { mean: floored(ratio.mean), ci: ratio.ci.map(floored), ..ratio })
}

fn ratio(metric: Metric, a: Moments, b: Moments) -> f64 {
    a.0.max(metric.floor()) / b.0.max(metric.floor())
}

/// The ratio of each pair.
fn ratios(metric: Metric, pairs: &[Moments]) -> Vec<f64> {
    pairs.chunks_exact(2).map(|pair| ratio(metric, pair[0], pair[1])).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = |n: usize| values.get(n).copied().unwrap_or(f64::NAN);
    f64::midpoint(at(values.len().saturating_sub(1) / 2), at(values.len() / 2))
}

/// A statistic of several series of the same flights, with its 95 % bootstrap interval.
fn resampled(series: &[Vec<f64>], statistic: impl Fn(&[Moments]) -> f64) -> Option<Mean> {
    let n = series.first()?.len();
    if series.iter().any(|values| values.len() != n) {
        return None;
    }
    let of =
        |picks: &[usize]| statistic(&series.iter().map(|values| moments(values, picks)).collect::<Vec<_>>());
    let mut rng = Noise::new(0).generator(Stream::Evaluation, n as u64);
    let ci = bootstrap(n, &mut rng, of);
    Some(Mean { mean: of(&(0..n).collect::<Vec<_>>()), ci, sd: 0.0 })
}

fn moments(values: &[f64], picks: &[usize]) -> Moments {
    let n = picks.len() as f64;
    let mean = picks.iter().map(|pick| values[*pick]).sum::<f64>() / n;
    let variance = picks.iter().map(|pick| (values[*pick] - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, variance.sqrt())
}
