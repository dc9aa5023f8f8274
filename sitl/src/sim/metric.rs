//! The one list of metrics: how a flight is scored, and how each score is named and printed.
//!
//! Tables, CSV, Parquet, JSON, figures and reports iterate over [`Metric::ALL`]. To add a metric, add
//! a variant, its place in `ALL`, its row in `about` and its formula in [`Metric::of`]; nothing else
//! names them one by one.

use std::ops::Index;

use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

use super::record::Record;
use crate::scenario::Scenario;
use crate::world::energy;

/// A number that scores a whole flight: the paper's five of Sec. IV-A6, in the order of the panels of Figs. 6 and 7,
/// then ours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Metric {
    /// d_f = |r_H - r_g|, paper units.
    TerminalDistance,
    /// E_comm = Σ a_p, in the paper's power levels.
    TransmitEnergy,
    /// E_ctrl = Σ P(|v|) Δt over v_1..v_H, joules.
    PropulsionEnergy,
    /// max_k p_coll,k over k = 1..H, in [0, 1].
    CollisionProbability,
    /// Intervals in outage (the paper's T_out is this times Δt).
    Outages,
    /// J = Σ ℓ_k, the stage cost of Eq. (9) on true states, with the scenario's weights: what every controller is
    /// compared by. Ours to print; the paper optimises it in latents.
    StageCost,
    /// J_T: J and the terminal cost of the last intervals, which CRPL and APC optimise. Ours.
    SettledCost,
    /// First interval from which on it stays in the goal region to the end; the flight's length if it does not
    /// end there. Ours.
    TimeToGoal,
    /// How far it got past the goal, along the line from start to goal, units; 0 if never. Ours.
    Overshoot,
    /// How often an outage began: episodes, not intervals. Ours.
    OutageEpisodes,
    /// How often it touched an obstacle: entries, not intervals. Ours.
    Collisions,
    /// How often it touched the field's edge: entries, not intervals. Ours.
    EdgeContacts,
}

/// How a metric is named and printed.
struct About {
    key: &'static str,
    symbol: &'static str,
    title: &'static str,
    unit: &'static str,
    head: &'static str,
    flight_decimals: usize,
    decimals: usize,
    count: Count,
    floor: f64,
    is_of_paper: bool,
}

/// Whether a metric is a whole number in every flight, and of what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Count {
    /// It is a real number.
    No,
    /// Of control intervals: at most as many as were flown.
    Intervals,
    /// Of events.
    Events,
}

const ABOUT: About = About {
    key: "",
    symbol: "",
    title: "",
    unit: "",
    head: "",
    flight_decimals: 4,
    decimals: 4,
    count: Count::No,
    floor: f64::MIN_POSITIVE,
    is_of_paper: true,
};

/// A count of events that the paper does not have.
const EVENTS: About =
    About { flight_decimals: 0, decimals: 2, count: Count::Events, floor: 1.0, is_of_paper: false, ..ABOUT };

impl Metric {
    /// All of them, in the order of every table and figure.
    pub const ALL: [Self; 12] = [
        Self::TerminalDistance,
        Self::TransmitEnergy,
        Self::PropulsionEnergy,
        Self::CollisionProbability,
        Self::Outages,
        Self::StageCost,
        Self::SettledCost,
        Self::TimeToGoal,
        Self::Overshoot,
        Self::OutageEpisodes,
        Self::Collisions,
        Self::EdgeContacts,
    ];

    /// Those of which the ratio to CRPL is told: the paper's and J.
    pub fn compared() -> impl Iterator<Item = Self> {
        Self::of_paper().chain([Self::StageCost])
    }

