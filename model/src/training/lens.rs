//! Harder cameras: what a real lens, sensor and scene would do to our camera's clean picture.
//!
//! A clean picture holds the UAV's coverage in red and the obstacle's visible coverage in blue, so
//! any other colours, a background, a gain and pixel noise can be put on afterwards. Knows pictures;
//! knows no positions, so no label can slip through.

use crpl_sitl::camera::{CHANNELS, Frame, SIDE};
use crpl_sitl::world::noise::{Noise, Stream};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// One camera. `Default` is the clean one, which changes nothing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Lens {
    /// Colour of the UAV, RGB in 0..=1.
    pub uav: [f32; CHANNELS],
    /// Colour of the obstacle, RGB in 0..=1.
    pub obstacle: [f32; CHANNELS],
    /// Standard deviation of white noise on every pixel and channel, in steps of 1/255.
    pub noise: f32,
    /// Brightest spot of the textured background, in steps of 1/255; the texture is the same in
    /// every picture.
    pub texture: f32,
    /// Largest relative deviation of the gain, which drifts as a sine of 100 frames.
    pub drift: f32,
}

impl Default for Lens {
    fn default() -> Self {
        Self { uav: [1.0, 0.0, 0.0], obstacle: [0.0, 0.0, 1.0], noise: 0.0, texture: 0.0, drift: 0.0 }
    }
}

/// UAV and obstacle that share all three channels.
pub const MIXED: Lens =
    Lens { uav: [1.0, 0.25, 0.1], obstacle: [0.1, 0.3, 1.0], noise: 0.0, texture: 0.0, drift: 0.0 };

/// Which picture is taken: decides its noise and the phase of the drift.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shot {
    /// The episode, or any number that names a series of pictures.
    pub series: u64,
    /// Frame in the series.
    pub frame: usize,
}

/// Several cameras and the seed of their noise; each series of pictures is taken with one of them.
#[derive(Debug, Clone)]
pub struct Lenses {
    lenses: Vec<Lens>,
    noise: Noise,
}

impl Lens {
    /// Whether colours lie in 0..=1 and the rest is finite and not negative, drift below 1.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let colours = self.uav.iter().chain(&self.obstacle).all(|c| (0.0..=1.0).contains(c));
        let sizes = [self.noise, self.texture].iter().all(|v| (0.0..=255.0).contains(v));
        colours && sizes && (0.0..1.0).contains(&self.drift)
    }

    /// The picture that this camera takes where the clean one took `clean`.
    #[must_use]
    pub fn take(&self, clean: Frame, shot: Shot, noise: &Noise) -> Frame {
        if *self == Self::default() {
            return clean;
        }
        let mut rng = noise.generator(Stream::Camera, (shot.series << 16) | shot.frame as u64);
        let gain = self.gain(shot);
        let mut bytes = Vec::with_capacity(clean.rgb().len());
        for (n, pixel) in clean.rgb().chunks_exact(CHANNELS).enumerate() {
            let (uav, obstacle) = (f32::from(pixel[0]), f32::from(pixel[2]));
            let open = 1.0 - (uav + obstacle) / 255.0;
            for channel in 0..CHANNELS {
                let mut value = uav * self.uav[channel] + obstacle * self.obstacle[channel];
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
    fn gain(&self, shot: Shot) -> f32 {
        // The golden ratio spreads the phases of consecutive series evenly.
        let phase = (shot.series as f64 * 0.618_033_988_749_894_9).fract();
        let turn = std::f64::consts::TAU * (shot.frame as f64 / 100.0 + phase);
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

impl Lenses {
    /// These cameras; none means the clean one.
    #[must_use]
    pub fn new(lenses: &[Lens], noise: &Noise) -> Self {
        let lenses = if lenses.is_empty() { vec![Lens::default()] } else { lenses.to_vec() };
        Self { lenses, noise: noise.clone() }
    }

    /// The picture `shot`, taken with its series' camera.
    #[must_use]
    pub fn take(&self, clean: Frame, shot: Shot) -> Frame {
        // Consecutive series go round the cameras.
        let lens = &self.lenses[(shot.series % self.lenses.len() as u64) as usize];
        lens.take(clean, shot, &self.noise)
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::Scenario;
    use nalgebra::Vector2;

    use super::*;

    fn clean() -> Frame {
        crpl_sitl::camera::render(Vector2::new(0.3, 0.4), Vector2::new(0.7, 0.6), &Scenario::default())
    }

    const SHOT: Shot = Shot { series: 3, frame: 7 };

    #[test]
    fn the_clean_camera_changes_nothing() {
        assert_eq!(Lens::default().take(clean(), SHOT, &Noise::new(1)), clean());
    }

    #[test]
    fn mixed_colours_are_the_bodies_colours() {
        let seen = MIXED.take(clean(), SHOT, &Noise::new(1));
        assert_eq!(seen.pixel(70, 60), [26, 77, 255]);
        let [red, green, blue] = seen.pixel(29, 39);
        let coverage = f32::from(clean().pixel(29, 39)[0]);
        assert_eq!([red, green, blue], [coverage, 0.25 * coverage, 0.1 * coverage].map(|v| v.round() as u8));
    }

    #[test]
    fn noise_has_its_size_and_belongs_to_the_shot() {
        let lens = Lens { noise: 2.0, texture: 100.0, ..Lens::default() };
        let still = Lens { noise: 0.0, ..lens }.take(clean(), SHOT, &Noise::new(1));
        let take = |shot, seed| lens.take(clean(), shot, &Noise::new(seed));
        let seen = take(SHOT, 1);
        assert_eq!(seen, take(SHOT, 1));
        assert_ne!(seen, take(Shot { frame: 8, ..SHOT }, 1));
        assert_ne!(seen, take(SHOT, 2));
        // Where the texture is bright, nothing is clamped.
        let pairs = seen.rgb().iter().zip(still.rgb()).filter(|(_, s)| (20..200).contains(*s));
        let squares: Vec<f64> = pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).collect();
        let deviation = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!((deviation - 2.0).abs() < 0.1, "{deviation}");
    }

    #[test]
    fn brightness_drifts_within_its_bounds_and_series_go_round_the_cameras() {
        let lens = Lens { drift: 0.2, ..Lens::default() };
        let gains: Vec<f32> = (0..100).map(|frame| lens.gain(Shot { series: 5, frame })).collect();
        let (low, high) = gains.iter().fold((9.0f32, 0.0f32), |(l, h), g| (l.min(*g), h.max(*g)));
        assert!((low - 0.8).abs() < 1e-3 && (high - 1.2).abs() < 1e-3, "{low} {high}");
        let two = Lenses::new(&[Lens::default(), MIXED], &Noise::new(0));
        assert_eq!(two.take(clean(), Shot { series: 4, frame: 0 }), clean());
        assert_ne!(two.take(clean(), Shot { series: 5, frame: 0 }), clean());
    }

    #[test]
    fn a_camera_that_cannot_be_is_told() {
        assert!(MIXED.is_sound());
        assert!(!Lens { noise: f32::NAN, ..MIXED }.is_sound());
        assert!(!Lens { uav: [1.5, 0.0, 0.0], ..MIXED }.is_sound());
        assert!(!Lens { drift: 1.0, ..MIXED }.is_sound());
    }
}
