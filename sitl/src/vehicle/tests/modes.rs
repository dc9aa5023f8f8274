//! Mode, arming, takeoff and landing.

use super::*;

/// Result, and the text if there is one.
fn told(bench: &mut Bench, ask: &impl MessageData) -> (Option<MavResult>, Option<String>) {
    bench.now += Duration::from_secs(2);
    let reply = bench.send(ask);
    let text = reply.iter().find_map(|packet| match packet.message() {
        Some(MavMessage::STATUSTEXT(text)) => Some(text.text.to_str().unwrap().to_owned()),
        _ => None,
    });
    (acks(&reply).first().map(|(_, ack)| ack.result), text)
}

fn long(command: MavCmd, param1: f32, param2: f32, param7: f32) -> dialect::COMMAND_LONG_DATA {
    dialect::COMMAND_LONG_DATA { param2, param7, ..ask(command, param1, (7, 1)) }
}

const ACCEPTED: Option<MavResult> = Some(MavResult::MAV_RESULT_ACCEPTED);
const DENIED: Option<MavResult> = Some(MavResult::MAV_RESULT_DENIED);
const FAILED: Option<MavResult> = Some(MavResult::MAV_RESULT_FAILED);

#[test]
fn it_is_armed_and_cannot_be_disarmed_in_the_air() {
    let mut bench = Bench::new();
    bench.hello();
    let arm = |p1, p2| long(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, p1, p2, 0.0);
    assert_eq!(told(&mut bench, &arm(1.0, 0.0)), (ACCEPTED, None));
    let (result, text) = told(&mut bench, &arm(0.0, 0.0));
    assert_eq!((result, text.as_deref()), (FAILED, Some("disarming refused: in the air")));
    let (result, text) = told(&mut bench, &arm(0.0, 21_196.0));
    assert_eq!((result, text.as_deref()), (FAILED, Some("disarming refused: a planar model cannot fall")));
    for odd in [7.5, -1.0, f32::NAN] {
        assert_eq!(told(&mut bench, &arm(odd, 0.0)).0, DENIED, "{odd}");
    }
    let heartbeat = messages::autopilot_heartbeat();
    assert!(heartbeat.base_mode.contains(dialect::MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED));
}

#[test]
fn guided_is_the_only_mode() {
    let mut bench = Bench::new();
    bench.hello();
    let mode = |p1, p2| long(MavCmd::MAV_CMD_DO_SET_MODE, p1, p2, 0.0);
    assert_eq!(told(&mut bench, &mode(1.0, 4.0)), (ACCEPTED, None));
    assert_eq!(told(&mut bench, &mode(209.0, 4.0)), (ACCEPTED, None), "other flags may be set too");
    let (result, text) = told(&mut bench, &mode(1.0, 6.0));
    assert_eq!((result, text.as_deref()), (DENIED, Some("mode 6 refused: only GUIDED (4)")));
    for (p1, p2) in [(0.0, 4.0), (1.0, f32::NAN), (f32::NAN, 4.0), (1.0, 4.5)] {
        assert_eq!(told(&mut bench, &mode(p1, p2)).0, DENIED, "{p1} {p2}");
    }
}

/// The old message, which is acknowledged by its own number.
#[test]
fn set_mode_is_answered_too() {
    let mut bench = Bench::new();
    bench.hello();
    for (custom_mode, result) in [(4, MavResult::MAV_RESULT_ACCEPTED), (3, MavResult::MAV_RESULT_DENIED)] {
        let base_mode = dialect::MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
        let reply = bench.send(&dialect::SET_MODE_DATA { custom_mode, target_system: 7, base_mode });
        let ack = reply.iter().find(|p| p.is::<dialect::COMMAND_ACK_DATA>()).unwrap().fields();
        assert_eq!((ack.u16(0), ack.u8(2)), (11, result as u8));
    }
}

#[test]
fn takeoff_and_landing_are_answered_as_a_planar_vehicle_can() {
    let mut bench = Bench::new();
    bench.hello();
    let takeoff = |height| long(MavCmd::MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, height);
    assert_eq!(told(&mut bench, &takeoff(100.0)), (ACCEPTED, None));
    let (result, text) = told(&mut bench, &takeoff(10.0));
    assert_eq!((result, text.as_deref()), (DENIED, Some("takeoff refused: flies at 100 m, always")));
    assert_eq!(told(&mut bench, &takeoff(f32::NAN)).0, DENIED);
    let (target_system, target_component, command) = (7, 1, MavCmd::MAV_CMD_NAV_TAKEOFF);
    let mut int = dialect::COMMAND_INT_DATA {
        z: 100.0,
        command,
        target_system,
        target_component,
        frame: dialect::MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT,
        ..Default::default()
    };
    assert_eq!(told(&mut bench, &int), (ACCEPTED, None));
    int.frame = dialect::MavFrame::MAV_FRAME_GLOBAL;
    assert_eq!(told(&mut bench, &int).0, DENIED, "100 m above the sea is below the ground");
    let (result, text) = told(&mut bench, &long(MavCmd::MAV_CMD_NAV_LAND, 0.0, 0.0, 0.0));
    assert_eq!(result, Some(MavResult::MAV_RESULT_UNSUPPORTED));
    assert_eq!(text.as_deref(), Some("landing refused: this vehicle is planar"));
    assert_eq!(bench.vehicle.tally().unsupported, 1);
}
