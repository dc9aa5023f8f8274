//! The latent heads in closed form: the exact minimisers of the JEPA prediction error over the last
//! linear layer, with Ψ0, Ψ1 pinned to (2I, -I). No labels: frames and actions only.
//!
//! z_c is what accelerates as the actions say; z_u is what moves at constant velocity between
//! bounces, with unit variance on its two axes. Least squares and an eigenvalue problem, in f64.

use nalgebra::{DMatrix, DVector, Vector2};

use crate::encoder::infer::Features;
use crate::encoder::weights::{FEATURES, LATENT, Layer};
use crate::world_model::config::ClosedForm;

/// Features of the three frames of each triple, oldest first, and what the actions contribute to the
/// double difference of the position, in latent units (S a_max times the response).
#[derive(Debug, Clone, Default)]
pub struct Triples {
    /// Features, one list for each of the three frames.
    pub features: [Vec<Features>; 3],
    /// What z_c's double difference must be.
    pub targets: Vec<Vector2<f64>>,
}

/// A head on its plane: y = W'x - offset.
#[derive(Debug, Clone, PartialEq)]
pub struct Readout {
    /// W, `[features, 2]`.
    pub w: DMatrix<f64>,
    /// W' mean(x).
    pub offset: Vector2<f64>,
}

/// Why the heads could not be fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// Too little data, or features without variance.
    #[error("the {0} is singular: take more frames")]
    Singular(&'static str),
}

/// z_c: least squares of the double differences of x on the known response, over both sets of triples.
/// Returns the head and its rms residual in latent units.
///
/// # Errors
/// If the Gram matrix is singular.
pub fn controllable(
    sets: [&Triples; 2],
    gated: bool,
    config: &ClosedForm,
) -> Result<(Readout, f64), FitError> {
    let x = if gated { Expansion::Gated } else { Expansion::Plain };
    let (mean, spread) = x.moments(sets);
    let width = x.width();
    let mut square = DMatrix::zeros(width, width);
    let mut cross = DMatrix::zeros(width, 2);
    let count = sets.iter().map(|s| s.targets.len()).sum::<usize>().max(1) as f64;
    let differences = sets.map(|set| x.differences(set));
    let targets = sets.map(|set| DMatrix::from_fn(set.targets.len(), 2, |n, axis| set.targets[n][axis]));
    for (d, y) in differences.iter().zip(&targets) {
        let transposed = d.transpose();
        square.gemm(1.0 / count, &transposed, d, 1.0);
        cross.gemm(1.0 / count, &transposed, y, 1.0);
    }
    for k in 0..width {
        square[(k, k)] += config.ridge_c * spread;
    }
    let w = square.cholesky().ok_or(FitError::Singular("Gram matrix of z_c"))?.solve(&cross);
    let residual: f64 = differences.iter().zip(&targets).map(|(d, y)| (d * &w - y).norm_squared()).sum();
    Ok((Readout::new(w, &mean), (residual / (2.0 * count)).sqrt()))
}

/// z_u: the two slowest directions of x, `rounds` times fitted on the share `keep` of the short
/// triples that the last fit explains best. Returns the head and the smallest eigenvalues.
///
/// # Errors
/// If the covariance is singular.
pub fn uncontrollable(
    short: &Triples,
    long: &Triples,
    config: &ClosedForm,
) -> Result<(Readout, [f64; 4]), FitError> {
    let x = Expansion::Plain;
    let (mean, spread) = x.moments([short, long]);
    let mut covariance = x.covariance([short, long], &mean);
    let width = x.width();
    for k in 0..width {
        covariance[(k, k)] += config.floor_u * spread;
    }
    let root = covariance.clone().cholesky().ok_or(FitError::Singular("covariance of z_u"))?.l();
    let d = x.differences(short);
    let mut kept: Vec<usize> = (0..d.nrows()).collect();
    let (mut w, mut eigenvalues) = (DMatrix::zeros(width, 2), [0.0; 4]);
    for _ in 0..config.rounds.max(1) {
        let rows = d.select_rows(&kept);
        let mut square = rows.transpose() * &rows / kept.len().max(1) as f64;
        for k in 0..width {
            square[(k, k)] += config.ridge_u * spread;
        }
        (w, eigenvalues) = slowest(square, &root)?;
        let residual: Vec<f64> = (&d * &w).row_iter().map(|r| r.norm_squared()).collect();
        let limit = crate::numeric::statistics::quantile(&residual, config.keep);
        kept = (0..residual.len()).filter(|&n| residual[n] <= limit).collect();
    }
    // The eigenvectors are free to turn and to flip in their plane. Features 0 and 1 fix both, so that
    // rounding cannot: y rises along its first axis with feature 0, along its second with feature 1.
    let loading = covariance.rows(0, 2) * &w;
    let (c, s) = (loading[(0, 0)], loading[(0, 1)]);
    let flip = if loading[(1, 1)] * c >= loading[(1, 0)] * s { 1.0 } else { -1.0 };
    let turn =
        DMatrix::from_row_slice(2, 2, &[c, -s * flip, s, c * flip]) / c.hypot(s).max(f64::MIN_POSITIVE);
    let w = w * turn;
    Ok((Readout::new(w, &mean), eigenvalues))
}

