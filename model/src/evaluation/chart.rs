//! Figures as SVG and PNG, with a font of our own, so that they look the same everywhere; line charts
//! with bands, levels and marks. Knows nothing of what it shows.

use std::ops::Range;
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

/// What can be drawn on any backend.
pub trait Figure {
    /// Width and height, px.
    fn size(&self) -> (u32, u32);

    /// Draws it on a white area of that size.
    ///
    /// # Errors
    /// If the backend fails.
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String>;
}

/// Figures of one size beside and below each other.
#[derive(Debug, Clone)]
pub struct Grid<'a, F> {
    /// Row by row.
    pub figures: &'a [F],
    /// Figures a row, at most.
    pub columns: usize,
}

impl<F: Figure> Grid<'_, F> {
    fn rows_and_columns(&self) -> (usize, usize) {
        let columns = self.columns.clamp(1, self.figures.len().max(1));
        (self.figures.len().div_ceil(columns).max(1), columns)
    }
}

impl<F: Figure> Figure for Grid<'_, F> {
    fn size(&self) -> (u32, u32) {
        let (rows, columns) = self.rows_and_columns();
        let (width, height) = self.figures.first().map_or((1, 1), Figure::size);
        (width * columns as u32, height * rows as u32)
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        let areas = area.split_evenly(self.rows_and_columns());
        self.figures.iter().zip(&areas).try_for_each(|(figure, area)| figure.draw(area))
    }
}

/// The text of an SVG picture that takes the width it is given.
///
/// # Errors
/// If the figure cannot be drawn.
pub fn svg(figure: &impl Figure) -> Result<String, PlotError> {
    let mut text = String::new();
    let backend = SVGBackend::with_string(&mut text, figure.size());
    render(figure, backend).map_err(|message| PlotError { path: "figure".into(), message })?;
    Ok(text)
}

/// Draws `{stem}.svg` and `{stem}.png` in `dir`.
///
/// # Errors
/// If one of them cannot be drawn or written; the error names it.
pub fn save(figure: &impl Figure, dir: &Path, stem: &str) -> Result<(), PlotError> {
    let at = |extension| dir.join(format!("{stem}.{extension}"));
    let failed = |path, message| PlotError { path, message };
    let text = svg(figure).map_err(|e| failed(at("svg"), e.message))?;
    std::fs::write(at("svg"), text).map_err(|e| failed(at("svg"), e.to_string()))?;
    render(figure, BitMapBackend::new(&at("png"), figure.size())).map_err(|e| failed(at("png"), e))
}

fn render<B: DrawingBackend>(figure: &impl Figure, backend: B) -> Result<(), String> {
    static FONT: std::sync::OnceLock<bool> = std::sync::OnceLock::new();
    let known = *FONT.get_or_init(|| {
        plotters::style::register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular()).is_ok()
    });
    if !known {
        return Err("the built-in font is not a font".into());
    }
    let area = backend.into_drawing_area();
    area.fill(&WHITE).map_err(|e| e.to_string())?;
    figure.draw(&area)?;
    area.present().map_err(|e| e.to_string())
}

/// Colours that stay apart in print and for most colour-blind eyes (Okabe and Ito).
pub const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(0, 158, 115),
    RGBColor(230, 159, 0),
    RGBColor(213, 94, 0),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(110, 80, 50),
    RGBColor(90, 90, 90),
];

/// The nth of [`COLOURS`], from the first again after the last.
#[must_use]
pub fn colour(n: usize) -> RGBColor {
    COLOURS[n % COLOURS.len()]
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Style {
    /// A line.
    #[default]
    Line,
    /// A line with a dot at every point.
    Dotted,
    /// A dashed line.
    Dashed,
    /// Crosses: what others report.
    Cross,
    /// Dots.
    Dot,
    /// Hollow circles: what others report.
    Hollow,
}

impl Style {
    /// Whether points are joined.
    fn joins(self) -> bool {
        matches!(self, Self::Line | Self::Dotted | Self::Dashed)
    }
}

/// One set of points.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// Name in the legend; empty: not listed.
    pub name: String,
    /// Index of its colour in [`COLOURS`].
    pub colour: usize,
    /// How it is drawn.
    pub style: Style,
    /// (x, y) in the chart's units, x ascending.
    pub points: Vec<(f64, f64)>,
    /// (x, low, high) of the band around it; empty for none.
    pub band: Vec<(f64, f64, f64)>,
}

impl Series {
    /// A line.
    pub fn line(name: impl Into<String>, colour: usize, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), colour, points, ..Self::default() }
    }

    /// The same points, drawn otherwise.
    #[must_use]
    pub fn styled(self, style: Style) -> Self {
        Self { style, ..self }
    }
}

