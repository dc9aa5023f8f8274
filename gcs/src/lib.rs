//! A ground station that flies a UAV from camera frames.
//!
//! ```text
//! Percept --> Station: encode --> Belief --> Pilot --> Command      (sans-IO)
//!    ^                                                     |
//!    +---------- flight: UDP, MAVLink, tlog ---------------+
//! ```
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`station`] | percept in, command out: belief, controllers, trained models | sockets, clocks, bytes |
//! | [`tools`] | MAVLink tools for any vehicle: router, parameters, missions, replay | controllers |
//! | [`flight`] | the shell of a flight over a link, on `sitl` or a foreign autopilot | controllers' insides |
//! | [`lab`] | flights in process, demo, sweeps, reports, run folders | protocols |

pub mod flight;
pub mod lab;
pub mod station;
pub mod tools;
