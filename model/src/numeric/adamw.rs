//! AdamW without decay over a list of tensors, its moments in the open so that they can be saved.

/// (0.9, 0.99, 1e-8), the gradient's norm bounded.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AdamW {
    clip: f32,
    step: i32,
    first: Vec<f32>,
    second: Vec<f32>,
}

impl AdamW {
    /// For tensors of these sizes.
    #[must_use]
    pub fn new(sizes: &[usize], clip: f32) -> Self {
        let count = sizes.iter().sum();
        Self { clip, step: 0, first: vec![0.0; count], second: vec![0.0; count] }
    }

    /// One step of `parts` down `gradient`; nothing and false if the gradient is not finite.
    pub fn descend(&mut self, parts: Vec<&mut [f32]>, gradient: &[&[f32]], rate: f32) -> bool {
        const BETAS: [f32; 2] = [0.9, 0.99];
        let squares: f64 = gradient.iter().flat_map(|g| g.iter()).map(|g| f64::from(*g).powi(2)).sum();
        let norm = squares.sqrt() as f32;
        if !norm.is_finite() {
            return false;
        }
        let scale = if norm > self.clip { self.clip / norm } else { 1.0 };
        self.step += 1;
        let [c1, c2] = BETAS.map(|beta| 1.0 - beta.powi(self.step));
        let weights = parts.into_iter().flat_map(|p| p.iter_mut());
        let gradient = gradient.iter().flat_map(|g| g.iter());
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((w, g), (m, v)) in weights.zip(gradient).zip(moments) {
            let g = scale * g;
            *m = BETAS[0] * *m + (1.0 - BETAS[0]) * g;
            *v = BETAS[1] * *v + (1.0 - BETAS[1]) * g * g;
            *w -= rate * (*m / c1) / ((*v / c2).sqrt() + 1e-8);
        }
        true
    }

    /// First and second moments, tensor after tensor.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_finds_the_bottom_of_a_bowl_and_goes_on_from_saved_moments() {
        let gradient = |w: &[f32]| vec![2.0 * (w[0] - 3.0), 20.0 * (w[1] + 1.0)];
        let (mut w, mut adam) = (vec![0.0f32, 0.0], AdamW::new(&[1, 1], 100.0));
        let step = |w: &mut Vec<f32>, adam: &mut AdamW| {
            let g = gradient(w);
            let (a, b) = w.split_at_mut(1);
            assert!(adam.descend(vec![a, b], &[&g[..1], &g[1..]], 0.05));
        };
        for _ in 0..100 {
            step(&mut w, &mut adam);
        }
        let mut again = AdamW::new(&[1, 1], 100.0);
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
    fn a_gradient_that_is_not_finite_changes_nothing() {
        let (mut w, mut adam) = (vec![1.0f32], AdamW::new(&[1], 1.0));
        assert!(!adam.descend(vec![&mut w], &[&[f32::NAN]], 0.1));
        assert_eq!((w, adam), (vec![1.0], AdamW::new(&[1], 1.0)));
    }
}
