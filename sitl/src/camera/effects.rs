//! Camera effects: what a real lens, sensor and scene would do to the clean frame.
//!
//! A clean frame holds the UAV's coverage in red and the obstacles' visible coverage in blue and green,
//! so any other colours, a background, a gain and pixel noise can be applied afterwards. Knows frames;
//! knows no positions, so no label can slip through. A scenario's `[camera.effects]` and each of a
//! training's `[[cameras]]` are an [`Effects`]: a new effect is a field here, its default, its range in
//! [`Effects::violation`] and its term in [`Effects::apply`].

use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use super::frame::{BLUE, CHANNELS, Frame, GREEN, RED, SIDE};
use crate::units::noise::{Noise, Stream};

/// The effects of one camera. `Default` is the clean one, which changes nothing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Effects {
    /// Colour of the UAV: RGB, each 0 to 1. Default red, `[1, 0, 0]`.
    pub uav: [f32; CHANNELS],
    /// Colour of all obstacles but the second: RGB, each 0 to 1. Default blue, `[0, 0, 1]`.
    pub obstacle: [f32; CHANNELS],
    /// Colour of the second obstacle: RGB, each 0 to 1. Default green, `[0, 1, 0]`.
    pub obstacle_2: [f32; CHANNELS],
    /// Standard deviation of white Gaussian noise on every pixel and channel, in steps of 1/255: 0 to
    /// 255. Default 0.
    pub noise: f32,
    /// Brightest spot of the textured background, in steps of 1/255: 0 to 255. The texture is the same
    /// in every frame. Default 0.
    pub texture: f32,
    /// Largest relative deviation of the gain, which drifts as a sine with a period of 100 frames: 0 to
    /// below 1. Default 0.
    pub drift: f32,
}

impl Default for Effects {
    fn default() -> Self {
        Self {
            uav: [1.0, 0.0, 0.0],
            obstacle: [0.0, 0.0, 1.0],
            obstacle_2: [0.0, 1.0, 0.0],
            noise: 0.0,
            texture: 0.0,
            drift: 0.0,
        }
    }
}

/// Which frame is taken: decides its noise and the phase of the drift.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameId {
    /// The flight's seed, the number of a training episode, or any number that names a series of frames.
    pub series: u64,
    /// Number of the frame in the series, from 0; in a flight the tick.
    pub frame: u64,
}

/// Several cameras and the source of their noise; each series of frames is taken with one of them.
#[derive(Debug, Clone)]
pub struct CameraSet {
    cameras: Vec<Effects>,
    noise: Noise,
}

impl Effects {
    /// UAV and obstacle share all three channels.
    #[must_use]
    pub fn mixed_colours() -> Self {
        Self { uav: [1.0, 0.25, 0.1], obstacle: [0.1, 0.3, 1.0], ..Self::default() }
    }

    /// The first key whose value is out of range: its name, the value and what it must be.
    #[must_use]
    pub fn violation(&self) -> Option<(&'static str, f64, &'static str)> {
        let colours = [("uav", self.uav), ("obstacle", self.obstacle), ("obstacle_2", self.obstacle_2)];
        let colours = colours
            .into_iter()
            .flat_map(|(key, rgb)| rgb.map(|c| (key, c, (0.0..=1.0).contains(&c), "must lie in [0, 1]")));
        let sizes = [("noise", self.noise), ("texture", self.texture)]
            .map(|(key, v)| (key, v, (0.0..=255.0).contains(&v), "must lie in [0, 255]"));
        let drift = ("drift", self.drift, (0.0..1.0).contains(&self.drift), "must lie in [0, 1)");
        let (key, value, _, must) = colours.chain(sizes).chain([drift]).find(|(_, _, good, _)| !good)?;
        Some((key, value.into(), must))
    }

