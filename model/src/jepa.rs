//! The JEPA encoder as a burn module: four convolutions, pooling, 256 features, two latent heads.
//!
//! Training computes its features here, on the chosen backend, and a gradient stage uses the same
//! module twice, as online encoder and as its slowly following target. Knows weights and tensors;
//! knows neither losses nor data.

use burn::module::{Module, Param};
use burn::nn::PaddingConfig2d;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::pool::{AdaptiveAvgPool2d, AdaptiveAvgPool2dConfig};
use burn::nn::{Linear, LinearConfig};
use burn::tensor::activation::leaky_relu;
use burn::tensor::{Device, Tensor, TensorData};
use sitl::camera::{CHANNELS, Frame, SIDE};

use crate::infer::{Features, Latent};
use crate::weights::{CONVS, ConvShape, FEATURES, Input, LATENT, LEAK, Layer, Weights};

/// Which of burn's CPU backends computes.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// burn-flex, the default.
    #[default]
    Flex,
    /// burn-ndarray; slower, deprecated upstream.
    Ndarray,
}

/// The program was built without this backend.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("backend ndarray is not in this build: build with the cargo feature `ndarray`")]
pub struct NoBackend;

impl Backend {
    /// burn's handle of the backend.
    pub fn device(self) -> Result<Device, NoBackend> {
        match self {
            Self::Flex => Ok(Device::flex()),
            Self::Ndarray => ndarray(),
        }
    }

    /// Its name on the command line and in config.json.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Flex => "flex",
            Self::Ndarray => "ndarray",
        }
    }
}

#[cfg(feature = "ndarray")]
#[expect(deprecated, reason = "still works, and is asked for by the flag alone")]
fn ndarray() -> Result<Device, NoBackend> {
    Ok(Device::ndarray())
}

#[cfg(not(feature = "ndarray"))]
fn ndarray() -> Result<Device, NoBackend> {
    Err(NoBackend)
}

/// Pictures as the network reads them.
#[derive(Debug, Clone)]
pub struct Batch {
    /// [batch, 3, 100, 100], scaled by [`Input`].
    pub frames: Tensor<4>,
    /// q, the missing share of each colour: [batch, 3].
    pub missing: Tensor<2>,
}

impl Batch {
    /// Scales the pictures and puts them on the device.
    #[must_use]
    pub fn new(frames: &[Frame], input: &Input, device: &Device) -> Self {
        let mut x = Vec::with_capacity(frames.len() * CHANNELS * SIDE * SIDE);
        let mut missing = Vec::with_capacity(frames.len() * CHANNELS);
        for frame in frames {
            let sums = std::array::from_fn(|channel| {
                frame.rgb().iter().skip(channel).step_by(CHANNELS).map(|b| u32::from(*b)).sum()
            });
            let (factor, q) = input.factors(sums);
            for (channel, factor) in factor.into_iter().enumerate() {
                x.extend(frame.rgb().iter().skip(channel).step_by(CHANNELS).map(|b| f32::from(*b) * factor));
            }
            missing.extend(q);
        }
        let data = TensorData::new(x, [frames.len(), CHANNELS, SIDE, SIDE]);
        let missing = TensorData::new(missing, [frames.len(), CHANNELS]);
        Self { frames: Tensor::from_data(data, device), missing: Tensor::from_data(missing, device) }
    }
}

/// The encoder. Online and target are two of these.
#[derive(Module, Debug)]
pub struct Encoder {
    conv1: Conv2d,
    conv2: Conv2d,
    conv3: Conv2d,
    conv4: Conv2d,
    pool: AdaptiveAvgPool2d,
    fc: Linear,
    head_c: Linear,
    head_u: Linear,
}

impl Encoder {
    /// The module with these weights.
    #[must_use]
    pub fn new(weights: &Weights, device: &Device) -> Self {
        let [conv1, conv2, conv3, conv4] =
            std::array::from_fn(|n| conv_from(&weights.convs[n], &CONVS[n], device));
        Self {
            conv1,
            conv2,
            conv3,
            conv4,
            pool: AdaptiveAvgPool2dConfig::new([CONVS[3].grid_out; 2]).init(),
            fc: linear_from(&weights.fc, device),
            head_c: linear_from(&weights.head_c, device),
            head_u: linear_from(&weights.head_u, device),
        }
    }

    /// The module's weights; `input` is carried along, it is not trained.
    #[must_use]
    pub fn weights(&self, input: Input) -> Weights {
        let convs = [&self.conv1, &self.conv2, &self.conv3, &self.conv4];
        Weights {
            input,
            convs: convs.map(layer_of_conv),
            fc: layer_of_linear(&self.fc),
            head_c: layer_of_linear(&self.head_c),
            head_u: layer_of_linear(&self.head_u),
        }
    }

