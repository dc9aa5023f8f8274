//! A UAV simulator that speaks MAVLink 2, renders its camera, and models the radio link.
//!
//! ```text
//! World --> camera --> Percept ==[link]==> ground station
//!   ^                                          |
//!   +-- Sim: fly the held action <-- radio gate <==[link]-- Command
//! ```
//!
//! ```
//! use crpl_sitl::radio::message::Command;
//! use crpl_sitl::units::{Motion, TxPower};
//! use crpl_sitl::{Scenario, Sim};
//!
//! // Ten intervals of full acceleration to the east, commands through the radio at high power.
//! let mut sim = Sim::new(Scenario::numbered(2)?, 0);
//! let (scale, a_max) = (sim.scenario().scale, sim.scenario().dynamics.a_max);
//! for _ in 0..10 {
//!     let accel = scale.ned_from_paper_acceleration(a_max * Motion::East.vector());
//!     sim.handle(Command::new(sim.tick(), accel, TxPower::High));
//!     sim.advance();
//! }
//! assert!(sim.world().uav.r.x > 0.2);
//! # Ok::<(), crpl_sitl::scenario::ScenarioError>(())
//! ```
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`units`] | ticks, SNR, actions, the scale between the paper's square and NED metres | physics |
//! | [`scenario`] | every parameter of a flight, with the paper as default | files other than its own |
//! | [`world`] | the paper's Sec. IV-A, one formula a function | protocol, controllers |
//! | [`camera`] | world to 100x100 frame | physics |
//! | [`radio`] | what crosses the radio, and the gate: delivered, delayed, superseded, lost; `air`: whole frames | bytes |
//! | [`sim`] | world + radio + camera, a state machine; records and metrics | clocks, sockets |
//! | [`link`] | MAVLink 2 in datagrams, for both programs | physics, controllers |
//! | [`vehicle`] | `Sim` as MAVLink peers see it, a state machine | clocks, sockets |
//! | [`program`] | sockets, timers, flags, logs | what a datagram means |
//!
//! A module uses only modules above it in this table. Nothing but [`program`] opens a socket or reads
//! a clock.

pub mod camera;
pub mod link;
pub mod program;
pub mod radio;
pub mod scenario;
pub mod sim;
pub mod units;
pub mod vehicle;
pub mod world;

pub use scenario::Scenario;
pub use sim::Sim;

/// Git revision of the sources from which this was compiled, with `-dirty` if one of them differed from
/// it; `unknown` where git did not tell. Files that are not compiled, such as documents, do not count.
#[must_use]
pub const fn revision() -> &'static str {
    env!("CRPL_REVISION")
}
