//! Affine maps from a latent half's plane to positions: the only place where labels meet the
//! encoder, and only to read it (metrics, plots, the image of the walls); it never trains on them.

use nalgebra::{DMatrix, Matrix2, Vector2};

use crate::numeric::tensors::{Reader, Stored, TensorError, Writer};

/// r = M y + b, paper units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine {
    /// M
    pub matrix: Matrix2<f64>,
    /// b
    pub offset: Vector2<f64>,
}

impl Affine {
    /// M y + b.
    #[must_use]
    pub fn apply(&self, y: Vector2<f64>) -> Vector2<f64> {
        self.matrix * y + self.offset
    }

    /// y = M⁻¹ (r - b), or `None` if M is singular.
    #[must_use]
    pub fn invert(&self, r: Vector2<f64>) -> Option<Vector2<f64>> {
        Some(self.matrix.try_inverse()? * (r - self.offset))
    }
}

/// One map for each half.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Probe {
    /// y_c to r_c.
    pub c: Affine,
    /// y_u to r_u.
    pub u: Affine,
}

impl Stored for Probe {
    fn put(&self, out: &mut Writer) {
        for (name, map) in [("probe.c", &self.c), ("probe.u", &self.u)] {
            out.matrix(&format!("{name}.matrix"), &map.matrix);
            out.f64(&format!("{name}.offset"), &[2], map.offset.iter().copied());
        }
    }

    fn get(from: &Reader<'_>) -> Result<Self, TensorError> {
        let map = |name: &str| -> Result<Affine, TensorError> {
            let matrix: Matrix2<f64> = from.matrix(&format!("{name}.matrix"))?;
            let offset = from.f64(&format!("{name}.offset"), &[2])?;
            Ok(Affine { matrix, offset: Vector2::new(offset[0], offset[1]) })
        };
        Ok(Self { c: map("probe.c")?, u: map("probe.u")? })
    }
}

/// Least squares of `r` on (y, 1), ridge `1e-8` relative; zero map where there is nothing to learn.
#[must_use]
pub fn fit(y: &[Vector2<f64>], r: &[Vector2<f64>]) -> Affine {
    let n = y.len().max(1) as f64;
    let mean = |x: &[Vector2<f64>]| x.iter().sum::<Vector2<f64>>() / n;
    let (my, mr) = (mean(y), mean(r));
    let (mut square, mut cross) = (Matrix2::zeros(), Matrix2::zeros());
    for (y, r) in y.iter().zip(r) {
        square += (y - my) * (y - my).transpose();
        cross += (r - mr) * (y - my).transpose();
    }
    square += Matrix2::identity() * (1e-8 * square.trace() / 2.0);
    let matrix = square.try_inverse().map_or(Matrix2::zeros(), |inverse| cross * inverse);
    Affine { matrix, offset: mr - matrix * my }
}

/// Share of the variance of `r` that a linear map of all latent dimensions `z` explains on the second
/// half of the samples when fitted on the first; 0 or below when it explains nothing.
#[must_use]
pub fn r_squared<const N: usize>(z: &[[f32; N]], r: &[Vector2<f64>]) -> f64 {
    let half = z.len() / 2;
    if half < 2 {
        return 0.0;
    }
    let mean_z: Vec<f64> =
        (0..N).map(|k| z[..half].iter().map(|z| f64::from(z[k])).sum::<f64>() / half as f64).collect();
    let mean_r = r[..half].iter().sum::<Vector2<f64>>() / half as f64;
    let centred = |z: &[f32; N]| nalgebra::DVector::from_fn(N, |k, _| f64::from(z[k]) - mean_z[k]);
    let (mut square, mut cross) = (DMatrix::zeros(N, N), DMatrix::zeros(N, 2));
    for (z, r) in z[..half].iter().zip(&r[..half]) {
        let z = centred(z);
        square.ger(1.0, &z, &z, 1.0);
        cross.ger(1.0, &z, &(r - mean_r), 1.0);
    }
    let ridge = (1e-8 * square.trace() / N as f64).max(1e-12);
    for k in 0..N {
        square[(k, k)] += ridge;
    }
    let Some(solver) = square.cholesky() else { return 0.0 };
    let w = solver.solve(&cross).transpose();
    let test_mean = r[half..].iter().sum::<Vector2<f64>>() / (r.len() - half) as f64;
    let (mut residual, mut total) = (0.0, 0.0);
    for (z, r) in z[half..].iter().zip(&r[half..]) {
        residual += (r - mean_r - &w * centred(z)).norm_squared();
        total += (r - test_mean).norm_squared();
    }
    1.0 - residual / total
}

