//! The hand-written reverse mode of J_η against finite differences and, with the feature `train`, against burn's.

mod oracle;

use crpl_model::numeric::kernel::LANES;
use crpl_model::planning::objective;
use crpl_model::planning::plant::{
    Edge, Execution, Objective, ObjectiveEstimate, RolloutLimits, RolloutOptions,
};
use crpl_model::planning::policy::Policies;
use crpl_sitl::scenario::Cost;
use oracle::{draws, net, plant};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// δ1 and δ2, β soft enough for differences.
fn objective(collision_tolerance: f64, outage_tolerance: f64) -> Objective {
    Objective { collision_tolerance, outage_tolerance, beta: 20.0, ..Objective::default() }
}

/// Slope of J along a random direction: by hand, by differences; and the J there.
fn slope_by_differences(
    objective: &Objective,
    limits: RolloutLimits,
    seed: u64,
    obstacles: usize,
) -> (f64, f64, ObjectiveEstimate) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut plant = plant(limits, &mut rng);
    if seed % 2 == 1 {
        // Near enough to be felt; one side alone, for between two the nearest has a kink.
        plant.edge = Some(Edge { margin: 0.8, softness: 0.7 });
        plant.corners[0] = [-9.0, -30.0];
        plant.corners[1][1] = 30.0;
    }
    let mut draws = draws(2, 20, &mut rng);
    // Beside the first, and on their way elsewhere.
    for n in 1..obstacles as u8 {
        draws.iter_mut().for_each(|d| {
            let moved = |by: f32| d.obstacles[0][0].map(|y| y.map(|v| 0.8 * v + by));
            d.obstacles.push([moved(f32::from(n)), moved(0.9 * f32::from(n))]);
        });
    }
    // A terminal cost that begins within the rollout, and a flight that goes on after it.
    draws.iter_mut().for_each(|d| d.beyond = 3 * usize::from(seed.is_multiple_of(2)));
    let cost = Cost { settle: 0.1 * (seed % 3) as f64, settle_intervals: 7, ..objective.cost.clone() };
    let objective = &Objective { cost, ..objective.clone() };
    let options = RolloutOptions { eta: Some(1.0), power: 4.0, execution: Execution::Relaxed };
    let mut motion = Policies::untrained(&mut rng).motion;
    motion.layers[2].w.iter_mut().for_each(|w| *w *= 100.0);
    let direction = net(&[6, 64, 64, 5], 1.0, &mut rng);
    let (here, grad) = objective::gradient(&plant, objective, options, &motion, &draws);
    let dot: f64 = grad
        .layers
        .iter()
        .zip(&direction.layers)
        .flat_map(|(g, d)| g.w.iter().chain(&g.b).zip(d.w.iter().chain(&d.b)))
        .map(|(g, d)| f64::from(*g) * f64::from(*d))
        .sum();
    let h = 1e-3f32;
    let at = |sign: f32| {
        let mut moved = motion.clone();
        for (layer, d) in moved.layers.iter_mut().zip(&direction.layers) {
            layer.w.iter_mut().zip(&d.w).for_each(|(w, d)| *w += sign * h * d);
            layer.b.iter_mut().zip(&d.b).for_each(|(b, d)| *b += sign * h * d);
        }
        objective::evaluate(&plant, objective, options, &moved, &draws).0.j
    };
    (dot, (at(1.0) - at(-1.0)) / (2.0 * f64::from(h)), here)
}

fn assert_near(exact: f64, differences: f64, at: &str) {
    let error = (exact - differences).abs() / differences.abs().max(1e-3);
    assert!(error < 0.02, "{at}: {exact} by hand, {differences} by differences");
}

#[test]
fn gradient_agrees_with_finite_differences() {
    for limits in [RolloutLimits::Plain, RolloutLimits::Clip, RolloutLimits::Walls] {
        for (seed, obstacles) in (0..4).flat_map(|seed| [(seed, 1), (seed, 2), (seed, 3)]) {
            // A barrier that is felt: tolerances wide enough that both logarithms are proper.
            let (exact, differences, _) = slope_by_differences(&objective(0.9, 0.9), limits, seed, obstacles);
            assert_near(exact, differences, &format!("{limits:?}, seed {seed}, {obstacles} obstacles"));
        }
    }
}

/// Where the link is lost half of the time and hardly anything else costs, the slope is the gain's: that of the obstacle
/// that blocks more.
#[test]
fn a_link_that_comes_and_goes_has_its_slope() {
    for (seed, obstacles) in (0..4).flat_map(|seed| [(seed, 1), (seed, 2), (seed, 3)]) {
        let slope = |snr_min: f64| {
            let cost = Cost { goal: 1e-4, ..Cost::default() };
            let objective = Objective { snr_min, cost, ..objective(0.9, 0.9) };
            slope_by_differences(&objective, RolloutLimits::Clip, 3 * seed, obstacles)
        };
        // P_comm falls with the SNR that a packet needs.
        let (mut low, mut high) = (-20.0f64, 20.0f64);
        for _ in 0..5 {
            let middle = 0.5 * (low + high);
            *if slope(middle.exp2()).2.p_comm > 0.4 { &mut low } else { &mut high } = middle;
        }
        let (exact, differences, here) = slope(low.exp2());
        assert!((0.15..0.95).contains(&here.p_comm), "{here:?}");
        assert_near(exact, differences, &format!("seed {seed}, {obstacles} obstacles, {here:?}"));
    }
}

