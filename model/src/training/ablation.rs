//! What each ingredient of the recipe buys: the same training with one thing changed, row by row.
//!
//! Encoders only, without risk and channel heads, so that a row takes seconds.

use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::Noise;
use serde::Serialize;

use crate::encoder::module::Backend;
use crate::evaluation::diagnostics::Diagnostics;
use crate::evaluation::robustness::{self, DecodeErrors};
use crate::training::recipe::{TrainError, without_heads};
use crate::world_model::config::TrainConfig;
use crate::world_model::stages::Init;
use crpl_sitl::camera::effects::{CameraSet, Effects};

/// One change of the recipe.
#[derive(Clone, Copy)]
pub struct Ablation {
    /// What is changed, in the words of the table.
    pub name: &'static str,
    apply: fn(&mut TrainConfig),
}

/// A row of the table.
#[derive(Debug, Clone, Serialize)]
pub struct AblationRow {
    /// What is changed.
    pub change: &'static str,
    /// Decode errors through the cameras of the training; none where the fit failed.
    pub errors: Option<DecodeErrors>,
    /// What the alarms look at.
    #[serde(rename = "figures")]
    pub diagnostics: Option<Diagnostics>,
    /// What is wrong, in words; empty if nothing is.
    pub alarms: Vec<String>,
}

/// The rows, the unchanged recipe first.
pub const ABLATIONS: [Ablation; 20] = [
    Ablation { name: "recipe as configured", apply: |_| {} },
    Ablation { name: "Kaiming weights, not triangles", apply: |c| c.stages.init = Init::Kaiming },
    Ablation { name: "mix 0.3", apply: |c| c.encoder.mix = 0.3 },
    Ablation { name: "mix 0.1", apply: |c| c.encoder.mix = 0.1 },
    Ablation { name: "mix 0.03", apply: |c| c.encoder.mix = 0.03 },
    Ablation {
        name: "moments, no division by the own mass",
        apply: |c| (c.encoder.normalise, c.encoder.gated) = ([false; 2], false),
    },
    Ablation { name: "no missing-mass gate", apply: |c| c.encoder.gated = false },
    Ablation {
        name: "no episodes that begin at an edge",
        apply: |c| {
            c.data.episodes += c.data.edge_episodes;
            c.data.edge_episodes = 0;
        },
    },
    Ablation { name: "200 episodes", apply: |c| (c.data.episodes, c.data.edge_episodes) = (150, 50) },
    Ablation { name: "6,000 frames", apply: |c| c.frames = 6000 },
    Ablation { name: "3,000 frames", apply: |c| c.frames = 3000 },
    Ablation { name: "no long lags", apply: |c| c.long = [4, 11] },
    Ablation { name: "z_u: no trimming", apply: |c| c.closed_form.keep = 1.0 },
    Ablation { name: "z_u: ridge 1e-6", apply: |c| c.closed_form.ridge_u = 1e-6 },
    Ablation { name: "z_u: floor 1e-5 on the covariance", apply: |c| c.closed_form.floor_u = 1e-5 },
    Ablation { name: "z_c: ridge 1e-5", apply: |c| c.closed_form.ridge_c = 1e-5 },
    Ablation { name: "trained on mixed colours", apply: |c| c.cameras = vec![Effects::mixed_colours()] },
    Ablation {
        name: "trained on pixel noise 2/255",
        apply: |c| c.cameras = vec![Effects { noise: 2.0, ..Effects::default() }],
    },
    Ablation {
        name: "trained on mixed colours, colour layer 0.03",
        apply: |c| {
            c.cameras = vec![Effects::mixed_colours()];
            c.encoder.colour = Some(0.03);
        },
    },
    Ablation {
        name: "trained on noise 2/255, colour layer 0.03",
        apply: |c| {
            c.cameras = vec![Effects { noise: 2.0, ..Effects::default() }];
            c.encoder.colour = Some(0.03);
        },
    },
];

impl Ablation {
    /// Trains with the change and measures `count` frames of each kind.
    ///
    /// # Errors
    /// If the backend is not in this build or a file fails; a fit that fails is a row.
    pub fn run(&self, base: &TrainConfig, backend: Backend, count: usize) -> Result<AblationRow, TrainError> {
        let mut config = base.clone();
        // Enough for the alarms' rollouts.
        config.predictor.episodes = config.predictor.episodes.min(50);
        (self.apply)(&mut config);
        let (model, diagnostics) = match without_heads(&config, backend) {
            Ok(trained) => trained,
            // A fit that fails is a result, too.
            Err(error @ (TrainError::Fit(_) | TrainError::Predictor | TrainError::Gradient(_))) => {
                let alarms = vec![error.to_string()];
                return Ok(AblationRow { change: self.name, errors: None, diagnostics: None, alarms });
            }
            Err(error) => return Err(error),
        };
        let noise = Noise::new(config.seed ^ FRESH);
        let cameras = CameraSet::new(&config.cameras, &noise);
        let errors = robustness::decode_errors(&model, &cameras, count, &Scenario::default(), &noise);
        let alarms = diagnostics.alarms(&config.alarms).iter().map(ToString::to_string).collect();
        Ok(AblationRow { change: self.name, errors: Some(errors), diagnostics: Some(diagnostics), alarms })
    }
}

/// Turns the seed of training into that of these measurements.
const FRESH: u64 = 0x6162_6c61_7465_2121;

/// The table's head.
pub const HEAD: &str = "| change | z_c p90 px | z_c, cut disc | z_u p90 px | second eigenvalue | alarms |\n|---|---|---|---|---|---|\n";

impl AblationRow {
    /// As a line of the table.
    #[must_use]
    pub fn line(&self) -> String {
        let px = |value: f64| if value < 10.0 { format!("{value:.3}") } else { format!("{value:.1}") };
        let errors = self.errors.map_or_else(
            || "- | - | -".into(),
            |e| format!("{} | {} | {}", px(e.whole_px), px(e.cut_px), px(e.obstacle_px)),
        );
        let eigenvalue = self.diagnostics.as_ref().and_then(|f| f.eigenvalue);
        let eigenvalue = eigenvalue.map_or_else(|| "-".into(), |v| format!("{v:.1e}"));
        format!("| {} | {errors} | {eigenvalue} | {} |\n", self.change, self.alarms.join("; "))
    }
}
