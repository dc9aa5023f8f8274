//! Rollouts of a predictor with the way back: the gradient of their error in the network's weights.
//! [`LANES`](crate::numeric::kernel::LANES) rollouts at a time.

use multiversion::multiversion;

use crate::numeric::kernel::{self, LANES, Lane, ZERO};
use crate::numeric::mlp::{Dense, Mlp};
use crate::predictor::networks::{Cell, INPUTS, Lstm, Predictor};

/// Rollouts that are followed together, one a lane.
pub(crate) struct Block {
    /// y_k, y_{k-1} at the start.
    pub(crate) begin: [[Lane; 2]; 2],
    /// a_k, a_{k+1}, ...
    pub(crate) actions: Vec<[Lane; 2]>,
    /// What the pictures show after each action: y_{k+1}, ...
    pub(crate) shown: Vec<[Lane; 2]>,
}

/// Mean over the lanes of Σ_k weight_k |y_k - shown_k|² / place², and its gradient in the layers of
/// [`layers`].
pub(crate) fn loss(predictor: &Predictor, block: &Block, weights: &[f32]) -> (f64, Mlp) {
    match &predictor.cell {
        Cell::Mlp(net) => through(predictor, &mut Layered::new(net, weights.len()), block, weights),
        Cell::Lstm(lstm) => through(predictor, &mut Gated::new(lstm, weights.len()), block, weights),
    }
}

/// The network's layers in the order of its gradient.
pub(crate) fn layers(cell: &Cell) -> Mlp {
    match cell {
        Cell::Mlp(net) => net.clone(),
        Cell::Lstm(Lstm { gates, out }) => Mlp { layers: vec![gates.clone(), out.clone()] },
    }
}

/// The network with these layers, of the kind of `like`.
pub(crate) fn with_layers(like: &Cell, net: &Mlp) -> Cell {
    match (like, net.layers.as_slice()) {
        (Cell::Lstm(_), [gates, out]) => Cell::Lstm(Lstm { gates: gates.clone(), out: out.clone() }),
        _ => Cell::Mlp(net.clone()),
    }
}

/// A network that is run forward step by step, then back.
trait Trace {
    /// Output of step k for these inputs.
    fn forward(&mut self, k: usize, x: &[Lane; INPUTS]) -> [Lane; 2];
    /// Slopes in the inputs of step k, from those in its output; steps come from last to first.
    fn backward(&mut self, k: usize, d_out: &[Lane; 2]) -> [Lane; INPUTS];
    /// Slopes in the weights, once all steps went back.
    fn gradient(&self) -> Mlp;
}

fn through(predictor: &Predictor, net: &mut impl Trace, block: &Block, weights: &[f32]) -> (f64, Mlp) {
    let s = predictor.scaling;
    let horizon = weights.len();
    // y_{-1}, y_0, y_1, ... and the slopes in them.
    let mut y = vec![[ZERO; 2]; horizon + 2];
    (y[1], y[0]) = (block.begin[0], block.begin[1]);
    for k in 0..horizon {
        let mut x = [ZERO; INPUTS];
        for axis in 0..2 {
            for l in 0..LANES {
                let (now, before) = (y[k + 1][axis][l], y[k][axis][l]);
                x[axis][l] = now / s.place;
                x[2 + axis][l] = (now - before) / s.step;
            }
            x[4 + axis] = block.actions[k][axis];
        }
        let out = net.forward(k, &x);
        for axis in 0..2 {
            for l in 0..LANES {
                let straight = y[k + 1][axis][l] + (y[k + 1][axis][l] - y[k][axis][l]);
                y[k + 2][axis][l] = s.bend.mul_add(out[axis][l], straight);
            }
        }
    }
    let mut sum = 0.0;
    let mut dy = vec![[ZERO; 2]; horizon + 2];
    for k in (0..horizon).rev() {
        let weight = weights[k] / (s.place * s.place * LANES as f32);
        let mut d_out = [ZERO; 2];
        for axis in 0..2 {
            for l in 0..LANES {
                let off = y[k + 2][axis][l] - block.shown[k][axis][l];
                sum += f64::from(weight * off * off);
                dy[k + 2][axis][l] += 2.0 * weight * off;
                d_out[axis][l] = s.bend * dy[k + 2][axis][l];
            }
        }
        let dx = net.backward(k, &d_out);
        for axis in 0..2 {
            for l in 0..LANES {
                let (after, speed) = (dy[k + 2][axis][l], dx[2 + axis][l] / s.step);
                dy[k + 1][axis][l] += 2.0f32.mul_add(after, dx[axis][l] / s.place + speed);
                dy[k][axis][l] -= after + speed;
            }
        }
    }
    (sum, net.gradient())
}

/// SiLU layers.
struct Layered<'a> {
    net: &'a Mlp,
    /// Transposed weights.
    back: Vec<Vec<f32>>,
    /// Input of each layer, slope of the activation behind it, and slope of the loss before that, all
    /// steps: [layer][step * width].
    inputs: Vec<Vec<Lane>>,
    bends: Vec<Vec<Lane>>,
    slopes: Vec<Vec<Lane>>,
}

