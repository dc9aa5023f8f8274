//! Latents of the next interval from those of the last two and an action.
//!
//! [`Predictor`] is one of a closed set behind one [`step`](Predictor::step): the linear one of the paper
//! (Sec. IV-A2, Eq. (31)), the MLP and LSTM that Sec. IV-B compares it with, and the linear one inside learned
//! bounds. Each of them predicts the controllable half in plane coordinates; the uncontrollable half, on which no action works, is linear.
//!
//! To add one: a file that has what [`linear`] or [`mlp`] has, and its arms here.

pub mod bounded;
pub mod linear;
pub mod lstm;
pub mod mlp;
pub mod observer;
pub mod residual;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rayon::prelude::*;
use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};

use crate::encoder::BuiltIn;
use crate::numeric::kernel::LANES;
use crate::numeric::mlp::{Dense, Mlp};
use crate::numeric::tensors::{self, Reader, TensorError, Writer};
use crate::predictor::bounded::{Bounded, BoundedMemory, Bounds};
use crate::predictor::linear::{Displacement, Pair, PlaneLinear};
use crate::predictor::lstm::{Lstm, LstmMemory};
use crate::predictor::mlp::{MlpMemory, SiluMlp};
use crate::predictor::residual::{Cell, INPUTS, Residual, Scaling};

/// Which predictor.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PredictorKind {
    /// The linear second-order predictor, part of every checkpoint.
    #[default]
    Linear,
    /// Two hidden SiLU layers.
    Mlp,
    /// One recurrent layer.
    Lstm,
    /// The linear one inside a longest step and a box that were learned.
    Bounded,
}

impl PredictorKind {
    /// All, in the order of the tables.
    pub const ALL: [Self; 4] = [Self::Linear, Self::Mlp, Self::Lstm, Self::Bounded];

    /// Those that are trained by gradient and stand in [`PREDICTORS`], in the file's order.
    pub const NETWORKS: [Self; 2] = [Self::Mlp, Self::Lstm];

    /// The name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Mlp => "mlp",
            Self::Lstm => "lstm",
            Self::Bounded => "bounded",
        }
    }

    /// Whether it is the default, which a configuration does not name.
    #[must_use]
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// How the controllable half moves, plane coordinates.
#[derive(Debug, Clone, PartialEq)]
pub enum Predictor {
    /// Ψ_0 y_k + Ψ_1 y_{k-1} + Ψ_a a_k
    Linear(PlaneLinear),
    /// Constant velocity and what an MLP adds.
    Mlp(Residual<SiluMlp>),
    /// Constant velocity and what an LSTM adds.
    Lstm(Residual<Lstm>),
    /// Constant velocity and action inside bounds.
    Bounded(Bounded),
}

/// What a predictor carries along its rollouts, and what their backward pass reads again. A rollout begins
/// with an empty one.
#[derive(Debug, Clone, Default)]
pub struct Memory {
    mlp: MlpMemory,
    lstm: LstmMemory,
    bounded: BoundedMemory,
}

/// Where a rollout begins and what is flown.
#[derive(Debug, Clone, Copy)]
pub struct Begin<'a> {
    /// y_k, latent units.
    pub now: Vector2<f64>,
    /// y_{k-1}, latent units.
    pub before: Vector2<f64>,
    /// a_k, a_{k+1}, ...: accelerations in units of a_max.
    pub actions: &'a [Vector2<f64>],
}

impl Predictor {
    /// The predictor of this kind; `None` if `networks` lacks it.
    #[must_use]
    pub fn of(kind: PredictorKind, linear: PlaneLinear, networks: &Networks) -> Option<Self> {
        match kind {
            PredictorKind::Linear => Some(Self::Linear(linear)),
            PredictorKind::Mlp | PredictorKind::Lstm => {
                networks.all.iter().find(|p| p.kind() == kind).cloned()
            }
            PredictorKind::Bounded => networks.bounds.map(|bounds| Self::Bounded(Bounded { linear, bounds })),
        }
    }

