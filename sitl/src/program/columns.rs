//! Tables of text that are no wider than the terminal: columns that do not fit follow below, behind the first one
//! again.

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
/// not fit follow below, behind the first one again.
#[must_use]
pub fn folded(lines: &str, columns: &[usize], width: Option<usize>) -> String {
    let mut text = String::new();
    let width = width.filter(|_| !lines.is_empty());
    for (n, block) in blocks(columns, width).iter().enumerate() {
        text.push_str(if n == 0 { "" } else { "\n" });
        for line in lines.lines() {
            let cells = block.iter().map(|n| {
                let before: usize = columns[..*n].iter().sum();
                line.chars().skip(before).take(columns[*n]).collect::<String>()
            });
            text.push_str(cells.collect::<String>().trim_end());
            text.push('\n');
        }
    }
    text
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
        assert_eq!(
            folded(lines, &[5, 4, 7], Some(12)),
            "  x  who\n  1  crpl\n\n  x      d_f\n  1    0.004\n"
        );
    }
}
