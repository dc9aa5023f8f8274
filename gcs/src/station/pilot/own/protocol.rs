//! The lines of `exec:` controllers, version 1: docs/own-controller.md describes them.
//!
//! Lengths are in the paper's units (the side of the square is 1), speeds in units per control interval.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use crpl_sitl::camera::Frame;
use crpl_sitl::link::image::png_from_frame;
use crpl_sitl::radio::message::{Held, LinkReport};
use crpl_sitl::units::{Motion, Tick, TxPower};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::station::belief::Latents;
use crate::station::pilot::reactive::{Present, Task};
use crate::station::seen::{Heard, MotionLimits, RadioConstants};

/// Version of the lines.
pub const VERSION: u32 = 1;

/// How a program wants the pictures.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PictureFormat {
    /// Not at all.
    #[default]
    None,
    /// A PNG of 100x100 pixels, base64.
    Png,
    /// 100 rows of 100 pixels of 3 bytes, base64.
    Rgb,
}

/// The first line to the program. What it says is what the other controllers are told before a flight.
#[derive(Debug, Clone, Serialize)]
#[serde(tag = "type", rename = "hello")]
pub struct Hello {
    version: u32,
    program: String,
    /// `percept` or `truth`.
    sees: &'static str,
    /// Control intervals of a flight.
    horizon: u64,
    /// Seconds of a control interval.
    interval_s: f64,
    /// Metres of one unit.
    metres_per_unit: f64,
    goal: Vector2<f64>,
    goal_radius: f64,
    v_max: f64,
    a_max: f64,
    uav_radius: f64,
    obstacle_radii: Vec<f64>,
    /// Clearance at which the collision probability is one half.
    d_min: f64,
    b_dt: f64,
    packet_bits: f64,
    noise_power: f64,
    snr_min: f64,
    powers: [f64; 2],
    /// Latent units per unit of length.
    latent_scale: f64,
    /// The whole scenario; for who sees the truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    scenario: Option<Scenario>,
}

impl Hello {
    /// That of a scenario.
    #[must_use]
    pub fn of(scenario: &Scenario, world: &WorldModel, sees_truth: bool) -> Self {
        let (limits, radio, task) =
            (MotionLimits::of(scenario), RadioConstants::of(scenario), Task::of(scenario));
        Self {
            version: VERSION,
            program: format!("gcs {}", env!("CARGO_PKG_VERSION")),
            sees: if sees_truth { "truth" } else { "percept" },
            horizon: scenario.horizon,
            interval_s: scenario.scale.interval_s,
            metres_per_unit: scenario.scale.metres_per_unit,
            goal: task.goal,
            goal_radius: scenario.goal_radius,
            v_max: limits.v_max,
            a_max: limits.a_max,
            uav_radius: task.uav_radius,
            obstacle_radii: task.obstacle_radii,
            d_min: task.safety.d_min,
            b_dt: radio.b_dt,
            packet_bits: radio.packet_bits,
            noise_power: radio.noise_power,
            snr_min: radio.snr_min,
            powers: TxPower::ALL.map(TxPower::level),
            latent_scale: world.scale,
            scenario: sees_truth.then(|| scenario.clone()),
        }
    }
}

/// The answer to [`Hello`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HelloAnswer {
    /// The version that the program speaks.
    pub version: u32,
    /// How it wants the pictures.
    #[serde(default)]
    pub picture: PictureFormat,
}

/// A flight begins; there is no answer to it.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(tag = "type", rename = "reset")]
pub struct Reset {
    /// How many flights this process has begun, from 1 on.
    pub flight: u64,
}

/// A control interval begins.
#[derive(Debug, Clone, Serialize)]
#[serde(tag = "type", rename = "percept")]
pub struct PerceptLine {
    tick: Tick,
    latents: LatentsLine,
    belief: BeliefLine,
    /// The last action that the vehicle says it flew.
    held: Option<HeldLine>,
    /// The radio in the interval that just ended.
    link: Option<LinkLine>,
    #[serde(skip_serializing_if = "Option::is_none")]
    picture: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    state: Option<StateLine>,
}

#[derive(Debug, Clone, Serialize)]
struct LatentsLine {
    y_c: [f32; 2],
    y_c_before: [f32; 2],
    y_u: Vec<[f32; 2]>,
}

/// The latents, decoded by the world model's probe.
#[derive(Debug, Clone, Serialize)]
struct BeliefLine {
    position: Vector2<f64>,
    velocity: Vector2<f64>,
    obstacles: Vec<Vector2<f64>>,
}

#[derive(Debug, Clone, Serialize)]
struct HeldLine {
    tick: Tick,
    action: Vector2<f64>,
}

#[derive(Debug, Clone, Serialize)]
struct LinkLine {
    snr_db: f32,
    power: TxPower,
    outage: bool,
}

