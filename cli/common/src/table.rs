//! Columns of text, as wide as they need to be and no wider than the terminal.

use std::io::IsTerminal;

use comfy_table::{CellAlignment, ContentArrangement, Row, Table, presets};
use terminal_size::{Width, terminal_size_of};

/// How wide a table may be where nobody says.
const WIDE: usize = 160;
/// Blanks between columns.
const GAP: u16 = 2;

/// A column.
#[derive(Debug, Clone, Copy)]
pub struct Column {
    /// What stands above it.
    pub title: &'static str,
    /// Whether it holds numbers.
    pub right: bool,
    /// Whether it is left out where it says nothing: where all its numbers are 0.
    rare: bool,
}

/// A column of text.
pub const fn left(title: &'static str) -> Column {
    Column {
        title,
        right: false,
        rare: false,
    }
}

/// A column of numbers.
pub const fn right(title: &'static str) -> Column {
    Column {
        title,
        right: true,
        rare: false,
    }
}

/// A column of numbers that are 0 mostly: shown where one is not.
pub const fn rare(title: &'static str) -> Column {
    Column {
        title,
        right: true,
        rare: true,
    }
}

/// How wide the terminal is.
pub fn width() -> usize {
    let stdout = std::io::stdout();
    if !stdout.is_terminal() {
        return WIDE;
    }
    terminal_size_of(stdout).map_or(80, |(Width(columns), _)| usize::from(columns))
}

/// The rows below their titles, no line wider than `width`: what does not fit is cut and ends in `…`.
pub fn lines(columns: &[Column], rows: &[Vec<String>], width: usize) -> Vec<String> {
    let says_something = |index: &usize| {
        let rare = columns.get(*index).is_some_and(|column| column.rare);
        let mut cells = rows.iter().filter_map(|row| row.get(*index));
        !rare || cells.any(|cell| cell != "0")
    };
    let kept: Vec<usize> = (0..columns.len()).filter(says_something).collect();
    let columns: Vec<Column> = kept
        .iter()
        .filter_map(|at| columns.get(*at).copied())
        .collect();
    let mut table = Table::new();
    table
        .load_style(presets::NOTHING)
        .set_truncation_indicator("…")
        .set_content_arrangement(ContentArrangement::Dynamic)
        // The gap after the last column is cut off below.
        .set_width(u16::try_from(width).map_or(u16::MAX, |width| width.saturating_add(GAP)));
    table.set_header(line(columns.iter().map(|column| column.title)));
    for row in rows {
        table.add_row(line(kept.iter().filter_map(|at| row.get(*at))));
    }
    for (shown, column) in table.column_iter_mut().zip(&columns) {
        shown.set_padding((0, GAP));
        if column.right {
            shown.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
        .lines()
        .map(|line| line.trim_end().to_owned())
        .collect()
}

/// A row of one line, whatever its cells hold.
fn line<T: ToString>(cells: impl Iterator<Item = T>) -> Row {
    let mut line = Row::from(cells.collect::<Vec<T>>());
    line.max_height(1);
    line
}

/// `text`, cut to `width` letters.
pub fn fitted(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let mut cut: String = text.chars().take(width.saturating_sub(1)).collect();
    cut.push('…');
    cut
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_as_wide_as_it_needs_to_be_and_no_wider_than_it_may() {
        let columns = [left("TASK"), right("HANDLED"), left("DOES")];
        let rows = [
            vec!["arm".into(), "12".into(), "idle".into()],
            vec![
                "gripper".into(),
                "3".into(),
                "waits 3.2 s for camera: look".into(),
            ],
        ];
        let wide = lines(&columns, &rows, 100);
        assert_eq!(
            wide,
            [
                "TASK     HANDLED  DOES",
                "arm           12  idle",
                "gripper        3  waits 3.2 s for camera: look",
            ]
        );
        let narrow = lines(&columns, &rows, 30);
        assert_eq!(narrow[2], "gripper        3  waits 3.2 s…");
        assert!(narrow.iter().all(|line| line.chars().count() <= 30));
    }

    #[test]
    fn a_rare_column_is_there_when_it_says_something() {
        let columns = [left("TASK"), rare("RESTARTS"), left("DOES")];
        let row = |restarts: &str| vec!["arm".to_owned(), restarts.to_owned(), "idle".to_owned()];
        assert_eq!(
            lines(&columns, &[row("0")], 80),
            ["TASK  DOES", "arm   idle"]
        );
        let both = lines(&columns, &[row("0"), row("2")], 80);
        assert_eq!(both[0], "TASK  RESTARTS  DOES");
        assert_eq!(both[2], "arm          2  idle");
    }
}
