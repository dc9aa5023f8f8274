//! Words of the command line that have changed. An old one gives an error that names the new one.

/// An old word, and what to write now.
#[derive(Debug, Clone, Copy)]
pub struct Renamed {
    /// The commands that had it.
    pub commands: &'static [&'static str],
    /// A flag or a subcommand.
    pub old: &'static str,
    /// What to write now.
    pub new: &'static str,
}

const fn renamed(commands: &'static [&'static str], old: &'static str, new: &'static str) -> Renamed {
    Renamed { commands, old, new }
}

/// All changed words.
pub const RENAMED: [Renamed; 13] = [
    renamed(&["sitl", "gcs sitl", "gcs demo", "gcs fly", "gcs episodes"], "--config", "--scenario FILE|NAME"),
    renamed(&["gcs optimise", "gcs check"], "--scenario-file", "--scenario FILE|NAME"),
    renamed(&["gcs episodes", "gcs sweep", "gcs report"], "--controllers", "--controller LIST"),
    renamed(&["sitl", "gcs sitl", "gcs demo", "gcs fly"], "--speedup", "--speed X"),
    renamed(&["gcs bridge"], "--master", "--connect ENDPOINT"),
    renamed(&["gcs bridge", "gcs replay"], "--out", "--forward ENDPOINT"),
    renamed(&["gcs bridge"], "--stats", "--every SECONDS"),
    renamed(&["gcs param", "gcs mission"], "--patience", "--timeout SECONDS"),
    renamed(&["gcs check"], "--flights", "--episodes N"),
    renamed(&["gcs check"], "--kick", "--gust-std X"),
    renamed(&["model"], "hard", "model robustness"),
    renamed(&["model"], "optimise", "gcs optimise"),
    renamed(&["model"], "check", "gcs check"),
];

/// The new word for what clap did not know in `command`, such as `gcs fly`.
#[must_use]
pub fn replacement(command: &str, unknown: &str) -> Option<&'static str> {
    let found = RENAMED.iter().find(|r| r.old == unknown && r.commands.contains(&command));
    found.map(|renamed| renamed.new)
}
