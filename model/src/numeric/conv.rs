//! Convolutions of dense pictures: forward, and both gradients.
//!
//! Channel-last grids with a border of zeros, so no cell needs a check. One loop does all: a [`ConvSweep`] adds
//! to each cell of one grid a linear map of cells around it in another. A convolution is a sweep; the gradient
//! of its input is one too (with a stride of 2, one for each of four phases). Outputs stand in blocks of
//! [`WIDTH`]; each sum runs in one fixed order with fused multiply-adds, so results do not depend on the
//! machine's vector width.

use multiversion::multiversion;

/// Outputs of one block: the inner loop's width.
pub const WIDTH: usize = 16;

/// Cells along a row that one inner loop computes together.
const TILE: usize = 5;

/// The same for most of what [`TILE`] leaves of a row.
const REST: usize = 3;

/// Inputs whose weight gradients one inner loop sums together.
const INPUTS: usize = 4;

/// One block of outputs.
type Block = [f32; WIDTH];

/// A square grid of cells, each with `channels` values, and a border of zeros around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellGrid {
    /// Cells along each side.
    pub side: usize,
    /// Cells of the border, on each side.
    pub border: usize,
    /// Values of a cell.
    pub channels: usize,
}

impl CellGrid {
    /// A grid of zeros.
    #[must_use]
    pub fn zeros(&self) -> Vec<f32> {
        vec![0.0; (self.side + 2 * self.border) * self.row()]
    }

    /// Floats from one row to the next.
    #[must_use]
    pub fn row(&self) -> usize {
        (self.side + 2 * self.border) * self.channels
    }

    /// Index of the first value of a cell.
    #[must_use]
    pub fn at(&self, y: usize, x: usize) -> usize {
        (y + self.border) * self.row() + (x + self.border) * self.channels
    }

    /// The indices of the cells' values, row by row, the border left out.
    pub fn rows(&self) -> impl Iterator<Item = std::ops::Range<usize>> {
        let (grid, width) = (*self, self.side * self.channels);
        (0..self.side).map(move |y| grid.at(y, 0)..grid.at(y, 0) + width)
    }
}

/// One term of a sweep: the cell `(dy, dx)` away from the centre, `inputs` of its values and of the values that
/// follow, and the place of its weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tap {
    /// Rows down.
    pub dy: isize,
    /// Columns right.
    pub dx: isize,
    /// Index of the weights `[inputs][outputs]` among all taps' weights.
    pub weight: usize,
}

/// Which cells are summed into which.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConvSweep {
    /// The grid that is read.
    pub from: CellGrid,
    /// The grid that is added to; its channels are a multiple of [`WIDTH`], at most three of them.
    pub to: CellGrid,
    /// The terms.
    pub taps: Vec<Tap>,
    /// Values of a tap.
    pub inputs: usize,
    /// Rows of cells computed.
    pub rows: usize,
    /// Cells of a row computed.
    pub cells: usize,
    /// Cells of `from` between two neighbours.
    pub from_stride: usize,
    /// Cells of `to` between two neighbours.
    pub to_stride: usize,
    /// The first cell of `to`: row and column.
    pub first: [usize; 2],
}

impl ConvSweep {
    /// A convolution: square `kernel`, equal stride, dilation and zero padding (the grid's border must hold it) on
    /// both axes. Weights are `[kernel²][inputs][outputs]`.
    #[must_use]
    pub fn convolution(from: CellGrid, to: CellGrid, kernel: usize, stride: usize, dilation: usize) -> Self {
        let reach = (kernel / 2 * dilation) as isize;
        let at = |k: usize| (k * dilation) as isize - reach;
        let taps =
            (0..kernel * kernel).map(|n| Tap { dy: at(n / kernel), dx: at(n % kernel), weight: n }).collect();
        let inputs = from.channels;
        Self {
            from,
            to,
            taps,
            inputs,
            rows: to.side,
            cells: to.side,
            from_stride: stride,
            to_stride: 1,
            first: [0, 0],
        }
    }

    /// The same with a row of the kernel as one tap, for few channels: its cells are neighbours in memory. Weights
    /// are `[kernel][kernel inputs][outputs]`, which is the same order. Dilation 1.
    #[must_use]
    pub fn by_rows(from: CellGrid, to: CellGrid, kernel: usize, stride: usize) -> Self {
        let reach = (kernel / 2) as isize;
        let taps = (0..kernel).map(|n| Tap { dy: n as isize - reach, dx: -reach, weight: n }).collect();
        let sweep = Self::convolution(from, to, kernel, stride, 1);
        Self { taps, inputs: kernel * from.channels, ..sweep }
    }

