//! What each fuzz target does with its bytes.
//!
//! A target promises three things of any input: no panic, no end without an answer (a hang), and memory
//! that stays bounded. The engine looks after all three. Some targets also promise what stands in them as
//! an assertion.

pub mod bytes;
pub mod files;
pub mod router;
pub mod vehicle;
pub mod wire;
