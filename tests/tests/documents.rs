//! Numbers in README and docs: each measured one stands below a note that says which command prints it. What is
//! quick is printed again and compared; the rest carries the revision that printed it.
//!
//! | note, an HTML comment | covers |
//! |---|---|
//! | `prints: gcs ...` | the next block: the command is run here, and must print just that but for times |
//! | `printed at REVISION by: ...`, or `printed at REVISION or before by: ...` | the next block or table |
//! | `section printed at REVISION by: ...` | all blocks and tables up to the next heading |
//! | `values` | the next table: what was chosen or given, not measured |
//! | `section values` | all tables up to the next heading |
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::path::{Path, PathBuf};
use std::process::Command;

use tests::program::{self, Program};

/// README and the pages in docs.
fn documents() -> Vec<PathBuf> {
    let root = program::workspace();
    let pages = std::fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let mut all: Vec<PathBuf> =
        pages.filter(|path| path.extension().is_some_and(|end| end == "md")).collect();
    all.push(root.join("README.md"));
    all.sort();
    all
}

/// A fenced block of text, or a table.
#[derive(Debug)]
struct Part {
    line: usize,
    text: Vec<String>,
    note: Option<String>,
}

impl Part {
    /// Whether it states a measured number: one with two decimals or more.
    fn measures(&self) -> bool {
        let is_decimal = |word: &str| {
            word.split_once('.').is_some_and(|(whole, rest)| {
                let digits = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
                digits(whole) && digits(rest) && rest.len() >= 2
            })
        };
        let words = self.text.iter().flat_map(|line| line.split(|c: char| !(c.is_ascii_digit() || c == '.')));
        words.into_iter().any(is_decimal)
    }
}

/// The blocks and tables of a page, each with the note that covers it.
fn parts(page: &Path) -> Vec<Part> {
    let text = std::fs::read_to_string(page).unwrap();
    let (mut parts, mut section, mut note, mut fence): (
        Vec<Part>,
        Option<String>,
        Option<String>,
        Option<Part>,
    ) = (Vec::new(), None, None, None);
    let mut table: Option<Part> = None;
    for (n, line) in text.lines().enumerate() {
        if let Some(block) = &mut fence {
            if line.trim_start().starts_with("```") {
                parts.extend(fence.take());
            } else {
                block.text.push(line.trim_end().to_owned());
            }
            continue;
        }
        if !line.trim_start().starts_with('|') {
            parts.extend(table.take());
        }
        let part = |note: &mut Option<String>| Part {
            line: n + 1,
            text: Vec::new(),
            note: note.take().or_else(|| section.clone()),
        };
        if let Some(told) = line.trim().strip_prefix("<!-- ").and_then(|rest| rest.strip_suffix(" -->")) {
            match told.strip_prefix("section ") {
                Some(told) => section = Some(told.into()),
                None => note = Some(told.into()),
            }
        } else if line.starts_with('#') {
            (section, note) = (None, None);
        } else if line.trim_start().starts_with("```text") {
            fence = Some(part(&mut note));
        } else if line.trim_start().starts_with('|') {
            let table = table.get_or_insert_with(|| part(&mut note));
            table.text.push(line.to_owned());
        }
    }
    parts.extend(table);
    parts
}

#[test]
fn every_measured_number_names_the_command_that_prints_it() {
    let mut bare = Vec::new();
    for page in documents() {
        let name = page.strip_prefix(program::workspace()).unwrap().display().to_string();
        for part in parts(&page) {
            let known = |note: &str| {
                let stamped = note.strip_prefix("printed at ").and_then(|rest| rest.split_once(" by: "));
                let revision = stamped.is_some_and(|(at, by)| {
                    let at = at.strip_suffix(" or before").unwrap_or(at);
                    (7..=40).contains(&at.len())
                        && at.bytes().all(|b| b.is_ascii_hexdigit())
                        && !by.is_empty()
                });
                revision || note == "values" || note.starts_with("prints: ")
            };
            if part.measures() && !part.note.as_deref().is_some_and(known) {
                bare.push(format!("{name}:{}: {:?}", part.line, part.note));
            }
        }
    }
    assert!(bare.is_empty(), "no command is named for\n{}", bare.join("\n"));
}

/// A line without what differs from run to run: times, and how much faster than real time.
fn lasting(line: &str) -> String {
    let varies = ["frame to command", "times real time"].iter().any(|what| line.starts_with(what));
    if varies { String::new() } else { line.trim_end().to_owned() }
}

#[test]
fn commands_print_what_the_pages_say() {
    let folder = tempfile::tempdir().unwrap();
    let mut checked = 0;
    for page in documents() {
        for part in parts(&page) {
            let Some(line) = part.note.as_deref().and_then(|note| note.strip_prefix("prints: ")) else {
                continue;
            };
            let mut words = line.split(' ');
            let mut command = Command::new(program::path(words.next().unwrap()).unwrap());
            command.args(words).current_dir(folder.path()).env("CRPL_CACHE", folder.path().join("cache"));
            let said = Program::spawn(line, command).unwrap().wait().unwrap().good().unwrap();
            let said: Vec<String> = said.trim_end().lines().map(lasting).collect();
            let stated: Vec<String> = part.text.iter().map(|line| lasting(line)).collect();
            assert!(said == stated, "{}:{}: `{line}` prints\n{}", page.display(), part.line, said.join("\n"));
            checked += 1;
        }
    }
    assert!(checked > 0, "no page states what a command prints");
}

#[test]
fn every_camera_with_a_name_stands_in_docs_camera_under_its_number() {
    let page = std::fs::read_to_string(program::workspace().join("docs/camera.md")).unwrap();
    for (number, case) in crpl_sitl::camera::cases::CASES.iter().enumerate() {
        let row = format!("| {number} | `{}` | {} |", case.name, case.about);
        assert!(page.contains(&row), "{row}");
    }
}

/// Report V18: north is down in the picture and up in the plot, said nowhere near.
#[test]
fn pages_about_pictures_say_that_north_is_down_in_them() {
    for page in ["docs/camera.md", "docs/mavlink.md"] {
        let text = std::fs::read_to_string(program::workspace().join(page)).unwrap().to_lowercase();
        assert!(text.contains("north is down"), "{page}");
        assert!(text.contains("plots have north up"), "{page}");
    }
}
