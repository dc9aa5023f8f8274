//! A chart, or several on one sheet, as SVG: one drawing from which the PNG and the PDF are made, so that all
//! three are the same. Lengths are px; words are text of the file, not shapes.

use std::fmt::Write;

use super::marks::mark;
use super::ranges::ChartAxis;
use super::{Chart, Legend, Series, Sheet, Style};

/// The text of an SVG file.
pub type SvgText = String;

/// Marks along a curve, at most.
const MARKS: usize = 9;
/// Width of a letter, in font sizes: what words are given room by.
const LETTER: f64 = 0.62;
/// From one row of a legend to the next, in font sizes.
const ROW: f64 = 1.7;
/// Length of a legend's sample, and from it to its name.
const SAMPLE: (f64, f64) = (26.0, 7.0);
const INK: &str = "rgb(27,31,36)";

/// Sizes of a chart on its own and of a panel.
struct Look {
    plot: (f64, f64),
    square: f64,
    title: f64,
    text: f64,
    /// Left of the plot, above it, right of it, below it.
    margins: [f64; 4],
    ticks: (usize, usize),
}

const ALONE: Look = Look {
    plot: (720.0, 430.0),
    square: 620.0,
    title: 18.0,
    text: 14.0,
    margins: [76.0, 44.0, 22.0, 58.0],
    ticks: (9, 8),
};
const PANEL: Look = Look {
    plot: (372.0, 240.0),
    square: 360.0,
    title: 15.0,
    text: 12.0,
    margins: [66.0, 34.0, 16.0, 48.0],
    ticks: (6, 5),
};

/// The sheet as the text of an SVG file that takes the width it is given, and says what it shows.
#[must_use]
pub fn svg<'a>(sheet: impl Into<Sheet<'a>>) -> SvgText {
    let sheet = sheet.into();
    let columns = sheet.columns.clamp(1, sheet.charts.len().max(1));
    let rows = sheet.charts.len().div_ceil(columns);
    let cell = sheet
        .charts
        .iter()
        .map(Chart::size)
        .fold((1.0, 1.0), |a: (f64, f64), b| (a.0.max(b.0), a.1.max(b.1)));
    let (width, above) = (cell.0 * columns as f64, cell.1 * rows as f64);
    let look = sheet.charts.first().map_or(&ALONE, Chart::look);
    let (key, key_height) = legend(sheet.charts, look, width);
    let height = above + key_height;
    let title: Vec<String> = sheet.charts.iter().map(|chart| escape(&chart.title)).collect();
    let alt: Vec<String> = sheet.charts.iter().map(|chart| escape(&chart.description())).collect();
    let (title, alt) = (title.join("; "), alt.join(" "));
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} \
         {height:.0}\" role=\"img\" aria-label=\"{alt}\" font-family=\"sans-serif\" fill=\"{INK}\">\n\
         <title>{title}</title>\n<desc>{alt}</desc>\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for (n, chart) in sheet.charts.iter().enumerate() {
        let at = ((n % columns) as f64 * cell.0, (n / columns) as f64 * cell.1);
        let _ = writeln!(text, "<g transform=\"translate({:.0} {:.0})\">", at.0, at.1);
        Drawing::of(chart).all(&mut text);
        text += "</g>\n";
    }
    let _ = writeln!(text, "<g transform=\"translate(0 {above:.0})\">\n{key}</g>\n</svg>");
    text
}

/// Width of a letter and height of a line in a square plot, as shares of its side.
#[must_use]
pub fn letter_share(panel: bool) -> (f64, f64) {
    let look = if panel { &PANEL } else { &ALONE };
    (LETTER * look.text / look.square, 1.2 * look.text / look.square)
}

/// Names of the series of all charts, each once, in rows; and the height that they take.
fn legend(charts: &[Chart], look: &Look, width: f64) -> (String, f64) {
    let told = charts.iter().filter(|chart| chart.legend == Legend::Below).flat_map(|chart| &chart.series);
    let mut entries: Vec<&Series> = Vec::new();
    for series in told.filter(|series| !series.name.is_empty()) {
        if !entries.iter().any(|known| known.name == series.name) {
            entries.push(series);
        }
    }
    if entries.is_empty() {
        return (String::new(), 0.0);
    }
    let room = |series: &Series| SAMPLE.0 + SAMPLE.1 + width_of(&series.name, look.text) + 18.0;
    let most = entries.iter().map(|series| room(series)).fold(1.0, f64::max);
    let columns = (((width - look.margins[0]) / most) as usize).clamp(1, entries.len());
    let (row, mut text) = (ROW * look.text, String::new());
    for (n, series) in entries.iter().enumerate() {
        let x = look.margins[0] + (n % columns) as f64 * most;
        let y = (n / columns) as f64 * row + 0.5 * row;
        sample(&mut text, series, (x, y));
        word(&mut text, &series.name, (x + SAMPLE.0 + SAMPLE.1, y + 0.35 * look.text), look.text, "start");
    }
    (text, entries.len().div_ceil(columns) as f64 * row + 10.0)
}

