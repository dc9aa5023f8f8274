//! The parameter protocol over two tables: the autopilot's (component 1) and the radio's (68).
//! Values are cast to float as in C, as the capabilities say.
//!
//! | parameter | unit | takes effect |
//! |---|---|---|
//! | `SYSID_THISMAV` | | read only |
//! | `RATE_*` | Hz, 0 or 0.0005 to 50 | at once: the default of every peer's stream, in real time |
//! | `FS_SETP_ACT`, `FS_STN_ACT` | 0 hold, 1 brake, 2 return | at once |
//! | `FENCE_ACTION` | 0 hold: says so, 1 brake, 2 return | at once |
//! | `FS_SETP_TIME`, `FS_STN_TIME` | s | at once |
//! | `WP_SPEED`, `WP_RADIUS`, `CLIMB_SPEED` | m/s, m, m/s | at once |
//! | `SIGN_REQUIRED` | 0 or 1: whether unsigned packets are refused once there is a key | at once |
//! | `RADIO_RULE` | 0 ideal, 1 drop, 2 queue | at boot |
//! | `RADIO_B_DT`, `RADIO_PKT_BITS` | bits an interval and bit/s/Hz; bits | at boot |
//! | `CHAN_REF_GAIN`, `CHAN_PL_EXP`, `CHAN_NLOS`, `CHAN_NOISE`, `CHAN_SNR_MIN` | the paper's | at boot |
//! | `DYN_V_MAX`, `DYN_A_MAX`, `DYN_WALLS` | m/s; m/s²; 0 or 1 | at boot |
//! | `WIND_GUST` | m/s, standard deviation an interval and axis | at boot |
//! | `COLLIDE_ACT` | 0 go on, as in the paper; 1 fall: the flight is over | at boot |
//! | `UAV_RADIUS` | m | at boot |
//! | `OBST_RADIUS`, `OBST_N`, `OBST_E`; of further obstacles `OBST2_RADIUS` ..., `OBST3_RADIUS` ... | m | at boot |
//! | `OBST_VN`, `OBST_VE`, `OBST_MARGIN`; of further obstacles `OBST2_VN` ... | m/s; m/s; m | read only |
//! | `START_N`, `START_E`, `GOAL_N`, `GOAL_E`, `GOAL_RADIUS`, `BS_N`, `BS_E` | m | at boot |
//! | `CHAN_BLOCK_SOFT`, `CHAN_DIST_FLOOR`, `SAFE_D_MIN`, `SAFE_SOFT` | m | at boot |
//! | `SAFE_TOL_COLL`, `SAFE_TOL_OUT` | 0 to 1 | at boot |
//! | `FLT_HORIZON`, `CAM_EDGE_PX`, `PROP_*` | intervals; px; the paper's | read only |
//! | `CAM_PRESET` | 0 clean, 1 hard, 2 harder, further ones in docs/camera.md; -1 a camera without a name | read only |
//! | `SCALE_UNIT_M`, `SCALE_DT_S`, `SCALE_ALT_M` | m; s; m | read only |
//! | `STAT_NEXT_BOOT` | 1: what was set makes another flight from the next boot on | read only |
//! | `STAT_*` | frames and bytes that came, by what became of them; setpoints | read only, and change by themselves |
//! | `RADIO_TXP`, of component 68 | 1 or 4 | at once |
//!
//! "At boot" is the next PREFLIGHT_REBOOT, or the next start with `--params`: a flight's physics is fixed, and
//! `--save-params` keeps what was set. A PARAM_SET is always answered to all peers with the value that now holds: the old one
//! if the new one is not finite, out of range, or the parameter read only. Unknown names and indices
//! are answered by PARAM_ERROR, as ArduPilot and PX4 do. A request to component 0 is answered by both.

use std::time::Duration;

use super::Vehicle;
use crate::camera::CameraConfig;
use crate::camera::cases::CASES;
use crate::link::dialect::{self, MavParamError, MavParamType};
use crate::link::encoder::DATAGRAM;
use crate::link::messages::Target;
use crate::link::param_file::Entry;
use crate::link::signing::Policy;
use crate::link::splitter::Counts;
use crate::link::{AUTOPILOT, MessageData, PeerId, RADIO};
use crate::scenario::{Action, CollisionAction, Obstacle, Rule, Scenario};
use crate::sim::Sim;
use crate::units::{MAX_OBSTACLES, TxPower};

