//! The encoder's numbers as plain arrays: the form in which burn's module, the flight path and the
//! checkpoint exchange them, and the structured initialisation.
//!
//! Knows shapes and start values; computes no frame.

use crpl_sitl::camera::{CHANNELS, SIDE};
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use crate::numeric::tensors::{Reader, Stored, TensorError, Writer};

/// Length of z_c and of z_u.
pub const LATENT: usize = 16;

/// Length of h, the features before the two latent heads.
pub const FEATURES: usize = 256;

/// Slope of the LeakyReLU below zero.
pub const LEAK: f32 = 0.1;

/// Geometry of one convolution: square kernel, equal stride and zero padding on both axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConvShape {
    /// Channels in.
    pub inputs: usize,
    /// Channels out.
    pub outputs: usize,
    /// Kernel side.
    pub kernel: usize,
    /// Stride.
    pub stride: usize,
    /// Zeros added on each side.
    pub padding: usize,
    /// Cells along each side of the input.
    pub grid_in: usize,
    /// Cells along each side of the output.
    pub grid_out: usize,
}

const fn conv(
    inputs: usize,
    outputs: usize,
    kernel: usize,
    stride: usize,
    padding: usize,
    grid_in: usize,
) -> ConvShape {
    let grid_out = (grid_in + 2 * padding - kernel) / stride + 1;
    ConvShape { inputs, outputs, kernel, stride, padding, grid_in, grid_out }
}

/// The trunk. Strides and padding are chosen so that every grid covers the whole frame.
pub const CONVS: [ConvShape; 4] = [
    conv(CHANNELS, 32, 7, 4, 4, SIDE), // 100 -> 26
    conv(32, 64, 3, 2, 2, 26),         // 26 -> 14
    conv(64, 96, 3, 2, 2, 14),         // 14 -> 8
    conv(96, 128, 3, 2, 2, 8),         // 8 -> 5
];

/// Length of the pooled trunk: 128 channels on a 5x5 grid.
pub const POOLED: usize = 128 * 5 * 5;

/// Weight and bias of a convolution `[out, in, k, k]` or a linear layer `[out, in]`, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Shape of `w`.
    pub shape: Vec<usize>,
    /// Weight.
    pub w: Vec<f32>,
    /// Bias, `[out]`.
    pub b: Vec<f32>,
}

impl Layer {
    /// A layer of zeros.
    #[must_use]
    pub fn zeros(shape: &[usize]) -> Self {
        Self { shape: shape.to_vec(), w: vec![0.0; shape.iter().product()], b: vec![0.0; shape[0]] }
    }
}

/// How bytes become the network's input, per colour channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Input {
    /// Divisor of x/255: square root of the mean coverage, so that both bodies weigh alike.
    pub scale: [f32; CHANNELS],
    /// Sum of a whole disc's coverage, px; 0 leaves the channel as it is. A channel is multiplied by
    /// its whole mass over its own sum, so that the trunk carries centres of mass, not moments: a disc
    /// that the frame's edge cuts keeps its place.
    pub whole_mass: [f32; CHANNELS],
    /// The learned colour layer in front of it, where there is one.
    pub colour: Option<Colour>,
}

/// A learned 1x1 layer: y = max(0, W x/255 + b) takes the place of red and blue, green stays empty.
/// W separates the bodies' colours, and b, negative, is a threshold below which background and pixel
/// noise vanish before a lever arm multiplies them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Colour {
    /// W, `[out][RGB]`.
    pub w: [[f32; CHANNELS]; 2],
    /// b
    pub b: [f32; 2],
}

impl Colour {
    /// The colour layer's outputs, as the trunk's channels.
    pub const CHANNELS: [usize; 2] = [0, 2];

    /// Red and blue pass, less a threshold of `threshold` (of a full channel).
    #[must_use]
    pub fn passing(threshold: f32) -> Self {
        Self { w: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], b: [-threshold; 2] }
    }

    /// y of one pixel of three bytes.
    #[inline(always)]
    #[must_use]
    pub fn apply(&self, pixel: &[u8]) -> [f32; 2] {
        let x = [0, 1, 2].map(|k| f32::from(pixel[k]) * (1.0 / 255.0));
        [0, 1].map(|o| {
            let w = &self.w[o];
            let sum = x[2].mul_add(w[2], x[1].mul_add(w[1], x[0].mul_add(w[0], self.b[o])));
            sum.max(0.0)
        })
    }
}

