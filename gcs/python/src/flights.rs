//! Flights side by side, flown by actions of Python.

use std::path::PathBuf;

use crpl_gcs::lab::environment::batch::{Autoreset, FlightBatch, StepReport};
use crpl_gcs::lab::environment::{ACTION, FlightView, OpenFlight, PICTURE, ShownNumber};
use crpl_model::world_model::recording::RecordingFormat;
use crpl_sitl::camera::{CHANNELS, Frame, SIDE};
use pyo3::buffer::{Element, PyBuffer};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::arrays::{fill, refuse, rows, rows_of, scenario_of, wrong};
use crate::lab::score_columns;
use crate::world::WorldModel;

/// Numbers of a step: reward, SNR in dB, p_coll.
pub const NUMBERS: usize = 3;
/// Flags of a step: terminated, truncated, flown, outage, collided.
pub const FLAGS: usize = 5;

/// The numbers of a report.
pub fn numbers_of(r: &StepReport) -> [f64; NUMBERS] {
    [r.reward, f64::from(r.snr_db), r.p_coll]
}

/// The flags of a report.
pub fn flags_of(r: &StepReport) -> [u8; FLAGS] {
    [r.terminated, r.truncated, r.flown, r.outage, r.collided].map(u8::from)
}

/// What flights show, by its name in Python; latents are of `world`.
pub fn view_of(view: &str, world: Option<&WorldModel>) -> PyResult<FlightView> {
    match (view, world) {
        ("state", _) => Ok(FlightView::State),
        ("image", _) => Ok(FlightView::Picture),
        ("latent", Some(world)) => Ok(FlightView::Latent(world.model.clone())),
        _ => refuse(format!("{view:?} is neither state, latent nor image")),
    }
}

/// What flights show, before it is copied to Python.
#[derive(Default)]
struct ViewBuffers<T> {
    now: Vec<T>,
    last: Vec<T>,
}

impl<T: Copy + Default> ViewBuffers<T> {
    fn new(size: usize, keeps_last: bool) -> Self {
        Self { now: vec![T::default(); size], last: vec![T::default(); if keeps_last { size } else { 0 }] }
    }
}

/// By the type of what is shown.
enum Buffers {
    Numbers(ViewBuffers<f32>),
    Bytes(ViewBuffers<u8>),
}

/// Many flights in one scenario, stepped in one call.
#[pyclass(module = "crpl._crpl")]
pub struct Flights {
    batch: FlightBatch,
    reports: Vec<StepReport>,
    buffers: Buffers,
    pool: Option<ThreadPool>,
}

#[pymethods]
impl Flights {
    #[new]
    #[pyo3(signature = (scenario, view, seeds, autoreset, threads, world=None))]
    fn new(
        py: Python<'_>,
        scenario: &str,
        view: &str,
        seeds: Vec<u64>,
        autoreset: &str,
        threads: usize,
        world: Option<&WorldModel>,
    ) -> PyResult<Self> {
        let scenario = scenario_of(scenario)?;
        let view = view_of(view, world)?;
        let autoreset = match autoreset {
            "next-step" => Autoreset::NextStep,
            "same-step" => Autoreset::SameStep,
            "disabled" => Autoreset::Disabled,
            _ => return refuse(format!("{autoreset:?} is neither next-step, same-step nor disabled")),
        };
        let pool = match threads {
            1 => None,
            n => Some(ThreadPoolBuilder::new().num_threads(n).build().map_err(wrong)?),
        };
        let reports = vec![StepReport::default(); seeds.len()];
        let batch = py.detach(|| FlightBatch::new(scenario, view, autoreset, &seeds));
        let (size, keeps_last) = (view_size(&batch), autoreset == Autoreset::SameStep);
        let buffers = match batch.view() {
            FlightView::Picture => Buffers::Bytes(ViewBuffers::new(size, keeps_last)),
            FlightView::State | FlightView::Latent(_) => Buffers::Numbers(ViewBuffers::new(size, keeps_last)),
        };
        Ok(Self { batch, reports, buffers, pool })
    }

    /// Numbers of one observation.
    #[getter]
    fn width(&self) -> usize {
        self.batch.view().width(self.batch.scenario())
    }

    /// Seeds of the flights in progress.
    fn seeds(&self) -> Vec<u64> {
        (0..self.batch.count()).filter_map(|index| self.batch.seed(index)).collect()
    }

    /// Begins a flight anew.
    fn reset(&mut self, index: usize, seed: u64) -> PyResult<()> {
        self.check(index)?;
        self.batch.reset(index, seed);
        Ok(())
    }

