//! Reading a radio: presets, files, and files that change some keys of a preset.
//!
//! A file may begin with `extends = "NAME"`, a preset of which it changes some keys. What is wrong is told with the
//! key's name; after [`AirRadio::load`] nothing checks ranges again.

use std::path::Path;

use super::AirRadio;
use crate::radio::air::blockage::BuildingsError;

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
            toml: include_str!(concat!("../../../../presets/radio/", $name, ".toml")),
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
    use super::super::PathModel;
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
}