    /// Its kind.
    #[must_use]
    pub fn kind(&self) -> PredictorKind {
        match self {
            Self::Linear(_) => PredictorKind::Linear,
            Self::Mlp(_) => PredictorKind::Mlp,
            Self::Lstm(_) => PredictorKind::Lstm,
            Self::Bounded(_) => PredictorKind::Bounded,
        }
    }

    /// y_{k+1} from y_k, y_{k-1} (latent units) and a_k (in units of a_max).
    #[must_use]
    pub fn step(
        &self,
        memory: &mut Memory,
        now: Vector2<f64>,
        before: Vector2<f64>,
        a: Vector2<f64>,
    ) -> Vector2<f64> {
        let mut states = [[now, before]];
        self.advance(memory, &mut states, |_| a);
        states[0][0]
    }

    /// One step of at most [`LANES`] rollouts, each given as `[y_k, y_{k-1}]`, in place.
    fn advance(
        &self,
        memory: &mut Memory,
        states: &mut [[Vector2<f64>; 2]],
        actions: impl Fn(usize) -> Vector2<f64>,
    ) {
        match self {
            Self::Linear(linear) => {
                for (n, [now, before]) in states.iter_mut().enumerate() {
                    (*now, *before) = (linear.step(*now, *before, actions(n)), *now);
                }
            }
            Self::Mlp(p) => p.advance(&mut memory.mlp, states, actions),
            Self::Lstm(p) => p.advance(&mut memory.lstm, states, actions),
            Self::Bounded(p) => p.advance(&mut memory.bounded, states, actions),
        }
    }

    /// y_c after each action of one rollout.
    #[must_use]
    pub fn rollout(&self, begin: Begin<'_>) -> Vec<Vector2<f64>> {
        self.block(&[begin]).swap_remove(0)
    }

