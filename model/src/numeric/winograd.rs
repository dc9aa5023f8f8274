//! 3 × 3 convolutions with stride 1 by Winograd's F(2 × 2, 3 × 3): 16 products for four outputs in place of 36.
//!
//! Four neighbouring outputs read 4 × 4 inputs d and are Aᵀ[(G g Gᵀ) ⊙ (Bᵀ d B)]A (A. Lavin, S. Gray, "Fast Algorithms
//! for Convolutional Neural Networks", CVPR 2016, Sec. 4.1). With a dilation of 2 the grid falls into four grids that
//! do not meet, and each is convolved so. Sums run in one fixed order, as in [`conv`](crate::numeric::conv); they
//! differ from those of the plain convolution by rounding alone.

use multiversion::multiversion;

use crate::numeric::conv::{CellGrid, ConvSweep, WIDTH};

/// Products of a tile: one for each of 4 × 4 places.
const PLACES: usize = 16;

/// Rows of tiles that are computed together: so often the weights are read.
const ROWS: usize = 2;

/// The three blocks of outputs that one inner loop sums together.
const BLOCKS: usize = 3;

/// Outputs of a convolution of this kind.
pub const OUTPUTS: usize = BLOCKS * WIDTH;

/// One block of channels.
type Block = [f32; WIDTH];

/// The values of a tile, `[row][column]`.
type Square<const N: usize> = [[Block; N]; N];

/// A convolution with its weights taken to the tiles' places.
#[derive(Debug, Clone)]
pub struct Winograd {
    from: CellGrid,
    to: CellGrid,
    dilation: usize,
    /// Along one axis: the first output of each tile, one of the grids that do not meet after the other.
    starts: Vec<usize>,
    /// G g Gᵀ: `[place][input][output]`.
    weights: Vec<f32>,
}

impl Winograd {
    /// A convolution of zero padding and this dilation, with weights `[9][inputs][outputs]`. The border of `from` is at
    /// least the dilation; inputs are a multiple of [`WIDTH`], outputs are [`OUTPUTS`].
    #[must_use]
    pub fn new(from: CellGrid, to: CellGrid, dilation: usize, w: &[f32]) -> Self {
        let pairs = from.channels * to.channels;
        let mut weights = vec![0.0; PLACES * pairs];
        for pair in 0..pairs {
            let g: [[f32; 3]; 3] =
                std::array::from_fn(|y| std::array::from_fn(|x| w[(3 * y + x) * pairs + pair]));
            // Columns, then rows.
            let columns = thirds(g);
            let turned: [[f32; 4]; 3] = std::array::from_fn(|x| columns.map(|row| row[x]));
            let all = thirds(turned);
            for (x, column) in all.iter().enumerate() {
                for (y, value) in column.iter().enumerate() {
                    weights[(4 * y + x) * pairs + pair] = *value;
                }
            }
        }
        let starts: Vec<usize> =
            (0..dilation).flat_map(|phase| (phase..to.side).step_by(2 * dilation)).collect();
        Self { from, to, dilation, starts, weights }
    }

    /// Adds the convolution of `x` to `y`.
    pub fn add(&self, x: &[f32], y: &mut [f32]) {
        let inputs = self.from.channels;
        let most = PLACES * ROWS * self.starts.len();
        let (mut places, mut products) = (vec![0.0; most * inputs], vec![0.0; most * OUTPUTS]);
        for rows in self.starts.chunks(ROWS) {
            let tiles = rows.len() * self.starts.len();
            let product = ConvSweep::product(tiles, inputs, OUTPUTS);
            let (places, products) =
                (&mut places[..PLACES * tiles * inputs], &mut products[..PLACES * tiles * OUTPUTS]);
            take_rows(self, rows, x, places);
            products.fill(0.0);
            let weights = self.weights.chunks_exact(inputs * OUTPUTS);
            let all = places.chunks_exact(tiles * inputs).zip(weights);
            for ((v, w), m) in all.zip(products.chunks_exact_mut(tiles * OUTPUTS)) {
                product.add(v, w, m);
            }
            give_rows(self, rows, products, y);
        }
    }
}

/// G g for each column of g: rows (g₀, (g₀+g₁+g₂)/2, (g₀−g₁+g₂)/2, g₂).
fn thirds<const N: usize>(g: [[f32; N]; 3]) -> [[f32; N]; 4] {
    let row = |f: fn(f32, f32, f32) -> f32| std::array::from_fn(|n| f(g[0][n], g[1][n], g[2][n]));
    [row(|a, _, _| a), row(|a, b, c| (a + b + c) * 0.5), row(|a, b, c| (a - b + c) * 0.5), row(|_, _, c| c)]
}

/// Bᵀ d B of all tiles whose outputs begin in these rows.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn take_rows(conv: &Winograd, rows: &[usize], x: &[f32], places: &mut [f32]) {
    let corners = rows.iter().flat_map(|row| conv.starts.iter().map(|column| [*row, *column]));
    for (tile, corner) in corners.enumerate() {
        take(conv, corner, [tile, rows.len() * conv.starts.len()], x, places);
    }
}

