//! Numbers in the four bytes of PARAM_VALUE and PARAM_SET.

use std::fmt;

/// How an integer sits in the float field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// As the float of the same value (ArduPilot, `sitl`).
    CCast,
    /// As its own bytes (PX4).
    Bytewise,
}

/// MAV_PARAM_TYPE, those that fit four bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A whole number of this many bits, signed or not.
    Int {
        /// 8, 16 or 32.
        bits: u8,
        /// Whether it may be below zero.
        signed: bool,
    },
    /// MAV_PARAM_TYPE_REAL32.
    Real,
}

impl Kind {
    /// Of MAV_PARAM_TYPE; an unknown type is read as a float.
    #[must_use]
    pub fn of(param_type: u8) -> Self {
        match param_type {
            1..=6 => {
                let bits = [8, 8, 16, 16, 32, 32][usize::from(param_type - 1)];
                Self::Int { bits, signed: param_type.is_multiple_of(2) }
            }
            _ => Self::Real,
        }
    }

    /// MAV_PARAM_TYPE.
    #[must_use]
    pub fn code(self) -> u8 {
        match self {
            Self::Int { bits, signed } => bits.ilog2() as u8 * 2 - 5 + u8::from(signed),
            Self::Real => 9,
        }
    }

    fn range(self) -> (i64, i64) {
        match self {
            Self::Int { bits, signed: true } => (-(1 << (bits - 1)), (1 << (bits - 1)) - 1),
            Self::Int { bits, signed: false } => (0, (1 << bits) - 1),
            Self::Real => (i64::MIN, i64::MAX),
        }
    }
}

/// A parameter's value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Number {
    /// Of an integer parameter.
    Int(i64),
    /// Of a float parameter.
    Real(f32),
}

impl fmt::Display for Number {
    /// The shortest digits that give the same value back.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Int(value) => value.fmt(f),
            Self::Real(value) => value.fmt(f),
        }
    }
}

/// No value for this parameter.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoNumber {
    /// Not a number, or not a finite one.
    #[error("`{0}` is no number")]
    Text(String),
    /// A fraction where only whole numbers go.
    #[error("{0} is no whole number")]
    Fraction(String),
    /// Too small or too large for the parameter's type.
    #[error("{value} is outside {least} to {most}")]
    Range {
        /// Value.
        value: String,
        /// Least value of the type.
        least: i64,
        /// Greatest value of the type.
        most: i64,
    },
    /// As a float, the link would carry another integer.
    #[error("{value} cannot cross the link as a float: the next that can is {nearest}")]
    Precision {
        /// Value.
        value: i64,
        /// What a float makes of it.
        nearest: i64,
    },
}

impl Number {
    /// Its value as a float, the width of a cast parameter.
    #[must_use]
    pub fn as_f32(self) -> f32 {
        match self {
            Self::Int(value) => value as f32,
            Self::Real(value) => value,
        }
    }

    /// What a person wrote, for a parameter of this kind. `3.0` is a whole number.
    ///
    /// # Errors
    /// The text is no finite number, or has a fraction or lies outside the range of a whole-numbered kind.
    pub fn parse(text: &str, kind: Kind) -> Result<Self, NoNumber> {
        let number = || NoNumber::Text(text.into());
        let real: f64 = text.trim().parse().map_err(|_| number())?;
        if !real.is_finite() {
            return Err(number());
        }
        if kind == Kind::Real {
            let value = real as f32;
            return if value.is_finite() { Ok(Self::Real(value)) } else { Err(number()) };
        }
        if real.fract() != 0.0 {
            return Err(NoNumber::Fraction(text.into()));
        }
        let (least, most) = kind.range();
        if real < least as f64 || real > most as f64 {
            return Err(NoNumber::Range { value: text.into(), least, most });
        }
        Ok(Self::Int(real as i64))
    }

