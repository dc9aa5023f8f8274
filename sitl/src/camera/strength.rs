//! The strength of an effect: a number, or a range from which each flight draws.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::de::value::MapAccessDeserializer;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A number, or a range from which each flight draws its own number, uniformly.
///
/// In a file `noise = 5.0`, or `noise = { low = 0.0, high = 5.0, share = 0.5 }`: half of the flights have
/// noise, of up to 5.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strength {
    /// Least value.
    pub low: f64,
    /// Greatest value.
    pub high: f64,
    /// Share of the flights that have the effect, 0 to 1; the others have the value 0.
    pub share: f64,
}

impl Strength {
    /// The same in each flight.
    #[must_use]
    pub const fn fixed(value: f64) -> Self {
        Self { low: value, high: value, share: 1.0 }
    }

    /// Drawn for each flight, uniformly.
    #[must_use]
    pub const fn between(low: f64, high: f64) -> Self {
        Self { low, high, share: 1.0 }
    }

    /// The value of one flight, or 0 where it does not have the effect. Takes two numbers from `rng`.
    pub(super) fn draw(self, rng: &mut ChaCha8Rng) -> f64 {
        let [chance, place]: [f64; 2] = rng.random();
        if chance < self.share { self.low + place * (self.high - self.low) } else { 0.0 }
    }

    /// The same in whole numbers, `high` included.
    pub(super) fn draw_whole(self, rng: &mut ChaCha8Rng) -> u32 {
        let wide = Self { high: self.high.floor() + 1.0, low: self.low.ceil(), ..self };
        (wide.draw(rng).floor() as u32).min(self.high as u32)
    }

    /// What is wrong with it: the value, and what it must be.
    pub(super) fn violation(self, least: f64, most: f64) -> Option<(f64, String)> {
        let within = |value: f64, least: f64, most: f64| {
            (!(least..=most).contains(&value)).then(|| (value, format!("must lie in [{least}, {most}]")))
        };
        within(self.low, least, most)
            .or_else(|| within(self.high, least, most))
            .or_else(|| within(self.share, 0.0, 1.0))
            .or_else(|| {
                let partial = least > 0.0 && self.share < 1.0;
                partial.then(|| (self.share, "must be in all flights: its `share` must be 1".into()))
            })
            .or_else(|| (self.low > self.high).then(|| (self.low, "must be at most its `high`".into())))
    }
}

/// A [`Strength`] as a table of a file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Spread {
    low: f64,
    high: f64,
    #[serde(default = "always")]
    share: f64,
}

fn always() -> f64 {
    1.0
}

impl Serialize for Strength {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if *self == Self::fixed(self.low) {
            return serializer.serialize_f64(self.low);
        }
        Spread { low: self.low, high: self.high, share: self.share }.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Strength {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Visitor)
    }
}

struct Visitor;

impl<'de> serde::de::Visitor<'de> for Visitor {
    type Value = Strength;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a number, or { low = NUMBER, high = NUMBER, share = NUMBER }")
    }

    fn visit_f64<E>(self, value: f64) -> Result<Strength, E> {
        Ok(Strength::fixed(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Strength, E> {
        Ok(Strength::fixed(value as f64))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Strength, E> {
        Ok(Strength::fixed(value as f64))
    }

    fn visit_map<A: serde::de::MapAccess<'de>>(self, map: A) -> Result<Strength, A::Error> {
        let Spread { low, high, share } = Spread::deserialize(MapAccessDeserializer::new(map))?;
        Ok(Strength { low, high, share })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct File {
        noise: Strength,
    }

    #[test]
    fn a_strength_is_read_as_number_or_range_and_written_as_it_was_read() {
        let half = Strength { low: 0.0, high: 5.0, share: 0.5 };
        for (text, noise) in [
            ("noise = 2.5", Strength::fixed(2.5)),
            ("noise = 2", Strength::fixed(2.0)),
            ("noise = { low = 1, high = 2 }", Strength::between(1.0, 2.0)),
            ("noise = { low = 0, high = 5, share = 0.5 }", half),
        ] {
            let file: File = toml::from_str(text).unwrap();
            assert_eq!(file, File { noise });
            assert_eq!(toml::from_str::<File>(&toml::to_string(&file).unwrap()).unwrap(), file);
        }
        let error = toml::from_str::<File>("noise = { low = 0, hihg = 5 }").unwrap_err().to_string();
        assert!(error.contains("hihg"), "{error}");
        let error = toml::from_str::<File>("noise = \"much\"").unwrap_err().to_string();
        assert!(error.contains("a number, or { low"), "{error}");
    }

    #[test]
    fn draws_keep_to_range_and_share() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let strength = Strength { low: 2.0, high: 4.0, share: 0.5 };
        let draws: Vec<f64> = (0..4000).map(|_| strength.draw(&mut rng)).collect();
        let on: Vec<f64> = draws.into_iter().filter(|&v| v != 0.0).collect();
        assert!((on.len() as f64 / 4000.0 - 0.5).abs() < 0.03, "{}", on.len());
        assert!(on.iter().all(|v| (2.0..=4.0).contains(v)));
        let whole = Strength::between(1.0, 2.0);
        let ones = (0..4000).filter(|_| whole.draw_whole(&mut rng) == 1).count();
        assert!((ones as f64 / 4000.0 - 0.5).abs() < 0.03, "{ones}");
        assert_eq!(Strength::fixed(50.0).draw_whole(&mut rng), 50);
    }

    #[test]
    fn what_is_out_of_range_is_told() {
        assert_eq!(Strength::between(0.0, 1.0).violation(0.0, 1.0), None);
        assert!(Strength::fixed(f64::NAN).violation(0.0, 1.0).is_some());
        for bad in
            [Strength::fixed(2.0), Strength::between(1.0, 0.5), Strength { low: 0.0, high: 1.0, share: 2.0 }]
        {
            assert!(bad.violation(0.0, 1.0).is_some(), "{bad:?}");
        }
        // What cannot be 0 cannot be left out of a flight.
        let half = Strength { low: 1.0, high: 2.0, share: 0.5 };
        assert!(half.violation(0.1, 10.0).is_some() && half.violation(0.0, 10.0).is_none());
    }
}
