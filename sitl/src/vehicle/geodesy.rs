//! Where on Earth the paper's square lies, and how a vehicle that accelerates is tilted.
//!
//! Home is the origin of the local NED frame, the paper's (0, 0), on the ground. It is the same in
//! every scenario: latitude 47.397742°, longitude 8.545594°, 488 m above sea level (a park in
//! Zürich, where PX4's simulators start too). North and east metres become degrees on a sphere with
//! the equator's radius, as autopilots do; over 500 m that is right to millimetres.

use crate::units::earth::{self, EARTH_M};

/// Home: latitude and longitude in degrees, height above sea level in metres.
pub const HOME: [f64; 3] = [47.397_742, 8.545_594, 488.0];

const GRAVITY: f64 = 9.806_65;

/// Latitude and longitude of a point this far north and east of home, in 1e-7 degrees.
pub fn latitude_longitude([north, east]: [f32; 2]) -> [i32; 2] {
    let latitude = HOME[0] + (f64::from(north) / EARTH_M).to_degrees();
    let around = EARTH_M * HOME[0].to_radians().cos();
    let longitude = HOME[1] + (f64::from(east) / around).to_degrees();
    [latitude, longitude].map(|degrees| (degrees * 1e7).round() as i32)
}

/// North and east of home, metres, of a latitude and a longitude in degrees.
pub fn north_east(place: [f64; 2]) -> [f32; 2] {
    earth::north_east([HOME[0], HOME[1]], place).map(|metres| metres as f32)
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
            let back = north_east(degrees);
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
}
