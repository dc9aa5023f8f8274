//! Degrees and metres on a sphere with the equator's radius, as autopilots reckon.

/// Radius, m.
pub const EARTH_M: f64 = 6_378_137.0;

/// How far north and east of `origin` a place is, m; both are latitude and longitude in degrees.
#[must_use]
pub fn north_east(origin: [f64; 2], [latitude, longitude]: [f64; 2]) -> [f64; 2] {
    let north = (latitude - origin[0]).to_radians() * EARTH_M;
    let east = (longitude - origin[1]).to_radians() * EARTH_M * origin[0].to_radians().cos();
    [north, east]
}
