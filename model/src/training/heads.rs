//! Training of the risk and channel heads by gradient descent in burn, handed over as plain networks.

use burn::module::Module;
use burn::nn::{Initializer, Linear, LinearConfig};
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::activation::{log_sigmoid, tanh};
use burn::tensor::{Device, Tensor, TensorData};
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::{Rng, RngExt};

use crate::encoder::module::values;
use crate::encoder::probe::Probe;
use crate::heads::labels::{HeadsConfig, Label};
use crate::heads::networks::{COLLISION_WIDTHS, GAIN_WIDTHS, Heads, SightLine};
use crate::numeric::mlp::{Dense, Mlp};

/// What the heads learn from, one entry a labelled frame.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// Plane coordinates of the UAV's half.
    pub y_c: Vec<[f32; 2]>,
    /// Plane coordinates of the obstacle's half.
    pub y_u: Vec<[f32; 2]>,
    /// s_BS, paper units.
    pub station: Vec<Vector2<f64>>,
    /// Ground truth.
    pub label: Vec<Label>,
}

/// Trains both heads. `probe` maps latents to positions; `tick` is called for every step.
pub fn train(
    samples: &Samples,
    probe: &Probe,
    config: &HeadsConfig,
    device: &Device,
    noise: &Noise,
    tick: impl Fn() + Sync,
) -> Heads {
    let Samples { y_c, y_u, station, label: labels } = samples;
    let n = labels.len().max(1) as f64;
    let mean = labels.iter().map(|l| l.log_gain).sum::<f64>() / n;
    let variance = labels.iter().map(|l| (l.log_gain - mean).powi(2)).sum::<f64>() / n;
    let mut heads = Heads {
        collision: Mlp::zeros(&COLLISION_WIDTHS),
        gain: Mlp::zeros(&GAIN_WIDTHS),
        gain_mean: mean as f32,
        gain_std: variance.sqrt().max(1e-6) as f32,
        scale_c: 1.0 / deviation(y_c),
        scale_u: 1.0 / deviation(y_u),
        floor: config.distance_floor as f32,
    };
    let each = || y_c.iter().zip(y_u).zip(station).map(|((c, u), s)| (*c, *u, *s));
    let x: Vec<_> = each().map(|(c, u, s)| heads.input(c, u, s)).collect();
    let sight: Vec<_> =
        each().map(|(c, u, s)| SightLine::new(s, probe, heads.floor).coordinates(c, u)).collect();
    let risk: Vec<f32> = labels.iter().map(|l| l.collision as f32).collect();
    let (mean, std) = (heads.gain_mean, heads.gain_std);
    let gain: Vec<f32> = labels.iter().map(|l| (l.log_gain as f32 - mean) / std).collect();
    (heads.collision, heads.gain) = rayon::join(
        || fit(&x, &risk, Loss::CrossEntropy, config, device, noise, &tick),
        || fit(&sight, &gain, Loss::Square, config, device, noise, &tick),
    );
    heads
}

#[derive(Debug, Clone, Copy)]
enum Loss {
    /// Of a logit against a soft label.
    CrossEntropy,
    Square,
}

#[derive(Module, Debug)]
struct Network {
    first: Linear,
    second: Linear,
    last: Linear,
}

impl Network {
    /// x `[batch, inputs]` -> `[batch, 1]`.
    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        self.last.forward(tanh(self.second.forward(tanh(self.first.forward(x)))))
    }
}

/// One head: Adam on random batches, learning rate falling as a cosine.
fn fit<const INPUTS: usize>(
    x: &[[f32; INPUTS]],
    y: &[f32],
    loss: Loss,
    config: &HeadsConfig,
    device: &Device,
    noise: &Noise,
    tick: &(impl Fn() + Sync),
) -> Mlp {
    let (device, hidden) = (device.clone().autodiff(), COLLISION_WIDTHS[1]);
    let mut rng = noise.generator(Stream::Batches, 100 + loss as u64);
    let mut network = Network {
        first: linear(INPUTS, hidden, &device, &mut rng),
        second: linear(hidden, hidden, &device, &mut rng),
        last: linear(hidden, 1, &device, &mut rng),
    };
    let mut optimiser = AdamConfig::new().with_epsilon(1e-8).init();
    for step in 0..config.steps {
        let picks: Vec<usize> = (0..config.batch).map(|_| rng.random_range(0..x.len())).collect();
        let inputs: Vec<f32> = picks.iter().flat_map(|&n| x[n]).collect();
        let targets: Vec<f32> = picks.iter().map(|&n| y[n]).collect();
        let inputs = Tensor::<2>::from_data(TensorData::new(inputs, [picks.len(), INPUTS]), &device);
        let targets = Tensor::<2>::from_data(TensorData::new(targets, [picks.len(), 1]), &device);
        let out = network.forward(inputs);
        let loss = match loss {
            Loss::Square => (out - targets).square().mean(),
            // -[y ln σ(x) + (1-y) ln σ(-x)]
            Loss::CrossEntropy => {
                let hit = targets.clone() * log_sigmoid(out.clone());
                let miss = (targets.neg() + 1.0) * log_sigmoid(out.neg());
                (hit + miss).mean().neg()
            }
        };
        let gradients = GradientsParams::from_grads(loss.backward(), &network);
        let phase = step as f64 / config.steps as f64 * std::f64::consts::PI;
        let rate = config.learning_rate * (0.01 + 0.99 * 0.5 * (1.0 + phase.cos()));
        network = optimiser.step(rate, network, gradients);
        tick();
    }
    Mlp { layers: [&network.first, &network.second, &network.last].map(dense).to_vec() }
}

