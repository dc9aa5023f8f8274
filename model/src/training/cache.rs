//! Finished stages of a training run on disk, so that an interrupted run resumes.

use std::path::{Path, PathBuf};

use crate::encoder::infer::{Encoder, Features};
use crate::encoder::weights::{FEATURES, Weights};
use crate::numeric::tensors::{self, Reader, Stored, TensorError, Writer};
use crate::training::closed_form::Triples;
use crate::training::fitting::{TrainContext, targets};
use crate::world_model::card::FitCheck;
use crate::world_model::dataset::Triple;

/// Why the folder of finished stages could not be used.
#[derive(Debug, thiserror::Error)]
pub enum CacheError {
    /// A file could not be read or written.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// The unfinished run was made with another configuration.
    #[error("{0}: the unfinished run there has another configuration or backend; train without --resume")]
    Resume(PathBuf),
}

/// The folder of finished stages; without one, every stage is computed and nothing is written.
#[derive(Debug)]
pub struct StageCache {
    dir: Option<PathBuf>,
}

impl StageCache {
    /// Keeps nothing.
    #[must_use]
    pub fn none() -> Self {
        Self { dir: None }
    }

    /// Starts a run in `dir`, or with `resume` continues the one there, which must have the same `identity`.
    ///
    /// # Errors
    /// [`CacheError::Resume`] if the run there is another one; else if a file cannot be read or written.
    pub fn open(dir: PathBuf, identity: &str, resume: bool) -> Result<Self, CacheError> {
        let failed = |source| TensorError::File { path: dir.clone(), source };
        let marker = dir.join("run.json");
        if resume && dir.exists() {
            if std::fs::read_to_string(&marker).map_err(failed)? != identity {
                return Err(CacheError::Resume(dir));
            }
        } else {
            if dir.exists() {
                std::fs::remove_dir_all(&dir).map_err(failed)?;
            }
            std::fs::create_dir_all(&dir).map_err(failed)?;
            tensors::write_all(&marker, identity.as_bytes())?;
        }
        Ok(Self { dir: Some(dir) })
    }

    /// Where a stage may leave its progress.
    #[must_use]
    pub fn dir(&self) -> Option<&Path> {
        self.dir.as_deref()
    }

    /// Reads the stage if it is finished, else makes and writes it; then it is read all the same, so
    /// that a resumed run sees exactly what an unbroken one does.
    ///
    /// # Errors
    /// What `make` returns, or if a file of the stage cannot be read or written.
    pub fn keep<T, E: From<TensorError>>(
        &self,
        name: &str,
        load: impl Fn(&Path) -> Result<T, TensorError>,
        make: impl FnOnce() -> Result<T, E>,
        save: impl Fn(&T, &Path) -> Result<(), TensorError>,
    ) -> Result<T, E> {
        let Some(home) = &self.dir else { return make() };
        let dir = home.join(name);
        if !dir.exists() {
            let made = make()?;
            // Finished when it has its name.
            let beside = home.join(format!("{name}.part"));
            let failed = |source| TensorError::File { path: beside.clone(), source };
            std::fs::create_dir_all(&beside).map_err(failed)?;
            save(&made, &beside)?;
            std::fs::rename(&beside, &dir).map_err(failed)?;
            tracing::info!("stage {name} done");
        }
        Ok(load(&dir)?)
    }

    /// Everything is in the checkpoint now.
    ///
    /// # Errors
    /// If the folder cannot be removed.
    pub fn remove(self) -> Result<(), TensorError> {
        let Some(dir) = self.dir else { return Ok(()) };
        std::fs::remove_dir_all(&dir).map_err(|source| TensorError::File { path: dir, source })
    }
}

/// Reads a file of a stage that holds one value.
///
/// # Errors
/// The file cannot be read, or a tensor is missing or has another shape.
pub fn load_one<T: Stored>(dir: &Path, name: &str) -> Result<T, TensorError> {
    read(dir, name, T::get)
}

/// Writes a file of a stage that holds one value.
///
/// # Errors
/// If the file cannot be written.
pub fn save_one(value: &impl Stored, dir: &Path, name: &str) -> Result<(), TensorError> {
    let mut out = Writer::default();
    value.put(&mut out);
    tensors::write_all(&dir.join(name), &out.bytes()?)
}

