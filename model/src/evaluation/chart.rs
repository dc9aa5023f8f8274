//! Line charts as SVG and PNG, with a font of our own, so that they look the same everywhere.

use std::path::{Path, PathBuf};

use plotters::coord::Shift;
use plotters::prelude::*;

/// A figure could not be drawn or written.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {message}")]
pub struct PlotError {
    /// The file.
    pub path: PathBuf,
    /// Why.
    pub message: String,
}

/// Colours of the series, in their order: told apart by colour-blind readers, too.
const PALETTE: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
];

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Style {
    /// A line.
    #[default]
    Line,
    /// A dashed line.
    Dashed,
    /// Crosses: what others report.
    Cross,
    /// Dots.
    Dot,
}

/// One set of points.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// Name in the legend; empty: not listed.
    pub name: String,
    /// Index of its colour.
    pub colour: usize,
    /// How it is drawn.
    pub style: Style,
    /// (x, y) in the chart's units.
    pub points: Vec<(f64, f64)>,
}

impl Series {
    /// A line.
    pub fn line(name: impl Into<String>, colour: usize, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), colour, style: Style::Line, points }
    }

    /// The same points, drawn otherwise.
    #[must_use]
    pub fn styled(self, style: Style) -> Self {
        Self { style, ..self }
    }
}

/// A chart of several series.
#[derive(Debug, Clone, Default)]
pub struct Chart {
    /// Caption.
    pub title: String,
    /// Name and unit of the abscissa.
    pub x: String,
    /// Name and unit of the ordinate.
    pub y: String,
    /// Range of x; the points' if `None`.
    pub x_range: Option<[f64; 2]>,
    /// Range of y; the points' if `None`.
    pub y_range: Option<[f64; 2]>,
    /// Whether x is logarithmic.
    pub log_x: bool,
    /// Whether y is logarithmic.
    pub log_y: bool,
    /// Whether the legend stands on the left.
    pub legend_left: bool,
    /// What is drawn, later over earlier.
    pub series: Vec<Series>,
}

/// Makes the built-in font known to the plotting library, once. `false` if it cannot be read.
pub fn register_font() -> bool {
    static FONT: std::sync::OnceLock<bool> = std::sync::OnceLock::new();
    *FONT.get_or_init(|| {
        plotters::style::register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular()).is_ok()
    })
}

/// Draws `chart` as `{stem}.svg` and `{stem}.png` in `dir`.
pub fn save(chart: &Chart, dir: &Path, stem: &str) -> Result<(), PlotError> {
    let (svg, png) = (dir.join(format!("{stem}.svg")), dir.join(format!("{stem}.png")));
    let failed = |path: &Path, message: String| PlotError { path: path.into(), message };
    if !register_font() {
        return Err(failed(&svg, "the built-in font is not a font".into()));
    }
    let size = (820, 560);
    draw(&SVGBackend::new(&svg, size).into_drawing_area(), chart).map_err(|m| failed(&svg, m))?;
    draw(&BitMapBackend::new(&png, size).into_drawing_area(), chart).map_err(|m| failed(&png, m))
}

/// Coordinates as they are drawn: logarithms to base 10 on a logarithmic axis.
fn scaled(log: bool, value: f64) -> f64 {
    if log { value.max(1e-12).log10() } else { value }
}

fn range(given: Option<[f64; 2]>, log: bool, values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    if let Some([low, high]) = given {
        return scaled(log, low)..scaled(log, high);
    }
    let (low, high) = values
        .filter(|v| v.is_finite())
        .map(|v| scaled(log, v))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    let margin = if high > low { 0.04 * (high - low) } else { 0.5 };
    if low.is_finite() { low - margin..high + margin } else { 0.0..1.0 }
}

