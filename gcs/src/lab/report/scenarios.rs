//! The paper's Figs. 4 and 5: all controllers in Scenarios 1 and 2, without gusts and packet loss; what the
//! flights show is told in a table computed from their records.

use std::path::Path;

use anyhow::{Context, Result};
use crpl_model::evaluation::chart::{self, Chart, Series, Sheet};
use crpl_sitl::Scenario;
use crpl_sitl::program::columns as layout;
use crpl_sitl::program::terminal::StopSignal;
use crpl_sitl::sim::metric::{self, FlightOutcome, FlightScore, Metric};
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::{Snr, TxPower};
use rayon::prelude::*;

use super::claims;
use super::page::Page;
use super::quantities::{FlightQuantity, Subject};
use super::rows::{self, VerdictRow};
use crate::lab::Contender;
use crate::lab::figures::FlightPath;
use crate::station::models::Models;
use crate::station::pilot::Controller;

/// The presets of Figs. 4 and 5.
const SCENARIOS: [&str; 2] = ["1-ideal", "2-ideal"];

/// Flights in gusts that tell on which side a controller passes.
pub const GUSTY: u64 = 200;

/// Their σ_c and first seed.
const GUSTS: (f64, u64) = (0.005, 300_000);

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
    /// How many flights in gusts pass below, and of how many; Scenario 2 only.
    pub gusty_below: Option<[u64; 2]>,
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
        let records = contender.records(0)?;
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

    /// Intervals from the first at high power to the first in which low power fails: negative if the power is
    /// raised only after. `None` if low power never fails, or fails and the power is never raised.
    fn lead(&self) -> Option<f64> {
        Some(later(*self.high.first()?, *self.dark.first()?))
    }

    /// Intervals from the last in which low power fails to the last at high power.
    fn overhang(&self) -> Option<f64> {
        Some(later(*self.dark.last()?, *self.high.last()?))
    }
}

/// How many intervals `b` is later than `a`.
fn later(a: u64, b: u64) -> f64 {
    b as f64 - a as f64
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
/// A controller without policies, a signal.
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
) -> Result<[u64; 2]> {
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
    Ok([below.iter().filter(|b| **b).count() as u64, flights])
}

impl Flown {
    fn of(&self, controller: Controller) -> Option<&ScenarioFlight> {
        self.flights.iter().find(|f| f.controller == controller)
    }

    /// What the paper says of this scenario, and what these flights say of that; `all` are both scenarios.
    #[must_use]
    pub fn verdicts(&self, all: &[Self]) -> Vec<VerdictRow> {
        let flown: Vec<Controller> = self.flights.iter().map(|flight| flight.controller).collect();
        let study = format!("scenario{}", self.number);
        claims::of_scenario(self.number)
            .flat_map(|(claim, quantity)| claim.of_teams(&flown).into_iter().map(move |c| (c, quantity)))
            .map(|(claim, quantity)| {
                VerdictRow::of_flight(&study, &claim, quantity, self.measure(quantity, claim.who, all))
            })
            .collect()
    }

    /// `None` if a controller or the other scenario was not flown, or the flights do not have the quantity.
    fn measure(&self, quantity: FlightQuantity, who: Subject, all: &[Self]) -> Option<f64> {
        let of = self.of(who.of)?;
        let over = || self.of(who.over?);
        let [first, second] = [1, 2].map(|number| all.iter().find(|flown| flown.number == number));
        Some(match quantity {
            FlightQuantity::Lead => of.lead()?,
            FlightQuantity::Overhang => of.overhang()?,
            FlightQuantity::Violations => of.violations.len() as f64,
            FlightQuantity::HighPower => of.high.len() as f64 - over()?.high.len() as f64,
            FlightQuantity::LeastSnr => of.least_snr - over()?.least_snr,
            FlightQuantity::Side => of.y_abreast? - self.scenario.obstacle().position.y,
            FlightQuantity::Ratio(metric) => self.ratio(metric, who)?,
            FlightQuantity::Apartness(metric) => {
                let crpl = self.of(Controller::Crpl)?.score[metric];
                (of.score[metric] - crpl).abs() - (over()?.score[metric] - crpl).abs()
            }
            FlightQuantity::Detour => first?.detour(who.of)? - second?.detour(who.of)?,
            FlightQuantity::Separation(metric) => {
                let apart = |flown: &Self| Some((flown.ratio(metric, who)? - 1.0).abs());
                apart(first?)? - apart(second?)?
            }
        })
    }

