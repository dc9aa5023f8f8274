//! Where the vehicle looks. Only body frames and what is told of it depend on it: the camera looks down, with
//! north where the picture says, and every way is flown without a turn.

use std::f64::consts::{PI, TAU};

/// How fast it turns, rad/s, unless it is asked to turn otherwise.
const TURN: f64 = PI / 2.0;
/// The fastest turn, rad/s.
const MAX_TURN: f64 = TAU;

/// Yaw and what becomes of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Heading {
    /// rad, clockwise from north, in [0, 2π).
    pub yaw: f64,
    turn: Turn,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Turn {
    None,
    /// To a yaw, at so many rad/s.
    To(f64, f64),
    /// So fast, rad/s, for ever.
    Rate(f64),
}

impl Heading {
    /// At rest.
    pub fn at(yaw: f64) -> Self {
        Self { yaw: yaw.rem_euclid(TAU), turn: Turn::None }
    }

    /// Turns to a yaw, rad, the shorter way round; at `rate` rad/s if that is above 0.
    pub fn turn_to(&mut self, yaw: f64, rate: f64) {
        let rate = if rate > 0.0 { rate.min(MAX_TURN) } else { TURN };
        self.turn = if yaw.is_finite() { Turn::To(yaw.rem_euclid(TAU), rate) } else { Turn::None };
    }

    /// Turns on and on, rad/s.
    pub fn turn_at(&mut self, rate: f64) {
        self.turn = Turn::Rate(rate.clamp(-MAX_TURN, MAX_TURN));
    }

    /// Stays as it is.
    pub fn stay(&mut self) {
        self.turn = Turn::None;
    }

    /// rad/s, clockwise: that of a turn under way.
    pub fn rate(&self) -> f64 {
        match self.turn {
            Turn::None => 0.0,
            Turn::To(yaw, rate) => rate * signum(shorter(yaw - self.yaw)),
            Turn::Rate(rate) => rate,
        }
    }

    /// An interval of so many seconds passes.
    pub fn step(&mut self, seconds: f64) {
        let change = match self.turn {
            Turn::None => return,
            Turn::To(yaw, rate) => shorter(yaw - self.yaw).clamp(-rate * seconds, rate * seconds),
            Turn::Rate(rate) => rate * seconds,
        };
        self.yaw = (self.yaw + change).rem_euclid(TAU);
        if let Turn::To(yaw, _) = self.turn
            && shorter(yaw - self.yaw).abs() < 1e-9
        {
            *self = Self::at(yaw);
        }
    }

    /// Forward and right as north and east.
    pub fn north_east(&self, [forward, right]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw.sin_cos();
        [forward * cos - right * sin, forward * sin + right * cos]
    }

    /// North and east as forward and right.
    pub fn forward_right(&self, [north, east]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw.sin_cos();
        [north * cos + east * sin, east * cos - north * sin]
    }

    /// Degrees in [0, 360).
    pub fn degrees(&self) -> f64 {
        self.yaw.to_degrees()
    }
}

/// An angle within half a turn, rad.
fn shorter(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

fn signum(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_turns_the_shorter_way_and_stops_there() {
        let mut heading = Heading::at(0.1);
        heading.turn_to(-0.3, 0.0);
        assert!(heading.rate() < 0.0);
        for _ in 0..3 {
            heading.step(0.4);
        }
        assert_eq!(heading, Heading::at(-0.3));
        heading.turn_at(f64::INFINITY);
        heading.step(0.4);
        assert!(heading.yaw.is_finite());
        heading.turn_to(f64::NAN, 1.0);
        assert_eq!(heading.rate(), 0.0);
    }

    #[test]
    fn forward_is_where_it_looks_and_back_again() {
        let east = Heading::at(PI / 2.0);
        let [north, right] = east.north_east([3.0, 1.0]);
        assert!((north + 1.0).abs() < 1e-12 && (right - 3.0).abs() < 1e-12, "{north} {right}");
        let back = east.forward_right([north, right]);
        assert!((back[0] - 3.0).abs() < 1e-12 && (back[1] - 1.0).abs() < 1e-12);
    }
}
