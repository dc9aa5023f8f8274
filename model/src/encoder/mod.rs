//! Frame to latents: the JEPA encoder (Eq. (2), Sec. II-A1; layers: Sec. IV-A2), for flights and for training.

pub mod frame_encoder;
pub mod infer;
#[cfg(feature = "train")]
pub mod module;
pub mod probe;
pub mod votes;
pub mod weights;
