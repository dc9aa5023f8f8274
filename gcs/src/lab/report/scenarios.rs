//! The paper's Figs. 4 and 5: all controllers in Scenarios 1 and 2, without gusts and packet loss; what the
//! flights show is told in sentences computed from their records.

use std::path::Path;

use anyhow::{Context, Result};
use crpl_model::evaluation::chart::{self, Chart, Grid, Legend, Series};
use crpl_sitl::Scenario;
use crpl_sitl::program::terminal::StopSignal;
use crpl_sitl::sim::metric::{self, FlightOutcome, FlightScore, Metric};
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::{Snr, TxPower};
use rayon::prelude::*;

use super::page::Page;
use super::{Claim, rgb};
use crate::lab::Contender;
use crate::lab::figures::FlightPath;
use crate::station::models::Models;
use crate::station::pilot::Controller;

/// The presets of Figs. 4 and 5.
const SCENARIOS: [&str; 2] = ["1-ideal", "2-ideal"];

/// Flights in gusts that tell on which side a controller passes.
pub const GUSTY: u64 = 200;

/// Their σ_c and first seed.
const GUSTS: (f64, u64) = (0.005, 100_000);

/// The controllers of the paper (Sec. IV-A7).
const PAPER: [Controller; 4] = [Controller::Crpl, Controller::Apc, Controller::Rcc, Controller::Ucc];

/// One controller's flight, and what its records say.
#[derive(Debug, Clone)]
pub struct ScenarioFlight {
    /// Who flew.
    pub controller: Controller,
    /// One line an interval.
    pub records: Vec<Record>,
    /// Its score.
    pub score: FlightScore,
    /// y where it first reached the obstacle's x.
    pub y_abreast: Option<f64>,
    /// Intervals at high power.
    pub high: Vec<u64>,
    /// Intervals in which low power gives less than γ_min.
    pub dark: Vec<u64>,
    /// Intervals in which the SNR was below γ_min.
    pub violations: Vec<u64>,
    /// Smallest SNR.
    pub least_snr: f64,
    /// Share of flights in gusts that pass below; Scenario 2 only.
    pub gusty_below: Option<f64>,
}

/// One scenario, flown by all.
#[derive(Debug, Clone)]
pub struct Flown {
    /// 1 or 2.
    pub number: u8,
    /// Where.
    pub scenario: Scenario,
    /// One flight a controller.
    pub flights: Vec<ScenarioFlight>,
}

impl ScenarioFlight {
    fn new(contender: &Contender, scenario: &Scenario) -> Result<Self> {
        let records = contender.records(0);
        let score = FlightScore::of(&records, scenario).context("no interval was flown")?;
        let snr = |r: &Record| Snr::from_db(f64::from(r.snr_db)).0;
        let least = scenario.channel.snr_min;
        let ticks = |of: &dyn Fn(&Record) -> bool| -> Vec<u64> {
            records.iter().filter(|r| of(r)).map(|r| r.tick.0).collect()
        };
        Ok(Self {
            controller: contender.controller,
            score,
            y_abreast: metric::abreast(&records, scenario),
            high: ticks(&|r| r.power == TxPower::High),
            dark: ticks(&|r| snr(r) / r.power.level() * TxPower::Low.level() < least),
            violations: ticks(&|r| snr(r) < least),
            least_snr: records.iter().map(snr).fold(f64::INFINITY, f64::min),
            gusty_below: None,
            records,
        })
    }

    fn passes_below(&self) -> bool {
        self.score.is(FlightOutcome::Below)
    }

    /// Whether the power was raised before low power fails, and nothing failed.
    fn raises_in_time(&self) -> bool {
        self.violations.is_empty() && self.dark.first().is_none_or(|dark| self.high.first() <= Some(dark))
    }

    /// Whether the power was raised once the SNR had been below γ_min, which then passed.
    fn raises_late(&self) -> bool {
        let (Some(dark), Some(high)) = (self.dark.first(), self.high.first()) else { return false };
        high > dark && !self.violations.is_empty() && self.violations.last() < self.high.last()
    }
}

/// The worlds that [`fly`] flies in: both scenarios, and Scenario 2 in gusts.
///
/// # Errors
/// A preset that is missing.
pub fn worlds() -> Result<Vec<Scenario>> {
    let mut worlds = SCENARIOS.into_iter().map(Scenario::named).collect::<Result<Vec<_>, _>>()?;
    let gusty = worlds.last().cloned().map(in_gusts);
    worlds.extend(gusty);
    Ok(worlds)
}

