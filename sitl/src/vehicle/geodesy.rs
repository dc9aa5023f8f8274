//! Where on Earth the paper's square lies, and how a vehicle that accelerates is tilted.
//!
//! The origin of the local NED frame, the paper's (0, 0), is on the ground. Unless `--home` says otherwise it
//! is the same in every scenario: latitude 47.397742°, longitude 8.545594°, 488 m above sea level (a park in
//! Zürich, where PX4's simulators start too). North and east metres become degrees on a sphere with
//! the equator's radius, as autopilots do; over 500 m that is right to millimetres.

use crate::units::earth::EARTH_M;

/// The origin by default: latitude and longitude in degrees, height above sea level in metres.
pub const HOME: [f64; 3] = [47.397_742, 8.545_594, 488.0];

const GRAVITY: f64 = 9.806_65;
/// Nearer to a pole a degree of longitude is no length.
const MAX_LATITUDE: f64 = 85.0;
/// Deserts and mountains have room; m above the sea.
const HEIGHTS_M: std::ops::RangeInclusive<f64> = -1000.0..=20_000.0;

/// Where the origin of the local frame is on Earth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    latitude: f64,
    longitude: f64,
    /// Of the ground above the sea, m.
    pub altitude_m: f64,
}

impl Default for Site {
    fn default() -> Self {
        let [latitude, longitude, altitude_m] = HOME;
        Self { latitude, longitude, altitude_m }
    }
}

impl Site {
    /// The site at which the point `ne`, north and east of the origin in metres, is `home`.
    #[must_use]
    pub fn with_home(home: &Home, [north, east]: [f32; 2]) -> Self {
        let latitude = home.latitude - (f64::from(north) / EARTH_M).to_degrees();
        let around = EARTH_M * latitude.to_radians().cos();
        let longitude = home.longitude - (f64::from(east) / around).to_degrees();
        Self { latitude, longitude, altitude_m: home.altitude_m }
    }

    /// Latitude and longitude of a point this far north and east of the origin, in 1e-7 degrees.
    #[must_use]
    pub fn latitude_longitude(&self, [north, east]: [f32; 2]) -> [i32; 2] {
        let latitude = self.latitude + (f64::from(north) / EARTH_M).to_degrees();
        let around = EARTH_M * self.latitude.to_radians().cos();
        let longitude = round_the_world(self.longitude + (f64::from(east) / around).to_degrees());
        [latitude, longitude].map(|degrees| (degrees * 1e7).round() as i32)
    }

    /// North and east of the origin, metres, of a latitude and a longitude in degrees.
    #[must_use]
    pub fn north_east(&self, [latitude, longitude]: [f64; 2]) -> [f32; 2] {
        let north = (latitude - self.latitude).to_radians() * EARTH_M;
        let way = round_the_world(longitude - self.longitude);
        let east = way.to_radians() * EARTH_M * self.latitude.to_radians().cos();
        [north as f32, east as f32]
    }
}

/// A longitude, or a difference of two, within half a turn.
fn round_the_world(degrees: f64) -> f64 {
    if degrees.abs() <= 180.0 { degrees } else { (degrees + 180.0).rem_euclid(360.0) - 180.0 }
}

/// Where a vehicle starts and where it looks, as a flag: `LAT,LON,ALT,HEADING`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Home {
    /// Degrees.
    pub latitude: f64,
    /// Degrees.
    pub longitude: f64,
    /// Of the ground above the sea, m.
    pub altitude_m: f64,
    /// Degrees, clockwise from north.
    pub heading: f64,
}

/// Why a text is no [`Home`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum HomeError {
    /// Not four numbers.
    #[error("must be LAT,LON,ALT,HEADING: degrees, degrees, m above the sea, degrees")]
    Form,
    /// A number beyond its range.
    #[error("{0}")]
    Range(&'static str),
}

impl std::str::FromStr for Home {
    type Err = HomeError;

    fn from_str(text: &str) -> Result<Self, HomeError> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
        let Ok([latitude, longitude, altitude_m, heading]) = numbers.as_deref().map_err(|_| HomeError::Form)
        else {
            return Err(HomeError::Form);
        };
        let home = Self {
            latitude: *latitude,
            longitude: *longitude,
            altitude_m: *altitude_m,
            heading: heading.rem_euclid(360.0),
        };
        let must = |good: bool, why| if good { Ok(()) } else { Err(HomeError::Range(why)) };
        must(home.latitude.abs() <= MAX_LATITUDE, "its latitude must lie in [-85, 85]")?;
        must(home.longitude.abs() <= 180.0, "its longitude must lie in [-180, 180]")?;
        must(HEIGHTS_M.contains(&home.altitude_m), "its height must lie in [-1000, 20000]")?;
        must(home.heading.is_finite(), "its heading must be finite")?;
        Ok(home)
    }
}

