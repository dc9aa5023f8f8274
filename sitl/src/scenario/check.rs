//! What a scenario may hold: a range for every number, places that are free, and what to write instead of a
//! former key.
//!
//! The ranges are wide: they keep out what no flight has, not what the paper does not have. Within them every
//! position, SNR and energy of a flight is a finite number; a property test below flies their corners.

use std::path::PathBuf;

use nalgebra::Vector2;

use super::{Obstacle, Scenario, presets};
use crate::units::MAX_OBSTACLES;

/// Why a scenario could not be used.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file could not be read.
    #[error("reading {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not a scenario.
    #[error("reading {path}: {message}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, key and reason, from the parser.
        message: String,
    },
    /// A value is out of range.
    #[error("{key} = {value}: {must}")]
    Range {
        /// Dotted key.
        key: String,
        /// The value found.
        value: String,
        /// What it must be.
        must: String,
    },
    /// A place that an obstacle covers.
    #[error(
        "{key} = [{}, {}]: must be more than {least:.4} from the centre of {obstacle} (both radii and d_min), and is \
         {distance:.4}", place[0], place[1]
    )]
    Covered {
        /// Dotted key.
        key: &'static str,
        /// The place, paper units.
        place: [f64; 2],
        /// Which obstacle, as a key.
        obstacle: String,
        /// R_o + R_u + d_min, paper units.
        least: f64,
        /// From the obstacle's centre, paper units.
        distance: f64,
    },
    /// A spelling of a former version.
    #[error("`{old}` is now {new}")]
    Renamed {
        /// The former key.
        old: &'static str,
        /// What to write instead.
        new: &'static str,
    },
    /// `--scenario` names neither a preset nor a file.
    #[error("there is no scenario file `{name}`, and no such preset; presets: {}", presets::names())]
    Unknown {
        /// What was given.
        name: String,
    },
    /// The paper has Scenarios 1 and 2.
    #[error("there is no scenario {0}; the paper has 1 and 2")]
    Number(u8),
}

