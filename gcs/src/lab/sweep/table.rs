//! From episodes to the rows of a figure: means, spread and intervals per point and controller, and
//! ratios to CRPL on the same seeds.

use std::fmt::Write;

use crpl_sitl::program::columns;
use crpl_sitl::sim::metric::{FlightOutcome, Metric, PerMetric};
use serde::Serialize;

use super::axis::SweepPoint;
use super::episode::SweepEpisode;
use super::plan::{SweepPlan, UncoveredPoint};
use crate::station::pilot::Controller;
use crate::watch::feed::{Feed, WatchEvent};
use crpl_model::numeric::statistics::{Mean, Resamples};

/// The outcomes in tables for people.
pub const SHOWN: [FlightOutcome; 2] = [FlightOutcome::Reached, FlightOutcome::Below];

/// One controller at one point.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TableRow {
    /// Name of the sweep.
    pub sweep: String,
    /// Value of the axis, and of the second one.
    #[serde(flatten)]
    pub point: SweepPoint,
    /// Who flew.
    pub controller: Controller,
    /// Flights.
    pub episodes: u64,
    /// Means.
    #[serde(flatten)]
    pub means: PerMetric<Mean>,
    /// Ratios of means to CRPL's on the same seeds; `None` if CRPL did not fly.
    pub ratio_to_crpl: Option<PerMetric<Mean>>,
    #[serde(skip)]
    shares: [f64; FlightOutcome::ALL.len()],
}

impl TableRow {
    /// Share of flights with this outcome.
    #[must_use]
    pub fn share(&self, outcome: FlightOutcome) -> f64 {
        self.shares[outcome as usize]
    }
}

impl TableRow {
    /// Tells a page its means, with their intervals.
    pub fn tell(&self, feed: &Feed) {
        for metric in Metric::ALL {
            let mean = &self.means[metric];
            feed.send(&WatchEvent::Point {
                x: self.point.x,
                controller: match self.point.y {
                    None => self.controller.to_string(),
                    Some(y) => format!("{} at {y}", self.controller),
                },
                metric: metric.key().into(),
                value: mean.mean,
                low: mean.ci[0],
                high: mean.ci[1],
            });
        }
    }
}

/// All rows of a sweep, points in their order, controllers in theirs. `episodes` must be in the order
/// of the plan.
#[must_use]
pub fn rows(plan: &SweepPlan, episodes: &[SweepEpisode]) -> Vec<TableRow> {
    let grid = plan.grid();
    let flights = episodes.len() / (grid.len() * plan.controllers.len()).max(1);
    let resamples = Resamples::of(flights);
    let mut rows = Vec::new();
    for point in grid {
        let of = |controller: Controller| -> Vec<&SweepEpisode> {
            episodes.iter().filter(|e| e.point == point && e.controller == controller).collect()
        };
        let crpl = plan.controllers.contains(&Controller::Crpl).then(|| of(Controller::Crpl));
        for controller in &plan.controllers {
            rows.push(row(plan, point, *controller, &of(*controller), crpl.as_deref(), &resamples));
        }
    }
    rows
}

fn row(
    plan: &SweepPlan,
    point: SweepPoint,
    controller: Controller,
    flights: &[&SweepEpisode],
    crpl: Option<&[&SweepEpisode]>,
    resamples: &Resamples,
) -> TableRow {
    let values =
        |of: Metric, flights: &[&SweepEpisode]| flights.iter().map(|e| e.metrics[of]).collect::<Vec<_>>();
    let ratio_to_crpl = crpl.and_then(|crpl| {
        PerMetric::try_from_fn(|m| {
            if controller == Controller::Crpl {
                // Exactly 1, also where its T_out is below the floor.
                return Some(Mean::of(&[1.0]));
            }
            resamples.ratio(&values(m, flights), &values(m, crpl), m.floor())
        })
    });
    TableRow {
        sweep: plan.name.clone(),
        point,
        controller,
        episodes: flights.len() as u64,
        means: PerMetric::from_fn(|m| Mean::of(&values(m, flights))),
        ratio_to_crpl,
        shares: FlightOutcome::ALL.map(|outcome| {
            let count = flights.iter().filter(|e| e.outcomes[outcome as usize]).count();
            count as f64 / flights.len().max(1) as f64
        }),
    }
}

/// The rows as comma-separated values, all digits. `policy_covers` is empty for a controller without
/// policies.
#[must_use]
pub fn csv(plan: &SweepPlan, rows: &[TableRow]) -> String {
    let second = if plan.second.is_some() { ",y" } else { "" };
    let mut text = format!("sweep,x{second},controller,episodes,policy_covers");
    FlightOutcome::ALL.iter().for_each(|outcome| text.extend([",", outcome.key()]));
    for m in Metric::ALL.map(Metric::key) {
        let _ = write!(text, ",{m}_mean,{m}_sd,{m}_lo,{m}_hi,{m}_ratio,{m}_ratio_lo,{m}_ratio_hi");
    }
    text.push('\n');
    for row in rows {
        let TableRow { sweep, point, controller, episodes, .. } = row;
        let covered = match controller.flies_policies() {
            true => plan.uncovered.iter().all(|far| far.point() != *point).to_string(),
            false => String::new(),
        };
        let _ = write!(text, "{sweep},{}", cells(*point, ","));
        let _ = write!(text, ",{controller},{episodes},{covered}");
        row.shares.iter().for_each(|share| text += &format!(",{share}"));
        for (m, Mean { mean, ci, sd }) in row.means.iter() {
            let _ = write!(text, ",{mean},{sd},{},{}", ci[0], ci[1]);
            match row.ratio_to_crpl.map(|ratios| ratios[m]) {
                Some(Mean { mean, ci, .. }) => {
                    let _ = write!(text, ",{mean},{},{}", ci[0], ci[1]);
                }
                None => text.push_str(",,,"),
            }
        }
        text.push('\n');
    }
    text
}

