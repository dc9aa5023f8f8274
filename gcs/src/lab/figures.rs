//! Pictures of flights: the path over the radio shadow, transmit power marked (the paper's Fig. 4). All that it
//! tells is told without colour too.

mod labels;

use contour::ContourBuilder;
use crpl_model::evaluation::chart::{Chart, Ink, Note, Series, Style};
use crpl_sitl::Scenario;
use crpl_sitl::camera::COLOURS;
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::TxPower;
use crpl_sitl::world::World;
use crpl_sitl::world::obstacles::Obstacles;
use labels::Labels;
use nalgebra::Vector2;

/// Points of the shadow's grid along each side.
const GRID: usize = 201;
/// Blockage probabilities of the shadow's contours, and the greys between them.
const SHADOW: [(f64, u8); 4] = [(0.05, 232), (0.25, 214), (0.5, 194), (0.75, 172)];
const LOW: Ink = [0, 114, 178];
const HIGH: Ink = [190, 40, 30];
const BLACK: Ink = [20, 20, 20];
const GOAL: Ink = [0, 110, 60];
/// Obstacles as the camera tells them apart; further ones have the first colour.
const BODIES: [Ink; COLOURS] = [[70, 90, 140], [70, 130, 90]];

/// An obstacle that goes no further stands: what the wire's widths leave, and more.
const STILL: f64 = 1e-3;
/// Intervals between the ticks along the path, and between those that are numbered, if there is room.
const TICKS: (u64, usize) = (10, 2);

/// A flight to draw.
#[derive(Debug, Clone)]
pub struct FlightPath<'a> {
    /// Over the picture.
    pub title: String,
    /// The flight.
    pub records: &'a [Record],
    /// Where it took place.
    pub scenario: &'a Scenario,
    /// Whether it is one of several.
    pub panel: bool,
}

impl FlightPath<'_> {
    /// The flight as a figure.
    #[must_use]
    pub fn chart(&self) -> Chart {
        let Self { records, scenario, .. } = *self;
        let obstacles = records.last().map_or_else(|| World::new(scenario).obstacles(), |r| r.obstacles);
        let path = path(records);
        let mut series = self.flight(&path);
        series.extend(bodies(&obstacles, scenario));
        series.extend(tracks(records, scenario));
        series.push(thin("goal region", GOAL, disc(scenario.goal, scenario.goal_radius)));
        let bs = scenario.channel.base_station;
        series.push(Series::line("base station", 7, vec![(bs.x, bs.y)]).styled(Style::Triangle).inked(BLACK));
        series.extend(shadow(&obstacles, scenario));
        let unit = format!("field widths of {:.0} m", scenario.scale.metres_per_unit);
        Chart {
            title: self.title.clone(),
            alt: self.alt(),
            x: format!("east x, {unit}"),
            y: format!("north y, {unit}"),
            x_range: Some([0.0, 1.0]),
            y_range: Some([0.0, 1.0]),
            square: true,
            panel: self.panel,
            notes: self.notes(&path),
            series,
            ..Chart::default()
        }
    }

    /// Path, power, outages, ticks and direction.
    fn flight(&self, path: &[Vector2<f64>]) -> Vec<Series> {
        let at = |of: &dyn Fn(&Record) -> bool| -> Vec<(f64, f64)> {
            self.records.iter().filter(|r| of(r)).map(|r| (r.r.x, r.r.y)).collect()
        };
        let marks = |name: &str, ink, style, points| Series::line(name, 0, points).styled(style).inked(ink);
        let ticks = path.iter().step_by(TICKS.0 as usize).skip(1).map(|r| (r.x, r.y)).collect();
        let mut series = vec![
            marks("outage", BLACK, Style::Cross, at(&|r| r.outage)),
            marks(&format!("every {} intervals", TICKS.0), BLACK, Style::Square, ticks),
            marks("low power", LOW, Style::Ring, at(&|r| r.power == TxPower::Low)),
            marks("high power", HIGH, Style::Dot, at(&|r| r.power == TxPower::High)),
        ];
        let line: Vec<(f64, f64)> = path.iter().map(|r| (r.x, r.y)).collect();
        series.push(thin("", BLACK, line));
        series.extend(
            arrows(path).into_iter().map(|arrow| Series::line("", 0, arrow).styled(Style::Area).inked(BLACK)),
        );
        series
    }

    /// Start, goal, base station and the ticks' numbers, each where it covers nothing.
    fn notes(&self, path: &[Vector2<f64>]) -> Vec<Note> {
        let scenario = self.scenario;
        let mut labels = Labels::new(path, self.records, scenario, self.panel);
        labels.put("goal", scenario.goal, scenario.goal_radius);
        labels.put("base station", scenario.channel.base_station, 0.02);
        if let Some(start) = path.first() {
            labels.put("start", *start, 0.01);
        }
        let ticks = path.iter().enumerate().step_by(TICKS.0 as usize * TICKS.1).skip(1);
        for (k, at) in ticks {
            labels.put_if_free(&format!("k = {k}"), *at);
        }
        labels.notes
    }

    /// The flight in words.
    fn alt(&self) -> String {
        let count = |of: &dyn Fn(&Record) -> bool| self.records.iter().filter(|r| of(r)).count();
        let Some(last) = self.records.last() else {
            return format!("{}: no interval was flown.", self.title);
        };
        format!(
            "{}: the path of {} intervals from ({:.2}, {:.2}) to ({:.2}, {:.2}) over the contours of the radio shadow; \
             {} intervals at high power, {} in outage; {:.2} from the goal at the end.",
            self.title,
            self.records.len(),
            self.records[0].r.x,
            self.records[0].r.y,
            last.r_next.x,
            last.r_next.y,
            count(&|r| r.power == TxPower::High),
            count(&|r| r.outage),
            (last.r_next - self.scenario.goal).norm(),
        )
    }
}

