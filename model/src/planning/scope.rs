//! The world that a policy was optimised and checked for, and whether a scenario lies in it.
//!
//! A policy sees latents alone. Where the goal is, where the base station stands and how large the obstacle
//! is are in its weights. In another world it flies, and what it flies means nothing.

use std::fmt;

use crpl_sitl::Scenario;
use crpl_sitl::program::files;
use crpl_sitl::world::channel;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Keys of a scenario that a policy's weights depend on; a table stands for all of its keys. Left out are
/// names, drawing, units of measurement, the vehicle's own autopilot, propulsion (in no objective), and the
/// keys of [`BOUNDED`].
const KEYS: [&str; 9] =
    ["start", "goal", "goal_radius", "uav_radius", "obstacle", "dynamics", "channel", "safety", "cost"];

/// Keys that [`PolicyScope::differences`] compares through a bound, or not at all: γ_min is part of the SNR
/// that a packet needs.
const BOUNDED: [&str; 1] = ["channel.snr_min"];

/// What a policy was optimised and checked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "StatedScope")]
pub struct PolicyScope {
    /// The scenario of the optimisation. The policy covers scenarios with the same keys that need at most
    /// the same SNR.
    pub scenario: Scenario,
    /// Largest standard deviation, per axis, of the gusts that it was checked in; units per interval.
    pub gust_std: f64,
    /// The scenario as the file states it: a file of an older version lacks keys, and was made without them.
    #[serde(skip)]
    stated: Value,
}

/// A scope as a file has it.
#[derive(Deserialize)]
struct StatedScope {
    scenario: Value,
    gust_std: f64,
}

impl TryFrom<StatedScope> for PolicyScope {
    type Error = serde_json::Error;

    fn try_from(stated: StatedScope) -> Result<Self, Self::Error> {
        let StatedScope { scenario, gust_std } = stated;
        Ok(Self { scenario: serde_json::from_value(scenario.clone())?, gust_std, stated: scenario })
    }
}

/// One key in which a scenario leaves a policy's world.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyDifference {
    /// Dotted key, such as `goal` or `obstacle[0].radius`; or a quantity.
    pub key: String,
    /// The policy's value.
    pub policy: String,
    /// The scenario's.
    pub here: String,
}

impl fmt::Display for KeyDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {} in the policy, {} here", self.key, self.policy, self.here)
    }
}

impl PolicyScope {
    /// A policy that was optimised for `scenario` and checked in gusts of `gust_std` (units per interval,
    /// per axis).
    #[must_use]
    pub fn new(scenario: Scenario, gust_std: f64) -> Self {
        Self { stated: json(&scenario), scenario, gust_std }
    }

    /// Where `here` leaves this world; empty if the policy covers it. Numbers are compared as f32, the
    /// width that parameters have on the wire.
    #[must_use]
    pub fn differences(&self, here: &Scenario) -> Vec<KeyDifference> {
        let (ours, theirs) = (leaves(&self.scenario, &self.stated), leaves(here, &json(here)));
        let mut found = Vec::new();
        let none = || "none".to_owned();
        for (key, value) in &ours {
            match theirs.iter().find(|(other, _)| other == key) {
                Some((_, other)) if equal(value, other) => {}
                other => found.push(KeyDifference {
                    key: key.clone(),
                    policy: text(value),
                    here: other.map_or_else(none, |(_, value)| text(value)),
                }),
            }
        }
        for (key, value) in &theirs {
            if ours.iter().all(|(other, _)| other != key) {
                found.push(KeyDifference { key: key.clone(), policy: none(), here: text(value) });
            }
        }
        let bounds = [
            ("gusts' standard deviation", self.gust_std, here.disturbance.gust_std()),
            ("SNR that a packet needs", required_snr(&self.scenario), required_snr(here)),
        ];
        for (key, most, needed) in bounds {
            if needed > most * (1.0 + 1e-6) {
                found.push(KeyDifference {
                    key: key.into(),
                    policy: format!("{most:.4} at most"),
                    here: format!("{needed:.4}"),
                });
            }
        }
        found
    }
}

/// The SNR that a packet of this scenario needs, linear: max(γ_min, 2^(L/(B Δt)) - 1).
#[must_use]
pub fn required_snr(scenario: &Scenario) -> f64 {
    let rate = channel::outage_snr(scenario.radio.b_dt, scenario.radio.packet_bits);
    scenario.channel.snr_min.max(rate.0)
}

