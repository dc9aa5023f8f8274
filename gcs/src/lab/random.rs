//! `gcs optimise --random N`: how general Algorithm 1 is, on worlds that nobody chose.
//!
//! Each world is Scenario 2 with another start, goal, obstacle, base station and bandwidth, drawn uniformly in
//! the ranges below. Whether a world is solvable is decided without any policy, by a search for a path
//! ([`solvable`]).

use std::collections::VecDeque;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use crpl_model::planning::config::OptimiseConfig;
use crpl_model::planning::scope;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use crpl_sitl::program::columns;
use crpl_sitl::program::files::write_whole;
use crpl_sitl::program::shard::Shard;
use crpl_sitl::units::TxPower;
use crpl_sitl::units::noise::{Noise, Stream};
use crpl_sitl::world::{channel, safety};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use crate::lab::attempts::{Begun, Quiet, optimise_for};
use crate::lab::check::ConstraintCheck;

/// Start, goal and base station lie in this range of each axis.
const PLACE: [f64; 2] = [0.08, 0.92];
/// The obstacle's centre lies in this range of each axis.
const OBSTACLE: [f64; 2] = [0.25, 0.75];
/// Its radius.
const RADIUS: [f64; 2] = [0.05, 0.15];
/// Least distance from start to goal: a flight of 100 intervals that is worth one.
const LEAST_WAY: f64 = 0.4;
/// Least clearance of start and goal from the obstacle.
const LEAST_CLEARANCE: f64 = 0.08;
/// B Δt.
const BANDWIDTH: [f64; 2] = [2.5, 6.0];
/// σ_c, the demo's.
const SIGMA_C: f64 = 0.005;

/// World `n` of `seed`: Scenario 2 with the drawn keys.
#[must_use]
pub fn world(seed: u64, n: u64) -> Scenario {
    let mut rng = Noise::new(seed).generator(Stream::Worlds, n);
    let mut scenario = Scenario { name: format!("random {seed}/{n}"), ..Scenario::default() };
    scenario.disturbance.sigma_c = SIGMA_C;
    loop {
        let mut within = |[low, high]: [f64; 2]| thousandths(rng.random_range(low..=high));
        scenario.radio.b_dt = within(BANDWIDTH);
        scenario.obstacles.truncate(1);
        if let Some(obstacle) = scenario.obstacles.first_mut() {
            obstacle.position = Vector2::new(within(OBSTACLE), within(OBSTACLE));
            obstacle.radius = within(RADIUS);
        }
        let place = |rng: &mut _| draw_place(rng);
        (scenario.start, scenario.goal) = (place(&mut rng), place(&mut rng));
        scenario.channel.base_station = place(&mut rng);
        let is_clear =
            [scenario.start, scenario.goal].iter().all(|r| clearance(*r, &scenario) >= LEAST_CLEARANCE);
        if is_clear && (scenario.goal - scenario.start).norm() >= LEAST_WAY && scenario.check().is_ok() {
            return scenario;
        }
    }
}

fn draw_place(rng: &mut impl Rng) -> Vector2<f64> {
    let [low, high] = PLACE;
    Vector2::from_fn(|_, _| thousandths(rng.random_range(low..=high)))
}

/// Three decimals: a world that can be typed.
fn thousandths(x: f64) -> f64 {
    (x * 1000.0).round() / 1000.0
}

fn clearance(r: Vector2<f64>, scenario: &Scenario) -> f64 {
    let o = scenario.obstacle();
    safety::clearance(r, o.position, scenario.uav_radius, o.radius)
}

/// Cells along each side of the search's grid.
const CELLS: usize = 100;

/// Most by which a way over sides and corners of cells is longer than the straight one.
const OCTILE: f64 = 1.0824;

