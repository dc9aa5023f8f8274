//! What the shipped world model promises, on frames that training never saw.

use crpl_model::encoder::BuiltIn;
use crpl_model::encoder::module::{self, Backend};
use crpl_model::evaluation;
use crpl_model::heads::labels::{self, BaseStation, HeadsConfig, Scene};
use crpl_model::world_model::WorldModel;
use crpl_model::world_model::config::EvaluationConfig;
use crpl_model::world_model::dataset::{self, EpisodeStart};
use crpl_sitl::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};

/// A seed that neither training nor its own evaluation used.
fn fresh() -> Noise {
    Noise::new(0x7465_7374)
}

fn shipped() -> WorldModel {
    WorldModel::built_in(BuiltIn::Centroid).expect("the shipped checkpoint reads")
}

#[test]
fn positions_are_read_to_a_fraction_of_a_pixel_and_not_from_the_wrong_half() {
    let probe = evaluation::decode(&shipped(), 6000, &Scenario::default(), &fresh());
    assert!(probe.c_middle_p90_px <= 0.15, "{probe:?}");
    assert!(probe.u_p90_px <= 0.3, "{probe:?}");
    assert!(probe.leak_c_to_u < 0.05 && probe.leak_u_to_c < 0.05, "{probe:?}");
}

#[test]
fn a_disc_that_the_frame_cuts_is_seen_where_it_is() {
    let (model, scenario) = (shipped(), Scenario::default());
    let probe = evaluation::decode(&model, 6000, &scenario, &fresh());
    assert!(probe.c_edge_p90_px <= 1.5 && probe.c_edge_max_px <= 3.0, "{probe:?}");
    // The trap itself: a UAV past the goal must never be seen short of it.
    for step in 0..=10 {
        let x = 0.90 + 0.01 * f64::from(step);
        let scene = Scene { uav: [x, 0.5].into(), obstacle: scenario.obstacle().position };
        let seen = model.uav(&model.encode(&scene.frame(&scenario)));
        assert!((seen.x - x).abs() < 0.01, "at {x} seen at {}", seen.x);
    }
}

#[test]
fn actions_matter_ten_times_over() {
    let (model, scenario) = (shipped(), Scenario::default());
    let config = EvaluationConfig { frames: 1500, rollouts: 200, horizon: 100 };
    let metrics = evaluation::measure(
        &model,
        &config,
        &HeadsConfig::default(),
        &scenario,
        &fresh(),
        model.card.metrics.label_free,
    );
    let r = metrics.rollout;
    assert!(r.true_p90_px * 10.0 < r.shuffled_p90_px && r.true_p90_px * 10.0 < r.zero_p90_px, "{r:?}");
    assert!(r.end_within_1_px > 0.93, "{r:?}");
    assert!(metrics.heads.collision_auc > 0.99 && metrics.heads.collision_ece <= 0.01, "{:?}", metrics.heads);
    assert!(metrics.heads.gain_rms_db <= 0.5, "{:?}", metrics.heads);
}

