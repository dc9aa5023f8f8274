//! What is learned of the world: the JEPA encoder and predictors, the risk and channel heads, and
//! CRPL's two policies.
//!
//! ```
//! use crpl_model::encoder::weights::vector;
//! use crpl_model::predictor::Begin;
//! use crpl_model::world_model::WorldModel;
//! use crpl_sitl::{Scenario, camera};
//! use nalgebra::Vector2;
//!
//! // The shipped world model, and a frame with the UAV at (0.3, 0.4) and the obstacle at (0.7, 0.6).
//! let world = WorldModel::embedded()?;
//! let frame = camera::render(Vector2::new(0.3, 0.4), Vector2::new(0.7, 0.6), &Scenario::default());
//! let latent = world.encode(&frame);
//! assert!((world.uav(&latent) - Vector2::new(0.3, 0.4)).norm() < 0.01);
//!
//! // Ten intervals of full acceleration to the right, from rest.
//! let now = vector(world.y_c(&latent));
//! let actions = [Vector2::new(1.0, 0.0); 10];
//! let path = world.predictor.rollout(Begin { now, before: now, actions: &actions });
//! assert!(world.probe.c.apply(path[9]).x > 0.45);
//! # Ok::<(), crpl_model::world_model::checkpoint::CheckpointError>(())
//! ```
//!
//! ```text
//! frame --> encoder --> latents {z_c, z_u} --> predictor (rollouts) --> heads (risk, gain)
//! ```
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`numeric`] | inner loops, small networks, optimisers, statistics | what they are for |
//! | [`encoder`] | frame to latents: plain Rust for flights, a burn module for training | link, policies |
//! | [`predictor`] | linear, MLP and LSTM predictors; the observer | frames, positions |
//! | [`heads`] | collision probability and channel gain: labels, networks | frames |
//! | [`world_model`] | the learned world as one value, its files and its configuration | physics, link, policies |
//! | [`evaluation`] | accuracy of a world model on held-out frames | training |
//! | [`training`] | the recipe and its pieces | flights |
//! | [`planning`] | policies, J_η on latent rollouts, Algorithm 1 | frames |
//!
//! What needs burn comes with the cargo feature `train`, which the `model` program has and a ground
//! station does without.

pub mod encoder;
pub mod evaluation;
pub mod heads;
pub mod numeric;
pub mod planning;
pub mod predictor;
pub mod training;
pub mod world_model;

/// Git revision of the sources from which this was compiled, with `-dirty` if one of them differed from
/// it; `unknown` where git did not tell. Files that are not compiled, such as documents, do not count.
#[must_use]
pub const fn revision() -> &'static str {
    env!("CRPL_REVISION")
}
