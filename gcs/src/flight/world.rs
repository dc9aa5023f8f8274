//! The world of a vehicle, as its own parameters tell it: what a flight is flown in and scored by.

use anyhow::{Context, Result, bail};
use crpl_sitl::Scenario;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::scenario::presets::PRESETS;
use crpl_sitl::vehicle::params::{world_of, world_params};

use crate::flight::Options;
use crate::tools::param::exchange::List;
use crate::tools::param::value::Encoding;
use crate::tools::session::Session;

/// How many contradictions an error names.
const SHOWN: usize = 3;

/// Finds the vehicle and reads its world; `scenario` and `camera`, where they are given, must not contradict it.
///
/// # Errors
/// No such scenario or camera, no vehicle, or as [`agree`].
pub async fn meet(
    options: &Options,
    connect: &Endpoint,
    scenario: Option<&str>,
    camera: &CameraFlag,
) -> Result<(Session, Scenario)> {
    // What is wrong with the file is said before anybody is asked.
    let stated = scenario.map(|name| camera.scenario(name)).transpose()?;
    camera.film(&mut Scenario::default())?;
    tracing::info!("connecting to {connect}");
    let mut session = options.find(connect).await?;
    let mut scenario = agree(&mut session, stated).await?;
    if camera.changes() {
        camera.put(&mut scenario)?;
        scenario = agree(&mut session, Some(scenario)).await?;
    }
    Ok((session, scenario))
}

/// Reads the vehicle's world and gives the scenario to fly: the vehicle's own, under the name of the preset that it
/// is; or `stated`, which must not contradict it.
///
/// # Errors
/// A contradiction, with both values; a vehicle that does not tell its world; parameters that take effect at its
/// next boot.
pub async fn agree(session: &mut Session, stated: Option<Scenario>) -> Result<Scenario> {
    let (system, _) = session.target();
    let params = session.run(&mut List::new(session.target(), Encoding::CCast)).await;
    let params = params.with_context(|| format!("vehicle {system}: reading its world"))?;
    let told: Vec<(String, f32)> =
        params.into_iter().map(|param| (param.name, param.value.as_f32())).collect();
    if told.iter().any(|(name, value)| name == "STAT_NEXT_BOOT" && *value != 0.0) {
        bail!(
            "vehicle {system}: parameters were set that take effect at its next boot, so they do not tell the \
             world that it flies in: restart it"
        );
    }
    if told.iter().any(|(name, value)| name == "CAM_PRESET" && *value < 0.0) {
        tracing::warn!("vehicle {system} films with a camera of its own, which its parameters do not tell");
    }
    match stated {
        Some(stated) => contradiction(&stated, &told).map_or(Ok(stated), |what| {
            bail!("vehicle {system} flies in another world than --scenario: {what}")
        }),
        None => {
            let world = world_of(&told).with_context(|| {
                format!("vehicle {system} does not tell its world: give it by --scenario")
            })?;
            // The vehicle may fly a preset with another camera.
            let known = PRESETS.iter().filter_map(|preset| Scenario::named(preset.name).ok());
            let known = known.map(|preset| Scenario { camera: world.camera.clone(), ..preset });
            let preset = known.into_iter().find(|preset| contradiction(preset, &told).is_none());
            let scenario = preset.unwrap_or(world);
            scenario.check().with_context(|| format!("vehicle {system}"))?;
            tracing::info!("vehicle {system} flies in {:?}", scenario.name);
            Ok(scenario)
        }
    }
}

/// Where a scenario contradicts what a vehicle tells, in one line. A vehicle may tell less.
fn contradiction(stated: &Scenario, told: &[(String, f32)]) -> Option<String> {
    let ours = world_params(stated);
    let value = |name: &str| told.iter().find(|(known, _)| known == name).map(|(_, value)| *value);
    let mut found: Vec<String> = ours
        .iter()
        .filter_map(|(name, ours)| Some((name, ours, value(name)?)))
        .filter(|(_, ours, theirs)| (*ours - theirs).abs() > 1e-6 * ours.abs().max(theirs.abs()))
        .map(|(name, ours, theirs)| format!("{name} = {ours} in the scenario, {theirs} on the vehicle"))
        .collect();
    let obstacle = |name: &str| name.starts_with("OBST") && name.ends_with("_RADIUS");
    let counts = [
        ours.iter().filter(|(name, _)| obstacle(name)).count(),
        told.iter().filter(|(name, _)| obstacle(name)).count(),
    ];
    if counts[0] != counts[1] && !told.is_empty() {
        found.insert(0, format!("{} obstacles in the scenario, {} on the vehicle", counts[0], counts[1]));
    }
    let more = found.len().saturating_sub(SHOWN);
    let shown = found.into_iter().take(SHOWN).collect::<Vec<_>>().join("; ");
    match (shown.is_empty(), more) {
        (true, _) => None,
        (false, 0) => Some(shown),
        (false, more) => Some(format!("{shown}; and {more} more")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(scenario: &Scenario) -> Vec<(String, f32)> {
        world_params(scenario).into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
    }

    #[test]
    fn every_preset_is_rebuilt_from_its_parameters() {
        for preset in PRESETS {
            let scenario = Scenario::named(preset.name).unwrap();
            let rebuilt = world_of(&told(&scenario)).unwrap();
            assert_eq!(contradiction(&rebuilt, &told(&scenario)), None, "{}", preset.name);
            rebuilt.check().unwrap();
            // What the vehicle does not tell: the station's own observer.
            let Scenario { name, observer, .. } = scenario.clone();
            assert_eq!(Scenario { name, observer, ..rebuilt }, scenario, "{}", preset.name);
        }
    }

    #[test]
    fn a_camera_with_a_name_is_told_and_another_one_contradicts() {
        let mut scenario = Scenario::named("demo").unwrap();
        scenario.film_with("hard").unwrap();
        assert_eq!(world_of(&told(&scenario)).unwrap().camera, scenario.camera);
        let what = contradiction(&Scenario::named("demo").unwrap(), &told(&scenario)).unwrap();
        assert_eq!(what, "CAM_PRESET = 0 in the scenario, 1 on the vehicle");
    }

    #[test]
    fn a_world_that_is_nobodys_is_rebuilt_to_the_last_digit() {
        let text = "start = [0.13, 0.47]\nuav_radius = 0.017\n[dynamics]\nv_max = 0.037\na_max = 0.0029\n\
                    [disturbance]\nsigma_c = 0.0037\n[[obstacle]]\nradius = 0.083\nvelocity = [0.0031, -0.0017]\n";
        let scenario = Scenario::from_toml(text).unwrap();
        let rebuilt = world_of(&told(&scenario)).unwrap();
        assert_eq!(Scenario { name: scenario.name.clone(), ..rebuilt }, scenario);
    }

    #[test]
    fn a_contradiction_names_both_values() {
        let (one, two) = (Scenario::named("1").unwrap(), Scenario::named("2").unwrap());
        let what = contradiction(&one, &told(&two)).unwrap();
        assert_eq!(what, "OBST_N = 150 in the scenario, 225 on the vehicle");
        let none = Scenario { obstacles: Vec::new(), ..two.clone() };
        let what = contradiction(&none, &told(&two)).unwrap();
        assert_eq!(what, "0 obstacles in the scenario, 1 on the vehicle");
    }
}