    /// The frame that this camera takes where the clean one took `clean`. The same for equal `noise`
    /// and `id`.
    #[must_use]
    pub fn apply(&self, clean: Frame, id: FrameId, noise: &Noise) -> Frame {
        if *self == Self::default() {
            return clean;
        }
        let mut rng = noise.generator(Stream::Camera, (id.series << 16) | id.frame);
        let gain = self.gain(id);
        let mut bytes = Vec::with_capacity(clean.rgb().len());
        for (n, pixel) in clean.rgb().chunks_exact(CHANNELS).enumerate() {
            let [uav, second, obstacle] = [RED, GREEN, BLUE].map(|channel| f32::from(pixel[channel]));
            let open = 1.0 - (uav + obstacle.max(second)) / 255.0;
            for channel in 0..CHANNELS {
                let mut value = uav * self.uav[channel]
                    + obstacle * self.obstacle[channel]
                    + second * self.obstacle_2[channel];
                if self.texture > 0.0 {
                    value += open * self.texture * texture(n % SIDE, n / SIDE, channel);
                }
                value *= gain;
                if self.noise > 0.0 {
                    let deviate: f32 = StandardNormal.sample(&mut rng);
                    value += self.noise * deviate;
                }
                bytes.push(value.round().clamp(0.0, 255.0) as u8);
            }
        }
        Frame::from_rgb(bytes).unwrap_or(clean)
    }

    /// 1 + drift sin(2π (frame/100 + phase)), the phase a function of the series.
    fn gain(&self, id: FrameId) -> f32 {
        // The golden ratio spreads the phases of consecutive series evenly.
        let phase = (id.series as f64 * 0.618_033_988_749_894_9).fract();
        let turn = std::f64::consts::TAU * (id.frame as f64 / 100.0 + phase);
        1.0 + self.drift * turn.sin() as f32
    }
}

/// Brightness of the background at a pixel, 0..=1: three waves that no channel shares.
fn texture(x: usize, y: usize, channel: usize) -> f32 {
    const WAVES: [[f32; 3]; 3] = [[0.31, 0.17, 0.0], [-0.11, 0.43, 1.3], [0.57, -0.23, 2.6]];
    let (x, y) = (x as f32, y as f32);
    let sum: f32 =
        WAVES.iter().map(|[a, b, phase]| (a * x + b * y + phase + 2.1 * channel as f32).sin()).sum();
    (sum + 3.0) / 6.0
}

impl CameraSet {
    /// These cameras; none means the clean one.
    #[must_use]
    pub fn new(cameras: &[Effects], noise: &Noise) -> Self {
        let cameras = if cameras.is_empty() { vec![Effects::default()] } else { cameras.to_vec() };
        Self { cameras, noise: noise.clone() }
    }

    /// The frame `id`, taken with its series' camera: consecutive series use the cameras in turn.
    #[must_use]
    pub fn apply(&self, clean: Frame, id: FrameId) -> Frame {
        let camera = &self.cameras[(id.series % self.cameras.len() as u64) as usize];
        camera.apply(clean, id, &self.noise)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::{Scenario, Sim, camera};

    fn clean() -> Frame {
        camera::render(Vector2::new(0.3, 0.4), Vector2::new(0.7, 0.6), &Scenario::default())
    }

    const SHOT: FrameId = FrameId { series: 3, frame: 7 };

    #[test]
    fn the_clean_camera_changes_nothing() {
        assert_eq!(Effects::default().apply(clean(), SHOT, &Noise::new(1)), clean());
    }

    #[test]
    fn mixed_colours_are_the_bodies_colours() {
        let seen = Effects::mixed_colours().apply(clean(), SHOT, &Noise::new(1));
        assert_eq!(seen.pixel(70, 60), [26, 77, 255]);
        let [red, green, blue] = seen.pixel(29, 39);
        let coverage = f32::from(clean().pixel(29, 39)[0]);
        assert_eq!([red, green, blue], [coverage, 0.25 * coverage, 0.1 * coverage].map(|v| v.round() as u8));
    }

    #[test]
    fn noise_has_its_size_and_belongs_to_the_frame() {
        let effects = Effects { noise: 2.0, texture: 100.0, ..Effects::default() };
        let still = Effects { noise: 0.0, ..effects }.apply(clean(), SHOT, &Noise::new(1));
        let take = |shot, seed| effects.apply(clean(), shot, &Noise::new(seed));
        let seen = take(SHOT, 1);
        assert_eq!(seen, take(SHOT, 1));
        assert_ne!(seen, take(FrameId { frame: 8, ..SHOT }, 1));
        assert_ne!(seen, take(SHOT, 2));
        // Where the texture is bright, nothing is clamped.
        let pairs = seen.rgb().iter().zip(still.rgb()).filter(|(_, s)| (20..200).contains(*s));
        let squares: Vec<f64> = pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).collect();
        let deviation = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!((deviation - 2.0).abs() < 0.1, "{deviation}");
    }

