//! Every message that the vehicle can be asked for by number, one row each. Knows what a message
//! says, not when it goes.
//!
//! | message | id | from | goes | in group of REQUEST_DATA_STREAM |
//! |---|---|---|---|---|
//! | HEARTBEAT | 0 | 1, 68, 100 | 1 Hz, always | |
//! | LOCAL_POSITION_NED | 32 | 1 | in every percept | |
//! | POSITION_TARGET_LOCAL_NED | 85 | 1 | in every percept | |
//! | DEBUG_VECT `OBSTACLE` | 250 | 1 | in every percept | |
//! | NAMED_VALUE_FLOAT `SNR_DB`, `TXP`, `OUTAGE` | 251 | 68 | in every percept from tick 1 on | |
//! | RADIO_STATUS | 109 | 68 | in every percept from tick 1 on | |
//! | ATTITUDE: the tilt that gives the acceleration flown, and the heading | 30 | 1 | 4 Hz | EXTRA1 |
//! | GLOBAL_POSITION_INT: the local position on Earth | 33 | 1 | 4 Hz | POSITION |
//! | ATTITUDE_QUATERNION: the same | 31 | 1 | 4 Hz | EXTRA1 |
//! | VFR_HUD | 74 | 1 | 4 Hz | EXTRA2 |
//! | NAV_CONTROLLER_OUTPUT: way to the point that it flies to by itself | 62 | 1 | 2 Hz | EXTRA1 |
//! | GPS_RAW_INT: the truth, as a 3D fix | 24 | 1 | 2 Hz | EXTENDED_STATUS |
//! | LINK_NODE_STATUS: traffic with all peers; pymavlink, which does not know it, would call it a loss | 8 | 1 | on request | |
//! | SYS_STATUS: battery; radio packets lost | 1 | 1 | 1 Hz | EXTENDED_STATUS |
//! | SYSTEM_TIME | 2 | 1 | 1 Hz | EXTRA3 |
//! | EXTENDED_SYS_STATE | 245 | 1 | 1 Hz | EXTENDED_STATUS |
//! | BATTERY_STATUS: energy really spent | 147 | 1 | 0.5 Hz | EXTRA3 |
//! | MISSION_CURRENT | 42 | 1 | 1 Hz | EXTENDED_STATUS |
//! | HOME_POSITION: the start, to which RTL returns | 242 | 1 | 0.5 Hz | EXTRA3 |
//! | GPS_GLOBAL_ORIGIN: the local frame's | 49 | 1 | on request | |
//! | AUTOPILOT_VERSION | 148 | 1 | on request | |
//! | PROTOCOL_VERSION | 300 | 1 | on request | |
//! | FENCE_STATUS | 162 | 1 | on request | |
//! | CAMERA_INFORMATION, CAMERA_SETTINGS, STORAGE_INFORMATION, CAMERA_CAPTURE_STATUS | 259 to 262 | 100 | on request | |
//!
//! The rates are those of the real-time pace; in lockstep only heartbeats and percepts go by
//! themselves. Time stamps are those of the tick whose state is told; SYSTEM_TIME's 1970 part is the
//! wall's.

use std::time::Duration;

use nalgebra::Vector2;

use super::battery::Battery;
use super::conduct::Conduct;
use super::geodesy::{self, Site};
use super::heading::Heading;
use super::height::Height;
use crate::camera::SIDE;
use crate::link::dialect::{
    self, CameraCapFlags, GpsFixType, MavAutopilot, MavLandedState, MavModeFlag, MavProtocolCapability,
    MavState, MavSysStatusSensor, MavSysStatusSensorExtended, MavType, MavVtolState, StorageStatus,
};
use crate::link::encoder::Encoder;
use crate::link::wire::{self, Clock};
use crate::link::{AUTOPILOT, CAMERA, MessageData, RADIO};
use crate::radio::Fates;
use crate::radio::message::Telemetry;
use crate::units::Scale;

/// Throttle of a hover, percent: ArduCopter's MOT_THST_HOVER is 0.35.
const HOVER_THROTTLE: f32 = 35.0;

