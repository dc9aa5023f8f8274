//! What the rest computes with: inner loops, small networks, optimisers.

pub mod adam;
pub mod adamw;
pub mod kernel;
pub mod mlp;
