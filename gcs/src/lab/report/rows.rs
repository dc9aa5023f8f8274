//! Claims with their verdicts, as rows: text for a terminal, and comma-separated values.

use std::collections::BTreeMap;
use std::fmt::Write;

use crpl_model::numeric::statistics::Mean;
use crpl_sitl::program::columns;

use super::claims::{Claim, ROLLOUTS};
use super::quantities::{FlightQuantity, SweepQuantity};
use super::verdict::Verdict;

/// A claim of the paper beside what we measured.
#[derive(Debug, Clone, PartialEq)]
pub struct VerdictRow {
    /// Where it was measured: the name of a sweep, or `scenario1`.
    pub study: String,
    /// Section of the paper.
    pub section: &'static str,
    /// What is measured, in words.
    pub quantity: String,
    /// What the paper says.
    pub paper: String,
    /// Ours.
    pub ours: Ours,
}

/// What we measured.
#[derive(Debug, Clone, PartialEq)]
pub enum Ours {
    /// A number with its verdict.
    Judged {
        /// The number with its 95 % interval.
        value: Mean,
        /// Decimals worth printing.
        decimals: usize,
        /// What follows for the paper.
        verdict: Verdict,
        /// Whether the interval contains the paper's value and no difference.
        is_undecided: bool,
    },
    /// Nothing here, and why.
    Missing(&'static str),
}

/// What a mark in the table means.
pub const UNDECIDED: &str = "* the interval contains no difference, too: more flights would tell";

/// Columns of a line before the quantity, and of a whole line.
const BEFORE: usize = 78;
const WIDTH: usize = 120;
/// Least room for what is measured beside the numbers.
const NARROW: usize = 24;
/// Its indent below them.
const BELOW: usize = 4;

impl VerdictRow {
    /// A claim that a sweep decides, measured or not.
    #[must_use]
    pub fn of_sweep(study: &str, claim: &Claim, quantity: SweepQuantity, ours: Option<Mean>) -> Self {
        let words = quantity.describe(claim.who);
        Self::new(study, claim, words, (quantity.neutral(), quantity.decimals()), ours)
    }

    /// A claim that single flights decide, measured or not.
    #[must_use]
    pub fn of_flight(study: &str, claim: &Claim, quantity: FlightQuantity, ours: Option<f64>) -> Self {
        let words = quantity.describe(claim.who);
        let ours = ours.map(|value| Mean::of(&[value]));
        Self::new(study, claim, words, (quantity.neutral(), quantity.decimals()), ours)
    }

    fn new(
        study: &str,
        claim: &Claim,
        quantity: String,
        (neutral, decimals): (f64, usize),
        ours: Option<Mean>,
    ) -> Self {
        let judged = ours.and_then(|value| {
            let verdict = claim.said.verdict(neutral, &value)?;
            let is_undecided = claim.said.is_undecided(neutral, &value);
            Some(Ours::Judged { value, decimals, verdict, is_undecided })
        });
        Self {
            study: study.into(),
            section: claim.section,
            quantity,
            paper: claim.said.signs(neutral),
            ours: judged.unwrap_or(Ours::Missing("not flown")),
        }
    }

    /// The claims of Fig. 3, which flights do not decide.
    pub fn of_rollouts() -> impl Iterator<Item = Self> {
        ROLLOUTS.iter().map(|(quantity, paper)| Self {
            study: "rollouts".into(),
            section: "IV-B",
            quantity: (*quantity).into(),
            paper: (*paper).into(),
            ours: Ours::Missing("model evaluate"),
        })
    }

    /// The verdict, if there is one.
    #[must_use]
    pub fn verdict(&self) -> Option<Verdict> {
        match self.ours {
            Ours::Judged { verdict, .. } => Some(verdict),
            Ours::Missing(_) => None,
        }
    }

    /// The verdict in words, marked if undecided; or why there is none.
    #[must_use]
    pub fn verdict_cell(&self) -> String {
        match self.ours {
            Ours::Judged { verdict, is_undecided, .. } => {
                format!("{verdict}{}", if is_undecided { " *" } else { "" })
            }
            Ours::Missing(why) => why.into(),
        }
    }

    /// Our value with its interval; alone where it has no width.
    #[must_use]
    pub fn ours_cell(&self) -> String {
        match &self.ours {
            Ours::Judged { value: Mean { mean, ci: [low, high], .. }, decimals: d, .. } => {
                if low == high {
                    format!("{mean:.d$}")
                } else {
                    format!("{mean:.d$} [{low:.d$}, {high:.d$}]")
                }
            }
            Ours::Missing(_) => "-".into(),
        }
    }

    /// The row in lines of at most `width` characters: what is measured stands behind, or below where that leaves
    /// little room.
    fn line(&self, width: usize) -> String {
        let (verdict, ours) = (self.verdict_cell(), self.ours_cell());
        let start = format!("{verdict:<24}  {:>12}  {ours:>26}  {:<8}", self.paper, self.section);
        let mut out = String::new();
        if width < BEFORE + NARROW {
            let _ = writeln!(out, "{}", start.trim_end());
            for part in wrapped(&self.quantity, width.saturating_sub(BELOW)) {
                let _ = writeln!(out, "{:BELOW$}{part}", "");
            }
            return out;
        }
        for (n, part) in wrapped(&self.quantity, width - BEFORE).iter().enumerate() {
            let start = if n == 0 { start.as_str() } else { "" };
            let _ = writeln!(out, "{start:<BEFORE$}{part}");
        }
        out
    }
}

/// Words in lines of at most `width` characters.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    columns::wrapped(text, 0, Some(width)).lines().map(str::to_owned).collect()
}

