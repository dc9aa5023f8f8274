//! What is learned of the world: the JEPA encoder and predictors, the risk and channel heads, and
//! CRPL's two policies.

pub mod crpl;
pub mod kernel;
pub mod mlp;
pub mod optimise;
pub mod policy;