/// A parameter's place in its component's table, its name and what it holds.
struct ParamSlot {
    name: &'static str,
    kind: MavParamType,
    holds: Holds,
}

type Get = fn(&Scenario) -> f64;
type Set = fn(&mut Scenario, f64);

enum Holds {
    System,
    /// The default rate of the message with this id.
    Rate(u32),
    TxPower,
    SignRequired,
    FenceAction,
    /// A number of the tally.
    Count(fn(&Counts) -> u64),
    Setpoints,
    RefusedSetpoints,
    /// A value of the scenario; whoever reads it decides whether it takes effect before the next boot.
    Setting(Get, Set),
    /// A value of the scenario to be read; what reads it can put it into a scenario of its own.
    Told(Get, Set),
    /// A length of the obstacle with this index, in a scenario that has so many; as [`Holds::Setting`].
    Obstacle(usize, fn(&mut Obstacle) -> &mut f64),
    /// A length of that obstacle, or its change in an interval, in units; as [`Holds::Told`].
    ObstacleTold(usize, ObstacleUnit, fn(&mut Obstacle) -> &mut f64),
    /// Whether what was set makes another flight than the one that is flown, from the next boot on.
    NextBoot,
}

/// The unit of a value of an obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ObstacleUnit {
    /// m
    Length,
    /// m/s
    Speed,
}

const REAL: MavParamType = MavParamType::MAV_PARAM_TYPE_REAL32;
/// MAVSDK knows no narrower integer.
const INT: MavParamType = MavParamType::MAV_PARAM_TYPE_INT32;

const fn rate(name: &'static str, id: u32) -> ParamSlot {
    ParamSlot { name, kind: REAL, holds: Holds::Rate(id) }
}

const fn told(name: &'static str, get: Get, set: Set) -> ParamSlot {
    ParamSlot { name, kind: REAL, holds: Holds::Told(get, set) }
}

const fn real(name: &'static str, get: Get, set: Set) -> ParamSlot {
    ParamSlot { name, kind: REAL, holds: Holds::Setting(get, set) }
}

const fn int(name: &'static str, get: Get, set: Set) -> ParamSlot {
    ParamSlot { name, kind: INT, holds: Holds::Setting(get, set) }
}

