//! Named tensors in a safetensors file: every shape, type and value is checked on reading.
//!
//! Knows names, shapes and bytes, not the meaning of the numbers.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use crpl_sitl::program::files::write_whole;
use nalgebra::SMatrix;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use crate::numeric::mlp::Mlp;

/// Why tensors could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum TensorError {
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

impl TensorError {
    /// For `map_err` on an operation on the file or folder `path`.
    pub fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { path, source }
    }
}

/// The bytes of a file.
///
/// # Errors
/// [`TensorError::File`] if it cannot be read.
pub fn read(path: &Path) -> Result<Vec<u8>, TensorError> {
    std::fs::read(path).map_err(TensorError::file(path))
}

/// Writes a file in one go ([`write_whole`]).
///
/// # Errors
/// [`TensorError::File`] if it cannot be written.
pub fn write_all(path: &Path, bytes: &[u8]) -> Result<(), TensorError> {
    write_whole(path, bytes).map_err(TensorError::file(path))
}

/// A value that is a set of named tensors.
pub trait Stored: Sized {
    /// Adds its tensors to a file.
    fn put(&self, out: &mut Writer);

    /// Reads what [`Stored::put`] wrote.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape or type, or a value is not finite.
    fn get(from: &Reader<'_>) -> Result<Self, TensorError>;
}

/// Collects named tensors and serialises them in a fixed order.
#[derive(Debug, Default)]
pub struct Writer {
    tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)>,
}

/// The largest magnitude of a stored f32. The shipped models stay below 400; with values far beyond, sums of
/// products overflow, and a network says anything.
const LARGEST: f32 = 1e6;

/// Whether a stored number can be one of a trained model: finite, and not absurdly large.
#[must_use]
pub fn is_sane(value: f32) -> bool {
    value.abs() <= LARGEST
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

    /// Adds a tensor of bytes.
    pub fn u8(&mut self, name: &str, shape: &[usize], values: impl IntoIterator<Item = u8>) {
        self.tensors.push((name.into(), Dtype::U8, shape.to_vec(), values.into_iter().collect()));
    }

    /// Adds a matrix of f64, row by row.
    pub fn matrix<const R: usize, const C: usize>(&mut self, name: &str, matrix: &SMatrix<f64, R, C>) {
        self.f64(name, &[R, C], matrix.transpose().iter().copied());
    }

    /// Adds `{name}.{n}.weight` `[out, in]` and `{name}.{n}.bias` for every layer.
    pub fn mlp(&mut self, name: &str, mlp: &Mlp) {
        for (n, layer) in mlp.layers.iter().enumerate() {
            let (inputs, outputs) = (layer.inputs, layer.outputs);
            let transposed = (0..outputs).flat_map(|o| (0..inputs).map(move |i| layer.w[i * outputs + o]));
            self.f32(&format!("{name}.{n}.weight"), &[outputs, inputs], transposed);
            self.f32(&format!("{name}.{n}.bias"), &[outputs], layer.b.iter().copied());
        }
    }

    /// The bytes of a safetensors file.
    ///
    /// # Errors
    /// [`TensorError::Format`] if a shape and its values disagree.
    pub fn bytes(&self) -> Result<Vec<u8>, TensorError> {
        self.bytes_about(None)
    }

    /// The bytes of a safetensors file with this metadata.
    ///
    /// # Errors
    /// [`TensorError::Format`] if a shape and its values disagree.
    pub fn bytes_about(&self, metadata: Option<HashMap<String, String>>) -> Result<Vec<u8>, TensorError> {
        let wrong = |e: safetensors::SafeTensorError| TensorError::Format {
            path: "tensors".into(),
            message: e.to_string(),
        };
        let mut views = Vec::with_capacity(self.tensors.len());
        for (name, dtype, shape, bytes) in &self.tensors {
            views.push((name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).map_err(wrong)?));
        }
        let sorted = |about: &HashMap<_, _>| serde_json::to_string(&about.iter().collect::<BTreeMap<_, _>>());
        let sorted = metadata.as_ref().map(sorted);
        let mut bytes = safetensors::serialize(views, metadata).map_err(wrong)?;
        if let Some(Ok(text)) = sorted {
            put_metadata(&mut bytes, &text);
        }
        Ok(bytes)
    }
}

/// Puts the same metadata in another order: the crate writes it in the order of a hash map, so equal values would
/// give files that differ.
fn put_metadata(bytes: &mut [u8], text: &str) {
    const KEY: &[u8] = b"{\"__metadata__\":";
    let place = 8 + KEY.len()..8 + KEY.len() + text.len();
    if bytes.get(8..place.start) == Some(KEY)
        && let Some(there) = bytes.get_mut(place)
    {
        there.copy_from_slice(text.as_bytes());
    }
}

/// The numbers of a tensor of f32.
fn words(view: &TensorView<'_>) -> Vec<f32> {
    view.data().as_chunks::<4>().0.iter().map(|w| f32::from_le_bytes(*w)).collect()
}

/// Reads named tensors and checks their shapes.
#[derive(Debug)]
pub struct Reader<'a> {
    tensors: SafeTensors<'a>,
    path: PathBuf,
}