/// The smallest generalised eigenvectors of M w = λ L L' w, with w' L L' w = 1, by inverse iteration
/// on a block of four.
fn slowest(m: DMatrix<f64>, root: &DMatrix<f64>) -> Result<(DMatrix<f64>, [f64; 4]), FitError> {
    const BLOCK: usize = 4;
    const ITERATIONS: usize = 30;
    let width = m.nrows();
    let solver = m.clone().cholesky().ok_or(FitError::Singular("difference matrix of z_u"))?;
    // In the whitened coordinates v = L' w the inverse is L' M⁻¹ L.
    let mut v = DMatrix::from_fn(width, BLOCK, |k, b| if k % BLOCK == b { 1.0 } else { 0.1 });
    let mut values = [0.0; BLOCK];
    for _ in 0..ITERATIONS {
        let next = root.transpose() * solver.solve(&(root * &v));
        let q = next.qr().q();
        let small = q.transpose() * (root.transpose() * solver.solve(&(root * &q)));
        let eigen = (0.5 * (&small + small.transpose())).symmetric_eigen();
        let mut order: Vec<usize> = (0..BLOCK).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        v = q * eigen.eigenvectors.select_columns(&order);
        values = std::array::from_fn(|b| 1.0 / eigen.eigenvalues[order[b]]);
    }
    let two = v.columns(0, 2).into_owned();
    let w = root.transpose().solve_upper_triangular(&two).ok_or(FitError::Singular("covariance of z_u"))?;
    Ok((w, values))
}

impl Readout {
    fn new(w: DMatrix<f64>, mean: &DVector<f64>) -> Self {
        let offset = w.transpose() * mean;
        Self { w, offset: Vector2::new(offset[0], offset[1]) }
    }

    /// The 16-d head z = E (W'x - offset) as a layer of f32.
    #[must_use]
    pub fn head(&self, plane: &[[f32; 2]; LATENT]) -> Layer {
        let width = self.w.nrows();
        let mut layer = Layer::zeros(&[LATENT, width]);
        for (k, e) in plane.iter().enumerate() {
            let e = [f64::from(e[0]), f64::from(e[1])];
            for i in 0..width {
                layer.w[k * width + i] = (e[0] * self.w[(i, 0)] + e[1] * self.w[(i, 1)]) as f32;
            }
            layer.b[k] = -(e[0] * self.offset.x + e[1] * self.offset.y) as f32;
        }
        layer
    }
}

/// From h and q to what a head reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expansion {
    /// x = h
    Plain,
    /// x = `[h ; q h]`, q the missing share of the UAV's mass.
    Gated,
}

impl Expansion {
    fn width(self) -> usize {
        if self == Self::Gated { 2 * FEATURES } else { FEATURES }
    }

    /// One row per frame.
    fn rows(self, features: &[Features]) -> DMatrix<f64> {
        DMatrix::from_fn(features.len(), self.width(), |n, k| {
            let f = &features[n];
            if k < FEATURES { f64::from(f.h[k]) } else { f64::from(f.missing[0] * f.h[k - FEATURES]) }
        })
    }

    /// x_{k+2d} - 2 x_{k+d} + x_k, one row per triple.
    fn differences(self, set: &Triples) -> DMatrix<f64> {
        let [a, b, c] = [0, 1, 2].map(|n| self.rows(&set.features[n]));
        a - b * 2.0 + c
    }

    /// Mean of x, and the mean variance of the features h.
    fn moments(self, sets: [&Triples; 2]) -> (DVector<f64>, f64) {
        let (mut sum, mut squares, mut count) = (DVector::zeros(self.width()), 0.0, 0);
        for features in sets.iter().flat_map(|s| &s.features) {
            let x = self.rows(features);
            sum += x.row_sum_tr();
            squares += x.columns(0, FEATURES).norm_squared();
            count += x.nrows();
        }
        let count = count.max(1) as f64;
        let mean = sum / count;
        let spread = squares / count - mean.rows(0, FEATURES).norm_squared();
        (mean, spread / FEATURES as f64)
    }

    fn covariance(self, sets: [&Triples; 2], mean: &DVector<f64>) -> DMatrix<f64> {
        let mut covariance = DMatrix::zeros(self.width(), self.width());
        let mut count = 0;
        for features in sets.iter().flat_map(|s| &s.features) {
            let mut x = self.rows(features);
            for (mut column, mean) in x.column_iter_mut().zip(mean.iter()) {
                column.add_scalar_mut(-mean);
            }
            covariance.gemm(1.0, &x.transpose(), &x, 1.0);
            count += x.nrows();
        }
        covariance / count.max(1) as f64
    }
}
