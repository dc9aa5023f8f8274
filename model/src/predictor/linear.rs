//! The linear second-order predictors of both latent halves (Eq. (31), Sec. IV-A2), learned in f64.
//!
//! ẑ_c' = Ψ_c0 z_c,k + Ψ_c1 z_c,k-1 + Ψ_ca a_k and ẑ_u' = Ψ_u0 z_u,k + Ψ_u1 z_u,k-1. Over 100 steps
//! Ψ0 + Ψ1 - I must be right to about 1e-6, so the fit is pinned to (2I, -I) by a ridge. Knows
//! latents and actions; neither frames nor positions.

use nalgebra::{DMatrix, Matrix2, SMatrix, Vector2};

use crate::encoder::weights::LATENT;
use crate::numeric::kernel::{Lane, ZERO};
use crate::numeric::tensors::{Reader, Stored, TensorError, Writer};

/// Ψ0 or Ψ1, 16x16.
pub type Psi = SMatrix<f64, LATENT, LATENT>;

/// Ψ_a, 16x2.
pub type PsiAction = SMatrix<f64, LATENT, 2>;

/// E of either half, 16x2, orthonormal columns.
pub type Plane = SMatrix<f64, LATENT, 2>;

/// A latent half.
pub type Half = SMatrix<f64, LATENT, 1>;

/// Three latents of one half at equal distance, oldest first, and the action that bends them.
pub type Window = ([Half; 3], Vector2<f64>);

/// The predictors of the 16-d halves.
#[derive(Debug, Clone, PartialEq)]
pub struct Linear {
    /// Ψ_c0
    pub c0: Psi,
    /// Ψ_c1
    pub c1: Psi,
    /// Ψ_ca: latent units per interval² at full acceleration.
    pub ca: PsiAction,
    /// Ψ_u0
    pub u0: Psi,
    /// Ψ_u1
    pub u1: Psi,
}

/// One quantity of both axes of [`LANES`](crate::numeric::kernel::LANES) rollouts.
pub type Pair = [Lane; 2];

/// One half's predictor in the plane coordinates y = E' z: y_{k+1} = Ψ_0 y_k + Ψ_1 y_{k-1} + Ψ_a a_k.
/// Nothing is lost: a latent half is of rank 2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneLinear {
    /// Ψ_0
    pub newer: Matrix2<f64>,
    /// Ψ_1
    pub older: Matrix2<f64>,
    /// Ψ_a, latent units per interval² at full acceleration, close to S a_max I; zero for the half on which
    /// no action works.
    pub action: Matrix2<f64>,
}

/// The step y_{k+1} - y_k, and its slopes in y_k and in v = y_k - y_{k-1}.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Displacement {
    /// y_{k+1} - y_k
    pub step: Vector2<f64>,
    /// Its slope in y_k at equal v.
    pub by_y: Matrix2<f64>,
    /// Its slope in v.
    pub by_v: Matrix2<f64>,
}

impl Linear {
    /// Constant velocity, and actions that do nothing: where the fit is pinned.
    #[must_use]
    pub fn pinned() -> Self {
        let (two, one) = (Psi::identity() * 2.0, Psi::identity());
        Self { c0: two, c1: -one, ca: PsiAction::zeros(), u0: two, u1: -one }
    }

    /// One step of the controllable half: newest, the one before, normalised acceleration.
    #[must_use]
    pub fn step_c(&self, now: &Half, before: &Half, a: Vector2<f64>) -> Half {
        self.c0 * now + self.c1 * before + self.ca * a
    }

    /// One step of the uncontrollable half.
    #[must_use]
    pub fn step_u(&self, now: &Half, before: &Half) -> Half {
        self.u0 * now + self.u1 * before
    }

    /// The controllable half in the coordinates of `plane`.
    #[must_use]
    pub fn controllable(&self, plane: &Plane) -> PlaneLinear {
        let square = |psi: &Psi| plane.transpose() * psi * plane;
        PlaneLinear { newer: square(&self.c0), older: square(&self.c1), action: plane.transpose() * self.ca }
    }

    /// The uncontrollable half in the coordinates of `plane`.
    #[must_use]
    pub fn uncontrollable(&self, plane: &Plane) -> PlaneLinear {
        let square = |psi: &Psi| plane.transpose() * psi * plane;
        PlaneLinear { newer: square(&self.u0), older: square(&self.u1), action: Matrix2::zeros() }
    }
}

