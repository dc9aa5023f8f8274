//! A world model on disk: `model.safetensors` (named tensors, PyTorch's layouts), `config.json` (what
//! decided its bytes, and its metrics) and `card.md` (the same for people, with time and revision).
//!
//! Every shape is checked on reading. Knows files and names; computes nothing.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crpl_sitl::program::files::{self, write_whole};
use nalgebra::{Matrix2, SMatrix, Vector2};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use crate::encoder::infer::Encoder;
use crate::encoder::probe::{Affine, Probe};
use crate::encoder::weights::{CONVS, Colour, FEATURES, Input, LATENT, Layer, POOLED, Weights};
use crate::heads::networks::{COLLISION_WIDTHS, GAIN_WIDTHS, Heads};
use crate::numeric::mlp::Mlp;
use crate::predictor::linear::Linear;
use crate::world_model::{Card, WorldModel};

/// Name of the tensors' file.
pub const TENSORS: &str = "model.safetensors";
/// Name of the configuration's file.
pub const CONFIG: &str = "config.json";
/// Name of the card's file.
pub const CARD: &str = "card.md";
/// What `format` must say.
pub const FORMAT: &str = "crpl-world-model/1";

/// Why a checkpoint could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not what it should be.
    #[error("{path}: {message}")]
    Format {
        /// The file.
        path: PathBuf,
        /// From the parser.
        message: String,
    },
    /// The configuration does not parse.
    #[error("{path}: {message}")]
    Config {
        /// The file.
        path: PathBuf,
        /// From the parser.
        message: String,
    },
    /// A tensor is not there.
    #[error("{path}: tensor `{name}` is missing")]
    Missing {
        /// The file.
        path: PathBuf,
        /// The tensor.
        name: String,
    },
    /// A tensor has another shape.
    #[error("{path}: tensor `{name}` has shape {found:?}, expected {expected:?}")]
    Shape {
        /// The file.
        path: PathBuf,
        /// The tensor.
        name: String,
        /// Its shape.
        found: Vec<usize>,
        /// The shape that the program needs.
        expected: Vec<usize>,
    },
    /// A tensor has another number type.
    #[error("{path}: tensor `{name}` has type {found}, expected {expected}")]
    Type {
        /// The file.
        path: PathBuf,
        /// The tensor.
        name: String,
        /// Its type.
        found: String,
        /// The type that the program needs.
        expected: String,
    },
    /// A tensor holds an infinity or NaN.
    #[error("{path}: tensor `{name}` holds a value that is not finite")]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The tensor.
        name: String,
    },
}

/// Reads the model in `dir`.
pub fn load(dir: &Path) -> Result<WorldModel, CheckpointError> {
    let read = |name: &str| {
        let path = dir.join(name);
        std::fs::read(&path).map_err(|source| CheckpointError::File { path, source })
    };
    parse(&read(TENSORS)?, &read(CONFIG)?, dir)
}

/// The model that was compiled into the program.
pub fn embedded() -> Result<WorldModel, CheckpointError> {
    let tensors = include_bytes!("../../pretrained/model.safetensors");
    let config = include_bytes!("../../pretrained/config.json");
    parse(tensors, config, Path::new("embedded"))
}

/// Writes the model's tensors and configuration into `dir`.
pub fn save(model: &WorldModel, dir: &Path) -> Result<(), CheckpointError> {
    std::fs::create_dir_all(dir).map_err(|source| CheckpointError::File { path: dir.into(), source })?;
    let mut config = serde_json::to_vec_pretty(&model.card)
        .map_err(|e| CheckpointError::Config { path: dir.join(CONFIG), message: e.to_string() })?;
    config.push(b'\n');
    write_all(&dir.join(TENSORS), &tensors(model)?)?;
    write_all(&dir.join(CONFIG), &config)
}

/// Writes a file in one go: first beside it, then over it, so that Ctrl-C leaves no half of one.
pub fn write_all(path: &Path, bytes: &[u8]) -> Result<(), CheckpointError> {
    write_whole(path, bytes).map_err(|source| CheckpointError::File { path: path.into(), source })
}

/// Collects named tensors and serialises them in a fixed order.
#[derive(Debug, Default)]
pub struct Writer {
    tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)>,
}

impl Writer {
    /// Adds a tensor of f32.
    pub fn f32(&mut self, name: &str, shape: &[usize], values: impl IntoIterator<Item = f32>) {
        let bytes = values.into_iter().flat_map(f32::to_le_bytes).collect();
        self.tensors.push((name.into(), Dtype::F32, shape.to_vec(), bytes));
    }

