//! A scenario drawn: in the terminal by characters, and as a picture.

use std::fmt::Write;

use crpl_model::evaluation::chart::{Chart, Ink, Series, Style};
use crpl_sitl::{Scenario, program};
use nalgebra::Vector2;

use super::field::{PowerReach, RadioField};
use crate::lab::figures;

/// Characters along x where there is room, and at least; along y half of them, as a character is twice as high as wide.
const COLUMNS: usize = 72;
const LEAST: usize = 24;
/// Characters beside them.
const FRAME: usize = 7;

/// What the characters mean, at most 80 columns a line.
const KEY: &str = "S start  G goal  B base station  # obstacle\n\
                   . in an obstacle's shadow, low power still reaches\n\
                   - low power fails, high power reaches   = no power reaches\n";

/// The world by characters, at most `width` of them in a line: north is up, east is right.
#[must_use]
pub fn text(scenario: &Scenario, width: Option<usize>) -> String {
    let field = RadioField::of(scenario);
    let columns = width.map_or(COLUMNS, |width| width.saturating_sub(FRAME).clamp(LEAST, COLUMNS));
    let grid = Grid { columns, rows: columns / 2 };
    let mut rows: Vec<Vec<char>> = (0..grid.rows)
        .map(|row| (0..columns).map(|column| glyph(&field, grid.place(column, row))).collect())
        .collect();
    for (at, mark) in [(scenario.channel.base_station, 'B'), (scenario.goal, 'G'), (scenario.start, 'S')] {
        let (column, row) = grid.cell(at);
        rows[row][column] = mark;
    }
    let mut out = format!("   1 +{}+\n", "-".repeat(columns));
    for (n, row) in rows.iter().enumerate() {
        let label = if n == grid.rows / 2 { "y" } else { "" };
        let _ = writeln!(out, "{label:>4} |{}|", row.iter().collect::<String>());
    }
    let _ = writeln!(out, "   0 +{}+", "-".repeat(columns));
    let _ = writeln!(out, "     0{:^columns$}1", "x");
    out + &program::columns::wrapped(KEY, 2, width)
}

/// The characters of a drawing.
struct Grid {
    columns: usize,
    rows: usize,
}

impl Grid {
    fn place(&self, column: usize, row: usize) -> Vector2<f64> {
        let part = |n: usize, of: usize| (n as f64 + 0.5) / of as f64;
        Vector2::new(part(column, self.columns), 1.0 - part(row, self.rows))
    }

    fn cell(&self, place: Vector2<f64>) -> (usize, usize) {
        let index = |part: f64, of: usize| ((part * of as f64) as usize).min(of - 1);
        (index(place.x, self.columns), index(1.0 - place.y, self.rows))
    }
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

/// Where low power fails, and where high power does too.
const FAILS: [(&str, PowerReach, Ink); 2] = [
    ("high power fails, too", PowerReach::Nothing, [190, 120, 110]),
    ("low power fails", PowerReach::High, [240, 200, 120]),
];

/// The world as a picture.
#[must_use]
pub fn picture(scenario: &Scenario) -> Chart {
    Chart {
        alt: format!(
            "{}: start, goal, base station and obstacles over the radio's shadow, and where each power fails.",
            scenario.name
        ),
        ..chart(scenario, scenario.name.clone(), Vec::new())
    }
}

/// The world under what is drawn on it.
#[must_use]
pub fn chart(scenario: &Scenario, title: String, mut series: Vec<Series>) -> Chart {
    let field = RadioField::of(scenario);
    let at = |r: Vector2<f64>| vec![(r.x, r.y)];
    let black: Ink = [20, 20, 20];
    series.push(Series::line("start", 0, at(scenario.start)).styled(Style::Dot).inked(black));
    series.push(
        Series::line("base station", 7, at(scenario.channel.base_station))
            .styled(Style::Triangle)
            .inked(black),
    );
    series.extend(figures::surroundings(scenario, &field.obstacles));
    for (name, least, ink) in FAILS {
        let fails = |place| f64::from(u8::from(field.reach(place) >= least));
        series.extend(figures::areas(name, ink, 0.5, fails));
    }
    series.extend(figures::shadow(&field.obstacles, scenario));
    let unit = format!("field widths of {:.0} m", scenario.scale.metres_per_unit);
    Chart {
        title,
        x: format!("east x, {unit}"),
        y: format!("north y, {unit}"),
        x_range: Some([0.0, 1.0]),
        y_range: Some([0.0, 1.0]),
        square: true,
        series,
        ..Chart::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_drawing_has_its_marks_and_fits_the_terminal() {
        let scenario = Scenario::named("narrow").unwrap();
        let marks = |width: Option<usize>| {
            let drawn = text(&scenario, width);
            let least = width.unwrap_or(80);
            assert!(drawn.lines().all(|line| line.chars().count() <= least), "{drawn}");
            let rows: Vec<&str> = drawn.lines().skip(1).take_while(|line| line.ends_with('|')).collect();
            let at = |mark: char| rows.iter().position(|line| line.contains(mark)).unwrap();
            // North is up.
            let grid = Grid { columns: 2 * rows.len(), rows: rows.len() };
            assert_eq!(grid.cell(scenario.channel.base_station).1, at('B'));
            assert!(at('#') < at('B') && (drawn.contains('=') || drawn.contains('-')));
            rows.len()
        };
        assert_eq!([None, Some(80), Some(60), Some(40)].map(marks), [36, 36, 26, 16]);
    }
}
