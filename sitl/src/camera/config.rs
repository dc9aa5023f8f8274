//! `[camera]` of a scenario: what lens, sensor and scene add to the clean drawing. Each effect has a key,
//! a unit, a range and a default, and all defaults together are the clean camera.
//!
//! A [`Strength`] is a number, or a range from which each flight draws its own. So one configuration
//! describes one camera, or a family of cameras to train on. A new effect is a field of
//! [`CameraConfig`], its row in [`CameraConfig::violation`], and its term in [`super::film`].

use serde::{Deserialize, Serialize};

use super::effects::Effects;
use super::frame::CHANNELS;
use super::ground::Ground;
use super::strength::Strength;

/// A colour: red, green, blue, each 0 to 1.
pub type Rgb = [f32; CHANNELS];

/// Where the colours of the bodies come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Palette {
    /// The colours that are given.
    #[default]
    Given,
    /// Drawn for each flight: a reddish UAV, bluish obstacles, a greenish second obstacle.
    Family,
    /// Drawn for each flight: any colours that stand off from each other and from the ground.
    Any,
}

/// The camera of a scenario. `Default` draws discs on black and nothing else.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraConfig {
    /// w, width of a disc's soft rim, px (our choice).
    pub edge_px: f64,
    /// Where the colours of the bodies come from. Default: those that follow.
    pub colours: Palette,
    /// Colour of the UAV: RGB, each 0 to 1. Default red, `[1, 0, 0]`.
    pub uav: Rgb,
    /// Colour of all obstacles but the second: RGB, each 0 to 1. Default blue, `[0, 0, 1]`.
    pub obstacle: Rgb,
    /// Colour of the second obstacle: RGB, each 0 to 1. Default green, `[0, 1, 0]`.
    pub obstacle_2: Rgb,
    /// Drawn radius of an obstacle over its true one: 0.1 to 10. Default 1.
    pub obstacle_scale: Strength,
    /// Change of brightness, contrast and white balance over time, relative: 0 to 0.9. Default 0.
    pub drift: Strength,
    /// Light from one side: relative change of a body's brightness at its rim, 0 to 1. Default 0.
    pub shade: Strength,
    /// Soft shadow of the bodies on the ground: share of the light that it takes, 0 to 1. Default 0.
    pub shadow: Strength,
    /// Quality of a JPEG's quantisation, 1 to 100, without subsampling of the colours; 0 is none. Default 0.
    pub jpeg: Strength,
    /// Motion blur: share of the control interval for which the shutter is open, centred on the frame's
    /// time, 0 to 1. Default 0.
    pub blur: Strength,
    /// Standard deviation of the whole picture's place in each axis, px, cut at two of them: 0 to 4. Default 0.
    pub shake: Strength,
    /// Standard deviation of the noise of each pixel and channel, in steps of 1/255: 0 to 255. Default 0.
    pub noise: Strength,
    /// What is behind the bodies. Default black.
    pub ground: Ground,
    /// Discs that drift over the ground and are neither UAV nor obstacle. Default none.
    pub distractors: Distractors,
    /// The six cameras for which the encoder `centroid` can be trained; beside other keys they must be left
    /// out.
    pub effects: Effects,
}

impl Default for CameraConfig {
    fn default() -> Self {
        let none = Strength::fixed(0.0);
        Self {
            edge_px: 4.0,
            colours: Palette::Given,
            uav: [1.0, 0.0, 0.0],
            obstacle: [0.0, 0.0, 1.0],
            obstacle_2: [0.0, 1.0, 0.0],
            obstacle_scale: Strength::fixed(1.0),
            drift: none,
            shade: none,
            shadow: none,
            jpeg: none,
            blur: none,
            shake: none,
            noise: none,
            ground: Ground::default(),
            distractors: Distractors::default(),
            effects: Effects::default(),
        }
    }
}

/// Discs that drift over the ground, reflect at the picture's edge and lie under the UAV. Their colours
/// stand off from those of the bodies and of the ground.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Distractors {
    /// Number of them, 0 to 32. Default 0.
    pub count: Strength,
    /// Radius, px, 0.1 to 50. Default: each draws its own from 2.5 to 4.5.
    pub radius: Strength,
    /// Speed, px per control interval, 0 to 50. Default: each draws its own from 0.2 to 1.2.
    pub speed: Strength,
}

impl Default for Distractors {
    fn default() -> Self {
        Self {
            count: Strength::fixed(0.0),
            radius: Strength::between(2.5, 4.5),
            speed: Strength::between(0.2, 1.2),
        }
    }
}

