//! What Algorithm 1 decides between its iterations.

use crpl_sitl::Scenario;

use super::*;
use crate::encoder::BuiltIn;
use crate::numeric::mlp::Mlp;
use crate::world_model::WorldModel;

fn problem(config: &OptimiseConfig) -> PlanningProblem {
    let world = WorldModel::built_in(BuiltIn::Centroid).unwrap();
    PlanningProblem::of(&world, &Scenario::default(), config, 0).unwrap()
}

/// Two displacements, three barrier weights: 1/η of 4, 16 and 64 are not below 0.01.
fn config() -> OptimiseConfig {
    OptimiseConfig {
        starts: 32,
        rollouts: 32,
        horizon: 10,
        displacements: vec![0.3, 0.1],
        warm_iterations: [40, 3, 12],
        stage1_iterations: 5,
        last_iterations: 7,
        stage2_iterations: 9,
        barrier_growth: 4.0,
        barrier_end: 0.01,
        ..OptimiseConfig::default()
    }
}

#[test]
fn iterations_are_counted_as_the_phases_make_them() {
    let config = config();
    let phases = phases(&problem(&config), &config);
    let each: Vec<usize> = phases.iter().map(|phase| phase.iterations).collect();
    assert_eq!(each, [40, 3, 3, 12, 3, 3, 12, 5, 5, 7]);
    assert_eq!(each, lengths(&config).collect::<Vec<_>>());
    assert_eq!(total_iterations(&config), each.iter().sum::<usize>() + 9);
    let untrained = Policies::untrained(&mut Noise::new(0).generator(Stream::Weights, 0)).motion;
    let behind = |phase: usize| {
        let none = (None, None, None, None);
        let (right, left, chosen, comparison) = none;
        OptimiseProgress { phase, free: untrained.clone(), right, left, chosen, comparison }
            .iterations(&config)
    };
    assert_eq!([0, 1, 4, 10].map(behind), [0, 40, 58, 93]);
    let last = phases.last().unwrap();
    assert!(last.is_whole && last.eta == Some(64.0) && last.side == PassingSide::Chosen);
    assert!(phases.iter().rev().skip(1).all(|phase| !phase.is_whole));
}

/// Feeds windows of three and says after which of them the phase is over.
fn over(tolerance: f64, windows: &[[f64; 3]]) -> Vec<bool> {
    let config = OptimiseConfig { averaged_iterations: 3, tolerance, ..OptimiseConfig::default() };
    let mut all = Windows::new(&config);
    windows
        .iter()
        .map(|window| {
            assert!(all.begins());
            assert!(!all.is_over(window[0]) && !all.begins());
            assert!(!all.is_over(window[1]) && !all.begins());
            all.is_over(window[2])
        })
        .collect()
}

#[test]
fn a_phase_is_over_when_a_window_gains_too_little() {
    // A hundredth of 10 is 0.1: a gain of 0.2 goes on, one of 0.05 does not, nor does a loss.
    let steady = |j: f64| [j; 3];
    assert_eq!(over(0.01, &[steady(10.0), steady(9.8), steady(9.75)]), [false, false, true]);
    assert_eq!(over(0.01, &[steady(10.0), steady(10.5)]), [false, true]);
    assert_eq!(over(0.01, &[steady(-10.0), steady(-10.05), steady(-10.3)]), [false, true, false]);
    assert_eq!(over(0.0, &[steady(10.0), steady(10.5)]), [false, false]);
}

#[test]
fn a_gain_within_the_noise_of_two_windows_is_none() {
    // Variance of a mean of three: (1 + 0 + 1)/2/3 = 1/3 each, together a standard error of 0.816.
    let noisy = |j: f64| [j - 1.0, j, j + 1.0];
    assert_eq!(over(1e-6, &[noisy(10.0), noisy(9.1)]), [false, false]);
    assert_eq!(over(1e-6, &[noisy(10.0), noisy(9.3)]), [false, true]);
    // One noisy window beside a steady one: 0.577.
    assert_eq!(over(1e-6, &[noisy(10.0), [9.5; 3]]), [false, true]);
    assert_eq!(over(1e-6, &[noisy(10.0), [9.3; 3]]), [false, false]);
}

/// Takes down the cost of each iteration.
#[derive(Default)]
struct Costs(Vec<f64>);

impl OptimiseWatch for Costs {
    fn iteration(&mut self, _: &str, _: usize, _: usize, estimate: &ObjectiveEstimate, _: f64) {
        self.0.push(estimate.cost);
    }

    fn phase_done(&mut self, _: &str, _: &OptimiseProgress) -> Result<(), OptimiseError> {
        Ok(())
    }

    fn compared(&mut self, _: &Comparison) {}
}

