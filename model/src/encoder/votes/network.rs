//! The learned encoder's layers on one frame: forward for flights, backward for training.

use std::sync::OnceLock;

use crpl_sitl::camera::Frame;

use crate::encoder::votes::BODIES;
use crate::encoder::votes::readout::{self, Attention, CELLS, STRIDE, Votes, VotesGradient};
use crate::encoder::votes::weights::{DEPTH, SIDES, TRUNK, VoteWeights};
use crate::encoder::weights::{LEAK, Layer};
use crate::numeric::conv::{CellGrid, ConvSweep, WIDTH};
use crate::numeric::winograd::Winograd;

/// Divisor of a byte: the network's input is byte/128.
pub const INPUT_SCALE: f32 = 128.0;

/// Weights in the order in which the inner loops read them.
#[derive(Debug, Clone)]
pub struct VoteEncoder {
    weights: VoteWeights,
    layers: [PackedConv; DEPTH + 1],
    /// The trunk's layers from [`FIRST_TILED`] on, for flights; made when a first picture is read.
    tiled: OnceLock<[Winograd; DEPTH - FIRST_TILED]>,
}

/// The first layer of the trunk with a stride of 1, and so have those after it.
const FIRST_TILED: usize = 2;

/// One layer: `[k²][inputs][outputs]` and its bias, outputs filled up to a multiple of [`WIDTH`].
#[derive(Debug, Clone)]
struct PackedConv {
    w: Vec<f32>,
    b: Vec<f32>,
    /// `[k²][outputs][inputs]`, for the gradient of the input; none for the first layer.
    turned: Vec<f32>,
    sweep: ConvSweep,
    back: Vec<ConvSweep>,
}

/// The grids of one frame, and what the backward pass needs of them. Reused from frame to frame.
#[derive(Debug, Clone)]
pub struct Activations {
    /// The frame, the outputs of the trunk's layers, and the maps.
    grids: [Vec<f32>; DEPTH + 2],
    attention: [Attention; BODIES],
    votes: Votes,
}

/// Gradients by a frame's grids; the frame itself has none.
#[derive(Debug, Clone)]
pub struct Scratch {
    gradients: [Vec<f32>; DEPTH + 2],
}

impl Default for Scratch {
    fn default() -> Self {
        Self { gradients: std::array::from_fn(|n| if n == 0 { Vec::new() } else { grid(n).zeros() }) }
    }
}

/// Gradient of the weights, in the order of the inner loops.
#[derive(Debug, Clone)]
pub struct VoteGradient {
    layers: [(Vec<f32>, Vec<f32>); DEPTH + 1],
}

/// CellGrid number `n`: 0 is the frame, then the trunk's outputs, last the maps. Its border is as wide as the layer
/// that reads it needs, and the layer before it in the backward pass.
fn grid(n: usize) -> CellGrid {
    let channels = if n == 0 {
        TRUNK[0].inputs
    } else if n <= DEPTH {
        TRUNK[n - 1].outputs
    } else {
        STRIDE
    };
    let reach = |n: usize| TRUNK.get(n).map_or(0, |c| c.kernel / 2 * c.dilation);
    let before = if n == 0 { 0 } else { reach(n - 1) };
    CellGrid { side: SIDES[n.min(DEPTH)], border: reach(n).max(before), channels }
}

impl PackedConv {
    fn new(n: usize, layer: &Layer) -> Self {
        let (from, to) = (grid(n), grid(n + 1));
        let (kernel, stride, dilation) = TRUNK.get(n).map_or((1, 1, 1), |c| (c.kernel, c.stride, c.dilation));
        let sweep = if n == 0 {
            ConvSweep::by_rows(from, to, kernel, stride)
        } else {
            ConvSweep::convolution(from, to, kernel, stride, dilation)
        };
        let back = if n == 0 { Vec::new() } else { sweep.transposed(to, from) };
        let (outputs, inputs) = (layer.b.len(), from.channels);
        let (taps, padded) = (kernel * kernel, to.channels);
        let mut packed = Self {
            w: vec![0.0; taps * inputs * padded],
            b: vec![0.0; padded],
            turned: vec![0.0; if n == 0 { 0 } else { taps * padded * inputs }],
            sweep,
            back,
        };
        packed.b[..outputs].copy_from_slice(&layer.b);
        for (k, w) in layer.w.iter().enumerate() {
            let (o, i, tap) = (k / taps / inputs, k / taps % inputs, k % taps);
            packed.w[(tap * inputs + i) * padded + o] = *w;
            if n > 0 {
                packed.turned[(tap * padded + o) * inputs + i] = *w;
            }
        }
        packed
    }

