//! The parameter protocol.

use super::*;

/// What a PARAM_VALUE says: component, name, value, index, count.
type Told = (u8, String, f32, u16, u16);

fn told(packets: &[Packet]) -> Vec<Told> {
    let values = packets.iter().filter_map(|packet| match packet.message() {
        Some(MavMessage::PARAM_VALUE(v)) => {
            let name = v.param_id.to_str().unwrap().to_owned();
            Some((packet.component, name, v.param_value, v.param_index, v.param_count))
        }
        _ => None,
    });
    values.collect()
}

fn list(bench: &mut Bench, target_component: u8) -> Vec<Told> {
    told(&bench.send(&dialect::PARAM_REQUEST_LIST_DATA { target_system: 7, target_component }))
}

fn read(bench: &mut Bench, param_index: i16, name: &str) -> Vec<Told> {
    let (target_system, target_component, param_id) = (7, 1, name.into());
    told(&bench.send(&dialect::PARAM_REQUEST_READ_DATA {
        param_index,
        target_system,
        target_component,
        param_id,
    }))
}

fn set(bench: &mut Bench, name: &str, param_value: f32) -> Vec<Told> {
    told(&bench.send(&dialect::PARAM_SET_DATA {
        param_value,
        target_system: 7,
        target_component: 1,
        param_id: name.into(),
        param_type: dialect::MavParamType::MAV_PARAM_TYPE_REAL32,
    }))
}

#[test]
fn the_list_is_whole_and_in_order_and_each_is_read_by_name_and_index() {
    let mut bench = Bench::new();
    bench.hello();
    let all = list(&mut bench, 1);
    for (index, param) in all.iter().enumerate() {
        assert_eq!((param.0, usize::from(param.3), usize::from(param.4)), (1, index, all.len()));
        assert!(param.1.len() <= 16 && !all[..index].iter().any(|other| other.1 == param.1), "{}", param.1);
        // The counters count these requests too.
        let same = |told: Vec<Told>| {
            let [(component, name, value, at, count)] = &told[..] else { panic!("one value") };
            (*component, name.as_str(), *at, *count) == (1, param.1.as_str(), param.3, param.4)
                && (*value == param.2 || name.starts_with("STAT_"))
        };
        assert!(same(read(&mut bench, index as i16, "")), "{param:?}");
        assert!(same(read(&mut bench, -1, &param.1)), "{param:?}");
    }
    let value = |name: &str| all.iter().find(|param| param.1 == name).map(|param| param.2);
    assert_eq!(value("SYSID_THISMAV"), Some(7.0));
    assert_eq!((value("DYN_V_MAX"), value("GOAL_E")), (Some(50.0), Some(450.0)));
    assert_eq!((value("RADIO_RULE"), value("RADIO_B_DT")), (Some(1.0), Some(4.0)));
    let both = list(&mut bench, 0);
    assert_eq!(both.len(), all.len() + 1);
    assert_eq!(both.last().map(|param| (param.0, param.1.as_str())), Some((68, "RADIO_TXP")));
}

/// The error that a request is answered with, and by whom.
fn error(packets: &[Packet]) -> Option<(u8, dialect::MavParamError)> {
    let [packet] = packets else { return None };
    match packet.message()? {
        MavMessage::PARAM_ERROR(error) => {
            assert_eq!((error.target_system, error.target_component), (255, 190));
            Some((packet.component, error.error))
        }
        _ => None,
    }
}

#[test]
fn what_is_unknown_is_told_to_the_asker_and_what_is_for_others_is_left_to_them() {
    let mut bench = Bench::new();
    bench.hello();
    let count = list(&mut bench, 1).len() as i16;
    let none = Some((1, dialect::MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST));
    let ask = |param_index, name: &str, target_component| dialect::PARAM_REQUEST_READ_DATA {
        param_index,
        target_system: 7,
        target_component,
        param_id: name.into(),
    };
    for index in [count, i16::MAX, -2, i16::MIN] {
        assert_eq!(error(&bench.send(&ask(index, "SYSID_THISMAV", 1))), none);
    }
    assert_eq!(error(&bench.send(&ask(-1, "NO_SUCH", 1))), none);
    assert_eq!(error(&bench.send(&ask(-1, "NO_SUCH", 0))), none, "one answer for both components");
    assert!(bench.send(&ask(-1, "NO_SUCH", 42)).is_empty());
    let set = dialect::PARAM_SET_DATA {
        param_value: 1.0,
        target_system: 7,
        target_component: 68,
        param_id: "NO_SUCH".into(),
        param_type: dialect::MavParamType::MAV_PARAM_TYPE_REAL32,
    };
    assert_eq!(error(&bench.send(&set)).map(|found| found.0), Some(68));
    assert_eq!(list(&mut bench, 42), []);
}

