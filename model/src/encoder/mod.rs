//! Frame to latents: the JEPA encoder (Eq. (2), Sec. II-A1; layers: Sec. IV-A2), for flights and for training.

pub mod infer;
#[cfg(feature = "train")]
pub mod module;
pub mod probe;
pub mod votes;
pub mod weights;

use std::path::Path;

/// The world models that ship with the programs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum BuiltIn {
    /// Hand-set kernels that carry centroids of colours: for the clean drawing.
    Centroid,
    /// Trained end to end from random weights on recorded pictures of clean and hard cameras: the one that programs
    /// take where none is named.
    #[default]
    Learned,
}

impl BuiltIn {
    /// The one of this name.
    #[must_use]
    pub fn of(name: &Path) -> Option<Self> {
        [Self::Centroid, Self::Learned].into_iter().find(|which| Path::new(which.name()) == name)
    }

    /// Its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Centroid => "centroid",
            Self::Learned => "learned",
        }
    }
}
