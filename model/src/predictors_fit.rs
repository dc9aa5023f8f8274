//! Training of the MLP and LSTM predictors in burn: first rollouts of 4 steps from anywhere, which are
//! cheap, then rollouts from rest that grow to the whole horizon; both are compared with the latents of
//! the pictures along them.
//!
//! Knows latents and actions; neither positions nor heads.

use std::path::Path;

use burn::grad_clipping::GradientClippingConfig;
use burn::module::Module;
use burn::nn::{Initializer, Linear, LinearConfig};
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::activation::{sigmoid, tanh};
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Vector2;
use rand::RngExt;
use sitl::Scenario;
use sitl::camera::SIDE;
use sitl::world::noise::{Noise, Stream};

use crate::checkpoint::{self, CheckpointError, Reader, Writer};
use crate::dataset::{self, Start};
use crate::heads_fit::{dense, linear};
use crate::jepa::values;
use crate::mlp::Mlp;
use crate::plot::{self, Chart, PlotError, Series};
use crate::predictors::{Begin, Cell, INPUTS, Lstm, NetworksConfig, Predictor, Predictors, Scaling};
use crate::probe::quantile;
use crate::weights::vector;
use crate::world_model::WorldModel;

/// A point of a learning curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Steps of Adam so far.
    pub step: usize,
    /// Length of the rollouts trained on, intervals.
    pub horizon: usize,
    /// Training loss of the last batch.
    pub loss: f64,
    /// Held-out rollouts over the whole horizon: l1 distance to the latent at the end, px, 90 % quantile.
    pub held_out_px: f64,
}

/// The predictors and how they got there.
#[derive(Debug, Clone, PartialEq)]
pub struct Trained {
    /// Both networks.
    pub predictors: Predictors,
    /// The learning curves of MLP and LSTM.
    pub curves: [Vec<Point>; 2],
}

/// Names of the curves, and of the networks in files.
const NAMES: [&str; 2] = ["mlp", "lstm"];

/// Latents along episodes from rest, and the actions between them.
struct Data {
    /// y_c of frames 1..=T+1, one list an episode.
    y: Vec<Vec<Vector2<f64>>>,
    /// a_0..a_T.
    actions: Vec<Vec<Vector2<f64>>>,
}

/// Trains both on the latents of `model`, each on a core of its own; `tick` hears of every step.
pub fn train(
    model: &WorldModel,
    config: &NetworksConfig,
    steps: usize,
    device: &Device,
    scenario: &Scenario,
    noise: &Noise,
    tick: impl Fn() + Sync,
) -> Result<Trained, CheckpointError> {
    let data = collect(model, config.episodes, steps, scenario, noise, TRAINING_EPISODES);
    let held_out = collect(model, config.held_out, steps, scenario, noise, TRAINING_EPISODES + 1);
    let scaling = scaling(&data);
    let px = SIDE as f64 / model.scale;
    let fit = |kind: usize| {
        let fit = Fit { data: &data, held_out: &held_out, scaling, config, px, kind };
        fit.run(device, noise, &tick)
    };
    let ((mlp, mlp_curve), (lstm, lstm_curve)) = rayon::join(|| fit(0), || fit(1));
    let world = checkpoint::fingerprint(model)?;
    Ok(Trained { predictors: Predictors { mlp, lstm, world }, curves: [mlp_curve, lstm_curve] })
}

/// Keeps these episodes apart from others of the seed.
const TRAINING_EPISODES: u64 = 20;

fn collect(
    model: &WorldModel,
    count: usize,
    steps: usize,
    scenario: &Scenario,
    noise: &Noise,
    purpose: u64,
) -> Data {
    let episodes = dataset::collect(count, steps, Start::Rest, scenario, noise, purpose);
    let frames: Vec<(usize, usize)> =
        (0..episodes.len()).flat_map(|n| (1..episodes[n].uav.len()).map(move |k| (n, k))).collect();
    let latents = model.encoder.encode_all(&frames, |&(n, k)| episodes[n].frame(k, scenario));
    let y: Vec<_> = latents.iter().map(|l| vector(model.y_c(l))).collect();
    Data {
        y: y.chunks(steps + 1).map(<[_]>::to_vec).collect(),
        actions: episodes.into_iter().map(|e| e.actions).collect(),
    }
}

fn scaling(data: &Data) -> Scaling {
    let rms = |values: &mut dyn Iterator<Item = Vector2<f64>>| {
        let (sum, count) = values.fold((0.0, 0usize), |(s, n), v| (s + v.norm_squared(), n + 2));
        (sum / count.max(1) as f64).sqrt().max(1e-6) as f32
    };
    Scaling {
        place: rms(&mut data.y.iter().flatten().copied()),
        step: rms(&mut data.y.iter().flat_map(|y| y.windows(2)).map(|y| y[1] - y[0])),
        bend: rms(&mut data.y.iter().flat_map(|y| y.windows(3)).map(|y| y[2] - y[1] * 2.0 + y[0])),
    }
}

