//! Training, read from top to bottom: collect, features, closed form, predictor, probe, heads,
//! evaluate (recipe A: the trunk keeps its structured start, only the last layers are fitted).
//!
//! Every finished stage is on disk, so a run that was stopped goes on where it was and ends with the
//! bytes of one that was not. All chance comes from the seed.

use std::path::{Path, PathBuf};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use nalgebra::Vector2;
use sitl::scenario::Scenario;
use sitl::world::noise::{Noise, Stream};

use crate::checkpoint::{self, CARD, CheckpointError, FORMAT, Reader, Writer};
use crate::closed_form::{self, Check, FitError, Triples};
use crate::config::{ConfigError, DataConfig, TrainConfig};
use crate::dataset::{self, EDGE_BAND, Episode, Start, Triple};
use crate::heads::{self, Scene, Station};
use crate::heads_at::Heads;
use crate::heads_fit::{self, Samples};
use crate::infer::{Encoder, Features};
use crate::jepa::{self, Backend, NoBackend};
use crate::predictor::{self, Half, Linear};
use crate::probe::{self, Probe};
use crate::weights::{self, FEATURES, Input, LATENT, Weights};
use crate::world_model::{Card, WorldModel};
use crate::{evaluate, weights::vector};

/// Why training stopped.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A file could not be read or written, or is not what it should be.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The configuration does not parse or makes no sense.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The heads could not be fitted.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// The predictors could not be fitted.
    #[error("the predictors' normal equations are singular: take more episodes")]
    Predictor,
    /// The backend is not in this build.
    #[error(transparent)]
    Backend(#[from] NoBackend),
    /// The unfinished run was made with another configuration.
    #[error("{0}: the unfinished run there has another configuration or backend; train without --resume")]
    Resume(PathBuf),
}

/// What a run needs beside its configuration.
#[derive(Debug, Clone)]
pub struct Run {
    /// burn's backend.
    pub backend: Backend,
    /// Where the checkpoint goes; unfinished stages stand in `stages` beside it.
    pub out: PathBuf,
    /// A dataset of `model collect` instead of a new one.
    pub data: Option<PathBuf>,
    /// Whether to go on with an unfinished run.
    pub resume: bool,
}

/// Draws the training episodes.
#[must_use]
pub fn collect(config: &TrainConfig, scenario: &Scenario) -> Vec<Episode> {
    let noise = Noise::new(config.seed);
    let DataConfig { episodes, edge_episodes, steps } = config.data;
    let mut all = dataset::collect(episodes, steps, Start::Mixed, scenario, &noise, 0);
    all.extend(dataset::collect(edge_episodes, steps, Start::Edge, scenario, &noise, 1));
    // Mixed, so that the first few are like all.
    rand::seq::SliceRandom::shuffle(
        all.as_mut_slice(),
        &mut noise.generator(Stream::Data, u64::from(u32::MAX)),
    );
    all
}

