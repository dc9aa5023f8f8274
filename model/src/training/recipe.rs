//! Training, read from top to bottom: collect, start values, gradient stage, features, closed form,
//! predictor, probe, heads, evaluate, alarms. Which of them a run has stands in its configuration; the
//! shipped recipe has no gradient stage (the trunk keeps its structured start).
//!
//! Every finished stage is on disk, so a run that was stopped goes on where it was and ends with the
//! bytes of one that was not. All chance comes from the seed. A model that raises an alarm does not
//! ship.

use std::path::PathBuf;

use crpl_sitl::program::progress;
use crpl_sitl::program::timing::Stopwatch;
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};

use crate::encoder::infer::Encoder;
use crate::encoder::module::{Backend, NoBackend};
use crate::encoder::probe::Probe;
use crate::encoder::weights::{self, Colour, Input, Weights};
use crate::evaluation;
use crate::evaluation::alarms::{self, Alarm, Figures};
use crate::evaluation::chart::PlotError;
use crate::heads::networks::{COLLISION_WIDTHS, GAIN_WIDTHS, Heads};
use crate::numeric::mlp::Mlp;
use crate::predictor::linear::Linear;
use crate::predictor::networks::NetworksConfig;
use crate::training::cache::{self, Kept};
use crate::training::closed_form::{Check, FitError};
use crate::training::fit::{self, Planes, Setting};
use crate::training::gradient::{self, Data, GradientError};
use crate::training::lens::Lenses;
use crate::training::predictors::{self, Trained};
use crate::training::stages::Init;
use crate::world_model::checkpoint::{self, CARD, CheckpointError, FORMAT, Writer};
use crate::world_model::config::{ConfigError, DataConfig, TrainConfig};
use crate::world_model::dataset::{self, Episode, Start, Triple};
use crate::world_model::{Card, WorldModel};

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
    /// The unfinished run was made with another configuration.
    #[error("{0}: the unfinished run there has another configuration or backend; train without --resume")]
    Resume(PathBuf),
    /// The model is not fit to ship.
    #[error("the model does not ship: {alarms}; it stands in {dir} to be looked at")]
    Alarms {
        /// What is wrong, in words.
        alarms: String,
        /// Where the rejected model is.
        dir: PathBuf,
    },
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
    /// Started with the run: the card says what training has cost.
    pub stopwatch: Stopwatch,
}

/// Where a model goes that does not ship, inside the run's folder.
pub const REJECTED: &str = "rejected";

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

/// The whole recipe. Writes the checkpoint and returns it with the alarms' figures.
pub fn train(config: &TrainConfig, run: &Run) -> Result<(WorldModel, Figures), TrainError> {
    config.check()?;
    let revision = crate::revision();
    let (scenario, noise) = (Scenario::default(), Noise::new(config.seed));
    let device = run.backend.device()?;
    let identity = serde_json::json!({ "config": config, "backend": run.backend, "data": run.data });
    let kept = Kept::open(run.out.join("stages"), &format!("{identity:#}\n"), run.resume)?;

    // Episodes: positions of both bodies and the actions between them.
    let episodes = kept.keep(
        "episodes",
        |dir| dataset::load(dir, config.data.steps),
        || match &run.data {
            Some(dir) => Ok(dataset::load(dir, config.data.steps)?),
            None => Ok(collect(config, &scenario)),
        },
        |episodes, dir| dataset::save(episodes, dir),
    )?;
    let lenses = Lenses::new(&config.cameras, &noise);
    let data = Data { episodes: &episodes, lenses: &lenses, scenario: &scenario };
    let planes = planes(&noise);
    let setting = Setting { config, data, planes: &planes, noise: &noise, device: &device, bars: true };

    // The encoder, its predictors and its probe.
    let (encoder, check) = encoder(&setting, &kept)?;
    let (predictor, probe) = readouts(&setting, &encoder, &kept)?;

    // Risk and channel heads, by gradient descent on labelled pictures.
    let heads = kept.keep(
        "heads",
        |dir| cache::read(dir, "heads.safetensors", checkpoint::get_heads),
        || Ok(fit::train_heads(&setting, &encoder, &probe)),
        |heads: &Heads, dir| {
            let mut out = Writer::default();
            checkpoint::put_heads(&mut out, heads);
            checkpoint::write_all(&dir.join("heads.safetensors"), &out.bytes()?)
        },
    )?;

    // Measured on fresh pictures, and looked at for what a loss does not show.
    let mut model = assemble(&setting, encoder, predictor, probe, heads);
    model.card.backend = run.backend.name().into();
    let held_out = Noise::new(config.seed ^ HELD_OUT);
    model.card.metrics = evaluation::measure(
        &model,
        &config.evaluation,
        &config.heads,
        &scenario,
        &held_out,
        check.unwrap_or_default(),
    );
    let figures = look_at(&model, &setting, &held_out, check);
    let alarms = figures.alarms(&config.alarms);

    // Only a model without alarms takes the checkpoint's place.
    let dir = if alarms.is_empty() { run.out.clone() } else { run.out.join(REJECTED) };
    model.save(&dir)?;
    if alarms.is_empty() {
        // What the linear predictor is compared with.
        let trained =
            kept.keep("networks", predictors::load, || networks(config, &model), predictors::save)?;
        predictors::publish(&trained, &dir)?;
    }
    let card = card_text(&model, &figures, &alarms, revision, run.stopwatch);
    checkpoint::write_all(&dir.join(CARD), card.as_bytes())?;
    if !alarms.is_empty() {
        kept.remove()?;
        return Err(TrainError::Alarms { alarms: in_words(&alarms), dir });
    }
    kept.remove()?;
    Ok((model, figures))
}