/// Covariance of latents, `[samples][N]` to `[N, N]`.
#[must_use]
pub fn covariance<const N: usize>(z: &[[f32; N]]) -> DMatrix<f64> {
    let n = z.len().max(1) as f64;
    let wide = |z: &[f32; N]| nalgebra::DVector::from_fn(N, |k, _| f64::from(z[k]));
    let mean = z.iter().fold(nalgebra::DVector::zeros(N), |m, z| m + wide(z)) / n;
    let mut covariance = DMatrix::<f64>::zeros(N, N);
    for z in z {
        let off = wide(z) - &mean;
        covariance.ger(1.0 / n, &off, &off, 1.0);
    }
    covariance
}

/// How many dimensions are in use: exp of the entropy of a covariance's normalised eigenvalues; 0 of nothing.
#[must_use]
pub fn effective_rank(covariance: &DMatrix<f64>) -> f64 {
    let values = covariance.symmetric_eigenvalues();
    let total: f64 = values.iter().map(|v| v.max(0.0)).sum();
    if !(total.is_finite() && total > 0.0) {
        return 0.0;
    }
    let shares = values.iter().map(|v| v.max(0.0) / total).filter(|p| *p > 0.0);
    (-shares.map(|p| p * p.ln()).sum::<f64>()).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_affine_map_is_found_and_inverted() {
        let truth = Affine { matrix: Matrix2::new(0.1, 0.02, -0.03, 0.2), offset: Vector2::new(0.5, 0.4) };
        let y: Vec<_> = (0..50).map(|k| Vector2::new((k as f64).sin(), (k as f64 * 0.7).cos())).collect();
        let r: Vec<_> = y.iter().map(|y| truth.apply(*y)).collect();
        let found = fit(&y, &r);
        assert!((found.matrix - truth.matrix).norm() < 1e-6 && (found.offset - truth.offset).norm() < 1e-6);
        assert!((found.invert(r[7]).unwrap() - y[7]).norm() < 1e-5);
    }

    #[test]
    fn the_effective_rank_counts_dimensions() {
        let z = |used: usize| -> Vec<[f32; 6]> {
            let value = |n: usize, k: usize| ((n * (2 * k + 3)) as f32 * 0.7).sin();
            (0..3000).map(|n| std::array::from_fn(|k| if k < used { value(n, k) } else { 1.0 })).collect()
        };
        for used in [1, 2, 6] {
            let rank = effective_rank(&covariance(&z(used)));
            assert!((rank - used as f64).abs() < 0.05, "{rank} of {used}");
        }
        assert_eq!(effective_rank(&covariance(&z(0))), 0.0);
    }

    #[test]
    fn noise_explains_nothing_and_the_truth_all() {
        let r: Vec<_> = (0..400).map(|k| Vector2::new((k as f64).sin(), (k as f64 * 1.3).cos())).collect();
        let told: Vec<[f32; 2]> = r.iter().map(|r| [r.x as f32 * 3.0, r.y as f32 - 1.0]).collect();
        let noise: Vec<[f32; 2]> =
            (0..400).map(|k| [(k as f32 * 7.7).sin(), (k as f32 * 9.1).cos()]).collect();
        assert!(r_squared(&told, &r) > 0.999);
        assert!(r_squared(&noise, &r) < 0.05);
    }
}
