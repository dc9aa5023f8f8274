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
        assert_eq!(read(&mut bench, index as i16, ""), std::slice::from_ref(param));
        assert_eq!(read(&mut bench, -1, &param.1), std::slice::from_ref(param));
    }
    let value = |name: &str| all.iter().find(|param| param.1 == name).map(|param| param.2);
    assert_eq!(value("SYSID_THISMAV"), Some(7.0));
    assert_eq!((value("DYN_V_MAX"), value("GOAL_E")), (Some(50.0), Some(450.0)));
    assert_eq!((value("RADIO_RULE"), value("RADIO_B_DT")), (Some(1.0), Some(4.0)));
    let both = list(&mut bench, 0);
    assert_eq!(both.len(), all.len() + 1);
    assert_eq!(both.last().map(|param| (param.0, param.1.as_str())), Some((68, "RADIO_TXP")));
}

#[test]
fn what_is_unknown_is_met_with_silence() {
    let mut bench = Bench::new();
    bench.hello();
    let count = list(&mut bench, 1).len() as i16;
    for index in [count, i16::MAX, -2, i16::MIN] {
        assert_eq!(read(&mut bench, index, "SYSID_THISMAV"), []);
    }
    assert_eq!(read(&mut bench, -1, "NO_SUCH"), []);
    assert_eq!(set(&mut bench, "NO_SUCH", 1.0), []);
    assert_eq!(list(&mut bench, 42), []);
}

#[test]
fn what_cannot_be_set_is_answered_with_the_old_value() {
    let mut bench = Bench::new();
    bench.hello();
    for (name, values, old) in [
        ("SYSID_THISMAV", [9.0, f32::NAN], 7.0),
        ("DYN_V_MAX", [1.0, f32::INFINITY], 50.0),
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
