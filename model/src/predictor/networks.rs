//! The predictors that the linear one is compared with: an MLP and an LSTM on the same frozen latents
//! (Sec. IV-B), as plain networks.
//!
//! Both correct constant velocity, ŷ' = 2 y_k - y_{k-1} + bend·f(y_k, y_k - y_{k-1}, a_k), in plane
//! coordinates: a latent half is of rank 2, so nothing is lost. They stand in a file of their own: the
//! flight does not need them, and the world model's fingerprint does not depend on them. Knows neither
//! pictures nor positions; trained in `predictors_fit`.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use multiversion::multiversion;
use nalgebra::Vector2;
use rayon::prelude::*;
use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};

use crate::numeric::kernel::{self, LANES, Lane, ZERO};
use crate::numeric::mlp::{Dense, Mlp};
use crate::world_model::checkpoint::{self, CheckpointError, Reader, Writer};

/// Name of the file beside the checkpoint.
pub const PREDICTORS: &str = "predictors.safetensors";

/// Key of the world model's fingerprint in the file's metadata.
const WORLD: &str = "world_model";

/// Numbers that a network reads: place, step, action.
pub const INPUTS: usize = 6;

/// How the MLP and the LSTM are trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworksConfig {
    /// Episodes from rest.
    pub episodes: usize,
    /// Further episodes for the curve that has to become flat.
    pub held_out: usize,
    /// Units of each hidden layer, and of the LSTM.
    pub hidden: usize,
    /// Steps of Adam on rollouts of 4 steps, each network.
    pub short_steps: usize,
    /// Steps of Adam on rollouts that grow to the whole horizon, the MLP.
    pub mlp_steps: usize,
    /// The same, the LSTM.
    pub lstm_steps: usize,
    /// Rollouts a step; rounded up to whole lanes of 32.
    pub batch: usize,
    /// Learning rate at the start of either kind of steps, the MLP; falls to 1 % of it as a cosine.
    pub mlp_rate: f64,
    /// The same, the LSTM.
    pub lstm_rate: f64,
}

impl Default for NetworksConfig {
    fn default() -> Self {
        Self {
            episodes: 400,
            held_out: 96,
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

/// What brings a network's inputs and output to order one; measured on the training latents.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scaling {
    /// Rms of a coordinate of y_c.
    pub place: f32,
    /// Rms of a coordinate of y_k - y_{k-1}.
    pub step: f32,
    /// Rms of a coordinate of y_{k+1} - 2 y_k + y_{k-1}.
    pub bend: f32,
}

/// A network that tells the bend of the path.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// SiLU layers (x σ(x), of which two make a straight line), no memory.
    Mlp(Mlp),
    /// One LSTM layer and a linear output.
    Lstm(Lstm),
}

/// One LSTM layer: gates i, f, g, o from [x, h], and a linear output.
#[derive(Debug, Clone, PartialEq)]
pub struct Lstm {
    /// [x, h] to the four gates, [INPUTS + n][4 n].
    pub gates: Dense,
    /// h to the output, [n][2].
    pub out: Dense,
}

/// A learned predictor of the controllable half.
#[derive(Debug, Clone, PartialEq)]
pub struct Predictor {
    /// The network.
    pub cell: Cell,
    /// Its units.
    pub scaling: Scaling,
}

/// Where a rollout begins and what is flown: y_c, y_c one interval earlier, normalised accelerations.
#[derive(Debug, Clone, Copy)]
pub struct Begin<'a> {
    /// y_k
    pub now: Vector2<f64>,
    /// y_{k-1}
    pub before: Vector2<f64>,
    /// a_k, a_{k+1}, ...
    pub actions: &'a [Vector2<f64>],
}