#[test]
fn the_shipped_evaluation_has_its_shape_and_holds_its_bars() {
    use crpl_model::evaluation::report::{ReportConfig, measure};
    use crpl_model::predictor::Networks;

    let (model, networks) =
        (shipped(), Networks::built_in(BuiltIn::Centroid).expect("the shipped networks read"));
    assert_eq!(networks.world, crpl_model::world_model::checkpoint::fingerprint(&model).unwrap());
    let config =
        ReportConfig { seed: 77, trajectories: 200, frames: 2000, window: 20, camera: "clean".into() };
    let measured = measure(&model, &networks, &config, &Scenario::default(), || ());
    let json = serde_json::to_value(&measured.report).unwrap();

    let rows = json["rollout"].as_array().unwrap();
    assert_eq!(rows.len(), 5 * 3 * 5);
    let row = |predictor: &str, start: &str, h: u64| {
        let found =
            rows.iter().find(|r| r["predictor"] == predictor && r["start"] == start && r["h"] == h).unwrap();
        for key in ["p02", "p1", "p5", "p90_px"] {
            let value = found[key].as_f64().unwrap();
            let ends = [0, 1].map(|n| found["ci"][key][n].as_f64().unwrap());
            assert!(ends[0] <= value && value <= ends[1], "{key} of {found}");
        }
        found
    };
    for count in json["acceptance"].as_array().unwrap() {
        let rate = count["rate"].as_f64().unwrap();
        assert!(count["kept"] == 200 && rate > 0.0 && rate < 1.0, "{count}");
    }
    assert!(measured.report.table(None).contains("kept of the candidates"));
    for predictor in ["linear", "mlp", "lstm", "constant_velocity", "observer"] {
        for start in ["rest", "rest_moving_obstacle", "moving"] {
            for h in [1, 10, 20, 50, 100] {
                row(predictor, start, h);
            }
        }
    }
    let number = |path: &str| json.pointer(path).and_then(|v| v.as_f64()).expect(path);
    let of =
        |predictor: &str, start: &str, h: u64, key: &str| row(predictor, start, h)[key].as_f64().unwrap();
    assert!(of("linear", "rest", 100, "p1") >= 0.99 && of("linear", "rest", 100, "p90_px") <= 0.3);
    assert!(of("linear", "rest", 1, "p02") >= 0.98);
    // 0.97 over 1000 trajectories; 200 tell it to within their interval.
    let observed = row("observer", "moving", 100)["ci"]["p1"][1].as_f64().unwrap();
    assert!(observed >= 0.97, "{}", row("observer", "moving", 100));
    // What the observer is for: two frames of a moving UAV do not do it.
    assert!(of("linear", "moving", 100, "p1") < 0.5);
    assert!(of("linear", "rest", 100, "p90_px") < of("mlp", "rest", 100, "p90_px"));
    assert!(of("linear", "rest", 100, "p90_px") < of("lstm", "rest", 100, "p90_px"));
    assert!(of("mlp", "rest", 100, "p90_px") < of("constant_velocity", "rest", 100, "p90_px"));
    assert!(number("/heads/auc") >= 0.998 && number("/heads/ece") <= 0.01);
    assert!(number("/heads/gain_rms_db") <= 0.35 && number("/heads/gain_rollout_rms_db") <= 0.5);
    assert!(number("/actions/shuffled_px") >= 10.0 * number("/actions/true_px"));
    assert!(number("/actions/zero_px") >= 10.0 * number("/actions/true_px"));
    assert!(number("/probe/z_c_p90_px") <= 0.15 && number("/probe/z_u_p90_px") <= 0.3);
    assert!(number("/probe/leak_c") < 0.05 && number("/probe/leak_u") < 0.05);
    for half in ["/rank/z_c", "/rank/z_u"] {
        assert!((1.9..=2.05).contains(&number(half)), "{half} {}", number(half));
    }
}

#[test]
fn plane_coordinates_predict_as_the_sixteen_dimensions_do() {
    let (model, scenario) = (shipped(), Scenario::default());
    let episode = &dataset::collect(1, 20, EpisodeStart::Mixed, &scenario, &fresh(), 0)[0];
    let [before, now] = [0, 1].map(|k| model.encode(&episode.frame(k, &scenario)));
    let wide = |z: &[f32; 16]| crpl_model::predictor::linear::Half::from_fn(|k, _| f64::from(z[k]));
    let full = model.linear.step_c(&wide(&now.z_c), &wide(&before.z_c), episode.actions[0]);
    let reduced = model.controllable().step(
        crpl_model::encoder::weights::vector(model.y_c(&now)),
        crpl_model::encoder::weights::vector(model.y_c(&before)),
        episode.actions[0],
    );
    let plane = crpl_model::world_model::plane(&model.plane_c);
    assert!((plane.transpose() * full - reduced).norm() < 1e-4, "{full} {reduced}");
}

#[test]
fn burn_and_the_flight_path_see_the_same() {
    let (model, scenario) = (shipped(), Scenario::default());
    let scenes =
        labels::sample(24, BaseStation::Given, &scenario, &mut fresh().generator(Stream::Evaluation, 3));
    let frames: Vec<_> = scenes.iter().map(|(s, _)| s.frame(&scenario)).collect();
    let own: Vec<_> = frames.iter().map(|f| model.encode(f)).collect();
    let backends =
        if cfg!(feature = "ndarray") { vec![Backend::Flex, Backend::Ndarray] } else { vec![Backend::Flex] };
    for backend in backends {
        let device = backend.device().unwrap();
        let weights = model.encoder.centroid().expect("the shipped encoder").weights();
        let encoder = module::EncoderModule::new(weights, &device);
        let theirs = module::latents_of(&encoder, &weights.input, &device, &frames);
        let size = own.iter().flat_map(|l| l.z_c).fold(0.0f32, |m, v| m.max(v.abs()));
        for (a, b) in own.iter().zip(&theirs) {
            let off = a.z_c.iter().chain(&a.z_u).zip(b.z_c.iter().chain(&b.z_u));
            let off = off.map(|(a, b)| (a - b).abs()).fold(0.0f32, f32::max);
            assert!(off <= 1e-4 * size, "{backend:?} is off by {off} of {size}");
        }
    }
}

