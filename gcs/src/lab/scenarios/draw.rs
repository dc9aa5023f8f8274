//! A scenario drawn: in the terminal by characters, and as a picture.

use std::fmt::Write;

use crpl_model::evaluation::chart::Figure;
use crpl_sitl::Scenario;
use nalgebra::Vector2;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use super::field::{PowerReach, RadioField};

/// Characters along x and y: a character is twice as high as wide.
const COLUMNS: usize = 72;
const ROWS: usize = 36;
/// Cells of the picture along each side.
const CELLS: usize = 100;

/// What the characters mean, at most 80 columns a line.
const KEY: &str = "S start  G goal  B base station  # obstacle\n\
                   . in an obstacle's shadow, low power still reaches\n\
                   - low power fails, high power reaches   = no power reaches\n";

/// The world by characters: north is up, east is right.
#[must_use]
pub fn text(scenario: &Scenario) -> String {
    let field = RadioField::of(scenario);
    let mut rows: Vec<Vec<char>> =
        (0..ROWS).map(|row| (0..COLUMNS).map(|column| glyph(&field, place(column, row))).collect()).collect();
    for (at, mark) in [(scenario.channel.base_station, 'B'), (scenario.goal, 'G'), (scenario.start, 'S')] {
        let (column, row) = cell(at);
        rows[row][column] = mark;
    }
    let mut out = format!("   1 +{}+\n", "-".repeat(COLUMNS));
    for (n, row) in rows.iter().enumerate() {
        let label = if n == ROWS / 2 { "y" } else { "" };
        let _ = writeln!(out, "{label:>4} |{}|", row.iter().collect::<String>());
    }
    let _ = writeln!(out, "   0 +{}+", "-".repeat(COLUMNS));
    let _ = writeln!(out, "     0{:^width$}1", "x", width = COLUMNS);
    out + KEY
}

fn place(column: usize, row: usize) -> Vector2<f64> {
    let part = |n: usize, of: usize| (n as f64 + 0.5) / of as f64;
    Vector2::new(part(column, COLUMNS), 1.0 - part(row, ROWS))
}

fn cell(place: Vector2<f64>) -> (usize, usize) {
    let index = |part: f64, of: usize| ((part * of as f64) as usize).min(of - 1);
    (index(place.x, COLUMNS), index(1.0 - place.y, ROWS))
}

fn glyph(field: &RadioField<'_>, at: Vector2<f64>) -> char {
    match field.reach(at) {
        _ if field.obstacle_at(at).is_some() => '#',
        PowerReach::Nothing => '=',
        PowerReach::High => '-',
        PowerReach::Low if field.is_shadow(at) => '.',
        PowerReach::Low => ' ',
    }
}

/// The world as a picture.
#[derive(Debug)]
pub struct WorldPicture<'a>(pub &'a Scenario);

impl WorldPicture<'_> {
    const SHADOW: RGBColor = RGBColor(225, 225, 225);
    const HIGH: RGBColor = RGBColor(240, 200, 120);
    const NOTHING: RGBColor = RGBColor(190, 120, 110);

    /// One rectangle for the neighbours of one kind in a row.
    fn cells(&self, kind: impl Fn(Vector2<f64>) -> bool, colour: RGBColor) -> Vec<Rectangle<(f64, f64)>> {
        let side = 1.0 / CELLS as f64;
        let is = |column: usize, row: usize| kind(Vector2::new(column as f64 + 0.5, row as f64 + 0.5) * side);
        let mut found = Vec::new();
        for row in 0..CELLS {
            let mut begin = 0;
            while begin < CELLS {
                let here = is(begin, row);
                let end = (begin..CELLS).find(|column| is(*column, row) != here).unwrap_or(CELLS);
                if here {
                    let corners =
                        [(begin, row), (end, row + 1)].map(|(x, y)| (x as f64 * side, y as f64 * side));
                    found.push(Rectangle::new(corners, colour.filled()));
                }
                begin = end;
            }
        }
        found
    }
}

fn disc(centre: Vector2<f64>, radius: f64) -> Vec<(f64, f64)> {
    let points = (0..=72).map(|n| f64::from(n) * std::f64::consts::TAU / 72.0);
    points.map(|angle| (centre.x + radius * angle.cos(), centre.y + radius * angle.sin())).collect()
}

/// Tells whether a place is of a kind.
type PlaceTest<'a> = &'a dyn Fn(Vector2<f64>) -> bool;