    /// Writes what all flights show now: float32 or, of pictures, uint8.
    fn show(&mut self, py: Python<'_>, now: &Bound<'_, PyAny>) -> PyResult<()> {
        match &mut self.buffers {
            Buffers::Numbers(buffers) => {
                py.detach(|| self.batch.show(&mut buffers.now));
                fill(py, &now.extract()?, &buffers.now)
            }
            Buffers::Bytes(buffers) => {
                py.detach(|| self.batch.show(&mut buffers.now));
                fill(py, &now.extract()?, &buffers.now)
            }
        }
    }

    /// One interval of all flights. `actions` float32 [n, 3]; `now` and `last` as [`Flights::show`]; `numbers` float64
    /// [n, 3] and `flags` uint8 [n, 5] take the report.
    fn step(
        &mut self,
        py: Python<'_>,
        actions: PyBuffer<f32>,
        now: &Bound<'_, PyAny>,
        last: Option<&Bound<'_, PyAny>>,
        numbers: PyBuffer<f64>,
        flags: PyBuffer<u8>,
    ) -> PyResult<()> {
        let actions = rows_of(py, "actions", &actions, self.batch.count(), &[ACTION])?;
        if actions.iter().any(|a| !a.is_finite()) {
            return refuse("an action is not a finite number".into());
        }
        let Self { batch, reports, buffers, pool } = self;
        let flown = InFlight { batch, reports, pool: pool.as_ref(), actions: &actions };
        match buffers {
            Buffers::Numbers(buffers) => flown.step(py, buffers, now, last)?,
            Buffers::Bytes(buffers) => flown.step(py, buffers, now, last)?,
        }
        let told: Vec<[f64; NUMBERS]> = self.reports.iter().map(numbers_of).collect();
        fill(py, &numbers, told.as_flattened())?;
        let told: Vec<[u8; FLAGS]> = self.reports.iter().map(flags_of).collect();
        fill(py, &flags, told.as_flattened())
    }

    /// The metrics of the flights that ended last at these places, as columns.
    fn scores<'py>(&self, py: Python<'py>, indices: Vec<usize>) -> PyResult<Bound<'py, PyDict>> {
        let scores = indices.iter().filter_map(|index| self.batch.score(*index)).copied().collect::<Vec<_>>();
        if scores.len() != indices.len() {
            return refuse("a flight has not ended yet".into());
        }
        score_columns(py, &scores)
    }

    /// The records of a flight so far: JSON, a line an interval, as in `record.jsonl`.
    fn records(&self, index: usize) -> PyResult<String> {
        self.check(index)?;
        let records = self.batch.flight(index).map_or(&[][..], OpenFlight::records);
        crate::lab::lines(records)
    }

    /// Writes a flight as an episode of a recording. `pictures` uint8 [k, 100, 100, 3] are those of its ticks from 0 on.
    fn save_episode(
        &self,
        py: Python<'_>,
        index: usize,
        pictures: PyBuffer<u8>,
        dir: PathBuf,
        episode: usize,
        png: bool,
    ) -> PyResult<()> {
        self.check(index)?;
        let (bytes, _) = rows(py, "pictures", &pictures, &[SIDE, SIDE, CHANNELS])?;
        let frames: Vec<Frame> =
            bytes.chunks_exact(PICTURE).filter_map(|bytes| Frame::from_rgb(bytes.to_vec())).collect();
        let Some(flight) = self.batch.flight(index) else { return Ok(()) };
        let (recorded, truth) = flight.recorded(frames);
        let format = if png { RecordingFormat::Png } else { RecordingFormat::Safetensors };
        truth.save(&dir, episode).map_err(wrong)?;
        recorded.save_as(format, &dir, episode).map_err(wrong)
    }
}

impl Flights {
    fn check(&self, index: usize) -> PyResult<()> {
        let n = self.batch.count();
        if index < n { Ok(()) } else { refuse(format!("there is no flight {index} of {n}")) }
    }
}

/// Numbers of all observations of a batch.
fn view_size(batch: &FlightBatch) -> usize {
    batch.count() * batch.view().width(batch.scenario())
}

/// A step that is about to be flown.
struct InFlight<'a> {
    batch: &'a mut FlightBatch,
    reports: &'a mut [StepReport],
    pool: Option<&'a ThreadPool>,
    actions: &'a [f32],
}

impl InFlight<'_> {
    fn step<T: ShownNumber + Element>(
        self,
        py: Python<'_>,
        buffers: &mut ViewBuffers<T>,
        now: &Bound<'_, PyAny>,
        last: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let Self { batch, reports, pool, actions } = self;
        let shown = &mut *buffers;
        py.detach(|| {
            let last = (!shown.last.is_empty()).then_some(&mut shown.last[..]);
            match pool {
                Some(pool) => pool.install(|| batch.step(actions, reports, &mut shown.now, last, true)),
                None => batch.step(actions, reports, &mut shown.now, last, false),
            }
        });
        fill(py, &now.extract()?, &buffers.now)?;
        last.map_or(Ok(()), |last| fill(py, &last.extract()?, &buffers.last))
    }
}
