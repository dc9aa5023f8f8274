//! A radio as a file: TOML that holds what differs from a preset, with ranges that name the key.
//!
//! Here is what can be in a file; [`mod@file`] reads one and holds the presets, `check` holds the ranges.

mod check;
pub mod file;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::blockage::{self, BlockageLoss, DiscObstacle, Prism, Surroundings};
use super::fading::{Fading, Shadowing};
use super::rate::{AirRate, FrameError};
pub use file::RadioError;

/// Thermal noise at 290 K, dBm/Hz: k T.
const THERMAL_DBM: f64 = -173.975;

/// A radio link: two ends, what is between them, and how its modems share the air.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AirRadio {
    /// Name in tables and logs.
    pub name: String,
    /// Carrier frequency, Hz.
    pub carrier_hz: f64,
    /// Noise bandwidth of the receivers, Hz.
    pub bandwidth_hz: f64,
    /// Length of a time slot of chance, s: fading is constant in it.
    pub slot_s: f64,
    /// The station's end.
    pub ground: AirEnd,
    /// The vehicle's end.
    pub vehicle: AirEnd,
    /// Path loss.
    pub path: PathModel,
    /// Whether the sight line is free.
    pub sight: SightRule,
    /// Shadowing.
    pub shadowing: Shadowing,
    /// Small-scale fading.
    pub fading: Fading,
    /// What an obstacle costs, where the path loss has no formula for a lost sight line.
    pub blockage: BlockageLoss,
    /// Obstacles: tables `[[disc]]`.
    #[serde(rename = "disc")]
    pub discs: Vec<DiscObstacle>,
    /// Obstacles: tables `[[prism]]`.
    #[serde(rename = "prism")]
    pub prisms: Vec<Prism>,
    /// Obstacles of a GeoJSON file.
    pub buildings: Option<Buildings>,
    /// How the two ends share the air.
    pub duplex: Duplex,
    /// Station to vehicle.
    pub up: Modem,
    /// Vehicle to station.
    pub down: Modem,
}

/// Antenna, amplifier and receiver of one end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AirEnd {
    /// Levels of transmit power, dBm, lowest first.
    pub powers_dbm: Vec<f64>,
    /// The level that is used, an index.
    pub power: usize,
    /// Gain of the antenna in its main direction, dBi.
    pub gain_dbi: f64,
    /// Shape of the antenna's gain.
    pub pattern: Pattern,
    /// Where the station is, north and east in the vehicle's local frame, m; the vehicle tells its own place.
    pub place: [f64; 2],
    /// Height of the antenna above the ground, m; the vehicle's is added to where the vehicle is.
    pub height_m: f64,
    /// Noise figure of the receiver, dB.
    pub noise_figure_db: f64,
    /// The receiver's noise, dBm, in place of k T B and the noise figure.
    pub noise_dbm: Option<f64>,
    /// Losses in cables and the like, dB.
    pub loss_db: f64,
}

impl Default for AirEnd {
    fn default() -> Self {
        Self {
            powers_dbm: vec![20.0],
            power: 0,
            gain_dbi: 0.0,
            pattern: Pattern::Isotropic,
            place: [0.0; 2],
            height_m: 0.0,
            noise_figure_db: 6.0,
            noise_dbm: None,
            loss_db: 0.0,
        }
    }
}

impl AirEnd {
    /// The transmit power in use, dBm.
    #[must_use]
    pub fn power_dbm(&self) -> f64 {
        // A checked level is one of the list.
        self.powers_dbm.get(self.power).copied().unwrap_or(f64::NEG_INFINITY)
    }

    /// Noise in the receiver, k T B F, dBm.
    #[must_use]
    pub fn noise_dbm(&self, bandwidth_hz: f64) -> f64 {
        self.noise_dbm.unwrap_or(THERMAL_DBM + 10.0 * bandwidth_hz.log10() + self.noise_figure_db)
    }
}