    /// y_c after each action of each rollout, on all cores.
    #[must_use]
    pub fn rollouts(&self, begins: &[Begin<'_>]) -> Vec<Vec<Vector2<f64>>> {
        let blocks: Vec<_> = begins.par_chunks(LANES).map(|block| self.block(block)).collect();
        blocks.into_iter().flatten().collect()
    }

    /// At most [`LANES`] rollouts side by side.
    fn block(&self, begins: &[Begin<'_>]) -> Vec<Vec<Vector2<f64>>> {
        let mut paths: Vec<Vec<Vector2<f64>>> = vec![Vec::new(); begins.len()];
        let mut states: Vec<[Vector2<f64>; 2]> = begins.iter().map(|b| [b.now, b.before]).collect();
        let longest = begins.iter().map(|b| b.actions.len()).max().unwrap_or(0);
        let mut memory = Memory::default();
        for k in 0..longest {
            let action = |n: usize| begins[n].actions.get(k).copied().unwrap_or_default();
            self.advance(&mut memory, &mut states, action);
            for ((path, [now, _]), begin) in paths.iter_mut().zip(&states).zip(begins) {
                if k < begin.actions.len() {
                    path.push(*now);
                }
            }
        }
        paths
    }

    /// The step from y_k at velocity v = y_k - y_{k-1}, and its slopes. An LSTM's memory is empty.
    #[must_use]
    pub fn displacement(&self, y: Vector2<f64>, v: Vector2<f64>, a: Vector2<f64>) -> Displacement {
        match self {
            Self::Linear(linear) => linear.displacement(y, v, a),
            Self::Mlp(p) => p.displacement(y, v, a),
            Self::Lstm(p) => p.displacement(y, v, a),
            Self::Bounded(p) => p.displacement(y, v, a),
        }
    }

    /// y_{k+1} of [`LANES`] rollouts, remembered for the backward pass.
    #[inline(always)]
    #[must_use]
    pub fn forward(&self, memory: &mut Memory, now: &Pair, before: &Pair, a: &Pair) -> Pair {
        match self {
            Self::Linear(linear) => linear.forward(now, before, a),
            Self::Mlp(p) => p.forward(&mut memory.mlp, now, before, a),
            Self::Lstm(p) => p.forward(&mut memory.lstm, now, before, a),
            Self::Bounded(p) => p.forward(&mut memory.bounded, now, before, a),
        }
    }

    /// Adds the slopes in y_k, y_{k-1} and a_k of the last step that was not yet taken back, from those in
    /// y_{k+1}.
    #[inline(always)]
    pub fn backward(&self, memory: &mut Memory, d_next: &Pair, slopes: [&mut Pair; 3]) {
        match self {
            Self::Linear(linear) => linear.backward(d_next, slopes),
            Self::Mlp(p) => p.backward(&mut memory.mlp, d_next, slopes),
            Self::Lstm(p) => p.backward(&mut memory.lstm, d_next, slopes),
            Self::Bounded(p) => p.backward(&mut memory.bounded, d_next, slopes),
        }
    }

    /// Slopes in the weights, in the order of [`Predictor::layers`], once all steps were taken back.
    #[must_use]
    pub fn gradient(&self, memory: &Memory) -> Mlp {
        match self {
            Self::Linear(_) | Self::Bounded(_) => Mlp { layers: Vec::new() },
            Self::Mlp(p) => p.cell.gradient(&memory.mlp),
            Self::Lstm(p) => p.cell.gradient(&memory.lstm),
        }
    }

    /// The weights of a network, layer by layer; none of a predictor that is no network.
    #[must_use]
    pub fn layers(&self) -> Mlp {
        match self {
            Self::Linear(_) | Self::Bounded(_) => Mlp { layers: Vec::new() },
            Self::Mlp(p) => p.cell.layers(),
            Self::Lstm(p) => p.cell.layers(),
        }
    }

    /// Takes up what [`Predictor::layers`] gave.
    pub fn set_layers(&mut self, layers: &Mlp) {
        match self {
            Self::Linear(_) | Self::Bounded(_) => {}
            Self::Mlp(p) => p.cell.set_layers(layers),
            Self::Lstm(p) => p.cell.set_layers(layers),
        }
    }

    /// An untrained network of this kind, which predicts constant velocity; `None` for those that are no network.
    #[must_use]
    pub fn untrained(
        kind: PredictorKind,
        scaling: Scaling,
        config: &NetworksConfig,
        rng: &mut impl Rng,
    ) -> Option<Self> {
        let n = config.hidden;
        // Zeros last: it begins as constant velocity.
        Some(match kind {
            PredictorKind::Linear | PredictorKind::Bounded => return None,
            PredictorKind::Mlp => {
                let layers = vec![random(INPUTS, n, rng), random(n, n, rng), Dense::zeros(n, 2)];
                Self::Mlp(Residual { cell: SiluMlp(Mlp { layers }), scaling })
            }
            PredictorKind::Lstm => {
                let cell = Lstm { gates: random(INPUTS + n, 4 * n, rng), out: Dense::zeros(n, 2) };
                Self::Lstm(Residual { cell, scaling })
            }
        })
    }

    /// The units of a network.
    #[must_use]
    pub fn scaling(&self) -> Option<Scaling> {
        match self {
            Self::Linear(_) | Self::Bounded(_) => None,
            Self::Mlp(p) => Some(p.scaling),
            Self::Lstm(p) => Some(p.scaling),
        }
    }

    fn put(&self, out: &mut Writer) {
        match self {
            Self::Linear(_) | Self::Bounded(_) => {}
            Self::Mlp(p) => p.cell.put(out),
            Self::Lstm(p) => p.cell.put(out),
        }
    }

    fn get(kind: PredictorKind, scaling: Scaling, from: &Reader<'_>) -> Result<Option<Self>, TensorError> {
        Ok(match kind {
            PredictorKind::Linear | PredictorKind::Bounded => None,
            PredictorKind::Mlp => Some(Self::Mlp(Residual { cell: SiluMlp::get(from)?, scaling })),
            PredictorKind::Lstm => Some(Self::Lstm(Residual { cell: Lstm::get(from)?, scaling })),
        })
    }
}

/// A layer as PyTorch starts it: U(±1/sqrt(inputs)).
fn random(inputs: usize, outputs: usize, rng: &mut impl Rng) -> Dense {
    let bound = 1.0 / (inputs as f32).sqrt();
    let mut dense = Dense::zeros(inputs, outputs);
    dense.w.iter_mut().chain(&mut dense.b).for_each(|w| *w = rng.random_range(-bound..bound));
    dense
}

/// How the networks are trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworksConfig {
    /// Episodes from rest.
    pub episodes: usize,
    /// Further episodes, for the learning curve.
    pub held_out: usize,
    /// Whether the episodes are unselected: walls and v_max act in them, and none is discarded.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub unselected: bool,
    /// Units of each hidden layer, and of the LSTM.
    pub hidden: usize,
    /// Steps of Adam on rollouts of 4 intervals, each network.
    pub short_steps: usize,
    /// Steps of Adam on rollouts that grow to the whole horizon, the MLP.
    pub mlp_steps: usize,
    /// Steps of Adam on rollouts that grow to the whole horizon, the LSTM.
    pub lstm_steps: usize,
    /// Rollouts a step; rounded up to a multiple of 32.
    pub batch: usize,
    /// Learning rate at the start of short and of long rollouts, the MLP; falls to 1 % of it as a cosine.
    pub mlp_rate: f64,
    /// Learning rate at the start of short and of long rollouts, the LSTM; falls to 1 % of it as a cosine.
    pub lstm_rate: f64,
}

impl Default for NetworksConfig {
    fn default() -> Self {
        Self {
            episodes: 400,
            held_out: 96,
            unselected: false,
            hidden: 64,
            short_steps: 300,
            mlp_steps: 5000,
            lstm_steps: 5000,
            batch: 32,
            mlp_rate: 1.5e-2,
            lstm_rate: 6e-3,
        }
    }
}

impl NetworksConfig {
    /// Steps on long rollouts, and the learning rate, of one network; (0, 0) for those that are no network.
    #[must_use]
    pub fn schedule(&self, kind: PredictorKind) -> (usize, f64) {
        match kind {
            PredictorKind::Linear | PredictorKind::Bounded => (0, 0.0),
            PredictorKind::Mlp => (self.mlp_steps, self.mlp_rate),
            PredictorKind::Lstm => (self.lstm_steps, self.lstm_rate),
        }
    }

