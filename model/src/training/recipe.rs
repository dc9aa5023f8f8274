//! Training, read from top to bottom: collect, start values, gradient stage, features, closed form,
//! predictor, probe, heads, evaluate, alarms. The configuration names those of a run; the
//! shipped recipe has no gradient stage (the trunk keeps its structured start).
//!
//! Every finished stage is on disk, so an interrupted run resumes and ends with the
//! bytes of one that was not. All chance comes from the seed. A model that raises an alarm does not
//! ship.

use std::path::PathBuf;

use crpl_sitl::program::page::feed::Feed;
use crpl_sitl::program::timing::Stopwatch;
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};

use crate::encoder::infer::Encoder;
use crate::encoder::module::{Backend, NoBackend};
use crate::encoder::probe::Probe;
use crate::encoder::weights::{self, Colour, Input, Weights};
use crate::evaluation;
use crate::evaluation::chart::PlotError;
use crate::evaluation::diagnostics::{self, CollapseCheck, Diagnostics};
use crate::heads::networks::{COLLISION_WIDTHS, GAIN_WIDTHS, Heads};
use crate::numeric::mlp::Mlp;
use crate::numeric::tensors::{self, Stored, TensorError, Writer};
use crate::predictor::Predictor;
use crate::predictor::linear::Linear;
use crate::training::cache::{self, CacheError, StageCache};
use crate::training::closed_form::FitError;
use crate::training::fitting::{self, Planes, TrainContext, TrainData};
use crate::training::gradient::{self, GradientError};
use crate::training::learned::device::EncoderDevice;
use crate::training::learned::{self, LearnedError};
use crate::training::predictors::{self, Trained};
use crate::training::show::StageShow;
use crate::world_model::card::{Card, FitCheck};
use crate::world_model::checkpoint::{CARD, CheckpointError, FORMAT};
use crate::world_model::config::{ConfigError, DataConfig, LearnedTraining, TrainConfig};
use crate::world_model::dataset::{self, Episode, EpisodeStart, Triple};
use crate::world_model::sight::FrameEncoder;
use crate::world_model::stages::Init;
use crate::world_model::{WorldModel, plane};
use crpl_sitl::camera::cases::CameraError;
use crpl_sitl::camera::effects::CameraSet;

/// Why training stopped.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A file could not be read or written, or is not what it should be.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Tensors could not be read or written.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// The finished stages could not be used.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// The configuration does not parse or makes no sense.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The heads could not be fitted.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// The gradient stage stopped.
    #[error(transparent)]
    Gradient(#[from] GradientError),
    /// The predictors could not be fitted.
    #[error("the predictors' normal equations are singular: take more episodes")]
    Predictor,
    /// The learning curves could not be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// The backend is not in this build.
    #[error(transparent)]
    Backend(#[from] NoBackend),
    /// The learned encoder stopped.
    #[error(transparent)]
    Learned(#[from] LearnedError),
    /// A camera of the recording is unknown.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Nothing tells the distance at which the bodies touch.
    #[error(
        "the recording holds no contact of UAV and obstacle beside pictures without one: the risk head needs both"
    )]
    Contacts,
    /// The model is not fit to ship.
    #[error("the model does not ship: {alarms}; it stands in {dir} to be looked at")]
    Alarms {
        /// What is wrong, in words.
        alarms: String,
        /// Where the rejected model is.
        dir: PathBuf,
    },
}

/// What a run needs in addition to its configuration.
#[derive(Debug, Clone)]
pub struct Run {
    /// burn's backend.
    pub backend: Backend,
    /// Where the learned encoder's passes run.
    pub device: EncoderDevice,
    /// Folder of the checkpoint; the stages of an unfinished run are in `stages` inside it.
    pub out: PathBuf,
    /// A dataset of `model collect` instead of a new one.
    pub data: Option<PathBuf>,
    /// Whether to resume an unfinished run.
    pub resume: bool,
    /// Started with the run: the card says what training has cost.
    pub stopwatch: Stopwatch,
    /// Where others watch, if they can.
    pub feed: Option<Feed>,
}

impl Run {
    /// What computed, for the card.
    #[must_use]
    pub fn backends(&self) -> String {
        match self.device {
            EncoderDevice::Cpu => self.backend.name().into(),
            EncoderDevice::Wgpu => format!("{}; encoder on wgpu", self.backend.name()),
        }
    }
}

/// Where a model goes that does not ship, inside the run's folder.
pub const REJECTED: &str = "rejected";

