//! What a foreign vehicle allows by its own parameters: its largest speed and acceleration, and its fence. They
//! are read before it is armed, and a flight beyond them is refused: the vehicle would not fly it as it is meant,
//! or would end it by itself. Without socket and clock.
//!
//! | | ArduCopter | its 4.7 | PX4 |
//! |---|---|---|---|
//! | speed | WPNAV_SPEED, cm/s | WP_SPD, m/s | MPC_XY_VEL_MAX, m/s |
//! | acceleration | WPNAV_ACCEL, cm/s² | WP_ACC, m/s² | MPC_ACC_HOR_MAX, m/s² |
//! | lean | ANGLE_MAX, 0.01° | ATC_ANGLE_MAX, ° | MPC_TILTMAX_AIR, ° |
//! | whether there is a fence | FENCE_ENABLE or FENCE_AUTOENABLE, FENCE_TYPE | the same | GF_ACTION above 1 |
//! | its height, m | FENCE_ALT_MAX, FENCE_ALT_MIN | the same | GF_MAX_VER_DIST |
//! | its radius about home, m | FENCE_RADIUS | the same | GF_MAX_HOR_DIST |
//!
//! Fences that are polygons are a mission of their own and are not read.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use crpl_sitl::link::AUTOPILOT;
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::packet::Packet;

use super::FlightPlan;
use super::stack::ForeignStack;
use crate::tools::param::exchange::Read;
use crate::tools::param::value::Encoding;
use crate::tools::session::Exchange;

/// m/s².
const GRAVITY: f64 = 9.806_65;
/// FENCE_TYPE: largest height, circle, polygons, least height.
const FENCE_TOP: u32 = 1;
const FENCE_CIRCLE: u32 = 2;
const FENCE_POLYGONS: u32 = 4;
const FENCE_BOTTOM: u32 = 8;

/// What a parameter limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum LimitKind {
    Speed,
    Accel,
    Lean,
    FenceAuto,
    FenceOn,
    FenceKind,
    Top,
    Bottom,
    Radius,
}

/// A parameter: what it limits, its name, and its unit in m, m/s, m/s² or degrees.
type LimitParam = (LimitKind, &'static str, f64);

/// Newer names beside older ones: the vehicle has one of both. FENCE_AUTOENABLE, which not every version has, comes
/// first: it is not waited for.
const ARDUPILOT: [LimitParam; 12] = [
    (LimitKind::FenceAuto, "FENCE_AUTOENABLE", 1.0),
    (LimitKind::Speed, "WPNAV_SPEED", 0.01),
    (LimitKind::Speed, "WP_SPD", 1.0),
    (LimitKind::Accel, "WPNAV_ACCEL", 0.01),
    (LimitKind::Accel, "WP_ACC", 1.0),
    (LimitKind::Lean, "ANGLE_MAX", 0.01),
    (LimitKind::Lean, "ATC_ANGLE_MAX", 1.0),
    (LimitKind::FenceKind, "FENCE_TYPE", 1.0),
    (LimitKind::Top, "FENCE_ALT_MAX", 1.0),
    (LimitKind::Bottom, "FENCE_ALT_MIN", 1.0),
    (LimitKind::Radius, "FENCE_RADIUS", 1.0),
    (LimitKind::FenceOn, "FENCE_ENABLE", 1.0),
];
const PX4: [LimitParam; 6] = [
    (LimitKind::Speed, "MPC_XY_VEL_MAX", 1.0),
    (LimitKind::Accel, "MPC_ACC_HOR_MAX", 1.0),
    (LimitKind::Lean, "MPC_TILTMAX_AIR", 1.0),
    (LimitKind::FenceOn, "GF_ACTION", 1.0),
    (LimitKind::Top, "GF_MAX_VER_DIST", 1.0),
    (LimitKind::Radius, "GF_MAX_HOR_DIST", 1.0),
];

/// A limit of the vehicle, and the parameter that says so.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Limit {
    name: &'static str,
    value: f64,
}

/// What the vehicle allows, as far as it has said.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleLimits {
    stack: ForeignStack,
    told: BTreeMap<LimitKind, Limit>,
}

impl VehicleLimits {
    /// Nothing yet.
    #[must_use]
    pub fn new(stack: ForeignStack) -> Self {
        Self { stack, told: BTreeMap::new() }
    }

    /// A limit above zero; others are none, or switched off.
    fn limit(&self, kind: LimitKind) -> Option<Limit> {
        self.told.get(&kind).copied().filter(|limit| limit.value > 0.0)
    }

    fn value(&self, kind: LimitKind) -> f64 {
        self.told.get(&kind).map_or(0.0, |limit| limit.value)
    }

