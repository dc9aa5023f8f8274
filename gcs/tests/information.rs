//! What a controller may see is in its signature: garbage in everything else changes no byte of what it
//! commands.

use std::sync::Arc;

use crpl_gcs::station::Station;
use crpl_gcs::station::models::{MismatchRule, Models};
use crpl_gcs::station::pilot::{Controller, Pilot};
use crpl_model::world_model::WorldModel;
use crpl_sitl::radio::message::{Command, Percept, Telemetry};
use crpl_sitl::scenario::Scenario;
use crpl_sitl::world::dynamics::State;
use crpl_sitl::{Sim, units::Tick};
use nalgebra::Vector2;

/// Intervals of a flight: past the obstacle, with outages.
const TICKS: u64 = 60;

fn scenario() -> Scenario {
    let mut scenario = Scenario::default();
    scenario.disturbance.sigma_c = 0.005;
    scenario.radio.b_dt = 2.4;
    scenario
}

/// A scenario of which only the part is true that a CRPL station reads in flight.
fn garbage() -> Scenario {
    let mut garbage = scenario();
    garbage.start = Vector2::new(0.77, 0.01);
    garbage.goal = Vector2::new(0.02, 0.93);
    garbage.goal_radius = 0.31;
    garbage.uav_radius = 0.013;
    garbage.horizon = 7;
    garbage.obstacles[0].position = Vector2::new(0.9, 0.9);
    garbage.obstacles[0].radius = 0.03;
    garbage.channel.base_station = Vector2::new(0.01, 0.99);
    garbage.channel.reference_gain = 17.0;
    garbage.channel.path_loss_exponent = 3.3;
    garbage.channel.blockage_softness = 0.4;
    garbage.channel.noise_power = 5.0;
    garbage.channel.snr_min = 9.0;
    garbage.radio.b_dt = 1.1;
    garbage.radio.packet_bits = 55.0;
    garbage.safety.softness = 0.5;
    garbage.safety.d_min = 0.2;
    garbage.propulsion.air_density = 0.1;
    garbage.dynamics.walls = false;
    garbage
}

/// The percept with everything replaced that a controller on frames has no right to.
fn blinded(percept: &Percept) -> Percept {
    let mut blinded = percept.clone();
    let noise = percept.telemetry.tick.0 as f32;
    blinded.telemetry.position = [noise * 13.7, f32::NAN];
    blinded.telemetry.velocity = [f32::INFINITY, -noise];
    blinded.telemetry.obstacles = [[f32::NAN, 1e30]].into();
    blinded
}

/// The bytes of a command.
fn bytes(command: &Command) -> ([u8; 8], u8, Tick) {
    let [north, east] = command.accel.map(f32::to_le_bytes);
    let mut accel = [0; 8];
    accel[..4].copy_from_slice(&north);
    accel[4..].copy_from_slice(&east);
    (accel, command.power.into(), command.tick)
}

/// The scenario of whole flights.
fn demo() -> Scenario {
    Scenario::named("demo").expect("a preset")
}

/// A pilot for a scenario, and what its station reads latents with.
fn pilot(controller: Controller, scenario: &Scenario) -> (Pilot, Arc<WorldModel>) {
    // Which policies fly does not matter here.
    let models = Models::load(None, None).expect("the shipped models read");
    let models = Models { mismatch: MismatchRule::Allow, ..models };
    let (pilot, _) = Pilot::load(controller, &models, scenario).expect("the shipped policies fit");
    (pilot, models.world)
}

/// A whole flight.
#[derive(PartialEq)]
struct Flown {
    /// Of every command.
    bytes: Vec<([u8; 8], u8, Tick)>,
    /// Where the UAV truly was.
    states: Vec<State>,
    reached: bool,
}

impl Flown {
    /// The interval in which another flight parts from this one.
    fn parts_from(&self, other: &Self) -> Option<usize> {
        let same =
            |k: &usize| self.bytes.get(*k) == other.bytes.get(*k) && self.states[*k] == other.states[*k];
        (0..self.states.len().min(other.states.len())).find(|k| !same(k))
    }
}

/// Flies `seed` of [`demo`] to its end by a station that is told `told` and hears through `blind`.
fn fly(
    (pilot, world): &(Pilot, Arc<WorldModel>),
    seed: u64,
    told: &Scenario,
    blind: impl Fn(&Percept) -> Percept,
) -> Flown {
    let demo = demo();
    let mut station = Station::new(told.clone(), world.clone(), pilot.clone());
    let mut sim = Sim::new(demo.clone(), seed);
    let mut flown = Flown { bytes: Vec::new(), states: vec![sim.world().uav], reached: false };
    while sim.tick().0 < demo.horizon && !sim.is_fallen() {
        let command = station.handle(&blind(&sim.percept()));
        flown.bytes.push(bytes(&command));
        sim.handle(command);
        sim.advance();
        flown.states.push(sim.world().uav);
    }
    flown.reached = (sim.world().uav.r - demo.goal).norm() <= demo.goal_radius;
    flown
}