impl Input {
    /// The scaling for this camera and these bodies: red is the UAV, blue the obstacle.
    #[must_use]
    pub fn new(scenario: &Scenario, normalise: [bool; CHANNELS]) -> Self {
        let px = SIDE as f64;
        let area = |radius: f64| {
            let (r, w) = (radius * px, scenario.camera.edge_px);
            std::f64::consts::PI * (r * r + w * w / 12.0)
        };
        let masses = [area(scenario.uav_radius), 0.0, area(scenario.obstacle().radius)];
        let share = |mass: f64, filled: f64| ((mass / (px * px)) * filled).sqrt() as f32;
        let mut whole_mass = [0.0; CHANNELS];
        for (channel, mass) in masses.into_iter().enumerate() {
            if normalise[channel] {
                whole_mass[channel] = mass as f32;
            }
        }
        Self { scale: [share(masses[0], 0.8), 1.0, share(masses[2], 0.9)], whole_mass, colour: None }
    }

    /// Factor from byte to input, and the missing share q = 1 - own mass / whole mass, per channel,
    /// of a frame whose bytes sum to `sums`. An empty channel has factor 1/(255 scale) and q = 0.
    #[must_use]
    pub fn factors(&self, sums: [u32; CHANNELS]) -> ([f32; CHANNELS], [f32; CHANNELS]) {
        self.factors_of(sums.map(|sum| sum as f32), 255.0)
    }

    /// The same of values that are `full` where a disc covers a pixel.
    #[must_use]
    pub fn factors_of(&self, sums: [f32; CHANNELS], full: f32) -> ([f32; CHANNELS], [f32; CHANNELS]) {
        let (mut factor, mut missing) = ([0.0; CHANNELS], [0.0; CHANNELS]);
        for channel in 0..CHANNELS {
            let plain = 1.0 / (full * self.scale[channel]);
            let whole = full * self.whole_mass[channel];
            let own = sums[channel];
            if whole > 0.0 && own > 0.0 {
                factor[channel] = plain * (whole / own);
                missing[channel] = 1.0 - own / whole;
            } else {
                factor[channel] = plain;
            }
        }
        (factor, missing)
    }
}

/// All of the encoder.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// Bytes to input.
    pub input: Input,
    /// The trunk's convolutions.
    pub convs: [Layer; 4],
    /// 3200 -> 256, without activation.
    pub fc: Layer,
    /// To z_c: `[16, 256]`, or `[16, 512]` where q h stands beside h, q being the missing share of the
    /// UAV's mass.
    pub head_c: Layer,
    /// To z_u: `[16, 256]`.
    pub head_u: Layer,
}

impl Weights {
    /// The structured start: triangle kernels that keep the centre of mass of a blob exactly linear in the
    /// features, one copied channel per output plus `mix` of dense noise, biases zero, heads zero.
    ///
    /// `gated` makes room for the missing-mass features in z_c's head.
    #[must_use]
    pub fn structured_init(input: Input, mix: f64, gated: bool, noise: &Noise) -> Self {
        let mut rng = noise.generator(Stream::Weights, 0);
        let convs = std::array::from_fn(|n| triangle_layer(&CONVS[n], mix, n == 0, &mut rng));
        let mut fc = Layer::zeros(&[FEATURES, POOLED]);
        let deviation = 1.0 / (POOLED as f64).sqrt();
        for w in &mut fc.w {
            *w = (deviation * normal(&mut rng)) as f32;
        }
        let head_c = Layer::zeros(&[LATENT, if gated { 2 * FEATURES } else { FEATURES }]);
        Self { input, convs, fc, head_c, head_u: Layer::zeros(&[LATENT, FEATURES]) }
    }

    /// Kaiming's start: every weight N(0, 2/((1 + LEAK²) inputs)), biases zero, heads zero. It loses the
    /// UAV; it is here to show that.
    #[must_use]
    pub fn kaiming(input: Input, gated: bool, noise: &Noise) -> Self {
        let mut weights = Self::structured_init(input, 0.0, gated, noise);
        let mut rng = noise.generator(Stream::Weights, 3);
        for layer in weights.convs.iter_mut().chain([&mut weights.fc]) {
            let inputs = layer.w.len() / layer.b.len();
            let deviation = (2.0 / (1.0 + f64::from(LEAK).powi(2)) / inputs as f64).sqrt();
            layer.w.iter_mut().for_each(|w| *w = (deviation * normal(&mut rng)) as f32);
        }
        weights
    }

