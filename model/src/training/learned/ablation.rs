//! What each ingredient of the learned encoder's training buys: the same training on the same recording with one
//! thing changed, row by row. Encoders only; each row is a file, so an interrupted table goes on.

use std::path::Path;

use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::noise::Noise;
use serde::{Deserialize, Serialize};

use crate::encoder::BuiltIn;
use crate::encoder::votes::{VoteEncoder, VoteWeights};
use crate::evaluation::hard;
use crate::numeric::tensors::{TensorError, write_all};
use crate::training::learned::{self, LearnedError, recipe};
use crate::training::recipe::TrainError;
use crate::training::show::StageShow;
use crate::world_model::WorldModel;
use crate::world_model::config::{LearnedTraining, TrainConfig};
use crate::world_model::learned::{LearnedConfig, LossWeights};
use crate::world_model::recording::Recording;
use crate::world_model::sight::FrameEncoder;

/// One change of the recipe.
#[derive(Clone, Copy)]
pub struct LearnedAblation {
    /// File of its row, and what `--only` looks in.
    pub key: &'static str,
    /// What is changed, in the words of the table.
    pub name: &'static str,
    apply: fn(&mut LearnedConfig),
}

/// A row of the table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LearnedAblationRow {
    /// What is changed.
    pub change: String,
    /// Errors case by case; none where the training diverged.
    pub cases: Vec<AblatedCase>,
    /// Why there are none; empty if there are.
    pub failure: String,
}

/// An encoder's errors with one camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AblatedCase {
    /// Name of the camera.
    pub case: String,
    /// UAV, 90 % quantile, px.
    pub z_c_p90_px: f64,
    /// Obstacle, 90 % quantile, px.
    pub z_u_p90_px: f64,
    /// Share of the pictures in which either body is more than 3 px off.
    pub lost: f64,
}

/// Cameras of the table.
const CASES: [&str; 3] = ["clean", "harder", "texture"];

/// The rows, the unchanged recipe first.
pub const LEARNED_ABLATIONS: [LearnedAblation; 13] = [
    LearnedAblation { key: "recipe", name: "recipe as configured", apply: |_| {} },
    LearnedAblation {
        key: "paper",
        name: "the paper's loss alone, Eq. (8): both halves against the EMA target, nothing else",
        apply: |c| {
            c.weights = LossWeights {
                target_c: 1.0,
                online_c: 0.0,
                correlation: 0.0,
                online_u: 0.0,
                target_u: 1.0,
                driven: 0.0,
                movement: 0.0,
                gain: 0.0,
                spread: 0.0,
            };
            c.teacher.weight = 0.0;
        },
    },
    LearnedAblation {
        key: "online",
        name: "z_c against the online encoder, no EMA target",
        apply: |c| (c.weights.online_c, c.weights.target_c) = (c.weights.target_c, 0.0),
    },
    LearnedAblation {
        key: "correlation",
        name: "no correlation with the actions",
        apply: |c| c.weights.correlation = 0.0,
    },
    LearnedAblation { key: "teacher", name: "no motion teacher", apply: |c| c.teacher.weight = 0.0 },
    LearnedAblation {
        key: "constant-velocity",
        name: "no constant velocity of z_u",
        apply: |c| (c.weights.online_u, c.weights.target_u) = (0.0, 0.0),
    },
    LearnedAblation { key: "driven", name: "z_u may be driven", apply: |c| c.weights.driven = 0.0 },
    LearnedAblation { key: "movement", name: "z_u may stand still", apply: |c| c.weights.movement = 0.0 },
    LearnedAblation { key: "gain", name: "no radio gain", apply: |c| c.weights.gain = 0.0 },
    LearnedAblation { key: "spread", name: "votes may spread", apply: |c| c.weights.spread = 0.0 },
    LearnedAblation { key: "augment", name: "no changed views", apply: |c| c.augment.share = 0.0 },
    LearnedAblation {
        key: "flips",
        name: "a flip a triple, not a picture",
        apply: |c| c.flip_pictures = false,
    },
    LearnedAblation { key: "long", name: "no long lags", apply: |c| c.long = c.short },
];

