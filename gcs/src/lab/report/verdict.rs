//! Two-sided verdicts: what the paper states, held against an interval of ours. No threshold of our own is in
//! them: only the paper's numbers, and the value at which nothing differs.

use std::fmt;

use crpl_model::numeric::statistics::{Interval, Mean};

/// What the paper states of a quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Said {
    /// About this value.
    Value(f64),
    /// Between these two, or a value that is rounded to them.
    Range(f64, f64),
    /// More than this, which itself is more than no difference.
    MoreThan(f64),
    /// More than no difference, without a number.
    More,
    /// Less than no difference, without a number.
    Less,
    /// No difference.
    Same,
    /// Near to no difference and not below it: a bound is approached, not passed.
    Near,
}

/// What our interval says of the paper's statement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// The paper's value lies in the interval.
    Agrees,
    /// The whole interval lies beyond the paper's value, seen from no difference.
    Stronger,
    /// The whole interval lies between no difference and the paper's value.
    Weaker,
    /// The interval contains no difference, which the paper states.
    NoDifference,
    /// The whole interval lies on the other side of no difference.
    Contradicts,
}

impl Verdict {
    /// All of them, from the best for the paper to the worst.
    pub const ALL: [Self; 5] =
        [Self::Agrees, Self::Stronger, Self::Weaker, Self::NoDifference, Self::Contradicts];

    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Agrees => "agrees",
            Self::Stronger => "same direction, stronger",
            Self::Weaker => "same direction, weaker",
            Self::NoDifference => "no difference",
            Self::Contradicts => "contradicts",
        }
    }

    /// In one word or two, for a column's head.
    #[must_use]
    pub fn short(self) -> &'static str {
        match self {
            Self::Agrees => "agrees",
            Self::Stronger => "stronger",
            Self::Weaker => "weaker",
            Self::NoDifference => "none",
            Self::Contradicts => "contradicts",
        }
    }

    /// A class of the page's style sheet.
    #[must_use]
    pub fn class(self) -> &'static str {
        match self {
            Self::Agrees => "agrees",
            Self::Stronger => "stronger",
            Self::Weaker => "weaker",
            Self::NoDifference => "nothing",
            Self::Contradicts => "contradicts",
        }
    }
}

impl Said {
    /// The verdict of `ours`, an estimate with its interval, where `neutral` is the value of no difference: 1 of
    /// a ratio, 0 of a difference or a count. `None` if ours is no number.
    ///
    /// An interval that contains both the paper's value and no difference agrees: [`Self::is_undecided`].
    #[must_use]
    pub fn verdict(self, neutral: f64, ours: &Mean) -> Option<Verdict> {
        if !ours.ci.iter().all(|end| end.is_finite()) {
            return None;
        }
        let verdict = match (self, Side::of(ours.ci, neutral)) {
            (Self::Same | Self::Near, Side::Within) => Verdict::Agrees,
            (Self::Near, Side::Above) => Verdict::Weaker,
            (Self::Same | Self::Near, _) => Verdict::Contradicts,
            (Self::More, Side::Above) | (Self::Less, Side::Below) => Verdict::Agrees,
            (Self::More | Self::Less, Side::Within) => Verdict::NoDifference,
            (Self::More | Self::Less, _) => Verdict::Contradicts,
            (Self::Value(value), _) => between([value, value], neutral, ours.ci),
            (Self::Range(low, high), _) => between([low, high], neutral, ours.ci),
            (Self::MoreThan(least), _) => between([least, f64::INFINITY], neutral, ours.ci),
        };
        Some(verdict)
    }

    /// Whether ours agrees with a number of the paper, and with no difference as well: more flights would tell.
    #[must_use]
    pub fn is_undecided(self, neutral: f64, ours: &Mean) -> bool {
        matches!(self, Self::Value(_) | Self::Range(..) | Self::MoreThan(_))
            && self.verdict(neutral, ours) == Some(Verdict::Agrees)
            && Side::of(ours.ci, neutral) == Side::Within
    }

    /// In signs, beside a value of no difference.
    #[must_use]
    pub fn signs(self, neutral: f64) -> String {
        match self {
            Self::Value(value) => value.to_string(),
            Self::Range(low, high) => format!("{low} to {high}"),
            Self::MoreThan(least) => format!("> {least}"),
            Self::More => format!("> {neutral}"),
            Self::Less => format!("< {neutral}"),
            Self::Same => neutral.to_string(),
            Self::Near => format!("near {neutral}"),
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.words())
    }
}

/// Where an interval lies, seen from a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Below,
    Within,
    Above,
}

impl Side {
    fn of([low, high]: Interval, value: f64) -> Self {
        if high < value {
            Self::Below
        } else if low > value {
            Self::Above
        } else {
            Self::Within
        }
    }
}

/// The verdict on numbers of the paper, all on one side of `neutral`.
fn between([from, to]: Interval, neutral: f64, ours: Interval) -> Verdict {
    if ours[0] <= to && from <= ours[1] {
        return Verdict::Agrees;
    }
    let side = Side::of(ours, neutral);
    let stated = Side::of([from, to], neutral);
    if side == Side::Within {
        return Verdict::NoDifference;
    }
    if side != stated {
        return Verdict::Contradicts;
    }
    let is_beyond = if stated == Side::Above { ours[0] > to } else { ours[1] < from };
    if is_beyond { Verdict::Stronger } else { Verdict::Weaker }
}

