//! The numbers of the learned encoder, their random start and their names on disk.

use crpl_sitl::camera::CHANNELS;
use crpl_sitl::world::noise::{Noise, Stream};
use rand_distr::{Distribution, StandardNormal};

use crate::encoder::votes::BODIES;
use crate::encoder::weights::{LEAK, Layer, get_layer, put_layer};
use crate::numeric::tensors::{Reader, Stored, TensorError, Writer};

/// One convolution of the trunk; padding keeps the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VoteConv {
    /// Channels in.
    pub inputs: usize,
    /// Channels out.
    pub outputs: usize,
    /// Side of the kernel.
    pub kernel: usize,
    /// Stride.
    pub stride: usize,
    /// Dilation.
    pub dilation: usize,
}

/// Number of the trunk's convolutions.
pub const DEPTH: usize = 4;

/// The trunk: 100 -> 50 -> 25 -> 25 -> 25 cells.
pub const TRUNK: [VoteConv; DEPTH] = [
    VoteConv { inputs: CHANNELS, outputs: 16, kernel: 5, stride: 2, dilation: 1 },
    VoteConv { inputs: 16, outputs: 32, kernel: 3, stride: 2, dilation: 1 },
    VoteConv { inputs: 32, outputs: 48, kernel: 3, stride: 1, dilation: 1 },
    VoteConv { inputs: 48, outputs: 48, kernel: 3, stride: 1, dilation: 2 },
];

/// Cells along each side of each grid, the frame first.
pub const SIDES: [usize; DEPTH + 1] = [100, 50, 25, 25, 25];

/// Values of a cell that the votes are made of: per body a logit and an offset.
pub const MAPS: usize = 3 * BODIES;

/// Standard deviation of the vote layer's start.
const VOTE_START: f64 = 0.03;

/// All of the learned encoder.
#[derive(Debug, Clone, PartialEq)]
pub struct VoteWeights {
    /// The trunk, `[out, in, k, k]`.
    pub trunk: [Layer; DEPTH],
    /// The vote layer, `[6, 48, 1, 1]`: logit, offset x, offset y of the UAV, then of the obstacle.
    pub vote: Layer,
}

impl VoteWeights {
    /// Shapes of all layers, the vote layer last.
    #[must_use]
    pub fn shapes() -> [[usize; 4]; DEPTH + 1] {
        let conv = |c: &VoteConv| [c.outputs, c.inputs, c.kernel, c.kernel];
        let [a, b, c, d] = &TRUNK;
        [conv(a), conv(b), conv(c), conv(d), [MAPS, d.outputs, 1, 1]]
    }

    /// All zero.
    #[must_use]
    pub fn zeros() -> Self {
        let [a, b, c, d, vote] = Self::shapes().map(|shape| Layer::zeros(&shape));
        Self { trunk: [a, b, c, d], vote }
    }

    /// The random start: Kaiming's normal weights, N(0, 2/((1 + LEAK²) inputs)); the vote layer N(0, 0.03²);
    /// biases zero.
    #[must_use]
    pub fn random(noise: &Noise) -> Self {
        let mut rng = noise.generator(Stream::Weights, 8);
        let mut weights = Self::zeros();
        let mut fill = |layer: &mut Layer, deviation: f64| {
            for w in &mut layer.w {
                let deviate: f64 = StandardNormal.sample(&mut rng);
                *w = (deviation * deviate) as f32;
            }
        };
        for layer in &mut weights.trunk {
            let inputs = layer.w.len() / layer.b.len();
            fill(layer, (2.0 / (1.0 + f64::from(LEAK).powi(2)) / inputs as f64).sqrt());
        }
        fill(&mut weights.vote, VOTE_START);
        weights
    }

    /// The layers, the vote layer last.
    #[must_use]
    pub fn layers(&self) -> [&Layer; DEPTH + 1] {
        let [a, b, c, d] = &self.trunk;
        [a, b, c, d, &self.vote]
    }

    /// All trainable values, tensor by tensor in a fixed order.
    #[must_use]
    pub fn parts(&self) -> Vec<&[f32]> {
        self.layers().into_iter().flat_map(|l| [l.w.as_slice(), l.b.as_slice()]).collect()
    }

    /// The same, to be changed.
    pub fn parts_mut(&mut self) -> Vec<&mut [f32]> {
        let layers = self.trunk.iter_mut().chain([&mut self.vote]);
        layers.flat_map(|l| [l.w.as_mut_slice(), l.b.as_mut_slice()]).collect()
    }

    /// Number of trainable values.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.parts().iter().map(|part| part.len()).sum()
    }

    /// Floating point operations of a frame, twice the multiply-adds.
    #[must_use]
    pub fn operations() -> usize {
        let cells = |n: usize| SIDES[n.min(DEPTH - 1) + 1].pow(2);
        Self::shapes().iter().enumerate().map(|(n, s)| 2 * cells(n) * s.iter().product::<usize>()).sum()
    }
}

impl Stored for VoteWeights {
    fn put(&self, out: &mut Writer) {
        for (n, layer) in self.trunk.iter().enumerate() {
            put_layer(out, &format!("votes.conv{}", n + 1), layer);
        }
        put_layer(out, "votes.vote", &self.vote);
    }

    fn get(from: &Reader<'_>) -> Result<Self, TensorError> {
        let [a, b, c, d, vote] = Self::shapes();
        let conv = |n: usize, shape: [usize; 4]| get_layer(from, &format!("votes.conv{n}"), &shape);
        let trunk = [conv(1, a)?, conv(2, b)?, conv(3, c)?, conv(4, d)?];
        Ok(Self { trunk, vote: get_layer(from, "votes.vote", &vote)? })
    }
}
