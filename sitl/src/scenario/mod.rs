//! Every parameter of a flight. `Default` is the paper; a file holds only what differs from it.
//!
//! What the paper does not give is marked *our choice* here and argued in `docs/choices.md`.
//! An unknown key is an error, and after [`Scenario::load`] nothing checks ranges again.

pub mod presets;

use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::camera::Sizes;
use crate::camera::effects::Effects;
use crate::units::{MAX_OBSTACLES, Scale};

/// One flight's parameters. Lengths in the paper's units, times in control intervals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scenario {
    /// Name in reports and plots.
    pub name: String,
    /// Number of control intervals H.
    pub horizon: u64,
    /// Start r_c,0, at rest.
    pub start: Vector2<f64>,
    /// Goal r_g.
    pub goal: Vector2<f64>,
    /// Radius of the goal region.
    pub goal_radius: f64,
    /// R_u, radius of the UAV (our choice).
    pub uav_radius: f64,
    /// The uncontrollable entities, at most [`MAX_OBSTACLES`]; the paper has one. In a file each is a
    /// table `[[obstacle]]`, and `obstacle = []` is a flight without any.
    #[serde(rename = "obstacle")]
    pub obstacles: Vec<Obstacle>,
    /// Motion of the UAV.
    pub dynamics: Dynamics,
    /// Disturbance of the UAV's speed.
    pub disturbance: Disturbance,
    /// Path loss and blockage.
    pub channel: Channel,
    /// Packets.
    pub radio: Radio,
    /// Collision probability and its tolerance.
    pub safety: Safety,
    /// Rotary-wing power.
    pub propulsion: Propulsion,
    /// NED metres and seconds.
    pub scale: Scale,
    /// What the camera draws.
    pub camera: Camera,
    /// How the ground station tells place and speed from pictures.
    pub observer: Observer,
    /// What the vehicle does when it hears nothing.
    pub failsafe: Failsafe,
    /// How the vehicle flies by itself: missions, return, landing.
    pub autopilot: Autopilot,
}

impl Sizes for Scenario {
    fn uav_radius(&self) -> f64 {
        self.uav_radius
    }

    fn obstacle_radii(&self) -> impl Iterator<Item = f64> {
        self.obstacles.iter().map(|obstacle| obstacle.radius)
    }

    fn edge_px(&self) -> f64 {
        self.camera.edge_px
    }
}

impl Default for Scenario {
    /// Scenario 2 of the paper: the obstacle in the direct path.
    fn default() -> Self {
        Self {
            name: "scenario 2".into(),
            horizon: 100,
            start: Vector2::new(0.1, 0.5),
            goal: Vector2::new(0.9, 0.5),
            goal_radius: 0.05,
            uav_radius: 0.02,
            obstacles: vec![Obstacle::PAPER],
            dynamics: Dynamics::default(),
            disturbance: Disturbance::default(),
            channel: Channel::default(),
            radio: Radio::default(),
            safety: Safety::default(),
            propulsion: Propulsion::default(),
            scale: Scale::default(),
            camera: Camera::default(),
            observer: Observer::default(),
            failsafe: Failsafe::default(),
            autopilot: Autopilot::default(),
        }
    }
}

/// An obstacle: stands in the paper's flights, moves and reflects in training data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Obstacle {
    /// r_u,0: (0.5, 0.30) in Scenario 1, (0.5, 0.45) in Scenario 2.
    pub position: Vector2<f64>,
    /// v_u, units per interval; zero stands.
    pub velocity: Vector2<f64>,
    /// R_o (our choice).
    pub radius: f64,
    /// Distance of its centre to a wall at which it reflects (our choice: its drawn edge touches).
    pub margin: f64,
}

impl Default for Obstacle {
    fn default() -> Self {
        Self::PAPER
    }
}

impl Obstacle {
    /// Scenario 2's.
    const PAPER: Self = Self {
        position: Vector2::new(0.5, 0.45),
        velocity: Vector2::new(0.0, 0.0),
        radius: 0.10,
        margin: 0.12,
    };