impl<'a> Layered<'a> {
    fn new(net: &'a Mlp, steps: usize) -> Self {
        Self {
            net,
            back: net.layers.iter().map(|l| kernel::transpose(&l.w, l.outputs)).collect(),
            inputs: net.layers.iter().map(|l| vec![ZERO; steps * l.inputs]).collect(),
            bends: net.layers.iter().map(|l| vec![ZERO; steps * l.outputs]).collect(),
            slopes: net.layers.iter().map(|l| vec![ZERO; steps * l.outputs]).collect(),
        }
    }
}

impl Trace for Layered<'_> {
    fn forward(&mut self, k: usize, x: &[Lane; INPUTS]) -> [Lane; 2] {
        let mut out = [ZERO; 2];
        let last = self.net.layers.len() - 1;
        row(&mut self.inputs[0], k, INPUTS).copy_from_slice(x);
        for (n, layer) in self.net.layers.iter().enumerate() {
            let (done, ahead) = self.inputs.split_at_mut(n + 1);
            let x = &done[n][k * layer.inputs..][..layer.inputs];
            if n == last {
                kernel::affine(&layer.w, &layer.b, x, &mut out);
            } else {
                let h = row(&mut ahead[0], k, layer.outputs);
                kernel::affine(&layer.w, &layer.b, x, h);
                activate(h, row(&mut self.bends[n], k, layer.outputs));
            }
        }
        out
    }

    fn backward(&mut self, k: usize, d_out: &[Lane; 2]) -> [Lane; INPUTS] {
        let last = self.net.layers.len() - 1;
        row(&mut self.slopes[last], k, 2).copy_from_slice(d_out);
        for n in (1..=last).rev() {
            let (before, after) = self.slopes.split_at_mut(n);
            let (inputs, outputs) = (self.net.layers[n].inputs, self.net.layers[n].outputs);
            let d = row(&mut before[n - 1], k, inputs);
            straight(&self.back[n], &after[0][k * outputs..][..outputs], d);
            let bends = row(&mut self.bends[n - 1], k, inputs).as_flattened();
            d.as_flattened_mut().iter_mut().zip(bends).for_each(|(d, bend)| *d *= bend);
        }
        let mut dx = [ZERO; INPUTS];
        let outputs = self.net.layers[0].outputs;
        straight(&self.back[0], &self.slopes[0][k * outputs..][..outputs], &mut dx);
        dx
    }

    fn gradient(&self) -> Mlp {
        let parts = self.inputs.iter().zip(&self.slopes);
        Mlp { layers: self.net.layers.iter().zip(parts).map(|(l, (x, dy))| outer(l, x, dy)).collect() }
    }
}

/// One recurrent layer.
struct Gated<'a> {
    lstm: &'a Lstm,
    gates_back: Vec<f32>,
    out_back: Vec<f32>,
    /// [x_k, h_{k-1}], and the slopes before the gates' activations.
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

impl<'a> Gated<'a> {
    fn new(lstm: &'a Lstm, steps: usize) -> Self {
        let n = lstm.out.inputs;
        Self {
            lstm,
            gates_back: kernel::transpose(&lstm.gates.w, lstm.gates.outputs),
            out_back: kernel::transpose(&lstm.out.w, lstm.out.outputs),
            inputs: vec![ZERO; steps * (INPUTS + n)],
            slopes: vec![ZERO; steps * 4 * n],
            gates: vec![ZERO; steps * 4 * n],
            carried: vec![ZERO; (steps + 1) * n],
            shown: vec![ZERO; steps * n],
            hidden: vec![ZERO; steps * n],
            out_slopes: vec![ZERO; steps * 2],
            d_hidden: vec![ZERO; n],
            d_carried: vec![ZERO; n],
        }
    }
}