/// What messages are made of: the vehicle at one moment.
#[derive(Debug, Clone)]
pub(super) struct VehicleState {
    pub report: Telemetry,
    pub clock: Clock,
    pub system: u8,
    /// Flown: north, east, m/s².
    pub accel: [f32; 2],
    pub conduct: Conduct,
    pub height: Height,
    pub heading: Heading,
    pub site: Site,
    pub shots: dialect::CAMERA_CAPTURE_STATUS_DATA,
    pub fence: dialect::FENCE_STATUS_DATA,
    pub system_status: MavState,
    pub mission: dialect::MISSION_CURRENT_DATA,
    /// Latitude and longitude of the start, 1e-7 degrees.
    pub launch: [i32; 2],
    /// The same, north and east, m.
    pub home: [f32; 2],
    pub battery: Battery,
    pub fates: Fates,
    /// Where it goes by itself, paper x/y.
    pub target: Option<Vector2<f64>>,
    pub scale: Scale,
    pub traffic: dialect::LINK_NODE_STATUS_DATA,
    /// Since 1970, if known.
    pub unix: Option<Duration>,
}

/// When a message goes without being asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Goes {
    /// Once a second on the wall, in every pace.
    Heartbeat,
    /// With every control interval.
    Percept,
    /// In real time so many times a second; with others of its group.
    Stream(f64, Group),
    /// Only if somebody asks.
    OnRequest,
}

/// Groups of REQUEST_DATA_STREAM, by MAV_DATA_STREAM.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Group {
    ExtendedStatus = 2,
    Position = 6,
    Extra1 = 10,
    Extra2 = 11,
    Extra3 = 12,
}

impl Group {
    /// Whether a request for this MAV_DATA_STREAM means the group; 0 is all.
    pub fn is(self, stream: u8) -> bool {
        stream == 0 || stream == self as u8
    }
}

/// A message that the vehicle has.
pub(super) struct Row {
    pub id: u32,
    pub component: u8,
    pub goes: Goes,
    push: fn(&VehicleState, &mut Encoder, &mut Vec<u8>),
}

impl Row {
    /// Whether there is something to tell: the radio has no report before its first interval.
    pub fn ready(&self, state: &VehicleState) -> bool {
        self.component != RADIO || self.goes != Goes::Percept || state.report.link.is_some()
    }

    /// Appends the message, if it is ready. `encoder` must be that of [`Row::component`].
    pub fn push(&self, state: &VehicleState, encoder: &mut Encoder, datagram: &mut Vec<u8>) {
        if self.ready(state) {
            (self.push)(state, encoder, datagram);
        }
    }
}

/// The row with this id that a component answers for: the radio for its own, the autopilot for all.
pub(super) fn row(id: u32, component: u8) -> Option<&'static Row> {
    let own = ROWS.iter().find(|row| row.id == id && row.component == component);
    own.or_else(|| ROWS.iter().find(|row| row.id == id && component == AUTOPILOT))
}

/// A row of the autopilot whose message is made by a function of the state.
macro_rules! row {
    ($message:ident, $goes:expr, $make:expr) => {
        Row {
            id: dialect::$message::ID,
            component: AUTOPILOT,
            goes: $goes,
            push: |state, encoder, datagram| encoder.push(datagram, &$make(state)),
        }
    };
}

/// The same of the camera, on request.
macro_rules! camera_row {
    ($message:ident, $make:expr) => {
        Row { component: CAMERA, ..row!($message, Goes::OnRequest, $make) }
    };
}

/// A message of the percept: the same bytes as in the report.
const fn percept(id: u32, component: u8, push: fn(&VehicleState, &mut Encoder, &mut Vec<u8>)) -> Row {
    Row { id, component, goes: Goes::Percept, push }
}

