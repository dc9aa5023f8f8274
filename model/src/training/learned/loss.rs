//! The losses of the learned encoder, on places and spreads of the votes, with their gradients.
//!
//! All in px. p0, p1, p2 are the online encoder's reading of a triple's pictures, t the EMA target's of the third;
//! y is what the known actions add to p2 - 2 p1 + p0. z_c and z_u are p in other units (`S E (p - 50)/100`), so
//! these are the JEPA's losses on them.

use rayon::prelude::*;

use crate::encoder::votes::{BODIES, Votes, VotesGradient};
use crate::numeric::adam::Adam;
use crate::numeric::kernel;
use crate::numeric::mlp::Mlp;
use crate::training::learned::batch::DrawnPictures;
use crate::training::learned::teacher;
use crate::world_model::learned::LearnedConfig;

/// Index of the UAV among the bodies.
const C: usize = 0;
/// Index of the obstacle.
const U: usize = 1;

/// Widths of the network that predicts the measured gain from both places.
pub const GAIN_NET: [usize; 4] = [2 * BODIES, 64, 64, 1];

/// δ of the gain's error, dB.
const GAIN_DELTA: f32 = 0.5;

/// Running means that the losses are scaled by, and those that are shown.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RunningMeans {
    /// z_c's loss; 0 before the first step.
    pub loss_c: f32,
    /// Median error of z_u's prediction, px.
    pub error_u: f32,
    /// z_u's error against the teacher.
    pub teacher: f32,
    /// Share of the triples on which the teacher says something.
    pub believed: f32,
    /// Correlation of z_c's second differences with the actions.
    pub correlation: f32,
    /// Movement of z_u in a short triple, px.
    pub movement: f32,
    /// Error of the gain, dB.
    pub gain: f32,
    /// Spread of the votes, px.
    pub spread: [f32; BODIES],
    /// Whether anything was added.
    begun: bool,
}

impl RunningMeans {
    /// Numbers of the saved state.
    pub const LENGTH: usize = 10;

    /// For the disk.
    #[must_use]
    pub fn numbers(&self) -> [f32; Self::LENGTH] {
        [
            self.loss_c,
            self.error_u,
            self.teacher,
            self.believed,
            self.correlation,
            self.movement,
            self.gain,
            self.spread[C],
            self.spread[U],
            f32::from(u8::from(self.begun)),
        ]
    }

    /// From the disk.
    #[must_use]
    pub fn from_numbers(n: [f32; Self::LENGTH]) -> Self {
        Self {
            loss_c: n[0],
            error_u: n[1],
            teacher: n[2],
            believed: n[3],
            correlation: n[4],
            movement: n[5],
            gain: n[6],
            spread: [n[7], n[8]],
            begun: n[9] > 0.0,
        }
    }
}

/// A step's readings, in the recording's coordinates.
#[derive(Debug)]
pub struct Readings<'a> {
    /// The online encoder's, `[3 n]`: first, second, third pictures.
    pub online: &'a [Votes],
    /// The target's of the third pictures, `[n]`.
    pub target: &'a [[[f32; 2]; BODIES]],
    /// What was drawn.
    pub drawn: &'a DrawnPictures,
}

/// The gain's network and its gradient.
#[derive(Debug)]
pub struct GainNet<'a> {
    /// The network.
    pub net: &'a Mlp,
    /// Its gradient; the loss adds to it.
    pub gradient: Mlp,
}

/// The loss, with its gradient by every online reading.
#[derive(Debug)]
pub struct LearnedLoss {
    /// The sum.
    pub value: f32,
    /// `[3 n]`
    pub gradients: Vec<VotesGradient>,
}

/// Where in the run a step is.
#[derive(Debug, Clone, Copy)]
pub struct TrainPhase {
    /// Number of the step.
    pub step: usize,
    /// Of so many.
    pub steps: usize,
}

impl TrainPhase {
    fn share(self) -> f32 {
        self.step as f32 / self.steps.max(1) as f32
    }
}

/// Evaluates the losses of a step and takes up its means.
#[must_use]
pub fn evaluate(
    readings: &Readings<'_>,
    gain: &mut GainNet<'_>,
    config: &LearnedConfig,
    phase: TrainPhase,
    means: &mut RunningMeans,
) -> LearnedLoss {
    let mut loss =
        LearnedLoss { value: 0.0, gradients: vec![VotesGradient::default(); readings.online.len()] };
    let first = !means.begun;
    means.begun = true;
    loss.controllable(readings, config, means, first);
    loss.teacher(readings, config, phase, means, first);
    loss.uncontrollable(readings, config, phase, means, first);
    loss.gain(readings, gain, config, means, first);
    loss.spread(readings, config, phase, means, first);
    loss
}

