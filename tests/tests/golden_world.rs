//! The world agrees with the golden vectors to the files' own tolerance, 1e-9 relative.

use crpl_sitl::Scenario;
use crpl_sitl::radio::Gate;
use crpl_sitl::radio::message::Command;
use crpl_sitl::scenario::Rule;
use crpl_sitl::sim::metric::{FlightScore, Metric};
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::{Motion, Snr, Tick, TxPower};
use crpl_sitl::world::{World, channel, dynamics, energy, safety};
use serde::Deserialize;
use tests::golden::{Flight, Flights, Table, assert_close, assert_vector_close, read, vector};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Step {
    r: [f64; 2],
    v: [f64; 2],
    a: [f64; 2],
    w: [f64; 2],
    sigma_c: f64,
    #[serde(rename = "box")]
    walls: bool,
    r_next: [f64; 2],
    v_next: [f64; 2],
}

#[test]
fn dynamics_step() {
    let table: Table<Step> = read("dynamics_step").unwrap();
    assert!(table.cases.len() >= 60, "{} cases", table.cases.len());
    for (i, case) in table.cases.iter().enumerate() {
        let dynamics =
            crpl_sitl::scenario::Dynamics { walls: case.walls, ..table.params.scenario().dynamics };
        let before = dynamics::State { r: vector(case.r), v: vector(case.v) };
        // The files give the disturbance as sigma times w; the scenario's own gain is not in them.
        let gust = case.sigma_c * vector(case.w);
        let after = dynamics::step(before, vector(case.a), gust, &dynamics);
        assert_vector_close(after.r, case.r_next, table.tol, &format!("case {i}, r"));
        assert_vector_close(after.v, case.v_next, table.tol, &format!("case {i}, v"));
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Link {
    r: [f64; 2],
    r_u: [f64; 2],
    a_p: f64,
    d: f64,
    h_los_sq: f64,
    d_seg: f64,
    p_block: f64,
    h_sq: f64,
    snr: f64,
    clearance: f64,
    p_coll: f64,
}

#[test]
fn channel_and_safety() {
    let table: Table<Link> = read("channel").unwrap();
    assert!(table.cases.len() >= 100, "{} cases", table.cases.len());
    let s = table.params.scenario();
    for (i, case) in table.cases.iter().enumerate() {
        let (uav, obstacle, radius) = (vector(case.r), vector(case.r_u), s.obstacle().radius);
        let gain = channel::gain(uav, obstacle, radius, &s.channel);
        let clearance = safety::clearance(uav, obstacle, s.uav_radius, radius);
        for (what, got, want) in [
            ("d", (uav - s.channel.base_station).norm(), case.d),
            ("h_los_sq", channel::los_gain(uav, &s.channel), case.h_los_sq),
            ("d_seg", channel::distance_to_sight_line(uav, obstacle, s.channel.base_station), case.d_seg),
            ("p_block", channel::blockage(uav, obstacle, radius, &s.channel), case.p_block),
            ("h_sq", gain, case.h_sq),
            ("snr", channel::snr(gain, case.a_p, &s.channel).0, case.snr),
            ("clearance", clearance, case.clearance),
            (
                "p_coll",
                safety::collision_probability(clearance, s.safety.d_min, s.safety.softness),
                case.p_coll,
            ),
        ] {
            assert_close(got, want, table.tol, &format!("case {i}, {what}"));
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(non_snake_case, reason = "the names of the reference files")]
struct Outage {
    snr: f64,
    B_dt: f64,
    bits: f64,
    outage: bool,
    gamma_out: f64,
}

#[test]
fn outage() {
    let table: Table<Outage> = read("outage").unwrap();
    assert!(table.cases.len() >= 70, "{} cases", table.cases.len());
    let packet_bits = table.params.L_pkt;
    let mut flags = 0;
    for (i, case) in table.cases.iter().enumerate() {
        let snr = Snr(case.snr);
        assert_close(channel::bits(case.B_dt, snr), case.bits, table.tol, &format!("case {i}, bits"));
        let threshold = channel::outage_snr(case.B_dt, packet_bits).0;
        assert_close(threshold, case.gamma_out, table.tol, &format!("case {i}, gamma_out"));
        // On the threshold itself the last bit of a logarithm decides: the bits are the promise there.
        if (case.bits - packet_bits).abs() > 1e-9 * packet_bits {
            assert_eq!(channel::outage(case.B_dt, snr, packet_bits), case.outage, "case {i}");
            flags += 1;
        }
    }
    assert!(flags >= 50, "only {flags} cases are away from the threshold");
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(non_snake_case, reason = "the names of the reference files")]
struct Power {
    v_mps: f64,
    /// In some cases the paper speed that is `v_mps`, units per interval.
    v_units: Option<f64>,
    P: f64,
}

#[test]
fn propulsion() {
    let table: Table<Power> = read("propulsion").unwrap();
    assert!(table.cases.len() >= 20, "{} cases", table.cases.len());
    let s = table.params.scenario();
    for case in &table.cases {
        let watts = energy::propulsion_power(case.v_mps, &s.propulsion);
        assert_close(watts, case.P, table.tol, &format!("P({})", case.v_mps));
        if let Some(speed) = case.v_units {
            assert_close(speed * s.scale.mps_per_speed(), case.v_mps, table.tol, "m/s in the paper's speed");
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Nearest {
    a: [f64; 2],
    idx: usize,
    action: [f64; 2],
}

#[test]
fn nearest_action() {
    let table: Table<Nearest> = read("nearest_action").unwrap();
    assert!(table.cases.len() >= 40, "{} cases", table.cases.len());
    for (i, case) in table.cases.iter().enumerate() {
        let motion = Motion::nearest(vector(case.a));
        assert_eq!(motion, Motion::ALL[case.idx], "case {i}: {:?}", case.a);
        assert_eq!(motion.vector(), vector(case.action), "case {i}: {:?}", case.a);
    }
}

/// The commands of each flight, given to our gate and our world, give the flight: every position,
/// SNR, outage, held action and risk, and the five metrics from our records.
#[test]
fn closed_loop_flights_from_their_commands() {
    let file: Flights = read("closed_loop").unwrap();
    assert_eq!(file.traces.len(), 14);
    for flight in &file.traces {
        let (scenario, name) = (flight.scenario(&file.params), flight.name());
        let records = replay(flight, &scenario, &name);

        let score = FlightScore::of(&records, &scenario).unwrap();
        let want = &flight.metrics;
        assert_close(score[Metric::TerminalDistance], want.d_f, 1e-9, &format!("{name}: d_f"));
        assert_close(score[Metric::TransmitEnergy], want.E_comm, 1e-9, &format!("{name}: E_comm"));
        assert_close(score[Metric::PropulsionEnergy], want.E_ctrl, 1e-9, &format!("{name}: E_ctrl"));
        assert_close(
            score[Metric::CollisionProbability],
            want.p_coll_max,
            1e-9,
            &format!("{name}: p_coll_max"),
        );
        assert_close(score[Metric::Outages], want.N_out, 1e-9, &format!("{name}: outages"));
    }
}

fn replay(flight: &Flight, scenario: &Scenario, name: &str) -> Vec<Record> {
    assert_eq!(scenario.radio.rule, Rule::Drop);
    let mut world = World::new(scenario);
    let mut gate = Gate::default();
    let mut records = Vec::new();
    for k in 0..flight.a_commanded.len() {
        let at = format!("{name}, step {k}");
        let before = world.uav;
        assert_vector_close(before.r, flight.r[k], 1e-9, &format!("{at}: r"));
        assert_vector_close(before.v, flight.v[k], 1e-9, &format!("{at}: v"));

        // The gate carries what it is given; unit accelerations are exact in its f32.
        let wish = vector(flight.a_commanded[k]);
        let power = TxPower::from_level(flight.a_p[k] as f32).expect("the file has powers of the paper");
        gate.submit(Command::new(Tick(k as u64), [wish.x as f32, wish.y as f32], power));
        let snr = world.snr(power, scenario);
        assert_close(snr.0, flight.snr[k], 1e-9, &format!("{at}: snr"));
        let outage = gate.transmit(Tick(k as u64), snr, &scenario.radio).outage;
        assert_eq!(outage, flight.outage[k], "{at}: outage");
        let held = gate.held().map_or([0.0; 2], |held| held.accel.map(f64::from));
        assert_eq!(held, flight.a_applied[k], "{at}: held action");

        world.step(vector(held), nalgebra::Vector2::zeros(), scenario);
        let p_coll = safety::collision_probability(
            world.clearance(scenario),
            scenario.safety.d_min,
            scenario.safety.softness,
        );
        assert_close(p_coll, flight.p_coll[k], 1e-9, &format!("{at}: p_coll"));
        records.push(Record {
            tick: Tick(k as u64),
            r: before.r,
            v: before.v,
            wish,
            power,
            snr_db: snr.to_db() as f32,
            outage,
            flown_tick: gate.held().map(|held| held.tick),
            flown: vector(held),
            r_next: world.uav.r,
            v_next: world.uav.v,
            obstacles: world.obstacles(),
            p_coll,
            collided: world.clearance(scenario) <= scenario.safety.d_min,
            edge: false,
        });
    }
    let last = flight.r.last().expect("a flight has positions");
    assert_vector_close(world.uav.r, *last, 1e-9, &format!("{name}: r_H"));
    records
}