    /// Steps of all networks together.
    #[must_use]
    pub fn steps(&self) -> usize {
        PredictorKind::NETWORKS.iter().map(|kind| self.short_steps + self.schedule(*kind).0).sum()
    }
}

/// Name of the networks' file beside the checkpoint.
pub const PREDICTORS: &str = "predictors.safetensors";

/// Key of the world model's fingerprint in the file's metadata.
const WORLD: &str = "world_model";

/// The networks of a world model, in a file of their own: the world model's fingerprint does not depend on
/// them.
#[derive(Debug, Clone, PartialEq)]
pub struct Networks {
    /// In the order of [`PredictorKind::NETWORKS`].
    pub all: Vec<Predictor>,
    /// Of [`PredictorKind::Bounded`]; a file may lack them.
    pub bounds: Option<Bounds>,
    /// Fingerprint of the world model on whose latents they were trained.
    pub world: String,
}

impl Networks {
    /// Writes [`PREDICTORS`] into `dir`, which must be there.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, dir: &Path) -> Result<(), TensorError> {
        let mut out = Writer::default();
        if let Some(Scaling { place, step, residual }) = self.all.iter().find_map(Predictor::scaling) {
            out.f32("scaling", &[3], [place, step, residual]);
        }
        self.all.iter().for_each(|predictor| predictor.put(&mut out));
        self.bounds.iter().for_each(|bounds| bounds.put(&mut out));
        let about = HashMap::from([(WORLD.to_owned(), self.world.clone())]);
        tensors::write_all(&dir.join(PREDICTORS), &out.bytes_about(Some(about))?)
    }