/// All rows, in the order of the table above.
pub(super) static ROWS: &[Row] = &[
    row!(HEARTBEAT_DATA, Goes::Heartbeat, |state: &VehicleState| {
        autopilot_heartbeat(&state.conduct, state.system_status)
    }),
    Row { component: RADIO, ..row!(HEARTBEAT_DATA, Goes::Heartbeat, |_: &VehicleState| radio_heartbeat()) },
    percept(dialect::LOCAL_POSITION_NED_DATA::ID, AUTOPILOT, |state, encoder, datagram| {
        wire::push_position(&state.report, &state.clock, state.height.ned(), encoder, datagram);
    }),
    percept(dialect::POSITION_TARGET_LOCAL_NED_DATA::ID, AUTOPILOT, |state, encoder, datagram| {
        wire::push_held(&state.report, &state.clock, encoder, datagram);
    }),
    percept(dialect::DEBUG_VECT_DATA::ID, AUTOPILOT, |state, encoder, datagram| {
        wire::push_obstacles(&state.report, &state.clock, encoder, datagram);
    }),
    percept(dialect::NAMED_VALUE_FLOAT_DATA::ID, RADIO, |state, encoder, datagram| {
        if let Some(link) = &state.report.link {
            wire::push_link_values(link, state.boot_ms(), encoder, datagram);
        }
    }),
    percept(dialect::RADIO_STATUS_DATA::ID, RADIO, |state, encoder, datagram| {
        if let Some(link) = &state.report.link {
            wire::push_radio_status(link, encoder, datagram);
        }
    }),
    row!(ATTITUDE_DATA, Goes::Stream(4.0, Group::Extra1), attitude),
    row!(GLOBAL_POSITION_INT_DATA, Goes::Stream(4.0, Group::Position), global_position),
    row!(ATTITUDE_QUATERNION_DATA, Goes::Stream(4.0, Group::Extra1), quaternion),
    row!(VFR_HUD_DATA, Goes::Stream(4.0, Group::Extra2), hud),
    row!(NAV_CONTROLLER_OUTPUT_DATA, Goes::Stream(2.0, Group::Extra1), navigation),
    row!(GPS_RAW_INT_DATA, Goes::Stream(2.0, Group::ExtendedStatus), gps),
    row!(LINK_NODE_STATUS_DATA, Goes::OnRequest, |state: &VehicleState| state.traffic.clone()),
    row!(SYS_STATUS_DATA, Goes::Stream(1.0, Group::ExtendedStatus), system_status),
    row!(SYSTEM_TIME_DATA, Goes::Stream(1.0, Group::Extra3), system_time),
    row!(EXTENDED_SYS_STATE_DATA, Goes::Stream(1.0, Group::ExtendedStatus), extended_state),
    row!(BATTERY_STATUS_DATA, Goes::Stream(0.5, Group::Extra3), |state: &VehicleState| state
        .battery
        .status()),
    row!(MISSION_CURRENT_DATA, Goes::Stream(1.0, Group::ExtendedStatus), |state: &VehicleState| {
        state.mission.clone()
    }),
    row!(HOME_POSITION_DATA, Goes::Stream(0.5, Group::Extra3), home_position),
    row!(GPS_GLOBAL_ORIGIN_DATA, Goes::OnRequest, origin),
    row!(AUTOPILOT_VERSION_DATA, Goes::OnRequest, version),
    row!(PROTOCOL_VERSION_DATA, Goes::OnRequest, protocol),
    row!(FENCE_STATUS_DATA, Goes::OnRequest, |state: &VehicleState| state.fence.clone()),
    Row { component: CAMERA, ..row!(HEARTBEAT_DATA, Goes::Heartbeat, |_: &VehicleState| camera_heartbeat()) },
    camera_row!(CAMERA_INFORMATION_DATA, camera_information),
    camera_row!(CAMERA_SETTINGS_DATA, camera_settings),
    camera_row!(STORAGE_INFORMATION_DATA, camera_storage),
    camera_row!(CAMERA_CAPTURE_STATUS_DATA, |state: &VehicleState| state.shots.clone()),
];

impl VehicleState {
    /// `time_boot_ms` of the state.
    pub fn boot_ms(&self) -> u32 {
        self.clock.boot_ms(self.report.tick)
    }

