//! A world model from a recording, read from top to bottom: the encoder, its readings' noise, the predictors, the
//! heads from measured gain and contacts, and what it is worth.

use std::path::Path;

use crpl_sitl::camera::CameraConfig;
use crpl_sitl::camera::effects::CameraSet;
use crpl_sitl::program::page::feed::Feed;
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};
use crpl_sitl::world::safety;
use nalgebra::{Matrix2, Vector2};
use rand::RngExt;

use crate::encoder::probe::{Affine, Probe};
use crate::encoder::votes::{VoteEncoder, VoteWeights};
use crate::encoder::weights::random_plane;
use crate::evaluation::diagnostics::{self, Diagnostics};
use crate::evaluation::{self};
use crate::heads::labels::Label;
use crate::heads::networks::Heads;
use crate::numeric::tensors::TensorError;
use crate::predictor::Predictor;
use crate::training::cache::{self, StageCache};
use crate::training::heads::{self as head_training, Samples};
use crate::training::learned::readings::{self, HeadSample};
use crate::training::learned::{self, EncoderRun, load_encoder, save_encoder};
use crate::training::recipe::{Run, TrainError, ship};
use crate::training::show::StageShow;
use crate::world_model::card::{Card, FitCheck, LearnedCheck};
use crate::world_model::checkpoint::FORMAT;
use crate::world_model::config::{LearnedTraining, TrainConfig};
use crate::world_model::exploration;
use crate::world_model::recording::{Recording, RecordingFormat};
use crate::world_model::sight::{FrameEncoder, LearnedSight, plane_of_px};
use crate::world_model::{WorldModel, plane};

/// File of the encoder among the finished stages.
const ENCODER: &str = "encoder.safetensors";

/// File of the heads among the finished stages.
const HEADS: &str = "heads.safetensors";

/// Distance of the bodies, px, within which a picture is near a collision.
const NEAR_PX: f64 = 25.0;

/// Trains a world model with the learned encoder. Writes the checkpoint and returns it with its diagnostics.
///
/// # Errors
/// [`TrainError::Alarms`] if the model is not fit to ship; else if a stage or a file fails.
pub fn train(
    config: &TrainConfig,
    part: &LearnedTraining,
    run: &Run,
) -> Result<(WorldModel, Diagnostics), TrainError> {
    let (scenario, noise) = (Scenario::default(), Noise::new(config.seed));
    let identity = serde_json::json!({ "config": config, "data": run.data, "device": run.device });
    let mut passes = run.device.passes(&part.encoder)?;
    let cache = StageCache::open(run.out.join("stages"), &format!("{identity:#}\n"), run.resume)?;

    // Pictures, actions, measured gain, contacts; no position.
    let own = run.out.join("stages").join("recording");
    let recording = match &run.data {
        Some(dir) => Recording::open(dir, None)?,
        None => {
            record(config, part, &scenario, &own, run.feed.as_ref())?;
            Recording::open(&own, None)?
        }
    };

    // The encoder, by gradient from random weights.
    let weights = cache.keep::<_, TrainError>(
        "encoder",
        |dir| load_encoder(&dir.join(ENCODER)),
        || {
            let shown = StageShow::begin("encoder", part.encoder.steps, run.feed.as_ref());
            let how =
                EncoderRun { passes: &mut *passes, dir: cache.dir(), shown: &shown, watch: &mut |_, _| {} };
            let weights = learned::train_on(&recording, &part.encoder, None, &noise, how)?;
            shown.finish();
            Ok(weights)
        },
        |weights, dir| save_encoder(weights, &dir.join(ENCODER)),
    )?;
    let (model, diagnostics) = finish(config, part, &weights, &recording, run, &cache)?;
    ship(model, diagnostics, run, cache)
}

/// Records exploratory flights into `dir`, unless they are there; `feed` is where others watch.
///
/// # Errors
/// If a camera has no such name, or a file cannot be written.
pub fn record(
    config: &TrainConfig,
    part: &LearnedTraining,
    scenario: &Scenario,
    dir: &Path,
    feed: Option<&Feed>,
) -> Result<(), TrainError> {
    let done = dir.join("done");
    if done.exists() {
        return Ok(());
    }
    let exploration = &part.recording;
    let shown = StageShow::begin("recording", exploration.episodes, feed);
    let cameras = cameras(exploration)?;
    let place = (dir, RecordingFormat::default());
    exploration::collect(exploration, &cameras, scenario, config.seed, place, || shown.add(1))?;
    shown.finish();
    Ok(std::fs::write(&done, "").map_err(TensorError::file(&done))?)
}

/// The cameras of a recording, in the order of the configuration.
///
/// # Errors
/// If one has no such name and no such file.
pub fn cameras(config: &exploration::ExplorationConfig) -> Result<Vec<CameraConfig>, TrainError> {
    config.cameras.iter().map(|(name, _)| Ok(CameraConfig::named(name)?)).collect()
}

