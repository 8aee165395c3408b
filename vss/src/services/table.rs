//! Reading tables of numbers: comma-separated, a header first, everything wrong told with its place.

use std::cmp::Ordering;

use ctos::diagnostic::{Finding, Findings, Source};
use sorma::{Report, Transport};

use super::code;

/// What a table should have.
pub(super) struct Columns {
    /// As the header names them; the case of letters does not matter. Empty: whatever the header names.
    pub names: &'static [&'static str],
    /// How many columns there are where they have no names: then the header may be left out, too.
    pub count: Option<usize>,
    /// Those whose cells may be empty. They are read as NaN, which no other cell is.
    pub may_be_empty: &'static [&'static str],
    /// What the table should be, for whoever wrote it.
    pub help: &'static str,
}

/// Numbers, row by row, in the order of [`Columns::names`].
pub(super) struct Table {
    /// Names of the columns.
    pub names: Vec<String>,
    /// All numbers.
    pub numbers: Vec<f64>,
    /// The byte offset of each row.
    pub at: Vec<usize>,
}

impl Table {
    /// The rows.
    pub fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.numbers.chunks_exact(self.names.len().max(1))
    }

    /// Tells of rows that repeat an earlier one, number for number: a fit counts each as measured anew.
    pub fn tell_repeated(&self, source: &Source, io: &mut Transport) {
        let same = |a: &[f64], b: &[f64]| {
            let differ = |(a, b): (&f64, &f64)| Some(a.total_cmp(b)).filter(|order| order.is_ne());
            let first = a.iter().zip(b).find_map(differ);
            first.unwrap_or(Ordering::Equal)
        };
        let mut rows: Vec<(usize, &[f64])> = self.rows().enumerate().collect();
        rows.sort_by(|(_, a), (_, b)| same(a, b));
        let pairs = rows.iter().zip(rows.iter().skip(1));
        let again = pairs.filter(|((_, one), (_, next))| same(one, next).is_eq());
        let again: Vec<usize> = again.map(|(_, (row, _))| *row).collect();
        let Some(first) = again.iter().min() else {
            return;
        };
        let first = self.place(source, *first);
        let (count, all) = (again.len(), rows.len());
        let text = format!(
            "{count} of {all} rows repeat an earlier one number for number, first {first}: they are counted as measured again, and the \
             standard deviations are too small if they were not; leave them out"
        );
        io.report(Report::warning(code::TABLE, text));
    }

    /// `file:line:column` of a row.
    pub fn place(&self, source: &Source, row: usize) -> String {
        let (line, column) = source.line_column(self.at.get(row).copied().unwrap_or_default());
        format!("{}:{line}:{column}", source.name())
    }
}

/// One field with its byte offset.
type Field<'a> = (usize, &'a str);

/// Reads a table. A first row of numbers alone is a row in the order of the columns; else it is the header, whose columns
/// may stand in any order. A table whose columns are free must have one. Lines that begin with `#` are comments.
///
/// # Errors
/// Everything that is wrong with it, with places.
pub(super) fn read(source: &Source, columns: &Columns) -> Result<Table, Findings> {
    let mut findings = Findings::new();
    let mut lines = rows(source.text());
    let Some(first) = lines.next() else {
        let finding = Finding::error("vss::table::header", "the table is empty");
        findings.push(finding.at(source.at(0..0)).help(columns.help));
        return Err(findings);
    };
    let optional = |name: &str| columns.may_be_empty.contains(&name);
    let is_number = |(_, text): &Field<'_>| text.is_empty() || text.parse::<f64>().is_ok();
    let numeric = first.iter().all(is_number);
    let headless = numeric && first.len() == columns.names.len();
    let nameless = columns.names.is_empty() && columns.count.is_some();
    if nameless && columns.count != Some(first.len()) {
        let text = format!(
            "{} columns stand here, not {}",
            first.len(),
            columns.count.unwrap_or_default()
        );
        let finding = Finding::error("vss::table::header", text);
        findings.push(finding.at(whole(source, &first)).help(columns.help));
        return Err(findings);
    }
    let (names, order) = if headless || !columns.names.is_empty() {
        let order = if headless {
            Some((0..first.len()).collect())
        } else {
            header(source, &first, columns, &mut findings)
        };
        (
            columns.names.iter().map(ToString::to_string).collect(),
            order,
        )
    } else {
        let names: Vec<String> = first.iter().map(|(_, name)| (*name).to_owned()).collect();
        if numeric && !nameless {
            let text = "the table begins with numbers: its first line should name the columns";
            let finding = Finding::error("vss::table::header", text);
            findings.push(finding.at(whole(source, &first)).help(columns.help));
        }
        (
            names,
            (nameless || !numeric).then(|| (0..first.len()).collect()),
        )
    };
    // A line with a number in it is no line of names, and what is wrong with it is told.
    let numbered = first.iter().any(|(_, text)| text.parse::<f64>().is_ok());
    let headless = headless || (nameless && numbered);
    let Some(order): Option<Vec<usize>> = order else {
        return Err(findings);
    };
    let mut table = Table {
        names,
        numbers: Vec::new(),
        at: Vec::new(),
    };
    let width = first.len();
    for fields in headless.then_some(first.clone()).into_iter().chain(lines) {
        if fields.len() != width {
            let text = format!(
                "{} values stand here, and {width} in the first line",
                fields.len()
            );
            let finding = Finding::error("vss::table::row", text);
            findings.push(finding.at(whole(source, &fields)).help(columns.help));
            continue;
        }
        for (name, index) in table.names.iter().zip(&order) {
            let (at, text) = fields.get(*index).copied().unwrap_or_default();
            match text.parse::<f64>() {
                Ok(number) if number.is_finite() => table.numbers.push(number),
                _ if text.is_empty() && optional(name) => table.numbers.push(f64::NAN),
                _ => {
                    let shown: String = text.chars().take(40).collect();
                    let said = format!("{name} must be a finite number, not `{shown}`");
                    let finding = Finding::error("vss::table::row", said);
                    let place = source.at(at..at + text.len());
                    findings.push(finding.at(place).help(columns.help));
                }
            }
        }
        table.at.push(fields.first().map_or(0, |(at, _)| *at));
    }
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(table)
    }
}

