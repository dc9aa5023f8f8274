//! The ways of several flights in one picture, over the world that they flew in.

use crpl_model::evaluation::chart::{Chart, Series, Style};
use crpl_sitl::Scenario;

use super::read::FlownFlight;
use crate::lab::scenarios::draw;

/// Strokes that stay apart without colour.
const STROKES: [Style; 3] = [Style::Line, Style::Dashed, Style::Dotted];

/// Flights of one world.
#[must_use]
pub fn overlay(scenario: &Scenario, flights: &[&FlownFlight]) -> Chart {
    let mut series = Vec::new();
    for (n, flight) in flights.iter().enumerate() {
        let start = flight.records.first().map(|r| (r.r.x, r.r.y));
        let way = start.into_iter().chain(flight.records.iter().map(|r| (r.r_next.x, r.r_next.y))).collect();
        let name = format!("[{}] {}", n + 1, flight.controller);
        series.push(Series::line(name, n, way).styled(STROKES[n % STROKES.len()]));
        let lost = flight.records.iter().filter(|r| r.outage).map(|r| (r.r.x, r.r.y)).collect();
        let name = if n == 0 { "outage" } else { "" };
        series.push(Series::line(name, n, lost).styled(Style::Cross));
    }
    let alt = format!("{}: the paths of {} flights over the radio's shadow.", scenario.name, flights.len());
    Chart { alt, ..draw::chart(scenario, scenario.name.clone(), series) }
}