    /// Bias in every cell, then the sweep, by `tiled` if that is given.
    fn forward(&self, tiled: Option<&Winograd>, x: &[f32], y: &mut [f32]) {
        let mut rows = self.sweep.to.rows();
        if let Some(first) = rows.next() {
            y[first.clone()].chunks_exact_mut(self.b.len()).for_each(|cell| cell.copy_from_slice(&self.b));
            rows.for_each(|row| y.copy_within(first.clone(), row.start));
        }
        match tiled {
            Some(tiled) => tiled.add(x, y),
            None => self.sweep.add(x, &self.w, y),
        }
    }
}

impl Default for Activations {
    fn default() -> Self {
        let grids = std::array::from_fn(|n| grid(n).zeros());
        Self { grids, attention: Default::default(), votes: Votes::default() }
    }
}

impl Activations {
    /// Takes up a frame.
    pub fn set_frame(&mut self, frame: &Frame) {
        self.set_pixels(frame.rgb().iter().map(|byte| f32::from(*byte)));
    }

    /// Takes up pixels `[100][100][3]`, each 0 to 255 but any number.
    pub fn set_pixels(&mut self, mut pixels: impl Iterator<Item = f32>) {
        let x = &mut self.grids[0];
        for row in grid(0).rows() {
            x[row].iter_mut().zip(&mut pixels).for_each(|(x, pixel)| *x = pixel * (1.0 / INPUT_SCALE));
        }
    }
}

impl VoteEncoder {
    /// Packs the weights.
    #[must_use]
    pub fn new(weights: VoteWeights) -> Self {
        let layers = weights.layers();
        let layers = std::array::from_fn(|n| PackedConv::new(n, layers[n]));
        Self { weights, layers, tiled: OnceLock::new() }
    }

    /// The weights as they were given.
    #[must_use]
    pub fn weights(&self) -> &VoteWeights {
        &self.weights
    }

    /// What the votes say of one frame.
    #[must_use]
    pub fn votes(&self, frame: &Frame) -> Votes {
        let mut activations = Activations::default();
        activations.set_frame(frame);
        self.read(&mut activations)
    }

    /// The same of what `activations` took up last.
    pub fn read(&self, activations: &mut Activations) -> Votes {
        let tiled = self.tiled.get_or_init(|| {
            std::array::from_fn(|n| {
                let layer = &self.layers[FIRST_TILED + n];
                Winograd::new(layer.sweep.from, layer.sweep.to, TRUNK[FIRST_TILED + n].dilation, &layer.w)
            })
        });
        self.run(tiled, activations)
    }

    /// The same with plain convolutions, whose weights may change with every batch: for training. It differs by
    /// rounding alone.
    pub fn forward(&self, activations: &mut Activations) -> Votes {
        self.run(&[], activations)
    }

    fn run(&self, tiled: &[Winograd], activations: &mut Activations) -> Votes {
        let Activations { grids, attention, votes } = activations;
        for (n, layer) in self.layers.iter().enumerate() {
            let (before, after) = grids.split_at_mut(n + 1);
            let tiled = n.checked_sub(FIRST_TILED).and_then(|n| tiled.get(n));
            layer.forward(tiled, &before[n], &mut after[0]);
            if n < DEPTH {
                for row in layer.sweep.to.rows() {
                    after[0][row].iter_mut().for_each(|v| *v = v.max(LEAK * *v));
                }
            }
        }
        *votes = readout::read(&grids[DEPTH + 1][..CELLS * CELLS * STRIDE], attention);
        *votes
    }

    /// Adds to `gradient` that of a loss whose gradient by the votes of the last [`VoteEncoder::forward`] is `by`.
    pub fn backward(
        &self,
        activations: &Activations,
        by: &VotesGradient,
        scratch: &mut Scratch,
        gradient: &mut VoteGradient,
    ) {
        let Activations { grids, attention, votes } = activations;
        let gradients = &mut scratch.gradients;
        gradients[DEPTH + 1].fill(0.0);
        readout::gradient(attention, votes.p, by, &mut gradients[DEPTH + 1]);
        for (n, layer) in self.layers.iter().enumerate().rev() {
            let (before, after) = gradients.split_at_mut(n + 1);
            let (dw, db) = &mut gradient.layers[n];
            let dy = &mut after[0];
            for row in layer.sweep.to.rows() {
                if n < DEPTH {
                    let y = &grids[n + 1][row.clone()];
                    dy[row.clone()]
                        .iter_mut()
                        .zip(y)
                        .for_each(|(d, y)| *d *= if *y > 0.0 { 1.0 } else { LEAK });
                }
                for cell in dy[row].chunks_exact(db.len()) {
                    db.iter_mut().zip(cell).for_each(|(b, d)| *b += d);
                }
            }
            layer.sweep.add_weights(&grids[n], dy, dw);
            if n > 0 {
                before[n].fill(0.0);
                for back in &layer.back {
                    back.add(dy, &layer.turned, &mut before[n]);
                }
                clear_border(&mut before[n], grid(n));
            }
        }
    }
}

