//! Algorithm 1: an iteration of stage 1 by the hand-written reverse mode and by burn's autodiff (64
//! rollouts of 100 intervals each), and a whole scenario.

#![expect(clippy::disallowed_methods, reason = "a benchmark")]

#[path = "../tests/oracle/mod.rs"]
mod oracle;

mod rate;

use crpl_model::encoder::BuiltIn;
use std::hint::black_box;
use std::time::Instant;

use crpl_model::planning::algorithm1::{
    Comparison, OptimiseProgress, OptimiseWatch, optimise, total_iterations,
};
use crpl_model::planning::config::{OptimiseConfig, OptimiseError};
use crpl_model::planning::head::Head;
use crpl_model::planning::objective;
use crpl_model::planning::plant::{Execution, Objective, ObjectiveEstimate, RolloutLimits, RolloutOptions};
use crpl_model::planning::policy::Policies;
use crpl_model::planning::problem::PlanningProblem;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use oracle::{by_autodiff, draws, net, plant};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Shows nothing and saves nothing.
struct Quiet;

impl OptimiseWatch for Quiet {
    fn iteration(&mut self, _: &str, _: usize, _: usize, _: &ObjectiveEstimate, _: f64) {}
    fn phase_done(&mut self, _: &str, _: &OptimiseProgress) -> Result<(), OptimiseError> {
        Ok(())
    }
    fn compared(&mut self, _: &Comparison) {}
}

fn main() {
    iteration();
    // Without cargo's `--bench` flag, as in `cargo test --benches`, one iteration each is enough.
    if std::env::args().any(|arg| arg == "--bench") {
        scenario();
    }
}

fn iteration() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let collision = net(&[4, 64, 64, 1], 1.0, &mut rng);
    let gain = net(&[4, 64, 64, 1], 1.0, &mut rng);
    let mut plant = plant(RolloutLimits::Plain, &mut rng);
    plant.collision = Head::new(collision.clone(), None).expect("a head's widths");
    plant.gain = Head::new(gain.clone(), None).expect("a head's widths");
    let draws = draws(2, 100, &mut rng);
    let objective = Objective::default();
    let motion = Policies::untrained(&mut rng).motion;
    let options = RolloutOptions { eta: Some(1.0), power: 4.0, execution: Execution::Nearest };
    rate::rate("stage 1 by hand", "iterations", 1, || {
        black_box(objective::gradient(&plant, &objective, options, black_box(&motion), &draws));
    });
    rate::rate("stage 1 by autodiff", "iterations", 1, || {
        black_box(by_autodiff::gradient(
            &plant,
            &collision,
            &gain,
            &objective,
            1.0,
            black_box(&motion),
            &draws,
        ));
    });
}

fn scenario() {
    let (world, scenario) =
        (WorldModel::built_in(BuiltIn::Centroid).expect("the shipped checkpoint reads"), Scenario::default());
    let config = OptimiseConfig::default();
    let start = Instant::now();
    let problem = PlanningProblem::of(&world, &scenario, &config, 1).expect("the shipped heads fit");
    let (_, outcome) = optimise(&problem, &config, 1, None, &mut Quiet).expect("a feasible policy");
    println!(
        "Scenario 2, both stages      {:>12.1} s, {} iterations, J {:.4}",
        start.elapsed().as_secs_f64(),
        total_iterations(&config),
        outcome.motion.j
    );
}
