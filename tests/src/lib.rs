//! What the whole-system tests share: the real programs, a path that loses datagrams, the Python
//! peers, the browser, and the golden vectors.
//!
//! The tests themselves lie in `tests/`, what they do in Python in `python/`, what they do in a
//! browser in `browser/`. Nothing here knows what
//! a flight is.

#![expect(clippy::disallowed_methods, reason = "whole programs run on the wall's time")]

pub mod browser;
pub mod fake_autopilot;
pub mod fake_params;
pub mod golden;
pub mod interchange;
pub mod program;
pub mod python;
pub mod relay;
