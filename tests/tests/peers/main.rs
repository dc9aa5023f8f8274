//! The real MAVLink tools that people arrive with, against the real programs.

#![expect(clippy::disallowed_methods, reason = "whole programs run on the wall's time")]
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod dronekit;
mod flood;
mod manual;
mod mavproxy;
mod mavsdk;
mod pymavlink;
mod routers;
