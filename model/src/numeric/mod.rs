//! What the rest computes with: inner loops, small networks, the optimiser, statistics, tensors in files.

pub mod adam;
pub mod conv;
pub mod kernel;
pub mod mlp;
pub mod statistics;
pub mod tensors;
pub mod winograd;
