//! `gcs scenario new`: a commented file to begin with.

use std::fmt::Write;

use crpl_sitl::Scenario;
use nalgebra::Vector2;

const HEAD: &str = "\
# A scenario of CRPL. The world is a square of side 1 (500 m unless [scale] says otherwise): x east, y north.
# A file holds only what differs from the paper's Scenario 2: any line may go. Numbers behind a # are as they are
# without the line; their range stands behind them. `gcs scenario check FILE` tells every fault, `gcs scenario
# show FILE` draws the world, `gcs episodes --scenario FILE --optimise` flies it.
";

/// The numbers that people change first, and what they mean.
const FIRST: [(&str, &str); 4] = [
    ("horizon", "Control intervals of a flight."),
    ("goal_radius", "A flight that ends so near to the goal has reached it."),
    ("radio.b_dt", "Bits that an interval carries per unit of spectral efficiency: less is a narrower link."),
    ("disturbance.sigma_c", "Strength of the gusts; the paper has 0 to 0.01."),
];

/// The file of a scenario.
#[must_use]
pub fn of(scenario: &Scenario) -> String {
    let mut out = format!("{HEAD}\nname = {:?}\n", scenario.name);
    let _ = writeln!(out, "start = {}\ngoal = {}", place(scenario.start), place(scenario.goal));
    section(&mut out, scenario, "");
    let about =
        "\n# An obstacle. A further table [[obstacle]] is a further one; `obstacle = []` above is none.\n";
    out += about;
    for obstacle in &scenario.obstacles {
        let _ = writeln!(
            out,
            "[[obstacle]]\nposition = {}\nradius = {}",
            place(obstacle.position),
            obstacle.radius
        );
        let _ = writeln!(out, "# Units per interval; it turns back at its margin from the walls.");
        let _ = writeln!(out, "velocity = {}\nmargin = {}", place(obstacle.velocity), obstacle.margin);
    }
    for table in tables(scenario) {
        let _ = writeln!(out, "\n[{table}]");
        match table {
            "channel" => {
                let _ = writeln!(out, "base_station = {}", place(scenario.channel.base_station));
            }
            "radio" => {
                let rule =
                    toml::Value::try_from(scenario.radio.rule).map_or(String::new(), |rule| rule.to_string());
                let about = "# What becomes of a packet that an interval cannot carry: drop (the paper), queue, ideal.";
                let _ = writeln!(out, "{about}\nrule = {rule}");
            }
            _ => {}
        }
        section(&mut out, scenario, table);
    }
    out
}

fn place(r: Vector2<f64>) -> String {
    format!("[{}, {}]", r.x, r.y)
}

/// Tables that have numbers, in their order.
fn tables(scenario: &Scenario) -> Vec<&'static str> {
    let mut found = Vec::new();
    for (key, ..) in scenario.ranges() {
        if let Some((table, _)) = key.rsplit_once('.')
            && !found.contains(&table)
        {
            found.push(table);
        }
    }
    found
}

/// The numbers of a table: those that people change first, and what differs from the paper; all others behind a #.
fn section(out: &mut String, scenario: &Scenario, table: &str) {
    let paper = Scenario::default();
    for ((key, value, least, most), (_, usual, ..)) in scenario.ranges().zip(paper.ranges()) {
        let (head, name) = key.rsplit_once('.').unwrap_or(("", key));
        if head != table || key.contains('[') {
            continue;
        }
        if let Some((_, about)) = FIRST.iter().find(|(first, _)| *first == key) {
            let _ = writeln!(out, "# {about}\n{name} = {value}");
            continue;
        }
        let hidden = if value == usual { "# " } else { "" };
        let _ = writeln!(out, "{hidden}{name} = {value}  # {least} to {most}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_of_a_preset_is_that_preset() {
        for name in ["demo", "elsewhere", "two-obstacles", "1-ideal", "2"] {
            let scenario = Scenario::named(name).unwrap();
            assert_eq!(Scenario::from_toml(&of(&scenario)).unwrap(), scenario, "{name}");
        }
    }

    #[test]
    fn a_line_that_loses_its_sign_is_still_a_scenario() {
        let text = of(&Scenario::default());
        let is_value = |line: &&str| {
            line.split_once(" = ")
                .is_some_and(|(key, _)| key.chars().all(|c| c.is_ascii_lowercase() || c == '_'))
        };
        let bare = |line| str::strip_prefix(line, "# ").filter(is_value).unwrap_or(line);
        let all: Vec<&str> = text.lines().map(bare).collect();
        assert!(all.iter().any(|line| line.starts_with("d_min = ")));
        Scenario::from_toml(&all.join("\n")).unwrap();
    }
}
