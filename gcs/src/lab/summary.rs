//! One flight over a link in numbers, and flights side by side as the table that is printed.

use crpl_model::numeric::statistics::quantile;
use crpl_sitl::program::columns;
use crpl_sitl::radio::Fates;
use crpl_sitl::scenario::CollisionAction;
use crpl_sitl::sim::metric::{Count, FlightOutcome, FlightScore, Metric};
use serde::Serialize;
use serde_json::Value;

use crate::flight::{Flight, FlightEnd};
use crate::station::Station;
use crate::station::models::PolicyOrigin;
use crate::station::pilot::Controller;
use crate::station::pilot::own::AnswerTally;

/// How and when a flight has ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FlightEnded {
    /// How.
    pub how: FlightEnd,
    /// Tick of the last percept.
    pub tick: Option<u64>,
    /// Why, in one line; empty after the last tick.
    pub why: String,
}

impl FlightEnded {
    /// The end of a flight.
    #[must_use]
    pub fn of(flight: &Flight) -> Self {
        let tick = flight.last.as_ref().map(|last| last.telemetry.tick.0);
        Self { how: flight.ended, tick, why: flight.why.clone() }
    }
}

/// One flight in numbers.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// The controller that flew.
    pub controller: Controller,
    /// The scenario's name.
    pub scenario: String,
    /// Seed of the gusts; `None` if another process started the vehicle.
    pub seed: Option<u64>,
    /// Its score.
    #[serde(flatten)]
    pub score: FlightScore,
    /// What became of the commands.
    pub commands: Fates,
    /// Intervals of which no percept arrived.
    pub missed: u64,
    /// From a complete percept to its command on the socket.
    pub latency_ms: Latency,
    /// Simulated over real time.
    pub real_time_factor: f64,
    /// Frames of the vehicle that the link has lost, by their sequence numbers.
    pub frames_lost: u64,
    /// How the flight has ended.
    pub ended: FlightEnded,
    /// Whether the flight ended because the operator took the vehicle over.
    pub taken_over: bool,
    /// Whether the flight ended because the vehicle collided and fell.
    pub fell: bool,
    /// Setpoints of other stations that were not forwarded to the vehicle.
    pub setpoints_held_back: u64,
    /// Where the controller's policies come from; `None` for a controller without any.
    pub policy: Option<PolicyOrigin>,
    /// How a controller of somebody's own has answered; `None` for another.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub answers: Option<AnswerTally>,
}

/// Percentiles, ms.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Latency {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
}

impl Summary {
    /// The summary of a flight over a link; `None` if no interval was flown.
    #[must_use]
    pub fn of(
        controller: Controller,
        seed: Option<u64>,
        station: &Station,
        flight: &Flight,
        ended: FlightEnded,
    ) -> Option<Self> {
        let scenario = station.scenario();
        let score = station.score()?;
        let at = |p: f64| quantile(&flight.latencies_us, p) / 1e3;
        let simulated = score.ticks as f64 * scenario.scale.interval_s;
        Some(Self {
            controller,
            scenario: scenario.name.clone(),
            seed,
            score,
            commands: station.fates(),
            missed: station.missed(),
            latency_ms: Latency { p50: at(0.5), p99: at(0.99) },
            real_time_factor: simulated / flight.wall.as_secs_f64(),
            frames_lost: flight.lost,
            fell: scenario.safety.collision_action == CollisionAction::Fall
                && station.records().last().is_some_and(|last| last.collided),
            ended,
            taken_over: flight.ended == FlightEnd::TakenOver,
            setpoints_held_back: flight.suppressed_setpoints,
            policy: station.policy().cloned(),
            answers: station.answers().cloned(),
        })
    }
}

/// The metrics of the first flight, and under `flights` those of each by its number on the page.
#[must_use]
pub fn by_vehicle(flights: &[Summary]) -> Value {
    let mut first = flights.first().and_then(|flight| serde_json::to_value(flight).ok()).unwrap_or_default();
    let each = flights
        .iter()
        .zip(1..)
        .map(|(flight, id): (_, u32)| (id.to_string(), serde_json::to_value(flight).unwrap_or_default()));
    if let Value::Object(first) = &mut first {
        first.insert("flights".into(), each.collect());
    }
    first
}

/// Flights side by side, for people; no wider than `width`.
#[must_use]
pub fn table(flights: &[Summary], width: Option<usize>) -> String {
    type Cell = fn(&Summary) -> String;
    let rows: [(&str, Cell); 10] = [
        ("commands sent", |f| f.commands.sent.to_string()),
        ("  delivered in their interval", |f| f.commands.delivered.to_string()),
        ("  delayed", |f| f.commands.delayed.to_string()),
        ("  superseded", |f| f.commands.superseded.to_string()),
        ("  lost", |f| f.commands.lost.to_string()),
        ("percepts missed", |f| f.missed.to_string()),
        ("frame to command, median, ms", |f| format!("{:.3}", f.latency_ms.p50)),
        ("frame to command, p99, ms", |f| format!("{:.3}", f.latency_ms.p99)),
        ("times real time", |f| format!("{:.0}", f.real_time_factor)),
        ("seed", |f| f.seed.map_or("-".into(), |s| s.to_string())),
    ];
    let mut text = format!("{:<40}", flights.first().map_or("", |f| f.scenario.as_str()));
    for flight in flights {
        text += &format!("{:>12}", flight.controller.label());
    }
    let mut row = |name: &str, cell: &dyn Fn(&Summary) -> String| {
        text += &format!("\n{name:<40}");
        flights.iter().for_each(|flight| text += &format!("{:>12}", cell(flight)));
    };
    row("reached the goal", &|f| if f.score.is(FlightOutcome::Reached) { "yes" } else { "no" }.into());
    for metric in Metric::ALL {
        row(&format!("{:<8}{}", metric.symbol(), metric.title()), &|f| {
            let value = metric.show(f.score[metric]);
            if metric.count() == Count::Intervals { format!("{value} of {}", f.score.ticks) } else { value }
        });
    }
    rows.iter().for_each(|(name, cell)| row(name, cell));
    let room: Vec<usize> = std::iter::once(40).chain(flights.iter().map(|_| 12)).collect();
    let mut notes = String::new();
    for flight in flights.iter().filter(|flight| flight.ended.how != FlightEnd::Over) {
        let (how, ticks, why) = (flight.ended.how.key(), flight.score.ticks, &flight.ended.why);
        notes += &format!("{}: ended after {ticks} intervals, {how}: {why}\n", flight.controller);
    }
    for flight in flights {
        if let Some(mismatch) = flight.policy.as_ref().and_then(PolicyOrigin::mismatch) {
            let does = if flight.controller.flies_policies() { "flew" } else { "began its search with" };
            notes += &format!("{}: {does} a policy of another world: {mismatch}\n", flight.controller);
        }
    }
    for flight in flights {
        if let Some(told) = flight.answers.as_ref().and_then(AnswerTally::told) {
            notes += &format!("{}: {told}\n", flight.controller);
        }
    }
    for flight in flights.iter().filter(|flight| flight.fell) {
        notes += &format!("{}: collided and fell in interval {}\n", flight.controller, flight.score.ticks);
    }
    for flight in flights.iter().filter(|flight| flight.setpoints_held_back > 0) {
        let count = flight.setpoints_held_back;
        notes += &format!("{}: {count} setpoints of other stations not forwarded\n", flight.controller);
    }
    columns::folded(&text, &room, width) + &columns::wrapped(&notes, 2, width)
}
