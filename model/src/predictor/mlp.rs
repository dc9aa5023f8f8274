//! A network without memory: SiLU layers (x σ(x), of which two make a straight line).

use multiversion::multiversion;

use crate::numeric::kernel::{self, Lane, ZERO};
use crate::numeric::mlp::Mlp;
use crate::numeric::tensors::{Reader, TensorError, Writer};
use crate::predictor::linear::Pair;
use crate::predictor::residual::{Cell, INPUTS, layer_gradient, row, times};

/// SiLU layers, and a linear one last.
#[derive(Debug, Clone, PartialEq)]
pub struct SiluMlp(pub Mlp);

/// What the backward pass reads again, `[layer][step * width]`.
#[derive(Debug, Clone, Default)]
pub struct MlpMemory {
    /// Steps forward that were not taken back.
    steps: usize,
    /// Transposed weights.
    transposed: Vec<Vec<f32>>,
    inputs: Vec<Vec<Lane>>,
    /// Slope of the activation behind each layer.
    activation_slopes: Vec<Vec<Lane>>,
    /// Slope of the loss before that activation.
    slopes: Vec<Vec<Lane>>,
}

impl SiluMlp {
    /// Reads what [`Cell::put`] wrote; the width of the hidden layers is the file's own.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape.
    pub fn get(from: &Reader<'_>) -> Result<Self, TensorError> {
        let hidden = from.shape("mlp.0.weight")?.first().copied().unwrap_or(0);
        Ok(Self(from.mlp("mlp", &[INPUTS, hidden, hidden, 2])?))
    }
}

impl Cell for SiluMlp {
    type Memory = MlpMemory;

    fn forward(&self, memory: &mut MlpMemory, x: &[Lane; INPUTS]) -> Pair {
        let (k, layers) = (memory.steps, &self.0.layers);
        for list in [&mut memory.inputs, &mut memory.activation_slopes, &mut memory.slopes] {
            list.resize_with(layers.len(), Vec::new);
        }
        memory.steps += 1;
        let mut out = [ZERO; 2];
        row(&mut memory.inputs[0], k, INPUTS).copy_from_slice(x);
        for (n, layer) in layers.iter().enumerate() {
            let (done, ahead) = memory.inputs.split_at_mut(n + 1);
            let x = &done[n][k * layer.inputs..][..layer.inputs];
            if n + 1 == layers.len() {
                kernel::affine(&layer.w, &layer.b, x, &mut out);
            } else {
                let h = row(&mut ahead[0], k, layer.outputs);
                kernel::affine(&layer.w, &layer.b, x, h);
                activate(h, row(&mut memory.activation_slopes[n], k, layer.outputs));
            }
        }
        out
    }

    fn backward(&self, memory: &mut MlpMemory, d_out: &Pair) -> [Lane; INPUTS] {
        let layers = &self.0.layers;
        let last = layers.len() - 1;
        if memory.transposed.is_empty() {
            memory.transposed = layers.iter().map(|l| kernel::transpose(&l.w, l.outputs)).collect();
        }
        memory.steps -= 1;
        let k = memory.steps;
        for (slopes, layer) in memory.slopes.iter_mut().zip(layers) {
            // The last step comes first.
            row(slopes, k, layer.outputs);
        }
        memory.slopes[last][2 * k..][..2].copy_from_slice(d_out);
        for n in (1..=last).rev() {
            let (before, after) = memory.slopes.split_at_mut(n);
            let (inputs, outputs) = (layers[n].inputs, layers[n].outputs);
            let d = &mut before[n - 1][k * inputs..][..inputs];
            times(&memory.transposed[n], &after[0][k * outputs..][..outputs], d);
            let slopes = memory.activation_slopes[n - 1][k * inputs..][..inputs].as_flattened();
            d.as_flattened_mut().iter_mut().zip(slopes).for_each(|(d, slope)| *d *= slope);
        }
        let mut dx = [ZERO; INPUTS];
        let outputs = layers[0].outputs;
        times(&memory.transposed[0], &memory.slopes[0][k * outputs..][..outputs], &mut dx);
        dx
    }

    fn gradient(&self, memory: &MlpMemory) -> Mlp {
        let parts = memory.inputs.iter().zip(&memory.slopes);
        let layers = self.0.layers.iter().zip(parts);
        Mlp { layers: layers.map(|(l, (x, dy))| layer_gradient(l, x, dy)).collect() }
    }

    fn layers(&self) -> Mlp {
        self.0.clone()
    }

    fn set_layers(&mut self, layers: &Mlp) {
        self.0.clone_from(layers);
    }

    fn put(&self, out: &mut Writer) {
        out.mlp("mlp", &self.0);
    }
}

/// SiLU, and its slope.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn activate(h: &mut [Lane], slopes: &mut [Lane]) {
    for (h, slope) in h.as_flattened_mut().iter_mut().zip(slopes.as_flattened_mut()) {
        let s = kernel::sigmoid(*h);
        *slope = s * (1.0 - s).mul_add(*h, 1.0);
        *h *= s;
    }
}
