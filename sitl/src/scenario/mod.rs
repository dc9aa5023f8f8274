//! Every parameter of a flight. `Default` is the paper; a file holds only what differs from it.
//!
//! What the paper does not give is marked *our choice* here and argued in `docs/choices.md`.
//! An unknown key is an error, and after [`Scenario::load`] nothing checks ranges again.

mod check;
pub mod keys;
pub mod presets;

pub use check::{ScenarioError, new_spelling};

use std::path::Path;

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::camera::cases::CameraError;
use crate::camera::{CameraConfig, Sizes};
use crate::units::{Scale, TxPower};

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
    /// The uncontrollable entities, at most [`crate::units::MAX_OBSTACLES`]; the paper has one. In a file each is a
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
    /// Weights of the stage cost.
    pub cost: Cost,
    /// Rotary-wing power.
    pub propulsion: Propulsion,
    /// NED metres and seconds.
    pub scale: Scale,
    /// What the camera draws.
    pub camera: CameraConfig,
    /// How the ground station tells place and speed from frames.
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
            cost: Cost::default(),
            propulsion: Propulsion::default(),
            scale: Scale::default(),
            camera: CameraConfig::default(),
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

/// Disturbance of the speed: w_k times `gust_scale` · `sigma_c`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Disturbance {
    /// σ_c of Eq. (30).
    pub sigma_c: f64,
    /// Standard deviation of a gust per unit of σ_c (our choice: 0.3; read literally, 1, no controller
    /// reaches the goal).
    pub gust_scale: f64,
}

impl Default for Disturbance {
    fn default() -> Self {
        Self { sigma_c: 0.0, gust_scale: 0.3 }
    }
}

impl Disturbance {
    /// Standard deviation of a gust, the change of the speed in each axis, units per interval.
    #[must_use]
    pub fn gust_std(&self) -> f64 {
        self.gust_scale * self.sigma_c
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
    /// M, frames from which place and speed are told; 2 is their difference (our choice).
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

/// What follows a collision with an obstacle. In the paper nothing does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CollisionAction {
    /// It flies on, through the obstacle.
    Continue,
    /// The motors stop, it falls, and the flight is over.
    Fall,
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
    /// What follows a collision.
    pub collision_action: CollisionAction,
    /// Distance of the UAV's centre to the field's edge that a flight must keep, units (our choice: R_u, its body
    /// does not touch the edge).
    pub edge_margin: f64,
}

impl Default for Safety {
    fn default() -> Self {
        Self {
            d_min: 0.0,
            softness: 0.02,
            collision_tolerance: 0.05,
            outage_tolerance: 0.05,
            collision_action: CollisionAction::Continue,
            edge_margin: 0.02,
        }
    }
}

/// Weights of the stage cost ℓ_k, Eq. (9), on true states: the objective that all controllers share.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Cost {
    /// Weight of |r - r_g|²: what the unknown latent scale of ‖z_c - z_g‖² stands for (our choice).
    pub goal: f64,
    /// λ_s, weight of ‖a_s‖² (our choice).
    pub motion: f64,
    /// λ_p, weight of a_p² (our choice).
    pub power: f64,
    /// Weight of |r - r_g|² in the last `settle_intervals` of the horizon, on top: a terminal cost, which the paper
    /// does not have. CRPL and APC optimise it; J does not count it (our choice).
    pub settle: f64,
    /// See `settle`.
    pub settle_intervals: u64,
}

