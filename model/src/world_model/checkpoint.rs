//! A world model on disk: `model.safetensors` (named tensors, PyTorch's layouts), `config.json` (what
//! decided its bytes, and its metrics) and `card.md` (the same for people, with time and revision).
//!
//! Every shape is checked on reading. Knows files and names; computes nothing.

use std::path::{Path, PathBuf};

use crpl_sitl::program::files;

use crate::encoder::BuiltIn;
use crate::encoder::weights::LATENT;
use crate::numeric::tensors::{self, Reader, Stored, TensorError, Writer};
use crate::predictor::linear::Linear;
use crate::predictor::{Networks, PREDICTORS, Predictor, PredictorKind};
use crate::world_model::card::Card;
use crate::world_model::sight::FrameEncoder;
use crate::world_model::{WorldModel, plane};

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
    /// The tensors could not be read or written.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// The file of networks lacks the predictor that is asked for.
    #[error("no trained predictor `{0}`")]
    Predictor(&'static str),
    /// The networks belong to another world model.
    #[error("{PREDICTORS} was trained on world model {networks}, and this is {here}")]
    World {
        /// Fingerprint of this world model.
        here: String,
        /// Fingerprint of the world model on whose latents the networks were trained.
        networks: String,
    },
    /// The configuration does not parse.
    #[error("{path}: {message}")]
    Config {
        /// The file.
        path: PathBuf,
        /// From the parser.
        message: String,
    },
}

impl WorldModel {
    /// Reads `model.safetensors` and `config.json` in `dir`, and `predictors.safetensors` if the
    /// configuration's `predictor.kind` names one of the networks there.
    ///
    /// # Errors
    /// If a file is missing, does not parse, or holds a tensor of another shape.
    pub fn load(dir: &Path) -> Result<Self, CheckpointError> {
        let files = (tensors::read(&dir.join(TENSORS))?, tensors::read(&dir.join(CONFIG))?);
        let model = Self::from_bytes(&files.0, &files.1, dir)?;
        match model.card.config.predictor.kind {
            PredictorKind::Linear => Ok(model),
            kind => model.with_predictor(kind, &Networks::load(dir)?),
        }
    }

    /// The world model of the bytes of its two files; `dir` names them in errors.
    ///
    /// # Errors
    /// The bytes do not parse, or hold a tensor of another shape.
    pub fn from_bytes(tensors: &[u8], config: &[u8], dir: &Path) -> Result<Self, CheckpointError> {
        let path = dir.join(CONFIG);
        let card: Card = serde_json::from_slice(config)
            .map_err(|e| CheckpointError::Config { path: path.clone(), message: e.to_string() })?;
        if card.format != FORMAT {
            let message = format!("format is `{}`, expected `{FORMAT}`", card.format);
            return Err(CheckpointError::Config { path, message });
        }
        let from = Reader::new(tensors, dir.join(TENSORS))?;
        let columns = |name: &str| -> Result<[[f32; 2]; LATENT], TensorError> {
            let e = from.f32(name, &[LATENT, 2])?;
            Ok(std::array::from_fn(|k| [e[2 * k], e[2 * k + 1]]))
        };
        let (plane_c, linear) = (columns("plane_c")?, Linear::get(&from)?);
        Ok(Self {
            encoder: Stored::get(&from)?,
            plane_c,
            plane_u: columns("plane_u")?,
            scale: from.f64("scale", &[1])?[0],
            predictor: Predictor::Linear(linear.controllable(&plane(&plane_c))),
            linear,
            heads: Stored::get(&from)?,
            probe: Stored::get(&from)?,
            card,
        })
    }

    /// The same world model with another predictor of the controllable half.
    ///
    /// # Errors
    /// If `networks` lacks it, or was trained on another world model.
    pub fn with_predictor(
        mut self,
        kind: PredictorKind,
        networks: &Networks,
    ) -> Result<Self, CheckpointError> {
        let here = planning_fingerprint(&self)?;
        if kind != PredictorKind::Linear && networks.world != here {
            return Err(CheckpointError::World { here, networks: networks.world.clone() });
        }
        self.predictor = Predictor::of(kind, self.controllable(), networks)
            .ok_or(CheckpointError::Predictor(kind.name()))?;
        self.card.config.predictor.kind = kind;
        Ok(self)
    }

