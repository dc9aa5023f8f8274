//! Algorithm 1: π_s and π_p optimised on latent rollouts, once or in flight.

pub mod algorithm1;
pub mod area;
pub mod config;
pub mod exact;
pub mod head;
pub(crate) mod lanes;
pub mod lookahead;
pub mod objective;
pub mod outlook;
pub mod plant;
pub mod policy;
mod power;
pub mod problem;
pub mod receding;
mod rollout;
pub mod scope;