/// Whether a path from start to goal exists on which a UAV could keep both constraints: in every cell the SNR at
/// full power carries a packet and the clearance is above d_min, and the path is no longer than a UAV at v_max
/// flies in the horizon, less the intervals that it takes to reach v_max and to stop. It bounds what any
/// controller can do: gusts and sight play no part. Cells touch by sides and corners.
#[must_use]
pub fn solvable(scenario: &Scenario) -> bool {
    let needed = scope::required_snr(scenario);
    let o = scenario.obstacle();
    let cell = 1.0 / CELLS as f64;
    let centre = |(i, j): (usize, usize)| Vector2::new(i as f64 + 0.5, j as f64 + 0.5) * cell;
    let is_free = |at: (usize, usize)| {
        let r = centre(at);
        let gain = channel::gain(r, o.position, o.radius, &scenario.channel);
        let snr = channel::snr(gain, TxPower::High.level(), &scenario.channel).0;
        clearance(r, scenario) > scenario.safety.d_min && snr >= needed
    };
    let at = |r: Vector2<f64>| {
        let index = |x: f64| ((x / cell) as usize).min(CELLS - 1);
        (index(r.x), index(r.y))
    };
    let (start, goal) = (at(scenario.start), at(scenario.goal));
    if !is_free(start) || !is_free(goal) {
        return false;
    }
    // Dijkstra would be exact; a queue that is visited again where a shorter way is found is enough here.
    let mut length = vec![f64::INFINITY; CELLS * CELLS];
    let mut queue = VecDeque::from([start]);
    length[start.0 * CELLS + start.1] = 0.0;
    while let Some((i, j)) = queue.pop_front() {
        let so_far = length[i * CELLS + j];
        for (di, dj) in [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1)] {
            let next = (i.wrapping_add_signed(di), j.wrapping_add_signed(dj));
            if next.0 >= CELLS || next.1 >= CELLS || !is_free(next) {
                continue;
            }
            let step = cell * if di != 0 && dj != 0 { std::f64::consts::SQRT_2 } else { 1.0 };
            let known = &mut length[next.0 * CELLS + next.1];
            if so_far + step < *known - 1e-12 {
                *known = so_far + step;
                queue.push_back(next);
            }
        }
    }
    let d = &scenario.dynamics;
    let reach = d.v_max * (scenario.horizon as f64 - d.v_max / d.a_max);
    length[goal.0 * CELLS + goal.1] <= OCTILE * reach
}

/// One world and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RandomRow {
    /// Number of the world under its seed.
    pub n: u64,
    /// Start, goal, obstacle and base station, paper units.
    pub start: Vector2<f64>,
    /// See `start`.
    pub goal: Vector2<f64>,
    /// See `start`.
    pub obstacle: Vector2<f64>,
    /// Radius of the obstacle, units.
    pub radius: f64,
    /// See `start`.
    pub base_station: Vector2<f64>,
    /// B Δt.
    pub b_dt: f64,
    /// See [`solvable`].
    pub solvable: bool,
    /// Whether the policies passed the check.
    pub solved: bool,
    /// Why they did not, if so.
    pub refused: Option<String>,
    /// Attempts that it took.
    pub attempts: usize,
    /// The check.
    pub flown: ConstraintCheck,
    /// Time of optimisation and check, s; not in the table on disk, which is the same wherever it is made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall_s: Option<f64>,
}

/// Which worlds, and what decides what becomes of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RandomPlan {
    /// How many.
    pub worlds: u64,
    /// Seed that draws them.
    pub seed: u64,
    /// Fingerprint of the world model.
    pub world_model: String,
    /// Name of the code ([`crate::sources`]).
    pub code: String,
    /// Algorithm 1.
    pub config: OptimiseConfig,
}

impl RandomPlan {
    /// So many worlds of a seed.
    ///
    /// # Errors
    /// The world model has no fingerprint.
    pub fn new(model: &WorldModel, config: OptimiseConfig, worlds: u64, seed: u64) -> Result<Self> {
        let world_model = crpl_model::world_model::checkpoint::planning_fingerprint(model)?;
        Ok(Self { worlds, seed, world_model, code: crate::sources().into(), config })
    }
}

/// Optimises for those worlds of a plan that are in the shard and prints a row each, and how many were solved. With
/// `out`, the rows are kept there as they come, and those that are there are not made again.
///
/// # Errors
/// As [`optimise_for`]; a folder of another plan or shard, a file that cannot be written.
pub fn run(
    model: &Arc<WorldModel>,
    plan: &RandomPlan,
    shard: Shard,
    out: Option<&Path>,
    json: bool,
) -> Result<()> {
    let folder = out.map(|dir| RandomFolder::begin(dir, plan, shard)).transpose()?;
    let mut rows = match &folder {
        Some(folder) => folder.rows()?,
        None => Vec::new(),
    };
    if !json {
        put(HEAD);
    }
    rows.iter().try_for_each(|row| show(row, json))?;
    for n in (rows.len() as u64..).map(|k| k * shard.of + shard.number - 1).take_while(|n| *n < plan.worlds) {
        let row = one(model, plan, n)?;
        if let Some(folder) = &folder {
            folder.add(&row)?;
        }
        show(&row, json)?;
        rows.push(row);
    }
    let line = summary(plan, &rows);
    if json {
        eprintln!("{line}");
    } else {
        crpl_sitl::outln!("{line}");
    }
    Ok(())
}