const fn of_obstacle(index: usize, names: [&'static str; 6]) -> [ParamSlot; 6] {
    let [radius, north, east, speed_north, speed_east, margin] = names;
    let (length, speed) = (ObstacleUnit::Length, ObstacleUnit::Speed);
    [
        ParamSlot { name: radius, kind: REAL, holds: Holds::Obstacle(index, |o| &mut o.radius) },
        ParamSlot { name: north, kind: REAL, holds: Holds::Obstacle(index, |o| &mut o.position.y) },
        ParamSlot { name: east, kind: REAL, holds: Holds::Obstacle(index, |o| &mut o.position.x) },
        ParamSlot {
            name: speed_north,
            kind: REAL,
            holds: Holds::ObstacleTold(index, speed, |o| &mut o.velocity.y),
        },
        ParamSlot {
            name: speed_east,
            kind: REAL,
            holds: Holds::ObstacleTold(index, speed, |o| &mut o.velocity.x),
        },
        ParamSlot { name: margin, kind: REAL, holds: Holds::ObstacleTold(index, length, |o| &mut o.margin) },
    ]
}

const fn count(name: &'static str, get: fn(&Counts) -> u64) -> ParamSlot {
    ParamSlot { name, kind: INT, holds: Holds::Count(get) }
}

/// The autopilot's table up to the obstacles.
static OF_AUTOPILOT: &[ParamSlot] = &[
    ParamSlot { name: "SYSID_THISMAV", kind: INT, holds: Holds::System },
    rate("RATE_ATTITUDE", dialect::ATTITUDE_DATA::ID),
    rate("RATE_QUATERNION", dialect::ATTITUDE_QUATERNION_DATA::ID),
    rate("RATE_GLOBAL", dialect::GLOBAL_POSITION_INT_DATA::ID),
    rate("RATE_HUD", dialect::VFR_HUD_DATA::ID),
    rate("RATE_NAV", dialect::NAV_CONTROLLER_OUTPUT_DATA::ID),
    rate("RATE_GPS", dialect::GPS_RAW_INT_DATA::ID),
    rate("RATE_STATUS", dialect::SYS_STATUS_DATA::ID),
    rate("RATE_TIME", dialect::SYSTEM_TIME_DATA::ID),
    rate("RATE_EXTENDED", dialect::EXTENDED_SYS_STATE_DATA::ID),
    rate("RATE_MISSION", dialect::MISSION_CURRENT_DATA::ID),
    rate("RATE_BATTERY", dialect::BATTERY_STATUS_DATA::ID),
    rate("RATE_HOME", dialect::HOME_POSITION_DATA::ID),
    int(
        "FS_SETP_ACT",
        |s| number(s.failsafe.setpoint_action),
        |s, v| set_action(&mut s.failsafe.setpoint_action, v),
    ),
    real("FS_SETP_TIME", |s| s.failsafe.setpoint_timeout_s, |s, v| s.failsafe.setpoint_timeout_s = v),
    int(
        "FS_STN_ACT",
        |s| number(s.failsafe.station_action),
        |s, v| set_action(&mut s.failsafe.station_action, v),
    ),
    real("FS_STN_TIME", |s| s.failsafe.station_timeout_s, |s, v| s.failsafe.station_timeout_s = v),
    ParamSlot { name: "FENCE_ACTION", kind: INT, holds: Holds::FenceAction },
    real("WP_SPEED", |s| s.autopilot.speed_mps, |s, v| s.autopilot.speed_mps = v),
    real("WP_RADIUS", |s| s.autopilot.acceptance_m, |s, v| s.autopilot.acceptance_m = v),
    real("CLIMB_SPEED", |s| s.autopilot.climb_mps, |s, v| s.autopilot.climb_mps = v),
    ParamSlot { name: "SIGN_REQUIRED", kind: INT, holds: Holds::SignRequired },
    int(
        "RADIO_RULE",
        |s| RULES.iter().position(|&rule| rule == s.radio.rule).unwrap_or(0) as f64,
        |s, v| {
            s.radio.rule = RULES.get(v as usize).copied().unwrap_or(s.radio.rule);
        },
    ),
    real("RADIO_B_DT", |s| s.radio.b_dt, |s, v| s.radio.b_dt = v),
    real("RADIO_PKT_BITS", |s| s.radio.packet_bits, |s, v| s.radio.packet_bits = v),
    real("CHAN_REF_GAIN", |s| s.channel.reference_gain, |s, v| s.channel.reference_gain = v),
    real("CHAN_PL_EXP", |s| s.channel.path_loss_exponent, |s, v| s.channel.path_loss_exponent = v),
    real("CHAN_NLOS", |s| s.channel.nlos_attenuation, |s, v| s.channel.nlos_attenuation = v),
    real("CHAN_NOISE", |s| s.channel.noise_power, |s, v| s.channel.noise_power = v),
    real("CHAN_SNR_MIN", |s| s.channel.snr_min, |s, v| s.channel.snr_min = v),
    real(
        "DYN_V_MAX",
        |s| s.dynamics.v_max * s.scale.mps_per_speed(),
        |s, v| s.dynamics.v_max = rounded(v / s.scale.mps_per_speed()),
    ),
    real(
        "DYN_A_MAX",
        |s| s.dynamics.a_max * s.scale.mps_per_speed() / s.scale.interval_s,
        |s, v| s.dynamics.a_max = rounded(v * s.scale.interval_s / s.scale.mps_per_speed()),
    ),
    int("DYN_WALLS", |s| f64::from(u8::from(s.dynamics.walls)), |s, v| s.dynamics.walls = v != 0.0),
    real(
        "WIND_GUST",
        |s| s.disturbance.gust_std() * s.scale.mps_per_speed(),
        |s, v| s.disturbance.sigma_c = rounded(v / s.scale.mps_per_speed() / s.disturbance.gust_scale),
    ),
    int(
        "COLLIDE_ACT",
        |s| f64::from(u8::from(s.safety.collision_action == CollisionAction::Fall)),
        |s, v| {
            s.safety.collision_action =
                if v == 0.0 { CollisionAction::Continue } else { CollisionAction::Fall };
        },
    ),
    real("UAV_RADIUS", |s| metres(s, s.uav_radius), |s, v| s.uav_radius = units(s, v)),
];

/// Between the two parts of the autopilot's table, as many rows as the scenario has obstacles.
static OF_OBSTACLES: [[ParamSlot; 6]; MAX_OBSTACLES] = [
    of_obstacle(0, ["OBST_RADIUS", "OBST_N", "OBST_E", "OBST_VN", "OBST_VE", "OBST_MARGIN"]),
    of_obstacle(1, ["OBST2_RADIUS", "OBST2_N", "OBST2_E", "OBST2_VN", "OBST2_VE", "OBST2_MARGIN"]),
    of_obstacle(2, ["OBST3_RADIUS", "OBST3_N", "OBST3_E", "OBST3_VN", "OBST3_VE", "OBST3_MARGIN"]),
    of_obstacle(3, ["OBST4_RADIUS", "OBST4_N", "OBST4_E", "OBST4_VN", "OBST4_VE", "OBST4_MARGIN"]),
    of_obstacle(4, ["OBST5_RADIUS", "OBST5_N", "OBST5_E", "OBST5_VN", "OBST5_VE", "OBST5_MARGIN"]),
    of_obstacle(5, ["OBST6_RADIUS", "OBST6_N", "OBST6_E", "OBST6_VN", "OBST6_VE", "OBST6_MARGIN"]),
    of_obstacle(6, ["OBST7_RADIUS", "OBST7_N", "OBST7_E", "OBST7_VN", "OBST7_VE", "OBST7_MARGIN"]),
    of_obstacle(7, ["OBST8_RADIUS", "OBST8_N", "OBST8_E", "OBST8_VN", "OBST8_VE", "OBST8_MARGIN"]),
];

static AFTER_OBSTACLES: &[ParamSlot] = &[
    real("START_N", |s| metres(s, s.start.y), |s, v| s.start.y = units(s, v)),
    real("START_E", |s| metres(s, s.start.x), |s, v| s.start.x = units(s, v)),
    real("GOAL_N", |s| metres(s, s.goal.y), |s, v| s.goal.y = units(s, v)),
    real("GOAL_E", |s| metres(s, s.goal.x), |s, v| s.goal.x = units(s, v)),
    real("GOAL_RADIUS", |s| metres(s, s.goal_radius), |s, v| s.goal_radius = units(s, v)),
    real("BS_N", |s| metres(s, s.channel.base_station.y), |s, v| s.channel.base_station.y = units(s, v)),
    real("BS_E", |s| metres(s, s.channel.base_station.x), |s, v| s.channel.base_station.x = units(s, v)),
    real(
        "CHAN_BLOCK_SOFT",
        |s| metres(s, s.channel.blockage_softness),
        |s, v| s.channel.blockage_softness = units(s, v),
    ),
    real(
        "CHAN_DIST_FLOOR",
        |s| metres(s, s.channel.distance_floor),
        |s, v| s.channel.distance_floor = units(s, v),
    ),
    real("SAFE_D_MIN", |s| metres(s, s.safety.d_min), |s, v| s.safety.d_min = units(s, v)),
    real("SAFE_EDGE", |s| metres(s, s.safety.edge_margin), |s, v| s.safety.edge_margin = units(s, v)),
    real("SAFE_SOFT", |s| metres(s, s.safety.softness), |s, v| s.safety.softness = units(s, v)),
    real("SAFE_TOL_COLL", |s| s.safety.collision_tolerance, |s, v| s.safety.collision_tolerance = v),
    real("SAFE_TOL_OUT", |s| s.safety.outage_tolerance, |s, v| s.safety.outage_tolerance = v),
    told("FLT_HORIZON", |s| s.horizon as f64, |s, v| s.horizon = v as u64),
    told("CAM_EDGE_PX", |s| s.camera.edge_px, |s, v| s.camera.edge_px = v),
    told("CAM_PRESET", |s| s.camera.number().map_or(-1.0, |number| number as f64), set_camera),
    told("PROP_P0", |s| s.propulsion.blade_profile_power, |s, v| s.propulsion.blade_profile_power = v),
    told("PROP_PI", |s| s.propulsion.induced_power, |s, v| s.propulsion.induced_power = v),
    told("PROP_TIP_SPEED", |s| s.propulsion.tip_speed, |s, v| s.propulsion.tip_speed = v),
    told("PROP_V0", |s| s.propulsion.hover_induced_velocity, |s, v| s.propulsion.hover_induced_velocity = v),
    told("PROP_D0", |s| s.propulsion.fuselage_drag_ratio, |s, v| s.propulsion.fuselage_drag_ratio = v),
    told("PROP_RHO", |s| s.propulsion.air_density, |s, v| s.propulsion.air_density = v),
    told("PROP_SOLIDITY", |s| s.propulsion.rotor_solidity, |s, v| s.propulsion.rotor_solidity = v),
    told("PROP_AREA", |s| s.propulsion.rotor_area, |s, v| s.propulsion.rotor_area = v),
    told("SCALE_UNIT_M", |s| s.scale.metres_per_unit, |s, v| s.scale.metres_per_unit = v),
    told("SCALE_DT_S", |s| s.scale.interval_s, |s, v| s.scale.interval_s = v),
    told("SCALE_ALT_M", |s| s.scale.altitude_m, |s, v| s.scale.altitude_m = v),
    ParamSlot { name: "STAT_NEXT_BOOT", kind: INT, holds: Holds::NextBoot },
    count("STAT_RX_FRAMES", |c| c.frames),
    count("STAT_RX_BADCRC", |c| c.bad_crc),
    count("STAT_RX_TRUNC", |c| c.truncated),
    count("STAT_RX_UNKNOWN", |c| c.unknown),
    count("STAT_RX_V1", |c| c.mavlink1),
    count("STAT_RX_INCOMP", |c| c.incompatible),
    count("STAT_RX_GARBAGE", |c| c.garbage_bytes),
    ParamSlot { name: "STAT_SETPOINTS", kind: INT, holds: Holds::Setpoints },
    ParamSlot { name: "STAT_SETP_REFD", kind: INT, holds: Holds::RefusedSetpoints },
];

static OF_RADIO: &[ParamSlot] = &[ParamSlot { name: "RADIO_TXP", kind: REAL, holds: Holds::TxPower }];

/// In the order of their numbers.
const RULES: [Rule; 3] = [Rule::Ideal, Rule::Drop, Rule::Queue];
const ACTIONS: [Action; 3] = [Action::Hold, Action::Brake, Action::Return];

fn number(action: Action) -> f64 {
    ACTIONS.iter().position(|&known| known == action).unwrap_or(0) as f64
}

/// A number that is no action's changes nothing, and is refused by that.
fn set_action(action: &mut Action, number: f64) {
    *action = ACTIONS.get(number as usize).copied().unwrap_or(*action);
}

/// A camera without a name is not told: it stays as it is.
fn set_camera(scenario: &mut Scenario, number: f64) {
    let case = CASES.iter().enumerate().find(|(index, _)| *index as f64 == number);
    if let Some(config) = case.and_then(|(_, case)| case.config().ok()) {
        scenario.camera = CameraConfig { edge_px: scenario.camera.edge_px, ..config };
    }
}

fn metres(scenario: &Scenario, units: f64) -> f64 {
    units * scenario.scale.metres_per_unit
}

fn units(scenario: &Scenario, metres: f64) -> f64 {
    rounded(metres / scenario.scale.metres_per_unit)
}

/// Former names, and what they are now.
const RENAMED: [(&str, &str); 1] = [("WIND_KICK", "WIND_GUST")];

/// Why a parameter of a file is not taken.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ParamError {
    /// There is none of this name.
    #[error("line {line}: there is no parameter {name}")]
    Unknown {
        /// Its line in the file, from 1.
        line: usize,
        /// Its name.
        name: String,
    },
    /// A former name.
    #[error("line {line}: `{name}` is now {new}")]
    Renamed {
        /// Its line in the file, from 1.
        line: usize,
        /// Its former name.
        name: String,
        /// Its name.
        new: &'static str,
    },
    /// Its value is out of range.
    #[error("line {line}: {name} = {value} is out of range")]
    Range {
        /// Its line in the file, from 1.
        line: usize,
        /// Its name.
        name: String,
        /// The value.
        value: f32,
    },
}

