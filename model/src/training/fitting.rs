//! The pieces of a training run, each from its inputs to its result: triples, features, latent heads,
//! predictors, probe, risk and channel heads. Knows no order and no files; `train` puts them together.

use crpl_sitl::camera::Frame;
use crpl_sitl::program::page::feed::Feed;
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rayon::prelude::*;

use crate::encoder::infer::Encoder;
use crate::encoder::module;
use crate::encoder::probe::{self, Probe};
use crate::encoder::weights::{self, LATENT, Weights, vector};
use crate::heads::labels::{self, BaseStation, Scene};
use crate::heads::networks::Heads;
use crate::numeric::statistics::quantile;
use crate::predictor::linear::{self, Half, Linear};
use crate::training::closed_form::{self, FitError, Triples};
use crate::training::heads::{self, Samples};
use crate::training::show::StageShow;
use crate::world_model::card::FitCheck;
use crate::world_model::config::TrainConfig;
use crate::world_model::dataset::{self, EDGE_BAND, Episode, Triple};
use crpl_sitl::camera::effects::{CameraSet, FrameId};

/// E_c and E_u, `[16][2]` each.
pub type Planes = [[[f32; 2]; LATENT]; 2];

/// Where the frames come from.
#[derive(Debug, Clone, Copy)]
pub struct TrainData<'a> {
    /// Positions and actions.
    pub episodes: &'a [Episode],
    /// The cameras.
    pub cameras: &'a CameraSet,
    /// The world.
    pub scenario: &'a Scenario,
}

/// What every piece reads.
#[derive(Debug, Clone, Copy)]
pub struct TrainContext<'a> {
    /// The configuration.
    pub config: &'a TrainConfig,
    /// Episodes, cameras, world.
    pub data: TrainData<'a>,
    /// E_c and E_u.
    pub planes: &'a Planes,
    /// All chance.
    pub noise: &'a Noise,
    /// burn's backend.
    pub device: &'a burn::tensor::Device,
    /// Whether progress is shown.
    pub bars: bool,
    /// Where others watch, if they can.
    pub feed: Option<&'a Feed>,
}

impl TrainContext<'_> {
    /// The frame of a training episode's frame.
    fn frame(&self, episode: usize, frame: usize) -> Frame {
        let TrainData { episodes, cameras, scenario } = self.data;
        let id = FrameId { series: episode as u64, frame: frame as u64 };
        cameras.apply(episodes[episode].frame(frame, scenario), id)
    }

    /// The frame of a labelled scene, each a series of its own beyond the episodes.
    fn scene(&self, number: usize, scene: &Scene) -> Frame {
        let id = FrameId { series: (1 << 32) + number as u64, frame: 0 };
        self.data.cameras.apply(scene.frame(self.data.scenario), id)
    }

    /// A stage of `length` steps.
    #[must_use]
    pub fn bar(&self, name: &'static str, length: usize) -> StageShow {
        if self.bars { StageShow::begin(name, length, self.feed) } else { StageShow::hidden() }
    }
}

/// The triples of both sets: long and short lags.
#[must_use]
pub fn pick(context: &TrainContext<'_>) -> [Vec<Triple>; 2] {
    pick_some(context, context.config.frames, 0)
}

/// Triples of `frames` frames in all; `purpose` keeps several draws of one seed apart.
#[must_use]
pub fn pick_some(context: &TrainContext<'_>, frames: usize, purpose: u64) -> [Vec<Triple>; 2] {
    let config = context.config;
    let mut rng = context.noise.generator(Stream::Batches, purpose);
    let count = frames / 6;
    [config.long, config.short]
        .map(|[low, high]| dataset::triples(context.data.episodes, count, low, high, &mut rng))
}

