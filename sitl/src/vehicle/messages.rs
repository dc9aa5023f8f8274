//! Every message that the vehicle can be asked for by number, one row each. Knows what a message
//! says, not when it goes.
//!
//! | message | id | from | goes | in group of REQUEST_DATA_STREAM |
//! |---|---|---|---|---|
//! | HEARTBEAT | 0 | 1, 68 | 1 Hz, always | |
//! | LOCAL_POSITION_NED | 32 | 1 | in every percept | |
//! | POSITION_TARGET_LOCAL_NED | 85 | 1 | in every percept | |
//! | DEBUG_VECT `OBSTACLE` | 250 | 1 | in every percept | |
//! | NAMED_VALUE_FLOAT `SNR_DB`, `TXP`, `OUTAGE` | 251 | 68 | in every percept from tick 1 on | |
//! | RADIO_STATUS | 109 | 68 | in every percept from tick 1 on | |
//! | SYSTEM_TIME | 2 | 1 | 1 Hz | EXTRA3 |
//! | EXTENDED_SYS_STATE | 245 | 1 | 1 Hz | EXTENDED_STATUS |
//! | AUTOPILOT_VERSION | 148 | 1 | on request | |
//! | PROTOCOL_VERSION | 300 | 1 | on request | |
//!
//! The rates are those of the real-time pace; in lockstep only heartbeats and percepts go by
//! themselves. Time stamps are those of the tick whose state is told; SYSTEM_TIME's 1970 part is the
//! wall's.

use std::time::Duration;

use mavlink::MessageData;

use crate::link::dialect::{
    self, MavAutopilot, MavLandedState, MavModeFlag, MavProtocolCapability, MavState, MavType, MavVtolState,
};
use crate::link::encoder::Encoder;
use crate::link::wire::{self, Clock};
use crate::link::{AUTOPILOT, RADIO};
use crate::msg::Telemetry;

/// ArduCopter's number of GUIDED.
pub(super) const MODE_GUIDED: u32 = 4;
/// Armed, guided, stabilised, manual input and custom mode, as ArduCopter in GUIDED says.
const BASE_MODE: u8 = 217;

/// What messages are made of: the vehicle at one moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct State {
    pub report: Telemetry,
    pub clock: Clock,
    pub system: u8,
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
    push: fn(&State, &mut Encoder, &mut Vec<u8>),
}

impl Row {
    /// Whether there is something to tell: the radio has no report before its first interval.
    pub fn ready(&self, state: &State) -> bool {
        self.component != RADIO || self.goes != Goes::Percept || state.report.link.is_some()
    }

    /// Appends the message, if it is ready. `encoder` must be that of [`Row::component`].
    pub fn push(&self, state: &State, encoder: &mut Encoder, datagram: &mut Vec<u8>) {
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

/// A message of the percept: the same bytes as in the report.
const fn percept(id: u32, component: u8, push: fn(&State, &mut Encoder, &mut Vec<u8>)) -> Row {
    Row { id, component, goes: Goes::Percept, push }
}

/// All rows, in the order of the table above.
pub(super) static ROWS: &[Row] = &[
    row!(HEARTBEAT_DATA, Goes::Heartbeat, |_: &State| autopilot_heartbeat()),
    Row { component: RADIO, ..row!(HEARTBEAT_DATA, Goes::Heartbeat, |_: &State| radio_heartbeat()) },
    percept(dialect::LOCAL_POSITION_NED_DATA::ID, AUTOPILOT, |state, encoder, datagram| {
        wire::push_position(&state.report, &state.clock, encoder, datagram);
    }),
    percept(dialect::POSITION_TARGET_LOCAL_NED_DATA::ID, AUTOPILOT, |state, encoder, datagram| {
        wire::push_held(&state.report, &state.clock, encoder, datagram);
    }),
    percept(dialect::DEBUG_VECT_DATA::ID, AUTOPILOT, |state, encoder, datagram| {
        wire::push_obstacle(&state.report, &state.clock, encoder, datagram);
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
    row!(SYSTEM_TIME_DATA, Goes::Stream(1.0, Group::Extra3), system_time),
    row!(EXTENDED_SYS_STATE_DATA, Goes::Stream(1.0, Group::ExtendedStatus), extended_state),
    row!(AUTOPILOT_VERSION_DATA, Goes::OnRequest, version),
    row!(PROTOCOL_VERSION_DATA, Goes::OnRequest, protocol),
];

impl State {
    /// `time_boot_ms` of the state.
    pub fn boot_ms(&self) -> u32 {
        self.clock.boot_ms(self.report.tick)
    }
}

/// HEARTBEAT of component 1.
pub(super) fn autopilot_heartbeat() -> dialect::HEARTBEAT_DATA {
    dialect::HEARTBEAT_DATA {
        custom_mode: MODE_GUIDED,
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
        base_mode: MavModeFlag::from_bits_retain(BASE_MODE),
        system_status: MavState::MAV_STATE_ACTIVE,
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
        ..autopilot_heartbeat()
    }
}

fn system_time(state: &State) -> dialect::SYSTEM_TIME_DATA {
    let time_unix_usec = state.unix.map_or(0, |unix| unix.as_micros() as u64);
    dialect::SYSTEM_TIME_DATA { time_unix_usec, time_boot_ms: state.boot_ms() }
}

fn extended_state(_: &State) -> dialect::EXTENDED_SYS_STATE_DATA {
    dialect::EXTENDED_SYS_STATE_DATA {
        vtol_state: MavVtolState::MAV_VTOL_STATE_UNDEFINED,
        landed_state: MavLandedState::MAV_LANDED_STATE_IN_AIR,
    }
}

/// What the vehicle can do, and nothing else: no mission, no file transfer, no fence.
pub(super) fn version(state: &State) -> dialect::AUTOPILOT_VERSION_DATA {
    dialect::AUTOPILOT_VERSION_DATA {
        capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST,
        uid: u64::from(state.system),
        ..Default::default()
    }
}

/// MAVLink 2 is spoken, and nothing older.
fn protocol(_: &State) -> dialect::PROTOCOL_VERSION_DATA {
    dialect::PROTOCOL_VERSION_DATA { version: 200, min_version: 200, max_version: 200, ..Default::default() }
}