/// The MLP and the LSTM on the latents of `model`, with a progress bar.
pub fn networks(config: &TrainConfig, model: &WorldModel) -> Result<Trained, TrainError> {
    let (scenario, noise) = (Scenario::default(), Noise::new(config.seed));
    let NetworksConfig { short_steps, mlp_steps, lstm_steps, .. } = config.networks;
    let bar = progress::bar("networks", (2 * short_steps + mlp_steps + lstm_steps) as u64);
    let (networks, steps) = (&config.networks, config.data.steps);
    let trained = predictors::train(model, networks, steps, &scenario, &noise, || bar.inc(1))?;
    bar.finish();
    Ok(trained)
}

/// An encoder with predictors and probe and without risk and channel heads, and its alarms' figures:
/// for comparisons. The closed form reads the features of the flight path's encoder, which is quicker
/// and differs in the last bits. Writes nothing.
pub fn without_heads(config: &TrainConfig, backend: Backend) -> Result<(WorldModel, Figures), TrainError> {
    config.check()?;
    let (scenario, noise) = (Scenario::default(), Noise::new(config.seed));
    let device = backend.device()?;
    let (episodes, planes) = (collect(config, &scenario), planes(&noise));
    let lenses = Lenses::new(&config.cameras, &noise);
    let data = Data { episodes: &episodes, lenses: &lenses, scenario: &scenario };
    let setting = Setting { config, data, planes: &planes, noise: &noise, device: &device, bars: false };
    let kept = Kept::nothing();
    let picks = fit::pick(&setting);
    let mut weights = trunk(&setting, &picks, &kept)?;
    let mut check = None;
    if config.stages.closed_form {
        let fitted = fit::refitted(&setting, weights, &picks)?;
        (weights, check) = (fitted.0, Some(fitted.1));
    }
    let encoder = Encoder::new(weights);
    let (predictor, probe) = readouts(&setting, &encoder, &kept)?;
    let none = Heads {
        collision: Mlp::zeros(&COLLISION_WIDTHS),
        gain: Mlp::zeros(&GAIN_WIDTHS),
        gain_mean: 0.0,
        gain_std: 1.0,
        scale_c: 1.0,
        scale_u: 1.0,
        floor: 1.0,
    };
    let model = assemble(&setting, encoder, predictor, probe, none);
    let figures = look_at(&model, &setting, &Noise::new(config.seed ^ HELD_OUT), check);
    Ok((model, figures))
}

/// Turns the seed of training into that of evaluation.
const HELD_OUT: u64 = 0x6865_6c64_6f75_7421;

fn planes(noise: &Noise) -> Planes {
    [weights::random_plane(noise, 1), weights::random_plane(noise, 2)]
}

/// Start values and gradient stage: the trunk, and heads where the gradient stage has some.
fn trunk(setting: &Setting<'_>, picks: &[Vec<Triple>; 2], kept: &Kept) -> Result<Weights, TrainError> {
    let config = setting.config;
    let weights = start(setting);
    let Some(stage) = &config.stages.gradient else {
        if config.encoder.colour.is_none() {
            return Ok(weights);
        }
        return Ok(gradient::calibrated(weights, &fit::some_frames(setting, picks)));
    };
    kept.keep(
        "gradient",
        cache::load_weights,
        || {
            let bar = setting.bar("gradient", stage.steps);
            let trained = gradient::train(&weights, stage, setting, kept.dir(), &bar)?;
            bar.finish();
            Ok(gradient::calibrated(trained, &fit::some_frames(setting, picks)))
        },
        cache::save_weights,
    )
}

