//! A head in the rollout: its value for all lanes, and its slope in y_c.

use crate::heads::networks::SightLine;
use crate::numeric::kernel::{self, LANES, Lane, ZERO};
use crate::numeric::mlp::Mlp;
use crate::planning::exact::Exact;
use crate::planning::lanes::{HIDDEN, tanh_all, times_tanh_slope};

/// A head with scalar output.
#[derive(Debug, Clone)]
pub struct Head(HeadKind);

#[derive(Debug, Clone)]
enum HeadKind {
    Learned(Learned),
    Exact(Box<Exact>),
}

impl Head {
    /// A learned head, a 4-64-64-1 network; `None` for other widths.
    #[must_use]
    pub fn new(net: Mlp, sight: Option<SightLine>) -> Option<Self> {
        Some(Self(HeadKind::Learned(Learned::new(net, sight)?)))
    }

    /// The simulator's equation in a head's place.
    #[must_use]
    pub fn exact(equation: Exact) -> Self {
        Self(HeadKind::Exact(Box::new(equation)))
    }

    /// The output for all lanes.
    #[inline(always)]
    pub(super) fn value(&self, y: &[Lane; 4]) -> Lane {
        match &self.0 {
            HeadKind::Learned(head) => head.value(y),
            HeadKind::Exact(head) => head.value(y),
        }
    }

    /// Gradient of the output with respect to y_c.
    #[inline(always)]
    pub(super) fn gradient(&self, y: &[Lane; 4]) -> [Lane; 2] {
        match &self.0 {
            HeadKind::Learned(head) => head.gradient(y),
            HeadKind::Exact(head) => head.gradient(y),
        }
    }
}

/// A network, MLP 4-64-64-1 (scales and constants folded in) on `[y_c, y_u]` or on their
/// coordinates of the sight line.
#[derive(Debug, Clone)]
struct Learned {
    net: Mlp,
    sight: Option<SightLine>,
    w1_transposed: Vec<f32>,
    w2_transposed: Vec<f32>,
}

impl Learned {
    fn new(net: Mlp, sight: Option<SightLine>) -> Option<Self> {
        let [a, b, c] = net.layers.as_slice() else { return None };
        let widths = [a.inputs, a.outputs, b.outputs, c.outputs];
        if widths != [4, HIDDEN, HIDDEN, 1] {
            return None;
        }
        let (w1_transposed, w2_transposed) =
            (kernel::transpose(&a.w, HIDDEN), kernel::transpose(&b.w, HIDDEN));
        Some(Self { net, sight, w1_transposed, w2_transposed })
    }

    #[inline(always)]
    fn value(&self, y: &[Lane; 4]) -> Lane {
        self.layers(&self.input(y)).2
    }

    #[inline(always)]
    fn gradient(&self, y: &[Lane; 4]) -> [Lane; 2] {
        let (h1, h2, _) = self.layers(&self.input(y));
        let Some(last) = self.net.layers.last() else { return [ZERO; 2] };
        let mut d2 = [ZERO; HIDDEN];
        for ((d, h), w) in d2.iter_mut().zip(&h2).zip(&last.w) {
            for (d, h) in d.iter_mut().zip(h) {
                *d = w * (1.0 - h * h);
            }
        }
        let (mut d1, mut dx) = ([ZERO; HIDDEN], [ZERO; 4]);
        kernel::affine(&self.w2_transposed, &[0.0; HIDDEN], &d2, &mut d1);
        times_tanh_slope(&mut d1, &h1);
        kernel::affine(&self.w1_transposed, &[0.0; 4], &d1, &mut dx);
        let mut dy = [dx[0], dx[1]];
        if let Some(sight) = &self.sight {
            for l in 0..LANES {
                let slope = std::array::from_fn(|i| dx[i][l]);
                let by_y = sight.pull_back([y[0][l], y[1][l]], [y[2][l], y[3][l]], slope);
                (dy[0][l], dy[1][l]) = (by_y[0], by_y[1]);
            }
        }
        dy
    }

    /// What the network reads of `[y_c, y_u]`.
    #[inline(always)]
    fn input(&self, y: &[Lane; 4]) -> [Lane; 4] {
        let Some(sight) = &self.sight else { return *y };
        let mut x = [ZERO; 4];
        for l in 0..LANES {
            let at = sight.coordinates([y[0][l], y[1][l]], [y[2][l], y[3][l]]);
            for i in 0..4 {
                x[i][l] = at[i];
            }
        }
        x
    }

    /// Hidden layers and output for all lanes.
    #[inline(always)]
    fn layers(&self, x: &[Lane; 4]) -> ([Lane; HIDDEN], [Lane; HIDDEN], Lane) {
        let [l1, l2, l3] = self.net.layers.as_slice() else { return ([ZERO; HIDDEN], [ZERO; HIDDEN], ZERO) };
        let (mut h1, mut h2, mut out) = ([ZERO; HIDDEN], [ZERO; HIDDEN], [ZERO; 1]);
        kernel::affine(&l1.w, &l1.b, x, &mut h1);
        tanh_all(&mut h1);
        kernel::affine(&l2.w, &l2.b, &h1, &mut h2);
        tanh_all(&mut h2);
        kernel::affine(&l3.w, &l3.b, &h2, &mut out);
        (h1, h2, out[0])
    }
}
