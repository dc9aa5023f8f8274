//! MAVLink tools for any vehicle: router, radio link, parameters, missions, commands, replay, logs, keys.

pub mod bridge;
pub mod command;
pub mod encode;
pub mod export;
pub mod fleet;
pub mod identity;
pub mod key;
pub mod link;
pub mod mission;
pub mod param;
pub mod parquet;
pub mod replay;
pub mod retry;
pub mod session;
pub mod spotter;
pub mod steering;
pub mod texts;
pub mod tlog;
