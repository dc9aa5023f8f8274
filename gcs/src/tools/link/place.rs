//! Where the vehicle is, as it tells it itself or as a recording says. Knows messages, not radios.

use std::str::FromStr;
use std::time::Duration;

use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::telemetry::{GlobalPositionInt, LocalPositionNed};
use crpl_sitl::link::packet::PacketRef;
use crpl_sitl::radio::air::track::GeometryTrack;
use crpl_sitl::units::earth;

/// Where the station stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Base {
    /// North, east, down in the vehicle's local frame, m.
    Local([f64; 3]),
    /// Latitude and longitude in degrees, height above sea level in m. Places then count from the station.
    Earth([f64; 3]),
}

impl FromStr for Base {
    type Err = &'static str;

    /// `N,E,D` or `geo:LAT,LON,ALT`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (numbers, earth) = text.strip_prefix("geo:").map_or((text, false), |rest| (rest, true));
        let parts: Vec<f64> = numbers
            .split(',')
            .map_while(|part| part.trim().parse().ok())
            .filter(|number: &f64| number.is_finite())
            .collect();
        let &[x, y, z] = &parts[..] else { return Err("must be N,E,D in metres or geo:LAT,LON,ALT") };
        match earth {
            true if x.abs() > 90.0 || y.abs() > 180.0 => Err("latitude or longitude is out of range"),
            true => Ok(Self::Earth([x, y, z])),
            false => Ok(Self::Local([x, y, z])),
        }
    }
}

impl Base {
    /// North, east and the height of the ground under the station, in the frame in which places count, m.
    #[must_use]
    pub fn place(self) -> [f64; 3] {
        match self {
            Self::Local([north, east, down]) => [north, east, -down],
            Self::Earth(_) => [0.0; 3],
        }
    }
}

/// Listens to what the vehicle tells of its place.
#[derive(Debug, Default)]
pub struct Whereabouts {
    base: Option<Base>,
    /// The system that is listened to: the first that tells a place, unless one was named.
    system: Option<u8>,
    /// Whether the track is a recording, which then counts in place of what is heard.
    replays: bool,
    /// Whether it has told its place in its own local frame, which then counts.
    local: bool,
    /// Where it was on Earth first, for one that tells no local frame: latitude and longitude, degrees.
    first: Option<[f64; 2]>,
    /// Where it was so far, from the place on at which it is taken to be until it has told one.
    track: GeometryTrack,
}

/// A place that is told counts from the next instant on, so that a recording of it gives the same to every frame.
const INSTANT: Duration = Duration::from_nanos(1);

impl Whereabouts {
    /// Of a system, or of the first that tells a place, seen from a base. Until it has told one it is at `start`: north,
    /// east, down, m.
    #[must_use]
    pub fn new(
        base: Option<Base>,
        system: Option<u8>,
        start: [f64; 3],
        replay: Option<GeometryTrack>,
    ) -> Self {
        let replays = replay.is_some();
        let mut track = replay.unwrap_or_default();
        if !replays {
            track.push(Duration::ZERO, start);
        }
        Self { base, system, replays, track, ..Self::default() }
    }

    /// A frame has come from the vehicle's side: its place in it, north, east and down in m, if there is one.
    pub fn hear(&mut self, frame: &PacketRef<'_>, now: Duration) -> Option<[f64; 3]> {
        if self.replays || self.system.is_some_and(|system| system != frame.system) {
            return None;
        }
        let place = self.told(frame).filter(|place| place.iter().all(|metres| metres.is_finite()))?;
        self.system.get_or_insert(frame.system);
        self.track.push(now + INSTANT, place);
        Some(place)
    }

    fn told(&mut self, frame: &PacketRef<'_>) -> Option<[f64; 3]> {
        if let Some(Base::Earth([latitude, longitude, height])) = self.base {
            let told = GlobalPositionInt::of(*frame)?;
            let [north, east] = earth::north_east([latitude, longitude], degrees(&told));
            return Some([north, east, height - metres(told.heights[0])]);
        }
        if let Some(told) = LocalPositionNed::of(*frame) {
            self.local = true;
            return Some(told.position.map(f64::from));
        }
        let told = GlobalPositionInt::of(*frame).filter(|_| !self.local)?;
        let first = *self.first.get_or_insert(degrees(&told));
        let [north, east] = earth::north_east(first, degrees(&told));
        Some([north, east, -metres(told.heights[1])])
    }

