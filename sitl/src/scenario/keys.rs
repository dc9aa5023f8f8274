//! Keys of a scenario as text, such as `radio.b_dt`, `goal[0]` or `obstacle[1].position[0]`: `--set` and the axes
//! of sweeps.

use anyhow::{Context, Result, anyhow, bail};

use super::{Scenario, new_spelling};

/// The value under a key.
///
/// # Errors
/// A scenario has no such key, or this one has no such entry.
pub fn entry<'a>(root: &'a mut toml::Value, key: &str) -> Result<&'a mut toml::Value> {
    walk(root, key, false)
}

/// `fresh`: a key that is not written yet, and the entry after the last one of a list, are made.
fn walk<'a>(root: &'a mut toml::Value, key: &str, fresh: bool) -> Result<&'a mut toml::Value> {
    let former = new_spelling(key.split('.').next().unwrap_or_default());
    let unknown = || former.map_or("a scenario has no such key".into(), |new| format!("this is now {new}"));
    let mut value = root;
    let mut parts = key.split('.').peekable();
    while let Some(part) = parts.next() {
        let (name, indices) = part.split_once('[').map_or((part, None), |(name, rest)| (name, Some(rest)));
        if fresh && parts.peek().is_none() && indices.is_none() {
            // One that is left out where it has no value; what is none is told with the whole scenario.
            let table = value.as_table_mut().with_context(unknown)?;
            return Ok(table.entry(name.to_owned()).or_insert(toml::Value::Boolean(false)));
        }
        value = value.get_mut(name).with_context(unknown)?;
        for index in indices.into_iter().flat_map(|all| all.split('[')) {
            let index =
                index.strip_suffix(']').and_then(|n| n.parse::<usize>().ok()).with_context(unknown)?;
            let list = value.as_array_mut().with_context(unknown)?;
            let count = list.len();
            if fresh && index == count && list.iter().all(toml::Value::is_table) {
                list.push(toml::Table::new().into());
            }
            let unset = || match fresh {
                true => format!("{name} has {count} entries here, from {name}[0] on"),
                false => format!("{name} has {count} entries here; set further ones under [scenario]"),
            };
            value = list.get_mut(index).with_context(unset)?;
        }
    }
    Ok(value)
}

/// The value of a flag: what TOML takes it for, else a text.
fn value_of(text: &str) -> toml::Value {
    let parsed = toml::from_str::<toml::Table>(&format!("value = {text}"));
    let value = parsed.ok().filter(|table| table.len() == 1).and_then(|mut table| table.remove("value"));
    value.unwrap_or_else(|| text.into())
}

impl Scenario {
    /// The scenario with these values in place of its own, each `KEY=VALUE`: a value as in a TOML file; the keys of
    /// a table take the place of its own keys. Its name says so, unless it is one of them.
    ///
    /// # Errors
    /// No `KEY=VALUE`, a key that a scenario has not, a value out of range: the error names key and range.
    pub fn with(&self, assignments: &[String]) -> Result<Self> {
        if assignments.is_empty() {
            return Ok(self.clone());
        }
        let mut root = toml::Value::try_from(self)?;
        for assignment in assignments {
            put(&mut root, assignment).with_context(|| format!("--set {assignment}"))?;
        }
        let is_named =
            assignments.iter().any(|a| a.split_once('=').is_some_and(|(key, _)| key.trim() == "name"));
        let mut scenario = Self::from_toml(&toml::to_string(&root)?)
            .with_context(|| format!("--set {}", assignments.join(" --set ")))?;
        if !is_named {
            scenario.name = format!("{}, {}", self.name, assignments.join(", "));
        }
        Ok(scenario)
    }
}

fn put(root: &mut toml::Value, assignment: &str) -> Result<()> {
    let (key, text) = assignment.split_once('=').context("must be KEY=VALUE, such as radio.b_dt=2.5")?;
    let (key, new) = (key.trim(), value_of(text.trim()));
    let old = walk(root, key, true)?;
    match (&mut *old, new) {
        (toml::Value::Table(old), toml::Value::Table(new)) => old.extend(new),
        (toml::Value::Float(old), toml::Value::Integer(new)) => *old = new as f64,
        (toml::Value::Integer(_), toml::Value::Float(new)) => {
            bail!("{key} = {new}: must be a whole number")
        }
        (toml::Value::Float(_) | toml::Value::Integer(_), new) if !is_number(&new) => {
            return Err(anyhow!("{key} = {new}: must be a number"));
        }
        (old, new) => *old = new,
    }
    Ok(())
}

fn is_number(value: &toml::Value) -> bool {
    value.is_float() || value.is_integer()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::terminal::one_line;

    fn with(assignments: &[&str]) -> Result<Scenario> {
        let all: Vec<String> = assignments.iter().map(|a| (*a).to_owned()).collect();
        Scenario::named("demo").unwrap().with(&all)
    }

    #[test]
    fn numbers_entries_lists_and_tables_are_set() {
        let scenario = with(&[
            "goal[1]=0.3",
            "obstacle[0].position[0] = 0.55",
            "radio={b_dt=4, rule=\"queue\"}",
            "horizon=80",
            "start=[0.2, 0.5]",
            "obstacle[1].position=[0.3, 0.8]",
        ])
        .unwrap();
        assert_eq!((scenario.goal.y, scenario.horizon), (0.3, 80));
        assert_eq!((scenario.obstacles[0].position.x, scenario.obstacles[1].position.y), (0.55, 0.8));
        let demo = Scenario::named("demo").unwrap();
        assert_eq!((scenario.radio.b_dt, scenario.radio.packet_bits), (4.0, demo.radio.packet_bits));
        assert!(scenario.name.starts_with(&demo.name) && scenario.name.contains("goal[1]=0.3"));
        assert_eq!(with(&["name=mine"]).unwrap().name, "mine");
        assert_eq!(
            with(&["failsafe.setpoint_action=brake"]).unwrap().failsafe.setpoint_action,
            crate::scenario::Action::Brake
        );
        assert_eq!(with(&[]).unwrap(), demo);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_key_and_range() {
        for (assignment, part) in [
            ("radio.b_dt=-1", "radio.b_dt = -1: must lie in [1e-6, 1e9]"),
            ("radio.b_dt=much", "radio.b_dt = \"much\": must be a number"),
            ("horizon=2.5", "horizon = 2.5: must be a whole number"),
            ("radio.bandwith=2", "unknown field `bandwith`"),
            ("rdio.b_dt=2", "a scenario has no such key"),
            ("goal[2]=0.1", "goal has 2 entries here, from goal[0] on"),
            ("goal", "must be KEY=VALUE"),
            ("obstacle[0].position=[0.1, 0.5]", "start = [0.1, 0.5]: must be more than"),
        ] {
            let told = one_line(&with(&[assignment]).unwrap_err());
            assert!(told.contains(part) && told.contains("--set"), "{told}");
        }
    }
}
