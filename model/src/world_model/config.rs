//! Every number of the world model's training. `Default` is the shipped recipe; a file holds only
//! what differs from it. Needs no burn, so the flight path can read a checkpoint's config.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::heads::labels::HeadsConfig;
use crate::predictor::{NetworksConfig, PredictorKind};
use crate::world_model::exploration::ExplorationConfig;
use crate::world_model::learned::LearnedConfig;
use crate::world_model::stages::{Layers, Stages};
use crpl_sitl::camera::effects::Effects;
use crpl_sitl::world::noise::Noise;

/// Everything that decides the bytes of a checkpoint. `Default` is the shipped recipe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Seed of all random streams.
    pub seed: u64,
    /// What is flown to make the frames.
    pub data: DataConfig,
    /// Frames from which the latent heads are fitted: two sets of triples.
    pub frames: usize,
    /// Lags of the long triples, intervals, log-uniform.
    pub long: [usize; 2],
    /// Lags of the short triples, on which z_u is fitted.
    pub short: [usize; 2],
    /// Frames a batch on the backend; more uses more memory, the result is the same.
    pub batch: usize,
    /// The cameras that took the frames, one after the other for consecutive episodes; none means the
    /// clean one.
    pub cameras: Vec<Effects>,
    /// What makes the encoder.
    pub stages: Stages,
    /// The encoder.
    pub encoder: EncoderConfig,
    /// The latent heads.
    pub closed_form: ClosedForm,
    /// The predictors.
    pub predictor: PredictorConfig,
    /// The networks that the linear predictor is compared with.
    pub networks: NetworksConfig,
    /// The risk and channel heads.
    pub heads: HeadsConfig,
    /// What is measured at the end.
    pub evaluation: EvaluationConfig,
    /// What a model must keep to be shipped.
    pub alarms: AlarmLimits,
    /// The learned encoder; with it the keys of the hand-set one play no part.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub learned: Option<LearnedTraining>,
}

/// The learned encoder's part of a training.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnedTraining {
    /// What is recorded where no recording is given.
    pub recording: ExplorationConfig,
    /// The encoder.
    pub encoder: LearnedConfig,
}

impl LearnedTraining {
    /// The method in a line, for a card.
    #[must_use]
    pub fn in_words(&self) -> String {
        let LearnedConfig { steps, triples, momentum, .. } = &self.encoder;
        format!(
            "learned encoder from random weights: {steps} steps on {} pictures each, EMA target with {momentum}, no \
             position",
            6 * triples
        )
    }
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            data: DataConfig::default(),
            frames: 24_000,
            long: [10, 48],
            short: [4, 10],
            batch: 64,
            cameras: Vec::new(),
            stages: Stages::default(),
            encoder: EncoderConfig::default(),
            closed_form: ClosedForm::default(),
            predictor: PredictorConfig::default(),
            networks: NetworksConfig::default(),
            heads: HeadsConfig::default(),
            evaluation: EvaluationConfig::default(),
            alarms: AlarmLimits::default(),
            learned: None,
        }
    }
}

/// What is flown to make the frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Episodes that begin anywhere.
    pub episodes: usize,
    /// Episodes that begin with a disc that the frame cuts.
    pub edge_episodes: usize,
    /// Actions an episode.
    pub steps: usize,
}

impl Default for DataConfig {
    fn default() -> Self {
        Self { episodes: 1500, edge_episodes: 500, steps: 100 }
    }
}

/// What is chosen about the encoder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EncoderConfig {
    /// Dense noise beside the one channel that each output channel copies.
    pub mix: f64,
    /// Whether red and blue are divided by their own mass (centroids instead of moments).
    pub normalise: [bool; 2],
    /// Whether z_c's head reads q h beside h, q being the missing share of the UAV's mass: what is cut
    /// lies outside the frame, which a centroid of the rest cannot tell.
    pub gated: bool,
    /// S, latent units of z_c per unit of length.
    pub scale: f64,
    /// Threshold with which a learned colour layer starts, as a share of a full channel; without it the
    /// bytes go to the trunk as they are.
    pub colour: Option<f64>,
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self { mix: 0.0, normalise: [true, true], gated: true, scale: 10.0, colour: None }
    }
}

