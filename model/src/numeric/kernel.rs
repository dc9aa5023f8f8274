//! The few inner loops that take the time, written so that they vectorise and give the same bits
//! on every machine: fixed order of summation, explicit fused multiply-adds, no platform libm.
//!
//! Rollouts run [`LANES`] at a time: a [`Lane`] holds one quantity of that many rollouts.

use pulp::{Arch, Simd, WithSimd};

/// Rollouts that move together through one call.
pub const LANES: usize = 32;

/// One quantity of [`LANES`] rollouts.
pub type Lane = [f32; LANES];

/// A lane of zeros.
pub const ZERO: Lane = [0.0; LANES];

/// tanh as a rational function (odd polynomial of degree 13 over even one of degree 6, on ±7.9),
/// within 4e-7 of the true value. The library's tanh differs between platforms; this does not.
#[inline(always)]
#[must_use]
pub fn tanh(x: f32) -> f32 {
    const ALPHA: [f32; 7] = [
        4.893_524_6e-3,
        6.372_619_3e-4,
        1.485_722_4e-5,
        5.122_297_1e-8,
        -8.604_672e-11,
        2.000_188e-13,
        -2.760_768_5e-16,
    ];
    const BETA: [f32; 4] = [4.893_525e-3, 2.268_434_6e-3, 1.185_347e-4, 1.198_258_4e-6];
    let x = x.clamp(-7.905_311, 7.905_311);
    let x2 = x * x;
    let p = x2.mul_add(ALPHA[6], ALPHA[5]);
    let p = x2.mul_add(p, ALPHA[4]);
    let p = x2.mul_add(p, ALPHA[3]);
    let p = x2.mul_add(p, ALPHA[2]);
    let p = x2.mul_add(p, ALPHA[1]);
    let p = x2.mul_add(p, ALPHA[0]);
    let q = x2.mul_add(BETA[3], BETA[2]);
    let q = x2.mul_add(q, BETA[1]);
    let q = x2.mul_add(q, BETA[0]);
    x * p / q
}

/// e^x for x in about ±87 (clamped there), within 2e-7 relative; no platform libm.
#[inline(always)]
#[must_use]
pub fn exp(x: f32) -> f32 {
    const LOG2_E: f32 = std::f32::consts::LOG2_E;
    // ln 2 in two parts, so that x - n ln 2 is exact to the last bits.
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    let x = x.clamp(-87.0, 87.0);
    let n = (x * LOG2_E).round_ties_even();
    let r = n.mul_add(-LN2_LOW, n.mul_add(-LN2_HIGH, x));
    let p = r.mul_add(1.987_569_1e-4, 1.398_2e-3);
    let p = r.mul_add(p, 8.333_452e-3);
    let p = r.mul_add(p, 4.166_579_6e-2);
    let p = r.mul_add(p, 1.666_666_5e-1);
    let p = r.mul_add(p, 0.5);
    let e = (r * r).mul_add(p, r) + 1.0;
    // 2^n by its exponent bits; n lies in ±126 after the clamp.
    e * f32::from_bits(((n as i32 + 127) as u32) << 23)
}

/// ln x of a positive normal x, within 1e-7 of |ln x| or 1e-7; no platform libm.
#[inline(always)]
#[must_use]
pub fn ln(x: f32) -> f32 {
    // x = 2^n m with m in [√½, √2): ln m = 2 artanh((m - 1)/(m + 1)).
    const SQRT_HALF: u32 = 0x3f35_04f3;
    let n = (x.to_bits().wrapping_sub(SQRT_HALF) as i32) >> 23;
    let m = f32::from_bits(x.to_bits().wrapping_sub((n << 23) as u32));
    let s = (m - 1.0) / (m + 1.0);
    let s2 = s * s;
    let p = s2.mul_add(2.0 / 9.0, 2.0 / 7.0);
    let p = s2.mul_add(p, 2.0 / 5.0);
    let p = s2.mul_add(p, 2.0 / 3.0);
    (s * s2).mul_add(p, 2.0 * s) + n as f32 * std::f32::consts::LN_2
}

/// 1 / (1 + e^-x).
#[inline(always)]
#[must_use]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// y = x W + b for all lanes: `w` row-major `[inputs][outputs]`, `x` `[inputs]`, `y` `[outputs]`.
pub fn affine(w: &[f32], b: &[f32], x: &[Lane], y: &mut [Lane]) {
    Arch::new().dispatch(AffineKernel { w, b, x, y });
}

struct AffineKernel<'a> {
    w: &'a [f32],
    b: &'a [f32],
    x: &'a [Lane],
    y: &'a mut [Lane],
}