    /// Adds a tensor of f64.
    pub fn f64(&mut self, name: &str, shape: &[usize], values: impl IntoIterator<Item = f64>) {
        let bytes = values.into_iter().flat_map(f64::to_le_bytes).collect();
        self.tensors.push((name.into(), Dtype::F64, shape.to_vec(), bytes));
    }

    /// Adds `{name}.weight` and `{name}.bias`.
    pub fn layer(&mut self, name: &str, layer: &Layer) {
        self.f32(&format!("{name}.weight"), &layer.shape, layer.w.iter().copied());
        self.f32(&format!("{name}.bias"), &[layer.b.len()], layer.b.iter().copied());
    }

    /// Adds a matrix of f64, row by row.
    pub fn matrix<const R: usize, const C: usize>(&mut self, name: &str, matrix: &SMatrix<f64, R, C>) {
        self.f64(name, &[R, C], matrix.transpose().iter().copied());
    }

    /// Adds `{name}.{n}.weight` [out, in] and `{name}.{n}.bias` for every layer.
    pub fn mlp(&mut self, name: &str, mlp: &Mlp) {
        for (n, layer) in mlp.layers.iter().enumerate() {
            let (inputs, outputs) = (layer.inputs, layer.outputs);
            let transposed = (0..outputs).flat_map(|o| (0..inputs).map(move |i| layer.w[i * outputs + o]));
            self.f32(&format!("{name}.{n}.weight"), &[outputs, inputs], transposed);
            self.f32(&format!("{name}.{n}.bias"), &[outputs], layer.b.iter().copied());
        }
    }

    /// The bytes of a safetensors file.
    pub fn bytes(&self) -> Result<Vec<u8>, CheckpointError> {
        self.bytes_about(None)
    }

    /// The bytes of a safetensors file with this metadata.
    pub fn bytes_about(&self, metadata: Option<HashMap<String, String>>) -> Result<Vec<u8>, CheckpointError> {
        let wrong = |e: safetensors::SafeTensorError| CheckpointError::Format {
            path: TENSORS.into(),
            message: e.to_string(),
        };
        let mut views = Vec::with_capacity(self.tensors.len());
        for (name, dtype, shape, bytes) in &self.tensors {
            views.push((name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).map_err(wrong)?));
        }
        safetensors::serialize(views, metadata).map_err(wrong)
    }
}

/// Reads named tensors and checks their shapes.
#[derive(Debug)]
pub struct Reader<'a> {
    tensors: SafeTensors<'a>,
    path: PathBuf,
}

impl<'a> Reader<'a> {
    /// Parses the bytes of a safetensors file; `path` is for the error messages.
    pub fn new(bytes: &'a [u8], path: PathBuf) -> Result<Self, CheckpointError> {
        match SafeTensors::deserialize(bytes) {
            Ok(tensors) => Ok(Self { tensors, path }),
            Err(e) => Err(CheckpointError::Format { path, message: format!("not a safetensors file: {e}") }),
        }
    }