/// The network after a phase of so many iterations, with windows of `averaged`.
fn after(iterations: usize, averaged: usize, tolerance: f64, is_whole: bool) -> Mlp {
    let config = OptimiseConfig { averaged_iterations: averaged, tolerance, ..config() };
    let problem = problem(&config);
    let noise = Noise::new(3);
    let mut net = Policies::untrained(&mut noise.generator(Stream::Weights, 0)).motion;
    let phase = OptimisePhase {
        name: String::new(),
        side: PassingSide::Free,
        obstacle: problem.obstacle,
        eta: None,
        iterations,
        is_whole,
    };
    run_phase(&problem, &config, &noise, 1, &phase, &mut net, &mut Costs::default());
    net
}

/// Largest difference of two networks' weights.
fn apart(a: &Mlp, b: &Mlp) -> f32 {
    let layers = a.layers.iter().zip(&b.layers);
    let each = layers.flat_map(|(a, b)| a.w.iter().chain(&a.b).zip(b.w.iter().chain(&b.b)));
    each.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

fn mean(nets: &[Mlp]) -> Mlp {
    let mut mean = WeightMean::default();
    nets.iter().for_each(|net| mean.add(net));
    mean.net().unwrap()
}

#[test]
fn a_phase_ends_with_the_mean_of_its_last_window() {
    // Windows longer than the phase are none: the network of the last iteration.
    let plain = |iterations| after(iterations, 1000, 0.0, false);
    let [six, seven, eight, nine] = [6, 7, 8, 9].map(plain);
    assert!(apart(&seven, &eight) > 1e-4);
    assert_eq!(apart(&after(8, 2, 0.0, false), &mean(&[seven.clone(), eight.clone()])), 0.0);
    // A rest that is shorter than a window joins the one before.
    assert_eq!(apart(&after(9, 2, 0.0, false), &mean(&[seven.clone(), eight.clone(), nine])), 0.0);
    // A phase shorter than four windows only leads the way: no mean.
    assert_eq!(apart(&after(7, 2, 0.0, false), &seven), 0.0);
    assert!(apart(&mean(&[six, seven]), &eight) > 0.0);
}

#[test]
fn a_whole_phase_goes_on_whatever_j_does() {
    // With such a tolerance the second window ends a phase: after four iterations.
    let [three, four] = [3, 4].map(|iterations| after(iterations, 1000, 0.0, false));
    assert_eq!(apart(&after(16, 2, 1e9, false), &mean(&[three, four])), 0.0);
    assert_eq!(apart(&after(16, 2, 1e9, true), &after(16, 2, 0.0, false)), 0.0);
}

#[test]
fn the_lead_counts_no_terminal_cost_and_the_rest_does() {
    let config = config();
    let problem = problem(&config);
    let (lead, whole) =
        (leading(&problem, &config), problem.objective(&config.objective, config.snr_headroom));
    assert!(whole.cost.settle > 0.0);
    assert_eq!(lead.cost.settle, 0.0);
    assert_eq!(Objective { cost: whole.cost.clone(), ..lead }, whole);
}

#[test]
fn the_feasible_way_is_chosen_and_of_equals_the_cheaper() {
    let o = Objective { collision_tolerance: 0.05, outage_tolerance: 0.1, ..Objective::default() };
    let good = |j: f64| ObjectiveEstimate { j, cost: 0.0, p_safe: 0.96, p_comm: 0.91 };
    let choose = |r: ObjectiveEstimate, l: ObjectiveEstimate, connected| side(&o, [&r, &l], connected);
    let both = [0.91; 2];
    assert_eq!(choose(good(1.0), good(2.0), both), PassingSide::Right);
    assert_eq!(choose(good(2.0), good(1.0), both), PassingSide::Left);
    assert_eq!(choose(good(1.0), good(1.0), both), PassingSide::Right);
    // At a tolerance is not within it.
    for [p_safe, p_comm] in [[0.95, 0.91], [0.96, 0.9]] {
        let bad = |j: f64| ObjectiveEstimate { p_safe, p_comm, ..good(j) };
        assert_eq!(choose(bad(1.0), good(2.0), both), PassingSide::Left);
        assert_eq!(choose(good(2.0), bad(1.0), both), PassingSide::Right);
        // Where neither is feasible, J tells.
        assert_eq!(choose(bad(1.0), bad(2.0), both), PassingSide::Right);
    }
    assert_eq!(choose(good(1.0), good(2.0), [0.9, 0.91]), PassingSide::Left);
    assert_eq!(choose(good(2.0), good(1.0), [0.91, 0.9]), PassingSide::Right);
}

#[test]
fn the_error_of_a_margin_is_that_of_the_paired_differences() {
    // Differences 1, 3, 5: variance 4, of a mean of three 4/3.
    assert!((paired_error(&[2.0, 8.0, 3.0], &[1.0, 5.0, -2.0]) - (4.0_f64 / 3.0).sqrt()).abs() < 1e-12);
    assert_eq!(paired_error(&[2.0, 7.0], &[1.0, 6.0]), 0.0);
}

#[test]
fn a_link_that_needs_too_much_is_never_there_and_one_that_needs_nothing_always() {
    let config = config();
    let problem = problem(&config);
    let motion = Policies::shipped(BuiltIn::Centroid, 2).unwrap().motion;
    let share = |snr_min: f64| {
        let o = Objective { snr_min, ..leading(&problem, &config) };
        always_connected(&problem, &config, &Noise::new(0), &o, &motion)
    };
    assert_eq!(share(1e-9), 1.0);
    assert_eq!(share(1e12), 0.0);
    // Full power is four times low power: so much more may be asked of the weakest link of all.
    let weakest = {
        let noise = Noise::new(0);
        let draws =
            problem.draws(&noise, Stream::Evaluation, 1 << 30, COUNTED, problem.obstacle, config.horizon);
        let options = RolloutOptions { eta: None, power: 1.0, execution: Execution::Nearest };
        let o = Objective { snr_min: 1.0, ..leading(&problem, &config) };
        let told =
            draws.iter().map(|d| rollout::forward(&problem.plant, &o, options, &motion, d).told().ratio);
        f64::from(told.flatten().flatten().fold(f32::INFINITY, f32::min))
    };
    assert_eq!(share(4.0 * weakest * 0.99), 1.0);
    assert!((0.5..1.0).contains(&share(4.0 * weakest * 1.01)));
}

/// Costs of the iterations of a phase that learns nothing.
fn costs(number: u64, side: PassingSide) -> Vec<f64> {
    let config = OptimiseConfig { learning_rate: 0.0, ..config() };
    let problem = problem(&config);
    let mut net = Policies::shipped(BuiltIn::Centroid, 2).unwrap().motion;
    let obstacle = problem.obstacle;
    let phase =
        OptimisePhase { name: String::new(), side, obstacle, eta: Some(1.0), iterations: 4, is_whole: false };
    let mut watch = Costs::default();
    run_phase(&problem, &config, &Noise::new(3), number, &phase, &mut net, &mut watch);
    watch.0
}

#[test]
fn every_iteration_of_every_phase_meets_gusts_of_its_own() {
    let mut all = [costs(1, PassingSide::Right), costs(2, PassingSide::Right)].concat();
    all.sort_by(f64::total_cmp);
    assert!(all.windows(2).all(|pair| pair[0] != pair[1]), "{all:?}");
}

#[test]
fn the_terminal_cost_counts_once_the_way_is_chosen() {
    let [led, chosen] = [PassingSide::Right, PassingSide::Chosen].map(|side| costs(1, side)[0]);
    assert!(chosen > 2.0 * led, "{led} {chosen}");
}

/// The comparison of two policies, and whether the better one was kept.
fn compared(right: Mlp, left: Mlp, rollouts: usize) -> Comparison {
    let config = OptimiseConfig { comparison_rollouts: rollouts, ..config() };
    let problem = problem(&config);
    let mut progress = OptimiseProgress {
        phase: 0,
        free: right.clone(),
        right: Some(right.clone()),
        left: Some(left.clone()),
        chosen: None,
        comparison: None,
    };
    choose(&problem, &config, &Noise::new(0), &mut progress).unwrap();
    let comparison = progress.comparison.unwrap();
    let kept = if comparison.chosen == PassingSide::Right { right } else { left };
    assert_eq!(progress.chosen, Some(kept));
    assert_eq!(comparison.margin, comparison.right.j - comparison.left.j);
    comparison
}

#[test]
fn candidates_are_compared_until_they_are_told_apart() {
    let good = Policies::shipped(BuiltIn::Centroid, 2).unwrap().motion;
    let lazy = Policies::untrained(&mut Noise::new(0).generator(Stream::Weights, 0)).motion;
    let clear = compared(lazy.clone(), good.clone(), 3 * PORTION);
    assert_eq!((clear.rollouts, clear.chosen), (PORTION, PassingSide::Left));
    assert!(clear.margin > CLEAR * clear.margin_se && clear.margin_se > 0.0, "{clear:?}");
    assert_eq!(compared(good.clone(), lazy, 3 * PORTION).chosen, PassingSide::Right);
    // All but the same: the portions go on to the end, and none comes twice.
    let mut other = good.clone();
    for b in other.layers.iter_mut().flat_map(|layer| &mut layer.b) {
        *b += 1e-3;
    }
    let close = [1, 3].map(|portions| compared(good.clone(), other.clone(), portions * PORTION));
    assert_eq!(close.map(|c| c.rollouts), [PORTION, 3 * PORTION]);
    let narrowed = close[1].margin_se / close[0].margin_se;
    assert!((narrowed * 3.0_f64.sqrt() - 1.0).abs() < 0.2, "{narrowed}");
    assert_ne!(close[0].right.cost, close[1].right.cost);
    // A policy beside itself has no margin at all, which is clear at once.
    assert_eq!(compared(good.clone(), good, 2 * PORTION).rollouts, PORTION);
}