/// Either network: with `gates` it is an LSTM.
#[derive(Module, Debug)]
struct Network {
    hidden: Vec<Linear>,
    gates: Option<Linear>,
    out: Linear,
}

impl Network {
    /// x [batch, 6] and (h, c) [batch, n] -> [batch, 2] and the next (h, c).
    fn step(&self, x: Tensor<2>, memory: [Tensor<2>; 2]) -> (Tensor<2>, [Tensor<2>; 2]) {
        let Some(gates) = &self.gates else {
            let h = self.hidden.iter().fold(x, |x, layer| tanh(layer.forward(x)));
            return (self.out.forward(h), memory);
        };
        let [h, c] = memory;
        let n = c.dims()[1];
        let gates = gates.forward(Tensor::cat(vec![x, h], 1)); // [batch, 4 n]: i, f, g, o
        let gate = |k: usize| gates.clone().narrow(1, k * n, n);
        let c = sigmoid(gate(1)) * c + sigmoid(gate(0)) * tanh(gate(2));
        let h = sigmoid(gate(3)) * tanh(c.clone());
        (self.out.forward(h.clone()), [h, c])
    }

    fn cell(&self) -> Cell {
        let out = dense(&self.out);
        match &self.gates {
            Some(gates) => Cell::Lstm(Lstm { gates: dense(gates), out }),
            None => Cell::Mlp(Mlp { layers: self.hidden.iter().map(dense).chain([out]).collect() }),
        }
    }
}

/// One network's training.
struct Fit<'a> {
    data: &'a Data,
    held_out: &'a Data,
    scaling: Scaling,
    config: &'a NetworksConfig,
    /// px per latent unit.
    px: f64,
    /// Index into [`NAMES`].
    kind: usize,
}

impl Fit<'_> {
    fn run(&self, device: &Device, noise: &Noise, tick: &(impl Fn() + Sync)) -> (Predictor, Vec<Point>) {
        let device = device.clone().autodiff();
        let mut rng = noise.generator(Stream::Batches, 200 + self.kind as u64);
        let n = self.config.hidden;
        let recurrent = self.kind == 1;
        let hidden = if recurrent { vec![] } else { vec![INPUTS, n] };
        let mut network = Network {
            hidden: hidden.into_iter().map(|inputs| linear(inputs, n, &device, &mut rng)).collect(),
            gates: recurrent.then(|| linear(INPUTS + n, 4 * n, &device, &mut rng)),
            // Zeros: it begins as constant velocity.
            out: LinearConfig::new(n, 2).with_initializer(Initializer::Zeros).init(&device),
        };
        let clip = GradientClippingConfig::Norm(0.1);
        let mut optimiser = AdamConfig::new().with_epsilon(1e-8).with_grad_clipping(Some(clip)).init();
        let NetworksConfig { short_steps, mlp_steps, lstm_steps, batch, learning_rate, .. } = *self.config;
        let long_steps = if recurrent { lstm_steps } else { mlp_steps };
        let steps = short_steps + long_steps;
        let longest = self.data.actions.first().map_or(1, Vec::len);
        let mut curve = Vec::new();
        for step in 0..steps {
            let long = step >= short_steps;
            let (done, of) = if long { (step - short_steps, long_steps) } else { (step, short_steps) };
            let share = done as f64 / of as f64;
            let grown = (SHORT as f64 + longest as f64 * share / GROWTH) as usize;
            let horizon = if long { grown } else { SHORT }.min(longest);
            let picks: Vec<(usize, usize)> = (0..batch)
                .map(|_| {
                    let first = if long { 0 } else { rng.random_range(0..=longest - horizon) };
                    (rng.random_range(0..self.data.y.len()), first)
                })
                .collect();
            let loss = self.loss(&network, &picks, horizon, &device);
            let told = (step + 1).is_multiple_of((steps / 100).max(1)) || step + 1 == steps;
            let value = if told { values(loss.clone())[0] } else { 0.0 };
            let gradients = GradientsParams::from_grads(loss.backward(), &network);
            let fall = 0.01 + 0.99 * 0.5 * (1.0 + (share * std::f64::consts::PI).cos());
            let rate = if long { LONG_RATE * learning_rate } else { learning_rate };
            network = optimiser.step(rate * fall, network, gradients);
            if told {
                let held_out_px = self.judge(&Predictor { cell: network.cell(), scaling: self.scaling });
                curve.push(Point { step: step + 1, horizon, loss: f64::from(value), held_out_px });
            }
            tick();
        }
        (Predictor { cell: network.cell(), scaling: self.scaling }, curve)
    }

    /// Mean square distance of rollouts, each from a frame of an episode, to the pictures' latents, in
    /// units of `scaling.place`; step k weighs 1/k². At frame 0 the UAV rests.
    fn loss(
        &self,
        network: &Network,
        picks: &[(usize, usize)],
        horizon: usize,
        device: &Device,
    ) -> Tensor<1> {
        let rows = |of: &dyn Fn(usize, usize) -> Vector2<f64>| {
            let flat: Vec<f32> =
                picks.iter().map(|&(n, first)| of(n, first)).flat_map(|v| [v.x as f32, v.y as f32]).collect();
            Tensor::<2>::from_data(TensorData::new(flat, [picks.len(), 2]), device)
        };
        let Scaling { place, step, bend } = self.scaling;
        let blank = Tensor::<2>::zeros([picks.len(), self.config.hidden], device);
        let mut memory = [blank.clone(), blank];
        let mut now = rows(&|n, first| self.data.y[n][first]);
        let mut before = rows(&|n, first| self.data.y[n][first.saturating_sub(1)]);
        let mut errors = Vec::with_capacity(horizon);
        let weights: Vec<f64> = (1..=horizon).map(|k| 1.0 / (k * k) as f64).collect();
        let whole: f64 = weights.iter().sum();
        for k in 0..horizon {
            let velocity = now.clone() - before;
            let a = rows(&|n, first| self.data.actions[n][first + k]);
            let x = Tensor::cat(vec![now.clone() / place, velocity.clone() / step, a], 1);
            let (out, kept) = network.step(x, memory);
            memory = kept;
            before = now.clone();
            now = now + velocity + out * bend;
            let off = (now.clone() - rows(&|n, first| self.data.y[n][first + k + 1])) / place;
            errors.push(off * (weights[k] / whole).sqrt());
        }
        Tensor::cat(errors, 1).square().sum_dim(1).mean()
    }

    /// Held-out rollouts over the whole horizon, 90 % quantile at the end, px.
    fn judge(&self, predictor: &Predictor) -> f64 {
        let begins: Vec<Begin<'_>> = (self.held_out.y.iter().zip(&self.held_out.actions))
            .map(|(y, actions)| Begin { now: y[0], before: y[0], actions })
            .collect();
        let ends = predictor.rollouts(&begins);
        let off: Vec<f64> = (ends.iter().zip(&self.held_out.y))
            .filter_map(|(path, y)| Some(self.px * (path.last()? - y.last()?).abs().sum()))
            .collect();
        quantile(&off, 0.9)
    }
}