impl Default for Cost {
    fn default() -> Self {
        Self { goal: 0.05, motion: 1e-4, power: 1e-5, settle: 5.0, settle_intervals: 40 }
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

impl Scenario {
    /// The paper's Scenario 1 or 2.
    ///
    /// # Errors
    /// The paper has no scenario of this number.
    pub fn numbered(number: u8) -> Result<Self, ScenarioError> {
        let mut scenario = Self::default();
        scenario.set_number(number)?;
        Ok(scenario)
    }

    /// The same without walls, obstacles, gusts and packet loss, and with its start at the local origin: for
    /// flights that lead anywhere.
    #[must_use]
    pub fn open(mut self) -> Self {
        self.name = format!("{}, open", self.name);
        self.obstacles.clear();
        self.start = Vector2::zeros();
        self.dynamics.walls = false;
        self.disturbance.sigma_c = 0.0;
        self.radio.rule = Rule::Ideal;
        self
    }

    /// Puts the first obstacle where Scenario 1 or 2 has it; all else stays.
    ///
    /// # Errors
    /// The paper has no scenario of this number.
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

    /// Replaces the camera by the one that `--camera` names. One of [`crate::camera::cases::CASES`] keeps the
    /// width of a disc's rim.
    ///
    /// # Errors
    /// As [`CameraConfig::named`].
    pub fn film_with(&mut self, camera: &str) -> Result<(), CameraError> {
        let edge_px = self.camera.edge_px;
        self.camera = match CameraConfig::case(camera) {
            Some(config) => CameraConfig { edge_px, ..config },
            None => CameraConfig::named(camera)?,
        };
        Ok(())
    }

    /// 1 or 2 if the first obstacle is where the paper's scenario has it.
    #[must_use]
    pub fn number(&self) -> Option<u8> {
        let position = self.obstacles.first()?.position;
        (1..=2).find(|&n| Self::numbered(n).is_ok_and(|s| s.obstacle().position == position))
    }

    /// ℓ of one interval, Eq. (9), Sec. II-C1: the UAV at `r` when it ended, `a` the normalised acceleration that was
    /// flown, `power` the transmit power.
    #[must_use]
    pub fn stage_cost(&self, r: Vector2<f64>, a: Vector2<f64>, power: TxPower) -> f64 {
        let Cost { goal, motion, power: transmit, .. } = self.cost;
        goal * (r - self.goal).norm_squared() + motion * a.norm_squared() + transmit * power.level().powi(2)
    }

    /// The first obstacle: the one that the paper has and that a world model is trained beside. The
    /// paper's own where the list is empty.
    #[must_use]
    pub fn obstacle(&self) -> &Obstacle {
        self.obstacles.first().unwrap_or(&Obstacle::PAPER)
    }

    /// Reads a TOML file; keys that it leaves out keep the paper's values.
    ///
    /// # Errors
    /// The file cannot be read, or is no scenario: the error names file, line and key.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ScenarioError::Read { path: path.into(), source })?;
        Self::from_toml(&text)
            .map_err(|message| ScenarioError::Parse { path: path.into(), message: message.to_string() })
    }

    /// Parses and checks a TOML text.
    ///
    /// # Errors
    /// The text is no TOML, has an unknown or former key, or a value out of range: the error names it.
    pub fn from_toml(text: &str) -> Result<Self, anyhow::Error> {
        // Some editors mark their files so.
        let text = text.trim_start_matches('\u{feff}');
        let scenario: Self = toml::from_str(text).map_err(|error| match check::renamed(text) {
            Some(renamed) => anyhow::Error::from(renamed),
            None if check::is_sweep(text) => {
                anyhow::anyhow!("this is a sweep, not a scenario: gcs sweep --config FILE flies it")
            }
            None => match check::key_at(text, error.span()) {
                Some(key) => anyhow::anyhow!("`{key}`: {error}"),
                None => error.into(),
            },
        })?;
        scenario.check()?;
        Ok(scenario)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::MAX_OBSTACLES;

    #[test]
    fn the_default_survives_its_own_checks_and_toml() {
        let scenario = Scenario::default();
        scenario.check().unwrap();
        let text = toml::to_string(&scenario).unwrap();
        assert_eq!(Scenario::from_toml(&text).unwrap(), scenario);
    }

    #[test]
    fn a_value_of_another_form_is_told_with_its_key() {
        for (text, key) in [
            ("start = [0.1, 0.5, 0.0]\n", "`start`"),
            ("[radio]\n  b_dt = \"much\"\n", "`b_dt`"),
            ("[[obstacle]]\nposition = [0.5]\n", "`position`"),
        ] {
            let error = Scenario::from_toml(text).unwrap_err();
            let told = crate::program::terminal::one_line(&error);
            assert!(told.contains(key), "{told}");
        }
    }

    /// The one table without defaults: "missing field `metres_per_unit`".
    #[test]
    fn a_scale_of_a_single_key_keeps_the_others() {
        for text in ["[scale]\ninterval_s = 0.2\n", "[scale]\nmetres_per_unit = 60.0\n"] {
            let scale = Scenario::from_toml(text).unwrap().scale;
            assert_eq!(scale.altitude_m, Scale::default().altitude_m);
        }
    }

    #[test]
    fn a_misspelt_key_is_named() {
        let error = Scenario::from_toml("[radio]\nbandwith = 2.5\n").unwrap_err().to_string();
        assert!(error.contains("bandwith"), "{error}");
    }

    #[test]
    fn a_value_out_of_range_is_named() {
        let error = Scenario::from_toml("[radio]\nb_dt = -1.0\n").unwrap_err().to_string();
        assert_eq!(error, "radio.b_dt = -1: must lie in [1e-6, 1e9]");
        assert!(Scenario::from_toml("[dynamics]\na_max = nan\n").is_err());
    }

    #[test]
    fn a_moving_obstacle_starts_and_stays_inside_its_margin() {
        let error = |text: &str| Scenario::from_toml(text).unwrap_err().to_string();
        let text = "[[obstacle]]\nposition = [0.1, 0.5]\nvelocity = [0.01, 0.0]\n";
        assert!(error(text).starts_with("obstacle[0].position[0] = 0.1: must be"), "{}", error(text));
        let text = "[[obstacle]]\nmargin = 0.45\nvelocity = [0.2, 0.0]\n";
        assert!(error(text).starts_with("obstacle[0].velocity = 0.2: must be"), "{}", error(text));
        assert!(Scenario::from_toml("[[obstacle]]\nposition = [0.1, 0.9]\n").is_ok(), "it stands");
    }

    #[test]
    fn a_second_obstacle_is_checked_as_the_first_is() {
        let second = |text: &str| Scenario::from_toml(&format!("[[obstacle]]\n[[obstacle]]\n{text}\n"));
        let scenario = second("position = [0.3, 0.8]\nvelocity = [0.01, 0.0]").unwrap();
        let again = Scenario::from_toml(&toml::to_string(&scenario).unwrap()).unwrap();
        assert_eq!(again, scenario);
        let error = second("position = [0.3, 0.8]\nradius = -1.0").unwrap_err().to_string();
        assert!(error.starts_with("obstacle[1].radius = -1: must lie in"), "{error}");
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