impl Predictor {
    /// y_c after each action of each rollout, on all cores.
    #[must_use]
    pub fn rollouts(&self, begins: &[Begin<'_>]) -> Vec<Vec<Vector2<f64>>> {
        let blocks: Vec<_> = begins.par_chunks(LANES).map(|block| self.block(block)).collect();
        blocks.into_iter().flatten().collect()
    }

    /// At most [`LANES`] rollouts side by side.
    fn block(&self, begins: &[Begin<'_>]) -> Vec<Vec<Vector2<f64>>> {
        let mut paths: Vec<Vec<Vector2<f64>>> = vec![Vec::new(); begins.len()];
        let mut ends: Vec<[Vector2<f64>; 2]> = begins.iter().map(|b| [b.now, b.before]).collect();
        let longest = begins.iter().map(|b| b.actions.len()).max().unwrap_or(0);
        let mut memory = self.cell.memory();
        for k in 0..longest {
            let mut x = [ZERO; INPUTS];
            for (lane, (begin, [now, before])) in begins.iter().zip(&ends).enumerate() {
                let a = begin.actions.get(k).copied().unwrap_or_default();
                for (x, value) in x.iter_mut().zip(self.scaling.inputs(*now, now - before, a)) {
                    x[lane] = value;
                }
            }
            let out = step(&self.cell, &x, &mut memory);
            for (lane, [now, before]) in ends.iter_mut().enumerate() {
                let bend = Vector2::new(out[0][lane], out[1][lane]).map(f64::from);
                (*now, *before) = (*now * 2.0 - *before + bend * f64::from(self.scaling.bend), *now);
                if k < begins[lane].actions.len() {
                    paths[lane].push(*now);
                }
            }
        }
        paths
    }
}

impl Cell {
    /// h and c of an LSTM, zero.
    fn memory(&self) -> [Vec<Lane>; 2] {
        let n = if let Self::Lstm(lstm) = self { lstm.out.inputs } else { 0 };
        [vec![ZERO; n], vec![ZERO; n]]
    }
}

/// The network's output for all lanes.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn step(cell: &Cell, x: &[Lane; INPUTS], memory: &mut [Vec<Lane>; 2]) -> [Lane; 2] {
    let mut out = [ZERO; 2];
    match cell {
        Cell::Mlp(mlp) => {
            let mut x = x.to_vec();
            for (n, layer) in mlp.layers.iter().enumerate() {
                let mut y = vec![ZERO; layer.outputs];
                kernel::affine(&layer.w, &layer.b, &x, &mut y);
                if n + 1 < mlp.layers.len() {
                    y.as_flattened_mut().iter_mut().for_each(|v| *v *= kernel::sigmoid(*v));
                }
                x = y;
            }
            out.copy_from_slice(&x);
        }
        Cell::Lstm(lstm) => {
            let ([hidden, carried], n) = (memory, lstm.out.inputs);
            let input = [x.as_slice(), hidden].concat();
            let mut gates = vec![ZERO; 4 * n];
            kernel::affine(&lstm.gates.w, &lstm.gates.b, &input, &mut gates);
            for k in 0..n {
                for l in 0..LANES {
                    let [keep_new, keep_old, new, show] = [0, 1, 2, 3].map(|gate| gates[gate * n + k][l]);
                    let old = kernel::sigmoid(keep_old) * carried[k][l];
                    carried[k][l] = kernel::sigmoid(keep_new).mul_add(kernel::tanh(new), old);
                    hidden[k][l] = kernel::sigmoid(show) * kernel::tanh(carried[k][l]);
                }
            }
            kernel::affine(&lstm.out.w, &lstm.out.b, hidden, &mut out);
        }
    }
    out
}

impl Scaling {
    /// What a network reads of y_k, y_k - y_{k-1} and a_k.
    #[must_use]
    pub fn inputs(&self, y: Vector2<f64>, step: Vector2<f64>, a: Vector2<f64>) -> [f32; INPUTS] {
        let (place, speed) = (self.place, self.step);
        [
            y.x as f32 / place,
            y.y as f32 / place,
            step.x as f32 / speed,
            step.y as f32 / speed,
            a.x as f32,
            a.y as f32,
        ]
    }
}

/// Both, and whose latents they read.
#[derive(Debug, Clone, PartialEq)]
pub struct Predictors {
    /// Two hidden layers.
    pub mlp: Predictor,
    /// One recurrent layer.
    pub lstm: Predictor,
    /// Fingerprint of the world model on whose latents they were trained.
    pub world: String,
}

impl Predictors {
    /// Writes [`PREDICTORS`] into `dir`, which must be there.
    pub fn save(&self, dir: &Path) -> Result<(), CheckpointError> {
        let mut out = Writer::default();
        let Scaling { place, step, bend } = self.mlp.scaling;
        out.f32("scaling", &[3], [place, step, bend]);
        for predictor in [&self.mlp, &self.lstm] {
            match &predictor.cell {
                Cell::Mlp(mlp) => out.mlp("mlp", mlp),
                Cell::Lstm(Lstm { gates, out: last }) => {
                    out.mlp("lstm.gates", &Mlp { layers: vec![gates.clone()] });
                    out.mlp("lstm.out", &Mlp { layers: vec![last.clone()] });
                }
            }
        }
        let about = HashMap::from([(WORLD.to_owned(), self.world.clone())]);
        checkpoint::write_all(&dir.join(PREDICTORS), &out.bytes_about(Some(about))?)
    }

    /// Reads what [`Predictors::save`] wrote; the widths are the file's own.
    pub fn load(dir: &Path) -> Result<Self, CheckpointError> {
        let path = dir.join(PREDICTORS);
        let bytes =
            std::fs::read(&path).map_err(|source| CheckpointError::File { path: path.clone(), source })?;
        Self::parse(&bytes, path)
    }

    /// Those that ship with the program.
    pub fn embedded() -> Result<Self, CheckpointError> {
        let bytes = include_bytes!("../../pretrained/predictors.safetensors");
        Self::parse(bytes, Path::new("embedded").join(PREDICTORS))
    }

