//! What `model train` promises of a run, on a small one.

use std::path::Path;

use crpl_model::encoder::module::Backend;
use crpl_model::evaluation;
use crpl_model::heads::labels::HeadsConfig;
use crpl_model::predictor::NetworksConfig;
use crpl_model::training::learned::device::EncoderDevice;
use crpl_model::training::recipe::{Run, TrainError, train};
use crpl_model::world_model::WorldModel;
use crpl_model::world_model::config::{
    AlarmLimits, DataConfig, EvaluationConfig, PredictorConfig, TrainConfig,
};
use crpl_model::world_model::stages::{Gradient, HeadStart, Layers, PsiStart, Stages};
use crpl_sitl::Scenario;
use crpl_sitl::camera::effects::Effects;
use crpl_sitl::program::timing::Stopwatch;
use crpl_sitl::world::noise::Noise;

fn small() -> TrainConfig {
    TrainConfig {
        seed: 4,
        data: DataConfig { episodes: 60, edge_episodes: 20, steps: 100 },
        frames: 3600,
        predictor: PredictorConfig { episodes: 6, ..PredictorConfig::default() },
        networks: NetworksConfig {
            episodes: 6,
            held_out: 4,
            hidden: 8,
            short_steps: 8,
            mlp_steps: 8,
            lstm_steps: 8,
            batch: 4,
            ..NetworksConfig::default()
        },
        heads: HeadsConfig { frames: 300, steps: 40, batch: 32, ..HeadsConfig::default() },
        evaluation: EvaluationConfig { frames: 300, rollouts: 30, horizon: 100 },
        ..TrainConfig::default()
    }
}

fn run(out: &Path, backend: Backend, resume: bool) -> Result<WorldModel, TrainError> {
    go(
        &small(),
        &Run {
            backend,
            device: EncoderDevice::default(),
            out: out.into(),
            data: None,
            resume,
            stopwatch: Stopwatch::default(),
            feed: None,
        },
    )
}

fn go(config: &TrainConfig, run: &Run) -> Result<WorldModel, TrainError> {
    train(config, run).map(|(model, _)| model)
}

/// Everything that equal seeds have to write alike.
fn bytes(out: &Path) -> [Vec<u8>; 4] {
    ["model.safetensors", "config.json", "predictors.safetensors", "predictors_loss.csv"]
        .map(|name| std::fs::read(out.join(name)).expect("the run wrote it"))
}

#[test]
fn equal_seeds_give_equal_bytes_on_one_core_and_on_all() {
    let dir = tempfile::tempdir().unwrap();
    let (all, one) = (dir.path().join("all"), dir.path().join("one"));
    run(&all, Backend::Flex, false).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| run(&one, Backend::Flex, false)).unwrap();
    assert!(bytes(&all) == bytes(&one), "the checkpoints differ");
    assert!(!all.join("stages").exists());
}

#[test]
fn a_model_is_measured_on_frames_that_training_did_not_draw() {
    let dir = tempfile::tempdir().unwrap();
    let (config, model) = (small(), run(dir.path(), Backend::Flex, false).unwrap());
    let measured = |noise: &Noise| {
        let (scenario, check) = (Scenario::default(), model.card.metrics.label_free);
        evaluation::measure(&model, &config.evaluation, &config.heads, &scenario, noise, check)
    };
    assert_eq!(model.card.metrics.probe, measured(&config.held_out()).probe);
    let seen = measured(&Noise::new(config.seed));
    assert_ne!(model.card.metrics.probe, seen.probe);
    assert_ne!(model.card.metrics.rollout, seen.rollout);
}

#[test]
fn a_run_that_was_stopped_ends_with_the_bytes_of_one_that_was_not() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, broken) = (dir.path().join("whole"), dir.path().join("broken"));
    run(&whole, Backend::Flex, false).unwrap();

    // A folder where the checkpoint should go stops the run at its very end.
    std::fs::create_dir_all(broken.join("model.safetensors/in the way")).unwrap();
    let error = run(&broken, Backend::Flex, false).unwrap_err().to_string();
    assert!(error.contains("model.safetensors"), "{error}");
    std::fs::remove_dir_all(broken.join("model.safetensors")).unwrap();
    // As if it had been stopped while the predictors were fitted.
    std::fs::remove_dir_all(broken.join("stages/heads")).unwrap();
    std::fs::rename(broken.join("stages/predictor"), broken.join("stages/predictor.part")).unwrap();
    run(&broken, Backend::Flex, true).unwrap();
    assert!(bytes(&whole) == bytes(&broken), "the checkpoints differ");
}

#[test]
fn another_configuration_does_not_go_on_with_the_run() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(dir.path().join("model.safetensors/in the way")).unwrap();
    run(dir.path(), Backend::Flex, false).unwrap_err();
    let other = TrainConfig { seed: 5, ..small() };
    let run = Run {
        backend: Backend::Flex,
        device: EncoderDevice::default(),
        out: dir.path().into(),
        data: None,
        resume: true,
        stopwatch: Stopwatch::default(),
        feed: None,
    };
    let error = train(&other, &run).unwrap_err().to_string();
    assert!(error.contains("another configuration"), "{error}");
}

