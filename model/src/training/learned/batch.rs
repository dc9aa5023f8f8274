//! The pictures of a training step: triples, mirrored, and as the online encoder sees them.

use crpl_sitl::camera::{CHANNELS, Frame, SIDE};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::encoder::votes::{Votes, VotesGradient};
use crate::numeric::tensors::TensorError;
use crate::world_model::learned::{AugmentConfig, LearnedConfig};
use crate::world_model::recording::{EpisodeIndex, Recording};

/// Values of a picture.
pub const PIXELS: usize = SIDE * SIDE * CHANNELS;

/// Three pictures of an episode, `lag` apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PictureTriple {
    /// Index of the episode.
    pub episode: usize,
    /// First picture.
    pub first: usize,
    /// Pictures between first and second, and second and third.
    pub lag: usize,
}

/// Mirroring and transposition of a picture, in this order: columns, rows, transposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Flip {
    /// Left becomes right.
    pub columns: bool,
    /// Top becomes bottom.
    pub rows: bool,
    /// Then columns become rows.
    pub transposed: bool,
}

/// How the online encoder's view of a picture differs from the recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PictureView {
    gains: [f32; CHANNELS],
    noise: f32,
    noise_seed: u64,
    /// Amplitude, wave numbers along both axes (1/px) and phase of a sine of light.
    light: [f32; 4],
}

/// All of a step: the first pictures of all triples (long, then short), the second, the third.
#[derive(Debug)]
pub struct DrawnPictures {
    /// Triples, long ones first.
    pub triples: Vec<PictureTriple>,
    /// Number of long triples.
    pub long: usize,
    /// Recorded pictures, three times as many as triples.
    pub frames: Vec<Frame>,
    /// How each picture is mirrored.
    pub flips: Vec<Flip>,
    /// How each differs for the online encoder; `None` as recorded.
    pub views: Vec<Option<PictureView>>,
    /// Px that the actions add to each triple's second difference.
    pub responses: Vec<[f32; 2]>,
    /// Measured gain at each picture, dB.
    pub gains_db: Vec<Option<f32>>,
}

impl DrawnPictures {
    /// Picture `k` as the online encoder sees it, values 0 to 255.
    pub fn seen(&self, k: usize, pixels: &mut [f32]) {
        self.flips[k].pixels(&self.frames[k], pixels);
        if let Some(view) = &self.views[k] {
            view.apply(pixels);
        }
    }

    /// Indices of the third pictures.
    #[must_use]
    pub fn third(&self) -> std::ops::Range<usize> {
        2 * self.triples.len()..3 * self.triples.len()
    }

    /// Votes of the mirrored picture `k` in the recording's coordinates.
    #[must_use]
    pub fn undo(&self, k: usize, votes: Votes) -> Votes {
        Votes { p: votes.p.map(|p| self.flips[k].undo(p)), ..votes }
    }

    /// Gradients by places in the recording as those by places in the mirrored pictures.
    #[must_use]
    pub fn redo(&self, by: &[VotesGradient]) -> Vec<VotesGradient> {
        let each = by.iter().zip(&self.flips);
        each.map(|(by, flip)| VotesGradient { p: by.p.map(|d| flip.redo(d)), ..*by }).collect()
    }
}

impl Flip {
    fn draw(rng: &mut impl Rng) -> Self {
        Self { columns: rng.random(), rows: rng.random(), transposed: rng.random() }
    }

    /// The pixel of the recording that comes to column `x`, row `y`.
    fn source(self, x: usize, y: usize) -> (usize, usize) {
        let (x, y) = if self.transposed { (y, x) } else { (x, y) };
        let mirrored = |k: usize, on: bool| if on { SIDE - 1 - k } else { k };
        (mirrored(x, self.columns), mirrored(y, self.rows))
    }

    /// A place in the mirrored picture as one in the recording, px.
    #[must_use]
    pub fn undo(self, p: [f32; 2]) -> [f32; 2] {
        let [x, y] = if self.transposed { [p[1], p[0]] } else { p };
        let mirrored = |v: f32, on: bool| if on { SIDE as f32 - v } else { v };
        [mirrored(x, self.columns), mirrored(y, self.rows)]
    }