#[test]
fn what_cannot_be_set_is_answered_with_the_old_value() {
    let mut bench = Bench::new();
    bench.hello();
    for (name, values, old) in [
        ("SYSID_THISMAV", [9.0, f32::NAN], 7.0),
        ("DYN_V_MAX", [-1.0, f32::INFINITY], 50.0),
        ("DYN_V_MAX", [0.0, 1.0], 50.0),
        ("SCALE_UNIT_M", [1.0, f32::NAN], 500.0),
        ("STAT_RX_BADCRC", [1.0, f32::NAN], 0.0),
        ("RADIO_RULE", [3.0, 0.5], 1.0),
        ("FS_SETP_ACT", [3.0, -1.0], 0.0),
        ("FS_SETP_TIME", [0.0, f32::NAN], 3.0),
        ("WP_SPEED", [51.0, 0.0], 20.0),
        ("SIGN_REQUIRED", [2.0, f32::NAN], 1.0),
        ("GOAL_E", [501.0, -1.0], 450.0),
        ("RATE_ATTITUDE", [f32::NAN, f32::NEG_INFINITY], 4.0),
        ("RATE_ATTITUDE", [-1.0, 51.0], 4.0),
    ] {
        for value in values {
            let echo = set(&mut bench, name, value);
            assert_eq!(echo.iter().map(|param| param.2).collect::<Vec<_>>(), [old], "{name} = {value}");
        }
    }
}

#[test]
fn a_rate_is_the_default_of_all_peers_and_of_those_to_come() {
    let mut bench = Bench::new();
    bench.vehicle.start_streams(Duration::from_millis(400), bench.now);
    bench.hello();
    assert_eq!(set(&mut bench, "RATE_ATTITUDE", 20.0)[0].2, 20.0);
    let every = |bench: &Bench| bench.vehicle.peers[&bench.address.into()].rates.every(30);
    assert_eq!(every(&bench), Some(Duration::from_millis(50)));
    bench.address.set_port(5001);
    bench.hello();
    assert_eq!(every(&bench), Some(Duration::from_millis(50)));
    set(&mut bench, "RATE_ATTITUDE", 0.0);
    assert_eq!(every(&bench), None);
}

#[test]
fn in_lockstep_a_rate_waits_for_real_time() {
    let mut bench = Bench::new();
    bench.hello();
    assert_eq!(set(&mut bench, "RATE_ATTITUDE", 20.0)[0].2, 20.0);
    assert_eq!(bench.vehicle.next_stream(), None);
}

#[test]
fn a_failsafe_is_set_in_flight_and_a_radio_at_boot() {
    let mut bench = Bench::new();
    bench.hello();
    assert_eq!(set(&mut bench, "FS_SETP_ACT", 1.0)[0].2, 1.0);
    assert_eq!(bench.vehicle.settings.failsafe.setpoint_action, Action::Brake);
    assert_eq!(set(&mut bench, "RADIO_B_DT", 2.5)[0].2, 2.5);
    assert_eq!(bench.vehicle.sim.scenario().radio.b_dt, 4.0, "the flight goes on as it began");
    let params = bench.vehicle.settable_params();
    let file = crate::link::param_file::parse(&crate::link::param_file::write(params.clone())).unwrap();
    let again = Vehicle::boot(&Scenario::default(), 1, 7, None, &file).unwrap();
    assert_eq!(again.sim.scenario().radio.b_dt, 2.5);
    assert_eq!(again.settable_params(), params);
    let mut expected = Scenario::default();
    expected.radio.b_dt = 2.5;
    expected.failsafe.setpoint_action = Action::Brake;
    assert_eq!(*again.sim.scenario(), expected, "what was not changed is what it was, to the last bit");
}

#[test]
fn every_parameter_that_can_be_set_takes_another_value_and_keeps_it() {
    let mut bench = Bench::new();
    bench.hello();
    for (name, value) in bench.vehicle.settable_params() {
        let component = if name == "RADIO_TXP" { 68 } else { 1 };
        let other = match (name, value) {
            ("RADIO_TXP", _) => 4.0,
            (_, 0.0) => 1.0,
            ("DYN_WALLS", _) => 0.0,
            ("RADIO_RULE" | "FENCE_ACTION", _) => 2.0,
            ("SIGN_REQUIRED", _) => 0.0,
            _ => value * 1.0625,
        };
        let reply = bench.send(&dialect::PARAM_SET_DATA {
            param_value: other,
            target_system: 7,
            target_component: component,
            param_id: name.into(),
            param_type: dialect::MavParamType::MAV_PARAM_TYPE_REAL32,
        });
        assert_eq!(told(&reply).first().map(|param| param.2), Some(other), "{name} from {value}");
    }
}

