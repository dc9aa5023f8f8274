//! The risk and channel heads: collision probability and ln |h|² from the latents, learned from
//! labelled pictures by gradient descent in burn and handed over as plain networks.
//!
//! The encoder is frozen: labels never reach it. Pictures are drawn where it matters: a third near a
//! collision, a third near a blocked line of sight, a third anywhere.

use burn::module::Module;
use burn::nn::{Initializer, Linear, LinearConfig};
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::activation::{log_sigmoid, tanh};
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use sitl::scenario::Scenario;
use sitl::world::noise::{Noise, Stream};
use sitl::world::{channel, safety};

use crate::checkpoint::HEAD_WIDTHS;
use crate::jepa::values;
use crate::mlp::{Dense, Mlp};
use crate::world_model::Heads;

/// How the heads are trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeadsConfig {
    /// Labelled pictures.
    pub frames: usize,
    /// Steps of Adam, each head.
    pub steps: usize,
    /// Pictures a step.
    pub batch: usize,
    /// Learning rate at the start; falls to 1 % of it as a cosine.
    pub learning_rate: f64,
    /// Smallest distance to the base station in the gain's label, units: ln d^-2 has no bound there,
    /// and no link fails there.
    pub distance_floor: f64,
}

impl Default for HeadsConfig {
    fn default() -> Self {
        Self { frames: 24_000, steps: 6000, batch: 512, learning_rate: 2e-2, distance_floor: 0.02 }
    }
}

/// A place of both bodies, paper units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scene {
    /// r_c
    pub uav: Vector2<f64>,
    /// r_u
    pub obstacle: Vector2<f64>,
}

/// Ground truth of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Label {
    /// p_coll
    pub collision: f64,
    /// ln |h|², distance kept above the floor.
    pub log_gain: f64,
}

impl Scene {
    /// Its picture.
    #[must_use]
    pub fn frame(&self, scenario: &Scenario) -> sitl::camera::Frame {
        sitl::camera::render(self.uav, self.obstacle, scenario)
    }

    /// Its ground truth.
    #[must_use]
    pub fn label(&self, scenario: &Scenario, distance_floor: f64) -> Label {
        let radius = scenario.obstacle.radius;
        let clearance = safety::clearance(self.uav, self.obstacle, scenario.uav_radius, radius);
        let mut link = scenario.channel.clone();
        link.distance_floor = link.distance_floor.max(distance_floor);
        Label {
            collision: safety::collision_probability(
                clearance,
                scenario.safety.d_min,
                scenario.safety.softness,
            ),
            log_gain: channel::gain(self.uav, self.obstacle, radius, &link).ln(),
        }
    }
}

/// UAV anywhere in [0,1]², obstacle anywhere that its walls allow.
#[must_use]
pub fn uniform_scene(scenario: &Scenario, rng: &mut impl Rng) -> Scene {
    let mut place = |margin: f64| margin + (1.0 - 2.0 * margin) * rng.random::<f64>();
    let uav = Vector2::new(place(0.0), place(0.0));
    let margin = scenario.obstacle.margin;
    Scene { uav, obstacle: Vector2::new(place(margin), place(margin)) }
}

/// `count` scenes: a third near a collision, a third near a blocked sight line, a third anywhere.
#[must_use]
pub fn sample(count: usize, scenario: &Scenario, rng: &mut impl Rng) -> Vec<Scene> {
    let margin = scenario.obstacle.margin;
    let inside = |r: Vector2<f64>| r.map(|x| x.clamp(margin, 1.0 - margin));
    (0..count)
        .map(|n| {
            let scene = uniform_scene(scenario, rng);
            let obstacle = match n % 3 {
                0 => {
                    let angle = std::f64::consts::TAU * rng.random::<f64>();
                    let distance = 0.04 + 0.2 * rng.random::<f64>();
                    scene.uav + distance * Vector2::new(angle.cos(), angle.sin())
                }
                1 => {
                    let station = scenario.channel.base_station;
                    let along = scene.uav + (station - scene.uav) * rng.random::<f64>();
                    let mut aside = || -> f64 { StandardNormal.sample(rng) };
                    along + 0.08 * Vector2::new(aside(), aside())
                }
                _ => scene.obstacle,
            };
            Scene { obstacle: inside(obstacle), ..scene }
        })
        .collect()
}