    /// Number of trainable values.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.parts().iter().map(|part| part.len()).sum()
    }

    /// All trainable values, tensor by tensor in a fixed order.
    #[must_use]
    pub fn parts(&self) -> Vec<&[f32]> {
        let colour = self.input.colour.iter().flat_map(|c| [c.w.as_flattened(), c.b.as_slice()]);
        let heads = [&self.fc, &self.head_c, &self.head_u];
        let layers = self.convs.iter().chain(heads).flat_map(|l| [l.w.as_slice(), l.b.as_slice()]);
        colour.chain(layers).collect()
    }

    /// The same, to be changed.
    pub fn parts_mut(&mut self) -> Vec<&mut [f32]> {
        let Self { input, convs, fc, head_c, head_u } = self;
        let colour = input.colour.iter_mut().flat_map(|c| [c.w.as_flattened_mut(), c.b.as_mut_slice()]);
        let layers = convs.iter_mut().chain([fc, head_c, head_u]);
        colour.chain(layers.flat_map(|l| [l.w.as_mut_slice(), l.b.as_mut_slice()])).collect()
    }

    /// One step of a target encoder after the online one: φ_tar ← τ φ_tar + (1-τ) φ
    pub fn follow(&mut self, online: &Self, tau: f32) {
        for (target, online) in self.parts_mut().into_iter().zip(online.parts()) {
            target.iter_mut().zip(online).for_each(|(t, o)| *t = tau * *t + (1.0 - tau) * o);
        }
    }
}

impl Stored for Weights {
    fn put(&self, out: &mut Writer) {
        out.f32("input.scale", &[3], self.input.scale);
        out.f32("input.whole_mass", &[3], self.input.whole_mass);
        if let Some(Colour { w, b }) = self.input.colour {
            out.f32("colour.weight", &[2, 3], w.into_iter().flatten());
            out.f32("colour.bias", &[2], b);
        }
        for (n, conv) in self.convs.iter().enumerate() {
            put_layer(out, &format!("conv{}", n + 1), conv);
        }
        put_layer(out, "fc", &self.fc);
        put_layer(out, "head_c", &self.head_c);
        put_layer(out, "head_u", &self.head_u);
    }

    fn get(from: &Reader<'_>) -> Result<Self, TensorError> {
        let triple = |name: &str| -> Result<[f32; 3], TensorError> {
            let v = from.f32(name, &[3])?;
            Ok([v[0], v[1], v[2]])
        };
        let conv = |n: usize| {
            let c = CONVS[n];
            get_layer(from, &format!("conv{}", n + 1), &[c.outputs, c.inputs, c.kernel, c.kernel])
        };
        // z_c's head is twice as wide where the missing-mass features stand beside h.
        let gated = from.shape("head_c.weight")?.get(1) == Some(&(2 * FEATURES));
        let width = if gated { 2 * FEATURES } else { FEATURES };
        let colour = if from.has("colour.weight") {
            let (w, b) = (from.f32("colour.weight", &[2, 3])?, from.f32("colour.bias", &[2])?);
            Some(Colour { w: [[w[0], w[1], w[2]], [w[3], w[4], w[5]]], b: [b[0], b[1]] })
        } else {
            None
        };
        Ok(Self {
            input: Input { scale: triple("input.scale")?, whole_mass: triple("input.whole_mass")?, colour },
            convs: [conv(0)?, conv(1)?, conv(2)?, conv(3)?],
            fc: get_layer(from, "fc", &[FEATURES, POOLED])?,
            head_c: get_layer(from, "head_c", &[LATENT, width])?,
            head_u: get_layer(from, "head_u", &[LATENT, FEATURES])?,
        })
    }
}

/// Adds `{name}.weight` and `{name}.bias`.
pub(crate) fn put_layer(out: &mut Writer, name: &str, layer: &Layer) {
    out.f32(&format!("{name}.weight"), &layer.shape, layer.w.iter().copied());
    out.f32(&format!("{name}.bias"), &[layer.b.len()], layer.b.iter().copied());
}

/// Reads `{name}.weight` with this shape and its bias.
pub(crate) fn get_layer(from: &Reader<'_>, name: &str, shape: &[usize]) -> Result<Layer, TensorError> {
    let w = from.f32(&format!("{name}.weight"), shape)?;
    let b = from.f32(&format!("{name}.bias"), &shape[..1])?;
    Ok(Layer { shape: shape.to_vec(), w, b })
}

