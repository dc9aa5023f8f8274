//! The JEPA encoder as a burn module: four convolutions, pooling, 256 features, two latent heads.
//!
//! Training computes its features here, on the chosen backend, and a gradient stage uses the same
//! module twice, as online encoder and as its slowly following target. Knows weights and tensors;
//! knows neither losses nor data.

use burn::module::{Module, Param};
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::pool::{AdaptiveAvgPool2d, AdaptiveAvgPool2dConfig};
use burn::nn::{Linear, LinearConfig, PaddingConfig2d};
use burn::tensor::activation::{leaky_relu, relu};
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use crpl_sitl::camera::{CHANNELS, Frame, SIDE};

use crate::encoder::infer::{Features, Latent};
use crate::encoder::weights::{CONVS, Colour, ConvShape, FEATURES, Input, LATENT, LEAK, Layer, Weights};

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

/// The program was built without this backend or device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{kind} {name} is not in this build: build with the cargo feature `{name}`")]
pub struct NoBackend {
    /// `backend` or `device`.
    pub kind: &'static str,
    /// Its name, and that of the cargo feature.
    pub name: &'static str,
}

impl Backend {
    /// burn's handle of the backend.
    ///
    /// # Errors
    /// If the backend is not in this build.
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
    Err(NoBackend { kind: "backend", name: "ndarray" })
}

/// Frames as the network reads them.
#[derive(Debug, Clone)]
pub struct Batch {
    /// `[batch, 3, 100, 100]`, scaled by [`Input`], or in 0..=1 where a colour layer comes first.
    pub frames: Tensor<4>,
    /// q, the missing share of each colour: `[batch, 3]`. A colour layer finds its own.
    pub missing: Tensor<2>,
}

/// What the trunk makes of a batch.
#[derive(Debug, Clone)]
pub struct Trunk {
    /// h, `[batch, 256]`.
    pub h: Tensor<2>,
    /// q, the missing share of each colour, `[batch, 3]`.
    pub missing: Tensor<2>,
}

