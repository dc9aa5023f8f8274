//! What a scenario becomes for Algorithm 1.

use crpl_sitl::world::channel;

use super::*;
use crate::encoder::BuiltIn;

fn world() -> WorldModel {
    WorldModel::built_in(BuiltIn::Centroid).unwrap()
}

fn problem(scenario: &Scenario, config: &OptimiseConfig) -> PlanningProblem {
    PlanningProblem::of(&world(), scenario, config, 0).unwrap()
}

fn config() -> OptimiseConfig {
    OptimiseConfig { starts: 16, ..OptimiseConfig::default() }
}

#[test]
fn the_objective_takes_the_scenarios_weights_and_the_stricter_tolerances() {
    let mut scenario = Scenario::default();
    scenario.safety.collision_tolerance = 0.03;
    scenario.safety.outage_tolerance = 0.2;
    scenario.cost.settle *= 3.0;
    scenario.channel.snr_min = 8.0;
    let problem = problem(&scenario, &config());
    let base = Objective {
        collision_tolerance: 0.04,
        outage_tolerance: 0.1,
        alpha: 7.0,
        snr_min: 123.0,
        ..Objective::default()
    };
    let o = problem.objective(&base, 1.5);
    assert_eq!([o.collision_tolerance, o.outage_tolerance, o.alpha], [0.03, 0.1, 7.0]);
    assert_eq!(o.snr_min, 1.5 * scope::required_snr(&scenario));
    assert_eq!(o.cost, scenario.cost);
    let strict = Objective { collision_tolerance: 0.01, outage_tolerance: 0.3, ..base };
    let o = problem.objective(&strict, 1.5);
    assert_eq!([o.collision_tolerance, o.outage_tolerance], [0.01, 0.2]);
}

/// Standard deviation of all gusts.
fn deviation(draws: &[Draws]) -> f64 {
    let all: Vec<f64> =
        draws.iter().flat_map(|d| d.wind.iter().flatten().flatten().map(|v| f64::from(*v))).collect();
    (all.iter().map(|v| v * v).sum::<f64>() / all.len() as f64).sqrt()
}

#[test]
fn rollouts_differ_by_index_and_block_and_stream_and_are_equal_for_equals() {
    let (problem, noise) = (problem(&Scenario::default(), &config()), Noise::new(4));
    let at = |stream, index| problem.draws(&noise, stream, index, 2 * LANES, problem.obstacle, 5);
    let wind = |draws: &[Draws]| draws.iter().map(|d| d.wind.clone()).collect::<Vec<_>>();
    let first = wind(&at(Stream::Batches, 0));
    assert_eq!(first.len(), 2);
    assert_ne!(first[0], first[1]);
    assert_eq!(first, wind(&at(Stream::Batches, 0)));
    let others = [wind(&at(Stream::Batches, 1)), wind(&at(Stream::Evaluation, 0))];
    for block in others.iter().flatten() {
        assert!(!first.contains(block));
    }
    let (y_c, y_u) = world().latents_at(Vector2::new(0.3, 0.4), Vector2::new(0.5, 0.6));
    let state = PlanningState { y_c: [y_c, [0.0; 2]], y_u: std::iter::once([y_u, [1.0; 2]]).collect() };
    let from = |index| problem.draws_from(&state, &noise, index, 2 * LANES, 5);
    assert_eq!(from(0).len(), 2);
    assert_ne!(from(0)[0].wind, from(0)[1].wind);
    assert!(!wind(&from(0)).contains(&from(1)[0].wind));
    let lanes = |y: [f32; 2]| y.map(|v| [v; LANES]);
    for draws in from(3) {
        assert_eq!(draws.start, [lanes(y_c), [ZERO; 2]]);
        assert_eq!(draws.obstacles, [[lanes(y_u), lanes([1.0; 2])]]);
        assert_eq!(draws.reported_obstacle, Some(problem.obstacle));
    }
}

#[test]
fn gusts_are_as_strong_as_the_config_says_in_units_of_the_acceleration() {
    let mut scenario = Scenario::default();
    scenario.disturbance.sigma_c = 0.002;
    let gusty = scenario.disturbance.gust_std();
    let (noise, a_max) = (Noise::new(1), scenario.dynamics.a_max);
    let strength = |gust_std: f64, gust_factor: f64, gust_least: f64| {
        let config = OptimiseConfig { gust_std, gust_factor, gust_least, ..config() };
        let problem = problem(&scenario, &config);
        let (y_c, y_u) = world().latents_at(scenario.start, scenario.goal);
        let state = PlanningState { y_c: [y_c; 2], y_u: std::iter::once([y_u; 2]).collect() };
        [
            deviation(&problem.draws(&noise, Stream::Batches, 0, 64 * LANES, problem.obstacle, 20)),
            deviation(&problem.draws_from(&state, &noise, 0, 64 * LANES, 20)),
        ]
    };
    let near = |found: f64, wanted: f64| (found / wanted - 1.0).abs() < 0.02;
    for found in [strength(0.0, 2.0, 1.0), strength(2.0 * gusty, 1.0, 1.0)] {
        assert!(found.iter().all(|s| near(*s, 2.0 * gusty / a_max)), "{found:?}");
    }
    // Strengths spread evenly from 0.4 to 1 of it: the mean square is (1 + 0.4 + 0.16)/3.
    let [spread, whole] = strength(0.0, 2.0, 0.4);
    assert!(near(spread, 2.0 * gusty / a_max * (1.56_f64 / 3.0).sqrt()), "{spread}");
    assert!(near(whole, 2.0 * gusty / a_max), "{whole}");
}