impl Vehicle {
    /// A vehicle that boots with these parameters: those that take effect at boot, too.
    ///
    /// # Errors
    /// A parameter that is unknown or out of range: the error names its line.
    pub fn boot(
        scenario: &Scenario,
        seed: u64,
        system: u8,
        ticks: Option<u64>,
        params: &[Entry],
    ) -> Result<Self, ParamError> {
        let mut trial = Self::new(Sim::new(scenario.clone(), seed), system, ticks);
        trial.load_params(params)?;
        let mut vehicle = Self::new(Sim::new(trial.settings, seed), system, ticks);
        vehicle.load_params(params)?;
        Ok(vehicle)
    }

    /// A component's table, in the order of its indices.
    fn table(&self, component: u8) -> Vec<&'static ParamSlot> {
        if component == RADIO {
            return OF_RADIO.iter().collect();
        }
        let obstacles = OF_OBSTACLES.iter().take(self.settings.obstacles.len()).flatten();
        OF_AUTOPILOT.iter().chain(obstacles).chain(AFTER_OBSTACLES).collect()
    }

    /// Index of the parameter with this name in a component's table.
    fn position(&self, component: u8, name: &str) -> Option<usize> {
        self.table(component).iter().position(|param| param.name == name)
    }

    /// Sets the parameters of a file; what is read only is left alone.
    ///
    /// Whether a place is free depends on others, which may stand below it in the file: what is refused by
    /// itself is set together at the end.
    fn load_params(&mut self, params: &[Entry]) -> Result<(), ParamError> {
        let (mut together, mut refused) = (self.settings.clone(), Vec::new());
        for Entry { line, name, value } in params {
            let (line, name, value) = (*line, name.clone(), *value);
            let found = [AUTOPILOT, RADIO].into_iter().flat_map(|component| self.table(component));
            let Some(param) = found.into_iter().find(|param| param.name == name) else {
                return Err(match RENAMED.iter().find(|(old, _)| *old == name) {
                    Some((_, new)) => ParamError::Renamed { line, name, new },
                    None => ParamError::Unknown { line, name },
                });
            };
            if param.get(&together).is_some_and(|known| known as f32 != value) {
                param.put(&mut together, value.into());
            }
            if !self.assign(param, value, Duration::ZERO) {
                refused.push((param, ParamError::Range { line, name, value }, value));
            }
        }
        if !refused.is_empty() && is_flyable(&together) {
            self.settings = together;
        }
        match refused.into_iter().find(|(param, _, value)| self.value(param) as f32 != *value) {
            Some((_, error, _)) => Err(error),
            None => Ok(()),
        }
    }

    /// All parameters that can be set, with their present values, the radio's last.
    #[must_use]
    pub fn settable_params(&self) -> Vec<(&'static str, f32)> {
        let params = [AUTOPILOT, RADIO].into_iter().flat_map(|component| self.table(component));
        params
            .filter(|param| param.is_settable())
            .map(|param| (param.name, self.value(param) as f32))
            .collect()
    }

    /// PARAM_SET.
    pub(super) fn param_set(
        &mut self,
        target: Target,
        name: &str,
        value: f32,
        asker: (u8, u8),
        from: PeerId,
        now: Duration,
    ) {
        let mut known = false;
        for component in self.meant(target) {
            let Some(index) = self.position(component, name) else { continue };
            known = true;
            self.assign(self.table(component)[index], value, now);
            let told = self.param_value(component, index);
            for (&address, peer) in &mut self.peers {
                let mut datagram = Vec::new();
                peer.encoder(component).push(&mut datagram, &told);
                self.outbox.push_back((address, datagram));
            }
        }
        if !known {
            self.no_param(target, -1, name, asker, from);
        }
    }

    /// PARAM_REQUEST_READ: by index, or by name if the index is -1.
    pub(super) fn param_read(
        &mut self,
        target: Target,
        index: i16,
        name: &str,
        asker: (u8, u8),
        from: PeerId,
    ) {
        let mut found = false;
        for component in self.meant(target) {
            let index =
                if index == -1 { self.position(component, name) } else { usize::try_from(index).ok() };
            let known = index.filter(|&index| index < self.table(component).len());
            found |= known.is_some();
            self.tell_params(component, known, from);
        }
        if !found {
            self.no_param(target, index, name, asker, from);
        }
    }

    /// PARAM_ERROR: none of the components that were asked has such a parameter.
    fn no_param(&mut self, target: Target, param_index: i16, name: &str, asker: (u8, u8), to: PeerId) {
        let Some(component) = self.meant(target).next() else { return };
        let (target_system, target_component) = asker;
        let error = dialect::PARAM_ERROR_DATA {
            param_index,
            target_system,
            target_component,
            param_id: name.into(),
            error: MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
        };
        let Some(peer) = self.peers.get_mut(&to) else { return };
        let mut datagram = Vec::new();
        peer.encoder(component).push(&mut datagram, &error);
        self.outbox.push_back((to, datagram));
    }

    /// PARAM_REQUEST_LIST.
    pub(super) fn param_list(&mut self, target: Target, from: PeerId) {
        for component in self.meant(target) {
            self.tell_params(component, 0..self.table(component).len(), from);
        }
    }

    fn meant(&self, target: Target) -> impl Iterator<Item = u8> + use<> {
        let system = self.system;
        [AUTOPILOT, RADIO].into_iter().filter(move |&component| target.is(system, component))
    }

    fn tell_params(&mut self, component: u8, indices: impl IntoIterator<Item = usize>, to: PeerId) {
        let values: Vec<_> = indices.into_iter().map(|index| self.param_value(component, index)).collect();
        let Some(peer) = self.peers.get_mut(&to) else { return };
        for some in values.chunks(DATAGRAM / (dialect::PARAM_VALUE_DATA::ENCODED_LEN + 12)) {
            let mut datagram = Vec::new();
            for value in some {
                peer.encoder(component).push(&mut datagram, value);
            }
            self.outbox.push_back((to, datagram));
        }
    }

    fn param_value(&self, component: u8, index: usize) -> dialect::PARAM_VALUE_DATA {
        let params = self.table(component);
        let param = params[index];
        dialect::PARAM_VALUE_DATA {
            param_value: self.value(param) as f32,
            param_count: params.len() as u16,
            param_index: index as u16,
            param_id: param.name.into(),
            param_type: param.kind,
        }
    }

    fn value(&self, param: &ParamSlot) -> f64 {
        match param.holds {
            Holds::System => f64::from(self.system),
            Holds::Rate(id) => self.default_hz(id),
            Holds::TxPower => self.sim.power().level(),
            Holds::SignRequired => f64::from(u8::from(self.signing.policy() == Policy::Required)),
            Holds::FenceAction => number(self.fence_action),
            Holds::Count(get) => get(&self.tally().packets) as f64,
            Holds::Setpoints => self.tally.setpoints as f64,
            Holds::RefusedSetpoints => self.tally.refused.values().sum::<u64>() as f64,
            Holds::NextBoot => f64::from(u8::from(self.is_for_next_boot())),
            Holds::Told(..) | Holds::Setting(..) | Holds::Obstacle(..) | Holds::ObstacleTold(..) => {
                param.get(&self.settings).unwrap_or(f64::NAN)
            }
        }
    }

    /// Whether the settings are another flight than the one that is flown. What takes effect at once is not.
    fn is_for_next_boot(&self) -> bool {
        let flown = self.sim.scenario();
        let (failsafe, autopilot) = (self.settings.failsafe.clone(), self.settings.autopilot.clone());
        self.settings != Scenario { failsafe, autopilot, ..flown.clone() }
    }

    /// Takes a value if the parameter can have it. Whether it holds that value now, or is read only.
    fn assign(&mut self, param: &ParamSlot, value: f32, now: Duration) -> bool {
        if !param.is_settable() {
            return true;
        }
        // What it has already is not set again: a float is narrower than what the scenario holds.
        if self.value(param) as f32 == value {
            return true;
        }
        if !value.is_finite() || param.kind == INT && value.fract() != 0.0 {
            return false;
        }
        match param.holds {
            Holds::Rate(id) if Self::takes_rate(value) => {
                self.set_default_hz(id, value.into(), now);
            }
            Holds::TxPower => {
                if let Ok(power) = TxPower::from_level(value) {
                    self.sim.set_power(power);
                }
            }
            Holds::FenceAction if value >= 0.0 => set_action(&mut self.fence_action, value.into()),
            Holds::SignRequired if value == 0.0 => self.signing.set_policy(Policy::Optional),
            Holds::SignRequired if value == 1.0 => self.signing.set_policy(Policy::Required),
            _ => {
                let mut settings = self.settings.clone();
                param.put(&mut settings, value.into());
                if is_flyable(&settings) {
                    self.settings = settings;
                }
            }
        }
        self.value(param) as f32 == value
    }
}