impl LearnedAblation {
    /// The training with the change.
    #[must_use]
    pub fn config(&self, base: &LearnedConfig) -> LearnedConfig {
        let mut config = base.clone();
        (self.apply)(&mut config);
        config
    }

    /// The row in `dir`, trained and measured if it is not there yet.
    ///
    /// # Errors
    /// If a file cannot be read or written; a training that diverges is a row.
    pub fn run(
        &self,
        base: &TrainConfig,
        part: &LearnedTraining,
        recording: &Recording,
        dir: &Path,
        count: usize,
    ) -> Result<LearnedAblationRow, TrainError> {
        let path = dir.join(format!("{}.json", self.key));
        if let Ok(text) = std::fs::read_to_string(&path)
            && let Ok(row) = serde_json::from_str(&text)
        {
            return Ok(row);
        }
        let config = self.config(&part.encoder);
        let noise = Noise::new(base.seed);
        let progress = dir.join(self.key);
        std::fs::create_dir_all(&progress).map_err(TensorError::file(&progress))?;
        let shown = StageShow::begin("encoder", config.steps, None);
        let trained = learned::train(recording, &config, None, &noise, Some(&progress), &shown);
        shown.finish();
        let row = match trained {
            Ok(weights) => LearnedAblationRow {
                change: self.name.into(),
                cases: cases(weights, count, base.seed)?,
                failure: String::new(),
            },
            Err(error @ LearnedError::Diverged(_)) => {
                LearnedAblationRow { change: self.name.into(), cases: Vec::new(), failure: error.to_string() }
            }
            Err(error) => return Err(error.into()),
        };
        let mut text = serde_json::to_vec_pretty(&row)
            .map_err(|error| TensorError::Format { path: path.clone(), message: error.to_string() })?;
        text.push(b'\n');
        write_all(&path, &text)?;
        Ok(row)
    }
}

/// Errors of an encoder with the cameras of the table. Its place is in picture coordinates by itself, so the probe and
/// the planes of the built-in model serve any learned encoder.
fn cases(weights: VoteWeights, count: usize, seed: u64) -> Result<Vec<AblatedCase>, TrainError> {
    let mut model = WorldModel::built_in(BuiltIn::Learned)?;
    if let FrameEncoder::Learned(sight) = &mut model.encoder {
        sight.encoder = VoteEncoder::new(weights);
    }
    let report = hard::measure(&model, count, &Scenario::default(), &Noise::new(seed ^ FRESH));
    let rows = report.hard.into_iter().filter(|row| CASES.contains(&row.case.as_str()));
    Ok(rows
        .map(|row| AblatedCase {
            case: row.case,
            z_c_p90_px: row.z_c_p90_px,
            z_u_p90_px: row.z_u_p90_px,
            lost: row.lost,
        })
        .collect())
}

/// Turns the seed of training into that of these measurements.
const FRESH: u64 = 0x6162_6c61_7465_2122;

/// The recording that all rows learn from: that in `data`, or one that is made in `dir` once.
///
/// # Errors
/// If it cannot be read or written.
pub fn recording(
    config: &TrainConfig,
    part: &LearnedTraining,
    data: Option<&Path>,
    dir: &Path,
) -> Result<Recording, TrainError> {
    let own = dir.join("recording");
    let place = match data {
        Some(data) => data,
        None => {
            recipe::record(config, part, &Scenario::default(), &own, None)?;
            &own
        }
    };
    Ok(Recording::open(place, None)?)
}

/// The table's head.
#[must_use]
pub fn head() -> String {
    let names: Vec<String> = CASES.iter().map(|case| format!("{case}: z_c, z_u, lost")).collect();
    format!("| change | {} |\n|{}\n", names.join(" | "), "---|".repeat(CASES.len() + 1))
}

impl LearnedAblationRow {
    /// As a line of the table.
    #[must_use]
    pub fn line(&self) -> String {
        let cell =
            |c: &AblatedCase| format!("{:.2}, {:.2}, {:.1} %", c.z_c_p90_px, c.z_u_p90_px, 100.0 * c.lost);
        let cells: Vec<String> = match self.failure.as_str() {
            "" => self.cases.iter().map(cell).collect(),
            failure => vec![failure.into()],
        };
        format!("| {} | {} |\n", self.change, cells.join(" | "))
    }
}
