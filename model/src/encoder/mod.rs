//! Frame to latents: the JEPA encoder (Sec. III-B), for flights and for training.

pub mod infer;
#[cfg(feature = "train")]
pub mod module;
pub mod probe;
pub mod weights;
