//! The world model, its observer, and CRPL's policies, on numpy arrays.

use std::path::PathBuf;
use std::sync::Arc;

use crpl_gcs::station::models::{MismatchRule, Models, PolicyUse};
use crpl_model::encoder::weights::LATENT;
use crpl_model::planning::policy::{Policies, features};
use crpl_model::predictor::observer::LatentObserver;
use crpl_model::predictor::{Memory, Predictor};
use crpl_model::world_model::{self, Latent, StationHeads, checkpoint};
use crpl_sitl::camera::{CHANNELS, Frame, SIDE};
use crpl_sitl::units::TxPower;
use nalgebra::Vector2;
use pyo3::buffer::PyBuffer;
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::arrays::{fill, refuse, rows, rows_of, scenario_of, wrong};

/// Shape of a picture.
const PICTURE: [usize; 3] = [SIDE, SIDE, CHANNELS];

/// Encoder, predictors, and heads.
#[pyclass(module = "crpl._crpl", frozen)]
pub struct WorldModel {
    pub(crate) model: Arc<world_model::WorldModel>,
}

fn pair(row: &[f32]) -> [f32; 2] {
    [row[0], row[1]]
}

fn vector(row: &[f64]) -> Vector2<f64> {
    Vector2::new(row[0], row[1])
}

/// `of` each picture, on all cores, in order.
fn each<T: Send>(py: Python<'_>, bytes: &[u8], of: impl Fn(&Frame) -> T + Sync) -> Vec<T> {
    py.detach(|| {
        let pictures = bytes.par_chunks_exact(PICTURE.iter().product());
        pictures.filter_map(|bytes| Frame::from_rgb(bytes.to_vec())).map(|frame| of(&frame)).collect()
    })
}

#[pymethods]
impl WorldModel {
    /// A built-in one, `centroid` or `learned`, or the folder of a checkpoint.
    #[staticmethod]
    fn load(py: Python<'_>, name: PathBuf) -> PyResult<Self> {
        let model = py.detach(|| world_model::WorldModel::named(&name)).map_err(wrong)?;
        Ok(Self { model: Arc::new(model) })
    }

    /// Latent units of z_c per unit of length.
    #[getter]
    fn scale(&self) -> f64 {
        self.model.scale
    }

    /// A name for the learned numbers.
    #[getter]
    fn fingerprint(&self) -> PyResult<String> {
        checkpoint::fingerprint(&self.model).map_err(wrong)
    }

    /// z_c and z_u of pictures, uint8 [N, 100, 100, 3] to float32 [N, 2, 16].
    fn encode(&self, py: Python<'_>, frames: PyBuffer<u8>, out: PyBuffer<f32>) -> PyResult<()> {
        let (bytes, _) = rows(py, "frames", &frames, &PICTURE)?;
        let latents = each(py, &bytes, |frame| self.model.encode(frame));
        let values: Vec<f32> = latents.iter().flat_map(|z| z.z_c.into_iter().chain(z.z_u)).collect();
        fill(py, &out, &values)
    }

    /// What the observer reads of pictures: y_c and y_u, float64 [N, 2, 2], and their standard deviations in units
    /// of 0.03 px, [N, 2].
    fn see(
        &self,
        py: Python<'_>,
        frames: PyBuffer<u8>,
        places: PyBuffer<f64>,
        errors: PyBuffer<f64>,
    ) -> PyResult<()> {
        let (bytes, _) = rows(py, "frames", &frames, &PICTURE)?;
        let seen = each(py, &bytes, |frame| self.model.see(frame));
        let told: Vec<f64> = seen.iter().flatten().flat_map(|reading| [reading.y.x, reading.y.y]).collect();
        let deviations: Vec<f64> = seen.iter().flatten().map(|reading| reading.sigma_scale).collect();
        fill(py, &places, &told)?;
        fill(py, &errors, &deviations)
    }

    /// From latents float32 [N, 2, 16] to their planes, y_c and y_u, float32 [N, 2, 2].
    fn plane(&self, py: Python<'_>, latents: PyBuffer<f32>, out: PyBuffer<f32>) -> PyResult<()> {
        let (values, _) = rows(py, "latents", &latents, &[2, LATENT])?;
        let half = |row: &[f32]| std::array::from_fn(|k| row[k]);
        let planes: Vec<f32> = (values.chunks_exact(2 * LATENT))
            .map(|row| Latent { z_c: half(&row[..LATENT]), z_u: half(&row[LATENT..]) })
            .flat_map(|latent| self.model.y_c(&latent).into_iter().chain(self.model.y_u(&latent)))
            .collect();
        fill(py, &out, &planes)
    }

