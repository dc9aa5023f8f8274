//! A picture in the making: three planes of f32, on which bodies are painted and effects applied.

use std::ops::Range;
use std::sync::LazyLock;

use multiversion::multiversion;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::frame::{CHANNELS, Frame, MARGIN, SIDE, WIDE};
use super::ground::Plane;
use super::render::Disc;

const AREA: usize = SIDE * SIDE;

/// Red, green and blue planes, rows of `SIDE` values. Painted from 0 to 1, developed from 0 to 255.
#[derive(Debug, Clone)]
pub(super) struct Canvas {
    values: Vec<f32>,
}

impl Canvas {
    /// Black.
    pub fn black() -> Self {
        Self { values: vec![0.0; CHANNELS * AREA] }
    }

    /// The ground as a camera sees it that is off by `shake` px.
    pub fn of_ground(ground: &Plane, shake: [f64; 2]) -> Self {
        let mut canvas = Self::black();
        for (out, plane) in canvas.values.chunks_exact_mut(AREA).zip(&ground.planes) {
            shifted(plane, shake, out);
        }
        canvas
    }

    pub fn planes_mut(&mut self) -> [&mut [f32]; CHANNELS] {
        let (red, rest) = self.values.split_at_mut(AREA);
        let (green, blue) = rest.split_at_mut(AREA);
        [red, green, blue]
    }

    /// Puts `colour` over what is there where the mask covers it; `light` gives the colour's factor at a
    /// pixel's column and row.
    pub fn paint(&mut self, mask: &Mask, colour: [f32; CHANNELS], light: impl Fn(usize, usize) -> f32) {
        mask.each(|x, y, covered| {
            let factor = covered * light(x, y);
            for (channel, hue) in colour.into_iter().enumerate() {
                let value = &mut self.values[channel * AREA + y * SIDE + x];
                *value += factor * hue - covered * *value;
            }
        });
    }

    /// Takes `share` of the light where the mask covers it.
    pub fn darken(&mut self, mask: &Mask, share: f32) {
        mask.each(|x, y, covered| {
            for channel in 0..CHANNELS {
                self.values[channel * AREA + y * SIDE + x] *= 1.0 - share * covered;
            }
        });
    }

    /// To values of 0 to 255, each channel by its own factor and offset.
    pub fn scale(&mut self, channels: [[f32; 2]; CHANNELS]) {
        for (plane, [factor, offset]) in self.values.chunks_exact_mut(AREA).zip(channels) {
            scale(plane, factor, offset);
        }
    }

    /// Adds normal noise of standard deviation `sigma`.
    pub fn add_noise(&mut self, sigma: f32, rng: &mut ChaCha8Rng) {
        for values in self.values.chunks_mut(4) {
            let random = rng.next_u64();
            for (n, value) in values.iter_mut().enumerate() {
                *value += sigma * QUANTILES[(random >> (16 * n)) as usize % SHARES];
            }
        }
    }

    /// Cuts values to 0 to 255.
    pub fn clamp(&mut self) {
        clamp(&mut self.values);
    }

    /// Rounds to bytes.
    pub fn into_frame(self) -> Frame {
        let mut frame = Frame::black();
        interleave(&self.values, &mut frame.bytes);
        frame
    }
}

/// How much of each pixel a body covers, the mean over the places where it is while the shutter is open.
pub(super) struct Mask {
    left: usize,
    top: usize,
    width: usize,
    coverage: Vec<f32>,
}

impl Mask {
    /// The mean of discs.
    pub fn new(discs: &[Disc]) -> Self {
        let windows = discs.iter().map(|disc| (disc, disc.window()));
        let seen: Vec<_> =
            windows.filter(|(_, (columns, rows))| !columns.is_empty() && !rows.is_empty()).collect();
        let (left, right) = bounds(seen.iter().map(|(_, (columns, _))| columns));
        let (top, bottom) = bounds(seen.iter().map(|(_, (_, rows))| rows));
        let width = right - left;
        let mut coverage = vec![0f32; width * (bottom - top)];
        let share = 1.0 / discs.len() as f32;
        for (disc, (columns, rows)) in seen {
            for y in rows {
                let at = (y as usize - top) * width + columns.start as usize - left;
                for (sum, c) in coverage[at..].iter_mut().zip(disc.row(y, columns.clone())) {
                    *sum += share * *c as f32;
                }
            }
        }
        Self { left, top, width, coverage }
    }

    /// Calls `paint` with column, row and coverage of each pixel that is covered.
    fn each(&self, mut paint: impl FnMut(usize, usize, f32)) {
        for (n, &c) in self.coverage.iter().enumerate() {
            if c > 0.0 {
                paint(self.left + n % self.width, self.top + n / self.width, c);
            }
        }
    }
}