/// The places at the beginnings of all intervals and at the end.
fn path(records: &[Record]) -> Vec<Vector2<f64>> {
    let start = records.first().map(|r| r.r);
    start.into_iter().chain(records.iter().map(|r| r.r_next)).collect()
}

fn thin(name: &str, ink: Ink, points: Vec<(f64, f64)>) -> Series {
    Series::line(name, 0, points).styled(Style::Thin).inked(ink)
}

fn disc(r: Vector2<f64>, radius: f64) -> Vec<(f64, f64)> {
    let points = (0..=72).map(|n| {
        let angle = f64::from(n) * std::f64::consts::TAU / 72.0;
        (r.x + radius * angle.cos(), r.y + radius * angle.sin())
    });
    points.collect()
}

fn bodies(obstacles: &Obstacles, scenario: &Scenario) -> Vec<Series> {
    let all = obstacles.each(scenario).enumerate();
    all.map(|(n, (centre, o))| {
        let name = if n == 0 { "obstacle" } else { "" };
        Series::line(name, 0, disc(centre, o.radius)).styled(Style::Area).inked(body(n))
    })
    .collect()
}

/// The ways of the obstacles that move, and where each was when the UAV came nearest.
fn tracks(records: &[Record], scenario: &Scenario) -> Vec<Series> {
    let mut series = Vec::new();
    for (n, obstacle) in scenario.obstacles.iter().enumerate() {
        let track: Vec<Vector2<f64>> = records.iter().filter_map(|r| r.obstacles.get(n).copied()).collect();
        if !track.first().is_some_and(|first| track.iter().any(|r| (r - first).norm() > STILL)) {
            continue;
        }
        let met = nearest(records, &track).map(|at| disc(at, obstacle.radius)).unwrap_or_default();
        let name = if series.is_empty() { "obstacle's way; where it was nearest" } else { "" };
        series.push(thin(name, body(n), met));
        series.push(thin("", body(n), track.iter().map(|r| (r.x, r.y)).collect()));
    }
    series
}

/// Colour of the obstacle with this index.
fn body(index: usize) -> Ink {
    BODIES.get(index).copied().unwrap_or(BODIES[0])
}

/// Where an obstacle with this track was when the UAV came nearest to it.
fn nearest(records: &[Record], track: &[Vector2<f64>]) -> Option<Vector2<f64>> {
    let pairs = records.iter().map(|r| r.r_next).zip(track);
    pairs.min_by(|a, b| (a.0 - a.1).norm().total_cmp(&(b.0 - b.1).norm())).map(|(_, at)| *at)
}

/// Heads of arrows in the direction of flight, between the ticks where the UAV moves.
fn arrows(path: &[Vector2<f64>]) -> Vec<Vec<(f64, f64)>> {
    let half = TICKS.0 as usize / 2;
    let middles = (half..path.len()).step_by(TICKS.0 as usize);
    let ways = middles.filter_map(|k| Some((path[k], path[k] - path.get(k.checked_sub(1)?)?)));
    ways.filter(|(_, way)| way.norm() > 4e-3)
        .map(|(at, way)| {
            let along = way.normalize() * 0.016;
            let across = Vector2::new(-along.y, along.x) * 0.5;
            [at + along, at - along + across, at - along * 0.5, at - along - across]
                .map(|r| (r.x, r.y))
                .to_vec()
        })
        .collect()
}

/// The contours of the blockage probability, the darkest first, so that it lies above.
fn shadow(obstacles: &Obstacles, scenario: &Scenario) -> Vec<Series> {
    let step = 1.0 / (GRID - 1) as f64;
    let place = |n: usize| Vector2::new((n % GRID) as f64, (n / GRID) as f64) * step;
    let values: Vec<f64> = (0..GRID * GRID).map(|n| obstacles.blockage(place(n), scenario)).collect();
    let builder = ContourBuilder::new(GRID, GRID, true).x_step(step).y_step(step);
    let mut series = Vec::new();
    for (level, grey) in SHADOW.into_iter().rev() {
        let name = format!("blocked with p ≥ {level}");
        // Numbers of a square grid have contours.
        let contours = builder.contours(&values, &[level]).unwrap_or_default();
        let parts = contours.iter().flat_map(|c| c.geometry().0.iter());
        let rings = parts.map(|part| part.exterior().0.iter().map(|at| (at.x, at.y)).collect::<Vec<_>>());
        for (n, ring) in rings.enumerate() {
            let name = if n == 0 { name.as_str() } else { "" };
            series.push(Series::line(name, 0, ring).styled(Style::Area).inked([grey; 3]));
        }
    }
    series
}
