//! Parameters of the copied autopilots, with the values that the real ones have at their first start, and how they
//! tell them: ArduCopter as floats, PX4 integers by their bytes. A name that they do not have gets no answer.

use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::param::{ParamRequestRead, ParamSet, ParamValue};

/// MAV_PARAM_TYPE.
const INT32: u8 = 6;
const REAL32: u8 = 9;

/// The parameters of one vehicle.
#[derive(Debug, Clone)]
pub struct FakeParams {
    bytewise: bool,
    all: Vec<FakeParam>,
    /// What it has as soon as a switch is above 0.
    behind: Vec<(&'static str, FakeParam)>,
}

/// Name, value, type.
type FakeParam = (&'static str, f32, u8);

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
            ("RNGFND1_TYPE", 0.0, INT32),
        ];
        let behind = vec![
            ("RNGFND1_TYPE", ("RNGFND1_MAX", 7.0, REAL32)),
            ("RNGFND1_MAX", ("RNGFND1_MIN", 0.2, REAL32)),
        ];
        Self { bytewise: false, all, behind }
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
        Self { bytewise: true, all, behind: Vec::new() }
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

    /// Answers a request by name, or by the place in the list.
    pub fn answer(&self, ask: &ParamRequestRead, encoder: &mut Encoder, out: &mut Vec<u8>) {
        let asked = ask.name.lossy();
        let by_name = self.all.iter().position(|(name, ..)| asked == *name);
        if let Some(index) = usize::try_from(ask.index).ok().or(by_name) {
            self.tell(index, encoder, out);
        }
    }

    /// Tells all.
    pub fn list(&self, encoder: &mut Encoder, out: &mut Vec<u8>) {
        (0..self.all.len()).for_each(|index| self.tell(index, encoder, out));
    }

    /// Sets one, and tells it.
    pub fn set(&mut self, asked: &ParamSet, encoder: &mut Encoder, out: &mut Vec<u8>) {
        let name = asked.name.lossy();
        let Some(index) = self.all.iter().position(|(known, ..)| name == *known) else { return };
        let is_whole = self.bytewise && self.all[index].2 == INT32;
        self.all[index].1 =
            if is_whole { i32::from_le_bytes(asked.value) as f32 } else { f32::from_le_bytes(asked.value) };
        self.tell(index, encoder, out);
        let (switch, value, _) = self.all[index];
        let revealed = self.behind.extract_if(.., |(behind, _)| *behind == switch && value > 0.0);
        self.all.extend(revealed.map(|(_, param)| param));
    }

    fn tell(&self, index: usize, encoder: &mut Encoder, out: &mut Vec<u8>) {
        let Some(&(name, value, kind)) = self.all.get(index) else { return };
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
