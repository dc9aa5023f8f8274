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

mod table;
mod world;

pub use world::{NoSuchParameter, world_of, world_params};

use std::time::Duration;

use table::{
    AFTER_OBSTACLES, Holds, INT, OF_AUTOPILOT, OF_OBSTACLES, OF_RADIO, ParamSlot, number, set_action,
};

use super::Vehicle;
use crate::link::dialect::{self, MavParamError};
use crate::link::encoder::DATAGRAM;
use crate::link::messages::Target;
use crate::link::param_file::Entry;
use crate::link::signing::Policy;
use crate::link::{AUTOPILOT, PeerId, RADIO};
use crate::scenario::Scenario;
use crate::sim::Sim;
use crate::units::TxPower;

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

/// Whether settings are a scenario, in which the vehicle by itself is no faster than it can be.
pub(super) fn is_flyable(settings: &Scenario) -> bool {
    let top_mps = settings.dynamics.v_max * settings.scale.mps_per_speed();
    settings.check().is_ok() && settings.autopilot.speed_mps <= top_mps * (1.0 + 1e-6)
}
