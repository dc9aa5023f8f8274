//! MAVLink tools for any vehicle: router, parameters, missions, commands, replay.

pub mod bridge;
pub mod command;
pub mod fleet;
pub mod mission;
pub mod param;
pub mod replay;
pub mod retry;
pub mod session;
