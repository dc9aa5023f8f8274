//! The tuned numbers of RCC and UCC: TOML files that `gcs tune` writes, each with its provenance.

use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use super::reactive::Law;

/// Which controllers have a law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tunable {
    /// Reactive constrained control
    Rcc,
    /// Unconstrained communication control
    Ucc,
}

impl Tunable {
    /// Its untuned law.
    #[must_use]
    pub fn paper(self) -> Law {
        match self {
            Self::Rcc => Law::RCC_PAPER,
            Self::Ucc => Law::UCC_PAPER,
        }
    }

    /// Its name in commands and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Rcc => "rcc",
            Self::Ucc => "ucc",
        }
    }
}

/// A file of `gcs tune`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LawFile {
    /// Whose numbers they are.
    pub controller: Tunable,
    /// The numbers.
    pub law: Law,
    /// How they were found.
    pub found: Provenance,
}

/// How a law was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// The command line.
    pub command: String,
    /// Revision of the program.
    pub revision: String,
    /// Presets or files of the worlds that it was tuned in.
    pub scenarios: Vec<String>,
    /// First of the training seeds, in every world.
    pub first_seed: u64,
    /// Flights of the last round, in every world.
    pub flights: u64,
    /// Laws that were tried.
    pub tried: u64,
    /// Mean d_f over the worlds in the last round, units.
    pub d_f: f64,
    /// That of the untuned law on the same seeds.
    pub d_f_paper: f64,
}

/// The laws that `rcc` and `ucc` fly.
#[derive(Debug, Clone, PartialEq)]
pub struct Laws {
    /// RCC's.
    pub rcc: Law,
    /// UCC's.
    pub ucc: Law,
}

/// The files that ship with the program.
const SHIPPED: [(&str, &str); 2] = [
    ("presets/rcc.toml", include_str!("../../../presets/rcc.toml")),
    ("presets/ucc.toml", include_str!("../../../presets/ucc.toml")),
];

impl LawFile {
    /// Parses and checks a file's text.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str) -> Result<Self> {
        let file: Self = toml::from_str(text)?;
        file.law.check().map_err(anyhow::Error::msg)?;
        Ok(file)
    }
}

impl Laws {
    /// The shipped laws, replaced by those in `files`.
    ///
    /// # Errors
    /// A file that does not read, or of another controller.
    pub fn load<P: AsRef<Path>>(files: &[P]) -> Result<Self> {
        let mut laws = Self { rcc: Law::RCC_PAPER, ucc: Law::UCC_PAPER };
        for (name, text) in SHIPPED {
            let file = LawFile::parse(text).with_context(|| format!("reading {name}"))?;
            laws.set(file.controller, file.law);
        }
        for path in files {
            let path = path.as_ref();
            let reading = || format!("reading {}", path.display());
            let text = std::fs::read_to_string(path).with_context(reading)?;
            let file = LawFile::parse(&text).with_context(reading)?;
            laws.set(file.controller, file.law);
        }
        Ok(laws)
    }

    /// Replaces the law of one of them.
    pub fn set(&mut self, controller: Tunable, law: Law) {
        match controller {
            Tunable::Rcc => self.rcc = law,
            Tunable::Ucc => self.ucc = law,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_replaces_the_law_of_its_controller_and_nonsense_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml");
        let mut file = LawFile::parse(SHIPPED[0].1).unwrap();
        file.law.position_gain = 0.5;
        let write = |file: &LawFile| std::fs::write(&path, toml::to_string(file).unwrap()).unwrap();
        write(&file);
        let laws = Laws::load(&[&path]).unwrap();
        assert_eq!(laws.rcc.position_gain, 0.5);
        assert_eq!(laws.ucc, Laws::load::<&Path>(&[]).unwrap().ucc);
        for (change, told) in [
            (
                (|f| f.law.position_gain = -1.0) as fn(&mut LawFile),
                "position_gain = -1: must lie in [0, 100]",
            ),
            (|f| f.law.steps = 0, "steps = 0: must lie in [1, 1000]"),
        ] {
            let mut wrong = file.clone();
            change(&mut wrong);
            write(&wrong);
            assert!(format!("{:#}", Laws::load(&[&path]).unwrap_err()).contains(told), "{told}");
        }
    }
}
