//! `gcs export`: a flight as a table, a track on a map, or a log for Foxglove.
//!
//! | module | what it is |
//! |---|---|
//! | [`track`] | a flight from a run folder or a tlog |
//! | `table` | CSV and Parquet |
//! | `maps` | GPX and GeoJSON |
//! | `foxglove` | the messages that Foxglove knows, as MCAP |
//! | `mcap` | that container |

mod foxglove;
mod maps;
mod mcap;
mod table;
pub mod track;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use crpl_sitl::program::files::write_whole;
use track::FlightTrack;

/// Flags of `gcs export`.
#[derive(Debug, Clone, clap::Args)]
pub struct ExportArgs {
    /// Run folder, or a tlog of any vehicle, or a record.jsonl
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// What to write
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: ExportFormat,
    /// File to write [default: flight.FORMAT in the run folder, or beside the log]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the file
    #[arg(long)]
    overwrite: bool,
}

/// What a flight is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// One row a position: comma-separated values
    Csv,
    /// The same table for pandas and DuckDB
    Parquet,
    /// The track for map programs
    Gpx,
    /// Track, base station, obstacles and outages for maps
    Geojson,
    /// Positions and records for Foxglove
    Mcap,
    /// Refused: examples/python/to_rerun.py writes it, with Rerun's own library
    Rrd,
}

impl ExportFormat {
    /// Its name, and the ending of its files.
    fn key(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Parquet => "parquet",
            Self::Gpx => "gpx",
            Self::Geojson => "geojson",
            Self::Mcap => "mcap",
            Self::Rrd => "rrd",
        }
    }

    /// The flight in this format.
    ///
    /// # Errors
    /// It cannot be written so.
    pub fn bytes(self, track: &FlightTrack) -> Result<Vec<u8>> {
        match self {
            Self::Csv => Ok(table::csv(track).into_bytes()),
            Self::Parquet => table::parquet(track),
            Self::Gpx => maps::gpx(track),
            Self::Geojson => Ok(maps::geojson(track).into_bytes()),
            Self::Mcap => foxglove::mcap(track),
            Self::Rrd => bail!(
                "--to rrd: Rerun's own library writes its files: pip install rerun-sdk, then, in the sources of \
                 this program, python examples/python/to_rerun.py RUN"
            ),
        }
    }
}

/// Writes the file and names it.
///
/// # Errors
/// No flight, a format that is not written, a file that is there.
pub fn run(args: &ExportArgs) -> Result<()> {
    let track = FlightTrack::open(&args.run)?;
    let bytes = args.to.bytes(&track)?;
    let out = args.out.clone().unwrap_or_else(|| beside(&args.run, args.to.key()));
    if out.exists() && !args.overwrite {
        bail!("{}: there is a file of this name: choose another --out, or --overwrite", out.display());
    }
    write_whole(&out, &bytes).with_context(|| format!("writing {}", out.display()))?;
    let seconds = track.samples.last().map_or(0.0, |last| last.time_s);
    crpl_sitl::outln!("{} positions of {seconds:.1} s in {}", track.samples.len(), out.display());
    Ok(())
}

/// Where the file goes that nobody named.
fn beside(run: &Path, ending: &str) -> PathBuf {
    let file = format!("flight.{ending}");
    if run.is_dir() { run.join(file) } else { run.with_extension(ending) }
}

#[cfg(test)]
mod tests;
