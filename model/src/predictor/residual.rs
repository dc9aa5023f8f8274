//! What the networks have in common: they correct constant velocity.
//!
//! ŷ_{k+1} = 2 y_k - y_{k-1} + ρ f(y_k / place, (y_k - y_{k-1}) / step, a_k), in plane coordinates: a latent
//! half is of rank 2, so nothing is lost. f is a [`Cell`], ρ the scale of its output.

use nalgebra::{Matrix2, Vector2};

use crate::numeric::kernel::{LANES, Lane, ZERO};
use crate::numeric::mlp::{Dense, Mlp};
use crate::numeric::{kernel, tensors};
use crate::predictor::linear::{Displacement, Pair};

/// Numbers that a network reads: place, step, action, two each.
pub const INPUTS: usize = 6;

/// What brings a network's inputs and output to order one; measured on the training latents.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scaling {
    /// Rms of a coordinate of y_c, latent units.
    pub place: f32,
    /// Rms of a coordinate of y_k - y_{k-1}, latent units.
    pub step: f32,
    /// Rms of a coordinate of y_{k+1} - 2 y_k + y_{k-1}, latent units.
    pub residual: f32,
}

/// A network f of [`LANES`] rollouts at once, run forward step by step, then backward.
pub trait Cell {
    /// What it carries from step to step, and what the backward pass reads again.
    type Memory: Default + std::fmt::Debug + Clone;

    /// The output of the next step for inputs of order one.
    fn forward(&self, memory: &mut Self::Memory, x: &[Lane; INPUTS]) -> Pair;

    /// Slopes in the inputs of the last step that was not yet taken back, from those in its output.
    fn backward(&self, memory: &mut Self::Memory, d_out: &Pair) -> [Lane; INPUTS];

    /// Slopes in the weights, in the order of [`Cell::layers`], once all steps were taken back.
    fn gradient(&self, memory: &Self::Memory) -> Mlp;

    /// The weights, layer by layer.
    fn layers(&self) -> Mlp;

    /// Takes up what [`Cell::layers`] gave.
    fn set_layers(&mut self, layers: &Mlp);

    /// Adds its tensors to a file.
    fn put(&self, out: &mut tensors::Writer);
}

/// A predictor that adds a network's output to constant velocity.
#[derive(Debug, Clone, PartialEq)]
pub struct Residual<C> {
    /// f
    pub cell: C,
    /// Its units.
    pub scaling: Scaling,
}

impl<C: Cell> Residual<C> {
    /// y_{k+1} of at most [`LANES`] rollouts in f64, each given as `[y_k, y_{k-1}]`, in place.
    pub fn advance(
        &self,
        memory: &mut C::Memory,
        states: &mut [[Vector2<f64>; 2]],
        actions: impl Fn(usize) -> Vector2<f64>,
    ) {
        let Scaling { place, step, residual } = self.scaling;
        let mut x = [ZERO; INPUTS];
        for (lane, [now, before]) in states.iter().enumerate() {
            let (a, v) = (actions(lane), now - before);
            let inputs = [
                now.x as f32 / place,
                now.y as f32 / place,
                v.x as f32 / step,
                v.y as f32 / step,
                a.x as f32,
                a.y as f32,
            ];
            for (x, value) in x.iter_mut().zip(inputs) {
                x[lane] = value;
            }
        }
        let out = self.cell.forward(memory, &x);
        for (lane, [now, before]) in states.iter_mut().enumerate() {
            let f = Vector2::new(out[0][lane], out[1][lane]).map(f64::from);
            (*now, *before) = (*now * 2.0 - *before + f * f64::from(residual), *now);
        }
    }

    /// y_{k+1} of [`LANES`] rollouts.
    pub fn forward(&self, memory: &mut C::Memory, now: &Pair, before: &Pair, a: &Pair) -> Pair {
        let Scaling { place, step, residual } = self.scaling;
        let mut x = [ZERO; INPUTS];
        for axis in 0..2 {
            for l in 0..LANES {
                x[axis][l] = now[axis][l] / place;
                x[2 + axis][l] = (now[axis][l] - before[axis][l]) / step;
            }
            x[4 + axis] = a[axis];
        }
        let mut next = self.cell.forward(memory, &x);
        for axis in 0..2 {
            for l in 0..LANES {
                let straight = now[axis][l] + (now[axis][l] - before[axis][l]);
                next[axis][l] = residual.mul_add(next[axis][l], straight);
            }
        }
        next
    }

    /// Adds the slopes in y_k, y_{k-1} and a_k, from those in y_{k+1}.
    pub fn backward(&self, memory: &mut C::Memory, d_next: &Pair, [d_now, d_before, d_a]: [&mut Pair; 3]) {
        let Scaling { place, step, residual } = self.scaling;
        let d_out = d_next.map(|d| d.map(|d| residual * d));
        let dx = self.cell.backward(memory, &d_out);
        for axis in 0..2 {
            for l in 0..LANES {
                let (after, speed) = (d_next[axis][l], dx[2 + axis][l] / step);
                d_now[axis][l] += 2.0f32.mul_add(after, dx[axis][l] / place + speed);
                d_before[axis][l] -= after + speed;
                d_a[axis][l] += dx[4 + axis][l];
            }
        }
    }

    /// The step from y_k, and its slopes in y_k and in v = y_k - y_{k-1}, with a fresh memory.
    #[must_use]
    pub fn displacement(&self, y: Vector2<f64>, v: Vector2<f64>, a: Vector2<f64>) -> Displacement {
        let mut state = [[y, y - v]];
        self.advance(&mut C::Memory::default(), &mut state, |_| a);
        // Lanes 0 and 1 take back one coordinate of y_{k+1} each.
        let lanes = |v: Vector2<f64>| [[v.x as f32; LANES], [v.y as f32; LANES]];
        let (mut memory, mut d_next) = (C::Memory::default(), [ZERO; 2]);
        self.forward(&mut memory, &lanes(y), &lanes(y - v), &lanes(a));
        (d_next[0][0], d_next[1][1]) = (1.0, 1.0);
        let (mut d_now, mut d_before, mut d_a) = ([ZERO; 2], [ZERO; 2], [ZERO; 2]);
        self.backward(&mut memory, &d_next, [&mut d_now, &mut d_before, &mut d_a]);
        let slopes = |d: &Pair| Matrix2::from_fn(|row, column| f64::from(d[column][row]));
        let (by_now, by_before) = (slopes(&d_now), slopes(&d_before));
        Displacement {
            step: state[0][0] - y,
            by_y: by_now + by_before - Matrix2::identity(),
            by_v: -by_before,
        }
    }
}

/// Step `k` of a quantity of so many lanes a step; grows the list where it ends.
pub(crate) fn row(of: &mut Vec<Lane>, k: usize, width: usize) -> &mut [Lane] {
    if of.len() < (k + 1) * width {
        of.resize((k + 1) * width, ZERO);
    }
    &mut of[k * width..][..width]
}

/// y = x W.
pub(crate) fn times(w: &[f32], x: &[Lane], y: &mut [Lane]) {
    kernel::affine(w, &vec![0.0; y.len()], x, y);
}

/// A layer's gradient from its inputs and the slopes before its activation, all steps.
pub(crate) fn layer_gradient(layer: &Dense, x: &[Lane], dy: &[Lane]) -> Dense {
    let mut grad = Dense::zeros(layer.inputs, layer.outputs);
    kernel::outer(x, layer.inputs, dy, layer.outputs, &mut grad.w);
    kernel::sum_lanes(dy, &mut grad.b);
    grad
}
