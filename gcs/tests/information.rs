//! What a controller may see is in its signature: garbage in everything else changes no byte of what it
//! commands.

use crpl_gcs::station::Station;
use crpl_gcs::station::models::{MismatchRule, Models};
use crpl_gcs::station::pilot::{Controller, Pilot};
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::scenario::Scenario;
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

/// Both stations hear the same flight, of which `other` hears through `blind`; their commands are equal.
fn same_commands(
    controller: Controller,
    other: Scenario,
    blind: impl Fn(&Percept) -> Percept,
) -> Result<(), u64> {
    // Which policies fly does not matter here.
    let models = Models::load(None, None).expect("the shipped models read");
    let models = Models { mismatch: MismatchRule::Allow, ..models };
    let (pilot, _) = Pilot::load(controller, &models, &scenario()).expect("the shipped policies fit");
    let mut sighted = Station::new(scenario(), models.world.clone(), pilot.clone());
    let mut blinded = Station::new(other, models.world, pilot);
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

/// The test can fail: what was heard and the frame matter, and the others do read positions.
#[test]
fn what_a_controller_does_see_matters() {
    let deaf = |percept: &Percept| {
        let mut deaf = percept.clone();
        deaf.telemetry.tick = Tick(percept.telemetry.tick.0 + 1);
        deaf
    };
    assert!(same_commands(Controller::Crpl, scenario(), deaf).is_err());
    let black = |percept: &Percept| Percept {
        frame: crpl_sitl::camera::Frame::black().into(),
        telemetry: percept.telemetry,
    };
    assert!(same_commands(Controller::Crpl, scenario(), black).is_err());
    for controller in [Controller::Rcc, Controller::Ucc, Controller::Apc, Controller::CrplExactLatents] {
        assert!(same_commands(controller, scenario(), blinded).is_err(), "{controller}");
    }
}
