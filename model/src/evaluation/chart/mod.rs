//! Figures: charts of series with bands, levels, areas and marks, readable in grey print, with their
//! legends below the plot. Knows nothing of what it shows.
//!
//! | module | what it is |
//! |---|---|
//! | `ranges` | what part of each axis is shown, and its ticks |
//! | `marks` | the mark of each series |
//! | `draw` | a chart, or several on one sheet, as SVG |
//! | `files` | PDF and PNG from that SVG, the numbers as CSV, and a script that draws them again |

mod draw;
mod files;
mod marks;
mod ranges;

use std::path::PathBuf;

pub use draw::{SvgText, letter_share, svg};
pub use files::{ENDINGS, save};

/// A figure could not be drawn or written.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {message}")]
pub struct PlotError {
    /// The file.
    pub path: PathBuf,
    /// Why.
    pub message: String,
}

/// Charts of one size beside and below each other, with one legend for all.
#[derive(Debug, Clone, Copy)]
pub struct Sheet<'a> {
    /// Row by row.
    pub charts: &'a [Chart],
    /// Charts a row, at most.
    pub columns: usize,
}

impl<'a> From<&'a Chart> for Sheet<'a> {
    fn from(chart: &'a Chart) -> Self {
        Self { charts: std::slice::from_ref(chart), columns: 1 }
    }
}

/// Red, green and blue.
pub type Ink = [u8; 3];

/// Colours that stay apart in print and for most colour-blind eyes (Okabe and Ito).
pub const COLOURS: [Ink; 8] = [
    [0, 114, 178],
    [0, 158, 115],
    [230, 159, 0],
    [213, 94, 0],
    [204, 121, 167],
    [86, 180, 233],
    [110, 80, 50],
    [90, 90, 90],
];

/// The nth of [`COLOURS`] as SVG and CSS name it, from the first again after the last.
#[must_use]
pub fn colour(n: usize) -> String {
    rgb(COLOURS[n % COLOURS.len()])
}

fn rgb([r, g, b]: Ink) -> String {
    format!("rgb({r},{g},{b})")
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Style {
    /// A line with a few marks of the series' own shape.
    #[default]
    Line,
    /// A line with a mark at every point.
    Dotted,
    /// A dashed line with a few marks.
    Dashed,
    /// A thin line without marks.
    Thin,
    /// A closed outline, filled.
    Area,
    /// Crosses.
    Cross,
    /// Filled discs.
    Dot,
    /// Small hollow circles.
    Ring,
    /// Large hollow diamonds: what others report.
    Diamond,
    /// Filled triangles.
    Triangle,
    /// Filled squares.
    Square,
}

impl Style {
    /// Whether points are joined.
    fn joins(self) -> bool {
        matches!(self, Self::Line | Self::Dotted | Self::Dashed | Self::Thin | Self::Area)
    }

    /// Its name in the CSV.
    fn key(self) -> &'static str {
        match self {
            Self::Line => "line",
            Self::Dotted => "dotted",
            Self::Dashed => "dashed",
            Self::Thin => "thin",
            Self::Area => "area",
            Self::Cross => "cross",
            Self::Dot => "dot",
            Self::Ring => "ring",
            Self::Diamond => "diamond",
            Self::Triangle => "triangle",
            Self::Square => "square",
        }
    }
}

/// One set of points.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// Name in the legend; empty: not listed.
    pub name: String,
    /// Index of its colour in [`COLOURS`], and of its mark's shape.
    pub colour: usize,
    /// Its colour, if it is none of these.
    pub ink: Option<Ink>,
    /// How it is drawn.
    pub style: Style,
    /// (x, y) in the chart's units, x ascending where they are joined to a curve.
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

    /// The same points in another colour.
    #[must_use]
    pub fn inked(self, ink: Ink) -> Self {
        Self { ink: Some(ink), ..self }
    }

    /// Its colour as SVG names it.
    fn rgb(&self) -> String {
        self.ink.map_or_else(|| colour(self.colour), rgb)
    }
}

/// Words at a place of the plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Note {
    /// What is said.
    pub text: String,
    /// Where the middle of the words stands, in the chart's units.
    pub at: (f64, f64),
}

/// Whether the names of the series stand below the plot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Legend {
    /// They stand nowhere.
    None,
    /// Below.
    #[default]
    Below,
}

/// A chart of several series.
#[derive(Debug, Clone, Default)]
pub struct Chart {
    /// Caption.
    pub title: String,
    /// What one sees, in a sentence or two, for those who do not see it; empty: the title says it.
    pub alt: String,
    /// Name, symbol and unit of the abscissa.
    pub x: String,
    /// Name, symbol and unit of the ordinate.
    pub y: String,
    /// Range of x; the points' if `None`.
    pub x_range: Option<[f64; 2]>,
    /// Range of y; the points' if `None`, and from 0 on a linear axis.
    pub y_range: Option<[f64; 2]>,
    /// Whether x is logarithmic.
    pub log_x: bool,
    /// Whether y is logarithmic.
    pub log_y: bool,
    /// Whether the plot is a square.
    pub square: bool,
    /// Whether the names of the series are told.
    pub legend: Legend,
    /// Whether it is one of several panels.
    pub panel: bool,
    /// What is drawn: areas below lines, lines below marks, and of each kind the earlier over the later.
    pub series: Vec<Series>,
    /// Horizontal dashed lines with their names.
    pub levels: Vec<(String, f64)>,
    /// Words in the plot.
    pub notes: Vec<Note>,
}

impl Chart {
    /// What one sees, for those who do not: `alt`, or title, axes and series.
    #[must_use]
    pub fn description(&self) -> String {
        if !self.alt.is_empty() {
            return self.alt.clone();
        }
        let mut names: Vec<&str> = self.series.iter().map(|s| s.name.as_str()).collect();
        names.retain(|name| !name.is_empty());
        let mut text = format!("{}: {} over {}", self.title, self.y, self.x);
        if !names.is_empty() {
            text += &format!("; {}", names.join(", "));
        }
        text + "."
    }
}

#[cfg(test)]
mod tests;
