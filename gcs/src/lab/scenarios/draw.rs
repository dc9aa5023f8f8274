//! A scenario drawn: in the terminal by characters, and as a picture.

use std::fmt::Write;

use crpl_model::evaluation::chart::{Chart, Ink, Series, Style};
use crpl_sitl::Scenario;
use nalgebra::Vector2;

use super::field::{PowerReach, RadioField};
use crate::lab::figures;

/// Characters along x and y: a character is twice as high as wide.
const COLUMNS: usize = 72;
const ROWS: usize = 36;

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
