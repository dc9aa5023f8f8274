//! What a sweep is: which key takes which values, who flies, on which seeds, in which scenario; and
//! the shard of it that one process flies.
//!
//! A plan is resolved before the first flight and decides every number of the result. Its hash names it.

use std::path::Path;

use anyhow::{Context, Result, bail};
use crpl_sitl::Scenario;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::files::fingerprint;
use crpl_sitl::program::shard::Shard;
use serde::{Deserialize, Serialize};

use super::axis::{self, SweepAxis, SweepPoint};
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
    #[serde(deserialize_with = "axis::values")]
    points: Vec<f64>,
    /// Another key, each of whose values meets each of the first.
    #[serde(default)]
    second: Option<SweepAxis>,
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
    /// Value of the second axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y: Option<f64>,
    /// Which policies fly there.
    pub policy: String,
    /// Where the scenario leaves their world.
    pub mismatch: String,
}

impl UncoveredPoint {
    /// Where.
    #[must_use]
    pub fn point(&self) -> SweepPoint {
        SweepPoint { x: self.x, y: self.y }
    }
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
    /// Other axes, one or two; empty: the file's.
    pub axes: Vec<SweepAxis>,
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
    /// Another key and its values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub second: Option<SweepAxis>,
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
    /// The whole scenario; the axes take the points' values.
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

    /// A sweep that flags alone describe: CRPL and RCC in a scenario.
    ///
    /// # Errors
    /// There is no such scenario.
    pub fn over(axes: &[SweepAxis], scenario: &str) -> Result<Self> {
        let scenario = Scenario::named(scenario)?;
        Ok(Self {
            name: axis::name_of(axes),
            axis: String::new(),
            points: Vec::new(),
            second: None,
            controllers: vec![Controller::Crpl, Controller::Rcc],
            episodes: default_episodes(),
            first_seed: default_first_seed(),
            policies: SweepPolicies::default(),
            scenario: toml::Table::try_from(&scenario)?,
        })
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
        let mut axes = flags.axes.iter().cloned();
        let own = || SweepAxis { axis: self.axis, points: self.points };
        let first = axes.next().unwrap_or_else(own);
        let second = if flags.axes.is_empty() { self.second } else { axes.next() };
        let mut plan = SweepPlan {
            name: self.name,
            axis: first.axis,
            points: flags.points.clone().unwrap_or(first.points),
            second,
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
        let lists = || std::iter::once(&self.points).chain(self.second.iter().map(|axis| &axis.points));
        if lists().any(Vec::is_empty) || self.controllers.is_empty() || self.episodes == 0 {
            bail!("a sweep needs a point, a controller and an episode, at least one each");
        }
        if let Some(twice) = lists().find_map(|points| repeated(points)) {
            bail!("points: {twice} stands there twice");
        }
        if let Some(twin) = self.second.as_ref().filter(|second| second.axis == self.axis) {
            bail!("both axes are {}", twin.axis);
        }
        if let Some(twice) = repeated(&self.controllers) {
            bail!("controllers: {twice} stands there twice");
        }
        let last = self.first_seed.checked_add(self.episodes);
        if last.is_none_or(|last| i64::try_from(last).is_err()) {
            bail!("first_seed = {}: {} seeds from there on leave 63 bits", self.first_seed, self.episodes);
        }
        self.grid().iter().try_for_each(|point| self.scenario_at(*point).map(drop))
    }

    /// All points: those of the first axis in their order, for each value of the second.
    #[must_use]
    pub fn grid(&self) -> Vec<SweepPoint> {
        let row = |y| self.points.iter().map(move |x| SweepPoint { x: *x, y });
        match &self.second {
            None => row(None).collect(),
            Some(second) => second.points.iter().flat_map(|y| row(Some(*y))).collect(),
        }
    }

    /// A point in words.
    #[must_use]
    pub fn at(&self, point: SweepPoint) -> String {
        let first = format!("{} = {}", self.axis, point.x);
        let second = self.second.as_ref().zip(point.y);
        second.map_or_else(|| first.clone(), |(axis, y)| format!("{first}, {} = {y}", axis.axis))
    }

    /// How many keys are varied.
    #[must_use]
    pub fn axis_count(&self) -> usize {
        1 + usize::from(self.second.is_some())
    }

    /// What is varied, in words.
    #[must_use]
    pub fn axes(&self) -> String {
        match &self.second {
            None => self.axis.clone(),
            Some(second) => format!("{} and {}", self.axis, second.axis),
        }
    }

    /// The scenario of a point.
    ///
    /// # Errors
    /// An axis is no number of a scenario, or the value is out of its range.
    pub fn scenario_at(&self, point: SweepPoint) -> Result<Scenario> {
        let mut root = toml::Value::try_from(&self.scenario)?;
        axis::set(&mut root, &self.axis, point.x)?;
        if let (Some(second), Some(y)) = (&self.second, point.y) {
            axis::set(&mut root, &second.axis, y)?;
        }
        Scenario::from_toml(&toml::to_string(&root)?)
    }

    /// The seeds of one shard.
    pub fn seeds_of(&self, shard: Shard) -> impl Iterator<Item = u64> {
        let first = self.first_seed;
        self.seeds().filter(move |seed| shard.has(seed - first))
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
        assert_eq!(plan.scenario_at(SweepPoint::on(2.5)).unwrap(), want);
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
            assert_eq!(get(&plan.scenario_at(SweepPoint::on(x)).unwrap()), x, "{axis}");
        }
    }