    /// Those of the paper: the panels of Figs. 6 and 7 and the ratios to CRPL.
    pub fn of_paper() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(|metric| metric.about().is_of_paper)
    }

    /// Scores a flight. Of no record it is what an empty sum or maximum is, and NaN for d_f.
    #[must_use]
    pub fn of(self, records: &[Record], scenario: &Scenario) -> f64 {
        match self {
            Self::TerminalDistance => {
                records.last().map_or(f64::NAN, |last| (last.r_next - scenario.goal).norm())
            }
            Self::TransmitEnergy => records.iter().map(|r| r.power.level()).sum(),
            Self::PropulsionEnergy => {
                let scale = &scenario.scale;
                let speeds = records.iter().map(|r| r.v_next.norm() * scale.mps_per_speed());
                speeds.map(|v| energy::propulsion_power(v, &scenario.propulsion)).sum::<f64>()
                    * scale.interval_s
            }
            Self::CollisionProbability => records.iter().map(|r| r.p_coll).fold(0.0, f64::max),
            Self::Outages => records.iter().filter(|r| r.outage).count() as f64,
            Self::StageCost => records.iter().map(|r| scenario.stage_cost(r.r_next, r.flown, r.power)).sum(),
            Self::SettledCost => {
                let last = scenario.horizon.saturating_sub(scenario.cost.settle_intervals);
                let settling = records.iter().filter(|r| r.tick.0 >= last);
                let missed: f64 = settling.map(|r| (r.r_next - scenario.goal).norm_squared()).sum();
                Self::StageCost.of(records, scenario) + scenario.cost.settle * missed
            }
            Self::TimeToGoal => {
                let inside = |r: &&Record| (r.r_next - scenario.goal).norm() <= scenario.goal_radius;
                let stayed = records.iter().rev().take_while(inside).count();
                (if stayed == 0 { records.len() } else { records.len() - stayed + 1 }) as f64
            }
            Self::Overshoot => {
                let way = scenario.goal - scenario.start;
                let along =
                    |r: &Record| (r.r_next - scenario.goal).dot(&way) / way.norm().max(f64::MIN_POSITIVE);
                records.iter().map(along).fold(0.0, f64::max)
            }
            Self::OutageEpisodes => entries(records, |r| r.outage),
            Self::Collisions => entries(records, |r| r.collided),
            Self::EdgeContacts => entries(records, |r| r.edge),
        }
    }

    fn about(self) -> About {
        match self {
            Self::TerminalDistance => About {
                key: "d_f",
                symbol: "d_f",
                title: "terminal distance to the goal",
                head: "d_f",
                ..ABOUT
            },
            Self::TransmitEnergy => About {
                key: "e_comm",
                symbol: "E_comm",
                title: "transmit energy",
                head: "E_comm",
                flight_decimals: 0,
                decimals: 1,
                ..ABOUT
            },
            Self::PropulsionEnergy => About {
                key: "e_ctrl",
                symbol: "E_ctrl",
                title: "propulsion energy",
                unit: "J",
                head: "E_ctrl J",
                flight_decimals: 0,
                decimals: 0,
                ..ABOUT
            },
            Self::CollisionProbability => About {
                key: "p_coll_max",
                symbol: "p_coll",
                title: "largest collision probability",
                head: "p_coll max",
                ..ABOUT
            },
            Self::Outages => About {
                key: "t_out",
                symbol: "T_out",
                title: "intervals in outage",
                head: "T_out",
                flight_decimals: 0,
                decimals: 2,
                count: Count::Intervals,
                floor: 1.0,
                ..ABOUT
            },
            Self::StageCost => About {
                key: "j",
                symbol: "J",
                title: "sum of the stage cost",
                head: "J",
                is_of_paper: false,
                ..ABOUT
            },
            Self::SettledCost => About {
                key: "j_t",
                symbol: "J_T",
                title: "J and the terminal cost",
                head: "J_T",
                is_of_paper: false,
                ..ABOUT
            },
            Self::TimeToGoal => About {
                key: "t_goal",
                symbol: "t_goal",
                title: "in the goal from interval on",
                head: "t_goal",
                flight_decimals: 0,
                decimals: 1,
                count: Count::Intervals,
                floor: 1.0,
                is_of_paper: false,
                ..ABOUT
            },
            Self::Overshoot => About {
                key: "overshoot",
                symbol: "past",
                title: "largest distance past the goal",
                head: "past goal",
                is_of_paper: false,
                ..ABOUT
            },
            Self::OutageEpisodes => About {
                key: "outage_episodes",
                symbol: "outages",
                title: "times the link was lost",
                head: "outages",
                ..EVENTS
            },
            Self::Collisions => About {
                key: "collisions",
                symbol: "coll",
                title: "collisions with an obstacle",
                head: "collisions",
                ..EVENTS
            },
            Self::EdgeContacts => About {
                key: "edge_contacts",
                symbol: "edge",
                title: "contacts with the field's edge",
                head: "edge contacts",
                ..EVENTS
            },
        }
    }

    /// Its key in CSV, Parquet, JSON and tables of sweeps.
    #[must_use]
    pub fn key(self) -> &'static str {
        self.about().key
    }

    /// The paper's symbol for it, or a short name of ours.
    #[must_use]
    pub fn symbol(self) -> &'static str {
        self.about().symbol
    }

    /// Its name with its unit, without its symbol.
    #[must_use]
    pub fn title(self) -> String {
        let About { title, unit, .. } = self.about();
        if unit.is_empty() { title.into() } else { format!("{title}, {unit}") }
    }

    /// Its unit; empty for paper units, power levels, probabilities and counts.
    #[must_use]
    pub fn unit(self) -> &'static str {
        self.about().unit
    }

    /// Head of its column where symbols are: symbol and unit.
    #[must_use]
    pub fn head(self) -> &'static str {
        self.about().head
    }

    /// Decimals worth printing of a mean over flights.
    #[must_use]
    pub fn decimals(self) -> usize {
        self.about().decimals
    }

    /// Whether it is a whole number in every flight, and of what.
    #[must_use]
    pub fn count(self) -> Count {
        self.about().count
    }

    /// Whether it is a whole number in every flight.
    #[must_use]
    pub fn is_count(self) -> bool {
        self.count() != Count::No
    }

    /// Least denominator of a ratio: CRPL may have no outage at all, so one interval there; one event, too.
    #[must_use]
    pub fn floor(self) -> f64 {
        self.about().floor
    }

    /// Its value in one flight, for people.
    #[must_use]
    pub fn show(self, value: f64) -> String {
        format!("{value:.*}", self.about().flight_decimals)
    }
}

