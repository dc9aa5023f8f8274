//! The log on stderr: one short line an event, or one JSON object; and what is drawn there while it is written.

#![expect(clippy::disallowed_methods, reason = "a shell: log lines carry the wall clock")]

use std::io::{IsTerminal, Write};
use std::time::{SystemTime, UNIX_EPOCH};

use clap::ValueEnum;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::FormatTime;

use super::progress;

/// What the log looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum LogFormat {
    /// A line for people
    #[default]
    Text,
    /// A JSON object a line, for programs
    Json,
}

/// What `-v` shows: the details of our own crates, of libraries no more than without it.
const DETAILS: &str = "info,crpl_sitl=debug,crpl_model=debug,crpl_gcs=debug,sitl=debug,model=debug,gcs=debug";

/// How much is logged, and how.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LogChoice {
    /// Errors alone.
    pub quiet: bool,
    /// Details: 1 of our own programs, 2 everything.
    pub verbose: u8,
    /// For whom.
    pub format: LogFormat,
}

impl LogChoice {
    /// The filter, as `RUST_LOG` has it; `None` if nothing was asked for.
    fn filter(self) -> Option<&'static str> {
        match (self.quiet, self.verbose) {
            (true, _) => Some("error"),
            (false, 0) => None,
            (false, 1) => Some(DETAILS),
            (false, _) => Some("trace"),
        }
    }

    /// Logs to stderr from now on: by these flags, else by RUST_LOG, else from level info on; colours on a terminal
    /// only.
    pub fn begin(self) {
        progress::set_quiet(self.quiet);
        let filter = match self.filter() {
            Some(filter) => filter.into(),
            None => EnvFilter::try_from_default_env().unwrap_or_else(|_| "info".into()),
        };
        let log = tracing_subscriber::fmt()
            .with_env_filter(filter)
            .with_writer(|| AboveBars)
            .with_ansi(std::io::stderr().is_terminal())
            // A reader that has gone away is no reason to stop, and telling it of that is impossible.
            .log_internal_errors(false);
        match self.format {
            LogFormat::Text => log.with_target(self.verbose > 1).with_timer(TimeOfDay).init(),
            LogFormat::Json => log.json().flatten_event(true).with_target(false).init(),
        }
    }
}

/// Hours, minutes and seconds, UTC.
struct TimeOfDay;

impl FormatTime for TimeOfDay {
    fn format_time(&self, writer: &mut Writer<'_>) -> std::fmt::Result {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs() % 86_400;
        write!(writer, "{:02}:{:02}:{:02}Z", now / 3600, now / 60 % 60, now % 60)
    }
}

/// Stderr, above the bars that are drawn there.
struct AboveBars;

impl Write for AboveBars {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        progress::above(|| std::io::stderr().write(bytes))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        std::io::stderr().flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_win_over_the_environment() {
        let choice = |quiet, verbose| LogChoice { quiet, verbose, ..LogChoice::default() }.filter();
        assert_eq!(choice(false, 0), None);
        assert_eq!(
            [choice(true, 0), choice(false, 1), choice(false, 5)],
            [Some("error"), Some(DETAILS), Some("trace")]
        );
    }
}
