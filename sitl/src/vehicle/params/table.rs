//! The tables of both components: each parameter's name, and what it holds.

use crate::camera::CameraConfig;
use crate::camera::cases::CASES;
use crate::link::MessageData;
use crate::link::dialect::{self, MavParamType};
use crate::link::splitter::Counts;
use crate::scenario::{Action, CollisionAction, Obstacle, Rule, Scenario};
use crate::units::MAX_OBSTACLES;

/// A parameter's place in its component's table, its name and what it holds.
pub(super) struct ParamSlot {
    pub name: &'static str,
    pub kind: MavParamType,
    pub holds: Holds,
}

type Get = fn(&Scenario) -> f64;
type Set = fn(&mut Scenario, f64);

pub(super) enum Holds {
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
pub(super) enum ObstacleUnit {
    /// m
    Length,
    /// m/s
    Speed,
}

const REAL: MavParamType = MavParamType::MAV_PARAM_TYPE_REAL32;
/// MAVSDK knows no narrower integer.
pub(super) const INT: MavParamType = MavParamType::MAV_PARAM_TYPE_INT32;

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
pub(super) static OF_AUTOPILOT: &[ParamSlot] = &[
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
pub(super) static OF_OBSTACLES: [[ParamSlot; 6]; MAX_OBSTACLES] = [
    of_obstacle(0, ["OBST_RADIUS", "OBST_N", "OBST_E", "OBST_VN", "OBST_VE", "OBST_MARGIN"]),
    of_obstacle(1, ["OBST2_RADIUS", "OBST2_N", "OBST2_E", "OBST2_VN", "OBST2_VE", "OBST2_MARGIN"]),
    of_obstacle(2, ["OBST3_RADIUS", "OBST3_N", "OBST3_E", "OBST3_VN", "OBST3_VE", "OBST3_MARGIN"]),
    of_obstacle(3, ["OBST4_RADIUS", "OBST4_N", "OBST4_E", "OBST4_VN", "OBST4_VE", "OBST4_MARGIN"]),
    of_obstacle(4, ["OBST5_RADIUS", "OBST5_N", "OBST5_E", "OBST5_VN", "OBST5_VE", "OBST5_MARGIN"]),
    of_obstacle(5, ["OBST6_RADIUS", "OBST6_N", "OBST6_E", "OBST6_VN", "OBST6_VE", "OBST6_MARGIN"]),
    of_obstacle(6, ["OBST7_RADIUS", "OBST7_N", "OBST7_E", "OBST7_VN", "OBST7_VE", "OBST7_MARGIN"]),
    of_obstacle(7, ["OBST8_RADIUS", "OBST8_N", "OBST8_E", "OBST8_VN", "OBST8_VE", "OBST8_MARGIN"]),
];

pub(super) static AFTER_OBSTACLES: &[ParamSlot] = &[
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

pub(super) static OF_RADIO: &[ParamSlot] =
    &[ParamSlot { name: "RADIO_TXP", kind: REAL, holds: Holds::TxPower }];

/// In the order of their numbers.
const RULES: [Rule; 3] = [Rule::Ideal, Rule::Drop, Rule::Queue];
const ACTIONS: [Action; 3] = [Action::Hold, Action::Brake, Action::Return];

pub(super) fn number(action: Action) -> f64 {
    ACTIONS.iter().position(|&known| known == action).unwrap_or(0) as f64
}

/// A number that is no action's changes nothing, and is refused by that.
pub(super) fn set_action(action: &mut Action, number: f64) {
    *action = ACTIONS.get(number as usize).copied().unwrap_or(*action);
}

/// A camera without a name is not told: it stays as it is.
fn set_camera(scenario: &mut Scenario, number: f64) {
    let case = CASES.iter().enumerate().find(|(index, _)| *index as f64 == number);
    if let Some(config) = case.and_then(|(_, case)| case.config().ok()) {
        scenario.camera = CameraConfig { edge_px: scenario.camera.edge_px, ..config };
    }
}

pub(super) fn metres(scenario: &Scenario, units: f64) -> f64 {
    units * scenario.scale.metres_per_unit
}

pub(super) fn units(scenario: &Scenario, metres: f64) -> f64 {
    rounded(metres / scenario.scale.metres_per_unit)
}

impl ObstacleUnit {
    /// How many m, or m/s, are one unit, or one unit per interval.
    pub fn size(self, settings: &Scenario) -> f64 {
        match self {
            Self::Length => settings.scale.metres_per_unit,
            Self::Speed => settings.scale.mps_per_speed(),
        }
    }
}

impl ParamSlot {
    /// Its value in a scenario, if it is one of a scenario.
    pub fn get(&self, settings: &Scenario) -> Option<f64> {
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
    pub fn put(&self, settings: &mut Scenario, value: f64) {
        match self.holds {
            Holds::Setting(_, set) if value >= 0.0 => set(settings, value),
            Holds::Obstacle(index, length) if value >= 0.0 => {
                *length(&mut settings.obstacles[index]) = units(settings, value);
            }
            _ => {}
        }
    }

    pub fn is_settable(&self) -> bool {
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

/// The shortest decimal within a float's rounding of x: what a division by the scale has left of a typed number.
pub(super) fn rounded(x: f64) -> f64 {
    let near = |digits: usize| {
        format!("{x:.digits$e}").parse().ok().filter(|y: &f64| (y - x).abs() <= 1.2e-7 * x.abs())
    };
    (0..=8).find_map(near).unwrap_or(x)
}
