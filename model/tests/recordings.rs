//! What the learned encoder is trained on: recorded episodes and nothing else.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking, its helpers too")]

use std::path::Path;

use crpl_model::encoder::votes::VoteWeights;
use crpl_model::training::learned::{self, LearnedConfig};
use crpl_model::training::show::StageShow;
use crpl_model::world_model::exploration::{self, ExplorationConfig};
use crpl_model::world_model::recording::{Recording, RecordingFormat, TRUTH, Truth};
use crpl_sitl::Scenario;
use crpl_sitl::camera::CameraConfig;
use crpl_sitl::world::noise::Noise;

/// Two short episodes.
fn collect(dir: &Path, format: RecordingFormat) {
    let config = ExplorationConfig {
        episodes: 2,
        pictures: 24,
        cameras: vec![("hard".into(), 1.0)],
        ..ExplorationConfig::default()
    };
    let cameras = [CameraConfig::named("hard").unwrap()];
    exploration::collect(&config, &cameras, &Scenario::default(), 3, (dir, format), || {}).unwrap();
}

/// The weights after a few steps.
fn trained(dir: &Path) -> Vec<f32> {
    let config = LearnedConfig { steps: 3, triples: 2, held_out: 0, ..LearnedConfig::default() };
    let recording = Recording::open(dir, None).unwrap();
    let bar = StageShow::hidden();
    let weights: VoteWeights = learned::train(&recording, &config, None, &Noise::new(1), None, &bar).unwrap();
    weights.parts().concat()
}

#[test]
fn training_without_the_true_positions_gives_the_same_weights() {
    let dir = tempfile::tempdir().unwrap();
    collect(dir.path(), RecordingFormat::Safetensors);
    assert!(Truth::load(dir.path(), 1).is_ok());
    let with = trained(dir.path());
    std::fs::remove_dir_all(dir.path().join(TRUTH)).unwrap();
    assert!(Truth::load(dir.path(), 1).is_err());
    assert_eq!(trained(dir.path()), with);
}

#[test]
fn pictures_as_png_train_the_same_weights_as_tensors() {
    let [tensors, pictures] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    collect(tensors.path(), RecordingFormat::Safetensors);
    collect(pictures.path(), RecordingFormat::Png);
    assert!(pictures.path().join("episode-00001").join("00023.png").is_file());
    assert_eq!(trained(pictures.path()), trained(tensors.path()));
}
