//! The camera of one flight: draws its look from the seed, and takes its frames.
//!
//! A frame is a function of (configuration, seed, tick, where the bodies are). Each effect has random
//! numbers of its own, so that switching one on changes no other.

use std::f64::consts::TAU;
use std::sync::{Arc, OnceLock};

use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::canvas::{Canvas, Mask};
use super::config::{CameraConfig, Rgb};
use super::distractor::Distractor;
use super::effects::FrameId;
use super::frame::{CHANNELS, Frame, SIDE};
use super::ground::Plane;
use super::jpeg::Quantiser;
use super::palette::Colours;
use super::poses::{Body, Poses};
use super::render::{Disc, Sizes, render_all};
use crate::units::noise::{Noise, Stream};
use crate::units::{PerObstacle, Tick};

/// The camera of one flight.
#[derive(Debug, Clone)]
pub struct Film {
    config: CameraConfig,
    seed: u64,
    noise: Noise,
    look: OnceLock<Arc<Look>>,
}

/// What is drawn once for a flight.
#[derive(Debug)]
struct Look {
    colours: Colours,
    obstacle_scale: f64,
    ground: Option<Plane>,
    distractors: Vec<Distractor>,
    /// Towards the light, a unit vector.
    light: Vector2<f64>,
    shade: f64,
    shadow: f64,
    drift: Drift,
    jpeg: Option<Quantiser>,
    blur: f64,
    shake: f64,
    noise: f64,
}

/// Change of brightness, contrast and white balance over time.
#[derive(Debug)]
struct Drift {
    strength: f64,
    /// Phases of brightness, contrast, and of each channel's balance, turns. Contrast and red share one.
    phases: [f64; 1 + CHANNELS],
}

/// Which number of the flight is drawn. The numbers are part of every published picture.
#[derive(Debug, Clone, Copy)]
enum Draw {
    Colours = 0,
    ObstacleScale = 1,
    Ground = 2,
    Distractors = 3,
    Light = 4,
    Shade = 5,
    Shadow = 6,
    Drift = 7,
    Jpeg = 8,
    Blur = 9,
    Shake = 10,
    Noise = 11,
}

/// Distance of a body's shadow from it, px.
const SHADOW_PX: f64 = 4.0;
/// Width of a shadow's rim over that of a body.
const SHADOW_RIM: f64 = 1.5;
/// Shading reaches its full strength this far beyond a body's radius, px.
const SHADE_PX: f64 = 2.0;
/// When the shutter is open, shares of its time.
const SHUTTER: [f64; 5] = [-0.4, -0.2, 0.0, 0.2, 0.4];

impl Film {
    /// The camera of the flight with this seed. `config` must have no [`CameraConfig::violation`].
    #[must_use]
    pub fn new(config: &CameraConfig, seed: u64) -> Self {
        Self { config: config.clone(), seed, noise: Noise::new(seed), look: OnceLock::new() }
    }

    /// The frame at `tick`.
    #[must_use]
    pub fn frame(&self, tick: Tick, poses: &Poses) -> Frame {
        if self.config.is_clean() {
            let centres = poses.obstacles.iter().map(|o| o.position).collect();
            let clean = render_all(poses.uav.position, &centres, &Seen { poses, edge: self.config.edge_px });
            let id = FrameId { series: self.seed, frame: tick.0 };
            return self.config.effects.apply(clean, id, &self.noise);
        }
        let shake = self.shake(tick);
        let mut canvas = self.scene(tick, poses, shake);
        self.develop(&mut canvas, tick);
        canvas.into_frame()
    }

    /// How far the camera's shake moves the picture at `tick`, px (column, row).
    #[must_use]
    pub fn shake(&self, tick: Tick) -> Vector2<f64> {
        let size = self.look().shake;
        if size == 0.0 {
            return Vector2::zeros();
        }
        size * self.noise.normal(Stream::Shake, tick).map(|w| w.clamp(-2.0, 2.0))
    }

    /// Drawn radius of an obstacle over its true one, in this flight.
    #[must_use]
    pub fn obstacle_scale(&self) -> f64 {
        self.look().obstacle_scale
    }

    /// Colours of the UAV, of all obstacles but the second, and of the second, in this flight.
    #[must_use]
    pub fn colours(&self) -> [Rgb; 3] {
        let Colours { uav, obstacle, obstacle_2 } = self.look().colours;
        [uav, obstacle, obstacle_2]
    }

    fn look(&self) -> &Look {
        self.look.get_or_init(|| Arc::new(Look::draw(&self.config, &self.noise)))
    }

    /// Ground and bodies, values from 0 to 1.
    fn scene(&self, tick: Tick, poses: &Poses, shake: Vector2<f64>) -> Canvas {
        let look = self.look();
        let mut canvas = match &look.ground {
            Some(ground) => Canvas::of_ground(ground, shake.into()),
            None => Canvas::black(),
        };
        let px = SIDE as f64;
        let on_film = |body: &Body, scale: f64| Body {
            position: body.position * px + shake,
            velocity: body.velocity * px,
            radius: body.radius * px * scale,
        };
        let uav = on_film(&poses.uav, 1.0);
        let obstacles: PerObstacle<Body> =
            poses.obstacles.iter().map(|o| on_film(o, look.obstacle_scale)).collect();
        if look.shadow > 0.0 {
            obstacles.iter().chain([&uav]).for_each(|body| self.cast(&mut canvas, body));
        }
        for (n, body) in obstacles.iter().enumerate() {
            self.paint(&mut canvas, body, look.colours.of_obstacle(n));
        }
        for distractor in &look.distractors {
            let body = distractor.at(tick);
            let body = Body { position: body.position + shake, ..body };
            self.paint(&mut canvas, &body, distractor.colour);
        }
        self.paint(&mut canvas, &uav, look.colours.uav);
        canvas
    }