    /// h of a batch: [batch, 3, 100, 100] -> [batch, 256].
    #[must_use]
    pub fn features(&self, frames: Tensor<4>) -> Tensor<2> {
        let mut x = frames;
        for conv in [&self.conv1, &self.conv2, &self.conv3, &self.conv4] {
            x = leaky_relu(conv.forward(x), f64::from(LEAK)); // 26², 14², 8², 5²
        }
        self.fc.forward(self.pool.forward(x).flatten(1, 3)) // [batch, 3200] -> [batch, 256]
    }

    /// z_c and z_u of a batch, [batch, 16] each.
    #[must_use]
    pub fn forward(&self, batch: &Batch) -> (Tensor<2>, Tensor<2>) {
        let h = self.features(batch.frames.clone());
        let z_u = self.head_u.forward(h.clone());
        let gated = self.head_c.weight.dims()[0] == 2 * FEATURES;
        let q = batch.missing.clone().narrow(1, 0, 1); // [batch, 1]
        let x = if gated { Tensor::cat(vec![h.clone(), h * q], 1) } else { h };
        (self.head_c.forward(x), z_u)
    }

    /// φ_tar ← τ φ_tar + (1-τ) φ, as the target that follows `online`.
    #[must_use]
    pub fn follow(mut self, online: &Self, tau: f64) -> Self {
        let mix = |target: Param<Tensor<4>>, online: &Param<Tensor<4>>| {
            target.map(|t| t * tau + online.val().detach() * (1.0 - tau))
        };
        let mix1 = |target: Option<Param<Tensor<1>>>, online: &Option<Param<Tensor<1>>>| {
            let online = online.as_ref()?.val().detach();
            Some(target?.map(|t| t * tau + online * (1.0 - tau)))
        };
        let mix2 = |target: Param<Tensor<2>>, online: &Param<Tensor<2>>| {
            target.map(|t| t * tau + online.val().detach() * (1.0 - tau))
        };
        for (target, online) in [
            (&mut self.conv1, &online.conv1),
            (&mut self.conv2, &online.conv2),
            (&mut self.conv3, &online.conv3),
            (&mut self.conv4, &online.conv4),
        ] {
            target.weight = mix(target.weight.clone(), &online.weight);
            target.bias = mix1(target.bias.clone(), &online.bias);
        }
        for (target, online) in [
            (&mut self.fc, &online.fc),
            (&mut self.head_c, &online.head_c),
            (&mut self.head_u, &online.head_u),
        ] {
            target.weight = mix2(target.weight.clone(), &online.weight);
            target.bias = mix1(target.bias.clone(), &online.bias);
        }
        self
    }
}

/// h and q of many pictures, `draw`n and computed in batches of `size` on the module's device.
pub fn features_of<T>(
    encoder: &Encoder,
    input: &Input,
    device: &Device,
    scenes: &[T],
    size: usize,
    draw: impl Fn(&T) -> Frame,
    mut tick: impl FnMut(usize),
) -> Vec<Features> {
    let mut out = Vec::with_capacity(scenes.len());
    for scenes in scenes.chunks(size.max(1)) {
        let frames: Vec<Frame> = scenes.iter().map(&draw).collect();
        let batch = Batch::new(&frames, input, device);
        let h = values(encoder.features(batch.frames));
        let q = values(batch.missing);
        for (h, q) in h.chunks_exact(FEATURES).zip(q.chunks_exact(CHANNELS)) {
            out.push(Features { h: h.to_vec(), missing: std::array::from_fn(|k| q[k]) });
        }
        tick(scenes.len());
    }
    out
}

/// The latents of some pictures by burn.
#[must_use]
pub fn latents_of(encoder: &Encoder, input: &Input, device: &Device, frames: &[Frame]) -> Vec<Latent> {
    let (c, u) = encoder.forward(&Batch::new(frames, input, device));
    let (c, u) = (values(c), values(u));
    let half = |v: &[f32], n: usize| std::array::from_fn(|k| v[n * LATENT + k]);
    (0..frames.len()).map(|n| Latent { z_c: half(&c, n), z_u: half(&u, n) }).collect()
}

/// A tensor's values, row by row.
#[must_use]
pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().iter::<f32>().collect()
}

fn parameter<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Param<Tensor<D>> {
    Param::from_data(TensorData::new(values, shape), device)
}

fn conv_from(layer: &Layer, shape: &ConvShape, device: &Device) -> Conv2d {
    let ConvShape { inputs, outputs, kernel, stride, padding, .. } = *shape;
    let mut conv = Conv2dConfig::new([inputs, outputs], [kernel; 2])
        .with_stride([stride; 2])
        .with_padding(PaddingConfig2d::Explicit(padding, padding, padding, padding))
        .with_initializer(burn::nn::Initializer::Zeros)
        .init(device);
    conv.weight = parameter(layer.w.clone(), [outputs, inputs, kernel, kernel], device);
    conv.bias = Some(parameter(layer.b.clone(), [outputs], device));
    conv
}

