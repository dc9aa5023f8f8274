//! Pictures of flights: the path over the blockage field, transmit power marked (the paper's Fig. 4).

use crpl_model::evaluation::chart::Figure;
use crpl_sitl::Scenario;
use crpl_sitl::camera::COLOURS;
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::TxPower;
use crpl_sitl::world::World;
use crpl_sitl::world::obstacles::Obstacles;
use nalgebra::Vector2;
use plotters::coord::Shift;
use plotters::prelude::*;

/// Cells of the blockage field along each side.
const CELLS: usize = 100;
const LOW: RGBColor = RGBColor(31, 119, 180);
/// Obstacles as the camera tells them apart; further ones have the first colour.
const BODIES: [RGBColor; COLOURS] = [RGBColor(70, 90, 140), RGBColor(70, 130, 90)];
const HIGH: RGBColor = RGBColor(214, 39, 40);

/// An obstacle that goes no further stands: what the wire's widths leave, and more.
const STILL: f64 = 1e-3;
/// Greys that tell blockage probabilities apart.
const GREYS: f64 = 21.0;

/// A flight to draw.
#[derive(Debug, Clone)]
pub struct FlightPath<'a> {
    /// Over the picture.
    pub title: String,
    /// The flight.
    pub records: &'a [Record],
    /// Where it took place.
    pub scenario: &'a Scenario,
    /// Width and height, px: [`FlightPath::ALONE`] or [`FlightPath::PANEL`].
    pub size: (u32, u32),
}

impl FlightPath<'_> {
    /// A picture of its own.
    pub const ALONE: (u32, u32) = (760, 800);
    /// One beside others.
    pub const PANEL: (u32, u32) = (440, 440);
}

impl Figure for FlightPath<'_> {
    fn size(&self) -> (u32, u32) {
        self.size
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        draw(area, &self.title, self.records, self.scenario)
    }
}

fn draw<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    records: &[Record],
    scenario: &Scenario,
) -> Result<(), String> {
    let failed = |e: DrawingAreaErrorKind<B::ErrorType>| e.to_string();
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(36)
        .y_label_area_size(44)
        .build_cartesian_2d(0.0..1.0, 0.0..1.0)
        .map_err(failed)?;
    let obstacles = records.last().map_or_else(|| World::new(scenario).obstacles(), |r| r.obstacles);
    chart.draw_series(shadow(&obstacles, scenario)).map_err(failed)?;
    chart.configure_mesh().disable_mesh().x_desc("x (east)").y_desc("y (north)").draw().map_err(failed)?;

    let disc = |r: Vector2<f64>, radius: f64| {
        let points = (0..=72).map(|n| {
            let angle = f64::from(n) * std::f64::consts::TAU / 72.0;
            (r.x + radius * angle.cos(), r.y + radius * angle.sin())
        });
        points.collect::<Vec<_>>()
    };
    let bodies = obstacles.each(scenario).enumerate();
    let bodies = bodies.map(|(n, (centre, o))| Polygon::new(disc(centre, o.radius), body(n).mix(0.8)));
    chart.draw_series(bodies).map_err(failed)?;
    for (track, radius, colour) in tracks(records, scenario) {
        let met = nearest(records, &track).map(|at| disc(at, radius)).unwrap_or_default();
        chart.draw_series([PathElement::new(met, colour.stroke_width(2))]).map_err(failed)?;
        let line: Vec<_> = track.iter().map(|r| (r.x, r.y)).collect();
        chart
            .draw_series([PathElement::new(line, colour.stroke_width(1))])
            .map_err(failed)?
            .label("obstacle's way; where it was nearest")
            .legend(move |at| Circle::new(at, 5, colour.stroke_width(2)));
    }
    let goal = disc(scenario.goal, scenario.goal_radius);
    chart.draw_series([PathElement::new(goal, GREEN.stroke_width(2))]).map_err(failed)?;
    let bs = (scenario.channel.base_station.x, scenario.channel.base_station.y);
    chart.draw_series([TriangleMarker::new(bs, 9, BLACK.filled())]).map_err(failed)?;
    let label = ("sans-serif", 15).into_font();
    let words = [
        ("base station", (bs.0 + 0.02, bs.1 + 0.015)),
        ("goal", (scenario.goal.x - 0.02, scenario.goal.y - 0.065)),
    ];
    chart.draw_series(words.map(|(word, at)| Text::new(word, at, label.clone()))).map_err(failed)?;

    let start = records.first().map(|r| (r.r.x, r.r.y));
    let line: Vec<(f64, f64)> =
        start.into_iter().chain(records.iter().map(|r| (r.r_next.x, r.r_next.y))).collect();
    chart.draw_series([PathElement::new(line, BLACK.mix(0.6).stroke_width(1))]).map_err(failed)?;
    for (power, colour, name) in [(TxPower::Low, LOW, "low power"), (TxPower::High, HIGH, "high power")] {
        let marks = records
            .iter()
            .filter(|r| r.power == power)
            .map(|r| Circle::new((r.r.x, r.r.y), 3, colour.filled()));
        chart
            .draw_series(marks)
            .map_err(failed)?
            .label(name)
            .legend(move |at| Circle::new(at, 4, colour.filled()));
    }
    let outages =
        records.iter().filter(|r| r.outage).map(|r| Cross::new((r.r.x, r.r.y), 5, BLACK.stroke_width(2)));
    chart
        .draw_series(outages)
        .map_err(failed)?
        .label("outage")
        .legend(|at| Cross::new(at, 4, BLACK.stroke_width(2)));
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.4))
        .draw()
        .map_err(failed)
}