#[cfg(feature = "ndarray")]
#[test]
fn both_backends_fit_the_same_encoder() {
    use nalgebra::Vector2;

    let dir = tempfile::tempdir().unwrap();
    let flex = run(&dir.path().join("flex"), Backend::Flex, false).unwrap();
    let ndarray = run(&dir.path().join("ndarray"), Backend::Ndarray, false).unwrap();
    let scenario = Scenario::default();
    for k in 0..20 {
        let k = f64::from(k);
        let uav = Vector2::new(0.5 + 0.5 * (k * 1.3).sin(), 0.5 + 0.5 * (k * 0.7).cos());
        let obstacle = Vector2::new(0.5 + 0.3 * (k * 0.9).cos(), 0.5 + 0.3 * (k * 1.1).sin());
        let frame = crpl_sitl::camera::render(uav, obstacle, &scenario);
        let (a, b) = (flex.encode(&frame), ndarray.encode(&frame));
        let size = a.z_c.iter().chain(&a.z_u).fold(0.0f32, |m, v| m.max(v.abs()));
        let off = a.z_c.iter().chain(&a.z_u).zip(b.z_c.iter().chain(&b.z_u));
        let off = off.map(|(a, b)| (a - b).abs()).fold(0.0f32, f32::max);
        assert!(off <= 1e-4 * size, "off by {off} of {size}");
    }
}

#[test]
fn a_misspelt_key_and_a_senseless_value_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("train.toml");
    std::fs::write(&path, "fraims = 3\n").unwrap();
    let error = TrainConfig::load(&path).unwrap_err().to_string();
    assert!(error.contains("train.toml") && error.contains("fraims"), "{error}");
    std::fs::write(&path, "[encoder]\nscale = -1.0\n").unwrap();
    let error = TrainConfig::load(&path).unwrap_err().to_string();
    assert_eq!(error, "encoder.scale = -1: must be finite and above 0");
}

/// A gradient stage so short that its figures mean nothing: limits that nothing breaks.
fn with_gradient() -> TrainConfig {
    let limits = AlarmLimits {
        rank: 0.0,
        spread: 0.0,
        eigenvalue: f64::MAX,
        r_squared: f64::MIN,
        leak: f64::MAX,
        action_ratio: 0.0,
    };
    let gradient = Gradient { steps: 5, batch: 2, save_every: 2, warm_up: 2, ..Gradient::default() };
    let stages = Stages { gradient: Some(gradient), ..Stages::default() };
    let heads = HeadsConfig { frames: 100, steps: 2, batch: 16, ..HeadsConfig::default() };
    TrainConfig { stages, alarms: limits, heads, frames: 1200, ..small() }
}

#[test]
fn a_gradient_stage_that_was_stopped_ends_with_the_bytes_of_one_that_was_not() {
    let dir = tempfile::tempdir().unwrap();
    let run = |out: &Path, resume| Run {
        backend: Backend::Flex,
        device: EncoderDevice::default(),
        out: out.into(),
        data: None,
        resume,
        stopwatch: Stopwatch::default(),
        feed: None,
    };
    let mut learned = with_gradient();
    if let Some(gradient) = &mut learned.stages.gradient {
        gradient.psi = PsiStart::Learned;
    }
    let mut colour = with_gradient();
    colour.encoder.colour = Some(0.05);
    if let Some(gradient) = &mut colour.stages.gradient {
        (gradient.layers, gradient.heads) = (Layers::Colour, HeadStart::ClosedForm);
        (gradient.refit_every, gradient.refit_frames) = (3, 900);
    }
    for (name, config) in [("learned", learned), ("colour", colour)] {
        let [whole, broken] = ["whole", "broken"].map(|part| dir.path().join(name).join(part));
        go(&config, &run(&whole, false)).unwrap();
        std::fs::create_dir_all(broken.join("model.safetensors/in the way")).unwrap();
        go(&config, &run(&broken, false)).unwrap_err();
        std::fs::remove_dir_all(broken.join("model.safetensors")).unwrap();
        // As if it had been stopped in the gradient stage, after its last saved state: step 4 of 5.
        for stage in ["gradient", "features", "encoder", "predictor", "heads"] {
            std::fs::remove_dir_all(broken.join("stages").join(stage)).unwrap();
        }
        assert!(broken.join("stages/gradient.safetensors").exists());
        go(&config, &run(&broken, true)).unwrap();
        assert!(bytes(&whole) == bytes(&broken), "the checkpoints differ");
    }
}

#[test]
fn stages_that_cannot_be_are_told() {
    let check = |change: fn(&mut TrainConfig)| {
        let mut config = with_gradient();
        change(&mut config);
        config.check().unwrap_err().to_string()
    };
    let without = check(|c| (c.stages.gradient, c.stages.closed_form) = (None, false));
    assert!(without.starts_with("stages.closed_form = 0: must be true without"), "{without}");
    let layers = check(|c| {
        if let Some(gradient) = &mut c.stages.gradient {
            gradient.layers = Layers::Colour;
        }
    });
    assert!(layers.starts_with("encoder.colour is not set"), "{layers}");
    let camera = check(|c| c.cameras = vec![Effects { noise: -1.0, ..Effects::default() }]);
    assert_eq!(camera, "cameras[0].noise = -1: must lie in [0, 255]");
}

#[test]
fn the_old_name_of_a_loss_is_an_error_that_names_the_new_one() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("train.toml");
    std::fs::write(&path, "[stages.gradient]\nloss = \"recipe_b\"\n").unwrap();
    let error = TrainConfig::load(&path).unwrap_err().to_string();
    assert!(error.contains("whitened_prediction_loss"), "{error}");
}
