//! Small fully connected networks as plain arrays: tanh hidden layers, linear output.
//!
//! The flight path, the rollouts and the checkpoint share this form; training may use burn and
//! export into it. Every sum runs in a fixed order with fused multiply-adds, so results do not
//! depend on the machine's vector width.

use serde::{Deserialize, Serialize};

use crate::numeric::kernel;

/// One layer: y = x W + b.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Dense {
    /// Length of x.
    pub inputs: usize,
    /// Length of y.
    pub outputs: usize,
    /// W, row-major `[inputs][outputs]`.
    pub w: Vec<f32>,
    /// b, `[outputs]`.
    pub b: Vec<f32>,
}

impl Dense {
    /// A layer of zeros.
    #[must_use]
    pub fn zeros(inputs: usize, outputs: usize) -> Self {
        Self { inputs, outputs, w: vec![0.0; inputs * outputs], b: vec![0.0; outputs] }
    }

    /// x W + b.
    #[must_use]
    pub fn forward(&self, x: &[f32]) -> Vec<f32> {
        let mut y = self.b.clone();
        for (xi, row) in x.iter().zip(self.w.chunks_exact(self.outputs)) {
            for (yj, w) in y.iter_mut().zip(row) {
                *yj = xi.mul_add(*w, *yj);
            }
        }
        y
    }
}

/// Layers with tanh between them and nothing after the last.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Mlp {
    /// First to last.
    pub layers: Vec<Dense>,
}

impl Mlp {
    /// A network of zeros with these layer widths, inputs first.
    #[must_use]
    pub fn zeros(widths: &[usize]) -> Self {
        Self { layers: widths.windows(2).map(|w| Dense::zeros(w[0], w[1])).collect() }
    }

    /// Length of the input.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.layers.first().map_or(0, |l| l.inputs)
    }

    /// Length of the output.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.layers.last().map_or(0, |l| l.outputs)
    }

    /// The output for one input vector.
    #[must_use]
    pub fn forward(&self, x: &[f32]) -> Vec<f32> {
        let mut x = x.to_vec();
        for (n, layer) in self.layers.iter().enumerate() {
            let mut y = layer.forward(&x);
            if n + 1 < self.layers.len() {
                y.iter_mut().for_each(|v| *v = kernel::tanh(*v));
            }
            x = y;
        }
        x
    }
}