/// Adds Aᵀ m A of all tiles whose outputs begin in these rows.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn give_rows(conv: &Winograd, rows: &[usize], products: &[f32], y: &mut [f32]) {
    let corners = rows.iter().flat_map(|row| conv.starts.iter().map(|column| [*row, *column]));
    for (tile, corner) in corners.enumerate() {
        give(conv, corner, [tile, rows.len() * conv.starts.len()], products, y);
    }
}

/// Bᵀ d B of one tile of so many, to its row of each place.
#[inline(always)]
fn take(conv: &Winograd, at: [usize; 2], [tile, tiles]: [usize; 2], x: &[f32], places: &mut [f32]) {
    let (grid, inputs) = (conv.from, conv.from.channels);
    let origin = grid.at(at[0], at[1]);
    let (down, right) = ((conv.dilation * grid.row()) as isize, (conv.dilation * inputs) as isize);
    for block in 0..inputs / WIDTH {
        let mut d: Square<4> = [[[0.0; WIDTH]; 4]; 4];
        for (i, row) in d.iter_mut().enumerate() {
            for (j, cell) in row.iter_mut().enumerate() {
                let way = (i as isize - 1) * down + (j as isize - 1) * right;
                let begin = origin.wrapping_add_signed(way) + block * WIDTH;
                // Only outputs beyond the grid read cells beyond the border.
                if let Some(values) = x.get(begin..begin + WIDTH) {
                    cell.copy_from_slice(values);
                }
            }
        }
        for j in 0..4 {
            let column = [d[0][j], d[1][j], d[2][j], d[3][j]];
            let [a, b, c, e] = differences(&column);
            (d[0][j], d[1][j], d[2][j], d[3][j]) = (a, b, c, e);
        }
        for (i, row) in d.iter().enumerate() {
            for (j, value) in differences(row).iter().enumerate() {
                let begin = ((4 * i + j) * tiles + tile) * inputs + block * WIDTH;
                places[begin..begin + WIDTH].copy_from_slice(value);
            }
        }
    }
}

/// Bᵀ d along one axis: (d₀ − d₂, d₁ + d₂, d₂ − d₁, d₁ − d₃).
#[inline(always)]
fn differences(d: &[Block; 4]) -> [Block; 4] {
    let mut out = [[0.0; WIDTH]; 4];
    for n in 0..WIDTH {
        out[0][n] = d[0][n] - d[2][n];
        out[1][n] = d[1][n] + d[2][n];
        out[2][n] = d[2][n] - d[1][n];
        out[3][n] = d[1][n] - d[3][n];
    }
    out
}

/// Adds Aᵀ m A of one tile to its outputs that lie in the grid.
#[inline(always)]
fn give(conv: &Winograd, at: [usize; 2], [tile, tiles]: [usize; 2], products: &[f32], y: &mut [f32]) {
    let (grid, d) = (conv.to, conv.dilation);
    for block in 0..BLOCKS {
        let mut rows = [[[0.0; WIDTH]; 2]; 4];
        for (i, row) in rows.iter_mut().enumerate() {
            let mut m = [[0.0; WIDTH]; 4];
            for (j, m) in m.iter_mut().enumerate() {
                let begin = ((4 * i + j) * tiles + tile) * OUTPUTS + block * WIDTH;
                m.copy_from_slice(&products[begin..begin + WIDTH]);
            }
            *row = sums(&m);
        }
        for j in 0..2 {
            let values = sums(&[rows[0][j], rows[1][j], rows[2][j], rows[3][j]]);
            for (i, value) in values.iter().enumerate() {
                let (row, column) = (at[0] + i * d, at[1] + j * d);
                if row < grid.side && column < grid.side {
                    let begin = grid.at(row, column) + block * WIDTH;
                    y[begin..begin + WIDTH].iter_mut().zip(value).for_each(|(y, v)| *y += v);
                }
            }
        }
    }
}

/// Aᵀ m along one axis: (m₀ + m₁ + m₂, m₁ − m₂ − m₃).
#[inline(always)]
fn sums(m: &[Block; 4]) -> [Block; 2] {
    let mut out = [[0.0; WIDTH]; 2];
    for n in 0..WIDTH {
        out[0][n] = m[0][n] + m[1][n] + m[2][n];
        out[1][n] = m[1][n] - m[2][n] - m[3][n];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_plain_convolution() {
        for (side, border, channels, dilation) in
            [(25, 1, 32, 1), (25, 2, 48, 2), (12, 2, 16, 2), (7, 1, 16, 1)]
        {
            let from = CellGrid { side, border, channels };
            let to = CellGrid { side, border: 0, channels: OUTPUTS };
            let value = |n: usize| ((n * 7919 + 104_729) % 1009) as f32 / 1009.0 - 0.5;
            let mut x = from.zeros();
            for (n, row) in from.rows().enumerate() {
                x[row].iter_mut().enumerate().for_each(|(k, x)| *x = value(n * 1013 + k));
            }
            let w: Vec<f32> = (0..9 * channels * OUTPUTS).map(value).collect();
            let (mut wanted, mut found) = (to.zeros(), to.zeros());
            ConvSweep::convolution(from, to, 3, 1, dilation).add(&x, &w, &mut wanted);
            Winograd::new(from, to, dilation, &w).add(&x, &mut found);
            for (found, wanted) in found.iter().zip(&wanted) {
                assert!((found - wanted).abs() < 1e-4, "{found} instead of {wanted}, side {side}");
            }
        }
    }
}