    /// Reads what [`Networks::save`] wrote; the widths are the file's own.
    ///
    /// # Errors
    /// If the file is missing, or a tensor is missing or has another shape.
    pub fn load(dir: &Path) -> Result<Self, TensorError> {
        let path = dir.join(PREDICTORS);
        Self::parse(&tensors::read(&path)?, path)
    }

    /// Those of the world model that programs take where none is named.
    ///
    /// # Errors
    /// If the program was built with a file of another format.
    pub fn embedded() -> Result<Self, TensorError> {
        Self::built_in(BuiltIn::default())
    }

    /// The networks that belong to a world model that ships with the program.
    ///
    /// # Errors
    /// If the program was built with a file of another format.
    pub fn built_in(which: BuiltIn) -> Result<Self, TensorError> {
        let bytes: &[u8] = match which {
            BuiltIn::Centroid => include_bytes!("../../pretrained/predictors.safetensors"),
            BuiltIn::Learned => include_bytes!("../../pretrained/learned/predictors.safetensors"),
        };
        Self::parse(bytes, Path::new("built-in").join(which.name()).join(PREDICTORS))
    }

    /// Those that belong to the world model that `--checkpoint` names.
    ///
    /// # Errors
    /// If a file is missing or holds something else.
    pub fn named(name: &Path) -> Result<Self, TensorError> {
        match BuiltIn::of(name) {
            Some(which) => Self::built_in(which),
            None => Self::load(name),
        }
    }

    fn parse(bytes: &[u8], path: PathBuf) -> Result<Self, TensorError> {
        let wrong = |message: String| TensorError::Format { path: path.clone(), message };
        let from = Reader::new(bytes, path.clone())?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| wrong(e.to_string()))?;
        let world = header.metadata().as_ref().and_then(|m| m.get(WORLD)).cloned().unwrap_or_default();
        let s = from.f32("scaling", &[3])?;
        if s.iter().any(|v| *v <= 0.0) {
            return Err(wrong("tensor `scaling` holds a value that is not above 0".into()));
        }
        let scaling = Scaling { place: s[0], step: s[1], residual: s[2] };
        let mut all = Vec::new();
        for kind in PredictorKind::NETWORKS {
            all.extend(Predictor::get(kind, scaling, &from)?);
        }
        if all.iter().flat_map(|p| p.layers().layers).any(|l| l.inputs == 0 || l.outputs == 0) {
            return Err(wrong("a network has no hidden unit".into()));
        }
        let bounds = Bounds::get(&from)?;
        if bounds.is_some_and(|b| b.reach <= 0.0 || b.low >= b.high) {
            return Err(wrong("tensor `bounds` leaves no room to move".into()));
        }
        Ok(Self { all, bounds, world })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(inputs: usize, outputs: usize, size: f32) -> Dense {
        let mut dense = Dense::zeros(inputs, outputs);
        let values = dense.w.iter_mut().chain(&mut dense.b).enumerate();
        values.for_each(|(k, w)| *w = size * ((k * 7 + outputs) as f32 * 1.7).sin());
        dense
    }

