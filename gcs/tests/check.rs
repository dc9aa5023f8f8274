//! The chance constraints as closed-loop flights measure them, before a policy ships.

use std::sync::Arc;

use crpl_gcs::lab::Contender;
use crpl_gcs::lab::check::ConstraintCheck;
use crpl_model::encoder::BuiltIn;
use crpl_model::numeric::mlp::Mlp;
use crpl_model::planning::policy::Policies;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;

fn measure(policies: &Policies, scenario: &Scenario, flights: usize, first_seed: u64) -> ConstraintCheck {
    let world = Arc::new(WorldModel::built_in(BuiltIn::Centroid).expect("the shipped model reads"));
    let contender = Contender::with_policies(&world, policies, scenario);
    ConstraintCheck::measure(&contender, 0.95, flights, first_seed, None).expect("flights fly")
}

#[test]
fn the_shipped_policies_keep_the_chance_constraints_in_flight() {
    for number in [1, 2] {
        let mut scenario = Scenario::numbered(number).expect("the paper's scenario");
        scenario.disturbance.sigma_c = 0.005;
        let policies = Policies::shipped(BuiltIn::Centroid, number).expect("the shipped policies read");
        let kept = measure(&policies, &scenario, 300, 3_100_000);
        assert!(kept.safe.holds() && kept.comm.holds(), "scenario {number}: {kept:?}");
    }
}

#[test]
fn a_policy_that_saves_power_in_the_shadow_is_caught_by_its_flights() {
    let scenario = Scenario::numbered(1).expect("the paper's scenario");
    let mut policies = Policies::shipped(BuiltIn::Centroid, 1).expect("the shipped policies read");
    if let Some(last) = policies.power.layers.last_mut() {
        last.b = vec![100.0, -100.0];
    }
    let flown = measure(&policies, &scenario, 4, 0);
    assert!(flown.safe.share == 1.0 && flown.comm.share == 0.0, "{flown:?}");
    assert!(!flown.comm.holds());
}

#[test]
fn a_policy_that_flies_into_the_obstacle_is_caught_by_its_flights() {
    // Scenario 2 with unequal tolerances and the obstacle on the straight way east.
    let mut scenario = Scenario::numbered(2).expect("the paper's scenario");
    scenario.obstacles[0].position.y = scenario.start.y;
    (scenario.safety.collision_tolerance, scenario.safety.outage_tolerance) = (0.2, 0.1);
    let mut policies = Policies::shipped(BuiltIn::Centroid, 2).expect("the shipped policies read");
    let east = |net: &mut Mlp| {
        if let Some(last) = net.layers.last_mut() {
            last.w.iter_mut().for_each(|w| *w = 0.0);
            last.b = vec![0.0, 100.0, 0.0, 0.0, 0.0];
        }
    };
    east(&mut policies.motion);
    let flown = measure(&policies, &scenario, 4, 0);
    assert_eq!((flown.safe.share, flown.safe.needed), (0.0, 0.8), "{flown:?}");
    assert_eq!(flown.comm.needed, 0.9, "{flown:?}");
    assert!(!flown.safe.holds() && !flown.holds());
    let error = flown.verdict().expect_err("it collides").to_string();
    assert!(error.contains("P_safe measured in 4 flights is 0.0000"), "{error}");
}

#[test]
fn a_policy_that_flies_to_the_edge_is_unsafe_where_the_scenario_has_a_margin() {
    let mut scenario = Scenario::numbered(2).expect("the paper's scenario");
    let mut policies = Policies::shipped(BuiltIn::Centroid, 2).expect("the shipped policies read");
    if let Some(last) = policies.motion.layers.last_mut() {
        // North, away from the obstacle.
        last.w.iter_mut().for_each(|w| *w = 0.0);
        last.b = vec![0.0, 0.0, 0.0, 100.0, 0.0];
    }
    assert_eq!(measure(&policies, &scenario, 4, 0).safe.share, 0.0);
    scenario.safety.edge_margin = 0.0;
    assert_eq!(measure(&policies, &scenario, 4, 0).safe.share, 1.0);
}