impl<'a> Reader<'a> {
    /// Parses the bytes of a safetensors file; `path` is for the error messages.
    ///
    /// # Errors
    /// [`TensorError::Format`] if the bytes are not a safetensors file.
    pub fn new(bytes: &'a [u8], path: PathBuf) -> Result<Self, TensorError> {
        match SafeTensors::deserialize(bytes) {
            Ok(tensors) => Ok(Self { tensors, path }),
            Err(e) => Err(TensorError::Format { path, message: format!("not a safetensors file: {e}") }),
        }
    }

    /// Whether the file holds this tensor.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.tensors.tensor(name).is_ok()
    }

    /// The shape of a tensor.
    ///
    /// # Errors
    /// [`TensorError::Missing`]
    pub fn shape(&self, name: &str) -> Result<Vec<usize>, TensorError> {
        Ok(self.view(name)?.shape().to_vec())
    }

    /// A tensor of f32 with this shape.
    ///
    /// # Errors
    /// If a tensor is missing, has another shape or type, or a value is not finite.
    pub fn f32(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, TensorError> {
        let values = words(&self.checked(name, shape, Dtype::F32)?);
        self.finite(name, values.iter().all(|v| is_sane(*v)))?;
        Ok(values)
    }

    /// The same where NaN stands for what was not measured.
    ///
    /// # Errors
    /// If a tensor is missing, has another shape or type, or a value is infinite.
    pub fn f32_or_nan(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, TensorError> {
        let values = words(&self.checked(name, shape, Dtype::F32)?);
        self.finite(name, values.iter().all(|v| v.is_nan() || is_sane(*v)))?;
        Ok(values)
    }

    /// A tensor of bytes with this shape.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape or type.
    pub fn u8(&self, name: &str, shape: &[usize]) -> Result<Vec<u8>, TensorError> {
        Ok(self.checked(name, shape, Dtype::U8)?.data().to_vec())
    }

    /// Where in the file's `bytes` a tensor of bytes with this shape begins.
    ///
    /// # Errors
    /// If the tensor is missing or has another shape or type.
    pub fn place(&self, name: &str, shape: &[usize], bytes: &[u8]) -> Result<usize, TensorError> {
        let view = self.checked(name, shape, Dtype::U8)?;
        Ok(view.data().as_ptr().addr() - bytes.as_ptr().addr())
    }

    /// The metadata of the file's `bytes`; none is an empty map.
    ///
    /// # Errors
    /// [`TensorError::Format`] if the header does not parse.
    pub fn metadata(&self, bytes: &[u8]) -> Result<HashMap<String, String>, TensorError> {
        let wrong = |e: safetensors::SafeTensorError| TensorError::Format {
            path: self.path.clone(),
            message: e.to_string(),
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(wrong)?;
        Ok(header.metadata().clone().unwrap_or_default())
    }

    /// A tensor of f64 with this shape.
    ///
    /// # Errors
    /// If a tensor is missing, has another shape or type, or a value is not finite.
    pub fn f64(&self, name: &str, shape: &[usize]) -> Result<Vec<f64>, TensorError> {
        let view = self.checked(name, shape, Dtype::F64)?;
        let (words, _) = view.data().as_chunks::<8>();
        let values: Vec<f64> = words.iter().map(|w| f64::from_le_bytes(*w)).collect();
        self.finite(name, values.iter().all(|v| v.is_finite()))?;
        Ok(values)
    }

    /// A matrix of f64.
    ///
    /// # Errors
    /// If a tensor is missing, has another shape or type, or a value is not finite.
    pub fn matrix<const R: usize, const C: usize>(
        &self,
        name: &str,
    ) -> Result<SMatrix<f64, R, C>, TensorError> {
        Ok(SMatrix::from_row_slice(&self.f64(name, &[R, C])?))
    }

    /// The network with these widths.
    ///
    /// # Errors
    /// If a tensor is missing, has another shape or type, or a value is not finite.
    pub fn mlp(&self, name: &str, widths: &[usize]) -> Result<Mlp, TensorError> {
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

    fn view(&self, name: &str) -> Result<TensorView<'a>, TensorError> {
        self.tensors
            .tensor(name)
            .map_err(|_| TensorError::Missing { path: self.path.clone(), name: name.into() })
    }

    fn checked(&self, name: &str, shape: &[usize], dtype: Dtype) -> Result<TensorView<'a>, TensorError> {
        let view = self.view(name)?;
        let (path, name) = (self.path.clone(), name.to_owned());
        if view.shape() != shape {
            let (found, expected) = (view.shape().to_vec(), shape.to_vec());
            return Err(TensorError::Shape { path, name, found, expected });
        }
        if view.dtype() != dtype {
            let (found, expected) = (format!("{:?}", view.dtype()), format!("{dtype:?}"));
            return Err(TensorError::Type { path, name, found, expected });
        }
        Ok(view)
    }

    fn finite(&self, name: &str, all: bool) -> Result<(), TensorError> {
        if all {
            return Ok(());
        }
        Err(TensorError::NotFinite { path: self.path.clone(), name: name.into() })
    }
}
