//! The file transfer protocol of a vehicle without files.

use super::*;
use crate::link::messages::service::FileTransfer;

/// Opcode, the request it answers and the data of the answer.
fn answer(bench: &mut Bench, opcode: u8) -> Option<(u8, u8, u8)> {
    let mut payload = [0; 251];
    payload[..4].copy_from_slice(&[0xFF, 0xFF, 9, opcode]);
    let ask = dialect::FILE_TRANSFER_PROTOCOL_DATA {
        target_network: 0,
        target_system: 7,
        target_component: 1,
        payload,
    };
    let packets = bench.send(&ask);
    let said = FileTransfer::of(packets.first()?)?;
    assert_eq!((packets.len(), said.target), (1, Target { system: 255, component: 190 }));
    assert_eq!((said.seq, said.session), (0, 9), "the next sequence number, the same session");
    assert_eq!(said.size, u8::from(said.opcode == 129), "a refusal has a reason");
    Some((said.opcode, said.request, said.data[0]))
}

#[test]
fn there_are_no_files_and_the_asker_knows_at_once() {
    let mut bench = Bench::new();
    bench.hello();
    assert_eq!(answer(&mut bench, 2), Some((128, 2, 0)));
    assert_eq!(answer(&mut bench, 4), Some((129, 4, 10)));
    assert_eq!(answer(&mut bench, 6), Some((129, 6, 7)));
    assert_eq!(answer(&mut bench, 128), None);
    assert!(
        bench
            .send(&dialect::FILE_TRANSFER_PROTOCOL_DATA {
                target_network: 0,
                target_system: 8,
                target_component: 1,
                payload: [0; 251],
            })
            .is_empty(),
        "another system is meant"
    );
}

/// MAVProxy's and QGroundControl's list of logs waited for an answer that never came.
#[test]
fn there_are_no_logs_and_the_asker_knows_at_once() {
    let mut bench = Bench::new();
    bench.hello();
    let mut ask = |target_system| {
        bench.send(&dialect::LOG_REQUEST_LIST_DATA {
            start: 0,
            end: 0xFFFF,
            target_system,
            target_component: 1,
        })
    };
    let answers = ask(7);
    let Some(MavMessage::LOG_ENTRY(entry)) = answers[0].message() else { panic!("{answers:?}") };
    assert_eq!((answers.len(), entry.num_logs, entry.size), (1, 0, 0));
    assert!(ask(8).is_empty(), "another system is meant");
}

/// Attitudes, sticks and origins were dropped without a word.
#[test]
fn what_the_vehicle_lacks_is_said_once() {
    let mut bench = Bench::new();
    bench.hello();
    let attitude = |target_system| dialect::SET_ATTITUDE_TARGET_DATA { target_system, ..Default::default() };
    assert_eq!(texts(&bench.send(&attitude(8))), [""; 0], "another system is meant");
    assert_eq!(texts(&bench.send(&attitude(7))), ["SET_ATTITUDE_TARGET is not supported"]);
    bench.now += Duration::from_secs(60);
    assert_eq!(texts(&bench.send(&attitude(7))), [""; 0]);
    let sticks = dialect::RC_CHANNELS_OVERRIDE_DATA { target_system: 7, ..Default::default() };
    assert_eq!(texts(&bench.send(&sticks)), ["RC_CHANNELS_OVERRIDE is not supported"]);
    let origin = dialect::SET_GPS_GLOBAL_ORIGIN_DATA { target_system: 7, ..Default::default() };
    assert_eq!(texts(&bench.send(&origin)), ["SET_GPS_GLOBAL_ORIGIN is not supported"]);
}