/// Draws the training episodes.
#[must_use]
pub fn collect(config: &TrainConfig, scenario: &Scenario) -> Vec<Episode> {
    let noise = Noise::new(config.seed);
    let DataConfig { episodes, edge_episodes, steps } = config.data;
    let mut all = dataset::collect(episodes, steps, EpisodeStart::Mixed, scenario, &noise, 0);
    all.extend(dataset::collect(edge_episodes, steps, EpisodeStart::Edge, scenario, &noise, 1));
    // Mixed, so that the first few are like all.
    rand::seq::SliceRandom::shuffle(
        all.as_mut_slice(),
        &mut noise.generator(Stream::Data, u64::from(u32::MAX)),
    );
    all
}

/// The whole recipe. Writes the checkpoint and returns it with its diagnostics.
///
/// # Errors
/// [`TrainError::Alarms`] if the model is not fit to ship; else if a stage or a file fails.
pub fn train(config: &TrainConfig, run: &Run) -> Result<(WorldModel, Diagnostics), TrainError> {
    config.check()?;
    if let Some(part) = &config.learned {
        return learned::recipe::train(config, part, run);
    }
    let (scenario, noise) = (Scenario::default(), Noise::new(config.seed));
    let device = run.backend.device()?;
    let identity = serde_json::json!({ "config": config, "backend": run.backend, "data": run.data });
    let cache = StageCache::open(run.out.join("stages"), &format!("{identity:#}\n"), run.resume)?;

    // Episodes: positions of both bodies and the actions between them.
    let episodes = cache.keep::<_, TrainError>(
        "episodes",
        |dir| dataset::load(dir, config.data.steps),
        || match &run.data {
            Some(dir) => Ok(dataset::load(dir, config.data.steps)?),
            None => Ok(collect(config, &scenario)),
        },
        |episodes, dir| dataset::save(episodes, dir),
    )?;
    let cameras = CameraSet::new(&config.cameras, &noise);
    let data = TrainData { episodes: &episodes, cameras: &cameras, scenario: &scenario };
    let planes = planes(&noise);
    let context = TrainContext {
        config,
        data,
        planes: &planes,
        noise: &noise,
        device: &device,
        bars: true,
        feed: run.feed.as_ref(),
    };

    // The encoder, its predictors and its probe.
    let (encoder, check) = encoder(&context, &cache)?;
    let (predictor, probe) = readouts(&context, &encoder, &cache)?;

    // Risk and channel heads, by gradient descent on labelled frames.
    let heads = cache.keep::<_, TrainError>(
        "heads",
        |dir| cache::load_one(dir, HEADS),
        || Ok(fitting::train_heads(&context, &encoder, &probe)),
        |heads: &Heads, dir| cache::save_one(heads, dir, HEADS),
    )?;

    // Measured on fresh frames, and looked at for what a loss does not show.
    let mut model = assemble(&context, encoder, predictor, probe, heads);
    model.card.backend = run.backend.name().into();
    model.card.metrics = evaluation::measure(
        &model,
        &config.evaluation,
        &config.heads,
        &scenario,
        &config.held_out(),
        check.unwrap_or_default(),
    );
    let diagnostics = look_at(&model, &context, check);
    ship(model, diagnostics, run, cache)
}

/// Writes the checkpoint, and its card for people. Only a model without alarms takes the checkpoint's place, and gets
/// the networks that its linear predictor is compared with; another is written to [`REJECTED`]. The finished stages are
/// no longer needed then, and go.
///
/// # Errors
/// [`TrainError::Alarms`] if the model is not fit to ship; else if a stage or a file fails.
pub fn ship(
    model: WorldModel,
    diagnostics: Diagnostics,
    run: &Run,
    cache: StageCache,
) -> Result<(WorldModel, Diagnostics), TrainError> {
    let alarms = diagnostics.alarms(&model.card.config.alarms);
    let dir = if alarms.is_empty() { run.out.clone() } else { run.out.join(REJECTED) };
    model.save(&dir)?;
    if alarms.is_empty() {
        let trained = cache.keep(
            "networks",
            predictors::load,
            || networks(&model.card.config, &model, run.feed.as_ref()),
            predictors::save,
        )?;
        predictors::publish(&trained, &dir)?;
    }
    let card = card_text(&model, &diagnostics, &alarms, crate::revision(), run.stopwatch);
    tensors::write_all(&dir.join(CARD), card.as_bytes())?;
    cache.remove()?;
    if !alarms.is_empty() {
        return Err(TrainError::Alarms { alarms: in_words(&alarms), dir });
    }
    Ok((model, diagnostics))
}

