//! The shell that flies a station: percept in, command out, until the last tick or an event that ends it.
//!
//! The same loop serves a vehicle in lockstep and one in real time. What comes late or not at all
//! is asked for again; commands are repeated, which also keeps the time-outs of real autopilots
//! away. Knows no controller: the station is a [`Crew`].
//!
//! Other stations may watch through the same program (`Options::forward`). During the flight their
//! setpoints are not forwarded. An operator's change of mode is; once the vehicle has accepted it, the station
//! stops its setpoints, reports that, and goes on forwarding messages.
//!
//! | a flight ends | the vehicle is left |
//! |---|---|
//! | after its last tick, when its crew is done, or in a fall | as its last command has it |
//! | by SIGINT, SIGTERM or SIGHUP | in mode BRAKE, which is asked for four times |
//! | because its controller, a program, gives no answers | the same |
//! | because an operator changed its mode | to the operator; a page that may steer can give it back, and the flight goes on |
//! | because another station's setpoint is flown | to the other station: no more setpoints from here |
//! | because it has booted anew | as it has booted: no more setpoints from here |
//! | because the link is lost | to its own failsafe |
//!
//! | file | what it is |
//! |---|---|
//! | `options` | how to fly |
//! | `crew` | who decides |
//! | `outcome` | what the flight was, and how it has ended |
//! | `shell` | the loop |

mod crew;
pub mod foreign;
mod options;
mod outcome;
pub mod remote;
mod shell;
pub mod world;

pub use crew::Crew;
pub use options::Options;
pub use outcome::{Flight, FlightEnd};
pub use shell::{fly, fly_on};

#[cfg(test)]
mod tests;
