//! One flight of a sweep as a row of a table: flown, written, read.

use std::str::FromStr;

use anyhow::{Context, Result, bail};
use crpl_sitl::sim::metric::{FlightOutcome, Metric, PerMetric};

use super::axis::SweepPoint;
use crate::lab::Contender;
use crate::station::pilot::Controller;
use crate::tools::parquet::{Column, Values};

/// One flight's score.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepEpisode {
    /// Value of the sweep's axis, and of its second one.
    pub point: SweepPoint,
    /// Who flew.
    pub controller: Controller,
    /// Seed of the disturbance.
    pub seed: u64,
    /// Its metrics.
    pub metrics: PerMetric<f64>,
    /// Its outcomes, in the order of [`FlightOutcome::ALL`].
    pub outcomes: [bool; FlightOutcome::ALL.len()],
}

impl SweepEpisode {
    /// Names of the columns, of a sweep over one axis or two.
    pub fn head(axes: usize) -> impl Iterator<Item = &'static str> {
        let metrics = Metric::ALL.into_iter().map(Metric::key);
        let outcomes = FlightOutcome::ALL.into_iter().map(FlightOutcome::key);
        let point = ["x", "y"].into_iter().take(axes);
        point.chain(["controller", "seed"]).chain(metrics).chain(outcomes)
    }

    /// Flies it: a pure function of contender, point and seed.
    ///
    /// # Errors
    /// If no interval was flown.
    pub fn fly(contender: &Contender, point: SweepPoint, seed: u64) -> Result<Self> {
        let score = contender.fly(seed)?;
        let controller = contender.controller;
        Ok(Self { point, controller, seed, metrics: score.metrics, outcomes: score.outcomes })
    }

    /// One line with its end.
    #[must_use]
    pub fn line(&self) -> Vec<u8> {
        let mut cells = vec![self.point.x.to_string()];
        cells.extend(self.point.y.map(|y| y.to_string()));
        cells.extend([self.controller.to_string(), self.seed.to_string()]);
        // The shortest text that reads back as the same number; whole numbers without a point.
        cells.extend(self.metrics.iter().map(|(_, value)| value.to_string()));
        cells.extend(self.outcomes.iter().map(bool::to_string));
        line(cells)
    }

    /// The table's columns.
    #[must_use]
    pub fn columns<'a>(episodes: &[Self], names: &'a [String]) -> Vec<Column<'a>> {
        let integers =
            |of: &dyn Fn(&Self) -> u64| Values::Integers(episodes.iter().map(|e| of(e) as i64).collect());
        let reals = |of: &dyn Fn(&Self) -> f64| Values::Reals(episodes.iter().map(of).collect());
        let controllers = Values::Texts(names.iter().map(String::as_str).collect());
        let metrics = Metric::ALL.map(|m| match m.is_count() {
            true => integers(&|e| e.metrics[m] as u64),
            false => reals(&|e| e.metrics[m]),
        });
        let outcomes = FlightOutcome::ALL
            .map(|outcome| Values::Booleans(episodes.iter().map(|e| e.outcomes[outcome as usize]).collect()));
        let second: Option<Vec<f64>> = episodes.iter().map(|e| e.point.y).collect();
        let second = second.filter(|all| !all.is_empty()).map(Values::Reals);
        let axes = 1 + usize::from(second.is_some());
        let point = std::iter::once(reals(&|e| e.point.x)).chain(second);
        let values = point.chain([controllers, integers(&|e| e.seed)]).chain(metrics).chain(outcomes);
        Self::head(axes).zip(values).map(|(name, values)| Column { name, values }).collect()
    }

    /// The episodes of a whole table.
    ///
    /// # Errors
    /// If the head is not [`SweepEpisode::head`], or a line is no episode: the error names the line.
    pub fn read(table: &[u8]) -> Result<Vec<Self>> {
        let mut lines = std::str::from_utf8(table)?.lines();
        let head = lines.next().unwrap_or_default();
        let Some(axes) = [1, 2].into_iter().find(|axes| head.split(',').eq(Self::head(*axes))) else {
            bail!("line 1 is not the head of a table of episodes");
        };
        lines
            .enumerate()
            .map(|(n, line)| Self::parse(line, axes).with_context(|| format!("line {}", n + 2)))
            .collect()
    }

    fn parse(line: &str, axes: usize) -> Result<Self> {
        let (cells, columns) = (line.split(',').count(), Self::head(axes).count());
        if cells != columns {
            bail!("{cells} columns instead of {columns}");
        }
        let mut cells = Self::head(axes).zip(line.split(','));
        let x = cell(cells.next())?;
        let y = if axes > 1 { Some(cell(cells.next())?) } else { None };
        let (controller, seed) = (cells.next(), cell(cells.next())?);
        let (_, controller) = controller.unwrap_or_default();
        let controller: Controller = controller.parse()?;
        let metrics = Metric::ALL.iter().map(|_| cell(cells.next())).collect::<Result<Vec<f64>>>()?;
        let mut outcomes = [false; FlightOutcome::ALL.len()];
        for outcome in &mut outcomes {
            *outcome = cell(cells.next())?;
        }
        let point = SweepPoint { x, y };
        Ok(Self { point, controller, seed, metrics: PerMetric::from_fn(|m| metrics[m as usize]), outcomes })
    }
}