/// Features of both sets' frames, by the backend.
#[must_use]
pub fn features(context: &TrainContext<'_>, weights: &Weights, picks: &[Vec<Triple>; 2]) -> [Triples; 2] {
    let trunk = module::EncoderModule::new(weights, context.device);
    let bar = context.bar("features", 6 * (context.config.frames / 6));
    let sets = picks.each_ref().map(|triples| {
        let features = [0, 1, 2].map(|n| {
            let draw = |t: &Triple| context.frame(t.episode, t.first + n * t.lag);
            let tick = |done| bar.add(done as u64);
            module::features_of(
                &trunk,
                &weights.input,
                context.device,
                triples,
                context.config.batch,
                draw,
                tick,
            )
        });
        Triples { features, targets: targets(context, triples) }
    });
    bar.finish();
    sets
}

/// The weights with heads fitted to these triples, the features by the flight path's encoder: quick.
///
/// # Errors
/// If the normal equations are singular.
pub fn refitted(
    context: &TrainContext<'_>,
    mut weights: Weights,
    picks: &[Vec<Triple>; 2],
) -> Result<(Weights, FitCheck), FitError> {
    let encoder = Encoder::new(weights.clone());
    let sets = picks.each_ref().map(|triples| {
        let features = [0, 1, 2].map(|n| {
            let see = |t: &Triple| encoder.features(&context.frame(t.episode, t.first + n * t.lag));
            triples.par_iter().map(see).collect()
        });
        Triples { features, targets: targets(context, triples) }
    });
    let check = fit_heads(context, &mut weights, &sets)?;
    Ok((weights, check))
}

/// S a_max times the response of every triple: what z_c's double difference must be.
#[must_use]
pub fn targets(context: &TrainContext<'_>, triples: &[Triple]) -> Vec<Vector2<f64>> {
    let unit = context.config.encoder.scale * context.data.scenario.dynamics.a_max;
    triples.iter().map(|t| unit * context.data.episodes[t.episode].input_response(t.first, t.lag)).collect()
}

/// Some of the triples' first frames: what a colour layer's masses are calibrated on.
#[must_use]
pub fn some_frames(context: &TrainContext<'_>, picks: &[Vec<Triple>; 2]) -> Vec<Frame> {
    const COUNT: usize = 1000;
    picks[1].par_iter().take(COUNT).map(|t| context.frame(t.episode, t.first)).collect()
}

/// Fits both latent heads in place.
///
/// # Errors
/// If the normal equations are singular.
pub fn fit_heads(
    context: &TrainContext<'_>,
    weights: &mut Weights,
    [long, short]: &[Triples; 2],
) -> Result<FitCheck, FitError> {
    let config = context.config;
    let (c, residual) = closed_form::controllable([long, short], config.encoder.gated, &config.closed_form)?;
    let (u, eigenvalues) = closed_form::uncontrollable(short, long, &config.closed_form)?;
    weights.head_c = c.head(&context.planes[0]);
    weights.head_u = u.head(&context.planes[1]);
    let px = 100.0 / config.encoder.scale;
    Ok(FitCheck { residual_c_px: px * residual, eigenvalues })
}

/// Ψ of both halves from episodes that are encoded frame by frame; `None` if the normal equations are singular.
pub fn fit_predictor(context: &TrainContext<'_>, encoder: &Encoder) -> Option<Linear> {
    let config = context.config;
    let count = config.predictor.episodes.min(context.data.episodes.len());
    let bar = context.bar("predictor", count);
    let wide = |z: &[f32; LATENT]| Half::from_fn(|k, _| f64::from(z[k]));
    let (mut c, mut u, mut lagged) = (Vec::new(), Vec::new(), Vec::new());
    let lag = config.predictor.lag;
    for (number, episode) in context.data.episodes[..count].iter().enumerate() {
        let frames: Vec<usize> = (0..episode.uav.len()).collect();
        let latents = encoder.encode_all(&frames, |k| context.frame(number, *k));
        for (k, a) in episode.actions.iter().enumerate() {
            let window = &latents[k..k + 3];
            let half = |pick: fn(&crate::encoder::infer::Latent) -> &[f32; LATENT]| {
                [0, 1, 2].map(|n| wide(pick(&window[n])))
            };
            c.push((half(|l| &l.z_c), *a));
            u.push((half(|l| &l.z_u), Vector2::zeros()));
        }
        for k in 0..latents.len().saturating_sub(2 * lag) {
            lagged.push(([0, 1, 2].map(|n| wide(&latents[k + n * lag].z_c)), episode.input_response(k, lag)));
        }
        bar.add(1);
    }
    bar.finish();
    let (c0, c1, one_step) = linear::fit_pinned(&c, config.predictor.ridge)?;
    let ca = if lag == 1 { one_step } else { linear::fit_action(&lagged) };
    let kept = without_bounces(u, config.closed_form.keep);
    let (u0, u1) = linear::fit_free(&kept, config.predictor.ridge)?;
    Some(Linear { c0, c1, ca, u0, u1 })
}

