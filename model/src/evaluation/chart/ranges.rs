//! What part of each axis a chart shows, and what its ticks say.

use std::ops::Range;

use super::Chart;

/// An axis: its range, in powers of ten if it is logarithmic.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartAxis {
    /// Whether it is logarithmic.
    pub log: bool,
    /// What it shows, as it is drawn.
    pub range: Range<f64>,
}

impl ChartAxis {
    /// Where a value stands: 0 at the range's beginning, 1 at its end.
    pub fn at(&self, value: f64) -> f64 {
        (scaled(self.log, value) - self.range.start) / (self.range.end - self.range.start)
    }

    /// Whether a place is on the axis.
    pub fn shows(&self, value: f64) -> bool {
        (-1e-9..=1.0 + 1e-9).contains(&self.at(value))
    }

    /// About so many places with a label, at round numbers; each label once.
    pub fn ticks(&self, about: usize) -> Vec<(f64, String)> {
        let (start, end) = (self.range.start, self.range.end);
        let step = if self.log { 1.0 } else { step((end - start) / about.max(1) as f64) };
        let first = (start / step - 1e-9).ceil() as i64;
        let last = (end / step + 1e-9).floor() as i64;
        let mut ticks: Vec<(f64, String)> =
            (first..=last).map(|n| self.tick(n as f64 * step, step)).collect();
        if self.log && ticks.len() < 3 {
            let between = (first - 1..=last).flat_map(|n| [2.0, 5.0].map(|m: f64| n as f64 + m.log10()));
            let inside = between.filter(|v| (start..=end).contains(v)).map(|v| self.tick(v, step));
            ticks.extend(inside.collect::<Vec<_>>());
        }
        ticks
    }

    /// The value at a place of the drawn axis, and its label.
    fn tick(&self, drawn: f64, step: f64) -> (f64, String) {
        if self.log {
            let value = 10f64.powf(drawn);
            let digits = (-drawn.floor()).clamp(0.0, 9.0) as usize;
            return (value, format!("{value:.digits$}"));
        }
        let digits = (-step.log10() - 1e-9).ceil().clamp(0.0, 9.0) as usize;
        let text = format!("{drawn:.digits$}");
        // A negative number that rounds to zero is zero.
        let is_zero = text.trim_start_matches('-').chars().all(|c| matches!(c, '0' | '.'));
        (drawn, if is_zero { text.trim_start_matches('-').to_owned() } else { text })
    }
}

/// The nearest of 1, 2 and 5 times a power of ten that is not below `wish`.
fn step(wish: f64) -> f64 {
    let power = 10f64.powf(wish.log10().floor());
    let round = [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * power >= wish * (1.0 - 1e-9));
    round.unwrap_or(10.0) * power
}

/// A value as it is drawn: its logarithm to base 10 on a logarithmic axis.
fn scaled(log: bool, value: f64) -> f64 {
    if log { value.max(1e-12).log10() } else { value }
}

/// The smallest range that holds all finite values; 0 to 1 without any.
fn hull(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low <= high { (low, high) } else { (0.0, 1.0) }
}

/// The given range, or the hull of `values` with a margin; around a single value, room for ticks that differ.
fn range(given: Option<[f64; 2]>, log: bool, values: impl Iterator<Item = f64>) -> Range<f64> {
    if let Some([low, high]) = given {
        return scaled(log, low)..scaled(log, high);
    }
    let (low, high) = hull(values.map(|v| scaled(log, v)));
    let size = low.abs().max(high.abs());
    let margin = if high - low > 1e-6 * size {
        0.03 * (high - low)
    } else {
        if size > 0.0 { 0.2 * size } else { 0.1 }
    };
    low - margin..high + margin
}

impl Chart {
    /// The axes of x and y, which hold all that is drawn.
    pub fn axes(&self) -> (ChartAxis, ChartAxis) {
        let points = || self.series.iter().flat_map(|s| s.points.iter().copied());
        let bands = || self.series.iter().flat_map(|s| s.band.iter().copied());
        let xs = points().map(|(x, y)| if y.is_finite() { x } else { f64::NAN });
        let x = range(self.x_range, self.log_x, xs.chain(bands().map(|(x, ..)| x)));
        let ys = points().map(|(_, y)| y).chain(bands().flat_map(|(_, low, high)| [low.max(0.0), high]));
        let ys = ys.chain(self.levels.iter().map(|(_, level)| *level));
        let y = if self.y_range.is_some() || self.log_y {
            range(self.y_range, self.log_y, ys)
        } else {
            let (low, high) = hull(ys.chain([0.0]));
            let height = (high - low).max(1e-9);
            let bottom = if low < 0.0 { low - 0.05 * height } else { 0.0 };
            bottom..low + 1.08 * height
        };
        (ChartAxis { log: self.log_x, range: x }, ChartAxis { log: self.log_y, range: y })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(log: bool, range: Range<f64>, about: usize) -> Vec<String> {
        ChartAxis { log, range }.ticks(about).into_iter().map(|(_, label)| label).collect()
    }

    #[test]
    fn ticks_stand_at_round_numbers() {
        assert_eq!(labels(false, 0.0..1.0, 5), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(false, -0.03..0.31, 4), ["0.0", "0.1", "0.2", "0.3"]);
        assert_eq!(labels(true, -2.0..1.0, 5), ["0.01", "0.1", "1", "10"]);
        assert_eq!(labels(true, 0.1..0.8, 5), ["2", "5"]);
    }

    /// First use, F1: a sweep of one point had "2.500000" six times on its axis.
    #[test]
    fn no_label_stands_twice() {
        for value in [2.5, 0.0, -3.0, 1e-7, 123_456.0] {
            let axis = ChartAxis { log: false, range: range(None, false, [value].into_iter()) };
            let mut labels: Vec<String> = axis.ticks(6).into_iter().map(|(_, label)| label).collect();
            let all = labels.len();
            labels.dedup();
            assert!(labels.len() == all && all >= 2, "{value}: {labels:?}");
        }
    }
}