#[cfg(test)]
mod tests {
    use super::Verdict::{Agrees, Contradicts, NoDifference, Stronger, Weaker};
    use super::*;

    fn ours(low: f64, high: f64) -> Mean {
        Mean { mean: f64::midpoint(low, high), ci: [low, high], sd: 0.1 }
    }

    fn check(neutral: f64, said: Said, cases: &[(f64, f64, Verdict)]) {
        for (low, high, want) in cases {
            let got = said.verdict(neutral, &ours(*low, *high));
            assert_eq!(got, Some(*want), "{said:?} against [{low}, {high}]");
        }
    }

    #[test]
    fn a_ratio_above_1_has_all_five_verdicts() {
        check(
            1.0,
            Said::Value(3.0),
            &[
                (2.5, 3.5, Agrees),
                (3.0, 3.0, Agrees),
                (3.1, 4.0, Stronger),
                (1.1, 2.9, Weaker),
                (0.9, 1.2, NoDifference),
                (1.0, 1.2, NoDifference),
                (0.5, 0.9, Contradicts),
            ],
        );
    }

    #[test]
    fn a_ratio_below_1_has_all_five_verdicts() {
        check(
            1.0,
            Said::Value(0.5),
            &[
                (0.4, 0.6, Agrees),
                (0.2, 0.4, Stronger),
                (0.6, 0.9, Weaker),
                (0.8, 1.1, NoDifference),
                (1.1, 2.0, Contradicts),
            ],
        );
    }

    #[test]
    fn a_difference_is_seen_from_0() {
        check(
            0.0,
            Said::Value(-2.0),
            &[
                (-2.5, -1.5, Agrees),
                (-4.0, -3.0, Stronger),
                (-1.0, -0.5, Weaker),
                (-1.0, 0.5, NoDifference),
                (0.5, 1.0, Contradicts),
            ],
        );
    }

    #[test]
    fn a_range_agrees_with_an_interval_that_overlaps_it() {
        check(
            1.0,
            Said::Range(1.1, 1.2),
            &[
                (1.05, 1.12, Agrees),
                (1.12, 1.18, Agrees),
                (1.0, 1.5, Agrees),
                (1.25, 1.3, Stronger),
                (1.02, 1.08, Weaker),
                (0.98, 1.05, NoDifference),
                (0.84, 0.9, Contradicts),
            ],
        );
        check(1.0, Said::Range(0.7, 0.8), &[(0.5, 0.6, Stronger), (0.85, 0.9, Weaker)]);
    }

    #[test]
    fn more_than_a_number_has_nothing_beyond_it() {
        check(
            1.0,
            Said::MoreThan(10.0),
            &[
                (12.0, 90.0, Agrees),
                (9.0, 11.0, Agrees),
                (2.0, 9.0, Weaker),
                (0.8, 1.5, NoDifference),
                (0.1, 0.3, Contradicts),
            ],
        );
    }

    #[test]
    fn a_direction_without_a_number_agrees_differs_not_or_contradicts() {
        let cases = |more, less| [(1.1, 9.0, more), (0.9, 1.1, NoDifference), (0.2, 0.9, less)];
        check(1.0, Said::More, &cases(Agrees, Contradicts));
        check(1.0, Said::Less, &cases(Contradicts, Agrees));
        check(0.0, Said::More, &[(3.0, 3.0, Agrees), (0.0, 0.0, NoDifference), (-1.0, -1.0, Contradicts)]);
    }

    #[test]
    fn no_difference_and_a_bound_are_statements_too() {
        check(1.0, Said::Same, &[(0.9, 1.1, Agrees), (1.1, 1.2, Contradicts), (0.7, 0.9, Contradicts)]);
        check(1.0, Said::Near, &[(0.9, 1.1, Agrees), (1.1, 1.2, Weaker), (0.7, 0.9, Contradicts)]);
        check(0.0, Said::Same, &[(0.0, 0.0, Agrees), (2.0, 2.0, Contradicts)]);
    }

    #[test]
    fn an_interval_with_the_papers_value_and_no_difference_in_it_is_marked() {
        let undecided = |said: Said, low, high| said.is_undecided(1.0, &ours(low, high));
        assert!(undecided(Said::Value(1.4), 0.9, 1.5) && undecided(Said::Range(1.1, 1.2), 1.0, 1.3));
        assert!(!undecided(Said::Value(1.4), 1.2, 1.5) && !undecided(Said::Value(1.4), 0.9, 1.3));
        assert!(!undecided(Said::Same, 0.9, 1.1) && !undecided(Said::More, 0.9, 1.1));
    }

    #[test]
    fn what_is_no_number_has_no_verdict() {
        assert_eq!(Said::More.verdict(1.0, &ours(f64::NAN, 2.0)), None);
        assert_eq!(Said::Value(3.0).verdict(1.0, &ours(2.0, f64::INFINITY)), None);
    }
}
