//! The file transfer protocol of a vehicle without files.

use super::*;

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
    let MavMessage::FILE_TRANSFER_PROTOCOL(said) = packets.first()?.message()? else { return None };
    assert_eq!((packets.len(), said.target_system, said.target_component), (1, 255, 190));
    assert_eq!(said.payload[..3], [0, 0, 9], "the next sequence number, the same session");
    assert_eq!(said.payload[4], u8::from(said.payload[3] == 129), "a refusal has a reason");
    Some((said.payload[3], said.payload[5], said.payload[12]))
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