    fn some(last: f32) -> Networks {
        let scaling = Scaling { place: 2.0, step: 0.2, residual: 0.03 };
        let layers = vec![filled(INPUTS, 8, 0.5), filled(8, 8, 0.4), filled(8, 2, last)];
        let lstm = Lstm { gates: filled(INPUTS + 4, 16, 0.5), out: filled(4, 2, last) };
        let all = vec![
            Predictor::Mlp(Residual { cell: SiluMlp(Mlp { layers }), scaling }),
            Predictor::Lstm(Residual { cell: lstm, scaling }),
        ];
        let (low, high) = (Vector2::repeat(-4.0), Vector2::repeat(5.0));
        let bounds = Some(Bounds { reach: 0.4, low, high, contact: 0.01, kept: 0.1 });
        Networks { all, bounds, world: "0123".into() }
    }

    #[test]
    fn they_survive_the_disk() {
        let dir = tempfile::tempdir().unwrap();
        some(0.7).save(dir.path()).unwrap();
        assert_eq!(Networks::load(dir.path()).unwrap(), some(0.7));
        std::fs::write(dir.path().join(PREDICTORS), b"no").unwrap();
        let error = Networks::load(dir.path()).unwrap_err().to_string();
        assert!(error.contains("predictors.safetensors: not a safetensors file"), "{error}");
    }

    #[test]
    fn a_network_of_zeros_keeps_the_speed() {
        let (now, before) = (Vector2::new(1.0, 2.0), Vector2::new(0.9, 2.2));
        for predictor in some(0.0).all {
            let actions = [Vector2::new(1.0, 1.0); 10];
            // More than one block, of unequal lengths.
            let begins: Vec<_> =
                (0..70).map(|n| Begin { now, before, actions: &actions[..1 + n % 10] }).collect();
            let paths = predictor.rollouts(&begins);
            assert!(paths.len() == 70 && paths[3].len() == 4);
            assert!((paths[69][9] - Vector2::new(2.0, 0.0)).norm() < 1e-9, "{}", paths[69][9]);
        }
    }

    #[test]
    fn an_lstm_remembers_and_an_mlp_does_not() {
        let past_matters = |p: &Predictor| {
            let zero = Vector2::zeros();
            let actions = [Vector2::new(1.0, 0.0), zero, zero];
            let y = p.rollout(Begin { now: zero, before: zero, actions: &actions });
            // The same place and step, without that past.
            let fresh = p.rollout(Begin { now: y[0], before: zero, actions: &actions[1..] });
            (y[1] - fresh[0]).norm()
        };
        let all = some(0.7).all;
        assert!(past_matters(&all[0]) < 1e-12 && past_matters(&all[1]) > 1e-4);
    }

    /// The slopes of one step against differences of it, for every kind.
    #[test]
    fn the_displacements_slopes_are_its_differences() {
        let linear = PlaneLinear::from_rows([
            [[2.0, 0.01], [0.0, 1.98]],
            [[-1.0, 0.0], [-0.01, -0.99]],
            [[0.035, 0.001], [-0.001, 0.035]],
        ]);
        let (y, v, a) = (Vector2::new(0.8, -0.3), Vector2::new(0.05, 0.11), Vector2::new(0.6, -0.2));
        for predictor in some(0.7).all.into_iter().chain([Predictor::Linear(linear)]) {
            let at = |y, v| predictor.displacement(y, v, a).step;
            let found = predictor.displacement(y, v, a);
            assert!((y + found.step - predictor.step(&mut Memory::default(), y, y - v, a)).norm() < 1e-12);
            for axis in 0..2 {
                let h = Vector2::from_fn(|row, _| if row == axis { 1e-3 } else { 0.0 });
                let by_y = (at(y + h, v) - at(y - h, v)) / 2e-3;
                let by_v = (at(y, v + h) - at(y, v - h)) / 2e-3;
                let kind = predictor.kind();
                assert!((found.by_y.column(axis) - by_y).norm() < 1e-3, "{kind:?}: {} {by_y}", found.by_y);
                assert!((found.by_v.column(axis) - by_v).norm() < 1e-3, "{kind:?}: {} {by_v}", found.by_v);
            }
        }
    }
}