    /// The value in the field's bytes.
    #[must_use]
    pub fn decode(bytes: [u8; 4], kind: Kind, encoding: Encoding) -> Self {
        let [low, ..] = bytes;
        let wide = u32::from_le_bytes(bytes);
        match (kind, encoding) {
            (Kind::Real, _) => Self::Real(f32::from_le_bytes(bytes)),
            (Kind::Int { .. }, Encoding::CCast) => {
                Self::Int(f64::from(f32::from_le_bytes(bytes)).round() as i64)
            }
            (Kind::Int { bits: 8, signed }, _) => {
                Self::Int(if signed { (low as i8).into() } else { low.into() })
            }
            (Kind::Int { bits: 16, signed }, _) => {
                Self::Int(if signed { (wide as i16).into() } else { (wide as u16).into() })
            }
            (Kind::Int { signed, .. }, _) => {
                Self::Int(if signed { (wide as i32).into() } else { wide.into() })
            }
        }
    }

    /// The field's bytes.
    ///
    /// # Errors
    /// The encoding is a float, which cannot carry this whole number exactly.
    pub fn encode(self, encoding: Encoding) -> Result<[u8; 4], NoNumber> {
        match (self, encoding) {
            (Self::Real(value), _) => Ok(value.to_le_bytes()),
            (Self::Int(value), Encoding::Bytewise) => Ok((value as u32).to_le_bytes()),
            (Self::Int(value), Encoding::CCast) => {
                let nearest = value as f32 as i64;
                if nearest == value {
                    Ok((value as f32).to_le_bytes())
                } else {
                    Err(NoNumber::Precision { value, nearest })
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn kinds_are_the_standard_s() {
        for (code, kind) in [
            (1, Kind::Int { bits: 8, signed: false }),
            (2, Kind::Int { bits: 8, signed: true }),
            (3, Kind::Int { bits: 16, signed: false }),
            (6, Kind::Int { bits: 32, signed: true }),
            (9, Kind::Real),
        ] {
            assert_eq!((Kind::of(code), kind.code()), (kind, code));
        }
    }

    #[test]
    fn what_people_write_is_read_or_refused_in_words() {
        let byte = Kind::Int { bits: 8, signed: false };
        assert_eq!(Number::parse("3", byte), Ok(Number::Int(3)));
        assert_eq!(Number::parse("3.0", byte), Ok(Number::Int(3)));
        assert_eq!(Number::parse("0.1", Kind::Real), Ok(Number::Real(0.1)));
        for (text, kind, why) in [
            ("x", byte, "`x` is no number"),
            ("nan", Kind::Real, "`nan` is no number"),
            ("1e39", Kind::Real, "`1e39` is no number"),
            ("0.5", byte, "0.5 is no whole number"),
            ("256", byte, "256 is outside 0 to 255"),
            ("-1", byte, "-1 is outside 0 to 255"),
        ] {
            assert_eq!(Number::parse(text, kind).unwrap_err().to_string(), why);
        }
        let error = Number::Int(16_777_217).encode(Encoding::CCast).unwrap_err().to_string();
        assert!(error.ends_with("the next that can is 16777216"), "{error}");
        assert_eq!(Number::Real(0.1).to_string(), "0.1");
        assert_eq!(Number::Real(3.0).to_string(), "3");
    }

    proptest! {
        #[test]
        fn every_value_crosses_bytewise(code in 1u8..=6, seed in any::<i64>()) {
            let kind = Kind::of(code);
            let (least, most) = kind.range();
            let value = Number::Int(least + seed.rem_euclid(most - least + 1));
            let bytes = value.encode(Encoding::Bytewise).unwrap();
            prop_assert_eq!(Number::decode(bytes, kind, Encoding::Bytewise), value);
        }

        #[test]
        fn whole_floats_cross_as_floats(value in -16_777_216i64..=16_777_216) {
            let bytes = Number::Int(value).encode(Encoding::CCast).unwrap();
            let kind = Kind::Int { bits: 32, signed: true };
            prop_assert_eq!(Number::decode(bytes, kind, Encoding::CCast), Number::Int(value));
        }
    }
}
