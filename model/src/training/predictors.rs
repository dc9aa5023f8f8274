//! Training of the MLP and LSTM predictors: first rollouts of 4 steps from anywhere, which are
//! cheap, then rollouts from rest that grow to the whole horizon; both are compared with the latents of
//! the frames along them. Beside them the bounds of motion are fitted ([`bounds`]).
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
use crate::numeric::adam::{Adam, Betas};
use crate::numeric::kernel::{LANES, ZERO};
use crate::numeric::mlp::Mlp;
use crate::numeric::statistics::quantile;
use crate::numeric::tensors::{self, Reader, TensorError, Writer};
use crate::predictor::bounded::Bounds;
use crate::predictor::linear::Pair;
use crate::predictor::residual::Scaling;
use crate::predictor::{Begin, Memory, Networks, NetworksConfig, Predictor, PredictorKind};
use crate::training::bounds::{self, LatentPath};
use crate::world_model::WorldModel;
use crate::world_model::checkpoint;
use crate::world_model::dataset::{Episode, EpisodeStart, Selection, select};

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
    /// The networks.
    pub networks: Networks,
    /// The learning curve of each.
    pub curves: Vec<Vec<Point>>,
}

/// Latents along episodes from rest, and the actions between them.
struct LatentEpisodes {
    /// y_c of frames 1..=T+1, one list an episode.
    y: Vec<Vec<Vector2<f64>>>,
    /// a_0..a_T.
    actions: Vec<Vec<Vector2<f64>>>,
}

impl LatentEpisodes {
    fn paths(self) -> Vec<LatentPath> {
        self.y.into_iter().zip(self.actions).map(|(y, actions)| LatentPath { y, actions }).collect()
    }
}

/// Fits the bounds and trains all of [`PredictorKind::NETWORKS`] on the latents of `model`, each on a core of its
/// own; `tick` is called for every step.
///
/// # Errors
/// If the world model has no fingerprint.
pub fn train(
    model: &WorldModel,
    config: &NetworksConfig,
    steps: usize,
    scenario: &Scenario,
    noise: &Noise,
    tick: impl Fn() + Sync,
) -> Result<Trained, TensorError> {
    let collect = |count, selection, purpose| {
        let drawn = select(count, steps, (EpisodeStart::Rest, selection), scenario, noise, purpose);
        encode(model, drawn.0, scenario)
    };
    let selection = if config.unselected { Selection::All } else { Selection::Free };
    let data = collect(config.episodes, selection, TRAINING_EPISODES);
    let held_out = collect(config.held_out, selection, TRAINING_EPISODES + 1);
    let all = collect(config.episodes, Selection::All, TRAINING_EPISODES + 2);
    let bounds = (config.episodes > 0).then(|| bounds::fit(&model.controllable(), &all.paths()));
    let scaling = scaling(&data);
    let px = SIDE as f64 / model.scale;
    let fit = |(number, kind): (usize, &PredictorKind)| {
        let mut rng = noise.generator(Stream::Batches, 200 + number as u64);
        let fresh = Predictor::untrained(*kind, scaling, config, &mut rng)?;
        let fit = Fit { data: &data, held_out: &held_out, config, px };
        Some(fit.run(fresh, rng, &tick))
    };
    let trained: Vec<Option<_>> = PredictorKind::NETWORKS.par_iter().enumerate().map(fit).collect();
    let (all, curves) = trained.into_iter().flatten().unzip();
    Ok(Trained {
        networks: Networks { all, bounds, world: checkpoint::planning_fingerprint(model)? },
        curves,
    })
}

/// Bounds for people: what they are by the probe, in px.
#[must_use]
pub fn in_px(bounds: &Bounds, model: &WorldModel) -> String {
    let (side, px) = (SIDE as f64, SIDE as f64 / model.scale);
    let [low, high] = [bounds.low, bounds.high].map(|y| model.probe.c.apply(y) * side);
    format!(
        "longest step {:.3} px, box x {:.2} to {:.2}, y {:.2} to {:.2} px, {:.3} of the speed left at its sides, \
         seen within {:.2} px of them",
        bounds.reach * px,
        low.x,
        high.x,
        low.y,
        high.y,
        bounds.kept,
        bounds.contact * px
    )
}

/// Keeps these episodes apart from others of the seed.
const TRAINING_EPISODES: u64 = 20;

fn encode(model: &WorldModel, episodes: Vec<Episode>, scenario: &Scenario) -> LatentEpisodes {
    let frames: Vec<(usize, usize)> =
        (0..episodes.len()).flat_map(|n| (1..episodes[n].uav.len()).map(move |k| (n, k))).collect();
    let latents = model.encode_all(&frames, |&(n, k)| episodes[n].frame(k, scenario));
    let y: Vec<_> = latents.iter().map(|l| vector(model.y_c(l))).collect();
    let length = episodes.first().map_or(1, |e| e.uav.len() - 1);
    LatentEpisodes {
        y: y.chunks(length).map(<[_]>::to_vec).collect(),
        actions: episodes.into_iter().map(|e| e.actions).collect(),
    }
}

