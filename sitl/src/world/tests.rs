//! Each formula of Sec. IV-A at numbers that were worked out by hand.

use nalgebra::Vector2;

use super::channel::{self, outage, outage_snr};
use super::contact::Contact;
use super::dynamics::{self, State};
use super::obstacles::Obstacles;
use super::{World, energy, safety};
use crate::camera;
use crate::scenario::{Channel, Dynamics, Propulsion, Scenario};
use crate::units::{Snr, TxPower};

fn v(x: f64, y: f64) -> Vector2<f64> {
    Vector2::new(x, y)
}

fn near(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-9, "{a}, {b}");
}

fn channel_of_its_own() -> Channel {
    Channel {
        base_station: v(1.0, 1.0),
        reference_gain: 3.0,
        nlos_attenuation: 0.2,
        noise_power: 6.0,
        blockage_softness: 0.1,
        distance_floor: 0.1,
        ..Channel::default()
    }
}

#[test]
fn path_loss_is_a_power_of_the_distance_above_a_floor() {
    let c = channel_of_its_own();
    near(channel::los_gain(v(1.0, 1.5), &c), 12.0);
    near(channel::los_gain(v(1.3, 1.4), &Channel { path_loss_exponent: 3.0, ..c.clone() }), 24.0);
    near(channel::los_gain(v(1.0, 1.01), &c), 300.0);
}

#[test]
fn the_sight_line_ends_at_both_stations() {
    let d = |obstacle| channel::distance_to_sight_line(v(3.0, 1.0), obstacle, v(1.0, 1.0));
    near(d(v(2.5, 1.7)), 0.7);
    near(d(v(3.3, 1.4)), 0.5);
    near(d(v(0.7, 0.6)), 0.5);
    near(channel::distance_to_sight_line(v(1.0, 1.0), v(1.3, 1.4), v(1.0, 1.0)), 0.5);
}

#[test]
fn blockage_is_a_half_at_the_shadows_rim_and_smooth_beside_it() {
    let c = channel_of_its_own();
    let (uav, obstacle) = (v(3.0, 1.0), v(2.0, 1.4));
    near(channel::blockage(uav, obstacle, 0.4, &c), 0.5);
    near(channel::blockage(uav, obstacle, 0.5, &c), 0.731_058_578_630_004_9);
    // LOS 3/4; half of it weakened to a fifth.
    near(channel::gain(uav, obstacle, 0.4, &c), 0.6 * 0.75);
    near(channel::gain(uav, obstacle, 9.0, &c), 0.2 * 0.75);
}

#[test]
fn snr_rate_and_outage_are_the_papers() {
    near(channel::snr(3.0, 4.0, &channel_of_its_own()).0, 2.0);
    near(channel::bits(2.5, Snr(3.0)), 5.0);
    assert!(!outage(2.5, Snr(3.0), 5.0), "just enough is enough");
    assert!(outage(2.5, Snr(3.0), 5.1) && !outage(2.5, Snr(3.0), 4.9));
    near(outage_snr(2.5, 5.0).0, 3.0);
}

#[test]
fn propulsion_is_profile_induced_and_parasite_power() {
    let p = Propulsion::default();
    near(energy::propulsion_power(0.0, &p), 167.0);
    // At 8 m/s x = 2: 79 (1 + 192/14400) + 88 (√5 - 2)^½ + 0.004 593 75 * 512.
    let induced = 88.0 * (5.0_f64.sqrt() - 2.0).sqrt();
    near(energy::propulsion_power(8.0, &p), 79.0 * (1.0 + 192.0 / 14_400.0) + induced + 2.352);
    let p = Propulsion { hover_induced_velocity: 8.0, rotor_solidity: 0.1, rotor_area: 0.2, ..p };
    let induced = 88.0 * (1.25_f64.sqrt() - 0.5).sqrt();
    near(energy::propulsion_power(8.0, &p), 79.0 * (1.0 + 192.0 / 14_400.0) + induced + 0.8 * 2.352);
}

#[test]
fn speed_is_limited_and_its_direction_kept() {
    near((dynamics::limit_speed(v(0.3, 0.4), 0.25) - v(0.15, 0.2)).norm(), 0.0);
    assert_eq!(dynamics::limit_speed(v(0.3, 0.4), 0.5), v(0.3, 0.4));
}

#[test]
fn a_step_is_speed_first_then_place() {
    let d = Dynamics { a_max: 0.005, v_max: 0.5, walls: true };
    let next = dynamics::step(State { r: v(0.2, 0.3), v: v(0.01, -0.02) }, v(1.0, -1.0), v(0.002, 0.001), &d);
    near((next.v - v(0.017, -0.024)).norm(), 0.0);
    near((next.r - v(0.217, 0.276)).norm(), 0.0);
}

