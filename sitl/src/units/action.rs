//! The two actions of the paper (Sec. IV-A1): motion A_s and transmit power A_p.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// The motion actions A_s (Sec. IV-A1), in the order of the policy's output neurons.
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

    /// The feasible action nearest to a relaxed one (Euclid; ties to the lowest index; Sec. IV-A1).
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
    ///
    /// # Errors
    /// The level is neither 1 nor 4.
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
