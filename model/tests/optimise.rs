//! Algorithm 1 in small: it lowers J, and a run that was stopped ends as one that was not.

use crpl_model::encoder::BuiltIn;
use crpl_model::planning::algorithm1::{Comparison, OptimiseProgress, OptimiseWatch, optimise};
use crpl_model::planning::config::{OptimiseConfig, OptimiseError};
use crpl_model::planning::plant::ObjectiveEstimate;
use crpl_model::planning::problem::PlanningProblem;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;

/// A few iterations of everything, as no result is an error.
fn config() -> OptimiseConfig {
    OptimiseConfig {
        horizon: 40,
        rollouts: 32,
        starts: 64,
        warm_iterations: [40, 3, 12],
        stage1_iterations: 4,
        last_iterations: 4,
        averaged_iterations: 2,
        tolerance: 0.0,
        comparison_rollouts: 64,
        stage2_rollouts: 32,
        stage2_iterations: 5,
        ..OptimiseConfig::default()
    }
}

/// Keeps what was saved, and stops after `phases` phases.
struct Keep {
    phases: usize,
    saved: Option<OptimiseProgress>,
    costs: Vec<f64>,
}

impl Keep {
    fn until(phases: usize) -> Self {
        Self { phases, saved: None, costs: Vec::new() }
    }
}

impl OptimiseWatch for Keep {
    fn iteration(&mut self, _: &str, _: usize, _: usize, estimate: &ObjectiveEstimate, _: f64) {
        self.costs.push(estimate.cost);
    }

    fn phase_done(&mut self, _: &str, progress: &OptimiseProgress) -> Result<(), OptimiseError> {
        // As a file would keep it.
        let text = serde_json::to_string(progress).expect("progress is JSON");
        self.saved = Some(serde_json::from_str(&text).expect("and reads back"));
        self.phases -= 1;
        if self.phases == 0 { Err(OptimiseError::Progress("stopped".into())) } else { Ok(()) }
    }

    fn compared(&mut self, comparison: &Comparison) {
        assert!(comparison.margin_se > 0.0 && comparison.margin.is_finite());
    }
}

fn problem() -> PlanningProblem {
    let world = WorldModel::built_in(BuiltIn::Centroid).expect("the shipped checkpoint reads");
    PlanningProblem::of(&world, &Scenario::default(), &config(), 3).expect("the shipped heads fit")
}

#[test]
fn a_stopped_run_goes_on_to_the_same_policies() {
    let problem = problem();
    let whole =
        optimise(&problem, &config(), 3, None, &mut Keep::until(usize::MAX)).expect("an unbroken run");
    for phases in [1, 5, 13] {
        let mut keep = Keep::until(phases);
        assert!(optimise(&problem, &config(), 3, None, &mut keep).is_err());
        let rest = optimise(&problem, &config(), 3, keep.saved, &mut Keep::until(usize::MAX));
        assert_eq!(rest.expect("the rest of it"), whole, "stopped after {phases} phases");
    }
}

#[test]
fn iterations_lower_the_cost() {
    let mut keep = Keep::until(1);
    let stopped = optimise(&problem(), &config(), 3, None, &mut keep);
    assert!(stopped.is_err());
    let mean = |costs: &[f64]| costs.iter().sum::<f64>() / costs.len() as f64;
    let (first, last) = (mean(&keep.costs[..5]), mean(&keep.costs[35..40]));
    assert!(last < 0.9 * first, "cost {first} at first, {last} after 40 iterations");
}

#[test]
fn a_number_out_of_range_is_named() {
    let error = OptimiseConfig { rollouts: 50, ..config() }.check().expect_err("50 is no multiple of 32");
    assert_eq!(error.to_string(), "rollouts = 50: must be a positive multiple of 32");
}
