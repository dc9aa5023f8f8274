//! The flight path's encoder: one frame to its latents in plain Rust, well below a millisecond.
//!
//! Channel-last, inner loop over output channels with fused multiply-adds, each sum in one fixed
//! order: every vector width gives equal bits. The frame is mostly black, so each layer scatters
//! from the cells that are not zero; that is exact, whatever the biases. Knows no burn; checked
//! against it by the tests.

use crpl_sitl::camera::{CHANNELS, Frame, SIDE};
use multiversion::multiversion;
use rayon::prelude::*;

use crate::encoder::weights::{
    CONVS, Colour, ConvShape, FEATURES, Input, LATENT, LEAK, Layer, POOLED, Weights,
};

/// Output channels that one inner loop carries in registers.
const BLOCK: usize = 32;

/// What the encoder knows of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Latent {
    /// The controllable half: the UAV.
    pub z_c: [f32; LATENT],
    /// The uncontrollable half: the obstacle.
    pub z_u: [f32; LATENT],
}

/// The trunk's answer to one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    /// h, `[256]`.
    pub h: Vec<f32>,
    /// q, the share of a colour's disc that is cut or hidden: red, green, blue.
    pub missing: [f32; CHANNELS],
}

/// Weights in the order in which the inner loops read them.
#[derive(Debug, Clone)]
pub struct Encoder {
    weights: Weights,
    convs: [Packed; 4],
    fc: Packed,
    head_c: Packed,
    head_u: Packed,
}

/// Weight as `[tap][block of outputs][input][BLOCK]` and bias `[outputs]`.
#[derive(Debug, Clone)]
struct Packed {
    w: Vec<f32>,
    b: Vec<f32>,
    inputs: usize,
}

impl Encoder {
    /// Packs the weights. Their shapes must be those of [`Weights::structured_init`].
    #[must_use]
    pub fn new(weights: Weights) -> Self {
        let convs = std::array::from_fn(|n| Packed::conv(&weights.convs[n], &CONVS[n]));
        // burn flattens [channel][y][x]; here the cell is the tap: [y][x][channel].
        let last = CONVS[3];
        let cells = last.grid_out * last.grid_out;
        let fc = Packed::new(&weights.fc.b, cells, last.outputs, |tap, i, o| {
            weights.fc.w[o * POOLED + i * cells + tap]
        });
        let (head_c, head_u) = (Packed::head(&weights.head_c), Packed::head(&weights.head_u));
        Self { weights, convs, fc, head_c, head_u }
    }

    /// The weights as they were given.
    #[must_use]
    pub fn weights(&self) -> &Weights {
        &self.weights
    }

    /// h and q of one frame.
    #[must_use]
    pub fn features(&self, frame: &Frame) -> Features {
        let mut h = self.fc.b.clone();
        let missing = trunk(frame.rgb(), &self.weights.input, &self.convs, &self.fc, &mut h);
        Features { h, missing }
    }

    /// The latents of one frame.
    #[must_use]
    pub fn encode(&self, frame: &Frame) -> Latent {
        self.read(self.features(frame))
    }

    /// The latents that the heads read from a frame's features.
    #[must_use]
    pub fn read(&self, features: Features) -> Latent {
        let Features { h, missing } = features;
        let mut x = h;
        let z_u = read(&self.head_u, &x);
        if self.head_c.inputs == 2 * FEATURES {
            x.extend_from_within(..);
            x[FEATURES..].iter_mut().for_each(|h| *h *= missing[0]);
        }
        Latent { z_c: read(&self.head_c, &x), z_u }
    }

    /// The latents of many frames, drawn and encoded on all cores; order and bits as one by one.
    #[must_use]
    pub fn encode_all<T: Sync>(&self, scenes: &[T], draw: impl Fn(&T) -> Frame + Sync) -> Vec<Latent> {
        scenes.par_iter().map(|scene| self.encode(&draw(scene))).collect()
    }
}

impl Packed {
    fn new(bias: &[f32], taps: usize, inputs: usize, at: impl Fn(usize, usize, usize) -> f32) -> Self {
        let outputs = bias.len();
        let blocks = outputs.div_ceil(BLOCK);
        let mut w = Vec::with_capacity(taps * blocks * inputs * BLOCK);
        for tap in 0..taps {
            for block in 0..blocks {
                for i in 0..inputs {
                    for lane in 0..BLOCK {
                        let o = block * BLOCK + lane;
                        w.push(if o < outputs { at(tap, i, o) } else { 0.0 });
                    }
                }
            }
        }
        let mut b = bias.to_vec();
        b.resize(blocks * BLOCK, 0.0);
        Self { w, b, inputs }
    }

    fn conv(layer: &Layer, shape: &ConvShape) -> Self {
        let taps = shape.kernel * shape.kernel;
        Self::new(&layer.b, taps, shape.inputs, |tap, i, o| layer.w[(o * shape.inputs + i) * taps + tap])
    }

    fn head(layer: &Layer) -> Self {
        let inputs = layer.shape[1];
        Self::new(&layer.b, 1, inputs, |_, i, o| layer.w[o * inputs + i])
    }
}