fn mean(into: &mut f32, value: f32, keep: f32, first: bool) {
    *into = if first { value } else { keep * *into + (1.0 - keep) * value };
}

type Place = [f32; 2];

fn sub(a: Place, b: Place) -> Place {
    [a[0] - b[0], a[1] - b[1]]
}

fn square(a: Place) -> f32 {
    a[0] * a[0] + a[1] * a[1]
}

/// A triple's readings of one body: p0, p1, p2.
fn triple(readings: &Readings<'_>, k: usize, body: usize) -> [Place; 3] {
    let n = readings.target.len();
    [0, 1, 2].map(|m| readings.online[m * n + k].p[body])
}

/// p2 - 2 p1 + p0
fn second([p0, p1, p2]: [Place; 3]) -> Place {
    [0, 1].map(|axis| p2[axis] - 2.0 * p1[axis] + p0[axis])
}

/// Correlation of second differences with the responses, and its gradient by them.
fn correlation(differences: &[Place], responses: &[Place]) -> (f32, Vec<Place>) {
    let dot =
        |a: &[Place], b: &[Place]| -> f32 { a.iter().zip(b).map(|(a, b)| a[0] * b[0] + a[1] * b[1]).sum() };
    let (dd, yy) = (dot(differences, differences), dot(responses, responses));
    let root = (dd * yy + 1e-9).sqrt();
    let dy = dot(differences, responses);
    let slope = differences
        .iter()
        .zip(responses)
        .map(|(d, y)| [0, 1].map(|k| y[k] / root - dy * yy * d[k] / (root * root * root)))
        .collect();
    (dy / root, slope)
}

impl LearnedLoss {
    /// Adds the gradient `by` (per triple from `from` on) of second differences.
    fn add_second(&mut self, n: usize, from: usize, body: usize, by: &[Place], weight: f32) {
        for (k, by) in by.iter().enumerate() {
            for (m, factor) in [1.0, -2.0, 1.0].into_iter().enumerate() {
                let into = &mut self.gradients[m * n + from + k].p[body];
                into[0] += weight * factor * by[0];
                into[1] += weight * factor * by[1];
            }
        }
    }

    /// z_c: prediction by the known actions, against the target and, if wished, the online encoder; correlation.
    fn controllable(
        &mut self,
        readings: &Readings<'_>,
        config: &LearnedConfig,
        means: &mut RunningMeans,
        first: bool,
    ) {
        let (n, w, delta) = (readings.target.len(), &config.weights, config.delta_px as f32);
        let responses = &readings.drawn.responses;
        let differences: Vec<Place> = (0..n).map(|k| second(triple(readings, k, C))).collect();
        // e = 2 p1 - p0 + y - last, as charb(e) = sqrt(|e|² + δ²) - δ.
        let mut sums = [0.0f32; 2];
        let mut slopes = Vec::with_capacity(n);
        for k in 0..n {
            let [_, _, p2] = triple(readings, k, C);
            let online = [0, 1].map(|axis| responses[k][axis] - differences[k][axis]);
            let against_target = [0, 1].map(|axis| online[axis] + p2[axis] - readings.target[k][C][axis]);
            slopes.push([online, against_target].map(|e| {
                let root = (square(e) + delta * delta).sqrt();
                (root - delta, [e[0] / root, e[1] / root])
            }));
            sums[0] += slopes[k][0].0;
            sums[1] += slopes[k][1].0;
        }
        let weights = [w.online_c as f32, w.target_c as f32];
        let value = (weights[0] * sums[0] + weights[1] * sums[1]) / n as f32;
        mean(&mut means.loss_c, value, 0.98, first);
        let scale = 1.0 / (means.loss_c.max(1e-6) * n as f32);
        self.value += value / means.loss_c.max(1e-6);
        for (k, [online, target]) in slopes.into_iter().enumerate() {
            for axis in 0..2 {
                // By p1: 2 of both; by p0: -1; by p2: -1 of the online term alone.
                let (o, t) = (weights[0] * scale * online.1[axis], weights[1] * scale * target.1[axis]);
                self.gradients[k].p[C][axis] -= o + t;
                self.gradients[n + k].p[C][axis] += 2.0 * (o + t);
                self.gradients[2 * n + k].p[C][axis] -= o;
            }
        }
        let (r, slope) = correlation(&differences, responses);
        mean(&mut means.correlation, r, 0.98, first);
        self.value += w.correlation as f32 * (1.0 - r);
        self.add_second(n, 0, C, &slope, -w.correlation as f32);
    }