    /// Whether the vehicle keeps a fence of this kind.
    fn has_fence(&self, kind: u32) -> bool {
        match self.stack {
            ForeignStack::Px4 => {
                self.value(LimitKind::FenceOn) > 1.0 && kind & (FENCE_TOP | FENCE_CIRCLE) != 0
            }
            ForeignStack::Ardupilot => {
                let is_on = self.value(LimitKind::FenceOn) > 0.0 || self.value(LimitKind::FenceAuto) > 0.0;
                is_on && self.value(LimitKind::FenceKind) as u32 & kind != 0
            }
        }
    }

    /// Why a flight is refused that reaches `reach` metres from where the vehicle takes off, one reason each.
    #[must_use]
    pub fn refusals(&self, plan: &FlightPlan, reach: f64) -> Vec<String> {
        let mut found = Vec::new();
        let mut refuse = |what: &str, asked: f64, limit: Limit, unit: &str| {
            let Limit { name, value } = limit;
            let past = if asked > value { "above" } else { "below" };
            found.push(format!(
                "{what} is {asked:.1} {unit}, {past} the vehicle's {name} of {value:.1} {unit}"
            ));
        };
        if let Some(limit) = self.limit(LimitKind::Speed).filter(|limit| plan.v_max > limit.value) {
            refuse("its largest speed", plan.v_max, limit, "m/s");
        }
        if let Some(limit) = self.limit(LimitKind::Accel).filter(|limit| plan.a_max > limit.value) {
            refuse("its largest acceleration", plan.a_max, limit, "m/s²");
        }
        let lean = (plan.a_max / GRAVITY).atan().to_degrees();
        if let Some(limit) = self.limit(LimitKind::Lean).filter(|limit| lean > limit.value) {
            refuse("the lean for its largest acceleration", lean, limit, "degrees");
        }
        let highest = plan.altitude_m + plan.vertical_limit_m;
        if let Some(limit) = self.limit(LimitKind::Top).filter(|limit| highest > limit.value)
            && self.has_fence(FENCE_TOP)
        {
            refuse("its height with the vertical limit", highest, limit, "m");
        }
        let lowest = plan.altitude_m - plan.vertical_limit_m;
        if let Some(&limit) = self.told.get(&LimitKind::Bottom).filter(|limit| lowest < limit.value)
            && self.has_fence(FENCE_BOTTOM)
        {
            refuse("its height less the vertical limit", lowest, limit, "m");
        }
        if let Some(limit) = self.limit(LimitKind::Radius).filter(|limit| reach > limit.value)
            && self.has_fence(FENCE_CIRCLE)
        {
            refuse("the field's farthest corner from home", reach, limit, "m");
        }
        found
    }
}

impl fmt::Display for VehicleLimits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.told.is_empty() {
            return f.write_str("the vehicle does not tell its limits: nothing is compared with them");
        }
        let mut words = Vec::new();
        for (kind, unit) in [(LimitKind::Speed, " m/s"), (LimitKind::Accel, " m/s²"), (LimitKind::Lean, "°")]
        {
            match self.limit(kind) {
                Some(Limit { name, value }) => words.push(format!("{name} {value:.1}{unit}")),
                None => words.push(format!("no word of a largest {}", kind.word())),
            }
        }
        for (fence, kind) in [
            (FENCE_TOP, LimitKind::Top),
            (FENCE_BOTTOM, LimitKind::Bottom),
            (FENCE_CIRCLE, LimitKind::Radius),
        ] {
            if let Some(Limit { name, value }) = self.told.get(&kind).filter(|_| self.has_fence(fence)) {
                words.push(format!("{name} {value:.1} m"));
            }
        }
        if self.has_fence(FENCE_POLYGONS) {
            words.push("fences that are polygons, which are not compared".into());
        }
        if self.value(LimitKind::FenceOn) == 0.0 && self.value(LimitKind::FenceAuto) == 0.0 {
            words.push("no fence".into());
        }
        write!(f, "the vehicle's own limits: {}", words.join(", "))
    }
}

impl LimitKind {
    fn word(self) -> &'static str {
        match self {
            Self::Speed => "speed",
            Self::Accel => "acceleration",
            Self::Lean => "lean",
            Self::FenceAuto | Self::FenceOn | Self::FenceKind => "fence",
            Self::Top => "height",
            Self::Bottom => "least height",
            Self::Radius => "radius",
        }
    }
}

/// Reads them.
#[derive(Debug)]
pub struct LimitReader {
    limits: VehicleLimits,
    open: Vec<(LimitParam, Read)>,
}

impl LimitReader {
    /// Of this system.
    #[must_use]
    pub fn new(stack: ForeignStack, system: u8) -> Self {
        let (params, encoding): (&[LimitParam], _) = match stack {
            ForeignStack::Ardupilot => (&ARDUPILOT, Encoding::CCast),
            ForeignStack::Px4 => (&PX4, Encoding::Bytewise),
        };
        let read = |param: &LimitParam| {
            let read = Read::new(param.1.into(), (system, AUTOPILOT), encoding).ok()?;
            Some((*param, read))
        };
        Self { limits: VehicleLimits::new(stack), open: params.iter().filter_map(read).collect() }
    }