#[test]
fn a_checkpoint_of_the_wrong_shape_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let model = shipped();
    model.save(dir.path()).unwrap();
    assert_eq!(WorldModel::load(dir.path()).unwrap().card, model.card);

    let path = dir.path().join("model.safetensors");
    let mut bytes = std::fs::read(&path).unwrap();
    // The header is JSON; turn one shape around without changing its length.
    let (from, to) = (b"[256,3200]", b"[3200,256]");
    let at = bytes.windows(from.len()).position(|w| w == from).expect("fc.weight has that shape");
    bytes[at..at + to.len()].copy_from_slice(to);
    std::fs::write(&path, &bytes).unwrap();
    let error = WorldModel::load(dir.path()).unwrap_err().to_string();
    assert!(error.ends_with("tensor `fc.weight` has shape [3200, 256], expected [256, 3200]"), "{error}");

    std::fs::write(&path, b"not a checkpoint").unwrap();
    let error = WorldModel::load(dir.path()).unwrap_err().to_string();
    assert!(error.contains("model.safetensors: not a safetensors file"), "{error}");
    let error = WorldModel::load(&dir.path().join("nowhere")).unwrap_err().to_string();
    assert!(error.contains("nowhere/model.safetensors"), "{error}");
}

#[test]
fn with_nothing_discarded_the_learned_bounds_hold_what_the_linear_predictor_does_not() {
    use crpl_model::evaluation::rollout::{Forecaster, Panel, RolloutRow, RolloutStart, draw};
    use crpl_model::predictor::{Networks, PredictorKind};
    use crpl_model::world_model::dataset::Selection;
    use crpl_sitl::world::noise::Noise;

    let (model, networks) =
        (shipped(), Networks::built_in(BuiltIn::Centroid).expect("the shipped networks read"));
    let scenario = Scenario::default();
    let panel = Panel::new(&model, &networks, &scenario);
    let row = |name: Forecaster, start: RolloutStart| {
        let (trajectories, count) = draw(150, start, Selection::All, 20, &scenario, &Noise::new(5));
        assert_eq!((count.kept, count.candidates), (150, 150), "a trajectory was discarded");
        let known = panel.look(&trajectories, &scenario, || ());
        RolloutRow::of(name, start, 100, &panel.errors(name, &trajectories, &known).expect("it is shipped"))
    };
    let bounded = Forecaster::Predictor(PredictorKind::Bounded);
    for (name, start, goal) in [
        (bounded, RolloutStart::Rest, 0.95),
        (bounded, RolloutStart::RestMovingObstacle, 0.95),
        (Forecaster::ObserverBounded, RolloutStart::Moving, 0.9),
    ] {
        let found = row(name, start);
        // 150 tell it to within their interval.
        assert!(found.ci.p1[1] >= goal && found.p1 > goal - 0.05, "{found:?}");
    }
    let linear = row(Forecaster::Predictor(PredictorKind::Linear), RolloutStart::Rest);
    assert!(linear.p1 < 0.3, "walls and v_max do not act: {linear:?}");
}

#[test]
fn the_shipped_networks_file_is_what_saving_writes() {
    use crpl_model::predictor::{Networks, PREDICTORS};

    let dir = tempfile::tempdir().unwrap();
    let networks = Networks::built_in(BuiltIn::Centroid).expect("the shipped networks read");
    assert!(networks.bounds.is_some());
    networks.save(dir.path()).unwrap();
    let shipped = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("pretrained").join(PREDICTORS);
    assert!(std::fs::read(dir.path().join(PREDICTORS)).unwrap() == std::fs::read(shipped).unwrap());
}
