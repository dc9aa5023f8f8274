//! Line charts: curves with bands, levels and marks, as SVG and PNG. Knows nothing of what it shows.

use std::path::Path;

use anyhow::{Context, Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;

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

/// Width and height of one panel, px.
pub const PANEL: (u32, u32) = (460, 330);

/// A curve.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Its name in the legend.
    pub name: String,
    /// Its colour.
    pub colour: RGBColor,
    /// (x, y), x ascending.
    pub points: Vec<(f64, f64)>,
    /// (x, low, high) of the band around it; empty for none.
    pub band: Vec<(f64, f64, f64)>,
    /// Whether every point is marked.
    pub dots: bool,
}

/// A panel.
#[derive(Debug, Clone, Default)]
pub struct Panel {
    /// Over it.
    pub title: String,
    /// Under it.
    pub x: String,
    /// The curves.
    pub curves: Vec<Curve>,
    /// Horizontal dashed lines with their names.
    pub levels: Vec<(String, f64)>,
    /// Hollow marks: colour, x, y.
    pub marks: Vec<(RGBColor, f64, f64)>,
    /// Whether it explains its colours.
    pub legend: bool,
}

impl Panel {
    /// Ranges of x and y: all that is drawn, y from 0 or below.
    fn ranges(&self) -> (std::ops::Range<f64>, std::ops::Range<f64>) {
        let (mut x, mut y) = ((f64::INFINITY, f64::NEG_INFINITY), (0.0_f64, f64::NEG_INFINITY));
        let mut see = |at: f64, value: f64| {
            if at.is_finite() && value.is_finite() {
                x = (x.0.min(at), x.1.max(at));
                y = (y.0.min(value), y.1.max(value));
            }
        };
        for curve in &self.curves {
            curve.points.iter().for_each(|(at, value)| see(*at, *value));
            curve
                .band
                .iter()
                .for_each(|(at, low, high)| [*low, *high].iter().for_each(|v| see(*at, v.max(0.0))));
        }
        self.marks.iter().for_each(|(_, at, value)| see(*at, *value));
        let top = self.levels.iter().fold(y.1, |top, (_, level)| top.max(*level));
        let (x, top) = if x.0 > x.1 { ((0.0, 1.0), 1.0) } else { (x, top) };
        let wide = (x.1 - x.0).max(1e-9);
        let high = (top - y.0).max(1e-9);
        let bottom = if y.0 < 0.0 { y.0 - 0.05 * high } else { 0.0 };
        (x.0 - 0.03 * wide..x.1 + 0.03 * wide, bottom..y.0 + 1.08 * high)
    }

    /// Draws it on an area of any size.
    pub fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<()> {
        let failed = |e: DrawingAreaErrorKind<B::ErrorType>| anyhow!("{e}");
        let (x, y) = self.ranges();
        let (x_decimals, y_decimals) = (decimals(&x), decimals(&y));
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", 16))
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(x.clone(), y.clone())
            .map_err(failed)?;
        chart
            .configure_mesh()
            .x_labels(8)
            .y_labels(6)
            .x_desc(&self.x)
            .label_style(("sans-serif", 13))
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.1))
            .x_label_formatter(&|v| format!("{v:.x_decimals$}"))
            .y_label_formatter(&|v| format!("{v:.y_decimals$}"))
            .draw()
            .map_err(failed)?;
        for (name, level) in &self.levels {
            let line = [(x.start, *level), (x.end, *level)];
            chart.draw_series(DashedLineSeries::new(line, 6, 4, BLACK.mix(0.7).into())).map_err(failed)?;
            let at = (x.start + 0.01 * (x.end - x.start), *level + 0.055 * (y.end - y.start));
            chart.draw_series([Text::new(name.clone(), at, ("sans-serif", 13))]).map_err(failed)?;
        }
        // The first curve lies on top.
        for curve in self.curves.iter().rev() {
            let colour = curve.colour;
            let there = curve.band.iter().map(|(x, low, _)| (*x, low.max(y.start)));
            let back = curve.band.iter().rev().map(|(x, _, high)| (*x, *high));
            let outline: Vec<_> = there.chain(back).collect();
            if !outline.is_empty() {
                chart.draw_series([Polygon::new(outline, colour.mix(0.15))]).map_err(failed)?;
            }
            let line = LineSeries::new(curve.points.iter().copied(), colour.stroke_width(2));
            chart.draw_series(line).map_err(failed)?;
            if curve.dots {
                let dots = curve.points.iter().map(|at| Circle::new(*at, 3, colour.filled()));
                chart.draw_series(dots).map_err(failed)?;
            }
        }
        let hollow = self.marks.iter().map(|(colour, x, y)| Circle::new((*x, *y), 6, colour.stroke_width(2)));
        chart.draw_series(hollow).map_err(failed)?;
        if self.legend {
            for curve in &self.curves {
                let colour = curve.colour;
                chart
                    .draw_series(LineSeries::new(std::iter::empty(), colour))
                    .map_err(failed)?
                    .label(&curve.name)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
            }
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperRight)
                .label_font(("sans-serif", 13))
                .background_style(WHITE.mix(0.85))
                .border_style(BLACK.mix(0.3))
                .draw()
                .map_err(failed)?;
        }
        Ok(())
    }

    /// As the text of an SVG picture.
    pub fn svg(&self) -> Result<String> {
        svg(PANEL, |area| self.draw(area))
    }
}