    /// Checks obstacle number `index` of a scenario.
    fn check(&self, index: usize) -> Result<(), ScenarioError> {
        let check = |key: &str, value: f64, good: bool, must| {
            if good { Ok(()) } else { check(&format!("obstacle[{index}].{key}"), value, false, must) }
        };
        let (radius, margin) = (self.radius, self.margin);
        check("radius", radius, radius > 0.0 && radius <= 1.0, SIZE)?;
        check("margin", margin, (0.0..0.5).contains(&margin), "must lie in [0, 0.5)")?;
        let (speed, most) = (self.velocity.norm(), (1.0 - 2.0 * margin).min(0.5));
        let must = "must be at most 0.5 units per interval, and at most 1 - 2 margin";
        check("velocity", speed, speed <= most, must)?;
        for (axis, key) in ["position[0]", "position[1]"].into_iter().enumerate() {
            let (r, v) = (self.position[axis], self.velocity[axis]);
            check(key, r, (0.0..=1.0).contains(&r), UNIT)?;
            let must = "must be its margin or more from the walls if it moves";
            let inside = margin..=1.0 - margin;
            check(key, r, v == 0.0 || inside.contains(&r), must)?;
        }
        Ok(())
    }
}

/// Second-order motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Dynamics {
    /// v_max, units per interval.
    pub v_max: f64,
    /// a_max, units per interval².
    pub a_max: f64,
    /// Whether `[0, 1]²` has walls (our choice: yes).
    pub walls: bool,
}

impl Default for Dynamics {
    fn default() -> Self {
        Self { v_max: 0.04, a_max: 3.5e-3, walls: true }
    }
}

/// Disturbance of the speed: w_k times `noise_gain` · `sigma_c`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Disturbance {
    /// σ_c of Eq. (30).
    pub sigma_c: f64,
    /// Kick per unit of σ_c (our choice: 0.3; read literally, 1, no controller reaches the goal).
    pub noise_gain: f64,
}

impl Default for Disturbance {
    fn default() -> Self {
        Self { sigma_c: 0.0, noise_gain: 0.3 }
    }
}

impl Disturbance {
    /// Standard deviation of the speed's kick in each axis, units per interval.
    #[must_use]
    pub fn kick(&self) -> f64 {
        self.noise_gain * self.sigma_c
    }
}

/// What the camera adds to geometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Camera {
    /// w, width of a disc's soft rim, px (our choice).
    pub edge_px: f64,
    /// What lens, sensor and scene add to the clean frame; nothing by default.
    pub effects: Effects,
}

impl Default for Camera {
    fn default() -> Self {
        Self { edge_px: 4.0, effects: Effects::default() }
    }
}

/// Geometry to SNR.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Channel {
    /// r_BS
    pub base_station: Vector2<f64>,
    /// G0
    pub reference_gain: f64,
    /// α_PL
    pub path_loss_exponent: f64,
    /// κ_NLOS
    pub nlos_attenuation: f64,
    /// P_n (our choice).
    pub noise_power: f64,
    /// τ_b, softness of the obstacle's shadow (our choice).
    pub blockage_softness: f64,
    /// Smallest distance in the path loss (our choice).
    pub distance_floor: f64,
    /// γ_min
    pub snr_min: f64,
}

impl Default for Channel {
    fn default() -> Self {
        Self {
            base_station: Vector2::new(0.5, 0.05),
            reference_gain: 1.0,
            path_loss_exponent: 2.0,
            nlos_attenuation: 0.1,
            noise_power: 1.0,
            blockage_softness: 0.02,
            distance_floor: 1e-3,
            snr_min: 1.0,
        }
    }
}

/// What happens to a packet that an interval could not carry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rule {
    /// Every packet gets through: the paper's Figs. 4 and 5.
    Ideal,
    /// It is lost (Sec. IV-A4): the paper's Figs. 6 and 7.
    Drop,
    /// It is sent again in the next interval, unless a newer one has taken its place.
    Queue,
}

/// The ground station's latent observer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Observer {
    /// M, pictures from which place and speed are told; 2 is their difference (our choice).
    pub window: u64,
}

impl Default for Observer {
    fn default() -> Self {
        Self { window: 2 }
    }
}