impl ObstacleUnit {
    /// How many m, or m/s, are one unit, or one unit per interval.
    fn size(self, settings: &Scenario) -> f64 {
        match self {
            Self::Length => settings.scale.metres_per_unit,
            Self::Speed => settings.scale.mps_per_speed(),
        }
    }
}

/// A parameter that a world has and a vehicle did not tell.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no parameter {0}")]
pub struct NoSuchParameter(pub &'static str);

/// The parameters that tell a vehicle's world, with their values in `scenario`: all that decides a flight and its
/// score but for the observer, which is the station's, and a camera without a name.
#[must_use]
pub fn world_params(scenario: &Scenario) -> Vec<(&'static str, f32)> {
    let slots = world_slots(scenario.obstacles.len());
    slots.filter_map(|slot| Some((slot.name, slot.get(scenario)? as f32))).collect()
}

/// The scenario that these parameters tell, each by its name; numbers are the shortest decimals that a parameter
/// holds. Unknown names are left out.
///
/// # Errors
/// A parameter of [`world_params`] is missing.
pub fn world_of(params: &[(String, f32)]) -> Result<Scenario, NoSuchParameter> {
    let value = |name: &str| params.iter().find(|(known, _)| known == name).map(|(_, value)| *value);
    let named = |slots: &[ParamSlot]| slots.iter().any(|slot| value(slot.name).is_some());
    let obstacles = OF_OBSTACLES.iter().take_while(|slots| named(&slots[..])).count();
    let mut world = Scenario { name: "the vehicle's".into(), ..Scenario::default() };
    world.obstacles = vec![Obstacle::default(); obstacles];
    // The scale comes first: lengths and speeds are told in its units.
    let is_scale = |slot: &&ParamSlot| slot.name.starts_with("SCALE_");
    let slots: Vec<&ParamSlot> = world_slots(obstacles).collect();
    for slot in slots.iter().filter(|slot| is_scale(slot)).chain(slots.iter().filter(|slot| !is_scale(slot)))
    {
        let told = value(slot.name).ok_or(NoSuchParameter(slot.name))?;
        // The shortest decimal that reads back as this float: 2.75 and not 2.7500000000000001.
        let told: f64 = told.to_string().parse().unwrap_or(f64::NAN);
        match slot.holds {
            Holds::Told(_, set) | Holds::Setting(_, set) => set(&mut world, told),
            Holds::Obstacle(index, length) => {
                *length(&mut world.obstacles[index]) = units(&world, told);
            }
            Holds::ObstacleTold(index, unit, of) => {
                *of(&mut world.obstacles[index]) = rounded(told / unit.size(&world));
            }
            _ => {}
        }
    }
    Ok(world)
}

/// The shortest decimal within a float's rounding of x: what a division by the scale has left of a typed number.
fn rounded(x: f64) -> f64 {
    let near = |digits: usize| {
        format!("{x:.digits$e}").parse().ok().filter(|y: &f64| (y - x).abs() <= 1.2e-7 * x.abs())
    };
    (0..=8).find_map(near).unwrap_or(x)
}

/// The rows of the autopilot's table that hold a world's values.
fn world_slots(obstacles: usize) -> impl Iterator<Item = &'static ParamSlot> {
    let obstacles = OF_OBSTACLES.iter().take(obstacles).flatten();
    OF_AUTOPILOT.iter().chain(obstacles).chain(AFTER_OBSTACLES).filter(|slot| {
        let holds = &slot.holds;
        matches!(holds, Holds::Told(..) | Holds::Setting(..) | Holds::Obstacle(..) | Holds::ObstacleTold(..))
    })
}