/// Least start and greatest end of ranges that lie in the frame.
fn bounds<'a>(ranges: impl Iterator<Item = &'a Range<i64>>) -> (usize, usize) {
    let bounds = ranges.map(|range| (range.start as usize, range.end as usize));
    bounds.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or_default()
}

/// Number of equal shares of the normal distribution.
const SHARES: usize = 4096;

/// The quantiles of the standard normal distribution at the middle of each share: noise that is quick to
/// draw, as far as 3.7 standard deviations.
static QUANTILES: LazyLock<Box<[f32; SHARES]>> = LazyLock::new(|| {
    let mut quantiles = Box::new([0.0; SHARES]);
    let mut x = -3.7;
    for (n, quantile) in quantiles.iter_mut().enumerate() {
        let share = (n as f64 + 0.5) / SHARES as f64;
        // Newton's steps from the quantile before it.
        for _ in 0..8 {
            x -= (normal_share(x) - share) / density(x);
        }
        *quantile = x as f32;
    }
    quantiles
});

fn density(x: f64) -> f64 {
    (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt()
}

/// Share of the standard normal distribution below `x`, |x| <= 6: ½ + φ(x) (x + x³/3 + x⁵/15 + ...).
fn normal_share(x: f64) -> f64 {
    let (mut term, mut sum) = (x, x);
    let mut odd = 3.0;
    while term.abs() > 1e-17 && odd < 400.0 {
        term *= x * x / odd;
        sum += term;
        odd += 2.0;
    }
    0.5 + sum * density(x)
}

/// Reads a ground's plane at a fraction of a pixel, the same for all pixels.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn shifted(plane: &[f32], shake: [f64; 2], out: &mut [f32]) {
    let most = (2 * MARGIN) as f64 - 1.0;
    let [x, y] = shake.map(|s| (MARGIN as f64 - s).clamp(0.0, most));
    let (column, row) = (x.floor(), y.floor());
    let (u, v) = ((x - column) as f32, (y - row) as f32);
    let (column, row) = (column as usize, row as usize);
    for (line, out) in out.chunks_exact_mut(SIDE).enumerate() {
        let upper = &plane[(row + line) * WIDE + column..][..SIDE + 1];
        let lower = &plane[(row + line + 1) * WIDE + column..][..SIDE + 1];
        for n in 0..SIDE {
            let above = upper[n] + u * (upper[n + 1] - upper[n]);
            let below = lower[n] + u * (lower[n + 1] - lower[n]);
            out[n] = above + v * (below - above);
        }
    }
}

#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn scale(plane: &mut [f32], factor: f32, offset: f32) {
    for value in plane {
        *value = *value * factor + offset;
    }
}

#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn clamp(values: &mut [f32]) {
    for value in values {
        *value = value.clamp(0.0, 255.0);
    }
}

#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn interleave(values: &[f32], bytes: &mut [u8]) {
    let (red, rest) = values.split_at(AREA);
    let (green, blue) = rest.split_at(AREA);
    for (((pixel, r), g), b) in bytes.as_chunks_mut::<CHANNELS>().0.iter_mut().zip(red).zip(green).zip(blue) {
        *pixel = [r, g, b].map(|value| value.round_ties_even() as u8);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ground_moves_with_the_shake_by_fractions_of_a_pixel() {
        let plane = |value: fn(usize, usize) -> usize| {
            (0..WIDE * WIDE).map(|n| value(n % WIDE, n / WIDE) as f32).collect::<Vec<f32>>()
        };
        let ground = Plane { planes: [plane(|x, _| x), plane(|_, y| y), plane(|_, _| 1)], mean: 0.0 };
        let mut canvas = Canvas::of_ground(&ground, [1.5, -2.25]);
        let [red, green, blue] = canvas.planes_mut().map(|plane| plane[20 * SIDE + 30]);
        assert_eq!([red, green, blue], [30.0 + 8.0 - 1.5, 20.0 + 8.0 + 2.25, 1.0]);
        // As far as a shake goes, and further than it can go, nothing is read beyond the ground.
        for far in [-100.0, -8.0, 8.0, 100.0] {
            let _ = Canvas::of_ground(&ground, [far, -far]);
        }
    }

    #[test]
    fn the_noise_is_normal() {
        assert!(QUANTILES.is_sorted());
        let mean = QUANTILES.iter().sum::<f32>() / SHARES as f32;
        let variance = QUANTILES.iter().map(|q| q * q).sum::<f32>() / SHARES as f32;
        assert!(mean.abs() < 1e-4 && (variance - 1.0).abs() < 2e-3, "{mean} {variance}");
        // 97.5 % are below 1.96.
        let below = QUANTILES.iter().filter(|q| **q < 1.959_964).count();
        assert_eq!(below, (0.975 * SHARES as f64).round() as usize);
    }
}