/// A key, its value, and the least and the greatest value that it may have.
type Row = (&'static str, Strength, f64, f64);

impl CameraConfig {
    /// Whether it draws the clean frame, `effects` apart.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        let clean = Self { edge_px: self.edge_px, effects: self.effects, ..Self::default() };
        *self == clean
    }

    /// The first key whose value is out of range: its name, the value and what it must be.
    #[must_use]
    pub fn violation(&self) -> Option<(String, String, String)> {
        let key = |key: &str, value: f64, must: String| (key.to_owned(), value.to_string(), must);
        let strengths = self.strengths().into_iter().find_map(|(name, strength, least, most)| {
            let (value, must) = strength.violation(least, most)?;
            Some(key(name, value, must))
        });
        let colours = [("uav", self.uav), ("obstacle", self.obstacle), ("obstacle_2", self.obstacle_2)];
        let colours = || {
            let mut channels = colours.into_iter().flat_map(|(name, rgb)| rgb.map(|c| (name, c)));
            let (name, c) = channels.find(|(_, c)| !(0.0..=1.0).contains(c))?;
            Some(key(name, c.into(), "must lie in [0, 1]".into()))
        };
        let edge = || {
            let good = (0.01..=100.0).contains(&self.edge_px);
            (!good).then(|| key("edge_px", self.edge_px, "must lie in [0.01, 100]".into()))
        };
        let effects = || {
            let (name, value, must) = self.effects.violation()?;
            Some(key(&format!("effects.{name}"), value, must.into()))
        };
        let both = || {
            let both = self.effects != Effects::default() && !self.is_clean();
            both.then(|| ("effects".into(), "set".into(), "must be left out beside other keys".into()))
        };
        strengths
            .or_else(colours)
            .or_else(edge)
            .or_else(|| self.ground.violation())
            .or_else(effects)
            .or_else(both)
    }

    fn strengths(&self) -> [Row; 15] {
        let (ground, distractors) = (&self.ground, &self.distractors);
        [
            ("obstacle_scale", self.obstacle_scale, 0.1, 10.0),
            ("drift", self.drift, 0.0, 0.9),
            ("shade", self.shade, 0.0, 1.0),
            ("shadow", self.shadow, 0.0, 1.0),
            ("jpeg", self.jpeg, 0.0, 100.0),
            ("blur", self.blur, 0.0, 1.0),
            ("shake", self.shake, 0.0, 4.0),
            ("noise", self.noise, 0.0, 255.0),
            ("ground.contrast", ground.contrast, 0.0, 1.0),
            ("ground.mean", ground.mean, 0.0, 1.0),
            ("ground.tint", ground.tint, 0.0, 1.0),
            ("ground.edges", ground.edges, 0.0, 100.0),
            ("distractors.count", distractors.count, 0.0, 32.0),
            ("distractors.radius", distractors.radius, 0.1, 50.0),
            ("distractors.speed", distractors.speed, 0.0, 50.0),
        ]
    }
}

#[cfg(test)]
mod tests {
    use crate::Scenario;

    #[test]
    fn a_camera_survives_toml_and_json() {
        for case in ["clean", "hard", "harder"] {
            let mut scenario = Scenario::default();
            scenario.film_with(case).unwrap();
            let again = Scenario::from_toml(&toml::to_string(&scenario).unwrap()).unwrap();
            assert_eq!(again, scenario, "{case}");
            let json = serde_json::to_string(&scenario).unwrap();
            assert_eq!(serde_json::from_str::<Scenario>(&json).unwrap(), scenario, "{case}");
        }
    }

    #[test]
    fn each_key_has_a_range_that_is_told() {
        let refused =
            |text: &str| Scenario::from_toml(&format!("[camera]\n{text}\n")).unwrap_err().to_string();
        for (text, said) in [
            ("noise = -1.0", "camera.noise = -1: must lie in [0, 255]"),
            ("noise = nan", "camera.noise = NaN: must lie in [0, 255]"),
            ("jpeg = 101", "camera.jpeg = 101: must lie in [0, 100]"),
            ("blur = { low = 0, high = 2 }", "camera.blur = 2: must lie in [0, 1]"),
            ("blur = { low = 1, high = 0 }", "camera.blur = 1: must be at most its `high`"),
            ("shake = 9.0", "camera.shake = 9: must lie in [0, 4]"),
            ("drift = 1.0", "camera.drift = 1: must lie in [0, 0.9]"),
            ("shade = 1.5", "camera.shade = 1.5: must lie in [0, 1]"),
            ("shadow = { low = 0, high = 1, share = 2 }", "camera.shadow = 2: must lie in [0, 1]"),
            ("obstacle_scale = 0.0", "camera.obstacle_scale = 0: must lie in [0.1, 10]"),
            ("uav = [0.0, 1.5, 0.0]", "camera.uav = 1.5: must lie in [0, 1]"),
            ("edge_px = 0.0", "camera.edge_px = 0: must lie in [0.01, 100]"),
            ("ground = { share = 1.5 }", "camera.ground.share = 1.5: must lie in [0, 1]"),
            ("ground = { contrast = 2 }", "camera.ground.contrast = 2: must lie in [0, 1]"),
            ("ground = { mean = 2 }", "camera.ground.mean = 2: must lie in [0, 1]"),
            ("ground = { tint = 2 }", "camera.ground.tint = 2: must lie in [0, 1]"),
            ("ground = { edges = -1 }", "camera.ground.edges = -1: must lie in [0, 100]"),
            ("distractors = { count = 33 }", "camera.distractors.count = 33: must lie in [0, 32]"),
            ("distractors = { radius = 0 }", "camera.distractors.radius = 0: must lie in [0.1, 50]"),
            ("distractors = { speed = -1 }", "camera.distractors.speed = -1: must lie in [0, 50]"),
            (
                "noise = 1.0\neffects = { noise = 1.0 }",
                "camera.effects = set: must be left out beside other keys",
            ),
        ] {
            assert_eq!(refused(text), said);
        }
        assert!(refused("nosie = 1.0").contains("nosie"));
    }
}