    /// A packet of the vehicle.
    pub fn packet(&mut self, packet: &Packet, now: Duration) {
        self.open.iter_mut().for_each(|(_, read)| read.packet(packet, now));
        self.settle();
    }

    /// Asks for what has not come.
    pub fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        self.open.iter_mut().for_each(|(_, read)| read.poll(now, station, datagram));
        self.settle();
    }

    fn settle(&mut self) {
        let told = &mut self.limits.told;
        self.open.retain_mut(|((kind, name, unit), read)| match read.outcome() {
            Some(Ok(param)) => {
                let value = f64::from(param.value.as_f32()) * *unit;
                if value.is_finite() {
                    told.insert(*kind, Limit { name, value });
                }
                false
            }
            Some(Err(_)) => false,
            None => true,
        });
    }

    /// The limits, once each has come by one of its names or does not come.
    #[must_use]
    pub fn done(&self) -> Option<&VehicleLimits> {
        let waits = |kind: &LimitKind| *kind != LimitKind::FenceAuto && !self.limits.told.contains_key(kind);
        (!self.open.iter().any(|((kind, ..), _)| waits(kind))).then_some(&self.limits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits(stack: ForeignStack, told: &[LimitParam]) -> VehicleLimits {
        let told = told.iter().map(|&(kind, name, value)| (kind, Limit { name, value })).collect();
        VehicleLimits { stack, told }
    }

    fn plan() -> FlightPlan {
        FlightPlan {
            altitude_m: 10.0,
            field_m: 60.0,
            v_max: 2.0,
            a_max: 1.0,
            heading: 0.0,
            origin: None,
            vertical_limit_m: 5.0,
        }
    }

    #[test]
    fn each_limit_is_kept_and_a_fence_counts_if_it_is_on() {
        let (mine, theirs) = (ForeignStack::Ardupilot, ForeignStack::Px4);
        let cases: [(ForeignStack, &[LimitParam], &str); 10] = [
            (
                mine,
                &[(LimitKind::Speed, "WP_SPD", 1.9)],
                "largest speed is 2.0 m/s, above the vehicle's WP_SPD of 1.9 m/s",
            ),
            (mine, &[(LimitKind::Accel, "WP_ACC", 0.5)], "largest acceleration is 1.0 m/s²"),
            (
                theirs,
                &[(LimitKind::Lean, "MPC_TILTMAX_AIR", 5.0)],
                "lean for its largest acceleration is 5.8 degrees",
            ),
            (
                mine,
                &[
                    (LimitKind::FenceOn, "FENCE_ENABLE", 1.0),
                    (LimitKind::FenceKind, "FENCE_TYPE", 7.0),
                    (LimitKind::Top, "FENCE_ALT_MAX", 14.0),
                ],
                "height with the vertical limit is 15.0 m, above the vehicle's FENCE_ALT_MAX of 14.0 m",
            ),
            (
                mine,
                &[
                    (LimitKind::FenceAuto, "FENCE_AUTOENABLE", 3.0),
                    (LimitKind::FenceKind, "FENCE_TYPE", 8.0),
                    (LimitKind::Bottom, "FENCE_ALT_MIN", 6.0),
                ],
                "height less the vertical limit is 5.0 m, below the vehicle's FENCE_ALT_MIN of 6.0 m",
            ),
            (
                theirs,
                &[(LimitKind::FenceOn, "GF_ACTION", 3.0), (LimitKind::Radius, "GF_MAX_HOR_DIST", 69.0)],
                "farthest corner from home is 70.0 m, above the vehicle's GF_MAX_HOR_DIST of 69.0 m",
            ),
            (
                theirs,
                &[(LimitKind::FenceOn, "GF_ACTION", 1.0), (LimitKind::Radius, "GF_MAX_HOR_DIST", 9.0)],
                "",
            ),
            (
                theirs,
                &[(LimitKind::FenceOn, "GF_ACTION", 3.0), (LimitKind::Radius, "GF_MAX_HOR_DIST", 0.0)],
                "",
            ),
            (mine, &[(LimitKind::FenceKind, "FENCE_TYPE", 7.0), (LimitKind::Top, "FENCE_ALT_MAX", 1.0)], ""),
            (mine, &[], ""),
        ];
        for (stack, told, why) in cases {
            let found = limits(stack, told).refusals(&plan(), 70.0).join("; ");
            assert!(if why.is_empty() { found.is_empty() } else { found.contains(why) }, "{why}: {found}");
        }
    }
}