/// A tick's label: plain numbers, powers of ten written out.
fn label(log: bool, value: f64) -> String {
    let value = if log { 10f64.powf(value) } else { value };
    let digits = if value == 0.0 { 0 } else { (1 - value.abs().log10().floor() as i32).clamp(0, 4) as usize };
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

fn draw<B: DrawingBackend>(area: &DrawingArea<B, Shift>, chart: &Chart) -> Result<(), String> {
    let failed = |e: DrawingAreaErrorKind<B::ErrorType>| e.to_string();
    area.fill(&WHITE).map_err(failed)?;
    let all = || chart.series.iter().flat_map(|s| &s.points);
    let x_range = range(chart.x_range, chart.log_x, all().map(|p| p.0));
    let y_range = range(chart.y_range, chart.log_y, all().map(|p| p.1));
    let mut plot = ChartBuilder::on(area)
        .caption(&chart.title, ("sans-serif", 19))
        .margin(14)
        .x_label_area_size(44)
        .y_label_area_size(60)
        .build_cartesian_2d(x_range, y_range)
        .map_err(failed)?;
    plot.configure_mesh()
        .x_desc(&chart.x)
        .y_desc(&chart.y)
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 15))
        .light_line_style(BLACK.mix(0.04))
        .bold_line_style(BLACK.mix(0.12))
        .x_label_formatter(&|v| label(chart.log_x, *v))
        .y_label_formatter(&|v| label(chart.log_y, *v))
        .draw()
        .map_err(failed)?;
    for series in &chart.series {
        let colour = PALETTE[series.colour % PALETTE.len()];
        let points: Vec<(f64, f64)> =
            series.points.iter().map(|p| (scaled(chart.log_x, p.0), scaled(chart.log_y, p.1))).collect();
        let thick = colour.stroke_width(2);
        let drawn = match series.style {
            Style::Line => plot.draw_series([PathElement::new(points, thick)]),
            Style::Dashed => plot.draw_series(DashedLineSeries::new(points, 6, 4, thick)),
            Style::Cross => plot.draw_series(points.into_iter().map(|p| Cross::new(p, 6, thick))),
            Style::Dot => plot.draw_series(points.into_iter().map(|p| Circle::new(p, 4, colour.filled()))),
        };
        let drawn = drawn.map_err(failed)?;
        if series.name.is_empty() {
            continue;
        }
        let style = series.style;
        drawn.label(&series.name).legend(move |(x, y)| match style {
            Style::Cross => Cross::new((x + 10, y), 5, thick).into_dyn(),
            Style::Dot => Circle::new((x + 10, y), 4, colour.filled()).into_dyn(),
            Style::Dashed => PathElement::new([(x, y), (x + 7, y)], thick).into_dyn(),
            Style::Line => PathElement::new([(x, y), (x + 20, y)], thick).into_dyn(),
        });
    }
    plot.configure_series_labels()
        .position(if chart.legend_left {
            SeriesLabelPosition::LowerLeft
        } else {
            SeriesLabelPosition::LowerRight
        })
        .label_font(("sans-serif", 14))
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .draw()
        .map_err(failed)?;
    area.present().map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_becomes_two_files_that_are_pictures() {
        let dir = tempfile::tempdir().unwrap();
        let points = vec![(0.1, 0.5), (1.0, 0.9), (10.0, 1.0)];
        let chart = Chart {
            title: "errors".into(),
            x: "px".into(),
            y: "share".into(),
            log_x: true,
            series: vec![
                Series::line("ours", 0, points.clone()),
                Series::line("theirs", 1, points).styled(Style::Cross),
            ],
            ..Chart::default()
        };
        save(&chart, dir.path(), "chart").unwrap();
        let svg = std::fs::read_to_string(dir.path().join("chart.svg")).unwrap();
        assert!(svg.contains("theirs") && svg.contains("<polyline"), "{svg}");
        let png = std::fs::read(dir.path().join("chart.png")).unwrap();
        assert_eq!(&png[..4], b"\x89PNG");
        let error = save(&chart, &dir.path().join("nowhere"), "chart").unwrap_err().to_string();
        assert!(error.contains("chart.svg"), "{error}");
    }

    #[test]
    fn labels_are_plain_numbers() {
        assert_eq!(label(true, -1.0), "0.1");
        assert_eq!(label(true, 1.0), "10");
        assert_eq!(label(false, 0.25), "0.25");
        assert_eq!(label(false, 0.0), "0");
    }
}
