//! `gcs report`: the paper's figures as one page that needs nothing else, and as SVG, PDF, PNG, CSV and text.
//!
//! | module | what it is |
//! |---|---|
//! | [`scenarios`] | Figs. 4 and 5: flights without gusts |
//! | [`sweeps`] | Figs. 6 and 7: a sweep's folder as panels and tables |
//! | [`claims`] | every claim of the paper that flights decide |
//! | [`quantities`] | what measures a claim |
//! | [`verdict`] | what an interval of ours says of a claim |
//! | [`rows`] | claims with verdicts: text and CSV |
//! | [`page`] | HTML |

pub mod claims;
pub mod page;
pub mod quantities;
pub mod rows;
pub mod scenarios;
pub mod sweeps;
pub mod verdict;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use crpl_model::evaluation::report::{self as measure, ReportConfig};
use crpl_model::evaluation::{chart, figures};
use crpl_model::predictor::Networks;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;

use crpl_sitl::program::flight_log;
use crpl_sitl::program::shard::Shard;
use crpl_sitl::program::terminal::StopSignal;

use crate::lab::policies;
use crate::lab::sweep;
use crate::lab::sweep::folder::Folder;
use crate::lab::sweep::plan::{Overrides, SweepFile};
use crate::station::models::{ModelFiles, Models};
use crate::station::pilot::{Controller, ControllerParser};
use page::Page;
use rows::VerdictRow;
use sweeps::Finished;

/// The sweeps of `gcs report all`: file, text, and what there is to say first.
const SWEEPS: [(&str, &str, &str); 3] = [
    ("configs/sweep_bandwidth.toml", include_str!("../../../presets/sweep_bandwidth.toml"), ""),
    ("configs/sweep_sigma.toml", include_str!("../../../presets/sweep_sigma.toml"), ""),
    ("configs/sweep_sigma_literal.toml", include_str!("../../../presets/sweep_sigma_literal.toml"), LITERAL),
];

/// Trajectories of Fig. 3 on the page.
const ROLLOUTS: usize = 300;

/// Why the paper's largest σ_c cannot be meant literally.
const LITERAL: &str = "Read literally, σ_c = 0.01 is a gust of 0.01 on the speed in each axis and interval. The largest acceleration is \
     0.0035: what one gust does takes three intervals of full thrust to undo, and three more gusts come \
     meanwhile. The speed wanders through its whole range of ±0.04 whatever is commanded, so no controller can \
     stop at the goal or keep clear of the obstacle, not the oracle either, which knows the equations, and not \
     a dynamic programme that knows the noise as well (calibration study: d_f 0.31). Terminal error, risk and \
     outage become alike for all; only the power that is spent still tells the controllers apart.";

/// Flags of `gcs report`.
#[derive(Debug, clap::Args)]
pub struct Report {
    /// `scenarios`: fly the paper's Figs. 4 and 5. `all`: fly these and the sweeps of Figs. 6 and 7. DIR: draw a
    /// finished sweep
    #[arg(value_name = "scenarios|all|DIR")]
    what: String,
    /// Controllers to fly [default: the paper's four, and those of the sweep files]
    #[arg(long, value_parser = ControllerParser, value_name = "LIST", value_delimiter = ',')]
    controller: Option<Vec<Controller>>,
    /// Override the sweep files' number of flights per point and controller
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    episodes: Option<u64>,
    #[command(flatten)]
    models: ModelFiles,
    /// Folder of the report [default: runs/report, or DIR/report]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Runs `gcs report`.
///
/// # Errors
/// A folder that is no finished sweep, a controller without policies, a file that cannot be written, a
/// signal.
pub fn run(args: &Report) -> Result<()> {
    let out = match (&args.out, args.what.as_str()) {
        (Some(out), _) => out.clone(),
        (None, "scenarios" | "all") => "runs/report".into(),
        (None, dir) => Path::new(dir).join("report"),
    };
    let mut page = Page::new(match args.what.as_str() {
        "scenarios" => "CRPL: Scenarios 1 and 2",
        "all" => "CRPL against APC, RCC and UCC",
        _ => "CRPL: a sweep",
    });
    // Read before the report's folder is made: a wrong name leaves nothing behind.
    let finished = match args.what.as_str() {
        "scenarios" | "all" => None,
        dir => Some(open(Path::new(dir))?),
    };
    let mut rows = Vec::new();
    if let Some(finished) = finished {
        create(&out)?;
        rows.extend(show(&finished, &mut page, &out, "")?);
    } else {
        let mut models = args.models.load()?;
        rows.extend(scenarios(&mut page, &out, &mut models, args)?);
        if args.what == "all" {
            rows.extend(all_sweeps(&mut page, &out, &mut models, args)?);
            rows.extend(rollouts(&mut page, &out)?);
            crpl_sitl::outln!("{}", rows::counts(&rows));
        }
    }
    write(&out, "verdicts.csv", &rows::csv(&rows))?;
    page.text(&format!("Made by gcs {} at revision {}.", env!("CARGO_PKG_VERSION"), crate::revision()));
    write(&out, "index.html", &page.html())?;
    crpl_sitl::outln!("{}, with figures and tables beside it", out.join("index.html").display());
    Ok(())
}

/// Makes the report's folder, once there is something to write.
fn create(out: &Path) -> Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("creating {}", out.display()))
}