impl Stored for Linear {
    fn put(&self, out: &mut Writer) {
        out.matrix("predictor.c0", &self.c0);
        out.matrix("predictor.c1", &self.c1);
        out.matrix("predictor.ca", &self.ca);
        out.matrix("predictor.u0", &self.u0);
        out.matrix("predictor.u1", &self.u1);
    }

    fn get(from: &Reader<'_>) -> Result<Self, TensorError> {
        Ok(Self {
            c0: from.matrix("predictor.c0")?,
            c1: from.matrix("predictor.c1")?,
            ca: from.matrix("predictor.ca")?,
            u0: from.matrix("predictor.u0")?,
            u1: from.matrix("predictor.u1")?,
        })
    }
}

impl PlaneLinear {
    /// From Ψ_0, Ψ_1 and Ψ_a, row by row.
    #[must_use]
    pub fn from_rows([newer, older, action]: [[[f32; 2]; 2]; 3]) -> Self {
        let matrix = |m: [[f32; 2]; 2]| Matrix2::from_fn(|row, column| f64::from(m[row][column]));
        Self { newer: matrix(newer), older: matrix(older), action: matrix(action) }
    }

    /// y_{k+1} from y_k, y_{k-1} and a_k.
    #[must_use]
    pub fn step(&self, now: Vector2<f64>, before: Vector2<f64>, a: Vector2<f64>) -> Vector2<f64> {
        self.newer * now + self.older * before + self.action * a
    }

    /// y_{k+1} without an action.
    #[must_use]
    pub fn coast(&self, now: Vector2<f64>, before: Vector2<f64>) -> Vector2<f64> {
        self.newer * now + self.older * before
    }

    /// The step from y_k, and its slopes.
    #[must_use]
    pub fn displacement(&self, y: Vector2<f64>, v: Vector2<f64>, a: Vector2<f64>) -> Displacement {
        let by_y = self.newer + self.older - Matrix2::identity();
        let by_v = -self.older;
        Displacement { step: by_y * y + by_v * v + self.action * a, by_y, by_v }
    }

    /// y_{k+1} of many rollouts.
    #[inline(always)]
    #[must_use]
    pub fn forward(&self, now: &Pair, before: &Pair, a: &Pair) -> Pair {
        let mut next = [ZERO; 2];
        apply(&rows(&self.newer), now, &mut next);
        apply(&rows(&self.older), before, &mut next);
        apply(&rows(&self.action), a, &mut next);
        next
    }

    /// y_{k+1} of many rollouts without an action.
    #[inline(always)]
    #[must_use]
    pub fn forward_coasting(&self, now: &Pair, before: &Pair) -> Pair {
        let mut next = [ZERO; 2];
        apply(&rows(&self.newer), now, &mut next);
        apply(&rows(&self.older), before, &mut next);
        next
    }

    /// Adds the slopes in y_k, y_{k-1} and a_k, from those in y_{k+1}.
    #[inline(always)]
    pub fn backward(&self, d_next: &Pair, [d_now, d_before, d_a]: [&mut Pair; 3]) {
        apply(&rows(&self.newer.transpose()), d_next, d_now);
        apply(&rows(&self.older.transpose()), d_next, d_before);
        apply(&rows(&self.action.transpose()), d_next, d_a);
    }
}

#[inline(always)]
fn rows(m: &Matrix2<f64>) -> [[f32; 2]; 2] {
    [[m[(0, 0)] as f32, m[(0, 1)] as f32], [m[(1, 0)] as f32, m[(1, 1)] as f32]]
}

/// Adds m v to `out`.
#[inline(always)]
fn apply(m: &[[f32; 2]; 2], v: &Pair, out: &mut Pair) {
    for (row, o) in m.iter().zip(out) {
        for ((o, a), b) in o.iter_mut().zip(&v[0]).zip(&v[1]) {
            *o = row[0].mul_add(*a, row[1].mul_add(*b, *o));
        }
    }
}

/// Ψ_a by least squares with Ψ0, Ψ1 at (2I, -I): z_{k+d} - 2 z_k + z_{k-d} = Ψ_a u, with u = a_k for
/// d = 1, else the sum of the actions between, each weighted by d less its distance to k.
#[must_use]
pub fn fit_action(windows: &[Window]) -> PsiAction {
    let mut square = Matrix2::zeros();
    let mut cross = PsiAction::zeros();
    for (z, a) in windows {
        square += a * a.transpose();
        cross += (z[2] - z[1] * 2.0 + z[0]) * a.transpose();
    }
    square.try_inverse().map_or(PsiAction::zeros(), |inverse| cross * inverse)
}