/// The true state.
#[derive(Debug, Clone, Serialize)]
struct StateLine {
    position: Vector2<f64>,
    velocity: Vector2<f64>,
    obstacles: Vec<Vector2<f64>>,
}

/// What is put into a line: all that [`PerceptLine`] is made of.
#[derive(Debug)]
pub struct OwnSight<'a> {
    /// What was heard of the vehicle.
    pub heard: Heard,
    /// What the encoder makes of the frames.
    pub latents: Latents,
    /// The newest frame.
    pub frame: Option<&'a Frame>,
    /// The true state, for who may see it.
    pub truth: Option<Present>,
}

impl PerceptLine {
    /// The line of an interval. `action` gives a held command's normalised acceleration.
    #[must_use]
    pub fn of(
        seen: &OwnSight<'_>,
        world: &WorldModel,
        picture: PictureFormat,
        action: impl Fn(Held) -> Vector2<f64>,
    ) -> Self {
        let OwnSight { heard, latents, frame, truth } = seen;
        let decoded = |y: [f32; 2]| world.probe.c.apply(Vector2::new(y[0].into(), y[1].into()));
        let obstacle = |y: &[f32; 2]| world.probe.u.apply(Vector2::new(y[0].into(), y[1].into()));
        let position = decoded(latents.y_c);
        Self {
            tick: heard.tick,
            latents: LatentsLine {
                y_c: latents.y_c,
                y_c_before: latents.y_c_before,
                y_u: latents.y_u.iter().copied().collect(),
            },
            belief: BeliefLine {
                position,
                velocity: position - decoded(latents.y_c_before),
                obstacles: latents.y_u.iter().map(obstacle).collect(),
            },
            held: heard.held.map(|held| HeldLine { tick: held.tick, action: action(held) }),
            link: heard.link.map(|LinkReport { snr_db, power, outage }| LinkLine { snr_db, power, outage }),
            picture: frame.and_then(|frame| encoded(frame, heard.tick, picture)),
            state: truth.as_ref().map(|now| StateLine {
                position: now.r,
                velocity: now.v,
                obstacles: now.obstacles.iter().copied().collect(),
            }),
        }
    }
}

fn encoded(frame: &Frame, tick: Tick, format: PictureFormat) -> Option<String> {
    match format {
        PictureFormat::None => None,
        PictureFormat::Rgb => Some(STANDARD.encode(frame.rgb())),
        // A frame of 100x100 bytes in memory has no reason to fail; without it the line says nothing of a picture.
        PictureFormat::Png => png_from_frame(frame, tick).ok().map(|png| STANDARD.encode(png)),
    }
}

/// The answer to a percept.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answer {
    /// The interval for which it is.
    pub tick: u64,
    wish: [f64; 2],
    power: f64,
}

/// Why a line is no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AnswerError {
    /// Not the JSON that is expected.
    #[error("{0}")]
    Json(String),
    /// Infinite, or no number.
    #[error("wish {0:?} is not finite")]
    Wish([f64; 2]),
    /// Neither 1 nor 4.
    #[error("transmit power {0} is neither 1 nor 4")]
    Power(f64),
}

impl Answer {
    /// Reads a line.
    ///
    /// # Errors
    /// It is no answer.
    pub fn parse(line: &str) -> Result<Self, AnswerError> {
        let answer: Self =
            serde_json::from_str(line).map_err(|error| AnswerError::Json(error.to_string()))?;
        if !answer.wish.iter().all(|part| part.is_finite()) {
            return Err(AnswerError::Wish(answer.wish));
        }
        TxPower::from_level(answer.power as f32).map_err(|_| AnswerError::Power(answer.power))?;
        Ok(answer)
    }

    /// The motion nearest to the wish, and the power.
    #[must_use]
    pub fn decision(&self) -> (Motion, TxPower) {
        let power = TxPower::from_level(self.power as f32).unwrap_or_default();
        (Motion::nearest(Vector2::from(self.wish)), power)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_the_nearest_motion_and_a_power() {
        let answer = Answer::parse(r#"{"tick": 3, "wish": [0.2, -0.9], "power": 4}"#).unwrap();
        assert_eq!((answer.tick, answer.decision()), (3, (Motion::South, TxPower::High)));
    }

    #[test]
    fn what_is_no_answer_says_why() {
        let error = |line: &str| Answer::parse(line).unwrap_err().to_string();
        assert!(error("hello").contains("expected value"));
        assert!(error(r#"{"tick":0,"wish":[1,0]}"#).contains("missing field `power`"));
        assert!(error(r#"{"tick":0,"wish":[1,0],"power":1,"x":2}"#).contains("unknown field `x`"));
        assert_eq!(error(r#"{"tick":0,"wish":[1,0],"power":2}"#), "transmit power 2 is neither 1 nor 4");
        assert!(Answer::parse(r#"{"tick":0,"wish":[1e999,0],"power":1}"#).is_err());
    }
}
