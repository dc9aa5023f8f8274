//! The chance constraints as closed-loop flights measure them, before a policy ships.

use std::sync::Arc;

use crpl_gcs::lab::Contender;
use crpl_gcs::lab::check::ConstraintCheck;
use crpl_model::planning::policy::Policies;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;

fn measure(policies: &Policies, scenario: &Scenario, flights: usize, first_seed: u64) -> ConstraintCheck {
    let world = Arc::new(WorldModel::embedded().expect("the shipped model reads"));
    let contender = Contender::with_policies(&world, policies, scenario);
    ConstraintCheck::measure(&contender, 0.95, flights, first_seed, None).expect("flights fly")
}

#[test]
fn the_shipped_policies_keep_the_chance_constraints_in_flight() {
    for number in [1, 2] {
        let mut scenario = Scenario::numbered(number).expect("the paper's scenario");
        scenario.disturbance.sigma_c = 0.005;
        let policies = Policies::shipped(number).expect("the shipped policies read");
        let kept = measure(&policies, &scenario, 300, 3_100_000);
        assert!(kept.safe.holds() && kept.comm.holds(), "scenario {number}: {kept:?}");
    }
}

#[test]
fn a_policy_that_saves_power_in_the_shadow_is_caught_by_its_flights() {
    let scenario = Scenario::numbered(1).expect("the paper's scenario");
    let mut policies = Policies::shipped(1).expect("the shipped policies read");
    if let Some(last) = policies.power.layers.last_mut() {
        last.b = vec![100.0, -100.0];
    }
    let flown = measure(&policies, &scenario, 4, 0);
    assert!(flown.safe.share == 1.0 && flown.comm.share == 0.0, "{flown:?}");
    assert!(!flown.comm.holds());
}