/// The whole recipe. Writes the checkpoint and returns it.
pub fn train(config: &TrainConfig, run: &Run) -> Result<WorldModel, TrainError> {
    config.check()?;
    let (started, cpu_before, revision) = (Instant::now(), cpu_seconds(), sitl::revision());
    let (scenario, noise) = (Scenario::default(), Noise::new(config.seed));
    let device = run.backend.device()?;
    let stages = Stages::open(config, run)?;

    // Episodes: positions of both bodies and the actions between them.
    let episodes = stages.keep(
        "episodes",
        |dir| dataset::load(dir, config.data.steps),
        || match &run.data {
            Some(dir) => Ok(dataset::load(dir, config.data.steps)?),
            None => Ok(collect(config, &scenario)),
        },
        |episodes, dir| dataset::save(episodes, dir),
    )?;

    // A structured start that keeps positions linear in the features.
    let normalise = [config.encoder.normalise[0], false, config.encoder.normalise[1]];
    let input = Input::new(&scenario, normalise);
    let mut weights = Weights::initial(input, config.encoder.mix, config.encoder.gated, &noise);
    let planes = [weights::random_plane(&noise, 1), weights::random_plane(&noise, 2)];

    // Features of the triples, by the backend.
    let picks = pick(config, &episodes, &noise);
    let sets = stages.keep(
        "features",
        |dir| load_features(dir, config, &episodes, &picks),
        || {
            let trunk = jepa::Encoder::new(&weights, &device);
            let bar = bar("features", 6 * (config.frames / 6));
            let sets = picks.each_ref().map(|triples| {
                features(&trunk, &input, &device, &episodes, triples, config, &scenario, &bar)
            });
            bar.finish();
            Ok(sets)
        },
        save_features,
    )?;

    // The latent heads, in closed form.
    let (encoder, check) = stages.keep(
        "encoder",
        load_encoder,
        || {
            let check = fit_heads(&mut weights, &sets, &planes, config)?;
            Ok((Encoder::new(weights.clone()), check))
        },
        save_encoder,
    )?;
    if check.eigenvalues[1] > closed_form::EIGENVALUE_LIMIT {
        tracing::warn!(second = check.eigenvalues[1], "z_u may not be the obstacle: take more frames");
    }

    // Predictors and probe.
    let (predictor, probe) = stages.keep(
        "predictor",
        |dir| {
            read(dir, "predictor.safetensors", |r| {
                Ok((checkpoint::get_predictor(r)?, checkpoint::get_probe(r)?))
            })
        },
        || {
            let predictor = fit_predictor(&encoder, &episodes, config, &scenario)?;
            Ok((predictor, fit_probe(&encoder, &planes, config, &scenario, &noise)))
        },
        |(predictor, probe), dir| {
            let mut out = Writer::default();
            checkpoint::put_predictor(&mut out, predictor);
            checkpoint::put_probe(&mut out, probe);
            checkpoint::write_all(&dir.join("predictor.safetensors"), &out.bytes()?)
        },
    )?;

    // Risk and channel heads, by gradient descent on labelled pictures.
    let heads = stages.keep(
        "heads",
        |dir| read(dir, "heads.safetensors", checkpoint::get_heads),
        || Ok(train_heads(&encoder, &planes, &probe, config, &device, &scenario, &noise)),
        |heads: &Heads, dir| {
            let mut out = Writer::default();
            checkpoint::put_heads(&mut out, heads);
            checkpoint::write_all(&dir.join("heads.safetensors"), &out.bytes()?)
        },
    )?;

    // Measured on fresh pictures.
    let card = Card {
        format: FORMAT.into(),
        backend: run.backend.name().into(),
        config: config.clone(),
        ..Card::default()
    };
    let [plane_c, plane_u] = planes;
    let mut model =
        WorldModel { encoder, plane_c, plane_u, scale: config.encoder.scale, predictor, heads, probe, card };
    let held_out = Noise::new(config.seed ^ HELD_OUT);
    model.card.metrics =
        evaluate::measure(&model, &config.evaluation, &config.heads, &scenario, &held_out, check);
    model.save(&run.out)?;
    let (wall, cpu) = (started.elapsed().as_secs_f64(), cpu_seconds() - cpu_before);
    let card = card_text(&model, &revision, wall, cpu);
    checkpoint::write_all(&run.out.join(CARD), card.as_bytes())?;
    stages.remove()?;
    Ok(model)
}

/// Turns the seed of training into that of evaluation.
const HELD_OUT: u64 = 0x6865_6c64_6f75_7421;

/// The triples of both sets: long and short lags.
fn pick(config: &TrainConfig, episodes: &[Episode], noise: &Noise) -> [Vec<Triple>; 2] {
    let mut rng = noise.generator(Stream::Batches, 0);
    let count = config.frames / 6;
    [config.long, config.short].map(|[low, high]| dataset::triples(episodes, count, low, high, &mut rng))
}

#[expect(clippy::too_many_arguments, reason = "one call, each argument named at it")]
fn features(
    trunk: &jepa::Encoder,
    input: &Input,
    device: &burn::tensor::Device,
    episodes: &[Episode],
    triples: &[Triple],
    config: &TrainConfig,
    scenario: &Scenario,
    bar: &ProgressBar,
) -> Triples {
    let features = [0, 1, 2].map(|n| {
        let draw = |t: &Triple| episodes[t.episode].frame(t.first + n * t.lag, scenario);
        jepa::features_of(trunk, input, device, triples, config.batch, draw, |done| bar.inc(done as u64))
    });
    Triples { features, targets: targets(episodes, triples, config, scenario) }
}

