//! Each view against the `mavlink` crate's type of the same message: the crate writes, the view reads, and
//! what the view writes are the same bytes.

use proptest::prelude::*;

use super::command::{CommandAck, CommandInt, CommandLong, SetMode};
use super::image::{EncapsulatedData, Handshake, Tunnel};
use super::mission::{
    MissionAck, MissionCount, MissionItem, MissionList, MissionPartialList, MissionRequest,
    MissionSetCurrent, Place, address_of,
};
use super::param::{ParamRequestList, ParamRequestRead, ParamSet, ParamValue};
use super::service::{FileTransfer, Ping, RequestDataStream, SetupSigning, Timesync};
use super::setpoint::{SetPositionTargetGlobalInt, SetPositionTargetLocalNed};
use super::status::{AutopilotVersion, Heartbeat, MessageInterval, StatusText};
use super::telemetry::{
    DebugVect, GlobalPositionInt, LocalPositionNed, NamedValueFloat, PositionTargetLocalNed,
};
use super::*;
use crate::link::decoder::Decoder;
use crate::link::dialect::*;
use crate::link::encoder::Encoder;
use crate::link::packet::Packet;

const TARGET: Target = Target { system: 7, component: 68 };

fn packet<M: MessageData>(message: &M) -> Packet {
    let mut datagram = Vec::new();
    Encoder::new(1, 1).push(&mut datagram, message);
    Decoder::default().datagram(&datagram).remove(0)
}

/// The crate's message reads as `fields`, and `fields` write the crate's bytes. A struct literal names all
/// fields, so none is left out.
fn agree<M: MessageData, V: View + PartialEq + std::fmt::Debug>(message: &M, fields: V) {
    let theirs = packet(message);
    assert_eq!(V::of(&theirs), Some(fields), "{}", M::NAME);
    let mut ours = Vec::new();
    let fields = V::read(theirs.payload());
    Encoder::new(1, 1).push_payload::<M>(&mut ours, &fields.payload());
    assert_eq!(ours[..], theirs.raw[..], "{}", M::NAME);
}

#[test]
fn status() {
    let message = STATUSTEXT_DATA {
        severity: MavSeverity::MAV_SEVERITY_ERROR,
        text: "said".into(),
        id: 0x0201,
        chunk_seq: 3,
    };
    agree(&message, StatusText { severity: 3, text: "said".into(), id: 0x0201, chunk_seq: 3 });
    let message = HEARTBEAT_DATA {
        custom_mode: 0x0403_0201,
        mavtype: MavType::MAV_TYPE_GCS,
        autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
        base_mode: MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED,
        system_status: MavState::MAV_STATE_CRITICAL,
        mavlink_version: 3,
    };
    let fields = Heartbeat {
        custom_mode: 0x0403_0201,
        kind: 6,
        autopilot: 12,
        base_mode: 128,
        system_status: 5,
        mavlink_version: 3,
    };
    agree(&message, fields);
    let capabilities = MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2;
    agree(
        &AUTOPILOT_VERSION_DATA { capabilities, ..Default::default() },
        AutopilotVersion { capabilities: 8192 },
    );
    agree(
        &MESSAGE_INTERVAL_DATA { interval_us: -1, message_id: 300 },
        MessageInterval { interval_us: -1, message_id: 300 },
    );
}

#[test]
fn telemetry() {
    let (x, y, z, vx, vy, vz) = (1.5, -2.5, 3.5, -4.5, 5.5, -6.5);
    agree(
        &LOCAL_POSITION_NED_DATA { time_boot_ms: 1000, x, y, z, vx, vy, vz },
        LocalPositionNed { time_boot_ms: 1000, position: [x, y, z], velocity: [vx, vy, vz] },
    );
    let global = GLOBAL_POSITION_INT_DATA {
        time_boot_ms: 1000,
        lat: 473_977_420,
        lon: -85_455_940,
        alt: 588_000,
        relative_alt: -100_000,
        vx: 1,
        vy: -2,
        vz: 3,
        hdg: 65_535,
    };
    let fields = GlobalPositionInt {
        time_boot_ms: 1000,
        place: [473_977_420, -85_455_940],
        heights: [588_000, -100_000],
        velocity: [1, -2, 3],
        heading: 65_535,
    };
    agree(&global, fields);
    let message = POSITION_TARGET_LOCAL_NED_DATA {
        time_boot_ms: 1000,
        x,
        y,
        z,
        vx,
        vy,
        vz,
        afx: 7.5,
        afy: 8.5,
        afz: 9.5,
        yaw: 10.5,
        yaw_rate: 11.5,
        type_mask: PositionTargetTypemask::from_bits_retain(3135),
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
    };
    let fields = PositionTargetLocalNed {
        time_boot_ms: 1000,
        position: [x, y, z],
        velocity: [vx, vy, vz],
        acceleration: [7.5, 8.5, 9.5],
        yaw: [10.5, 11.5],
        type_mask: 3135,
        coordinate_frame: 1,
    };
    agree(&message, fields);
    agree(
        &DEBUG_VECT_DATA { time_usec: 1 << 40, x, y, z, name: "OBSTACLE_2".into() },
        DebugVect { time_usec: 1 << 40, vector: [x, y, z], name: "OBSTACLE_2".into() },
    );
    agree(
        &NAMED_VALUE_FLOAT_DATA { time_boot_ms: 1000, value: x, name: "SNR_DB".into() },
        NamedValueFloat { time_boot_ms: 1000, value: x, name: "SNR_DB".into() },
    );
}

