//! What the messages beside the percept say.

use super::*;
use crate::world::energy;

/// Asks for a message and gives its fields' packet.
fn requested(bench: &mut Bench, id: u32) -> Packet {
    let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, id as f32, (7, 1)));
    reply.into_iter().find(|packet| packet.id == id).expect("the message")
}

fn fly(bench: &mut Bench, ticks: u64, accel: [f32; 2], power: TxPower) {
    for _ in 0..ticks {
        bench.command(bench.vehicle.sim.tick().0, accel, power);
        bench.vehicle.advance(bench.now);
        bench.received();
    }
}

#[test]
fn attitude_is_that_of_the_acceleration_flown() {
    let mut bench = Bench::new();
    bench.hello();
    let attitude = |bench: &mut Bench| match requested(bench, 30).message() {
        Some(MavMessage::ATTITUDE(attitude)) => [attitude.roll, attitude.pitch, attitude.yaw],
        other => panic!("{other:?}"),
    };
    assert_eq!(attitude(&mut bench), [0.0; 3]);
    fly(&mut bench, 1, [5.0, -1000.0], TxPower::High);
    let [roll, pitch, _] = attitude(&mut bench);
    assert!((pitch.tan() * -9.806_65 - 5.0).abs() < 1e-3, "pitch {pitch}");
    // 1000 m/s² is flown at the limit: 3.5e-3 units per interval², 500 m a unit, 0.4 s an interval.
    let east = 9.806_65 * roll.tan() / pitch.cos();
    assert!((east + 3.5e-3 * 500.0 / 0.16).abs() < 1e-3, "roll {roll}");
}

#[test]
fn the_map_shows_the_local_position() {
    let mut bench = Bench::new();
    bench.hello();
    fly(&mut bench, 3, [5.0, 2.0], TxPower::High);
    let Some(MavMessage::GLOBAL_POSITION_INT(at)) = requested(&mut bench, 33).message() else { panic!() };
    let Some(MavMessage::HOME_POSITION(home)) = requested(&mut bench, 242).message() else { panic!() };
    let told = bench.vehicle.sim.telemetry();
    let metres = |degrees: i32| f64::from(degrees) * 1e-7 * 6_378_137.0 * std::f64::consts::PI / 180.0;
    let north = metres(at.lat - home.latitude) + f64::from(home.x);
    let east = metres(at.lon - home.longitude) * (f64::from(home.latitude) * 1e-7).to_radians().cos()
        + f64::from(home.y);
    assert!((north - f64::from(told.position[0])).abs() < 0.02, "{north}");
    assert!((east - f64::from(told.position[1])).abs() < 0.02, "{east}");
    assert_eq!((at.alt - home.altitude, at.relative_alt), (100_000, 100_000));
    assert!((f32::from(at.vx) / 100.0 - told.velocity[0]).abs() < 0.01);
    let Some(MavMessage::GPS_GLOBAL_ORIGIN(origin)) = requested(&mut bench, 49).message() else { panic!() };
    assert_eq!([origin.latitude, origin.longitude], geodesy::latitude_longitude([0.0; 2]));
    assert_eq!([home.x, home.y], [250.0, 50.0], "home is the start");
}

#[test]
fn the_battery_pays_for_propulsion_and_radio() {
    let mut bench = Bench::new();
    bench.hello();
    let mut joules = 0.0;
    for k in 0..100 {
        let power = if k % 2 == 0 { TxPower::High } else { TxPower::Low };
        fly(&mut bench, 1, [3.0, 1.0], power);
        let (sim, scenario) = (&bench.vehicle.sim, bench.vehicle.sim.scenario());
        let speed = sim.world().uav.v.norm() * scenario.scale.mps_per_speed();
        joules += 0.4 * (energy::propulsion_power(speed, &scenario.propulsion) + power.level());
    }
    let Some(MavMessage::BATTERY_STATUS(battery)) = requested(&mut bench, 147).message() else { panic!() };
    assert_eq!(battery.energy_consumed, (joules / 100.0_f64).round() as i32);
    assert_eq!(battery.current_consumed, (joules / 14.8 / 3.6).round() as i32);
    assert!(battery.fault_bitmask.is_empty());
    let Some(MavMessage::SYS_STATUS(status)) = requested(&mut bench, 1).message() else { panic!() };
    assert_eq!(status.battery_remaining, battery.battery_remaining);
    assert_eq!((status.voltage_battery, status.current_battery), (14_800, battery.current_battery));
    assert!(status.battery_remaining < 100);
}

#[test]
fn packets_that_the_radio_lost_are_in_the_status() {
    let mut scenario = Scenario::default();
    scenario.radio.b_dt = 1e-3;
    let mut bench = Bench::with(scenario, None);
    bench.hello();
    fly(&mut bench, 4, [1.0, 0.0], TxPower::Low);
    let Some(MavMessage::SYS_STATUS(status)) = requested(&mut bench, 1).message() else { panic!() };
    assert_eq!((status.errors_comm, status.drop_rate_comm), (4, 10_000));
}

