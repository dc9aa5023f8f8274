//! Every number of the learned encoder's training. Needs no burn.

use serde::{Deserialize, Serialize};

/// How the learned encoder is trained on a recording. `Default` is the shipped recipe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnedConfig {
    /// Steps.
    pub steps: usize,
    /// Triples of pictures a step of each set, long and short: six times as many pictures.
    pub triples: usize,
    /// Lags of the long triples, intervals, log-uniform: on these z_c is learned.
    pub long: [usize; 2],
    /// Lags of the short triples: on these z_u is learned, too.
    pub short: [usize; 2],
    /// Learning rate after the warm-up; falls to 2 % of it as a cosine.
    pub learning_rate: f64,
    /// Steps in which the learning rate rises from 0.
    pub warm_up: usize,
    /// Decoupled weight decay.
    pub weight_decay: f64,
    /// Bound of the gradient's norm.
    pub clip: f64,
    /// τ: φ_tar ← τ φ_tar + (1-τ) φ, Eq. (7), Sec. II-A3; at first min(τ, (n+1)/(n+10)).
    pub momentum: f64,
    /// Weights of the losses.
    pub weights: LossWeights,
    /// δ of Charbonnier's error of z_c, and floor of the scale of z_u's, px.
    pub delta_px: f64,
    /// The motion teacher.
    pub teacher: TeacherConfig,
    /// What the online encoder's view of a picture is changed by.
    pub augment: AugmentConfig,
    /// Mirror and transpose each picture anew, so that p has no constant offset; else each triple as one.
    pub flip_pictures: bool,
    /// Episodes at the recording's end that are not trained on: the progress line shows the loss there.
    pub held_out: usize,
    /// Steps between two saved states, from which `--resume` continues.
    pub save_every: usize,
}

/// Weights of the losses of the learned encoder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossWeights {
    /// z_c's prediction error against the EMA target, divided by its running mean: Eq. (8), Sec. II-A3.
    pub target_c: f64,
    /// The same against the online encoder, with the gradient through it. The paper has none.
    pub online_c: f64,
    /// 1 - correlation of z_c's second differences with what the actions add: scale-free, starts the search.
    pub correlation: f64,
    /// z_u's prediction error against the online encoder.
    pub online_u: f64,
    /// The same against the EMA target.
    pub target_u: f64,
    /// Squared correlation of z_u's second differences with what the actions add: it must not be driven.
    pub driven: f64,
    /// Reward of movement of z_u, so that it does not stand still.
    pub movement: f64,
    /// Error of the measured radio gain that is predicted from both halves.
    pub gain: f64,
    /// Spread of the votes, both halves.
    pub spread: f64,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self {
            target_c: 1.3,
            online_c: 0.0,
            correlation: 1.0,
            online_u: 1.0,
            target_u: 0.3,
            driven: 1.0,
            movement: 0.3,
            gain: 0.3,
            spread: 0.3,
        }
    }
}

/// The motion teacher: where a triple's middle picture differs from both others, away from our own z_c.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TeacherConfig {
    /// Weight; 0 is no teacher, and z_u is left to constant velocity and the radio.
    pub weight: f64,
    /// First step.
    pub from: usize,
    /// Shares of the steps between which its weight falls to 0.
    pub fade: [f64; 2],
    /// Difference, summed over the channels, below which a pixel did not move, steps of 1/255.
    pub threshold: f64,
    /// Radius around our own z_c that is left out, px.
    pub own_radius_px: f64,
    /// Radius of the mean shift, px.
    pub radius_px: f64,
    /// Smallest and largest area that is believed, px.
    pub area_px: [f64; 2],
    /// Largest rms width that is believed, px.
    pub width_px: f64,
    /// Error of z_u against the teacher below which constant velocity shapes it, px/10.
    pub landed: f64,
}

impl Default for TeacherConfig {
    fn default() -> Self {
        Self {
            weight: 3.0,
            from: 300,
            fade: [0.35, 0.55],
            threshold: 45.0,
            own_radius_px: 8.0,
            radius_px: 24.0,
            area_px: [120.0, 700.0],
            width_px: 10.0,
            landed: 6.0,
        }
    }
}

/// Changes of the online encoder's view; the target sees the recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentConfig {
    /// Share of the triples that are changed.
    pub share: f64,
    /// Largest relative change of a channel's gain.
    pub gain: f64,
    /// Largest standard deviation of pixel noise, steps of 1/255.
    pub noise: f64,
    /// Largest amplitude of a sine of light over the picture.
    pub light: f64,
}

impl Default for AugmentConfig {
    fn default() -> Self {
        Self { share: 0.3, gain: 0.2, noise: 4.0, light: 0.4 }
    }
}

impl Default for LearnedConfig {
    fn default() -> Self {
        Self {
            steps: 10_000,
            triples: 16,
            long: [10, 48],
            short: [4, 12],
            learning_rate: 2e-3,
            warm_up: 50,
            weight_decay: 1e-4,
            clip: 5.0,
            momentum: 0.995,
            weights: LossWeights::default(),
            delta_px: 0.05,
            teacher: TeacherConfig::default(),
            augment: AugmentConfig::default(),
            flip_pictures: true,
            held_out: 40,
            save_every: 250,
        }
    }
}
