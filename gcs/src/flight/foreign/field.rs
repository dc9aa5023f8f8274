//! How the field lies on the ground, and what is done when its flight is over.

use crpl_sitl::link::dialect::SET_POSITION_TARGET_LOCAL_NED_DATA;

/// What a vehicle does at the end of its flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum WhenOver {
    /// Holds its place
    #[default]
    Hold,
    /// Lands where it is
    Land,
    /// Returns to where it took off, and lands
    Rtl,
}

/// The field's axes, turned from the vehicle's north and east about its origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldFrame {
    /// Degrees clockwise from north to the field's up: 0 to below 360.
    pub degrees: f64,
    sin: f32,
    cos: f32,
}

impl Default for FieldFrame {
    /// The field's up is north.
    fn default() -> Self {
        Self { degrees: 0.0, sin: 0.0, cos: 1.0 }
    }
}

impl FieldFrame {
    /// The field's up lies that many degrees clockwise from north.
    #[must_use]
    pub fn heading(degrees: f64) -> Self {
        // 360 degrees are none, to the last bit.
        let degrees = degrees.rem_euclid(360.0);
        let (sin, cos) = degrees.to_radians().sin_cos();
        Self { degrees, sin: sin as f32, cos: cos as f32 }
    }

    /// North, east, down to up, right, down.
    #[must_use]
    pub fn from_ned(self, [north, east, down]: [f32; 3]) -> [f32; 3] {
        let Self { sin, cos, .. } = self;
        [cos * north + sin * east, cos * east - sin * north, down]
    }

    /// Up and right to north and east.
    #[must_use]
    pub fn to_ned(self, [up, right]: [f32; 2]) -> [f32; 2] {
        let Self { sin, cos, .. } = self;
        [cos * up - sin * right, cos * right + sin * up]
    }

    /// A setpoint of the field as the vehicle's.
    pub fn turn(self, message: &mut SET_POSITION_TARGET_LOCAL_NED_DATA) {
        [message.x, message.y] = self.to_ned([message.x, message.y]);
        [message.vx, message.vy] = self.to_ned([message.vx, message.vy]);
        [message.afx, message.afy] = self.to_ned([message.afx, message.afy]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_to_the_east_has_east_up_and_south_on_its_right() {
        let field = FieldFrame::heading(90.0);
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(near(&field.from_ned([-1.0, 5.0, -3.0]), &[5.0, 1.0, -3.0]));
        for degrees in [0.0, 33.0, 90.0, 211.0, -45.0] {
            let field = FieldFrame::heading(degrees);
            let [up, right, _] = field.from_ned([2.0, -7.0, 0.0]);
            assert!(near(&field.to_ned([up, right]), &[2.0, -7.0]), "{degrees}");
        }
        assert_eq!(FieldFrame::heading(360.0), FieldFrame::default());
    }
}
