//! Accelerations that are flown as they were meant.
//!
//! CRPL plans for a body that keeps its speed unless it is pushed. An autopilot's vehicle has drag,
//! follows a push late and drifts in height. So the speed that the commands add up to is kept as a
//! reference, and what the vehicle lacks of it is added to the acceleration that is asked for; the
//! constant part of that, drag above all, is learned. The height is held by a spring and a damper.

/// Speed error to acceleration, 1/s: behind an autopilot that answers with a lag of 0.35 s and a delay
/// of 0.1 s the speed settles within a second and overshoots by a tenth.
const SPEED_GAIN: f64 = 2.5;
/// Speed error to learned acceleration, 1/s²: a drag of 1/s is learned within two seconds.
const DRAG_GAIN: f64 = 2.0;
/// Largest error that counts, m/s: a vehicle at its limits does not wind the reference up.
const SPEED_ERROR: f64 = 1.5;
/// Largest acceleration that is learned, m/s².
const DRAG_LIMIT: f64 = 3.0;
/// Deceleration that is reckoned with before the square's edge, m/s²: half of what is asked for at most.
const BRAKING: f64 = LIMIT / 2.0;
/// Largest acceleration that is asked for on an axis, m/s²: what ArduCopter's tilt gives.
const LIMIT: f64 = 3.5;
/// Height error to acceleration, 1/s², and speed to acceleration, 1/s: 0.8 rad/s, well damped.
const HEIGHT_GAINS: [f64; 2] = [0.64, 1.3];
/// Largest vertical acceleration, m/s².
const HEIGHT_LIMIT: f64 = 1.5;

/// Follows the speed that accelerations add up to. North, east.
#[derive(Debug, Clone, Copy)]
pub struct Tracker {
    reference: [f64; 2],
    drag: [f64; 2],
    v_max: f64,
}

impl Tracker {
    /// At rest; `v_max` in m/s limits the reference as the paper limits the speed.
    #[must_use]
    pub fn new(v_max: f64) -> Self {
        Self { reference: [0.0; 2], drag: [0.0; 2], v_max }
    }

    /// `dt` seconds pass with the acceleration `wish`, at the speed `velocity`; what to ask for, m/s².
    /// `room` is how far it is to the edges on each axis, downwards and upwards, m: as the paper's walls
    /// do, they end the speed towards them.
    pub fn step(&mut self, mut wish: [f64; 2], velocity: [f64; 2], room: [[f64; 2]; 2], dt: f64) -> [f64; 2] {
        for axis in 0..2 {
            let reference = self.reference[axis] + wish[axis] * dt;
            self.reference[axis] =
                reference.clamp(velocity[axis] - SPEED_ERROR, velocity[axis] + SPEED_ERROR);
        }
        let speed = self.reference[0].hypot(self.reference[1]);
        if speed > self.v_max {
            self.reference = self.reference.map(|v| v * self.v_max / speed);
        }
        for axis in 0..2 {
            let [down, up] = room[axis].map(|room| (2.0 * BRAKING * room.max(0.0)).sqrt());
            let allowed = self.reference[axis].clamp(-down, up);
            if allowed != self.reference[axis] {
                (self.reference[axis], wish[axis]) = (allowed, 0.0);
            }
        }
        std::array::from_fn(|axis| {
            let error = self.reference[axis] - velocity[axis];
            self.drag[axis] = (self.drag[axis] + DRAG_GAIN * error * dt).clamp(-DRAG_LIMIT, DRAG_LIMIT);
            (wish[axis] + SPEED_GAIN * error + self.drag[axis]).clamp(-LIMIT, LIMIT)
        })
    }
}

/// Vertical acceleration (down, m/s²) that holds the height `z` (down, m) at `wanted`.
#[must_use]
pub fn hold_height(z: f64, vz: f64, wanted: f64) -> f64 {
    (HEIGHT_GAINS[0] * (wanted - z) - HEIGHT_GAINS[1] * vz).clamp(-HEIGHT_LIMIT, HEIGHT_LIMIT)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.05;

    /// A vehicle with this drag (1/s) that follows an acceleration with a lag of 0.35 s; its speed after
    /// pushes of 1 m/s² for 3 s and none for 3 s more.
    fn pushed(drag: f64) -> [f64; 2] {
        let (mut tracker, mut v, mut a) = (Tracker::new(10.0), 0.0, 0.0);
        let mut at = [0.0; 2];
        for k in 0..120 {
            let wish = if k < 60 { 1.0 } else { 0.0 };
            let asked = tracker.step([wish, 0.0], [v, 0.0], [[1e3; 2]; 2], DT)[0];
            a += (asked - a) * DT / 0.35;
            v += (a - drag * v) * DT;
            at[usize::from(k >= 60)] = v;
        }
        at
    }

    #[test]
    fn a_push_gives_its_speed_with_drag_and_without() {
        for drag in [0.0, 0.3, 1.0] {
            let [pushed, coasting] = pushed(drag);
            assert!((pushed - 3.0).abs() < 0.6, "drag {drag}: {pushed}");
            assert!((coasting - 3.0).abs() < 0.3, "drag {drag}: {coasting}");
        }
    }

    #[test]
    fn an_edge_stops_what_flies_towards_it() {
        let (mut tracker, mut v, mut a, mut room) = (Tracker::new(2.0), 0.0, 0.0, 20.0);
        for _ in 0..400 {
            let asked = tracker.step([1.0, 0.0], [v, 0.0], [[1e3, room], [1e3; 2]], DT)[0];
            a += (asked - a) * DT / 0.35;
            v += a * DT;
            room -= v * DT;
        }
        assert!(room.abs() < 1.0 && v.abs() < 0.1, "{room} m, {v} m/s");
    }

    #[test]
    fn height_is_held_against_a_drift() {
        let (mut z, mut vz) = (-18.0, 0.0);
        for _ in 0..600 {
            vz += (hold_height(z, vz, -20.0) + 0.05) * DT;
            z += vz * DT;
        }
        assert!((z + 20.0).abs() < 0.2, "{z}");
    }
}
