//! Latents of the next interval from those of the last two and an action.

pub(crate) mod backprop;
pub mod linear;
pub mod networks;
pub mod observer;