/// How the predictors are fitted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PredictorConfig {
    /// Which one predicts the controllable half in flights and plans.
    #[serde(skip_serializing_if = "PredictorKind::is_default")]
    pub kind: PredictorKind,
    /// Episodes that are encoded frame by frame.
    pub episodes: usize,
    /// Ridge to (2I, -I), relative to the largest diagonal entry.
    pub ridge: f64,
    /// Lag of the windows on which Ψ_ca is fitted, intervals. 1 is the one-step fit; over a longer lag
    /// the action moves the UAV further and the frames' error weighs less.
    pub lag: usize,
}

impl Default for PredictorConfig {
    fn default() -> Self {
        Self { kind: PredictorKind::Linear, episodes: 400, ridge: 1e3, lag: 10 }
    }
}

/// The heads' regularisers and trimming.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClosedForm {
    /// Ridge of z_c's least squares, relative to the mean variance of a feature.
    pub ridge_c: f64,
    /// Ridge on the double differences of z_u, relative as above. On this side, not the covariance's:
    /// there it would select noise. At 1e-6 the error is a third lower, but which triples are kept then
    /// hangs on the last bits of the features.
    pub ridge_u: f64,
    /// Floor of the covariance, relative as above; keeps it positive definite.
    pub floor_u: f64,
    /// Share of the triples kept in each round: the others hit a wall.
    pub keep: f64,
    /// Rounds of trimming.
    pub rounds: usize,
}

impl Default for ClosedForm {
    fn default() -> Self {
        Self { ridge_c: 1e-7, ridge_u: 1e-5, floor_u: 1e-9, keep: 0.6, rounds: 12 }
    }
}

/// How much is measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Frames for the probe, and again as many for its test.
    pub frames: usize,
    /// Trajectories of 100 steps, each from rest.
    pub rollouts: usize,
    /// Length of a rollout, intervals.
    pub horizon: usize,
}

impl Default for EvaluationConfig {
    fn default() -> Self {
        Self { frames: 4000, rollouts: 500, horizon: 100 }
    }
}

/// Largest second eigenvalue of a z_u that is right.
pub const EIGENVALUE_LIMIT: f64 = 2e-6;

/// What a model must keep to be shipped.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlarmLimits {
    /// Smallest effective rank of each half; two bodies' coordinates make 2.
    pub rank: f64,
    /// Smallest standard deviation of a half, as a share of what the gauge makes it.
    pub spread: f64,
    /// Largest second generalised eigenvalue of z_u's closed form. No label is needed to see it. With
    /// pixel noise the frames' own error adds to it.
    pub eigenvalue: f64,
    /// Smallest R² of the right body's position from each half.
    pub r_squared: f64,
    /// Largest R² of the wrong body's position from each half.
    pub leak: f64,
    /// Smallest ratio of the rollout error with zero or shuffled actions to that with the true ones.
    pub action_ratio: f64,
}

impl Default for AlarmLimits {
    fn default() -> Self {
        Self {
            rank: 1.5,
            spread: 0.1,
            eigenvalue: EIGENVALUE_LIMIT,
            r_squared: 0.99,
            leak: 0.05,
            action_ratio: 10.0,
        }
    }
}

