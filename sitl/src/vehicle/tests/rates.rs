//! Message intervals, requests and streams.

use super::*;

/// A vehicle in real time that has greeted its station.
fn in_real_time() -> Bench {
    let mut bench = Bench::new();
    bench.vehicle.start_streams(Duration::from_millis(400), bench.now);
    bench.hello();
    bench
}

fn set(bench: &mut Bench, id: u32, us: f32) -> MavResult {
    let command = MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL;
    let reply = bench.send(&dialect::COMMAND_LONG_DATA { param2: us, ..ask(command, id as f32, (7, 1)) });
    acks(&reply)[0].1.result
}

fn get(bench: &mut Bench, id: u32) -> (i32, MavResult) {
    let reply = bench.send(&ask(MavCmd::MAV_CMD_GET_MESSAGE_INTERVAL, id as f32, (7, 1)));
    let Some(MavMessage::MESSAGE_INTERVAL(told)) = reply[0].message() else { panic!("the interval first") };
    assert_eq!(u32::from(told.message_id), id);
    (told.interval_us, acks(&reply)[0].1.result)
}

/// How often each message came in this time.
fn heard(bench: &mut Bench, seconds: u64) -> BTreeMap<u32, usize> {
    let end = bench.now + Duration::from_secs(seconds);
    let mut heard = BTreeMap::new();
    while let Some(due) = bench.vehicle.next_stream().filter(|&due| due < end) {
        bench.now = bench.now.max(due);
        bench.vehicle.stream(bench.now);
        for packet in bench.received() {
            *heard.entry(packet.id).or_default() += 1;
        }
    }
    bench.now = end;
    heard
}

const SYSTEM_TIME: u32 = 2;
const POSITION: u32 = 32;
const EXTENDED: u32 = 245;

#[test]
fn in_real_time_streams_flow_at_their_rates_and_can_be_changed() {
    let mut bench = in_real_time();
    assert_eq!(heard(&mut bench, 10)[&SYSTEM_TIME], 10);
    assert_eq!(get(&mut bench, SYSTEM_TIME), (1_000_000, MavResult::MAV_RESULT_ACCEPTED));
    assert_eq!(set(&mut bench, SYSTEM_TIME, 100_000.0), MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(get(&mut bench, SYSTEM_TIME).0, 100_000);
    assert_eq!(heard(&mut bench, 10)[&SYSTEM_TIME], 100);
    assert_eq!(set(&mut bench, SYSTEM_TIME, -1.0), MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(get(&mut bench, SYSTEM_TIME).0, -1);
    assert_eq!(heard(&mut bench, 10).get(&SYSTEM_TIME), None);
    assert_eq!(set(&mut bench, SYSTEM_TIME, 0.0), MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(heard(&mut bench, 10)[&SYSTEM_TIME], 10);
}

#[test]
fn in_lockstep_nothing_streams_unless_somebody_asks() {
    let mut bench = Bench::new();
    bench.hello();
    assert_eq!(bench.vehicle.next_stream(), None);
    assert_eq!(set(&mut bench, SYSTEM_TIME, 500_000.0), MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(heard(&mut bench, 10), [(SYSTEM_TIME, 20)].into());
}

#[test]
fn a_percept_can_be_had_more_often_and_never_less() {
    let mut bench = in_real_time();
    assert_eq!(get(&mut bench, POSITION).0, 400_000);
    assert_eq!(set(&mut bench, POSITION, -1.0), MavResult::MAV_RESULT_DENIED);
    assert_eq!(set(&mut bench, POSITION, 1e6), MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(get(&mut bench, POSITION).0, 400_000);
    assert_eq!(set(&mut bench, POSITION, 100_000.0), MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(heard(&mut bench, 10)[&POSITION], 100);
    bench.vehicle.advance(bench.now);
    let group = [(1, 32), (1, 85), (1, 250), (68, 251), (68, 251), (68, 251), (68, 109)];
    assert_eq!(ids(&bench.received()), group);
}

#[test]
fn an_interval_that_cannot_be_is_denied() {
    let mut bench = in_real_time();
    for us in [f32::NAN, f32::INFINITY, 1.0, -2.0, 1e30] {
        assert_eq!(set(&mut bench, SYSTEM_TIME, us), MavResult::MAV_RESULT_DENIED, "{us}");
    }
    assert_eq!(set(&mut bench, 333, 1e6), MavResult::MAV_RESULT_DENIED);
    assert_eq!(get(&mut bench, 333), (0, MavResult::MAV_RESULT_DENIED));
    for number in [f32::NAN, f32::INFINITY, -1.0, 2.5] {
        let reply = bench.send(&ask(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, number, (7, 1)));
        assert_eq!(acks(&reply)[0].1.result, MavResult::MAV_RESULT_DENIED, "{number}");
    }
    assert_eq!(set(&mut bench, 0, -1.0), MavResult::MAV_RESULT_DENIED, "a heartbeat is for ever");
    assert_eq!(heard(&mut bench, 10)[&SYSTEM_TIME], 10);
}

#[test]
fn every_message_is_told_on_request_by_its_owner() {
    let mut bench = Bench::new();
    bench.hello();
    for row in messages::ROWS {
        let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, row.id as f32, (7, row.component)));
        if row.component == RADIO && row.id != 0 {
            assert_eq!(acks(&reply)[0].1.result, MavResult::MAV_RESULT_TEMPORARILY_REJECTED, "no report yet");
            continue;
        }
        assert_eq!(ids(&reply), [(row.component, 77), (row.component, row.id)]);
    }
    bench.vehicle.advance(bench.now);
    bench.received();
    let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 109.0, (7, 1)));
    assert_eq!(ids(&reply), [(1, 77), (68, 109)], "the autopilot passes it on");
    let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 2.0, (7, 68)));
    assert_eq!(acks(&reply)[0].1.result, MavResult::MAV_RESULT_DENIED, "the radio has no such message");
}

