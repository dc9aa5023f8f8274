//! The learned encoder as a burn module: the same sums on any of burn's devices, with burn's gradients. The tests
//! hold [`super::network`] against it, and `model train --device` trains with it.

use burn::module::{Module, Param};
use burn::nn::PaddingConfig2d;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::activation::{leaky_relu, log_softmax};
use burn::tensor::{Device, Tensor, TensorData};
use crpl_sitl::camera::{CHANNELS, SIDE};

use crate::encoder::module::{gradient_of, values};
use crate::encoder::votes::BODIES;
use crate::encoder::votes::network::INPUT_SCALE;
use crate::encoder::votes::readout::{CELLS, PITCH, SHARPNESS, Votes, VotesGradient};
use crate::encoder::votes::weights::{TRUNK, VoteWeights};
use crate::encoder::weights::{LEAK, Layer};

/// The learned encoder in burn.
#[derive(Module, Debug)]
pub struct VoteModule {
    trunk: Vec<Conv2d>,
    vote: Conv2d,
}

/// What the module makes of a batch, kept for the gradient.
#[derive(Debug)]
pub struct VoteBatch {
    /// p, `[batch, 2 bodies, 2, 1]`.
    p: Tensor<4>,
    /// Votes less p held still, squared, weighed: `[batch, 2 bodies]`.
    spread: Tensor<2>,
    evidence: Tensor<2>,
}

impl VoteModule {
    /// The module with these weights.
    #[must_use]
    pub fn new(weights: &VoteWeights, device: &Device) -> Self {
        let conv = |layer: &Layer, stride: usize, dilation: usize| {
            let [outputs, inputs, kernel, _] = [0, 1, 2, 3].map(|k| layer.shape[k]);
            let reach = kernel / 2 * dilation;
            let mut conv = Conv2dConfig::new([inputs, outputs], [kernel; 2])
                .with_stride([stride; 2])
                .with_dilation([dilation; 2])
                .with_padding(PaddingConfig2d::Explicit(reach, reach, reach, reach))
                .with_initializer(burn::nn::Initializer::Zeros)
                .init(device);
            let shape = [outputs, inputs, kernel, kernel];
            conv.weight = Param::from_data(TensorData::new(layer.w.clone(), shape), device);
            conv.bias = Some(Param::from_data(TensorData::new(layer.b.clone(), [outputs]), device));
            conv
        };
        let trunk = weights.trunk.iter().zip(&TRUNK).map(|(l, c)| conv(l, c.stride, c.dilation)).collect();
        Self { trunk, vote: conv(&weights.vote, 1, 1) }
    }

    /// The forward pass of pictures `[batch][100][100][3]`, values 0 to 255.
    #[must_use]
    pub fn forward(&self, pixels: &[&[f32]], device: &Device) -> VoteBatch {
        let count = pixels.len();
        let mut x = Vec::with_capacity(count * CHANNELS * SIDE * SIDE);
        for picture in pixels {
            for channel in 0..CHANNELS {
                x.extend(picture.iter().skip(channel).step_by(CHANNELS).map(|v| v * (1.0 / INPUT_SCALE)));
            }
        }
        let mut x = Tensor::<4>::from_data(TensorData::new(x, [count, CHANNELS, SIDE, SIDE]), device);
        for conv in &self.trunk {
            x = leaky_relu(conv.forward(x), f64::from(LEAK));
        }
        let cells = CELLS * CELLS;
        // [batch, 6, 25, 25] -> [batch, 2 bodies, 3, 625]
        let maps = self.vote.forward(x).reshape([count, BODIES, 3, cells]);
        let logits = maps.clone().narrow(2, 0, 1).mul_scalar(SHARPNESS); // [batch, 2, 1, 625]
        let log_w = log_softmax(logits.clone(), 3);
        let w = log_w.clone().exp();
        let centre = |k: usize| PITCH * k as f32 + 0.5;
        let grid: Vec<f32> =
            (0..cells).map(|n| centre(n % CELLS)).chain((0..cells).map(|n| centre(n / CELLS))).collect();
        let grid = Tensor::<4>::from_data(TensorData::new(grid, [1, 1, 2, cells]), device);
        let votes = maps.narrow(2, 1, 2).mul_scalar(PITCH) + grid; // [batch, 2, 2, 625]
        let p = (votes.clone() * w.clone()).sum_dim(3);
        let apart = (votes - p.clone().detach()).square().sum_dim(2);
        let spread = (apart * w).sum_dim(3).reshape([count, BODIES]);
        // log Σ exp(l) = l - log w, in every cell.
        let evidence = (logits - log_w).narrow(3, 0, 1).reshape([count, BODIES]);
        VoteBatch { p, spread, evidence }
    }