    /// Roll and pitch, rad, of the acceleration that is flown.
    fn tilt(&self) -> [f32; 2] {
        geodesy::tilt(self.heading.forward_right(self.accel.map(f64::from)).map(|a| a as f32))
    }
}

/// HEARTBEAT of component 1.
pub(super) fn autopilot_heartbeat(conduct: &Conduct, system_status: MavState) -> dialect::HEARTBEAT_DATA {
    dialect::HEARTBEAT_DATA {
        custom_mode: conduct.mode as u32,
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
        base_mode: conduct.base_mode(),
        system_status,
        mavlink_version: 3,
    }
}

/// HEARTBEAT of component 68. Clients must not take the radio for a vehicle, hence this type.
pub(super) fn radio_heartbeat() -> dialect::HEARTBEAT_DATA {
    dialect::HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    }
}

/// HEARTBEAT of component 100.
pub(super) fn camera_heartbeat() -> dialect::HEARTBEAT_DATA {
    dialect::HEARTBEAT_DATA { mavtype: MavType::MAV_TYPE_CAMERA, ..radio_heartbeat() }
}

/// Level but for the tilt; between two ticks the acceleration is constant, so nothing but the heading turns.
fn attitude(state: &VehicleState) -> dialect::ATTITUDE_DATA {
    let [roll, pitch] = state.tilt();
    dialect::ATTITUDE_DATA {
        time_boot_ms: state.boot_ms(),
        roll,
        pitch,
        yaw: wrapped(state.heading.yaw) as f32,
        yawspeed: state.heading.rate() as f32,
        ..Default::default()
    }
}

/// An angle of [0, 2π) in (-π, π].
fn wrapped(angle: f64) -> f64 {
    if angle > std::f64::consts::PI { angle - std::f64::consts::TAU } else { angle }
}

/// Yaw, then pitch, then roll.
fn quaternion(state: &VehicleState) -> dialect::ATTITUDE_QUATERNION_DATA {
    let [roll, pitch] = state.tilt().map(|angle| angle / 2.0);
    let yaw = (wrapped(state.heading.yaw) / 2.0) as f32;
    let level = [
        roll.cos() * pitch.cos(),
        roll.sin() * pitch.cos(),
        roll.cos() * pitch.sin(),
        -roll.sin() * pitch.sin(),
    ];
    let (sin, cos) = yaw.sin_cos();
    dialect::ATTITUDE_QUATERNION_DATA {
        time_boot_ms: state.boot_ms(),
        q1: cos * level[0] - sin * level[3],
        q2: cos * level[1] - sin * level[2],
        q3: cos * level[2] + sin * level[1],
        q4: cos * level[3] + sin * level[0],
        yawspeed: state.heading.rate() as f32,
        ..Default::default()
    }
}

/// The air stands still: speed over the ground is speed through the air. Throttle is lift and tilt's.
fn hud(state: &VehicleState) -> dialect::VFR_HUD_DATA {
    let [north, east] = state.report.velocity;
    let speed = north.hypot(east);
    let [roll, pitch] = state.tilt();
    let throttle = if state.conduct.armed { HOVER_THROTTLE / (roll.cos() * pitch.cos()) } else { 0.0 };
    dialect::VFR_HUD_DATA {
        airspeed: speed,
        groundspeed: speed,
        alt: (state.site.altitude_m + state.height.altitude_m) as f32,
        climb: state.height.climb_mps as f32,
        heading: state.heading.degrees() as i16,
        throttle: throttle.min(100.0) as u16,
    }
}

fn navigation(state: &VehicleState) -> dialect::NAV_CONTROLLER_OUTPUT_DATA {
    let [roll, pitch] = state.tilt();
    let target = state.target.map_or(state.report.position, |target| state.scale.ned_from_paper(target));
    let [north, east] = [0, 1].map(|axis| target[axis] - state.report.position[axis]);
    let bearing = east.atan2(north).to_degrees().round() as i16;
    dialect::NAV_CONTROLLER_OUTPUT_DATA {
        nav_roll: roll.to_degrees(),
        nav_pitch: pitch.to_degrees(),
        nav_bearing: bearing,
        target_bearing: bearing,
        wp_dist: north.hypot(east).min(f32::from(u16::MAX)) as u16,
        ..Default::default()
    }
}