impl WithSimd for AffineKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { w, b, x, y } = self;
        let whole = y.len() / 8 * 8;
        for j in (0..whole).step_by(8) {
            affine_tile::<S, 8>(simd, w, b, x, y, j);
        }
        for j in whole..y.len() {
            affine_tile::<S, 1>(simd, w, b, x, y, j);
        }
    }
}

/// Outputs j..j+N of [`affine`], their sums kept in registers.
#[inline(always)]
fn affine_tile<S: Simd, const N: usize>(simd: S, w: &[f32], b: &[f32], x: &[Lane], y: &mut [Lane], j: usize) {
    let outputs = y.len();
    for v in 0..LANES / S::F32_LANES {
        let mut acc = [simd.splat_f32s(0.0); N];
        for (a, bias) in acc.iter_mut().zip(&b[j..j + N]) {
            *a = simd.splat_f32s(*bias);
        }
        for (xi, row) in x.iter().zip(w.chunks_exact(outputs)) {
            let xi = S::as_simd_f32s(xi).0[v];
            for (a, weight) in acc.iter_mut().zip(&row[j..j + N]) {
                *a = simd.mul_add_f32s(simd.splat_f32s(*weight), xi, *a);
            }
        }
        for (lane, a) in y[j..j + N].iter_mut().zip(acc) {
            S::as_mut_simd_f32s(lane).0[v] = a;
        }
    }
}

/// dW += Σ_k Σ_lanes x_k ⊗ dy_k, over consecutive blocks of `inputs` resp. `outputs` lanes.
pub fn outer(x: &[Lane], inputs: usize, dy: &[Lane], outputs: usize, dw: &mut [f32]) {
    let (x, dy) = (panels(x, inputs), panels(dy, outputs));
    for (i, x) in (0..inputs).step_by(SQUARE).zip(&x) {
        for (j, dy) in (0..outputs).step_by(SQUARE).zip(&dy) {
            let sums = square(x, dy);
            for (u, cells) in sums.iter().enumerate().take(inputs - i) {
                for (v, cell) in cells.iter().enumerate().take(outputs - j) {
                    dw[(i + u) * outputs + j + v] += cell.iter().sum::<f32>();
                }
            }
        }
    }
}

/// Sides of the squares in which [`outer`] sums.
const SQUARE: usize = 4;

/// Partial sums of a lane: fixed, so that every vector width adds in the same order.
const PARTIAL: usize = 16;

/// Partial sums of a square's cells.
type Square = [[[f32; PARTIAL]; SQUARE]; SQUARE];

/// Blocks of `width` lanes as panels of [`SQUARE`] neighbours, each panel's blocks one behind the other: a square
/// then reads memory in order. Past the end a panel repeats the last lane; what is summed there is not kept.
fn panels(blocks: &[Lane], width: usize) -> Vec<Vec<[Lane; SQUARE]>> {
    let panel = |first: usize| {
        let lanes = |block: &[Lane]| std::array::from_fn(|t| block[(first + t).min(width - 1)]);
        blocks.chunks_exact(width).map(lanes).collect()
    };
    (0..width).step_by(SQUARE).map(panel).collect()
}

/// The partial sums of one square, over all blocks of two panels.
fn square(x: &[[Lane; SQUARE]], dy: &[[Lane; SQUARE]]) -> Square {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512f") {
        return square_in_wide_registers(x, dy);
    }
    Arch::new().dispatch(SquareKernel { x, dy })
}

/// [`square`] for registers of [`PARTIAL`] floats, of which there are twice as many: all sums stay in them.
#[multiversion::multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq"))]
fn square_in_wide_registers(x: &[[Lane; SQUARE]], dy: &[[Lane; SQUARE]]) -> Square {
    let mut sums = [[[0.0f32; PARTIAL]; SQUARE]; SQUARE];
    for (x, dy) in x.iter().zip(dy) {
        for half in 0..LANES / PARTIAL {
            for (cells, x) in sums.iter_mut().zip(x) {
                for (cell, dy) in cells.iter_mut().zip(dy) {
                    let (x, dy) = (&x[half * PARTIAL..][..PARTIAL], &dy[half * PARTIAL..][..PARTIAL]);
                    for ((sum, x), dy) in cell.iter_mut().zip(x).zip(dy) {
                        *sum = x.mul_add(*dy, *sum);
                    }
                }
            }
        }
    }
    sums
}

struct SquareKernel<'a> {
    x: &'a [[Lane; SQUARE]],
    dy: &'a [[Lane; SQUARE]],
}