    /// A gradient by a place in the recording as one by the place in the mirrored picture.
    #[must_use]
    pub fn redo(self, d: [f32; 2]) -> [f32; 2] {
        let turned = |v: f32, on: bool| if on { -v } else { v };
        let d = [turned(d[0], self.columns), turned(d[1], self.rows)];
        if self.transposed { [d[1], d[0]] } else { d }
    }

    /// The mirrored picture's values, 0 to 255.
    pub fn pixels(self, frame: &Frame, out: &mut [f32]) {
        let rgb = frame.rgb();
        for (n, out) in out.chunks_exact_mut(CHANNELS).enumerate() {
            let (x, y) = self.source(n % SIDE, n / SIDE);
            let at = (y * SIDE + x) * CHANNELS;
            out.iter_mut().zip(&rgb[at..at + CHANNELS]).for_each(|(o, byte)| *o = f32::from(*byte));
        }
    }
}

impl PictureView {
    /// One view for each picture of a triple: gains and noise are the triple's, the light each picture's.
    fn draw(config: &AugmentConfig, rng: &mut impl Rng) -> [Option<Self>; 3] {
        let on = rng.random::<f64>() < config.share;
        let gains = std::array::from_fn(|_| (1.0 + config.gain * rng.random_range(-1.0..=1.0)) as f32);
        let noise = (config.noise * rng.random::<f64>()) as f32;
        std::array::from_fn(|_| {
            let angle = std::f64::consts::TAU * rng.random::<f64>();
            let phase = std::f64::consts::TAU * rng.random::<f64>();
            // Wavelengths of 16 to 63 px.
            let wave = rng.random_range(0.1..0.4);
            let amplitude = config.light * rng.random::<f64>();
            let light = [amplitude, wave * angle.cos(), wave * angle.sin(), phase].map(|v| v as f32);
            on.then_some(Self { gains, noise, noise_seed: rng.random(), light })
        })
    }

    /// Changes a picture's values.
    pub fn apply(&self, pixels: &mut [f32]) {
        let [amplitude, along_x, along_y, phase] = self.light;
        let mut noise = CheapNormal(self.noise_seed);
        for (n, pixel) in pixels.chunks_exact_mut(CHANNELS).enumerate() {
            let (x, y) = ((n % SIDE) as f32 + 0.5, (n / SIDE) as f32 + 0.5);
            let light = 1.0 + amplitude * (along_x * x + along_y * y + phase).sin();
            for (v, gain) in pixel.iter_mut().zip(self.gains) {
                *v = (*v * gain * light + self.noise * noise.next()).clamp(0.0, 255.0);
            }
        }
    }
}

/// Nearly normal deviates, fast: the sum of four uniform ones of 16 bits, from SplitMix64.
struct CheapNormal(u64);

impl CheapNormal {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        let sum = (0..4).map(|k| (z >> (16 * k)) as u16 as f32).sum::<f32>();
        // Four uniform ones on 0..65536 have mean 2·65536 and variance 4·65536²/12.
        (sum / 65536.0 - 2.0) * 1.732_050_8
    }
}

/// A lag, log-uniform in `low..=high`, in an episode that is drawn by its length, and a start: the first picture in
/// a quarter of the cases, where a disc may be cut by the edge.
fn triple(episodes: &[EpisodeIndex], [low, high]: [usize; 2], rng: &mut impl Rng) -> PictureTriple {
    let episode = rng.random_range(0..episodes.len());
    let last = (episodes[episode].len() - 1) / 2;
    let (low, high) = (low.min(last), high.min(last));
    let (from, to) = ((low as f64 - 0.49).ln(), (high as f64 + 0.49).ln());
    let lag = ((from + (to - from) * rng.random::<f64>()).exp().round() as usize).clamp(low, high);
    let latest = episodes[episode].len() - 1 - 2 * lag;
    let first = if rng.random::<f64>() < 0.25 { 0 } else { rng.random_range(0..=latest) };
    PictureTriple { episode, first, lag }
}