fn gps(state: &VehicleState) -> dialect::GPS_RAW_INT_DATA {
    let [lat, lon] = state.site.latitude_longitude(state.report.position);
    let [north, east] = state.report.velocity;
    let course = east.atan2(north).to_degrees().rem_euclid(360.0);
    dialect::GPS_RAW_INT_DATA {
        time_usec: u64::from(state.boot_ms()) * 1000,
        lat,
        lon,
        alt: millimetres(state.site.altitude_m + state.height.altitude_m),
        eph: 100,
        epv: 100,
        vel: (north.hypot(east) * 100.0) as u16,
        cog: (course * 100.0) as u16,
        fix_type: GpsFixType::GPS_FIX_TYPE_3D_FIX,
        satellites_visible: 10,
        ..Default::default()
    }
}

fn global_position(state: &VehicleState) -> dialect::GLOBAL_POSITION_INT_DATA {
    let [lat, lon] = state.site.latitude_longitude(state.report.position);
    let [vx, vy] = state.report.velocity.map(|speed| (speed * 100.0).round() as i16);
    dialect::GLOBAL_POSITION_INT_DATA {
        time_boot_ms: state.boot_ms(),
        lat,
        lon,
        alt: millimetres(state.site.altitude_m + state.height.altitude_m),
        relative_alt: millimetres(state.height.altitude_m),
        vx,
        vy,
        vz: (-100.0 * state.height.climb_mps).round() as i16,
        hdg: (state.heading.degrees() * 100.0) as u16,
    }
}

fn millimetres(metres: f64) -> i32 {
    (metres * 1e3).round() as i32
}

/// Nothing is measured: positions are the simulator's truth, told as a fix of perfect sensors, for
/// which MAVSDK's programs wait. No fence is breached, as there is none. Packets lost are the radio's.
fn system_status(state: &VehicleState) -> dialect::SYS_STATUS_DATA {
    let sensors = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_EXTERNAL_GROUND_TRUTH
        | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_GYRO
        | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_MAG
        | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_GPS
        | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
        | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
        | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
        | MavSysStatusSensor::MAV_SYS_STATUS_AHRS
        | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_BATTERY
        | MavSysStatusSensor::MAV_SYS_STATUS_PREARM_CHECK;
    let Fates { sent, lost, .. } = state.fates;
    dialect::SYS_STATUS_DATA {
        onboard_control_sensors_present: sensors,
        onboard_control_sensors_enabled: sensors,
        onboard_control_sensors_health: sensors | MavSysStatusSensor::MAV_SYS_STATUS_GEOFENCE,
        load: 0,
        voltage_battery: state.battery.millivolts(),
        current_battery: state.battery.centiamperes(),
        drop_rate_comm: (lost * 10_000 / sent.max(1)) as u16,
        errors_comm: u16::try_from(lost).unwrap_or(u16::MAX),
        errors_count1: 0,
        errors_count2: 0,
        errors_count3: 0,
        errors_count4: 0,
        battery_remaining: state.battery.remaining(),
        onboard_control_sensors_present_extended: MavSysStatusSensorExtended::empty(),
        onboard_control_sensors_enabled_extended: MavSysStatusSensorExtended::empty(),
        onboard_control_sensors_health_extended: MavSysStatusSensorExtended::empty(),
    }
}

fn home_position(state: &VehicleState) -> dialect::HOME_POSITION_DATA {
    let [latitude, longitude] = state.launch;
    let [x, y] = state.home;
    dialect::HOME_POSITION_DATA {
        latitude,
        longitude,
        altitude: millimetres(state.site.altitude_m),
        x,
        y,
        q: [1.0, 0.0, 0.0, 0.0],
        time_usec: u64::from(state.boot_ms()) * 1000,
        ..Default::default()
    }
}

