//! The parameters that tell a vehicle's world, and the world that they tell.

use super::table::{AFTER_OBSTACLES, Holds, OF_AUTOPILOT, OF_OBSTACLES, ParamSlot, rounded, units};
use crate::scenario::{Obstacle, Scenario};

/// A parameter that a world has and a vehicle did not tell.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no parameter {0}")]
pub struct NoSuchParameter(pub &'static str);

/// The parameters that tell a vehicle's world, with their values in `scenario`: all that decides a flight and its
/// score but for the observer, which is the station's, and a camera without a name.
#[must_use]
pub fn world_params(scenario: &Scenario) -> Vec<(&'static str, f32)> {
    let slots = world_slots(scenario.obstacles.len());
    slots.filter_map(|slot| Some((slot.name, slot.get(scenario)? as f32))).collect()
}

/// The scenario that these parameters tell, each by its name; numbers are the shortest decimals that a parameter
/// holds. Unknown names are left out.
///
/// # Errors
/// A parameter of [`world_params`] is missing.
pub fn world_of(params: &[(String, f32)]) -> Result<Scenario, NoSuchParameter> {
    let value = |name: &str| params.iter().find(|(known, _)| known == name).map(|(_, value)| *value);
    let named = |slots: &[ParamSlot]| slots.iter().any(|slot| value(slot.name).is_some());
    let obstacles = OF_OBSTACLES.iter().take_while(|slots| named(&slots[..])).count();
    let mut world = Scenario { name: "the vehicle's".into(), ..Scenario::default() };
    world.obstacles = vec![Obstacle::default(); obstacles];
    // The scale comes first: lengths and speeds are told in its units.
    let is_scale = |slot: &&ParamSlot| slot.name.starts_with("SCALE_");
    let slots: Vec<&ParamSlot> = world_slots(obstacles).collect();
    for slot in slots.iter().filter(|slot| is_scale(slot)).chain(slots.iter().filter(|slot| !is_scale(slot)))
    {
        let told = value(slot.name).ok_or(NoSuchParameter(slot.name))?;
        // The shortest decimal that reads back as this float: 2.75 and not 2.7500000000000001.
        let told: f64 = told.to_string().parse().unwrap_or(f64::NAN);
        match slot.holds {
            Holds::Told(_, set) | Holds::Setting(_, set) => set(&mut world, told),
            Holds::Obstacle(index, length) => {
                *length(&mut world.obstacles[index]) = units(&world, told);
            }
            Holds::ObstacleTold(index, unit, of) => {
                *of(&mut world.obstacles[index]) = rounded(told / unit.size(&world));
            }
            _ => {}
        }
    }
    Ok(world)
}

/// The rows of the autopilot's table that hold a world's values.
fn world_slots(obstacles: usize) -> impl Iterator<Item = &'static ParamSlot> {
    let obstacles = OF_OBSTACLES.iter().take(obstacles).flatten();
    OF_AUTOPILOT.iter().chain(obstacles).chain(AFTER_OBSTACLES).filter(|slot| {
        let holds = &slot.holds;
        matches!(holds, Holds::Told(..) | Holds::Setting(..) | Holds::Obstacle(..) | Holds::ObstacleTold(..))
    })
}
