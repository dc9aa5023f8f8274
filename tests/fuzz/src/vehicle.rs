//! The whole vehicle: frames whose form is right and whose numbers are anything, and bytes that are none.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::LazyLock;
use std::time::Duration;

use crpl_sitl::vehicle::{Start, Vehicle};
use crpl_sitl::{Scenario, Sim};

use crate::bytes::{Choices, frame};

/// Messages that the vehicle looks into.
const IDS: [u32; 32] = [
    0, 2, 4, 11, 20, 21, 22, 23, 37, 38, 39, 40, 41, 43, 44, 45, 47, 51, 66, 73, 75, 76, 84, 85, 86, 110,
    111, 130, 131, 253, 256, 345,
];

/// Worlds to fly in: the paper's, and one without walls.
static WORLDS: LazyLock<[Scenario; 2]> = LazyLock::new(|| [Scenario::default(), Scenario::default().open()]);

/// The first byte chooses the vehicle. Then, each a byte and what it asks for: frames, bytes, time.
pub fn vehicle(data: &[u8]) {
    let mut choices = Choices::new(data);
    let begins = choices.byte();
    let sim = Sim::new(WORLDS[usize::from(begins & 1)].clone(), 0);
    let mut vehicle = Vehicle::new(sim, 1, (begins & 2 != 0).then_some(9));
    vehicle.set_start(Start { on_ground: begins & 4 != 0, home: None });
    if begins & 8 != 0 {
        vehicle.set_epoch(Some(Duration::from_secs(1_700_000_000)));
    }
    let mut now = Duration::ZERO;
    if begins & 16 != 0 {
        vehicle.start_streams(Duration::from_millis(400), now);
    }
    let mut sequence = 0;
    while !choices.is_empty() {
        let what = choices.byte();
        let from = SocketAddr::from((Ipv4Addr::LOCALHOST, 9000 + u16::from(what >> 6)));
        match what & 7 {
            0..=4 => {
                let id = IDS[usize::from(choices.byte()) % IDS.len()];
                let length = usize::from(choices.byte());
                let payload = choices.some(length);
                sequence += 1;
                let source = (255 - (what >> 7), 190);
                vehicle.datagram(&frame(sequence as u8, source, id, payload), from, now);
            }
            5 => {
                let length = usize::from(choices.byte());
                vehicle.datagram(choices.some(length), from, now);
            }
            6 => {
                vehicle.advance(now);
                vehicle.beat();
            }
            _ => {
                // Times to come from a millisecond to 18 hours: a process may be halted.
                now += Duration::from_millis(u64::from(choices.short()) << (what >> 4 & 3) * 4);
                vehicle.stream(now);
            }
        }
        let mut sent = 0;
        while let Some((_, datagram)) = vehicle.poll() {
            sent += datagram.len();
        }
        assert!(sent < 4 << 20, "{sent} bytes for one step");
    }
    let uav = vehicle.sim().world().uav;
    assert!(uav.r.iter().chain(uav.v.iter()).all(|x| x.is_finite()), "{uav:?}");
}
