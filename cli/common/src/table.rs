//! Columns of text, as wide as they need to be and no wider than the terminal.

use std::{
    io::{self, IsTerminal},
    os::fd::AsFd,
};

use comfy_table::{CellAlignment, ContentArrangement, Row, Table, presets};
use terminal_size::{Width, terminal_size_of};
use textwrap::{Options, WordSeparator, WordSplitter, WrapAlgorithm};

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
    /// What it holds mostly: it is left out where it holds nothing else.
    usual: Option<&'static str>,
}

/// A column of text.
pub const fn left(title: &'static str) -> Column {
    Column {
        title,
        right: false,
        usual: None,
    }
}

/// A column of numbers.
pub const fn right(title: &'static str) -> Column {
    Column {
        title,
        right: true,
        usual: None,
    }
}

/// A column of numbers that are 0 mostly: shown where one is not.
pub const fn rare(title: &'static str) -> Column {
    Column {
        title,
        right: true,
        usual: Some("0"),
    }
}

impl Column {
    /// The same one, shown where a row has something else than `usual`.
    pub const fn unless(self, usual: &'static str) -> Self {
        let usual = Some(usual);
        Self { usual, ..self }
    }
}

/// How wide the terminal is.
pub fn width() -> usize {
    terminal(io::stdout()).unwrap_or(WIDE)
}

/// How wide the terminal at a stream is, if there is one.
pub fn terminal(stream: impl IsTerminal + AsFd) -> Option<usize> {
    stream
        .is_terminal()
        .then(|| terminal_size_of(stream).map_or(80, |(Width(columns), _)| usize::from(columns)))
}

/// A text as a terminal shows it: its long lines [`wrapped`]. Other outputs get it as it is.
pub fn for_terminal(text: &str) -> String {
    terminal(io::stdout()).map_or_else(|| text.to_owned(), |width| wrapped(text, width))
}

/// As [`for_terminal`], for what is said on standard error.
pub fn for_messages(text: &str) -> String {
    terminal(io::stderr()).map_or_else(|| text.to_owned(), |width| wrapped(text, width))
}

/// `text` with its lines that are longer than `width` broken between words, which a terminal would break anywhere. What
/// follows of such a line stands below its second column, which begins after two blanks, or is indented.
pub fn wrapped(text: &str, width: usize) -> String {
    let lines = text.lines().map(|line| {
        let start = line.len() - line.trim_start().len();
        let second = line.trim_start().split_once("  ");
        let second = second.map(|(_, second)| line.len() - second.trim_start().len());
        let column = second.filter(|column| *column <= width / 2);
        let indent = " ".repeat(column.unwrap_or(start + 2).min(width / 2));
        let options = Options::new(width)
            .subsequent_indent(&indent)
            .break_words(false)
            .word_separator(WordSeparator::AsciiSpace)
            .word_splitter(WordSplitter::NoHyphenation)
            .wrap_algorithm(WrapAlgorithm::FirstFit);
        textwrap::fill(line, options)
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// The rows below their titles, no line wider than `width`: what does not fit is cut and ends in `…`.
pub fn lines(columns: &[Column], rows: &[Vec<String>], width: usize) -> Vec<String> {
    let says_something = |index: &usize| {
        let usual = columns.get(*index).and_then(|column| column.usual);
        let mut cells = rows.iter().filter_map(|row| row.get(*index));
        usual.is_none_or(|usual| cells.any(|cell| cell != usual))
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

/// `text`, cut to `width` characters.
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
    fn a_long_line_is_broken_between_words_and_goes_on_below_its_second_column() {
        let long = "of_a_word_that_is_longer_than_a_line_of_the_terminal";
        let text = format!(
            "  set NAME = WORDS    a variable, used as $NAME\nshort\ntakes joint positions, {long} q6"
        );
        let below = " ".repeat("  set NAME = WORDS    ".len());
        let shown = format!(
            "  set NAME = WORDS    a variable, used as\n{below}$NAME\nshort\ntakes joint positions,\n  {long}\n  q6"
        );
        assert_eq!(wrapped(&text, 44), shown);
        assert_eq!(wrapped(&text, 200), text);
        // A second column has to leave room.
        let narrow = wrapped("  set NAME = WORDS    a variable", 20);
        assert_eq!(narrow, "  set NAME = WORDS\n    a variable");
    }

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
        // The same of words.
        let columns = [left("TASK"), left("PHASE").unless("run")];
        let row = |phase: &str| vec!["arm".to_owned(), phase.to_owned()];
        assert_eq!(lines(&columns, &[row("run")], 80), ["TASK", "arm"]);
        let waits = lines(&columns, &[row("run"), row("connect")], 80);
        assert_eq!(waits[2], "arm   connect");
    }
}
