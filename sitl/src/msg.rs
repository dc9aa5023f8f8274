//! What crosses the link, without bytes: commands down to the vehicle, percepts up to the station.
//!
//! Every number has the width that it has on the wire (f32, NED, SI units), so a flight in process
//! and a flight over UDP see the same values to the last bit.

use std::sync::Arc;

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::camera::Frame;
use crate::units::{Scale, Tick};
use crate::world::obstacles::Obstacles;

/// The paper's motion actions A_s, in the order of the policy's output neurons.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Motion {
    /// (0, 0)
    Coast,
    /// (1, 0), paper x
    East,
    /// (-1, 0)
    West,
    /// (0, 1), paper y
    North,
    /// (0, -1)
    South,
}

impl Motion {
    /// A_s in the paper's order.
    pub const ALL: [Self; 5] = [Self::Coast, Self::East, Self::West, Self::North, Self::South];

    /// The normalised acceleration a_s, paper x/y.
    #[must_use]
    pub fn vector(self) -> Vector2<f64> {
        match self {
            Self::Coast => Vector2::new(0.0, 0.0),
            Self::East => Vector2::new(1.0, 0.0),
            Self::West => Vector2::new(-1.0, 0.0),
            Self::North => Vector2::new(0.0, 1.0),
            Self::South => Vector2::new(0.0, -1.0),
        }
    }

    /// The feasible action nearest to a relaxed one (Euclid; ties to the lowest index; Sec. IV-A).
    #[must_use]
    pub fn nearest(wish: Vector2<f64>) -> Self {
        let mut best = Self::Coast;
        for action in Self::ALL {
            if (wish - action.vector()).norm_squared() < (wish - best.vector()).norm_squared() {
                best = action;
            }
        }
        best
    }
}

/// The base station's transmit power a_p ∈ A_p = {1, 4}, in units of the paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum TxPower {
    /// a_p = 1
    #[default]
    Low,
    /// a_p = 4
    High,
}

/// A transmit power outside A_p.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("transmit power {0} is neither 1 nor 4")]
pub struct NoSuchPower(pub f32);

impl TxPower {
    /// A_p in the paper's order.
    pub const ALL: [Self; 2] = [Self::Low, Self::High];

    /// a_p.
    #[must_use]
    pub fn level(self) -> f64 {
        match self {
            Self::Low => 1.0,
            Self::High => 4.0,
        }
    }

    /// The power with this level, which must be 1 or 4.
    pub fn from_level(level: f32) -> Result<Self, NoSuchPower> {
        Self::ALL.into_iter().find(|p| p.level() == f64::from(level)).ok_or(NoSuchPower(level))
    }
}

impl TryFrom<u8> for TxPower {
    type Error = NoSuchPower;
    fn try_from(level: u8) -> Result<Self, NoSuchPower> {
        Self::from_level(f32::from(level))
    }
}

impl From<TxPower> for u8 {
    fn from(power: TxPower) -> Self {
        power.level() as Self
    }
}

/// What the station asks of the vehicle and of its own transmitter for one control interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// The interval for which it was computed.
    pub tick: Tick,
    /// Acceleration north, east, m/s².
    pub accel: [f32; 2],
    /// Transmit power of the base station.
    pub power: TxPower,
    /// What to fly in the intervals after it if no newer packet gets through.
    pub plan: Plan,
}

impl Command {
    /// A command without a plan: in an outage the vehicle holds it.
    #[must_use]
    pub fn new(tick: Tick, accel: [f32; 2], power: TxPower) -> Self {
        Self { tick, accel, power, plan: Plan::default() }
    }

    /// The acceleration for interval `now`: the command's own, then its plan's, whose last one holds.
    #[must_use]
    pub fn accel_at(&self, now: Tick) -> [f32; 2] {
        let later = usize::try_from(now.0.saturating_sub(self.tick.0)).unwrap_or(usize::MAX);
        let planned = self.plan.accelerations();
        match later.min(planned.len()) {
            0 => self.accel,
            n => planned[n - 1],
        }
    }

    /// This command, and after its own plan what an `older` one had planned for later intervals.
    #[must_use]
    pub fn over(mut self, older: &Self) -> Self {
        let known = (self.tick.0 - older.tick.0.min(self.tick.0)) as usize + self.plan.length;
        for accel in older.plan.accelerations().iter().skip(known) {
            self.plan.push(*accel);
        }
        self
    }
}

/// Accelerations north, east, m/s², for the intervals after a command's own, at most
/// [`Plan::MOST`] (packetised predictive control).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Plan {
    accel: [[f32; 2]; Self::MOST],
    length: usize,
}

impl Plan {
    /// Actions that a plan holds at most: with the command's own ten, 4 s of flight.
    pub const MOST: usize = 9;

    /// Appends the acceleration of the next interval; a full plan stays as it is.
    pub fn push(&mut self, accel: [f32; 2]) {
        if let Some(slot) = self.accel.get_mut(self.length) {
            *slot = accel;
            self.length += 1;
        }
    }

    /// One a later interval.
    #[must_use]
    pub fn accelerations(&self) -> &[[f32; 2]] {
        &self.accel[..self.length]
    }
}

/// The command that the vehicle is flying.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Held {
    /// Tick of that command.
    pub tick: Tick,
    /// Acceleration north, east, m/s², that it had for the interval, as it was sent.
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
    /// Obstacle's north, east, m.
    pub obstacle: [f32; 2],
    /// The second one's, in a scenario that has one.
    pub second_obstacle: Option<[f32; 2]>,
    /// What the vehicle flew in the interval that just ended; `None` before the first delivery.
    pub held: Option<Held>,
    /// The radio in the interval that just ended; `None` at tick 0.
    pub link: Option<LinkReport>,
}

impl Telemetry {
    /// Where the obstacles are, paper units.
    #[must_use]
    pub fn obstacles(&self, scale: &Scale) -> Obstacles {
        Obstacles {
            first: scale.paper_from_ned(self.obstacle),
            second: self.second_obstacle.map(|place| scale.paper_from_ned(place)),
        }
    }
}

/// Everything that the vehicle sends at the start of a control interval.
#[derive(Debug, Clone, PartialEq)]
pub struct Percept {
    /// The numbers.
    pub telemetry: Telemetry,
    /// The picture.
    pub frame: Arc<Frame>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ties_go_to_the_lowest_index() {
        assert_eq!(Motion::nearest(Vector2::new(0.5, 0.0)), Motion::Coast);
        assert_eq!(Motion::nearest(Vector2::new(0.7, 0.7)), Motion::East);
        assert_eq!(Motion::nearest(Vector2::new(-0.2, -0.9)), Motion::South);
    }

    #[test]
    fn only_one_and_four_are_powers() {
        assert_eq!(TxPower::from_level(4.0), Ok(TxPower::High));
        assert_eq!(TxPower::from_level(2.0).unwrap_err().to_string(), "transmit power 2 is neither 1 nor 4");
        assert!(TxPower::from_level(f32::NAN).is_err());
    }
}