    /// A body's shadow on the ground.
    fn cast(&self, canvas: &mut Canvas, body: &Body) {
        let place = body.position - SHADOW_PX * self.look().light;
        let mask = Mask::new(&[disc(place, body.radius, SHADOW_RIM * self.config.edge_px)]);
        canvas.darken(&mask, self.look().shadow as f32);
    }

    /// A body, lengths in px, over what is there.
    fn paint(&self, canvas: &mut Canvas, body: &Body, colour: Rgb) {
        let look = self.look();
        let at = |time: f64| {
            disc(body.position + time * look.blur * body.velocity, body.radius, self.config.edge_px)
        };
        let is_blurred = look.blur > 0.0 && body.velocity != Vector2::zeros();
        let mask = if is_blurred { Mask::new(&SHUTTER.map(at)) } else { Mask::new(&[at(0.0)]) };
        if look.shade == 0.0 {
            canvas.paint(&mask, colour, |_, _| 1.0);
            return;
        }
        let slope = look.light / (body.radius + SHADE_PX);
        canvas.paint(&mask, colour, |x, y| {
            let from_centre = Vector2::new(x as f64 + 0.5, y as f64 + 0.5) - body.position;
            (1.0 + look.shade * from_centre.dot(&slope).clamp(-1.0, 1.0)) as f32
        });
    }

    /// What sensor and file make of the scene: values from 0 to 255.
    fn develop(&self, canvas: &mut Canvas, tick: Tick) {
        let look = self.look();
        canvas.scale(look.drift.channels(tick, look.ground.as_ref().map_or(0.0, |ground| ground.mean)));
        if look.noise > 0.0 {
            canvas.add_noise(look.noise as f32, &mut self.noise.generator(Stream::Grain, tick.0));
        }
        canvas.clamp();
        if let Some(jpeg) = &look.jpeg {
            jpeg.apply(canvas);
        }
    }
}

/// A disc with its lengths in px.
fn disc(centre: Vector2<f64>, radius: f64, edge: f64) -> Disc {
    Disc::new(centre / SIDE as f64, radius, edge)
}

/// Poses as the clean drawing knows them.
struct Seen<'a> {
    poses: &'a Poses,
    edge: f64,
}

impl Sizes for Seen<'_> {
    fn uav_radius(&self) -> f64 {
        self.poses.uav.radius
    }

    fn obstacle_radii(&self) -> impl Iterator<Item = f64> {
        self.poses.obstacles.iter().map(|obstacle| obstacle.radius)
    }

    fn edge_px(&self) -> f64 {
        self.edge
    }
}

impl Look {
    fn draw(config: &CameraConfig, noise: &Noise) -> Self {
        let rng = |what: Draw| noise.generator(Stream::Look, what as u64);
        let ground = config.ground.draw(&mut rng(Draw::Ground));
        let mean = ground.as_ref().map_or(0.0, |ground| ground.mean);
        let colours = Colours::draw(config, mean, &mut rng(Draw::Colours));
        let distractors = Distractor::draw_all(config, &colours, mean, &mut rng(Draw::Distractors));
        let quality = config.jpeg.draw_whole(&mut rng(Draw::Jpeg));
        let turn: f64 = rng(Draw::Light).random();
        let (sin, cos) = (TAU * turn).sin_cos();
        Self {
            colours,
            obstacle_scale: config.obstacle_scale.draw(&mut rng(Draw::ObstacleScale)),
            ground,
            distractors,
            light: Vector2::new(cos, sin),
            shade: config.shade.draw(&mut rng(Draw::Shade)),
            shadow: config.shadow.draw(&mut rng(Draw::Shadow)),
            drift: Drift::draw(config, &mut rng(Draw::Drift)),
            jpeg: (quality > 0).then(|| Quantiser::new(quality)),
            blur: config.blur.draw(&mut rng(Draw::Blur)),
            shake: config.shake.draw(&mut rng(Draw::Shake)),
            noise: config.noise.draw(&mut rng(Draw::Noise)),
        }
    }
}

impl Drift {
    fn draw(config: &CameraConfig, rng: &mut ChaCha8Rng) -> Self {
        Self { strength: config.drift.draw(rng), phases: rng.random() }
    }

    /// Factor and offset of each channel, from values of 0 to 1 to values of 0 to 255. The contrast is
    /// about the ground's mean.
    fn channels(&self, tick: Tick, mean: f32) -> [[f32; 2]; CHANNELS] {
        let k = tick.0 as f64 / 100.0;
        let wave = |size: f64, rate: f64, phase: f64| size * self.strength * (TAU * (rate * k + phase)).sin();
        let [bright, balance @ ..] = self.phases;
        let contrast = 1.0 + wave(1.0, 0.7, balance[0]);
        balance.map(|phase| {
            let gain = 255.0 * (1.0 + wave(1.0, 1.0, bright) + wave(0.4, 1.3, phase));
            [(gain * contrast) as f32, (gain * f64::from(mean) * (1.0 - contrast)) as f32]
        })
    }
}
