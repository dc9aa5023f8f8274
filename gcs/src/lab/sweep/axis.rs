//! What a sweep varies: one key of a scenario or two, each with its values.

use std::str::FromStr;

use anyhow::{Context, Result, bail};
use crpl_sitl::scenario::keys::entry;
use serde::{Deserialize, Serialize};

/// Most values of a grid: a typo shall not ask for a million.
const MOST: usize = 10_000;

/// A key and its values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepAxis {
    /// Dotted key of the scenario, `goal[1]` and `obstacle[0].position[0]` among them.
    pub axis: String,
    /// Its values.
    #[serde(deserialize_with = "values")]
    pub points: Vec<f64>,
}

/// Where a sweep flies: a value of each axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SweepPoint {
    /// Of the first axis.
    pub x: f64,
    /// Of the second, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y: Option<f64>,
}

impl SweepPoint {
    /// A point of a sweep over one axis.
    #[must_use]
    pub fn on(x: f64) -> Self {
        Self { x, y: None }
    }

    /// Its bits, to be looked up.
    #[must_use]
    pub fn bits(self) -> (u64, Option<u64>) {
        (self.x.to_bits(), self.y.map(f64::to_bits))
    }
}

/// The values of an axis as text: `0.1,0.2,0.5`, or `0.1:0.5:5`, five values from 0.1 to 0.5.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisValues(pub Vec<f64>);

impl FromStr for AxisValues {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |part: &str| {
            let x: Option<f64> = part.trim().parse().ok();
            x.filter(|x| x.is_finite()).ok_or_else(|| format!("{part:?} is not a number"))
        };
        let parts: Vec<&str> = text.split(':').collect();
        let [from, to, count] = parts.as_slice() else {
            if parts.len() > 1 {
                return Err(format!("{text:?}: a grid is FROM:TO:COUNT, such as 0.1:0.5:5"));
            }
            return text.split(',').map(number).collect::<Result<_, _>>().map(Self);
        };
        let (from, to) = (number(from)?, number(to)?);
        let count = count.trim().parse().ok().filter(|n| (2..=MOST).contains(n));
        let count: usize = count.ok_or_else(|| format!("{text:?}: a grid has 2 to {MOST} values"))?;
        let at = |n: usize| from + (to - from) * n as f64 / (count - 1) as f64;
        Ok(Self((0..count).map(|n| twelve_digits(at(n))).collect()))
    }
}

/// 0.3, not 0.30000000000000004.
fn twelve_digits(x: f64) -> f64 {
    format!("{x:.12e}").parse().unwrap_or(x)
}

/// `KEY=VALUES` of a flag.
impl FromStr for SweepAxis {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (axis, values) = text
            .split_once('=')
            .ok_or("must be KEY=VALUES, such as goal[1]=0.3,0.5 or radio.b_dt=2.5:5:6")?;
        let AxisValues(points) = values.parse()?;
        Ok(Self { axis: axis.trim().to_owned(), points })
    }
}

/// Points of a file: a list of numbers, or a grid as text.
///
/// # Errors
/// It is neither.
pub fn values<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "must be a list of numbers, or a grid such as \"0.1:0.5:5\"")]
    enum Points {
        List(Vec<f64>),
        Grid(String),
    }
    match Points::deserialize(from)? {
        Points::List(list) => Ok(list),
        Points::Grid(text) => text.parse().map(|AxisValues(list)| list).map_err(serde::de::Error::custom),
    }
}

/// A scenario in which a key has another value.
///
/// # Errors
/// The key is no number of a scenario.
pub fn set(root: &mut toml::Value, axis: &str, x: f64) -> Result<()> {
    match entry(root, axis).with_context(|| format!("axis = {axis:?}"))? {
        toml::Value::Float(value) => *value = x,
        toml::Value::Integer(value) if x.fract() == 0.0 => *value = x as i64,
        toml::Value::Integer(_) => bail!("{axis} = {x}: must be a whole number"),
        toml::Value::Array(all) => {
            bail!("axis = {axis:?}: name one of its entries, {axis}[0] to [{}]", all.len() - 1)
        }
        _ => bail!("axis = {axis:?}: must be a number of the scenario"),
    }
    Ok(())
}

/// A name for a sweep that has none: of what it varies.
#[must_use]
pub fn name_of(axes: &[SweepAxis]) -> String {
    let keys: Vec<&str> = axes.iter().map(|axis| axis.axis.as_str()).collect();
    let word = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' };
    let mut name: String = keys.join("-and-").chars().map(word).collect();
    while name.contains("--") {
        name = name.replace("--", "-");
    }
    name.trim_matches('-').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_a_list_or_a_grid() {
        let of = |text: &str| text.parse::<AxisValues>().map(|values| values.0);
        assert_eq!(of("0.1, 0.5,2"), Ok(vec![0.1, 0.5, 2.0]));
        assert_eq!(of("0.1:0.5:5"), Ok(vec![0.1, 0.2, 0.3, 0.4, 0.5]));
        assert_eq!(of("3:1:3"), Ok(vec![3.0, 2.0, 1.0]));
        for text in ["", "a", "1:2", "1:2:1", "1:2:x", "1:2:3:4", "nan", "1,,2", "1:2:99999999"] {
            assert!(of(text).is_err(), "{text}");
        }
        let axis: SweepAxis = "goal[1]=0.3,0.5".parse().unwrap();
        assert_eq!((axis.axis.as_str(), axis.points), ("goal[1]", vec![0.3, 0.5]));
        assert!("goal[1]".parse::<SweepAxis>().is_err());
    }

    #[test]
    fn a_sweep_without_a_name_is_named_after_what_it_varies() {
        let axes = ["goal[1]=0.3", "radio.b_dt=2.5"].map(|text| text.parse().unwrap());
        assert_eq!(name_of(&axes), "goal-1-and-radio-b_dt");
    }
}
