//! What is behind the bodies: nothing, a procedural texture drawn for each flight, or a picture file.
//!
//! The texture is like a photograph of fields: octaves of noise from 1 to 64 px, mostly of brightness, and
//! a few hard edges. A ground is made once for a flight. It is wider than the frame by a margin, so that a
//! shaking camera sees no border.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use super::frame::{CHANNELS, WIDE};
use super::picture::Picture;
use super::strength::Strength;

/// What kind of ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GroundKind {
    /// Black.
    #[default]
    None,
    /// A texture drawn for each flight.
    Procedural,
    /// A picture file.
    File,
}

/// The ground of a camera. `Default` is black.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ground {
    /// What kind. Default none.
    pub kind: GroundKind,
    /// The picture of kind `file`: PNG or JPEG, its middle square scaled to the frame and 8 px round it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<Picture>,
    /// Share of the flights that have it, 0 to 1; the others have a black one. Default 1.
    pub share: f64,
    /// Standard deviation of the texture, 0 to 1 (white). Default 0.2.
    pub contrast: Strength,
    /// Mean brightness of the texture, 0 to 1 (white). Default 0.35.
    pub mean: Strength,
    /// Standard deviation of the mean of each colour, 0 to 1. Default 0.06.
    pub tint: Strength,
    /// Number of hard edges, such as those of fields and roads, 0 to 100. Default 0 to 3.
    pub edges: Strength,
}

impl Default for Ground {
    fn default() -> Self {
        Self {
            kind: GroundKind::None,
            file: None,
            share: 1.0,
            contrast: Strength::fixed(0.2),
            mean: Strength::fixed(0.35),
            tint: Strength::fixed(0.06),
            edges: Strength::between(0.0, 3.0),
        }
    }
}

impl Ground {
    /// What is wrong with kind, file and share: the key, the value and what it must be.
    pub(super) fn violation(&self) -> Option<(String, String, String)> {
        let key = |key: &str, value: String, must: &str| Some((format!("ground.{key}"), value, must.into()));
        match (self.kind, &self.file) {
            _ if !(0.0..=1.0).contains(&self.share) => {
                key("share", self.share.to_string(), "must lie in [0, 1]")
            }
            (GroundKind::File, None) => key("file", "nothing".into(), "must name a picture"),
            (GroundKind::File, Some(picture)) => {
                let why = picture.problem()?;
                key("file", picture.path().display().to_string(), &format!("must be a picture: {why}"))
            }
            (_, Some(picture)) => {
                key("file", picture.path().display().to_string(), "needs ground.kind = \"file\"")
            }
            _ => None,
        }
    }

    /// The ground of one flight, or `None` if it is black.
    pub(super) fn draw(&self, rng: &mut ChaCha8Rng) -> Option<Plane> {
        let chance: f64 = rng.random();
        if chance >= self.share {
            return None;
        }
        match self.kind {
            GroundKind::None => None,
            GroundKind::Procedural => Some(self.procedural(rng)),
            GroundKind::File => Some(Plane::of_picture(self.file.as_ref()?)),
        }
    }

    fn procedural(&self, rng: &mut ChaCha8Rng) -> Plane {
        let [contrast, mean, tint] = [self.contrast, self.mean, self.tint].map(|s| s.draw(rng) as f32);
        let edges = self.edges.draw_whole(rng);
        let mut planes = texture(edges, rng);
        for plane in &mut planes {
            let deviate: f32 = StandardNormal.sample(rng);
            let level = mean + tint * deviate;
            plane.iter_mut().for_each(|value| *value = level + contrast * *value);
        }
        Plane { planes, mean }
    }
}

/// The ground of one flight.
#[derive(Debug, Clone)]
pub(super) struct Plane {
    /// Red, green and blue, each `WIDE` rows of `WIDE` values, 0 to 1 (white) but for a texture's tails.
    pub planes: [Vec<f32>; CHANNELS],
    /// Mean brightness, 0 to 1.
    pub mean: f32,
}

impl Plane {
    fn of_picture(picture: &Picture) -> Self {
        let planes = picture.planes();
        let sum: f64 = planes.iter().flatten().map(|&v| f64::from(v)).sum();
        Self { mean: (sum / (CHANNELS * WIDE * WIDE) as f64) as f32, planes }
    }
}

