//! What a controller of somebody's own is called: `exec:COMMAND`, `exec-truth:COMMAND`, `mavlink:ENDPOINT`.
//!
//! The name is all that flags, sweep files, tables and journals know of it, so it says what the controller may
//! see, too.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use crpl_sitl::program::files::fingerprint;

/// How a controller of somebody's own is spoken to, and what it may see.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum OwnKind {
    /// A program, by lines of JSON; it sees what CRPL sees.
    Exec,
    /// The same, and the true state.
    ExecTruth,
    /// A station that speaks MAVLink; telemetry holds the true state.
    Mavlink,
}

impl OwnKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Exec, Self::ExecTruth, Self::Mavlink];

    /// What its names begin with.
    #[must_use]
    pub fn prefix(self) -> &'static str {
        match self {
            Self::Exec => "exec:",
            Self::ExecTruth => "exec-truth:",
            Self::Mavlink => "mavlink:",
        }
    }
}

/// A controller of somebody's own, by its name.
///
/// Names are kept for the life of the program, so that a controller stays a value that is copied: there are as
/// many as the command line and the files of a run name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct OwnController {
    /// How it is spoken to.
    pub kind: OwnKind,
    name: &'static str,
}

/// A name that is none.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OwnNameError {
    /// Nothing follows the prefix.
    #[error("{0}... names no {1}")]
    Empty(&'static str, &'static str),
    /// It would not fit into a list of names, or a table.
    #[error("`{0}` holds a comma or a line break, which separate controllers: put the command into a script")]
    Separator(String),
    /// A quotation mark without its other half.
    #[error("`{0}` are not the words of a command: {1}")]
    Words(String, String),
}

static NAMES: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());

/// The one copy of this name.
fn kept(name: &str) -> &'static str {
    let mut names = NAMES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = names.get(name) {
        return known;
    }
    let name: &'static str = Box::leak(name.to_owned().into_boxed_str());
    names.insert(name);
    name
}

impl OwnController {
    /// The controller of this name; `None` where the name has no prefix of [`OwnKind`].
    ///
    /// # Errors
    /// What follows the prefix is no command, or no endpoint.
    pub fn parse(text: &str) -> Result<Option<Self>, OwnNameError> {
        let found = OwnKind::ALL.into_iter().find_map(|kind| Some((kind, text.strip_prefix(kind.prefix())?)));
        let Some((kind, rest)) = found else { return Ok(None) };
        if rest.trim().is_empty() {
            let what = if kind == OwnKind::Mavlink { "endpoint" } else { "command" };
            return Err(OwnNameError::Empty(kind.prefix(), what));
        }
        if text.contains([',', '\n', '\r']) {
            return Err(OwnNameError::Separator(text.into()));
        }
        if kind != OwnKind::Mavlink {
            let words = shell_words::split(rest);
            words.map_err(|error| OwnNameError::Words(rest.into(), error.to_string()))?;
        }
        Ok(Some(Self { kind, name: kept(text) }))
    }

    /// The whole name, as on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.name
    }

    /// What follows the prefix: the command or the endpoint.
    #[must_use]
    pub fn rest(self) -> &'static str {
        self.name.strip_prefix(self.kind.prefix()).unwrap_or(self.name)
    }

    /// Words of the command, as a shell takes them.
    #[must_use]
    pub fn words(self) -> Vec<String> {
        shell_words::split(self.rest()).unwrap_or_default()
    }

    /// Names the command and the files that it names, so that a sweep does not go on with another script.
    #[must_use]
    pub fn fingerprint(self) -> String {
        let words = self.words();
        let files = words.iter().filter_map(|word| std::fs::read(word).ok()).map(|bytes| fingerprint(&bytes));
        fingerprint(files.fold(self.name.to_owned(), |all, file| all + &file).as_bytes())
    }

    /// A short name for the head of a column: the program's file, or the last one that is named after it.
    #[must_use]
    pub fn label(self) -> String {
        let kind = self.kind.prefix();
        if self.kind == OwnKind::Mavlink {
            return kind.trim_end_matches(':').into();
        }
        let words = self.words();
        let script = words.iter().skip(1).find(|word| Path::new(word).extension().is_some());
        let file = script.or(words.first()).map(Path::new);
        let stem = file.and_then(Path::file_stem).map(|stem| stem.to_string_lossy().into_owned());
        kind.to_owned() + &stem.unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_reads_back_and_says_what_is_seen() {
        let own = OwnController::parse("exec:python3 examples/pid.py --kp 0.2").unwrap().unwrap();
        assert_eq!(own.words(), ["python3", "examples/pid.py", "--kp", "0.2"]);
        assert_eq!((own.kind, own.label().as_str()), (OwnKind::Exec, "exec:pid"));
        assert_eq!(OwnController::parse(own.name()).unwrap(), Some(own));
        let truth = OwnController::parse("exec-truth:./fly").unwrap().unwrap();
        assert_eq!((truth.kind, truth.label().as_str()), (OwnKind::ExecTruth, "exec-truth:fly"));
        assert_eq!(OwnController::parse("crpl").unwrap(), None);
    }

    #[test]
    fn a_name_that_is_none_says_why() {
        let error = |text: &str| OwnController::parse(text).unwrap_err().to_string();
        assert_eq!(error("exec: "), "exec:... names no command");
        assert_eq!(error("mavlink:"), "mavlink:... names no endpoint");
        assert!(error("exec:a,b").contains("put the command into a script"));
        assert!(error("exec:a 'b").contains("are not the words of a command"));
    }
}