/// burn keeps a linear layer as [in, out].
fn linear_from(layer: &Layer, device: &Device) -> Linear {
    let (outputs, inputs) = (layer.shape[0], layer.shape[1]);
    let mut linear =
        LinearConfig::new(inputs, outputs).with_initializer(burn::nn::Initializer::Zeros).init(device);
    linear.weight = parameter(transposed(&layer.w, outputs, inputs), [inputs, outputs], device);
    linear.bias = Some(parameter(layer.b.clone(), [outputs], device));
    linear
}

fn layer_of_conv(conv: &Conv2d) -> Layer {
    let bias = conv.bias.as_ref().map_or_else(Vec::new, |b| values(b.val()));
    Layer { shape: conv.weight.dims().to_vec(), w: values(conv.weight.val()), b: bias }
}

fn layer_of_linear(linear: &Linear) -> Layer {
    let [inputs, outputs] = linear.weight.dims();
    let bias = linear.bias.as_ref().map_or_else(Vec::new, |b| values(b.val()));
    Layer {
        shape: vec![outputs, inputs],
        w: transposed(&values(linear.weight.val()), inputs, outputs),
        b: bias,
    }
}

fn transposed(w: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    (0..columns).flat_map(|c| (0..rows).map(move |r| w[r * columns + c])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use sitl::scenario::Scenario;
    use sitl::world::noise::Noise;

    fn weights() -> Weights {
        let input = Input::new(&Scenario::default(), [true, false, true]);
        let mut weights = Weights::initial(input, 0.03, true, &Noise::new(2));
        // Heads and biases that are not zero, so that nothing hides behind a zero.
        for (k, w) in weights.head_c.w.iter_mut().chain(&mut weights.head_u.w).enumerate() {
            *w = ((k as f32) * 0.37).sin() * 0.1;
        }
        for (k, b) in weights.convs.iter_mut().flat_map(|l| &mut l.b).enumerate() {
            *b = ((k as f32) * 0.11).sin() * 0.05;
        }
        weights
    }

    fn frames() -> Vec<Frame> {
        let places =
            [(0.5, 0.5, 0.3, 0.7), (1.0, 0.2, 0.6, 0.4), (0.0, 0.0, 0.2, 0.2), (0.31, 0.36, 0.3, 0.4)];
        places
            .iter()
            .map(|p| {
                sitl::camera::render(Vector2::new(p.0, p.1), Vector2::new(p.2, p.3), &Scenario::default())
            })
            .chain([Frame::black()])
            .collect()
    }

    /// Largest difference over the largest value, both halves.
    fn apart(a: &[Latent], b: &[Latent]) -> f32 {
        let flat =
            |l: &[Latent]| -> Vec<f32> { l.iter().flat_map(|l| l.z_c.into_iter().chain(l.z_u)).collect() };
        let (a, b) = (flat(a), flat(b));
        let size = a.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        a.iter().zip(&b).fold(0.0f32, |m, (a, b)| m.max((a - b).abs())) / size
    }

    fn by_burn(backend: Backend) -> Vec<Latent> {
        let (weights, device) = (weights(), backend.device().unwrap());
        latents_of(&Encoder::new(&weights, &device), &weights.input, &device, &frames())
    }

    #[test]
    fn the_flight_path_computes_what_burn_computes() {
        let encoder = crate::infer::Encoder::new(weights());
        let own: Vec<Latent> = frames().iter().map(|f| encoder.encode(f)).collect();
        let off = apart(&by_burn(Backend::Flex), &own);
        assert!(off < 1e-4, "flex is off by {off}");
    }

    #[cfg(feature = "ndarray")]
    #[test]
    fn both_backends_agree() {
        let off = apart(&by_burn(Backend::Flex), &by_burn(Backend::Ndarray));
        assert!(off < 1e-4, "ndarray is off by {off}");
    }

    #[test]
    fn weights_survive_the_module() {
        let device = Backend::Flex.device().unwrap();
        let weights = weights();
        assert_eq!(Encoder::new(&weights, &device).weights(weights.input), weights);
    }

    #[test]
    fn a_target_follows_by_one_minus_tau() {
        let device = Backend::Flex.device().unwrap();
        let online = weights();
        let mut still = online.clone();
        still.fc.w.fill(0.0);
        let target = Encoder::new(&still, &device).follow(&Encoder::new(&online, &device), 0.75);
        let moved = target.weights(online.input);
        assert!((moved.fc.w[17] - 0.25 * online.fc.w[17]).abs() < 1e-7);
        assert!((moved.convs[2].w[5] - online.convs[2].w[5]).abs() < 1e-7);
    }
}