/// CAMERA_INFORMATION and every camera command were UNSUPPORTED.
#[test]
fn the_camera_says_what_it_is_and_takes_pictures_on_command() {
    let mut bench = Bench::new();
    bench.hello();
    for component in [1, 100] {
        let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 259.0, (7, component)));
        assert_eq!(ids(&reply), [(component, 77), (100, 259)]);
        let Some(MavMessage::CAMERA_INFORMATION(told)) = reply[1].message() else { panic!("a camera") };
        assert_eq!((told.resolution_h, told.resolution_v), (100, 100));
        for (command, id) in [(521, 259), (522, 260), (525, 261), (527, 262)] {
            let mut datagram = Vec::new();
            let command = CommandLong {
                params: [1.0; 7],
                command,
                target: Target { system: 7, component },
                confirmation: 0,
            };
            bench.station.push_view(&mut datagram, &command);
            assert_eq!(ids(&bench.datagram(&datagram)), [(component, 77), (100, id)]);
        }
    }
    let start = |seconds, total| dialect::COMMAND_LONG_DATA {
        param2: seconds,
        param3: total,
        ..ask(MavCmd::MAV_CMD_IMAGE_START_CAPTURE, 0.0, (7, 100))
    };
    let one = bench.send(&start(0.0, 1.0));
    assert_eq!(ids(&one)[..3], [(100, 77), (100, 263), (1, 130)]);
    let mut images = Reassembler::default();
    assert!(one.iter().any(|packet| images.push(packet) == Some((Tick(0), bench.vehicle.sim.frame()))));
    assert_eq!(acks(&bench.send(&start(f32::NAN, 1.0)))[0].1.result, MavResult::MAV_RESULT_DENIED);

    let mut shots = bench.send(&start(0.8, 3.0));
    for _ in 0..10 {
        bench.vehicle.advance(bench.now);
        shots.extend(bench.received());
    }
    let taken: Vec<_> = shots
        .iter()
        .filter_map(|packet| match packet.message() {
            Some(MavMessage::CAMERA_IMAGE_CAPTURED(shot)) => Some((shot.image_index, shot.time_boot_ms)),
            _ => None,
        })
        .collect();
    assert_eq!(taken, [(1, 1000), (2, 1800), (3, 2600)]);
    let again = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_CAMERA_IMAGE_CAPTURE, 2.0, (7, 100)));
    assert_eq!(ids(&again), [(100, 77), (100, 263)]);
    let zoom = bench.send(&ask(MavCmd::MAV_CMD_SET_CAMERA_ZOOM, 0.0, (7, 100)));
    assert_eq!(acks(&zoom)[0].1.result, MavResult::MAV_RESULT_UNSUPPORTED);
    bench.vehicle.beat();
    assert!(ids(&bench.received()).contains(&(100, 0)), "stations look for its heartbeat");
}

/// VIDEO_START_CAPTURE was unsupported.
#[test]
fn a_video_is_the_picture_of_every_interval() {
    let mut bench = Bench::new();
    bench.hello();
    let status = |bench: &mut Bench| {
        let reply = bench.send(&ask(MavCmd::MAV_CMD_REQUEST_MESSAGE, 262.0, (7, 100)));
        let told = reply.iter().find_map(|packet| match packet.message() {
            Some(MavMessage::CAMERA_CAPTURE_STATUS(told)) => {
                Some((told.video_status, told.recording_time_ms))
            }
            _ => None,
        });
        told.unwrap()
    };
    let fly = |bench: &mut Bench| {
        let mut images = Reassembler::default();
        bench.vehicle.advance(bench.now);
        bench
            .received()
            .iter()
            .filter_map(|packet| images.push(packet))
            .map(|(tick, _)| tick)
            .collect::<Vec<_>>()
    };
    let started = bench.send(&ask(MavCmd::MAV_CMD_VIDEO_START_CAPTURE, 0.0, (7, 100)));
    assert_eq!(ids(&started)[..2], [(100, 77), (1, 130)]);
    for tick in 1..4 {
        assert_eq!(fly(&mut bench), [Tick(tick)]);
    }
    assert_eq!(status(&mut bench), (1, 1200));
    let stopped = bench.send(&ask(MavCmd::MAV_CMD_VIDEO_STOP_CAPTURE, 0.0, (7, 100)));
    assert_eq!(acks(&stopped)[0].1.result, MavResult::MAV_RESULT_ACCEPTED);
    assert_eq!(fly(&mut bench), []);
    assert_eq!(status(&mut bench), (0, 0));
}
