//! The parameter protocol over two tables: the autopilot's (component 1) and the radio's (68).
//! Values are cast to float as in C, as the capabilities say.
//!
//! | parameter | from | unit | written |
//! |---|---|---|---|
//! | `SYSID_THISMAV` | 1 | | no |
//! | `RATE_ATTITUDE`, `_GLOBAL`, `_STATUS`, `_TIME`, `_EXTENDED`, `_BATTERY`, `_HOME` | 1 | Hz, 0 to 50 | yes: the default of every peer's stream, at once for all |
//! | `RADIO_RULE` | 1 | 0 ideal, 1 drop, 2 queue | no |
//! | `RADIO_B_DT`, `RADIO_PKT_BITS` | 1 | bits an interval and bit/s/Hz; bits | no |
//! | `CHAN_REF_GAIN`, `CHAN_PL_EXP`, `CHAN_NLOS`, `CHAN_NOISE`, `CHAN_SNR_MIN` | 1 | the paper's | no |
//! | `DYN_V_MAX`, `DYN_A_MAX`, `DYN_WALLS` | 1 | m/s; m/s²; 0 or 1 | no |
//! | `WIND_KICK` | 1 | m/s, standard deviation an interval and axis | no |
//! | `UAV_RADIUS`, `OBST_RADIUS`, `GOAL_N`, `GOAL_E`, `GOAL_RADIUS` | 1 | m | no |
//! | `SCALE_UNIT_M`, `SCALE_DT_S`, `SCALE_ALT_M` | 1 | m; s; m | no |
//! | `RADIO_TXP` | 68 | 1 or 4 | yes |
//!
//! A PARAM_SET is always answered to all peers with the value that now holds: the old one if the new
//! one is not finite, out of range, or the parameter only to be read (a flight's scenario is fixed).
//! Unknown names and indices are met with silence, as ArduPilot does. A request to component 0 is
//! answered by both.

use std::time::Duration;

use mavlink::MessageData;

use super::Vehicle;
use crate::link::dialect::{self, MavParamType};
use crate::link::encoder::DATAGRAM;
use crate::link::wire::Target;
use crate::link::{AUTOPILOT, PeerId, RADIO};
use crate::msg::TxPower;
use crate::scenario::{Rule, Scenario};

/// A parameter's place in its component's table, its name and what it holds.
struct Param {
    name: &'static str,
    kind: MavParamType,
    holds: Holds,
}

enum Holds {
    System,
    /// The default rate of the message with this id.
    Rate(u32),
    TxPower,
    /// A value of the scenario.
    Of(fn(&Scenario) -> f64),
}

const REAL: MavParamType = MavParamType::MAV_PARAM_TYPE_REAL32;
/// MAVSDK knows no narrower integer.
const INT: MavParamType = MavParamType::MAV_PARAM_TYPE_INT32;

const fn rate(name: &'static str, id: u32) -> Param {
    Param { name, kind: REAL, holds: Holds::Rate(id) }
}

const fn of(name: &'static str, kind: MavParamType, value: fn(&Scenario) -> f64) -> Param {
    Param { name, kind, holds: Holds::Of(value) }
}

