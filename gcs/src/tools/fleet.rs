//! Who is out there: vehicles by their heartbeats, found, lost and found again. No socket, no clock.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::Duration;

use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::status::Heartbeat;
use crpl_sitl::link::packet::Packet;

/// A link counts as lost when five heartbeats, one a second of the vehicle's time, are missing.
const LOST_AFTER: Duration = Duration::from_millis(5500);
/// MAV_AUTOPILOT_INVALID: stations, radios, cameras.
const NO_AUTOPILOT: u8 = 8;
/// MAV_MODE_FLAG_SAFETY_ARMED.
const ARMED: u8 = 128;

/// The flight stack of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stack {
    /// MAV_AUTOPILOT_ARDUPILOTMEGA.
    ArduPilot,
    /// MAV_AUTOPILOT_PX4.
    Px4,
    /// Another MAV_AUTOPILOT.
    Other(u8),
}

impl Stack {
    fn of(autopilot: u8) -> Self {
        match autopilot {
            3 => Self::ArduPilot,
            12 => Self::Px4,
            other => Self::Other(other),
        }
    }
}

/// A vehicle's mode in its own stack's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FlightMode {
    /// Whose numbers.
    pub stack: Stack,
    /// HEARTBEAT.custom_mode.
    pub custom: u32,
}

impl FlightMode {
    /// ArduCopter's GUIDED.
    pub const GUIDED: u32 = 4;
    /// PX4's OFFBOARD: main mode 6 in the third byte.
    pub const OFFBOARD: u32 = 6 << 16;

    /// Whether the vehicle takes setpoints in it.
    #[must_use]
    pub fn takes_setpoints(self) -> bool {
        self.custom == if self.stack == Stack::Px4 { Self::OFFBOARD } else { Self::GUIDED }
    }
}

impl fmt::Display for FlightMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = if self.stack == Stack::Px4 {
            match (self.custom >> 16 & 0xFF, self.custom >> 24) {
                (1, _) => "MANUAL",
                (2, _) => "ALTCTL",
                (3, _) => "POSCTL",
                (4, 2) => "TAKEOFF",
                (4, 3) => "LOITER",
                (4, 4) => "MISSION",
                (4, 5) => "RTL",
                (4, 6) => "LAND",
                (6, _) => "OFFBOARD",
                (7, _) => "STABILIZED",
                _ => "",
            }
        } else {
            match self.custom {
                0 => "STABILIZE",
                2 => "ALT_HOLD",
                3 => "AUTO",
                4 => "GUIDED",
                5 => "LOITER",
                6 => "RTL",
                9 => "LAND",
                16 => "POSHOLD",
                17 => "BRAKE",
                _ => "",
            }
        };
        if name.is_empty() { write!(f, "mode {}", self.custom) } else { f.write_str(name) }
    }
}

/// A vehicle as its heartbeats tell it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeardVehicle {
    /// Of its autopilot.
    pub mode: FlightMode,
    /// Whether its motors may turn.
    pub armed: bool,
    /// MAV_STATE.
    pub status: u8,
    /// The component that is its autopilot.
    pub autopilot: u8,
    /// Components that have been heard.
    pub components: BTreeSet<u8>,
    heard: Duration,
    lost: bool,
}

/// What is new.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum News {
    /// A vehicle's first heartbeat.
    Found(u8, FlightMode, bool),
    /// Five heartbeats are missing.
    Lost(u8),
    /// It is back after this time.
    Regained(u8, Duration),
    /// It has changed its mode, from and to.
    Mode(u8, FlightMode, FlightMode),
    /// It was armed or disarmed.
    Armed(u8, bool),
}

impl News {
    /// Whether the vehicle takes setpoints again.
    #[must_use]
    pub fn gives_back(&self) -> bool {
        matches!(self, Self::Mode(_, before, after) if !before.takes_setpoints() && after.takes_setpoints())
    }
}