    #[test]
    fn brightness_drifts_within_its_bounds_and_series_go_round_the_cameras() {
        let effects = Effects { drift: 0.2, ..Effects::default() };
        let gains: Vec<f32> = (0..100).map(|frame| effects.gain(FrameId { series: 5, frame })).collect();
        let (low, high) = gains.iter().fold((9.0f32, 0.0f32), |(l, h), g| (l.min(*g), h.max(*g)));
        assert!((low - 0.8).abs() < 1e-3 && (high - 1.2).abs() < 1e-3, "{low} {high}");
        let two = CameraSet::new(&[Effects::default(), Effects::mixed_colours()], &Noise::new(0));
        assert_eq!(two.apply(clean(), FrameId { series: 4, frame: 0 }), clean());
        assert_ne!(two.apply(clean(), FrameId { series: 5, frame: 0 }), clean());
    }

    #[test]
    fn a_value_out_of_range_is_named() {
        let mixed = Effects::mixed_colours();
        assert_eq!(mixed.violation(), None);
        for (effects, key) in [
            (Effects { noise: f32::NAN, ..mixed }, "noise"),
            (Effects { uav: [1.5, 0.0, 0.0], ..mixed }, "uav"),
            (Effects { drift: 1.0, ..mixed }, "drift"),
        ] {
            assert_eq!(effects.violation().unwrap().0, key);
        }
        let error = Scenario::from_toml("[camera.effects]\ntexture = -1.0\n").unwrap_err().to_string();
        assert_eq!(error, "camera.effects.texture = -1: must lie in [0, 255]");
    }

    #[test]
    fn a_flight_is_filmed_as_training_films_it() {
        let effects =
            "uav = [1.0, 0.25, 0.1]\nobstacle = [0.1, 0.3, 1.0]\nnoise = 5.0\ntexture = 20.0\ndrift = 0.2\n";
        let scenario = Scenario::from_toml(&format!("[camera.effects]\n{effects}")).unwrap();
        let camera: Effects = toml::from_str(effects).unwrap();
        let seed = 6;
        let [mut one, mut other] = [(); 2].map(|()| Sim::new(scenario.clone(), seed));
        for frame in 0..5 {
            let clean = one.world().frame(&scenario);
            let id = FrameId { series: seed, frame };
            let seen = CameraSet::new(&[camera], &Noise::new(seed)).apply(clean.clone(), id);
            assert_eq!(one.frame(), seen);
            assert_eq!(one.frame(), other.frame());
            assert_ne!(seen, clean);
            one.advance();
            other.advance();
        }
        assert_ne!(Sim::new(scenario.clone(), seed + 1).frame(), Sim::new(scenario, seed).frame());
    }

    #[test]
    fn a_second_obstacle_has_a_colour_of_its_own() {
        let mut scenario =
            Scenario::from_toml("[[obstacle]]\n[[obstacle]]\nposition = [0.2, 0.2]\n").unwrap();
        scenario.camera.effects.obstacle_2 = [1.0, 1.0, 0.0];
        let frame = Sim::new(scenario, 0).frame();
        assert_eq!([frame.pixel(20, 20), frame.pixel(50, 45)], [[255, 255, 0], [0, 0, 255]]);
    }
}
