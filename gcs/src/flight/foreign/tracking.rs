//! Accelerations that are flown as they were meant.
//!
//! CRPL plans for a body that keeps its speed unless it is pushed. An autopilot's vehicle has drag,
//! follows a push late and drifts in height. So what is asked for is the speed that the commands add up to, with
//! the acceleration fed forward: the autopilot closes both loops itself, on board and without the radio's delay.
//! A loop of speed and height over the link, of accelerations alone, is unstable from 0.15 s of delay on.

/// Largest difference between the speed that is asked for and the vehicle's, m/s: a vehicle at its limits does
/// not wind the reference up.
const SPEED_ERROR: f64 = 3.0;
/// Deceleration that is reckoned with before the square's edge, m/s².
const BRAKING: f64 = 1.75;
/// Height error to vertical speed, 1/s, and its limit, m/s.
const HEIGHT_GAIN: f64 = 0.8;
const HEIGHT_SPEED: f64 = 1.5;

/// Follows the speed that accelerations add up to. North, east.
#[derive(Debug, Clone, Copy)]
pub struct Tracker {
    reference: [f64; 2],
    v_max: f64,
}

/// What to ask for, north and east: m/s and m/s².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steering {
    /// Speed.
    pub velocity: [f64; 2],
    /// Acceleration.
    pub accel: [f64; 2],
}

impl Tracker {
    /// At rest; `v_max` in m/s limits the reference as the paper limits the speed.
    #[must_use]
    pub fn new(v_max: f64) -> Self {
        Self { reference: [0.0; 2], v_max }
    }

    /// The acceleration against the speed that is asked for, m/s²: none beyond its end within `dt` seconds.
    #[must_use]
    pub fn against(&self, dt: f64) -> [f64; 2] {
        let speed = self.reference[0].hypot(self.reference[1]);
        let deceleration = BRAKING.min(speed / dt.max(1e-3));
        self.reference.map(|v| if speed > 0.0 { -v * deceleration / speed } else { 0.0 })
    }

    /// `dt` seconds pass with the acceleration `wish`, at the speed `velocity`; what to ask for.
    /// `room` is how far it is to the edges on each axis, downwards and upwards, m: as the paper's walls
    /// do, they end the speed towards them.
    pub fn step(&mut self, mut wish: [f64; 2], velocity: [f64; 2], room: [[f64; 2]; 2], dt: f64) -> Steering {
        for axis in 0..2 {
            let reference = self.reference[axis] + wish[axis] * dt;
            self.reference[axis] =
                reference.clamp(velocity[axis] - SPEED_ERROR, velocity[axis] + SPEED_ERROR);
        }
        let speed = self.reference[0].hypot(self.reference[1]);
        if speed > self.v_max {
            self.reference = self.reference.map(|v| v * self.v_max / speed);
            wish = [0.0; 2];
        }
        for axis in 0..2 {
            let [down, up] = room[axis].map(|room| (2.0 * BRAKING * room.max(0.0)).sqrt());
            let allowed = self.reference[axis].clamp(-down, up);
            if allowed != self.reference[axis] {
                (self.reference[axis], wish[axis]) = (allowed, 0.0);
            }
        }
        Steering { velocity: self.reference, accel: wish }
    }
}

/// Vertical speed (down, m/s) that brings the height `z` (down, m) to `wanted`.
#[must_use]
pub fn hold_height(z: f64, wanted: f64) -> f64 {
    (HEIGHT_GAIN * (wanted - z)).clamp(-HEIGHT_SPEED, HEIGHT_SPEED)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.05;

    /// A vehicle whose own speed loop answers with this lag, s; its speed after pushes of 1 m/s² for 3 s and
    /// none for 3 s more.
    fn pushed(lag: f64) -> [f64; 2] {
        let (mut tracker, mut v) = (Tracker::new(10.0), 0.0);
        let mut at = [0.0; 2];
        for k in 0..120 {
            let wish = if k < 60 { 1.0 } else { 0.0 };
            let asked = tracker.step([wish, 0.0], [v, 0.0], [[1e3; 2]; 2], DT);
            v += (asked.velocity[0] - v) * DT / lag;
            at[usize::from(k >= 60)] = v;
        }
        at
    }

    #[test]
    fn a_push_gives_its_speed_however_late_the_vehicle_follows() {
        for lag in [0.1, 0.3, 1.0] {
            let [pushed, coasting] = pushed(lag);
            assert!((pushed - 3.0).abs() < lag + 0.1, "lag {lag}: {pushed}");
            assert!((coasting - 3.0).abs() < 0.2, "lag {lag}: {coasting}");
        }
    }

    #[test]
    fn an_edge_stops_what_flies_towards_it() {
        let (mut tracker, mut v, mut room) = (Tracker::new(2.0), 0.0, 20.0);
        for _ in 0..400 {
            let asked = tracker.step([1.0, 0.0], [v, 0.0], [[1e3, room], [1e3; 2]], DT);
            v += (asked.velocity[0] - v) * DT / 0.35;
            room -= v * DT;
        }
        assert!(room.abs() < 1.0 && v.abs() < 0.1, "{room} m, {v} m/s");
    }

    #[test]
    fn height_is_held_against_a_drift() {
        let (mut z, mut vz) = (-18.0, 0.0);
        for _ in 0..600 {
            vz += (hold_height(z, -20.0) - vz) * DT / 0.35;
            z += (vz + 0.05) * DT;
        }
        assert!((z + 20.0).abs() < 0.2, "{z}");
    }
}