    /// The sweeps that take the gradient of this convolution's output to that of its input: one, or four with a
    /// stride of 2. Weights are `[kernel²][outputs][inputs]`: each tap's transposed.
    #[must_use]
    pub fn transposed(&self, from: CellGrid, to: CellGrid) -> Vec<Self> {
        let stride = self.from_stride as isize;
        let phases =
            (0..self.from_stride * self.from_stride).map(|n| [n / self.from_stride, n % self.from_stride]);
        phases
            .map(|first| {
                // Cell i s + phase of the input has met output cell o = (i s + phase - d) / s by tap d.
                let reached = |d: isize, phase: usize| {
                    let way = phase as isize - d;
                    (way.rem_euclid(stride) == 0).then(|| way.div_euclid(stride))
                };
                let taps = self.taps.iter().filter_map(|tap| {
                    let (dy, dx) = (reached(tap.dy, first[0])?, reached(tap.dx, first[1])?);
                    Some(Tap { dy, dx, weight: tap.weight })
                });
                Self {
                    from,
                    to,
                    taps: taps.collect(),
                    inputs: from.channels,
                    rows: to.side / self.from_stride,
                    cells: to.side / self.from_stride,
                    from_stride: 1,
                    to_stride: self.from_stride,
                    first,
                }
            })
            .collect()
    }

    /// A product of matrices: adds `[cells][inputs]` times `[inputs][outputs]` to `[cells][outputs]`.
    #[must_use]
    pub fn product(cells: usize, inputs: usize, outputs: usize) -> Self {
        let row = |channels: usize| CellGrid { side: cells, border: 0, channels };
        Self { rows: 1, ..Self::convolution(row(inputs), row(outputs), 1, 1, 1) }
    }

    /// Adds the sweep of `x` with weights `w` to `y`.
    pub fn add(&self, x: &[f32], w: &[f32], y: &mut [f32]) {
        match self.to.channels / WIDTH {
            1 => sweep_one(self, x, w, y),
            2 => sweep_two(self, x, w, y),
            _ => sweep_three(self, x, w, y),
        }
    }

    /// Adds to `dw` the gradient of the weights: `x` as [`ConvSweep::add`] read it, `dy` the gradient of what it
    /// added to. For sweeps of [`ConvSweep::convolution`] and [`ConvSweep::by_rows`].
    pub fn add_weights(&self, x: &[f32], dy: &[f32], dw: &mut [f32]) {
        match self.to.channels / WIDTH {
            1 => weights_one(self, x, dy, dw),
            2 => weights_two(self, x, dy, dw),
            _ => weights_three(self, x, dy, dw),
        }
    }

    /// Where the sweep's cell reads (`from`, its centre) and adds (`to`).
    #[inline(always)]
    fn places(&self, cy: usize, cx: usize) -> (usize, usize) {
        let ([fy, fx], s) = (self.first, self.to_stride);
        (self.from.at(cy * self.from_stride, cx * self.from_stride), self.to.at(fy + cy * s, fx + cx * s))
    }

    /// Where a tap of the cell that is centred at `centre` begins.
    #[inline(always)]
    fn tap(&self, centre: usize, tap: &Tap) -> usize {
        let way = tap.dy * self.from.row() as isize + tap.dx * self.from.channels as isize;
        centre.wrapping_add_signed(way)
    }
}

macro_rules! widths {
    ($sweep:ident, $weights:ident, $blocks:literal) => {
        #[multiversion(targets(
            "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
            "x86_64+avx2+fma",
            "aarch64+neon"
        ))]
        fn $sweep(sweep: &ConvSweep, x: &[f32], w: &[f32], y: &mut [f32]) {
            sweep_blocks::<$blocks>(sweep, x, w, y);
        }

        #[multiversion(targets(
            "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
            "x86_64+avx2+fma",
            "aarch64+neon"
        ))]
        fn $weights(sweep: &ConvSweep, x: &[f32], dy: &[f32], dw: &mut [f32]) {
            weights_blocks::<$blocks>(sweep, x, dy, dw);
        }
    };
}

widths!(sweep_one, weights_one, 1);
widths!(sweep_two, weights_two, 2);
widths!(sweep_three, weights_three, 3);

