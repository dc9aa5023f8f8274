//! A fleet of vehicles on one base station, flown by actions of Python.

use crpl_gcs::lab::environment::fleet::{FleetReport, OpenFleet};
use crpl_gcs::lab::environment::{ACTION, FlightView, OpenFlight};
use crpl_gcs::lab::fleet::FleetPlan;
use crpl_gcs::lab::fleet::scheduler::Scheduler;
use pyo3::buffer::PyBuffer;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{fill, refuse, rows_of, scenario_of, wrong};
use crate::flights::{FLAGS, NUMBERS, flags_of, numbers_of, view_of};
use crate::lab::score_columns;
use crate::world::WorldModel;

/// Flags of a turn: those of a step, and whether the vehicle met another.
const TURN_FLAGS: usize = FLAGS + 1;

/// Several vehicles that share a base station's bandwidth and the field.
#[pyclass(module = "crpl._crpl")]
pub struct Fleet {
    fleet: OpenFleet,
}

#[pymethods]
impl Fleet {
    #[new]
    #[pyo3(signature = (scenario, view, vehicles, scheduler, bandwidth, headway, separate, drawn, seed, world=None))]
    #[expect(clippy::too_many_arguments, reason = "Python's side names them")]
    fn new(
        py: Python<'_>,
        scenario: &str,
        view: &str,
        vehicles: usize,
        scheduler: &str,
        bandwidth: Option<f64>,
        headway: u64,
        separate: bool,
        drawn: bool,
        seed: u64,
        world: Option<&WorldModel>,
    ) -> PyResult<Self> {
        let scenario = scenario_of(scenario)?;
        let view = view_of(view, world)?;
        let Some(scheduler) = Scheduler::ALL.into_iter().find(|s| s.name() == scheduler) else {
            let names = Scheduler::ALL.map(Scheduler::name).join(", ");
            return refuse(format!("the scheduler is {scheduler:?}: one of {names}"));
        };
        let b_dt = bandwidth.unwrap_or(4.0 * scenario.radio.b_dt);
        let plan = FleetPlan { vehicles, scheduler, b_dt, headway, separate, drawn };
        let fleet = py.detach(|| OpenFleet::new(&scenario, &view, &plan, seed)).map_err(wrong)?;
        Ok(Self { fleet })
    }

    /// Numbers of one vehicle's observation.
    #[getter]
    fn width(&self) -> usize {
        self.fleet.width()
    }

    /// Begins anew.
    fn reset(&mut self, py: Python<'_>, seed: u64) {
        py.detach(|| self.fleet.reset(seed));
    }

    /// Writes what all vehicles see now: float32 [n, width] or, of pictures, uint8 [n, 100, 100, 3].
    fn show(&self, py: Python<'_>, now: &Bound<'_, PyAny>) -> PyResult<()> {
        let size = self.fleet.count() * self.fleet.width();
        match self.fleet.view() {
            FlightView::Picture => {
                let mut shown = vec![0u8; size];
                py.detach(|| self.fleet.show_pictures(&mut shown));
                fill(py, &now.extract()?, &shown)
            }
            FlightView::State | FlightView::Latent(_) => {
                let mut shown = vec![0f32; size];
                py.detach(|| self.fleet.show_numbers(&mut shown));
                fill(py, &now.extract()?, &shown)
            }
        }
    }

    /// One turn. `actions` float32 [n, 3]; `numbers` float64 [n, 3] and `flags` uint8 [n, 6] take the report.
    fn step(
        &mut self,
        py: Python<'_>,
        actions: PyBuffer<f32>,
        numbers: PyBuffer<f64>,
        flags: PyBuffer<u8>,
    ) -> PyResult<()> {
        let actions = rows_of(py, "actions", &actions, self.fleet.count(), &[ACTION])?;
        if actions.iter().any(|a| !a.is_finite()) {
            return refuse("an action is not a finite number".into());
        }
        let (actions, _) = actions.as_chunks::<ACTION>();
        let reports = py.detach(|| self.fleet.step(actions));
        let told: Vec<[f64; NUMBERS]> = reports.iter().map(|r| numbers_of(&r.step)).collect();
        fill(py, &numbers, told.as_flattened())?;
        let of = |r: &FleetReport| -> [u8; TURN_FLAGS] {
            let step = flags_of(&r.step);
            std::array::from_fn(|n| step.get(n).copied().unwrap_or_else(|| u8::from(r.met)))
        };
        let told: Vec<[u8; TURN_FLAGS]> = reports.iter().map(of).collect();
        fill(py, &flags, told.as_flattened())
    }

    /// Which vehicles are in the air in the coming turn.
    fn airborne(&self) -> Vec<bool> {
        (0..self.fleet.count()).map(|n| self.fleet.is_airborne(n)).collect()
    }

    /// Collisions of two vehicles so far, and the least distance of two, units.
    fn encounters(&self) -> (u64, f64) {
        self.fleet.encounters()
    }

    /// The metrics of a vehicle that has flown, as columns of one row.
    fn score<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Bound<'py, PyDict>> {
        match self.fleet.score(index) {
            Some(score) => score_columns(py, &[score]),
            None => refuse(format!("vehicle {index} has not flown")),
        }
    }

    /// The records of a vehicle so far: JSON, a line an interval, as in `record.jsonl`.
    fn records(&self, index: usize) -> PyResult<String> {
        crate::lab::lines(self.fleet.flight(index).map_or(&[][..], OpenFlight::records))
    }
}
