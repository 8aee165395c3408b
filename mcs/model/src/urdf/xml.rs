//! XML with places: one finding when it is not well formed, numbers of attributes, where things stand.

use std::ops::Range;

use ctos_config::diagnostic::{Finding, Source};
use roxmltree::{Document, Node};

/// The most attributes of one element: finding two of the same name takes the square of their number.
const MOST_ATTRIBUTES: usize = 256;

/// A finding of this reader at a place.
pub(super) fn finding(source: &Source, text: impl Into<String>, range: Range<usize>) -> Finding {
    Finding::error("mcs::model::urdf", text).at(source.at(range))
}

/// Parses a document. Document types, and so entities, are refused by the parser.
pub(super) fn parse(source: &Source) -> Result<Document<'_>, Finding> {
    let text = source.text();
    let mut start = 0;
    // No `<` stands inside a tag, so this counts at least the attributes.
    for piece in text.split('<') {
        let is_tag = !piece.starts_with(['!', '?']);
        if is_tag && piece.bytes().filter(|byte| *byte == b'=').count() > MOST_ATTRIBUTES {
            let text =
                format!("malformed XML: an element has more than {MOST_ATTRIBUTES} attributes");
            return Err(finding(source, text, start..start));
        }
        start += piece.len() + 1;
    }
    Document::parse(text).map_err(|error| {
        let position = error.pos();
        let message = error.to_string();
        let what = message.split(" at ").next().unwrap_or_default();
        let at = offset(text, position.row, position.col);
        finding(source, format!("malformed XML: {what}"), at..at)
            .help("write the URDF anew from its tool; a file of xacro has to be expanded first")
    })
}

/// The byte at a row and a column of the parser, which count from 1.
fn offset(text: &str, row: u32, column: u32) -> usize {
    let mut start = 0;
    for (index, line) in (1..).zip(text.split_inclusive('\n')) {
        if index == row {
            let mut places = line.char_indices().map(|(at, _)| at);
            return start
                + places
                    .nth(column.saturating_sub(1) as usize)
                    .unwrap_or(line.len());
        }
        start += line.len();
    }
    text.len()
}

/// URDF knows no units but its own. What another language of descriptions says of them must not be passed over in silence.
pub(super) fn check_units(source: &Source, document: &Document<'_>) -> Result<(), Finding> {
    const NAMES: [&str; 3] = ["unit", "units", "angle_unit"];
    const OWN: [&str; 6] = ["m", "meter", "metre", "rad", "radian", "kg"];
    let elements = document.descendants().filter(Node::is_element);
    let mut all = elements.flat_map(|element| {
        let attributes = element.attributes();
        attributes.map(move |attribute| (element, attribute))
    });
    let other = all.find(|(_, attribute)| {
        NAMES.contains(&attribute.name()) && !OWN.contains(&attribute.value())
    });
    let Some((element, attribute)) = other else {
        return Ok(());
    };
    let text = format!(
        "unknown unit: `{}` in `{}` of <{}>",
        attribute.value().chars().take(40).collect::<String>(),
        attribute.name(),
        element.tag_name().name()
    );
    Err(finding(source, text, attribute.range_value())
        .help("a URDF has no units of its own: write lengths in m, angles in rad and masses in kg"))
}

/// Where an element begins: `<name`.
pub(super) fn opening(node: Node<'_, '_>) -> Range<usize> {
    let start = node.range().start;
    start..start + 1 + node.tag_name().name().len()
}

/// The child element of that name.
pub(super) fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|child| child.has_tag_name(name))
}

/// The number that a child element of that name holds, and where it stands.
pub(super) fn number_within(
    source: &Source,
    node: Node<'_, '_>,
    name: &str,
) -> Result<Option<(f64, Range<usize>)>, Finding> {
    let Some(element) = child(node, name) else {
        return Ok(None);
    };
    let text = element.text().unwrap_or_default().trim();
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(Some((number, opening(element)))),
        _ => {
            let text = format!("not a finite number: <{name}> holds `{text}`");
            Err(finding(source, text, opening(element)))
        }
    }
}

/// The text of an attribute and where it stands.
pub(super) fn attribute<'a>(
    source: &Source,
    node: Node<'a, '_>,
    name: &str,
) -> Result<(&'a str, Range<usize>), Finding> {
    let found = node.attribute_node(name).ok_or_else(|| {
        let text = format!(
            "missing attribute: <{}> has no `{name}`",
            node.tag_name().name()
        );
        finding(source, text, opening(node))
    })?;
    Ok((found.value(), found.range_value()))
}

/// As many finite numbers as asked for, in an attribute; `usual` when there is no such attribute.
pub(super) fn numbers<const N: usize>(
    source: &Source,
    node: Node<'_, '_>,
    name: &str,
    usual: [f64; N],
) -> Result<[f64; N], Finding> {
    let Some(found) = node.attribute_node(name) else {
        return Ok(usual);
    };
    let mut numbers = [0.0; N];
    let mut words = found.value().split_ascii_whitespace();
    let wrong = |what: String| {
        finding(
            source,
            format!(
                "not a number: {what} in `{name}` of <{}>",
                node.tag_name().name()
            ),
            found.range_value(),
        )
        .help("numbers stand without units; lengths are in m, angles in rad")
    };
    for number in &mut numbers {
        let word = words
            .next()
            .ok_or_else(|| wrong(format!("{N} are needed, fewer stand")))?;
        *number = match word.parse::<f64>() {
            Ok(value) if value.is_finite() => value,
            _ => {
                return Err(wrong(format!(
                    "`{}`",
                    word.chars().take(40).collect::<String>()
                )));
            }
        };
    }
    match words.next() {
        None => Ok(numbers),
        Some(more) => {
            let more = more.chars().take(40).collect::<String>();
            Err(wrong(format!("`{more}` after {N}")))
        }
    }
}
