//! Reads the keys of one table one by one, so that all that is wrong in it is found at once.

use super::keys::{self, Kind};
use super::node::{Entry, Node, Value};
use crate::diagnostic::{Finding, Findings, Place};
use std::str::FromStr;
use std::time::Duration;

/// The keys of one table. Every getter returns `None` for a key that is absent, and also, with a
/// finding, for one that is wrong: that is not what [`keys`] says it holds.
pub(super) struct Fields<'n, 'f> {
    node: Option<&'n Node>,
    what: String,
    table: &'static str,
    findings: &'f mut Findings,
}

/// What [`Fields::flag_or`] found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FlagOr {
    Flag(bool),
    Word,
}

impl<'n, 'f> Fields<'n, 'f> {
    /// Looks at the table of that name at the top level.
    pub(super) fn top(root: &'n Node, table: &'static str, findings: &'f mut Findings) -> Self {
        let node = root.entry(table).map(|entry| &entry.value);
        Self::new(node, format!("[{table}]"), table, findings)
    }

    /// Looks at a table with a name of its own, called `kind` and that name in messages.
    pub(super) fn named(
        entry: &'n Entry,
        kind: &str,
        table: &'static str,
        findings: &'f mut Findings,
    ) -> Self {
        let what = format!("{kind} `{}`", entry.key);
        Self::new(Some(&entry.value), what, table, findings)
    }

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
            table,
            findings,
        };
        if let Some(node) = node.filter(|node| !node.is_table()) {
            fields.wrong(node, "expected a table of keys");
        }
        for entry in node.map_or(&[][..], Node::entries) {
            if !keys::names(table).any(|known| known == entry.key) {
                fields.push(unknown_key(
                    entry,
                    &format!("in {}", fields.what),
                    keys::names(table),
                ));
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

    /// What the key holds.
    fn kind(&self, key: &str) -> Option<&'static Kind> {
        let key = keys::table(self.table).iter().find(|one| one.name == key)?;
        Some(&key.kind)
    }

    fn wrong(&mut self, node: &Node, expected: &str) {
        let text = format!("{}: {expected}, found {}", self.what, shown(node));
        self.push(Finding::error("ctos::config::value", text).at(node.place().cloned()));
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
            && let Some(node) = self.node.filter(|node| node.is_table())
        {
            let text = format!("{} has no `{key}`", self.what);
            let finding = Finding::error("ctos::config::missing_key", text).help(help);
            self.push(finding.at(node.place().cloned()));
        }
        self.text(key)
    }

    /// What one of a few words stands for; the default without any.
    pub(super) fn choice<T: Copy + Default>(&mut self, key: &str, choices: &[(&str, T)]) -> T {
        let found = self.text(key).and_then(|(text, place)| {
            let found = choices.iter().find(|(word, _)| *word == text);
            if found.is_none() {
                self.unknown_choice(key, text, choices.iter().map(|(word, _)| *word), place);
            }
            found
        });
        found.map(|(_, choice)| *choice).unwrap_or_default()
    }

    fn unknown_choice<'w>(
        &mut self,
        key: &str,
        text: &str,
        known: impl Iterator<Item = &'w str>,
        place: Place,
    ) {
        let said = format!("{}: unknown choice `{text}` for `{key}`", self.what);
        let finding = Finding::error("ctos::config::unknown_choice", said);
        self.push(finding.suggest(text, known).at(place));
    }

    /// What `read` makes of a value.
    fn read<T>(
        &mut self,
        key: &str,
        expected: &str,
        read: impl FnOnce(&'n Node) -> Option<T>,
    ) -> Option<T> {
        let node = self.value(key)?;
        let value = read(node);
        if value.is_none() {
            self.wrong_key(key, node, expected);
        }
        value
    }

    /// A boolean.
    pub(super) fn flag(&mut self, key: &str) -> Option<bool> {
        self.read(key, "true or false", Node::as_bool)
    }

    /// A boolean, or the key's one word.
    pub(super) fn flag_or(&mut self, key: &str) -> Option<FlagOr> {
        let Kind::FlagOr(word) = self.kind(key)? else {
            return None;
        };
        let expected = format!("true, false or {word:?}");
        self.read(key, &expected, |node| match node.as_str() {
            Some(text) => (text == *word).then_some(FlagOr::Word),
            None => node.as_bool().map(FlagOr::Flag),
        })
    }

    /// A whole number within the key's range.
    pub(super) fn integer<T: TryFrom<u64>>(&mut self, key: &str) -> Option<T> {
        T::try_from(self.whole(key)?).ok()
    }

    fn whole(&mut self, key: &str) -> Option<u64> {
        let Kind::Integer(least, most) = self.kind(key)? else {
            return None;
        };
        self.read(
            key,
            &format!("a whole number from {least} to {most}"),
            |node| {
                let number = u64::try_from(node.as_integer()?).ok()?;
                (least..=most).contains(&&number).then_some(number)
            },
        )
    }

    /// A number within the key's range.
    pub(super) fn number(&mut self, key: &str) -> Option<f64> {
        let Kind::Number(least, most) = self.kind(key)? else {
            return None;
        };
        let expected = format!("a number from {least} to {most}");
        self.read(key, &expected, |node| {
            node.as_f64()
                .filter(|number| least <= number && number <= most)
        })
    }

    /// A time in seconds, above 0 and at most the key's longest.
    pub(super) fn seconds(&mut self, key: &str) -> Option<Duration> {
        let Kind::Seconds(most) = self.kind(key)? else {
            return None;
        };
        let expected = format!("a number of seconds above 0 and at most {most}");
        self.read(key, &expected, |node| {
            let time = node.as_f64().filter(|time| *time > 0.0 && time <= most);
            time.map(Duration::from_secs_f64)
        })
    }

    /// A string that is parsed further.
    pub(super) fn parsed<T: FromStr>(&mut self, key: &str, expected: &str) -> Option<T> {
        let (text, _) = self.text(key)?;
        self.read(key, expected, |_| text.parse().ok())
    }

    /// A table.
    pub(super) fn table(&mut self, key: &str) -> Option<&'n Node> {
        self.read(key, "a table", |node| node.is_table().then_some(node))
    }

    /// The elements of a list; `help` says how one is written.
    pub(super) fn list(&mut self, key: &str, help: &str) -> &'n [Node] {
        let Some(list) = self.value(key) else {
            return &[];
        };
        if !matches!(list.value(), Value::Array(_)) {
            let text = format!("{}: `{key}` must be a list", self.what);
            let finding = Finding::error("ctos::config::value", text).help(help);
            self.push(finding.at(list.place().cloned()));
        }
        list.elements()
    }

    /// Whether it has no keys.
    pub(super) fn is_empty(&self) -> bool {
        self.node.is_none_or(|node| node.entries().is_empty())
    }
}

/// A key that nobody reads; `place` is where it stands, in words.
pub(super) fn unknown_key<'a>(
    entry: &Entry,
    place: &str,
    known: impl Iterator<Item = &'a str>,
) -> Finding {
    let text = format!("unknown key `{}` {place}", entry.key);
    Finding::error("ctos::config::unknown_key", text)
        .label("nobody reads this key")
        .suggest(&entry.key, known)
        .at(entry.key_place.clone())
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
        let text = format!("`{}` cannot be the name of a {kind}", name.escape_debug());
        let finding = Finding::error("ctos::config::name", text)
            .help("names are 1 to 64 letters, digits, `_`, `-` or `.`");
        findings.push(finding.at(place.clone()));
    }
}
