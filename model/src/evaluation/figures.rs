//! The paper's Fig. 3 from our rollouts, with the paper's own figures marked, and the reliability of
//! the collision head.

use std::path::Path;

use crate::evaluation::chart::{self, Chart, PlotError, Series, Style};
use crate::evaluation::report::Measured;
use crate::evaluation::rollout::{Errors, Forecaster, LONGEST, RolloutErrors, RolloutStart};
use crate::numeric::statistics::quantile;
use crate::predictor::PredictorKind;

/// The predictors of Fig. 3, and what Sec. IV-B reports for H = 100: P(≤ 1 px), p90 in px.
const PAPER: [(Forecaster, &str, f64, f64); 3] = [
    (Forecaster::Predictor(PredictorKind::Linear), "linear", 0.93, 0.82),
    (Forecaster::Predictor(PredictorKind::Mlp), "MLP", 0.84, 1.08),
    (Forecaster::Predictor(PredictorKind::Lstm), "LSTM", 0.68, 1.28),
];

/// Colours of three series that are compared, and of what they are held against.
const HUES: [usize; 3] = [0, 3, 1];
const GREY: usize = 7;

/// Draws `fig3a`, `fig3b`, `moving` and `reliability` in `dir`, each in every format.
///
/// # Errors
/// If a figure cannot be drawn or written.
pub fn draw(measured: &Measured, dir: &Path) -> Result<(), PlotError> {
    let [within, distribution] = fig3(&measured.errors);
    chart::save(&within, dir, "fig3a")?;
    chart::save(&distribution, dir, "fig3b")?;
    chart::save(&moving(measured), dir, "moving")?;
    chart::save(&reliability(measured), dir, "reliability")
}

/// Figs. 3(a) and 3(b) from the errors of rollouts, l1 in px.
#[must_use]
pub fn fig3(measured: &[RolloutErrors]) -> [Chart; 2] {
    [within(measured), distribution(measured)]
}

fn errors(measured: &[RolloutErrors], name: Forecaster, start: RolloutStart) -> &[Vec<f64>] {
    let found = measured.iter().find(|(n, s, _)| *n == name && *s == start);
    found.map_or(&[], |(_, _, e)| e.as_slice())
}

/// Share of errors up to `px` after each step.
fn shares(errors: &[Vec<f64>], px: f64) -> Vec<(f64, f64)> {
    let n = errors.len().max(1) as f64;
    let share = |h: usize| errors.iter().filter(|e| e[h] <= px).count() as f64 / n;
    (0..LONGEST).map(|h| ((h + 1) as f64, share(h))).collect()
}

/// Fig. 3(a): share of rollouts from rest within 1 and 5 px over the look-ahead.
fn within(measured: &[RolloutErrors]) -> Chart {
    let mut series = Vec::new();
    for (colour, (name, word, p1, _)) in HUES.into_iter().zip(PAPER) {
        let e = errors(measured, name, RolloutStart::Rest);
        series.push(Series::line(format!("{word}, 1 px"), colour, shares(e, 1.0)));
        series.push(Series::line(format!("{word}, 5 px"), colour, shares(e, 5.0)).styled(Style::Dashed));
        let theirs = vec![(LONGEST as f64, p1)];
        series.push(Series::line(format!("{word}, 1 px, paper"), colour, theirs).styled(Style::Diamond));
    }
    Chart {
        title: "Fig. 3(a): rollouts from rest, share of errors up to 1 and 5 px".into(),
        x: "look-ahead H, control intervals".into(),
        y: "share of rollouts with e ≤ 1 or 5 px".into(),
        x_range: Some([0.0, 103.0]),
        y_range: Some([0.0, 1.02]),
        series,
        ..Chart::default()
    }
}

/// Fig. 3(b): distribution of the error after 1 and after 100 steps from rest.
fn distribution(measured: &[RolloutErrors]) -> Chart {
    let mut series = Vec::new();
    for (colour, (name, word, _, p90)) in HUES.into_iter().zip(PAPER) {
        let e = errors(measured, name, RolloutStart::Rest);
        series.push(Series::line(format!("{word}, H = 100"), colour, cdf(e, LONGEST)));
        series.push(Series::line(format!("{word}, H = 1"), colour, cdf(e, 1)).styled(Style::Dashed));
        let theirs = vec![(p90, 0.9)];
        series.push(Series::line(format!("{word}, H = 100, paper"), colour, theirs).styled(Style::Diamond));
    }
    series.push(Series::line("all, H = 1, paper", GREY, vec![(0.2, 0.9)]).styled(Style::Diamond));
    Chart {
        title: "Fig. 3(b): error after 1 and after 100 steps from rest".into(),
        x: "l1 error of the position e, px".into(),
        y: "share of rollouts with a smaller error".into(),
        x_range: Some([0.005, 50.0]),
        y_range: Some([0.0, 1.02]),
        log_x: true,
        series,
        ..Chart::default()
    }
}

/// Empirical distribution after `h` steps, at 200 levels.
fn cdf(errors: &[Vec<f64>], h: usize) -> Vec<(f64, f64)> {
    let at: Vec<f64> = errors.iter().map(|e| e[h - 1]).collect();
    (0..=200).map(|k| f64::from(k) / 200.0).map(|p| (quantile(&at, p).max(0.005), p)).collect()
}

/// From a moving UAV: two frames against the observer's window.
fn moving(measured: &Measured) -> Chart {
    let named = [
        (Forecaster::Predictor(PredictorKind::Linear), "linear, two frames"),
        (Forecaster::Observer, "linear, observer"),
        (Forecaster::ConstantVelocity, "constant velocity"),
    ];
    let series = HUES.into_iter().zip(named).map(|(colour, (name, word))| {
        let e: &Errors = &errors(&measured.errors, name, RolloutStart::Moving).to_vec();
        Series::line(word, colour, shares(e, 1.0))
    });
    Chart {
        title: "Rollouts from a moving UAV, share of errors up to 1 px".into(),
        x: "look-ahead H, control intervals".into(),
        y: "share of rollouts with e ≤ 1 px".into(),
        x_range: Some([0.0, 103.0]),
        y_range: Some([0.0, 1.02]),
        series: series.collect(),
        ..Chart::default()
    }
}

fn reliability(measured: &Measured) -> Chart {
    let bins = measured.report.heads.reliability.iter().map(|(p, t, _)| (*p, *t)).collect();
    Chart {
        title: format!("Collision head on frames, ECE {:.4}", measured.report.heads.ece),
        x: "predicted collision probability, mean of the bin".into(),
        y: "true collision probability, mean of the bin".into(),
        x_range: Some([0.0, 1.0]),
        y_range: Some([0.0, 1.0]),
        series: vec![
            Series::line("perfect", GREY, vec![(0.0, 0.0), (1.0, 1.0)]).styled(Style::Dashed),
            Series::line("ten bins", 0, bins).styled(Style::Dot),
        ],
        ..Chart::default()
    }
}
