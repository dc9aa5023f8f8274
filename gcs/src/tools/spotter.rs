//! Vehicles of any kind for a page, by what they say on the link: where they are, what they tell, and what the link
//! has carried. No socket, no clock.

use std::collections::BTreeMap;
use std::time::Duration;

use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::dialect::{GLOBAL_POSITION_INT_DATA, MavMessage};
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::status::Heartbeat;
use crpl_sitl::link::messages::telemetry::NamedValueFloat;
use crpl_sitl::link::packet::Packet;
use crpl_sitl::vehicle::geodesy::{Home, Site};
use serde_json::{Value, json};

use crate::tools::fleet::{Fleet, Stack};
use crate::tools::texts::Texts;
use crate::watch::feed::{Feed, ShownFrame, ShownVehicle, VERSION, WatchEvent, rounded};

/// Seconds of an interval on the page.
const INTERVAL_S: f64 = 0.5;
/// MAV_AUTOPILOT_INVALID: stations, radios, cameras.
const NO_AUTOPILOT: u8 = 8;

/// Where a vehicle was told to be, m east and north of the first place that was told, and in m/s.
#[derive(Debug, Clone, Copy)]
struct Spot {
    place: [f64; 2],
    velocity: [f64; 2],
    tick: u64,
}

/// Tells a feed of vehicles.
#[derive(Debug)]
pub struct Spotter {
    feed: Feed,
    program: String,
    control: bool,
    decoder: Decoder,
    fleet: Fleet,
    texts: Texts,
    site: Option<Site>,
    buildings: Option<Value>,
    /// Where the station stands: m east and north of the origin.
    base: Option<[f64; 2]>,
    spots: BTreeMap<u8, Option<Spot>>,
    radios: BTreeMap<u8, SpottedRadio>,
}

/// What a vehicle's radio tells: `SNR_DB`, `TXP`, `OUTAGE`.
#[derive(Debug, Clone, Copy, Default)]
struct SpottedRadio {
    snr_db: Option<f32>,
    power: Option<f32>,
    outage: Option<f32>,
}

impl Spotter {
    /// Of a program; whether its page may steer; buildings of the map, as GeoJSON.
    #[must_use]
    pub fn new(feed: Feed, program: &str, control: bool, buildings: Option<Value>) -> Self {
        let spotter = Self {
            feed,
            program: program.into(),
            control,
            decoder: Decoder::default(),
            fleet: Fleet::default(),
            texts: Texts::default(),
            site: None,
            buildings,
            base: None,
            spots: BTreeMap::new(),
            radios: BTreeMap::new(),
        };
        spotter.hello();
        spotter
    }

    fn hello(&self) {
        let vehicle = |system: &u8| ShownVehicle {
            id: u32::from(*system),
            name: format!("vehicle {system}"),
            controller: None,
        };
        self.feed.send(&WatchEvent::Hello {
            version: VERSION,
            title: self.program.clone(),
            program: self.program.clone(),
            revision: crate::revision().into(),
            seed: None,
            frame: ShownFrame::Local,
            scenario: self.base.map(|base| json!({ "channel": { "base_station": base } })),
            vehicles: self.spots.keys().map(vehicle).collect(),
            limits: None,
            ticks: None,
            dt_s: INTERVAL_S,
            control: self.control,
        });
    }

    /// The place of the only vehicle or of the first, m east and north of the origin.
    #[must_use]
    pub fn place(&self) -> Option<[f64; 2]> {
        self.spots.values().flatten().next().map(|spot| spot.place)
    }

    /// Shows the station, m east and north of the origin.
    pub fn stand(&mut self, base: [f64; 2]) {
        self.base = Some(base.map(|metres| rounded(metres, 1)));
        self.hello();
    }

    /// The flight stack of a vehicle and its autopilot's component, if it was heard.
    #[must_use]
    pub fn autopilot(&self, system: u8) -> Option<(Stack, u8)> {
        self.fleet.get(system).map(|vehicle| (vehicle.mode.stack, vehicle.autopilot))
    }

    /// A datagram has come at `now` of the program's time.
    pub fn datagram(&mut self, bytes: &[u8], now: Duration) {
        for packet in self.decoder.datagram(bytes) {
            self.packet(&packet, now);
        }
    }

    fn packet(&mut self, packet: &Packet, now: Duration) {
        let time_s = rounded(now.as_secs_f64(), 3);
        if Heartbeat::of(packet).is_some_and(|beat| beat.autopilot != NO_AUTOPILOT)
            && !self.spots.contains_key(&packet.system)
        {
            self.spots.insert(packet.system, None);
            self.hello();
        }
        for news in self.fleet.packet(packet, now) {
            self.feed.log("info", time_s, news.to_string());
        }
        for said in self.texts.packet(packet) {
            let level = if said.is_warning() { "warn" } else { "info" };
            self.feed.log(level, time_s, format!("vehicle {}: {}", said.system, said.text));
        }
        if let Some(told) = NamedValueFloat::of(packet).filter(|told| told.value.is_finite()) {
            let radio = self.radios.entry(packet.system).or_default();
            match &*told.name.lossy() {
                "SNR_DB" => radio.snr_db = Some(told.value),
                "TXP" => radio.power = Some(told.value),
                "OUTAGE" => radio.outage = Some(told.value),
                _ => {}
            }
        }
        if packet.is::<GLOBAL_POSITION_INT_DATA>()
            && let Some(MavMessage::GLOBAL_POSITION_INT(message)) = packet.message()
        {
            self.spotted(packet.system, &message, now);
        }
    }