#[test]
fn setpoints() {
    let message = SET_POSITION_TARGET_LOCAL_NED_DATA {
        time_boot_ms: 1000,
        x: 1.5,
        y: 2.5,
        z: 3.5,
        vx: 4.5,
        vy: 5.5,
        vz: 6.5,
        afx: 7.5,
        afy: 8.5,
        afz: 9.5,
        yaw: 10.5,
        yaw_rate: 11.5,
        type_mask: PositionTargetTypemask::from_bits_retain(3135),
        target_system: TARGET.system,
        target_component: TARGET.component,
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
    };
    let fields = SetPositionTargetLocalNed {
        time_boot_ms: 1000,
        position: [1.5, 2.5, 3.5],
        velocity: [4.5, 5.5, 6.5],
        acceleration: [7.5, 8.5, 9.5],
        yaw: [10.5, 11.5],
        type_mask: 3135,
        target: TARGET,
        coordinate_frame: 1,
    };
    agree(&message, fields);
    let message = SET_POSITION_TARGET_GLOBAL_INT_DATA {
        time_boot_ms: 1000,
        lat_int: 473_977_420,
        lon_int: -85_455_940,
        alt: 3.5,
        vx: 4.5,
        vy: 5.5,
        vz: 6.5,
        afx: 7.5,
        afy: 8.5,
        afz: 9.5,
        yaw: 10.5,
        yaw_rate: 11.5,
        type_mask: PositionTargetTypemask::from_bits_retain(3135),
        target_system: TARGET.system,
        target_component: TARGET.component,
        coordinate_frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    };
    let fields = SetPositionTargetGlobalInt {
        time_boot_ms: 1000,
        place: [473_977_420, -85_455_940],
        altitude: 3.5,
        velocity: [4.5, 5.5, 6.5],
        acceleration: [7.5, 8.5, 9.5],
        yaw: [10.5, 11.5],
        type_mask: 3135,
        target: TARGET,
        coordinate_frame: 6,
    };
    agree(&message, fields);
}

#[test]
fn commands() {
    let Target { system: target_system, component: target_component } = TARGET;
    let (param1, param2, param3, param4) = (1.5, 2.5, 3.5, 4.5);
    let command = MavCmd::MAV_CMD_USER_1;
    let message = COMMAND_LONG_DATA {
        param1,
        param2,
        param3,
        param4,
        param5: 5.5,
        param6: 6.5,
        param7: 7.5,
        command,
        target_system,
        target_component,
        confirmation: 9,
    };
    let fields = CommandLong {
        params: [1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5],
        command: 31010,
        target: TARGET,
        confirmation: 9,
    };
    agree(&message, fields);
    let message = COMMAND_INT_DATA {
        param1,
        param2,
        param3,
        param4,
        x: -5,
        y: 6,
        z: 7.5,
        command,
        target_system,
        target_component,
        frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT,
        current: 8,
        autocontinue: 9,
    };
    let fields = CommandInt {
        params: [1.5, 2.5, 3.5, 4.5],
        place: [-5, 6],
        z: 7.5,
        command: 31010,
        target: TARGET,
        frame: 3,
        current: 8,
        autocontinue: 9,
    };
    agree(&message, fields);
    let message = COMMAND_ACK_DATA {
        command,
        result: MavResult::MAV_RESULT_DENIED,
        progress: 50,
        result_param2: -3,
        target_system,
        target_component,
    };
    let fields = CommandAck { command: 31010, result: 2, progress: 50, result_param2: -3, target: TARGET };
    agree(&message, fields);
    let base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
    agree(
        &SET_MODE_DATA { custom_mode: 17, target_system, base_mode },
        SetMode { custom_mode: 17, system: TARGET.system, base_mode: 1 },
    );
}