/// The packet link.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Radio {
    /// What becomes of a packet in an outage.
    pub rule: Rule,
    /// B Δt, bits per interval and unit of spectral efficiency (our choice: 4, where the outage
    /// begins at γ = γ_min = 1). The paper sweeps B without naming its values.
    pub b_dt: f64,
    /// L_pkt, bits.
    pub packet_bits: f64,
}

impl Default for Radio {
    fn default() -> Self {
        Self { rule: Rule::Drop, b_dt: 4.0, packet_bits: 4.0 }
    }
}

/// Collision probability and the tolerances of the chance constraints.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Safety {
    /// d_min
    pub d_min: f64,
    /// τ_c, softness of the collision probability (our choice).
    pub softness: f64,
    /// δ1
    pub collision_tolerance: f64,
    /// δ2
    pub outage_tolerance: f64,
}

impl Default for Safety {
    fn default() -> Self {
        Self { d_min: 0.0, softness: 0.02, collision_tolerance: 0.05, outage_tolerance: 0.05 }
    }
}

/// Rotary-wing power model; all given by the paper (Sec. IV-A6), SI units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Propulsion {
    /// P0, W
    pub blade_profile_power: f64,
    /// P_i, W
    pub induced_power: f64,
    /// U_tip, m/s
    pub tip_speed: f64,
    /// v0, m/s
    pub hover_induced_velocity: f64,
    /// d0
    pub fuselage_drag_ratio: f64,
    /// ρ, kg/m³
    pub air_density: f64,
    /// s
    pub rotor_solidity: f64,
    /// A, m²
    pub rotor_area: f64,
}

impl Default for Propulsion {
    fn default() -> Self {
        Self {
            blade_profile_power: 79.0,
            induced_power: 88.0,
            tip_speed: 120.0,
            hover_induced_velocity: 4.0,
            fuselage_drag_ratio: 0.3,
            air_density: 1.225,
            rotor_solidity: 0.05,
            rotor_area: 0.5,
        }
    }
}

/// What the vehicle does on its own when something is not heard any longer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Action {
    /// Goes on as before: the paper's rule (Sec. IV-A4), a UAV holds its last action.
    Hold,
    /// Brakes to a stop, as ArduCopter in GUIDED does.
    Brake,
    /// Flies back to the start and lands.
    Return,
}

/// Time-outs and what follows them. The vehicle counts control intervals, not the wall's seconds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Failsafe {
    /// When no setpoint has got through the radio for `setpoint_timeout_s` in GUIDED.
    pub setpoint_action: Action,
    /// Seconds of flight (our choice: ArduCopter's GUID_TIMEOUT).
    pub setpoint_timeout_s: f64,
    /// When no station has got anything through the radio for `station_timeout_s`.
    pub station_action: Action,
    /// Seconds (our choice: ArduCopter's FS_GCS_TIMEOUT, five heartbeats).
    pub station_timeout_s: f64,
}

impl Default for Failsafe {
    fn default() -> Self {
        Self {
            setpoint_action: Action::Hold,
            setpoint_timeout_s: 3.0,
            station_action: Action::Hold,
            station_timeout_s: 5.0,
        }
    }
}

/// How the vehicle flies by itself. No experiment of the paper does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Autopilot {
    /// Cruise speed, m/s (our choice).
    pub speed_mps: f64,
    /// A waypoint is reached within this distance, m (our choice).
    pub acceptance_m: f64,
    /// Speed of climb and descent, m/s (our choice).
    pub climb_mps: f64,
}

impl Default for Autopilot {
    fn default() -> Self {
        Self { speed_mps: 20.0, acceptance_m: 5.0, climb_mps: 5.0 }
    }
}

/// Why a scenario could not be used.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file could not be read.
    #[error("reading {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not a scenario.
    #[error("reading {path}: {message}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, key and reason, from the parser.
        message: String,
    },
    /// A value is out of range.
    #[error("{key} = {value}: {must}")]
    Range {
        /// Dotted key.
        key: String,
        /// The value found.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// A spelling of a former version.
    #[error("`{old}` is now {new}")]
    Renamed {
        /// The former key.
        old: &'static str,
        /// What to write instead.
        new: &'static str,
    },
    /// `--scenario` names neither a preset nor a file.
    #[error("there is no scenario file `{name}`, and no such preset; presets: {}", presets::names())]
    Unknown {
        /// What was given.
        name: String,
    },
    /// The paper has Scenarios 1 and 2.
    #[error("there is no scenario {0}; the paper has 1 and 2")]
    Number(u8),
}