impl fmt::Display for News {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Found(id, mode, armed) => {
                let stack = match mode.stack {
                    Stack::ArduPilot => "ArduPilot".into(),
                    Stack::Px4 => "PX4".into(),
                    Stack::Other(0) => "a generic autopilot".into(),
                    Stack::Other(id) => format!("autopilot {id}"),
                };
                let armed = if *armed { "armed" } else { "disarmed" };
                write!(f, "vehicle {id} found: {stack}, {mode}, {armed}")
            }
            Self::Lost(id) => write!(f, "vehicle {id}: link lost, five heartbeats are missing"),
            Self::Regained(id, gap) => {
                write!(f, "vehicle {id}: link regained after {:.1} s", gap.as_secs_f64())
            }
            Self::Mode(id, before, after) => write!(f, "vehicle {id}: {before} to {after}"),
            Self::Armed(id, true) => write!(f, "vehicle {id}: armed"),
            Self::Armed(id, false) => write!(f, "vehicle {id}: disarmed"),
        }
    }
}

impl News {
    /// Says it in the log: a lost link as a warning.
    pub fn log(&self) {
        match self {
            Self::Lost(_) => tracing::warn!("{self}"),
            _ => tracing::info!("{self}"),
        }
    }
}

/// All vehicles on a link.
#[derive(Debug, Clone)]
pub struct Fleet {
    vehicles: BTreeMap<u8, HeardVehicle>,
    lost_after: Duration,
}

impl Default for Fleet {
    fn default() -> Self {
        Self { vehicles: BTreeMap::new(), lost_after: LOST_AFTER }
    }
}

impl Fleet {
    /// Of vehicles that beat once a second of a time that runs `speed` times as fast as the wall's.
    #[must_use]
    pub fn paced(speed: f64) -> Self {
        Self { lost_after: LOST_AFTER.div_f64(speed), ..Self::default() }
    }

    /// A packet has come.
    pub fn packet(&mut self, packet: &Packet, now: Duration) -> Vec<News> {
        if let Some(vehicle) = self.vehicles.get_mut(&packet.system) {
            vehicle.components.insert(packet.component);
        }
        let beat = Heartbeat::of(packet).filter(|beat| beat.autopilot != NO_AUTOPILOT);
        let Some(Heartbeat { custom_mode, autopilot, base_mode, system_status: status, .. }) = beat else {
            return Vec::new();
        };
        let (id, mut news) = (packet.system, Vec::new());
        let mode = FlightMode { stack: Stack::of(autopilot), custom: custom_mode };
        let armed = base_mode & ARMED != 0;
        let Some(known) = self.vehicles.get_mut(&id) else {
            let (autopilot, components) = (packet.component, [packet.component].into());
            let vehicle =
                HeardVehicle { mode, armed, status, autopilot, components, heard: now, lost: false };
            self.vehicles.insert(id, vehicle);
            return vec![News::Found(id, mode, armed)];
        };
        // A second autopilot of one system is a copy for safety; the first one speaks for it.
        if known.autopilot != packet.component {
            return news;
        }
        if known.lost {
            news.push(News::Regained(id, now.saturating_sub(known.heard)));
        }
        if known.mode != mode {
            news.push(News::Mode(id, known.mode, mode));
        }
        if known.armed != armed {
            news.push(News::Armed(id, armed));
        }
        *known = HeardVehicle { mode, armed, status, heard: now, lost: false, ..known.clone() };
        news
    }

    /// Who has been lost by now.
    pub fn poll(&mut self, now: Duration) -> Vec<News> {
        let mut news = Vec::new();
        for (&id, vehicle) in &mut self.vehicles {
            if !vehicle.lost && now.saturating_sub(vehicle.heard) >= self.lost_after {
                vehicle.lost = true;
                news.push(News::Lost(id));
            }
        }
        news
    }

    /// A vehicle.
    #[must_use]
    pub fn get(&self, system: u8) -> Option<&HeardVehicle> {
        self.vehicles.get(&system)
    }