/// The MLP and the LSTM on the latents of `model`, with a progress bar; `feed` is where others watch.
///
/// # Errors
/// If the world model has no fingerprint.
pub fn networks(
    config: &TrainConfig,
    model: &WorldModel,
    feed: Option<&Feed>,
) -> Result<Trained, TrainError> {
    let (scenario, noise) = (Scenario::default(), Noise::new(config.seed));
    let shown = StageShow::begin("networks", config.networks.steps(), feed);
    let (networks, steps) = (&config.networks, config.data.steps);
    let trained = predictors::train(model, networks, steps, &scenario, &noise, || shown.add(1))?;
    for (network, curve) in trained.networks.all.iter().zip(&trained.curves) {
        let what = format!("{}, held out p90, px", network.kind().name());
        curve.iter().for_each(|point| shown.curve(&what, point.step, point.held_out_px));
    }
    shown.finish();
    Ok(trained)
}

/// An encoder with predictors and probe and without risk and channel heads, and its diagnostics:
/// for comparisons. The closed form reads the features of the flight path's encoder, which is quicker
/// and differs in the last bits. Writes nothing.
///
/// # Errors
/// If the backend is not in this build or a fit fails.
pub fn without_heads(
    config: &TrainConfig,
    backend: Backend,
) -> Result<(WorldModel, Diagnostics), TrainError> {
    config.check()?;
    let (scenario, noise) = (Scenario::default(), Noise::new(config.seed));
    let device = backend.device()?;
    let (episodes, planes) = (collect(config, &scenario), planes(&noise));
    let cameras = CameraSet::new(&config.cameras, &noise);
    let data = TrainData { episodes: &episodes, cameras: &cameras, scenario: &scenario };
    let context = TrainContext {
        config,
        data,
        planes: &planes,
        noise: &noise,
        device: &device,
        bars: false,
        feed: None,
    };
    let cache = StageCache::none();
    let picks = fitting::pick(&context);
    let mut weights = trunk(&context, &picks, &cache)?;
    let mut check = None;
    if config.stages.closed_form {
        let fitted = fitting::refitted(&context, weights, &picks)?;
        (weights, check) = (fitted.0, Some(fitted.1));
    }
    let encoder = Encoder::new(weights);
    let (predictor, probe) = readouts(&context, &encoder, &cache)?;
    let none = Heads {
        collision: Mlp::zeros(&COLLISION_WIDTHS),
        gain: Mlp::zeros(&GAIN_WIDTHS),
        gain_mean: 0.0,
        gain_std: 1.0,
        scale_c: 1.0,
        scale_u: 1.0,
        floor: 1.0,
    };
    let model = assemble(&context, encoder, predictor, probe, none);
    let diagnostics = look_at(&model, &context, check);
    Ok((model, diagnostics))
}

/// File of the stage with the risk and channel heads.
const HEADS: &str = "heads.safetensors";

fn planes(noise: &Noise) -> Planes {
    [weights::random_plane(noise, 1), weights::random_plane(noise, 2)]
}

/// Start values and gradient stage: the trunk, and heads where the gradient stage has some.
fn trunk(
    context: &TrainContext<'_>,
    picks: &[Vec<Triple>; 2],
    cache: &StageCache,
) -> Result<Weights, TrainError> {
    let config = context.config;
    let weights = start(context);
    let Some(stage) = &config.stages.gradient else {
        if config.encoder.colour.is_none() {
            return Ok(weights);
        }
        return Ok(gradient::calibrated(weights, &fitting::some_frames(context, picks)));
    };
    cache.keep(
        "gradient",
        cache::load_weights,
        || {
            let shown = context.bar("gradient", stage.steps);
            let trained = gradient::train(&weights, stage, context, cache.dir(), &shown)?;
            shown.finish();
            Ok(gradient::calibrated(trained, &fitting::some_frames(context, picks)))
        },
        cache::save_weights,
    )
}

/// The trunk, then the closed form where the configuration names it.
fn encoder(
    context: &TrainContext<'_>,
    cache: &StageCache,
) -> Result<(Encoder, Option<FitCheck>), TrainError> {
    let config = context.config;
    let picks = fitting::pick(context);
    let mut weights = trunk(context, &picks, cache)?;
    if !config.stages.closed_form {
        return Ok((Encoder::new(weights), None));
    }
    let sets = cache.keep::<_, TrainError>(
        "features",
        |dir| cache::load_features(dir, context, &picks),
        || Ok(fitting::features(context, &weights, &picks)),
        cache::save_features,
    )?;
    cache.keep(
        "encoder",
        cache::load_encoder,
        || {
            let check = fitting::fit_heads(context, &mut weights, &sets)?;
            Ok((Encoder::new(weights.clone()), Some(check)))
        },
        cache::save_encoder,
    )
}

