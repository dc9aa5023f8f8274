//! Training of the MLP and LSTM predictors: first rollouts of 4 steps from anywhere, which are
//! cheap, then rollouts from rest that grow to the whole horizon; both are compared with the latents of
//! the pictures along them.
//!
//! Knows latents and actions; neither positions nor heads.

use std::path::Path;

use crpl_sitl::Scenario;
use crpl_sitl::camera::SIDE;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rayon::prelude::*;

use crate::encoder::weights::vector;
use crate::evaluation::chart::{self, Chart, PlotError, Series};
use crate::numeric::adam::Adam;
use crate::numeric::kernel::{LANES, Lane, ZERO};
use crate::numeric::mlp::{Dense, Mlp};
use crate::numeric::statistics::quantile;
use crate::predictor::backprop::{self, Block};
use crate::predictor::networks::{Begin, Cell, INPUTS, Lstm, NetworksConfig, Predictor, Predictors, Scaling};
use crate::world_model::WorldModel;
use crate::world_model::checkpoint::{self, CheckpointError, Reader, Writer};
use crate::world_model::dataset::{self, Start};

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
        fit.run(noise, &tick)
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
    fn run(&self, noise: &Noise, tick: &(impl Fn() + Sync)) -> (Predictor, Vec<Point>) {
        let mut rng = noise.generator(Stream::Batches, 200 + self.kind as u64);
        let n = self.config.hidden;
        let recurrent = self.kind == 1;
        // Zeros last: it begins as constant velocity.
        let like = if recurrent {
            let gates = random(INPUTS + n, 4 * n, &mut rng);
            Cell::Lstm(Lstm { gates, out: Dense::zeros(n, 2) })
        } else {
            let layers = vec![random(INPUTS, n, &mut rng), random(n, n, &mut rng), Dense::zeros(n, 2)];
            Cell::Mlp(Mlp { layers })
        };
        let mut predictor = Predictor { cell: like, scaling: self.scaling };
        let mut net = backprop::layers(&predictor.cell);
        let mut adam = Adam::new(&net, 0.0, CLIP);
        let NetworksConfig { short_steps, mlp_steps, lstm_steps, mlp_rate, lstm_rate, .. } = *self.config;
        let (long_steps, rate) = if recurrent { (lstm_steps, lstm_rate) } else { (mlp_steps, mlp_rate) };
        let steps = short_steps + long_steps;
        let longest = self.data.actions.first().map_or(1, Vec::len);
        let mut curve = Vec::new();
        for step in 0..steps {
            let long = step >= short_steps;
            let (done, of) = if long { (step - short_steps, long_steps) } else { (step, short_steps) };
            let share = done as f64 / of as f64;
            let grown = (SHORT as f64 + longest as f64 * share / GROWTH) as usize;
            let horizon = if long { grown } else { SHORT }.min(longest);
            let (loss, grad) = self.gradient(&predictor, horizon, !long, &mut rng);
            let fall = 0.01 + 0.99 * 0.5 * (1.0 + (share * std::f64::consts::PI).cos());
            adam.set_rate((rate * fall) as f32);
            adam.descend(&mut net, &grad);
            predictor.cell = backprop::with_layers(&predictor.cell, &net);
            if (step + 1).is_multiple_of((steps / 100).max(1)) || step + 1 == steps {
                let held_out_px = self.judge(&predictor);
                curve.push(Point { step: step + 1, horizon, loss, held_out_px });
            }
            tick();
        }
        (predictor, curve)
    }

    /// Mean square distance of rollouts, each from a frame of an episode, to the pictures' latents, in
    /// units of `scaling.place`; step k weighs 1/k². At frame 0 the UAV rests. And its gradient.
    fn gradient(
        &self,
        predictor: &Predictor,
        horizon: usize,
        anywhere: bool,
        rng: &mut impl Rng,
    ) -> (f64, Mlp) {
        let longest = self.data.actions.first().map_or(1, Vec::len);
        let mut pick = |_| {
            let first = if anywhere { rng.random_range(0..=longest - horizon) } else { 0 };
            (rng.random_range(0..self.data.y.len()), first)
        };
        let count = self.config.batch.div_ceil(LANES);
        let blocks: Vec<Block> =
            (0..count).map(|_| self.block(&std::array::from_fn(&mut pick), horizon)).collect();
        let whole: f32 = (1..=horizon).map(|k| 1.0 / (k * k) as f32).sum();
        let weights: Vec<f32> = (1..=horizon).map(|k| 1.0 / (k * k) as f32 / whole).collect();
        let parts: Vec<(f64, Mlp)> =
            blocks.par_iter().map(|block| backprop::loss(predictor, block, &weights)).collect();
        let share = 1.0 / count as f32;
        let mut grad = backprop::layers(&predictor.cell);
        grad.layers.iter_mut().flat_map(|l| l.w.iter_mut().chain(&mut l.b)).for_each(|g| *g = 0.0);
        for (_, part) in &parts {
            for (sum, part) in grad.layers.iter_mut().zip(&part.layers) {
                let pairs = sum.w.iter_mut().chain(&mut sum.b).zip(part.w.iter().chain(&part.b));
                pairs.for_each(|(sum, part)| *sum = part.mul_add(share, *sum));
            }
        }
        (parts.iter().map(|(loss, _)| loss).sum::<f64>() / count as f64, grad)
    }

    /// Rollouts from these frames of these episodes.
    fn block(&self, picks: &[(usize, usize); LANES], horizon: usize) -> Block {
        let lanes = |of: &dyn Fn(usize, usize) -> Vector2<f64>| -> [Lane; 2] {
            let mut out = [ZERO; 2];
            for (l, &(n, first)) in picks.iter().enumerate() {
                let v = of(n, first);
                (out[0][l], out[1][l]) = (v.x as f32, v.y as f32);
            }
            out
        };
        let Data { y, actions } = self.data;
        Block {
            begin: [lanes(&|n, first| y[n][first]), lanes(&|n, first| y[n][first.saturating_sub(1)])],
            actions: (0..horizon).map(|k| lanes(&|n, first| actions[n][first + k])).collect(),
            shown: (0..horizon).map(|k| lanes(&|n, first| y[n][first + k + 1])).collect(),
        }
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

/// A layer as PyTorch starts it: U(±1/sqrt(inputs)).
fn random(inputs: usize, outputs: usize, rng: &mut impl Rng) -> Dense {
    let bound = 1.0 / (inputs as f32).sqrt();
    let mut dense = Dense::zeros(inputs, outputs);
    dense.w.iter_mut().chain(&mut dense.b).for_each(|w| *w = rng.random_range(-bound..bound));
    dense
}

/// Bound of the gradient's norm.
const CLIP: f32 = 0.1;

/// Length of the rollouts of the short steps, intervals.
const SHORT: usize = 4;

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
    for (colour, (name, curve)) in [0, 3].into_iter().zip(NAMES.iter().zip(&trained.curves)) {
        for p in curve {
            text += &format!("{name},{},{},{:e},{:.4}\n", p.step, p.horizon, p.loss, p.held_out_px);
        }
        let points = curve.iter().map(|p| (p.step as f64, p.held_out_px)).collect();
        series.push(Series::line(*name, colour, points));
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
    chart::save(&chart, dir, "predictors_loss")
}
