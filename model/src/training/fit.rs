//! The pieces of a training run, each from its inputs to its result: triples, features, latent heads,
//! predictors, probe, risk and channel heads. Knows no order and no files; `train` puts them together.

use crpl_sitl::camera::Frame;
use crpl_sitl::program::progress;
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};
use indicatif::ProgressBar;
use nalgebra::Vector2;
use rayon::prelude::*;

use crate::encoder::infer::Encoder;
use crate::encoder::module;
use crate::encoder::probe::{self, Probe};
use crate::encoder::weights::{self, LATENT, Weights, vector};
use crate::heads::labels::{self, Scene, Station};
use crate::heads::networks::Heads;
use crate::numeric::statistics::quantile;
use crate::predictor::linear::{self, Half, Linear};
use crate::training::closed_form::{self, Check, FitError, Triples};
use crate::training::gradient::Data;
use crate::training::heads::{self, Samples};
use crate::training::lens::Shot;
use crate::world_model::config::TrainConfig;
use crate::world_model::dataset::{self, EDGE_BAND, Triple};

/// E_c and E_u, [16][2] each.
pub type Planes = [[[f32; 2]; LATENT]; 2];

/// What every piece reads.
#[derive(Debug, Clone, Copy)]
pub struct Setting<'a> {
    /// The configuration.
    pub config: &'a TrainConfig,
    /// Episodes, cameras, world.
    pub data: Data<'a>,
    /// E_c and E_u.
    pub planes: &'a Planes,
    /// All chance.
    pub noise: &'a Noise,
    /// burn's backend.
    pub device: &'a burn::tensor::Device,
    /// Whether progress is shown.
    pub bars: bool,
}

impl Setting<'_> {
    /// The picture of a training episode's frame.
    fn frame(&self, episode: usize, frame: usize) -> Frame {
        let Data { episodes, lenses, scenario } = self.data;
        let shot = Shot { series: episode as u64, frame };
        lenses.take(episodes[episode].frame(frame, scenario), shot)
    }

    /// The picture of a labelled scene, each a series of its own beyond the episodes.
    fn scene(&self, number: usize, scene: &Scene) -> Frame {
        let shot = Shot { series: (1 << 32) + number as u64, frame: 0 };
        self.data.lenses.take(scene.frame(self.data.scenario), shot)
    }

    /// A progress bar of `length` steps.
    #[must_use]
    pub fn bar(&self, name: &'static str, length: usize) -> ProgressBar {
        if self.bars { progress::bar(name, length as u64) } else { ProgressBar::hidden() }
    }
}

/// The triples of both sets: long and short lags.
#[must_use]
pub fn pick(setting: &Setting<'_>) -> [Vec<Triple>; 2] {
    pick_some(setting, setting.config.frames, 0)
}

/// Triples of `frames` pictures in all; `purpose` keeps several draws of one seed apart.
#[must_use]
pub fn pick_some(setting: &Setting<'_>, frames: usize, purpose: u64) -> [Vec<Triple>; 2] {
    let config = setting.config;
    let mut rng = setting.noise.generator(Stream::Batches, purpose);
    let count = frames / 6;
    [config.long, config.short]
        .map(|[low, high]| dataset::triples(setting.data.episodes, count, low, high, &mut rng))
}

/// Features of both sets' pictures, by the backend.
#[must_use]
pub fn features(setting: &Setting<'_>, weights: &Weights, picks: &[Vec<Triple>; 2]) -> [Triples; 2] {
    let trunk = module::Encoder::new(weights, setting.device);
    let bar = setting.bar("features", 6 * (setting.config.frames / 6));
    let sets = picks.each_ref().map(|triples| {
        let features = [0, 1, 2].map(|n| {
            let draw = |t: &Triple| setting.frame(t.episode, t.first + n * t.lag);
            let tick = |done| bar.inc(done as u64);
            module::features_of(
                &trunk,
                &weights.input,
                setting.device,
                triples,
                setting.config.batch,
                draw,
                tick,
            )
        });
        Triples { features, targets: targets(setting, triples) }
    });
    bar.finish();
    sets
}

/// The weights with heads fitted to these triples, the features by the flight path's encoder: quick.
pub fn refitted(
    setting: &Setting<'_>,
    mut weights: Weights,
    picks: &[Vec<Triple>; 2],
) -> Result<(Weights, Check), FitError> {
    let encoder = Encoder::new(weights.clone());
    let sets = picks.each_ref().map(|triples| {
        let features = [0, 1, 2].map(|n| {
            let see = |t: &Triple| encoder.features(&setting.frame(t.episode, t.first + n * t.lag));
            triples.par_iter().map(see).collect()
        });
        Triples { features, targets: targets(setting, triples) }
    });
    let check = fit_heads(setting, &mut weights, &sets)?;
    Ok((weights, check))
}

/// S a_max times the drive of every triple: what z_c's double difference must be.
#[must_use]
pub fn targets(setting: &Setting<'_>, triples: &[Triple]) -> Vec<Vector2<f64>> {
    let unit = setting.config.encoder.scale * setting.data.scenario.dynamics.a_max;
    triples.iter().map(|t| unit * setting.data.episodes[t.episode].drive(t.first, t.lag)).collect()
}