    /// What a vehicle's own radio tells, else a radio between it and us, which has a system id of its own.
    fn radio(&self, system: u8) -> SpottedRadio {
        let between = || self.radios.iter().find(|(sender, _)| !self.spots.contains_key(sender));
        let own = self.radios.get(&system).or_else(|| between().map(|(_, radio)| radio));
        own.copied().unwrap_or_default()
    }

    /// Twice a second at most a place becomes a line.
    fn spotted(&mut self, system: u8, told: &GLOBAL_POSITION_INT_DATA, now: Duration) {
        let tick = (now.as_secs_f64() / INTERVAL_S) as u64;
        let Some(last) = self.spots.get(&system).copied() else { return };
        if (told.lat, told.lon) == (0, 0) || last.is_some_and(|last| last.tick >= tick) {
            return;
        }
        let degrees = [told.lat, told.lon].map(|angle| f64::from(angle) * 1e-7);
        let site = match self.site {
            Some(site) => site,
            None => {
                let [latitude, longitude] = degrees;
                let home = Home { latitude, longitude, altitude_m: 0.0, heading: 0.0 };
                let buildings = self.buildings.take();
                self.feed.send(&WatchEvent::Geo { origin: degrees, heading: 0.0, buildings });
                *self.site.insert(Site::with_home(&home, [0.0; 2]))
            }
        };
        let [north, east] = site.north_east(degrees).map(f64::from);
        let place = [rounded(east, 2), rounded(north, 2)];
        let velocity = [told.vy, told.vx].map(|cm| f64::from(cm) / 100.0);
        let before = last.unwrap_or(Spot { place, velocity, tick });
        let radio = self.radio(system);
        self.feed.send(&WatchEvent::Tick(json!({
            "snr_db": radio.snr_db,
            "power": radio.power,
            "outage": radio.outage.is_some_and(|outage| outage != 0.0),
            "vehicle": system,
            "tick": tick,
            "r": before.place,
            "v": before.velocity,
            "r_next": place,
            "v_next": velocity,
            "altitude_m": rounded(f64::from(told.relative_alt) / 1e3, 2),
        })));
        self.spots.insert(system, Some(Spot { place, velocity, tick }));
    }

    /// What the links have carried by now, by name; and who has fallen silent.
    pub fn counters(&mut self, counters: &Value, now: Duration) {
        let time_s = rounded(now.as_secs_f64(), 3);
        for news in self.fleet.poll(now) {
            self.feed.log("warn", time_s, news.to_string());
        }
        let tick = (now.as_secs_f64() / INTERVAL_S) as u64;
        for system in self.spots.keys() {
            let (vehicle, counters) = (u32::from(*system), counters.clone());
            self.feed.send(&WatchEvent::Link { vehicle, tick, counters });
        }
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::dialect::{HEARTBEAT_DATA, MavAutopilot};
    use crpl_sitl::link::encoder::Encoder;

    use super::*;

    #[test]
    fn a_vehicle_appears_and_its_places_are_metres_from_the_first() {
        let feed = Feed::default();
        let mut spotter = Spotter::new(feed.clone(), "gcs bridge", false, None);
        let (mut vehicle, mut datagram) = (Encoder::new(3, 1), Vec::new());
        let autopilot = MavAutopilot::MAV_AUTOPILOT_PX4;
        vehicle.push(&mut datagram, &HEARTBEAT_DATA { autopilot, ..Default::default() });
        for (second, lat) in [(0, 473_977_420), (1, 473_977_420 + 898), (1, 0)] {
            let place = GLOBAL_POSITION_INT_DATA { lat, lon: 85_455_940, ..Default::default() };
            vehicle.push(&mut datagram, &place);
            spotter.datagram(&datagram, Duration::from_secs(second));
            datagram.clear();
        }
        spotter.counters(&json!({ "frames": 3 }), Duration::from_secs(2));
        let lines: Vec<Value> =
            feed.all().iter().map(|line| serde_json::from_str(&line.text).unwrap()).collect();
        let of = |kind: &str| lines.iter().filter(|line| line["kind"] == kind).cloned().collect::<Vec<_>>();
        let hellos = of("hello");
        assert_eq!(hellos.last().unwrap()["vehicles"][0]["id"], 3);
        let ticks = of("tick");
        assert_eq!(ticks.len(), 2, "{ticks:?}");
        let north = ticks[1]["r_next"][1].as_f64().unwrap();
        assert!((north - 10.0).abs() < 0.1 && ticks[1]["r_next"][0] == 0.0, "{ticks:?}");
        assert_eq!(of("link")[0]["counters"]["frames"], 3);
        assert_eq!(of("geo").len(), 1);
        assert_eq!(spotter.autopilot(3), Some((Stack::Px4, 1)));
    }
}
