//! What a sweep is: which key takes which values, who flies, on which seeds, in which scenario; and
//! the shard of it that one process flies.
//!
//! A plan is resolved before the first flight and decides every number of the result. Its hash names it.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use anyhow::{Context, Result, bail};
use crpl_sitl::Scenario;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::files::fingerprint;
use crpl_sitl::scenario::keys::entry;
use serde::{Deserialize, Serialize};

use crate::station::pilot::Controller;

/// A sweep as it stands in a file: only what it needs.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepFile {
    /// Name of the sweep, and of its folder.
    name: String,
    /// Dotted key of the scenario that the points set.
    axis: String,
    /// Values of that key.
    points: Vec<f64>,
    /// Who flies.
    controllers: Vec<Controller>,
    /// Flights per point and controller.
    #[serde(default = "default_episodes")]
    episodes: u64,
    /// The first of so many consecutive seeds.
    #[serde(default = "default_first_seed")]
    first_seed: u64,
    /// Which policies fly where the axis changes the world that they were optimised for.
    #[serde(default)]
    policies: SweepPolicies,
    /// What differs from the paper's scenario at every point.
    #[serde(default)]
    scenario: toml::Table,
}

/// Which policies the crpl controllers of a sweep fly.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SweepPolicies {
    /// Those that cover the point's scenario; a point without any is an error.
    #[default]
    Covering,
    /// The same, and Algorithm 1 runs for a point without any.
    Optimised,
    /// The nearest ones, at every point; the results say where the point lies outside their world.
    Fixed,
}

/// A point whose scenario the policies do not cover.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UncoveredPoint {
    /// Value of the axis.
    pub x: f64,
    /// Which policies fly there.
    pub policy: String,
    /// Where the scenario leaves their world.
    pub mismatch: String,
}

/// What flies a plan: fingerprints, and the points that the policies do not cover.
#[derive(Debug, Clone, Default)]
pub struct SweepModels {
    /// Fingerprint of the world model.
    pub world_model: String,
    /// Fingerprint of the policies of all points.
    pub policy: String,
    /// Points outside the policies' world.
    pub uncovered: Vec<UncoveredPoint>,
}

/// Flights per point and controller where neither file nor flag says.
fn default_episodes() -> u64 {
    200
}

/// Nothing was chosen, tuned or trained by a look at flights with seeds from here on.
fn default_first_seed() -> u64 {
    300_000
}

/// What flags put in place of a file's values.
#[derive(Debug, Clone, Default)]
pub struct Overrides {
    /// Other points.
    pub points: Option<Vec<f64>>,
    /// Another number of flights.
    pub episodes: Option<u64>,
    /// Another first seed.
    pub first_seed: Option<u64>,
    /// Others fly.
    pub controllers: Option<Vec<Controller>>,
    /// Another choice of policies.
    pub policies: Option<SweepPolicies>,
    /// Another camera.
    pub camera: CameraFlag,
}

/// A resolved sweep: equal plans give equal bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepPlan {
    /// Name of the sweep.
    pub name: String,
    /// Dotted key of the scenario that the points set.
    pub axis: String,
    /// Values of that key.
    pub points: Vec<f64>,
    /// Who flies.
    pub controllers: Vec<Controller>,
    /// Flights per point and controller.
    pub episodes: u64,
    /// The first of so many consecutive seeds.
    pub first_seed: u64,
    /// Fingerprint of the world model that encodes the frames.
    pub world_model: String,
    /// Fingerprint of the policies of all points.
    pub policy: String,
    /// Which policies fly.
    pub policies: SweepPolicies,
    /// Points outside the policies' world: only where that is allowed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub uncovered: Vec<UncoveredPoint>,
    /// Name of the code that flies ([`crate::sources`]).
    pub code: String,
    /// The whole scenario; `axis` takes the points' values.
    pub scenario: Scenario,
}

impl SweepFile {
    /// Reads a file. Errors name it.
    ///
    /// # Errors
    /// The file cannot be read, or is no sweep: the error names file and key.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
        Self::parse(&text).with_context(|| format!("reading {}", path.display()))
    }

    /// Parses the text of a file.
    ///
    /// # Errors
    /// The text is no sweep: the error names the key.
    pub fn parse(text: &str) -> Result<Self> {
        Ok(toml::from_str(text)?)
    }

    /// Puts in what the flags say, and checks that every point is a scenario. `trained` gives what flies
    /// the plan, which has no trained parts yet when it is asked.
    ///
    /// # Errors
    /// A point that is no scenario, an empty or repeated list, and the errors of `trained`.
    pub fn resolve(
        self,
        flags: &Overrides,
        trained: impl FnOnce(&SweepPlan) -> Result<SweepModels>,
    ) -> Result<SweepPlan> {
        let mut scenario = Scenario::from_toml(&toml::to_string(&self.scenario)?).context("[scenario]")?;
        flags.camera.put(&mut scenario)?;
        let mut plan = SweepPlan {
            name: self.name,
            axis: self.axis,
            points: flags.points.clone().unwrap_or(self.points),
            controllers: flags.controllers.clone().unwrap_or(self.controllers),
            episodes: flags.episodes.unwrap_or(self.episodes),
            first_seed: flags.first_seed.unwrap_or(self.first_seed),
            world_model: String::new(),
            policy: String::new(),
            policies: flags.policies.unwrap_or(self.policies),
            uncovered: Vec::new(),
            code: crate::sources().into(),
            scenario,
        };
        plan.check()?;
        let SweepModels { world_model, policy, uncovered } = trained(&plan)?;
        (plan.world_model, plan.policy, plan.uncovered) = (world_model, policy, uncovered);
        Ok(plan)
    }
}

