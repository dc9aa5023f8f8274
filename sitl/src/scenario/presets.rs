//! Scenarios that have a name: `--scenario NAME` in all programs.
//!
//! Each is a file of `sitl/presets`, compiled in, but for 1 and 2, which are the paper's values alone.

use std::path::Path;

use super::{Scenario, ScenarioError};

/// A scenario with a name.
#[derive(Debug, Clone, Copy)]
pub struct Preset {
    /// What follows `--scenario`.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    toml: &'static str,
}

const SCENARIO_1: &str = "name = \"scenario 1\"\n[[obstacle]]\nposition = [0.50, 0.30]\n";

/// All presets. The paper's two come first.
pub const PRESETS: [Preset; 14] = [
    Preset { name: "1", about: "the paper's Scenario 1: the obstacle shadows the path", toml: SCENARIO_1 },
    Preset { name: "2", about: "the paper's Scenario 2: the obstacle is in the path", toml: "" },
    Preset {
        name: "1-ideal",
        about: "1 without packet loss, as in the paper's Figs. 4 and 5",
        toml: include_str!("../../presets/1-ideal.toml"),
    },
    Preset {
        name: "2-ideal",
        about: "2 without packet loss, as in the paper's Figs. 4 and 5",
        toml: include_str!("../../presets/2-ideal.toml"),
    },
    Preset {
        name: "demo",
        about: "2 with little bandwidth and gusts",
        toml: include_str!("../../presets/demo.toml"),
    },
    Preset {
        name: "lowest-bandwidth",
        about: "2 at the lowest bandwidth of the sweep",
        toml: include_str!("../../presets/lowest-bandwidth.toml"),
    },
    Preset {
        name: "gusty",
        about: "2 with the paper's strongest gusts",
        toml: include_str!("../../presets/gusty.toml"),
    },
    Preset {
        name: "narrow",
        about: "2 with less bandwidth than crpl's power can serve",
        toml: include_str!("../../presets/narrow.toml"),
    },
    Preset {
        name: "shadow",
        about: "1 with no link in the obstacle's shadow",
        toml: include_str!("../../presets/shadow.toml"),
    },
    Preset {
        name: "moving",
        about: "demo with a slow obstacle",
        toml: include_str!("../../presets/moving.toml"),
    },
    Preset {
        name: "moving-fast",
        about: "demo with a fast obstacle",
        toml: include_str!("../../presets/moving-fast.toml"),
    },
    Preset {
        name: "two-obstacles",
        about: "demo with two moving obstacles",
        toml: include_str!("../../presets/two-obstacles.toml"),
    },
    Preset {
        name: "foreign",
        about: "2 on a field of 60 m, for ArduPilot and PX4",
        toml: include_str!("../../presets/foreign.toml"),
    },
    Preset {
        name: "elsewhere",
        about: "start, goal, obstacle and base station moved",
        toml: include_str!("../../presets/elsewhere.toml"),
    },
];

/// The names of all presets, separated by commas.
#[must_use]
pub fn names() -> String {
    PRESETS.map(|preset| preset.name).join(", ")
}

/// The presets as a table, for the end of `--help`.
#[must_use]
pub fn table() -> String {
    let lines = PRESETS.map(|preset| format!("\n  {:<15}{}", preset.name, preset.about));
    format!("Presets of --scenario (a file holds only what differs from 2):{}", lines.concat())
}

impl Scenario {
    /// The scenario that `--scenario` names: a preset, else a TOML file.
    ///
    /// # Errors
    /// Neither a preset nor a file has this name, or the file is not a scenario.
    pub fn named(name: &str) -> Result<Self, ScenarioError> {
        let path = Path::new(name);
        match PRESETS.iter().find(|preset| preset.name == name) {
            Some(preset) => Self::from_toml(preset.toml)
                .map_err(|error| ScenarioError::Parse { path: path.into(), message: error.to_string() }),
            None if path.exists() => Self::load(path),
            None => Err(ScenarioError::Unknown { name: name.into() }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_is_a_scenario_with_a_line_of_its_own() {
        for preset in PRESETS {
            Scenario::named(preset.name).unwrap();
            assert!(table().contains(&format!("\n  {:<15}{}", preset.name, preset.about)));
            assert!(preset.about.len() <= 60, "{}", preset.name);
        }
        assert_eq!(Scenario::named("1").unwrap(), Scenario::numbered(1).unwrap());
        assert_eq!(Scenario::named("2").unwrap(), Scenario::default());
    }

    #[test]
    fn a_name_that_is_neither_preset_nor_file_is_an_error_that_lists_the_presets() {
        let error = Scenario::named("gutsy").unwrap_err().to_string();
        assert!(error.contains("`gutsy`") && error.ends_with(&names()), "{error}");
    }
}