/// Trains both heads. `y_c`, `y_u` are the plane coordinates of the labelled pictures; `tick` hears of
/// every step.
pub fn train(
    y_c: &[[f32; 2]],
    y_u: &[[f32; 2]],
    labels: &[Label],
    config: &HeadsConfig,
    device: &Device,
    noise: &Noise,
    tick: impl Fn() + Sync,
) -> Heads {
    let n = labels.len().max(1) as f64;
    let mean = labels.iter().map(|l| l.log_gain).sum::<f64>() / n;
    let variance = labels.iter().map(|l| (l.log_gain - mean).powi(2)).sum::<f64>() / n;
    let mut heads = Heads {
        collision: Mlp::zeros(&HEAD_WIDTHS),
        gain: Mlp::zeros(&HEAD_WIDTHS),
        gain_mean: mean as f32,
        gain_std: variance.sqrt().max(1e-6) as f32,
        scale_c: 1.0 / deviation(y_c),
        scale_u: 1.0 / deviation(y_u),
    };
    let x: Vec<[f32; 4]> = y_c.iter().zip(y_u).map(|(c, u)| heads.input(*c, *u)).collect();
    let risk: Vec<f32> = labels.iter().map(|l| l.collision as f32).collect();
    let (mean, std) = (heads.gain_mean, heads.gain_std);
    let gain: Vec<f32> = labels.iter().map(|l| (l.log_gain as f32 - mean) / std).collect();
    (heads.collision, heads.gain) = rayon::join(
        || fit(&x, &risk, Loss::CrossEntropy, config, device, noise, &tick),
        || fit(&x, &gain, Loss::Square, config, device, noise, &tick),
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
    /// x [batch, 4] -> [batch, 1].
    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        self.last.forward(tanh(self.second.forward(tanh(self.first.forward(x)))))
    }
}

