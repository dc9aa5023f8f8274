//! Frames whose checksum is right and whose content is anything.

use proptest::prelude::*;

use super::*;
use crate::link::crc::crc_extra;

/// What the vehicle looks into.
const IDS: [u32; 33] = [
    0, 2, 4, 11, 20, 21, 22, 23, 32, 37, 38, 39, 40, 41, 43, 44, 45, 47, 51, 66, 73, 75, 76, 84, 85, 110,
    111, 130, 131, 147, 253, 256, 345,
];

fn frame(sequence: u8, id: u32, payload: &[u8]) -> Vec<u8> {
    let [id0, id1, id2, _] = id.to_le_bytes();
    let mut frame = vec![0xFD, payload.len() as u8, 0, 0, sequence, 255, 190, id0, id1, id2];
    frame.extend_from_slice(payload);
    let crc = checksum(&frame[1..], crc_extra(id).unwrap_or(0));
    frame.extend(crc.to_le_bytes());
    frame
}

/// Bytes, floats that are hardly ever asked for, and the ids of the vehicle.
fn payload() -> impl Strategy<Value = Vec<u8>> {
    let word = prop_oneof![
        any::<[u8; 4]>(),
        Just([0; 4]),
        Just(f32::NAN.to_le_bytes()),
        Just(f32::INFINITY.to_le_bytes()),
        Just(f32::MAX.to_le_bytes()),
        (-10_i16..600).prop_map(|number| f32::from(number).to_le_bytes()),
        Just([7, 1, 7, 1]),
        Just([0, 0, 7, 1]),
    ];
    prop::collection::vec(word, 0..16).prop_map(|words| words.concat())
}

proptest! {
    #[test]
    fn nothing_that_is_sent_stops_the_vehicle(
        sent in prop::collection::vec((prop::sample::select(&IDS[..]), payload()), 1..60)
    ) {
        let mut bench = Bench::new();
        bench.vehicle.start_streams(Duration::from_millis(400), bench.now);
        bench.hello();
        for (k, (id, payload)) in sent.iter().enumerate() {
            bench.datagram(&frame(k as u8, *id, payload));
            bench.now += Duration::from_millis(350);
            bench.vehicle.stream(bench.now);
            if k % 2 == 0 {
                bench.vehicle.advance(bench.now);
            }
            bench.vehicle.beat();
            bench.received();
        }
        let uav = bench.vehicle.sim.world().uav;
        prop_assert!(uav.r.iter().chain(uav.v.iter()).all(|x| x.is_finite()), "{:?}", uav);
        // A key may have been set, but unsigned frames are heard unless it was also required.
        let ping = dialect::PING_DATA { time_usec: 1, seq: 2, target_system: 0, target_component: 0 };
        let reply = bench.send(&ping);
        prop_assert!(
            bench.vehicle.signing.is_required() || reply.iter().any(|p| p.is::<dialect::PING_DATA>())
        );
    }
}
