//! Cameras that have a name: `--camera NAME` in all programs, and the cases in which an encoder is
//! evaluated.

use std::path::{Path, PathBuf};

use super::config::CameraConfig;

/// Where the UAV is in the pictures of a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Placement {
    /// Anywhere.
    Anywhere,
    /// Its disc is whole: its centre is 4 px or more from the picture's edge.
    Whole,
    /// The picture's edge cuts its disc: its centre is less than 4 px from it.
    Cut,
    /// It is whole and over the obstacle or within 6 px of it.
    Over,
}

/// A camera with a name.
#[derive(Debug, Clone, Copy)]
pub struct CameraCase {
    /// What follows `--camera`.
    pub name: &'static str,
    /// One line for people, and for the rows of a table.
    pub about: &'static str,
    /// Where the UAV is when an encoder is evaluated in it.
    pub placement: Placement,
    toml: &'static str,
}

/// A camera cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// The file could not be read.
    #[error("reading {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is no camera.
    #[error("reading {path}: {message}")]
    Parse {
        /// The file or the name.
        path: PathBuf,
        /// Line, key and reason.
        message: String,
    },
    /// Neither a name nor a file.
    #[error("there is no camera file `{name}`, and no camera of this name; cameras: {}", names())]
    Unknown {
        /// What was given.
        name: String,
    },
}

const fn case(
    name: &'static str,
    about: &'static str,
    placement: Placement,
    toml: &'static str,
) -> CameraCase {
    CameraCase { name, about, placement, toml }
}

/// Puts `colours = "family"` before further keys.
macro_rules! family {
    ($($keys:literal),*) => { concat!("colours = \"family\"\n", $($keys),*) };
}

const TEXTURE: &str = family!("[ground]\nkind = \"procedural\"\n");

use Placement::{Anywhere, Cut, Over, Whole};

/// All cameras with a name, as the rows of an evaluation. The vehicle's parameter `CAM_PRESET` is the index.
pub const CASES: [CameraCase; 26] = [
    case("clean", "discs on black", Whole, ""),
    case(
        "hard",
        "all together: each flight draws its own",
        Anywhere,
        include_str!("../../presets/cameras/hard.toml"),
    ),
    case("harder", "everything at full", Whole, include_str!("../../presets/cameras/harder.toml")),
    case("cut", "disc cut by the edge", Cut, ""),
    case("over", "UAV over the obstacle", Over, ""),
    case("mixed", "mixed colours", Whole, "uav = [1.0, 0.25, 0.1]\nobstacle = [0.1, 0.3, 1.0]"),
    case("family", "random colours, family", Whole, family!("")),
    case("any", "random colours, any", Whole, "colours = \"any\""),
    case("noise-2", "noise 2/255", Whole, "noise = 2"),
    case("noise-5", "noise 5/255", Whole, "noise = 5"),
    case(
        "mixed-noise-5",
        "mixed colours, noise 5/255",
        Whole,
        "uav = [1.0, 0.25, 0.1]\nobstacle = [0.1, 0.3, 1.0]\nnoise = 5",
    ),
    case("drift", "drift 20 %", Whole, family!("drift = 0.2")),
    case("radius-0.08", "obstacle drawn at 0.8 of its radius", Whole, "obstacle_scale = 0.8"),
    case("radius-0.12", "obstacle drawn at 1.2 of its radius", Whole, "obstacle_scale = 1.2"),
    case("shade", "shading 30 %", Whole, family!("shade = 0.3")),
    case("jpeg-50", "JPEG quality 50", Whole, family!("jpeg = 50")),
    case("blur", "motion blur, half an interval", Whole, family!("blur = 0.5")),
    case("shake", "shake 1 px", Whole, family!("shake = 1")),
    case("distractors", "2 distractors", Whole, family!("distractors = { count = 2 }")),
    case("texture", "textured ground", Whole, TEXTURE),
    case("texture-cut", "textured ground, disc cut by the edge", Cut, TEXTURE),
    case("texture-over", "textured ground, UAV over the obstacle", Over, TEXTURE),
    case(
        "texture-drift",
        "textured ground, noise 5/255, drift, shadow",
        Whole,
        family!("noise = 5\ndrift = 0.2\nshadow = 0.4\n[ground]\nkind = \"procedural\"\n"),
    ),
    case(
        "texture-any",
        "textured ground, any colours",
        Whole,
        "colours = \"any\"\n[ground]\nkind = \"procedural\"",
    ),
    case(
        "texture-distractors",
        "textured ground, 2 distractors",
        Whole,
        family!("distractors = { count = 2 }\n[ground]\nkind = \"procedural\"\n"),
    ),
    case(
        "photo",
        "an aerial photograph as ground",
        Whole,
        family!("[ground]\nkind = \"file\"\nfile = \"shipped:photo\"\n"),
    ),
];

