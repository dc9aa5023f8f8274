//! The rollout beside the same equations written down once more, a rollout at a time and in double precision.

use crpl_sitl::Scenario;
use crpl_sitl::scenario::Obstacle;
use crpl_sitl::units::Motion;
use crpl_sitl::world::channel;
use crpl_sitl::world::noise::{Noise, Stream};
use nalgebra::Vector2;
use rand::RngExt;

use super::*;
use crate::encoder::BuiltIn;
use crate::planning::config::OptimiseConfig;
use crate::planning::objective::softmin;
use crate::planning::policy::{MOTION_WIDTHS, features, softmax};
use crate::planning::problem::PlanningProblem;
use crate::predictor::Predictor;
use crate::world_model::WorldModel;

type Place = Vector2<f64>;

/// Two obstacles, the second of which meets a wall; an edge to keep off; a net that decides something.
struct Case {
    plant: Plant,
    objective: Objective,
    motion: Mlp,
    draws: Draws,
    world: WorldModel,
    margins: [f64; 2],
}

const HORIZON: usize = 10;

fn case(limits: RolloutLimits) -> Case {
    let world = WorldModel::built_in(BuiltIn::Centroid).unwrap();
    let mut scenario = Scenario::default();
    scenario.safety.edge_margin = 0.06;
    let second = Obstacle { margin: 0.1, ..scenario.obstacle().clone() };
    scenario.obstacles.push(second);
    let margins = [0, 1].map(|n| scenario.obstacles[n].margin);
    let config = OptimiseConfig { starts: 1, limits, ..OptimiseConfig::default() };
    let problem = PlanningProblem::of(&world, &scenario, &config, 0).unwrap();
    let mut rng = Noise::new(5).generator(Stream::Weights, 9);
    let mut motion = Mlp::zeros(&MOTION_WIDTHS);
    for layer in &mut motion.layers {
        let size = 1.7 / (layer.inputs as f32).sqrt();
        layer.w.iter_mut().for_each(|w| *w = size * rng.random_range(-2.0..2.0f32));
    }
    // From all over the field, at any speed up to v_max and beyond; each obstacle at a place of its own.
    let mut body = |to: &dyn Fn(Place) -> [f32; 2], low: [f64; 2], high: [f64; 2], speed: f64| {
        let mut lanes = [[ZERO; 2]; 2];
        for l in 0..LANES {
            let r = Place::new(rng.random_range(low[0]..high[0]), rng.random_range(low[1]..high[1]));
            let v = Place::new(rng.random_range(-speed..speed), rng.random_range(-speed..speed));
            for (at, y) in [to(r), to(r - v)].into_iter().enumerate() {
                (lanes[at][0][l], lanes[at][1][l]) = (y[0], y[1]);
            }
        }
        lanes
    };
    let y_c = |r: Place| world.latents_at(r, Place::repeat(0.5)).0;
    let y_u = |r: Place| world.latents_at(Place::repeat(0.5), r).1;
    let corner = |x: f64, y: f64| y_u(Place::new(x, y));
    let start = body(&y_c, [0.02, 0.02], [0.98, 0.98], 0.04);
    let obstacles =
        vec![body(&y_u, [0.3, 0.3], [0.6, 0.6], 0.01), body(&y_u, [0.12, 0.12], [0.2, 0.88], 0.03)];
    let mut gust = || -> Lane { std::array::from_fn(|_| rng.random_range(-0.5..0.5f32)) };
    let wind = (0..HORIZON).map(|_| [gust(), gust()]).collect();
    let mut opening = vec![[None; LANES]; 2];
    (opening[0][4], opening[1][8]) = (Some([1.0, 0.0]), Some([0.0, -1.0]));
    let draws = Draws { start, obstacles, reported_obstacle: None, wind, beyond: 3, opening };
    let base = Objective { beta: 40.0, alpha: 2.5, ..Objective::default() };
    let mut objective = problem.objective(&base, 1.0);
    // Each part of the cost is felt.
    (objective.cost.settle_intervals, objective.cost.motion, objective.cost.power) = (8, 0.03, 0.01);
    let mut plant = problem.plant().clone();
    // As the probe has them: what a picture of a corner is off by, a reflection doubles.
    plant.areas = margins
        .iter()
        .map(|m| Area::new(corner(*m, *m), [corner(1.0 - m, *m), corner(*m, 1.0 - m)]))
        .collect();
    Case { plant, objective, motion, draws, world, margins }
}

/// Where an obstacle is that was at `now` and `before`, `k` intervals later: straight on, reflected at its margins.
fn obstacle(now: Place, before: Place, k: usize, margin: f64, reflects: bool) -> Place {
    (now + (now - before) * k as f64).map(|x| {
        if !reflects {
            return x;
        }
        let (width, along) = (1.0 - 2.0 * margin, (x - margin).rem_euclid(2.0 * (1.0 - 2.0 * margin)));
        margin + if along > width { 2.0 * width - along } else { along }
    })
}