#[test]
fn counters_can_be_read() {
    let mut bench = Bench::new();
    bench.hello();
    bench.datagram(b"junk!");
    bench.send(&setpoint(0, f32::NAN));
    assert_eq!(read(&mut bench, -1, "STAT_RX_GARBAGE")[0].2, 5.0);
    assert_eq!(read(&mut bench, -1, "STAT_SETP_REFD")[0].2, 1.0);
    assert_eq!(read(&mut bench, -1, "STAT_RX_FRAMES")[0].2, 5.0);
}

fn boot(text: &str) -> Result<Vehicle, ParamError> {
    let file = crate::link::param_file::parse(text).unwrap();
    Vehicle::boot(&Scenario::default(), 1, 7, None, &file)
}

#[test]
fn a_start_inside_the_obstacle_is_refused_in_flight_and_at_boot() {
    let mut bench = Bench::new();
    bench.hello();
    // The start is north 250, the obstacle's centre north 225, east 250.
    assert_eq!(set(&mut bench, "START_E", 250.0)[0].2, 50.0);
    assert_eq!(set(&mut bench, "START_E", 150.0)[0].2, 150.0);
    let error = boot("GOAL_N 225\nGOAL_E 250\n").unwrap_err().to_string();
    assert_eq!(error, "line 2: GOAL_E = 250 is out of range");
}

#[test]
fn a_file_that_swaps_start_and_obstacle_is_taken_whole() {
    let vehicle = boot("OBST_N 250\nOBST_E 50\nSTART_N 225\nSTART_E 250\n").unwrap();
    let scenario = vehicle.sim.scenario();
    assert_eq!((scenario.start, scenario.obstacle().position), ([0.5, 0.45].into(), [0.1, 0.5].into()));
    // What cannot be at all is refused beside it.
    let error = boot("OBST_N 250\nOBST_E 50\nSTART_N 225\nSTART_E 250\nFS_SETP_ACT 7\n").err().unwrap();
    assert_eq!(error.to_string(), "line 5: FS_SETP_ACT = 7 is out of range");
}

#[test]
fn what_follows_a_collision_is_a_parameter() {
    let vehicle = boot("COLLIDE_ACT 1\n").unwrap();
    assert_eq!(vehicle.sim.scenario().safety.collision_action, crate::scenario::CollisionAction::Fall);
    assert_eq!(boot("WIND_KICK 1\n").err().unwrap().to_string(), "line 1: `WIND_KICK` is now WIND_GUST");
}

/// One PARAM_SET killed the process: the time between two messages was no Duration.
#[test]
fn a_rate_that_no_timer_has_is_refused_and_the_old_value_told() {
    let mut bench = Bench::new();
    bench.hello();
    bench.vehicle.start_streams(Duration::from_millis(400), bench.now);
    let names: Vec<String> = list(&mut bench, 1).into_iter().map(|param| param.1).collect();
    let rates: Vec<&String> = names.iter().filter(|name| name.starts_with("RATE_")).collect();
    assert_eq!(rates.len(), 12);
    for value in [1e-18, 1e-19, 5.421e-20, 1e-30, 1e-45, f32::MIN_POSITIVE, 1e-4, 50.1, -1.0, f32::INFINITY] {
        for name in &rates {
            let old = read(&mut bench, -1, name)[0].2;
            assert_eq!(set(&mut bench, name, value)[0].2, old, "{name} {value}");
        }
        bench.now += Duration::from_secs(1);
        bench.vehicle.stream(bench.now);
    }
    assert_eq!(set(&mut bench, "RATE_GPS", 0.001)[0].2, 0.001);
    assert_eq!(set(&mut bench, "RATE_GPS", 0.0)[0].2, 0.0);
}

#[test]
fn a_file_with_such_a_rate_names_its_line() {
    let entries = crate::link::param_file::parse("WP_SPEED 10\nRATE_GPS 1e-30\n").unwrap();
    let error = Vehicle::boot(&Scenario::default(), 1, 7, None, &entries).unwrap_err();
    assert!(error.to_string().starts_with("line 2: RATE_GPS"), "{error}");
}