/// Whether settings are a scenario, in which the vehicle by itself is no faster than it can be.
pub(super) fn is_flyable(settings: &Scenario) -> bool {
    let top_mps = settings.dynamics.v_max * settings.scale.mps_per_speed();
    settings.check().is_ok() && settings.autopilot.speed_mps <= top_mps * (1.0 + 1e-6)
}

impl ParamSlot {
    /// Its value in a scenario, if it is one of a scenario.
    fn get(&self, settings: &Scenario) -> Option<f64> {
        match self.holds {
            Holds::Told(get, _) | Holds::Setting(get, _) => Some(get(settings)),
            Holds::ObstacleTold(index, unit, value) => {
                let mut obstacle = settings.obstacles[index].clone();
                Some(*value(&mut obstacle) * unit.size(settings))
            }
            Holds::Obstacle(index, length) => {
                let mut obstacle = settings.obstacles[index].clone();
                Some(metres(settings, *length(&mut obstacle)))
            }
            _ => None,
        }
    }

    /// Puts a value into a scenario, if it is one of a scenario and at least 0.
    fn put(&self, settings: &mut Scenario, value: f64) {
        match self.holds {
            Holds::Setting(_, set) if value >= 0.0 => set(settings, value),
            Holds::Obstacle(index, length) if value >= 0.0 => {
                *length(&mut settings.obstacles[index]) = units(settings, value);
            }
            _ => {}
        }
    }

    fn is_settable(&self) -> bool {
        matches!(
            self.holds,
            Holds::Rate(_)
                | Holds::TxPower
                | Holds::SignRequired
                | Holds::FenceAction
                | Holds::Setting(..)
                | Holds::Obstacle(..)
        )
    }
}