/// Cost, s_safe and s_comm of one rollout.
fn by_hand(case: &Case, options: RolloutOptions, l: usize) -> [f64; 3] {
    let Case { plant, objective: o, motion, draws, world, margins } = case;
    let lane = |y: &[Lane; 2]| Place::new(y[0][l].into(), y[1][l].into());
    let single = |y: Place| [y.x as f32, y.y as f32];
    let Predictor::Linear(linear) = &plant.predictor else { panic!("not linear") };
    let (scale, reach) = (f64::from(plant.scale), f64::from(plant.scale * plant.v_max));
    let goal = Place::new(plant.goal[0].into(), plant.goal[1].into());
    let corner = |n: usize, i: usize| f64::from(plant.corners[n][i]);
    let y_u = |n: usize, k: usize| {
        let [now, before] = [0, 1].map(|at| world.probe.u.apply(lane(&draws.obstacles[n][at])));
        let there = obstacle(now, before, k, margins[n], plant.limits == RolloutLimits::Walls);
        world.probe.u.invert(there).unwrap()
    };
    let heads = |y: Place, k: usize| {
        [0, 1].map(|n| {
            let u = y_u(n, k);
            let input = [y.x, y.y, u.x, u.y].map(|v| [v as f32; LANES]);
            (plant.collision.value(&input)[0], plant.gain.value(&input)[0])
        })
    };
    let (mut now, mut before) = (lane(&draws.start[0]), lane(&draws.start[1]));
    let (mut cost, mut comm, mut clear) = (0.0, 0.0, Vec::new());
    for k in 0..HORIZON {
        let reported = draws.reported_obstacle.unwrap_or_else(|| single(y_u(0, k)));
        let x = features(single(now), single(before), reported, plant.scale, plant.v_max);
        let p = softmax(&motion.forward(&x));
        let relaxed: Place = Motion::ALL.iter().zip(p).map(|(m, p)| m.vector() * f64::from(p)).sum();
        let mut a =
            if options.execution == Execution::Relaxed { relaxed } else { Motion::nearest(relaxed).vector() };
        if let Some(Some(first)) = draws.opening.get(k).map(|row| row[l]) {
            a = Place::new(first[0].into(), first[1].into());
        }
        let weakest = heads(now, k).iter().map(|(_, gain)| f64::from(*gain)).fold(f64::INFINITY, f64::min);
        let ratio = weakest.exp() * options.power / o.snr_min;
        comm += (1.0 - channel::sigmoid(o.alpha * (1.0 - ratio))) / HORIZON as f64;

        let mut step = linear.step(now, before, a + lane(&draws.wind[k])) - now;
        if plant.limits != RolloutLimits::Plain && step.norm() > reach {
            step *= reach / step.norm();
        }
        let mut next = now + step;
        if plant.limits == RolloutLimits::Walls {
            next = Place::from_fn(|i, _| next[i].clamp(corner(0, i), corner(1, i)));
        }
        (before, now) = (now, next);

        let left = (HORIZON - k + draws.beyond) as u64;
        let settle = if left <= o.cost.settle_intervals { o.cost.settle } else { 0.0 };
        let off = (now - goal).norm_squared() / (scale * scale);
        cost += (o.cost.goal + settle) * off
            + o.cost.motion * a.norm_squared()
            + o.cost.power * options.power.powi(2);

        let mut missed: f64 =
            heads(now, k + 1).iter().map(|(logit, _)| 1.0 - channel::sigmoid(f64::from(*logit))).product();
        if let Some(edge) = &plant.edge {
            let distance = (0..2)
                .flat_map(|i| [now[i] - corner(0, i), corner(1, i) - now[i]])
                .fold(f64::INFINITY, f64::min);
            missed *= 1.0 - channel::sigmoid((f64::from(edge.margin) - distance) / f64::from(edge.softness));
        }
        clear.push(missed);
    }
    [cost, softmin(&clear, o.beta), comm]
}

#[test]
fn a_rollout_is_its_equations() {
    for limits in [RolloutLimits::Plain, RolloutLimits::Clip, RolloutLimits::Walls] {
        for (execution, power) in [(Execution::Nearest, 4.0), (Execution::Relaxed, 1.0)] {
            let mut case = case(limits);
            if limits == RolloutLimits::Clip {
                case.draws.reported_obstacle = Some([0.3, -0.7]);
            }
            let options = RolloutOptions { eta: None, power, execution };
            let found = forward(&case.plant, &case.objective, options, &case.motion, &case.draws);
            let mut moved = 0;
            for l in (0..LANES).step_by(4) {
                let wanted = by_hand(&case, options, l);
                let got = [found.cost[l], found.safe[l], found.comm[l]].map(f64::from);
                for (name, (got, wanted)) in ["cost", "safe", "comm"].iter().zip(got.into_iter().zip(wanted))
                {
                    let off = (got - wanted).abs();
                    assert!(
                        off < 2e-3 * (1.0 + wanted.abs()),
                        "{limits:?} {execution:?} {l} {name}: {got}, {wanted}"
                    );
                }
                moved += found.a.iter().filter(|a| a[0][l].abs() + a[1][l].abs() > 0.5).count();
            }
            assert!(moved > LANES / 4, "the policy decides nothing");
        }
    }
}

#[test]
fn the_slope_of_the_edge_is_the_difference_of_its_logit() {
    let plant = case(RolloutLimits::Walls).plant;
    let edge = plant.edge.unwrap();
    for y in [[-4.9, 1.0], [4.8, -2.0], [1.0, -4.7], [-2.0, 4.9], [4.0, 3.0]] {
        let (_, axis, slope) = edge_logit(&plant, &edge, y);
        let moved = |by: f32| {
            let mut y = y;
            y[axis] += by;
            edge_logit(&plant, &edge, y).0
        };
        let difference = (moved(0.01) - moved(-0.01)) / 0.02;
        assert!((difference / slope - 1.0).abs() < 1e-2, "{y:?}: {slope}, {difference}");
    }
}

#[test]
fn the_nearest_motion_is_that_of_the_simulator() {
    for x in -25..=25 {
        for y in -25..=25 {
            let (x, y) = (x as f32 / 20.0, y as f32 / 20.0);
            let wanted = Motion::nearest(Place::new(x.into(), y.into())).vector();
            let found = nearest(x, y);
            assert_eq!([found.0, found.1].map(f64::from), [wanted.x, wanted.y], "{x} {y}");
        }
    }
}