    /// The gradient by the weights of a loss with these gradients by the batch's votes.
    #[must_use]
    pub fn backward(&self, batch: VoteBatch, by: &[VotesGradient], device: &Device) -> VoteWeights {
        let count = by.len();
        let flat: Vec<f32> = by.iter().flat_map(|g| g.p.into_iter().flatten()).collect();
        let by_p = Tensor::<4>::from_data(TensorData::new(flat, [count, BODIES, 2, 1]), device);
        let flat: Vec<f32> = by.iter().flat_map(|g| g.spread).collect();
        let by_spread = Tensor::<2>::from_data(TensorData::new(flat, [count, BODIES]), device);
        let loss = (batch.p * by_p).sum() + (batch.spread * by_spread).sum();
        let gradients = loss.backward();
        let layer = |conv: &Conv2d| Layer {
            shape: conv.weight.dims().to_vec(),
            w: gradient_of(&conv.weight.val(), &gradients),
            b: conv.bias.as_ref().map_or_else(Vec::new, |b| gradient_of(&b.val(), &gradients)),
        };
        let mut out = VoteWeights::zeros();
        for (into, conv) in out.trunk.iter_mut().zip(&self.trunk) {
            *into = layer(conv);
        }
        out.vote = layer(&self.vote);
        out
    }
}

impl VoteBatch {
    /// The votes of every picture.
    #[must_use]
    pub fn votes(&self) -> Vec<Votes> {
        let [p, spread, evidence] =
            [values(self.p.clone()), values(self.spread.clone()), values(self.evidence.clone())];
        let each = spread.chunks_exact(BODIES).zip(evidence.chunks_exact(BODIES));
        p.chunks_exact(2 * BODIES)
            .zip(each)
            .map(|(p, (s, e))| Votes {
                p: [[p[0], p[1]], [p[2], p[3]]],
                spread: [s[0], s[1]],
                evidence: [e[0], e[1]],
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::world::noise::{Noise, Stream};
    use rand::RngExt;

    use super::*;
    use crate::encoder::module::Backend;
    use crate::encoder::votes::network::Scratch;
    use crate::encoder::votes::{Activations, VoteEncoder, VoteGradient};

    /// Our passes and burn's on the same noisy pictures and random weights.
    #[test]
    fn forward_and_backward_are_burns() {
        let weights = VoteWeights::random(&Noise::new(4));
        let mut rng = Noise::new(5).generator(Stream::Evaluation, 0);
        let pictures: Vec<Vec<f32>> =
            (0..3).map(|_| (0..30_000).map(|_| 255.0 * rng.random::<f32>()).collect()).collect();
        let by: Vec<VotesGradient> = (0..3)
            .map(|k| VotesGradient { p: [[0.3, -0.2 * k as f32], [0.1, 0.25]], spread: [0.002, -0.003] })
            .collect();
        let device = Backend::Flex.device().unwrap().autodiff();
        let module = VoteModule::new(&weights, &device);
        let pixels: Vec<&[f32]> = pictures.iter().map(Vec::as_slice).collect();
        let batch = module.forward(&pixels, &device);
        let theirs = batch.votes();
        let theirs_gradient = module.backward(batch, &by, &device);

        let encoder = VoteEncoder::new(weights);
        let (mut gradient, mut scratch) = (VoteGradient::default(), Scratch::default());
        for ((picture, by), theirs) in pictures.iter().zip(&by).zip(&theirs) {
            let mut activations = Activations::default();
            activations.set_pixels(picture.iter().copied());
            let own = encoder.forward(&mut activations);
            for body in 0..BODIES {
                for axis in 0..2 {
                    assert!((own.p[body][axis] - theirs.p[body][axis]).abs() < 1e-3, "{own:?} {theirs:?}");
                }
                assert!((own.spread[body] / theirs.spread[body] - 1.0).abs() < 1e-4, "{own:?} {theirs:?}");
                assert!((own.evidence[body] - theirs.evidence[body]).abs() < 1e-4, "{own:?} {theirs:?}");
            }
            encoder.backward(&activations, by, &mut scratch, &mut gradient);
        }
        let own = gradient.unpacked();
        for (n, (own, theirs)) in own.parts().into_iter().zip(theirs_gradient.parts()).enumerate() {
            let size = theirs.iter().map(|v| v.abs()).fold(0.0f32, f32::max);
            for (a, b) in own.iter().zip(theirs) {
                assert!((a - b).abs() < 2e-4 * size, "part {n}: {a} instead of {b}, largest {size}");
            }
        }
    }
}