/// A key, its value, and the least and the greatest value that it may have.
type Row = (&'static str, f64, f64, f64);

impl Scenario {
    /// Checks every range, and that start and goal are free.
    ///
    /// # Errors
    /// The first value that is out of range, with its key and what it must be; or a start or goal that an
    /// obstacle covers.
    pub fn check(&self) -> Result<(), ScenarioError> {
        self.faults().into_iter().next().map_or(Ok(()), Err)
    }

    /// Everything that [`Scenario::check`] would refuse, in its order.
    #[must_use]
    pub fn faults(&self) -> Vec<ScenarioError> {
        let mut all: Vec<Result<(), ScenarioError>> = self
            .ranges()
            .map(|(key, value, least, most)| {
                check(key, value, (least..=most).contains(&value), || within(least, most))
            })
            .collect();
        let most = 1000.0 * self.radio.b_dt;
        all.push(check("radio.packet_bits", self.radio.packet_bits, self.radio.packet_bits <= most, || {
            "must be at most 1000 times radio.b_dt".into()
        }));
        let count = self.obstacles.len();
        all.push(check("number of obstacles", count as f64, count <= MAX_OBSTACLES, || {
            "must be at most 8".into()
        }));
        for (n, obstacle) in self.obstacles.iter().enumerate() {
            all.push(obstacle.check(n));
            let is_alone = self.obstacles[..n].iter().all(|o| o.position != obstacle.position);
            all.push(check(&format!("obstacle[{n}].position[0]"), obstacle.position.x, is_alone, || {
                "must be another place than that of the obstacles before it".into()
            }));
        }
        if let Some((key, value, must)) = self.camera.violation() {
            all.push(Err(ScenarioError::Range { key: format!("camera.{key}"), value, must }));
        }
        all.push(self.is_free("start", self.start, |_| true));
        // One that moves can leave the goal before the UAV is there.
        all.push(self.is_free("goal", self.goal, |obstacle| obstacle.velocity == Vector2::zeros()));
        all.into_iter().filter_map(Result::err).collect()
    }

    /// Every number with a range of its own: its key, its value, the least and the greatest that it may have.
    pub fn ranges(&self) -> impl Iterator<Item = (&'static str, f64, f64, f64)> {
        self.lengths().into_iter().chain(self.others())
    }

    /// Everything in the paper's units of length and time.
    fn lengths(&self) -> [Row; 19] {
        [
            ("start[0]", self.start.x, 0.0, 1.0),
            ("start[1]", self.start.y, 0.0, 1.0),
            ("goal[0]", self.goal.x, 0.0, 1.0),
            ("goal[1]", self.goal.y, 0.0, 1.0),
            ("goal_radius", self.goal_radius, 1e-6, 2.0),
            ("uav_radius", self.uav_radius, 1e-3, 1.0),
            ("dynamics.v_max", self.dynamics.v_max, 1e-6, 1.0),
            ("dynamics.a_max", self.dynamics.a_max, 1e-9, 1.0),
            ("disturbance.sigma_c", self.disturbance.sigma_c, 0.0, 10.0),
            ("disturbance.gust_scale", self.disturbance.gust_scale, 0.0, 100.0),
            ("channel.base_station[0]", self.channel.base_station.x, 0.0, 1.0),
            ("channel.base_station[1]", self.channel.base_station.y, 0.0, 1.0),
            ("channel.blockage_softness", self.channel.blockage_softness, 1e-6, 10.0),
            ("channel.distance_floor", self.channel.distance_floor, 1e-6, 1.0),
            ("safety.softness", self.safety.softness, 1e-6, 10.0),
            ("safety.d_min", self.safety.d_min, 0.0, 1.0),
            ("safety.edge_margin", self.safety.edge_margin, 0.0, 0.5),
            ("horizon", self.horizon as f64, 1.0, 1e6),
            ("observer.window", self.observer.window as f64, 2.0, 100.0),
        ]
    }

    /// Powers, bits, shares, and everything in SI units.
    fn others(&self) -> [Row; 30] {
        let (channel, propulsion, scale) = (&self.channel, &self.propulsion, &self.scale);
        [
            ("channel.reference_gain", channel.reference_gain, 1e-12, 1e12),
            ("channel.path_loss_exponent", channel.path_loss_exponent, 0.0, 10.0),
            ("channel.nlos_attenuation", channel.nlos_attenuation, 1e-12, 1.0),
            ("channel.noise_power", channel.noise_power, 1e-12, 1e12),
            ("channel.snr_min", channel.snr_min, 1e-12, 1e12),
            ("radio.b_dt", self.radio.b_dt, 1e-6, 1e9),
            ("radio.packet_bits", self.radio.packet_bits, 1e-6, 1e9),
            ("safety.collision_tolerance", self.safety.collision_tolerance, 0.0, 1.0),
            ("safety.outage_tolerance", self.safety.outage_tolerance, 0.0, 1.0),
            ("cost.goal", self.cost.goal, 0.0, 1e6),
            ("cost.motion", self.cost.motion, 0.0, 1e6),
            ("cost.power", self.cost.power, 0.0, 1e6),
            ("cost.settle", self.cost.settle, 0.0, 1e6),
            ("cost.settle_intervals", self.cost.settle_intervals as f64, 0.0, 1e6),
            ("propulsion.blade_profile_power", propulsion.blade_profile_power, 1e-3, 1e6),
            ("propulsion.induced_power", propulsion.induced_power, 1e-3, 1e6),
            ("propulsion.tip_speed", propulsion.tip_speed, 1e-3, 1e6),
            ("propulsion.hover_induced_velocity", propulsion.hover_induced_velocity, 1e-3, 1e6),
            ("propulsion.fuselage_drag_ratio", propulsion.fuselage_drag_ratio, 0.0, 1e3),
            ("propulsion.air_density", propulsion.air_density, 0.0, 1e3),
            ("propulsion.rotor_solidity", propulsion.rotor_solidity, 0.0, 1e3),
            ("propulsion.rotor_area", propulsion.rotor_area, 0.0, 1e3),
            ("scale.metres_per_unit", scale.metres_per_unit, 1e-3, 1e6),
            // Time is told in ms.
            ("scale.interval_s", scale.interval_s, 1e-3, 1e3),
            ("scale.altitude_m", scale.altitude_m, 0.0, 1e5),
            ("failsafe.setpoint_timeout_s", self.failsafe.setpoint_timeout_s, 1e-3, 1e6),
            ("failsafe.station_timeout_s", self.failsafe.station_timeout_s, 1e-3, 1e6),
            ("autopilot.speed_mps", self.autopilot.speed_mps, 1e-6, 1e6),
            ("autopilot.acceptance_m", self.autopilot.acceptance_m, 1e-6, 1e6),
            ("autopilot.climb_mps", self.autopilot.climb_mps, 1e-6, 1e6),
        ]
    }

    /// Whether the UAV can be at `place` without touching one of these obstacles.
    fn is_free(
        &self,
        key: &'static str,
        place: Vector2<f64>,
        counts: impl Fn(&Obstacle) -> bool,
    ) -> Result<(), ScenarioError> {
        for (n, obstacle) in self.obstacles.iter().enumerate().filter(|(_, o)| counts(o)) {
            let distance = (place - obstacle.position).norm();
            let least = obstacle.radius + self.uav_radius + self.safety.d_min;
            if distance <= least {
                let (place, obstacle) = (place.into(), format!("obstacle[{n}]"));
                return Err(ScenarioError::Covered { key, place, obstacle, least, distance });
            }
        }
        Ok(())
    }
}

impl Obstacle {
    /// Checks obstacle number `index` of a scenario.
    fn check(&self, index: usize) -> Result<(), ScenarioError> {
        let check = |key: &str, value: f64, good: bool, must: &dyn Fn() -> String| {
            check(&format!("obstacle[{index}].{key}"), value, good, must)
        };
        let (radius, margin) = (self.radius, self.margin);
        check("radius", radius, (1e-3..=1.0).contains(&radius), &|| within(1e-3, 1.0))?;
        check("margin", margin, (0.0..0.5).contains(&margin), &|| "must lie in [0, 0.5)".into())?;
        let (speed, most) = (self.velocity.norm(), (1.0 - 2.0 * margin).min(0.5));
        check("velocity", speed, speed <= most, &|| {
            "must be at most 0.5 units per interval, and at most 1 - 2 margin".into()
        })?;
        for (axis, key) in ["position[0]", "position[1]"].into_iter().enumerate() {
            let (r, v) = (self.position[axis], self.velocity[axis]);
            check(key, r, (0.0..=1.0).contains(&r), &|| within(0.0, 1.0))?;
            let inside = margin..=1.0 - margin;
            check(key, r, v == 0.0 || inside.contains(&r), &|| {
                "must be its margin or more from the walls if it moves".into()
            })?;
        }
        Ok(())
    }
}

fn check(key: &str, value: f64, good: bool, must: impl Fn() -> String) -> Result<(), ScenarioError> {
    if good {
        Ok(())
    } else {
        Err(ScenarioError::Range { key: key.into(), value: show(value), must: must() })
    }
}

fn within(least: f64, most: f64) -> String {
    format!("must lie in [{}, {}]", show(least), show(most))
}

/// A number as a person writes it.
fn show(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || (1e-3..1e6).contains(&size) { value.to_string() } else { format!("{value:e}") }
}

/// Spellings of former versions and what to write now. A list under an old name is the new spelling.
const RENAMED: [(&str, &str); 3] = [
    ("obstacle", "one table [[obstacle]] for each obstacle; as an axis, obstacle[0]"),
    ("second_obstacle", "a further table [[obstacle]]; as an axis, obstacle[1]"),
    ("disturbance.noise_gain", "disturbance.gust_scale"),
];

/// The new spelling of a former key.
#[must_use]
pub fn new_spelling(key: &str) -> Option<&'static str> {
    RENAMED.iter().find(|(old, _)| *old == key).map(|(_, new)| *new)
}

