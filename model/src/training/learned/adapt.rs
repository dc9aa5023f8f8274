//! Fine-tuning of a learned encoder on a few recorded episodes of a new camera.
//!
//! Predictors, heads and planes stay: they are the picture's geometry and the radio's, not the camera's. So
//! policies that were made in the world model's plane fly with the adapted one.

use crpl_sitl::world::noise::Noise;

use crate::encoder::votes::VoteEncoder;
use crate::training::learned::{self, LearnedConfig, LearnedError, readings};
use crate::training::show::StageShow;
use crate::world_model::WorldModel;
use crate::world_model::recording::Recording;
use crate::world_model::sight::{FrameEncoder, LearnedSight};

/// Learning rate of the fine-tuning: a quarter of the training's.
const RATE: f64 = 5e-4;

/// One of so many episodes is not trained on.
const HELD_OUT: usize = 5;

/// The recipe of a fine-tuning: the training's, without its search.
#[must_use]
pub fn recipe(steps: usize, episodes: usize) -> LearnedConfig {
    let mut config = LearnedConfig {
        steps,
        learning_rate: RATE,
        held_out: episodes / HELD_OUT,
        ..LearnedConfig::default()
    };
    config.teacher.from = 0;
    config
}

/// A fine-tuned world model.
#[derive(Debug)]
pub struct Adapted {
    /// The world model.
    pub model: WorldModel,
    /// [`readings::explained`] in the episodes that were not trained on.
    pub explained: f64,
}

/// Share that the actions must explain for the UAV to be found.
pub const FOUND: f64 = 0.9;

/// The world model with its encoder fine-tuned.
///
/// # Errors
/// A world model without the learned encoder, too few episodes, a recording that does not read.
pub fn adapt(
    mut model: WorldModel,
    recording: &Recording,
    steps: usize,
    seed: u64,
    shown: &StageShow,
) -> Result<Adapted, LearnedError> {
    let name = model.encoder.name();
    let Some(sight) = model.encoder.learned() else { return Err(LearnedError::NotLearned(name)) };
    let config = recipe(steps, recording.episodes().len());
    let start = sight.encoder.weights().clone();
    let weights = learned::train(recording, &config, Some(&start), &Noise::new(seed), None, shown)?;
    let readings = readings::read_all(&weights, recording, || ())?;
    let noise = readings::noise(&readings, recording, recording.episodes().len() - config.held_out.max(1));
    let explained =
        readings::explained(&readings, recording, recording.episodes().len() - config.held_out.max(1));
    model.encoder =
        FrameEncoder::Learned(Box::new(LearnedSight { encoder: VoteEncoder::new(weights), noise }));
    Ok(Adapted { model, explained })
}