/// Names the world that a policy for this scenario is optimised for: equal for scenarios that differ in
/// nothing that matters to it.
#[must_use]
pub fn fingerprint(scenario: &Scenario) -> String {
    let mut text = String::new();
    for (key, value) in leaves(scenario, &json(scenario)) {
        text += &format!("{key} = {};", narrow(&value));
    }
    text += &format!("{} {}", required_snr(scenario) as f32, scenario.disturbance.gust_std() as f32);
    files::fingerprint(text.as_bytes())
}

/// A value with the width that parameters have on the wire.
fn narrow(value: &Value) -> String {
    match value {
        Value::Array(list) => list.iter().map(narrow).collect::<Vec<_>>().join(","),
        Value::Number(number) => number.as_f64().map_or_else(String::new, |x| (x as f32).to_string()),
        value => value.to_string(),
    }
}

/// A scenario is a table of numbers, words and tables: it always has a JSON form.
fn json(scenario: &Scenario) -> Value {
    serde_json::to_value(scenario).unwrap_or_default()
}

/// Dotted keys and values of all that matters to a policy, of `scenario` with the JSON form `all`.
fn leaves(scenario: &Scenario, all: &Value) -> Vec<(String, Value)> {
    let mut found = Vec::new();
    for key in KEYS {
        if let Some(value) = all.get(key) {
            collect(key, value, &mut found);
        }
    }
    let stands = |n: usize| scenario.obstacles.get(n).is_some_and(|o| o.velocity.norm() == 0.0);
    found.retain(|(key, _)| {
        // An obstacle that stands reflects nowhere.
        let idle =
            (0..scenario.obstacles.len()).any(|n| stands(n) && *key == format!("obstacle[{n}].margin"));
        !idle && !BOUNDED.contains(&key.as_str())
    });
    found
}

fn collect(key: &str, value: &Value, found: &mut Vec<(String, Value)>) {
    match value {
        Value::Object(table) => {
            table.iter().for_each(|(name, value)| collect(&format!("{key}.{name}"), value, found));
        }
        Value::Array(list) if list.iter().any(Value::is_object) => {
            list.iter().enumerate().for_each(|(n, value)| collect(&format!("{key}[{n}]"), value, found));
        }
        Value::Array(list) if list.is_empty() => {}
        value => found.push((key.into(), value.clone())),
    }
}

fn equal(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Array(a), Value::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| equal(a, b)),
        (Value::Number(a), Value::Number(b)) => match (a.as_f64(), b.as_f64()) {
            (Some(a), Some(b)) => a as f32 == b as f32,
            _ => a == b,
        },
        _ => a == b,
    }
}