/// World `n` and what becomes of it.
fn one(model: &Arc<WorldModel>, plan: &RandomPlan, n: u64) -> Result<RandomRow> {
    let scenario = world(plan.seed, n);
    let solvable = solvable(&scenario);
    // Where no controller can, one attempt is enough to see that the bound is one.
    let attempts = if solvable { plan.config.attempts } else { 1 };
    let config = OptimiseConfig { attempts, ..plan.config.clone() };
    let made = optimise_for(model, &scenario, &config, plan.seed, Begun::default(), &mut Quiet)?;
    let o = scenario.obstacle();
    Ok(RandomRow {
        n,
        start: scenario.start,
        goal: scenario.goal,
        obstacle: o.position,
        radius: o.radius,
        base_station: scenario.channel.base_station,
        b_dt: scenario.radio.b_dt,
        solvable,
        solved: made.flown.holds(),
        refused: made.flown.verdict().err().map(|error| error.to_string()),
        attempts: made.attempts,
        flown: made.flown,
        wall_s: Some(made.wall_s),
    })
}

fn show(row: &RandomRow, json: bool) -> Result<()> {
    if json {
        crpl_sitl::outln!("{}", serde_json::to_string(row)?);
        return Ok(());
    }
    put(&text(row));
    let width = columns::width();
    let say = |why: &String| crpl_sitl::out!("{}", columns::wrapped(&format!("       {why}"), 7, width));
    row.refused.iter().for_each(say);
    Ok(())
}

/// How many were solved, and the median time of those that were made now.
fn summary(plan: &RandomPlan, rows: &[RandomRow]) -> String {
    let solvable: Vec<&RandomRow> = rows.iter().filter(|row| row.solvable).collect();
    let solved = solvable.iter().filter(|row| row.solved).count();
    let beyond = rows.iter().filter(|row| row.solved && !row.solvable).count();
    let mut times: Vec<f64> = solvable.iter().filter_map(|row| row.wall_s).collect();
    times.sort_by(f64::total_cmp);
    let median = times.get(times.len() / 2);
    let median = median.map(|s| format!("; median of the solvable {s:.1} s")).unwrap_or_default();
    format!(
        "{} worlds of seed {}: {} solvable, {solved} of these solved, {beyond} solved beyond them{median}",
        rows.len(),
        plan.seed,
        solvable.len()
    )
}

/// What `random.toml` says.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RandomManifest {
    shard: String,
    plan: RandomPlan,
}

/// A table of random worlds on disk: `random.toml` says which, `worlds.jsonl` has a line for each.
#[derive(Debug)]
pub struct RandomFolder {
    dir: PathBuf,
    plan: RandomPlan,
    shard: Shard,
}

impl RandomFolder {
    /// Whether a folder holds random worlds.
    #[must_use]
    pub fn is_one(dir: &Path) -> bool {
        dir.join(MANIFEST).exists()
    }

    fn open(dir: &Path) -> Result<Self> {
        let path = dir.join(MANIFEST);
        let reading = || format!("reading {}", path.display());
        let text = std::fs::read_to_string(&path).with_context(reading)?;
        let RandomManifest { shard, plan } = toml::from_str(&text).with_context(reading)?;
        let shard = shard.parse().map_err(|error| anyhow::anyhow!("{}: shard {error}", path.display()))?;
        Ok(Self { dir: dir.into(), plan, shard })
    }

    fn begin(dir: &Path, plan: &RandomPlan, shard: Shard) -> Result<Self> {
        if Self::is_one(dir) {
            let there = Self::open(dir)?;
            if there.plan != *plan || there.shard != shard {
                bail!("{} holds other worlds or another shard: choose another --out", dir.display());
            }
            return Ok(there);
        }
        std::fs::create_dir_all(dir).with_context(|| format!("creating {}", dir.display()))?;
        let manifest = RandomManifest { shard: shard.to_string(), plan: plan.clone() };
        let path = dir.join(MANIFEST);
        write_whole(&path, toml::to_string(&manifest)?.as_bytes())
            .with_context(|| format!("writing {}", path.display()))?;
        Ok(Self { dir: dir.into(), plan: plan.clone(), shard })
    }

    /// The rows so far; a last line that was cut is dropped, and made again.
    fn rows(&self) -> Result<Vec<RandomRow>> {
        let path = self.dir.join(ROWS);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(error).with_context(|| format!("reading {}", path.display())),
        };
        let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
        if whole.len() < text.len() {
            write_whole(&path, whole.as_bytes()).with_context(|| format!("writing {}", path.display()))?;
        }
        let rows: Vec<RandomRow> = whole
            .lines()
            .enumerate()
            .map(|(n, line)| {
                serde_json::from_str(line).with_context(|| format!("{}, line {}", path.display(), n + 1))
            })
            .collect::<Result<_>>()?;
        let wanted = |k: usize| k as u64 * self.shard.of + self.shard.number - 1;
        match rows.iter().enumerate().find(|(k, row)| row.n != wanted(*k)) {
            Some((k, _)) => bail!("{}, line {}: is not world {}", path.display(), k + 1, wanted(k)),
            None => Ok(rows),
        }
    }

    fn add(&self, row: &RandomRow) -> Result<()> {
        let path = self.dir.join(ROWS);
        let line = serde_json::to_string(&RandomRow { wall_s: None, ..row.clone() })? + "\n";
        let file = std::fs::OpenOptions::new().create(true).append(true).open(&path);
        file.and_then(|mut file| file.write_all(line.as_bytes()))
            .with_context(|| format!("writing {}", path.display()))
    }
}