#[test]
fn each_constraint_has_its_own_tolerance_in_the_gradient() {
    for (seed, d1, d2) in (0..4).flat_map(|seed| [(seed, 0.95, 0.6), (seed, 0.6, 0.95)]) {
        let (exact, differences, here) =
            slope_by_differences(&objective(d1, d2), RolloutLimits::Clip, seed, 1);
        assert_near(exact, differences, &format!("tolerances {d1}, {d2}, seed {seed}, {here:?}"));
    }
}

#[test]
fn an_infeasible_start_has_the_slope_of_the_tangent() {
    for (seed, d1) in (0..4).flat_map(|seed| [(seed, 1e-3), (seed, 1e-2)]) {
        let (exact, differences, here) =
            slope_by_differences(&objective(d1, 0.9), RolloutLimits::Clip, seed, 1);
        let at = format!("tolerance {d1}, seed {seed}, {here:?}");
        assert!(here.p_safe < 1.0 - d1, "feasible: {at}");
        assert_near(exact, differences, &at);
    }
}

#[test]
fn a_second_obstacle_on_the_first_ones_place_adds_risk_and_no_shadow() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let plant = plant(RolloutLimits::Walls, &mut rng);
    let mut draws = draws(1, 12, &mut rng);
    let motion = Policies::untrained(&mut rng).motion;
    let options = RolloutOptions { eta: Some(1.0), power: 4.0, execution: Execution::Nearest };
    let (_, one) = objective::evaluate(&plant, &Objective::default(), options, &motion, &draws);
    let first = draws[0].obstacles[0];
    draws[0].obstacles.push(first);
    let (_, two) = objective::evaluate(&plant, &Objective::default(), options, &motion, &draws);
    assert_eq!((&one.cost, &one.comm), (&two.cost, &two.comm));
    assert!(one.safe.iter().zip(&two.safe).all(|(one, two)| two < one));
}

#[test]
fn an_opening_flies_its_own_motions_and_then_the_policys() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let plant = plant(RolloutLimits::Plain, &mut rng);
    let mut draws = draws(1, 12, &mut rng);
    let motion = Policies::untrained(&mut rng).motion;
    let options = RolloutOptions { eta: None, power: 4.0, execution: Execution::Nearest };
    let (_, own) = objective::evaluate(&plant, &Objective::default(), options, &motion, &draws);
    // Lane 1 is pushed to the goal, which lies ahead on the first axis; lane 2 away from it.
    let mut row = [None; LANES];
    (row[1], row[2]) = (Some([1.0, 0.0]), Some([-1.0, 0.0]));
    draws[0].opening = vec![row; 4];
    let (_, opened) = objective::evaluate(&plant, &Objective::default(), options, &motion, &draws);
    assert!(opened.cost[1] < own.cost[1] && opened.cost[2] > own.cost[2]);
    assert_eq!((opened.cost[0], &opened.cost[3..]), (own.cost[0], &own.cost[3..]));
}

#[test]
fn number_of_threads_changes_no_bit() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let plant = plant(RolloutLimits::Walls, &mut rng);
    let draws = draws(4, 12, &mut rng);
    let motion = Policies::untrained(&mut rng).motion;
    let options = RolloutOptions { eta: Some(2.0), power: 4.0, execution: Execution::Nearest };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| objective::gradient(&plant, &Objective::default(), options, &motion, &draws).1)
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn rollouts_are_scored_one_by_one_as_in_a_batch() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let plant = plant(RolloutLimits::Plain, &mut rng);
    let draws = draws(3, 15, &mut rng);
    let motion = Policies::untrained(&mut rng).motion;
    let options = RolloutOptions { eta: Some(1.0), power: 4.0, execution: Execution::Nearest };
    let (_, all) = objective::evaluate(&plant, &Objective::default(), options, &motion, &draws);
    let (_, one) = objective::evaluate(&plant, &Objective::default(), options, &motion, &draws[1..2]);
    assert_eq!(all.cost[LANES..2 * LANES], one.cost[..]);
    assert!(all.safe.iter().all(|s| *s <= 1.0) && all.comm.iter().all(|s| (0.0..=1.0).contains(s)));
}

#[cfg(feature = "train")]
#[test]
fn gradient_agrees_with_autodiff() {
    use crpl_model::planning::head::Head;

    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut collision = net(&[4, 64, 64, 1], 3.0, &mut rng);
    collision.layers[2].b[0] = -3.0;
    let gain = net(&[4, 64, 64, 1], 1.0, &mut rng);
    let mut plant = plant(RolloutLimits::Plain, &mut rng);
    plant.collision = Head::new(collision.clone(), None).expect("a head's widths");
    plant.gain = Head::new(gain.clone(), None).expect("a head's widths");
    let draws = draws(2, 12, &mut rng);
    let objective = objective(0.95, 0.8);
    let mut motion = Policies::untrained(&mut rng).motion;
    motion.layers[2].w.iter_mut().for_each(|w| *w *= 100.0);
    let options = RolloutOptions { eta: Some(1.0), power: 4.0, execution: Execution::Nearest };
    let (estimate, by_hand) = objective::gradient(&plant, &objective, options, &motion, &draws);
    let (j, oracle) =
        oracle::by_autodiff::gradient(&plant, &collision, &gain, &objective, 1.0, &motion, &draws);
    assert!((estimate.j - j).abs() < 1e-4 * j.abs().max(1.0), "J {} by hand, {j} by autodiff", estimate.j);
    let by_hand: Vec<&Vec<f32>> = by_hand.layers.iter().flat_map(|l| [&l.w, &l.b]).collect();
    for (n, (hand, auto)) in by_hand.iter().zip(&oracle).enumerate() {
        let scale = auto.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let worst = hand.iter().zip(auto).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(scale > 0.0 && worst < 1e-3 * scale, "tensor {n}: off by {worst} of {scale}");
    }
}