/// The scenario in the gusts that tell on which side a controller passes.
fn in_gusts(mut scenario: Scenario) -> Scenario {
    scenario.disturbance.sigma_c = GUSTS.0;
    scenario
}

/// Flies both scenarios by these controllers; in Scenario 2 each flies in gusts, too, so many times.
///
/// # Errors
/// No policy fits a controller and scenario, a flight fails, or a signal stops the flights.
pub fn fly(
    models: &Models,
    controllers: &[Controller],
    gusty: u64,
    stop: Option<&StopSignal>,
) -> Result<Vec<Flown>> {
    let fly_one = |(number, preset): (u8, &str)| -> Result<Flown> {
        let scenario = Scenario::named(preset)?;
        let mut flights: Vec<ScenarioFlight> = controllers
            .par_iter()
            .map(|c| ScenarioFlight::new(&Contender::new(models, *c, &scenario)?, &scenario))
            .collect::<Result<_>>()?;
        if number == 2 {
            for flight in &mut flights {
                flight.gusty_below = Some(gusty_below(models, flight.controller, &scenario, gusty, stop)?);
            }
        }
        Ok(Flown { number, scenario, flights })
    };
    (1..).zip(SCENARIOS).map(fly_one).collect()
}

fn gusty_below(
    models: &Models,
    controller: Controller,
    scenario: &Scenario,
    flights: u64,
    stop: Option<&StopSignal>,
) -> Result<f64> {
    let (_, first) = GUSTS;
    let scenario = in_gusts(scenario.clone());
    let contender = Contender::new(models, controller, &scenario)?;
    let below: Vec<bool> = (first..first + flights)
        .into_par_iter()
        .filter(|_| stop.is_none_or(|stop| stop.get().is_none()))
        .map(|seed| Ok(contender.fly(seed)?.is(FlightOutcome::Below)))
        .collect::<Result<_>>()?;
    if let Some(signal) = stop.and_then(StopSignal::get) {
        return Err(signal.exit("the scenarios were not flown to their end; nothing is written").into());
    }
    Ok(below.iter().filter(|b| **b).count() as f64 / flights.max(1) as f64)
}

impl Flown {
    fn of(&self, controller: Controller) -> Option<&ScenarioFlight> {
        self.flights.iter().find(|f| f.controller == controller)
    }

    /// What the paper says of this scenario, and whether these flights say the same.
    #[must_use]
    pub fn claims(&self) -> Vec<Claim> {
        let mut claims = Vec::new();
        for flight in PAPER.iter().filter_map(|c| self.of(*c)) {
            let predictive = matches!(flight.controller, Controller::Crpl | Controller::Apc);
            claims.push(match (self.number, predictive) {
                (1, true) => timely(flight),
                (1, false) => late(flight),
                (_, true) => below_and_connected(flight),
                (_, false) => through_the_shadow(flight),
            });
        }
        if let (Some(crpl), Some(ucc)) = (self.of(Controller::Crpl), self.of(Controller::Ucc)) {
            let risk = Metric::CollisionProbability;
            let ratio = ucc.score[risk] / crpl.score[risk];
            let (holds, paper) = if self.number == 1 {
                ((0.9..=1.5).contains(&ratio), "the paper says about 1.2, and 0.9 to 1.5 counts as that")
            } else {
                (ratio >= 3.5, "the paper says about 4; at least 3.5 is asked for")
            };
            claims
                .push(Claim { holds, text: format!("ucc's peak risk is {ratio:.2} times crpl's; {paper}.") });
        }
        claims
    }

    /// A row per controller.
    fn rows(&self) -> Vec<Vec<String>> {
        let row = |f: &ScenarioFlight| {
            let mut cells = vec![
                f.controller.to_string(),
                f.y_abreast.map_or("-".into(), |y| format!("{y:.3}")),
                ranges(&f.high),
                ranges(&f.dark),
                ranges(&f.violations),
                format!("{:.2}", f.least_snr),
            ];
            cells.extend(columns().map(|metric| metric.show(f.score[metric])));
            cells.push(f.gusty_below.map_or("-".into(), |share| format!("{share:.3}")));
            cells
        };
        self.flights.iter().map(row).collect()
    }

