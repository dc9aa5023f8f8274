//! A radio for whole frames: geometry to SNR, SNR to rate and loss, and frames through a modem.
//!
//! The radio gate ([`super::Gate`]) decides on setpoints of four bits. This is the radio for everything that crosses
//! a link, in both ways, at its length. Knows neither bytes nor messages nor clocks: a frame is a length and a kind.
//!
//! | module | what it is |
//! |---|---|
//! | [`pathloss`] | one published formula a function |
//! | [`blockage`] | discs, prisms, GeoJSON buildings; knife edges |
//! | [`fading`] | Rician fading by slot, shadowing by place |
//! | [`rate`] | SNR to rate, SNR to loss |
//! | [`config`] | a radio as a file, and the presets |
//! | [`scenic`] | the radio of a scenario, for whole frames |
//! | [`channel`] | all of the above: geometry to SNR |
//! | [`modem`] | queue, air time, repetition, time slots, delay |
//! | [`track`] | where a vehicle was, by time |

pub mod blockage;
pub mod channel;
pub mod config;
pub mod fading;
pub mod modem;
pub mod pathloss;
pub mod rate;
pub mod scenic;
pub mod track;

pub use channel::Way;
pub use config::AirRadio;
pub use modem::{Air, AirReport, CarriedFrame, FrameFate};
