//! Parameter files: `NAME VALUE` (MAVProxy; a comma or a tab will do, as Mission Planner writes) and
//! QGroundControl's five columns `SYSTEM COMPONENT NAME VALUE TYPE`.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};
use crpl_sitl::link::param_file::excerpt;
use crpl_sitl::program::files;

use super::exchange::Param;

/// One parameter of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// Line of the file, from 1.
    pub number: usize,
    /// Name.
    pub name: String,
    /// Value as it is written.
    pub value: String,
    /// System and component that it is for, where the file says so.
    pub of: Option<(u8, u8)>,
}

/// Reads a file of either kind.
///
/// # Errors
/// The file cannot be read, or a line is no parameter.
pub fn read(path: &Path) -> Result<Vec<Line>> {
    let text = files::read_text(path).with_context(|| format!("reading {}", path.display()))?;
    let lines = parse(&text).with_context(|| path.display().to_string())?;
    if lines.is_empty() {
        bail!("{}: no parameter in it", path.display());
    }
    Ok(lines)
}

/// Reads a text of either kind.
///
/// # Errors
/// A line is no parameter.
pub fn parse(text: &str) -> Result<Vec<Line>> {
    let mut lines = Vec::new();
    for (k, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default();
        let words: Vec<_> =
            line.split([',', '\t', ' ']).map(str::trim).filter(|word| !word.is_empty()).collect();
        let (name, value, of) = match words[..] {
            [] => continue,
            [name, value] => (name, value, None),
            [system, component, name, value, _] => {
                let id = |text: &str| {
                    text.parse::<u8>()
                        .with_context(|| format!("line {}: `{}` is no id", k + 1, excerpt(text)))
                };
                (name, value, Some((id(system)?, id(component)?)))
            }
            _ => bail!("line {}: expected NAME VALUE, found `{}`", k + 1, excerpt(line.trim())),
        };
        if value.parse::<f64>().is_err() {
            bail!("line {}: {}: `{}` is no number", k + 1, excerpt(name), excerpt(value));
        }
        lines.push(Line { number: k + 1, name: name.into(), value: value.into(), of });
    }
    Ok(lines)
}

/// Writes all; QGroundControl's columns if the file's name ends so.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, params: &[Param], (system, component): (u8, u8)) -> Result<()> {
    let columns = path.extension().is_some_and(|end| end == "params");
    let mut text = String::new();
    if columns {
        let _ = writeln!(text, "# Vehicle-Id Component-Id Name Value Type");
    }
    for param in params {
        let _ = if columns {
            let code = param.kind.code();
            writeln!(text, "{system}\t{component}\t{}\t{}\t{code}", param.name, param.value)
        } else {
            writeln!(text, "{param}")
        };
    }
    std::fs::write(path, text).with_context(|| format!("writing {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(text: &str) -> Vec<(usize, String, String)> {
        parse(text).unwrap().into_iter().map(|line| (line.number, line.name, line.value)).collect()
    }

    #[test]
    fn the_files_that_people_have_are_read() {
        let expected = [(2, "RTL_ALT".into(), "1500".into()), (3, "WPNAV_SPEED".into(), "-0.5".into())];
        assert_eq!(names("# MAVProxy\nRTL_ALT          1500\nWPNAV_SPEED -0.5  # slow\n"), expected);
        assert_eq!(names("#NOTE: Mission Planner\r\nRTL_ALT,1500\r\nWPNAV_SPEED,-0.5\r\n"), expected);
        assert_eq!(names("# QGC\n1\t1\tRTL_ALT\t1500\t6\n1\t1\tWPNAV_SPEED\t-0.5\t9\n"), expected);
    }

    #[test]
    fn a_bad_line_is_named() {
        for (text, why) in [
            ("A 1\nB\n", "line 2: expected NAME VALUE, found `B`"),
            ("A one\n", "line 1: A: `one` is no number"),
            ("A 1 2\n", "line 1: expected"),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.starts_with(why), "{error}");
        }
    }
}
