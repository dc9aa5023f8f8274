//! World to frame: 100x100 RGB. [`mod@render`] draws discs on black, [`effects`] makes of that clean frame
//! the one that a real camera would take.

pub mod effects;
pub mod frame;
pub mod render;

pub use frame::{CHANNELS, COLOURS, Frame, SIDE};
pub use render::{Sizes, render, render_all};