    /// Whether a vehicle was heard and its heartbeats are missing now.
    #[must_use]
    pub fn is_lost(&self, system: u8) -> bool {
        self.get(system).is_some_and(|vehicle| vehicle.lost)
    }

    /// System ids of all vehicles.
    #[must_use]
    pub fn systems(&self) -> Vec<u8> {
        self.vehicles.keys().copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::decoder::Decoder;
    use crpl_sitl::link::dialect::{HEARTBEAT_DATA, MavAutopilot, MavModeFlag};
    use crpl_sitl::link::encoder::Encoder;

    use super::*;

    fn beat(system: u8, component: u8, autopilot: MavAutopilot, custom_mode: u32, armed: bool) -> Packet {
        let base_mode = if armed { MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED } else { MavModeFlag::empty() };
        let mut datagram = Vec::new();
        let message = HEARTBEAT_DATA { custom_mode, autopilot, base_mode, ..Default::default() };
        Encoder::new(system, component).push(&mut datagram, &message);
        Decoder::default().datagram(&datagram).remove(0)
    }

    const APM: MavAutopilot = MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA;

    fn s(seconds: f64) -> Duration {
        Duration::from_secs_f64(seconds)
    }

    fn words(news: Vec<News>) -> Vec<String> {
        news.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_link_is_lost_after_five_heartbeats_and_regained_in_words() {
        let mut fleet = Fleet::default();
        let found = fleet.packet(&beat(1, 1, APM, 0, false), s(0.0));
        assert_eq!(words(found), ["vehicle 1 found: ArduPilot, STABILIZE, disarmed"]);
        assert_eq!(fleet.poll(s(5.0)), []);
        assert_eq!(words(fleet.poll(s(5.6))), ["vehicle 1: link lost, five heartbeats are missing"]);
        assert_eq!(fleet.poll(s(9.0)), [], "said once");
        assert!(fleet.is_lost(1));
        let back = fleet.packet(&beat(1, 1, APM, 4, true), s(9.5));
        let expected =
            ["vehicle 1: link regained after 9.5 s", "vehicle 1: STABILIZE to GUIDED", "vehicle 1: armed"];
        assert_eq!(words(back), expected);
        assert!(fleet.get(1).unwrap().mode.takes_setpoints());
    }

    #[test]
    fn heartbeats_are_counted_in_the_vehicle_s_time() {
        let mut fleet = Fleet::paced(10.0);
        fleet.packet(&beat(1, 1, APM, 4, true), s(0.0));
        assert_eq!(fleet.poll(s(0.5)), []);
        assert_eq!(fleet.poll(s(0.56)), [News::Lost(1)]);
        assert!(fleet.is_lost(1) && !fleet.is_lost(2));
    }

    #[test]
    fn vehicles_are_told_apart_and_stations_and_radios_are_none() {
        let mut fleet = Fleet::default();
        let px4 = beat(2, 1, MavAutopilot::MAV_AUTOPILOT_PX4, 50_593_792, false);
        assert_eq!(words(fleet.packet(&px4, s(0.0))), ["vehicle 2 found: PX4, LOITER, disarmed"]);
        fleet.packet(&beat(1, 1, APM, 4, true), s(0.0));
        fleet.packet(&beat(2, 68, MavAutopilot::MAV_AUTOPILOT_INVALID, 0, false), s(0.1));
        fleet.packet(&beat(255, 190, MavAutopilot::MAV_AUTOPILOT_INVALID, 0, false), s(0.1));
        assert_eq!(fleet.systems(), [1, 2]);
        assert!(fleet.get(2).unwrap().components.contains(&68));
        let offboard = beat(2, 1, MavAutopilot::MAV_AUTOPILOT_PX4, FlightMode::OFFBOARD, true);
        assert_eq!(words(fleet.packet(&offboard, s(1.0)))[0], "vehicle 2: LOITER to OFFBOARD");
        assert!(fleet.get(2).unwrap().mode.takes_setpoints());
    }
}
