//! What the rest computes with: inner loops, small networks, the optimiser, tensors in files.

pub mod adam;
pub mod kernel;
pub mod mlp;
pub mod tensors;
