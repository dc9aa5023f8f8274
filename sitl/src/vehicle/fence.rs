//! The fence: polygons and circles in the plane that the vehicle must not leave, or not enter, and the failsafe
//! that keeps it. Knows places and items, no messages.
//!
//! | item | area |
//! |---|---|
//! | FENCE_POLYGON_VERTEX_INCLUSION (5001), EXCLUSION (5002) | a polygon of param1 vertices, which follow one another |
//! | FENCE_CIRCLE_INCLUSION (5003), EXCLUSION (5004) | a circle of param1 m |
//! | FENCE_RETURN_POINT (5000) | kept, and not returned to |
//!
//! As with ArduCopter the vehicle must be inside every inclusion. The failsafe looks where the vehicle would come
//! to rest: if that is outside and the vehicle is inside, or has just left, it does what `FENCE_ACTION` says: 0
//! says so, 1 brakes (BRAKE), 2 returns (RTL). A vehicle that is outside already may be flown back.

use std::time::Duration;

use nalgebra::Vector2;

use super::conduct::Mode;
use super::item::{Fault, StoredItem};
use super::{Vehicle, guidance};
use crate::link::dialect::{self, FenceBreach, FenceMitigate, MavMissionResult, MavSeverity};
use crate::scenario::Action;
use crate::world::dynamics::State;

const RETURN_POINT: u16 = 5000;
const POLYGON_INSIDE: u16 = 5001;
const POLYGON_OUTSIDE: u16 = 5002;
const CIRCLE_INSIDE: u16 = 5003;
const CIRCLE_OUTSIDE: u16 = 5004;

/// A fence as it was uploaded, and what it encloses.
#[derive(Debug, Clone, Default)]
pub(super) struct Fence {
    items: Vec<StoredItem>,
    areas: Vec<Zone>,
    /// Whether the vehicle was outside, or about to be, when it was last looked at.
    breached: bool,
    /// How often that has begun, and when last, boot ms.
    breaches: u16,
    breach_ms: u32,
}

#[derive(Debug, Clone, PartialEq)]
struct Zone {
    /// Whether the vehicle must be inside, not outside.
    is_inclusion: bool,
    shape: Shape,
}

/// North and east, m.
#[derive(Debug, Clone, PartialEq)]
enum Shape {
    Polygon(Vec<Vector2<f64>>),
    Circle(Vector2<f64>, f64),
}

impl Shape {
    fn contains(&self, place: Vector2<f64>) -> bool {
        match self {
            Self::Circle(centre, radius) => (place - centre).norm() <= *radius,
            Self::Polygon(corners) => {
                // A ray to the east crosses an odd number of sides from inside.
                let sides = corners.iter().zip(corners.iter().cycle().skip(1));
                let crossed = sides.filter(|(a, b)| {
                    (a.x > place.x) != (b.x > place.x)
                        && place.y < (b.y - a.y) * (place.x - a.x) / (b.x - a.x) + a.y
                });
                crossed.count() % 2 == 1
            }
        }
    }
}

/// What keeps an item from being one of a fence.
pub(super) fn fault(item: &StoredItem) -> Result<(), Fault> {
    if !(RETURN_POINT..=CIRCLE_OUTSIDE).contains(&item.command) {
        let result = MavMissionResult::MAV_MISSION_UNSUPPORTED;
        return Err(Fault::of(result, "its command is not one of a fence"));
    }
    if !item.frame_has_places() {
        return Err(Fault::of(MavMissionResult::MAV_MISSION_UNSUPPORTED_FRAME, "its frame has no places"));
    }
    let first = item.params[0];
    let good = match item.command {
        POLYGON_INSIDE | POLYGON_OUTSIDE => first >= 3.0 && first.fract() == 0.0,
        CIRCLE_INSIDE | CIRCLE_OUTSIDE => first > 0.0 && first.is_finite(),
        _ => true,
    };
    if !good {
        return Err(Fault::of(MavMissionResult::MAV_MISSION_INVALID_PARAM1, "its count or radius is none"));
    }
    item.place_fault()
}

