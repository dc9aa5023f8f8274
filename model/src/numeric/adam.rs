//! Adam over one network, and the mean of its iterates.

use crate::numeric::mlp::Mlp;

/// Adam (0.9, 0.999, 1e-8) over one network.
pub(crate) struct Adam {
    rate: f32,
    clip: f32,
    step: i32,
    first: Mlp,
    second: Mlp,
}

impl Adam {
    pub(crate) fn new(net: &Mlp, rate: f32, clip: f32) -> Self {
        let mut zeros = net.clone();
        for layer in &mut zeros.layers {
            layer.w.fill(0.0);
            layer.b.fill(0.0);
        }
        Self { rate, clip, step: 0, first: zeros.clone(), second: zeros }
    }

    /// Changes the learning rate.
    pub(crate) fn set_rate(&mut self, rate: f32) {
        self.rate = rate;
    }

    /// One step down `grad`; returns the gradient's norm before clipping.
    pub(crate) fn descend(&mut self, net: &mut Mlp, grad: &Mlp) -> f64 {
        let squares = |l: &crate::numeric::mlp::Dense| {
            l.w.iter().chain(&l.b).map(|g| f64::from(*g) * f64::from(*g)).sum::<f64>()
        };
        let norm = grad.layers.iter().map(squares).sum::<f64>().sqrt();
        // A gradient that is not finite teaches nothing; the iteration is skipped.
        if !norm.is_finite() {
            return norm;
        }
        let scale = if norm > f64::from(self.clip) { (f64::from(self.clip) / norm) as f32 } else { 1.0 };
        self.step += 1;
        let (c1, c2) = (1.0 - 0.9f32.powi(self.step), 1.0 - 0.999f32.powi(self.step));
        let layers = net.layers.iter_mut().zip(&grad.layers);
        for ((layer, g), (m, v)) in layers.zip(self.first.layers.iter_mut().zip(&mut self.second.layers)) {
            let weights = layer.w.iter_mut().chain(&mut layer.b).zip(g.w.iter().chain(&g.b));
            let moments = m.w.iter_mut().chain(&mut m.b).zip(v.w.iter_mut().chain(&mut v.b));
            for ((w, g), (m, v)) in weights.zip(moments) {
                let g = scale * g;
                *m = 0.9 * *m + 0.1 * g;
                *v = 0.999 * *v + 0.001 * g * g;
                *w -= self.rate * (*m / c1) / ((*v / c2).sqrt() + 1e-8);
            }
        }
        norm
    }
}

/// Running sum of a network's weights in f64.
#[derive(Default)]
pub struct Mean {
    sums: Vec<f64>,
    like: Option<Mlp>,
    count: f64,
}

impl Mean {
    /// Adds one network to the mean.
    pub fn add(&mut self, net: &Mlp) {
        let weights = net.layers.iter().flat_map(|l| l.w.iter().chain(&l.b));
        self.sums.resize(weights.clone().count(), 0.0);
        self.sums.iter_mut().zip(weights).for_each(|(s, w)| *s += f64::from(*w));
        self.like.get_or_insert_with(|| net.clone());
        self.count += 1.0;
    }

    /// The mean; `None` if nothing was added.
    pub fn net(self) -> Option<Mlp> {
        let mut net = self.like?;
        let weights = net.layers.iter_mut().flat_map(|l| l.w.iter_mut().chain(&mut l.b));
        weights.zip(self.sums).for_each(|(w, s)| *w = (s / self.count) as f32);
        Some(net)
    }
}
