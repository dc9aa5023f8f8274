//! Frames whose checksum is right and whose content is anything.

use proptest::prelude::*;

use super::*;
use crate::link::crc::crc_extra;
use crate::link::messages::command::{CommandInt, CommandLong};
use crate::link::messages::mission::MissionItem;
use crate::link::messages::param::ParamSet;
use crate::link::messages::setpoint::{SetPositionTargetGlobalInt, SetPositionTargetLocalNed};

/// What the vehicle looks into.
const IDS: [u32; 34] = [
    0, 2, 4, 11, 20, 21, 22, 23, 32, 37, 38, 39, 40, 41, 43, 44, 45, 47, 51, 66, 73, 75, 76, 84, 85, 86, 110,
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

/// Commands that read their numbers.
const COMMANDS: [u16; 28] = [
    16, 17, 18, 19, 20, 21, 22, 30, 31, 82, 93, 115, 176, 177, 178, 192, 193, 224, 246, 300, 400, 510, 511,
    512, 530, 2000, 2001, 2002,
];
const ME: Target = Target { system: 7, component: 1 };

/// Any float: common ones, those at the ends of what integers and times hold, and those that are none.
fn wild() -> impl Strategy<Value = f32> {
    prop_oneof![
        any::<u32>().prop_map(f32::from_bits),
        (-300_i16..600).prop_map(f32::from),
        prop::sample::select(
            &[
                0.0,
                -0.0,
                -1.0,
                1e-45,
                5e-20,
                1e-19,
                1e-18,
                1e19,
                1e38,
                2_147_483_600.0,
                4_294_967_300.0,
                f32::MAX,
                f32::MIN,
                f32::NAN,
                f32::INFINITY,
                f32::NEG_INFINITY,
            ][..]
        ),
    ]
}

/// A message whose form is right and whose numbers are anything: message id and payload.
fn with_wild_numbers() -> impl Strategy<Value = (u32, Vec<u8>)> {
    let names: Vec<&'static str> =
        Bench::new().vehicle.settable_params().into_iter().map(|(name, _)| name).collect();
    let floats = || prop::array::uniform7(wild());
    let threes = || prop::array::uniform3(wild());
    let place = || {
        prop_oneof![
            prop::array::uniform2(any::<i32>()),
            Just([i32::MAX; 2]),
            Just([0; 2]),
            (470_000_000..480_000_000, 80_000_000..90_000_000).prop_map(|(x, y)| [x, y]),
        ]
    };
    let frame = || prop::sample::select(&[0_u8, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12, 20][..]);
    let command = || prop::sample::select(&COMMANDS[..]);
    let target = ME;
    prop_oneof![
        (prop::sample::select(names), wild()).prop_map(|(name, value)| {
            let set = ParamSet {
                value: value.to_le_bytes(),
                target: Target { system: 7, component: 0 },
                name: name.into(),
                kind: 9,
            };
            (23, set.payload().to_vec())
        }),
        (command(), floats()).prop_map(move |(command, params)| {
            (76, CommandLong { params, command, target, confirmation: 0 }.payload().to_vec())
        }),
        (command(), floats(), place(), frame()).prop_map(
            move |(command, [a, b, c, d, z, ..], place, frame)| {
                let (params, current, autocontinue) = ([a, b, c, d], 0, 0);
                let int = CommandInt { params, place, z, command, target, frame, current, autocontinue };
                (75, int.payload().to_vec())
            }
        ),
        (threes(), threes(), threes(), prop::array::uniform2(wild()), any::<u16>(), frame()).prop_map(
            move |(position, velocity, acceleration, yaw, mask, coordinate_frame)| {
                let local = SetPositionTargetLocalNed {
                    time_boot_ms: 0,
                    position,
                    velocity,
                    acceleration,
                    yaw,
                    type_mask: mask & 0x0DFF,
                    target,
                    coordinate_frame,
                };
                (84, local.payload().to_vec())
            }
        ),
        (place(), wild(), threes(), threes(), any::<u16>(), frame()).prop_map(
            move |(place, altitude, velocity, acceleration, mask, coordinate_frame)| {
                let global = SetPositionTargetGlobalInt {
                    time_boot_ms: 0,
                    place,
                    altitude,
                    velocity,
                    acceleration,
                    yaw: [0.0; 2],
                    type_mask: mask & 0x0DFF,
                    target,
                    coordinate_frame,
                };
                (86, global.payload().to_vec())
            }
        ),
        (command(), floats(), place(), frame(), 0_u8..4, any::<bool>()).prop_map(
            move |(command, [a, b, c, d, z, ..], place, frame, current, int)| {
                let item = MissionItem {
                    params: [a, b, c, d],
                    place,
                    z,
                    seq: 1,
                    command,
                    target,
                    frame,
                    current,
                    autocontinue: 1,
                    mission_type: 0,
                };
                (if int { 73 } else { 39 }, item.payload().to_vec())
            }
        ),
    ]
}

proptest! {
    /// Each number of each of these messages that reaches a time, an index, a cast or the physics.
    #[test]
    fn no_number_of_a_message_stops_the_vehicle(
        sent in prop::collection::vec(with_wild_numbers(), 1..60), walls: bool, on_ground: bool,
    ) {
        let mut scenario = Scenario::default();
        scenario.dynamics.walls = walls;
        let mut bench = Bench::with(scenario, None);
        bench.vehicle.set_start(Start { on_ground, home: None });
        bench.vehicle.start_streams(Duration::from_millis(400), bench.now);
        bench.hello();
        let items = bench.send(&dialect::MISSION_COUNT_DATA { count: 3, target_system: 7, ..Default::default() });
        prop_assert!(!items.is_empty());
        for (k, (id, payload)) in sent.iter().enumerate() {
            let end = payload.iter().rposition(|&byte| byte != 0).map_or(1, |last| last + 1);
            bench.datagram(&frame(k as u8, *id, &payload[..end]));
            bench.now += Duration::from_millis(350);
            bench.vehicle.stream(bench.now);
            bench.vehicle.advance(bench.now);
            bench.vehicle.beat();
            bench.received();
            let uav = bench.vehicle.sim.world().uav;
            prop_assert!(uav.r.iter().chain(uav.v.iter()).all(|x| x.is_finite()), "{:?}", uav);
            let vertical = [bench.vehicle.height.altitude_m, bench.vehicle.height.climb_mps];
            prop_assert!(vertical.iter().all(|x| x.is_finite()), "{vertical:?}");
            prop_assert!(bench.vehicle.heading.yaw.is_finite());
        }
        let ping = dialect::PING_DATA { time_usec: 1, seq: 2, target_system: 0, target_component: 0 };
        prop_assert!(bench.send(&ping).iter().any(|p| p.is::<dialect::PING_DATA>()));
    }
}
