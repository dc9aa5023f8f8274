//! Parameters of the copied autopilots, with the values that the real ones have at their first start, and how they
//! tell them: ArduCopter as floats, PX4 integers by their bytes. A name that they do not have gets no answer.

use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::param::{ParamRequestRead, ParamValue};

/// MAV_PARAM_TYPE.
const INT32: u8 = 6;
const REAL32: u8 = 9;

/// The parameters of one vehicle.
#[derive(Debug, Clone)]
pub struct FakeParams {
    bytewise: bool,
    all: Vec<(&'static str, f32, u8)>,
}

impl FakeParams {
    /// ArduCopter's, up to 4.6.
    #[must_use]
    pub fn ardupilot() -> Self {
        let all = vec![
            ("WPNAV_SPEED", 1000.0, REAL32),
            ("WPNAV_ACCEL", 250.0, REAL32),
            ("ANGLE_MAX", 3000.0, REAL32),
            ("FENCE_ENABLE", 0.0, INT32),
            ("FENCE_TYPE", 7.0, INT32),
            ("FENCE_ALT_MAX", 100.0, REAL32),
            ("FENCE_ALT_MIN", -10.0, REAL32),
            ("FENCE_RADIUS", 300.0, REAL32),
        ];
        Self { bytewise: false, all }
    }

    /// PX4's.
    #[must_use]
    pub fn px4() -> Self {
        let all = vec![
            ("MPC_XY_VEL_MAX", 12.0, REAL32),
            ("MPC_ACC_HOR_MAX", 5.0, REAL32),
            ("MPC_TILTMAX_AIR", 45.0, REAL32),
            ("GF_ACTION", 2.0, INT32),
            ("GF_MAX_VER_DIST", 0.0, REAL32),
            ("GF_MAX_HOR_DIST", 0.0, REAL32),
        ];
        Self { bytewise: true, all }
    }

    /// The names that ArduCopter has from 4.7 on, and their units.
    #[must_use]
    pub fn renamed(mut self) -> Self {
        for (name, value, _) in &mut self.all {
            (*name, *value) = match *name {
                "WPNAV_SPEED" => ("WP_SPD", *value / 100.0),
                "WPNAV_ACCEL" => ("WP_ACC", *value / 100.0),
                "ANGLE_MAX" => ("ATC_ANGLE_MAX", *value / 100.0),
                same => (same, *value),
            };
        }
        self
    }

    /// With another value.
    ///
    /// # Panics
    /// There is no parameter of this name.
    #[must_use]
    pub fn with(mut self, name: &str, value: f32) -> Self {
        let found = self.all.iter_mut().find(|(known, ..)| *known == name);
        found.expect("the vehicle has this parameter").1 = value;
        self
    }

    /// None at all.
    #[must_use]
    pub fn silent(mut self) -> Self {
        self.all.clear();
        self
    }

    /// Answers a request by name.
    pub fn answer(&self, ask: &ParamRequestRead, encoder: &mut Encoder, out: &mut Vec<u8>) {
        let asked = ask.name.lossy();
        let Some(index) = self.all.iter().position(|(name, ..)| asked == *name) else { return };
        let (name, value, kind) = self.all[index];
        let told = ParamValue {
            value: if self.bytewise && kind == INT32 {
                (value as i32).to_le_bytes()
            } else {
                value.to_le_bytes()
            },
            count: self.all.len() as u16,
            index: index as u16,
            name: name.into(),
            kind,
        };
        encoder.push_view(out, &told);
    }
}
