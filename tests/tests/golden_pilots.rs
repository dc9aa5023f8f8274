//! The untuned RCC, UCC and APC decide as the reference's do: in the loop with our world and our gate, its flights
//! come out again. Those of RCC and UCC command by command; APC's for 19 intervals (at the 20th of Scenario
//! 1 our beam keeps a node that the reference's does not), and in the large from there on.

use crpl_gcs::station::pilot::apc_paper::ApcPaper;
use crpl_gcs::station::pilot::reactive::{Law, Present, Reactive, Task};
use crpl_sitl::Scenario;
use crpl_sitl::radio::Gate;
use crpl_sitl::radio::message::Command;
use crpl_sitl::scenario::Rule;
use crpl_sitl::units::{Motion, Tick, TxPower};
use crpl_sitl::world::World;
use nalgebra::Vector2;
use tests::golden::{Flight, Flights, assert_vector_close, read, vector};

/// Flies `decide`, compares the first `exact` steps with the reference's and the others to 0.05 units;
/// gives the last position.
fn fly(
    flight: &Flight,
    scenario: &Scenario,
    exact: usize,
    mut decide: impl FnMut(&Present) -> (Motion, TxPower),
) -> Vector2<f64> {
    assert_eq!(scenario.radio.rule, Rule::Drop);
    let mut world = World::new(scenario);
    let mut gate = Gate::default();
    let mut link = None;
    for k in 0..flight.a_commanded.len() {
        let at = format!("{}, step {k}", flight.name());
        let tolerance = if k < exact { 1e-9 } else { 0.05 };
        assert_vector_close(world.uav.r, flight.r[k], tolerance, &at);
        let present = Present { r: world.uav.r, v: world.uav.v, obstacles: world.obstacles(), link };
        let (motion, power) = decide(&present);
        if k < exact {
            assert_eq!(motion.vector(), vector(flight.a_commanded[k]), "{at}: motion");
            assert_eq!(power.level(), flight.a_p[k], "{at}: power");
        }

        let tick = Tick(k as u64);
        let wish = motion.vector();
        gate.submit(Command::new(tick, [wish.x as f32, wish.y as f32], power));
        let snr = world.snr(power, scenario);
        gate.transmit(tick, snr, &scenario.radio);
        let held = gate.held().map_or([0.0; 2], |held| held.accel.map(f64::from));
        world.step(vector(held), Vector2::zeros(), scenario);
        link = Some((snr, power));
    }
    world.uav.r
}

/// A flight that is the reference's to its end.
fn fly_exactly(flight: &Flight, scenario: &Scenario, decide: impl FnMut(&Present) -> (Motion, TxPower)) {
    let last = fly(flight, scenario, flight.a_commanded.len(), decide);
    assert_vector_close(last, flight.r[flight.r.len() - 1], 1e-9, &flight.name());
}

fn flights_of(controller: &str, count: usize, mut check: impl FnMut(&Flight, &Scenario)) {
    let file: Flights = read("closed_loop").expect("the golden file");
    let mut flown = 0;
    for flight in file.traces.iter().filter(|flight| flight.controller == controller) {
        check(flight, &flight.scenario(&file.params));
        flown += 1;
    }
    assert_eq!(flown, count);
}

#[test]
fn rcc_flies_the_reference_flights() {
    flights_of("RCC", 6, |flight, scenario| {
        let mut rcc = Reactive::new(Law::RCC_PAPER, Task::of(scenario));
        fly_exactly(flight, scenario, |present| rcc.decide(present));
    });
}

#[test]
fn ucc_flies_the_reference_flights() {
    flights_of("UCC", 6, |flight, scenario| {
        let mut ucc = Reactive::new(Law::UCC_PAPER, Task::of(scenario));
        fly_exactly(flight, scenario, |present| ucc.decide(present));
    });
}

#[test]
fn apc_flies_the_reference_flights() {
    flights_of("APC", 2, |flight, scenario| {
        let apc = ApcPaper::new(scenario);
        let last = fly(flight, scenario, 19, |present| apc.decide(present));
        let d_f = (last - scenario.goal).norm();
        assert!((d_f - flight.metrics.d_f).abs() < 0.02, "{}: d_f {d_f}", flight.name());
    });
}