/// A series in small.
fn sample(text: &mut String, series: &Series, (x, y): (f64, f64)) {
    let rgb = series.rgb();
    if series.style == Style::Area {
        let (top, half) = (y - 6.0, SAMPLE.0);
        let _ = writeln!(
            text,
            "<rect x=\"{x:.2}\" y=\"{top:.2}\" width=\"{half}\" height=\"12\" fill=\"{rgb}\" stroke=\"{INK}\" stroke-width=\"0.5\"/>"
        );
        return;
    }
    if series.style.joins() {
        line(text, &[(x, y), (x + SAMPLE.0, y)], series);
    }
    if series.style != Style::Thin {
        *text += &mark(series, (x + 0.5 * SAMPLE.0, y));
        text.push('\n');
    }
}

/// How a line of the series is painted.
fn line(text: &mut String, points: &[(f64, f64)], series: &Series) {
    if points.is_empty() {
        return;
    }
    let (width, dashes) = match series.style {
        Style::Thin => (1.2, ""),
        Style::Dashed => (2.0, " stroke-dasharray=\"7 4\""),
        _ => (2.0, ""),
    };
    let _ = writeln!(
        text,
        "<path d=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\" stroke-linejoin=\"round\"{dashes}/>",
        path(points),
        series.rgb()
    );
}

fn path(points: &[(f64, f64)]) -> String {
    let places: Vec<String> = points.iter().map(|(x, y)| format!("{x:.2} {y:.2}")).collect();
    format!("M{}", places.join("L"))
}

/// Words with their baseline at a place.
fn word(text: &mut String, words: &str, (x, y): (f64, f64), size: f64, anchor: &str) {
    let words = escape(words);
    let _ = writeln!(
        text,
        "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{size}\" text-anchor=\"{anchor}\">{words}</text>"
    );
}

/// Room that words take, px.
fn width_of(words: &str, size: f64) -> f64 {
    LETTER * size * words.chars().count() as f64
}

/// Text for the inside of an element or a quoted attribute.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

impl Chart {
    fn look(&self) -> &'static Look {
        if self.panel { &PANEL } else { &ALONE }
    }

    fn plot(&self) -> (f64, f64) {
        let look = self.look();
        if self.square { (look.square, look.square) } else { look.plot }
    }

    /// Right of the plot: room for the names of the levels.
    fn right(&self) -> f64 {
        let names = self.levels.iter().map(|(name, _)| width_of(name, self.look().text) + 10.0);
        names.fold(self.look().margins[2], f64::max)
    }

    /// Width and height without the legend.
    fn size(&self) -> (f64, f64) {
        let [left, top, _, bottom] = self.look().margins;
        let (width, height) = self.plot();
        (left + width + self.right(), top + height + bottom)
    }
}

/// A chart with its axes.
struct Drawing<'a> {
    chart: &'a Chart,
    look: &'static Look,
    axes: (ChartAxis, ChartAxis),
    /// Left, top, width and height of the plot.
    plot: [f64; 4],
}

impl<'a> Drawing<'a> {
    fn of(chart: &'a Chart) -> Self {
        let (look, (width, height)) = (chart.look(), chart.plot());
        Self { chart, look, axes: chart.axes(), plot: [look.margins[0], look.margins[1], width, height] }
    }

    /// A place of the chart in px; `None` for what is no number.
    fn px(&self, (x, y): (f64, f64)) -> Option<(f64, f64)> {
        let [left, top, width, height] = self.plot;
        let at = (left + width * self.axes.0.at(x), top + height * (1.0 - self.axes.1.at(y)));
        (at.0.is_finite() && at.1.is_finite()).then_some(at)
    }

    fn all(&self, text: &mut String) {
        let [left, top, width, height] = self.plot;
        let (clip, series) =
            (format!("x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\""), &self.chart.series);
        self.grid(text);
        // A nested picture cuts off what is outside the plot.
        let _ = writeln!(text, "<svg {clip} viewBox=\"{left} {top} {width} {height}\">");
        for area in series.iter().rev().filter(|s| s.style == Style::Area) {
            self.area(text, area);
        }
        for series in series {
            self.band(text, series);
        }
        for curve in series.iter().rev().filter(|s| s.style.joins() && s.style != Style::Area) {
            self.curve(text, curve);
        }
        text.push_str("</svg>\n");
        let _ = writeln!(text, "<rect {clip} fill=\"none\" stroke=\"{INK}\" stroke-width=\"1\"/>");
        for (n, series) in series.iter().enumerate().rev().filter(|(_, s)| s.style != Style::Area) {
            self.marks(text, n, series);
        }
        self.levels(text);
        self.notes(text);
        self.words(text);
    }

