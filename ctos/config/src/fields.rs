//! Reads the keys of one table one by one, so that all that is wrong in it is found at once.

use super::keys;
use super::node::{Node, Value};
use crate::diagnostic::{Finding, Findings, Place};
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;
use std::time::Duration;

/// The keys of one table. Every getter returns `None` for a key that is absent, and also, with a
/// finding, for one that is wrong.
pub(super) struct Fields<'n, 'f> {
    node: Option<&'n Node>,
    what: String,
    findings: &'f mut Findings,
}

/// What [`Fields::flag_or`] found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FlagOr {
    Flag(bool),
    Word,
}

impl<'n, 'f> Fields<'n, 'f> {
    /// Looks at `node`, called `what` in messages, and reports the keys that the list does not have in `table`.
    pub(super) fn new(
        node: Option<&'n Node>,
        what: String,
        table: &'static str,
        findings: &'f mut Findings,
    ) -> Self {
        let mut fields = Self {
            node,
            what,
            findings,
        };
        let Some(node) = node else {
            return fields;
        };
        if !matches!(node.value(), Value::Table(_)) {
            fields.wrong(node, "expected a table of keys");
            return fields;
        }
        for entry in node.entries() {
            if !keys::names(table).any(|known| known == entry.key) {
                let finding = Finding::error(
                    "ctos::config::unknown_key",
                    format!("unknown key `{}` in {}", entry.key, fields.what),
                )
                .label("nobody reads this key")
                .suggest(&entry.key, keys::names(table));
                fields.push(match &entry.key_place {
                    Some(place) => finding.at(place.clone()),
                    None => finding,
                });
            }
        }
        fields
    }

    /// Adds a finding.
    pub(super) fn push(&mut self, finding: Finding) {
        self.findings.push(finding);
    }

    /// The place of a key's value.
    pub(super) fn place(&self, key: &str) -> Option<Place> {
        self.value(key).and_then(|node| node.place().cloned())
    }

