//! Adam with decoupled weight decay, its moments in the open so that they can be saved, and the mean of
//! its iterates.

use crate::numeric::mlp::{Dense, Mlp};

/// Decay rates of the two moments: what a step keeps of each, and what it adds.
///
/// Both are stored because `1 - 0.9` is not `0.1` in f32, and results must not change by a bit.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Betas {
    first: [f32; 2],
    second: [f32; 2],
}

impl Betas {
    /// (0.9, 0.999), for the small networks.
    pub const SLOW: Self = Self { first: [0.9, 0.1], second: [0.999, 0.001] };
    /// (0.9, 0.99), for the encoder.
    pub const FAST: Self = Self { first: [0.9, 1.0 - 0.9f32], second: [0.99, 1.0 - 0.99f32] };
}

/// The optimiser of a list of weights; ε is 1e-8.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Adam {
    betas: Betas,
    /// Share of each weight that a step of rate 1 takes away.
    weight_decay: f32,
    step: i32,
    first: Vec<f32>,
    second: Vec<f32>,
}

impl Adam {
    /// For `count` weights.
    #[must_use]
    pub fn new(count: usize, betas: Betas, weight_decay: f32) -> Self {
        Self { betas, weight_decay, step: 0, first: vec![0.0; count], second: vec![0.0; count] }
    }

    /// For the weights of a network, without decay.
    #[must_use]
    pub fn of(net: &Mlp, betas: Betas) -> Self {
        Self::new(net.layers.iter().map(|l| l.w.len() + l.b.len()).sum(), betas, 0.0)
    }

    /// One step of `weights` down `scale` times `gradient`, entry by entry.
    pub fn step<'a>(
        &mut self,
        weights: impl IntoIterator<Item = &'a mut f32>,
        gradient: impl IntoIterator<Item = &'a f32>,
        scale: f32,
        rate: f32,
    ) {
        let Betas { first, second } = self.betas;
        self.step += 1;
        let (c1, c2) = (1.0 - first[0].powi(self.step), 1.0 - second[0].powi(self.step));
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((w, g), (m, v)) in weights.into_iter().zip(gradient).zip(moments) {
            let g = scale * g;
            *m = first[0] * *m + first[1] * g;
            *v = second[0] * *v + second[1] * g * g;
            *w -= rate * (*m / c1) / ((*v / c2).sqrt() + 1e-8) + rate * self.weight_decay * *w;
        }
    }

    /// One step of a network down `gradient`, its norm bounded by `clip`; gives the norm before that. A
    /// gradient that is not finite changes nothing.
    pub fn descend(&mut self, net: &mut Mlp, gradient: &Mlp, clip: f32, rate: f32) -> f64 {
        let squares = |l: &Dense| l.w.iter().chain(&l.b).map(|g| f64::from(*g) * f64::from(*g)).sum::<f64>();
        let norm = gradient.layers.iter().map(squares).sum::<f64>().sqrt();
        if norm.is_finite() {
            let scale = if norm > f64::from(clip) { (f64::from(clip) / norm) as f32 } else { 1.0 };
            let weights = net.layers.iter_mut().flat_map(|l| l.w.iter_mut().chain(&mut l.b));
            let gradient = gradient.layers.iter().flat_map(|l| l.w.iter().chain(&l.b));
            self.step(weights, gradient, scale, rate);
        }
        norm
    }

    /// First and second moments, weight after weight.
    #[must_use]
    pub fn moments(&self) -> [&[f32]; 2] {
        [&self.first, &self.second]
    }

    /// Takes up the moments after `step` steps.
    pub fn restore(&mut self, [first, second]: [Vec<f32>; 2], step: usize) {
        self.step = i32::try_from(step).unwrap_or(i32::MAX);
        (self.first, self.second) = (first, second);
    }
}

/// Running mean of a network's weights, summed in f64.
#[derive(Default)]
pub struct WeightMean {
    sums: Vec<f64>,
    like: Option<Mlp>,
    count: f64,
}

