//! A ground station that flies a UAV from pictures.

pub mod fly;
pub mod remote;