fn cell<T: FromStr>(cell: Option<(&str, &str)>) -> Result<T> {
    let (name, text) = cell.unwrap_or_default();
    text.parse().ok().with_context(|| format!("{name} = {text:?}"))
}

/// One line of comma-separated values, with its end.
pub fn line<T: Into<String>>(cells: impl IntoIterator<Item = T>) -> Vec<u8> {
    let cells: Vec<String> = cells.into_iter().map(Into::into).collect();
    (cells.join(",") + "\n").into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(line: &str) -> Result<Vec<SweepEpisode>> {
        SweepEpisode::read(&[&super::line(SweepEpisode::head(1)), line.as_bytes()].concat())
    }

    #[test]
    fn a_line_that_is_none_says_why() {
        let error = |line: &str| crpl_sitl::program::terminal::one_line(&read(line).unwrap_err());
        let columns = SweepEpisode::head(1).count();
        assert_eq!(error("2.5,rcc,1"), format!("line 2: 3 columns instead of {columns}"));
        let line = |name: &str, text: &str| {
            let of = |column| match column {
                column if column == name => text,
                "controller" => "rcc",
                column if FlightOutcome::ALL.iter().any(|outcome| outcome.key() == column) => "true",
                _ => "0",
            };
            SweepEpisode::head(1).map(of).collect::<Vec<_>>().join(",")
        };
        assert!(read(&line("", "")).is_ok());
        assert_eq!(error(&line("controller", "nobody")), "line 2: no controller is called \"nobody\"");
        assert_eq!(error(&line("e_comm", "x")), "line 2: e_comm = \"x\"");
    }

    proptest! {
        #[test]
        fn a_line_reads_back_as_the_same_bits(
            x in proptest::num::f64::NORMAL, seed: u64, reached: bool,
            values in prop::collection::vec(0.0..1e5f64, Metric::ALL.len()),
        ) {
            let metrics = PerMetric::from_fn(|m| match m.is_count() {
                true => values[m as usize].round(),
                false => values[m as usize],
            });
            let outcomes = [reached, !reached, false];
            for (axes, y) in [(1, None), (2, Some(x / 3.0))] {
                let point = SweepPoint { x, y };
                let episode = SweepEpisode { point, controller: Controller::Ucc, seed, metrics, outcomes };
                let table = [line(SweepEpisode::head(axes)), episode.line()].concat();
                prop_assert_eq!(SweepEpisode::read(&table).unwrap(), [episode]);
            }
        }
    }
}