    fn ratio(&self, metric: Metric, who: Subject) -> Option<f64> {
        Some(self.of(who.of)?.score[metric] / self.of(who.over?)?.score[metric].max(metric.floor()))
    }

    fn detour(&self, controller: Controller) -> Option<f64> {
        Some((self.of(controller)?.y_abreast? - self.scenario.start.y).abs())
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
            cells.push(f.gusty_below.map_or("-".into(), |[below, of]| format!("{below} of {of}")));
            cells
        };
        self.flights.iter().map(row).collect()
    }

    /// Verdicts and table, for a terminal.
    #[must_use]
    pub fn text(&self, verdicts: &[VerdictRow]) -> String {
        let mut text = format!("Scenario {}, no gusts, no packet loss\n", self.number);
        text += &rows::text(verdicts, layout::width());
        text + &layout::table(&head(), &self.rows(), layout::width())
    }

    /// The rows as comma-separated values.
    #[must_use]
    pub fn csv(&self) -> String {
        let lines = std::iter::once(head()).chain(self.rows());
        lines.map(|cells| cells.join(",") + "\n").collect()
    }

    /// SNR and collision probability over time.
    fn panels(&self) -> Vec<Chart> {
        let panel = |title: &str, y: &str, of: &dyn Fn(&Record) -> (f64, f64), level: (&str, f64)| Chart {
            title: format!("Scenario {}: {title}", self.number),
            x: "time k, control intervals".into(),
            y: y.into(),
            series: self
                .flights
                .iter()
                .enumerate()
                .map(|(n, f)| Series::line(f.controller.to_string(), n, f.records.iter().map(of).collect()))
                .collect(),
            levels: vec![(level.0.into(), level.1)],
            panel: true,
            ..Chart::default()
        };
        let least = Snr(self.scenario.channel.snr_min).to_db();
        vec![
            panel(
                "signal-to-noise ratio",
                "SNR γ, dB",
                &|r| (r.tick.0 as f64, f64::from(r.snr_db)),
                ("γ_min", least),
            ),
            panel(
                "collision probability",
                "collision probability p_coll",
                &|r| ((r.tick.0 + 1) as f64, r.p_coll),
                ("δ1", self.scenario.safety.collision_tolerance),
            ),
        ]
    }

    /// Adds a section, and leaves the figures in `dir`.
    ///
    /// # Errors
    /// A figure or table cannot be written.
    pub fn show(&self, page: &mut Page, dir: &Path, verdicts: &[VerdictRow]) -> Result<()> {
        let number = self.number;
        page.section(&format!("Scenario {number}: paths, SNR and risk"));
        page.text(
            "No gusts, every packet gets through. Grey is the obstacle's radio shadow, open circles are low transmit \
             power, filled ones high. k counts control intervals.",
        );
        page.verdicts(verdicts);
        let paths = self.flights.iter().map(|f| FlightPath {
            title: format!("{}, Scenario {number}", f.controller),
            records: &f.records,
            scenario: &self.scenario,
            panel: true,
        });
        let paths: Vec<Chart> = paths.map(|path| path.chart()).collect();
        let panels = self.panels();
        for charts in [&paths, &panels] {
            page.figures(&charts.iter().map(|c| (chart::svg(c), c.title.clone())).collect::<Vec<_>>());
        }
        page.table(&head(), &self.rows());
        chart::save(Sheet { charts: &paths, columns: 2 }, dir, &format!("scenario{number}_paths"))?;
        chart::save(Sheet { charts: &panels, columns: 2 }, dir, &format!("scenario{number}_snr_risk"))?;
        super::write(dir, &format!("scenario{number}.csv"), &self.csv())
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
    use crate::lab::report::verdict::Verdict;

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
            assert!(apc.violations.is_empty() && apc.lead().is_none_or(|lead| lead >= 0.0), "{:?}", apc.high);
            assert!(rcc.lead().is_some_and(|lead| lead < 0.0), "{:?}", rcc.violations);
            assert!(rcc.overhang().is_some_and(|late| late > 0.0) && !rcc.violations.is_empty());
        }
        let verdicts = flown[1].verdicts(&flown);
        let side = |controller: &str| {
            let row = verdicts
                .iter()
                .find(|row| row.quantity == format!("y abreast: {controller} less the obstacle"));
            row.unwrap().verdict()
        };
        // At γ_min high power carries through the shadow, and the shorter way above is the better one: here the
        // oracle contradicts the paper.
        assert_eq!(
            [side("apc"), side("rcc"), side("ucc")],
            [Some(Verdict::Contradicts), Some(Verdict::Agrees), None]
        );
    }
}