/// The trunk, then the closed form where the configuration names it.
fn encoder(setting: &Setting<'_>, kept: &Kept) -> Result<(Encoder, Option<Check>), TrainError> {
    let config = setting.config;
    let picks = fit::pick(setting);
    let mut weights = trunk(setting, &picks, kept)?;
    if !config.stages.closed_form {
        return Ok((Encoder::new(weights), None));
    }
    let sets = kept.keep(
        "features",
        |dir| cache::load_features(dir, setting, &picks),
        || Ok(fit::features(setting, &weights, &picks)),
        cache::save_features,
    )?;
    kept.keep(
        "encoder",
        cache::load_encoder,
        || {
            let check = fit::fit_heads(setting, &mut weights, &sets)?;
            Ok((Encoder::new(weights.clone()), Some(check)))
        },
        cache::save_encoder,
    )
}

/// The trunk's start values.
fn start(setting: &Setting<'_>) -> Weights {
    let config = &setting.config.encoder;
    let normalise = [config.normalise[0], false, config.normalise[1]];
    let mut input = Input::new(setting.data.scenario, normalise);
    input.colour = config.colour.map(|threshold| Colour::passing(threshold as f32));
    match setting.config.stages.init {
        Init::Triangle => Weights::initial(input, config.mix, config.gated, setting.noise),
        Init::Kaiming => Weights::kaiming(input, config.gated, setting.noise),
    }
}

/// Predictors and probe.
fn readouts(setting: &Setting<'_>, encoder: &Encoder, kept: &Kept) -> Result<(Linear, Probe), TrainError> {
    kept.keep(
        "predictor",
        |dir| {
            cache::read(dir, "predictor.safetensors", |r| {
                Ok((checkpoint::get_predictor(r)?, checkpoint::get_probe(r)?))
            })
        },
        || {
            let predictor = fit::fit_predictor(setting, encoder).ok_or(TrainError::Predictor)?;
            Ok((predictor, fit::fit_probe(setting, encoder)))
        },
        |(predictor, probe), dir| {
            let mut out = Writer::default();
            checkpoint::put_predictor(&mut out, predictor);
            checkpoint::put_probe(&mut out, probe);
            checkpoint::write_all(&dir.join("predictor.safetensors"), &out.bytes()?)
        },
    )
}

fn assemble(
    setting: &Setting<'_>,
    encoder: Encoder,
    predictor: Linear,
    probe: Probe,
    heads: Heads,
) -> WorldModel {
    let [plane_c, plane_u] = *setting.planes;
    let card = Card { format: FORMAT.into(), config: setting.config.clone(), ..Card::default() };
    let scale = setting.config.encoder.scale;
    WorldModel { encoder, plane_c, plane_u, scale, predictor, heads, probe, card }
}

/// The alarms' figures, through the cameras of the training.
fn look_at(model: &WorldModel, setting: &Setting<'_>, noise: &Noise, check: Option<Check>) -> Figures {
    let evaluation = &setting.config.evaluation;
    let sizes = [evaluation.frames, evaluation.rollouts, evaluation.horizon];
    let lenses = Lenses::new(&setting.config.cameras, noise);
    let eigenvalue = check.map(|c| c.eigenvalues[1]);
    alarms::measure(model, sizes, &lenses, setting.data.scenario, noise, eigenvalue)
}

fn in_words(alarms: &[Alarm]) -> String {
    alarms.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

/// The card for people.
fn card_text(
    model: &WorldModel,
    figures: &Figures,
    alarms: &[Alarm],
    revision: &str,
    stopwatch: Stopwatch,
) -> String {
    let Card { backend, config, metrics, .. } = &model.card;
    let data = &config.data;
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
         | data | {} episodes and {} that begin at an edge, {} actions each; {} pictures for the latent heads, {} labelled ones for the risk and channel heads |\n\
         | method | {} |\n\
         | time | {wall:.0} s wall, {cpu:.0} s CPU |\n\n\
         Measured on held-out pictures (l1 errors, 1 px = 0.01 unit):\n\n```text\n{}{}```\n",
        model.encoder.weights().parameters(),
        config.seed,
        revision,
        data.episodes,
        data.edge_episodes,
        data.steps,
        config.frames,
        config.heads.frames,
        config.stages.in_words(),
        metrics.table(),
        figures.table(),
    )
}
