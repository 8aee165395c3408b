//! `${NAME}` in the strings of a file: the only way in which the environment reaches an app.
//!
//! Knows the form of a reference and where the values come from; knows nothing of what a string is
//! for.

use super::load::Files;
use super::node::{Node, Value};
use crate::diagnostic::{Finding, Findings, Place};
use std::collections::BTreeMap;
use std::ffi::OsString;

/// The variables that an app's files name, each with its value. `None`: it was not set, and the
/// file's default was taken.
pub(super) type Used = BTreeMap<String, Option<String>>;

/// Where the values come from, and which were asked for.
pub(super) struct Variables<'a> {
    pub(super) files: Files<'a>,
    pub(super) used: Used,
}

impl<'a> Variables<'a> {
    pub(super) fn of(files: Files<'a>) -> Self {
        Self {
            files,
            used: Used::new(),
        }
    }

    /// Puts values in place of the references in every string below `node`, as long as `wanted` says
    /// yes to the place of the string.
    pub(super) fn expand(
        &mut self,
        node: &mut Node,
        findings: &mut Findings,
        wanted: &dyn Fn(&Place) -> bool,
    ) {
        node.visit(&mut |node| {
            if let Value::String(text) = &mut node.value
                && text.contains("${")
                && node.place.as_ref().is_none_or(wanted)
            {
                let expanded = self.expanded(text, node.place.as_ref(), findings);
                *text = expanded.unwrap_or_default();
            }
        });
    }

    /// A text with its references replaced, if nothing is wrong with them; else that goes to `findings` at its place.
    pub(super) fn expanded(
        &mut self,
        text: &str,
        place: Option<&Place>,
        findings: &mut Findings,
    ) -> Option<String> {
        let (mut out, mut is_right) = (String::new(), true);
        let mut rest = text;
        while let Some(at) = rest.find('$') {
            let (before, from) = rest.split_at(at);
            out.push_str(before);
            if let Some(after) = from.strip_prefix("$${") {
                out.push_str("${");
                rest = after;
            } else if let Some(after) = from.strip_prefix("${") {
                let (inside, left) = after.split_once('}').unwrap_or((after, ""));
                let is_closed = inside.len() < after.len();
                let reference = reference(inside).filter(|_| is_closed);
                let reference = reference.ok_or_else(|| malformed(inside));
                match reference.and_then(|(name, default)| self.value(name, default)) {
                    Ok(value) => out.push_str(&value),
                    Err(finding) => {
                        is_right = false;
                        let part = place.map(|place| narrowed(place, &format!("${{{inside}")));
                        findings.push(finding.at(part));
                    }
                }
                rest = left;
            } else {
                out.push('$');
                rest = from.get(1..).unwrap_or_default();
            }
        }
        out.push_str(rest);
        is_right.then_some(out)
    }

    /// As in a shell, a default stands in for a variable that is unset or empty.
    fn value(&mut self, name: &str, default: Option<&str>) -> Result<String, Finding> {
        let found = self.files.variable(name).map(OsString::into_string);
        let found = found.transpose().map_err(|_| {
            let text = format!("the environment variable `{name}` does not hold UTF-8 text");
            Finding::error("ctos::config::variable", text)
        })?;
        self.used.insert(name.to_owned(), found.clone());
        match (found, default) {
            (Some(value), None) => Ok(value),
            (Some(value), Some(_)) if !value.is_empty() => Ok(value),
            (_, Some(default)) => Ok(default.to_owned()),
            (None, None) => {
                let text = format!("the environment variable `{name}` is not set");
                let help = format!("set it, or write what holds without it: ${{{name}:-...}}");
                let finding = Finding::error("ctos::config::unset_variable", text);
                Err(finding.label("its value belongs here").help(help))
            }
        }
    }
}

/// The name and the default of `NAME` or `NAME:-default`.
fn reference(inside: &str) -> Option<(&str, Option<&str>)> {
    let (name, default) = match inside.split_once(":-") {
        Some((name, default)) => (name, Some(default)),
        None => (inside, None),
    };
    let letter = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
    let first = name.chars().next()?;
    let plain = !first.is_ascii_digit() && name.chars().all(letter);
    plain.then_some((name, default))
}

fn malformed(inside: &str) -> Finding {
    Finding::error(
        "ctos::config::variable",
        format!("`${{{inside}` is no reference to an environment variable"),
    )
    .help("write ${NAME} or ${NAME:-default}; a text that holds `${` writes it as `$${`")
}

/// The part of `place` that reads `text`, or all of it when escapes hide that.
fn narrowed(place: &Place, text: &str) -> Place {
    let whole = place.source.text().get(place.range.clone());
    match whole.and_then(|whole| whole.find(text)) {
        Some(at) => {
            let start = place.range.start + at;
            place.source.at(start..start + text.len())
        }
        None => place.clone(),
    }
}