/// The place of a whole row.
pub(super) fn whole(source: &Source, fields: &[Field<'_>]) -> ctos::diagnostic::Place {
    let start = fields.first().map_or(0, |(at, _)| *at);
    let end = fields.last().map_or(start, |(at, text)| at + text.len());
    source.at(start..end)
}

/// Where each column stands.
fn header(
    source: &Source,
    fields: &[Field<'_>],
    columns: &Columns,
    findings: &mut Findings,
) -> Option<Vec<usize>> {
    let mut order = Vec::new();
    let mut missing = Vec::new();
    for name in columns.names {
        let mut found = fields
            .iter()
            .enumerate()
            .filter(|(_, (_, text))| text.eq_ignore_ascii_case(name));
        match (found.next(), found.next()) {
            (None, _) => missing.push(*name),
            (Some((index, _)), None) => order.push(index),
            (Some(_), Some((_, (at, text)))) => {
                let text_of = format!("the column `{name}` stands twice in the header");
                let finding = Finding::error("vss::table::header", text_of);
                let place = source.at(*at..at + text.len());
                findings.push(finding.at(place).help(columns.help));
            }
        }
    }
    // `X (mm)` and `X [mm]`: a unit that is not read must not be believed.
    let with_unit = fields.iter().find_map(|(at, text)| {
        let (name, unit) = text.split_once(['(', '['])?;
        let known = |one: &&&str| one.eq_ignore_ascii_case(name.trim());
        let name = missing.iter().find(known)?;
        let unit = unit.trim_end_matches([')', ']']);
        Some((source.at(*at..at + text.len()), *name, unit))
    });
    if let Some((place, name, unit)) = with_unit {
        let text = format!(
            "the header names the unit `{unit}`: write `{name}` alone, and its values in the table's unit"
        );
        let finding = Finding::error("vss::table::header", text);
        findings.push(finding.at(place).help(columns.help));
    } else if !missing.is_empty() {
        let names: Vec<&str> = fields.iter().map(|(_, text)| *text).collect();
        let given: String = names.join(",").chars().take(80).collect();
        let text = format!("the header lacks {}: it is `{given}`", missing.join(", "));
        let finding = Finding::error("vss::table::header", text);
        findings.push(finding.at(whole(source, fields)).help(columns.help));
    }
    (!findings.has_errors()).then_some(order)
}

/// The fields of every line that is neither empty nor a comment.
pub(super) fn rows(text: &str) -> impl Iterator<Item = Vec<Field<'_>>> {
    let mut end = 0;
    text.split_inclusive('\n').filter_map(move |line| {
        let mut start = end;
        end += line.len();
        // Some editors put a byte order mark before everything else.
        let line = match line.strip_prefix('\u{feff}') {
            Some(rest) if start == 0 => {
                start = line.len() - rest.len();
                rest
            }
            _ => line,
        };
        let content = line.trim();
        if content.is_empty() || content.starts_with('#') {
            return None;
        }
        // An empty last cell stands in its own line.
        let fields = line.trim_end().split(',').map(|field| {
            let shown = field.trim();
            let at = start + (field.len() - field.trim_start().len());
            start += field.len() + 1;
            (at, shown)
        });
        Some(fields.collect())
    })
}
