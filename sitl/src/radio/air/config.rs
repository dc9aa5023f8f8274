//! A radio as a file: TOML that holds what differs from a preset, with ranges that name the key.
//!
//! A file may begin with `extends = "NAME"`, a preset of which it changes some keys. What is wrong is told with the
//! key's name; after [`AirRadio::load`] nothing checks ranges again.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::blockage::{self, BlockageLoss, BuildingsError, DiscObstacle, Prism, Surroundings};
use super::fading::{Fading, Shadowing};
use super::rate::{AirRate, FrameError};

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

/// A radio that is compiled in.
struct RadioPreset {
    name: &'static str,
    about: &'static str,
    toml: &'static str,
}

macro_rules! presets {
    ($($name:literal: $about:literal,)+) => {
        [$(RadioPreset {
            name: $name,
            about: $about,
            toml: include_str!(concat!("../../../presets/radio/", $name, ".toml")),
        },)+]
    };
}

static PRESETS: [RadioPreset; 8] = presets! {
    "perfect": "everything arrives at once",
    "paper": "the paper's gate, for every frame: it gets through or not",
    "sik-57": "SiK telemetry, 433 MHz, 57,600 baud, air rate 64",
    "sik-64k-915": "SiK telemetry, 915 MHz, air rate 64 with ECC",
    "elrs-mavlink": "ExpressLRS in MAVLink mode, 2.4 GHz, 333 Hz Full",
    "lte": "LTE in a rural cell, 10 MHz at 800 MHz",
    "wifi": "802.11n, 2.4 GHz, 20 MHz",
    "satellite": "L band over a geostationary satellite",
};

/// The presets as a table, for the end of `--help`.
#[must_use]
pub fn table() -> String {
    let lines = PRESETS.iter().map(|preset| format!("\n  {:<15}{}", preset.name, preset.about));
    format!("Presets of --radio (configs/radio holds them as files):{}", lines.collect::<String>())
}

/// The names of all presets.
pub fn names() -> impl Iterator<Item = &'static str> {
    PRESETS.iter().map(|preset| preset.name)
}