/// Ψ0, Ψ1 and Ψ_a together by one-step least squares, Ψ0 and Ψ1 pinned to (2I, -I) by a ridge of
/// `ridge` times the largest diagonal entry of the latents' Gram matrix. `None` if it is singular.
#[must_use]
pub fn fit_pinned(windows: &[Window], ridge: f64) -> Option<(Psi, Psi, PsiAction)> {
    fit(windows, ridge, 0.0)
}

fn fit(windows: &[Window], ridge: f64, action_ridge: f64) -> Option<(Psi, Psi, PsiAction)> {
    const N: usize = 2 * LATENT;
    let mean = windows.iter().fold(Half::zeros(), |m, (z, _)| m + z[1]) / windows.len().max(1) as f64;
    let mut square = DMatrix::<f64>::zeros(N + 2, N + 2);
    let mut cross = DMatrix::<f64>::zeros(N + 2, LATENT);
    let mut row = nalgebra::DVector::<f64>::zeros(N + 2);
    for (z, a) in windows {
        row.rows_mut(0, LATENT).copy_from(&(z[1] - mean));
        row.rows_mut(LATENT, LATENT).copy_from(&(z[0] - mean));
        row.rows_mut(N, 2).copy_from(a);
        square.ger(1.0, &row, &row, 1.0);
        cross.ger(1.0, &row, &(z[2] - z[1] * 2.0 + z[0]), 1.0);
    }
    let largest = (0..N).map(|k| square[(k, k)]).fold(0.0, f64::max);
    for k in 0..N {
        square[(k, k)] += ridge * largest;
    }
    for k in N..N + 2 {
        square[(k, k)] += action_ridge;
    }
    let solution = square.cholesky()?.solve(&cross).transpose(); // [16, 34]
    let d0: Psi = solution.fixed_view::<LATENT, LATENT>(0, 0).into_owned();
    let d1: Psi = solution.fixed_view::<LATENT, LATENT>(0, LATENT).into_owned();
    let a: PsiAction = solution.fixed_view::<LATENT, 2>(0, N).into_owned();
    let pin = Linear::pinned();
    Some((pin.c0 + d0, pin.c1 + d1, a))
}

/// Ψ0 and Ψ1 of a half on which no action works.
#[must_use]
pub fn fit_free(windows: &[Window], ridge: f64) -> Option<(Psi, Psi)> {
    // Without actions their Gram entries are zero; a ridge keeps the system regular.
    let (c0, c1, _) = fit(windows, ridge, 1.0)?;
    Some((c0, c1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Latents of a point that accelerates as it is told, on a tilted plane.
    fn windows() -> (Vec<Window>, Plane) {
        let mut plane = Plane::zeros();
        plane[(3, 0)] = 0.6;
        plane[(5, 0)] = 0.8;
        plane[(7, 1)] = 1.0;
        let (mut r, mut v) = (Vector2::new(1.0, 2.0), Vector2::zeros());
        let mut out = Vec::new();
        let mut z = [plane * r; 3];
        for k in 0..200 {
            let a = Vector2::new((k as f64 * 1.7).sin(), (k as f64 * 2.3).cos());
            v += 0.035 * a;
            r += v;
            z = [z[1], z[2], plane * r];
            out.push((z, a));
        }
        (out, plane)
    }

    #[test]
    fn both_fits_find_the_action_matrix() {
        let (windows, plane) = windows();
        let known = plane * 0.035;
        assert!((fit_action(&windows) - known).norm() < 1e-9);
        let (c0, c1, ca) = fit_pinned(&windows, 1e3).unwrap();
        assert!((c0 + c1 - Psi::identity()).norm() < 1e-6);
        assert!((ca - known).norm() < 1e-6);
    }

    #[test]
    fn the_plane_steps_as_the_sixteen_dimensions_do() {
        let (_, plane) = windows();
        let linear = Linear { ca: plane * 0.035, ..Linear::pinned() };
        let small = linear.controllable(&plane);
        let (now, before, a) = (Vector2::new(1.0, -2.0), Vector2::new(0.9, -2.1), Vector2::new(0.3, 1.0));
        let full = linear.step_c(&(plane * now), &(plane * before), a);
        let step = small.step(now, before, a);
        assert!((plane.transpose() * full - step).norm() < 1e-12);
        let moved = small.displacement(now, now - before, a);
        assert!((now + moved.step - step).norm() < 1e-12);
    }
}