    /// Where the model sees UAV and obstacle, from y_c and y_u float64 [N, 2, 2] to paper units: the probe.
    fn places(&self, py: Python<'_>, planes: PyBuffer<f64>, out: PyBuffer<f64>) -> PyResult<()> {
        let (values, _) = rows(py, "planes", &planes, &[2, 2])?;
        let probe = &self.model.probe;
        let places = values.chunks_exact(4).flat_map(|row| {
            let [c, u] = [probe.c.apply(vector(&row[..2])), probe.u.apply(vector(&row[2..]))];
            [c.x, c.y, u.x, u.y]
        });
        fill(py, &out, &places.collect::<Vec<f64>>())
    }

    /// The other way: from places in paper units, float64 [N, 2, 2], to y_c and y_u.
    fn planes_at(&self, py: Python<'_>, places: PyBuffer<f64>, out: PyBuffer<f32>) -> PyResult<()> {
        let (values, _) = rows(py, "places", &places, &[2, 2])?;
        let planes = values.chunks_exact(4).flat_map(|row| {
            let (c, u) = self.model.latents_at(vector(&row[..2]), vector(&row[2..]));
            [c[0], c[1], u[0], u[1]]
        });
        fill(py, &out, &planes.collect::<Vec<f32>>())
    }

    /// Rollouts of N flights: y of the next T intervals, float64 [N, T, 2], from `now` and `before` [N, 2] and actions
    /// [N, T, 2], shares of a_max. `obstacle`: of the uncontrollable half, on which no action works.
    fn predict(
        &self,
        py: Python<'_>,
        now: PyBuffer<f64>,
        before: PyBuffer<f64>,
        actions: PyBuffer<f64>,
        obstacle: bool,
        out: PyBuffer<f64>,
    ) -> PyResult<()> {
        let (now, n) = rows(py, "now", &now, &[2])?;
        let before = rows_of(py, "before", &before, n, &[2])?;
        let t = actions.shape().get(1).copied().unwrap_or_default();
        let actions = rows_of(py, "actions", &actions, n, &[t, 2])?;
        let predictor = if obstacle {
            Predictor::Linear(self.model.uncontrollable())
        } else {
            self.model.predictor.clone()
        };
        let mut ahead = vec![0.0; n * t * 2];
        py.detach(|| {
            let begins = now.par_chunks_exact(2).zip(before.par_chunks_exact(2));
            let flights =
                begins.zip(actions.par_chunks(2 * t.max(1))).zip(ahead.par_chunks_mut(2 * t.max(1)));
            flights.for_each(|(((now, before), actions), out)| {
                let (mut now, mut before, mut memory) = (vector(now), vector(before), Memory::default());
                for (a, out) in actions.chunks_exact(2).zip(out.chunks_exact_mut(2)) {
                    let a = if obstacle { Vector2::zeros() } else { vector(a) };
                    let next = predictor.step(&mut memory, now, before, a);
                    (before, now) = (now, next);
                    out.copy_from_slice(next.as_slice());
                }
            });
        });
        fill(py, &out, &ahead)
    }

    /// Predicted collision probability, float32 [N], of y_c and y_u float32 [N, 2, 2], in a scenario.
    fn risk(&self, py: Python<'_>, y: PyBuffer<f32>, scenario: &str, out: PyBuffer<f32>) -> PyResult<()> {
        let heads = self.model.station_heads(&scenario_of(scenario)?);
        head(py, &y, &out, |c, u| heads.collision(c, u))
    }

    /// Predicted channel gain |h|², float32 [N], of y_c and y_u float32 [N, 2, 2], in a scenario.
    fn gain(&self, py: Python<'_>, y: PyBuffer<f32>, scenario: &str, out: PyBuffer<f32>) -> PyResult<()> {
        let scenario = scenario_of(scenario)?;
        let untrained = StationHeads::untrained(&scenario);
        if !untrained.is_empty() {
            return refuse(format!(
                "the channel head was trained with other values of {}",
                untrained.join(", ")
            ));
        }
        let heads = self.model.station_heads(&scenario);
        head(py, &y, &out, |c, u| heads.log_gain(c, u).exp())
    }

    /// CRPL's policies for a scenario: the built-in ones that cover it, or those of a file.
    fn policy(&self, scenario: &str, file: Option<PathBuf>, any_world: bool) -> PyResult<NetworkPolicy> {
        let scenario = scenario_of(scenario)?;
        let models = Models::load(None, file).map_err(wrong)?;
        let mismatch = if any_world { MismatchRule::Allow } else { MismatchRule::Refuse };
        let models = Models { world: self.model.clone(), mismatch, ..models };
        let chosen = models.policies(&scenario, PolicyUse::Fly).map_err(wrong)?;
        let (scale, v_max) = (self.model.scale as f32, scenario.dynamics.v_max as f32);
        Ok(NetworkPolicy { policies: chosen.policies, source: chosen.origin.source, scale, v_max })
    }