    /// Writes `model.safetensors` and `config.json` into `dir`, which is made if it is not there.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn save(&self, dir: &Path) -> Result<(), CheckpointError> {
        std::fs::create_dir_all(dir).map_err(TensorError::file(dir))?;
        let mut config = serde_json::to_vec_pretty(&self.card)
            .map_err(|e| CheckpointError::Config { path: dir.join(CONFIG), message: e.to_string() })?;
        config.push(b'\n');
        tensors::write_all(&dir.join(TENSORS), &bytes(self)?)?;
        Ok(tensors::write_all(&dir.join(CONFIG), &config)?)
    }

    /// The model that programs take where none is named: [`BuiltIn::Learned`].
    ///
    /// # Errors
    /// If the program was built with a checkpoint of another format.
    pub fn embedded() -> Result<Self, CheckpointError> {
        Self::built_in(BuiltIn::default())
    }

    /// A model that ships with the program, trained by `model train`.
    ///
    /// # Errors
    /// If the program was built with a checkpoint of another format.
    pub fn built_in(which: BuiltIn) -> Result<Self, CheckpointError> {
        let (tensors, config): (&[u8], &[u8]) = match which {
            BuiltIn::Centroid => (
                include_bytes!("../../pretrained/model.safetensors"),
                include_bytes!("../../pretrained/config.json"),
            ),
            BuiltIn::Learned => (
                include_bytes!("../../pretrained/learned/model.safetensors"),
                include_bytes!("../../pretrained/learned/config.json"),
            ),
        };
        Self::from_bytes(tensors, config, &Path::new("built-in").join(which.name()))
    }

    /// The model that `--checkpoint` names: `centroid` or `learned`, which are built in, or a folder.
    ///
    /// # Errors
    /// If there is no such folder, or what is there is no world model.
    pub fn named(name: &Path) -> Result<Self, CheckpointError> {
        match BuiltIn::of(name) {
            Some(which) => Self::built_in(which),
            None => Self::load(name),
        }
    }
}

/// A name for the learned numbers, equal for equal weights: FNV-1a over the tensors' bytes.
///
/// # Errors
/// [`TensorError::Format`] if a tensor's shape and values disagree.
pub fn fingerprint(model: &WorldModel) -> Result<String, TensorError> {
    Ok(files::fingerprint(&bytes(model)?))
}

/// A name for the world that policies and networks are made in: the same for two learned encoders that differ in
/// nothing but how they read a picture, as an adapted one does. Their plane is the picture's, so what was made for
/// one holds for the other.
///
/// # Errors
/// [`TensorError::Format`] if a tensor's shape and values disagree.
pub fn planning_fingerprint(model: &WorldModel) -> Result<String, TensorError> {
    match model.encoder {
        FrameEncoder::Centroid(_) => fingerprint(model),
        FrameEncoder::Learned(_) => {
            let mut out = Writer::default();
            put_planning(model, &mut out);
            Ok(files::fingerprint(&out.bytes()?))
        }
    }
}

fn bytes(model: &WorldModel) -> Result<Vec<u8>, TensorError> {
    let mut out = Writer::default();
    model.encoder.put(&mut out);
    put_planning(model, &mut out);
    out.bytes()
}

/// All but the encoder.
fn put_planning(model: &WorldModel, out: &mut Writer) {
    out.f32("plane_c", &[LATENT, 2], model.plane_c.into_iter().flatten());
    out.f32("plane_u", &[LATENT, 2], model.plane_u.into_iter().flatten());
    out.f64("scale", &[1], [model.scale]);
    model.linear.put(out);
    model.probe.put(out);
    model.heads.put(out);
}