impl WithSimd for SquareKernel<'_> {
    type Output = Square;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Square {
        let mut sums = [[[0.0f32; PARTIAL]; SQUARE]; SQUARE];
        for v in 0..PARTIAL / S::F32_LANES.min(PARTIAL) {
            let mut acc = [[simd.splat_f32s(0.0); SQUARE]; SQUARE];
            for (x, dy) in self.x.iter().zip(self.dy) {
                for half in 0..LANES / PARTIAL {
                    let at = half * (PARTIAL / S::F32_LANES) + v;
                    for (cells, x) in acc.iter_mut().zip(x) {
                        let xv = S::as_simd_f32s(x).0[at];
                        for (cell, dy) in cells.iter_mut().zip(dy) {
                            *cell = simd.mul_add_f32s(xv, S::as_simd_f32s(dy).0[at], *cell);
                        }
                    }
                }
            }
            for (sums, cells) in sums.iter_mut().zip(acc) {
                for (sum, cell) in sums.iter_mut().zip(cells) {
                    S::as_mut_simd_f32s(sum).0[v] = cell;
                }
            }
        }
        sums
    }
}

/// Sum of every lane, added to `db` `[outputs]`, over all blocks of `dy`.
#[inline(always)]
pub fn sum_lanes(dy: &[Lane], db: &mut [f32]) {
    for block in dy.chunks_exact(db.len()) {
        for (b, lane) in db.iter_mut().zip(block) {
            *b += lane.iter().sum::<f32>();
        }
    }
}

/// W transposed: `w` `[rows][columns]` row-major to `[columns][rows]`.
#[must_use]
pub fn transpose(w: &[f32], columns: usize) -> Vec<f32> {
    let rows = w.len() / columns;
    (0..columns * rows).map(|n| w[(n % rows) * columns + n / rows]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tanh_is_tanh() {
        for k in -2000..=2000 {
            let x = k as f32 * 0.006;
            let error = (f64::from(tanh(x)) - f64::from(x).tanh()).abs();
            assert!(error < 4e-7, "tanh({x}) is off by {error}");
        }
    }

    #[test]
    fn exp_is_exp() {
        for k in -8000..=8000 {
            let x = k as f32 * 0.01;
            let error = (f64::from(exp(x)) / f64::from(x).exp() - 1.0).abs();
            assert!(error < 2e-7, "exp({x}) is off by {error}");
        }
    }

    #[test]
    fn ln_is_ln() {
        for k in -6000..=6000 {
            let x = (k as f32 * 0.01).exp();
            let truth = f64::from(x).ln();
            let error = (f64::from(ln(x)) - truth).abs();
            assert!(error < 2e-7 * (1.0 + truth.abs()), "ln({x}) is off by {error}");
        }
        assert_eq!(ln(1.0), 0.0);
    }

    #[test]
    fn affine_and_outer_agree_with_plain_loops() {
        let (inputs, outputs, steps) = (6, 5, 3);
        let value = |n: usize| ((n * 37 + 11) % 23) as f32 / 23.0 - 0.5;
        let w: Vec<f32> = (0..inputs * outputs).map(value).collect();
        let b: Vec<f32> = (0..outputs).map(value).collect();
        let lanes = |n: usize| -> Vec<Lane> {
            (0..n).map(|i| std::array::from_fn(|l| value(i * LANES + l))).collect()
        };
        let (x, dy) = (lanes(inputs * steps), lanes(outputs * steps));
        let mut y = vec![ZERO; outputs];
        affine(&w, &b, &x[..inputs], &mut y);
        let mut dw = vec![0.0; w.len()];
        outer(&x, inputs, &dy, outputs, &mut dw);
        for j in 0..outputs {
            for (l, got) in y[j].iter().enumerate() {
                let want = b[j] + (0..inputs).map(|i| w[i * outputs + j] * x[i][l]).sum::<f32>();
                assert!((got - want).abs() < 1e-6);
            }
            for i in 0..inputs {
                let want: f32 = (0..steps)
                    .flat_map(|k| (0..LANES).map(move |l| (k, l)))
                    .map(|(k, l)| x[k * inputs + i][l] * dy[k * outputs + j][l])
                    .sum();
                assert!((dw[i * outputs + j] - want).abs() < 1e-4);
            }
        }
        assert_eq!(transpose(&transpose(&w, outputs), inputs), w);
    }

    #[test]
    fn every_vector_width_gives_the_same_sums_to_the_last_bit() {
        let value = |n: usize| ((n * 7919 + 104_729) % 1009) as f32 / 1009.0 - 0.5;
        let panel = |seed: usize| -> Vec<[Lane; SQUARE]> {
            let lane =
                |k: usize, t: usize| -> Lane { std::array::from_fn(|l| value(seed + k * 131 + t * 37 + l)) };
            (0..50).map(|k| std::array::from_fn(|t| lane(k, t))).collect()
        };
        let (x, dy) = (panel(3), panel(11));
        let narrow = Arch::new().dispatch(SquareKernel { x: &x, dy: &dy });
        assert_eq!(square_in_wide_registers(&x, &dy), narrow);
        assert_eq!(square(&x, &dy), narrow);
    }
}