#[test]
fn rollouts_begin_round_the_start_with_the_spread_of_the_config() {
    let (scenario, world) = (Scenario::default(), world());
    let config = OptimiseConfig { starts: 2000, start_spread: [0.02, 0.003], ..config() };
    let problem = problem(&scenario, &config);
    let place = |y: [f32; 2]| world.probe.c.apply(Vector2::new(y[0].into(), y[1].into()));
    let pairs: Vec<[Vector2<f64>; 2]> =
        problem.starts.iter().map(|(now, before)| [place(*now), place(*before)]).collect();
    let deviation = |of: &dyn Fn(&[Vector2<f64>; 2]) -> Vector2<f64>| {
        (pairs.iter().map(|pair| of(pair).norm_squared()).sum::<f64>() / (2 * pairs.len()) as f64).sqrt()
    };
    assert!((deviation(&|[now, _]| now - scenario.start) / 0.02 - 1.0).abs() < 0.1);
    assert!((deviation(&|[now, before]| now - before) / 0.003 - 1.0).abs() < 0.1);
}

#[test]
fn a_start_keeps_clear_of_edge_and_obstacle_and_gives_up_after_twenty() {
    let mut scenario = Scenario::default();
    let (soft, margin) = (scenario.safety.softness, 0.05);
    scenario.safety.edge_margin = margin;
    let edge = margin + CLEAR_START * soft;
    let o = scenario.obstacle().clone();
    let touch = o.radius + scenario.uav_radius + scenario.safety.d_min + CLEAR_START * soft;
    let at = |place: Vector2<f64>| {
        let mut first = true;
        start(&scenario, || {
            let offset = if first { place - scenario.start } else { Vector2::zeros() };
            first = false;
            offset
        })
    };
    let taken = |place: Vector2<f64>| (at(place) - place).norm() < 1e-12;
    for (x, y) in [(edge, 0.3), (1.0 - edge, 0.3), (0.3, edge), (0.3, 1.0 - edge)] {
        let inwards =
            Vector2::new(0.5 - x, 0.5 - y).map(|d| if d.abs() > 0.3 { d.signum() * 1e-6 } else { 0.0 });
        assert!(taken(Vector2::new(x, y) + inwards) && !taken(Vector2::new(x, y) - inwards), "{x} {y}");
    }
    for way in [Vector2::x(), -Vector2::x(), Vector2::y()] {
        assert!(
            taken(o.position + way * (touch + 1e-6)) && !taken(o.position + way * (touch - 1e-6)),
            "{way}"
        );
    }
    let mut asked = 0;
    let given_up = start(&scenario, || {
        asked += 1;
        o.position - scenario.start
    });
    assert_eq!((given_up, asked), (scenario.start, 20));
}

#[test]
fn the_edge_is_a_risk_in_latent_units_where_the_scenario_keeps_off_it() {
    let mut scenario = Scenario::default();
    scenario.safety.edge_margin = 0.04;
    let config = OptimiseConfig { edge_softness: 0.005, ..config() };
    assert_eq!(edge(10.0, &scenario, &config), Some(Edge { margin: 0.4, softness: 0.05 }));
    scenario.safety.edge_margin = 0.0;
    assert_eq!(edge(10.0, &scenario, &config), None);
}

#[test]
fn the_learned_heads_have_the_scenarios_noise_power() {
    let (world, mut scenario) = (world(), Scenario::default());
    scenario.channel.noise_power *= 5.0;
    let (_, gain) = learned_heads(&world, &scenario).unwrap();
    let o = scenario.obstacle();
    for uav in [Vector2::new(0.3, 0.3), Vector2::new(0.5, 0.2), Vector2::new(0.8, 0.5)] {
        let (c, u) = world.latents_at(uav, o.position);
        let found = gain.value(&[c[0], c[1], u[0], u[1]].map(|v| [v; LANES]))[0];
        let true_gain = channel::gain(uav, o.position, o.radius, &scenario.channel);
        let wanted = (true_gain / scenario.channel.noise_power).ln() as f32;
        assert!((found - wanted).abs() < 0.3, "{uav}: {found} instead of {wanted}");
    }
}
