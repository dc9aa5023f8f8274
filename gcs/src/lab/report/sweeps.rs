//! The paper's Figs. 6 and 7 from a sweep's folder: five panels with mean, band and the paper's ratios,
//! the tables, and the verdicts on what the paper says.

use std::path::Path;

use anyhow::Result;
use crpl_model::evaluation::chart::{self, Chart, Series, Sheet, Style};
use crpl_sitl::program::columns;
use crpl_sitl::sim::metric::Metric;

use super::claims::{self, Claim};
use super::page::Page;
use super::quantities::SweepQuantity;
use super::rows::{self, VerdictRow};
use super::verdict::Said;
use crate::lab::sweep::axis::SweepPoint;
use crate::lab::sweep::episode::SweepEpisode;
use crate::lab::sweep::figure;
use crate::lab::sweep::folder::Folder;
use crate::lab::sweep::table::{self, TableRow};
use crate::station::pilot::Controller;

/// A finished sweep with its table.
#[derive(Debug)]
pub struct Finished {
    folder: Folder,
    episodes: Vec<SweepEpisode>,
    rows: Vec<TableRow>,
}

impl Finished {
    /// From a folder and its episodes.
    #[must_use]
    pub fn new(folder: Folder, episodes: Vec<SweepEpisode>) -> Self {
        let rows = table::rows(&folder.plan, &episodes);
        Self { folder, episodes, rows }
    }

    fn row(&self, x: f64, controller: Controller) -> Option<&TableRow> {
        self.rows.iter().find(|r| r.point == SweepPoint::on(x) && r.controller == controller)
    }

    /// What the paper says of this sweep, and what these flights say of that.
    #[must_use]
    pub fn verdicts(&self) -> Vec<VerdictRow> {
        let plan = &self.folder.plan;
        if plan.second.is_some() {
            // The paper's sweeps have one axis.
            return Vec::new();
        }
        let row = |claim: &Claim, quantity: SweepQuantity| {
            let ours = quantity.measure(claim.who, plan, &self.episodes);
            VerdictRow::of_sweep(&plan.name, claim, quantity, ours)
        };
        claims::of_sweep(&plan.name)
            .flat_map(|(claim, quantity)| {
                claim.of_teams(&plan.controllers).into_iter().map(move |c| (c, quantity))
            })
            .map(|(claim, quantity)| row(&claim, quantity))
            .collect()
    }

    /// The paper's ratios to our crpl at single points: who, where, metric and ratio.
    fn marks(&self) -> impl Iterator<Item = (Controller, f64, Metric, f64)> {
        claims::of_sweep(&self.folder.plan.name).filter_map(|(claim, quantity)| {
            match (claim.who.over, quantity, claim.said) {
                (Some(Controller::Crpl), SweepQuantity::Ratio(metric, x), Said::Value(paper)) => {
                    Some((claim.who.of, x, metric, paper))
                }
                _ => None,
            }
        })
    }

    /// The paper's five panels.
    #[must_use]
    pub fn panels(&self) -> Vec<Chart> {
        Metric::of_paper().map(|metric| self.panel(metric)).collect()
    }

    fn panel(&self, metric: Metric) -> Chart {
        let plan = &self.folder.plan;
        let marks = self.marks().filter(|mark| mark.2 == metric).filter_map(|(controller, x, _, paper)| {
            let n = plan.controllers.iter().position(|c| *c == controller)?;
            let crpl = self.row(x, Controller::Crpl)?.means[metric].mean;
            let at = (x, paper * crpl.max(metric.floor()));
            Some(Series::line("the paper's ratio times our crpl", n, vec![at]).styled(Style::Diamond))
        });
        let curves = figure::curves(plan, &self.rows, metric);
        Chart {
            title: match plan.uncovered.as_slice() {
                [] => metric.title().to_owned(),
                points => {
                    let at: Vec<String> = points.iter().map(|point| point.x.to_string()).collect();
                    format!("{} (crpl outside its policy's world at {})", metric.title(), at.join(", "))
                }
            },
            x: figure::axis_name(&plan.axis),
            y: figure::metric_name(metric),
            series: curves.into_iter().chain(marks).collect(),
            panel: true,
            ..Chart::default()
        }
    }

    /// Verdicts, for a terminal.
    #[must_use]
    pub fn text(&self, verdicts: &[VerdictRow]) -> String {
        let plan = &self.folder.plan;
        format!("Sweep {} over {}\n{}", plan.name, plan.axes(), rows::text(verdicts, columns::width()))
    }

    /// Adds a section, and leaves figures and tables in `dir`.
    ///
    /// # Errors
    /// A figure or table cannot be written.
    pub fn show(&self, page: &mut Page, dir: &Path, words: &str, verdicts: &[VerdictRow]) -> Result<()> {
        let plan = &self.folder.plan;
        page.section(&format!("Sweep {}: the five metrics over {}", plan.name, plan.axes()));
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
        page.verdicts(verdicts);
        let panels = self.panels();
        let svgs: Vec<(String, String)> =
            panels.iter().map(|panel| (chart::svg(panel), panel.title.clone())).collect();
        page.figures(&svgs);
        self.tables(page);
        page.folded("The resolved sweep", &toml::to_string(plan)?);
        chart::save(Sheet { charts: &panels, columns: 3 }, dir, &plan.name)?;
        super::write(dir, &format!("{}.csv", plan.name), &table::csv(plan, &self.rows))?;
        super::write(dir, &format!("{}.txt", plan.name), &table::text(plan, &self.rows, None))
    }

    fn tables(&self, page: &mut Page) {
        let head = |metrics: &mut dyn Iterator<Item = Metric>| -> Vec<String> {
            let point = ["x", "y"].into_iter().take(self.folder.plan.axis_count());
            point.chain(["controller"]).chain(metrics.map(Metric::key)).map(String::from).collect()
        };
        let start = |row: &TableRow| -> Vec<String> {
            let point = std::iter::once(row.point.x).chain(row.point.y).map(|x| x.to_string());
            point.chain([row.controller.to_string()]).collect()
        };
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
}
