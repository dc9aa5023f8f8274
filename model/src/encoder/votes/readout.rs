//! From a frame's maps to the places of both bodies, and the gradient back.

use multiversion::multiversion;

use crate::encoder::votes::BODIES;
use crate::encoder::votes::weights::MAPS;
use crate::numeric::kernel;

/// Cells along each side of the maps.
pub const CELLS: usize = 25;

/// Pixels between two cells' centres.
pub const PITCH: f32 = 4.0;

/// Factor of the logit: how sharply the softmax chooses.
pub const SHARPNESS: f32 = 8.0;

/// Stride of a cell's maps in memory: [`MAPS`] values and what fills the block.
pub const STRIDE: usize = 16;

/// What the votes say of a frame; the UAV first, then the obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Votes {
    /// p, px: column and row.
    pub p: [[f32; 2]; BODIES],
    /// Σ w |vote - p|², px²: how far the votes lie apart.
    pub spread: [f32; BODIES],
    /// log Σ exp(8 l): how much the cells found.
    pub evidence: [f32; BODIES],
}

/// The gradient of a loss by p and by the spread (p in it held still).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct VotesGradient {
    /// By p.
    pub p: [[f32; 2]; BODIES],
    /// By the spread.
    pub spread: [f32; BODIES],
}

/// One body's softmax and votes.
#[derive(Debug, Clone)]
pub struct Attention {
    /// w, `[625]`.
    w: Vec<f32>,
    /// Votes x + o, px, `[625]`.
    votes: Vec<[f32; 2]>,
}

impl Default for Attention {
    fn default() -> Self {
        let cells = CELLS * CELLS;
        Self { w: vec![0.0; cells], votes: vec![[0.0; 2]; cells] }
    }
}

/// Reads both bodies from `maps` `[625][STRIDE]`; `attention` is kept for [`gradient`].
#[must_use]
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
pub fn read(maps: &[f32], attention: &mut [Attention; BODIES]) -> Votes {
    let mut out = Votes::default();
    for (body, attention) in attention.iter_mut().enumerate() {
        let Attention { w, votes } = attention;
        let mut highest = f32::MIN;
        for ((n, cell), w) in maps.chunks_exact(STRIDE).enumerate().zip(w.iter_mut()) {
            *w = SHARPNESS * cell[3 * body];
            highest = highest.max(*w);
            let centre = |k: usize| PITCH * k as f32 + 0.5;
            let (x, y) = (centre(n % CELLS), centre(n / CELLS));
            votes[n] = [PITCH.mul_add(cell[3 * body + 1], x), PITCH.mul_add(cell[3 * body + 2], y)];
        }
        let mut sum = 0.0;
        for w in w.iter_mut() {
            *w = kernel::exp(*w - highest);
            sum += *w;
        }
        let mut p = [0.0f32; 2];
        for (w, vote) in w.iter_mut().zip(votes.iter()) {
            *w /= sum;
            p = [w.mul_add(vote[0], p[0]), w.mul_add(vote[1], p[1])];
        }
        let apart = w.iter().zip(votes.iter()).map(|(w, v)| w * distance_squared(*v, p));
        out.spread[body] = apart.sum();
        out.evidence[body] = highest + kernel::ln(sum);
        out.p[body] = p;
    }
    out
}

/// Adds to `dmaps` `[625][STRIDE]` the gradient by the maps of the frame that [`read`] has read last.
pub fn gradient(
    attention: &[Attention; BODIES],
    p: [[f32; 2]; BODIES],
    by: &VotesGradient,
    dmaps: &mut [f32],
) {
    for (body, Attention { w, votes }) in attention.iter().enumerate() {
        let ([dx, dy], ds, p) = (by.p[body], by.spread[body], p[body]);
        // dL/dw of each cell, and its mean under w, which the softmax takes out.
        let by_w =
            |vote: [f32; 2]| dx * (vote[0] - p[0]) + dy * (vote[1] - p[1]) + ds * distance_squared(vote, p);
        let mean: f32 = w.iter().zip(votes).map(|(w, v)| w * by_w(*v)).sum();
        for ((w, vote), cell) in w.iter().zip(votes).zip(dmaps.chunks_exact_mut(STRIDE)) {
            cell[3 * body] += SHARPNESS * w * (by_w(*vote) - mean);
            cell[3 * body + 1] += PITCH * w * (dx + 2.0 * ds * (vote[0] - p[0]));
            cell[3 * body + 2] += PITCH * w * (dy + 2.0 * ds * (vote[1] - p[1]));
        }
    }
}

fn distance_squared(a: [f32; 2], b: [f32; 2]) -> f32 {
    let (x, y) = (a[0] - b[0], a[1] - b[1]);
    x * x + y * y
}

const _: () = assert!(MAPS <= STRIDE);
