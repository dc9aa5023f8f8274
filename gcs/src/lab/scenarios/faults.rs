//! Everything that is wrong with a scenario's file, not the first fault alone.

use crpl_sitl::Scenario;
use crpl_sitl::scenario::ScenarioError;
use toml::{Table, Value};

/// One entry of a file by its way from the root.
#[derive(Debug, Clone)]
struct Leaf {
    key: String,
    /// The file with nothing but this entry.
    alone: Table,
}

/// All faults of the text of a scenario's file, each with its key; none: it is a scenario.
#[must_use]
pub fn of_text(text: &str) -> Vec<String> {
    let Err(whole) = Scenario::from_toml(text) else { return Vec::new() };
    // A file of another kind, or of a former version, is told as such.
    let is_former = matches!(whole.downcast_ref(), Some(ScenarioError::Renamed { .. }));
    if is_former || whole.to_string().starts_with("this is a sweep") {
        return vec![format!("{whole:#}")];
    }
    let Ok(table) = toml::from_str::<Table>(text.trim_start_matches('\u{feff}')) else {
        // What is no TOML has one fault: the parser stops there.
        return vec![format!("{whole:#}")];
    };
    if let Ok(scenario) = table.clone().try_into::<Scenario>() {
        let faults: Vec<String> = scenario.faults().iter().map(ToString::to_string).collect();
        return if faults.is_empty() { vec![format!("{whole:#}")] } else { faults };
    }
    let mut faults = Vec::new();
    let mut good = Table::new();
    for leaf in leaves("", &table) {
        match leaf.alone.clone().try_into::<Scenario>() {
            Ok(_) => merge(&mut good, leaf.alone),
            Err(error) => faults.push(format!("`{}`: {}", leaf.key, error.message())),
        }
    }
    if let Ok(scenario) = good.try_into::<Scenario>() {
        faults.extend(scenario.faults().iter().map(ToString::to_string));
    }
    if faults.is_empty() { vec![format!("{whole:#}")] } else { faults }
}

fn leaves(prefix: &str, table: &Table) -> Vec<Leaf> {
    let mut found = Vec::new();
    for (name, value) in table {
        let key = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        let alone = |value: Value| Table::from_iter([(name.clone(), value)]);
        match value {
            Value::Table(inner) if !inner.is_empty() => {
                found.extend(
                    leaves(&key, inner)
                        .into_iter()
                        .map(|leaf| Leaf { alone: alone(leaf.alone.into()), ..leaf }),
                );
            }
            Value::Array(all) if !all.is_empty() && all.iter().all(Value::is_table) => {
                for (n, inner) in all.iter().filter_map(Value::as_table).enumerate() {
                    // Tables before it keep their number in the merged file.
                    let at = |inner: Table| {
                        let mut list = vec![Value::Table(Table::new()); n];
                        list.push(inner.into());
                        alone(list.into())
                    };
                    let inner = leaves(&format!("{key}[{n}]"), inner);
                    found.extend(inner.into_iter().map(|leaf| Leaf { alone: at(leaf.alone), ..leaf }));
                }
            }
            other => found.push(Leaf { key, alone: alone(other.clone()) }),
        }
    }
    found
}

/// Puts the entries of one file into another.
fn merge(into: &mut Table, from: Table) {
    for (name, value) in from {
        match (into.get_mut(&name), value) {
            (Some(Value::Table(old)), Value::Table(new)) => merge(old, new),
            (Some(Value::Array(old)), Value::Array(new)) if new.iter().all(Value::is_table) => {
                for (n, value) in new.into_iter().enumerate() {
                    match (old.get_mut(n), value) {
                        (Some(Value::Table(old)), Value::Table(new)) => merge(old, new),
                        (None, value) => old.push(value),
                        (Some(_), _) => {}
                    }
                }
            }
            (_, value) => {
                into.insert(name, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_is_told_with_its_key() {
        let text = "horizn = 3\ngoal = [1.4, 0.5]\n[radio]\nb_dt = \"much\"\nrule = \"drop\"\n[[obstacle]]\n\
                    raduis = 0.1\nradius = -1.0\n[disturbance]\nsigma_c = 99.0\n";
        let faults = of_text(text);
        for part in [
            "`horizn`",
            "`radio.b_dt`",
            "`obstacle[0].raduis`",
            "goal[0] = 1.4",
            "obstacle[0].radius = -1",
            "disturbance.sigma_c = 99",
        ] {
            assert_eq!(faults.iter().filter(|fault| fault.contains(part)).count(), 1, "{part}: {faults:#?}");
        }
        assert_eq!(faults.len(), 6, "{faults:#?}");
    }

    #[test]
    fn a_good_file_has_none_and_no_toml_has_one() {
        assert!(of_text("[radio]\nb_dt = 2.5\n").is_empty());
        assert_eq!(of_text("[radio\n").len(), 1);
        assert!(of_text("axis = \"goal[0]\"\npoints = [1.0]\n")[0].contains("this is a sweep"));
    }
}