impl SweepPlan {
    fn check(&self) -> Result<()> {
        let in_a_name = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
        if self.name.is_empty() || !self.name.chars().all(in_a_name) {
            bail!("name = {:?}: must be letters, digits, - and _: a folder is named after it", self.name);
        }
        if self.points.is_empty() || self.controllers.is_empty() || self.episodes == 0 {
            bail!("a sweep needs a point, a controller and an episode, at least one each");
        }
        if let Some(twice) = repeated(&self.points) {
            bail!("points: {twice} stands there twice");
        }
        if let Some(twice) = repeated(&self.controllers) {
            bail!("controllers: {twice} stands there twice");
        }
        let last = self.first_seed.checked_add(self.episodes);
        if last.is_none_or(|last| i64::try_from(last).is_err()) {
            bail!("first_seed = {}: {} seeds from there on leave 63 bits", self.first_seed, self.episodes);
        }
        self.points.iter().try_for_each(|x| self.scenario_at(*x).map(drop))
    }

    /// The scenario in which `axis` has the value `x`.
    ///
    /// # Errors
    /// The axis is no number of a scenario, or the value is out of its range.
    pub fn scenario_at(&self, x: f64) -> Result<Scenario> {
        let axis = &self.axis;
        let mut root = toml::Value::try_from(&self.scenario)?;
        match entry(&mut root, axis).with_context(|| format!("axis = {axis:?}"))? {
            toml::Value::Float(value) => *value = x,
            toml::Value::Integer(value) if x.fract() == 0.0 => *value = x as i64,
            toml::Value::Integer(_) => bail!("{axis} = {x}: must be a whole number"),
            toml::Value::Array(all) => {
                bail!("axis = {axis:?}: name one of its entries, {axis}[0] to [{}]", all.len() - 1)
            }
            _ => bail!("axis = {axis:?}: must be a number of the scenario"),
        }
        Scenario::from_toml(&toml::to_string(&root)?)
    }

    /// The seeds of all episodes.
    #[must_use]
    pub fn seeds(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed + self.episodes
    }

    /// Names the plan: FNV-1a of all that decides the result.
    ///
    /// # Errors
    /// The plan has no TOML form.
    pub fn hash(&self) -> Result<String> {
        Ok(fingerprint(toml::to_string(self)?.as_bytes()))
    }

    /// The first key in which two plans differ, with both values.
    ///
    /// # Errors
    /// A plan has no TOML form.
    pub fn difference(&self, other: &Self) -> Result<Option<String>> {
        let (ours, theirs) = (toml::Table::try_from(self)?, toml::Table::try_from(other)?);
        Ok(difference("", &ours, &theirs))
    }
}

fn difference(prefix: &str, ours: &toml::Table, theirs: &toml::Table) -> Option<String> {
    let keys = ours.keys().chain(theirs.keys().filter(|key| !ours.contains_key(*key)));
    keys.into_iter().find_map(|key| {
        let name = format!("{prefix}{key}");
        match (ours.get(key), theirs.get(key)) {
            (Some(toml::Value::Table(a)), Some(toml::Value::Table(b))) => {
                difference(&format!("{name}."), a, b)
            }
            (a, b) if a == b => None,
            (a, b) => {
                let show = |v: Option<&toml::Value>| v.map_or("nothing".into(), ToString::to_string);
                Some(format!("{name} = {} and {}", show(a), show(b)))
            }
        }
    })
}

fn repeated<T: PartialEq + Copy>(items: &[T]) -> Option<T> {
    items.iter().enumerate().find(|(n, item)| items[..*n].contains(item)).map(|(_, item)| *item)
}

/// Shard I of N of a sweep, I from 1: the seeds whose number leaves the remainder I - 1. Every shard has all
/// points and controllers, so shards take equally long and their ratios stay paired.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// I, from 1.
    pub number: u64,
    /// N.
    pub of: u64,
}

