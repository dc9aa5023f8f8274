//! Progress bars on stderr; nothing is drawn where that is no terminal.

use std::borrow::Cow;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar of `length` steps of `what`, with the time passed and left, and room for a message.
#[must_use]
pub fn bar(what: impl Into<Cow<'static, str>>, length: u64) -> ProgressBar {
    let bar = ProgressBar::new(length).with_prefix(what);
    match ProgressStyle::with_template("{prefix:>10} {bar:30} {pos}/{len} {elapsed}, {eta} left  {msg}") {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}