/// Why something is no radio.
#[derive(Debug, thiserror::Error)]
pub enum RadioError {
    /// Neither a preset nor a file.
    #[error("`{name}` is neither a radio file nor one of {}", names().collect::<Vec<_>>().join(", "))]
    Unknown {
        /// What was asked for.
        name: String,
    },
    /// The file cannot be read.
    #[error("reading {path}: {source}")]
    Read {
        /// Which.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// It is no TOML, or has a wrong key.
    #[error("reading {origin}: {why}")]
    Parse {
        /// Which file or preset.
        origin: String,
        /// What is wrong.
        why: String,
    },
    /// A number is out of its range.
    #[error("{key} is {value}, must be {range}")]
    Range {
        /// The key.
        key: String,
        /// Its value.
        value: f64,
        /// What it must be.
        range: &'static str,
    },
    /// The buildings.
    #[error("buildings.file: {0}")]
    Buildings(#[from] BuildingsError),
}

impl AirRadio {
    /// The radio that `--radio` names: a preset, else a file.
    ///
    /// # Errors
    /// There is none, or it is wrong.
    pub fn named(name: &str) -> Result<Self, RadioError> {
        if let Some(preset) = PRESETS.iter().find(|preset| preset.name == name) {
            return Self::parse(preset.toml, name);
        }
        let path = Path::new(name);
        if !path.exists() {
            return Err(RadioError::Unknown { name: name.into() });
        }
        Self::load(path)
    }

    /// The radio in a file.
    ///
    /// # Errors
    /// It cannot be read, or is wrong.
    pub fn load(path: &Path) -> Result<Self, RadioError> {
        let origin = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|source| RadioError::Read { path: origin.clone(), source })?;
        let mut radio = Self::parse(&text, &origin)?;
        if let Some(buildings) = &mut radio.buildings {
            let folder = path.parent().unwrap_or(Path::new("."));
            buildings.file = folder.join(&buildings.file);
        }
        Ok(radio)
    }

    /// The radio of a TOML text; `origin` names it in errors.
    ///
    /// # Errors
    /// It is wrong.
    pub fn parse(text: &str, origin: &str) -> Result<Self, RadioError> {
        let parse = |why: String| RadioError::Parse { origin: origin.into(), why };
        let mut table: toml::Table =
            text.parse().map_err(|error: toml::de::Error| parse(error.to_string()))?;
        if let Some(base) = table.remove("extends") {
            let known = base.as_str().and_then(|name| PRESETS.iter().find(|preset| preset.name == name));
            let preset = known.ok_or_else(|| parse(format!("extends = {base} is no preset")))?;
            let mut whole: toml::Table =
                preset.toml.parse().map_err(|error: toml::de::Error| parse(error.to_string()))?;
            merge(&mut whole, table);
            table = whole;
            let radio: Self = table.try_into().map_err(|error: toml::de::Error| parse(error.to_string()))?;
            radio.check()?;
            return Ok(radio);
        }
        // From the text, so that an error names its line.
        let radio: Self = toml::from_str(text).map_err(|error| parse(error.to_string()))?;
        radio.check()?;
        Ok(radio)
    }

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

    fn check(&self) -> Result<(), RadioError> {
        self.check_channel()?;
        for (way, modem) in [("up", &self.up), ("down", &self.down)] {
            modem.check(way)?;
        }
        for (name, end) in [("ground", &self.ground), ("vehicle", &self.vehicle)] {
            end.check(name)?;
        }
        for disc in &self.discs {
            positive("disc.radius_m", disc.radius_m)?;
        }
        for prism in &self.prisms {
            positive("prism.height_m", prism.height_m)?;
            range(
                "prism.corners",
                prism.corners.len() as f64,
                prism.corners.len() > 2,
                "at least 3 corners",
            )?;
        }
        Ok(())
    }

    fn check_channel(&self) -> Result<(), RadioError> {
        positive("carrier_hz", self.carrier_hz)?;
        positive("bandwidth_hz", self.bandwidth_hz)?;
        positive("slot_s", self.slot_s)?;
        not_negative("shadowing.sigma_db", self.shadowing.sigma_db)?;
        positive("shadowing.distance_m", self.shadowing.distance_m)?;
        match self.path {
            PathModel::Paper { unit_m, reference_gain, exponent, floor } => {
                positive("path.unit_m", unit_m)?;
                positive("path.reference_gain", reference_gain)?;
                positive("path.exponent", exponent)?;
                positive("path.floor", floor)?;
            }
            PathModel::Orbit { distance_m } => positive("path.distance_m", distance_m)?,
            PathModel::TwoRay { permittivity } => {
                range("path.permittivity", permittivity, permittivity >= 1.0, "at least 1")?;
            }
            PathModel::LogDistance { reference_m, exponent, .. } => {
                positive("path.reference_m", reference_m)?;
                positive("path.exponent", exponent)?;
            }
            _ => {}
        }
        match self.duplex {
            Duplex::Slots { up_s, down_s, guard_s } => {
                positive("duplex.up_s", up_s)?;
                positive("duplex.down_s", down_s)?;
                not_negative("duplex.guard_s", guard_s)?;
            }
            Duplex::Full | Duplex::Shared => {}
        }
        match self.blockage {
            BlockageLoss::KnifeEdge { limit_db } => not_negative("blockage.limit_db", limit_db),
            BlockageLoss::Soft { attenuation, softness_m } => {
                let good = attenuation > 0.0 && attenuation <= 1.0;
                range("blockage.attenuation", attenuation, good, "in (0, 1]")?;
                positive("blockage.softness_m", softness_m)
            }
        }
    }
}

impl AirEnd {
    fn check(&self, name: &str) -> Result<(), RadioError> {
        let known = self.power < self.powers_dbm.len();
        range(&format!("{name}.power"), self.power as f64, known, "an index of powers_dbm")?;
        for &power in &self.powers_dbm {
            range(&format!("{name}.powers_dbm"), power, power.is_finite(), "finite")?;
        }
        for (key, value) in
            [("gain_dbi", self.gain_dbi), ("height_m", self.height_m), ("loss_db", self.loss_db)]
        {
            range(&format!("{name}.{key}"), value, value.is_finite(), "finite")?;
        }
        not_negative(&format!("{name}.noise_figure_db"), self.noise_figure_db)?;
        if let Pattern::Sector { width_deg, .. } = self.pattern {
            positive(&format!("{name}.pattern.width_deg"), width_deg)?;
        }
        Ok(())
    }
}

/// Longest time that a key may hold, s: nothing overflows.
const LONGEST_S: f64 = 1e6;

impl Modem {
    fn check(&self, way: &str) -> Result<(), RadioError> {
        let times = [
            ("overhead_s", self.overhead_s),
            ("gap_s", self.gap_s),
            ("retry_s", self.retry_s),
            ("latency_s", self.latency_s),
            ("jitter_s", self.jitter_s),
        ];
        for (key, value) in times {
            range(&format!("{way}.{key}"), value, (0.0..=LONGEST_S).contains(&value), "in [0, 1e6]")?;
        }
        not_negative(&format!("{way}.serial_baud"), self.serial_baud)?;
        let filled = !self.full_packets || self.packet_bytes > 0;
        range(&format!("{way}.packet_bytes"), self.packet_bytes as f64, filled, "above 0 with full_packets")?;
        range(&format!("{way}.retries"), f64::from(self.retries), self.retries <= 1000, "at most 1000")?;
        self.check_rate(way)?;
        match self.error {
            FrameError::Waterfall { per, width_db } => {
                range(&format!("{way}.error.per"), per, per > 0.0 && per < 1.0, "in (0, 1)")?;
                positive(&format!("{way}.error.width_db"), width_db)
            }
            _ => Ok(()),
        }
    }

