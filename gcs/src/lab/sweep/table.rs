//! From episodes to the rows of a figure: means, spread and intervals per point and controller, and
//! ratios to CRPL on the same seeds.

use std::fmt::Write;

use serde::Serialize;

use super::episode::{Episode, Outcome};
use super::plan::Plan;
use crate::lab::stats::{Mean, Resamples};
use crate::station::pilot::Controller;

/// The paper's five metrics (Sec. IV-A6), in the order of the panels of Figs. 6 and 7.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Metric {
    /// d_f
    TerminalError,
    /// E_comm
    TransmitEnergy,
    /// E_ctrl
    PropulsionEnergy,
    /// p_coll^max
    CollisionRisk,
    /// T_out
    OutageTime,
}

impl Metric {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::TerminalError,
        Self::TransmitEnergy,
        Self::PropulsionEnergy,
        Self::CollisionRisk,
        Self::OutageTime,
    ];

    /// Its key in tables.
    #[must_use]
    pub fn key(self) -> &'static str {
        ["d_f", "e_comm", "e_ctrl", "p_coll_max", "t_out"][self as usize]
    }

    /// Its name with its unit, for people.
    #[must_use]
    pub fn title(self) -> &'static str {
        [
            "d_f, terminal error",
            "E_comm, transmit energy",
            "E_ctrl, propulsion energy, J",
            "p_coll, largest collision probability",
            "T_out, control intervals in outage",
        ][self as usize]
    }

    /// Its value in one flight.
    #[must_use]
    pub fn of(self, o: &Outcome) -> f64 {
        match self {
            Self::TerminalError => o.d_f,
            Self::TransmitEnergy => o.e_comm,
            Self::PropulsionEnergy => o.e_ctrl,
            Self::CollisionRisk => o.p_coll_max,
            Self::OutageTime => o.t_out as f64,
        }
    }

    /// Least denominator of a ratio: CRPL may have no outage at all, so one interval there.
    #[must_use]
    pub fn floor(self) -> f64 {
        if self == Self::OutageTime { 1.0 } else { f64::MIN_POSITIVE }
    }

    /// Mean ± half of its interval (standard deviation), with the decimals that are worth printing.
    #[must_use]
    pub fn cell(self, mean: &Mean) -> String {
        let d = [4, 1, 0, 4, 2][self as usize];
        format!("{:.d$} ±{:.d$} ({:.d$})", mean.mean, mean.half_width(), mean.sd)
    }
}

/// One number per metric.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Five<T> {
    /// d_f, units.
    pub d_f: T,
    /// E_comm.
    pub e_comm: T,
    /// E_ctrl, J.
    pub e_ctrl: T,
    /// p_coll^max.
    pub p_coll_max: T,
    /// T_out, control intervals.
    pub t_out: T,
}

impl<T: Copy> Five<T> {
    fn from_fn(mut of: impl FnMut(Metric) -> Option<T>) -> Option<Self> {
        Some(Self {
            d_f: of(Metric::TerminalError)?,
            e_comm: of(Metric::TransmitEnergy)?,
            e_ctrl: of(Metric::PropulsionEnergy)?,
            p_coll_max: of(Metric::CollisionRisk)?,
            t_out: of(Metric::OutageTime)?,
        })
    }

    /// The number of one metric.
    pub fn get(&self, metric: Metric) -> T {
        match metric {
            Metric::TerminalError => self.d_f,
            Metric::TransmitEnergy => self.e_comm,
            Metric::PropulsionEnergy => self.e_ctrl,
            Metric::CollisionRisk => self.p_coll_max,
            Metric::OutageTime => self.t_out,
        }
    }
}

/// One controller at one point.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Name of the sweep.
    pub sweep: String,
    /// Value of the axis.
    pub x: f64,
    /// Who flew.
    pub controller: Controller,
    /// Flights.
    pub episodes: u64,
    /// Means.
    #[serde(flatten)]
    pub means: Five<Mean>,
    /// Ratios of means to CRPL's on the same seeds; `None` if CRPL did not fly.
    pub ratio_to_crpl: Option<Five<Mean>>,
    /// Share of flights that ended in the goal region.
    #[serde(skip)]
    pub reached: f64,
    /// Share of flights that passed below the obstacle.
    #[serde(skip)]
    pub below: f64,
    /// Share of flights that ended at a wall.
    #[serde(skip)]
    pub at_wall: f64,
}

/// All rows of a sweep, points in their order, controllers in theirs. `episodes` must be in the order
/// of the plan.
#[must_use]
pub fn rows(plan: &Plan, episodes: &[Episode]) -> Vec<Row> {
    let flights = episodes.len() / (plan.points.len() * plan.controllers.len()).max(1);
    let resamples = Resamples::of(flights);
    let mut rows = Vec::new();
    for x in &plan.points {
        let of = |controller: Controller| -> Vec<Outcome> {
            let here = episodes.iter().filter(|e| e.x == *x && e.controller == controller);
            here.map(|e| e.scored).collect()
        };
        let crpl = plan.controllers.contains(&Controller::Crpl).then(|| of(Controller::Crpl));
        for controller in &plan.controllers {
            rows.extend(row(plan, *x, *controller, &of(*controller), crpl.as_deref(), &resamples));
        }
    }
    rows
}

