//! Algorithm 1: π_s and π_p optimised on latent rollouts, once or in flight.

pub mod algorithm1;
mod area;
mod exact;
mod head;
pub(crate) mod lanes;
mod lookahead;
pub mod objective;
pub mod policy;
mod power;
mod problem;
mod receding;
mod rollout;