/// The pictures of a step.
///
/// # Errors
/// If a picture cannot be read.
pub fn draw(
    recording: &Recording,
    episodes: &[EpisodeIndex],
    config: &LearnedConfig,
    rng: &mut impl Rng,
) -> Result<DrawnPictures, TensorError> {
    let mut triples = Vec::with_capacity(2 * config.triples);
    for lags in [config.long, config.short] {
        triples.extend((0..config.triples).map(|_| triple(episodes, lags, rng)));
    }
    let n = triples.len();
    let whole: Vec<Flip> = (0..n).map(|_| Flip::draw(rng)).collect();
    let own: Vec<Flip> = (0..3 * n).map(|_| Flip::draw(rng)).collect();
    let flips = if config.flip_pictures { own } else { [&whole[..], &whole, &whole].concat() };
    let drawn: Vec<[Option<PictureView>; 3]> =
        (0..n).map(|_| PictureView::draw(&config.augment, rng)).collect();
    let views = (0..3).flat_map(|m| drawn.iter().map(move |v| v[m])).collect();
    let px = (recording.a_max * SIDE as f64) as f32;
    let responses = triples
        .iter()
        .map(|t| episodes[t.episode].response(t.first, t.lag) * px)
        .map(|r: Vector2<f32>| [r.x, r.y])
        .collect();
    let places: Vec<(&EpisodeIndex, usize)> = (0..3)
        .flat_map(|m| triples.iter().map(move |t| (&episodes[t.episode], t.first + m * t.lag)))
        .collect();
    let frames = places.par_iter().map(|(e, k)| e.frame(*k)).collect::<Result<_, _>>()?;
    // The gain's network knows one base station alone.
    let station = recording.usual_station();
    let gains_db = places.iter().map(|(e, k)| e.gain_db(*k).filter(|_| e.base_station == station)).collect();
    Ok(DrawnPictures { triples, long: config.triples, frames, flips, views, responses, gains_db })
}

/// Standard normal deviates for start values.
pub fn normal(rng: &mut impl Rng) -> f32 {
    let deviate: f64 = StandardNormal.sample(rng);
    deviate as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all() -> impl Iterator<Item = Flip> {
        (0..8).map(|n| Flip { columns: n & 1 > 0, rows: n & 2 > 0, transposed: n & 4 > 0 })
    }

    #[test]
    fn a_place_in_the_mirrored_picture_is_the_place_in_the_recording() {
        let mut bytes = vec![0; PIXELS];
        bytes[(20 * SIDE + 70) * CHANNELS] = 255;
        let frame = Frame::from_rgb(bytes).unwrap();
        for flip in all() {
            let mut pixels = vec![0.0; PIXELS];
            flip.pixels(&frame, &mut pixels);
            let lit = pixels.iter().position(|v| *v > 0.0).unwrap() / CHANNELS;
            let p = [(lit % SIDE) as f32 + 0.5, (lit / SIDE) as f32 + 0.5];
            assert_eq!(flip.undo(p), [70.5, 20.5], "{flip:?}");
        }
    }

    #[test]
    fn a_gradient_follows_its_place() {
        for flip in all() {
            let (at, d) = ([30.0, 80.0], [0.5, -2.0]);
            let back = flip.redo(d);
            // The loss d·undo(p) has the gradient redo(d) by p.
            for axis in 0..2 {
                let mut moved = at;
                moved[axis] += 1.0;
                let (a, b) = (flip.undo(moved), flip.undo(at));
                let rise = d[0] * (a[0] - b[0]) + d[1] * (a[1] - b[1]);
                assert_eq!(rise, back[axis], "{flip:?}");
            }
        }
    }

    #[test]
    fn cheap_deviates_are_standard() {
        let mut noise = CheapNormal(3);
        let draws: Vec<f32> = (0..50_000).map(|_| noise.next()).collect();
        let mean = draws.iter().sum::<f32>() / 5e4;
        let variance = draws.iter().map(|v| v * v).sum::<f32>() / 5e4;
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
    }
}