/// One head: Adam on random batches, learning rate falling as a cosine.
fn fit(
    x: &[[f32; 4]],
    y: &[f32],
    loss: Loss,
    config: &HeadsConfig,
    device: &Device,
    noise: &Noise,
    tick: &(impl Fn() + Sync),
) -> Mlp {
    let device = device.clone().autodiff();
    let mut rng = noise.generator(Stream::Batches, 100 + loss as u64);
    let mut network = Network {
        first: linear(HEAD_WIDTHS[0], HEAD_WIDTHS[1], &device, &mut rng),
        second: linear(HEAD_WIDTHS[1], HEAD_WIDTHS[2], &device, &mut rng),
        last: linear(HEAD_WIDTHS[2], HEAD_WIDTHS[3], &device, &mut rng),
    };
    let mut optimiser = AdamConfig::new().with_epsilon(1e-8).init();
    for step in 0..config.steps {
        let picks: Vec<usize> = (0..config.batch).map(|_| rng.random_range(0..x.len())).collect();
        let inputs: Vec<f32> = picks.iter().flat_map(|&n| x[n]).collect();
        let targets: Vec<f32> = picks.iter().map(|&n| y[n]).collect();
        let inputs = Tensor::<2>::from_data(TensorData::new(inputs, [picks.len(), 4]), &device);
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
fn linear(inputs: usize, outputs: usize, device: &Device, rng: &mut impl Rng) -> Linear {
    let bound = 1.0 / (inputs as f32).sqrt();
    let mut draw =
        |count: usize| -> Vec<f32> { (0..count).map(|_| rng.random_range(-bound..bound)).collect() };
    let (w, b) = (draw(inputs * outputs), draw(outputs));
    let mut linear = LinearConfig::new(inputs, outputs).with_initializer(Initializer::Zeros).init(device);
    linear.weight = burn::module::Param::from_data(TensorData::new(w, [inputs, outputs]), device);
    linear.bias = Some(burn::module::Param::from_data(TensorData::new(b, [outputs]), device));
    linear
}

fn dense(linear: &Linear) -> Dense {
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

/// Area under the receiver's curve of `score` for the events `hit`; ½ if all or none are hits.
#[must_use]
pub fn auc(score: &[f64], hit: &[bool]) -> f64 {
    let mut order: Vec<usize> = (0..score.len()).collect();
    order.sort_by(|a, b| score[*a].total_cmp(&score[*b]));
    let (mut ranks, mut hits) = (0.0, 0.0);
    for (rank, &n) in order.iter().enumerate() {
        if hit[n] {
            ranks += rank as f64 + 1.0;
            hits += 1.0;
        }
    }
    let pairs = hits * (score.len() as f64 - hits);
    if pairs > 0.0 { (ranks - hits * (hits + 1.0) / 2.0) / pairs } else { 0.5 }
}

/// Expected calibration error: mean distance of predicted and true probability over ten bins.
#[must_use]
pub fn calibration_error(predicted: &[f64], truth: &[f64]) -> f64 {
    let mut bins = [(0.0, 0.0); 10];
    for (p, t) in predicted.iter().zip(truth) {
        let bin = &mut bins[((p * 10.0) as usize).min(9)];
        bin.0 += p;
        bin.1 += t;
    }
    bins.iter().map(|(p, t)| (p - t).abs()).sum::<f64>() / predicted.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_the_worlds() {
        let scenario = Scenario::default();
        let scene = Scene { uav: Vector2::new(0.5, 0.52), obstacle: Vector2::new(0.5, 0.40) };
        let label = scene.label(&scenario, 0.02);
        assert!((label.collision - 0.5).abs() < 1e-9, "contact is one half, not {}", label.collision);
        let above = Scene { uav: Vector2::new(0.5, 0.05), obstacle: Vector2::new(0.2, 0.8) };
        assert!((above.label(&scenario, 0.02).log_gain - 2500f64.ln()).abs() < 1e-6);
    }

    #[test]
    fn scores_of_a_perfect_and_of_a_blind_judge() {
        let hit: Vec<bool> = (0..100).map(|k| k >= 60).collect();
        let rising: Vec<f64> = (0..100).map(f64::from).collect();
        let falling: Vec<f64> = (0..100).map(|k| -f64::from(k)).collect();
        assert!((auc(&rising, &hit) - 1.0).abs() < 1e-12 && auc(&falling, &hit).abs() < 1e-12);
        assert!((calibration_error(&[0.25, 0.75], &[0.35, 0.75]) - 0.05).abs() < 1e-12);
    }

    #[test]
    fn a_head_learns_and_equal_seeds_learn_alike() {
        let (scenario, noise) = (Scenario::default(), Noise::new(9));
        let mut rng = noise.generator(Stream::Data, 0);
        let scenes = sample(600, &scenario, &mut rng);
        let as_latent = |r: Vector2<f64>| [(r.x * 10.0 - 5.0) as f32, (r.y * 10.0 - 5.0) as f32];
        let y_c: Vec<_> = scenes.iter().map(|s| as_latent(s.uav)).collect();
        let y_u: Vec<_> = scenes.iter().map(|s| as_latent(s.obstacle)).collect();
        let labels: Vec<_> = scenes.iter().map(|s| s.label(&scenario, 0.02)).collect();
        let config = HeadsConfig { steps: 300, batch: 64, ..HeadsConfig::default() };
        let device = crate::jepa::Backend::Flex.device().unwrap();
        let learn = || train(&y_c, &y_u, &labels, &config, &device, &noise, || ());
        let heads = learn();
        let predicted: Vec<f64> =
            y_c.iter().zip(&y_u).map(|(c, u)| f64::from(heads.collision(*c, *u))).collect();
        let hit: Vec<bool> = labels.iter().map(|l| l.collision > 0.5).collect();
        assert!(auc(&predicted, &hit) > 0.9);
        assert_eq!(heads, learn());
    }
}