/// Latitude and longitude of a point this far north and east of [`HOME`], in 1e-7 degrees.
#[must_use]
pub fn latitude_longitude(ne: [f32; 2]) -> [i32; 2] {
    Site::default().latitude_longitude(ne)
}

/// Roll and pitch, radians, at which the thrust of a level, north-looking multirotor accelerates it
/// north and east by this much, m/s²: a_n = -g tan θ, a_e = g tan φ / cos θ.
pub fn tilt([north, east]: [f32; 2]) -> [f32; 2] {
    let pitch = -(f64::from(north) / GRAVITY).atan();
    let roll = (f64::from(east) * pitch.cos() / GRAVITY).atan();
    [roll as f32, pitch as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_thrust_of_a_tilted_vehicle_is_its_acceleration() {
        for wish in [[0.0, 0.0], [5.0, 0.0], [0.0, -5.0], [10.9, 10.9], [-3.0, 7.0]] {
            let [roll, pitch] = tilt(wish).map(f64::from);
            // Third column of Ry(pitch) Rx(roll): the body's down axis in NED.
            let down = [roll.cos() * pitch.sin(), -roll.sin(), roll.cos() * pitch.cos()];
            let thrust = GRAVITY / down[2];
            for axis in 0..2 {
                assert!((-thrust * down[axis] - f64::from(wish[axis])).abs() < 1e-5, "{wish:?}");
            }
        }
        assert!(tilt([1.0, 0.0])[1] < 0.0, "nose down to fly north");
        assert!(tilt([0.0, 1.0])[0] > 0.0, "right side down to fly east");
    }

    #[test]
    fn degrees_there_and_back_are_within_two_centimetres() {
        for place in [[0.0, 0.0], [500.0, 1.0], [250.5, 450.25]] {
            let degrees = latitude_longitude(place).map(|degrees| f64::from(degrees) / 1e7);
            let back = Site::default().north_east(degrees);
            assert!((0..2).all(|axis| (back[axis] - place[axis]).abs() < 0.02), "{place:?} {back:?}");
        }
    }

    #[test]
    fn a_kilometre_is_a_kilometre() {
        let [home, north] = [[0.0, 0.0], [1000.0, 0.0]].map(latitude_longitude);
        assert_eq!(home, [473_977_420, 85_455_940]);
        assert!((f64::from(north[0] - home[0]) / 1e7 - 0.008_983).abs() < 1e-6);
        assert_eq!(north[1], home[1]);
        let east = latitude_longitude([0.0, 1000.0]);
        assert!((f64::from(east[1] - home[1]) / 1e7 - 0.013_271).abs() < 1e-5, "{}", east[1] - home[1]);
    }

    #[test]
    fn a_home_is_where_the_vehicle_starts_on_either_side_of_the_date_line() {
        for text in ["-35.363261,149.165230,584,353", "0, 179.9999, 0, 0", "52.1,-180,-4,720"] {
            let home: Home = text.parse().unwrap();
            let site = Site::with_home(&home, [250.0, 50.0]);
            let [latitude, longitude] = site.latitude_longitude([250.0, 50.0]);
            assert!((f64::from(latitude) / 1e7 - home.latitude).abs() < 1e-6, "{text}");
            let off = round_the_world(f64::from(longitude) / 1e7 - home.longitude);
            assert!(off.abs() < 1e-6, "{text}: {off}");
            let far = site.latitude_longitude([250.0, 900.0]).map(|degrees| f64::from(degrees) / 1e7);
            let [north, east] = site.north_east(far);
            assert!((north - 250.0).hypot(east - 900.0) < 0.02, "{text}: {north} {east}");
            assert_eq!(home.heading, if text.contains("353") { 353.0 } else { 0.0 });
        }
        for bad in ["", "1,2,3", "1,2,3,4,5", "a,2,3,4", "nan,2,3,4", "86,0,0,0", "0,181,0,0", "0,0,1e9,0"] {
            assert!(bad.parse::<Home>().is_err(), "{bad}");
        }
        assert!("0,0,0,inf".parse::<Home>().is_err());
    }
}
