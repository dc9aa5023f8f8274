//! What the sources promise about their own structure: bytes live in `link`, a crate's top level is short,
//! and no modules import each other in a circle.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

/// The crates whose modules import each other in no circle.
const WITHOUT_CIRCLES: [&str; 3] = ["sitl", "model", "gcs"];
/// Files and folders at the top of a crate's src/.
const MAX_ENTRIES: usize = 10;

#[test]
fn the_top_level_of_a_crate_is_short() {
    for name in ["sitl", "model", "gcs"] {
        let entries = std::fs::read_dir(src(name)).expect("the sources can be read").count();
        assert!(entries <= MAX_ENTRIES, "{name}/src has {entries} entries, at most {MAX_ENTRIES}");
    }
}

#[test]
fn only_the_link_names_the_mavlink_crate() {
    let link = src("sitl").join("link");
    let found = ["sitl", "gcs"].into_iter().flat_map(|name| lines(&src(name))).filter(|(path, _, line)| {
        let names = line.contains("mavlink::") || line.contains("use mavlink");
        names && !path.starts_with(&link)
    });
    none(found, "crpl_sitl::link re-exports what others need");
}

#[test]
fn offsets_in_payloads_stand_in_link_messages_alone() {
    let messages = src("sitl").join("link/messages");
    let found = ["sitl", "gcs"]
        .into_iter()
        .flat_map(|name| lines(&src(name)))
        .filter(|(path, _, line)| !path.starts_with(&messages) && !is_test(path) && reads_payload(line));
    none(found, "crpl_sitl::link::messages has a view of each message");
}

/// `x.u16(28)`, `payload()[28]`, `payload[28..]`, `payload().get(28)`.
fn reads_payload(line: &str) -> bool {
    const READERS: [&str; 11] = [
        ".u8(",
        ".u16(",
        ".u32(",
        ".u64(",
        ".f32(",
        ".text(",
        ".byte(",
        ".target(",
        "payload()[",
        "payload[",
        "payload().get(",
    ];
    READERS.iter().any(|reader| {
        let mut behind = line.match_indices(reader).map(|(at, _)| &line[at + reader.len()..]);
        behind.any(|rest| rest.starts_with(|c: char| c.is_ascii_digit()))
    })
}

/// Each has a plain meaning in its module, and ARCHITECTURE.md says which.
const TWICE: [&str; 3] = ["Args", "Command", "Encoder"];

#[test]
fn names_of_types_are_unique_across_the_crates() {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for path in ["sitl", "model", "gcs"].into_iter().flat_map(|name| files(&src(name))) {
        if is_test(&path) {
            continue;
        }
        for line in code(&path).lines() {
            let words: Vec<&str> = line
                .split(|c: char| !c.is_alphanumeric() && c != '_')
                .filter(|word| !word.is_empty())
                .collect();
            let kind = words.iter().position(|word| ["struct", "enum", "trait"].contains(word));
            let visible = |at: usize| words[..at].iter().all(|word| ["pub", "crate", "super"].contains(word));
            if let Some(name) = kind.filter(|at| visible(*at)).and_then(|at| words.get(at + 1)) {
                places.entry((*name).to_owned()).or_default().push(path.display().to_string());
            }
        }
    }
    assert!(places.len() > 100, "no types were read");
    places.retain(|name, places| places.len() > 1 && !TWICE.contains(&name.as_str()));
    assert!(places.is_empty(), "{places:#?}");
}

#[test]
fn no_modules_import_each_other_in_a_circle() {
    let circles: Vec<String> = WITHOUT_CIRCLES
        .into_iter()
        .flat_map(|name| {
            let files = imports(&src(name));
            assert!(files.values().map(BTreeSet::len).sum::<usize>() > 100, "{name}: no imports were read");
            let folders = folders(&files);
            [circle(&files), circle(&folders)]
                .into_iter()
                .flatten()
                .map(move |circle| format!("{name}: {}", circle.join(" -> ")))
        })
        .collect();
    assert!(circles.is_empty(), "{}", circles.join("\n"));
}