/// A chart of the unit square.
pub type SquareChart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

impl Figure for WorldPicture<'_> {
    fn size(&self) -> (u32, u32) {
        (760, 800)
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        Self::finish(&mut self.chart(area)?)
    }
}

impl WorldPicture<'_> {
    /// The world without its legend, for who draws on it.
    ///
    /// # Errors
    /// If the backend fails.
    pub fn chart<'b, B: DrawingBackend>(
        &self,
        area: &'b DrawingArea<B, Shift>,
    ) -> Result<SquareChart<'b, B>, String> {
        let scenario = self.0;
        let failed = |e: DrawingAreaErrorKind<B::ErrorType>| e.to_string();
        let mut chart = ChartBuilder::on(area)
            .caption(&scenario.name, ("sans-serif", 20))
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(44)
            .build_cartesian_2d(0.0..1.0, 0.0..1.0)
            .map_err(failed)?;
        let field = RadioField::of(scenario);
        let layers: [(PlaceTest<'_>, RGBColor, &str); 3] = [
            (&|at| field.is_shadow(at), Self::SHADOW, "obstacle's shadow"),
            (&|at| field.reach(at) == PowerReach::High, Self::HIGH, "low power fails"),
            (&|at| field.reach(at) == PowerReach::Nothing, Self::NOTHING, "high power fails, too"),
        ];
        for (kind, colour, name) in layers {
            let cells = self.cells(kind, colour);
            if !cells.is_empty() {
                let key = move |(x, y)| Rectangle::new([(x, y - 5), (x + 10, y + 5)], colour.filled());
                chart.draw_series(cells).map_err(failed)?.label(name).legend(key);
            }
        }
        chart
            .configure_mesh()
            .disable_mesh()
            .x_desc("x (east)")
            .y_desc("y (north)")
            .draw()
            .map_err(failed)?;
        let bodies = field.obstacles.each(scenario);
        let bodies =
            bodies.map(|(centre, o)| Polygon::new(disc(centre, o.radius), RGBColor(70, 90, 140).filled()));
        chart.draw_series(bodies).map_err(failed)?;
        let line = [scenario.start, scenario.goal].map(|r| (r.x, r.y));
        chart.draw_series([PathElement::new(line, BLACK.mix(0.5).stroke_width(1))]).map_err(failed)?;
        let goal = disc(scenario.goal, scenario.goal_radius);
        chart.draw_series([PathElement::new(goal, BLACK.stroke_width(2))]).map_err(failed)?;
        let bs = (scenario.channel.base_station.x, scenario.channel.base_station.y);
        chart.draw_series([TriangleMarker::new(bs, 9, BLACK.filled())]).map_err(failed)?;
        chart.draw_series([Circle::new(line[0], 5, BLACK.filled())]).map_err(failed)?;
        let font = ("sans-serif", 15).into_font();
        let words = [("base station", bs), ("start", line[0]), ("goal", line[1])];
        let words = words.map(|(word, (x, y))| {
            let x = if x > 0.8 { x - 0.12 } else { x + 0.015 };
            Text::new(word, (x, if y < 0.9 { y + 0.05 } else { y - 0.03 }), font.clone())
        });
        chart.draw_series(words).map_err(failed)?;
        Ok(chart)
    }

    /// Draws the legend.
    ///
    /// # Errors
    /// If the backend fails.
    pub fn finish<'b, B: DrawingBackend + 'b>(chart: &mut SquareChart<'b, B>) -> Result<(), String> {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.85))
            .border_style(BLACK.mix(0.4))
            .draw()
            .map_err(|e: DrawingAreaErrorKind<B::ErrorType>| e.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_drawing_has_its_marks_and_fits_80_columns() {
        let scenario = Scenario::named("narrow").unwrap();
        let drawn = text(&scenario);
        assert!(drawn.lines().all(|line| line.chars().count() <= 80), "{drawn}");
        let lines: Vec<&str> = drawn.lines().collect();
        let at = |mark: char| lines[1..=ROWS].iter().position(|line| line.contains(mark)).unwrap();
        // North is up.
        let (obstacle, base) = (at('#'), scenario.channel.base_station.y);
        assert!(obstacle < ROWS && cell(scenario.channel.base_station).1 == at('B'), "{base}");
        assert!(drawn.contains('=') || drawn.contains('-'));
    }
}