#[inline(always)]
fn sweep_blocks<const B: usize>(sweep: &ConvSweep, x: &[f32], w: &[f32], y: &mut [f32]) {
    for cy in 0..sweep.rows {
        let mut cx = 0;
        while cx + TILE <= sweep.cells {
            tile::<B, TILE>(sweep, cy, cx, x, w, y);
            cx += TILE;
        }
        if cx + REST <= sweep.cells {
            tile::<B, REST>(sweep, cy, cx, x, w, y);
            cx += REST;
        }
        while cx < sweep.cells {
            tile::<B, 1>(sweep, cy, cx, x, w, y);
            cx += 1;
        }
    }
}

/// `T` neighbouring cells of a row.
#[inline(always)]
fn tile<const B: usize, const T: usize>(
    sweep: &ConvSweep,
    cy: usize,
    cx: usize,
    x: &[f32],
    w: &[f32],
    y: &mut [f32],
) {
    let (centre, out) = sweep.places(cy, cx);
    let (step, out_step) = (sweep.from_stride * sweep.from.channels, sweep.to_stride * sweep.to.channels);
    let mut sums = [[[0.0f32; WIDTH]; B]; T];
    for (t, sums) in sums.iter_mut().enumerate() {
        let cell = &y[out + t * out_step..][..B * WIDTH];
        for (sum, y) in sums.iter_mut().zip(cell.as_chunks::<WIDTH>().0) {
            *sum = *y;
        }
    }
    let inputs = sweep.inputs;
    for tap in &sweep.taps {
        let begin = sweep.tap(centre, tap);
        let w = &w[tap.weight * inputs * B * WIDTH..][..inputs * B * WIDTH];
        let w = w.as_chunks::<WIDTH>().0.as_chunks::<B>().0;
        let mut cells: [&[f32]; T] = [&[]; T];
        for (t, cell) in cells.iter_mut().enumerate() {
            *cell = &x[begin + t * step..][..w.len()];
        }
        for (i, w) in w.iter().enumerate() {
            for t in 0..T {
                let v = cells[t][i];
                for b in 0..B {
                    multiply_add(v, &w[b], &mut sums[t][b]);
                }
            }
        }
    }
    for (t, sums) in sums.iter().enumerate() {
        y[out + t * out_step..][..B * WIDTH].copy_from_slice(sums.as_flattened());
    }
}

#[inline(always)]
fn multiply_add(v: f32, w: &Block, sum: &mut Block) {
    for (sum, w) in sum.iter_mut().zip(w) {
        *sum = v.mul_add(*w, *sum);
    }
}

#[inline(always)]
fn weights_blocks<const B: usize>(sweep: &ConvSweep, x: &[f32], dy: &[f32], dw: &mut [f32]) {
    let inputs = sweep.inputs;
    for tap in &sweep.taps {
        let dw = &mut dw[tap.weight * inputs * B * WIDTH..][..inputs * B * WIDTH];
        let mut first = 0;
        while first + INPUTS <= inputs {
            some_weights::<B, INPUTS>(sweep, tap, first, x, dy, dw);
            first += INPUTS;
        }
        while first < inputs {
            some_weights::<B, 1>(sweep, tap, first, x, dy, dw);
            first += 1;
        }
    }
}