    fn grid(&self, text: &mut String) {
        let [left, top, width, height] = self.plot;
        let (bottom, size) = (top + height, self.look.text);
        for (value, label) in self.axes.0.ticks(self.look.ticks.0) {
            let x = left + width * self.axes.0.at(value);
            let _ = writeln!(
                text,
                "<path d=\"M{x:.2} {top}V{:.2}\" stroke=\"{INK}\" stroke-opacity=\"0.12\"/>",
                bottom
            );
            let _ = writeln!(text, "<path d=\"M{x:.2} {bottom}v5\" stroke=\"{INK}\"/>");
            word(text, &label, (x, bottom + 6.0 + size), size, "middle");
        }
        for (value, label) in self.axes.1.ticks(self.look.ticks.1) {
            let y = bottom - height * self.axes.1.at(value);
            let _ = writeln!(
                text,
                "<path d=\"M{left} {y:.2}H{:.2}\" stroke=\"{INK}\" stroke-opacity=\"0.12\"/>",
                left + width
            );
            let _ = writeln!(text, "<path d=\"M{left} {y:.2}h-5\" stroke=\"{INK}\"/>");
            word(text, &label, (left - 8.0, y + 0.35 * size), size, "end");
        }
    }

    fn places(&self, points: &[(f64, f64)]) -> Vec<(f64, f64)> {
        points.iter().filter_map(|point| self.px(*point)).collect()
    }

    fn area(&self, text: &mut String, series: &Series) {
        let _ =
            writeln!(text, "<path d=\"{}Z\" fill=\"{}\"/>", path(&self.places(&series.points)), series.rgb());
    }

    fn band(&self, text: &mut String, series: &Series) {
        let bottom = self.axes.1.range.start;
        let floor = |y: f64| if self.axes.1.log { y } else { y.max(bottom) };
        let there = series.band.iter().map(|(x, low, _)| (*x, floor(*low)));
        let back = series.band.iter().rev().map(|(x, _, high)| (*x, *high));
        let outline = self.places(&there.chain(back).collect::<Vec<_>>());
        if !outline.is_empty() {
            let _ = writeln!(
                text,
                "<path d=\"{}Z\" fill=\"{}\" fill-opacity=\"0.15\"/>",
                path(&outline),
                series.rgb()
            );
        }
    }

    fn curve(&self, text: &mut String, series: &Series) {
        line(text, &self.places(&series.points), series);
    }

    /// The marks of a series; a curve has a few, each curve at other places, so that curves which lie on each other
    /// are seen.
    fn marks(&self, text: &mut String, n: usize, series: &Series) {
        let (step, first) = match series.style {
            Style::Thin | Style::Area => return,
            Style::Line | Style::Dashed => {
                let step = series.points.len().div_ceil(MARKS).max(1);
                let curves = self.chart.series.len().max(1);
                (step, n * step / curves)
            }
            _ => (1, 0),
        };
        for point in series.points.iter().skip(first).step_by(step) {
            if let Some(at) =
                self.px(*point).filter(|_| self.axes.0.shows(point.0) && self.axes.1.shows(point.1))
            {
                *text += &mark(series, at);
                text.push('\n');
            }
        }
    }

    /// Dashed, with their names right of the plot, where no curve is.
    fn levels(&self, text: &mut String) {
        let [left, _, width, _] = self.plot;
        for (name, level) in &self.chart.levels {
            let Some((_, y)) = self.px((0.0, *level)).filter(|_| self.axes.1.shows(*level)) else { continue };
            let end = left + width;
            let _ = writeln!(
                text,
                "<path d=\"M{left} {y:.2}H{end:.2}\" stroke=\"{INK}\" stroke-dasharray=\"6 4\" stroke-opacity=\"0.7\"/>"
            );
            word(text, name, (end + 5.0, y + 0.35 * self.look.text), self.look.text, "start");
        }
    }

    /// Words in the plot, with a white edge over what is below them.
    fn notes(&self, text: &mut String) {
        let size = self.look.text;
        for note in &self.chart.notes {
            let Some((x, y)) = self.px(note.at) else { continue };
            let y = y + 0.35 * size;
            let words = escape(&note.text);
            let _ = writeln!(
                text,
                "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{size}\" text-anchor=\"middle\" stroke=\"white\" stroke-width=\"3\" \
                 stroke-linejoin=\"round\">{words}</text>"
            );
            word(text, &note.text, (x, y), size, "middle");
        }
    }

    /// Caption and names of the axes.
    fn words(&self, text: &mut String) {
        let [left, top, width, height] = self.plot;
        let (middle, size) = ((left + 0.5 * width, top + 0.5 * height), self.look.text);
        let whole = self.chart.size().0;
        // A long caption is smaller.
        let fits = |words: &str, size: f64, room: f64| size * (room / width_of(words, size)).min(1.0);
        let title = fits(&self.chart.title, self.look.title, whole - 12.0);
        let half = 0.5 * width_of(&self.chart.title, title);
        let x = middle.0.clamp(half, (whole - half).max(half));
        word(text, &self.chart.title, (x, 0.65 * top), title, "middle");
        let at = (middle.0, top + height + self.look.margins[3] - 0.6 * size);
        word(text, &self.chart.x, at, fits(&self.chart.x, size, whole - 12.0), "middle");
        let (x, y) = (0.35 * size + size, middle.1);
        let _ = writeln!(text, "<g transform=\"rotate(-90 {x:.2} {y:.2})\">");
        word(text, &self.chart.y, (x, y), fits(&self.chart.y, size, top + height + 20.0), "middle");
        text.push_str("</g>\n");
    }
}
