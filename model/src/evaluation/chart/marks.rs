//! The mark of each series: shapes, filled and hollow, that differ without colour.

use super::{Series, Style};

/// A shape around the origin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum MarkShape {
    Disc,
    Square,
    Triangle,
    Diamond,
    Cross,
}

/// The shapes of lines' marks by the index of their colour, and whether they are filled.
const SHAPES: [(MarkShape, bool); 8] = [
    (MarkShape::Disc, true),
    (MarkShape::Square, false),
    (MarkShape::Triangle, true),
    (MarkShape::Disc, false),
    (MarkShape::Square, true),
    (MarkShape::Diamond, false),
    (MarkShape::Diamond, true),
    (MarkShape::Triangle, false),
];

/// Shape, whether it is filled, and its radius in px.
fn shape_of(series: &Series) -> (MarkShape, bool, f64) {
    match series.style {
        Style::Cross => (MarkShape::Cross, false, 5.0),
        Style::Dot => (MarkShape::Disc, true, 3.6),
        Style::Ring => (MarkShape::Disc, false, 3.0),
        Style::Diamond => (MarkShape::Diamond, false, 9.0),
        Style::Triangle => (MarkShape::Triangle, true, 8.0),
        Style::Square => (MarkShape::Square, true, 2.5),
        Style::Line | Style::Dotted | Style::Dashed | Style::Thin | Style::Area => {
            let (shape, filled) = SHAPES[series.colour % SHAPES.len()];
            (shape, filled, 4.0)
        }
    }
}

/// The series' mark at a place in px, as elements of SVG. What others report has the series' own mark inside.
pub fn mark(series: &Series, at: (f64, f64)) -> String {
    let outer = drawn(series, shape_of(series), at);
    if series.style != Style::Diamond {
        return outer;
    }
    let (shape, filled) = SHAPES[series.colour % SHAPES.len()];
    outer + &drawn(series, (shape, filled, 2.8), at)
}

fn drawn(series: &Series, (shape, filled, r): (MarkShape, bool, f64), (x, y): (f64, f64)) -> String {
    let rgb = series.rgb();
    let paint = if filled {
        format!("fill=\"{rgb}\"")
    } else {
        let inside = if shape == MarkShape::Cross { "none" } else { "white" };
        format!("fill=\"{inside}\" stroke=\"{rgb}\" stroke-width=\"1.6\"")
    };
    let corners = |corners: &[(f64, f64)]| {
        let places: Vec<String> =
            corners.iter().map(|(dx, dy)| format!("{:.2} {:.2}", x + r * dx, y + r * dy)).collect();
        format!("<path d=\"M{}Z\" {paint}/>", places.join("L"))
    };
    match shape {
        MarkShape::Disc => format!("<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{r}\" {paint}/>"),
        MarkShape::Square => corners(&[(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)]),
        MarkShape::Triangle => corners(&[(0.0, -1.1), (1.0, 0.75), (-1.0, 0.75)]),
        MarkShape::Diamond => corners(&[(0.0, -1.1), (0.9, 0.0), (0.0, 1.1), (-0.9, 0.0)]),
        MarkShape::Cross => {
            let (l, t, e, b) = (x - r, y - r, x + r, y + r);
            format!("<path d=\"M{l:.2} {t:.2}L{e:.2} {b:.2}M{l:.2} {b:.2}L{e:.2} {t:.2}\" {paint}/>")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_of_lines_differ_without_colour() {
        let marks: Vec<(MarkShape, bool)> = (0..SHAPES.len())
            .map(|n| Series { colour: n, ..Series::default() })
            .map(|s| {
                let (shape, filled, _) = shape_of(&s);
                (shape, filled)
            })
            .collect();
        for (n, mark) in marks.iter().enumerate() {
            assert!(!marks[..n].contains(mark), "{n}");
        }
    }
}