/// The rows as a table for a terminal of that width, and how often each verdict is in it.
#[must_use]
pub fn text(rows: &[VerdictRow], width: Option<usize>) -> String {
    let fitted = |line: &str| width.map_or_else(|| line.into(), |width| wrapped(line, width).join("\n"));
    let width = width.map_or(WIDTH, |width| width.min(WIDTH));
    let mut out = format!(
        "{:<24}  {:>12}  {:>26}  {:<8}  {}\n",
        "verdict", "paper", "ours [95 %]", "section", "quantity"
    );
    if width < BEFORE + NARROW {
        out = format!("{}\n{:BELOW$}quantity\n", out.replace("quantity", "").trim_end(), "");
    }
    rows.iter().for_each(|row| out += &row.line(width));
    if rows.iter().any(|row| row.verdict_cell().ends_with('*')) {
        let _ = writeln!(out, "{}", fitted(UNDECIDED));
    }
    let _ = writeln!(out, "{}", fitted(&counts(rows)));
    out
}

/// How often each verdict is in these rows, and how many have none.
#[must_use]
pub fn counts(rows: &[VerdictRow]) -> String {
    let of = |verdict| rows.iter().filter(|row| row.verdict() == Some(verdict)).count();
    let mut parts: Vec<String> =
        Verdict::ALL.iter().map(|verdict| format!("{verdict} {}", of(*verdict))).collect();
    let mut missing: BTreeMap<&str, usize> = BTreeMap::new();
    for row in rows {
        if let Ours::Missing(why) = row.ours {
            *missing.entry(why).or_default() += 1;
        }
    }
    parts.extend(missing.iter().map(|(why, count)| format!("{why} {count}")));
    format!("{} claims: {}", rows.len(), parts.join("; "))
}

/// The rows as comma-separated values, all digits. `also_neutral` says whether the interval contains the paper's
/// value and no difference.
#[must_use]
pub fn csv(rows: &[VerdictRow]) -> String {
    let mut out = String::from("study,section,quantity,paper,ours,ours_lo,ours_hi,verdict,also_neutral\n");
    for row in rows {
        let VerdictRow { study, section, quantity, paper, ours } = row;
        let _ = write!(out, "{study},{section},{quantity},{paper},");
        let _ = match ours {
            Ours::Judged { value: Mean { mean, ci, .. }, verdict, is_undecided, .. } => {
                // "same direction, stronger" in one cell.
                writeln!(out, "{mean},{},{},\"{verdict}\",{is_undecided}", ci[0], ci[1])
            }
            Ours::Missing(why) => writeln!(out, ",,,\"{why}\","),
        };
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::claims::{CLAIMS, Measure, of_sweep};
    use super::*;

    /// All claims, each with this value of ours.
    fn rows(ours: Mean) -> Vec<VerdictRow> {
        let row = |claim: &Claim| match claim.measure {
            Measure::Sweep(name, quantity) => VerdictRow::of_sweep(name, claim, quantity, Some(ours)),
            Measure::Flight(_, quantity) => {
                VerdictRow::of_flight("scenario1", claim, quantity, Some(ours.mean))
            }
        };
        CLAIMS.iter().map(row).collect()
    }

    #[test]
    fn no_line_is_wider_than_the_terminal_and_no_word_is_lost() {
        let rows = rows(Mean { mean: -10.25, ci: [-12.0, 10.5], sd: 0.0 });
        for width in [None, Some(80), Some(105), Some(200)] {
            let text = text(&rows, width);
            let most = width.unwrap_or(WIDTH).min(WIDTH);
            let rows_alone = text.lines().filter(|line| width.is_some() || !line.contains(" claims: "));
            assert!(rows_alone.into_iter().all(|line| line.chars().count() <= most), "{text}");
            for row in &rows {
                assert!(row.quantity.split(' ').all(|word| text.contains(word)), "{row:?}");
            }
        }
    }

    #[test]
    fn a_line_of_csv_has_as_many_cells_as_its_head() {
        let rows = rows(Mean { mean: 1.0, ci: [0.5, 9.0], sd: 0.0 });
        let text = csv(&rows);
        let cells = |line: &str| line.replace("direction, ", "direction ").split(',').count();
        assert!(text.lines().all(|line| cells(line) == 9), "{text}");
        assert!(csv(&VerdictRow::of_rollouts().collect::<Vec<_>>()).lines().all(|line| cells(line) == 9));
    }

    #[test]
    fn a_claim_that_was_not_flown_is_said_to_be_so() {
        let (claim, quantity) = of_sweep("bandwidth").next().unwrap();
        let rows = [VerdictRow::of_sweep("bandwidth", &claim, quantity, None)];
        assert!(
            text(&rows, None).contains("not flown") && counts(&rows).ends_with("contradicts 0; not flown 1")
        );
    }
}