    /// Sentences and table, for a terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = format!("Scenario {}, no gusts, no packet loss\n", self.number);
        for claim in self.claims() {
            text += &format!("  {:<13} {}\n", claim.verdict(), claim.text);
        }
        let rows = self.rows();
        let head = head();
        let width = |n: usize| rows.iter().chain([&head]).map(|r| r[n].len()).max().unwrap_or(0);
        let line = |cells: &[String]| {
            let cells = cells.iter().enumerate().map(|(n, cell)| format!("  {cell:>w$}", w = width(n)));
            cells.collect::<String>() + "\n"
        };
        text += &line(&head);
        text + &rows.iter().map(|row| line(row)).collect::<String>()
    }

    /// The rows as comma-separated values.
    #[must_use]
    pub fn csv(&self) -> String {
        let lines = std::iter::once(head()).chain(self.rows());
        lines.map(|cells| cells.join(",") + "\n").collect()
    }

    /// SNR and collision probability over time.
    fn panels(&self) -> Vec<Chart> {
        let panel = |title: &str, of: &dyn Fn(&Record) -> (f64, f64), level: (&str, f64)| Chart {
            title: format!("Scenario {}: {title}", self.number),
            x: "control interval k".into(),
            series: self
                .flights
                .iter()
                .enumerate()
                .map(|(n, f)| Series::line(f.controller.to_string(), n, f.records.iter().map(of).collect()))
                .collect(),
            levels: vec![(level.0.into(), level.1)],
            legend: Legend::UpperRight,
            panel: true,
            ..Chart::default()
        };
        let least = Snr(self.scenario.channel.snr_min).to_db();
        vec![
            panel("SNR, dB", &|r| (r.tick.0 as f64, f64::from(r.snr_db)), ("γ_min", least)),
            panel(
                "collision probability",
                &|r| ((r.tick.0 + 1) as f64, r.p_coll),
                ("δ1", self.scenario.safety.collision_tolerance),
            ),
        ]
    }

    /// Adds a section, and leaves the figures in `dir`.
    ///
    /// # Errors
    /// A figure cannot be drawn, or a file cannot be written: the error names it.
    pub fn show(&self, page: &mut Page, dir: &Path) -> Result<()> {
        let number = self.number;
        page.section(&format!("Scenario {number}: paths, SNR and risk"));
        page.text(
            "No gusts, every packet gets through. Grey is the obstacle's radio shadow, blue is low transmit \
             power, red is high. k counts control intervals.",
        );
        page.claims(&self.claims());
        let paths = self.flights.iter().map(|f| FlightPath {
            title: f.controller.to_string(),
            records: &f.records,
            scenario: &self.scenario,
            size: FlightPath::PANEL,
        });
        let paths: Vec<FlightPath<'_>> = paths.collect();
        let svgs: Vec<(String, String)> = paths
            .iter()
            .map(|path| Ok((chart::svg(path)?, format!("{}, Scenario {number}", path.title))))
            .collect::<Result<_>>()?;
        page.figures(&svgs);
        let panels = self.panels();
        let svgs: Vec<(String, String)> =
            panels.iter().map(|p| Ok((chart::svg(p)?, p.title.clone()))).collect::<Result<_>>()?;
        page.key(
            &self
                .flights
                .iter()
                .enumerate()
                .map(|(n, f)| (f.controller.to_string(), rgb(n)))
                .collect::<Vec<_>>(),
        );
        page.figures(&svgs);
        page.table(&head(), &self.rows());
        chart::save(&Grid { figures: &paths, columns: 4 }, dir, &format!("scenario{number}_paths"))?;
        chart::save(&Grid { figures: &panels, columns: 2 }, dir, &format!("scenario{number}_snr_risk"))?;
        let path = dir.join(format!("scenario{number}.csv"));
        std::fs::write(&path, self.csv()).with_context(|| format!("writing {}", path.display()))
    }
}

/// Metrics in the table: risk stands beside the SNR, and where no packet is lost outages say nothing.
fn columns() -> impl Iterator<Item = Metric> {
    let risk = Metric::CollisionProbability;
    let others = Metric::ALL.into_iter().filter(move |m| ![risk, Metric::Outages].contains(m));
    std::iter::once(risk).chain(others)
}