#[test]
fn circles_are_found() {
    let graph = |edges: &[(&str, &str)]| {
        let mut graph = Graph::new();
        for (from, to) in edges {
            graph.entry((*from).into()).or_default().insert((*to).into());
        }
        graph
    };
    assert_eq!(circle(&graph(&[("a", "b"), ("b", "c"), ("a", "c")])), None);
    let long = graph(&[("a", "b"), ("b", "c"), ("c", "d"), ("d", "b")]);
    assert_eq!(circle(&long), Some(["b", "c", "d", "b"].map(String::from).to_vec()));
    assert_eq!(
        paths("link::{self, wire::{A, b::C}, d as e};"),
        [vec!["link"], vec!["link", "wire", "A"], vec!["link", "wire", "b", "C"], vec!["link", "d"]]
    );
    assert_eq!(paths("units::Tick(3) + 1"), [["units", "Tick"]]);
}

/// Module to the modules that it imports, by paths such as `link::wire`; the crate's root is empty.
type Graph = BTreeMap<String, BTreeSet<String>>;

/// The imports among a crate's files. A module and what is below it are one house: that a child uses its
/// ancestors is no import.
fn imports(src: &Path) -> Graph {
    let sources: BTreeMap<String, String> = files(src)
        .into_iter()
        .filter(|path| !path.ends_with("main.rs") && !is_test(path))
        .map(|path| (module(src, &path), code(&path)))
        .collect();
    let known = |path: &[&str]| {
        (1..=path.len()).rev().map(|n| path[..n].join("::")).find(|name| sources.contains_key(name))
    };
    // What lib.rs re-exports under a shorter name.
    let short: BTreeMap<&str, Vec<&str>> = sources
        .get("")
        .map(|root| root.match_indices("pub use ").flat_map(|(at, key)| paths(&root[at + key.len()..])))
        .into_iter()
        .flatten()
        .filter_map(|path| Some((*path.last()?, path.clone())))
        .collect();
    let mut graph = Graph::new();
    for (name, text) in &sources {
        let own: Vec<&str> = name.split("::").filter(|part| !part.is_empty()).collect();
        let mut found: Vec<Vec<&str>> = Vec::new();
        for (at, _) in text.match_indices("crate::") {
            for path in paths(&text[at + "crate::".len()..]) {
                let full = path.first().and_then(|first| short.get(first)).filter(|_| path.len() == 1);
                found.push(full.cloned().unwrap_or(path));
            }
        }
        for (at, _) in text.match_indices("super::") {
            // In super::super:: the last one counts both.
            if text[at..].starts_with("super::super::") {
                continue;
            }
            let levels =
                1 + text[..at].len().saturating_sub(text[..at].trim_end_matches("super::").len()) / 7;
            let parent = &own[..own.len().saturating_sub(levels)];
            found.extend(paths(&text[at + 7..]).into_iter().map(|path| [parent, &path].concat()));
        }
        // A child by its own name.
        let prefix = if name.is_empty() { String::new() } else { format!("{name}::") };
        let children = sources.keys().filter_map(|other| other.strip_prefix(&prefix));
        for child in children.filter(|child| !child.is_empty() && !child.contains("::") && !name.is_empty()) {
            let called = text
                .match_indices(&format!("{child}::"))
                .any(|(at, _)| !text[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':'));
            if called {
                found.push([&own[..], &[child]].concat());
            }
        }
        let edges = found.iter().filter_map(|path| known(path)).filter(|to| {
            let ancestor = name == to || name.starts_with(&format!("{to}::"));
            !ancestor
        });
        graph.insert(name.clone(), edges.collect());
    }
    graph
}

/// The same among the folders at the top.
fn folders(files: &Graph) -> Graph {
    let top = |name: &str| name.split("::").next().unwrap_or_default().to_owned();
    let mut graph = Graph::new();
    for (from, to) in files.iter().filter(|(from, _)| !from.is_empty()) {
        let to = to.iter().map(|to| top(to)).filter(|to| *to != top(from));
        graph.entry(top(from)).or_default().extend(to);
    }
    graph
}

