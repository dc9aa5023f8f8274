//! Parameter files, as ground stations write them. Knows names and numbers, not what they mean.
//!
//! | written by | a line |
//! |---|---|
//! | MAVProxy, pymavlink | `NAME 1.5` |
//! | Mission Planner | `NAME,1.5` |
//! | QGroundControl | system, component, name, value and type, between tabs |
//!
//! `#` begins a comment. Written is MAVProxy's form, which all but QGroundControl read.

use std::fmt::Write;

/// A parameter of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Its line, from 1.
    pub line: usize,
    /// At most 16 characters.
    pub name: String,
    /// Finite.
    pub value: f32,
}

/// A line that is no parameter's.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: `{text}` is no parameter: expected a name and a number")]
pub struct NoParam {
    /// From 1.
    pub line: usize,
    /// What stands there.
    pub text: String,
}

/// The parameters of a file, in its order.
///
/// # Errors
/// A line that is no parameter: the error names it.
pub fn parse(text: &str) -> Result<Vec<Entry>, NoParam> {
    // Some editors mark their files so.
    let text = text.trim_start_matches('\u{feff}');
    let lines =
        text.lines().enumerate().map(|(k, text)| (k + 1, text.split('#').next().unwrap_or("").trim()));
    lines
        .filter(|(_, text)| !text.is_empty())
        .map(|(line, text)| entry(line, text).ok_or_else(|| NoParam { line, text: excerpt(text) }))
        .collect()
}

/// What an error shows of a line: neither megabytes nor what a terminal would obey.
#[must_use]
pub fn excerpt(text: &str) -> String {
    const MOST: usize = 60;
    let cut = if text.chars().nth(MOST).is_some() { "..." } else { "" };
    text.chars().take(MOST).flat_map(shown).collect::<String>() + cut
}

fn shown(c: char) -> impl Iterator<Item = char> {
    let (plain, escaped) = if c.is_control() { (None, Some(c.escape_default())) } else { (Some(c), None) };
    plain.into_iter().chain(escaped.into_iter().flatten())
}

fn entry(line: usize, text: &str) -> Option<Entry> {
    let fields: Vec<&str> =
        text.split(|c: char| c == ',' || c.is_whitespace()).filter(|field| !field.is_empty()).collect();
    let (name, value) = match fields[..] {
        [name, value] => (name, value),
        [_, _, name, value, _] => (name, value),
        _ => return None,
    };
    let value = value.parse().ok().filter(|value: &f32| value.is_finite())?;
    (name.len() <= 16).then(|| Entry { line, name: name.into(), value })
}

/// A file with these parameters.
#[must_use]
pub fn write<'a>(params: impl IntoIterator<Item = (&'a str, f32)>) -> String {
    params.into_iter().fold(String::new(), |mut text, (name, value)| {
        // A number's shortest decimals that give the same number again.
        writeln!(text, "{name:<16} {value}").expect("a String takes every text");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_station_s_form_is_read() {
        let text = "# MAVProxy\nA_ONE 1.5\n  A_TWO\t-2e-3 # twice\nB_ONE,3\n\n1\t1\tC_ONE\t4.25\t9\n";
        let found: Vec<(usize, String, f32)> =
            parse(text).unwrap().into_iter().map(|e| (e.line, e.name, e.value)).collect();
        let expected = [(2, "A_ONE", 1.5), (3, "A_TWO", -2e-3), (4, "B_ONE", 3.0), (6, "C_ONE", 4.25)];
        assert_eq!(found, expected.map(|(line, name, value)| (line, name.to_owned(), value)));
    }

    /// It was refused as a parameter with a puzzling name.
    #[test]
    fn a_byte_order_mark_is_no_parameter() {
        assert_eq!(parse("\u{feff}A 1\n").unwrap()[0].name, "A");
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for bad in ["A", "A B", "A nan", "A inf", "A 1 2", "A_NAME_THAT_IS_TOO_LONG 1"] {
            let error = parse(&format!("GOOD 1\n{bad}\n")).unwrap_err().to_string();
            assert!(error.starts_with("line 2: ") && error.contains(bad), "{error}");
        }
    }

    /// A file without line ends was shown whole, 5 MB long.
    #[test]
    fn an_error_shows_a_part_of_a_long_line_and_no_control_characters() {
        let error = parse(&"A".repeat(5_000_000)).unwrap_err().to_string();
        assert!(error.len() < 150 && error.contains("AAA..."), "{error}");
        let error = parse("A\u{1b}[2J").unwrap_err().to_string();
        assert!(error.contains("A\\u{1b}[2J"), "{error}");
    }

    #[test]
    fn what_is_written_is_read_again() {
        let params = [("A", 0.1), ("B", 1e-9), ("C", 16_777_215.0), ("D", -3.0)];
        let back: Vec<(String, f32)> =
            parse(&write(params)).unwrap().into_iter().map(|e| (e.name, e.value)).collect();
        assert_eq!(back, params.map(|(name, value)| (name.to_owned(), value)));
    }
}
