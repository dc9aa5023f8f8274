//! The learned encoder: a small convolutional trunk in which every cell votes for each body's centre.
//!
//! Four convolutions take a frame to 25x25 cells; for each body a cell gives a logit l and an offset o. The
//! body's place is p = Σ w_i (x_i + o_i), w the softmax of 8 l over the cells and x_i the cell's centre, px.
//! So p is in picture coordinates by construction, and the action, known in the same unit, fixes its scale:
//! the prediction loss has no collapsed solution. z_c = E_c S (p_c - 50)/100 and z_u alike.
//!
//! Trained from random weights on recorded pictures and actions (`training::learned`). Knows frames, no
//! positions.

#[cfg(feature = "train")]
pub mod module;
pub mod network;
pub mod noise;
pub mod readout;
pub mod weights;

pub use network::{Activations, VoteEncoder, VoteGradient};
pub use readout::{Votes, VotesGradient};
pub use weights::VoteWeights;

/// Bodies that are read from a frame: the UAV, then the obstacle.
pub const BODIES: usize = 2;
