//! Flights that are on the disk, whoever flew them: their numbers, side by side, and their ways in one picture.
//!
//! | module | what it is |
//! |---|---|
//! | [`read`] | a run folder, a file of records or a log as a flight |
//! | [`overlay`] | the ways of several flights in one picture |

pub mod overlay;
pub mod read;

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use crpl_model::evaluation::chart;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::columns;
use crpl_sitl::sim::metric::{Count, FlightOutcome, FlightScore, Metric};
use crpl_sitl::{Scenario, out, outln};
use serde_json::json;

use read::FlownFlight;

/// Flags of `gcs score`.
#[derive(Debug, clap::Args)]
pub struct Score {
    /// Run folders of gcs or sitl, files of records (record.jsonl), logs (.tlog) of flights with sitl
    #[arg(required = true, value_name = "FLIGHT")]
    flights: Vec<PathBuf>,
    /// Scenario of files that have no config.toml beside them: TOML file or preset
    #[arg(long, value_name = "FILE|NAME")]
    scenario: Option<String>,
    #[command(flatten)]
    camera: CameraFlag,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Flags of `gcs compare`.
#[derive(Debug, clap::Args)]
pub struct Compare {
    #[command(flatten)]
    score: Score,
    /// Folder of the picture of all ways, compare.svg and compare.png
    #[arg(long, value_name = "DIR", default_value = "runs/compare")]
    out: PathBuf,
}

/// A flight and its numbers.
struct Scored {
    flight: FlownFlight,
    score: FlightScore,
}

impl Score {
    fn load(&self) -> Result<Vec<Scored>> {
        let scenario = self.scenario.as_deref().map(|name| self.camera.scenario(name)).transpose()?;
        let load = |path: &PathBuf| {
            let flight = read::flight(path, scenario.as_ref())?;
            let score = FlightScore::of(&flight.records, &flight.scenario);
            let score = score.with_context(|| format!("{}: no interval was flown", path.display()))?;
            Ok(Scored { flight, score })
        };
        self.flights.iter().map(load).collect()
    }
}

/// Runs `gcs score`.
///
/// # Errors
/// A flight that does not read.
pub fn score(args: &Score) -> Result<()> {
    print(&args.load()?, args.json)
}

/// Runs `gcs compare`.
///
/// # Errors
/// A flight that does not read; flights of different worlds cannot be in one picture.
pub fn compare(args: &Compare) -> Result<()> {
    let flights = args.score.load()?;
    let Some((first, others)) = flights.split_first().filter(|(_, others)| !others.is_empty()) else {
        bail!("one flight alone: gcs score prints its numbers");
    };
    print(&flights, args.score.json)?;
    if let Some(other) =
        others.iter().find(|other| !is_same_world(&first.flight.scenario, &other.flight.scenario))
    {
        bail!(
            "no picture: {} flew in {:?} and {} in {:?}",
            first.flight.path.display(),
            first.flight.scenario.name,
            other.flight.path.display(),
            other.flight.scenario.name
        );
    }
    std::fs::create_dir_all(&args.out).with_context(|| format!("creating {}", args.out.display()))?;
    let all: Vec<&FlownFlight> = flights.iter().map(|scored| &scored.flight).collect();
    chart::save(&overlay::overlay(&first.flight.scenario, &all), &args.out, "compare")?;
    if !args.score.json {
        outln!("compare.svg, .pdf and .png in {}", args.out.display());
    }
    Ok(())
}

/// Whether two flights can be compared: all but the name is the same.
fn is_same_world(one: &Scenario, other: &Scenario) -> bool {
    Scenario { name: String::new(), ..one.clone() } == Scenario { name: String::new(), ..other.clone() }
}

/// Whether two flights met the same gusts in the same world.
fn is_paired(one: &FlownFlight, other: &FlownFlight) -> bool {
    one.seed.is_some() && one.seed == other.seed && is_same_world(&one.scenario, &other.scenario)
}

fn print(flights: &[Scored], json: bool) -> Result<()> {
    if json {
        let rows: Vec<_> = flights
            .iter()
            .map(|Scored { flight, score }| {
                json!({
                    "flight": flight.path, "controller": flight.controller, "seed": flight.seed,
                    "scenario": flight.scenario.name, "score": score,
                })
            })
            .collect();
        outln!("{}", serde_json::to_string(&json!({ "flights": rows }))?);
        return Ok(());
    }
    out!("{}", table(flights, columns::width()));
    Ok(())
}

/// Columns of a flight's values; the head beside them takes 40.
const WIDTH: usize = 12;

/// The flights side by side; a number of each names it in the head, and the legend below says which it is.
fn table(flights: &[Scored], width: Option<usize>) -> String {
    let mut text = format!("{:<40}", flights.first().map_or("", |f| f.flight.scenario.name.as_str()));
    for (n, _) in flights.iter().enumerate() {
        text += &format!("{:>WIDTH$}", format!("[{}]", n + 1));
    }
    let mut row = |name: &str, cell: &dyn Fn(&Scored) -> String| {
        text += &format!("\n{name:<40}");
        flights.iter().for_each(|flight| text += &format!("{:>WIDTH$}", cell(flight)));
    };
    row("reached the goal", &|f| if f.score.is(FlightOutcome::Reached) { "yes" } else { "no" }.into());
    for metric in Metric::ALL {
        row(&format!("{:<8}{}", metric.symbol(), metric.title()), &|f| {
            let value = metric.show(f.score[metric]);
            if metric.count() == Count::Intervals { format!("{value} of {}", f.score.ticks) } else { value }
        });
    }
    row("seed", &|f| f.flight.seed.map_or("-".into(), |seed| seed.to_string()));
    let room: Vec<usize> = std::iter::once(40).chain(flights.iter().map(|_| WIDTH)).collect();
    let mut names = String::new();
    for (n, Scored { flight, .. }) in flights.iter().enumerate() {
        names += &format!("[{}] {}, {}\n", n + 1, flight.controller, flight.path.display());
    }
    columns::folded(&text, &room, width) + &names + &columns::wrapped(&ratios(flights), 4, width)
}

/// What those that met the same gusts have over the first.
fn ratios(flights: &[Scored]) -> String {
    let Some((first, others)) = flights.split_first() else { return String::new() };
    let mut text = String::new();
    for (n, other) in others.iter().enumerate().filter(|(_, other)| is_paired(&first.flight, &other.flight)) {
        let ratio = |m: Metric| {
            let floor = m.floor();
            format!("{} {:.2}", m.symbol(), other.score[m] / first.score[m].max(floor))
        };
        let cells: Vec<String> = Metric::compared().map(ratio).collect();
        text += &format!("[{}] over [1], same gusts: {}\n", n + 2, cells.join(", "));
    }
    text
}
