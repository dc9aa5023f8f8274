//! A radio link for a page: the vehicle where the tools hear it, the station, and what was carried.

use std::time::Duration;

use serde_json::Value;

use super::carrier::Carrier;
use crate::tools::spotter::Spotter;
use crate::watch::feed::Feed;

/// After this time the vehicle has told both its frames, if it tells both.
const BOTH_FRAMES: Duration = Duration::from_secs(2);

/// Tells a feed of a link.
#[derive(Debug)]
pub struct LinkShow {
    feed: Feed,
    spotter: Spotter,
    /// North and east of the station in the radio's frame, m.
    station: [f64; 2],
    /// Whether the station is on the map.
    stands: bool,
}

impl LinkShow {
    /// Of a link to a station so far north and east, m; buildings of the map, as GeoJSON.
    #[must_use]
    pub fn new(feed: &Feed, station: [f64; 2], buildings: Option<Value>) -> Self {
        let spotter = Spotter::new(feed.clone(), "gcs link", false, buildings);
        Self { feed: feed.clone(), spotter, station, stands: false }
    }

    /// A datagram of the vehicle's side has come through.
    pub fn arrived(&mut self, datagram: &[u8], now: Duration) {
        self.spotter.datagram(datagram, now);
    }

    /// Tells what was carried, and once where the station stands.
    pub fn count(&mut self, carrier: &Carrier) {
        let now = carrier.now();
        self.spotter.counters(&carrier.summary().by_name(), now);
        if self.stands || now < BOTH_FRAMES {
            return;
        }
        // The same vehicle at the same time, seen from the map's origin and in the radio's frame.
        let (Some([x, y]), Some([north, east, _])) =
            (self.spotter.place(), carrier.whereabouts().track().at(now))
        else {
            return;
        };
        self.spotter.stand([x + self.station[1] - east, y + self.station[0] - north]);
        self.stands = true;
    }

    /// A line for people.
    pub fn log(&self, line: &str, now: Duration) {
        self.feed.log("info", now.as_secs_f64(), line);
    }
}
