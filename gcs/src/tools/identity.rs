//! Who this program is on the network: a ground station, or a companion computer on board.
//!
//! A companion has the vehicle's system id and is no ground station: a station's heartbeats from on board would
//! keep the autopilot's failsafe quiet when the real station is lost.

use clap::ValueEnum;
use crpl_sitl::link::dialect::{self, MavAutopilot, MavModeFlag, MavState, MavType};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::{COMPANION, STATION_COMPONENT, STATION_SYSTEM};

/// What a program is on the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum StationRole {
    /// Ground station: system 255, component 190
    #[default]
    Gcs,
    /// Computer on board: the vehicle's system, component 191
    Companion,
}

/// Flags of every program that speaks to a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::Args)]
pub struct Identity {
    /// Speak as a ground station, or as a companion computer on board, which never counts as a station
    #[arg(long, value_enum, default_value = "gcs")]
    pub role: StationRole,
    /// System id to speak as [default: 255; of a companion, the vehicle's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    pub source_system: Option<u8>,
    /// Component id to speak as [default: 190; of a companion, 191]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    pub source_component: Option<u8>,
}

impl Identity {
    /// What writes as this program to the vehicle of this system id.
    #[must_use]
    pub fn encoder(&self, vehicle: u8) -> Encoder {
        let (system, component) = match self.role {
            StationRole::Gcs => (STATION_SYSTEM, STATION_COMPONENT),
            StationRole::Companion => (vehicle, COMPANION),
        };
        Encoder::new(self.source_system.unwrap_or(system), self.source_component.unwrap_or(component))
    }

    /// Appends a heartbeat of this program.
    pub fn push_heartbeat(&self, encoder: &mut Encoder, datagram: &mut Vec<u8>) {
        let mavtype = match self.role {
            StationRole::Gcs => MavType::MAV_TYPE_GCS,
            StationRole::Companion => MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        };
        let message = dialect::HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        };
        encoder.push(datagram, &message);
    }
}
