//! What holds for every world, command, seed and scenario, not only for those of the examples.

use crpl_sitl::camera::{CHANNELS, SIDE, render};
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::radio::{Fates, Gate};
use crpl_sitl::scenario::{Radio, Rule, Scenario, ScenarioError};
use crpl_sitl::units::{Motion, Scale, Snr, Tick, TxPower};
use crpl_sitl::world::{channel, dynamics, energy, safety};
use crpl_sitl::{Sim, world::dynamics::State};
use nalgebra::Vector2;
use proptest::prelude::*;

/// Any point of the square.
fn point() -> impl Strategy<Value = Vector2<f64>> {
    (0.0..=1.0, 0.0..=1.0).prop_map(|(x, y)| Vector2::new(x, y))
}

/// Any vector whose parts lie within ±`limit`.
fn vector(limit: f64) -> impl Strategy<Value = Vector2<f64>> {
    (-limit..=limit, -limit..=limit).prop_map(|(x, y)| Vector2::new(x, y))
}

fn power() -> impl Strategy<Value = TxPower> {
    prop_oneof![Just(TxPower::Low), Just(TxPower::High)]
}

fn rule() -> impl Strategy<Value = Rule> {
    prop_oneof![Just(Rule::Ideal), Just(Rule::Drop), Just(Rule::Queue)]
}

/// Half the SNR that just carries a packet of the default radio, or twice that.
fn snr(outage: bool) -> Snr {
    let radio = Radio::default();
    Snr(channel::outage_snr(radio.b_dt, radio.packet_bits).0 * if outage { 0.5 } else { 2.0 })
}

/// An acceleration as it may come off the wire: any finite f32, most of them sensible.
fn accel() -> impl Strategy<Value = [f32; 2]> {
    let axis = prop_oneof![
        4 => -12.0f32..=12.0,
        1 => -1e6f32..=1e6,
        1 => prop::num::f32::NORMAL | prop::num::f32::SUBNORMAL | prop::num::f32::ZERO,
    ];
    [axis.clone(), axis]
}

/// Commands for the ticks of a short flight; `None` where the station is silent.
fn commands() -> impl Strategy<Value = Vec<Option<Command>>> {
    prop::collection::vec(prop::option::weighted(0.8, (accel(), power())), 1..60).prop_map(|wishes| {
        let stamp = |(k, wish): (usize, Option<([f32; 2], TxPower)>)| {
            wish.map(|(accel, power)| Command::new(Tick(k as u64), accel, power))
        };
        wishes.into_iter().enumerate().map(stamp).collect()
    })
}

/// A scenario that passes its own checks, with other values than the paper's in most keys.
fn scenario() -> impl Strategy<Value = Scenario> {
    let geometry = (point(), point(), point(), 0.01..0.05, 0.05..0.15);
    let motion = (vector(0.05), 0.0..0.4, 0.01..0.1, 1e-3..1e-2, any::<bool>(), 0.0..0.02);
    let radio = (rule(), 1.0..12.0, 0.3..3.0, 0.005..0.05, 0.0..1.0);
    let any = (geometry, motion, radio, 1u64..400);
    any.prop_filter_map("start or goal in the obstacle", |(geometry, motion, radio, horizon)| {
        let mut s = Scenario { name: "any".into(), horizon, ..Scenario::default() };
        let obstacle = &mut s.obstacles[0];
        (s.start, s.goal, obstacle.position, s.uav_radius, obstacle.radius) = geometry;
        let sigma_c;
        (obstacle.velocity, obstacle.margin, s.dynamics.v_max, s.dynamics.a_max, s.dynamics.walls, sigma_c) =
            motion;
        s.disturbance.sigma_c = sigma_c;
        (
            s.radio.rule,
            s.radio.b_dt,
            s.channel.noise_power,
            s.channel.blockage_softness,
            s.channel.nlos_attenuation,
        ) = radio;
        let margin = obstacle.margin;
        obstacle.position = obstacle.position.map(|x| x.clamp(margin, 1.0 - margin));
        match s.check() {
            Err(ScenarioError::Covered { .. }) => None,
            checked => {
                checked.expect("the strategy stays within the ranges of the checks");
                Some(s)
            }
        }
    })
}

