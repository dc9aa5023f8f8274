//! Where a flight on a foreign vehicle would be, in words for who lets it.

use std::fmt;

use crpl_sitl::Scenario;
use nalgebra::Vector2;

use super::Foreign;

/// How far above or below its height a vehicle may come unless another limit is given, m: no more than half of its
/// height.
const VERTICAL_LIMIT_M: f64 = 5.0;

/// Where a vehicle will fly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightPlan {
    /// Above its start, m.
    pub altitude_m: f64,
    /// Side of the square, m.
    pub field_m: f64,
    /// Largest speed, m/s.
    pub v_max: f64,
    /// Largest acceleration on each axis, m/s².
    pub a_max: f64,
    /// From north to the square's up, degrees clockwise.
    pub heading: f64,
    /// The square's lower left corner, north and east of the vehicle's origin, m, if it is not laid so that the
    /// vehicle stands at the scenario's start.
    pub origin: Option<[f32; 2]>,
    /// How far above or below its height it may come, m.
    pub vertical_limit_m: f64,
}

impl FlightPlan {
    /// Of a scenario on a vehicle.
    #[must_use]
    pub fn of(scenario: &Scenario, how: &Foreign) -> Self {
        let scale = &scenario.scale;
        let [a_max, _] = scale.ned_from_paper_acceleration(Vector2::repeat(scenario.dynamics.a_max));
        Self {
            altitude_m: scale.altitude_m,
            field_m: scale.metres_per_unit,
            v_max: scenario.dynamics.v_max * scale.mps_per_speed(),
            a_max: f64::from(a_max),
            heading: how.field.degrees,
            origin: how.origin,
            vertical_limit_m: how.vertical_limit.unwrap_or_else(|| Self::vertical_limit(scale.altitude_m)),
        }
    }

    /// How far above or below its height it may come if nothing is said, m.
    #[must_use]
    pub fn vertical_limit(altitude_m: f64) -> f64 {
        VERTICAL_LIMIT_M.min(altitude_m / 2.0)
    }

    /// Whether it is larger than what is flown without a question.
    #[must_use]
    pub fn is_large(&self) -> bool {
        self.altitude_m > 50.0 || self.field_m > 150.0 || self.v_max > 10.0
    }
}

impl fmt::Display for FlightPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { altitude_m, field_m, v_max, a_max, heading, origin, vertical_limit_m } = self;
        let up = if *heading == 0.0 {
            "whose north is up".into()
        } else {
            format!("whose up is {heading:.0} degrees from north")
        };
        write!(
            f,
            "the vehicle would climb to {altitude_m:.0} m and fly in a square of {field_m:.0} m {up}, \
             at {v_max:.1} m/s and {a_max:.1} m/s² at most, no more than {vertical_limit_m:.1} m higher or lower"
        )?;
        if let Some([north, east]) = origin {
            write!(
                f,
                "; the square's lower left corner is {north:.0} m north and {east:.0} m east of the vehicle's origin, \
                 and it flies to its start first"
            )?;
        }
        Ok(())
    }
}
