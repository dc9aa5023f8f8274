//! Quantities that are easily mixed up, and the scale between the paper's square and NED metres.

mod action;
pub mod earth;
pub mod noise;
mod per_obstacle;

pub use action::{Motion, NoSuchPower, TxPower};
pub use per_obstacle::{MAX_OBSTACLES, Obstacles, PerObstacle};

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// Number of a control interval, from 0. The state at tick k is the state before interval k.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Tick(pub u64);

impl Tick {
    /// The tick after this one.
    #[must_use]
    pub fn next(self) -> Self {
        Self(self.0 + 1)
    }

    /// Milliseconds since tick 0, as MAVLink's `time_boot_ms` (wraps after 49.7 days).
    #[must_use]
    pub fn to_boot_ms(self, interval_s: f64) -> u32 {
        ((self.0 as f64 * interval_s * 1e3).round() as u64 & u64::from(u32::MAX)) as u32
    }

    /// The tick whose [`Tick::to_boot_ms`] this is, or `None` if it is no tick's.
    #[must_use]
    pub fn from_boot_ms(ms: u32, interval_s: f64) -> Option<Self> {
        let tick = Self((f64::from(ms) / (interval_s * 1e3)).round() as u64);
        (tick.to_boot_ms(interval_s) == ms).then_some(tick)
    }
}

/// Signal-to-noise ratio γ, linear.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Snr(pub f64);

impl Snr {
    /// 10 log10 γ.
    #[must_use]
    pub fn to_db(self) -> f64 {
        10.0 * self.0.log10()
    }

    /// γ from decibels.
    #[must_use]
    pub fn from_db(db: f64) -> Self {
        Self(10f64.powf(db / 10.0))
    }
}

/// The scale between the paper's unit square (x right, y up) and NED metres: north = y, east = x.
///
/// The paper's units are 1 length unit and 1 control interval; speeds are units per interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scale {
    /// Metres per unit of length (our choice; docs/choices.md).
    pub metres_per_unit: f64,
    /// Length of a control interval Δt, seconds (our choice).
    pub interval_s: f64,
    /// Height at which the planar vehicle flies, metres (our choice; no formula reads it).
    pub altitude_m: f64,
}

impl Default for Scale {
    fn default() -> Self {
        Self { metres_per_unit: 500.0, interval_s: 0.4, altitude_m: 100.0 }
    }
}

impl Scale {
    /// Paper position to north, east, in metres as they cross the link.
    #[must_use]
    pub fn ned_from_paper(&self, r: Vector2<f64>) -> [f32; 2] {
        [(r.y * self.metres_per_unit) as f32, (r.x * self.metres_per_unit) as f32]
    }

    /// North, east in metres to paper position.
    #[must_use]
    pub fn paper_from_ned(&self, ne: [f32; 2]) -> Vector2<f64> {
        Vector2::new(f64::from(ne[1]), f64::from(ne[0])) / self.metres_per_unit
    }

    /// Paper speed (units per interval) to north, east, m/s.
    #[must_use]
    pub fn ned_from_paper_velocity(&self, v: Vector2<f64>) -> [f32; 2] {
        let mps = self.mps_per_speed();
        [(v.y * mps) as f32, (v.x * mps) as f32]
    }

    /// North, east in m/s to paper speed (units per interval).
    #[must_use]
    pub fn paper_from_ned_velocity(&self, ne: [f32; 2]) -> Vector2<f64> {
        Vector2::new(f64::from(ne[1]), f64::from(ne[0])) / self.mps_per_speed()
    }

    /// Paper acceleration (units per interval²) to north, east, m/s².
    #[must_use]
    pub fn ned_from_paper_acceleration(&self, a: Vector2<f64>) -> [f32; 2] {
        let scale = self.mps_per_speed() / self.interval_s;
        [(a.y * scale) as f32, (a.x * scale) as f32]
    }

    /// North, east in m/s² to paper acceleration (units per interval²).
    #[must_use]
    pub fn paper_from_ned_acceleration(&self, ne: [f32; 2]) -> Vector2<f64> {
        Vector2::new(f64::from(ne[1]), f64::from(ne[0])) / (self.mps_per_speed() / self.interval_s)
    }

    /// Metres per second in one unit per interval.
    #[must_use]
    pub fn mps_per_speed(&self) -> f64 {
        self.metres_per_unit / self.interval_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boot_ms_names_its_tick_and_no_other() {
        for k in [0, 1, 99, 100, 12_345] {
            let ms = Tick(k).to_boot_ms(0.4);
            assert_eq!(Tick::from_boot_ms(ms, 0.4), Some(Tick(k)));
            assert_eq!(Tick::from_boot_ms(ms + 1, 0.4), None);
        }
    }

    #[test]
    fn north_is_y_and_east_is_x() {
        let scale = Scale::default();
        assert_eq!(scale.ned_from_paper(Vector2::new(0.1, 0.5)), [250.0, 50.0]);
        let back = scale.paper_from_ned([250.0, 50.0]);
        assert!((back - Vector2::new(0.1, 0.5)).norm() < 1e-9);
    }

    #[test]
    fn decibels_there_and_back() {
        assert!((Snr(2.0).to_db() - 3.010_299_956_639_812).abs() < 1e-12);
        assert!((Snr::from_db(Snr(0.37).to_db()).0 - 0.37).abs() < 1e-12);
    }
}
