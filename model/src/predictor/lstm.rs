//! A network with memory: one LSTM layer and a linear output. A rollout begins with an empty memory.

use multiversion::multiversion;

use crate::numeric::kernel::{self, LANES, Lane, ZERO};
use crate::numeric::mlp::{Dense, Mlp};
use crate::numeric::tensors::{Reader, TensorError, Writer};
use crate::predictor::linear::Pair;
use crate::predictor::residual::{Cell, INPUTS, layer_gradient, row, times};

/// One LSTM layer: gates i, f, g, o from `[x, h]`, and a linear output.
#[derive(Debug, Clone, PartialEq)]
pub struct Lstm {
    /// `[x, h]` to the four gates, `[INPUTS + n][4 n]`.
    pub gates: Dense,
    /// h to the output, `[n][2]`.
    pub out: Dense,
}

/// h and c, and what the backward pass reads again, `[step * width]`.
#[derive(Debug, Clone, Default)]
pub struct LstmMemory {
    /// Steps forward that were not taken back.
    steps: usize,
    gates_transposed: Vec<f32>,
    out_transposed: Vec<f32>,
    /// `[x_k, h_{k-1}]`, and the slopes before the gates' activations.
    inputs: Vec<Lane>,
    slopes: Vec<Lane>,
    /// i, f, g, o after their activations.
    gates: Vec<Lane>,
    /// c_{-1}, c_0, ... and tanh c_k.
    carried: Vec<Lane>,
    shown: Vec<Lane>,
    /// h_k, and the slopes in the output.
    hidden: Vec<Lane>,
    out_slopes: Vec<Lane>,
    /// Slopes in h_k and c_k that step k + 1 gives back.
    d_hidden: Vec<Lane>,
    d_carried: Vec<Lane>,
}

impl Lstm {
    /// Reads what [`Cell::put`] wrote; the number of units is the file's own.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape.
    pub fn get(from: &Reader<'_>) -> Result<Self, TensorError> {
        let n = from.shape("lstm.gates.0.weight")?.first().copied().unwrap_or(0) / 4;
        let one = |name: &str, widths: [usize; 2]| -> Result<Dense, TensorError> {
            Ok(from.mlp(name, &widths)?.layers.swap_remove(0))
        };
        Ok(Self { gates: one("lstm.gates", [INPUTS + n, 4 * n])?, out: one("lstm.out", [n, 2])? })
    }
}

impl Cell for Lstm {
    type Memory = LstmMemory;

    fn forward(&self, memory: &mut LstmMemory, x: &[Lane; INPUTS]) -> Pair {
        let Self { gates, out } = self;
        let (k, n) = (memory.steps, out.inputs);
        memory.steps += 1;
        let input = row(&mut memory.inputs, k, INPUTS + n);
        input[..INPUTS].copy_from_slice(x);
        if k > 0 {
            input[INPUTS..].copy_from_slice(&memory.hidden[(k - 1) * n..][..n]);
        }
        let now = row(&mut memory.gates, k, 4 * n);
        kernel::affine(&gates.w, &gates.b, input, now);
        row(&mut memory.carried, k + 1, n);
        let (before, after) = memory.carried[k * n..].split_at_mut(n);
        let shown = row(&mut memory.shown, k, n);
        open(now, before, &mut after[..n], shown, row(&mut memory.hidden, k, n));
        let mut y = [ZERO; 2];
        kernel::affine(&out.w, &out.b, &memory.hidden[k * n..][..n], &mut y);
        y
    }