/// Length of the rollouts of the short steps, intervals.
const SHORT: usize = 4;

/// Learning rate of the long steps, relative to that of the short ones.
const LONG_RATE: f64 = 0.3;

/// Share of the long steps after which rollouts have their whole length.
const GROWTH: f64 = 0.4;

/// Writes a finished stage.
pub fn save(trained: &Trained, dir: &Path) -> Result<(), CheckpointError> {
    let mut out = Writer::default();
    for (name, curve) in NAMES.iter().zip(&trained.curves) {
        let rows = curve.iter().flat_map(|p| [p.step as f64, p.horizon as f64, p.loss, p.held_out_px]);
        out.f64(name, &[curve.len(), 4], rows);
    }
    checkpoint::write_all(&dir.join(CURVES), &out.bytes()?)?;
    trained.predictors.save(dir)
}

/// Name of the curves' file in a stage.
const CURVES: &str = "curves.safetensors";

/// Reads what [`save`] wrote.
pub fn load(dir: &Path) -> Result<Trained, CheckpointError> {
    let path = dir.join(CURVES);
    let bytes =
        std::fs::read(&path).map_err(|source| CheckpointError::File { path: path.clone(), source })?;
    let from = Reader::new(&bytes, path)?;
    let curve = |name: &str| -> Result<Vec<Point>, CheckpointError> {
        let rows = from.shape(name)?.first().copied().unwrap_or(0);
        let flat = from.f64(name, &[rows, 4])?;
        let point =
            |p: &[f64]| Point { step: p[0] as usize, horizon: p[1] as usize, loss: p[2], held_out_px: p[3] };
        Ok(flat.chunks_exact(4).map(point).collect())
    };
    Ok(Trained { predictors: Predictors::load(dir)?, curves: [curve(NAMES[0])?, curve(NAMES[1])?] })
}

/// Puts the networks beside the checkpoint, and their learning curves as CSV, SVG and PNG.
pub fn publish(trained: &Trained, dir: &Path) -> Result<(), PlotError> {
    let failed = |e: CheckpointError| PlotError { path: dir.into(), message: e.to_string() };
    trained.predictors.save(dir).map_err(failed)?;
    let mut text = String::from("network,step,horizon,loss,held_out_p90_px\n");
    let mut series = Vec::new();
    for (k, (name, curve)) in NAMES.iter().zip(&trained.curves).enumerate() {
        for p in curve {
            text += &format!("{name},{},{},{:e},{:.4}\n", p.step, p.horizon, p.loss, p.held_out_px);
        }
        let points = curve.iter().map(|p| (p.step as f64, p.held_out_px)).collect();
        series.push(Series::line(*name, k, points));
    }
    checkpoint::write_all(&dir.join("predictors_loss.csv"), text.as_bytes()).map_err(failed)?;
    let chart = Chart {
        title: "Held-out rollouts while the predictors learn".into(),
        x: "steps of Adam".into(),
        y: "error after the whole horizon, p90, px".into(),
        log_y: true,
        series,
        ..Chart::default()
    };
    plot::save(&chart, dir, "predictors_loss")
}