    /// z_u after what moved in the picture, at first.
    fn teacher(
        &mut self,
        readings: &Readings<'_>,
        config: &LearnedConfig,
        phase: TrainPhase,
        means: &mut RunningMeans,
        first: bool,
    ) {
        let (n, teacher) = (readings.target.len(), &config.teacher);
        let [full, gone] = teacher.fade.map(|v| v as f32);
        let fade = ((gone - phase.share()) / (gone - full).max(1e-6)).clamp(0.0, 1.0);
        if phase.step < teacher.from || fade == 0.0 || teacher.weight == 0.0 {
            return;
        }
        let frames = &readings.drawn.frames;
        let find = |k: usize| {
            let pictures = [0, 1, 2].map(|m| &frames[m * n + k]);
            teacher::moved(pictures, readings.online[n + k].p[C], teacher)
        };
        let moved: Vec<Option<Place>> = (0..n).into_par_iter().map(find).collect();
        let believed = moved.iter().flatten().count() as f32;
        let weight = teacher.weight as f32 * fade / 10.0 / (believed + 1.0);
        let mut sum = 0.0;
        for (k, moved) in moved.into_iter().enumerate() {
            let Some(moved) = moved else { continue };
            let e = sub(readings.online[n + k].p[U], moved);
            let root = (square(e) + 1.0).sqrt();
            sum += root - 1.0;
            for axis in 0..2 {
                self.gradients[n + k].p[U][axis] += weight * e[axis] / root;
            }
        }
        self.value += weight * sum;
        let begins = phase.step == teacher.from || first;
        mean(&mut means.believed, believed / n as f32, 0.98, begins);
        mean(&mut means.teacher, sum / (believed + 1.0), 0.95, begins);
    }

    /// z_u: constant velocity, not driven by the actions, moving; once it follows something that moves.
    fn uncontrollable(
        &mut self,
        readings: &Readings<'_>,
        config: &LearnedConfig,
        phase: TrainPhase,
        means: &mut RunningMeans,
        first: bool,
    ) {
        let (n, from, w) = (readings.target.len(), readings.drawn.long, &config.weights);
        let short = n - from;
        let triples: Vec<[Place; 3]> = (from..n).map(|k| triple(readings, k, U)).collect();
        let differences: Vec<Place> = triples.iter().map(|t| second(*t)).collect();
        let mut errors: Vec<f32> = differences.iter().map(|d| square(*d).sqrt()).collect();
        errors.sort_by(f32::total_cmp);
        let median = errors.get((short - 1) / 2).copied().unwrap_or_default();
        let scale = if first { 5.0 } else { means.error_u }.max(config.delta_px as f32);
        mean(&mut means.error_u, median, 0.98, first);
        let moves: Vec<(Place, f32)> = triples
            .iter()
            .map(|t| {
                let d = sub(t[2], t[0]);
                (d, (square(d) + 1e-6).sqrt())
            })
            .collect();
        let movement = moves.iter().map(|(_, length)| length).sum::<f32>() / short as f32;
        mean(&mut means.movement, movement, 0.98, first);
        let taught = config.teacher.weight == 0.0
            || (means.teacher > 0.0 && means.teacher < config.teacher.landed as f32)
            || f64::from(phase.share()) > config.teacher.fade[1];
        if phase.step <= config.teacher.from + 50 || !taught {
            return;
        }
        // Cauchy with a running scale: a bounce is an outlier.
        let [online, target] = [w.online_u, w.target_u].map(|w| w as f32 / short as f32);
        for (k, t) in triples.iter().enumerate() {
            let e = differences[k];
            let last = sub(t[2], readings.target[from + k][U]);
            let e_target = [e[0] - last[0], e[1] - last[1]];
            let cauchy = |e: Place| {
                (0.5 * kernel::ln(1.0 + square(e) / (scale * scale)), 1.0 / (scale * scale + square(e)))
            };
            let ((value, slope), (value_t, slope_t)) = (cauchy(e), cauchy(e_target));
            self.value += online * value + target * value_t;
            for axis in 0..2 {
                let (o, t) = (online * slope * e[axis], target * slope_t * e_target[axis]);
                self.gradients[from + k].p[U][axis] += o + t;
                self.gradients[n + from + k].p[U][axis] -= 2.0 * (o + t);
                self.gradients[2 * n + from + k].p[U][axis] += o;
            }
        }
        let (driven, slope) = correlation(&differences, &readings.drawn.responses[from..]);
        self.value += w.driven as f32 * driven * driven;
        self.add_second(n, from, U, &slope, 2.0 * driven * w.driven as f32);
        // Reward of movement, as far as 8 px.
        const FAR: f32 = 8.0;
        self.value -= w.movement as f32 * kernel::ln(movement.min(FAR));
        if movement < FAR {
            let weight = w.movement as f32 / (movement * short as f32);
            for (k, (d, length)) in moves.iter().enumerate() {
                for axis in 0..2 {
                    let slope = weight * d[axis] / length;
                    self.gradients[from + k].p[U][axis] += slope;
                    self.gradients[2 * n + from + k].p[U][axis] -= slope;
                }
            }
        }
    }

