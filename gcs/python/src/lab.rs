//! Flights of the built-in controllers, their metrics, statistics, and recordings.

use std::path::PathBuf;

use crpl_gcs::flight::Crew;
use crpl_gcs::lab::Contender;
use crpl_gcs::lab::record::folder::RecordingFolder;
use crpl_gcs::lab::record::recorder::{Recorder, RecordingPlan};
use crpl_gcs::station::models::{MismatchRule, Models, cache_folder};
use crpl_gcs::station::pilot::Controller;
use crpl_model::numeric::statistics::{self, Mean, Resamples};
use crpl_model::world_model::recording::RecordingFormat;
use crpl_sitl::Sim;
use crpl_sitl::scenario::presets::PRESETS;
use crpl_sitl::sim::metric::{FlightOutcome, FlightScore, Metric};
use crpl_sitl::sim::record::Record;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;

use crate::arrays::{refuse, scenario_of, wrong};

/// Git revision of the sources from which this was compiled.
#[pyfunction]
pub fn revision() -> &'static str {
    crpl_gcs::revision()
}

/// Names of the presets, each with a line about it.
#[pyfunction]
pub fn presets() -> Vec<(&'static str, &'static str)> {
    PRESETS.iter().map(|preset| (preset.name, preset.about)).collect()
}

/// All parameters of a scenario as JSON: of a preset's name, a TOML file, or a JSON object of what differs from the
/// paper. `camera` replaces its camera.
#[pyfunction]
pub fn scenario(source: &str, camera: Option<&str>) -> PyResult<String> {
    let mut scenario = scenario_of(source)?;
    if let Some(camera) = camera {
        scenario.film_with(camera).map_err(wrong)?;
    }
    serde_json::to_string(&scenario).map_err(wrong)
}

/// The metrics: key, symbol, title, unit, least denominator of a ratio, and whether reports compare it.
#[pyfunction]
pub fn metrics() -> Vec<(&'static str, &'static str, String, &'static str, f64, bool)> {
    let compared: Vec<Metric> = Metric::compared().collect();
    let about = |m: Metric| (m.key(), m.symbol(), m.title(), m.unit(), m.floor(), compared.contains(&m));
    Metric::ALL.map(about).into()
}

/// Scores of flights as columns by key: `ticks`, the metrics, the outcomes.
pub fn score_columns<'py>(py: Python<'py>, scores: &[FlightScore]) -> PyResult<Bound<'py, PyDict>> {
    let columns = PyDict::new(py);
    columns.set_item("ticks", scores.iter().map(|s| s.ticks).collect::<Vec<_>>())?;
    for metric in Metric::ALL {
        columns.set_item(metric.key(), scores.iter().map(|s| s[metric]).collect::<Vec<_>>())?;
    }
    for outcome in FlightOutcome::ALL {
        columns.set_item(outcome.key(), scores.iter().map(|s| s.is(outcome)).collect::<Vec<_>>())?;
    }
    Ok(columns)
}

/// Records as JSON, a line an interval.
pub fn lines(records: &[Record]) -> PyResult<String> {
    let mut text = String::new();
    for record in records {
        text += &serde_json::to_string(record).map_err(wrong)?;
        text.push('\n');
    }
    Ok(text)
}

/// A built-in controller that is ready to fly.
fn contender(
    controller: &str,
    scenario: &str,
    checkpoint: Option<PathBuf>,
    policy: Option<PathBuf>,
    any_world: bool,
) -> PyResult<Contender> {
    let controller: Controller = serde_json::from_value(controller.into()).map_err(wrong)?;
    let models = Models::load(checkpoint.as_deref(), policy).map_err(wrong)?;
    let mismatch = if any_world { MismatchRule::Allow } else { MismatchRule::Refuse };
    let models = Models { mismatch, cache: cache_folder(), ..models };
    Contender::new(&models, controller, &scenario_of(scenario)?).map_err(wrong)
}

