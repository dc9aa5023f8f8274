//! Curves of a sweep: a metric over the first axis, a line per controller, and per value of the second axis.

use std::path::Path;

use anyhow::Result;
use crpl_model::evaluation::chart::{self, Chart, Series, Sheet, Style};
use crpl_sitl::sim::metric::Metric;

use super::plan::SweepPlan;
use super::table::TableRow;
use crate::station::pilot::Controller;

/// How the lines of each controller are drawn, where the colour is the second axis's.
const STYLES: [Style; 4] = [Style::Dotted, Style::Dashed, Style::Thin, Style::Line];

/// Name, symbol and unit of a sweep's axis: of the paper's axes; else the key.
#[must_use]
pub fn axis_name(key: &str) -> String {
    match key {
        "radio.b_dt" => "bandwidth times interval B Δt, Hz s".into(),
        "disturbance.sigma_c" => "gusts σ_c, field widths per interval".into(),
        key => key.to_owned(),
    }
}

/// Name, symbol and unit of a metric.
#[must_use]
pub fn metric_name(metric: Metric) -> String {
    let unit = match metric {
        Metric::TerminalDistance => "field widths",
        Metric::TransmitEnergy => "power levels times intervals",
        Metric::Outages => "intervals",
        metric => metric.unit(),
    };
    if unit.is_empty() { metric.symbol().to_owned() } else { format!("{}, {unit}", metric.symbol()) }
}

/// Means with their bands: one line per controller, and where there is a second axis one per value of it, coloured by
/// that value.
#[must_use]
pub fn curves(plan: &SweepPlan, rows: &[TableRow], metric: Metric) -> Vec<Series> {
    let Some(second) = &plan.second else {
        let line = |(n, controller): (usize, &Controller)| {
            let name = controller.to_string();
            curve(plan, rows, (*controller, None), metric, (name, n, Style::Dotted))
        };
        return plan.controllers.iter().enumerate().map(line).collect();
    };
    let line = |(k, controller): (usize, &Controller), (n, y): (usize, &f64)| {
        let name = format!("{controller}, {} = {y}", second.axis);
        curve(plan, rows, (*controller, Some(*y)), metric, (name, n, STYLES[k % STYLES.len()]))
    };
    let each = |who: (usize, &Controller)| -> Vec<Series> {
        second.points.iter().enumerate().map(|y| line((who.0, who.1), y)).collect()
    };
    plan.controllers.iter().enumerate().flat_map(each).collect()
}

fn curve(
    plan: &SweepPlan,
    rows: &[TableRow],
    (controller, y): (Controller, Option<f64>),
    metric: Metric,
    (name, colour, style): (String, usize, Style),
) -> Series {
    let is_here =
        |row: &&TableRow, x: f64| row.point.x == x && row.point.y == y && row.controller == controller;
    let mut means: Vec<(f64, _)> = plan
        .points
        .iter()
        .filter_map(|x| Some((*x, rows.iter().find(|row| is_here(row, *x))?.means[metric])))
        .collect();
    means.sort_by(|a, b| a.0.total_cmp(&b.0));
    let points = means.iter().map(|(x, m)| (*x, m.mean)).collect();
    let band = means.iter().map(|(x, m)| (*x, m.ci[0], m.ci[1])).collect();
    Series { band, ..Series::line(name, colour, points).styled(style) }
}

/// Draws the paper's metrics into a folder, named after the sweep.
///
/// # Errors
/// A file cannot be written.
pub fn save(plan: &SweepPlan, rows: &[TableRow], dir: &Path) -> Result<()> {
    let panel = |metric: Metric| Chart {
        title: metric.title().to_owned(),
        x: axis_name(&plan.axis),
        y: metric_name(metric),
        series: curves(plan, rows, metric),
        panel: true,
        ..Chart::default()
    };
    let panels: Vec<Chart> = Metric::of_paper().map(panel).collect();
    chart::save(Sheet { charts: &panels, columns: 3 }, dir, &plan.name)?;
    Ok(())
}
