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

    /// The output for one input vector, the gradient by the input and, added to `gradient`, by the weights, of a loss
    /// whose gradient by the output is what `by_output` makes of the output.
    pub fn backward(
        &self,
        x: &[f32],
        by_output: impl FnOnce(&[f32]) -> Vec<f32>,
        gradient: &mut Self,
    ) -> (Vec<f32>, Vec<f32>) {
        let mut inputs = vec![x.to_vec()];
        for (n, layer) in self.layers.iter().enumerate() {
            let mut y = layer.forward(&inputs[n]);
            if n + 1 < self.layers.len() {
                y.iter_mut().for_each(|v| *v = kernel::tanh(*v));
            }
            inputs.push(y);
        }
        let output = inputs.pop().unwrap_or_default();
        let mut d = by_output(&output);
        for ((n, layer), into) in self.layers.iter().enumerate().zip(&mut gradient.layers).rev() {
            let mut d_in = vec![0.0; layer.inputs];
            for ((i, x), d_in) in inputs[n].iter().enumerate().zip(&mut d_in) {
                let row = i * layer.outputs..(i + 1) * layer.outputs;
                for ((w, dw), d) in layer.w[row.clone()].iter().zip(&mut into.w[row]).zip(&d) {
                    *dw += x * d;
                    *d_in += w * d;
                }
                if n > 0 {
                    *d_in *= 1.0 - x * x;
                }
            }
            into.b.iter_mut().zip(&d).for_each(|(b, d)| *b += d);
            d = d_in;
        }
        (output, d)
    }

    /// All weights, layer by layer.
    #[must_use]
    pub fn parts(&self) -> Vec<&[f32]> {
        self.layers.iter().flat_map(|l| [l.w.as_slice(), l.b.as_slice()]).collect()
    }

    /// The same, to be changed.
    pub fn parts_mut(&mut self) -> Vec<&mut [f32]> {
        self.layers.iter_mut().flat_map(|l| [l.w.as_mut_slice(), l.b.as_mut_slice()]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_is_that_of_differences() {
        let value = |n: usize| ((n * 37 + 11) % 23) as f32 / 23.0 - 0.5;
        let mut net = Mlp::zeros(&[3, 5, 4, 2]);
        net.parts_mut().into_iter().flatten().enumerate().for_each(|(n, w)| *w = value(n));
        let (x, by) = ([0.3, -0.7, 0.2], vec![0.8, -1.1]);
        let loss = |net: &Mlp, x: &[f32]| -> f32 { net.forward(x).iter().zip(&by).map(|(y, d)| y * d).sum() };
        let mut gradient = Mlp::zeros(&[3, 5, 4, 2]);
        let (output, d) = net.backward(&x, |_| by.clone(), &mut gradient);
        assert_eq!(output, net.forward(&x));
        let step = 1e-2;
        for k in 0..3 {
            let (mut up, mut down) = (x, x);
            (up[k], down[k]) = (x[k] + step, x[k] - step);
            let wanted = (loss(&net, &up) - loss(&net, &down)) / (2.0 * step);
            assert!((d[k] - wanted).abs() < 1e-3, "input {k}: {} instead of {wanted}", d[k]);
        }
        for (part, k) in [(0, 4), (1, 2), (2, 7), (3, 3), (4, 5), (5, 1)] {
            let moved = |by: f32| {
                let mut net = net.clone();
                net.parts_mut()[part][k] += by;
                loss(&net, &x)
            };
            let (found, wanted) = (gradient.parts()[part][k], (moved(step) - moved(-step)) / (2.0 * step));
            assert!((found - wanted).abs() < 1e-3, "part {part}, {k}: {found} instead of {wanted}");
        }
    }
}