fn scaling(data: &LatentEpisodes) -> Scaling {
    let rms = |values: &mut dyn Iterator<Item = Vector2<f64>>| {
        let (sum, count) = values.fold((0.0, 0usize), |(s, n), v| (s + v.norm_squared(), n + 2));
        (sum / count.max(1) as f64).sqrt().max(1e-6) as f32
    };
    Scaling {
        place: rms(&mut data.y.iter().flatten().copied()),
        step: rms(&mut data.y.iter().flat_map(|y| y.windows(2)).map(|y| y[1] - y[0])),
        residual: rms(&mut data.y.iter().flat_map(|y| y.windows(3)).map(|y| y[2] - y[1] * 2.0 + y[0])),
    }
}

/// One network's training.
struct Fit<'a> {
    data: &'a LatentEpisodes,
    held_out: &'a LatentEpisodes,
    config: &'a NetworksConfig,
    /// px per latent unit.
    px: f64,
}

impl Fit<'_> {
    fn run(
        &self,
        mut predictor: Predictor,
        mut rng: impl Rng,
        tick: &(impl Fn() + Sync),
    ) -> (Predictor, Vec<Point>) {
        let mut net = predictor.layers();
        let mut adam = Adam::of(&net, Betas::SLOW);
        let short_steps = self.config.short_steps;
        let (long_steps, rate) = self.config.schedule(predictor.kind());
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
            adam.descend(&mut net, &grad, CLIP, (rate * fall) as f32);
            predictor.set_layers(&net);
            if (step + 1).is_multiple_of((steps / 100).max(1)) || step + 1 == steps {
                let held_out_px = self.judge(&predictor);
                curve.push(Point { step: step + 1, horizon, loss, held_out_px });
            }
            tick();
        }
        (predictor, curve)
    }

    /// Mean square distance of rollouts, each from a frame of an episode, to the frames' latents, in
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
            blocks.par_iter().map(|block| rollout_loss(predictor, block, &weights)).collect();
        let share = 1.0 / count as f32;
        let mut grad = predictor.layers();
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
        let lanes = |of: &dyn Fn(usize, usize) -> Vector2<f64>| -> Pair {
            let mut out = [ZERO; 2];
            for (l, &(n, first)) in picks.iter().enumerate() {
                let v = of(n, first);
                (out[0][l], out[1][l]) = (v.x as f32, v.y as f32);
            }
            out
        };
        let LatentEpisodes { y, actions } = self.data;
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

/// Rollouts that are followed together, one a lane.
struct Block {
    /// y_k, y_{k-1} at the start.
    begin: [Pair; 2],
    /// a_k, a_{k+1}, ...
    actions: Vec<Pair>,
    /// What the frames show after each action: y_{k+1}, ...
    shown: Vec<Pair>,
}

/// Mean over the lanes of Σ_k weight_k |y_k - shown_k|² / place², place being the rms of the shown
/// coordinates, and its gradient in the layers of [`Predictor::layers`].
fn rollout_loss(predictor: &Predictor, block: &Block, weights: &[f32]) -> (f64, Mlp) {
    let place = predictor.scaling().map_or(1.0, |s| s.place);
    let horizon = weights.len();
    let mut memory = Memory::default();
    // y_{-1}, y_0, y_1, ... and the slopes in them.
    let mut y = vec![[ZERO; 2]; horizon + 2];
    (y[1], y[0]) = (block.begin[0], block.begin[1]);
    for k in 0..horizon {
        y[k + 2] = predictor.forward(&mut memory, &y[k + 1], &y[k], &block.actions[k]);
    }
    let mut sum = 0.0;
    let mut dy = vec![[ZERO; 2]; horizon + 2];
    for k in (0..horizon).rev() {
        let weight = weights[k] / (place * place * LANES as f32);
        for axis in 0..2 {
            for l in 0..LANES {
                let off = y[k + 2][axis][l] - block.shown[k][axis][l];
                sum += f64::from(weight * off * off);
                dy[k + 2][axis][l] += 2.0 * weight * off;
            }
        }
        let (earlier, later) = dy.split_at_mut(k + 2);
        let [.., d_before, d_now] = earlier else { continue };
        predictor.backward(&mut memory, &later[0], [d_now, d_before, &mut [ZERO; 2]]);
    }
    (sum, predictor.gradient(&memory))
}

/// Bound of the gradient's norm.
const CLIP: f32 = 0.1;

/// Length of the rollouts of the short steps, intervals.
const SHORT: usize = 4;

/// Share of the long steps after which rollouts have their whole length.
const GROWTH: f64 = 0.4;

/// Writes a finished stage.
///
/// # Errors
/// If a file cannot be written.
pub fn save(trained: &Trained, dir: &Path) -> Result<(), TensorError> {
    let mut out = Writer::default();
    for (network, curve) in trained.networks.all.iter().zip(&trained.curves) {
        let rows = curve.iter().flat_map(|p| [p.step as f64, p.horizon as f64, p.loss, p.held_out_px]);
        out.f64(network.kind().name(), &[curve.len(), 4], rows);
    }
    tensors::write_all(&dir.join(CURVES), &out.bytes()?)?;
    trained.networks.save(dir)
}

