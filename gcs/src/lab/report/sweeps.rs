//! The paper's Figs. 6 and 7 from a sweep's folder: five panels with mean, band and the paper's ratios,
//! the tables, and what the paper says of its extreme points beside what was measured.

use std::path::Path;

use anyhow::{Context, Result};
use crpl_model::evaluation::chart::{self, Chart, Grid, Legend, Series, Style};
use crpl_sitl::sim::metric::Metric;

use super::page::Page;
use super::{Claim, rgb};
use crate::lab::sweep::episode::SweepEpisode;
use crate::lab::sweep::folder::Folder;
use crate::lab::sweep::table::{self, TableRow};
use crate::station::pilot::Controller;
use crpl_model::numeric::statistics::Mean;

/// What the paper says of one controller over CRPL at one point.
struct Said {
    sweep: &'static str,
    x: f64,
    controller: Controller,
    metric: Metric,
    /// Ratio in the paper.
    paper: f64,
    /// Least ratio at which we call it reproduced: from the calibration study, which met the paper's figures
    /// with some of its own definitions (docs/choices.md, section 5).
    least: f64,
}

const fn said(
    sweep: &'static str,
    x: f64,
    controller: Controller,
    metric: Metric,
    paper: f64,
    least: f64,
) -> Said {
    Said { sweep, x, controller, metric, paper, least }
}

/// Sec. IV-D of the paper, in numbers.
const SAID: [Said; 13] = [
    said("bandwidth", 2.5, Controller::Rcc, Metric::TerminalDistance, 3.0, 3.0),
    said("bandwidth", 2.5, Controller::Ucc, Metric::TerminalDistance, 2.5, 2.5),
    said("bandwidth", 2.5, Controller::Rcc, Metric::TransmitEnergy, 1.7, 1.45),
    said("bandwidth", 2.5, Controller::Ucc, Metric::TransmitEnergy, 1.6, 1.4),
    said("bandwidth", 2.5, Controller::Rcc, Metric::Outages, 18.0, 10.0),
    said("bandwidth", 2.5, Controller::Ucc, Metric::Outages, 12.0, 8.0),
    said("sigma", 0.01, Controller::Rcc, Metric::TerminalDistance, 1.35, 1.5),
    said("sigma", 0.01, Controller::Ucc, Metric::TerminalDistance, 1.4, 1.4),
    said("sigma", 0.01, Controller::Rcc, Metric::TransmitEnergy, 1.4, 1.4),
    said("sigma", 0.01, Controller::Ucc, Metric::TransmitEnergy, 1.4, 1.4),
    said("sigma", 0.01, Controller::Rcc, Metric::Outages, 7.0, 5.0),
    said("sigma", 0.01, Controller::Ucc, Metric::Outages, 6.5, 4.5),
    said("sigma", 0.01, Controller::Ucc, Metric::CollisionProbability, 3.0, 2.5),
];

/// Outage of CRPL itself, and of CRPL that knows the bandwidth, in intervals, at most: sweep, x, who, bound.
const OUTAGE: [(&str, f64, Controller, f64); 2] =
    [("bandwidth", 2.5, Controller::Crpl, 5.0), ("bandwidth", 2.4, Controller::CrplBw, 0.5)];

/// A finished sweep with its table.
#[derive(Debug)]
pub struct Finished {
    folder: Folder,
    rows: Vec<TableRow>,
}

impl Finished {
    /// From a folder and its episodes.
    #[must_use]
    pub fn new(folder: Folder, episodes: &[SweepEpisode]) -> Self {
        let rows = table::rows(&folder.plan, episodes);
        Self { folder, rows }
    }