/// Weight[o,i,:,:] = M[o,i] T: T the outer product of triangles of half-width = stride, which are a
/// partition of unity and reproduce linear functions, divided by its sum.
fn triangle_layer(shape: &ConvShape, mix: f64, first: bool, rng: &mut impl Rng) -> Layer {
    let ConvShape { inputs, outputs, kernel, stride, .. } = *shape;
    let triangle: Vec<f64> = (0..kernel)
        .map(|x| (1.0 - (x as f64 - (kernel - 1) as f64 / 2.0).abs() / stride as f64).max(0.0))
        .collect();
    let sum = triangle.iter().sum::<f64>().powi(2);
    // The first layer copies red or blue: green is empty.
    let gain = if first { 3.0 } else { 2.0 };
    let deviation = mix * (gain / inputs as f64).sqrt();
    let mut layer = Layer::zeros(&[outputs, inputs, kernel, kernel]);
    for o in 0..outputs {
        let copied = if first { 2 * rng.random_range(0..2) } else { rng.random_range(0..inputs) };
        for i in 0..inputs {
            let m = f64::from(u8::from(i == copied)) + deviation * normal(rng);
            for ky in 0..kernel {
                for kx in 0..kernel {
                    let at = ((o * inputs + i) * kernel + ky) * kernel + kx;
                    layer.w[at] = (m * triangle[ky] * triangle[kx] / sum) as f32;
                }
            }
        }
    }
    layer
}

/// A random 2-plane of R^16: two orthonormal columns, E `[16][2]`.
#[must_use]
pub fn random_plane(noise: &Noise, index: u64) -> [[f32; 2]; LATENT] {
    let mut rng = noise.generator(Stream::Weights, index);
    let mut draw = || -> Vec<f64> { (0..LATENT).map(|_| normal(&mut rng)).collect() };
    let (mut a, mut b) = (draw(), draw());
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let length = dot(&a, &a).sqrt();
    a.iter_mut().for_each(|x| *x /= length);
    let along = dot(&a, &b);
    b.iter_mut().zip(&a).for_each(|(y, x)| *y -= along * x);
    let length = dot(&b, &b).sqrt();
    b.iter_mut().for_each(|x| *x /= length);
    std::array::from_fn(|k| [a[k] as f32, b[k] as f32])
}

fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// E' z: a latent's coordinates on its plane.
#[must_use]
pub fn on_plane(plane: &[[f32; 2]; LATENT], z: &[f32; LATENT]) -> [f32; 2] {
    let mut y = [0.0f32; 2];
    for (e, z) in plane.iter().zip(z) {
        y[0] = e[0].mul_add(*z, y[0]);
        y[1] = e[1].mul_add(*z, y[1]);
    }
    y
}

/// E y: the latent with these coordinates on its plane.
#[must_use]
pub fn from_plane(plane: &[[f32; 2]; LATENT], y: [f32; 2]) -> [f32; LATENT] {
    std::array::from_fn(|k| plane[k][0].mul_add(y[0], plane[k][1] * y[1]))
}

/// A pair of f32 as a vector of f64.
#[must_use]
pub fn vector(y: [f32; 2]) -> Vector2<f64> {
    Vector2::new(f64::from(y[0]), f64::from(y[1]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_cover_the_frame() {
        let sides: Vec<_> = CONVS.iter().map(|c| c.grid_out).collect();
        assert_eq!(sides, [26, 14, 8, 5]);
        assert_eq!(CONVS[3].outputs * CONVS[3].grid_out.pow(2), POOLED);
    }

    #[test]
    fn a_target_keeps_tau_of_itself() {
        let input = Input { scale: [1.0; 3], colour: None, whole_mass: [1.0; 3] };
        let mut target = Weights::structured_init(input, 0.0, false, &Noise::new(1));
        let mut online = target.clone();
        target.parts_mut().into_iter().for_each(|part| part.fill(1.0));
        online.parts_mut().into_iter().for_each(|part| part.fill(3.0));
        target.follow(&online, 0.75);
        assert!(target.parts().into_iter().flatten().all(|t| *t == 0.75 * 1.0 + 0.25 * 3.0));
    }

    #[test]
    fn a_plane_is_orthonormal_and_keeps_its_coordinates() {
        let plane = random_plane(&Noise::new(3), 1);
        let y = on_plane(&plane, &from_plane(&plane, [1.5, -0.25]));
        assert!((y[0] - 1.5).abs() < 1e-5 && (y[1] + 0.25).abs() < 1e-5, "{y:?}");
        assert_ne!(plane, random_plane(&Noise::new(4), 1));
    }

    #[test]
    fn an_empty_channel_is_left_alone() {
        let input = Input::new(&Scenario::default(), [true, false, true]);
        let (factor, missing) = input.factors([0, 0, 0]);
        assert!(factor.iter().all(|f| f.is_finite()) && missing == [0.0; 3]);
        assert!(
            (input.scale[0] - 0.0366).abs() < 1e-4 && (input.scale[2] - 0.1693).abs() < 1e-3,
            "{input:?}"
        );
    }
}