/// Joins the shards of random worlds into the table of one run, byte for byte, and prints it.
///
/// # Errors
/// Folders that are not all shards of one run, and files that cannot be written.
pub fn merge(dirs: &[PathBuf], out: &Path, json: bool) -> Result<()> {
    let folders = dirs.iter().map(|dir| RandomFolder::open(dir)).collect::<Result<Vec<_>>>()?;
    let Some(first) = folders.first() else { bail!("no shard") };
    if let Some(other) = folders.iter().find(|folder| folder.plan != first.plan) {
        let (a, b) = (first.dir.display(), other.dir.display());
        bail!("{a} and {b} are of different runs: compare their {MANIFEST}");
    }
    let named: Vec<(String, Shard)> =
        folders.iter().map(|folder| (folder.dir.display().to_string(), folder.shard)).collect();
    if let Some(lack) = Shard::lack(&named) {
        bail!(lack);
    }
    let mut rows = Vec::new();
    for folder in &folders {
        rows.extend(folder.rows()?);
    }
    rows.sort_by_key(|row| row.n);
    if let Some(n) = (0..first.plan.worlds).find(|n| rows.get(*n as usize).is_none_or(|row| row.n != *n)) {
        bail!("world {n} is missing: make its shard again, with the same command");
    }
    let whole = RandomFolder::begin(out, &first.plan, Shard::WHOLE)?;
    if whole.rows()?.is_empty() {
        rows.iter().try_for_each(|row| whole.add(row))?;
    }
    if !json {
        put(HEAD);
    }
    rows.iter().try_for_each(|row| show(row, json))?;
    if !json {
        crpl_sitl::outln!("{}", summary(&first.plan, &rows));
    }
    Ok(())
}

/// The plan of a folder of random worlds.
const MANIFEST: &str = "random.toml";
/// Its rows.
const ROWS: &str = "worlds.jsonl";

/// Names of the columns of [`text`].
const HEAD: &str = "  n  start         goal          obstacle      radius  base station  B dt   solvable  solved  attempt  P_safe  P_comm  reached  s";

/// Widths of these columns.
const COLUMNS: [usize; 14] = [3, 16, 15, 15, 8, 15, 7, 10, 8, 9, 8, 8, 9, 7];

fn put(line: &str) {
    crpl_sitl::out!("{}", columns::folded_line(line, &COLUMNS, columns::width()));
}

fn text(row: &RandomRow) -> String {
    let place = |r: Vector2<f64>| format!("({:.3}, {:.3})", r.x, r.y);
    let yes = |yes: bool| if yes { "yes" } else { "no" };
    format!(
        "{:>3}  {} {} {} {:<7.3} {} {:<6.3} {:<9} {:<7} {:<8} {:.4}  {:.4}  {:.4}   {}",
        row.n,
        place(row.start),
        place(row.goal),
        place(row.obstacle),
        row.radius,
        place(row.base_station),
        row.b_dt,
        yes(row.solvable),
        yes(row.solved),
        row.attempts,
        row.flown.safe.share,
        row.flown.comm.share,
        row.flown.reached.share,
        row.wall_s.map_or_else(|| "-".into(), |s| format!("{s:.1}"))
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_are_equal_for_equal_seeds_and_keep_their_ranges() {
        assert_eq!(world(3, 5), world(3, 5));
        assert_ne!(world(3, 5), world(4, 5));
        for n in 0..200 {
            let scenario = world(1, n);
            scenario.check().unwrap();
            assert!((scenario.goal - scenario.start).norm() >= LEAST_WAY);
            assert!(clearance(scenario.start, &scenario) >= LEAST_CLEARANCE);
        }
    }

    #[test]
    fn the_paper_s_scenarios_are_solvable_and_a_goal_without_link_is_not() {
        for number in [1, 2] {
            assert!(solvable(&Scenario::numbered(number).unwrap()));
        }
        let mut far = Scenario::default();
        far.channel.noise_power = 40.0;
        assert!(!solvable(&far));
        let slow = Scenario { horizon: 20, ..Scenario::default() };
        assert!(!solvable(&slow), "0.8 units at 0.04 an interval take more than 20 intervals with the start");
    }
}