#[test]
fn a_command_int_is_answered_like_a_command_long() {
    let mut bench = Bench::new();
    bench.hello();
    let (target_system, target_component) = (7, 1);
    let command = MavCmd::MAV_CMD_REQUEST_MESSAGE;
    let ask = dialect::COMMAND_INT_DATA {
        command,
        param1: 2.0,
        target_system,
        target_component,
        ..Default::default()
    };
    assert_eq!(ids(&bench.send(&ask)), [(1, 77), (1, 2)]);
}

#[test]
fn a_data_stream_sets_the_rates_of_its_group() {
    let mut bench = in_real_time();
    let request = |stream, hz, start_stop| dialect::REQUEST_DATA_STREAM_DATA {
        req_message_rate: hz,
        target_system: 7,
        target_component: 1,
        req_stream_id: stream,
        start_stop,
    };
    use dialect::MavDataStream as Of;
    bench.send(&request(Of::MAV_DATA_STREAM_EXTRA3, 4, 1));
    let count = heard(&mut bench, 10);
    assert_eq!((count[&SYSTEM_TIME], count[&EXTENDED]), (40, 10));
    bench.send(&request(Of::MAV_DATA_STREAM_ALL, 10_000, 1));
    let count = heard(&mut bench, 10);
    assert_eq!((count[&SYSTEM_TIME], count[&EXTENDED]), (500, 500), "50 Hz is the most");
    bench.send(&request(Of::MAV_DATA_STREAM_ALL, 4, 0));
    assert_eq!(heard(&mut bench, 10), BTreeMap::new());
}

#[test]
fn a_busy_machine_skips_what_it_missed() {
    let mut bench = in_real_time();
    bench.now += Duration::from_secs(60);
    bench.vehicle.stream(bench.now);
    assert_eq!(bench.received().iter().filter(|p| p.id == SYSTEM_TIME).count(), 1);
    bench.vehicle.stream(bench.now);
    assert!(bench.received().is_empty());
}

#[test]
fn the_wall_clock_is_told_if_it_is_known() {
    let mut bench = Bench::new();
    bench.hello();
    let mut unix = || {
        bench.now = Duration::from_secs(3);
        let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 2.0, (7, 1)));
        bench.vehicle.set_epoch(Some(Duration::from_secs(1_000_000)));
        let Some(MavMessage::SYSTEM_TIME(time)) = reply[1].message() else { panic!("SYSTEM_TIME") };
        time.time_unix_usec
    };
    assert_eq!((unix(), unix()), (0, 1_000_003_000_000));
}

/// It went on at 22.7 Hz.
#[test]
fn a_faster_rate_of_the_percept_ends_at_minus_one() {
    let mut bench = Bench::new();
    bench.vehicle.start_streams(Duration::from_millis(400), bench.now);
    bench.hello();
    let mut set = |us| {
        let ask = ask(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, 32.0, (7, 1));
        bench.send(&dialect::COMMAND_LONG_DATA { param2: us, ..ask });
        bench.vehicle.peers[&bench.address.into()].rates.every(32)
    };
    assert_eq!(set(44_000.0), Some(Duration::from_millis(44)));
    assert_eq!(set(-1.0), None);
}