/// Where the names of the series stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Legend {
    /// Nowhere.
    None,
    /// Upper right.
    UpperRight,
    /// Lower left.
    LowerLeft,
    /// Lower right.
    #[default]
    LowerRight,
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
    /// Range of y; the points' if `None`, and from 0 on a linear axis.
    pub y_range: Option<[f64; 2]>,
    /// Whether x is logarithmic.
    pub log_x: bool,
    /// Whether y is logarithmic.
    pub log_y: bool,
    /// Where the legend stands.
    pub legend: Legend,
    /// Whether it is one of several panels.
    pub panel: bool,
    /// What is drawn: lines below marks, earlier lines over later ones.
    pub series: Vec<Series>,
    /// Horizontal dashed lines with their names.
    pub levels: Vec<(String, f64)>,
}

/// Sizes, px: of a chart on its own and of a panel.
struct Look {
    size: (u32, u32),
    title: i32,
    label: i32,
    axis: i32,
    margin: i32,
    label_areas: (i32, i32),
    ticks: (usize, usize),
}

const ALONE: Look = Look {
    size: (820, 560),
    title: 19,
    label: 14,
    axis: 15,
    margin: 14,
    label_areas: (44, 60),
    ticks: (10, 10),
};
const PANEL: Look = Look {
    size: (460, 330),
    title: 16,
    label: 13,
    axis: 13,
    margin: 8,
    label_areas: (36, 52),
    ticks: (8, 6),
};

/// A value as it is drawn: its logarithm to base 10 on a logarithmic axis.
fn scaled(log: bool, value: f64) -> f64 {
    if log { value.max(1e-12).log10() } else { value }
}

/// The smallest range that holds all finite values; 0 to 1 without any.
fn hull(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low <= high { (low, high) } else { (0.0, 1.0) }
}

/// The given range, or the hull of `values` with a margin.
fn range(given: Option<[f64; 2]>, log: bool, values: impl Iterator<Item = f64>) -> Range<f64> {
    if let Some([low, high]) = given {
        return scaled(log, low)..scaled(log, high);
    }
    let (low, high) = hull(values.map(|v| scaled(log, v)));
    let margin = 0.03 * (high - low).max(1e-9);
    low - margin..high + margin
}

