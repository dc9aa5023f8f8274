//! A UAV simulator with a camera and a real radio in the way, spoken to over MAVLink 2.
//!
//! ```text
//! World --> camera --> Percept ==[link]==> ground station
//!   ^                                          |
//!   +-- Sim: fly the held action <-- radio gate <==[link]-- Command
//! ```
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`scenario`] | every parameter of a flight, with the paper as default | files other than its own |
//! | [`units`] | ticks, SNR, the scale between the paper's square and NED metres | physics |
//! | [`msg`] | what crosses the link: [`msg::Command`], [`msg::Percept`] | bytes |
//! | [`world`] | the paper's Section IV-A, one formula a function | protocol, controllers |
//! | [`camera`] | world to 100x100 picture | physics |
//! | [`radio`] | the gate: delivered, delayed, superseded, lost; hold-last | geometry |
//! | [`sim`] | world + gate + camera, a state machine | clocks, sockets |
//! | [`link`] | MAVLink 2 in datagrams, for both programs | physics, controllers |
//! | [`vehicle`] | `Sim` as MAVLink peers see it, a state machine | clocks, sockets |
//! | [`shell`] | sockets and timers: lockstep and real time | what a datagram means |
//! | [`fleet`] | many vehicles in one process: ids, ports, obstacles | sockets |
//! | [`cli`] | flags to a running vehicle | |
//! | [`stats`] | how late intervals begin, and the processor's time | vehicles |
//! | [`record`] | one line per control interval, and the five metrics | where the lines came from |
//!
//! Nothing here opens a socket or reads a clock but the shells of the program.

pub mod camera;
pub mod cli;
pub mod fleet;
pub mod link;
pub mod msg;
pub mod radio;
pub mod record;
mod revision;
pub mod scenario;
pub mod shell;
pub mod sim;
pub mod stats;
pub mod units;
pub mod vehicle;
pub mod world;

pub use revision::revision;
pub use scenario::Scenario;
pub use sim::Sim;
