//! A policy network for [`LANES`](crate::numeric::kernel::LANES) rollouts at once: forward and backward.

use crate::numeric::kernel::{self, Lane, ZERO};
use crate::numeric::mlp::{Dense, Mlp};

/// Units of a hidden layer.
pub(crate) const HIDDEN: usize = 64;

#[inline(always)]
pub(crate) fn tanh_all(h: &mut [Lane]) {
    for v in h.as_flattened_mut() {
        *v = kernel::tanh(*v);
    }
}

/// d ← d (1 - h²), the slope of tanh at output h.
#[inline(always)]
pub(crate) fn times_tanh_slope(d: &mut [Lane], h: &[Lane]) {
    for (d, h) in d.as_flattened_mut().iter_mut().zip(h.as_flattened()) {
        *d *= 1.0 - h * h;
    }
}

/// A policy's action probabilities for all lanes, keeping the hidden layers for the backward pass.
#[inline(always)]
pub(crate) fn probabilities(net: &Mlp, x: &[Lane], h1: &mut [Lane], h2: &mut [Lane], p: &mut [Lane]) {
    let [l1, l2, l3] = net.layers.as_slice() else { return };
    kernel::affine(&l1.w, &l1.b, x, h1);
    tanh_all(h1);
    kernel::affine(&l2.w, &l2.b, h1, h2);
    tanh_all(h2);
    kernel::affine(&l3.w, &l3.b, h2, p);
    let (mut top, mut sum) = (p[0], ZERO);
    for lane in &p[1..] {
        for (t, v) in top.iter_mut().zip(lane) {
            *t = t.max(*v);
        }
    }
    for lane in p.iter_mut() {
        for ((v, t), s) in lane.iter_mut().zip(&top).zip(&mut sum) {
            *v = kernel::exp(*v - t);
            *s += *v;
        }
    }
    for lane in p {
        for (v, s) in lane.iter_mut().zip(&sum) {
            *v /= s;
        }
    }
}

/// A policy network's transposed weights, for the backward pass.
pub(crate) struct Back {
    /// First layer, `[hidden][features]`.
    pub(crate) w1: Vec<f32>,
    w2: Vec<f32>,
    w3: Vec<f32>,
}

impl Back {
    pub(crate) fn new(net: &Mlp) -> Self {
        let t = |n: usize| net.layers.get(n).map_or(Vec::new(), |l| kernel::transpose(&l.w, l.outputs));
        Self { w1: t(0), w2: t(1), w3: t(2) }
    }

    /// From the slopes `dp` in the probabilities `p` to the slopes before each layer's activation.
    #[inline(always)]
    pub(crate) fn hidden(
        &self,
        p: &[Lane],
        dp: &[Lane],
        (h1, h2): (&[Lane], &[Lane]),
        (d1, d2, d3): (&mut [Lane], &mut [Lane], &mut [Lane]),
    ) {
        let mut mean = ZERO;
        for (p, d) in p.iter().zip(dp) {
            for ((m, p), d) in mean.iter_mut().zip(p).zip(d) {
                *m = p.mul_add(*d, *m);
            }
        }
        for ((out, p), d) in d3.iter_mut().zip(p).zip(dp) {
            for (((o, p), d), m) in out.iter_mut().zip(p).zip(d).zip(&mean) {
                *o = p * (d - m);
            }
        }
        kernel::affine(&self.w3, &[0.0; HIDDEN], d3, d2);
        times_tanh_slope(d2, h2);
        kernel::affine(&self.w2, &[0.0; HIDDEN], d2, d1);
        times_tanh_slope(d1, h1);
    }
}

/// Gradient of the weights from each layer's inputs and the slopes before its activation.
#[inline(always)]
pub(crate) fn weight_gradient(net: &Mlp, parts: [(&[Lane], &[Lane]); 3]) -> Mlp {
    let mut grad = Mlp { layers: net.layers.iter().map(|l| Dense::zeros(l.inputs, l.outputs)).collect() };
    for (layer, (x, dy)) in grad.layers.iter_mut().zip(parts) {
        kernel::outer(x, layer.inputs, dy, layer.outputs, &mut layer.w);
        kernel::sum_lanes(dy, &mut layer.b);
    }
    grad
}
