//! A ground station that flies a UAV from camera frames.
//!
//! ```text
//! Percept --> Station: encode --> Belief --> Pilot --> Command      (sans-IO)
//!    ^                                                     |
//!    +---------- flight: UDP, MAVLink, tlog ---------------+
//! ```
//!
//! ```
//! use crpl_gcs::station::models::Models;
//! use crpl_gcs::station::pilot::Controller;
//! use crpl_sitl::{Scenario, Sim};
//!
//! // The reactive baseline in Scenario 2, without a network.
//! let scenario = Scenario::numbered(2)?;
//! let mut sim = Sim::new(scenario.clone(), 0);
//! let mut station = Models::load(None, None)?.station(Controller::Rcc, &scenario)?;
//! for _ in 0..scenario.horizon {
//!     let command = station.handle(&sim.percept());
//!     sim.handle(command);
//!     sim.advance();
//! }
//! station.finish(&sim.percept());
//! assert!(station.score().is_some());
//! # Ok::<(), anyhow::Error>(())
//! ```
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`station`] | percept in, command out: belief, controllers, trained models | sockets, clocks, bytes |
//! | [`watch`] | what a station knows as lines of a page, `flight.html` | links, run folders |
//! | [`tools`] | MAVLink tools for any vehicle: router, radio link, parameters, missions | controllers |
//! | [`flight`] | the shell of a flight over a link, on `sitl` or a foreign autopilot | controllers' insides |
//! | [`lab`] | flights in process, demo, sweeps, reports, run folders | protocols |

pub mod flight;
pub mod lab;
pub mod station;
pub mod tools;
pub mod watch;

/// Git revision of the sources from which this was compiled, with `-dirty` if one of them differed from
/// it; `unknown` where git did not tell. Files that are not compiled, such as documents, do not count.
#[must_use]
pub const fn revision() -> &'static str {
    env!("CRPL_REVISION")
}

/// Names the bytes of the code that was compiled: results of equal names were computed by the same code.
#[must_use]
pub const fn sources() -> &'static str {
    env!("CRPL_SOURCES")
}
