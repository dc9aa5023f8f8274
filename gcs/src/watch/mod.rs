//! Flights to look at: what a station knows, told as lines of a page's feed, and `flight.html`.
//!
//! ```text
//! Station --copy after each command--> FlightWatcher --> Narrator --> Feed --> server --> page
//!                                                                       \--> flight.html
//! ```
//!
//! An observer: no flight waits for it, and none changes by it. Knows the station; neither links nor run folders.
//! The page, its feed and its server are those of all programs ([`crpl_sitl::program::page`]). docs/watch.md lists
//! the lines.

pub mod map;
pub mod narrator;
pub mod watcher;

pub use crpl_sitl::program::page::{SteerFlags, WatchFlags, WatchPage, control, document, feed};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use crpl_sitl::camera::Frame;
use crpl_sitl::link::image::png_from_frame;
use crpl_sitl::units::Tick;
use serde_json::Value;

use crate::station::pilot::Controller;
use crate::watch::feed::{ShownVehicle, WatchEvent};

/// What a feed's first line says.
#[derive(Debug, Clone, Default)]
pub struct Shown {
    /// The command, such as `gcs fly`.
    pub program: String,
    /// Seed of the gusts, if it is known.
    pub seed: Option<u64>,
    /// Whether the page may steer.
    pub control: bool,
    /// Those who have flown, and who flies.
    pub vehicles: Vec<ShownVehicle>,
    /// Buildings of the map, as GeoJSON.
    pub buildings: Option<Value>,
}

impl Shown {
    /// One vehicle, flown by `controller`.
    #[must_use]
    pub fn one(program: &str, controller: Controller) -> Self {
        let mut shown = Self { program: program.into(), ..Self::default() };
        shown.add(controller);
        shown
    }

    /// One more vehicle, flown by `controller`.
    pub fn add(&mut self, controller: Controller) {
        let id = self.vehicles.len() as u32 + 1;
        let name = controller.to_string();
        self.vehicles.push(ShownVehicle { id, controller: Some(name.clone()), name });
    }
}

/// A frame as it was received; `None` if it has no PNG.
#[must_use]
pub fn picture(vehicle: u32, tick: u64, frame: &Frame) -> Option<WatchEvent> {
    let png = png_from_frame(frame, Tick(tick)).ok()?;
    Some(WatchEvent::Picture { vehicle, tick, png: STANDARD.encode(png) })
}