impl Shard {
    /// All of it.
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// The seeds of `plan` in this shard.
    pub fn seeds(self, plan: &SweepPlan) -> impl Iterator<Item = u64> {
        let first = plan.first_seed;
        plan.seeds().filter(move |seed| (seed - first) % self.of == self.number - 1)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match parts {
            Some((number, of)) if (1..=of).contains(&number) => Ok(Self { number, of }),
            _ => Err("must be I/N with I from 1 to N, such as 1/3".into()),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str =
        "name = \"small\"\naxis = \"radio.b_dt\"\npoints = [2.5, 4.0]\ncontrollers = [\"rcc\"]\n";

    fn plan(text: &str) -> Result<SweepPlan> {
        SweepFile::parse(text)?.resolve(&Overrides::default(), |_| Ok(SweepModels::default()))
    }

    fn error(text: &str) -> String {
        crpl_sitl::program::terminal::one_line(&plan(text).unwrap_err())
    }

    #[test]
    fn a_point_sets_its_key_and_nothing_else() {
        let plan = plan(&format!("{FILE}[scenario.disturbance]\nsigma_c = 0.005\n")).unwrap();
        let mut want = plan.scenario.clone();
        want.radio.b_dt = 2.5;
        assert_eq!(plan.scenario_at(2.5).unwrap(), want);
        assert_eq!(want.disturbance.sigma_c, 0.005);
    }

    #[test]
    fn an_entry_of_a_list_is_an_axis() {
        for (axis, x, get) in [
            ("goal[0]", 0.8, (|s| s.goal.x) as fn(&Scenario) -> f64),
            ("start[1]", 0.3, |s| s.start.y),
            ("channel.base_station[0]", 0.2, |s| s.channel.base_station.x),
            ("obstacle[0].position[0]", 0.6, |s| s.obstacles[0].position.x),
            ("obstacle[1].radius", 0.04, |s| s.obstacles[1].radius),
        ] {
            let two = "[[scenario.obstacle]]\n[[scenario.obstacle]]\nposition = [0.3, 0.8]\n";
            let file = FILE.replace("radio.b_dt", axis).replace("[2.5, 4.0]", &format!("[{x}]"));
            let plan = plan(&format!("{file}{two}")).unwrap();
            assert_eq!(get(&plan.scenario_at(x).unwrap()), x, "{axis}");
        }
    }

    #[test]
    fn nonsense_is_named() {
        let with = |from: &str, to: &str| FILE.replace(from, to);
        for (text, part) in [
            (with("radio.b_dt", "radio.bandwith"), "axis = \"radio.bandwith\": a scenario has no such key"),
            (with("radio.b_dt", "name"), "must be a number"),
            (with("radio.b_dt", "goal"), "name one of its entries, goal[0] to [1]"),
            (with("radio.b_dt", "goal[2]"), "goal has 2 entries here"),
            (with("radio.b_dt", "goal[x]"), "a scenario has no such key"),
            (with("radio.b_dt", "obstacle[1].radius"), "obstacle has 1 entries here; set further ones"),
            (with("radio.b_dt", "obstacle[0].raduis"), "a scenario has no such key"),
            (with("radio.b_dt", "obstacle.radius"), "this is now one table [[obstacle]]"),
            (with("radio.b_dt", "second_obstacle.radius"), "as an axis, obstacle[1]"),
            (with("2.5", "-1.0"), "radio.b_dt = -1"),
            (with("2.5", "4.0"), "points: 4 stands there twice"),
            (with("[2.5, 4.0]", "[]"), "at least one each"),
            (with("small", "../x"), "name = \"../x\""),
            (with("axis", "axes"), "axes"),
            (format!("{FILE}[scenario.radio]\nb_dd = 3.0\n"), "b_dd"),
        ] {
            let line = error(&text);
            assert!(line.contains(part) && !line.contains('\n'), "{line}");
        }
    }

    #[test]
    fn shares_part_the_seeds() {
        let mut plan = plan(FILE).unwrap();
        (plan.first_seed, plan.episodes) = (10, 8);
        let shard = |text: &str| text.parse::<Shard>().unwrap().seeds(&plan).collect::<Vec<_>>();
        assert_eq!(
            [shard("1/3"), shard("2/3"), shard("3/3")],
            [vec![10, 13, 16], vec![11, 14, 17], vec![12, 15]]
        );
        for text in ["0/3", "4/3", "1", "a/b", "1/0", "/"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }

    #[test]
    fn plans_that_differ_say_where() {
        let one = plan(FILE).unwrap();
        let mut other = one.clone();
        assert_eq!(one.difference(&other).unwrap(), None);
        other.scenario.radio.b_dt = 3.0;
        assert_eq!(one.difference(&other).unwrap().unwrap(), "scenario.radio.b_dt = 4.0 and 3.0");
        assert_ne!(one.hash().unwrap(), other.hash().unwrap());
    }
}
