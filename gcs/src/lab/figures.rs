//! Pictures of flights: the path over the blockage field, transmit power marked (the paper's Fig. 4).

use std::path::Path;

use anyhow::{Context, Result, anyhow};
use plotters::prelude::*;
use sitl::Scenario;
use sitl::msg::TxPower;
use sitl::record::Record;
use sitl::world::channel;

/// Cells of the blockage field along each side.
const CELLS: usize = 100;
const LOW: RGBColor = RGBColor(31, 119, 180);
const HIGH: RGBColor = RGBColor(214, 39, 40);

/// Makes the font known to the plotting library, once.
fn font() -> Result<()> {
    static FONT: std::sync::OnceLock<bool> = std::sync::OnceLock::new();
    let known = *FONT.get_or_init(|| {
        plotters::style::register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular()).is_ok()
    });
    if known { Ok(()) } else { Err(anyhow!("the built-in font is not a font")) }
}

/// Draws the flight as `path.svg` and `path.png` in `dir`.
pub fn path(dir: &Path, title: &str, records: &[Record], scenario: &Scenario) -> Result<()> {
    font()?;
    let size = (760, 800);
    let svg = dir.join("path.svg");
    draw(SVGBackend::new(&svg, size).into_drawing_area(), title, records, scenario)
        .with_context(|| format!("drawing {}", svg.display()))?;
    let png = dir.join("path.png");
    draw(BitMapBackend::new(&png, size).into_drawing_area(), title, records, scenario)
        .with_context(|| format!("drawing {}", png.display()))
}

fn draw<B: DrawingBackend>(
    area: DrawingArea<B, plotters::coord::Shift>,
    title: &str,
    records: &[Record],
    scenario: &Scenario,
) -> Result<()> {
    let failed = |e: DrawingAreaErrorKind<B::ErrorType>| anyhow!("{e}");
    area.fill(&WHITE).map_err(failed)?;
    let mut chart = ChartBuilder::on(&area)
        .caption(title, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(36)
        .y_label_area_size(44)
        .build_cartesian_2d(0.0..1.0, 0.0..1.0)
        .map_err(failed)?;
    let obstacle = records.last().map_or(scenario.obstacle.position, |r| r.obstacle);
    let cell = 1.0 / CELLS as f64;
    let field = (0..CELLS * CELLS).map(|n| {
        let (x, y) = ((n % CELLS) as f64 * cell, (n / CELLS) as f64 * cell);
        let centre = nalgebra::Vector2::new(x + 0.5 * cell, y + 0.5 * cell);
        let p = channel::blockage(centre, obstacle, scenario.obstacle.radius, &scenario.channel);
        let grey = (255.0 - 105.0 * p) as u8;
        Rectangle::new([(x, y), (x + cell, y + cell)], RGBColor(grey, grey, grey).filled())
    });
    chart.draw_series(field).map_err(failed)?;
    chart.configure_mesh().disable_mesh().x_desc("x (east)").y_desc("y (north)").draw().map_err(failed)?;

    let disc = |r: nalgebra::Vector2<f64>, radius: f64| {
        let points = (0..=72).map(|n| {
            let angle = f64::from(n) * std::f64::consts::TAU / 72.0;
            (r.x + radius * angle.cos(), r.y + radius * angle.sin())
        });
        points.collect::<Vec<_>>()
    };
    let body = disc(obstacle, scenario.obstacle.radius);
    chart.draw_series([Polygon::new(body, RGBColor(70, 90, 140).mix(0.8))]).map_err(failed)?;
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
        .map_err(failed)?;
    area.present().map_err(failed)
}