    /// An observer of one flight in a scenario.
    fn observer(&self, scenario: &str) -> PyResult<Observer> {
        let scenario = scenario_of(scenario)?;
        let window = usize::try_from(scenario.observer.window).unwrap_or(usize::MAX);
        let window = window.max(self.model.least_window());
        let motions = self.model.motions(scenario.dynamics.v_max, scenario.disturbance.gust_std());
        let halves = motions.map(|motion| LatentObserver::new(motion, window));
        Ok(Observer { model: self.model.clone(), halves })
    }
}

/// `of` each row of y.
fn head(
    py: Python<'_>,
    y: &PyBuffer<f32>,
    out: &PyBuffer<f32>,
    of: impl Fn([f32; 2], [f32; 2]) -> f32,
) -> PyResult<()> {
    let (y, _) = rows(py, "y", y, &[2, 2])?;
    let values: Vec<f32> = y.chunks_exact(4).map(|row| of(pair(&row[..2]), pair(&row[2..]))).collect();
    fill(py, out, &values)
}

/// π_s and π_p.
#[pyclass(module = "crpl._crpl", frozen)]
pub struct NetworkPolicy {
    policies: Policies,
    source: String,
    scale: f32,
    v_max: f32,
}

#[pymethods]
impl NetworkPolicy {
    /// Where they come from.
    #[getter]
    fn source(&self) -> &str {
        &self.source
    }

    /// The actions, float32 [N, 3], for y_c, y_c one interval ago and y_u, float32 [N, 2] each.
    fn act(
        &self,
        py: Python<'_>,
        y_c: PyBuffer<f32>,
        y_c_before: PyBuffer<f32>,
        y_u: PyBuffer<f32>,
        out: PyBuffer<f32>,
    ) -> PyResult<()> {
        let (now, n) = rows(py, "y_c", &y_c, &[2])?;
        let before = rows_of(py, "y_c_before", &y_c_before, n, &[2])?;
        let obstacle = rows_of(py, "y_u", &y_u, n, &[2])?;
        let flights = now.chunks_exact(2).zip(before.chunks_exact(2)).zip(obstacle.chunks_exact(2));
        let actions = flights.flat_map(|((now, before), u)| {
            let x = features(pair(now), pair(before), pair(u), self.scale, self.v_max);
            let (motion, power) = self.policies.act(&x);
            let a = motion.vector();
            [a.x as f32, a.y as f32, if power == TxPower::High { 1.0 } else { -1.0 }]
        });
        fill(py, &out, &actions.collect::<Vec<f32>>())
    }
}

/// Place and speed in latents, from the pictures and the actions of one flight.
#[pyclass(module = "crpl._crpl")]
pub struct Observer {
    model: Arc<world_model::WorldModel>,
    halves: [LatentObserver; 2],
}

#[pymethods]
impl Observer {
    /// Takes in a picture uint8 [100, 100, 3] and the accelerations flown since the last one, float64 [K, 2], shares of
    /// a_max. Gives y_c, y_c one interval ago, and y_u, float64 [3, 2].
    fn observe(
        &mut self,
        py: Python<'_>,
        frame: PyBuffer<u8>,
        flown: PyBuffer<f64>,
        out: PyBuffer<f64>,
    ) -> PyResult<()> {
        let bytes = if frame.shape() == PICTURE { frame.to_vec(py)? } else { Vec::new() };
        let Some(frame) = Frame::from_rgb(bytes) else {
            return refuse(format!("the picture has shape {:?}, not {PICTURE:?}", frame.shape()));
        };
        let (flown, n) = rows(py, "flown", &flown, &[2])?;
        let flown: Vec<Vector2<f64>> = flown.chunks_exact(2).map(vector).collect();
        let [c, u] = py.detach(|| self.model.see(&frame));
        let [uav, obstacle] = &mut self.halves;
        uav.observe(c, &flown);
        obstacle.observe(u, &vec![Vector2::zeros(); n]);
        let (Some(c), Some(u)) = (uav.estimate(), obstacle.estimate()) else {
            return refuse("nothing was seen".into());
        };
        fill(py, &out, [c.y, c.before(), u.y].map(|y| [y.x, y.y]).as_flattened())
    }
}