fn origin(state: &VehicleState) -> dialect::GPS_GLOBAL_ORIGIN_DATA {
    let [latitude, longitude] = state.site.latitude_longitude([0.0; 2]);
    let time_usec = u64::from(state.boot_ms()) * 1000;
    dialect::GPS_GLOBAL_ORIGIN_DATA {
        latitude,
        longitude,
        altitude: millimetres(state.site.altitude_m),
        time_usec,
    }
}

fn system_time(state: &VehicleState) -> dialect::SYSTEM_TIME_DATA {
    let time_unix_usec = state.unix.map_or(0, |unix| unix.as_micros() as u64);
    dialect::SYSTEM_TIME_DATA { time_unix_usec, time_boot_ms: state.boot_ms() }
}

fn extended_state(state: &VehicleState) -> dialect::EXTENDED_SYS_STATE_DATA {
    let landed_state = match state.conduct {
        Conduct { climbing: Some(_), .. } => MavLandedState::MAV_LANDED_STATE_TAKEOFF,
        _ if state.height.on_ground() => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
        _ if state.height.climb_mps < 0.0 => MavLandedState::MAV_LANDED_STATE_LANDING,
        _ => MavLandedState::MAV_LANDED_STATE_IN_AIR,
    };
    dialect::EXTENDED_SYS_STATE_DATA { vtol_state: MavVtolState::MAV_VTOL_STATE_UNDEFINED, landed_state }
}

/// What the vehicle can do, and nothing else: no file transfer.
pub(super) fn version(state: &VehicleState) -> dialect::AUTOPILOT_VERSION_DATA {
    dialect::AUTOPILOT_VERSION_DATA {
        capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST,
        uid: u64::from(state.system),
        ..Default::default()
    }
}

/// MAVLink 2 is spoken, and nothing older.
fn protocol(_: &VehicleState) -> dialect::PROTOCOL_VERSION_DATA {
    dialect::PROTOCOL_VERSION_DATA { version: 200, min_version: 200, max_version: 200, ..Default::default() }
}

/// CAMERA_INFORMATION: it takes pictures and videos in its only mode, and has no lens whose length there would be.
fn camera_information(state: &VehicleState) -> dialect::CAMERA_INFORMATION_DATA {
    let name = |text: &str| {
        let mut bytes = [0; 32];
        bytes.iter_mut().zip(text.bytes()).for_each(|(to, from)| *to = from);
        bytes
    };
    dialect::CAMERA_INFORMATION_DATA {
        time_boot_ms: state.boot_ms(),
        firmware_version: 1,
        focal_length: f32::NAN,
        sensor_size_h: f32::NAN,
        sensor_size_v: f32::NAN,
        flags: CameraCapFlags::CAMERA_CAP_FLAGS_CAPTURE_IMAGE
            | CameraCapFlags::CAMERA_CAP_FLAGS_CAPTURE_VIDEO
            | CameraCapFlags::CAMERA_CAP_FLAGS_CAN_CAPTURE_VIDEO_IN_IMAGE_MODE,
        resolution_h: SIDE as u16,
        resolution_v: SIDE as u16,
        vendor_name: name("CRPL"),
        model_name: name("field from above"),
        ..Default::default()
    }
}

/// CAMERA_SETTINGS: there is one mode, for images.
fn camera_settings(state: &VehicleState) -> dialect::CAMERA_SETTINGS_DATA {
    dialect::CAMERA_SETTINGS_DATA {
        time_boot_ms: state.boot_ms(),
        zoomLevel: f32::NAN,
        focusLevel: f32::NAN,
        ..Default::default()
    }
}

/// STORAGE_INFORMATION: there is none.
fn camera_storage(state: &VehicleState) -> dialect::STORAGE_INFORMATION_DATA {
    dialect::STORAGE_INFORMATION_DATA {
        time_boot_ms: state.boot_ms(),
        status: StorageStatus::STORAGE_STATUS_NOT_SUPPORTED,
        ..Default::default()
    }
}