impl Scenario {
    /// The paper's Scenario 1 or 2.
    pub fn numbered(number: u8) -> Result<Self, ScenarioError> {
        let mut scenario = Self::default();
        scenario.set_number(number)?;
        Ok(scenario)
    }

    /// Puts the first obstacle where Scenario 1 or 2 has it; all else stays.
    pub fn set_number(&mut self, number: u8) -> Result<(), ScenarioError> {
        let position = match number {
            1 => Vector2::new(0.50, 0.30),
            2 => Vector2::new(0.50, 0.45),
            other => return Err(ScenarioError::Number(other)),
        };
        match self.obstacles.first_mut() {
            Some(first) => first.position = position,
            None => self.obstacles.push(Obstacle { position, ..Obstacle::PAPER }),
        }
        self.name = format!("scenario {number}");
        Ok(())
    }

    /// 1 or 2 if the first obstacle is where the paper's scenario has it.
    #[must_use]
    pub fn number(&self) -> Option<u8> {
        let position = self.obstacles.first()?.position;
        (1..=2).find(|&n| Self::numbered(n).is_ok_and(|s| s.obstacle().position == position))
    }

    /// The first obstacle: the one that the paper has and that a world model is trained beside. The
    /// paper's own where the list is empty.
    #[must_use]
    pub fn obstacle(&self) -> &Obstacle {
        self.obstacles.first().unwrap_or(&Obstacle::PAPER)
    }