fn row(
    plan: &Plan,
    x: f64,
    controller: Controller,
    flights: &[Outcome],
    crpl: Option<&[Outcome]>,
    resamples: &Resamples,
) -> Option<Row> {
    let values = |of: Metric, flights: &[Outcome]| flights.iter().map(|o| of.of(o)).collect::<Vec<f64>>();
    let share = |of: fn(&Outcome) -> bool| {
        flights.iter().filter(|o| of(o)).count() as f64 / flights.len().max(1) as f64
    };
    let ratio_to_crpl = crpl.and_then(|crpl| {
        Five::from_fn(|m| {
            if controller == Controller::Crpl {
                // Exactly 1, also where its T_out is below the floor.
                return Some(Mean::of(&[1.0]));
            }
            resamples.ratio(&values(m, flights), &values(m, crpl), m.floor())
        })
    });
    Some(Row {
        sweep: plan.name.clone(),
        x,
        controller,
        episodes: flights.len() as u64,
        means: Five::from_fn(|m| Some(Mean::of(&values(m, flights))))?,
        ratio_to_crpl,
        reached: share(|o| o.reached),
        below: share(|o| o.below),
        at_wall: share(|o| o.at_wall),
    })
}

/// The rows as comma-separated values, all digits.
#[must_use]
pub fn csv(rows: &[Row]) -> String {
    let mut text = String::from("sweep,x,controller,episodes,reached,below,at_wall");
    for m in Metric::ALL.map(Metric::key) {
        let _ = write!(text, ",{m}_mean,{m}_sd,{m}_lo,{m}_hi,{m}_ratio,{m}_ratio_lo,{m}_ratio_hi");
    }
    text.push('\n');
    for row in rows {
        let Row { sweep, x, controller, episodes, reached, below, at_wall, .. } = row;
        let _ = write!(text, "{sweep},{x},{controller},{episodes},{reached},{below},{at_wall}");
        for m in Metric::ALL {
            let Mean { mean, ci, sd } = row.means.get(m);
            let _ = write!(text, ",{mean},{sd},{},{}", ci[0], ci[1]);
            match row.ratio_to_crpl.map(|ratios| ratios.get(m)) {
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

/// A ratio with its interval.
#[must_use]
pub fn ratio_cell(ratio: &Mean) -> String {
    format!("{:.2} [{:.2}, {:.2}]", ratio.mean, ratio.ci[0], ratio.ci[1])
}

/// The rows as two tables for people: means with the half width of their 95 % interval and the
/// standard deviation of a flight; ratios to CRPL with their 95 % interval.
#[must_use]
pub fn text(plan: &Plan, rows: &[Row]) -> String {
    let mut out = format!(
        "{}: {} over {} flights a row from seed {}; mean ± half of the 95 % interval (standard deviation)\n",
        plan.name,
        plan.axis,
        rows.first().map_or(0, |r| r.episodes),
        plan.first_seed
    );
    let head = |out: &mut String, widths: [usize; 5], tail: &str| {
        let _ = write!(out, "{:>8}  {:<18}", "x", "controller");
        for (m, width) in Metric::ALL.iter().zip(widths) {
            let _ = write!(out, "{:>width$}", m.key());
        }
        let _ = writeln!(out, "{tail}");
    };
    head(&mut out, [26, 20, 20, 26, 22], "   reached   below");
    for row in rows {
        let _ = write!(out, "{:>8}  {:<18}", row.x, row.controller.to_string());
        for (m, width) in Metric::ALL.iter().zip([26, 20, 20, 26, 22]) {
            let cell = m.cell(&row.means.get(*m));
            let _ = write!(out, "{cell:>width$}");
        }
        let _ = writeln!(out, "{:>10.3}{:>8.3}", row.reached, row.below);
    }
    let others = || rows.iter().filter(|r| r.controller != Controller::Crpl && r.ratio_to_crpl.is_some());
    if others().next().is_some() {
        out.push_str(
            "\nratio to crpl on the same seeds [95 % bootstrap interval]; T_out over at least one interval\n",
        );
        head(&mut out, [22; 5], "");
    }
    for row in others() {
        let _ = write!(out, "{:>8}  {:<18}", row.x, row.controller.to_string());
        for ratio in Metric::ALL.iter().filter_map(|m| row.ratio_to_crpl.map(|five| five.get(*m))) {
            let cell = ratio_cell(&ratio);
            let _ = write!(out, "{cell:>22}");
        }
        out.push('\n');
    }
    out
}