/// A latent head: z = W x + b.
fn read(head: &Packed, x: &[f32]) -> [f32; LATENT] {
    let mut z = [0.0; BLOCK];
    z.copy_from_slice(&head.b);
    dense(x, &head.w, &mut z);
    std::array::from_fn(|k| z[k])
}

/// Pixels to h: four convolutions with LeakyReLU, then the linear layer. Returns q.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn trunk(rgb: &[u8], input: &Input, convs: &[Packed; 4], fc: &Packed, h: &mut [f32]) -> [f32; CHANNELS] {
    let (mut x, missing) = match &input.colour {
        None => scaled(rgb, input),
        Some(colour) => unmixed(rgb, input, colour),
    };
    for (shape, layer) in CONVS.iter().zip(convs) {
        x = convolve(&x, shape, layer);
    }
    let inputs = CONVS[3].outputs;
    for (cell, w) in x.chunks_exact(inputs).zip(fc.w.chunks_exact(inputs * FEATURES)) {
        if cell.iter().any(|v| *v != 0.0) {
            accumulate(cell, w, h);
        }
    }
    missing
}

/// The frame as the trunk reads it, `[SIDE²][3]`, and q.
#[inline(always)]
fn scaled(rgb: &[u8], input: &Input) -> (Vec<f32>, [f32; CHANNELS]) {
    let mut sums = [0u32; CHANNELS];
    for pixel in rgb.chunks_exact(CHANNELS) {
        for (sum, byte) in sums.iter_mut().zip(pixel) {
            *sum += u32::from(*byte);
        }
    }
    let (factor, missing) = input.factors(sums);
    let mut x = vec![0.0f32; SIDE * SIDE * CHANNELS];
    for (x, byte) in x.chunks_exact_mut(CHANNELS).zip(rgb.chunks_exact(CHANNELS)) {
        for channel in 0..CHANNELS {
            x[channel] = f32::from(byte[channel]) * factor[channel];
        }
    }
    (x, missing)
}

/// The same behind a colour layer.
#[inline(always)]
fn unmixed(rgb: &[u8], input: &Input, colour: &Colour) -> (Vec<f32>, [f32; CHANNELS]) {
    let mut sums = [0.0f32; CHANNELS];
    let mut x = vec![0.0f32; SIDE * SIDE * CHANNELS];
    for (x, pixel) in x.chunks_exact_mut(CHANNELS).zip(rgb.chunks_exact(CHANNELS)) {
        for (channel, y) in Colour::CHANNELS.into_iter().zip(colour.apply(pixel)) {
            x[channel] = y;
            sums[channel] += y;
        }
    }
    let (factor, missing) = input.factors_of(sums, 1.0);
    for x in x.chunks_exact_mut(CHANNELS) {
        x.iter_mut().zip(factor).for_each(|(x, factor)| *x *= factor);
    }
    (x, missing)
}

/// One convolution with LeakyReLU: `[grid_in²][inputs]` -> `[grid_out²][outputs]`.
#[inline(always)]
fn convolve(x: &[f32], shape: &ConvShape, layer: &Packed) -> Vec<f32> {
    let ConvShape { inputs, outputs, kernel, stride, padding, grid_in, grid_out } = *shape;
    let mut y = Vec::with_capacity(grid_out * grid_out * outputs);
    for _ in 0..grid_out * grid_out {
        y.extend_from_slice(&layer.b);
    }
    // Cells of the output that a cell of the input reaches along one axis.
    let reached = |at: usize| {
        let low = (at + padding + 1).saturating_sub(kernel).div_ceil(stride);
        low..((at + padding) / stride + 1).min(grid_out)
    };
    for iy in 0..grid_in {
        for ix in 0..grid_in {
            let cell = &x[(iy * grid_in + ix) * inputs..][..inputs];
            if cell.iter().all(|v| *v == 0.0) {
                continue;
            }
            for oy in reached(iy) {
                for ox in reached(ix) {
                    let tap = (iy + padding - oy * stride) * kernel + (ix + padding - ox * stride);
                    let w = &layer.w[tap * inputs * outputs..][..inputs * outputs];
                    accumulate(cell, w, &mut y[(oy * grid_out + ox) * outputs..][..outputs]);
                }
            }
        }
    }
    for v in &mut y {
        *v = v.max(LEAK * *v);
    }
    y
}

/// y += x W, W as `[block][input][BLOCK]`. The order of the sum is that of the inputs.
#[inline(always)]
fn accumulate(x: &[f32], w: &[f32], y: &mut [f32]) {
    for (y, w) in y.chunks_exact_mut(BLOCK).zip(w.chunks_exact(x.len() * BLOCK)) {
        let mut sum = [0.0f32; BLOCK];
        sum.copy_from_slice(y);
        for (x, w) in x.iter().zip(w.chunks_exact(BLOCK)) {
            for lane in 0..BLOCK {
                sum[lane] = x.mul_add(w[lane], sum[lane]);
            }
        }
        y.copy_from_slice(&sum);
    }
}

/// [`accumulate`] for a single linear layer.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn dense(x: &[f32], w: &[f32], y: &mut [f32]) {
    accumulate(x, w, y);
}