impl Batch {
    /// Scales the frames and puts them on the device.
    #[must_use]
    pub fn new(frames: &[Frame], input: &Input, device: &Device) -> Self {
        let mut x = Vec::with_capacity(frames.len() * CHANNELS * SIDE * SIDE);
        let mut missing = Vec::with_capacity(frames.len() * CHANNELS);
        for frame in frames {
            let sums = std::array::from_fn(|channel| {
                frame.rgb().iter().skip(channel).step_by(CHANNELS).map(|b| u32::from(*b)).sum()
            });
            let (factor, q) = match input.colour {
                None => input.factors(sums),
                Some(_) => ([1.0 / 255.0; CHANNELS], [0.0; CHANNELS]),
            };
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
pub struct EncoderModule {
    /// 3 -> 2, pixel by pixel.
    colour: Option<Linear>,
    #[module(skip)]
    input: Input,
    conv1: Conv2d,
    conv2: Conv2d,
    conv3: Conv2d,
    conv4: Conv2d,
    pool: AdaptiveAvgPool2d,
    fc: Linear,
    head_c: Linear,
    head_u: Linear,
}

impl EncoderModule {
    /// The module with these weights.
    #[must_use]
    pub fn new(weights: &Weights, device: &Device) -> Self {
        let [conv1, conv2, conv3, conv4] =
            std::array::from_fn(|n| conv_from(&weights.convs[n], &CONVS[n], device));
        let colour = weights.input.colour.map(|c| {
            let w = c.w.as_flattened().to_vec();
            linear_from(&Layer { shape: vec![2, CHANNELS], w, b: c.b.to_vec() }, device)
        });
        Self {
            colour,
            input: weights.input,
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

    /// The module's weights.
    #[must_use]
    pub fn weights(&self) -> Weights {
        let convs = [&self.conv1, &self.conv2, &self.conv3, &self.conv4];
        let mut input = self.input;
        if let (Some(linear), Some(colour)) = (&self.colour, &mut input.colour) {
            let layer = layer_of_linear(linear);
            colour.w.as_flattened_mut().copy_from_slice(&layer.w);
            colour.b.copy_from_slice(&layer.b);
        }
        Weights {
            input,
            convs: convs.map(layer_of_conv),
            fc: layer_of_linear(&self.fc),
            head_c: layer_of_linear(&self.head_c),
            head_u: layer_of_linear(&self.head_u),
        }
    }

    /// h and q of a batch.
    #[must_use]
    pub fn trunk(&self, batch: &Batch) -> Trunk {
        let (mut x, missing) = match &self.colour {
            None => (batch.frames.clone(), batch.missing.clone()),
            Some(layer) => self.unmixed(layer, batch),
        };
        for conv in [&self.conv1, &self.conv2, &self.conv3, &self.conv4] {
            x = leaky_relu(conv.forward(x), f64::from(LEAK)); // 26², 14², 8², 5²
        }
        let h = self.fc.forward(self.pool.forward(x).flatten(1, 3)); // [batch, 3200] -> [batch, 256]
        Trunk { h, missing }
    }

    /// z_c and z_u of a batch, `[batch, 16]` each.
    #[must_use]
    pub fn forward(&self, batch: &Batch) -> (Tensor<2>, Tensor<2>) {
        let Trunk { h, missing } = self.trunk(batch);
        let z_u = self.head_u.forward(h.clone());
        let gated = self.head_c.weight.dims()[0] == 2 * FEATURES;
        let q = missing.narrow(1, 0, 1); // [batch, 1]
        let x = if gated { Tensor::cat(vec![h.clone(), h * q], 1) } else { h };
        (self.head_c.forward(x), z_u)
    }

    /// The same encoder, of whose trunk nothing but the colour layer learns.
    #[must_use]
    pub fn with_a_still_trunk(mut self) -> Self {
        self.conv1 = self.conv1.no_grad();
        self.conv2 = self.conv2.no_grad();
        self.conv3 = self.conv3.no_grad();
        self.conv4 = self.conv4.no_grad();
        self.fc = self.fc.no_grad();
        self
    }

    /// The same encoder, whose latent heads do not learn.
    #[must_use]
    pub fn with_still_heads(mut self) -> Self {
        self.head_c = self.head_c.no_grad();
        self.head_u = self.head_u.no_grad();
        self
    }

    /// The colour layer, then each channel over its own mass: `[batch, 3, 100, 100]` in 0..=1 to the
    /// trunk's input, and q `[batch, 3]`.
    fn unmixed(&self, layer: &Linear, batch: &Batch) -> (Tensor<4>, Tensor<2>) {
        let [count, ..] = batch.frames.dims();
        let pixels = batch.frames.clone().reshape([count, CHANNELS, SIDE * SIDE]);
        let w = layer.weight.val().transpose().unsqueeze::<3>(); // [1, 2, 3]
        let mut y = w.expand([count, 2, CHANNELS]).matmul(pixels); // [batch, 2, 10000]
        if let Some(b) = &layer.bias {
            y = y + b.val().reshape([1, 2, 1]);
        }
        let y = relu(y);
        let own = y.clone().sum_dim(2); // [batch, 2, 1]
        let constants = |values: [f32; CHANNELS]| {
            let pair = Colour::CHANNELS.map(|k| values[k]);
            Tensor::<3>::from_data(TensorData::new(pair.to_vec(), [1, 2, 1]), &y.device())
        };
        let (whole, scale) = (constants(self.input.whole_mass), constants(self.input.scale));
        // A channel without mass is black: it stays so, and misses nothing.
        let lit = own.clone().greater_elem(0.0).float();
        let ratio = whole.clone() / (own.clone() + (lit.clone().neg() + 1.0));
        let x = y * (ratio / scale);
        let q = (own / whole).neg().add_scalar(1.0) * lit;
        let side = [count, 1, SIDE, SIDE];
        let channel = |k: usize| x.clone().narrow(1, k, 1).reshape(side);
        let green = Tensor::zeros(side, &x.device());
        let q_of = |k: usize| q.clone().narrow(1, k, 1).reshape([count, 1]);
        let none = Tensor::zeros([count, 1], &x.device());
        (Tensor::cat(vec![channel(0), green, channel(1)], 1), Tensor::cat(vec![q_of(0), none, q_of(1)], 1))
    }

    /// The gradients of the values that [`Weights::parts`] lists, in its order; zeros where there is
    /// none.
    #[must_use]
    pub fn gradients(&self, gradients: &Gradients) -> Weights {
        let conv = |c: &Conv2d| Layer {
            shape: c.weight.dims().to_vec(),
            w: gradient_of(&c.weight.val(), gradients),
            b: c.bias.as_ref().map_or_else(Vec::new, |b| gradient_of(&b.val(), gradients)),
        };
        let linear = |l: &Linear| {
            let [inputs, outputs] = l.weight.dims();
            Layer {
                shape: vec![outputs, inputs],
                w: transposed(&gradient_of(&l.weight.val(), gradients), inputs, outputs),
                b: l.bias.as_ref().map_or_else(Vec::new, |b| gradient_of(&b.val(), gradients)),
            }
        };
        let mut input = self.input;
        if let (Some(layer), Some(colour)) = (&self.colour, &mut input.colour) {
            let layer = linear(layer);
            colour.w.as_flattened_mut().copy_from_slice(&layer.w);
            colour.b.copy_from_slice(&layer.b);
        }
        Weights {
            input,
            convs: [&self.conv1, &self.conv2, &self.conv3, &self.conv4].map(conv),
            fc: linear(&self.fc),
            head_c: linear(&self.head_c),
            head_u: linear(&self.head_u),
        }
    }
}

/// A tensor's gradient, row by row; zeros where it has none.
pub fn gradient_of<const D: usize>(tensor: &Tensor<D>, gradients: &Gradients) -> Vec<f32> {
    let count = tensor.shape().num_elements();
    tensor.grad(gradients).map_or_else(|| vec![0.0; count], values)
}
/// h and q of many frames, `draw`n and computed in batches of `size` on the module's device.
pub fn features_of<T>(
    encoder: &EncoderModule,
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
        let Trunk { h, missing } = encoder.trunk(&batch);
        let (h, q) = (values(h), values(missing));
        for (h, q) in h.chunks_exact(FEATURES).zip(q.chunks_exact(CHANNELS)) {
            out.push(Features { h: h.to_vec(), missing: std::array::from_fn(|k| q[k]) });
        }
        tick(scenes.len());
    }
    out
}

/// The latents of some frames by burn.
#[must_use]
pub fn latents_of(encoder: &EncoderModule, input: &Input, device: &Device, frames: &[Frame]) -> Vec<Latent> {
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

/// burn keeps a linear layer as `[in, out]`.
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
    use crpl_sitl::scenario::Scenario;
    use crpl_sitl::world::noise::Noise;
    use nalgebra::Vector2;

    fn weights() -> Weights {
        with_input(Input::new(&Scenario::default(), [true, false, true]))
    }

    fn with_colour() -> Weights {
        let w = [[1.0, -0.3, 0.1], [-0.2, 0.1, 0.9]];
        let colour = Some(Colour { w, b: [-0.03, -0.05] });
        with_input(Input { colour, ..Input::new(&Scenario::default(), [true, false, true]) })
    }

    fn with_input(input: Input) -> Weights {
        let mut weights = Weights::structured_init(input, 0.03, true, &Noise::new(2));
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
                crpl_sitl::camera::render(
                    Vector2::new(p.0, p.1),
                    Vector2::new(p.2, p.3),
                    &Scenario::default(),
                )
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

    fn by_burn(backend: Backend, weights: &Weights) -> Vec<Latent> {
        let device = backend.device().unwrap();
        latents_of(&EncoderModule::new(weights, &device), &weights.input, &device, &frames())
    }

    #[test]
    fn the_flight_path_computes_what_burn_computes() {
        for weights in [weights(), with_colour()] {
            let encoder = crate::encoder::infer::Encoder::new(weights.clone());
            let own: Vec<Latent> = frames().iter().map(|f| encoder.encode(f)).collect();
            let off = apart(&by_burn(Backend::Flex, &weights), &own);
            assert!(off < 1e-4, "flex is off by {off}");
        }
    }

    #[cfg(feature = "ndarray")]
    #[test]
    fn both_backends_agree() {
        for weights in [weights(), with_colour()] {
            let off = apart(&by_burn(Backend::Flex, &weights), &by_burn(Backend::Ndarray, &weights));
            assert!(off < 1e-4, "ndarray is off by {off}");
        }
    }

    #[test]
    fn weights_survive_the_module() {
        let device = Backend::Flex.device().unwrap();
        for weights in [weights(), with_colour()] {
            assert_eq!(EncoderModule::new(&weights, &device).weights(), weights);
        }
    }
}
