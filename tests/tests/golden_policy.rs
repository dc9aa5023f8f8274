//! Policies that were trained elsewhere, on the true state: our networks give their probabilities, and
//! our rules of execution fly their flights.
//!
//! The reference computed in f64, our networks in f32, so probabilities agree to 1e-5. A flight is made
//! of chosen actions alone and agrees to rounding.

use crpl_model::numeric::mlp::{Dense, Mlp};
use crpl_model::planning::policy::{Policies, features, softmax};
use crpl_sitl::Scenario;
use crpl_sitl::world::World;
use nalgebra::Vector2;
use serde::Deserialize;
use tests::golden::{assert_vector_close, read, vector};

#[derive(Deserialize)]
struct File {
    r_u: [f64; 2],
    pi_s: Vec<Layer>,
    pi_p: Vec<Layer>,
    cases: Vec<Case>,
    trajectory: Vec<[f64; 2]>,
    a_p: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(non_snake_case, reason = "the names of the reference files")]
struct Layer {
    W: Vec<Vec<f32>>,
    b: Vec<f32>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    x: [f32; 6],
    pi_s: Vec<f64>,
    pi_p: Vec<f64>,
}

fn network(layers: &[Layer]) -> Mlp {
    let dense = |layer: &Layer| Dense {
        inputs: layer.W.len(),
        outputs: layer.b.len(),
        w: layer.W.concat(),
        b: layer.b.clone(),
    };
    Mlp { layers: layers.iter().map(dense).collect() }
}

fn assert_probabilities(got: &[f32], want: &[f64], what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    for (got, want) in got.iter().zip(want) {
        assert!((f64::from(*got) - want).abs() < 1e-5, "{what}: got {got}, golden {want}");
    }
}

fn check(name: &str) {
    let file: File = read(name).expect("the golden file");
    let policies = Policies {
        motion: network(&file.pi_s),
        power: network(&file.pi_p),
        world: String::new(),
        scope: None,
    };
    assert_eq!(file.cases.len(), 20);
    for (i, case) in file.cases.iter().enumerate() {
        let probabilities = |net: &Mlp| softmax(&net.forward(&case.x));
        assert_probabilities(
            &probabilities(&policies.motion),
            &case.pi_s,
            &format!("{name}, case {i}, motion"),
        );
        assert_probabilities(
            &probabilities(&policies.power),
            &case.pi_p,
            &format!("{name}, case {i}, power"),
        );
    }

    // The true state in place of the latent one: a latent scale of 1 and the square's middle as origin.
    let mut scenario = Scenario::default();
    scenario.obstacles[0].position = vector(file.r_u);
    let centred = |r: Vector2<f64>, scale: f64| [(scale * (r.x - 0.5)) as f32, (scale * (r.y - 0.5)) as f32];
    let mut world = World::new(&scenario);
    let mut before = world.uav.r;
    for (k, level) in file.a_p.iter().enumerate() {
        let r = world.uav.r;
        assert_vector_close(r, file.trajectory[k], 1e-9, &format!("{name}, step {k}"));
        let obstacle = centred(world.obstacles()[0], 4.0);
        let x =
            features(centred(r, 1.0), centred(before, 1.0), obstacle, 1.0, scenario.dynamics.v_max as f32);
        let (motion, power) = policies.act(&x);
        assert_eq!(power.level(), *level, "{name}, step {k}");
        before = r;
        world.step(motion.vector(), Vector2::zeros(), &scenario);
    }
    assert_eq!(file.a_p.len(), 100);
    assert_vector_close(world.uav.r, file.trajectory[100], 1e-9, &format!("{name}, the end"));
}

#[test]
fn scenario_1() {
    check("policy_s1");
}

#[test]
fn scenario_2() {
    check("policy_s2");
}