/// One value per metric.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PerMetric<T>([T; Metric::ALL.len()]);

impl<T> PerMetric<T> {
    /// `of` each metric.
    pub fn from_fn(of: impl FnMut(Metric) -> T) -> Self {
        Self(Metric::ALL.map(of))
    }

    /// `of` each metric; `None` if it is of one.
    pub fn try_from_fn(of: impl FnMut(Metric) -> Option<T>) -> Option<Self> {
        let values = Metric::ALL.into_iter().map(of).collect::<Option<Vec<T>>>()?;
        values.try_into().ok().map(Self)
    }

    /// Metrics and values, in the order of [`Metric::ALL`].
    pub fn iter(&self) -> impl Iterator<Item = (Metric, &T)> {
        Metric::ALL.into_iter().zip(&self.0)
    }
}

impl<T> Index<Metric> for PerMetric<T> {
    type Output = T;

    fn index(&self, metric: Metric) -> &T {
        // The variants are in the order of `ALL`; a test holds them to it.
        &self.0[metric as usize]
    }
}

/// A map from keys to values.
impl<T: Serialize> Serialize for PerMetric<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.iter().map(|(metric, value)| (metric.key(), value)))
    }
}

/// A question about a whole flight that is answered by yes or no.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FlightOutcome {
    /// Whether it ended in the goal region.
    Reached,
    /// Whether it passed below the obstacle: at smaller y where it first reached the x of the
    /// obstacle's first position.
    Below,
    /// Whether it touched the field's edge at any time.
    AtWall,
}

impl FlightOutcome {
    /// All of them, in the order of every table.
    pub const ALL: [Self; 3] = [Self::Reached, Self::Below, Self::AtWall];

    /// Its key in CSV, Parquet and JSON.
    #[must_use]
    pub fn key(self) -> &'static str {
        match self {
            Self::Reached => "reached",
            Self::Below => "below",
            Self::AtWall => "at_wall",
        }
    }

    /// The answer; no for a flight without a record.
    #[must_use]
    pub fn of(self, records: &[Record], scenario: &Scenario) -> bool {
        let end = records.last().map(|last| last.r_next);
        match self {
            Self::Reached => end.is_some_and(|r| (r - scenario.goal).norm() <= scenario.goal_radius),
            Self::Below => {
                let obstacle = scenario.obstacle().position;
                abreast(records, scenario).is_some_and(|y| y < obstacle.y)
            }
            Self::AtWall => records.iter().any(|r| r.edge),
        }
    }
}

/// How often a state is entered: intervals in it, less those that follow another in it.
fn entries(records: &[Record], is_in: impl Fn(&Record) -> bool) -> f64 {
    let mut before = false;
    records.iter().map(is_in).filter(|now| !std::mem::replace(&mut before, *now) && *now).count() as f64
}

/// The y at which a flight first reached the x of the obstacle's first position.
#[must_use]
pub fn abreast(records: &[Record], scenario: &Scenario) -> Option<f64> {
    let x = scenario.obstacle().position.x;
    records.iter().map(|r| r.r_next).find(|r| r.x >= x).map(|r| r.y)
}

/// All that one flight is scored by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightScore {
    /// Control intervals flown.
    pub ticks: u64,
    /// The metrics.
    pub metrics: PerMetric<f64>,
    /// The outcomes, in the order of [`FlightOutcome::ALL`].
    pub outcomes: [bool; FlightOutcome::ALL.len()],
}

impl FlightScore {
    /// Scores a flight; `None` if it has no record.
    #[must_use]
    pub fn of(records: &[Record], scenario: &Scenario) -> Option<Self> {
        (!records.is_empty()).then(|| Self {
            ticks: records.len() as u64,
            metrics: PerMetric::from_fn(|metric| metric.of(records, scenario)),
            outcomes: FlightOutcome::ALL.map(|outcome| outcome.of(records, scenario)),
        })
    }