/// The trunk's start values.
fn start(context: &TrainContext<'_>) -> Weights {
    let config = &context.config.encoder;
    let normalise = [config.normalise[0], false, config.normalise[1]];
    let mut input = Input::new(context.data.scenario, normalise);
    input.colour = config.colour.map(|threshold| Colour::passing(threshold as f32));
    match context.config.stages.init {
        Init::Triangle => Weights::structured_init(input, config.mix, config.gated, context.noise),
        Init::Kaiming => Weights::kaiming(input, config.gated, context.noise),
    }
}

/// Predictors and probe.
fn readouts(
    context: &TrainContext<'_>,
    encoder: &Encoder,
    cache: &StageCache,
) -> Result<(Linear, Probe), TrainError> {
    cache.keep(
        "predictor",
        |dir| cache::read(dir, "predictor.safetensors", |from| Ok((Linear::get(from)?, Probe::get(from)?))),
        || {
            let predictor = fitting::fit_predictor(context, encoder).ok_or(TrainError::Predictor)?;
            Ok((predictor, fitting::fit_probe(context, encoder)))
        },
        |(predictor, probe), dir| {
            let mut out = Writer::default();
            predictor.put(&mut out);
            probe.put(&mut out);
            tensors::write_all(&dir.join("predictor.safetensors"), &out.bytes()?)
        },
    )
}

fn assemble(
    context: &TrainContext<'_>,
    encoder: Encoder,
    linear: Linear,
    probe: Probe,
    heads: Heads,
) -> WorldModel {
    let [plane_c, plane_u] = *context.planes;
    let card = Card { format: FORMAT.into(), config: context.config.clone(), ..Card::default() };
    let scale = context.config.encoder.scale;
    let predictor = Predictor::Linear(linear.controllable(&plane(&plane_c)));
    let encoder = FrameEncoder::Centroid(Box::new(encoder));
    WorldModel { encoder, plane_c, plane_u, scale, linear, predictor, heads, probe, card }
}

/// The diagnostics, through the cameras of the training.
fn look_at(model: &WorldModel, context: &TrainContext<'_>, check: Option<FitCheck>) -> Diagnostics {
    let noise = &context.config.held_out();
    let evaluation = &context.config.evaluation;
    let sizes = [evaluation.frames, evaluation.rollouts, evaluation.horizon];
    let cameras = CameraSet::new(&context.config.cameras, noise);
    let eigenvalue = check.map(|c| c.eigenvalues[1]);
    diagnostics::measure(model, sizes, &cameras, context.data.scenario, noise, eigenvalue)
}

fn in_words(alarms: &[CollapseCheck]) -> String {
    alarms.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

/// What a model was trained on, for a card.
fn data_in_words(config: &TrainConfig) -> String {
    let (data, heads) = (&config.data, config.heads.frames);
    match &config.learned {
        Some(part) => format!(
            "{}; {heads} of its pictures for the risk and channel heads, labelled by contacts and measured SNR",
            part.recording.in_words()
        ),
        None => format!(
            "{} episodes and {} that begin at an edge, {} actions each; {} frames for the latent heads, {heads} labelled \
             ones for the risk and channel heads",
            data.episodes, data.edge_episodes, data.steps, config.frames
        ),
    }
}

/// The card for people.
fn card_text(
    model: &WorldModel,
    diagnostics: &Diagnostics,
    alarms: &[CollapseCheck],
    revision: &str,
    stopwatch: Stopwatch,
) -> String {
    let Card { backend, config, metrics, .. } = &model.card;
    let (wall, cpu) = stopwatch.seconds();
    let verdict = if alarms.is_empty() {
        String::new()
    } else {
        format!("**Does not ship**: {}.\n\n", in_words(alarms))
    };
    format!(
        "# CRPL world model\n\n\
         JEPA encoder (100x100x3 to two 16-d latents, {} parameters), linear second-order predictors,\n\
         collision and channel heads, position probe.\n\n{verdict}\
         | | |\n|---|---|\n\
         | trained by | `model train --seed {}`, backend {backend} |\n\
         | revision | {} |\n\
         | data | {} |\n\
         | method | {} |\n\
         | time | {wall:.0} s wall, {cpu:.0} s CPU |\n\n\
         Measured on held-out frames (l1 errors, 1 px = 0.01 unit):\n\n```text\n{}{}```\n",
        model.encoder.parameters(),
        config.seed,
        revision,
        data_in_words(config),
        config.learned.as_ref().map_or_else(|| config.stages.in_words(), LearnedTraining::in_words),
        metrics.table(),
        diagnostics.table(),
    )
}