/// The shortest way from a module back to itself.
fn circle(graph: &Graph) -> Option<Vec<String>> {
    let back = |start: &String| {
        let mut queue = VecDeque::from([vec![start.clone()]]);
        let mut seen = BTreeSet::new();
        while let Some(path) = queue.pop_front() {
            for next in path.last().and_then(|last| graph.get(last)).into_iter().flatten() {
                let longer = [&path[..], std::slice::from_ref(next)].concat();
                if next == start {
                    return Some(longer);
                }
                if seen.insert(next.clone()) {
                    queue.push_back(longer);
                }
            }
        }
        None
    };
    graph.keys().filter_map(back).min_by_key(Vec::len)
}

/// The paths of a use tree, or of an expression, at the beginning of a text.
fn paths(text: &str) -> Vec<Vec<&str>> {
    let text = text.trim_start();
    if let Some(group) = text.strip_prefix('{') {
        let (mut depth, mut begin, mut found) = (0, 0, Vec::new());
        for (at, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                ',' if depth == 0 => {
                    found.extend(paths(&group[begin..at]));
                    begin = at + 1;
                }
                '}' if depth == 0 => {
                    found.extend(paths(&group[begin..at]));
                    break;
                }
                '}' => depth -= 1,
                _ => {}
            }
        }
        return found;
    }
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
    let (name, rest) = text.split_at(end);
    match rest.strip_prefix("::") {
        _ if name.is_empty() => Vec::new(),
        _ if name == "self" => vec![vec![]],
        Some(rest) => {
            let inner = paths(rest);
            let inner = if inner.is_empty() { vec![vec![]] } else { inner };
            inner.into_iter().map(|path| [&[name][..], &path].concat()).collect()
        }
        None => vec![vec![name]],
    }
}

fn src(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name).join("src")
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).expect("the sources can be read") {
        let path = entry.expect("the sources can be read").path();
        if path.is_dir() {
            found.extend(files(&path));
        } else if path.extension().is_some_and(|end| end == "rs") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Whether a file under src/ holds tests alone.
fn is_test(path: &Path) -> bool {
    let mut below = path.iter().rev().take_while(|part| *part != "src");
    below.any(|part| part == "tests" || part == "tests.rs")
}

/// The module of a file: `link::wire` of link/wire/mod.rs.
fn module(src: &Path, path: &Path) -> String {
    let path = path.strip_prefix(src).expect("a file of the crate").with_extension("");
    let parts: Vec<_> = path.iter().map(|part| part.to_str().expect("UTF-8")).collect();
    let parts = match parts.split_last() {
        Some((&("mod" | "lib"), above)) => above,
        _ => &parts[..],
    };
    parts.join("::")
}

/// A file without its comments and its tests.
fn code(path: &Path) -> String {
    let text = std::fs::read_to_string(path).expect("the sources can be read");
    let text = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    let lines = text.lines().filter(|line| !line.trim_start().starts_with("//"));
    lines.map(|line| line.split(" // ").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// Path, number and text of each line, tests and comments included.
fn lines(folder: &Path) -> Vec<(PathBuf, usize, String)> {
    let numbered = files(folder).into_iter().flat_map(|path| {
        let text = std::fs::read_to_string(&path).expect("the sources can be read");
        let lines: Vec<_> =
            text.lines().enumerate().map(|(k, line)| (path.clone(), k + 1, line.to_owned())).collect();
        lines
    });
    numbered.collect()
}

fn none(found: impl Iterator<Item = (PathBuf, usize, String)>, instead: &str) {
    let found: Vec<String> =
        found.map(|(path, number, line)| format!("{}:{number}: {}", path.display(), line.trim())).collect();
    assert!(found.is_empty(), "{instead}:\n{}", found.join("\n"));
}