    /// Whether the file holds this tensor.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.tensors.tensor(name).is_ok()
    }

    /// The shape of a tensor.
    pub fn shape(&self, name: &str) -> Result<Vec<usize>, CheckpointError> {
        Ok(self.view(name)?.shape().to_vec())
    }

    /// A tensor of f32 with this shape.
    pub fn f32(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, CheckpointError> {
        let view = self.checked(name, shape, Dtype::F32)?;
        let (words, _) = view.data().as_chunks::<4>();
        let values: Vec<f32> = words.iter().map(|w| f32::from_le_bytes(*w)).collect();
        self.finite(name, values.iter().all(|v| v.is_finite()))?;
        Ok(values)
    }

    /// A tensor of f64 with this shape.
    pub fn f64(&self, name: &str, shape: &[usize]) -> Result<Vec<f64>, CheckpointError> {
        let view = self.checked(name, shape, Dtype::F64)?;
        let (words, _) = view.data().as_chunks::<8>();
        let values: Vec<f64> = words.iter().map(|w| f64::from_le_bytes(*w)).collect();
        self.finite(name, values.iter().all(|v| v.is_finite()))?;
        Ok(values)
    }

    /// `{name}.weight` with this shape and its bias.
    pub fn layer(&self, name: &str, shape: &[usize]) -> Result<Layer, CheckpointError> {
        let w = self.f32(&format!("{name}.weight"), shape)?;
        let b = self.f32(&format!("{name}.bias"), &shape[..1])?;
        Ok(Layer { shape: shape.to_vec(), w, b })
    }

    /// A matrix of f64.
    pub fn matrix<const R: usize, const C: usize>(
        &self,
        name: &str,
    ) -> Result<SMatrix<f64, R, C>, CheckpointError> {
        Ok(SMatrix::from_row_slice(&self.f64(name, &[R, C])?))
    }

    /// The network with these widths.
    pub fn mlp(&self, name: &str, widths: &[usize]) -> Result<Mlp, CheckpointError> {
        let mut mlp = Mlp::zeros(widths);
        for (n, layer) in mlp.layers.iter_mut().enumerate() {
            let (inputs, outputs) = (layer.inputs, layer.outputs);
            let w = self.f32(&format!("{name}.{n}.weight"), &[outputs, inputs])?;
            for i in 0..inputs {
                for o in 0..outputs {
                    layer.w[i * outputs + o] = w[o * inputs + i];
                }
            }
            layer.b = self.f32(&format!("{name}.{n}.bias"), &[outputs])?;
        }
        Ok(mlp)
    }

    fn view(&self, name: &str) -> Result<TensorView<'a>, CheckpointError> {
        self.tensors
            .tensor(name)
            .map_err(|_| CheckpointError::Missing { path: self.path.clone(), name: name.into() })
    }

    fn checked(&self, name: &str, shape: &[usize], dtype: Dtype) -> Result<TensorView<'a>, CheckpointError> {
        let view = self.view(name)?;
        let (path, name) = (self.path.clone(), name.to_owned());
        if view.shape() != shape {
            let (found, expected) = (view.shape().to_vec(), shape.to_vec());
            return Err(CheckpointError::Shape { path, name, found, expected });
        }
        if view.dtype() != dtype {
            let (found, expected) = (format!("{:?}", view.dtype()), format!("{dtype:?}"));
            return Err(CheckpointError::Type { path, name, found, expected });
        }
        Ok(view)
    }

    fn finite(&self, name: &str, all: bool) -> Result<(), CheckpointError> {
        if all {
            return Ok(());
        }
        Err(CheckpointError::NotFinite { path: self.path.clone(), name: name.into() })
    }
}

/// The encoder's tensors.
pub fn put_weights(out: &mut Writer, weights: &Weights) {
    out.f32("input.scale", &[3], weights.input.scale);
    out.f32("input.whole_mass", &[3], weights.input.whole_mass);
    if let Some(Colour { w, b }) = weights.input.colour {
        out.f32("colour.weight", &[2, 3], w.into_iter().flatten());
        out.f32("colour.bias", &[2], b);
    }
    for (n, conv) in weights.convs.iter().enumerate() {
        out.layer(&format!("conv{}", n + 1), conv);
    }
    out.layer("fc", &weights.fc);
    out.layer("head_c", &weights.head_c);
    out.layer("head_u", &weights.head_u);
}

/// Reads what [`put_weights`] wrote.
pub fn get_weights(from: &Reader<'_>) -> Result<Weights, CheckpointError> {
    let triple = |name: &str| -> Result<[f32; 3], CheckpointError> {
        let v = from.f32(name, &[3])?;
        Ok([v[0], v[1], v[2]])
    };
    let conv = |n: usize| {
        let c = CONVS[n];
        from.layer(&format!("conv{}", n + 1), &[c.outputs, c.inputs, c.kernel, c.kernel])
    };
    // z_c's head is twice as wide where the missing-mass features stand beside h.
    let gated = from.shape("head_c.weight")?.get(1) == Some(&(2 * FEATURES));
    let width = if gated { 2 * FEATURES } else { FEATURES };
    let colour = if from.has("colour.weight") {
        let (w, b) = (from.f32("colour.weight", &[2, 3])?, from.f32("colour.bias", &[2])?);
        Some(Colour { w: [[w[0], w[1], w[2]], [w[3], w[4], w[5]]], b: [b[0], b[1]] })
    } else {
        None
    };
    Ok(Weights {
        input: Input { scale: triple("input.scale")?, whole_mass: triple("input.whole_mass")?, colour },
        convs: [conv(0)?, conv(1)?, conv(2)?, conv(3)?],
        fc: from.layer("fc", &[FEATURES, POOLED])?,
        head_c: from.layer("head_c", &[LATENT, width])?,
        head_u: from.layer("head_u", &[LATENT, FEATURES])?,
    })
}

/// A name for the learned numbers, equal for equal weights: FNV-1a over the tensors' bytes.
pub fn fingerprint(model: &WorldModel) -> Result<String, CheckpointError> {
    Ok(files::fingerprint(&tensors(model)?))
}

