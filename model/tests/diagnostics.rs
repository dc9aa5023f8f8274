//! Failures planted in training: each raises its alarm, and none ships.

use crpl_model::encoder::module::Backend;
use crpl_model::evaluation::diagnostics::{CollapseCheck, LatentHalf};
use crpl_model::heads::labels::HeadsConfig;
use crpl_model::training::learned::device::EncoderDevice;
use crpl_model::training::recipe::{Run, TrainError, train, without_heads};
use crpl_model::world_model::config::{DataConfig, EvaluationConfig, PredictorConfig, TrainConfig};
use crpl_model::world_model::stages::{Gradient, GradientLoss, Init, PsiStart, Stages};
use crpl_sitl::program::timing::Stopwatch;

fn small() -> TrainConfig {
    TrainConfig {
        seed: 4,
        data: DataConfig { episodes: 60, edge_episodes: 20, steps: 100 },
        frames: 3600,
        predictor: PredictorConfig { episodes: 6, ..PredictorConfig::default() },
        heads: HeadsConfig { frames: 200, steps: 10, batch: 32, ..HeadsConfig::default() },
        evaluation: EvaluationConfig { frames: 300, rollouts: 30, horizon: 100 },
        ..TrainConfig::default()
    }
}

fn alarms(config: &TrainConfig) -> Vec<CollapseCheck> {
    let (_, diagnostics) =
        without_heads(config, Backend::Flex).expect("the fit succeeds, whatever it is worth");
    diagnostics.alarms(&config.alarms)
}

/// The paper's loss with predictors that learn from the start, heads by gradient.
fn learned_from_the_start(steps: usize) -> TrainConfig {
    let gradient = Gradient {
        loss: GradientLoss::Paper,
        psi: PsiStart::Learned,
        steps,
        batch: 2,
        learning_rate: 3e-3,
        // A quick target, so that the collapse is quick, too.
        momentum: 0.9,
        warm_up: 1,
        ..Gradient::default()
    };
    let stages = Stages { closed_form: false, gradient: Some(gradient), ..Stages::default() };
    TrainConfig { stages, ..small() }
}

#[test]
fn a_sound_recipe_raises_none() {
    assert_eq!(alarms(&small()), []);
}

#[test]
fn predictors_that_learn_from_the_start_let_both_halves_collapse() {
    let alarms = alarms(&learned_from_the_start(60));
    for side in LatentHalf::BOTH {
        assert!(
            alarms.iter().any(|a| matches!(a, CollapseCheck::Collapsed(s, _) if *s == side)),
            "{alarms:?}"
        );
    }
}

#[test]
fn kaimings_weights_lose_both_bodies() {
    let config = TrainConfig { stages: Stages { init: Init::Kaiming, ..Stages::default() }, ..small() };
    let alarms = alarms(&config);
    for side in LatentHalf::BOTH {
        assert!(alarms.iter().any(|a| matches!(a, CollapseCheck::Lost(s, _) if *s == side)), "{alarms:?}");
    }
}

#[test]
fn too_few_frames_are_told_by_the_eigenvalue() {
    // A trunk with mixing noise needs more of them than one without.
    let mut config = TrainConfig { frames: 3000, ..small() };
    config.encoder.mix = 0.03;
    let alarms = alarms(&config);
    assert!(alarms.iter().any(|a| matches!(a, CollapseCheck::Eigenvalue(_))), "{alarms:?}");
}

#[test]
fn a_model_with_an_alarm_does_not_ship() {
    let dir = tempfile::tempdir().unwrap();
    let config = TrainConfig { stages: Stages { init: Init::Kaiming, ..Stages::default() }, ..small() };
    let run = Run {
        backend: Backend::Flex,
        device: EncoderDevice::default(),
        out: dir.path().into(),
        data: None,
        resume: false,
        stopwatch: Stopwatch::default(),
        feed: None,
    };
    let error = train(&config, &run).unwrap_err();
    assert!(matches!(error, TrainError::Alarms { .. }), "{error}");
    let words = error.to_string();
    assert!(words.contains("z_c has lost the UAV") && words.contains("rejected"), "{words}");
    assert!(!dir.path().join("model.safetensors").exists() && !dir.path().join("config.json").exists());
    let card = std::fs::read_to_string(dir.path().join("rejected/card.md")).unwrap();
    assert!(card.contains("**Does not ship**: z_c has lost the UAV"), "{card}");
}
