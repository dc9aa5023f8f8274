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
    look: OnceLock<Arc<FilmLook>>,
}

/// What is drawn once for a flight.
#[derive(Debug)]
struct FilmLook {
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

    fn look(&self) -> &FilmLook {
        self.look.get_or_init(|| Arc::new(FilmLook::draw(&self.config, &self.noise)))
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

impl FilmLook {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::cases::CASES;

    const TICK: Tick = Tick(7);

    fn poses() -> Poses {
        let body = |x, y, vx, vy, radius| Body {
            position: Vector2::new(x, y),
            velocity: Vector2::new(vx, vy),
            radius,
        };
        let obstacles = [body(0.7, 0.6, 0.0, 0.0125, 0.1)];
        Poses { uav: body(0.3, 0.4, 0.03, 0.0, 0.02), obstacles: obstacles.into() }
    }

    fn camera(toml: &str) -> CameraConfig {
        let config: CameraConfig = toml::from_str(toml).unwrap();
        assert_eq!(config.violation(), None, "{toml}");
        config
    }

    fn take(toml: &str, seed: u64, tick: Tick) -> Frame {
        Film::new(&camera(toml), seed).frame(tick, &poses())
    }

    /// Sum and centre, px, of how far `channel` is from that of `without`.
    fn moments(frame: &Frame, without: &Frame, channel: usize) -> (f64, Vector2<f64>) {
        let (mut sum, mut place) = (0.0, Vector2::zeros());
        for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
            let change = f64::from(frame.pixel(x, y)[channel]) - f64::from(without.pixel(x, y)[channel]);
            sum += change.abs();
            place += change.abs() * Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
        }
        (sum, place / sum)
    }

    #[test]
    fn equal_seeds_give_equal_bytes_whatever_was_taken_before() {
        for case in CASES {
            let config = case.config().unwrap();
            let [one, other] = [(); 2].map(|()| Film::new(&config, 5));
            let _ = one.frame(Tick(90), &poses());
            assert_eq!(one.frame(TICK, &poses()), other.frame(TICK, &poses()), "{}", case.name);
        }
    }

    #[test]
    fn each_effect_changes_the_picture() {
        let ground = "ground = { kind = \"procedural\" }\n";
        let plain = take(ground, 3, TICK);
        for effect in [
            "uav = [1.0, 1.0, 0.0]",
            "obstacle = [0.0, 1.0, 1.0]",
            "colours = \"family\"",
            "colours = \"any\"",
            "obstacle_scale = 0.8",
            "drift = 0.1",
            "shade = 0.3",
            "shadow = 0.4",
            "jpeg = 50",
            "blur = 0.5",
            "shake = 1.0",
            "noise = 2.0",
            "distractors = { count = 1 }",
            "edge_px = 2.0",
        ] {
            assert_ne!(take(&format!("{ground}{effect}"), 3, TICK), plain, "{effect}");
        }
        for key in ["contrast = 0.1", "mean = 0.5", "tint = 0.2", "edges = 20", "share = 0.0"] {
            let other = format!("ground = {{ kind = \"procedural\", {key} }}");
            assert_ne!(take(&other, 3, TICK), plain, "{key}");
        }
        assert_ne!(take(ground, 4, TICK), plain);
        assert_eq!(take(ground, 3, Tick(8)), plain, "the ground stands still");
    }

    #[test]
    fn what_drifts_shakes_and_flickers_is_another_in_each_frame() {
        for effect in ["drift = 0.2", "shake = 1.0", "noise = 2.0", "distractors = { count = 1 }"] {
            assert_ne!(take(effect, 3, Tick(8)), take(effect, 3, TICK), "{effect}");
        }
    }

    #[test]
    fn the_canvas_draws_the_clean_frame_to_a_rounding() {
        let clean = take("", 0, TICK);
        // Just off the default, so that it is painted on the canvas.
        let painted = take("obstacle_2 = [0.0, 0.9, 0.0]", 0, TICK);
        let far = clean.rgb().iter().zip(painted.rgb()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(far <= Some(1), "{far:?}");
    }

    #[test]
    fn blur_widens_a_body_along_its_way_and_keeps_centre_and_light() {
        let black = Frame::black();
        let (sharp, blurred) = (take("", 0, TICK), take("blur = 1.0", 0, TICK));
        let [(sum, centre), (sum_b, centre_b)] = [&sharp, &blurred].map(|frame| moments(frame, &black, 0));
        assert!((sum_b / sum - 1.0).abs() < 0.01 && (centre - centre_b).norm() < 0.05);
        let spread = |frame: &Frame, axis: usize| {
            let pixels = (0..SIDE * SIDE).map(|n| (n % SIDE, n / SIDE));
            let far = |(x, y): (usize, usize)| {
                let r = Vector2::new(x as f64 + 0.5, y as f64 + 0.5) - centre;
                r[axis].powi(2) * f64::from(frame.pixel(x, y)[0]) / sum
            };
            pixels.map(far).sum::<f64>()
        };
        // 3 px in an interval: places at -1.2, -0.6, 0, 0.6 and 1.2 px add a variance of 0.72.
        let wider = [0, 1].map(|axis| spread(&blurred, axis) - spread(&sharp, axis));
        assert!((wider[0] - 0.72).abs() < 0.1 && wider[1].abs() < 0.05, "{wider:?}");
    }

    #[test]
    fn a_shadow_falls_four_pixels_from_its_body_and_away_from_the_light() {
        let ground = "uav = [0.0, 0.0, 0.0]\nobstacle = [0.0, 0.0, 0.0]\n[ground]\nkind = \"procedural\"\ncontrast = 0.0\nmean = 0.8\n";
        let film = |toml: &str| Film::new(&camera(toml), 3);
        let far = Poses { uav: Body { position: Vector2::new(-1.0, -1.0), ..poses().uav }, ..poses() };
        let dark = film(&format!("shadow = 0.5\n{ground}"));
        let (with, without) = (dark.frame(TICK, &far), film(ground).frame(TICK, &far));
        // The shadow's part that the body hides has its centre elsewhere than the part that is seen.
        let (_, seen) = moments(&with, &without, 1);
        let away = seen - 100.0 * far.obstacles[0].position;
        assert!(away.norm() > 4.0, "{away}");
        assert!(away.normalize().dot(&dark.look().light) < -0.99, "{away}");
    }

    #[test]
    fn shading_is_brighter_towards_the_light() {
        let film = Film::new(&camera("obstacle = [0.0, 0.0, 0.5]\nshade = 0.3"), 3);
        let plain = Film::new(&camera("obstacle = [0.0, 0.0, 0.5]"), 3).frame(TICK, &poses());
        let frame = film.frame(TICK, &poses());
        let at = |side: f64| {
            let place = 100.0 * poses().obstacles[0].position + side * 7.0 * film.look().light;
            let [x, y] = [place.x, place.y].map(|p| p as usize);
            f64::from(frame.pixel(x, y)[2]) / f64::from(plain.pixel(x, y)[2]) - 1.0
        };
        // 7 of 12 px from the centre.
        assert!(
            (at(1.0) - 0.175).abs() < 0.03 && (at(-1.0) + 0.175).abs() < 0.03,
            "{} {}",
            at(1.0),
            at(-1.0)
        );
    }

    #[test]
    fn a_shaking_camera_moves_bodies_and_ground_together() {
        let toml = "uav = [1.0, 0.0, 0.0]\nshake = 2.0\nedge_px = 3.9";
        let film = Film::new(&camera(toml), 3);
        let shift = film.shake(TICK);
        assert!(shift.norm() > 0.1 && shift.amax() <= 4.0);
        let (_, centre) = moments(&film.frame(TICK, &poses()), &Frame::black(), 0);
        assert!((centre - Vector2::new(30.0, 40.0) - shift).norm() < 0.05, "{centre} {shift}");
        assert_ne!(film.shake(Tick(8)), shift);
    }

    #[test]
    fn noise_has_its_size() {
        let grey = "[ground]\nkind = \"procedural\"\ncontrast = 0.0\nmean = 0.5\ntint = 0.0\n";
        let (with, without) = (take(&format!("noise = 5.0\n{grey}"), 1, TICK), take(grey, 1, TICK));
        let pairs = with.rgb().iter().zip(without.rgb()).filter(|(_, plain)| (100..150).contains(*plain));
        let changes: Vec<f64> = pairs.map(|(a, b)| f64::from(*a) - f64::from(*b)).collect();
        let mean = changes.iter().sum::<f64>() / changes.len() as f64;
        let variance = changes.iter().map(|c| c * c).sum::<f64>() / changes.len() as f64;
        // Rounding adds a twelfth.
        assert!(mean.abs() < 0.6 && (variance - 25.0 - 1.0 / 12.0).abs() < 1.5, "{mean} {variance}");
    }

    #[test]
    fn drift_keeps_its_bounds() {
        let config = camera("drift = 0.2");
        let drift = Drift::draw(&config, &mut Noise::new(4).generator(Stream::Look, 0));
        for tick in 0..400 {
            for [factor, _] in drift.channels(Tick(tick), 0.0) {
                let factor = factor / 255.0;
                assert!((0.72 * 0.8..=1.28 * 1.2).contains(&factor), "{factor}");
            }
        }
    }

    #[test]
    fn distractors_reflect_and_stand_off_from_the_bodies_colours() {
        let film = Film::new(&camera("colours = \"family\"\ndistractors = { count = 5, speed = 9.0 }"), 3);
        let look = film.look();
        assert_eq!(look.distractors.len(), 5);
        for distractor in &look.distractors {
            for tick in 0..200 {
                let [now, next] = [tick, tick + 1].map(|k| distractor.at(Tick(k)));
                assert!(now.position.iter().all(|x| (4.0..=96.0).contains(x)));
                assert!((next.position - now.position).norm() <= 9.0 + 1e-9);
            }
            for body in [look.colours.uav, look.colours.obstacle] {
                let apart = distractor.colour.iter().zip(body).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
                assert!(apart.sqrt() > 0.5);
            }
        }
    }

    #[test]
    fn bodies_beyond_the_edge_are_cut_and_nothing_breaks() {
        let config = CameraConfig::case("harder").unwrap();
        for x in [-3.0, -0.05, 0.0, 0.5, 1.0, 1.08, 4.0] {
            for y in [-0.11, 0.0, 1.0, 2.0] {
                let mut poses = poses();
                poses.uav.position = Vector2::new(x, y);
                poses.obstacles[0].position = Vector2::new(y, x);
                let _ = Film::new(&config, 1).frame(TICK, &poses);
            }
        }
    }

    #[test]
    fn half_of_the_flights_have_an_effect_and_seven_in_ten_a_ground() {
        let config = CameraConfig::case("hard").unwrap();
        let looks: Vec<FilmLook> = (0..400).map(|seed| FilmLook::draw(&config, &Noise::new(seed))).collect();
        let share = |has: fn(&FilmLook) -> bool| looks.iter().filter(|look| has(look)).count() as f64 / 400.0;
        let halves =
            [share(|l| l.jpeg.is_some()), share(|l| l.blur > 0.0), share(|l| !l.distractors.is_empty())];
        assert!(halves.iter().all(|s| (s - 0.5).abs() < 0.08), "{halves:?}");
        assert!((share(|l| l.ground.is_some()) - 0.7).abs() < 0.08);
        assert!(looks.iter().all(|l| (0.8..=1.2).contains(&l.obstacle_scale)));
    }
}
