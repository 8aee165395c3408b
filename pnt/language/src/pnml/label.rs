//! Labels of PNML elements: names, numbers, graphics and tool sections.

use std::ops::Range;

use ctos::diagnostic::{Finding, Findings, Source};
use roxmltree::Node;

use super::{
    kept::TOOL,
    xml::{attribute, elements, name, opening, raw, text, text_range},
};
use crate::text::MOST_TOKENS;

/// A value and where it stands.
#[derive(Debug, Clone)]
pub(super) struct Label {
    pub(super) text: String,
    pub(super) range: Range<usize>,
}

/// The only child element of that name.
pub(super) fn only<'a, 'i>(
    source: &Source,
    node: Node<'a, 'i>,
    wanted: &str,
    findings: &mut Findings,
) -> Option<Node<'a, 'i>> {
    let mut found = elements(node).filter(|child| name(*child) == wanted);
    let first = found.next();
    if let Some(second) = found.next() {
        findings.push(
            Finding::error(
                "pnt::pnml::twice",
                format!("this {} has a second `{wanted}`", name(node)),
            )
            .at(source.at(opening(second)))
            .help("keep the one that is meant"),
        );
    }
    first
}

/// What a label says, in `<text>` (2009), `<value>` (2004) or directly.
pub(super) fn label(
    source: &Source,
    node: Node<'_, '_>,
    wanted: &str,
    findings: &mut Findings,
) -> Option<Label> {
    let label = only(source, node, wanted, findings)?;
    let inner = only(source, label, "text", findings)
        .or_else(|| only(source, label, "value", findings))
        .unwrap_or(label);
    Some(Label {
        text: text(inner).trim().to_owned(),
        range: text_range(inner),
    })
}

/// A natural number: decimal digits, or PIPE's `Default,1`.
pub(super) fn number(
    source: &Source,
    what: &str,
    label: &Label,
    least: u32,
) -> Result<u32, Finding> {
    let wrong = |message: String| {
        Finding::error("pnt::pnml::number", message)
            .at(source.at(label.range.clone()))
            .help(format!(
                "write a whole number from {least} to {MOST_TOKENS}"
            ))
    };
    let digits = match label.text.split_once(',') {
        Some((colour, digits)) if colour.trim() == "Default" => digits,
        Some(_) => {
            return Err(wrong(format!(
                "{what} is `{}`: tokens of several colours are not read",
                short(&label.text)
            )));
        }
        None => &label.text,
    };
    let digits = digits.trim();
    if digits.is_empty() || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        let shown = short(&label.text);
        return Err(wrong(format!("{what} cannot be `{shown}`")));
    }
    match digits.parse::<u32>() {
        Ok(number) if (least..=MOST_TOKENS).contains(&number) => Ok(number),
        Ok(number) if number < least => Err(wrong(format!("{what} cannot be {number}"))),
        _ => Err(wrong(format!(
            "{what} is {}, more than can be counted here",
            short(digits)
        ))),
    }
}

/// A text short enough for a message.
pub(super) fn short(text: &str) -> String {
    const MOST: usize = 40;
    if text.chars().count() <= MOST {
        return text.to_owned();
    }
    let head: String = text.chars().take(MOST).collect();
    format!("{head}…")
}

/// Whether an element is the section of our own tool.
pub(super) fn is_ours(node: Node<'_, '_>) -> bool {
    name(node) == "toolspecific" && attribute(node, "tool") == Some(TOOL)
}

/// Graphics and foreign tool sections of an element, as they stand.
pub(super) fn kept(source: &Source, node: Node<'_, '_>) -> Vec<String> {
    elements(node)
        .filter(|child| matches!(name(*child), "graphics" | "toolspecific") && !is_ours(*child))
        .map(|child| raw(source, child).to_owned())
        .collect()
}

/// The same for the labels of an element that have that name.
pub(super) fn kept_of_label(source: &Source, node: Node<'_, '_>, wanted: &str) -> Vec<String> {
    let label = elements(node).find(|child| name(*child) == wanted);
    label.map_or_else(Vec::new, |label| kept(source, label))
}

/// A point given by the attributes `x` and `y`.
fn point(node: Node<'_, '_>) -> Option<[f64; 2]> {
    let coordinate = |name| attribute(node, name)?.trim().parse::<f64>().ok();
    let point = [coordinate("x")?, coordinate("y")?];
    point.iter().all(|c| c.is_finite()).then_some(point)
}

/// The positions in an element's graphics.
pub(super) fn positions(node: Node<'_, '_>) -> Vec<[f64; 2]> {
    let inside = elements(node)
        .filter(|child| name(*child) == "graphics")
        .flat_map(elements)
        .filter(|child| name(*child) == "position")
        .filter_map(point);
    let mut points: Vec<[f64; 2]> = inside.collect();
    // TAPAAL's attributes.
    if let (true, Some(x), Some(y)) = (
        points.is_empty(),
        attribute(node, "positionX").and_then(|x| x.trim().parse().ok()),
        attribute(node, "positionY").and_then(|y| y.trim().parse().ok()),
    ) {
        points.push([x, y]);
    }
    points
}