impl WeightMean {
    /// Adds one network to the mean.
    pub fn add(&mut self, net: &Mlp) {
        let weights = net.layers.iter().flat_map(|l| l.w.iter().chain(&l.b));
        self.sums.resize(weights.clone().count(), 0.0);
        self.sums.iter_mut().zip(weights).for_each(|(s, w)| *s += f64::from(*w));
        self.like.get_or_insert_with(|| net.clone());
        self.count += 1.0;
    }

    /// The mean; `None` if nothing was added.
    #[must_use]
    pub fn net(self) -> Option<Mlp> {
        let mut net = self.like?;
        let weights = net.layers.iter_mut().flat_map(|l| l.w.iter_mut().chain(&mut l.b));
        weights.zip(self.sums).for_each(|(w, s)| *w = (s / self.count) as f32);
        Some(net)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_finds_the_bottom_of_a_bowl_and_goes_on_from_saved_moments() {
        let gradient = |w: &[f32]| [2.0 * (w[0] - 3.0), 20.0 * (w[1] + 1.0)];
        let (mut w, mut adam) = (vec![0.0f32, 0.0], Adam::new(2, Betas::FAST, 0.0));
        let step = |w: &mut Vec<f32>, adam: &mut Adam| {
            let g = gradient(w);
            adam.step(w, &g, 1.0, 0.05);
        };
        for _ in 0..100 {
            step(&mut w, &mut adam);
        }
        let mut again = Adam::new(2, Betas::FAST, 0.0);
        again.restore(adam.moments().map(<[f32]>::to_vec), 100);
        let mut v = w.clone();
        step(&mut v, &mut again);
        step(&mut w, &mut adam);
        assert_eq!(v, w);
        for _ in 0..400 {
            step(&mut w, &mut adam);
        }
        assert!((w[0] - 3.0).abs() < 0.05 && (w[1] + 1.0).abs() < 0.05, "{w:?}");
    }

    #[test]
    fn the_first_steps_are_as_long_as_the_rate_whatever_the_gradients_size() {
        // With both biases corrected, moments of a constant gradient g are g and g² from the first step on.
        for (size, betas) in [1e-3, 1.0, 1e3].into_iter().flat_map(|s| [(s, Betas::SLOW), (s, Betas::FAST)]) {
            let (mut w, mut adam) = ([0.0f32, 0.0], Adam::new(2, betas, 0.0));
            for n in 1..=3 {
                adam.step(&mut w, &[size, -size], 1.0, 0.01);
                let far = 0.01 * n as f32;
                assert!((w[0] + far).abs() < 1e-5 && (w[1] - far).abs() < 1e-5, "step {n}, {size}: {w:?}");
            }
        }
    }

    #[test]
    fn a_change_of_sign_moves_as_the_formula_has_it() {
        let (mut w, mut adam) = ([0.0f32], Adam::new(1, Betas::SLOW, 0.0));
        adam.step(&mut w, &[1.0], 1.0, 0.1);
        adam.step(&mut w, &[-3.0], 1.0, 0.1);
        // m = 0.9 0.1 - 0.3, v = 0.999 0.001 + 0.009; over 1 - 0.9², 1 - 0.999².
        let (m, v): (f64, f64) = (-0.21 / 0.19, 0.009_999 / 0.001_999);
        assert!((f64::from(w[0]) - (-0.1 - 0.1 * m / v.sqrt())).abs() < 1e-5, "{w:?}");
    }

    #[test]
    fn a_gradient_that_is_not_finite_changes_nothing() {
        let mut net = Mlp::zeros(&[1, 1]);
        let mut gradient = net.clone();
        gradient.layers[0].w[0] = f32::NAN;
        let mut adam = Adam::of(&net, Betas::SLOW);
        assert!(adam.descend(&mut net, &gradient, 1.0, 0.1).is_nan());
        assert_eq!((net, adam), (Mlp::zeros(&[1, 1]), Adam::of(&Mlp::zeros(&[1, 1]), Betas::SLOW)));
    }

    #[test]
    fn weight_decay_shrinks_weights_that_have_no_gradient() {
        let mut w = [2.0f32];
        Adam::new(1, Betas::SLOW, 0.1).step(&mut w, &[0.0], 1.0, 0.5);
        assert!((w[0] - 1.9).abs() < 1e-6, "{w:?}");
    }
}