/// The key on the line at which a parser's `span` of a text begins, if a value stands there.
pub(super) fn key_at(text: &str, span: Option<std::ops::Range<usize>>) -> Option<&str> {
    let start = span?.start;
    let line = text.get(..start)?.rsplit('\n').next()?.len();
    let (key, _) = text.get(start - line..)?.lines().next()?.split_once('=')?;
    // Before the sign stands the key itself, of which the parser speaks.
    (line > key.len()).then(|| key.trim())
}

/// Whether the text is a file of `gcs sweep`.
pub(super) fn is_sweep(text: &str) -> bool {
    toml::from_str::<toml::Table>(text)
        .is_ok_and(|table| table.contains_key("axis") && table.contains_key("points"))
}

/// The former spelling that a scenario's text uses.
pub(super) fn renamed(text: &str) -> Option<ScenarioError> {
    let table: toml::Table = toml::from_str(text).ok()?;
    let is_old = |old: &str| {
        let mut keys = old.split('.');
        let first = table.get(keys.next()?);
        keys.fold(first, |value, key| value?.get(key)).filter(|value| !value.is_array())
    };
    let (old, new) = RENAMED.into_iter().find(|(old, _)| is_old(old).is_some())?;
    Some(ScenarioError::Renamed { old, new })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sim;
    use crate::radio::message::Command;
    use crate::sim::metric::FlightScore;
    use crate::sim::record::Record;
    use crate::units::TxPower;
    use proptest::prelude::*;

    fn refused(toml: &str) -> String {
        Scenario::from_toml(toml).unwrap_err().to_string()
    }

    #[test]
    fn a_start_or_goal_inside_an_obstacle_is_refused() {
        let said = refused("start = [0.5, 0.45]");
        let whose = "from the centre of obstacle[0] (both radii and d_min), and is";
        assert_eq!(said, format!("start = [0.5, 0.45]: must be more than 0.1200 {whose} 0.0000"));
        assert!(refused("goal = [0.5, 0.56]").starts_with("goal = [0.5, 0.56]: must be"));
        Scenario::from_toml("goal = [0.5, 0.58]").unwrap();
        // Of d_min, too, and of the second obstacle.
        assert!(refused("goal = [0.5, 0.58]\n[safety]\nd_min = 0.02").contains("obstacle[0]"));
        let two = "start = [0.3, 0.85]\n[[obstacle]]\n[[obstacle]]\nposition = [0.3, 0.8]";
        assert!(refused(two).contains("obstacle[1]"), "{}", refused(two));
        // A moving one may be at the goal first, and not at the start.
        let moving = |key: &str| format!("{key} = [0.5, 0.5]\n[[obstacle]]\nvelocity = [0.01, 0.0]");
        Scenario::from_toml(&moving("goal")).unwrap();
        assert!(refused(&moving("start")).starts_with("start"));
    }

    #[test]
    fn a_start_or_goal_outside_the_square_is_refused() {
        assert_eq!(refused("start = [1.2, 0.5]"), "start[0] = 1.2: must lie in [0, 1]");
        assert_eq!(refused("goal = [0.5, -0.1]"), "goal[1] = -0.1: must lie in [0, 1]");
    }

    #[test]
    fn a_finite_value_that_no_flight_has_is_refused() {
        for (toml, said) in [
            ("[disturbance]\nsigma_c = 1e300", "disturbance.sigma_c = 1e300: must lie in [0, 10]"),
            ("[channel]\nnoise_power = 1e-320", "channel.noise_power = 1e-320: must lie in [1e-12, 1e12]"),
            ("[scale]\nmetres_per_unit = 1e300", "scale.metres_per_unit = 1e300: must lie in [0.001, 1e6]"),
            (
                "[radio]\npacket_bits = 1e6\nb_dt = 1.0",
                "radio.packet_bits = 1e6: must be at most 1000 times radio.b_dt",
            ),
        ] {
            assert_eq!(refused(toml), said);
        }
    }

    /// Puts a number where a dotted key such as `start[0]` says.
    fn put(table: &mut toml::Value, key: &str, number: f64) {
        let mut place = table;
        for part in key.split('.') {
            let (name, index) = part.split_once('[').map_or((part, None), |(name, n)| (name, Some(n)));
            place = place.get_mut(name).unwrap();
            if let Some(index) = index {
                place = place.get_mut(index.trim_end_matches(']').parse::<usize>().unwrap()).unwrap();
            }
        }
        *place = number.into();
    }

    /// Any value of a range, small ones as likely as large ones; its ends more often than that.
    fn of_range((key, _, least, most): Row) -> impl Strategy<Value = (&'static str, f64)> {
        let low = f64::max(least, most * 1e-18).log10();
        let inside = (low..=most.log10()).prop_map(move |x| 10f64.powf(x).clamp(least, most));
        prop_oneof![2 => Just(least), 2 => Just(most), 4 => inside, 1 => any::<f64>()]
            .prop_map(move |value| (key, value))
    }

    /// A scenario with extreme values in some keys, whether it passes its check or not.
    fn extreme() -> impl Strategy<Value = Result<Scenario, String>> {
        let default = Scenario::default();
        let rows = default.lengths().into_iter().chain(default.others());
        let rows: Vec<Row> = rows
            .filter(|(key, ..)| !["horizon", "observer.window", "cost.settle_intervals"].contains(key))
            .chain([("obstacle[0].radius", 0.1, 1e-3, 1.0), ("obstacle[0].margin", 0.12, 0.0, 0.5)])
            .chain([("obstacle[0].velocity[0]", 0.0, 0.0, 0.5), ("obstacle[0].position[1]", 0.5, 0.0, 1.0)])
            .collect();
        let count = rows.len();
        let values = rows.into_iter().map(of_range).collect::<Vec<_>>();
        (values, prop::collection::vec(0..count, 0..12), any::<bool>()).prop_map(
            move |(values, chosen, walls)| {
                let mut table = toml::Value::try_from(Scenario::default()).unwrap();
                for (key, value) in chosen.into_iter().map(|n| values[n]) {
                    put(&mut table, key, value);
                }
                table["dynamics"]["walls"] = walls.into();
                Scenario::from_toml(&toml::to_string(&table).unwrap()).map_err(|error| error.to_string())
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(1000) })]

        #[test]
        fn any_scenario_that_passes_flies_with_finite_numbers_and_any_other_is_told(
            scenario in extreme(), seed: u64,
        ) {
            let scenario = match scenario {
                Ok(scenario) => scenario,
                Err(error) => {
                    prop_assert!(error.contains("must be") || error.contains("must lie in"), "{error}");
                    return Ok(());
                }
            };
            let mut sim = Sim::new(scenario.clone(), seed);
            let mut records = Vec::new();
            for k in 0..100_usize {
                let before = sim.telemetry();
                let motion = crate::units::Motion::ALL[k / 7 % 5].vector() * scenario.dynamics.a_max;
                let power = if k % 2 == 0 { TxPower::Low } else { TxPower::High };
                let accel = scenario.scale.ned_from_paper_acceleration(motion);
                let command = Command::new(before.tick, accel, power);
                sim.handle(command);
                sim.advance();
                let record = Record::new(&before, &command, &sim.telemetry(), &scenario);
                let numbers = [record.r_next, record.v_next, record.flown, sim.world().uav.r, sim.world().uav.v];
                prop_assert!(numbers.iter().flatten().all(|x| x.is_finite()), "{record:?}");
                prop_assert!(record.snr_db.is_finite() && record.p_coll.is_finite(), "{record:?}");
                records.push(record);
            }
            let score = FlightScore::of(&records, &scenario).unwrap();
            prop_assert!(score.metrics.iter().all(|(_, value)| value.is_finite()), "{score:?}");
        }
    }

    #[test]
    fn a_former_key_names_the_new_one() {
        let said = refused("[disturbance]\nnoise_gain = 0.3");
        assert_eq!(said, "`disturbance.noise_gain` is now disturbance.gust_scale");
    }
}