fn tensors(model: &WorldModel) -> Result<Vec<u8>, CheckpointError> {
    let mut out = Writer::default();
    put_weights(&mut out, model.encoder.weights());
    out.f32("plane_c", &[LATENT, 2], model.plane_c.into_iter().flatten());
    out.f32("plane_u", &[LATENT, 2], model.plane_u.into_iter().flatten());
    out.f64("scale", &[1], [model.scale]);
    put_predictor(&mut out, &model.predictor);
    put_probe(&mut out, &model.probe);
    put_heads(&mut out, &model.heads);
    out.bytes()
}

fn parse(tensors: &[u8], config: &[u8], dir: &Path) -> Result<WorldModel, CheckpointError> {
    let path = dir.join(CONFIG);
    let card: Card = serde_json::from_slice(config)
        .map_err(|e| CheckpointError::Config { path: path.clone(), message: e.to_string() })?;
    if card.format != FORMAT {
        let message = format!("format is `{}`, expected `{FORMAT}`", card.format);
        return Err(CheckpointError::Config { path, message });
    }
    let from = Reader::new(tensors, dir.join(TENSORS))?;
    let plane = |name: &str| -> Result<[[f32; 2]; LATENT], CheckpointError> {
        let e = from.f32(name, &[LATENT, 2])?;
        Ok(std::array::from_fn(|k| [e[2 * k], e[2 * k + 1]]))
    };
    Ok(WorldModel {
        encoder: Encoder::new(get_weights(&from)?),
        plane_c: plane("plane_c")?,
        plane_u: plane("plane_u")?,
        scale: from.f64("scale", &[1])?[0],
        predictor: get_predictor(&from)?,
        heads: get_heads(&from)?,
        probe: get_probe(&from)?,
        card,
    })
}

/// The predictors' tensors.
pub fn put_predictor(out: &mut Writer, predictor: &Linear) {
    out.matrix("predictor.c0", &predictor.c0);
    out.matrix("predictor.c1", &predictor.c1);
    out.matrix("predictor.ca", &predictor.ca);
    out.matrix("predictor.u0", &predictor.u0);
    out.matrix("predictor.u1", &predictor.u1);
}

/// Reads what [`put_predictor`] wrote.
pub fn get_predictor(from: &Reader<'_>) -> Result<Linear, CheckpointError> {
    Ok(Linear {
        c0: from.matrix("predictor.c0")?,
        c1: from.matrix("predictor.c1")?,
        ca: from.matrix("predictor.ca")?,
        u0: from.matrix("predictor.u0")?,
        u1: from.matrix("predictor.u1")?,
    })
}

/// The probe's tensors.
pub fn put_probe(out: &mut Writer, probe: &Probe) {
    for (name, map) in [("probe.c", &probe.c), ("probe.u", &probe.u)] {
        out.matrix(&format!("{name}.matrix"), &map.matrix);
        out.f64(&format!("{name}.offset"), &[2], map.offset.iter().copied());
    }
}

/// Reads what [`put_probe`] wrote.
pub fn get_probe(from: &Reader<'_>) -> Result<Probe, CheckpointError> {
    let map = |name: &str| -> Result<Affine, CheckpointError> {
        let matrix: Matrix2<f64> = from.matrix(&format!("{name}.matrix"))?;
        let offset = from.f64(&format!("{name}.offset"), &[2])?;
        Ok(Affine { matrix, offset: Vector2::new(offset[0], offset[1]) })
    };
    Ok(Probe { c: map("probe.c")?, u: map("probe.u")? })
}

/// The risk and channel heads' tensors.
pub fn put_heads(out: &mut Writer, heads: &Heads) {
    out.mlp("heads.collision", &heads.collision);
    out.mlp("heads.gain", &heads.gain);
    out.f32("heads.gain_mean", &[1], [heads.gain_mean]);
    out.f32("heads.gain_std", &[1], [heads.gain_std]);
    out.f32("heads.scale", &[2], [heads.scale_c, heads.scale_u]);
    out.f32("heads.floor", &[1], [heads.floor]);
}

/// Reads what [`put_heads`] wrote.
pub fn get_heads(from: &Reader<'_>) -> Result<Heads, CheckpointError> {
    let scale = from.f32("heads.scale", &[2])?;
    Ok(Heads {
        collision: from.mlp("heads.collision", &COLLISION_WIDTHS)?,
        gain: from.mlp("heads.gain", &GAIN_WIDTHS)?,
        gain_mean: from.f32("heads.gain_mean", &[1])?[0],
        gain_std: from.f32("heads.gain_std", &[1])?[0],
        scale_c: scale[0],
        scale_u: scale[1],
        floor: from.f32("heads.floor", &[1])?[0],
    })
}