fn text(value: &Value) -> String {
    match value {
        Value::Array(list) => format!("[{}]", list.iter().map(text).collect::<Vec<_>>().join(", ")),
        Value::String(word) => word.clone(),
        value => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scope() -> PolicyScope {
        PolicyScope::new(Scenario::named("demo").unwrap(), 0.0015)
    }

    fn differences(change: impl FnOnce(&mut Scenario)) -> Vec<String> {
        let mut here = scope().scenario;
        change(&mut here);
        scope().differences(&here).iter().map(ToString::to_string).collect()
    }

    #[test]
    fn the_policy_s_own_world_and_easier_ones_are_covered() {
        assert!(differences(|_| ()).is_empty());
        assert!(differences(|s| s.name = "another".into()).is_empty());
        assert!(differences(|s| s.radio.b_dt = 4.0).is_empty(), "more bandwidth needs less SNR");
        assert!(differences(|s| s.disturbance.sigma_c = 0.0).is_empty());
        assert!(differences(|s| s.obstacles[0].margin = 0.2).is_empty(), "it stands");
        assert!(differences(|s| s.scale.metres_per_unit = 60.0).is_empty());
        assert!(differences(|s| s.goal.x = f64::from(s.goal.x as f32)).is_empty(), "a parameter's width");
    }

    #[test]
    fn every_key_of_the_faults_list_is_told_with_both_values() {
        for (told, change) in [
            (
                "goal = [0.9, 0.5] in the policy, [0.85, 0.8] here",
                (|s| s.goal = [0.85, 0.8].into()) as fn(&mut Scenario),
            ),
            ("start = [0.1, 0.5] in the policy, [0.1, 0.4] here", |s| s.start.y = 0.4),
            ("obstacle[0].radius = 0.1 in the policy, 0.2 here", |s| s.obstacles[0].radius = 0.2),
            ("channel.base_station = [0.5, 0.05] in the policy, [0.2, 0.9] here", |s| {
                s.channel.base_station = [0.2, 0.9].into();
            }),
            ("SNR that a packet needs = 1.7407 at most in the policy, 3.0000 here", |s| s.radio.b_dt = 2.0),
            ("gusts' standard deviation = 0.0015 at most in the policy, 0.0030 here", |s| {
                s.disturbance.sigma_c = 0.01;
            }),
            ("channel.noise_power = 1.0 in the policy, 2.0 here", |s| s.channel.noise_power = 2.0),
            ("dynamics.walls = true in the policy, false here", |s| s.dynamics.walls = false),
            ("uav_radius = 0.02 in the policy, 0.03 here", |s| s.uav_radius = 0.03),
        ] {
            assert_eq!(differences(change), [told]);
        }
    }

    #[test]
    fn the_margin_of_an_obstacle_that_moves_is_told_of_that_one_alone() {
        let text = "[[obstacle]]\n[[obstacle]]\nposition = [0.3, 0.8]\nvelocity = [0.01, 0.0]";
        let ours = PolicyScope::new(Scenario::from_toml(text).unwrap(), 0.0015);
        let mut here = ours.scenario.clone();
        here.obstacles.iter_mut().for_each(|o| o.margin = 0.25);
        let told = ours.differences(&here);
        assert_eq!(told.iter().map(|d| d.key.as_str()).collect::<Vec<_>>(), ["obstacle[1].margin"]);
    }

    #[test]
    fn a_policy_for_still_air_covers_still_air() {
        let mut here = scope().scenario;
        here.disturbance.sigma_c = 0.0;
        assert_eq!(PolicyScope::new(here.clone(), 0.0).differences(&here), []);
    }

    #[test]
    fn a_fingerprint_names_what_matters_and_nothing_else() {
        let of = |change: fn(&mut Scenario)| {
            let mut here = scope().scenario;
            change(&mut here);
            fingerprint(&here)
        };
        let own = of(|_| ());
        assert_eq!(own, of(|s| s.name = "another".into()));
        assert_eq!(own, of(|s| s.goal.x = f64::from(s.goal.x as f32)), "a parameter's width");
        let others = [
            of(|s| s.goal.y = 0.6),
            of(|s| s.uav_radius = 0.03),
            of(|s| s.dynamics.walls = false),
            of(|s| s.radio.b_dt = 2.0),
            of(|s| s.disturbance.sigma_c = 0.01),
        ];
        for (n, other) in others.iter().enumerate() {
            assert!(*other != own && !others[..n].contains(other), "{n}");
        }
    }

    #[test]
    fn a_key_that_an_older_file_does_not_state_is_told() {
        let mut file = serde_json::to_value(scope()).unwrap();
        let here = scope().scenario;
        let read = |file: &Value| serde_json::from_value::<PolicyScope>(file.clone()).unwrap();
        assert_eq!((read(&file), read(&file).differences(&here).len()), (scope(), 0));
        file["scenario"].as_object_mut().unwrap().remove("cost");
        let told: Vec<String> = read(&file).differences(&here).iter().map(ToString::to_string).collect();
        assert!(told.contains(&"cost.settle = none in the policy, 5.0 here".to_owned()), "{told:?}");
        file["scenario"]["safety"]["softness"] = "wide".into();
        assert!(serde_json::from_value::<PolicyScope>(file).is_err());
    }

    #[test]
    fn another_number_of_obstacles_is_told() {
        let more = differences(|s| s.obstacles.push(crpl_sitl::scenario::Obstacle::default()));
        assert!(more.contains(&"obstacle[1].radius = none in the policy, 0.1 here".to_owned()), "{more:?}");
        let fewer = differences(|s| s.obstacles.clear());
        assert!(fewer.contains(&"obstacle[0].radius = 0.1 in the policy, none here".to_owned()), "{fewer:?}");
        assert!(fewer.iter().all(|told| told.starts_with("obstacle[0].")), "{fewer:?}");
    }
}
