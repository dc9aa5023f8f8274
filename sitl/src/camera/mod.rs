//! World to frame: 100x100 RGB. [`mod@render`] draws discs on black; [`film`] is the camera of one flight,
//! with all effects of a scenario's `[camera]`, which [`config`] lists and [`cases`] names.
//! [`effects`] are the six cameras that the encoder `centroid` knows.

mod canvas;
pub mod cases;
pub mod config;
mod distractor;
pub mod effects;
pub mod film;
pub mod frame;
pub mod ground;
mod jpeg;
mod palette;
pub mod picture;
mod poses;
pub mod render;
pub mod strength;

pub use config::CameraConfig;
pub use film::Film;
pub use frame::{CHANNELS, COLOURS, Frame, SIDE};
pub use poses::{Body, Poses};
pub use render::{Sizes, render, render_all};
