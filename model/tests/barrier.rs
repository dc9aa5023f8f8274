//! The barrier of Eq. (29): each constraint with its own tolerance, the tangent below feasibility, and
//! how η grows in Algorithm 1.

use crpl_model::encoder::BuiltIn;
use crpl_model::planning::algorithm1::{Comparison, OptimiseProgress, OptimiseWatch, optimise};
use crpl_model::planning::config::{OptimiseConfig, OptimiseError};
use crpl_model::planning::objective::{
    barrier, barrier_weight, estimate, influence, log_ext, outage_surrogate,
};
use crpl_model::planning::plant::{Execution, Objective, ObjectiveEstimate, RolloutOptions, Scores};
use crpl_model::planning::problem::PlanningProblem;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;

/// δ1 and δ2 differ.
fn objective() -> Objective {
    Objective { collision_tolerance: 0.04, outage_tolerance: 0.3, ..Objective::default() }
}

fn assert_near(a: f64, b: f64, what: &str) {
    assert!((a - b).abs() < 1e-9 * a.abs().max(1.0), "{what}: {a}, {b}");
}

#[test]
fn each_constraint_has_its_own_tolerance() {
    // P_safe - 1 + δ1 = 0.03, P_comm - 1 + δ2 = 0.2.
    let value = barrier(0.99, 0.9, 0.5, 0.01, &objective());
    assert_near(value, -0.5 * (0.03_f64.ln() + 0.2_f64.ln()), "barrier");
}

#[test]
fn the_smooth_outage_is_a_half_at_the_snr_that_a_packet_needs() {
    let at = |snr: f64| outage_surrogate(snr, 4.0, 3.0);
    assert!((at(4.0) - 0.5).abs() < 1e-12);
    // Without any signal sigmoid(3), with twice what it needs sigmoid(-3).
    assert!(
        (at(0.0) - 1.0 / (1.0 + (-3.0_f64).exp())).abs() < 1e-12 && (at(8.0) + at(0.0) - 1.0).abs() < 1e-12
    );
}

#[test]
fn the_logarithm_goes_on_as_its_tangent() {
    let eps = 0.02;
    assert_near(log_ext(0.05, eps), 0.05_f64.ln(), "the logarithm proper");
    assert_near(log_ext(eps, eps), eps.ln(), "where both meet");
    assert_near(log_ext(-0.3, eps), eps.ln() - 0.32 / eps, "the tangent");
}

#[test]
fn the_weight_falls_with_eta_to_its_residual() {
    let [first, middle, last] = [2.0, 50.0, 1e12].map(|eta| barrier_weight(eta, 1e-4));
    assert_near(first.0, 0.5001, "w at 2");
    assert_near(first.1, 0.02, "eps at 2");
    assert_near(middle.1, 0.010_05, "eps at 50");
    assert_near(last.0, 1e-4, "w at the end");
}

/// The mean influence changes with single scores as J does.
fn compare_influence(safe: f64, comm: f64) {
    let (o, eta) = (objective(), 5.0);
    let options = RolloutOptions { eta: Some(eta), power: 4.0, execution: Execution::Nearest };
    let scores = Scores { cost: vec![1.0, 2.0, 4.0], safe: vec![safe; 3], comm: vec![comm; 3] };
    let at = estimate(&o, options, &scores);
    let mean = |scores: &Scores| influence(&o, eta, &at, scores).iter().sum::<f64>() / 3.0;
    let change: [fn(&mut Scores, f64); 3] =
        [|s, h| s.cost[0] += h, |s, h| s.safe[1] += h, |s, h| s.comm[2] += h];
    for (n, change) in change.iter().enumerate() {
        let [up, down] = [1e-5, -1e-5].map(|h| {
            let mut moved = scores.clone();
            change(&mut moved, h);
            (mean(&moved), estimate(&o, options, &moved).j)
        });
        let (first_order, j) = (up.0 - down.0, up.1 - down.1);
        assert!((first_order - j).abs() < 1e-4 * j.abs(), "score {n} at {safe}, {comm}: {first_order}, {j}");
    }
}

#[test]
fn influence_is_the_slope_of_the_objective_in_each_score() {
    compare_influence(0.99, 0.9);
    compare_influence(0.8, 0.9);
    compare_influence(0.99, 0.4);
}

/// One iteration of everything.
fn config() -> OptimiseConfig {
    OptimiseConfig {
        objective: Objective { collision_tolerance: 0.01, outage_tolerance: 0.04, ..Objective::default() },
        horizon: 10,
        rollouts: 32,
        starts: 32,
        warm_iterations: [1, 1, 1],
        stage1_iterations: 1,
        last_iterations: 2,
        averaged_iterations: 1,
        tolerance: 0.0,
        barrier_growth: 3.0,
        barrier_end: 0.004,
        comparison_rollouts: 32,
        stage2_rollouts: 32,
        stage2_iterations: 1,
        ..OptimiseConfig::default()
    }
}

/// What was estimated in each iteration.
#[derive(Default)]
struct Seen(Vec<(String, ObjectiveEstimate)>);

impl OptimiseWatch for Seen {
    fn iteration(&mut self, phase: &str, _: usize, _: usize, estimate: &ObjectiveEstimate, _: f64) {
        self.0.push((phase.into(), *estimate));
    }

    fn phase_done(&mut self, _: &str, _: &OptimiseProgress) -> Result<(), OptimiseError> {
        Ok(())
    }

    fn compared(&mut self, _: &Comparison) {}
}

#[test]
fn eta_grows_by_mu_until_its_inverse_is_below_the_end() {
    let world = WorldModel::built_in(BuiltIn::Centroid).expect("the shipped checkpoint reads");
    let problem = PlanningProblem::of(&world, &Scenario::default(), &config(), 3).expect("the heads fit");
    let mut seen = Seen::default();
    optimise(&problem, &config(), 3, None, &mut seen).expect("it runs");
    let stage1: Vec<_> = seen.0.iter().filter(|(phase, _)| phase.starts_with("stage 1")).collect();
    // 1/243 is the last above 0.004, and the last phase has two iterations.
    let etas = [3.0, 9.0, 27.0, 81.0, 243.0, 243.0];
    assert_eq!(stage1.len(), etas.len(), "{stage1:?}");
    let o = problem.objective(&config().objective, config().snr_headroom);
    for (eta, (phase, at)) in etas.into_iter().zip(stage1) {
        let (w, eps) = barrier_weight(eta, o.barrier_residual);
        assert_near(at.j - at.cost, barrier(at.p_safe, at.p_comm, w, eps, &o), phase);
    }
}