/// Writes a file of the report.
fn write(dir: &Path, name: &str, text: &str) -> Result<()> {
    let path = dir.join(name);
    std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))
}

fn open(dir: &Path) -> Result<Finished> {
    if dir.join(flight_log::RECORDS).exists() {
        let dir = dir.display();
        bail!(
            "{dir} holds one flight, not a sweep: `gcs score {dir}` prints its numbers, {dir}/path.svg shows it"
        );
    }
    if std::fs::read_dir(dir)
        .is_ok_and(|all| all.flatten().any(|one| one.path().join(flight_log::RECORDS).exists()))
    {
        let dir = dir.display();
        bail!("{dir} holds flights, not a sweep: `gcs compare {dir}/*/` puts them side by side");
    }
    let folder = Folder::open(dir)?;
    let episodes = folder.finished()?;
    let episodes =
        episodes.with_context(|| format!("{} is not finished: run its `gcs sweep` again", dir.display()))?;
    Ok(Finished::new(folder, episodes))
}

fn scenarios(page: &mut Page, out: &Path, models: &mut Models, args: &Report) -> Result<Vec<VerdictRow>> {
    let paper = [Controller::Crpl, Controller::Apc, Controller::Rcc, Controller::Ucc];
    let controllers = args.controller.as_deref().unwrap_or(&paper);
    for scenario in scenarios::worlds()? {
        policies::cover(models, controllers, &scenario, args.models.optimise)?;
    }
    let flown = scenarios::fly(models, controllers, scenarios::GUSTY, Some(&StopSignal::listen()?))?;
    create(out)?;
    let mut rows = Vec::new();
    for scenario in &flown {
        let verdicts = scenario.verdicts(&flown);
        scenario.show(page, out, &verdicts)?;
        crpl_sitl::outln!("{}", scenario.text(&verdicts));
        rows.extend(verdicts);
    }
    Ok(rows)
}

fn all_sweeps(page: &mut Page, out: &Path, models: &mut Models, args: &Report) -> Result<Vec<VerdictRow>> {
    let flags = Overrides {
        episodes: args.episodes,
        controllers: args.controller.clone(),
        ..sweep::overrides(&args.models)
    };
    let mut rows = Vec::new();
    for (file, text, words) in SWEEPS {
        let file = SweepFile::parse(text).with_context(|| format!("reading {file}"))?;
        let plan = sweep::resolve(file, &flags, models)?;
        let dir = out.join(&plan.name);
        let folder = Folder::begin(&dir, plan, Shard::WHOLE)?;
        let episodes = sweep::complete(&folder, models)?;
        rows.extend(show(&Finished::new(folder, episodes), page, out, words)?);
    }
    Ok(rows)
}

/// A sweep's section, files and printed verdicts.
fn show(finished: &Finished, page: &mut Page, out: &Path, words: &str) -> Result<Vec<VerdictRow>> {
    let verdicts = finished.verdicts();
    finished.show(page, out, words, &verdicts)?;
    crpl_sitl::outln!("{}", finished.text(&verdicts));
    Ok(verdicts)
}

/// Fig. 3: the shipped world model's rollouts from rest, drawn; its verdicts name the command that measures more.
fn rollouts(page: &mut Page, out: &Path) -> Result<Vec<VerdictRow>> {
    let rows: Vec<VerdictRow> = VerdictRow::of_rollouts().collect();
    page.section("Rollouts (Fig. 3)");
    page.text(&format!(
        "The shipped world model's rollouts from rest, {ROLLOUTS} trajectories of clean frames; diamonds are the paper's \
         numbers. model evaluate measures more of them, and prints the paper's numbers beside ours."
    ));
    let (model, networks) = (WorldModel::embedded()?, Networks::embedded()?);
    let config = ReportConfig { trajectories: ROLLOUTS, ..ReportConfig::default() };
    let figures = figures::fig3(&measure::from_rest(&model, &networks, &config, &Scenario::default()));
    page.figures(&figures.each_ref().map(|figure| (chart::svg(figure), figure.title.clone())));
    for (figure, stem) in figures.iter().zip(["fig3a", "fig3b"]) {
        chart::save(figure, out, stem)?;
    }
    page.verdicts(&rows);
    Ok(rows)
}