/// How an antenna's gain falls off its main direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Pattern {
    /// It does not.
    Isotropic,
    /// An upright half-wave dipole: (cos(π/2 sin θ) / cos θ)² at elevation θ; above and below 20 dB less, for what is
    /// around fills the nulls (our choice).
    Dipole,
    /// A sector or patch: -min(12 (φ / φ3dB)² + 12 (θ / θ3dB)², A): 3GPP TR 38.901, Table 7.3-1.
    Sector {
        /// Where it looks, degrees from north to the east.
        azimuth_deg: f64,
        /// How far it looks up, degrees.
        tilt_deg: f64,
        /// φ3dB = θ3dB, degrees.
        width_deg: f64,
        /// A, dB.
        floor_db: f64,
    },
}

impl Pattern {
    /// Gain relative to the main direction, dB, to a direction `azimuth`, `elevation`, rad.
    #[must_use]
    pub fn db(&self, azimuth: f64, elevation: f64) -> f64 {
        match *self {
            Self::Isotropic => 0.0,
            Self::Dipole => {
                let (sin, cos) = elevation.sin_cos();
                let field = (std::f64::consts::FRAC_PI_2 * sin).cos() / cos.abs().max(1e-6);
                20.0 * field.abs().max(0.1).log10()
            }
            Self::Sector { azimuth_deg, tilt_deg, width_deg, floor_db } => {
                let aside = (azimuth.to_degrees() - azimuth_deg + 540.0).rem_euclid(360.0) - 180.0;
                let above = elevation.to_degrees() - tilt_deg;
                -(12.0 * ((aside / width_deg).powi(2) + (above / width_deg).powi(2))).min(floor_db)
            }
        }
    }
}

/// A formula of path loss; see [`super::pathloss`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "kebab-case", deny_unknown_fields)]
pub enum PathModel {
    /// No loss at all.
    None,
    /// The paper's, over the distance on the ground.
    Paper {
        /// Metres of a unit of length.
        unit_m: f64,
        /// G0.
        reference_gain: f64,
        /// α_PL.
        exponent: f64,
        /// Smallest distance, units.
        floor: f64,
    },
    /// Free space.
    FreeSpace,
    /// The same distance always, m: a satellite.
    Orbit {
        /// m.
        distance_m: f64,
    },
    /// Two rays over flat ground.
    TwoRay {
        /// Relative permittivity of the ground.
        permittivity: f64,
    },
    /// Log-distance.
    LogDistance {
        /// Loss at the reference distance, dB.
        reference_db: f64,
        /// Reference distance, m.
        reference_m: f64,
        /// n.
        exponent: f64,
    },
    /// 3GPP TR 36.777 UMa-AV, near the ground TR 38.901 UMa.
    UmaAv,
    /// 3GPP TR 36.777 RMa-AV, near the ground TR 38.901 RMa.
    RmaAv,
    /// Al-Hourani's air to ground.
    AlHourani {
        /// a and b.
        shape: [f64; 2],
        /// Excess loss with and without a sight line, dB.
        excess_db: [f64; 2],
    },
}

/// What decides whether the sight line is free, for formulas that have two cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SightRule {
    /// Obstacles: it is free where none reaches over it.
    Obstacles,
    /// The formula's own probability, by a field that is correlated in space as shadowing is.
    Chance,
}

/// Buildings of a GeoJSON file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Buildings {
    /// The file, beside the radio's own.
    pub file: PathBuf,
    /// Latitude and longitude of north 0, east 0: where the obstacles' coordinates begin.
    pub origin: [f64; 2],
    /// Height of one that tells none, m.
    pub default_height_m: f64,
}

/// How the two ends share the air.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Duplex {
    /// Each way has a channel of its own.
    Full,
    /// One sends at a time.
    Shared,
    /// They take turns: a window up, a guard, a window down, a guard.
    Slots {
        /// s.
        up_s: f64,
        /// s.
        down_s: f64,
        /// s.
        guard_s: f64,
    },
}