/// A tick's label. On a linear axis the decimals that tell the ticks of the range apart; powers of ten
/// written out on a logarithmic one.
fn label(log: bool, range: &Range<f64>, value: f64) -> String {
    if !log {
        let step = (range.end - range.start) / 6.0;
        let digits = (-step.log10()).ceil().clamp(0.0, 6.0) as usize;
        return format!("{value:.digits$}");
    }
    let value = 10f64.powf(value);
    let digits = (1 - value.log10().floor() as i32).clamp(0, 4) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

impl Chart {
    fn look(&self) -> Look {
        if self.panel { PANEL } else { ALONE }
    }

    /// Ranges of x and y that hold all that is drawn.
    fn ranges(&self) -> (Range<f64>, Range<f64>) {
        let points = || self.series.iter().flat_map(|s| s.points.iter().copied());
        let bands = || self.series.iter().flat_map(|s| s.band.iter().copied());
        let xs = points().map(|(x, y)| if y.is_finite() { x } else { f64::NAN });
        let x = range(self.x_range, self.log_x, xs.chain(bands().map(|(x, ..)| x)));
        let ys = points().map(|(_, y)| y).chain(bands().flat_map(|(_, low, high)| [low.max(0.0), high]));
        let ys = ys.chain(self.levels.iter().map(|(_, level)| *level));
        if self.y_range.is_some() || self.log_y {
            return (x, range(self.y_range, self.log_y, ys));
        }
        let (low, high) = hull(ys.chain([0.0]));
        let height = (high - low).max(1e-9);
        let bottom = if low < 0.0 { low - 0.05 * height } else { 0.0 };
        (x, bottom..low + 1.08 * height)
    }
}

impl Figure for Chart {
    fn size(&self) -> (u32, u32) {
        self.look().size
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        let failed = |e: DrawingAreaErrorKind<B::ErrorType>| e.to_string();
        let look = self.look();
        let (x, y) = self.ranges();
        let mut plot = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", look.title))
            .margin(look.margin)
            .x_label_area_size(look.label_areas.0)
            .y_label_area_size(look.label_areas.1)
            .build_cartesian_2d(x.clone(), y.clone())
            .map_err(failed)?;
        plot.configure_mesh()
            .x_labels(look.ticks.0)
            .y_labels(look.ticks.1)
            .x_desc(&self.x)
            .y_desc(&self.y)
            .label_style(("sans-serif", look.label))
            .axis_desc_style(("sans-serif", look.axis))
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.1))
            .x_label_formatter(&|v| label(self.log_x, &x, *v))
            .y_label_formatter(&|v| label(self.log_y, &y, *v))
            .draw()
            .map_err(failed)?;
        for (name, level) in &self.levels {
            let level = scaled(self.log_y, *level);
            let line = [(x.start, level), (x.end, level)];
            plot.draw_series(DashedLineSeries::new(line, 6, 4, BLACK.mix(0.7).into())).map_err(failed)?;
            let at = (x.start + 0.01 * (x.end - x.start), level + 0.055 * (y.end - y.start));
            plot.draw_series([Text::new(name.clone(), at, ("sans-serif", look.label))]).map_err(failed)?;
        }
        let at = |x: f64, y: f64| (scaled(self.log_x, x), scaled(self.log_y, y));
        let (lines, marks): (Vec<&Series>, Vec<_>) = self.series.iter().partition(|s| s.style.joins());
        for series in lines.into_iter().rev().chain(marks) {
            let colour = colour(series.colour);
            let there = series.band.iter().map(|(x, low, _)| at(*x, low.max(y.start)));
            let back = series.band.iter().rev().map(|(x, _, high)| at(*x, *high));
            let outline: Vec<_> = there.chain(back).collect();
            if !outline.is_empty() {
                plot.draw_series([Polygon::new(outline, colour.mix(0.15))]).map_err(failed)?;
            }
            let points: Vec<(f64, f64)> = series.points.iter().map(|p| at(p.0, p.1)).collect();
            let (thick, filled) = (colour.stroke_width(2), colour.filled());
            match series.style {
                Style::Line => plot.draw_series(LineSeries::new(points, thick)),
                Style::Dashed => plot.draw_series(DashedLineSeries::new(points, 6, 4, thick)),
                Style::Cross => plot.draw_series(points.into_iter().map(|p| Cross::new(p, 6, thick))),
                Style::Dot => plot.draw_series(points.into_iter().map(|p| Circle::new(p, 4, filled))),
                Style::Hollow => plot.draw_series(points.into_iter().map(|p| Circle::new(p, 6, thick))),
                Style::Dotted => {
                    plot.draw_series(LineSeries::new(points.iter().copied(), thick)).map_err(failed)?;
                    plot.draw_series(points.into_iter().map(|p| Circle::new(p, 3, filled)))
                }
            }
            .map_err(failed)?;
        }
        let position = match self.legend {
            Legend::None => return Ok(()),
            Legend::UpperRight => SeriesLabelPosition::UpperRight,
            Legend::LowerLeft => SeriesLabelPosition::LowerLeft,
            Legend::LowerRight => SeriesLabelPosition::LowerRight,
        };
        for series in self.series.iter().filter(|s| !s.name.is_empty()) {
            let (style, colour) = (series.style, colour(series.colour));
            let thick = colour.stroke_width(2);
            let named = plot.draw_series(LineSeries::new(std::iter::empty(), colour)).map_err(failed)?;
            named.label(&series.name).legend(move |(x, y)| match style {
                Style::Cross => Cross::new((x + 10, y), 5, thick).into_dyn(),
                Style::Dot => Circle::new((x + 10, y), 4, colour.filled()).into_dyn(),
                Style::Hollow => Circle::new((x + 10, y), 4, thick).into_dyn(),
                Style::Dashed => PathElement::new([(x, y), (x + 7, y)], thick).into_dyn(),
                Style::Line | Style::Dotted => PathElement::new([(x, y), (x + 18, y)], thick).into_dyn(),
            });
        }
        plot.configure_series_labels()
            .position(position)
            .label_font(("sans-serif", look.label))
            .background_style(WHITE.mix(0.85))
            .border_style(BLACK.mix(0.3))
            .draw()
            .map_err(failed)
    }
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
        assert_eq!(label(true, &(-2.0..2.0), -1.0), "0.1");
        assert_eq!(label(true, &(-2.0..2.0), 1.0), "10");
        assert_eq!(label(false, &(0.0..1.0), 0.25), "0.2");
        assert_eq!(label(false, &(0.0..0.3), 0.25), "0.25");
        assert_eq!(label(false, &(0.0..100.0), 0.0), "0");
    }

    fn panel(points: Vec<(f64, f64)>) -> Chart {
        let series = vec![Series::line("c", 0, points).styled(Style::Dotted)];
        Chart { series, levels: vec![("limit".into(), 2.0)], panel: true, ..Chart::default() }
    }

    #[test]
    fn everything_drawn_lies_inside() {
        let mut panel = panel(vec![(2.5, 0.5), (8.0, 1.0)]);
        panel.series[0].band = vec![(2.5, -1.0, 0.6), (8.0, 0.9, 4.0)];
        panel.series.push(Series::line("", 1, vec![(2.5, 3.0)]).styled(Style::Hollow));
        let (x, y) = panel.ranges();
        assert!(x.start < 2.5 && x.end > 8.0 && y.start == 0.0 && y.end > 4.0, "{x:?} {y:?}");
    }

    #[test]
    fn a_picture_says_what_it_shows() {
        let text = svg(&panel(vec![(0.0, 1.0), (1.0, 1.5)])).unwrap();
        assert!(text.starts_with("<svg") && text.contains("limit") && text.contains("<polyline"), "{text}");
        // Nothing to show is no reason to fail.
        assert!(svg(&panel(vec![])).is_ok() && svg(&panel(vec![(1.0, f64::NAN)])).is_ok());
    }
}