/// The border belongs to no cell.
fn clear_border(x: &mut [f32], grid: CellGrid) {
    let mut end = 0;
    for row in grid.rows() {
        x[end..row.start].fill(0.0);
        end = row.end;
    }
    x[end..].fill(0.0);
}

impl Default for VoteGradient {
    fn default() -> Self {
        let layers = VoteWeights::shapes();
        Self {
            layers: std::array::from_fn(|n| {
                let [_, inputs, kernel, _] = layers[n];
                let outputs = grid(n + 1).channels;
                (vec![0.0; kernel * kernel * inputs * outputs], vec![0.0; outputs])
            }),
        }
    }
}

impl VoteGradient {
    /// Back to zero.
    pub fn clear(&mut self) {
        for (w, b) in &mut self.layers {
            w.fill(0.0);
            b.fill(0.0);
        }
    }

    /// Adds another one.
    pub fn add(&mut self, other: &Self) {
        for ((w, b), (dw, db)) in self.layers.iter_mut().zip(&other.layers) {
            w.iter_mut().zip(dw).for_each(|(w, d)| *w += d);
            b.iter_mut().zip(db).for_each(|(b, d)| *b += d);
        }
    }

    /// The same in the shapes and order of the weights.
    #[must_use]
    pub fn unpacked(&self) -> VoteWeights {
        let mut out = VoteWeights::zeros();
        let layers = out.trunk.iter_mut().chain([&mut out.vote]);
        for (layer, (w, b)) in layers.zip(&self.layers) {
            let (outputs, padded) = (layer.b.len(), b.len());
            layer.b.copy_from_slice(&b[..outputs]);
            let (inputs, taps) = (layer.shape[1], layer.shape[2] * layer.shape[3]);
            for (k, value) in layer.w.iter_mut().enumerate() {
                let (o, i, tap) = (k / taps / inputs, k / taps % inputs, k % taps);
                *value = w[(tap * inputs + i) * padded + o];
            }
        }
        out
    }
}

const _: () = assert!(STRIDE == WIDTH);

#[cfg(test)]
mod tests {
    use crpl_sitl::world::noise::Noise;

    use super::*;

    fn scene() -> Activations {
        // No black ground: with biases of zero it would stand on the LeakyReLU's kink.
        let mut activations = Activations::default();
        activations.set_pixels((0..30_000).map(|n| 90.0 + 60.0 * (n as f32 * 0.37).sin() + (n % 97) as f32));
        activations
    }

    #[test]
    fn the_cells_borders_stay_zero_from_frame_to_frame() {
        let encoder = VoteEncoder::new(VoteWeights::random(&Noise::new(4)));
        let mut used = scene();
        let first = encoder.forward(&mut used);
        let by = VotesGradient { p: [[1.0; 2]; 2], spread: [0.1; 2] };
        let (mut once, mut twice) = (VoteGradient::default(), VoteGradient::default());
        let mut scratch = Scratch::default();
        encoder.backward(&used, &by, &mut scratch, &mut once);
        assert_eq!(encoder.forward(&mut used), first);
        encoder.backward(&used, &by, &mut scratch, &mut twice);
        assert_eq!(once.unpacked(), twice.unpacked());
    }

    #[test]
    fn a_flight_reads_what_training_reads() {
        let encoder = VoteEncoder::new(VoteWeights::random(&Noise::new(4)));
        let (flown, trained) = (encoder.read(&mut scene()), encoder.forward(&mut scene()));
        for body in 0..BODIES {
            for axis in 0..2 {
                let (a, b) = (flown.p[body][axis], trained.p[body][axis]);
                assert!((a - b).abs() < 1e-3, "{a} px in flight, {b} px in training");
            }
        }
    }
}