#[test]
fn parameters() {
    let Target { system: target_system, component: target_component } = TARGET;
    let (param_type, param_value) = (MavParamType::MAV_PARAM_TYPE_INT32, -2.5_f32);
    let (value, kind) = (param_value.to_le_bytes(), 6);
    // As long as names can be, so that a byte too few would show.
    let name = "ABCDEFGHIJKLMNOP";
    agree(
        &PARAM_VALUE_DATA {
            param_value,
            param_count: 513,
            param_index: 258,
            param_id: name.into(),
            param_type,
        },
        ParamValue { value, count: 513, index: 258, name: name.into(), kind },
    );
    agree(
        &PARAM_SET_DATA { param_value, target_system, target_component, param_id: name.into(), param_type },
        ParamSet { value, target: TARGET, name: name.into(), kind },
    );
    agree(
        &PARAM_REQUEST_READ_DATA { param_index: -1, target_system, target_component, param_id: name.into() },
        ParamRequestRead { index: -1, target: TARGET, name: name.into() },
    );
    agree(&PARAM_REQUEST_LIST_DATA { target_system, target_component }, ParamRequestList { target: TARGET });
}

#[test]
fn missions() {
    let Target { system: target_system, component: target_component } = TARGET;
    let mission_type = MavMissionType::MAV_MISSION_TYPE_RALLY;
    let list = MissionList { target: TARGET, mission_type: 2 };
    agree(&MISSION_REQUEST_LIST_DATA { target_system, target_component, mission_type }, list);
    agree(&MISSION_CLEAR_ALL_DATA { target_system, target_component, mission_type }, list);
    agree(
        &MISSION_COUNT_DATA { count: 513, target_system, target_component, mission_type, opaque_id: 1 << 30 },
        MissionCount { count: 513, target: TARGET, mission_type: 2, opaque_id: 1 << 30 },
    );
    let request = MissionRequest { seq: 513, target: TARGET, mission_type: 2 };
    agree(&MISSION_REQUEST_INT_DATA { seq: 513, target_system, target_component, mission_type }, request);
    agree(&MISSION_REQUEST_DATA { seq: 513, target_system, target_component, mission_type }, request);
    let (start_index, end_index) = (258, -1);
    let part = MissionPartialList { first: 258, last: -1, target: TARGET, mission_type: 2 };
    agree(
        &MISSION_WRITE_PARTIAL_LIST_DATA {
            start_index,
            end_index,
            target_system,
            target_component,
            mission_type,
        },
        part,
    );
    agree(
        &MISSION_REQUEST_PARTIAL_LIST_DATA {
            start_index,
            end_index,
            target_system,
            target_component,
            mission_type,
        },
        part,
    );
    let mavtype = MavMissionResult::MAV_MISSION_DENIED;
    agree(
        &MISSION_ACK_DATA { target_system, target_component, mavtype, mission_type, opaque_id: 1 << 30 },
        MissionAck { target: TARGET, result: 14, mission_type: 2, opaque_id: 1 << 30 },
    );
    agree(
        &MISSION_SET_CURRENT_DATA { seq: 513, target_system, target_component },
        MissionSetCurrent { seq: 513, target: TARGET },
    );
    let others = [
        packet(&MISSION_CLEAR_ALL_DATA { target_system, target_component, mission_type }),
        packet(&MISSION_COUNT_DATA { target_system, target_component, mission_type, ..Default::default() }),
        packet(&MISSION_REQUEST_DATA { seq: 1, target_system, target_component, mission_type }),
        packet(&MISSION_ACK_DATA { target_system, target_component, mission_type, ..Default::default() }),
    ];
    assert!(others.iter().all(|packet| address_of(packet) == Some((TARGET, 2))));
    let current = packet(&MISSION_SET_CURRENT_DATA { seq: 1, target_system, target_component });
    assert_eq!(address_of(&current), Some((TARGET, 0)));
    assert_eq!(address_of(&packet(&HEARTBEAT_DATA::default())), None);
}

#[test]
fn mission_items_in_both_forms() {
    let item = MISSION_ITEM_INT_DATA {
        param1: 1.5,
        param2: 2.5,
        param3: 3.5,
        param4: 4.5,
        x: -5,
        y: 6,
        z: 7.5,
        seq: 513,
        command: MavCmd::MAV_CMD_DO_JUMP,
        target_system: TARGET.system,
        target_component: TARGET.component,
        frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT,
        current: 8,
        autocontinue: 9,
        mission_type: MavMissionType::MAV_MISSION_TYPE_RALLY,
    };
    let fields = MissionItem {
        params: [1.5, 2.5, 3.5, 4.5],
        place: [-5, 6],
        z: 7.5,
        seq: 513,
        command: 177,
        target: TARGET,
        frame: 3,
        current: 8,
        autocontinue: 9,
        mission_type: 2,
    };
    agree(&item, fields);
    assert_eq!(MissionItem::with_place(&packet(&item)), Some((fields, Place::Integers([-5, 6]))));
    assert_eq!(address_of(&packet(&item)), Some((TARGET, 2)));
    let MISSION_ITEM_INT_DATA { param1, param2, param3, param4, z, seq, command, .. } = item;
    let MISSION_ITEM_INT_DATA { target_system, target_component, frame, current, .. } = item;
    let float = MISSION_ITEM_DATA {
        param1,
        param2,
        param3,
        param4,
        x: -5.5,
        y: 6.5,
        z,
        seq,
        command,
        target_system,
        target_component,
        frame,
        current,
        autocontinue: 9,
        mission_type: item.mission_type,
    };
    let (fields, place) = MissionItem::with_place(&packet(&float)).unwrap();
    assert_eq!(place, Place::Floats([-5.5, 6.5]));
    agree(&float, fields);
    assert_eq!(MissionItem { place: [-5, 6], ..fields }, MissionItem::of(&packet(&item)).unwrap());
}