impl Fence {
    /// The fence of these items, each of which is good, at places north and east in metres.
    ///
    /// # Errors
    /// A polygon that is not complete.
    pub fn new(items: Vec<StoredItem>, place: impl Fn(&StoredItem) -> [f32; 2]) -> Result<Self, Fault> {
        let place = |item: &StoredItem| Vector2::from(place(item).map(f64::from));
        let (mut areas, mut rest) = (Vec::new(), &items[..]);
        while let Some(item) = rest.first() {
            let is_inclusion = matches!(item.command, POLYGON_INSIDE | CIRCLE_INSIDE);
            let mut length = 1;
            match item.command {
                POLYGON_INSIDE | POLYGON_OUTSIDE => {
                    length = item.params[0] as usize;
                    let corners = rest.get(..length).unwrap_or_default();
                    let alike = |other: &StoredItem| {
                        (other.command, other.params[0]) == (item.command, item.params[0])
                    };
                    if corners.is_empty() || !corners.iter().all(alike) {
                        let result = MavMissionResult::MAV_MISSION_INVALID_PARAM1;
                        return Err(Fault::of(result, "a polygon lacks vertices"));
                    }
                    areas.push(Zone {
                        is_inclusion,
                        shape: Shape::Polygon(corners.iter().map(place).collect()),
                    });
                }
                CIRCLE_INSIDE | CIRCLE_OUTSIDE => {
                    let shape = Shape::Circle(place(item), item.params[0].into());
                    areas.push(Zone { is_inclusion, shape });
                }
                _ => {}
            }
            rest = rest.get(length..).unwrap_or_default();
        }
        Ok(Self { items, areas, ..Self::default() })
    }

    /// Its items.
    pub fn items(&self) -> &[StoredItem] {
        &self.items
    }

    /// Whether there is anything to keep.
    pub fn is_set(&self) -> bool {
        !self.areas.is_empty()
    }

    /// FENCE_STATUS.
    pub fn status(&self, action: Action) -> dialect::FENCE_STATUS_DATA {
        let keeps = action != Action::Hold;
        dialect::FENCE_STATUS_DATA {
            breach_time: self.breach_ms,
            breach_count: self.breaches,
            breach_status: self.breached.into(),
            breach_type: if self.breached {
                FenceBreach::FENCE_BREACH_BOUNDARY
            } else {
                FenceBreach::FENCE_BREACH_NONE
            },
            breach_mitigation: if keeps {
                FenceMitigate::FENCE_MITIGATE_VEL_LIMIT
            } else {
                FenceMitigate::FENCE_MITIGATE_NONE
            },
        }
    }

    /// Whether the vehicle may be at a place, north and east in metres.
    pub fn allows(&self, place: [f32; 2]) -> bool {
        let place = Vector2::from(place.map(f64::from));
        self.areas.iter().all(|zone| zone.shape.contains(place) == zone.is_inclusion)
    }
}

impl Vehicle {
    /// Looks whether the vehicle leaves the fence, and keeps it inside.
    pub(super) fn keep_fence(&mut self, now: Duration) {
        if !self.fence.is_set() || !self.conduct.armed || self.height.on_ground() {
            self.fence.breached = false;
            return;
        }
        let scenario = self.sim.scenario();
        let state = self.sim.world().uav;
        // The station's acceleration is flown for one interval before the vehicle can brake.
        let is_pushed = self.conduct.mode == Mode::Guided && self.conduct.guided.is_none();
        let push = if is_pushed { self.sim.flown() * scenario.dynamics.a_max } else { Vector2::zeros() };
        let rest = guidance::rest(State { v: state.v + push, ..state }, &scenario.dynamics);
        let [here, there] = [state.r, rest].map(|r| self.fence.allows(scenario.scale.ned_from_paper(r)));
        let breached = !here || !there;
        let begins = breached && !self.fence.breached;
        self.fence.breached = breached;
        let is_safe = matches!(self.conduct.mode, Mode::Brake | Mode::Return | Mode::Land);
        let leaves = here && !there && !is_safe;
        if !begins && !leaves {
            return;
        }
        if begins {
            self.fence.breaches = self.fence.breaches.saturating_add(1);
            self.fence.breach_ms = self.clock.boot_ms(self.sim.tick());
        }
        let (what, mode) = match self.fence_action {
            Action::Hold => ("goes on", None),
            Action::Brake => ("brakes", Some(Mode::Brake)),
            Action::Return => ("returns", Some(Mode::Return)),
        };
        let text = format!("failsafe: at the fence: {what}");
        self.say("fence", MavSeverity::MAV_SEVERITY_CRITICAL, &text, now);
        if let Some(mode) = mode.filter(|_| !is_safe) {
            self.enter(mode, now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_inside_a_polygon_of_any_shape_or_not() {
        let corners = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [5.0, 2.0], [0.0, 10.0]];
        let shape = Shape::Polygon(corners.map(Vector2::from).into());
        for (place, inside) in
            [([1.0, 1.0], true), ([9.0, 5.0], true), ([5.0, 5.0], false), ([-1.0, 1.0], false)]
        {
            assert_eq!(shape.contains(place.into()), inside, "{place:?}");
        }
        let circle = Shape::Circle(Vector2::new(1.0, 1.0), 2.0);
        assert!(circle.contains(Vector2::new(3.0, 1.0)) && !circle.contains(Vector2::new(3.0, 1.1)));
    }
}