    /// Where it is and was.
    #[must_use]
    pub fn track(&self) -> &GeometryTrack {
        &self.track
    }
}

fn degrees(told: &GlobalPositionInt) -> [f64; 2] {
    told.place.map(|e7| f64::from(e7) / 1e7)
}

fn metres(millimetres: i32) -> f64 {
    f64::from(millimetres) / 1e3
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::decoder::Decoder;
    use crpl_sitl::link::encoder::Encoder;

    use super::*;

    fn hear(whereabouts: &mut Whereabouts, system: u8, message: &impl View) -> Option<[f64; 3]> {
        let mut bytes = Vec::new();
        Encoder::new(system, 1).push_view(&mut bytes, message);
        let packet = Decoder::default().datagram(&bytes).remove(0);
        whereabouts.hear(&(&packet).into(), Duration::ZERO)
    }

    fn local(x: f32) -> LocalPositionNed {
        LocalPositionNed { time_boot_ms: 0, position: [x, 2.0, -3.0], velocity: [0.0; 3] }
    }

    fn global(latitude: i32) -> GlobalPositionInt {
        let (place, heights) = ([latitude, 80_000_000], [530_000, 30_000]);
        GlobalPositionInt { time_boot_ms: 0, place, heights, velocity: [0; 3], heading: 0 }
    }

    #[test]
    fn the_local_frame_counts_once_it_is_told() {
        let mut whereabouts = Whereabouts::new(None, None, [9.0; 3], None);
        assert_eq!(hear(&mut whereabouts, 1, &global(470_000_000)), Some([0.0, 0.0, -30.0]));
        let [north, ..] = hear(&mut whereabouts, 1, &global(470_010_000)).unwrap();
        assert!((north - 111.3).abs() < 0.1, "{north}");
        assert_eq!(hear(&mut whereabouts, 1, &local(5.0)), Some([5.0, 2.0, -3.0]));
        assert_eq!(hear(&mut whereabouts, 1, &global(470_020_000)), None);
        assert_eq!(hear(&mut whereabouts, 2, &local(6.0)), None, "another system");
        assert_eq!(hear(&mut whereabouts, 1, &local(f32::NAN)), None);
        assert_eq!(whereabouts.track().at(Duration::ZERO), Some([9.0; 3]), "not yet");
        assert_eq!(whereabouts.track().at(INSTANT), Some([5.0, 2.0, -3.0]));
    }

    #[test]
    fn a_base_on_earth_is_where_places_count_from() {
        let mut whereabouts =
            Whereabouts::new(Some("geo:47.0,8.0,500".parse().unwrap()), None, [9.0; 3], None);
        assert_eq!(hear(&mut whereabouts, 1, &local(5.0)), None);
        let [north, east, down] = hear(&mut whereabouts, 1, &global(470_010_000)).unwrap();
        assert!((north - 111.3).abs() < 0.1 && east.abs() < 1e-6 && (down + 30.0).abs() < 1e-9);
    }

    #[test]
    fn a_recording_counts_in_place_of_what_is_heard() {
        let track = GeometryTrack::parse("time,x,y,z\n0,1,2,3\n").unwrap();
        let mut whereabouts = Whereabouts::new(None, None, [9.0; 3], Some(track.clone()));
        assert_eq!(hear(&mut whereabouts, 1, &local(5.0)), None);
        assert_eq!(whereabouts.track(), &track);
    }

    #[test]
    fn bases_are_told_by_metres_or_degrees() {
        assert_eq!("25, 250,-2".parse(), Ok(Base::Local([25.0, 250.0, -2.0])));
        assert_eq!(Base::Local([1.0, 2.0, -3.0]).place(), [1.0, 2.0, 3.0]);
        for (text, told) in
            [("1,2", "must be"), ("1,2,x", "must be"), ("geo:91,0,0", "range"), ("inf,0,0", "must be")]
        {
            assert!(text.parse::<Base>().unwrap_err().contains(told), "{text}");
        }
    }
}
