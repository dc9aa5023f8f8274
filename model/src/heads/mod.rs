//! Collision probability and channel gain, read from the latents.

pub mod labels;
pub mod networks;