/// The values of a point, one after the other.
fn cells(point: SweepPoint, between: &str) -> String {
    let second = point.y.map(|y| format!("{between}{y}")).unwrap_or_default();
    format!("{}{second}", point.x)
}

/// The same in columns.
fn padded(point: SweepPoint) -> String {
    point.y.map_or_else(|| point.x.to_string(), |y| format!("{}{y:>10}", point.x))
}

/// The first columns of a line of the text.
fn start(point: &str, controller: &str) -> String {
    // Two axes: the second ends ten columns further.
    let width = if point.contains(' ') { 18 } else { 8 };
    format!("{point:>width$}  {controller:<18}")
}

/// Mean with its interval, or `= all` where every flight has the same value, with the decimals that are worth
/// printing.
#[must_use]
pub fn mean_cell(metric: Metric, mean: &Mean) -> String {
    let d = metric.decimals();
    if mean.is_constant() {
        return format!("{:.d$} = all", mean.mean);
    }
    format!("{:.d$} [{:.d$}, {:.d$}]", mean.mean, mean.ci[0], mean.ci[1])
}

/// Width of the column of [`mean_cell`].
fn mean_width(metric: Metric) -> usize {
    (20 + 2 * metric.decimals()).max(22)
}

/// A ratio with its interval.
#[must_use]
pub fn ratio_cell(ratio: &Mean) -> String {
    format!("{:.2} [{:.2}, {:.2}]", ratio.mean, ratio.ci[0], ratio.ci[1])
}

/// Width of the columns of the axis and the controller, and of two axes and the controller.
const KEYS: [usize; 2] = [28, 38];

/// Width of the columns of the outcomes.
const OUTCOMES: [usize; SHOWN.len()] = [10, 8];

/// Width of a column of ratios.
const RATIO: usize = 22;

/// The rows as two tables for people: means with their 95 % interval and counts of outcomes; ratios to CRPL with their 95 % interval.
/// Lines are no wider than `width`.
#[must_use]
pub fn text(plan: &SweepPlan, rows: &[TableRow], width: Option<usize>) -> String {
    let mut out = format!(
        "{}: {} over {} flights a row from seed {}; mean [95 % bootstrap interval],\n= all: the same in every flight; reached and below: of all flights\n",
        plan.name,
        plan.axes(),
        rows.first().map_or(0, |r| r.episodes),
        plan.first_seed
    );
    let head = |out: &mut String,
                metrics: &mut dyn Iterator<Item = Metric>,
                width: fn(Metric) -> usize,
                tail: &str| {
        out.push_str(&start(if plan.second.is_some() { "x         y" } else { "x" }, "controller"));
        for m in metrics {
            let _ = write!(out, "{:>width$}", m.key(), width = width(m));
        }
        let _ = writeln!(out, "{tail}");
    };
    let [reached, below] = SHOWN.map(FlightOutcome::key);
    let [wide, narrow] = OUTCOMES;
    let key = KEYS[usize::from(plan.second.is_some())];
    let mut table = String::new();
    let tail = format!("{reached:>wide$}{below:>narrow$}");
    head(&mut table, &mut Metric::ALL.into_iter(), mean_width, &tail);
    for row in rows {
        table.push_str(&start(&padded(row.point), &row.controller.label()));
        for (m, mean) in row.means.iter() {
            let _ = write!(table, "{:>width$}", mean_cell(m, mean), width = mean_width(m));
        }
        let [reached, below] = SHOWN.map(|outcome| (row.share(outcome) * row.episodes as f64).round());
        let _ = writeln!(table, "{reached:>wide$}{below:>narrow$}");
    }
    let columns: Vec<usize> =
        std::iter::once(key).chain(Metric::ALL.map(mean_width)).chain(OUTCOMES).collect();
    out += &columns::folded(&table, &columns, width);
    table.clear();
    let others = || rows.iter().filter(|r| r.controller != Controller::Crpl && r.ratio_to_crpl.is_some());
    if others().next().is_some() {
        out.push_str(
            "\nratio to crpl on the same seeds [95 % bootstrap interval]; T_out over at least one interval\n",
        );
        head(&mut table, &mut Metric::compared(), |_| RATIO, "");
    }
    for row in others() {
        table.push_str(&start(&padded(row.point), &row.controller.label()));
        for ratio in row.ratio_to_crpl.iter().flat_map(|ratios| Metric::compared().map(|m| ratios[m])) {
            let _ = write!(table, "{:>RATIO$}", ratio_cell(&ratio));
        }
        table.push('\n');
    }
    let columns: Vec<usize> = std::iter::once(key).chain(Metric::compared().map(|_| RATIO)).collect();
    out + &columns::folded(&table, &columns, width) + &uncovered(plan)
}

/// A line for each point at which the crpl controllers fly policies of another world.
#[must_use]
pub fn uncovered(plan: &SweepPlan) -> String {
    let mut out = String::new();
    for point in &plan.uncovered {
        let UncoveredPoint { policy, mismatch, .. } = point;
        let at = plan.at(point.point());
        let _ = writeln!(out, "\nat {at} crpl flies policies of another world ({policy}): {mismatch}");
    }
    out
}