    fn value(&self, key: &str) -> Option<&'n Node> {
        self.node?.entry(key).map(|entry| &entry.value)
    }

    fn wrong(&mut self, node: &Node, expected: &str) {
        let finding = Finding::error(
            "ctos::config::value",
            format!("{}: {expected}, found {}", self.what, shown(node)),
        );
        self.push(match node.place() {
            Some(place) => finding.at(place.clone()),
            None => finding,
        });
    }

    fn wrong_key(&mut self, key: &str, node: &Node, expected: &str) {
        self.wrong(node, &format!("`{key}` must be {expected}"));
    }

    /// A text with its place.
    pub(super) fn text(&mut self, key: &str) -> Option<(&'n str, Place)> {
        let node = self.value(key)?;
        match (node.as_str(), node.place()) {
            (Some(""), _) => {
                self.wrong_key(key, node, "a text that is not empty");
                None
            }
            (Some(text), Some(place)) => Some((text, place.clone())),
            _ => {
                self.wrong_key(key, node, "a string");
                None
            }
        }
    }

    /// A text that must be there; `help` says what to add when it is not.
    pub(super) fn required(&mut self, key: &str, help: &str) -> Option<(&'n str, Place)> {
        if self.value(key).is_none()
            && let Some(Node {
                value: Value::Table(_),
                place,
            }) = self.node
        {
            let finding = Finding::error(
                "ctos::config::missing_key",
                format!("{} has no `{key}`", self.what),
            )
            .help(help);
            self.push(match place {
                Some(place) => finding.at(place.clone()),
                None => finding,
            });
        }
        self.text(key)
    }

    /// One of a few words.
    pub(super) fn choice(&mut self, key: &str, choices: &[&'static str]) -> Option<&'static str> {
        let (text, place) = self.text(key)?;
        let found = choices.iter().find(|choice| **choice == text);
        if found.is_none() {
            let finding = Finding::error(
                "ctos::config::unknown_choice",
                format!("{}: unknown choice `{text}` for `{key}`", self.what),
            );
            self.push(finding.suggest(text, choices.iter().copied()).at(place));
        }
        found.copied()
    }

    /// A boolean.
    pub(super) fn flag(&mut self, key: &str) -> Option<bool> {
        let node = self.value(key)?;
        let flag = node.as_bool();
        if flag.is_none() {
            self.wrong_key(key, node, "true or false");
        }
        flag
    }

    /// A boolean, or one word beside.
    pub(super) fn flag_or(&mut self, key: &str, word: &str) -> Option<FlagOr> {
        let node = self.value(key)?;
        let found = match (node.as_bool(), node.as_str()) {
            (Some(flag), _) => Some(FlagOr::Flag(flag)),
            (None, Some(text)) if text == word => Some(FlagOr::Word),
            _ => None,
        };
        if found.is_none() {
            self.wrong_key(key, node, &format!("true, false or {word:?}"));
        }
        found
    }

    /// A whole number within a range.
    pub(super) fn integer<T>(&mut self, key: &str, range: RangeInclusive<T>) -> Option<T>
    where
        T: TryFrom<i128> + PartialOrd + Display,
    {
        let node = self.value(key)?;
        let number = node
            .as_integer()
            .and_then(|number| T::try_from(number).ok())
            .filter(|number| range.contains(number));
        if number.is_none() {
            let expected = format!("a whole number from {} to {}", range.start(), range.end());
            self.wrong_key(key, node, &expected);
        }
        number
    }

    /// A number within a range.
    pub(super) fn number(&mut self, key: &str, range: RangeInclusive<f64>) -> Option<f64> {
        let node = self.value(key)?;
        let number = node.as_f64().filter(|number| range.contains(number));
        if number.is_none() {
            let expected = format!("a number from {} to {}", range.start(), range.end());
            self.wrong_key(key, node, &expected);
        }
        number
    }

    /// A time in seconds, above 0 and at most `most`.
    pub(super) fn seconds(&mut self, key: &str, most: f64) -> Option<Duration> {
        let node = self.value(key)?;
        let time = node
            .as_f64()
            .filter(|time| *time > 0.0 && *time <= most)
            .map(Duration::from_secs_f64);
        if time.is_none() {
            let expected = format!("a number of seconds above 0 and at most {most}");
            self.wrong_key(key, node, &expected);
        }
        time
    }

    /// A string that is parsed further.
    pub(super) fn parsed<T: FromStr>(&mut self, key: &str, expected: &str) -> Option<T> {
        let (text, _) = self.text(key)?;
        let parsed = text.parse().ok();
        if let (None, Some(node)) = (&parsed, self.value(key)) {
            self.wrong_key(key, node, expected);
        }
        parsed
    }

    /// A table.
    pub(super) fn table(&mut self, key: &str) -> Option<&'n Node> {
        let node = self.value(key)?;
        if matches!(node.value(), Value::Table(_)) {
            return Some(node);
        }
        self.wrong_key(key, node, "a table");
        None
    }
}

/// A value as it stands in a message.
fn shown(node: &Node) -> String {
    match node.value() {
        Value::String(text) => format!("{text:?}"),
        Value::Integer(number) => number.to_string(),
        Value::Float(number) => format!("{number:?}"),
        Value::Bool(value) => value.to_string(),
        Value::Datetime(_) | Value::Array(_) | Value::Table(_) => node.kind().to_owned(),
    }
}

/// Names of chassis, processors and tasks stand in paths (`chassis/processor`), commands and file
/// names, so they are kept plain.
pub(super) fn check_name(kind: &str, name: &str, place: &Place, findings: &mut Findings) {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "_-.".contains(letter);
    if name.is_empty() || name.len() > 64 || !name.chars().all(plain) {
        findings.push(
            Finding::error(
                "ctos::config::name",
                format!("`{}` cannot be the name of a {kind}", name.escape_debug()),
            )
            .help("names are 1 to 64 letters, digits, `_`, `-` or `.`")
            .at(place.clone()),
        );
    }
}