/// The gradient of one tap's weights of `I` inputs from `first` on.
#[inline(always)]
fn some_weights<const B: usize, const I: usize>(
    sweep: &ConvSweep,
    tap: &Tap,
    first: usize,
    x: &[f32],
    dy: &[f32],
    dw: &mut [f32],
) {
    let mut sums = [[[0.0f32; WIDTH]; B]; I];
    let step = sweep.from_stride * sweep.from.channels;
    for cy in 0..sweep.rows {
        let (centre, out) = sweep.places(cy, 0);
        let begin = sweep.tap(centre, tap) + first;
        let dy = &dy[out..][..sweep.cells * B * WIDTH];
        for (cx, dy) in dy.as_chunks::<WIDTH>().0.as_chunks::<B>().0.iter().enumerate() {
            let x: &[f32; I] = x[begin + cx * step..].first_chunk().unwrap_or(&[0.0; I]);
            for i in 0..I {
                for b in 0..B {
                    multiply_add(x[i], &dy[b], &mut sums[i][b]);
                }
            }
        }
    }
    let place = &mut dw[first * B * WIDTH..][..I * B * WIDTH];
    for (dw, sum) in place.iter_mut().zip(sums.as_flattened().as_flattened()) {
        *dw += sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(n: usize) -> f32 {
        ((n * 7919 + 104_729) % 1009) as f32 / 1009.0 - 0.5
    }

    fn filled(grid: CellGrid, seed: usize) -> Vec<f32> {
        let mut x = grid.zeros();
        for (n, row) in grid.rows().enumerate() {
            x[row].iter_mut().enumerate().for_each(|(k, x)| *x = value(seed + n * 1013 + k));
        }
        x
    }

    /// Every kind of layer that the encoder has, small: grids, kernel, stride, dilation.
    fn layers() -> [(CellGrid, CellGrid, usize, usize, usize); 4] {
        let grid = |side, border, channels| CellGrid { side, border, channels };
        [
            (grid(12, 2, 3), grid(6, 1, 16), 5, 2, 1),
            (grid(12, 1, 16), grid(6, 1, 32), 3, 2, 1),
            (grid(7, 1, 32), grid(7, 2, 48), 3, 1, 1),
            (grid(7, 2, 16), grid(7, 2, 48), 3, 1, 2),
        ]
    }

    /// y by the definition, no vectors and no borders.
    fn plainly(x: &[f32], w: &[f32], layer: (CellGrid, CellGrid, usize, usize, usize)) -> Vec<f32> {
        let (from, to, kernel, stride, dilation) = layer;
        let mut y = to.zeros();
        let inside = |v: isize| (0..from.side as isize).contains(&v);
        for (oy, ox, o) in (0..to.side * to.side * to.channels)
            .map(|n| (n / to.channels / to.side, n / to.channels % to.side, n % to.channels))
        {
            for (ky, kx) in (0..kernel * kernel).map(|n| (n / kernel, n % kernel)) {
                let at = |o: usize, k: usize| {
                    (o * stride + k * dilation) as isize - (kernel / 2 * dilation) as isize
                };
                let (iy, ix) = (at(oy, ky), at(ox, kx));
                if inside(iy) && inside(ix) {
                    for i in 0..from.channels {
                        let w = w[((ky * kernel + kx) * from.channels + i) * to.channels + o];
                        y[to.at(oy, ox) + o] += x[from.at(iy as usize, ix as usize) + i] * w;
                    }
                }
            }
        }
        y
    }

    fn sweep_of(
        (from, to, kernel, stride, dilation): (CellGrid, CellGrid, usize, usize, usize),
    ) -> ConvSweep {
        if from.channels == 3 {
            ConvSweep::by_rows(from, to, kernel, stride)
        } else {
            ConvSweep::convolution(from, to, kernel, stride, dilation)
        }
    }

    fn dot(a: &[f32], b: &[f32]) -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    }

    #[test]
    fn a_sweep_is_the_convolution_of_the_definition() {
        for layer in layers() {
            let (from, to, kernel, ..) = layer;
            let x = filled(from, 1);
            let w: Vec<f32> = (0..kernel * kernel * from.channels * to.channels).map(value).collect();
            let mut y = to.zeros();
            sweep_of(layer).add(&x, &w, &mut y);
            for (found, wanted) in y.iter().zip(plainly(&x, &w, layer)) {
                assert!((found - wanted).abs() < 1e-4, "{found} instead of {wanted} in {layer:?}");
            }
        }
    }

    #[test]
    fn both_gradients_are_the_adjoints_of_the_sweep() {
        for layer in layers() {
            let (from, to, kernel, ..) = layer;
            let (x, dy) = (filled(from, 1), filled(to, 5));
            let taps = kernel * kernel;
            let w: Vec<f32> = (0..taps * from.channels * to.channels).map(value).collect();
            let sweep = sweep_of(layer);
            let mut y = to.zeros();
            sweep.add(&x, &w, &mut y);
            let wanted = dot(&y, &dy);
            // <w, dL/dw> = <y, dy>, as y is linear in w; and <x, dL/dx> = <y, dy>.
            let mut dw = vec![0.0; w.len()];
            sweep.add_weights(&x, &dy, &mut dw);
            assert!((dot(&w, &dw) - wanted).abs() < 1e-2 * (1.0 + wanted.abs()), "{layer:?}");
            if from.channels % WIDTH == 0 {
                let mut turned = Vec::with_capacity(w.len());
                for w in w.chunks_exact(from.channels * to.channels) {
                    turned
                        .extend((0..w.len()).map(|n| w[n % from.channels * to.channels + n / from.channels]));
                }
                let mut dx = from.zeros();
                for back in sweep.transposed(to, from) {
                    back.add(&dy, &turned, &mut dx);
                }
                let found = dot(&x, &dx);
                assert!((found - wanted).abs() < 1e-3 * (1.0 + wanted.abs()), "{found} {wanted} {layer:?}");
            }
        }
    }
}