/// PyTorch's default start, U(±1/sqrt(inputs)), from our own stream.
pub(crate) fn linear(inputs: usize, outputs: usize, device: &Device, rng: &mut impl Rng) -> Linear {
    let bound = 1.0 / (inputs as f32).sqrt();
    let mut draw =
        |count: usize| -> Vec<f32> { (0..count).map(|_| rng.random_range(-bound..bound)).collect() };
    let (w, b) = (draw(inputs * outputs), draw(outputs));
    let mut linear = LinearConfig::new(inputs, outputs).with_initializer(Initializer::Zeros).init(device);
    linear.weight = burn::module::Param::from_data(TensorData::new(w, [inputs, outputs]), device);
    linear.bias = Some(burn::module::Param::from_data(TensorData::new(b, [outputs]), device));
    linear
}

/// A burn layer as plain arrays.
pub(crate) fn dense(linear: &Linear) -> Dense {
    let [inputs, outputs] = linear.weight.dims();
    let b = linear.bias.as_ref().map_or_else(|| vec![0.0; outputs], |b| values(b.val()));
    Dense { inputs, outputs, w: values(linear.weight.val()), b }
}

/// Root of the mean variance of the two coordinates; 1 where they do not vary.
fn deviation(y: &[[f32; 2]]) -> f32 {
    let n = y.len().max(1) as f64;
    let variance = |axis: usize| {
        let mean = y.iter().map(|y| f64::from(y[axis])).sum::<f64>() / n;
        y.iter().map(|y| (f64::from(y[axis]) - mean).powi(2)).sum::<f64>() / n
    };
    let deviation = ((variance(0) + variance(1)) / 2.0).sqrt() as f32;
    if deviation > 0.0 { deviation } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::Scenario;

    use super::*;
    use crate::encoder::probe::Affine;
    use crate::heads::labels::{BaseStation, auc, sample};

    #[test]
    fn a_head_learns_and_equal_seeds_learn_alike() {
        let (scenario, noise) = (Scenario::default(), Noise::new(9));
        let mut rng = noise.generator(Stream::Data, 0);
        let scenes = sample(600, BaseStation::Anywhere, &scenario, &mut rng);
        let as_latent = |r: Vector2<f64>| [(r.x * 10.0 - 5.0) as f32, (r.y * 10.0 - 5.0) as f32];
        let samples = Samples {
            y_c: scenes.iter().map(|(s, _)| as_latent(s.uav)).collect(),
            y_u: scenes.iter().map(|(s, _)| as_latent(s.obstacle)).collect(),
            station: scenes.iter().map(|(_, station)| *station).collect(),
            label: scenes.iter().map(|(s, station)| s.label(*station, &scenario, 0.02)).collect(),
        };
        let map = Affine { matrix: nalgebra::Matrix2::identity() * 0.1, offset: Vector2::repeat(0.5) };
        let probe = Probe { c: map, u: map };
        let config = HeadsConfig { steps: 300, batch: 64, ..HeadsConfig::default() };
        let device = crate::encoder::module::Backend::Flex.device().unwrap();
        let learn = || train(&samples, &probe, &config, &device, &noise, || ());
        let heads = learn();
        let (mut predicted, mut square) = (Vec::new(), 0.0);
        for (n, label) in samples.label.iter().enumerate() {
            let at = heads.at(samples.station[n], &probe);
            predicted.push(f64::from(at.collision(samples.y_c[n], samples.y_u[n])));
            square += (f64::from(at.log_gain(samples.y_c[n], samples.y_u[n])) - label.log_gain).powi(2);
        }
        let hit: Vec<bool> = samples.label.iter().map(|l| l.collision > 0.5).collect();
        assert!(auc(&predicted, &hit) > 0.9);
        let rms = (square / 600.0).sqrt();
        assert!(rms < 0.5 * f64::from(heads.gain_std), "off by {rms} of {}", heads.gain_std);
        assert_eq!(heads, learn());
    }
}