    /// Name of the sweep.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.folder.plan.name
    }

    fn row(&self, x: f64, controller: Controller) -> Option<&TableRow> {
        self.rows.iter().find(|r| r.x == x && r.controller == controller)
    }

    /// What the paper says of this sweep, and whether these flights say the same.
    #[must_use]
    pub fn claims(&self) -> Vec<Claim> {
        let plan = &self.folder.plan;
        let mut claims: Vec<Claim> = SAID
            .iter()
            .filter(|said| said.sweep == plan.name)
            .filter_map(|said| {
                let ratio = self.row(said.x, said.controller)?.ratio_to_crpl?[said.metric];
                Some(Claim {
                    holds: ratio.mean >= said.least,
                    text: format!(
                        "{} at {} = {}: {} over crpl is {:.2} [{:.2}, {:.2}]; the paper says {}, at least {} is \
                         asked for.",
                        said.metric.key(),
                        plan.axis,
                        said.x,
                        said.controller,
                        ratio.mean,
                        ratio.ci[0],
                        ratio.ci[1],
                        said.paper,
                        said.least
                    ),
                })
            })
            .collect();
        for (_, x, controller, most) in OUTAGE.iter().filter(|o| o.0 == plan.name) {
            let Some(row) = self.row(*x, *controller) else { continue };
            let Mean { mean, ci, .. } = row.means[Metric::Outages];
            claims.push(Claim {
                holds: mean <= *most,
                text: format!(
                    "{} at {} = {x}: {controller} {mean:.2} intervals [{:.2}, {:.2}]; at most {most} is asked for.",
                    Metric::Outages.key(),
                    plan.axis,
                    ci[0],
                    ci[1]
                ),
            });
        }
        claims
    }

    /// The paper's five panels.
    #[must_use]
    pub fn panels(&self) -> Vec<Chart> {
        Metric::of_paper().map(|metric| self.panel(metric)).collect()
    }

    fn panel(&self, metric: Metric) -> Chart {
        let plan = &self.folder.plan;
        let curve = |(n, controller): (usize, &Controller)| {
            let rows: Vec<(f64, _)> = plan
                .points
                .iter()
                .filter_map(|x| Some((*x, self.row(*x, *controller)?.means[metric])))
                .collect();
            let points = rows.iter().map(|(x, m)| (*x, m.mean)).collect();
            let band = rows.iter().map(|(x, m)| (*x, m.ci[0], m.ci[1])).collect();
            Series { band, ..Series::line(controller.to_string(), n, points).styled(Style::Dotted) }
        };
        let marks =
            SAID.iter().filter(|said| said.sweep == plan.name && said.metric == metric).filter_map(|said| {
                let n = plan.controllers.iter().position(|c| *c == said.controller)?;
                let crpl = self.row(said.x, Controller::Crpl)?.means[metric].mean;
                let at = (said.x, said.paper * crpl.max(metric.floor()));
                Some(Series::line("", n, vec![at]).styled(Style::Hollow))
            });
        let curves = plan.controllers.iter().enumerate().map(curve);
        Chart {
            title: format!("{}, {}", metric.symbol(), metric.title()),
            x: match plan.uncovered.as_slice() {
                [] => plan.axis.clone(),
                points => {
                    let at: Vec<String> = points.iter().map(|point| point.x.to_string()).collect();
                    format!("{} (crpl outside its policy's world at {})", plan.axis, at.join(", "))
                }
            },
            series: curves.chain(marks).collect(),
            legend: if metric == Metric::ALL[0] { Legend::UpperRight } else { Legend::None },
            panel: true,
            ..Chart::default()
        }
    }

    /// Adds a section, and leaves figures and tables in `dir`.
    ///
    /// # Errors
    /// A figure or table cannot be written.
    pub fn show(&self, page: &mut Page, dir: &Path, words: &str) -> Result<()> {
        let plan = &self.folder.plan;
        page.section(&format!("Sweep {}: the five metrics over {}", plan.name, plan.axis));
        page.text(&format!(
            "{} flights per point and controller from seed {}, the same gusts for every controller; mean and its \
             95 % interval. Frames are rendered and encoded at every step.",
            self.rows.first().map_or(0, |r| r.episodes),
            plan.first_seed
        ));
        if !words.is_empty() {
            page.text(words);
        }
        if !plan.uncovered.is_empty() {
            page.text(table::uncovered(plan).trim());
        }
        page.claims(&self.claims());
        let key = |(n, c): (usize, &Controller)| (c.to_string(), rgb(n));
        page.key(&plan.controllers.iter().enumerate().map(key).collect::<Vec<_>>());
        let panels = self.panels();
        let svgs: Vec<(String, String)> = panels
            .iter()
            .map(|panel| {
                let marked = panel.series.iter().any(|s| s.style == Style::Hollow);
                let paper = if marked { "; hollow: the paper's ratio times our crpl" } else { "" };
                Ok((chart::svg(panel)?, format!("{}{paper}", panel.title)))
            })
            .collect::<Result<_>>()?;
        page.figures(&svgs);
        self.tables(page);
        page.folded("The resolved sweep", &toml::to_string(plan)?);
        chart::save(&Grid { figures: &panels, columns: 3 }, dir, &plan.name)?;
        let write = |name: String, text: String| {
            let path = dir.join(name);
            std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))
        };
        write(format!("{}.csv", plan.name), table::csv(plan, &self.rows))?;
        write(format!("{}.txt", plan.name), table::text(plan, &self.rows))
    }

    fn tables(&self, page: &mut Page) {
        let head = |metrics: &mut dyn Iterator<Item = Metric>| -> Vec<String> {
            ["x", "controller"].into_iter().chain(metrics.map(Metric::key)).map(String::from).collect()
        };
        let start = |row: &TableRow| vec![row.x.to_string(), row.controller.to_string()];
        let means = self.rows.iter().map(|row| {
            let cells = Metric::ALL.map(|m| table::mean_cell(m, &row.means[m]));
            let count = |outcome| (row.share(outcome) * row.episodes as f64).round();
            let shares = table::SHOWN.map(|outcome| format!("{} of {}", count(outcome), row.episodes));
            start(row).into_iter().chain(cells).chain(shares).collect::<Vec<_>>()
        });
        page.text("Mean with its 95 % bootstrap interval; of all flights, how many reached the goal, and how many passed below the obstacle.");
        let shares = table::SHOWN.map(|outcome| outcome.key().to_owned());
        let wide: Vec<String> = head(&mut Metric::ALL.into_iter()).into_iter().chain(shares).collect();
        page.table(&wide, &means.collect::<Vec<_>>());
        let ratios: Vec<Vec<String>> = self
            .rows
            .iter()
            .filter(|row| row.controller != Controller::Crpl)
            .filter_map(|row| {
                let ratios = row.ratio_to_crpl?;
                let cells = Metric::of_paper().map(|m| table::ratio_cell(&ratios[m]));
                Some(start(row).into_iter().chain(cells).collect())
            })
            .collect();
        if !ratios.is_empty() {
            page.text("Ratio of means to crpl on the same seeds, with its 95 % bootstrap interval; T_out over at least one interval.");
            page.table(&head(&mut Metric::of_paper()), &ratios);
        }
    }

    /// Sentences, for a terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let claims = self.claims();
        let lines = claims.iter().map(|claim| format!("  {:<13} {}\n", claim.verdict(), claim.text));
        format!("Sweep {}\n{}", self.name(), lines.collect::<String>())
    }
}