#[test]
fn walls_stop_what_flies_out_and_only_that() {
    let contain = |r, v| dynamics::contain(State { r, v });
    assert_eq!(contain(v(-0.1, 1.2), v(-1.0, 2.0)), State { r: v(0.0, 1.0), v: v(0.0, 0.0) });
    assert_eq!(contain(v(1.2, -0.1), v(-1.0, 2.0)), State { r: v(1.0, 0.0), v: v(-1.0, 2.0) });
    let at_walls = State { r: v(0.0, 1.0), v: v(-1.0, 2.0) };
    assert_eq!(dynamics::contain(at_walls), at_walls);
    let open = Dynamics { walls: false, v_max: 1.0, ..Dynamics::default() };
    let out = State { r: v(0.9, 0.1), v: v(0.3, -0.3) };
    near((dynamics::step(out, v(0.0, 0.0), v(0.0, 0.0), &open).r - v(1.2, -0.2)).norm(), 0.0);
}

#[test]
fn an_obstacle_reflects_behind_its_margin_on_each_axis() {
    let step = |r, v| dynamics::step_obstacle(State { r, v }, 0.25);
    // It would be 0.125 beyond both margins.
    assert_eq!(step(v(0.375, 0.625), v(-0.25, 0.25)), State { r: v(0.375, 0.625), v: v(0.25, -0.25) });
    assert_eq!(step(v(0.625, 0.5), v(0.25, -0.25)), State { r: v(0.625, 0.25), v: v(-0.25, -0.25) });
    assert_eq!(step(v(0.5, 0.5), v(-0.25, 0.25)), State { r: v(0.25, 0.75), v: v(-0.25, 0.25) });
    // One that stands on an axis is never reflected on it.
    assert_eq!(step(v(0.125, 0.5), v(0.0, 0.125)), State { r: v(0.125, 0.625), v: v(0.0, 0.125) });
    assert_eq!(step(v(0.125, 0.875), v(0.0, 0.0)), State { r: v(0.125, 0.875), v: v(0.0, 0.0) });
}

#[test]
fn risk_is_a_sigmoid_of_the_clearance() {
    near(safety::clearance(v(0.3, 0.4), v(0.0, 0.0), 0.02, 0.1), 0.38);
    near(safety::collision_probability(0.03, 0.01, 0.02), 0.268_941_421_369_995_1);
    near(safety::collision_probability(0.01, 0.01, 0.02), 0.5);
}

#[test]
fn the_edge_begins_a_millionth_before_the_walls() {
    let scenario = Scenario::default();
    let none = Obstacles::default();
    let edge = |r| Contact::between((v(0.5, 0.5), &none), (r, &none), &scenario).edge;
    assert!(edge(v(1e-7, 0.5)) && edge(v(0.5, 1.0 - 1e-7)) && edge(v(1.1, 0.5)));
    assert!(!edge(v(1e-5, 0.5)) && !edge(v(0.5, 1.0 - 1e-5)));
}

#[test]
fn the_world_moves_uav_and_obstacles_and_shows_them() {
    let text = "[[obstacle]]\nvelocity = [0.01, 0.0]\n[[obstacle]]\nposition = [0.3, 0.8]\nvelocity = [0.0, -0.02]\n";
    let scenario = Scenario::from_toml(text).unwrap();
    let mut world = World::new(&scenario);
    assert_eq!((world.uav.r, world.uav.v), (scenario.start, v(0.0, 0.0)));
    world.step(v(1.0, 0.0), v(0.001, 0.0), &scenario);
    near((world.uav.v - v(0.0045, 0.0)).norm(), 0.0);
    let places = world.obstacles();
    near((places[0] - v(0.51, 0.45)).norm() + (places[1] - v(0.3, 0.78)).norm(), 0.0);
    world.step_obstacles(&scenario);
    near((world.obstacles()[1] - v(0.3, 0.76)).norm(), 0.0);
    let (uav, at) = (world.uav.r, world.obstacles());
    near(world.clearance(&scenario), at.clearance(uav, &scenario));
    near(world.snr(TxPower::High, &scenario).0, 4.0 * at.gain(uav, &scenario));
    assert_eq!(world.frame(&scenario), camera::render_all(uav, &at, &scenario));
}

#[test]
fn blockage_by_several_is_that_of_the_worst() {
    let scenario = Scenario::from_toml("[[obstacle]]\n[[obstacle]]\nposition = [0.3, 0.8]\n").unwrap();
    let [first, second] = [0, 1].map(|n: usize| scenario.obstacles[n].position);
    let (uav, both) = (v(0.5, 0.9), Obstacles::from([first, second]));
    let one = |at| channel::blockage(uav, at, scenario.obstacles[0].radius, &scenario.channel);
    assert!(one(first) > 0.9 && one(second) < 0.5);
    assert_eq!(both.blockage(uav, &scenario), one(first));
}