/// The names of all cameras, separated by commas.
#[must_use]
pub fn names() -> String {
    CASES.map(|case| case.name).join(", ")
}

impl CameraCase {
    /// The camera.
    ///
    /// # Errors
    /// None of [`CASES`] gives one: a test reads them all.
    pub fn config(&self) -> Result<CameraConfig, CameraError> {
        parse(Path::new(self.name), self.toml)
    }
}

impl CameraConfig {
    /// Its index in [`CASES`], or `None` if it has no name. The width of a disc's rim does not count.
    #[must_use]
    pub fn number(&self) -> Option<usize> {
        let is_this = |case: &CameraCase| {
            case.config().is_ok_and(|config| Self { edge_px: self.edge_px, ..config } == *self)
        };
        CASES.iter().position(is_this)
    }

    /// The camera of this name.
    #[must_use]
    pub fn case(name: &str) -> Option<Self> {
        CASES.iter().find(|case| case.name == name)?.config().ok()
    }

    /// The camera that `--camera` names: one of [`CASES`], else a TOML file with the keys of a scenario's
    /// `[camera]`.
    ///
    /// # Errors
    /// Neither a camera nor a file has this name, or the file is no camera.
    pub fn named(name: &str) -> Result<Self, CameraError> {
        let path = Path::new(name);
        match CASES.iter().find(|case| case.name == name) {
            Some(case) => case.config(),
            None if path.exists() => {
                let read = std::fs::read_to_string(path);
                parse(path, &read.map_err(|source| CameraError::Read { path: path.into(), source })?)
            }
            None => Err(CameraError::Unknown { name: name.into() }),
        }
    }
}

fn parse(path: &Path, toml: &str) -> Result<CameraConfig, CameraError> {
    let failed = |message: String| CameraError::Parse { path: path.into(), message };
    let config: CameraConfig = toml::from_str(toml).map_err(|error| failed(error.to_string()))?;
    match config.violation() {
        Some((key, value, must)) => Err(failed(format!("{key} = {value}: {must}"))),
        None => Ok(config),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::strength::Strength;

    #[test]
    fn every_camera_with_a_name_is_read_and_names_are_unique() {
        for (n, case) in CASES.iter().enumerate() {
            let config = CameraConfig::named(case.name).unwrap();
            assert_eq!(CameraConfig::case(case.name), Some(config));
            assert!(CASES[..n].iter().all(|other| other.name != case.name), "{}", case.name);
        }
        let wide = CameraConfig { edge_px: 5.0, ..CameraConfig::case("harder").unwrap() };
        assert_eq!((wide.number(), CASES[2].name), (Some(2), "harder"));
        assert_eq!(CameraConfig { noise: Strength::fixed(1.0), ..wide }.number(), None);
        assert_eq!(CameraConfig::case("clean"), Some(CameraConfig::default()));
        assert_eq!(CameraConfig::case("hrad"), None);
        let error = CameraConfig::named("hrad").unwrap_err().to_string();
        assert!(error.contains("`hrad`") && error.contains("harder"), "{error}");
    }
}
