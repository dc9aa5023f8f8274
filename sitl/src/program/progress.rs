//! Progress on stderr: a bar on a terminal; elsewhere a line every 10 s, and none of work that is done sooner.

use std::borrow::Cow;
use std::io::{IsTerminal, Write};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle, WeakProgressBar};

/// How often progress is told where there is no terminal.
const TOLD: Duration = Duration::from_secs(10);

/// All bars of this program.
static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);
static QUIET: AtomicBool = AtomicBool::new(false);

/// Whether no progress is to be told from now on.
pub fn set_quiet(quiet: bool) {
    QUIET.store(quiet, Ordering::Relaxed);
}

/// Does what writes to stderr, with the bars out of the way.
pub fn above<T>(write: impl FnOnce() -> T) -> T {
    BARS.suspend(write)
}

/// A bar of `length` steps of `what`, with the time passed and left, and room for a message.
#[must_use]
pub fn bar(what: impl Into<Cow<'static, str>>, length: u64) -> ProgressBar {
    styled(what, length, "{prefix:>10} {bar:30} {pos}/{len} {elapsed}, {eta} left  {msg}")
}

/// A short bar with a long message: how a flight is going.
#[must_use]
pub fn live(what: impl Into<Cow<'static, str>>, length: u64) -> ProgressBar {
    styled(what, length, "{prefix} {bar:16} {pos}/{len} {elapsed}  {msg}")
}

fn styled(what: impl Into<Cow<'static, str>>, length: u64, template: &str) -> ProgressBar {
    if QUIET.load(Ordering::Relaxed) {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(length).with_prefix(what);
    let bar = match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    };
    if std::io::stderr().is_terminal() {
        return BARS.add(bar);
    }
    let (told, bar) = (bar.downgrade(), bar);
    // It ends with the bar, or with the program.
    std::thread::spawn(move || tell(&told));
    bar
}

/// A line of where the bar stands, as long as there is the bar and it gets on.
fn tell(bar: &WeakProgressBar) {
    let mut last = None;
    loop {
        std::thread::sleep(TOLD);
        let Some(bar) = bar.upgrade().filter(|bar| !bar.is_finished()) else { return };
        if last.replace(bar.position()) == Some(bar.position()) {
            continue;
        }
        // A reader that has gone away wants no progress.
        let _ = writeln!(std::io::stderr().lock(), "{}", line(&bar));
    }
}

/// Where a bar stands, in words.
fn line(bar: &ProgressBar) -> String {
    let length = bar.length().map_or_else(String::new, |length| format!(" of {length}"));
    let seconds = bar.elapsed().as_secs();
    let message = bar.message();
    let end = if message.is_empty() { String::new() } else { format!(", {message}") };
    format!("{}: {}{length} after {seconds} s{end}", bar.prefix(), bar.position())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_how_far_it_is() {
        let bar = ProgressBar::hidden().with_prefix("rollouts");
        bar.set_length(20);
        bar.set_position(5);
        bar.set_message("px 0.1");
        assert_eq!(line(&bar), "rollouts: 5 of 20 after 0 s, px 0.1");
    }
}