/// Both stations hear the same flight, of which `other` hears through `blind`; their commands are equal.
fn same_commands(
    controller: Controller,
    other: Scenario,
    blind: impl Fn(&Percept) -> Percept,
) -> Result<(), u64> {
    let (pilot, world) = pilot(controller, &scenario());
    let mut sighted = Station::new(scenario(), world.clone(), pilot.clone());
    let mut blinded = Station::new(other, world, pilot);
    let mut sim = Sim::new(scenario(), 3);
    for tick in 0..TICKS {
        let percept = sim.percept();
        let command = sighted.handle(&percept);
        if bytes(&command) != bytes(&blinded.handle(&blind(&percept))) {
            return Err(tick);
        }
        sim.handle(command);
        sim.advance();
    }
    Ok(())
}

#[test]
fn crpl_on_frames_reads_no_telemetry_but_what_was_heard_and_no_scenario() {
    for controller in [Controller::Crpl, Controller::CrplBw, Controller::CrplRh] {
        assert_eq!(same_commands(controller, garbage(), blinded), Ok(()), "{controller}");
    }
}

/// One value of the telemetry that CRPL does not get, replaced.
type Blindfold = (&'static str, fn(&mut Telemetry, f32));

/// Each value that CRPL does not get, replaced by garbage: alone, and all at once.
const BLINDFOLDS: [Blindfold; 7] = [
    ("north", |t, x| t.position[0] = x),
    ("east", |t, x| t.position[1] = x),
    ("velocity north", |t, x| t.velocity[0] = x),
    ("velocity east", |t, x| t.velocity[1] = x),
    ("obstacle north", |t, x| t.obstacles = [[x, t.obstacles[0][1]]].into()),
    ("obstacle east", |t, x| t.obstacles = [[t.obstacles[0][0], x]].into()),
    ("all", |t, x| {
        (t.position, t.velocity, t.obstacles) = ([x, -x], [0.1 * x, x], [[-x, 0.3 * x]].into());
    }),
];

/// Garbage of a plausible size, another in each interval.
fn worn(percept: &Percept, (_, blindfold): Blindfold) -> Percept {
    let mut percept = percept.clone();
    let k = percept.telemetry.tick.0;
    let garbage = ((k * 7919 + 13) % 1009) as f32 - 500.0;
    blindfold(&mut percept.telemetry, garbage);
    percept
}

fn crpl_flies_blindfold(controller: Controller, blindfolds: &[Blindfold]) {
    let pilot = pilot(controller, &demo());
    let sighted = fly(&pilot, 3, &demo(), Percept::clone);
    assert!(sighted.bytes.len() as u64 == demo().horizon, "{controller}");
    for blindfold in blindfolds {
        let blind = fly(&pilot, 3, &demo(), |percept| worn(percept, *blindfold));
        assert_eq!(blind.parts_from(&sighted), None, "{controller}, {}", blindfold.0);
        assert!(blind == sighted, "{controller}, {}: one is longer", blindfold.0);
    }
}

#[test]
fn whole_flights_of_crpl_are_the_same_without_each_value_that_it_does_not_get() {
    crpl_flies_blindfold(Controller::Crpl, &BLINDFOLDS);
    crpl_flies_blindfold(Controller::CrplBw, &BLINDFOLDS);
    // Re-optimised at every interval, so all at once.
    crpl_flies_blindfold(Controller::CrplRh, &BLINDFOLDS[6..]);
}

#[test]
fn whole_flights_of_crpl_are_the_same_in_a_scenario_of_garbage() {
    let blind = |percept: &Percept| worn(percept, BLINDFOLDS[6]);
    for controller in [Controller::Crpl, Controller::CrplBw] {
        let pilot = pilot(controller, &demo());
        let sighted = fly(&pilot, 4, &demo(), Percept::clone);
        assert_eq!(fly(&pilot, 4, &garbage(), blind).parts_from(&sighted), None, "{controller}");
    }
}

#[test]
fn rcc_collapses_under_the_blindfold_and_crpl_does_not() {
    let reached = |controller: Controller, blind: fn(&Percept) -> Percept| {
        let pilot = pilot(controller, &demo());
        (0..10).filter(|seed| fly(&pilot, *seed, &demo(), blind).reached).count()
    };
    let blindfold = |percept: &Percept| worn(percept, BLINDFOLDS[6]);
    let [crpl, rcc] = [Controller::Crpl, Controller::Rcc]
        .map(|controller| [reached(controller, Percept::clone), reached(controller, blindfold)]);
    println!("of 10 flights reach the goal, sighted and blindfold: crpl {crpl:?}, rcc {rcc:?}");
    assert_eq!(crpl[0], crpl[1]);
    assert!(rcc[0] > 5 && rcc[1] == 0, "{rcc:?} of 10");
}

/// The test can fail: what was heard and the frame matter, and the others do read positions.
#[test]
fn what_a_controller_does_see_matters() {
    let deaf = |percept: &Percept| {
        let mut deaf = percept.clone();
        deaf.telemetry.tick = Tick(percept.telemetry.tick.0 + 1);
        deaf
    };
    assert!(same_commands(Controller::Crpl, scenario(), deaf).is_err());
    let black =
        |percept: &Percept| Percept { frame: crpl_sitl::camera::Frame::black().into(), ..percept.clone() };
    assert!(same_commands(Controller::Crpl, scenario(), black).is_err());
    for controller in [Controller::Rcc, Controller::Ucc, Controller::Apc, Controller::CrplExactLatents] {
        assert!(same_commands(controller, scenario(), blinded).is_err(), "{controller}");
    }
}