/// Reads one file of a stage.
///
/// # Errors
/// The file cannot be read, is no safetensors file, or `parse` refuses it.
pub fn read<T>(
    dir: &Path,
    name: &str,
    parse: impl Fn(&Reader<'_>) -> Result<T, TensorError>,
) -> Result<T, TensorError> {
    let path = dir.join(name);
    let bytes = tensors::read(&path)?;
    parse(&Reader::new(&bytes, path)?)
}

/// Writes both sets' features.
///
/// # Errors
/// If the file cannot be written.
pub fn save_features(sets: &[Triples; 2], dir: &Path) -> Result<(), TensorError> {
    let mut out = Writer::default();
    for (name, features) in NAMES.iter().zip(sets.iter().flat_map(|s| &s.features)) {
        out.f32(&format!("{name}.h"), &[features.len(), FEATURES], features.iter().flat_map(|f| f.h.clone()));
        out.f32(&format!("{name}.q"), &[features.len(), 3], features.iter().flat_map(|f| f.missing));
    }
    tensors::write_all(&dir.join("features.safetensors"), &out.bytes()?)
}

/// Reads what [`save_features`] wrote of these triples.
///
/// # Errors
/// If the file is missing or has other shapes than `picks` need.
pub fn load_features(
    dir: &Path,
    context: &TrainContext<'_>,
    picks: &[Vec<Triple>; 2],
) -> Result<[Triples; 2], TensorError> {
    read(dir, "features.safetensors", |from| {
        let one = |name: &str, count: usize| -> Result<Vec<Features>, TensorError> {
            let h = from.f32(&format!("{name}.h"), &[count, FEATURES])?;
            let q = from.f32(&format!("{name}.q"), &[count, 3])?;
            let rows = h.chunks_exact(FEATURES).zip(q.chunks_exact(3));
            Ok(rows.map(|(h, q)| Features { h: h.to_vec(), missing: [q[0], q[1], q[2]] }).collect())
        };
        let set = |n: usize| -> Result<Triples, TensorError> {
            let (names, triples) = (&NAMES[3 * n..], &picks[n]);
            let count = triples.len();
            let features = [one(names[0], count)?, one(names[1], count)?, one(names[2], count)?];
            Ok(Triples { features, targets: targets(context, triples) })
        };
        Ok([set(0)?, set(1)?])
    })
}

const NAMES: [&str; 6] = ["long.0", "long.1", "long.2", "short.0", "short.1", "short.2"];

/// Writes the weights of a stage.
///
/// # Errors
/// If the file cannot be written.
pub fn save_weights(weights: &Weights, dir: &Path) -> Result<(), TensorError> {
    save_one(weights, dir, "weights.safetensors")
}

/// Reads what [`save_weights`] wrote.
///
/// # Errors
/// The file cannot be read, or a tensor is missing or has another shape.
pub fn load_weights(dir: &Path) -> Result<Weights, TensorError> {
    load_one(dir, "weights.safetensors")
}

/// Writes an encoder and the check of its fit.
///
/// # Errors
/// If the file cannot be written.
pub fn save_encoder((encoder, check): &(Encoder, Option<FitCheck>), dir: &Path) -> Result<(), TensorError> {
    let mut out = Writer::default();
    encoder.weights().put(&mut out);
    let numbers: Vec<f64> =
        check.iter().flat_map(|c| [c.residual_c_px].into_iter().chain(c.eigenvalues)).collect();
    out.f64("check", &[numbers.len()], numbers);
    tensors::write_all(&dir.join("encoder.safetensors"), &out.bytes()?)
}

/// Reads what [`save_encoder`] wrote.
///
/// # Errors
/// If the file is missing or a tensor has another shape.
pub fn load_encoder(dir: &Path) -> Result<(Encoder, Option<FitCheck>), TensorError> {
    read(dir, "encoder.safetensors", |from| {
        let encoder = Encoder::new(Weights::get(from)?);
        if from.shape("check")? == [0] {
            return Ok((encoder, None));
        }
        let v = from.f64("check", &[5])?;
        Ok((encoder, Some(FitCheck { residual_c_px: v[0], eigenvalues: [v[1], v[2], v[3], v[4]] })))
    })
}
