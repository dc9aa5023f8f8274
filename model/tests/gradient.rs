//! The hand-written reverse mode of J_η against finite differences.

use model::crpl::{self, Draws, Execution, Head, Limits, Objective, Plant, Setting};
use model::kernel::LANES;
use model::mlp::Mlp;
use model::policy::Policies;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

fn normal(rng: &mut ChaCha8Rng) -> f32 {
    let z: f64 = StandardNormal.sample(rng);
    z as f32
}

fn net(widths: &[usize], last: f32, rng: &mut ChaCha8Rng) -> Mlp {
    let mut net = Mlp::zeros(widths);
    let layers = net.layers.len();
    for (n, layer) in net.layers.iter_mut().enumerate() {
        let std = (layer.inputs as f32).sqrt().recip() * if n + 1 == layers { last } else { 1.0 };
        layer.w.iter_mut().for_each(|w| *w = std * normal(rng));
        layer.b.iter_mut().for_each(|b| *b = 0.3 * normal(rng));
    }
    net
}

/// A latent world of unit scale with random heads: nothing of it is special.
fn plant(limits: Limits, rng: &mut ChaCha8Rng) -> Plant {
    let mut collision = net(&[4, 64, 64, 1], 3.0, rng);
    collision.layers[2].b[0] = -3.0;
    Plant {
        psi_c: [[[2.0, 0.01], [0.0, 1.98]], [[-1.0, 0.0], [-0.01, -0.99]], [[0.035, 0.001], [-0.001, 0.035]]],
        psi_u: [[[2.0, 0.0], [0.0, 2.0]], [[-1.0, 0.0], [0.0, -1.0]]],
        scale: 10.0,
        v_max: 0.04,
        corners: [[-5.0, -5.0], [-3.0, 5.0]],
        limits,
        goal: [4.0, 0.0],
        collision: Head::new(collision).expect("a head's widths"),
        gain: Head::new(net(&[4, 64, 64, 1], 1.0, rng)).expect("a head's widths"),
    }
}

fn draws(blocks: usize, horizon: usize, rng: &mut ChaCha8Rng) -> Vec<Draws> {
    let lane = |mean: f32, std: f32, rng: &mut ChaCha8Rng| -> [f32; LANES] {
        std::array::from_fn(|_| mean + std * normal(rng))
    };
    (0..blocks)
        .map(|_| {
            let now = [lane(-4.0, 0.3, rng), lane(0.0, 0.3, rng)];
            let before = now.map(|y| y.map(|v| v - 0.1));
            let obstacle = [lane(0.0, 0.1, rng), lane(-0.5, 0.1, rng)];
            let wind = (0..horizon).map(|_| [lane(0.0, 0.8, rng), lane(0.0, 0.8, rng)]).collect();
            Draws { start: [now, before], obstacle: [obstacle, obstacle], wind }
        })
        .collect()
}

fn slope_by_differences(limits: Limits, seed: u64) -> (f64, f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let plant = plant(limits, &mut rng);
    let draws = draws(2, 20, &mut rng);
    // A barrier that is felt: tolerances wide enough that both logarithms are proper.
    let objective =
        Objective { collision_tolerance: 0.9, outage_tolerance: 0.9, beta: 20.0, ..Objective::default() };
    let setting = Setting { eta: Some(1.0), power: 4.0, execution: Execution::Relaxed };
    let mut motion = Policies::untrained(&mut rng).motion;
    motion.layers[2].w.iter_mut().for_each(|w| *w *= 100.0);
    let direction = net(&[6, 64, 64, 5], 1.0, &mut rng);
    let (_, grad) = crpl::gradient(&plant, &objective, setting, &motion, &draws);
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
        crpl::evaluate(&plant, &objective, setting, &moved, &draws).0.j
    };
    (dot, (at(1.0) - at(-1.0)) / (2.0 * f64::from(h)))
}

#[test]
fn gradient_agrees_with_finite_differences() {
    for limits in [Limits::Plain, Limits::Clip, Limits::Walls] {
        for seed in 0..4 {
            let (exact, differences) = slope_by_differences(limits, seed);
            let error = (exact - differences).abs() / differences.abs().max(1e-3);
            assert!(error < 0.02, "{limits:?}, seed {seed}: {exact} by hand, {differences} by differences");
        }
    }
}

#[test]
fn number_of_threads_changes_no_bit() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let plant = plant(Limits::Walls, &mut rng);
    let draws = draws(4, 12, &mut rng);
    let motion = Policies::untrained(&mut rng).motion;
    let setting = Setting { eta: Some(2.0), power: 4.0, execution: Execution::Nearest };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| crpl::gradient(&plant, &Objective::default(), setting, &motion, &draws).1)
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn rollouts_are_scored_one_by_one_as_in_a_batch() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let plant = plant(Limits::Plain, &mut rng);
    let draws = draws(3, 15, &mut rng);
    let motion = Policies::untrained(&mut rng).motion;
    let setting = Setting { eta: Some(1.0), power: 4.0, execution: Execution::Nearest };
    let (_, all) = crpl::evaluate(&plant, &Objective::default(), setting, &motion, &draws);
    let (_, one) = crpl::evaluate(&plant, &Objective::default(), setting, &motion, &draws[1..2]);
    assert_eq!(all.cost[LANES..2 * LANES], one.cost[..]);
    assert!(all.safe.iter().all(|s| *s <= 1.0) && all.comm.iter().all(|s| (0.0..=1.0).contains(s)));
}
#[test]
fn timing_tmp() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let plant = plant(Limits::Walls, &mut rng);
    let draws = draws(2, 100, &mut rng);
    let motion = Policies::untrained(&mut rng).motion;
    let setting = Setting { eta: Some(1.0), power: 4.0, execution: Execution::Nearest };
    for _ in 0..3 {
        let t = std::time::Instant::now();
        for _ in 0..20 {
            let _ = crpl::evaluate(&plant, &Objective::default(), setting, &motion, &draws);
        }
        eprintln!("eval {:?}", t.elapsed() / 20);
        let t = std::time::Instant::now();
        for _ in 0..20 {
            let _ = crpl::gradient(&plant, &Objective::default(), setting, &motion, &draws);
        }
        eprintln!("grad {:?}", t.elapsed() / 20);
    }
}