/// Decimals that tell the ticks of a range apart.
fn decimals(range: &std::ops::Range<f64>) -> usize {
    let step = (range.end - range.start) / 6.0;
    (-step.log10()).ceil().clamp(0.0, 6.0) as usize
}

/// Several panels as one picture, `NAME.svg` and `NAME.png` in `dir`.
pub fn save(dir: &Path, name: &str, panels: &[Panel], columns: usize) -> Result<()> {
    let columns = columns.clamp(1, panels.len().max(1));
    let rows = panels.len().div_ceil(columns).max(1);
    let size = (PANEL.0 * columns as u32, PANEL.1 * rows as u32);
    let path = dir.join(format!("{name}.svg"));
    let text = svg(size, |area| grid(area, panels, (rows, columns)))?;
    std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
    png(&dir.join(format!("{name}.png")), size, |area| grid(area, panels, (rows, columns)))
}

fn grid<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    panels: &[Panel],
    cells: (usize, usize),
) -> Result<()> {
    area.split_evenly(cells).iter().zip(panels).try_for_each(|(cell, panel)| panel.draw(cell))
}

/// Draws on a white page into the text of an SVG picture that takes the width it is given.
pub fn svg(
    size: (u32, u32),
    draw: impl FnOnce(&DrawingArea<SVGBackend<'_>, Shift>) -> Result<()>,
) -> Result<String> {
    super::figures::font()?;
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        area.fill(&WHITE).map_err(|e| anyhow!("{e}"))?;
        draw(&area)?;
        area.present().map_err(|e| anyhow!("{e}"))?;
    }
    Ok(text)
}

/// Draws on a white page into a PNG file.
pub fn png(
    path: &Path,
    size: (u32, u32),
    draw: impl FnOnce(&DrawingArea<BitMapBackend<'_>, Shift>) -> Result<()>,
) -> Result<()> {
    super::figures::font()?;
    let area = BitMapBackend::new(path, size).into_drawing_area();
    let context = || format!("drawing {}", path.display());
    area.fill(&WHITE).map_err(|e| anyhow!("{e}")).with_context(context)?;
    draw(&area).with_context(context)?;
    area.present().map_err(|e| anyhow!("{e}")).with_context(context)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(points: Vec<(f64, f64)>) -> Panel {
        let curve = Curve { name: "c".into(), colour: COLOURS[0], points, band: Vec::new(), dots: true };
        Panel { curves: vec![curve], levels: vec![("limit".into(), 2.0)], ..Panel::default() }
    }

    #[test]
    fn everything_drawn_lies_inside() {
        let mut panel = panel(vec![(2.5, 0.5), (8.0, 1.0)]);
        panel.marks = vec![(COLOURS[1], 2.5, 3.0)];
        panel.curves[0].band = vec![(2.5, -1.0, 0.6), (8.0, 0.9, 4.0)];
        let (x, y) = panel.ranges();
        assert!(x.start < 2.5 && x.end > 8.0 && y.start == 0.0 && y.end > 4.0, "{x:?} {y:?}");
    }

    #[test]
    fn a_picture_says_what_it_shows() {
        let text = panel(vec![(0.0, 1.0), (1.0, 1.5)]).svg().unwrap();
        assert!(text.starts_with("<svg") && text.contains("limit") && text.contains("<polyline"), "{text}");
        // Nothing to show is no reason to fail.
        assert!(panel(vec![]).svg().is_ok() && panel(vec![(1.0, f64::NAN)]).svg().is_ok());
    }
}
