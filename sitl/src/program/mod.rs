//! The shells: flags, sockets, timers, logs. All that a state machine must not know.
//!
//! | module | what it is |
//! |---|---|
//! | [`terminal`] | what `sitl`, `gcs` and `model` share: flags, log, output, errors, exit codes, signals |
//! | [`renamed`] | words of the command line that have changed |
//! | [`air`] | `--radio`: everything through the air |
//! | [`camera`] | `--camera` |
//! | [`cli`] | flags to a running vehicle |
//! | [`columns`] | tables that fit the terminal |
//! | [`common`] | flags and subcommands of all three programs: log, completions, manual pages |
//! | [`files`] | files that are whole or absent |
//! | [`flight_log`] | the folder of a flight as the vehicle knows it |
//! | [`fleet`] | many vehicles in one process: ids, ports, obstacles |
//! | [`log`] | the log on stderr |
//! | [`page`] | a page in the browser that shows what a program does |
//! | [`priority`] | threads whose work may be late |
//! | [`progress`] | progress bars, and lines where there is no terminal |
//! | [`shard`] | one machine's share of a computation |
//! | [`shell`] | sockets and timers: lockstep and real time |
//! | [`timing`] | how late intervals begin, and the processor's time |

pub mod air;
pub mod camera;
pub mod cli;
pub mod columns;
pub mod common;
pub mod files;
pub mod fleet;
pub mod flight_log;
pub mod log;
pub mod page;
pub mod priority;
pub mod progress;
pub mod renamed;
pub mod shard;
pub mod shell;
pub mod terminal;
pub mod timing;
