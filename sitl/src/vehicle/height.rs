//! Up and down of a vehicle that the paper flies at one height: landing, take-off, heights of missions and
//! setpoints, and the fall of one whose motors were cut. Knows height and speed of climb, not why it goes up or
//! down.
//!
//! Heights count from the ground at home, in metres, up. No formula of the paper reads them, so the
//! plane's physics goes on beside them.

/// Standard gravity, m/s².
const GRAVITY: f64 = 9.806_65;
/// The lowest height to which it flies but to land, m.
const FLOOR_M: f64 = 0.5;
/// The greatest height, m.
const CEILING_M: f64 = 100_000.0;

/// Where the vehicle is on its vertical.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Height {
    /// Above the ground, m.
    pub altitude_m: f64,
    /// In the interval that just ended, m/s, up.
    pub climb_mps: f64,
}

/// What the motors do about the height in an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Lift {
    /// The height stays.
    Hover,
    /// To that height, m, at that speed, m/s.
    Towards(f64, f64),
    /// Nothing: they are off.
    None,
}

impl Lift {
    /// To a height, as near as it may be flown, at `speed` m/s.
    pub fn to(height_m: f64, speed: f64) -> Self {
        Self::Towards(nearest(height_m), speed)
    }

    /// Up, or down if it is below 0, at `climb_mps`, within `most`.
    pub fn at(climb_mps: f64, most: f64) -> Self {
        let speed = climb_mps.abs().min(most);
        if speed == 0.0 { Self::Hover } else { Self::to(climb_mps * f64::INFINITY, speed) }
    }
}

/// The height nearest to this one at which it flies, m.
pub(super) fn nearest(height_m: f64) -> f64 {
    height_m.clamp(FLOOR_M, CEILING_M)
}

/// Whether a height above home, m, is one that can be flown.
pub(super) fn is_flyable(height_m: f64) -> bool {
    (-1e-3..=CEILING_M).contains(&height_m)
}

impl Height {
    /// In the air, at rest.
    pub fn hovering(altitude_m: f64) -> Self {
        Self { altitude_m, climb_mps: 0.0 }
    }

    /// z and vz of the local frame: down, m and m/s.
    pub fn ned(&self) -> [f32; 2] {
        [-self.altitude_m as f32, -self.climb_mps as f32]
    }

    /// Whether it stands on the ground.
    pub fn on_ground(&self) -> bool {
        self.altitude_m <= 0.0
    }

    /// An interval of so many seconds passes. Gives the speed of a touch-down in it, m/s.
    pub fn step(&mut self, lift: Lift, seconds: f64) -> Option<f64> {
        if self.on_ground() && matches!(lift, Lift::None | Lift::Hover) {
            self.climb_mps = 0.0;
            return None;
        }
        let before = self.altitude_m;
        match lift {
            Lift::Hover => self.climb_mps = 0.0,
            Lift::Towards(goal, speed) => {
                let most = speed * seconds;
                self.altitude_m += (goal - before).clamp(-most, most);
                self.climb_mps = (self.altitude_m - before) / seconds;
            }
            Lift::None => {
                self.climb_mps -= GRAVITY * seconds;
                self.altitude_m += self.climb_mps * seconds;
            }
        }
        let speed = -self.climb_mps;
        (before > 0.0 && self.on_ground()).then(|| {
            *self = Self { altitude_m: 0.0, climb_mps: 0.0 };
            speed
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn until_down(lift: Lift) -> (usize, f64) {
        let mut height = Height::hovering(100.0);
        (1..).find_map(|k| height.step(lift, 0.4).map(|speed| (k, speed))).unwrap()
    }

    #[test]
    fn a_landing_is_as_long_as_its_speed_says_and_a_fall_as_gravity_says() {
        assert_eq!(until_down(Lift::Towards(0.0, 5.0)).0, 50);
        let (intervals, speed) = until_down(Lift::None);
        assert_eq!(intervals, 11, "4.5 s from 100 m");
        assert!((speed - (2.0 * GRAVITY * 100.0).sqrt()).abs() < 2.0, "{speed}");
    }

    #[test]
    fn on_the_ground_it_stays_until_it_climbs_and_no_higher_than_asked() {
        let mut height = Height::hovering(0.0);
        assert_eq!((height.step(Lift::None, 0.4), height.step(Lift::Hover, 0.4)), (None, None));
        for _ in 0..60 {
            assert_eq!(height.step(Lift::Towards(100.0, 5.0), 0.4), None);
        }
        assert_eq!(height, Height::hovering(100.0));
    }
}