/// Every percept of a flight, the first and the last included.
fn percepts(scenario: &Scenario, seed: u64, commands: &[Option<Command>], repeats: usize) -> Vec<Percept> {
    let mut sim = Sim::new(scenario.clone(), seed);
    let mut seen = vec![sim.percept()];
    for command in commands {
        for _ in 0..repeats {
            command.iter().for_each(|c| sim.handle(*c));
            assert_eq!(seen.last(), Some(&sim.percept()), "asking or commanding moved the world");
        }
        sim.advance();
        seen.push(sim.percept());
    }
    seen
}

fn total(fates: Fates) -> u64 {
    fates.delivered + fates.delayed + fates.superseded + fates.lost
}

proptest! {
    // A failure prints its smallest case; that case then becomes a test of its own.
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_command_and_no_gust_breaks_the_speed_limit_or_the_box(
        mut scenario in scenario(), seed in any::<u64>(), commands in commands(),
    ) {
        scenario.dynamics.walls = true;
        let v_max = scenario.dynamics.v_max;
        let mut sim = Sim::new(scenario, seed);
        for command in commands {
            command.into_iter().for_each(|c| sim.handle(c));
            sim.advance();
            let State { r, v } = sim.world().uav;
            prop_assert!(v.norm() <= v_max * (1.0 + 1e-12), "speed {} of {v_max}", v.norm());
            prop_assert!(r.iter().all(|x| (0.0..=1.0).contains(x)), "position {r}");
            prop_assert!(sim.flown().iter().all(|a| (-1.0..=1.0).contains(a)), "flown {}", sim.flown());
        }
    }

    #[test]
    fn equal_seeds_and_commands_give_equal_percepts_and_repeats_change_nothing(
        scenario in scenario(), seed in any::<u64>(), commands in commands(),
    ) {
        let once = percepts(&scenario, seed, &commands, 1);
        prop_assert_eq!(&once, &percepts(&scenario, seed, &commands, 1));
        prop_assert_eq!(&once, &percepts(&scenario, seed, &commands, 3));
    }

    #[test]
    fn another_seed_meets_another_gust(seed in any::<u64>()) {
        let mut scenario = Scenario::default();
        scenario.disturbance.sigma_c = 0.005;
        let flight = |seed| percepts(&scenario, seed, &[None, None], 1).pop().map(|p| p.telemetry.position);
        prop_assert_ne!(flight(seed), flight(seed.wrapping_add(1)));
    }

    #[test]
    fn a_moving_obstacle_reflects_at_full_speed_and_never_leaves_its_margin(
        scenario in scenario(), ticks in 1usize..300,
    ) {
        let margin = scenario.obstacle().margin;
        let mut state = State { r: scenario.obstacle().position, v: scenario.obstacle().velocity };
        let speed = state.v.norm();
        for k in 0..ticks {
            state = dynamics::step_obstacle(state, margin);
            let inside = margin - 1e-12..=1.0 - margin + 1e-12;
            prop_assert!(state.r.iter().all(|x| inside.contains(x)), "tick {k}: {} at margin {margin}", state.r);
            prop_assert_eq!(state.v.norm(), speed);
        }
    }

    #[test]
    fn every_command_meets_exactly_one_fate(
        rule in rule(),
        events in prop::collection::vec((0u64..40, any::<bool>(), any::<bool>(), power()), 1..120),
    ) {
        let mut gate = Gate::default();
        let (mut now, mut flown) = (0, None);
        for (tick, submits, outage, power) in events {
            if submits {
                gate.submit(Command::new(Tick(tick), [0.0; 2], power));
            } else {
                gate.transmit(Tick(now), snr(outage), &Radio { rule, ..Radio::default() });
                now += 1;
            }
            prop_assert_eq!(total(gate.fates()), gate.fates().sent);
            let newer = gate.held().map(|held| held.tick);
            prop_assert!(newer >= flown, "went back from {flown:?} to {newer:?}");
            flown = newer;
        }
        let fates = gate.fates();
        match rule {
            Rule::Queue => prop_assert!(fates.lost <= 1, "a queue loses only what waits at the end: {fates:?}"),
            Rule::Ideal => prop_assert!(fates.lost <= 1, "an ideal link drops nothing: {fates:?}"),
            Rule::Drop => {}
        }
    }

    #[test]
    fn a_stale_command_changes_nothing(newest in 1u64..50, age in 1u64..50, power in power()) {
        let mut gate = Gate::default();
        gate.submit(Command::new(Tick(newest), [1.0, 2.0], power));
        let other = if power == TxPower::Low { TxPower::High } else { TxPower::Low };
        let stale = Command::new(Tick(newest.saturating_sub(age)), [3.0, 4.0], other);
        gate.submit(stale);
        prop_assert_eq!(gate.power(), power);
        gate.transmit(Tick(newest), snr(false), &Radio::default());
        prop_assert_eq!(gate.held().map(|h| (h.tick, h.accel)), Some((Tick(newest), [1.0, 2.0])));
        gate.submit(stale);
        prop_assert_eq!(gate.power(), power);
        prop_assert_eq!(gate.fates().sent, 1);
    }

    #[test]
    fn more_power_never_loses_a_packet_that_less_power_carries(
        uav in point(), obstacle in point(), b_dt in 0.5..20.0,
    ) {
        let s = Scenario::default();
        let gain = channel::gain(uav, obstacle, s.obstacle().radius, &s.channel);
        let fails = |power: TxPower| {
            channel::outage(b_dt, channel::snr(gain, power.level(), &s.channel), s.radio.packet_bits)
        };
        prop_assert!(fails(TxPower::Low) || !fails(TxPower::High));
        let blockage = channel::blockage(uav, obstacle, s.obstacle().radius, &s.channel);
        prop_assert!((0.0..=1.0).contains(&blockage));
        let los = channel::los_gain(uav, &s.channel);
        prop_assert!(gain > 0.0 && gain <= los, "gain {gain} of {los} in sight");
    }

    #[test]
    fn the_outage_threshold_parts_the_rates(b_dt in 0.5..20.0, offset in 1e-6..1.0) {
        let threshold = channel::outage_snr(b_dt, 4.0).0;
        prop_assert!(channel::outage(b_dt, Snr(threshold * (1.0 - offset)), 4.0));
        prop_assert!(!channel::outage(b_dt, Snr(threshold * (1.0 + offset)), 4.0));
    }

    #[test]
    fn risk_falls_with_distance_and_is_one_half_at_contact(gap in -0.2..1.0, more in 1e-6..0.2) {
        let risk = |clearance| safety::collision_probability(clearance, 0.0, 0.02);
        prop_assert!(risk(gap) >= risk(gap + more));
        prop_assert!((0.0..=1.0).contains(&risk(gap)));
        prop_assert_eq!(risk(0.0), 0.5);
    }

    #[test]
    fn propulsion_power_is_finite_and_positive(speed in 0.0..200.0) {
        let watts = energy::propulsion_power(speed, &Scenario::default().propulsion);
        prop_assert!(watts.is_finite() && watts > 50.0, "{watts} W at {speed} m/s");
    }

    #[test]
    fn a_whole_disc_has_its_area_and_its_centre(uav in point(), obstacle in point()) {
        let s = Scenario::default();
        let edge = s.camera.edge_px;
        let inside = |r: Vector2<f64>, radius: f64| {
            let reach = radius + edge / 2.0 / SIDE as f64;
            r.map(|x| x.clamp(reach, 1.0 - reach))
        };
        let (uav, obstacle) = (inside(uav, s.uav_radius), inside(obstacle, s.obstacle().radius));
        // Where the UAV covers it, the obstacle is less than whole.
        let apart = safety::clearance(uav, obstacle, s.uav_radius, s.obstacle().radius) > edge / SIDE as f64;
        let frame = render(uav, obstacle, &s);
        for (channel, whole, centre, radius, bound) in
            [(0, true, uav, s.uav_radius, 8e-3), (2, apart, obstacle, s.obstacle().radius, 3e-3)]
        {
            if !whole {
                continue;
            }
            let (mass, x, y) = moments(frame.rgb(), channel);
            let px = radius * SIDE as f64;
            let area = std::f64::consts::PI * (px * px + edge * edge / 12.0);
            prop_assert!((mass / area - 1.0).abs() < bound, "channel {channel}: area {mass}, not {area}");
            let off = (Vector2::new(x, y) / SIDE as f64 - centre).norm() * SIDE as f64;
            prop_assert!(off < 0.08, "channel {channel}: centre off by {off} px");
        }
    }

    #[test]
    fn the_nearest_action_is_nearest_and_its_own_nearest(wish in vector(1.5)) {
        let chosen = Motion::nearest(wish);
        prop_assert_eq!(Motion::nearest(chosen.vector()), chosen);
        let distance = |action: Motion| (wish - action.vector()).norm_squared();
        let rank = |action| Motion::ALL.iter().position(|&a| a == action);
        for action in Motion::ALL {
            prop_assert!(distance(chosen) <= distance(action), "{action:?} is nearer than {chosen:?}");
            prop_assert!(distance(chosen) < distance(action) || rank(chosen) <= rank(action), "tie");
        }
    }

    #[test]
    fn a_scenario_survives_toml(scenario in scenario()) {
        let text = toml::to_string(&scenario).unwrap();
        prop_assert_eq!(Scenario::from_toml(&text).unwrap(), scenario);
    }

    #[test]
    fn no_text_makes_the_scenario_parser_panic(text in "\\PC{0,200}") {
        let _ = Scenario::from_toml(&text);
    }

    #[test]
    fn paper_and_ned_are_the_same_place(r in point(), v in vector(0.04), a in vector(0.0035)) {
        let scale = Scale::default();
        let off = |there: Vector2<f64>, back: Vector2<f64>| (there - back).norm();
        prop_assert!(off(r, scale.paper_from_ned(scale.ned_from_paper(r))) < 1e-7);
        prop_assert!(off(v, scale.paper_from_ned_velocity(scale.ned_from_paper_velocity(v))) < 1e-8);
        prop_assert!(off(a, scale.paper_from_ned_acceleration(scale.ned_from_paper_acceleration(a))) < 1e-9);
    }

    #[test]
    fn a_boot_time_names_its_tick(tick in 0u64..4_000_000, ms in 1u32..1000) {
        let interval = f64::from(ms) * 1e-3;
        let stamp = Tick(tick).to_boot_ms(interval);
        prop_assert_eq!(Tick::from_boot_ms(stamp, interval), Some(Tick(tick)));
    }
}

/// Sum, and centre of mass in px, of one channel of a picture.
fn moments(rgb: &[u8], channel: usize) -> (f64, f64, f64) {
    let (mut mass, mut mx, mut my) = (0.0, 0.0, 0.0);
    for (i, pixel) in rgb.chunks_exact(CHANNELS).enumerate() {
        let c = f64::from(pixel[channel]) / 255.0;
        mass += c;
        mx += c * ((i % SIDE) as f64 + 0.5);
        my += c * ((i / SIDE) as f64 + 0.5);
    }
    (mass, mx / mass, my / mass)
}
