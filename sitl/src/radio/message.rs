//! What crosses the link, without bytes: commands down to the vehicle, percepts up to the station.
//!
//! Every number has the width that it has on the wire (f32, NED, SI units), so a flight in process
//! and a flight over UDP see the same values to the last bit.

use std::sync::Arc;

use crate::camera::Frame;
use crate::scenario::Scenario;
use crate::units::{Scale, Tick, TxPower};
use crate::world::contact::Contact;
use crate::world::obstacles::{Obstacles, PerObstacle};

/// What the station asks of the vehicle and of its own transmitter for one control interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// The interval for which it was computed.
    pub tick: Tick,
    /// Acceleration north, east, m/s².
    pub accel: [f32; 2],
    /// Transmit power of the base station.
    pub power: TxPower,
}

impl Command {
    /// The vehicle flies `accel`, m/s², from interval `tick` on, until a newer command gets through.
    #[must_use]
    pub fn new(tick: Tick, accel: [f32; 2], power: TxPower) -> Self {
        Self { tick, accel, power }
    }
}

/// The command that the vehicle is flying.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Held {
    /// Tick of that command.
    pub tick: Tick,
    /// Its acceleration north, east, m/s², as it was sent.
    pub accel: [f32; 2],
}

/// What the radio measured in the interval that just ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkReport {
    /// Received SNR γ, dB.
    pub snr_db: f32,
    /// Transmit power in that interval.
    pub power: TxPower,
    /// Whether the rate was too low for a packet, R Δt < L.
    pub outage: bool,
}

/// The vehicle's own report: what a reactive controller may see, and what the metrics are made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Telemetry {
    /// The tick that begins now.
    pub tick: Tick,
    /// North, east, m.
    pub position: [f32; 2],
    /// North, east, m/s.
    pub velocity: [f32; 2],
    /// Each obstacle's north, east, m.
    pub obstacles: PerObstacle<[f32; 2]>,
    /// What the vehicle flew in the interval that just ended; `None` before the first delivery.
    pub held: Option<Held>,
    /// The radio in the interval that just ended; `None` at tick 0.
    pub link: Option<LinkReport>,
}

impl Telemetry {
    /// Where the obstacles are, paper units.
    #[must_use]
    pub fn obstacles(&self, scale: &Scale) -> Obstacles {
        self.obstacles.iter().map(|place| scale.paper_from_ned(*place)).collect()
    }

    /// What the UAV touched between this report and a later one. Vehicle and station compute it from the
    /// same reports, so they agree.
    #[must_use]
    pub fn contact(&self, after: &Self, scenario: &Scenario) -> Contact {
        let scale = &scenario.scale;
        let place = |report: &Self| scale.paper_from_ned(report.position);
        Contact::between(
            (place(self), &self.obstacles(scale)),
            (place(after), &after.obstacles(scale)),
            scenario,
        )
    }
}

/// Numbers in a latent vector.
pub const NUMBERS: usize = 16;

/// A latent vector and how far off it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SentLatent {
    /// z.
    pub z: [f32; NUMBERS],
    /// Standard deviation in units of the encoder's noise on a clean frame.
    pub sigma_scale: f32,
    /// What quantising adds to each number: its largest error.
    pub half_step: f32,
}

/// The latents of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SentLatents {
    /// Of the frame.
    pub tick: Tick,
    /// z_c, then z_u of each obstacle.
    pub vectors: Vec<SentLatent>,
}

/// Everything that the vehicle sends at the start of a control interval.
#[derive(Debug, Clone, PartialEq)]
pub struct Percept {
    /// The numbers.
    pub telemetry: Telemetry,
    /// The frame; black where it was encoded on board.
    pub frame: Arc<Frame>,
    /// What the encoder made of the frame on board, if it was sent in place of it.
    pub latents: Option<Arc<SentLatents>>,
}
