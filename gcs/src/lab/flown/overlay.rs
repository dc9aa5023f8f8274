//! The ways of several flights in one picture, over the world that they flew in.

use crpl_model::evaluation::chart::{Figure, colour};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::read::FlownFlight;
use crate::lab::scenarios::draw::WorldPicture;

/// Flights of one world.
#[derive(Debug)]
pub struct Overlay<'a> {
    /// At least one.
    pub flights: &'a [&'a FlownFlight],
}

impl Figure for Overlay<'_> {
    fn size(&self) -> (u32, u32) {
        (760, 800)
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        let failed = |e: DrawingAreaErrorKind<B::ErrorType>| e.to_string();
        let Some(first) = self.flights.first() else { return Ok(()) };
        let mut chart = WorldPicture(&first.scenario).chart(area)?;
        for (n, flight) in self.flights.iter().enumerate() {
            let start = flight.records.first().map(|r| (r.r.x, r.r.y));
            let way: Vec<(f64, f64)> =
                start.into_iter().chain(flight.records.iter().map(|r| (r.r_next.x, r.r_next.y))).collect();
            let colour = colour(n);
            chart
                .draw_series([PathElement::new(way, colour.stroke_width(2))])
                .map_err(failed)?
                .label(format!("[{}] {}", n + 1, flight.controller))
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 12, y)], colour.stroke_width(2)));
            let lost = flight.records.iter().filter(|r| r.outage);
            let marks = lost.map(|r| Cross::new((r.r.x, r.r.y), 4, colour.stroke_width(2)));
            chart.draw_series(marks).map_err(failed)?;
        }
        WorldPicture::finish(&mut chart)
    }
}
