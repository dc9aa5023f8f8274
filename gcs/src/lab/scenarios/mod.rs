//! `gcs scenario`: list the presets, draw one, check a file, begin one.
//!
//! | module | what it is |
//! |---|---|
//! | [`field`] | where the radio reaches, and what the straight line needs |
//! | [`draw`] | the world by characters and as a picture |
//! | [`faults`] | everything that is wrong with a file |
//! | [`template`] | a commented file to begin with |

pub mod draw;
pub mod faults;
pub mod field;
pub mod template;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Subcommand;
use crpl_model::evaluation::chart;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::columns;
use crpl_sitl::program::files::write_whole;
use crpl_sitl::scenario::presets::PRESETS;
use crpl_sitl::{Scenario, out, outln};
use serde_json::json;

use field::{RadioField, StraightLine};

/// Flags of `gcs scenario`.
#[derive(Debug, clap::Args)]
pub struct Scenarios {
    #[command(subcommand)]
    command: ScenarioCommand,
}

#[derive(Debug, Subcommand)]
enum ScenarioCommand {
    /// The presets, one line each
    List,
    /// Draw a scenario: shadow, where low and high power fail, what the straight line needs
    Show(ShowScenario),
    /// Tell every fault of a scenario's file
    Check {
        /// TOML files
        #[arg(required = true, value_name = "FILE")]
        files: Vec<PathBuf>,
    },
    /// Write a commented file to begin with
    New(NewScenario),
}

#[derive(Debug, clap::Args)]
struct ShowScenario {
    /// TOML file or preset
    #[arg(value_name = "FILE|NAME", default_value = "demo")]
    scenario: String,
    #[command(flatten)]
    camera: CameraFlag,
    /// Folder for the picture, scenario.svg and scenario.png
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print JSON: the resolved scenario, and what the straight line needs
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct NewScenario {
    /// File to write
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Scenario to begin with: TOML file or preset
    #[arg(long, value_name = "FILE|NAME", default_value = "demo")]
    scenario: String,
    #[command(flatten)]
    camera: CameraFlag,
    /// Replace the file
    #[arg(long)]
    overwrite: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// A scenario that does not read, faults in a file, a file that cannot be written.
pub fn run(args: &Scenarios) -> Result<()> {
    match &args.command {
        ScenarioCommand::List => {
            for preset in PRESETS {
                let line = format!("{:<18}{}", preset.name, preset.about);
                out!("{}", columns::wrapped(&line, 18, columns::width()));
            }
            Ok(())
        }
        ScenarioCommand::Show(args) => show(args),
        ScenarioCommand::Check { files } => check(files),
        ScenarioCommand::New(args) => new(args),
    }
}

fn show(args: &ShowScenario) -> Result<()> {
    let scenario = args.camera.scenario(&args.scenario)?;
    let line = RadioField::of(&scenario).straight_line();
    if args.json {
        outln!("{}", json!({ "scenario": scenario, "straight_line": line }));
    } else {
        let width = columns::width();
        outln!("{}", scenario.name);
        out!("{}{}", draw::text(&scenario, width), columns::wrapped(&told(&line), 2, width));
    }
    if let Some(dir) = &args.out {
        std::fs::create_dir_all(dir).with_context(|| format!("creating {}", dir.display()))?;
        chart::save(&draw::picture(&scenario), dir, "scenario")?;
        if !args.json {
            outln!("scenario.svg and scenario.png in {}", dir.display());
        }
    }
    Ok(())
}

/// What the straight line needs, for people; 80 columns at most.
fn told(line: &StraightLine) -> String {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let mut text = format!(
        "straight to the goal, {:.3} units: least power that carries every packet {:.3}\n  \
         (low is 1, high is 4); low power serves {}, high power {} more,\n  no power serves {}; in a shadow {}\n",
        line.length,
        line.least_power,
        percent(line.low),
        percent(line.high),
        percent(line.nothing),
        percent(line.shadow)
    );
    if let Some(clearance) = line.clearance {
        text += &match clearance < 0.0 {
            true => format!("  and it leads through an obstacle, {:.3} units deep\n", -clearance),
            false => format!("  and it passes the nearest obstacle at {clearance:.3} units\n"),
        };
    }
    text
}

fn check(files: &[PathBuf]) -> Result<()> {
    let mut bad = 0;
    for path in files {
        let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
        let faults = faults::of_text(&text);
        for fault in &faults {
            outln!("{}: {}", path.display(), fault.split_whitespace().collect::<Vec<_>>().join(" "));
        }
        if faults.is_empty() {
            outln!("{}: good", path.display());
        }
        bad += usize::from(!faults.is_empty());
    }
    ensure!(bad == 0, "{bad} of {} files are no scenarios", files.len());
    Ok(())
}

fn new(args: &NewScenario) -> Result<()> {
    let mut scenario = args.camera.scenario(&args.scenario)?;
    let path: &Path = &args.file;
    if path.exists() && !args.overwrite {
        bail!("{} is there already: choose another file, or --overwrite", path.display());
    }
    if let Some(stem) = path.file_stem() {
        scenario.name = stem.to_string_lossy().into_owned();
    }
    let text = template::of(&scenario);
    Scenario::from_toml(&text).with_context(|| format!("the file of {:?}", scenario.name))?;
    write_whole(path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))?;
    outln!("{}: change it, then gcs scenario check {}", path.display(), path.display());
    Ok(())
}