    fn parse(bytes: &[u8], path: PathBuf) -> Result<Self, CheckpointError> {
        let wrong = |message: String| CheckpointError::Format { path: path.clone(), message };
        let from = Reader::new(bytes, path.clone())?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| wrong(e.to_string()))?;
        let world = header.metadata().as_ref().and_then(|m| m.get(WORLD)).cloned().unwrap_or_default();
        let s = from.f32("scaling", &[3])?;
        if s.iter().any(|v| *v <= 0.0) {
            return Err(wrong("tensor `scaling` holds a value that is not above 0".into()));
        }
        let scaling = Scaling { place: s[0], step: s[1], bend: s[2] };
        let wide = |name: &str| -> Result<usize, CheckpointError> {
            Ok(from.shape(name)?.first().copied().unwrap_or(0))
        };
        let (hidden, n) = (wide("mlp.0.weight")?, wide("lstm.gates.0.weight")? / 4);
        if hidden == 0 || n == 0 {
            return Err(wrong("a network has no hidden unit".into()));
        }
        let mlp = from.mlp("mlp", &[INPUTS, hidden, hidden, 2])?;
        let one = |name: &str, widths: [usize; 2]| -> Result<Dense, CheckpointError> {
            let layer = from.mlp(name, &widths)?.layers.pop();
            layer.ok_or_else(|| wrong(format!("`{name}` has no layer")))
        };
        let gates = one("lstm.gates", [INPUTS + n, 4 * n])?;
        let lstm = Lstm { gates, out: one("lstm.out", [n, 2])? };
        Ok(Self {
            mlp: Predictor { cell: Cell::Mlp(mlp), scaling },
            lstm: Predictor { cell: Cell::Lstm(lstm), scaling },
            world,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(inputs: usize, outputs: usize) -> Dense {
        let mut dense = Dense::zeros(inputs, outputs);
        let values = dense.w.iter_mut().chain(&mut dense.b).enumerate();
        values.for_each(|(k, w)| *w = 0.2 * ((k * 7 + outputs) as f32).sin());
        dense
    }

    fn some() -> Predictors {
        let scaling = Scaling { place: 2.0, step: 0.2, bend: 0.03 };
        let layers = vec![filled(INPUTS, 8), filled(8, 8), filled(8, 2)];
        let lstm = Lstm { gates: filled(INPUTS + 4, 16), out: filled(4, 2) };
        Predictors {
            mlp: Predictor { cell: Cell::Mlp(Mlp { layers }), scaling },
            lstm: Predictor { cell: Cell::Lstm(lstm), scaling },
            world: "0123".into(),
        }
    }

    #[test]
    fn they_survive_the_disk() {
        let dir = tempfile::tempdir().unwrap();
        some().save(dir.path()).unwrap();
        assert_eq!(Predictors::load(dir.path()).unwrap(), some());
        std::fs::write(dir.path().join(PREDICTORS), b"no").unwrap();
        let error = Predictors::load(dir.path()).unwrap_err().to_string();
        assert!(error.contains("predictors.safetensors: not a safetensors file"), "{error}");
    }

    #[test]
    fn a_network_of_zeros_keeps_the_speed() {
        let scaling = Scaling { place: 2.0, step: 0.2, bend: 0.03 };
        let lstm = Lstm { gates: filled(INPUTS + 4, 16), out: Dense::zeros(4, 2) };
        let (now, before) = (Vector2::new(1.0, 2.0), Vector2::new(0.9, 2.2));
        for cell in [Cell::Mlp(Mlp::zeros(&[INPUTS, 8, 8, 2])), Cell::Lstm(lstm)] {
            let actions = [Vector2::new(1.0, 1.0); 10];
            // More than one block, of unequal lengths.
            let begins: Vec<_> =
                (0..70).map(|n| Begin { now, before, actions: &actions[..1 + n % 10] }).collect();
            let paths = Predictor { cell, scaling }.rollouts(&begins);
            assert!(paths.len() == 70 && paths[3].len() == 4);
            assert!((paths[69][9] - Vector2::new(2.0, 0.0)).norm() < 1e-9, "{}", paths[69][9]);
        }
    }

    #[test]
    fn an_lstm_remembers_and_an_mlp_does_not() {
        let past_matters = |p: &Predictor| {
            let zero = Vector2::zeros();
            let actions = [Vector2::new(1.0, 0.0), zero, zero];
            let y = &p.rollouts(&[Begin { now: zero, before: zero, actions: &actions }])[0];
            // The same place and step, without that past.
            let fresh = &p.rollouts(&[Begin { now: y[0], before: zero, actions: &actions[1..] }])[0];
            (y[1] - fresh[0]).norm()
        };
        assert!(past_matters(&some().mlp) < 1e-12 && past_matters(&some().lstm) > 1e-4);
    }
}