/// Why a training config could not be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The configuration does not parse.
    #[error("reading {path}: {message}")]
    Config {
        /// The file.
        path: PathBuf,
        /// Line, key and reason.
        message: String,
    },
    /// A key is needed beside another one.
    #[error("{key} is not set: {why}")]
    Missing {
        /// Dotted key.
        key: &'static str,
        /// What needs it.
        why: &'static str,
    },
    /// A value of a camera is out of range.
    #[error("cameras[{entry}].{key} = {value}: {must}")]
    Camera {
        /// Index of the camera, from 0.
        entry: usize,
        /// Its key.
        key: &'static str,
        /// The value found.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// A value is out of range.
    #[error("{key} = {value}: {must}")]
    Range {
        /// Dotted key.
        key: &'static str,
        /// The value found.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
}

impl TrainConfig {
    /// The chance of the frames on which a model is measured: of another seed than its training's.
    #[must_use]
    pub fn held_out(&self) -> Noise {
        /// Turns the seed of training into that of evaluation.
        const HELD_OUT: u64 = 0x6865_6c64_6f75_7421;
        Noise::new(self.seed ^ HELD_OUT)
    }

    /// Reads a TOML file; keys that it leaves out keep their defaults.
    ///
    /// # Errors
    /// The file cannot be read, or a key or value is wrong: the error names it.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let wrong = |message: String| ConfigError::Config { path: path.into(), message };
        let text = std::fs::read_to_string(path).map_err(|e| wrong(e.to_string()))?;
        let config: Self = toml::from_str(&text).map_err(|e| wrong(e.to_string()))?;
        config.check()?;
        Ok(config)
    }

    /// The recipe in small, in seconds: it shows that everything runs; its figures are not the recipe's.
    #[must_use]
    pub fn quick(mut self) -> Self {
        self.data.episodes = self.data.episodes.min(300);
        self.data.edge_episodes = self.data.edge_episodes.min(100);
        self.frames = self.frames.min(6000);
        self.predictor.episodes = self.predictor.episodes.min(30);
        self.heads.frames = self.heads.frames.min(3000);
        self.heads.steps = self.heads.steps.min(600);
        for steps in
            [&mut self.networks.short_steps, &mut self.networks.mlp_steps, &mut self.networks.lstm_steps]
        {
            *steps = (*steps).min(100);
        }
        self.evaluation.frames = self.evaluation.frames.min(1000);
        self.evaluation.rollouts = self.evaluation.rollouts.min(100);
        if let Some(gradient) = &mut self.stages.gradient {
            gradient.steps = gradient.steps.min(40);
            gradient.warm_up = gradient.warm_up.min(10);
        }
        self
    }

    /// Refuses values that make no sense.
    ///
    /// # Errors
    /// [`ConfigError::Range`] or [`ConfigError::Missing`] with the dotted key.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.check_counts()?;
        self.check_sizes()?;
        self.check_stages()?;
        self.check_lags()
    }

    fn check_counts(&self) -> Result<(), ConfigError> {
        let mut counts = vec![
            ("data.episodes", self.data.episodes),
            ("frames", self.frames / 6),
            ("batch", self.batch),
            ("predictor.episodes", self.predictor.episodes),
            ("predictor.lag", self.predictor.lag),
            ("networks.episodes", self.networks.episodes),
            ("networks.held_out", self.networks.held_out),
            ("networks.hidden", self.networks.hidden),
            ("networks.short_steps", self.networks.short_steps),
            ("networks.mlp_steps", self.networks.mlp_steps),
            ("networks.lstm_steps", self.networks.lstm_steps),
            ("networks.batch", self.networks.batch),
            ("heads.frames", self.heads.frames),
            ("heads.batch", self.heads.batch),
            ("evaluation.frames", self.evaluation.frames),
            ("evaluation.rollouts", self.evaluation.rollouts),
            ("evaluation.horizon", self.evaluation.horizon),
            ("closed_form.rounds", self.closed_form.rounds),
        ];
        if let Some(gradient) = &self.stages.gradient {
            counts.extend([
                ("stages.gradient.steps", gradient.steps),
                // A batch of one has no variance.
                ("stages.gradient.batch", gradient.batch / 2),
                ("stages.gradient.save_every", gradient.save_every),
                ("stages.gradient.refit_every", gradient.refit_every),
                ("stages.gradient.refit_frames", gradient.refit_frames / 6),
            ]);
        }
        match counts.into_iter().find(|(_, n)| *n == 0) {
            Some((key, value)) => Err(ConfigError::Range { key, value: value as f64, must: POSITIVE }),
            None if self.data.episodes + self.data.edge_episodes < self.predictor.episodes => {
                let must = "must not be more than data.episodes + data.edge_episodes";
                let value = self.predictor.episodes as f64;
                Err(ConfigError::Range { key: "predictor.episodes", value, must })
            }
            None => Ok(()),
        }
    }

    fn check_sizes(&self) -> Result<(), ConfigError> {
        let mut sizes = vec![
            ("encoder.scale", self.encoder.scale),
            ("closed_form.ridge_c", self.closed_form.ridge_c),
            ("closed_form.ridge_u", self.closed_form.ridge_u),
            ("closed_form.floor_u", self.closed_form.floor_u),
            ("closed_form.keep", self.closed_form.keep),
            ("predictor.ridge", self.predictor.ridge),
            ("networks.mlp_rate", self.networks.mlp_rate),
            ("networks.lstm_rate", self.networks.lstm_rate),
            ("heads.learning_rate", self.heads.learning_rate),
            ("heads.distance_floor", self.heads.distance_floor),
        ];
        if let Some(gradient) = &self.stages.gradient {
            sizes.extend([
                ("stages.gradient.learning_rate", gradient.learning_rate),
                ("stages.gradient.clip", gradient.clip),
                ("stages.gradient.keep", gradient.keep),
            ]);
        }
        if let Some((key, value)) = sizes.into_iter().find(|(_, v)| !(v.is_finite() && *v > 0.0)) {
            return Err(ConfigError::Range { key, value, must: POSITIVE });
        }
        let mut weights = vec![("encoder.mix", self.encoder.mix)];
        if let Some(gradient) = &self.stages.gradient {
            weights.extend([
                ("stages.gradient.target_weight", gradient.target_weight),
                ("stages.gradient.whitening", gradient.whitening),
                ("stages.gradient.off_plane", gradient.off_plane),
            ]);
        }
        if let Some((key, value)) = weights.into_iter().find(|(_, v)| !(v.is_finite() && *v >= 0.0)) {
            return Err(ConfigError::Range { key, value, must: "must be finite and not below 0" });
        }
        Ok(())
    }

    fn check_stages(&self) -> Result<(), ConfigError> {
        let refuse = |key, value, must| Err(ConfigError::Range { key, value, must });
        let mut cameras = self.cameras.iter().enumerate();
        let violation = cameras.find_map(|(entry, camera)| Some((entry, camera.violation()?)));
        if let Some((entry, (key, value, must))) = violation {
            return Err(ConfigError::Camera { entry, key, value, must });
        }
        if let Some(threshold) = self.encoder.colour {
            if !(0.0..1.0).contains(&threshold) {
                return refuse("encoder.colour", threshold, "must lie in 0..1");
            }
            if self.encoder.normalise != [true; 2] {
                return refuse("encoder.colour", threshold, "needs encoder.normalise = [true, true]");
            }
        }
        let stages = &self.stages;
        let Some(gradient) = &stages.gradient else {
            let must = "must be true without [stages.gradient]: nothing else makes the latent heads";
            return if stages.closed_form { Ok(()) } else { refuse("stages.closed_form", 0.0, must) };
        };
        if !(0.0..1.0).contains(&gradient.momentum) {
            return refuse("stages.gradient.momentum", gradient.momentum, "must lie in 0..1");
        }
        if gradient.layers == Layers::Colour && self.encoder.colour.is_none() {
            let why = "stages.gradient.layers = \"colour\" trains that layer alone";
            return Err(ConfigError::Missing { key: "encoder.colour", why });
        }
        Ok(())
    }

    fn check_lags(&self) -> Result<(), ConfigError> {
        // Random flights that stay in the square for longer are too rare to find.
        for (key, steps) in [("data.steps", self.data.steps), ("evaluation.horizon", self.evaluation.horizon)]
        {
            if steps > 200 {
                return Err(ConfigError::Range { key, value: steps as f64, must: "must be at most 200" });
            }
        }
        let lag = [1, self.predictor.lag];
        for (key, lags) in [("long", self.long), ("short", self.short), ("predictor.lag", lag)] {
            if !(1 <= lags[0] && lags[0] <= lags[1] && 2 * lags[1] <= self.data.steps) {
                let must = "must rise from at least 1 to at most half of data.steps";
                return Err(ConfigError::Range { key, value: lags[1] as f64, must });
            }
        }
        Ok(())
    }
}

const POSITIVE: &str = "must be finite and above 0";

#[cfg(test)]
mod tests {
    use crpl_sitl::world::noise::Stream;
    use rand::RngExt;

    use super::*;

    #[test]
    fn what_a_model_is_measured_on_is_not_what_training_drew() {
        let first = |noise: Noise, stream| noise.generator(stream, 0).random::<u64>();
        for (seed, stream) in
            (0..100).flat_map(|seed| [Stream::Data, Stream::Evaluation, Stream::Camera].map(|s| (seed, s)))
        {
            let config = TrainConfig { seed, ..TrainConfig::default() };
            assert_ne!(first(config.held_out(), stream), first(Noise::new(seed), stream), "seed {seed}");
        }
    }
}
