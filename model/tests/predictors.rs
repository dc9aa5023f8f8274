//! Each predictor forecasts, plans and observes behind the same `step`.

use crpl_model::encoder::BuiltIn;
use crpl_model::encoder::weights::vector;
use crpl_model::planning::config::OptimiseConfig;
use crpl_model::planning::objective;
use crpl_model::planning::plant::{Execution, Objective, RolloutOptions};
use crpl_model::planning::policy::Policies;
use crpl_model::planning::problem::PlanningProblem;
use crpl_model::predictor::{Networks, PREDICTORS, PredictorKind};
use crpl_model::world_model::WorldModel;
use crpl_model::world_model::dataset::{self, EpisodeStart};
use crpl_sitl::Scenario;
use crpl_sitl::world::noise::{Noise, Stream};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

fn world(kind: PredictorKind) -> WorldModel {
    let networks = Networks::built_in(BuiltIn::Centroid).expect("the shipped networks read");
    let world = WorldModel::built_in(BuiltIn::Centroid).expect("the shipped checkpoint reads");
    world.with_predictor(kind, &networks).expect("they belong together")
}

#[test]
fn each_of_them_rolls_a_flight_from_rest_out_to_within_a_few_pixels() {
    let scenario = Scenario::default();
    let episodes = dataset::collect(20, 100, EpisodeStart::Rest, &scenario, &Noise::new(77), 0);
    for kind in PredictorKind::ALL {
        let world = world(kind);
        assert_eq!(world.predictor.kind(), kind);
        let mut errors: Vec<f64> = episodes
            .iter()
            .map(|episode| {
                let now = vector(world.y_c(&world.encode(&episode.frame(1, &scenario))));
                let begin = crpl_model::predictor::Begin { now, before: now, actions: &episode.actions };
                let path = world.predictor.rollout(begin);
                100.0 * (world.probe.c.apply(path[99]) - episode.uav[101]).abs().sum()
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        assert!(errors[10] < 3.0, "{kind:?}: half of the rollouts end {} px or more away", errors[10]);
    }
}

#[test]
fn each_of_them_gives_algorithm_1_the_slope_of_its_objective() {
    let config = OptimiseConfig { starts: 16, ..OptimiseConfig::default() };
    // Wide tolerances: both logarithms of the barrier are proper.
    let objective =
        Objective { collision_tolerance: 0.9, outage_tolerance: 0.9, beta: 20.0, ..Objective::default() };
    let options = RolloutOptions { eta: Some(1.0), power: 4.0, execution: Execution::Relaxed };
    let mut motion = Policies::untrained(&mut ChaCha8Rng::seed_from_u64(3)).motion;
    motion.layers[2].w.iter_mut().for_each(|w| *w *= 30.0);
    for kind in PredictorKind::ALL {
        let problem = PlanningProblem::of(&world(kind), &Scenario::default(), &config, 3).expect("it plans");
        let draws = problem.draws(&Noise::new(1), Stream::Batches, 0, 32, [0.0, 0.0], 15);
        let (estimate, grad) = objective::gradient(problem.plant(), &objective, options, &motion, &draws);
        let norm: f64 = grad.layers.iter().flat_map(|l| &l.w).map(|g| f64::from(*g).powi(2)).sum();
        assert!(estimate.j.is_finite() && norm > 0.0, "{kind:?}: {estimate:?}");
        // Along the gradient itself, in the last layer.
        let h = 2e-3 / norm.sqrt() as f32;
        let at = |sign: f32| {
            let mut moved = motion.clone();
            for (layer, g) in moved.layers.iter_mut().zip(&grad.layers) {
                layer.w.iter_mut().zip(&g.w).for_each(|(w, g)| *w += sign * h * g);
            }
            objective::evaluate(problem.plant(), &objective, options, &moved, &draws).0.j
        };
        let slope = (at(1.0) - at(-1.0)) / (2.0 * f64::from(h));
        assert!((slope - norm).abs() < 0.03 * norm, "{kind:?}: {norm} by hand, {slope} by differences");
    }
}

#[test]
fn a_checkpoint_names_its_predictor_and_the_shipped_one_does_not_have_to() {
    let (dir, networks) = (tempfile::tempdir().unwrap(), Networks::built_in(BuiltIn::Centroid).unwrap());
    let world = world(PredictorKind::Mlp);
    world.save(dir.path()).unwrap();
    let missing = WorldModel::load(dir.path()).unwrap_err().to_string();
    assert!(missing.contains(PREDICTORS), "{missing}");
    networks.save(dir.path()).unwrap();
    assert_eq!(WorldModel::load(dir.path()).unwrap().predictor, world.predictor);

    let other = Networks { world: "0123".into(), ..networks };
    other.save(dir.path()).unwrap();
    let foreign = WorldModel::load(dir.path()).unwrap_err().to_string();
    assert!(foreign.contains("was trained on world model 0123, and this is"), "{foreign}");

    let shipped = WorldModel::built_in(BuiltIn::Centroid).unwrap();
    shipped.save(dir.path()).unwrap();
    let text = std::fs::read_to_string(dir.path().join("config.json")).unwrap();
    assert!(!text.contains("\"kind\""), "the default is not written");
    let own = std::fs::read(dir.path().join("model.safetensors")).unwrap();
    let manifest = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    assert_eq!(own, std::fs::read(manifest.join("pretrained/model.safetensors")).unwrap());
    assert_eq!(text.as_bytes(), std::fs::read(manifest.join("pretrained/config.json")).unwrap());
}