impl Trace for Gated<'_> {
    fn forward(&mut self, k: usize, x: &[Lane; INPUTS]) -> [Lane; 2] {
        let Lstm { gates, out } = self.lstm;
        let n = out.inputs;
        let input = row(&mut self.inputs, k, INPUTS + n);
        input[..INPUTS].copy_from_slice(x);
        if k > 0 {
            input[INPUTS..].copy_from_slice(&self.hidden[(k - 1) * n..][..n]);
        }
        let now = row(&mut self.gates, k, 4 * n);
        kernel::affine(&gates.w, &gates.b, input, now);
        let (before, after) = self.carried[k * n..].split_at_mut(n);
        open(now, before, &mut after[..n], row(&mut self.shown, k, n), row(&mut self.hidden, k, n));
        let mut shown = [ZERO; 2];
        kernel::affine(&out.w, &out.b, &self.hidden[k * n..][..n], &mut shown);
        shown
    }

    fn backward(&mut self, k: usize, d_out: &[Lane; 2]) -> [Lane; INPUTS] {
        let n = self.lstm.out.inputs;
        row(&mut self.out_slopes, k, 2).copy_from_slice(d_out);
        let mut d_hidden = vec![ZERO; n];
        straight(&self.out_back, d_out, &mut d_hidden);
        for (d, later) in d_hidden.as_flattened_mut().iter_mut().zip(self.d_hidden.as_flattened()) {
            *d += later;
        }
        let slopes = row(&mut self.slopes, k, 4 * n);
        shut(
            (&self.gates[k * 4 * n..][..4 * n], &self.carried[k * n..][..n], &self.shown[k * n..][..n]),
            &d_hidden,
            &mut self.d_carried,
            slopes,
        );
        let mut d_input = vec![ZERO; INPUTS + n];
        straight(&self.gates_back, slopes, &mut d_input);
        self.d_hidden.copy_from_slice(&d_input[INPUTS..]);
        std::array::from_fn(|i| d_input[i])
    }

    fn gradient(&self) -> Mlp {
        let Lstm { gates, out } = self.lstm;
        let layers =
            vec![outer(gates, &self.inputs, &self.slopes), outer(out, &self.hidden, &self.out_slopes)];
        Mlp { layers }
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

/// The way back through [`open`]: slopes before the activations; `d_carried` from c_k's to c_{k-1}'s.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn shut(
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

/// SiLU, and its slope.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn activate(h: &mut [Lane], bends: &mut [Lane]) {
    for (h, bend) in h.as_flattened_mut().iter_mut().zip(bends.as_flattened_mut()) {
        let s = kernel::sigmoid(*h);
        *bend = s * (1.0 - s).mul_add(*h, 1.0);
        *h *= s;
    }
}

/// y = x W.
fn straight(w: &[f32], x: &[Lane], y: &mut [Lane]) {
    kernel::affine(w, &vec![0.0; y.len()], x, y);
}

/// Step k of a quantity of so many lanes a step.
fn row(of: &mut [Lane], k: usize, width: usize) -> &mut [Lane] {
    &mut of[k * width..][..width]
}

/// A layer's gradient from its inputs and the slopes before its activation, all steps.
fn outer(layer: &Dense, x: &[Lane], dy: &[Lane]) -> Dense {
    let mut grad = Dense::zeros(layer.inputs, layer.outputs);
    kernel::outer(x, layer.inputs, dy, layer.outputs, &mut grad.w);
    kernel::sum_lanes(dy, &mut grad.b);
    grad
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::predictor::networks::Scaling;

    fn filled(inputs: usize, outputs: usize, size: f32) -> Dense {
        let mut dense = Dense::zeros(inputs, outputs);
        let values = dense.w.iter_mut().chain(&mut dense.b).enumerate();
        values.for_each(|(k, w)| *w = size * ((k * 7 + outputs) as f32 * 1.7).sin());
        dense
    }

    fn lanes(steps: usize, size: f32) -> Vec<[Lane; 2]> {
        let value = |n: usize| size * (n as f32 * 0.77).sin();
        let lane = |at: usize| std::array::from_fn(|l| value(at * LANES + l));
        (0..steps).map(|k| [lane(2 * k), lane(2 * k + 1)]).collect()
    }

    /// Against differences of the loss in every weight of both kinds.
    #[test]
    fn the_gradient_is_the_slope() {
        let scaling = Scaling { place: 2.0, step: 0.2, bend: 0.03 };
        let steps = 12;
        let begin = [lanes(1, 3.0)[0], lanes(1, 2.9)[0]];
        let block = Block { begin, actions: lanes(steps, 1.0), shown: lanes(steps, 3.0) };
        let weights: Vec<f32> = (1..=steps).map(|k| 1.0 / k as f32).collect();
        let mlp = Mlp { layers: vec![filled(INPUTS, 8, 0.5), filled(8, 8, 0.4), filled(8, 2, 0.7)] };
        let lstm = Lstm { gates: filled(INPUTS + 4, 16, 0.5), out: filled(4, 2, 0.9) };
        for cell in [Cell::Mlp(mlp), Cell::Lstm(lstm)] {
            let (_, grad) = loss(&Predictor { cell: cell.clone(), scaling }, &block, &weights);
            let net = layers(&cell);
            for (n, g) in grad.layers.iter().enumerate() {
                let size = g.w.iter().chain(&g.b).fold(0.0f32, |m, v| m.max(v.abs()));
                for k in 0..g.w.len() + g.b.len() {
                    let at = |h: f32| {
                        let mut moved = net.clone();
                        let layer = &mut moved.layers[n];
                        *layer.w.iter_mut().chain(&mut layer.b).nth(k).unwrap() += h;
                        loss(&Predictor { cell: with_layers(&cell, &moved), scaling }, &block, &weights).0
                    };
                    let h = 1e-2;
                    let slope = (at(h) - at(-h)) / f64::from(2.0 * h);
                    let got = f64::from(*g.w.iter().chain(&g.b).nth(k).unwrap());
                    let off = (slope - got).abs();
                    assert!(off < 0.01 * f64::from(size), "layer {n}, weight {k}: {got}, slope {slope}");
                }
            }
        }
    }
}