/// S a_max times the drive of every triple: what z_c's double difference must be.
fn targets(
    episodes: &[Episode],
    triples: &[Triple],
    config: &TrainConfig,
    scenario: &Scenario,
) -> Vec<Vector2<f64>> {
    let unit = config.encoder.scale * scenario.dynamics.a_max;
    triples.iter().map(|t| unit * episodes[t.episode].drive(t.first, t.lag)).collect()
}

/// Fits both heads in place.
fn fit_heads(
    weights: &mut Weights,
    sets: &[Triples; 2],
    planes: &[[[f32; 2]; LATENT]; 2],
    config: &TrainConfig,
) -> Result<Check, TrainError> {
    let [long, short] = sets;
    let (c, residual) = closed_form::controllable([long, short], config.encoder.gated, &config.closed_form)?;
    let (u, eigenvalues) = closed_form::uncontrollable(short, long, &config.closed_form)?;
    weights.head_c = c.head(&planes[0]);
    weights.head_u = u.head(&planes[1]);
    let px = 100.0 / config.encoder.scale;
    Ok(Check { residual_c_px: px * residual, eigenvalues })
}

/// Ψ of both halves from episodes that are encoded frame by frame.
fn fit_predictor(
    encoder: &Encoder,
    episodes: &[Episode],
    config: &TrainConfig,
    scenario: &Scenario,
) -> Result<Linear, TrainError> {
    let episodes = &episodes[..config.predictor.episodes.min(episodes.len())];
    let bar = bar("predictor", episodes.len());
    let wide = |z: &[f32; LATENT]| Half::from_fn(|k, _| f64::from(z[k]));
    let (mut c, mut u, mut lagged) = (Vec::new(), Vec::new(), Vec::new());
    let lag = config.predictor.lag;
    for episode in episodes {
        let frames: Vec<usize> = (0..episode.uav.len()).collect();
        let latents = encoder.encode_all(&frames, |k| episode.frame(*k, scenario));
        for (k, a) in episode.actions.iter().enumerate() {
            let window = &latents[k..k + 3];
            let half =
                |pick: fn(&crate::infer::Latent) -> &[f32; LATENT]| [0, 1, 2].map(|n| wide(pick(&window[n])));
            c.push((half(|l| &l.z_c), *a));
            u.push((half(|l| &l.z_u), Vector2::zeros()));
        }
        for k in 0..latents.len().saturating_sub(2 * lag) {
            lagged.push(([0, 1, 2].map(|n| wide(&latents[k + n * lag].z_c)), episode.drive(k, lag)));
        }
        bar.inc(1);
    }
    bar.finish();
    let (c0, c1, one_step) =
        predictor::fit_pinned(&c, config.predictor.ridge).ok_or(TrainError::Predictor)?;
    let ca = if lag == 1 { one_step } else { predictor::fit_action(&lagged) };
    let kept = without_bounces(u, config.closed_form.keep);
    let (u0, u1) = predictor::fit_free(&kept, config.predictor.ridge).ok_or(TrainError::Predictor)?;
    Ok(Linear { c0, c1, ca, u0, u1 })
}

/// The windows of z_u that constant velocity explains best: the others hit a wall.
fn without_bounces(windows: Vec<predictor::Window>, keep: f64) -> Vec<predictor::Window> {
    let size = |z: &[Half; 3]| (z[2] - z[1] * 2.0 + z[0]).norm_squared();
    let limit = probe::quantile(&windows.iter().map(|(z, _)| size(z)).collect::<Vec<_>>(), keep);
    windows.into_iter().filter(|(z, _)| size(z) <= limit).collect()
}

/// Affine maps to positions, on labelled pictures with whole discs.
fn fit_probe(
    encoder: &Encoder,
    planes: &[[[f32; 2]; LATENT]; 2],
    config: &TrainConfig,
    scenario: &Scenario,
    noise: &Noise,
) -> Probe {
    let mut rng = noise.generator(Stream::Evaluation, 10);
    let whole = |s: &Scene| s.uav.iter().all(|x| (EDGE_BAND..=1.0 - EDGE_BAND).contains(x));
    let scenes: Vec<Scene> = std::iter::repeat_with(|| heads::uniform_scene(scenario, &mut rng))
        .filter(whole)
        .take(config.evaluation.frames)
        .collect();
    let latents = encoder.encode_all(&scenes, |s| s.frame(scenario));
    let y_c: Vec<_> = latents.iter().map(|l| vector(weights::on_plane(&planes[0], &l.z_c))).collect();
    let y_u: Vec<_> = latents.iter().map(|l| vector(weights::on_plane(&planes[1], &l.z_u))).collect();
    let r_c: Vec<_> = scenes.iter().map(|s| s.uav).collect();
    let r_u: Vec<_> = scenes.iter().map(|s| s.obstacle).collect();
    Probe { c: probe::fit(&y_c, &r_c), u: probe::fit(&y_u, &r_u) }
}

