//! What is learned of the world: the JEPA encoder and predictors, the risk and channel heads, and
//! CRPL's two policies.
//!
//! ```text
//! picture --> infer::Encoder --> Latent {z_c, z_u} --> predictor (rollouts) --> heads (risk, gain)
//!                  ^ weights
//! dataset --> lens --> jepa (burn) [gradient] --> closed_form --> checkpoint   train.rs reads top to bottom
//! ```
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`world_model`] | the learned world as one value | physics, link, policies |
//! | [`infer`] | the flight path's encoder, plain Rust | burn |
//! | [`config`] | every number of the training | how it is done |
//! | `jepa` | the same encoder as a burn module, online and target | losses, data |
//! | [`weights`] | the encoder's numbers and its structured start | pictures |
//! | [`closed_form`] | the latent heads by least squares | labels |
//! | [`predictor`] | linear second-order steps of both halves | pictures, positions |
//! | [`predictors`] | the MLP and the LSTM that it is compared with | pictures, positions |
//! | `predictors_fit`, `predictors_back` | their training, and its gradient by hand | positions, heads |
//! | [`observer`] | place and speed from several latents and the actions flown | pictures, positions |
//! | [`heads`] | collision probability and channel gain: labels, measures | networks |
//! | [`heads_at`] | the heads' networks, and what they are for one base station | labels |
//! | `heads_fit` | their training in burn | pictures |
//! | [`stages`] | which stages a training has | how they are done |
//! | `gradient`, `losses`, [`adamw`] | the gradient stage: online and target encoder | labels |
//! | [`lens`] | harder cameras, put on the clean picture | positions |
//! | [`alarms`] | what a loss does not show: collapse, a lost body | training |
//! | [`hard`] | where an encoder breaks, case by case | training |
//! | `fit`, `kept` | the pieces of a training; finished stages on disk | their order |
//! | `ablate` | the recipe with one thing changed | files |
//! | [`probe`] | latents to positions, to measure and to draw | training |
//! | [`dataset`] | episodes from the simulator's world | networks |
//! | `train` | the recipe | flights |
//! | [`evaluate`] | what it is worth on held-out pictures | training |
//! | [`flown`] | the chance constraints, counted in closed-loop flights | Algorithm 1 |
//! | [`plot`] | line charts as SVG and PNG | what they show |
//! | [`policy`] | π_s and π_p, and how they are executed | positions, bandwidth |
//! | [`crpl`] | J_η on latent rollouts, and its gradient | pictures |
//! | [`optimise`] | Algorithm 1 | the simulator |
//! | [`checkpoint`] | files, names and shapes | numbers |
//! | [`mlp`], [`kernel`] | small networks and inner loops | what they are for |
//!
//! `jepa`, `heads_fit`, `gradient`, `losses`, `fit`, `kept`, `ablate` and `train` need burn: they come
//! with the cargo feature `train`, which the `model` program has and a ground station does without.

#![allow(rustdoc::broken_intra_doc_links, reason = "shapes are written [rows, columns]")]

#[cfg(feature = "train")]
pub mod ablate;
pub mod adamw;
pub mod alarms;
pub mod checkpoint;
pub mod closed_form;
pub mod config;
pub mod crpl;
pub mod dataset;
pub mod evaluate;
#[cfg(feature = "train")]
pub mod fit;
pub mod flown;
#[cfg(feature = "train")]
pub mod gradient;
pub mod hard;
pub mod heads;
pub mod heads_at;
#[cfg(feature = "train")]
pub mod heads_fit;
pub mod infer;
#[cfg(feature = "train")]
pub mod jepa;
#[cfg(feature = "train")]
pub mod kept;
pub mod kernel;
pub mod lens;
#[cfg(feature = "train")]
pub mod losses;
pub mod mlp;
pub mod observer;
pub mod optimise;
pub mod plot;
pub mod policy;
pub mod predictor;
pub mod predictors;
mod predictors_back;
pub mod predictors_fit;
pub mod probe;
pub mod stages;
#[cfg(feature = "train")]
pub mod train;
pub mod weights;
pub mod world_model;