    fn backward(&self, memory: &mut LstmMemory, d_out: &Pair) -> [Lane; INPUTS] {
        let n = self.out.inputs;
        if memory.out_transposed.is_empty() {
            memory.gates_transposed = kernel::transpose(&self.gates.w, self.gates.outputs);
            memory.out_transposed = kernel::transpose(&self.out.w, self.out.outputs);
            memory.d_hidden = vec![ZERO; n];
            memory.d_carried = vec![ZERO; n];
        }
        memory.steps -= 1;
        let k = memory.steps;
        row(&mut memory.out_slopes, k, 2).copy_from_slice(d_out);
        let mut d_hidden = vec![ZERO; n];
        times(&memory.out_transposed, d_out, &mut d_hidden);
        for (d, later) in d_hidden.as_flattened_mut().iter_mut().zip(memory.d_hidden.as_flattened()) {
            *d += later;
        }
        let slopes = row(&mut memory.slopes, k, 4 * n);
        close(
            (&memory.gates[k * 4 * n..][..4 * n], &memory.carried[k * n..][..n], &memory.shown[k * n..][..n]),
            &d_hidden,
            &mut memory.d_carried,
            slopes,
        );
        let mut d_input = vec![ZERO; INPUTS + n];
        times(&memory.gates_transposed, slopes, &mut d_input);
        memory.d_hidden.copy_from_slice(&d_input[INPUTS..]);
        std::array::from_fn(|i| d_input[i])
    }

    fn gradient(&self, memory: &LstmMemory) -> Mlp {
        let Self { gates, out } = self;
        let layers = vec![
            layer_gradient(gates, &memory.inputs, &memory.slopes),
            layer_gradient(out, &memory.hidden, &memory.out_slopes),
        ];
        Mlp { layers }
    }

    fn layers(&self) -> Mlp {
        Mlp { layers: vec![self.gates.clone(), self.out.clone()] }
    }

    fn set_layers(&mut self, layers: &Mlp) {
        if let [gates, out] = layers.layers.as_slice() {
            (self.gates, self.out) = (gates.clone(), out.clone());
        }
    }

    fn put(&self, out: &mut Writer) {
        out.mlp("lstm.gates", &Mlp { layers: vec![self.gates.clone()] });
        out.mlp("lstm.out", &Mlp { layers: vec![self.out.clone()] });
    }
}

/// Activates i, f, g, o and carries c on: c = f c + i g, h = o tanh c.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn open(gates: &mut [Lane], before: &[Lane], carried: &mut [Lane], shown: &mut [Lane], hidden: &mut [Lane]) {
    let n = carried.len();
    for (gate, lane) in gates.iter_mut().enumerate() {
        let new = gate / n == 2;
        for v in lane {
            *v = if new { kernel::tanh(*v) } else { kernel::sigmoid(*v) };
        }
    }
    for k in 0..n {
        for l in 0..LANES {
            let [i, f, g, o] = [0, 1, 2, 3].map(|gate| gates[gate * n + k][l]);
            carried[k][l] = i.mul_add(g, f * before[k][l]);
            shown[k][l] = kernel::tanh(carried[k][l]);
            hidden[k][l] = o * shown[k][l];
        }
    }
}

/// Backward through [`open`]: slopes before the activations; `d_carried` from c_k's to c_{k-1}'s.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn close(
    (gates, before, shown): (&[Lane], &[Lane], &[Lane]),
    d_hidden: &[Lane],
    d_carried: &mut [Lane],
    slopes: &mut [Lane],
) {
    let n = before.len();
    for k in 0..n {
        for l in 0..LANES {
            let [i, f, g, o] = [0, 1, 2, 3].map(|gate| gates[gate * n + k][l]);
            let (dh, tanh_c) = (d_hidden[k][l], shown[k][l]);
            let dc = (dh * o).mul_add(1.0 - tanh_c * tanh_c, d_carried[k][l]);
            slopes[k][l] = dc * g * i * (1.0 - i);
            slopes[n + k][l] = dc * before[k][l] * f * (1.0 - f);
            slopes[2 * n + k][l] = dc * i * (1.0 - g * g);
            slopes[3 * n + k][l] = dh * tanh_c * o * (1.0 - o);
            d_carried[k][l] = dc * f;
        }
    }
}