/// Base stations stand anywhere in the frame's square.
fn train_heads(
    encoder: &Encoder,
    planes: &[[[f32; 2]; LATENT]; 2],
    probe: &Probe,
    config: &TrainConfig,
    device: &burn::tensor::Device,
    scenario: &Scenario,
    noise: &Noise,
) -> Heads {
    let mut rng = noise.generator(Stream::Data, u64::from(u32::MAX) - 1);
    let scenes = heads::sample(config.heads.frames, Station::Anywhere, scenario, &mut rng);
    let floor = config.heads.distance_floor;
    let latents = encoder.encode_all(&scenes, |(s, _)| s.frame(scenario));
    let samples = Samples {
        y_c: latents.iter().map(|l| weights::on_plane(&planes[0], &l.z_c)).collect(),
        y_u: latents.iter().map(|l| weights::on_plane(&planes[1], &l.z_u)).collect(),
        station: scenes.iter().map(|(_, station)| *station).collect(),
        label: scenes.iter().map(|(s, station)| s.label(*station, scenario, floor)).collect(),
    };
    let bar = bar("heads", 2 * config.heads.steps);
    let heads = heads_fit::train(&samples, probe, &config.heads, device, noise, || bar.inc(1));
    bar.finish();
    heads
}

/// Finished stages on disk.
struct Stages {
    dir: PathBuf,
}

impl Stages {
    /// Begins anew, or goes on with a run of the same configuration.
    fn open(config: &TrainConfig, run: &Run) -> Result<Self, TrainError> {
        let dir = run.out.join("stages");
        let failed = |source| CheckpointError::File { path: dir.clone(), source };
        let marker = dir.join("run.json");
        let wanted = serde_json::json!({ "config": config, "backend": run.backend, "data": run.data });
        let wanted = format!("{wanted:#}\n");
        if run.resume && dir.exists() {
            let found = std::fs::read_to_string(&marker).map_err(failed)?;
            if found != wanted {
                return Err(TrainError::Resume(dir));
            }
        } else {
            if dir.exists() {
                std::fs::remove_dir_all(&dir).map_err(failed)?;
            }
            std::fs::create_dir_all(&dir).map_err(failed)?;
            checkpoint::write_all(&marker, wanted.as_bytes())?;
        }
        Ok(Self { dir })
    }

    /// Reads the stage if it is finished, else makes and writes it; then it is read all the same, so
    /// that a resumed run sees exactly what an unbroken one does.
    fn keep<T>(
        &self,
        name: &str,
        load: impl Fn(&Path) -> Result<T, CheckpointError>,
        make: impl FnOnce() -> Result<T, TrainError>,
        save: impl Fn(&T, &Path) -> Result<(), CheckpointError>,
    ) -> Result<T, TrainError> {
        let dir = self.dir.join(name);
        if !dir.exists() {
            let started = Instant::now();
            let made = make()?;
            // Finished when it has its name.
            let beside = self.dir.join(format!("{name}.part"));
            let failed = |source| CheckpointError::File { path: beside.clone(), source };
            std::fs::create_dir_all(&beside).map_err(failed)?;
            save(&made, &beside)?;
            std::fs::rename(&beside, &dir).map_err(failed)?;
            tracing::info!(seconds = started.elapsed().as_secs_f32(), "stage {name} done");
        }
        Ok(load(&dir)?)
    }

    fn remove(self) -> Result<(), CheckpointError> {
        std::fs::remove_dir_all(&self.dir)
            .map_err(|source| CheckpointError::File { path: self.dir.clone(), source })
    }
}