    /// The measured gain from both places; z_u alone learns from it.
    fn gain(
        &mut self,
        readings: &Readings<'_>,
        gain: &mut GainNet<'_>,
        config: &LearnedConfig,
        means: &mut RunningMeans,
        first: bool,
    ) {
        let measured: Vec<(usize, f32)> =
            readings.drawn.gains_db.iter().enumerate().filter_map(|(k, g)| Some((k, (*g)?))).collect();
        let weight = config.weights.gain as f32 / measured.len().max(1) as f32;
        if measured.is_empty() || weight == 0.0 {
            return;
        }
        let mut sum = 0.0;
        for (k, measured) in &measured {
            let [c, u] = readings.online[*k].p;
            let x = [c[0], c[1], u[0], u[1]].map(|p| (p - 50.0) / 25.0);
            let by = |y: &[f32]| {
                let e = GAIN_UNIT * y[0] + GAIN_MIDDLE - measured;
                let root = (e * e + GAIN_DELTA * GAIN_DELTA).sqrt();
                sum += root - GAIN_DELTA;
                vec![weight * GAIN_UNIT * e / root]
            };
            let (_, d) = gain.net.backward(&x, by, &mut gain.gradient);
            for axis in 0..2 {
                self.gradients[*k].p[U][axis] += d[2 + axis] / 25.0;
            }
        }
        self.value += weight * sum;
        mean(&mut means.gain, sum / measured.len() as f32, 0.98, first);
    }

    /// Agreement of the votes.
    fn spread(
        &mut self,
        readings: &Readings<'_>,
        config: &LearnedConfig,
        phase: TrainPhase,
        means: &mut RunningMeans,
        first: bool,
    ) {
        let pictures = readings.online.len() as f32;
        let weight = config.weights.spread as f32 * (phase.share() / 0.3).min(1.0) / 10.0 / pictures;
        for body in 0..BODIES {
            let mut sum = 0.0;
            for (votes, into) in readings.online.iter().zip(&mut self.gradients) {
                let root = (votes.spread[body] + 1.0).sqrt();
                sum += root;
                into.spread[body] += weight * 0.5 / root;
            }
            self.value += weight * sum;
            mean(&mut means.spread[body], sum / pictures, 0.98, first);
        }
    }
}

/// Decibels of one unit of the gain network's output.
const GAIN_UNIT: f32 = 10.0;
/// Decibels of its output 0.
const GAIN_MIDDLE: f32 = 5.0;

/// Bounds the norm of all gradients together and takes a step of Adam; false if one is not finite.
pub fn descend(
    weights: Vec<&mut [f32]>,
    gradients: &[&[f32]],
    adam: &mut Adam,
    clip: f64,
    rate: f64,
) -> bool {
    let squares: f64 = gradients.iter().flat_map(|g| g.iter()).map(|g| f64::from(*g).powi(2)).sum();
    let norm = squares.sqrt();
    if !norm.is_finite() {
        return false;
    }
    let scale = if norm > clip { (clip / norm) as f32 } else { 1.0 };
    adam.step(weights.into_iter().flatten(), gradients.iter().flat_map(|g| g.iter()), scale, rate as f32);
    true
}
