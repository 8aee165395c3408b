//! XML read safely: no document type, so no entities; bounded depth and attributes; one finding, with
//! its place, when it is not well formed. Knows nothing of nets.

use std::ops::Range;

use ctos::diagnostic::{Finding, Source};
use roxmltree::{Document, Node, ParsingOptions};

/// The deepest nesting.
const DEEPEST: usize = 128;

/// The most attributes of one element: finding two of the same name takes the square of their number.
const MOST_ATTRIBUTES: usize = 256;

pub(super) fn parse(source: &Source) -> Result<Document<'_>, Finding> {
    scan(source)?;
    let options = ParsingOptions {
        allow_dtd: false,
        ..ParsingOptions::default()
    };
    Document::parse_with_options(source.text(), options).map_err(|error| {
        let at = offset(source.text(), error.pos());
        let message = error.to_string();
        let what = message.split(" at ").next().unwrap_or_default();
        Finding::error(
            "pnt::pnml::xml",
            format!("this is not well-formed XML: {what}"),
        )
        .at(source.at(at..at))
        .help("the file may have been cut off or edited by hand; write it anew from its tool")
    })
}

/// The byte at which a row and column of the parser stand; for errors about the whole, the end.
fn offset(text: &str, position: roxmltree::TextPos) -> usize {
    let row = position.row.max(1) as usize;
    if (position.row, position.col) == (1, 1) {
        return text.len();
    }
    let mut start = 0;
    for (index, line) in text.split_inclusive('\n').enumerate() {
        if index + 1 == row {
            let column = position.col.max(1) as usize - 1;
            let inside = line.char_indices().nth(column);
            return start + inside.map_or(line.len(), |(at, _)| at);
        }
        start += line.len();
    }
    text.len()
}

/// Looks for what the parser should not be given.
fn scan(source: &Source) -> Result<(), Finding> {
    let text = source.text();
    let bytes = text.as_bytes();
    let (mut at, mut depth) = (0, 0_usize);
    while let Some(found) = bytes.get(at..).and_then(|rest| find(rest, b"<")) {
        at += found;
        let rest = &text[at..];
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")]
            .iter()
            .find(|(begin, _)| rest.starts_with(begin));
        if let Some((_, end)) = skipped {
            let Some(length) = find(rest.as_bytes(), end.as_bytes()) else {
                return Ok(());
            };
            at += length + end.len();
            continue;
        }
        if rest.starts_with("<!") {
            return Err(Finding::error(
                "pnt::pnml::dtd",
                "this document has a document type, which is not read",
            )
            .at(source.at(at..at + 2))
            .help("remove the `<!DOCTYPE ...>`; PNML needs none, and entities are not read"));
        }
        let Some(tag) = tag(rest.as_bytes()) else {
            return Ok(());
        };
        let place = || source.at(at..at + 1);
        if tag.attributes > MOST_ATTRIBUTES {
            let message = format!("an element has more than {MOST_ATTRIBUTES} attributes");
            return Err(limit(message).at(place()));
        }
        if rest.starts_with("</") {
            depth = depth.saturating_sub(1);
        } else if !tag.closed {
            depth += 1;
        }
        if depth > DEEPEST {
            let message = format!("elements are nested more than {DEEPEST} deep");
            return Err(limit(message).at(place()));
        }
        at += tag.length;
    }
    Ok(())
}

fn limit(message: String) -> Finding {
    Finding::error("pnt::pnml::limit", message)
        .help("no tool writes such nets; is it the right file?")
}

fn find(bytes: &[u8], wanted: &[u8]) -> Option<usize> {
    let first = *wanted.first()?;
    let mut from = 0;
    loop {
        let rest = bytes.get(from..)?;
        let at = from + rest.iter().position(|byte| *byte == first)?;
        if bytes.get(at..)?.starts_with(wanted) {
            return Some(at);
        }
        from = at + 1;
    }
}

struct Tag {
    length: usize,
    attributes: usize,
    /// Whether it ends its element, too.
    closed: bool,
}

/// The tag that `bytes` begin with; `None` when it has no end.
fn tag(bytes: &[u8]) -> Option<Tag> {
    let (mut quote, mut attributes, mut last) = (None, 0, b'<');
    for (index, byte) in bytes.iter().enumerate() {
        match (quote, byte) {
            (Some(open), _) if open == *byte => quote = None,
            (Some(_), _) => {}
            (None, b'"' | b'\'') => quote = Some(*byte),
            (None, b'=') => attributes += 1,
            (None, b'>') => {
                return Some(Tag {
                    length: index + 1,
                    attributes,
                    closed: last == b'/',
                });
            }
            (None, _) => {}
        }
        last = *byte;
    }
    None
}

/// An element's name without its prefix.
pub(super) fn name<'i>(node: Node<'_, 'i>) -> &'i str {
    node.tag_name().name()
}

/// The child elements.
pub(super) fn elements<'a, 'i>(node: Node<'a, 'i>) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(Node::is_element)
}

/// All text directly inside an element, comments left out.
pub(super) fn text(node: Node<'_, '_>) -> String {
    node.children()
        .filter(Node::is_text)
        .filter_map(|node| node.text())
        .collect()
}

/// Where the text of an element stands, without the blanks around it; else the element's tag.
pub(super) fn text_range(node: Node<'_, '_>) -> Range<usize> {
    let mut parts = node.children().filter(Node::is_text);
    match (parts.next(), parts.next()) {
        (Some(part), None) => {
            let range = part.range();
            let raw = part
                .document()
                .input_text()
                .get(range.clone())
                .unwrap_or("");
            let start = range.start + (raw.len() - raw.trim_start().len());
            start..start + raw.trim().len()
        }
        _ => opening(node),
    }
}

/// Where an element begins: `<name`.
pub(super) fn opening(node: Node<'_, '_>) -> Range<usize> {
    let range = node.range();
    let raw = node
        .document()
        .input_text()
        .get(range.clone())
        .unwrap_or("");
    let length = raw
        .find(|c: char| c.is_whitespace() || c == '>' || c == '/')
        .unwrap_or(raw.len());
    range.start..range.start + length
}

/// Where the value of an attribute stands; else where the element begins.
pub(super) fn attribute_range(node: Node<'_, '_>, name: &str) -> Range<usize> {
    let found = node.attributes().find(|attribute| attribute.name() == name);
    found.map_or_else(|| opening(node), |attribute| attribute.range_value())
}

/// The value of an attribute, whatever its namespace.
pub(super) fn attribute<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    let found = node.attributes().find(|attribute| attribute.name() == name);
    found.map(|attribute| attribute.value())
}

/// An element as it stands in the file.
pub(super) fn raw<'a>(source: &'a Source, node: Node<'_, '_>) -> &'a str {
    source.text().get(node.range()).unwrap_or_default()
}