fn read<T>(
    dir: &Path,
    name: &str,
    parse: impl Fn(&Reader<'_>) -> Result<T, CheckpointError>,
) -> Result<T, CheckpointError> {
    let path = dir.join(name);
    let bytes =
        std::fs::read(&path).map_err(|source| CheckpointError::File { path: path.clone(), source })?;
    parse(&Reader::new(&bytes, path)?)
}

fn save_features(sets: &[Triples; 2], dir: &Path) -> Result<(), CheckpointError> {
    let mut out = Writer::default();
    for (name, features) in names().iter().zip(sets.iter().flat_map(|s| &s.features)) {
        out.f32(&format!("{name}.h"), &[features.len(), FEATURES], features.iter().flat_map(|f| f.h.clone()));
        out.f32(&format!("{name}.q"), &[features.len(), 3], features.iter().flat_map(|f| f.missing));
    }
    checkpoint::write_all(&dir.join("features.safetensors"), &out.bytes()?)
}

fn load_features(
    dir: &Path,
    config: &TrainConfig,
    episodes: &[Episode],
    picks: &[Vec<Triple>; 2],
) -> Result<[Triples; 2], CheckpointError> {
    let names = names();
    read(dir, "features.safetensors", |from| {
        let one = |name: &str, count: usize| -> Result<Vec<Features>, CheckpointError> {
            let h = from.f32(&format!("{name}.h"), &[count, FEATURES])?;
            let q = from.f32(&format!("{name}.q"), &[count, 3])?;
            let rows = h.chunks_exact(FEATURES).zip(q.chunks_exact(3));
            Ok(rows.map(|(h, q)| Features { h: h.to_vec(), missing: [q[0], q[1], q[2]] }).collect())
        };
        let set = |n: usize| -> Result<Triples, CheckpointError> {
            let (names, triples) = (&names[3 * n..], &picks[n]);
            let count = triples.len();
            let features = [one(names[0], count)?, one(names[1], count)?, one(names[2], count)?];
            Ok(Triples { features, targets: targets(episodes, triples, config, &Scenario::default()) })
        };
        Ok([set(0)?, set(1)?])
    })
}

fn names() -> [&'static str; 6] {
    ["long.0", "long.1", "long.2", "short.0", "short.1", "short.2"]
}

fn save_encoder((encoder, check): &(Encoder, Check), dir: &Path) -> Result<(), CheckpointError> {
    let mut out = Writer::default();
    checkpoint::put_weights(&mut out, encoder.weights());
    out.f64("check", &[5], [check.residual_c_px].into_iter().chain(check.eigenvalues));
    checkpoint::write_all(&dir.join("encoder.safetensors"), &out.bytes()?)
}

fn load_encoder(dir: &Path) -> Result<(Encoder, Check), CheckpointError> {
    read(dir, "encoder.safetensors", |from| {
        let v = from.f64("check", &[5])?;
        let check = Check { residual_c_px: v[0], eigenvalues: [v[1], v[2], v[3], v[4]] };
        Ok((Encoder::new(checkpoint::get_weights(from)?), check))
    })
}

fn bar(name: &'static str, length: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{prefix:>10} {bar:40} {pos}/{len} {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length as u64).with_style(style).with_prefix(name)
}

/// CPU time of this process, user and system, seconds; 0 where the system does not tell.
#[must_use]
pub fn cpu_seconds() -> f64 {
    // Fields 14 and 15 of the line, counted after the name in parentheses; in ticks of 10 ms.
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    after_name.split_whitespace().skip(11).take(2).filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// The card for people.
fn card_text(model: &WorldModel, revision: &str, wall: f64, cpu: f64) -> String {
    let Card { backend, config, metrics, .. } = &model.card;
    let data = &config.data;
    format!(
        "# CRPL world model\n\n\
         JEPA encoder (100x100x3 to two 16-d latents, {} parameters), linear second-order predictors,\n\
         collision and channel heads, position probe.\n\n\
         | | |\n|---|---|\n\
         | trained by | `model train --seed {}`, backend {backend} |\n\
         | revision | {} |\n\
         | data | {} episodes and {} that begin at an edge, {} actions each; {} pictures for the latent heads, {} labelled ones for the risk and channel heads |\n\
         | method | structured start, closed-form latent heads; the trunk is not trained |\n\
         | time | {wall:.0} s wall, {cpu:.0} s CPU |\n\n\
         Measured on held-out pictures (l1 errors, 1 px = 0.01 unit):\n\n```text\n{}```\n",
        model.encoder.weights().parameters(),
        config.seed,
        revision,
        data.episodes,
        data.edge_episodes,
        data.steps,
        config.frames,
        config.heads.frames,
        metrics.table(),
    )
}