/// The centres of each obstacle that moves, interval by interval, with its radius and colour.
fn tracks(records: &[Record], scenario: &Scenario) -> Vec<(Vec<Vector2<f64>>, f64, RGBColor)> {
    let track = |n: usize| records.iter().filter_map(|r| r.obstacles.get(n).copied()).collect();
    let all = scenario.obstacles.iter().enumerate().map(|(n, o)| (track(n), o.radius, body(n)));
    let moves = |(track, ..): &(Vec<Vector2<f64>>, f64, RGBColor)| {
        track.first().is_some_and(|first| track.iter().any(|r| (r - first).norm() > STILL))
    };
    all.filter(moves).collect()
}

/// Colour of the obstacle with this index.
fn body(index: usize) -> RGBColor {
    BODIES.get(index).copied().unwrap_or(BODIES[0])
}

/// Where an obstacle with this track was when the UAV came nearest to it.
fn nearest(records: &[Record], track: &[Vector2<f64>]) -> Option<Vector2<f64>> {
    let pairs = records.iter().map(|r| r.r_next).zip(track);
    pairs.min_by(|a, b| (a.0 - a.1).norm().total_cmp(&(b.0 - b.1).norm())).map(|(_, at)| *at)
}

/// The blockage field: neighbours of one grey in a row are one rectangle, and where nothing is blocked
/// there is none.
fn shadow(obstacles: &Obstacles, scenario: &Scenario) -> Vec<Rectangle<(f64, f64)>> {
    let cell = 1.0 / CELLS as f64;
    let level = |column: usize, row: usize| {
        let centre = Vector2::new(column as f64 + 0.5, row as f64 + 0.5) * cell;
        let p = obstacles.blockage(centre, scenario);
        (p * (GREYS - 1.0)).round()
    };
    let mut rectangles = Vec::new();
    for row in 0..CELLS {
        let mut begin = 0;
        while begin < CELLS {
            let grey = level(begin, row);
            let end = (begin..CELLS).find(|column| level(*column, row) != grey).unwrap_or(CELLS);
            if grey > 0.0 {
                let corners = [(begin, row), (end, row + 1)].map(|(x, y)| (x as f64 * cell, y as f64 * cell));
                let shade = (255.0 - 105.0 * grey / (GREYS - 1.0)) as u8;
                rectangles.push(Rectangle::new(corners, RGBColor(shade, shade, shade).filled()));
            }
            begin = end;
        }
    }
    rectangles
}
