//! Reading a table of lights and their pictures: comma-separated, with the columns X, Y, Z, u, v.

use ctos::diagnostic::{Finding, Findings, Source};

use crate::calibrate::LightPoint;

/// The columns, as the header names them; their letters' case does not matter.
pub(super) const COLUMNS: [&str; 5] = ["X", "Y", "Z", "u", "v"];

/// The points of a table with the byte offsets of their rows.
pub(super) struct Table {
    pub points: Vec<LightPoint>,
    pub rows: Vec<usize>,
}

/// One field with its byte offset.
type Field<'a> = (usize, &'a str);

/// Reads a table. A first row of five numbers is a row of points in the order of [`COLUMNS`]; else it is the
/// header, whose columns may stand in any order. Lines that begin with `#` are comments.
///
/// # Errors
/// Everything that is wrong with it, with places.
pub(super) fn read(source: &Source) -> Result<Table, Findings> {
    let mut findings = Findings::new();
    let mut lines = rows(source.text());
    let Some(first) = lines.next() else {
        let finding = Finding::error("vss::resect::header", "the table is empty");
        findings.push(finding.at(source.at(0..0)).help(HELP));
        return Err(findings);
    };
    let is_number = |(_, text): &Field<'_>| text.parse::<f64>().is_ok();
    let headless = first.len() == COLUMNS.len() && first.iter().all(is_number);
    let order = if headless {
        Some([0, 1, 2, 3, 4])
    } else {
        header(source, &first, &mut findings)
    };
    let Some(order) = order else {
        return Err(findings);
    };
    let mut table = Table {
        points: Vec::new(),
        rows: Vec::new(),
    };
    let width = first.len();
    for fields in headless.then_some(first.clone()).into_iter().chain(lines) {
        if let Some(point) = point(source, &fields, order, width, &mut findings) {
            table.points.push(point);
            table.rows.push(fields.first().map_or(0, |(at, _)| *at));
        }
    }
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(table)
    }
}

const HELP: &str =
    "the first line is `X,Y,Z,u,v`: world coordinates in m, picture coordinates in px";

/// Where each column stands.
fn header(source: &Source, fields: &[Field<'_>], findings: &mut Findings) -> Option<[usize; 5]> {
    let whole = |fields: &[Field<'_>]| {
        let start = fields.first().map_or(0, |(at, _)| *at);
        let end = fields.last().map_or(start, |(at, text)| at + text.len());
        source.at(start..end)
    };
    let mut order = [0; 5];
    let mut missing = Vec::new();
    for (name, slot) in COLUMNS.iter().zip(&mut order) {
        let mut found = fields
            .iter()
            .enumerate()
            .filter(|(_, (_, text))| text.eq_ignore_ascii_case(name));
        match (found.next(), found.next()) {
            (None, _) => missing.push(*name),
            (Some((index, _)), None) => *slot = index,
            (Some(_), Some((_, (at, text)))) => {
                let text_of = format!("the column `{name}` stands twice in the header");
                let finding = Finding::error("vss::resect::header", text_of);
                findings.push(finding.at(source.at(*at..at + text.len())).help(HELP));
            }
        }
    }
    if !missing.is_empty() {
        let names: Vec<&str> = fields.iter().map(|(_, text)| *text).collect();
        let given: String = names.join(",").chars().take(80).collect();
        let text = format!("the header lacks {}: it is `{given}`", missing.join(", "));
        let finding = Finding::error("vss::resect::header", text);
        findings.push(finding.at(whole(fields)).help(HELP));
    }
    (!findings.has_errors()).then_some(order)
}

/// The point of one row.
fn point(
    source: &Source,
    fields: &[Field<'_>],
    order: [usize; 5],
    width: usize,
    findings: &mut Findings,
) -> Option<LightPoint> {
    let start = fields.first().map_or(0, |(at, _)| *at);
    let end = fields.last().map_or(start, |(at, text)| at + text.len());
    if fields.len() != width {
        let text = format!(
            "{} values stand here, and {width} in the first line",
            fields.len()
        );
        let finding = Finding::error("vss::resect::row", text);
        findings.push(finding.at(source.at(start..end)).help(HELP));
        return None;
    }
    let mut numbers = [0.0; 5];
    let mut good = true;
    for ((name, index), number) in COLUMNS.iter().zip(order).zip(&mut numbers) {
        let (at, text) = fields.get(index).copied().unwrap_or((end, ""));
        match text.parse::<f64>() {
            Ok(read) if read.is_finite() => *number = read,
            _ => {
                good = false;
                let shown: String = text.chars().take(40).collect();
                let said = format!("{name} must be a finite number, not `{shown}`");
                let finding = Finding::error("vss::resect::row", said);
                findings.push(finding.at(source.at(at..at + text.len())).help(HELP));
            }
        }
    }
    let [x, y, z, u, v] = numbers;
    good.then_some(LightPoint { x, y, z, u, v })
}

/// The fields of every line that is neither empty nor a comment.
fn rows(text: &str) -> impl Iterator<Item = Vec<Field<'_>>> {
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
        let fields = line.split(',').map(|field| {
            let shown = field.trim();
            let at = start + (field.len() - field.trim_start().len());
            start += field.len() + 1;
            (at, shown)
        });
        Some(fields.collect())
    })
}