    /// One of the outcomes.
    #[must_use]
    pub fn is(&self, outcome: FlightOutcome) -> bool {
        self.outcomes[outcome as usize]
    }
}

impl Index<Metric> for FlightScore {
    type Output = f64;

    fn index(&self, metric: Metric) -> &f64 {
        &self.metrics[metric]
    }
}

/// Ticks, whether it reached the goal, and each metric by its key; counts are integers.
impl Serialize for FlightScore {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("ticks", &self.ticks)?;
        map.serialize_entry(FlightOutcome::Reached.key(), &self.is(FlightOutcome::Reached))?;
        for (metric, value) in self.metrics.iter() {
            if metric.is_count() {
                map.serialize_entry(metric.key(), &(*value as u64))?;
            } else {
                map.serialize_entry(metric.key(), value)?;
            }
        }
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_and_outcomes_are_in_the_order_of_their_lists() {
        for (n, metric) in Metric::ALL.into_iter().enumerate() {
            assert_eq!(metric as usize, n, "{}", metric.key());
            assert_eq!(Metric::ALL.iter().filter(|m| m.key() == metric.key()).count(), 1);
        }
        for (n, outcome) in FlightOutcome::ALL.into_iter().enumerate() {
            assert_eq!(outcome as usize, n, "{}", outcome.key());
        }
    }

    #[test]
    fn a_contact_of_many_intervals_is_one_and_a_second_touch_is_two() {
        let mut sim = crate::Sim::new(Scenario::default(), 0);
        let before = sim.telemetry();
        sim.advance();
        let command = crate::radio::message::Command::new(before.tick, [0.0; 2], crate::units::TxPower::Low);
        let record = Record::new(&before, &command, &sim.telemetry(), sim.scenario());
        let score = |collided: [bool; 6]| {
            let records = collided.map(|collided| Record { collided, edge: !collided, ..record.clone() });
            let score = FlightScore::of(&records, &Scenario::default()).unwrap();
            [score[Metric::Collisions], score[Metric::EdgeContacts]]
        };
        assert_eq!(score([false; 6]), [0.0, 1.0]);
        assert_eq!(score([true; 6]), [1.0, 0.0]);
        assert_eq!(score([true, true, false, true, false, false]), [2.0, 2.0]);
    }

    #[test]
    fn cost_arrival_and_overshoot_are_told_from_the_places() {
        let mut sim = crate::Sim::new(Scenario::default(), 0);
        let before = sim.telemetry();
        sim.advance();
        let command = crate::radio::message::Command::new(before.tick, [0.0; 2], crate::units::TxPower::Low);
        let record = Record::new(&before, &command, &sim.telemetry(), sim.scenario());
        let mut scenario = Scenario::default();
        (scenario.horizon, scenario.cost.settle_intervals) = (5, 2);
        // In, out on the far side, in, in, in; the link is lost twice.
        let xs = [0.88, 0.96, 0.94, 0.92, 0.9];
        let records: Vec<Record> = (xs.iter().zip(0..))
            .map(|(x, n)| Record {
                tick: crate::units::Tick(n),
                r_next: [*x, 0.5].into(),
                flown: [f64::from(u8::from(n == 0)), 0.0].into(),
                outage: n == 0 || n == 2 || n == 3,
                ..record.clone()
            })
            .collect();
        let score = FlightScore::of(&records, &scenario).unwrap();
        let close =
            |metric: Metric, want: f64| assert!((score[metric] - want).abs() < 1e-12, "{}", metric.key());
        let missed = |xs: &[f64]| xs.iter().map(|x| (x - 0.9f64).powi(2)).sum::<f64>();
        let j = 0.05 * missed(&xs) + 1e-4 + 5.0 * 1e-5;
        close(Metric::StageCost, j);
        close(Metric::SettledCost, j + 5.0 * missed(&xs[3..]));
        close(Metric::TimeToGoal, 3.0);
        close(Metric::Overshoot, 0.06);
        close(Metric::OutageEpisodes, 2.0);
        let away: Vec<Record> =
            records[..2].iter().map(|r| Record { r_next: [0.2, 0.5].into(), ..r.clone() }).collect();
        let score = FlightScore::of(&away, &scenario).unwrap();
        assert_eq!([score[Metric::TimeToGoal], score[Metric::Overshoot]], [2.0, 0.0]);
    }

    #[test]
    fn the_papers_metrics_are_its_five_in_its_order() {
        let keys: Vec<_> = Metric::of_paper().map(Metric::key).collect();
        assert_eq!(keys, ["d_f", "e_comm", "e_ctrl", "p_coll_max", "t_out"]);
    }

    #[test]
    fn a_flight_without_a_record_has_no_score() {
        assert_eq!(FlightScore::of(&[], &Scenario::default()), None);
    }
}