static OF_AUTOPILOT: &[Param] = &[
    Param { name: "SYSID_THISMAV", kind: INT, holds: Holds::System },
    rate("RATE_ATTITUDE", dialect::ATTITUDE_DATA::ID),
    rate("RATE_GLOBAL", dialect::GLOBAL_POSITION_INT_DATA::ID),
    rate("RATE_STATUS", dialect::SYS_STATUS_DATA::ID),
    rate("RATE_TIME", dialect::SYSTEM_TIME_DATA::ID),
    rate("RATE_EXTENDED", dialect::EXTENDED_SYS_STATE_DATA::ID),
    rate("RATE_BATTERY", dialect::BATTERY_STATUS_DATA::ID),
    rate("RATE_HOME", dialect::HOME_POSITION_DATA::ID),
    of("RADIO_RULE", INT, |s| match s.radio.rule {
        Rule::Ideal => 0.0,
        Rule::Drop => 1.0,
        Rule::Queue => 2.0,
    }),
    of("RADIO_B_DT", REAL, |s| s.radio.b_dt),
    of("RADIO_PKT_BITS", REAL, |s| s.radio.packet_bits),
    of("CHAN_REF_GAIN", REAL, |s| s.channel.reference_gain),
    of("CHAN_PL_EXP", REAL, |s| s.channel.path_loss_exponent),
    of("CHAN_NLOS", REAL, |s| s.channel.nlos_attenuation),
    of("CHAN_NOISE", REAL, |s| s.channel.noise_power),
    of("CHAN_SNR_MIN", REAL, |s| s.channel.snr_min),
    of("DYN_V_MAX", REAL, |s| s.dynamics.v_max * s.scale.mps_per_speed()),
    of("DYN_A_MAX", REAL, |s| s.dynamics.a_max * s.scale.mps_per_speed() / s.scale.interval_s),
    of("DYN_WALLS", INT, |s| f64::from(u8::from(s.dynamics.walls))),
    of("WIND_KICK", REAL, |s| s.disturbance.kick() * s.scale.mps_per_speed()),
    of("UAV_RADIUS", REAL, |s| s.uav_radius * s.scale.metres_per_unit),
    of("OBST_RADIUS", REAL, |s| s.obstacle.radius * s.scale.metres_per_unit),
    of("GOAL_N", REAL, |s| s.goal.y * s.scale.metres_per_unit),
    of("GOAL_E", REAL, |s| s.goal.x * s.scale.metres_per_unit),
    of("GOAL_RADIUS", REAL, |s| s.goal_radius * s.scale.metres_per_unit),
    of("SCALE_UNIT_M", REAL, |s| s.scale.metres_per_unit),
    of("SCALE_DT_S", REAL, |s| s.scale.interval_s),
    of("SCALE_ALT_M", REAL, |s| s.scale.altitude_m),
];

static OF_RADIO: &[Param] = &[Param { name: "RADIO_TXP", kind: REAL, holds: Holds::TxPower }];

fn table(component: u8) -> &'static [Param] {
    if component == RADIO { OF_RADIO } else { OF_AUTOPILOT }
}

fn position(component: u8, name: &str) -> Option<usize> {
    table(component).iter().position(|param| param.name == name)
}

impl Vehicle {
    /// PARAM_SET.
    pub(super) fn param_set(&mut self, target: Target, name: &str, value: f32, now: Duration) {
        for component in self.meant(target) {
            let Some(index) = position(component, name) else { continue };
            self.assign(&table(component)[index], value, now);
            let told = self.param_value(component, index);
            for (&address, peer) in &mut self.peers {
                let mut datagram = Vec::new();
                peer.encoder(component).push(&mut datagram, &told);
                self.outbox.push_back((address, datagram));
            }
        }
    }

    /// PARAM_REQUEST_READ: by index, or by name if the index is -1.
    pub(super) fn param_read(&mut self, target: Target, index: i16, name: &str, from: PeerId) {
        for component in self.meant(target) {
            let index = if index == -1 { position(component, name) } else { usize::try_from(index).ok() };
            let known = index.filter(|&index| index < table(component).len());
            self.tell_params(component, known, from);
        }
    }

    /// PARAM_REQUEST_LIST.
    pub(super) fn param_list(&mut self, target: Target, from: PeerId) {
        for component in self.meant(target) {
            self.tell_params(component, 0..table(component).len(), from);
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
        let params = table(component);
        let param = &params[index];
        let value = match param.holds {
            Holds::System => f64::from(self.system),
            Holds::Rate(id) => self.default_hz(id),
            Holds::TxPower => self.sim.power().level(),
            Holds::Of(value) => value(self.sim.scenario()),
        };
        dialect::PARAM_VALUE_DATA {
            param_value: value as f32,
            param_count: params.len() as u16,
            param_index: index as u16,
            param_id: param.name.into(),
            param_type: param.kind,
        }
    }

    /// Takes a value if the parameter can have it.
    fn assign(&mut self, param: &Param, value: f32, now: Duration) {
        match param.holds {
            Holds::Rate(id) if (0.0..=50.0).contains(&value) => self.set_default_hz(id, value.into(), now),
            Holds::TxPower => {
                if let Ok(power) = TxPower::from_level(value) {
                    self.sim.set_power(power);
                }
            }
            _ => {}
        }
    }
}