/// How one way's modem sends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Modem {
    /// SNR to rate.
    pub rate: AirRate,
    /// SNR to loss.
    pub error: FrameError,
    /// Bytes that the modem adds to each packet, inside its checksum.
    pub overhead_bytes: usize,
    /// Time that the modem adds to each packet on the air, s: preamble, turnaround.
    pub overhead_s: f64,
    /// Time that it leaves after each packet, s.
    pub gap_s: f64,
    /// Payload of a packet, bytes. A longer frame takes several and arrives if all do. 0 is no limit.
    pub packet_bytes: usize,
    /// Whether a packet has always the length of a full one.
    pub full_packets: bool,
    /// Whether frames that wait share a packet, as many whole ones as fit in it and in the window.
    pub join: bool,
    /// Bytes that may wait; a frame that finds no room is lost.
    pub queue_bytes: usize,
    /// How often a lost packet is sent again.
    pub retries: u32,
    /// When it is sent again: after the end of the one before, s.
    pub retry_s: f64,
    /// Time from the end of a packet to its arrival, s: processing, networks, the way.
    pub latency_s: f64,
    /// Mean of what is added to it, exponential, s. Frames do not overtake each other.
    pub jitter_s: f64,
    /// Baud of the serial lines at both ends, each of which takes ten bits a byte. 0 is no serial line.
    pub serial_baud: f64,
}

impl Default for Modem {
    /// Perfect.
    fn default() -> Self {
        Self {
            rate: AirRate::Unlimited,
            error: FrameError::None,
            overhead_bytes: 0,
            overhead_s: 0.0,
            gap_s: 0.0,
            packet_bytes: 0,
            full_packets: false,
            join: false,
            queue_bytes: 1 << 20,
            retries: 0,
            retry_s: 0.0,
            latency_s: 0.0,
            jitter_s: 0.0,
            serial_baud: 0.0,
        }
    }
}

impl Default for AirRadio {
    /// Perfect: everything arrives at once.
    fn default() -> Self {
        Self {
            name: "perfect".into(),
            carrier_hz: 2.4e9,
            bandwidth_hz: 1e6,
            slot_s: 0.01,
            ground: AirEnd::default(),
            vehicle: AirEnd::default(),
            path: PathModel::None,
            sight: SightRule::Obstacles,
            shadowing: Shadowing::default(),
            fading: Fading::None,
            blockage: BlockageLoss::KnifeEdge { limit_db: 40.0 },
            discs: Vec::new(),
            prisms: Vec::new(),
            buildings: None,
            duplex: Duplex::Full,
            up: Modem::default(),
            down: Modem::default(),
        }
    }
}

impl AirRadio {
    /// All that stands around, the buildings' file read.
    ///
    /// # Errors
    /// The buildings' file is wrong.
    pub fn surroundings(&self) -> Result<Surroundings, RadioError> {
        let mut prisms = self.prisms.clone();
        if let Some(Buildings { file, origin, default_height_m }) = &self.buildings {
            prisms.extend(blockage::buildings(file, *origin, *default_height_m)?);
        }
        Ok(Surroundings::new(self.discs.clone(), prisms))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thermal_noise_is_k_t_b() {
        // -174 dBm/Hz, 1 MHz, 6 dB.
        assert!((AirEnd::default().noise_dbm(1e6) + 108.0).abs() < 0.1);
    }

    #[test]
    fn antennas_have_the_published_shapes() {
        let [level, sixty] = [0.0, 60f64.to_radians()];
        // A half-wave dipole: 0.1747 of the power at 60 degrees.
        let dipole = |elevation| Pattern::Dipole.db(0.0, elevation);
        assert!(dipole(level).abs() < 1e-9 && (dipole(sixty) + 7.58).abs() < 0.1, "{}", dipole(sixty));
        assert_eq!(dipole(90f64.to_radians()), -20.0);
        let sector = Pattern::Sector { azimuth_deg: 350.0, tilt_deg: 0.0, width_deg: 65.0, floor_db: 30.0 };
        // TR 38.901, Table 7.3-1: 3 dB at half of the width, 30 dB at most.
        assert!((sector.db(22.5f64.to_radians(), 0.0) + 3.0).abs() < 1e-9);
        assert_eq!(sector.db(170f64.to_radians(), 0.0), -30.0);
    }
}