    #[test]
    fn each_value_of_the_second_axis_meets_each_of_the_first() {
        let file = FILE.replace("[2.5, 4.0]", "\"2.5:4:2\"");
        let plan = plan(&format!("{file}[second]\naxis = \"goal[1]\"\npoints = [0.3, 0.5]\n")).unwrap();
        let grid: Vec<_> = plan.grid().iter().map(|point| (point.x, point.y)).collect();
        assert_eq!(grid, [(2.5, Some(0.3)), (4.0, Some(0.3)), (2.5, Some(0.5)), (4.0, Some(0.5))]);
        let last = plan.scenario_at(plan.grid()[3]).unwrap();
        assert_eq!((last.radio.b_dt, last.goal.y), (4.0, 0.5));
        assert_eq!(plan.at(plan.grid()[1]), "radio.b_dt = 4, goal[1] = 0.3");
        // A plan is written down and read again.
        assert_eq!(toml::from_str::<SweepPlan>(&toml::to_string(&plan).unwrap()).unwrap(), plan);
    }

    #[test]
    fn axes_of_flags_stand_in_place_of_a_file_s() {
        let file =
            || SweepFile::parse(&format!("{FILE}[second]\naxis = \"goal[1]\"\npoints = [0.3]\n")).unwrap();
        let axes = ["goal[0]=0.8", "start[1]=0.3:0.4:2"].map(|text| text.parse().unwrap());
        let resolve = |axes: &[SweepAxis]| {
            let flags = Overrides { axes: axes.to_vec(), ..Overrides::default() };
            file().resolve(&flags, |_| Ok(SweepModels::default())).unwrap()
        };
        assert_eq!(resolve(&axes).axes(), "goal[0] and start[1]");
        assert_eq!(resolve(&axes[..1]).axes(), "goal[0]");
        assert_eq!(resolve(&[]).axes(), "radio.b_dt and goal[1]");
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
            (format!("{FILE}[second]\naxis = \"radio.b_dt\"\npoints = [1.0]\n"), "both axes are radio.b_dt"),
            (
                format!("{FILE}[second]\naxis = \"goal[1]\"\npoints = [0.3, 0.3]\n"),
                "points: 0.3 stands there twice",
            ),
            (format!("{FILE}[second]\naxis = \"goal[1]\"\npoints = []\n"), "at least one each"),
            (with("[2.5, 4.0]", "\"2:3\""), "FROM:TO:COUNT"),
        ] {
            let line = error(&text);
            assert!(line.contains(part) && !line.contains('\n'), "{line}");
        }
    }

    #[test]
    fn shares_part_the_seeds() {
        let mut plan = plan(FILE).unwrap();
        (plan.first_seed, plan.episodes) = (10, 8);
        let shard = |text: &str| plan.seeds_of(text.parse().unwrap()).collect::<Vec<_>>();
        assert_eq!(
            [shard("1/3"), shard("2/3"), shard("3/3")],
            [vec![10, 13, 16], vec![11, 14, 17], vec![12, 15]]
        );
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