/// Heads of the table's columns.
fn head() -> Vec<String> {
    let first = [
        "controller",
        "y abreast",
        "high power at k",
        "low power fails at k",
        "SNR < γ_min at k",
        "least SNR",
    ];
    let heads = first.into_iter().chain(columns().map(Metric::head)).chain(["below in gusts"]);
    heads.map(String::from).collect()
}

fn timely(f: &ScenarioFlight) -> Claim {
    let text = match (f.high.first(), f.dark.first()) {
        (Some(high), Some(dark)) => format!(
            "{} raises power at k = {high}, {} low power would fall below γ_min (k = {dark}); SNR below γ_min in \
             {} intervals.",
            f.controller,
            if high < dark {
                "before"
            } else if high == dark {
                "as"
            } else {
                "after"
            },
            f.violations.len()
        ),
        (None, Some(dark)) => {
            format!("{} never raises power; low power fails from k = {dark}.", f.controller)
        }
        (_, None) => format!("{} never needs high power.", f.controller),
    };
    Claim { holds: f.raises_in_time(), text }
}

fn late(f: &ScenarioFlight) -> Claim {
    let text = match (f.high.first(), f.dark.first()) {
        (Some(high), Some(dark)) => format!(
            "{} raises power at k = {high}, {} intervals after low power fell below γ_min (k = {dark}), which \
             violates the SNR at k = {}; it lowers power {} intervals after low power would do again.",
            f.controller,
            high.saturating_sub(*dark),
            ranges(&f.violations),
            f.high.last().unwrap_or(&0).saturating_sub(*f.dark.last().unwrap_or(&0)),
        ),
        _ => format!("{} never raises power or never needs to.", f.controller),
    };
    Claim { holds: f.raises_late(), text }
}

fn below_and_connected(f: &ScenarioFlight) -> Claim {
    let gusty = f.gusty_below.unwrap_or(0.0);
    Claim {
        holds: f.passes_below() && f.violations.is_empty() && gusty >= 0.99,
        text: format!(
            "{} passes {} the obstacle (y = {:.3}), in gusts below it in {:.1} % of flights; SNR below γ_min in {} \
             intervals, high power in {}.",
            f.controller,
            if f.passes_below() { "below" } else { "above" },
            f.y_abreast.unwrap_or(f64::NAN),
            100.0 * gusty,
            f.violations.len(),
            f.high.len()
        ),
    }
}

fn through_the_shadow(f: &ScenarioFlight) -> Claim {
    Claim {
        holds: !f.passes_below() && f.raises_late(),
        text: format!(
            "{} passes {} the obstacle (y = {:.3}); SNR below γ_min at k = {}, until power is raised at k = {}.",
            f.controller,
            if f.passes_below() { "below" } else { "above" },
            f.y_abreast.unwrap_or(f64::NAN),
            ranges(&f.violations),
            f.high.first().map_or("never".into(), ToString::to_string)
        ),
    }
}

/// Ascending numbers as `3-5 8`.
fn ranges(numbers: &[u64]) -> String {
    let mut runs: Vec<(u64, u64)> = Vec::new();
    for n in numbers {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == *n => *last = *n,
            _ => runs.push((*n, *n)),
        }
    }
    let show = |(a, b): &(u64, u64)| if a == b { a.to_string() } else { format!("{a}-{b}") };
    if runs.is_empty() { "never".into() } else { runs.iter().map(show).collect::<Vec<_>>().join(" ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_numbers_are_short() {
        assert_eq!(ranges(&[3, 4, 5, 8]), "3-5 8");
        assert_eq!(ranges(&[]), "never");
    }

    #[test]
    fn reactive_controllers_are_late_and_the_oracle_is_not() {
        // Both need no policy, so this is told from the equations alone.
        let models = Models::load(None, None).unwrap();
        let flown = fly(&models, &[Controller::Apc, Controller::Rcc], 8, None).unwrap();
        for scenario in &flown {
            let [apc, rcc] = &scenario.flights[..] else { panic!("two flights") };
            assert!(apc.violations.is_empty() && apc.raises_in_time(), "{:?}", apc.high);
            assert!(rcc.raises_late() && !rcc.raises_in_time(), "{:?}", rcc.violations);
            assert!(scenario.claims().iter().all(|c| c.holds), "{}", scenario.text());
        }
        assert!(flown[1].flights[0].passes_below() && !flown[1].flights[1].passes_below());
    }
}
