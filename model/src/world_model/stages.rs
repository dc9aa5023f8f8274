//! Which stages a training run has, and the numbers of the gradient stage. Needs no burn, so the
//! flight path can read a checkpoint's config.

use serde::{Deserialize, Serialize};

/// The stages that make the encoder, in their order: start values, gradient descent, closed form.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Stages {
    /// The trunk's start values.
    pub init: Init,
    /// Whether the latent heads are fitted in closed form at the end.
    pub closed_form: bool,
    /// Gradient descent on the whole encoder, if any.
    pub gradient: Option<Gradient>,
}

impl Default for Stages {
    fn default() -> Self {
        Self { init: Init::Triangle, closed_form: true, gradient: None }
    }
}

impl Stages {
    /// The method in a line, for a card.
    #[must_use]
    pub fn in_words(&self) -> String {
        let init = match self.init {
            Init::Triangle => "structured start",
            Init::Kaiming => "Kaiming start",
        };
        let heads = if self.closed_form { "closed-form latent heads" } else { "latent heads by gradient" };
        let trunk = match &self.gradient {
            None => "the trunk is not trained".into(),
            Some(g) => {
                let loss = match g.loss {
                    GradientLoss::WhitenedPrediction => "the whitened prediction loss",
                    GradientLoss::Paper => "the paper's loss",
                };
                let layers = match g.layers {
                    Layers::All => "the trunk",
                    Layers::Colour => "the colour layer",
                };
                format!("{layers} trained by {} steps on {loss}", g.steps)
            }
        };
        format!("{init}, {heads}; {trunk}")
    }
}

/// The trunk's start values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Init {
    /// Triangle kernels: a blob's centre of mass is linear in the features from the start.
    Triangle,
    /// Kaiming's normal weights, which lose a small body.
    Kaiming,
}

/// The gradient stage: an online encoder that descends, a target encoder that follows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Gradient {
    /// What is minimised.
    pub loss: GradientLoss,
    /// Whether the predictors learn, too.
    pub psi: PsiStart,
    /// Which layers of the trunk learn.
    pub layers: Layers,
    /// Where the latent heads of this stage come from.
    pub heads: HeadStart,
    /// With closed-form heads: steps between two fits, each on `refit_frames` frames.
    pub refit_every: usize,
    /// Frames of such a fit.
    pub refit_frames: usize,
    /// Steps of AdamW without decay, (0.9, 0.99).
    pub steps: usize,
    /// Triples a step of each set: six times as many frames.
    pub batch: usize,
    /// Learning rate after the warm-up; falls to 1 % of it as a cosine.
    pub learning_rate: f64,
    /// Steps in which the learning rate rises from 0.
    pub warm_up: usize,
    /// Bound of the gradient's norm.
    pub clip: f64,
    /// τ: φ_tar ← τ φ_tar + (1-τ) φ, Eq. (7), Sec. II-A3.
    pub momentum: f64,
    /// Whitened prediction loss: weight of the error against the target encoder, relative to that against the
    /// online one.
    pub target_weight: f64,
    /// Whitened prediction loss: share of the short triples kept in z_u's loss: the others hit a wall.
    pub keep: f64,
    /// Whitened prediction loss: weight of z_u's whitening on its plane.
    pub whitening: f64,
    /// Whitened prediction loss: weight of what lies off the two planes.
    pub off_plane: f64,
    /// Steps between two saved states, from which `--resume` continues.
    pub save_every: usize,
}

impl Default for Gradient {
    fn default() -> Self {
        Self {
            loss: GradientLoss::WhitenedPrediction,
            psi: PsiStart::Pinned,
            layers: Layers::All,
            heads: HeadStart::Random,
            refit_every: 20,
            refit_frames: 6000,
            steps: 2700,
            batch: 16,
            learning_rate: 7e-4,
            warm_up: 100,
            clip: 5.0,
            momentum: 0.995,
            target_weight: 0.1,
            keep: 0.6,
            whitening: 10.0,
            off_plane: 10.0,
            save_every: 100,
        }
    }
}

/// What the gradient stage minimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GradientLoss {
    /// Prediction errors of both halves with the gradient through every online frame, each divided by
    /// its own running mean; z_u whitened and trimmed; a little weight on the target encoder.
    #[serde(rename = "whitened_prediction_loss")]
    WhitenedPrediction,
    /// The paper's, Eq. (8), Sec. II-A3: |ẑ_c - z_c,tar|² + |ẑ_u - z_u,tar|², no gradient through the target,
    /// nothing else.
    Paper,
}

/// The predictors in the gradient stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PsiStart {
    /// (2I, -I) and S a_max E_c throughout.
    Pinned,
    /// Random, learned together with the encoder: it collapses.
    Learned,
}

/// Which layers of the trunk the gradient stage trains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layers {
    /// All of them.
    All,
    /// The colour layer alone.
    Colour,
}

/// The latent heads of the gradient stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeadStart {
    /// Random, learned by gradient together with the trunk.
    Random,
    /// The closed form's, fitted anew every now and then and still in between. As they minimise the
    /// loss, its gradient on the trunk is that of the loss with the best heads (variable projection).
    ClosedForm,
}
