//! What the rest computes with: inner loops, small networks, optimisers, statistics.

pub mod adam;
pub mod adamw;
pub mod kernel;
pub mod mlp;
pub mod statistics;