    /// Reads a TOML file; keys that it leaves out keep the paper's values.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ScenarioError::Read { path: path.into(), source })?;
        Self::from_toml(&text)
            .map_err(|message| ScenarioError::Parse { path: path.into(), message: message.to_string() })
    }

    /// Parses and checks a TOML text.
    pub fn from_toml(text: &str) -> Result<Self, anyhow::Error> {
        let scenario: Self = toml::from_str(text).map_err(|error| match renamed(text) {
            Some(renamed) => anyhow::Error::from(renamed),
            None => error.into(),
        })?;
        scenario.check()?;
        Ok(scenario)
    }

    /// Checks every range.
    pub fn check(&self) -> Result<(), ScenarioError> {
        let positive = "must be finite and above 0";
        let finite = "must be finite and at least 0";
        for (key, value) in [
            ("scale.metres_per_unit", self.scale.metres_per_unit),
            ("scale.interval_s", self.scale.interval_s),
            ("dynamics.v_max", self.dynamics.v_max),
            ("dynamics.a_max", self.dynamics.a_max),
            ("goal_radius", self.goal_radius),
            ("channel.noise_power", self.channel.noise_power),
            ("channel.blockage_softness", self.channel.blockage_softness),
            ("channel.distance_floor", self.channel.distance_floor),
            ("channel.reference_gain", self.channel.reference_gain),
            ("channel.snr_min", self.channel.snr_min),
            ("radio.b_dt", self.radio.b_dt),
            ("radio.packet_bits", self.radio.packet_bits),
            ("safety.softness", self.safety.softness),
            ("propulsion.blade_profile_power", self.propulsion.blade_profile_power),
            ("propulsion.induced_power", self.propulsion.induced_power),
            ("propulsion.tip_speed", self.propulsion.tip_speed),
            ("propulsion.hover_induced_velocity", self.propulsion.hover_induced_velocity),
            ("failsafe.setpoint_timeout_s", self.failsafe.setpoint_timeout_s),
            ("failsafe.station_timeout_s", self.failsafe.station_timeout_s),
            ("autopilot.speed_mps", self.autopilot.speed_mps),
            ("autopilot.acceptance_m", self.autopilot.acceptance_m),
            ("autopilot.climb_mps", self.autopilot.climb_mps),
        ] {
            check(key, value, value > 0.0 && value.is_finite(), positive)?;
        }
        for (key, value, most) in
            [("uav_radius", self.uav_radius, 1.0), ("camera.edge_px", self.camera.edge_px, 100.0)]
        {
            check(key, value, value > 0.0 && value <= most, SIZE)?;
        }
        for (key, value) in [
            ("start[0]", self.start.x),
            ("start[1]", self.start.y),
            ("goal[0]", self.goal.x),
            ("goal[1]", self.goal.y),
            ("channel.base_station[0]", self.channel.base_station.x),
            ("channel.base_station[1]", self.channel.base_station.y),
            ("channel.nlos_attenuation", self.channel.nlos_attenuation),
            ("safety.collision_tolerance", self.safety.collision_tolerance),
            ("safety.outage_tolerance", self.safety.outage_tolerance),
        ] {
            check(key, value, (0.0..=1.0).contains(&value), UNIT)?;
        }
        for (key, value) in [
            ("disturbance.sigma_c", self.disturbance.sigma_c),
            ("disturbance.noise_gain", self.disturbance.noise_gain),
            ("safety.d_min", self.safety.d_min),
            ("channel.path_loss_exponent", self.channel.path_loss_exponent),
            ("propulsion.fuselage_drag_ratio", self.propulsion.fuselage_drag_ratio),
            ("propulsion.air_density", self.propulsion.air_density),
            ("propulsion.rotor_solidity", self.propulsion.rotor_solidity),
            ("propulsion.rotor_area", self.propulsion.rotor_area),
            ("scale.altitude_m", self.scale.altitude_m),
        ] {
            check(key, value, value >= 0.0 && value.is_finite(), finite)?;
        }
        let count = self.obstacles.len();
        check("number of obstacles", count as f64, count <= MAX_OBSTACLES, "must be at most 8")?;
        for (n, obstacle) in self.obstacles.iter().enumerate() {
            obstacle.check(n)?;
            let is_alone = self.obstacles[..n].iter().all(|o| o.position != obstacle.position);
            let (key, x) = (format!("obstacle[{n}].position[0]"), obstacle.position.x);
            check(&key, x, is_alone, "must be another place than that of the obstacles before it")?;
        }
        if let Some((key, value, must)) = self.camera.effects.violation() {
            check(&format!("camera.effects.{key}"), value, false, must)?;
        }
        let interval = self.scale.interval_s;
        check("scale.interval_s", interval, interval >= 1e-3, "must be at least 0.001: time is told in ms")?;
        let window = self.observer.window as f64;
        check("observer.window", window, (2.0..=100.0).contains(&window), "must lie in 2..=100")?;
        let horizon = self.horizon as f64;
        check("horizon", horizon, horizon >= 1.0, "must be at least 1")
    }
}

const UNIT: &str = "must lie in [0, 1]";
const SIZE: &str = "must be above 0 and at most the width of the frame, 1 unit or 100 px";

fn check(key: &str, value: f64, good: bool, must: &'static str) -> Result<(), ScenarioError> {
    if good { Ok(()) } else { Err(ScenarioError::Range { key: key.into(), value, must }) }
}

/// Spellings of former versions and what to write now. A list under an old name is the new spelling.
const RENAMED: [(&str, &str); 2] = [
    ("obstacle", "one table [[obstacle]] for each obstacle; as an axis, obstacle[0]"),
    ("second_obstacle", "a further table [[obstacle]]; as an axis, obstacle[1]"),
];

/// The new spelling of a former key.
#[must_use]
pub fn new_spelling(key: &str) -> Option<&'static str> {
    RENAMED.iter().find(|(old, _)| *old == key).map(|(_, new)| *new)
}