/// All that comes after the encoder, and what the model shows on fresh frames.
fn finish(
    config: &TrainConfig,
    part: &LearnedTraining,
    weights: &VoteWeights,
    recording: &Recording,
    run: &Run,
    cache: &StageCache,
) -> Result<(WorldModel, Diagnostics), TrainError> {
    let (scenario, noise) = (Scenario::default(), Noise::new(config.seed));
    let scale = config.encoder.scale;

    // What it reads in the recording, and how far such a reading is off.
    let shown = StageShow::begin("readings", recording.episodes().len(), run.feed.as_ref());
    let readings = readings::read_all(weights, recording, || shown.add(1))?;
    shown.finish();
    let held_out = recording.episodes().len().saturating_sub(part.encoder.held_out);
    let reading_noise = readings::noise(&readings, recording, held_out);
    let planes = [random_plane(&noise, 1), random_plane(&noise, 2)];
    let wide = planes.each_ref().map(plane);
    let sizes = (scale, config.predictor.ridge, config.predictor.lag);
    let fitted = readings::predictor(&readings, recording, &reading_noise, &wide, sizes)
        .ok_or(TrainError::Predictor)?;

    // p is in picture coordinates by construction: this affine map is geometry, not a fit.
    let straight = Affine { matrix: Matrix2::identity() / scale, offset: Vector2::repeat(0.5) };
    let probe = Probe { c: straight, u: straight };

    // Heads from the measured gain and from the distance at which the bodies touched.
    let samples = readings::head_samples(&readings, recording, &reading_noise);
    let touch = readings::touch_distance_px(&samples).ok_or(TrainError::Contacts)?;
    let heads = cache.keep::<_, TrainError>(
        "heads",
        |dir| cache::load_one(dir, HEADS),
        || train_heads(config, &samples, touch, &probe, &scenario, run),
        |heads: &Heads, dir| cache::save_one(heads, dir, HEADS),
    )?;

    let [plane_c, plane_u] = planes;
    let sight = LearnedSight { encoder: VoteEncoder::new(weights.clone()), noise: reading_noise };
    let mut model = WorldModel {
        encoder: FrameEncoder::Learned(Box::new(sight)),
        plane_c,
        plane_u,
        scale,
        predictor: Predictor::Linear(fitted.linear.controllable(&wide[0])),
        linear: fitted.linear,
        heads,
        probe,
        card: Card {
            format: FORMAT.into(),
            backend: run.backends(),
            config: config.clone(),
            ..Card::default()
        },
    };
    let held_out = config.held_out();
    model.card.metrics = evaluation::measure(
        &model,
        &config.evaluation,
        &config.heads,
        &scenario,
        &held_out,
        FitCheck::default(),
    );
    model.card.metrics.learned = Some(LearnedCheck {
        psi_off: fitted.off,
        psi_off_free: fitted.off_free,
        touch_px: touch,
        episodes: recording.episodes().len(),
    });
    let evaluation = &config.evaluation;
    let sizes = [evaluation.frames, evaluation.rollouts, evaluation.horizon];
    let clean = CameraSet::new(&[], &held_out);
    let diagnostics = diagnostics::measure(&model, sizes, &clean, &scenario, &held_out, None);
    Ok((model, diagnostics))
}

/// Risk and channel heads: half of the pictures from near collisions, half from anywhere.
fn train_heads(
    config: &TrainConfig,
    samples: &[HeadSample],
    touch_px: f64,
    probe: &Probe,
    scenario: &Scenario,
    run: &Run,
) -> Result<Heads, TrainError> {
    let noise = Noise::new(config.seed);
    let mut rng = noise.generator(Stream::Data, u64::from(u32::MAX) - 2);
    let near: Vec<&HeadSample> = samples.iter().filter(|s| s.distance_px < NEAR_PX).collect();
    if near.is_empty() {
        return Err(TrainError::Contacts);
    }
    let mut drawn = Samples::default();
    for n in 0..config.heads.frames {
        let sample = if n % 2 == 0 {
            near[rng.random_range(0..near.len())]
        } else {
            &samples[rng.random_range(0..samples.len())]
        };
        let [c, u] = sample.p;
        let apart = f64::from((c[0] - u[0]).hypot(c[1] - u[1]));
        // Clearance of the bodies' rims as the contacts tell it, in units.
        let clearance = (apart - touch_px) / 100.0;
        let Scenario { safety: s, .. } = scenario;
        drawn.y_c.push(plane_of_px(c, config.encoder.scale));
        drawn.y_u.push(plane_of_px(u, config.encoder.scale));
        drawn.station.push(sample.station);
        drawn.label.push(Label {
            collision: safety::collision_probability(clearance, s.d_min, s.softness),
            log_gain: f64::from(sample.gain_db) * std::f64::consts::LN_10 / 10.0
                + scenario.channel.noise_power.ln(),
        });
    }
    let device = run.backend.device()?;
    let shown = StageShow::begin("heads", 2 * config.heads.steps, run.feed.as_ref());
    let heads = head_training::train(&drawn, probe, &config.heads, &device, &noise, || shown.add(1));
    shown.finish();
    Ok(heads)
}