    fn check_rate(&self, way: &str) -> Result<(), RadioError> {
        let key = |name: &str| format!("{way}.rate.{name}");
        match &self.rate {
            AirRate::Unlimited => Ok(()),
            AirRate::Outage { b_dt, packet_bits } => {
                positive(&key("b_dt"), *b_dt)?;
                positive(&key("packet_bits"), *packet_bits)
            }
            AirRate::Shannon { gap_db, max_bps, min_snr_db } => {
                not_negative(&key("gap_db"), *gap_db)?;
                positive(&key("max_bps"), *max_bps)?;
                range(&key("min_snr_db"), *min_snr_db, (-50.0..=100.0).contains(min_snr_db), "in [-50, 100]")
            }
            AirRate::Fixed { bps, .. } => positive(&key("bps"), *bps),
            AirRate::Table { rows } => {
                range(&key("rows"), rows.len() as f64, !rows.is_empty(), "at least 1 row")?;
                let rising = rows.windows(2).all(|pair| pair[0].snr_db < pair[1].snr_db);
                range(&key("rows"), rows.len() as f64, rising, "rows by rising snr_db")?;
                rows.iter().try_for_each(|row| positive(&key("rows.bps"), row.bps))
            }
        }
    }
}

fn range(key: &str, value: f64, good: bool, range: &'static str) -> Result<(), RadioError> {
    if good { Ok(()) } else { Err(RadioError::Range { key: key.into(), value, range }) }
}

fn positive(key: &str, value: f64) -> Result<(), RadioError> {
    range(key, value, value.is_finite() && value > 0.0, "above 0")
}

fn not_negative(key: &str, value: f64) -> Result<(), RadioError> {
    range(key, value, value.is_finite() && value >= 0.0, "at least 0")
}

/// Puts the keys of `changes` over those of `whole`. A table that names another `model` or `shape` is another
/// table, with none of the old one's keys.
fn merge(whole: &mut toml::Table, changes: toml::Table) {
    for (key, value) in changes {
        match (whole.get_mut(&key), value) {
            (Some(toml::Value::Table(old)), toml::Value::Table(new))
                if !new.contains_key("model") && !new.contains_key("shape") =>
            {
                merge(old, new);
            }
            (_, value) => {
                whole.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        AirRadio::parse(text, "x.toml").unwrap_err().to_string()
    }

    #[test]
    fn every_preset_is_a_radio_and_lies_in_configs_too() {
        for preset in &PRESETS {
            let radio = AirRadio::named(preset.name).unwrap();
            assert_eq!(radio.name, preset.name);
            assert!(table().contains(preset.about));
            let file = format!("{}/../configs/radio/{}.toml", env!("CARGO_MANIFEST_DIR"), preset.name);
            assert_eq!(std::fs::read_to_string(&file).unwrap(), preset.toml, "{file}");
            let whole = toml::to_string(&radio).unwrap();
            assert_eq!(AirRadio::parse(&whole, "whole").unwrap(), radio);
        }
        assert_eq!(AirRadio::named("perfect").unwrap(), AirRadio::default());
    }

    #[test]
    fn a_wrong_key_or_number_is_told_by_its_name() {
        for (text, told) in [
            ("carier_hz = 1", "unknown field `carier_hz`"),
            ("carrier_hz = 0", "carrier_hz is 0, must be above 0"),
            ("[down]\nlatency_s = -1", "down.latency_s is -1, must be in [0, 1e6]"),
            ("[up]\nrate = { model = \"fixed\", bps = 0, snr_db = 1 }", "up.rate.bps is 0"),
            ("[up]\nrate = { model = \"fixed\", bps = 1, snr_db = 1, gap = 2 }", "unknown field `gap`"),
            ("[up]\nrate = { model = \"table\", rows = [] }", "up.rate.rows is 0, must be at least 1 row"),
            ("[ground]\npower = 3", "ground.power is 3, must be an index of powers_dbm"),
            (
                "path = { model = \"two-ray\", permittivity = 0.5 }",
                "path.permittivity is 0.5, must be at least 1",
            ),
            ("[[prism]]\ncorners = [[0, 0]]\nheight_m = 3", "prism.corners is 1"),
            ("extends = \"sik\"", "extends = \"sik\" is no preset"),
            ("extends = \"sik-57\"\nslot_s = 0", "slot_s is 0"),
            ("extends = \"sik-57\"\nnosie = 0", "unknown field `nosie`"),
        ] {
            assert!(error(text).contains(told), "{text}: {}", error(text));
        }
        let unknown = AirRadio::named("sik").unwrap_err().to_string();
        assert!(unknown.contains("`sik`") && unknown.contains("sik-57, sik-64k-915"), "{unknown}");
    }

    #[test]
    fn a_file_changes_some_keys_of_a_preset() {
        let whole = AirRadio::named("sik-57").unwrap();
        let text = "extends = \"sik-57\"\n[down]\nqueue_bytes = 7\n[path]\nmodel = \"free-space\"\n";
        let changed = AirRadio::parse(text, "x").unwrap();
        assert_eq!((changed.down.queue_bytes, changed.path), (7, PathModel::FreeSpace));
        let mut expected = whole;
        expected.down.queue_bytes = 7;
        expected.path = PathModel::FreeSpace;
        assert_eq!(changed, expected);
    }

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