#[test]
fn images() {
    let message = DATA_TRANSMISSION_HANDSHAKE_DATA {
        size: 70_000,
        width: 513,
        height: 514,
        packets: 515,
        mavtype: MavlinkDataStreamType::MAVLINK_DATA_STREAM_IMG_PNG,
        payload: 253,
        jpg_quality: 9,
    };
    let fields = Handshake {
        size: 70_000,
        width: 513,
        height: 514,
        packets: 515,
        kind: MavlinkDataStreamType::MAVLINK_DATA_STREAM_IMG_PNG as u8,
        payload: 253,
        quality: 9,
    };
    agree(&message, fields);
    let data = std::array::from_fn(|k| k as u8 + 1);
    agree(&ENCAPSULATED_DATA_DATA { seqnr: 513, data }, EncapsulatedData { seq: 513, data });
    let payload = std::array::from_fn(|k| k as u8 + 1);
    let message = TUNNEL_DATA {
        payload_type: MavTunnelPayloadType::default(),
        target_system: 2,
        target_component: 3,
        payload_length: 9,
        payload,
    };
    agree(&message, Tunnel { kind: 0, target: [2, 3], length: 9, payload });
}

#[test]
fn services() {
    let Target { system: target_system, component: target_component } = TARGET;
    agree(
        &PING_DATA { time_usec: 1 << 40, seq: 1 << 20, target_system, target_component },
        Ping { time_usec: 1 << 40, seq: 1 << 20, target: TARGET },
    );
    agree(
        &TIMESYNC_DATA { tc1: -1 << 40, ts1: 1 << 50, target_system, target_component },
        Timesync { tc1: -1 << 40, ts1: 1 << 50, target: TARGET },
    );
    let req_stream_id = MavDataStream::MAV_DATA_STREAM_POSITION;
    agree(
        &REQUEST_DATA_STREAM_DATA {
            req_message_rate: 513,
            target_system,
            target_component,
            req_stream_id,
            start_stop: 1,
        },
        RequestDataStream { rate: 513, target: TARGET, stream: 6, start: 1 },
    );
    let secret_key = std::array::from_fn(|k| k as u8 + 1);
    agree(
        &SETUP_SIGNING_DATA { initial_timestamp: 1 << 40, target_system, target_component, secret_key },
        SetupSigning { initial_timestamp: 1 << 40, target: TARGET, key: secret_key },
    );
    // The payload format of MAVLink FTP: byte 7 of it is padding.
    let payload = std::array::from_fn(|k| if k == 7 { 0 } else { k as u8 + 1 });
    let fields = FileTransfer {
        network: 9,
        target: TARGET,
        seq: 0x0201,
        session: 3,
        opcode: 4,
        size: 5,
        request: 6,
        burst_complete: 7,
        offset: 0x0C0B_0A09,
        data: std::array::from_fn(|k| k as u8 + 13),
    };
    agree(
        &FILE_TRANSFER_PROTOCOL_DATA { target_network: 9, target_system, target_component, payload },
        fields,
    );
}

#[test]
fn texts_end_at_their_first_nul_and_are_cut_to_fit() {
    assert_eq!(Text::<4>::from("AB").lossy(), "AB");
    assert_eq!(Text::<4>::from("ABCDE").lossy(), "ABCD");
    assert_eq!(Text(*b"A\0B").lossy(), "A");
    assert_eq!(Text([b'A', 0xFF]).lossy(), "A\u{FFFD}");
}

proptest! {
    #[test]
    fn what_was_cut_off_reads_as_zeros(length in 0usize..60, bytes: [u8; 32]) {
        let whole = [bytes, bytes].concat();
        let mut padded = whole[..length.min(53)].to_vec();
        padded.resize(53, 0);
        let cut = SetPositionTargetLocalNed::read(&whole[..length.min(53)]);
        prop_assert_eq!(cut.payload(), SetPositionTargetLocalNed::read(&padded).payload());
        prop_assert_eq!(&cut.payload()[..53], &padded[..]);
    }
}
