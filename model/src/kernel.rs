//! The few inner loops that take the time, written so that they vectorise and give the same bits
//! on every machine: fixed order of summation, explicit fused multiply-adds, no platform libm.
//!
//! Rollouts run [`LANES`] at a time: a [`Lane`] holds one quantity of that many rollouts.

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

/// 1 / (1 + e^-x).
#[inline(always)]
#[must_use]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// y = x W + b for all lanes: `w` row-major [inputs][outputs], `x` [inputs], `y` [outputs].
#[inline(always)]
pub fn affine(w: &[f32], b: &[f32], x: &[Lane], y: &mut [Lane]) {
    const TILE: usize = 4;
    let outputs = y.len();
    let mut j = 0;
    while j + TILE <= outputs {
        let mut acc = [ZERO; TILE];
        for (t, lane) in acc.iter_mut().enumerate() {
            *lane = [b[j + t]; LANES];
        }
        for (xi, row) in x.iter().zip(w.chunks_exact(outputs)) {
            let row = &row[j..j + TILE];
            for (lane, &weight) in acc.iter_mut().zip(row) {
                for (a, v) in lane.iter_mut().zip(xi) {
                    *a = weight.mul_add(*v, *a);
                }
            }
        }
        y[j..j + TILE].copy_from_slice(&acc);
        j += TILE;
    }
    while j < outputs {
        let mut acc = [b[j]; LANES];
        for (xi, row) in x.iter().zip(w.chunks_exact(outputs)) {
            let weight = row[j];
            for (a, v) in acc.iter_mut().zip(xi) {
                *a = weight.mul_add(*v, *a);
            }
        }
        y[j] = acc;
        j += 1;
    }
}

/// dW += Σ_k Σ_lanes x_k ⊗ dy_k, for `steps` consecutive blocks of `inputs` resp. `outputs` lanes.
#[inline(always)]
pub fn outer(x: &[Lane], inputs: usize, dy: &[Lane], outputs: usize, dw: &mut [f32]) {
    const TILE: usize = 4;
    const HALF: usize = 16;
    let mut i = 0;
    while i < inputs {
        let ti = TILE.min(inputs - i);
        let mut j = 0;
        while j < outputs {
            let tj = TILE.min(outputs - j);
            let mut acc = [[[0.0f32; HALF]; TILE]; TILE];
            if ti == TILE && tj == TILE {
                for (xk, dk) in x.chunks_exact(inputs).zip(dy.chunks_exact(outputs)) {
                    let (xs, ds) = (&xk[i..i + TILE], &dk[j..j + TILE]);
                    for h in 0..LANES / HALF {
                        for (row, xl) in acc.iter_mut().zip(xs) {
                            let xl = &xl[h * HALF..(h + 1) * HALF];
                            for (cell, dl) in row.iter_mut().zip(ds) {
                                let dl = &dl[h * HALF..(h + 1) * HALF];
                                for ((a, u), v) in cell.iter_mut().zip(xl).zip(dl) {
                                    *a = u.mul_add(*v, *a);
                                }
                            }
                        }
                    }
                }
            } else {
                for (xk, dk) in x.chunks_exact(inputs).zip(dy.chunks_exact(outputs)) {
                    for (row, xl) in acc.iter_mut().zip(&xk[i..i + ti]) {
                        for (cell, dl) in row.iter_mut().zip(&dk[j..j + tj]) {
                            for h in 0..LANES / HALF {
                                for l in 0..HALF {
                                    cell[l] = xl[h * HALF + l].mul_add(dl[h * HALF + l], cell[l]);
                                }
                            }
                        }
                    }
                }
            }
            for (u, row) in acc.iter().enumerate().take(ti) {
                for (v, cell) in row.iter().enumerate().take(tj) {
                    dw[(i + u) * outputs + j + v] += cell.iter().sum::<f32>();
                }
            }
            j += TILE;
        }
        i += TILE;
    }
}

/// Sum of every lane, added to `db` [outputs], over all blocks of `dy`.
#[inline(always)]
pub fn sum_lanes(dy: &[Lane], db: &mut [f32]) {
    for block in dy.chunks_exact(db.len()) {
        for (b, lane) in db.iter_mut().zip(block) {
            *b += lane.iter().sum::<f32>();
        }
    }
}

/// W transposed: `w` [rows][columns] row-major to [columns][rows].
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
}
