//! Tables and sentences that are no wider than the terminal: columns that do not fit follow below, words on the next
//! line.

use std::io::IsTerminal;

/// Width of the terminal that stdout is; `None` if it is none, and lines may be of any length.
#[must_use]
pub fn width() -> Option<usize> {
    let stdout = std::io::stdout();
    if !stdout.is_terminal() {
        return None;
    }
    terminal_size::terminal_size_of(stdout).map(|(width, _)| usize::from(width.0))
}

/// Lines of a table whose columns have these widths, folded where they are wider than `width`: the columns that do
/// not fit follow below, behind the first one again. A line that does not stand in these columns is wrapped.
#[must_use]
pub fn folded(lines: &str, columns: &[usize], width: Option<usize>) -> String {
    let fits = |width: &usize| lines.lines().any(|line| line.chars().count() > *width);
    let Some(width) = width.filter(fits) else { return whole(lines) };
    let mut text = String::new();
    for (n, block) in blocks(columns, Some(width)).iter().enumerate() {
        text.push_str(if n == 0 { "" } else { "\n" });
        for line in lines.lines() {
            if stands_in(line, columns) {
                text.push_str(cells(line, columns, block).trim_end());
                text.push('\n');
            } else if n == 0 {
                text.push_str(&wrapped(line, 2, Some(width)));
            }
        }
    }
    text
}

/// One line of such a table, which is printed before the next one is known: what does not fit stands below.
#[must_use]
pub fn folded_line(line: &str, columns: &[usize], width: Option<usize>) -> String {
    let Some(width) = width.filter(|width| line.chars().count() > *width) else { return whole(line) };
    if !stands_in(line, columns) {
        return wrapped(line, 2, Some(width));
    }
    let first = columns.first().copied().unwrap_or_default();
    let mut text = String::new();
    for (n, block) in blocks(columns, Some(width)).iter().enumerate() {
        let begin = if n == 0 { String::new() } else { " ".repeat(first) };
        let block = if n == 0 { block } else { &block[1..] };
        text.push_str((begin + &cells(line, columns, block)).trim_end());
        text.push('\n');
    }
    text
}

/// Sentences, broken between words where they are wider than `width`; what follows stands `indent` blanks in.
#[must_use]
pub fn wrapped(lines: &str, indent: usize, width: Option<usize>) -> String {
    let Some(width) = width else { return whole(lines) };
    let mut text = String::new();
    for line in lines.lines() {
        let mut used = 0;
        for (n, word) in line.split(' ').enumerate() {
            let long = word.chars().count();
            if n > 0 && used + 1 + long > width && used > indent {
                text.truncate(text.trim_end_matches(' ').len());
                text.push('\n');
                text.push_str(&" ".repeat(indent));
                used = indent;
            } else if n > 0 {
                text.push(' ');
                used += 1;
            }
            text.push_str(word);
            used += long;
        }
        text.push('\n');
    }
    text
}

/// Each line as it is.
fn whole(lines: &str) -> String {
    lines.lines().map(|line| format!("{}\n", line.trim_end())).collect()
}

/// The cells of a line that stand in some columns.
fn cells(line: &str, columns: &[usize], block: &[usize]) -> String {
    let cell = |n: &usize| {
        let before: usize = columns[..*n].iter().sum();
        // The last column takes what is left.
        let room = if n + 1 == columns.len() { usize::MAX } else { columns[*n] };
        line.chars().skip(before).take(room).collect::<String>()
    };
    block.iter().map(cell).collect()
}

/// Whether no cell of a line reaches into the next column.
fn stands_in(line: &str, columns: &[usize]) -> bool {
    let line: Vec<char> = line.chars().collect();
    let mut end = 0;
    columns.iter().take(columns.len().saturating_sub(1)).all(|column| {
        end += column;
        let is_blank = |at: usize| line.get(at).is_none_or(|c| *c == ' ');
        end == 0 || is_blank(end - 1) || is_blank(end)
    })
}

/// Head and rows, right-aligned, two blanks before each cell; folded where they are wider than `width`.
#[must_use]
pub fn table(head: &[String], rows: &[Vec<String>], width: Option<usize>) -> String {
    let room: Vec<usize> = (0..head.len())
        .map(|n| {
            let cells = rows.iter().filter_map(|row| row.get(n)).chain([&head[n]]);
            cells.map(|cell| cell.chars().count()).max().unwrap_or_default() + 2
        })
        .collect();
    let mut text = String::new();
    for (n, columns) in blocks(&room, width).iter().enumerate() {
        text.push_str(if n == 0 { "" } else { "\n" });
        for row in std::iter::once(head).chain(rows.iter().map(Vec::as_slice)) {
            let cells = columns.iter().filter_map(|n| Some((row.get(*n)?, room[*n])));
            text.extend(cells.map(|(cell, room)| format!("{cell:>room$}")));
            text.push('\n');
        }
    }
    text
}

/// The columns of each block: the first of all, and as many others as fit, but one at least.
fn blocks(room: &[usize], width: Option<usize>) -> Vec<Vec<usize>> {
    let Some(width) = width else { return vec![(0..room.len()).collect()] };
    let first = room.first().copied().unwrap_or_default();
    let (mut blocks, mut used) = (vec![vec![0]], first);
    for (n, room) in room.iter().enumerate().skip(1) {
        if used + room > width && used > first {
            blocks.push(vec![0]);
            used = first;
        }
        used += room;
        if let Some(block) = blocks.last_mut() {
            block.push(n);
        }
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_no_wider_than_the_terminal() {
        let words = |row: &[&str]| row.iter().map(ToString::to_string).collect::<Vec<_>>();
        let (head, rows) =
            (words(&["who", "d_f", "E_comm", "T_out"]), [words(&["crpl", "0.0047", "100", "0"])]);
        assert_eq!(
            table(&head, &rows, None),
            "   who     d_f  E_comm  T_out\n  crpl  0.0047     100      0\n"
        );
        let folded = table(&head, &rows, Some(16));
        assert_eq!(folded.split("\n\n").count(), 3);
        assert!(folded.lines().all(|line| line.len() <= 16), "{folded}");
        assert_eq!(folded.matches("crpl").count(), 3);
    }

    #[test]
    fn lines_are_cut_where_their_columns_end() {
        let lines = "  x  who     d_f\n  1  crpl  0.004\n";
        assert_eq!(folded(lines, &[5, 4, 7], None), lines);
        let narrow = "  x  who\n  1  crpl\n\n  x      d_f\n  1    0.004\n";
        assert_eq!(folded(lines, &[5, 4, 7], Some(12)), narrow);
        assert_eq!(
            folded(&(lines.to_owned() + "no table"), &[5, 4, 7], Some(16)),
            lines.to_owned() + "no table\n"
        );
        assert_eq!(folded_line("  1  crpl  0.004", &[5, 4, 7], Some(12)), "  1  crpl\n       0.004\n");
        // A name that is longer than its column is cut nowhere.
        let long = folded(&(lines.to_owned() + "  2  somebody 0.005\n"), &[5, 4, 7], Some(12));
        assert!(long.contains("  2\n  somebody\n  0.005\n") && long.contains("  1    0.004"), "{long}");
    }

    #[test]
    fn sentences_are_broken_between_words() {
        assert_eq!(wrapped("name  one two\nthree\n", 6, None), "name  one two\nthree\n");
        assert_eq!(wrapped("name  one two\nthree\n", 6, Some(10)), "name  one\n      two\nthree\n");
        assert_eq!(wrapped("longerthanall", 2, Some(5)), "longerthanall\n");
    }
}