/// The former spelling that a scenario's text uses.
fn renamed(text: &str) -> Option<ScenarioError> {
    let table: toml::Table = toml::from_str(text).ok()?;
    let is_old = |old: &str| {
        let mut keys = old.split('.');
        let first = table.get(keys.next()?);
        keys.fold(first, |value, key| value?.get(key)).filter(|value| !value.is_array())
    };
    let (old, new) = RENAMED.into_iter().find(|(old, _)| is_old(old).is_some())?;
    Some(ScenarioError::Renamed { old, new })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_survives_its_own_checks_and_toml() {
        let scenario = Scenario::default();
        scenario.check().unwrap();
        let text = toml::to_string(&scenario).unwrap();
        assert_eq!(Scenario::from_toml(&text).unwrap(), scenario);
    }

    #[test]
    fn a_misspelt_key_is_named() {
        let error = Scenario::from_toml("[radio]\nbandwith = 2.5\n").unwrap_err().to_string();
        assert!(error.contains("bandwith"), "{error}");
    }

    #[test]
    fn a_value_out_of_range_is_named() {
        let error = Scenario::from_toml("[radio]\nb_dt = -1.0\n").unwrap_err().to_string();
        assert_eq!(error, "radio.b_dt = -1: must be finite and above 0");
        assert!(Scenario::from_toml("[dynamics]\na_max = nan\n").is_err());
    }

    #[test]
    fn a_moving_obstacle_starts_and_stays_inside_its_margin() {
        let error = |text: &str| Scenario::from_toml(text).unwrap_err().to_string();
        let text = "[[obstacle]]\nposition = [0.1, 0.5]\nvelocity = [0.01, 0.0]\n";
        assert!(error(text).starts_with("obstacle[0].position[0] = 0.1: must be"), "{}", error(text));
        let text = "[[obstacle]]\nmargin = 0.45\nvelocity = [0.2, 0.0]\n";
        assert!(error(text).starts_with("obstacle[0].velocity = 0.2: must be"), "{}", error(text));
        assert!(Scenario::from_toml("[[obstacle]]\nposition = [0.1, 0.5]\n").is_ok(), "it stands");
    }

    #[test]
    fn a_second_obstacle_is_checked_as_the_first_is() {
        let second = |text: &str| Scenario::from_toml(&format!("[[obstacle]]\n[[obstacle]]\n{text}\n"));
        let scenario = second("position = [0.3, 0.8]\nvelocity = [0.01, 0.0]").unwrap();
        let again = Scenario::from_toml(&toml::to_string(&scenario).unwrap()).unwrap();
        assert_eq!(again, scenario);
        let error = second("position = [0.3, 0.8]\nradius = -1.0").unwrap_err().to_string();
        assert!(error.starts_with("obstacle[1].radius = -1: must be"), "{error}");
        let error = second("position = [0.05, 0.5]\nvelocity = [0.01, 0.0]").unwrap_err().to_string();
        assert!(error.starts_with("obstacle[1].position[0] = 0.05: must be"), "{error}");
        let error = second("radius = 0.1").unwrap_err().to_string();
        assert!(error.contains("must be another place"), "{error}");
        let error = second("postion = [0.3, 0.8]").unwrap_err().to_string();
        assert!(error.contains("postion"), "{error}");
    }

    #[test]
    fn any_number_of_obstacles_up_to_the_maximum_survives_toml() {
        for count in 0..=MAX_OBSTACLES + 1 {
            let mut scenario = Scenario::default();
            let place = |n| Vector2::new(0.5, 0.3 + 0.01 * n as f64);
            scenario.obstacles =
                (0..count).map(|n| Obstacle { position: place(n), ..Obstacle::PAPER }).collect();
            let again = Scenario::from_toml(&toml::to_string(&scenario).unwrap());
            match again {
                Ok(again) => assert_eq!(again, scenario),
                Err(error) => {
                    assert_eq!(count, MAX_OBSTACLES + 1);
                    assert_eq!(error.to_string(), "number of obstacles = 9: must be at most 8");
                }
            }
        }
    }

    #[test]
    fn a_former_spelling_names_the_new_one() {
        for old in ["[obstacle]\nradius = 0.2", "[second_obstacle]\nposition = [0.5, 0.8]"] {
            let error = Scenario::from_toml(old).unwrap_err().to_string();
            assert!(error.contains("[[obstacle]]"), "{error}");
        }
    }

    #[test]
    fn scenarios_have_numbers() {
        assert_eq!(Scenario::numbered(1).unwrap().number(), Some(1));
        assert_eq!(Scenario::default().number(), Some(2));
        assert!(Scenario::numbered(3).is_err());
    }
}