/// The windows of z_u that constant velocity explains best: the others hit a wall.
fn without_bounces(windows: Vec<linear::Window>, keep: f64) -> Vec<linear::Window> {
    let size = |z: &[Half; 3]| (z[2] - z[1] * 2.0 + z[0]).norm_squared();
    let limit = quantile(&windows.iter().map(|(z, _)| size(z)).collect::<Vec<_>>(), keep);
    windows.into_iter().filter(|(z, _)| size(z) <= limit).collect()
}

/// Affine maps to positions, on labelled frames with whole discs.
#[must_use]
pub fn fit_probe(context: &TrainContext<'_>, encoder: &Encoder) -> Probe {
    let scenario: &Scenario = context.data.scenario;
    let mut rng = context.noise.generator(Stream::Evaluation, 10);
    let whole = |s: &Scene| s.uav.iter().all(|x| (EDGE_BAND..=1.0 - EDGE_BAND).contains(x));
    let scenes: Vec<Scene> = std::iter::repeat_with(|| labels::uniform_scene(scenario, &mut rng))
        .filter(whole)
        .take(context.config.evaluation.frames)
        .collect();
    let (y_c, y_u) = encode(context, encoder, &scenes);
    let y_c: Vec<_> = y_c.into_iter().map(vector).collect();
    let y_u: Vec<_> = y_u.into_iter().map(vector).collect();
    let r_c: Vec<_> = scenes.iter().map(|s| s.uav).collect();
    let r_u: Vec<_> = scenes.iter().map(|s| s.obstacle).collect();
    Probe { c: probe::fit(&y_c, &r_c), u: probe::fit(&y_u, &r_u) }
}

/// Risk and channel heads on labelled frames, with base stations anywhere in the frame's square.
#[must_use]
pub fn train_heads(context: &TrainContext<'_>, encoder: &Encoder, probe: &Probe) -> Heads {
    let (config, scenario) = (&context.config.heads, context.data.scenario);
    let mut rng = context.noise.generator(Stream::Data, u64::from(u32::MAX) - 1);
    let drawn = labels::sample(config.frames, BaseStation::Anywhere, scenario, &mut rng);
    let floor = config.distance_floor;
    let scenes: Vec<Scene> = drawn.iter().map(|(scene, _)| *scene).collect();
    let (y_c, y_u) = encode(context, encoder, &scenes);
    let samples = Samples {
        y_c,
        y_u,
        station: drawn.iter().map(|(_, station)| *station).collect(),
        label: drawn.iter().map(|(scene, station)| scene.label(*station, scenario, floor)).collect(),
    };
    let bar = context.bar("heads", 2 * config.steps);
    let heads = heads::train(&samples, probe, config, context.device, context.noise, || bar.add(1));
    bar.finish();
    heads
}

/// Plane coordinates of both halves of these scenes' frames.
fn encode(context: &TrainContext<'_>, encoder: &Encoder, scenes: &[Scene]) -> (Vec<[f32; 2]>, Vec<[f32; 2]>) {
    let numbered: Vec<usize> = (0..scenes.len()).collect();
    let latents = encoder.encode_all(&numbered, |&n| context.scene(n, &scenes[n]));
    let [plane_c, plane_u] = context.planes;
    latents.iter().map(|l| (weights::on_plane(plane_c, &l.z_c), weights::on_plane(plane_u, &l.z_u))).unzip()
}
