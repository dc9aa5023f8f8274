//! RCC and UCC decide as the reference's do: in the loop with our world and our gate, every command and
//! every position of its flights comes out again.

use gcs::pilot::rcc::Rcc;
use gcs::pilot::reactive::Present;
use gcs::pilot::ucc::Ucc;
use nalgebra::Vector2;
use sitl::Scenario;
use sitl::msg::{Command, Motion, TxPower};
use sitl::radio::Gate;
use sitl::scenario::Rule;
use sitl::units::Tick;
use sitl::world::{World, channel};
use tests::golden::{Flight, Flights, assert_vector_close, read, vector};

/// Flies `decide` and compares every step with the reference's.
fn fly(flight: &Flight, scenario: &Scenario, mut decide: impl FnMut(&Present) -> (Motion, TxPower)) {
    let mut world = World::new(scenario);
    let mut gate = Gate::new(Rule::Drop);
    let mut link = None;
    for k in 0..flight.a_commanded.len() {
        let at = format!("{}, step {k}", flight.name());
        assert_vector_close(world.uav.r, flight.r[k], 1e-9, &at);
        let present = Present { r: world.uav.r, v: world.uav.v, obstacle: world.obstacle.r, link };
        let (motion, power) = decide(&present);
        assert_eq!(motion.vector(), vector(flight.a_commanded[k]), "{at}: motion");
        assert_eq!(power.level(), flight.a_p[k], "{at}: power");

        let tick = Tick(k as u64);
        let wish = motion.vector();
        gate.submit(Command { tick, accel: [wish.x as f32, wish.y as f32], power });
        let snr = world.snr(power, scenario);
        gate.transmit(tick, channel::outage(scenario.radio.b_dt, snr, scenario.radio.packet_bits));
        let held = gate.held().map_or([0.0; 2], |held| held.accel.map(f64::from));
        world.step(vector(held), Vector2::zeros(), scenario);
        link = Some((snr, power));
    }
    assert_vector_close(world.uav.r, flight.r[flight.r.len() - 1], 1e-9, &flight.name());
}

fn flights_of(controller: &str, mut check: impl FnMut(&Flight, &Scenario)) {
    let file: Flights = read("closed_loop").expect("the golden file");
    let mut flown = 0;
    for flight in file.traces.iter().filter(|flight| flight.controller == controller) {
        check(flight, &flight.scenario(&file.params));
        flown += 1;
    }
    assert_eq!(flown, 6, "both scenarios at three bandwidths");
}

#[test]
fn rcc_flies_the_reference_flights() {
    flights_of("RCC", |flight, scenario| {
        let mut rcc = Rcc::default();
        fly(flight, scenario, |present| rcc.decide(present, scenario));
    });
}

#[test]
fn ucc_flies_the_reference_flights() {
    flights_of("UCC", |flight, scenario| {
        let mut ucc = Ucc::default();
        fly(flight, scenario, |present| ucc.decide(present, scenario));
    });
}