/// Some of the triples' first pictures: what a colour layer's masses are calibrated on.
#[must_use]
pub fn some_frames(setting: &Setting<'_>, picks: &[Vec<Triple>; 2]) -> Vec<Frame> {
    const COUNT: usize = 1000;
    picks[1].par_iter().take(COUNT).map(|t| setting.frame(t.episode, t.first)).collect()
}

/// Fits both latent heads in place.
pub fn fit_heads(
    setting: &Setting<'_>,
    weights: &mut Weights,
    [long, short]: &[Triples; 2],
) -> Result<Check, FitError> {
    let config = setting.config;
    let (c, residual) = closed_form::controllable([long, short], config.encoder.gated, &config.closed_form)?;
    let (u, eigenvalues) = closed_form::uncontrollable(short, long, &config.closed_form)?;
    weights.head_c = c.head(&setting.planes[0]);
    weights.head_u = u.head(&setting.planes[1]);
    let px = 100.0 / config.encoder.scale;
    Ok(Check { residual_c_px: px * residual, eigenvalues })
}

/// Ψ of both halves from episodes that are encoded frame by frame; `None` if the normal equations are singular.
pub fn fit_predictor(setting: &Setting<'_>, encoder: &Encoder) -> Option<Linear> {
    let config = setting.config;
    let count = config.predictor.episodes.min(setting.data.episodes.len());
    let bar = setting.bar("predictor", count);
    let wide = |z: &[f32; LATENT]| Half::from_fn(|k, _| f64::from(z[k]));
    let (mut c, mut u, mut lagged) = (Vec::new(), Vec::new(), Vec::new());
    let lag = config.predictor.lag;
    for (number, episode) in setting.data.episodes[..count].iter().enumerate() {
        let frames: Vec<usize> = (0..episode.uav.len()).collect();
        let latents = encoder.encode_all(&frames, |k| setting.frame(number, *k));
        for (k, a) in episode.actions.iter().enumerate() {
            let window = &latents[k..k + 3];
            let half = |pick: fn(&crate::encoder::infer::Latent) -> &[f32; LATENT]| {
                [0, 1, 2].map(|n| wide(pick(&window[n])))
            };
            c.push((half(|l| &l.z_c), *a));
            u.push((half(|l| &l.z_u), Vector2::zeros()));
        }
        for k in 0..latents.len().saturating_sub(2 * lag) {
            lagged.push(([0, 1, 2].map(|n| wide(&latents[k + n * lag].z_c)), episode.drive(k, lag)));
        }
        bar.inc(1);
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

/// Affine maps to positions, on labelled pictures with whole discs.
#[must_use]
pub fn fit_probe(setting: &Setting<'_>, encoder: &Encoder) -> Probe {
    let scenario: &Scenario = setting.data.scenario;
    let mut rng = setting.noise.generator(Stream::Evaluation, 10);
    let whole = |s: &Scene| s.uav.iter().all(|x| (EDGE_BAND..=1.0 - EDGE_BAND).contains(x));
    let scenes: Vec<Scene> = std::iter::repeat_with(|| labels::uniform_scene(scenario, &mut rng))
        .filter(whole)
        .take(setting.config.evaluation.frames)
        .collect();
    let (y_c, y_u) = encode(setting, encoder, &scenes);
    let y_c: Vec<_> = y_c.into_iter().map(vector).collect();
    let y_u: Vec<_> = y_u.into_iter().map(vector).collect();
    let r_c: Vec<_> = scenes.iter().map(|s| s.uav).collect();
    let r_u: Vec<_> = scenes.iter().map(|s| s.obstacle).collect();
    Probe { c: probe::fit(&y_c, &r_c), u: probe::fit(&y_u, &r_u) }
}

/// Risk and channel heads on labelled pictures. Base stations stand anywhere in the frame's square.
#[must_use]
pub fn train_heads(setting: &Setting<'_>, encoder: &Encoder, probe: &Probe) -> Heads {
    let (config, scenario) = (&setting.config.heads, setting.data.scenario);
    let mut rng = setting.noise.generator(Stream::Data, u64::from(u32::MAX) - 1);
    let drawn = labels::sample(config.frames, Station::Anywhere, scenario, &mut rng);
    let floor = config.distance_floor;
    let scenes: Vec<Scene> = drawn.iter().map(|(scene, _)| *scene).collect();
    let (y_c, y_u) = encode(setting, encoder, &scenes);
    let samples = Samples {
        y_c,
        y_u,
        station: drawn.iter().map(|(_, station)| *station).collect(),
        label: drawn.iter().map(|(scene, station)| scene.label(*station, scenario, floor)).collect(),
    };
    let bar = setting.bar("heads", 2 * config.steps);
    let heads = heads::train(&samples, probe, config, setting.device, setting.noise, || bar.inc(1));
    bar.finish();
    heads
}

/// Plane coordinates of both halves of these scenes' pictures.
fn encode(setting: &Setting<'_>, encoder: &Encoder, scenes: &[Scene]) -> (Vec<[f32; 2]>, Vec<[f32; 2]>) {
    let numbered: Vec<usize> = (0..scenes.len()).collect();
    let latents = encoder.encode_all(&numbered, |&n| setting.scene(n, &scenes[n]));
    let [plane_c, plane_u] = setting.planes;
    latents.iter().map(|l| (weights::on_plane(plane_c, &l.z_c), weights::on_plane(plane_u, &l.z_u))).unzip()
}