/// Flies a built-in controller on these seeds, on all cores: the scores as columns.
#[pyfunction]
#[pyo3(signature = (controller, scenario, seeds, checkpoint=None, policy=None, any_world=false))]
pub fn fly<'py>(
    py: Python<'py>,
    controller: &str,
    scenario: &str,
    seeds: Vec<u64>,
    checkpoint: Option<PathBuf>,
    policy: Option<PathBuf>,
    any_world: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let contender = contender(controller, scenario, checkpoint, policy, any_world)?;
    let scores =
        py.detach(|| seeds.par_iter().map(|seed| contender.fly(*seed)).collect::<Result<Vec<_>, _>>());
    score_columns(py, &scores.map_err(wrong)?)
}

/// The records of one flight of a built-in controller: JSON, a line an interval.
#[pyfunction]
#[pyo3(signature = (controller, scenario, seed, checkpoint=None, policy=None, any_world=false))]
pub fn records(
    py: Python<'_>,
    controller: &str,
    scenario: &str,
    seed: u64,
    checkpoint: Option<PathBuf>,
    policy: Option<PathBuf>,
    any_world: bool,
) -> PyResult<String> {
    let contender = contender(controller, scenario, checkpoint, policy, any_world)?;
    lines(&py.detach(|| contender.records(seed)).map_err(wrong)?)
}

fn ends(Mean { mean, ci, .. }: Mean) -> [f64; 3] {
    [mean, ci[0], ci[1]]
}

/// Mean, and the ends of its 95 % interval by the bootstrap.
#[pyfunction]
pub fn mean(values: Vec<f64>) -> [f64; 3] {
    ends(Mean::of(&values))
}

/// Ratio of the means of pairs, mean(a) / max(mean(b), floor), and the ends of its 95 % interval by the bootstrap.
#[pyfunction]
pub fn ratio(a: Vec<f64>, b: Vec<f64>, floor: f64) -> Option<[f64; 3]> {
    Resamples::of(a.len()).ratio(&a, &b, floor).map(ends)
}

/// Wilson's 95 % interval of a share.
#[pyfunction]
pub fn wilson(hits: usize, n: usize) -> [f64; 2] {
    statistics::wilson(hits, n)
}

/// Makes a folder for a recording, which holds none unless that is to be replaced or goes on. Gives the number of the
/// next episode.
#[pyfunction]
pub fn claim(dir: PathBuf, scenario: &str, overwrite: bool, resume: bool) -> PyResult<usize> {
    let folder = RecordingFolder::claim(&dir, overwrite, resume).map_err(wrong)?;
    folder.begin(&scenario_of(scenario)?).map_err(wrong)?;
    Ok(folder.next())
}

/// Records exploratory flights in process, as `gcs record` does over a link, until the folder holds `episodes`; each
/// episode is a flight with a seed and a camera of its own. Gives the number of episodes in the folder.
#[pyfunction]
pub fn explore(
    py: Python<'_>,
    dir: PathBuf,
    scenario: &str,
    episodes: usize,
    pictures: usize,
    seed: u64,
    png: bool,
) -> PyResult<usize> {
    let scenario = scenario_of(scenario)?;
    if pictures < 3 {
        return refuse(format!("an episode has at least 3 pictures, not {pictures}"));
    }
    let format = if png { RecordingFormat::Png } else { RecordingFormat::Safetensors };
    loop {
        let folder = RecordingFolder::claim(&dir, false, true).map_err(wrong)?;
        let index = folder.next();
        if index >= episodes {
            return Ok(index);
        }
        let plan = RecordingPlan { episodes: index + 1, pictures, seed, format };
        let mut recorder = Recorder::new(&scenario, plan, folder);
        let mut sim = Sim::new(scenario.clone(), seed.wrapping_add(index as u64));
        recorder.begin().map_err(wrong)?;
        py.detach(|| {
            while !recorder.is_done() {
                let command = recorder.command(&sim.percept());
                recorder.sent();
                sim.handle(command);
                sim.advance();
            }
        });
        if let (_, Some(failed)) = recorder.land() {
            return refuse(failed);
        }
        py.check_signals()?;
    }
}