/// Scale of an octave, px, and its amplitude.
const OCTAVES: [(usize, f32); 7] =
    [(1, 0.12), (2, 0.25), (4, 0.4), (8, 0.6), (16, 0.8), (32, 1.0), (64, 1.0)];
/// Amplitude of each colour's own noise beside that of the brightness.
const COLOUR: f32 = 0.35;

/// Three planes of `WIDE` x `WIDE` with mean 0 and variance 1 together.
fn texture(edges: u32, rng: &mut ChaCha8Rng) -> [Vec<f32>; CHANNELS] {
    let mut planes = [(); CHANNELS].map(|()| vec![0f32; WIDE * WIDE]);
    for (scale, amplitude) in OCTAVES {
        let coarse = WIDE / scale + 3;
        let brightness = normals(coarse * coarse, rng);
        let spare = coarse * scale - WIDE;
        let [row, column] = [(); 2].map(|()| taps(rng.random_range(0..=spare), scale, coarse));
        for plane in &mut planes {
            let own = normals(coarse * coarse, rng);
            let sum: Vec<f32> =
                brightness.iter().zip(own).map(|(b, c)| amplitude * (b + COLOUR * c)).collect();
            add_enlarged(plane, &sum, coarse, &row, &column);
        }
    }
    (0..edges).for_each(|_| add_half_plane(&mut planes, rng));
    standardise(&mut planes);
    planes
}

fn normals(count: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
    StandardNormal.sample_iter(rng).take(count).collect()
}

/// Indices and weights of the four coarse values that make a fine one.
type Tap = ([usize; 4], [f32; 4]);

/// Cubic convolution (Keys, a = -3/4) of coarse values, each `scale` px wide, from fine pixel `offset` on.
fn taps(offset: usize, scale: usize, coarse: usize) -> Vec<Tap> {
    let tap = |fine: usize| {
        let place = ((fine + offset) as f32 + 0.5) / scale as f32 - 0.5;
        let t = place - place.floor();
        let first = place.floor() as i64 - 1;
        let index = |k: usize| (first + k as i64).clamp(0, coarse as i64 - 1) as usize;
        ([0, 1, 2, 3].map(index), [far(1.0 + t), near(t), near(1.0 - t), far(2.0 - t)])
    };
    (0..WIDE).map(tap).collect()
}

const KEYS: f32 = -0.75;

fn near(d: f32) -> f32 {
    ((KEYS + 2.0) * d - (KEYS + 3.0)) * d * d + 1.0
}

fn far(d: f32) -> f32 {
    ((KEYS * d - 5.0 * KEYS) * d + 8.0 * KEYS) * d - 4.0 * KEYS
}

/// Adds coarse values, enlarged in both axes.
fn add_enlarged(plane: &mut [f32], values: &[f32], coarse: usize, rows: &[Tap], columns: &[Tap]) {
    for (line, (at, weight)) in plane.chunks_exact_mut(WIDE).zip(rows) {
        let sum = |x: usize| (0..4).map(|k| weight[k] * values[at[k] * coarse + x]).sum::<f32>();
        let across: Vec<f32> = (0..coarse).map(sum).collect();
        for (value, (at, weight)) in line.iter_mut().zip(columns) {
            *value += (0..4).map(|k| weight[k] * across[at[k]]).sum::<f32>();
        }
    }
}

/// Another brightness on one side of a line.
fn add_half_plane(planes: &mut [Vec<f32>; CHANNELS], rng: &mut ChaCha8Rng) {
    let [turn, left, top]: [f32; 3] = rng.random();
    let step: f32 = StandardNormal.sample(rng);
    let (sin, cos) = (turn * std::f32::consts::TAU).sin_cos();
    for plane in planes {
        for (n, value) in plane.iter_mut().enumerate() {
            let (x, y) = ((n % WIDE) as f32 - left * WIDE as f32, (n / WIDE) as f32 - top * WIDE as f32);
            *value += if x * cos + y * sin > 0.0 { step } else { 0.0 };
        }
    }
}

fn standardise(planes: &mut [Vec<f32>; CHANNELS]) {
    let count = (CHANNELS * WIDE * WIDE) as f64;
    let mean = planes.iter().flatten().map(|&v| f64::from(v)).sum::<f64>() / count;
    let variance = planes.iter().flatten().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / count;
    let scale = 1.0 / variance.sqrt().max(1e-9);
    for value in planes.iter_mut().flatten() {
        *value = ((f64::from(*value) - mean) * scale) as f32;
    }
}