/// Name of the curves' file in a stage.
const CURVES: &str = "curves.safetensors";

/// Reads what [`save`] wrote.
///
/// # Errors
/// If a file is missing or a tensor has another shape.
pub fn load(dir: &Path) -> Result<Trained, TensorError> {
    let path = dir.join(CURVES);
    let bytes = tensors::read(&path)?;
    let from = Reader::new(&bytes, path)?;
    let curve = |name: &str| -> Result<Vec<Point>, TensorError> {
        let rows = from.shape(name)?.first().copied().unwrap_or(0);
        let flat = from.f64(name, &[rows, 4])?;
        let point =
            |p: &[f64]| Point { step: p[0] as usize, horizon: p[1] as usize, loss: p[2], held_out_px: p[3] };
        Ok(flat.chunks_exact(4).map(point).collect())
    };
    let networks = Networks::load(dir)?;
    let curves = networks.all.iter().map(|network| curve(network.kind().name()));
    Ok(Trained { curves: curves.collect::<Result<_, _>>()?, networks })
}

/// Writes the networks next to the checkpoint, and their learning curves as CSV, SVG and PNG.
///
/// # Errors
/// If a file cannot be written or the figure cannot be drawn.
pub fn publish(trained: &Trained, dir: &Path) -> Result<(), PlotError> {
    let failed = |e: TensorError| PlotError { path: dir.into(), message: e.to_string() };
    trained.networks.save(dir).map_err(failed)?;
    let mut text = String::from("network,step,horizon,loss,held_out_p90_px\n");
    let mut series = Vec::new();
    for (colour, (network, curve)) in [0, 3].into_iter().zip(trained.networks.all.iter().zip(&trained.curves))
    {
        let name = network.kind().name();
        for p in curve {
            text += &format!("{name},{},{},{:e},{:.4}\n", p.step, p.horizon, p.loss, p.held_out_px);
        }
        let points = curve.iter().map(|p| (p.step as f64, p.held_out_px)).collect();
        series.push(Series::line(name, colour, points));
    }
    tensors::write_all(&dir.join("predictors_loss.csv"), text.as_bytes()).map_err(failed)?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::kernel::Lane;

    fn lanes(steps: usize, size: f32) -> Vec<Pair> {
        let value = |n: usize| size * (n as f32 * 0.77).sin();
        let lane = |at: usize| -> Lane { std::array::from_fn(|l| value(at * LANES + l)) };
        (0..steps).map(|k| [lane(2 * k), lane(2 * k + 1)]).collect()
    }

    /// Against differences of the loss in every weight of both kinds.
    #[test]
    fn the_gradient_is_the_slope() {
        let scaling = Scaling { place: 2.0, step: 0.2, residual: 0.03 };
        let steps = 12;
        let begin = [lanes(1, 3.0)[0], lanes(1, 2.9)[0]];
        let block = Block { begin, actions: lanes(steps, 1.0), shown: lanes(steps, 3.0) };
        let weights: Vec<f32> = (1..=steps).map(|k| 1.0 / k as f32).collect();
        let config = NetworksConfig { hidden: 6, ..NetworksConfig::default() };
        for kind in PredictorKind::NETWORKS {
            let mut rng = Noise::new(3).generator(Stream::Batches, 0);
            let mut predictor = Predictor::untrained(kind, scaling, &config, &mut rng).unwrap();
            let mut net = predictor.layers();
            for (n, layer) in net.layers.iter_mut().enumerate() {
                let values = layer.w.iter_mut().chain(&mut layer.b).enumerate();
                values.for_each(|(k, w)| *w = 0.6 * ((k * 7 + n) as f32 * 1.7).sin());
            }
            predictor.set_layers(&net);
            let (_, grad) = rollout_loss(&predictor, &block, &weights);
            for (n, g) in grad.layers.iter().enumerate() {
                let size = g.w.iter().chain(&g.b).fold(0.0f32, |m, v| m.max(v.abs()));
                for k in 0..g.w.len() + g.b.len() {
                    let at = |h: f32| {
                        let (mut moved, mut layers) = (predictor.clone(), net.clone());
                        let layer = &mut layers.layers[n];
                        *layer.w.iter_mut().chain(&mut layer.b).nth(k).unwrap() += h;
                        moved.set_layers(&layers);
                        rollout_loss(&moved, &block, &weights).0
                    };
                    let h = 1e-2;
                    let slope = (at(h) - at(-h)) / f64::from(2.0 * h);
                    let got = f64::from(*g.w.iter().chain(&g.b).nth(k).unwrap());
                    let off = (slope - got).abs();
                    assert!(off < 0.01 * f64::from(size), "{kind:?} {n}, weight {k}: {got}, slope {slope}");
                }
            }
        }
    }
}
