//! A configuration value of which every key and every value remembers where it was written.
//!
//! Knows TOML and places; knows nothing of what any key means.

use crate::diagnostic::{Finding, Findings, Place, Source};
use serde::de::DeserializeOwned;
use std::ops::Range;
use std::time::Duration;
use toml::de::{DeTable, DeValue};

/// A value: a scalar, an array or a table, with its place.
///
/// Nodes read from a file or from `--set` always have a place. Nodes built in code (by an
/// [`Expander`](super::Expander)) have none until the loader gives them their task's place.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    pub(super) value: Value,
    pub(super) place: Option<Place>,
}

/// What a [`Node`] holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Text.
    String(String),
    /// A whole number; wide enough for every `i64` and every `u64`.
    Integer(i128),
    /// A floating-point number; may be NaN or infinite, as TOML allows both.
    Float(f64),
    /// `true` or `false`.
    Bool(bool),
    /// A date, a time or both, as written.
    Datetime(String),
    /// Values in order.
    Array(Vec<Node>),
    /// Keys with values, in the order in which they were written.
    Table(Vec<Entry>),
}

/// One key of a table with its value.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The key, without quotes.
    pub key: String,
    /// Where the key stands.
    pub key_place: Option<Place>,
    /// Its value.
    pub value: Node,
}

impl Node {
    /// An empty table made in code; fill it by [`with`](Self::with).
    #[must_use]
    pub fn table() -> Self {
        Self {
            value: Value::Table(Vec::new()),
            place: None,
        }
    }

    /// This table with `key` set to `value`; a key that is there already is replaced. A node that
    /// is not a table becomes one.
    #[must_use]
    pub fn with(mut self, key: impl Into<String>, value: impl Into<Self>) -> Self {
        self.set(key, value);
        self
    }

    /// Does what [`with`](Self::with) does to this table.
    pub(super) fn set(&mut self, key: impl Into<String>, value: impl Into<Self>) {
        let (key, value) = (key.into(), value.into());
        if let Some(there) = self.inner(&key) {
            *there = value;
            return;
        }
        let entry = Entry {
            key,
            key_place: None,
            value,
        };
        match &mut self.value {
            Value::Table(entries) => entries.push(entry),
            other => *other = Value::Table(vec![entry]),
        }
    }

    /// This table without some of its keys; any other node as it is.
    #[must_use]
    pub fn without(&self, keys: &[&str]) -> Self {
        let mut node = self.clone();
        if let Value::Table(entries) = &mut node.value {
            entries.retain(|entry| !keys.contains(&entry.key.as_str()));
        }
        node
    }

    /// The same with other texts where `change` has one, here and in all below; it is told where each stands. Places
    /// stay.
    #[must_use]
    pub fn with_texts(
        &self,
        change: &mut dyn FnMut(&str, Option<&Place>) -> Option<String>,
    ) -> Self {
        let mut copy = self.clone();
        copy.visit(&mut |node| {
            if let Value::String(text) = &mut node.value
                && let Some(other) = change(text, node.place.as_ref())
            {
                *text = other;
            }
        });
        copy
    }

    /// What the node holds.
    #[must_use]
    pub fn value(&self) -> &Value {
        &self.value
    }

    /// Where the value was written: for a `[table]` its header, for a scalar the scalar.
    #[must_use]
    pub fn place(&self) -> Option<&Place> {
        self.place.as_ref()
    }

    pub(super) fn is_table(&self) -> bool {
        matches!(self.value, Value::Table(_))
    }

    /// The keys of a table with their values and places, in order; nothing for other nodes.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        match &self.value {
            Value::Table(entries) => entries,
            _ => &[],
        }
    }

    /// The keys of a table in this one, if it is there.
    pub(super) fn tables(&self, key: &str) -> &[Entry] {
        let entry = self.entry(key);
        entry.map_or(&[], |entry| entry.value.entries())
    }

    /// The value at a dotted path as a `T`; `None` where there is none, or one that was found wrong before.
    pub(super) fn read<T: DeserializeOwned>(&self, path: &str) -> Option<T> {
        self.get(path)?.parse().ok()
    }

    /// The time at a dotted path, where it stands in seconds.
    pub(super) fn seconds(&self, path: &str) -> Option<Duration> {
        Duration::try_from_secs_f64(self.read(path)?).ok()
    }

    /// The place of the value at a dotted path.
    pub(super) fn place_of(&self, path: &str) -> Option<Place> {
        self.get(path)?.place.clone()
    }

    /// The elements of an array; nothing for other nodes.
    #[must_use]
    pub fn elements(&self) -> &[Self] {
        match &self.value {
            Value::Array(elements) => elements,
            _ => &[],
        }
    }

    /// One key of a table, taken literally (dots are part of it).
    #[must_use]
    pub fn entry(&self, key: &str) -> Option<&Entry> {
        self.entries().iter().find(|entry| entry.key == key)
    }

    /// The value at a dotted path such as `cameras.0.name`; a number counts array elements from 0.
    /// A key that contains a dot is quoted: `files."a.csv"`.
    #[must_use]
    pub fn get(&self, path: &str) -> Option<&Self> {
        self.find(path).map(|(node, _)| node)
    }

    /// The place of the key that a dotted path leads to, or of the element for an array index.
    #[must_use]
    pub fn locate(&self, path: &str) -> Option<Place> {
        self.find(path).and_then(|(_, place)| place.cloned())
    }

    fn find(&self, path: &str) -> Option<(&Self, Option<&Place>)> {
        let mut at = (self, self.place.as_ref());
        for part in split_path(path) {
            at = match &at.0.value {
                Value::Array(elements) => {
                    let element = elements.get(part.parse::<usize>().ok()?)?;
                    (element, element.place.as_ref())
                }
                _ => {
                    let entry = at.0.entry(&part)?;
                    (&entry.value, entry.key_place.as_ref())
                }
            };
        }
        Some(at)
    }

    /// The text of a string.
    #[must_use]
    pub fn as_str(&self) -> Option<&str> {
        match &self.value {
            Value::String(text) => Some(text),
            _ => None,
        }
    }

    /// The number of an integer or a float.
    #[must_use]
    #[allow(
        clippy::cast_precision_loss,
        reason = "a whole number where a float is meant loses no more than writing it with a dot"
    )]
    pub fn as_f64(&self) -> Option<f64> {
        match self.value {
            Value::Float(number) => Some(number),
            Value::Integer(number) => Some(number as f64),
            _ => None,
        }
    }

    /// The number of an integer.
    #[must_use]
    pub fn as_integer(&self) -> Option<i128> {
        match self.value {
            Value::Integer(number) => Some(number),
            _ => None,
        }
    }

    /// The value of a boolean.
    #[must_use]
    pub fn as_bool(&self) -> Option<bool> {
        match self.value {
            Value::Bool(value) => Some(value),
            _ => None,
        }
    }

    /// It is something else than `what` says that it is.
    pub(super) fn is_no(&self, code: &'static str, what: &str, help: &str) -> Finding {
        let text = format!("{what}, found {}", self.kind());
        let finding = Finding::error(code, text).help(help);
        finding.at(self.place.clone())
    }

    /// The kind of value, as a person calls it.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self.value {
            Value::String(_) => "a string",
            Value::Integer(_) => "an integer",
            Value::Float(_) => "a float",
            Value::Bool(_) => "a boolean",
            Value::Datetime(_) => "a date or time",
            Value::Array(_) => "an array",
            Value::Table(_) => "a table",
        }
    }

    /// Reads the node as a `T`. A key that `T` has no field for is a mistake, whether it denies unknown
    /// fields or not. Integers are taken where a float is meant, and a number of seconds where a
    /// [`Duration`] is; nothing else is converted.
    ///
    /// # Errors
    /// The first mistake, at its key or value. It is an unknown key (with what was probably meant),
    /// a missing key (at the table), a wrong type or a refused value.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, Finding> {
        super::de::read(self)
    }

    /// Whether `place` is that of a key or a value in it.
    pub(super) fn holds(&self, place: &Place) -> bool {
        let of_entry =
            |entry: &Entry| entry.key_place.as_ref() == Some(place) || entry.value.holds(place);
        self.place() == Some(place)
            || self.elements().iter().any(|element| element.holds(place))
            || self.entries().iter().any(of_entry)
    }

    /// As [`parse`](Self::parse) for a table, with all its mistakes: they go to `findings`. Where nothing but keys that
    /// nobody reads is wrong, the rest of it is read all the same.
    #[must_use]
    pub fn parse_all<T: DeserializeOwned>(&self, findings: &mut Findings) -> Option<T> {
        super::de::read_all(self, findings)
    }

    /// Reads a whole TOML text. Returns what could be read (an empty table at worst) and adds every
    /// syntax error, duplicate key and unrepresentable number to `findings`.
    #[must_use]
    pub fn from_toml(source: &Source, findings: &mut Findings) -> Self {
        let (table, errors) = DeTable::parse_recoverable(source.text());
        for error in errors {
            findings.push(syntax_finding(&error, source, 0));
        }
        let entries = Reader::new(source, 0, findings).table(table.get_ref());
        Self {
            value: Value::Table(entries),
            place: Some(source.at(0..0)),
        }
    }

    /// Reads the dotted key that is the text of `source` before `end`. Returns the tables that it stands for,
    /// with an integer innermost; `None` when it is not a key.
    pub(super) fn from_toml_key(source: &Source, end: usize) -> Option<Self> {
        let text = source.text().get(..end)?;
        let document = format!("{text} = 0");
        let table = DeTable::parse(&document).ok()?;
        let is_key = !text.chars().any(char::is_control) && !table.get_ref().is_empty();
        let mut none = Findings::new();
        let entries = Reader::new(source, 0, &mut none).table(table.get_ref());
        is_key.then(|| Value::Table(entries).into())
    }

    /// Reads one TOML value, which is this byte range of `source`.
    pub(super) fn from_toml_value(source: &Source, range: Range<usize>) -> Result<Self, Finding> {
        let offset = range.start;
        let text = source.text().get(range).unwrap_or_default();
        let value = DeValue::parse(text).map_err(|error| syntax_finding(&error, source, offset))?;
        let mut findings = Findings::new();
        let mut reader = Reader::new(source, offset, &mut findings);
        let node = reader.node(value.get_ref(), value.span());
        match findings.into_sorted().into_iter().next() {
            Some(finding) => Err(finding),
            None => Ok(node),
        }
    }

    /// Lays `over` on top of this node: tables are merged key by key, everything else is replaced.
    /// A merged table keeps the place where it was first written.
    pub(super) fn merge(&mut self, over: Self) {
        let (ours, theirs) = match (&mut self.value, over) {
            (
                Value::Table(ours),
                Self {
                    value: Value::Table(theirs),
                    ..
                },
            ) => (ours, theirs),
            (_, over) => {
                *self = over;
                return;
            }
        };
        for entry in theirs {
            match ours.iter_mut().find(|own| own.key == entry.key) {
                Some(own) => {
                    if !own.value.is_table() || !entry.value.is_table() {
                        own.key_place = entry.key_place;
                    }
                    own.value.merge(entry.value);
                }
                None => ours.push(entry),
            }
        }
    }

    /// The value of one key of a table, to change it.
    pub(super) fn inner(&mut self, key: &str) -> Option<&mut Self> {
        let Value::Table(entries) = &mut self.value else {
            return None;
        };
        let entry = entries.iter_mut().find(|entry| entry.key == key)?;
        Some(&mut entry.value)
    }

    /// Removes a key of a table and returns it.
    pub(super) fn take(&mut self, key: &str) -> Option<Entry> {
        let Value::Table(entries) = &mut self.value else {
            return None;
        };
        let at = entries.iter().position(|entry| entry.key == key)?;
        Some(entries.remove(at))
    }

    /// Gives every part that has no place this one.
    pub(super) fn placed(mut self, place: &Place) -> Self {
        self.visit(&mut |node| {
            node.place.get_or_insert_with(|| place.clone());
            if let Value::Table(entries) = &mut node.value {
                for entry in entries {
                    entry.key_place.get_or_insert_with(|| place.clone());
                }
            }
        });
        self
    }

    /// Shows this node and then all below it.
    pub(super) fn visit(&mut self, visitor: &mut dyn FnMut(&mut Self)) {
        visitor(self);
        match &mut self.value {
            Value::Array(elements) => elements.iter_mut().for_each(|one| one.visit(visitor)),
            Value::Table(entries) => entries.iter_mut().for_each(|one| one.value.visit(visitor)),
            _ => {}
        }
    }
}

/// Turns the TOML crate's spanned tree into nodes.
struct Reader<'a> {
    source: &'a Source,
    offset: usize,
    findings: &'a mut Findings,
}

impl<'a> Reader<'a> {
    fn new(source: &'a Source, offset: usize, findings: &'a mut Findings) -> Self {
        Self {
            source,
            offset,
            findings,
        }
    }

    fn table(&mut self, table: &DeTable<'_>) -> Vec<Entry> {
        // The parser sorts keys by name; places bring back the order in which they were written.
        let mut pairs: Vec<_> = table.iter().collect();
        pairs.sort_by_key(|(key, _)| key.span().start);
        let read = pairs.into_iter().map(|(key, value)| {
            // A header's key is the best place for its table.
            let span = match value.get_ref() {
                DeValue::Table(_) => key.span(),
                _ => value.span(),
            };
            Entry {
                key: key.get_ref().to_string(),
                key_place: Some(self.at(key.span())),
                value: self.node(value.get_ref(), span),
            }
        });
        read.collect()
    }

    fn node(&mut self, value: &DeValue<'_>, span: Range<usize>) -> Node {
        let place = self.at(span);
        let value = match value {
            DeValue::String(text) => Value::String(text.to_string()),
            DeValue::Boolean(value) => Value::Bool(*value),
            DeValue::Datetime(value) => Value::Datetime(value.to_string()),
            DeValue::Integer(number) => {
                match i128::from_str_radix(number.as_str(), number.radix()) {
                    Ok(number) => Value::Integer(number),
                    Err(_) => self.unrepresentable(&place, "integer"),
                }
            }
            DeValue::Float(number) => match number.as_str().parse::<f64>() {
                Ok(parsed) if !parsed.is_infinite() || number.as_str().contains("inf") => {
                    Value::Float(parsed)
                }
                _ => self.unrepresentable(&place, "float"),
            },
            DeValue::Array(array) => Value::Array(
                array
                    .iter()
                    .map(|element| self.node(element.get_ref(), element.span()))
                    .collect(),
            ),
            DeValue::Table(table) => Value::Table(self.table(table)),
        };
        Node {
            value,
            place: Some(place),
        }
    }

    fn unrepresentable(&mut self, place: &Place, kind: &str) -> Value {
        let text = format!("this {kind} is too large to be represented");
        let finding = Finding::error("ctos::config::number", text);
        self.findings.push(finding.at(place.clone()));
        Value::Integer(0)
    }

    fn at(&self, span: Range<usize>) -> Place {
        self.source
            .at(span.start + self.offset..span.end + self.offset)
    }
}

fn syntax_finding(error: &toml::de::Error, source: &Source, offset: usize) -> Finding {
    let text = format!("this is not valid TOML: {}", error.message());
    let mut finding = Finding::error("ctos::config::syntax", text);
    if error.message() == "duplicate key" {
        let help = "a key, or a table, stands once in a file: rename it or take it out";
        finding = finding.help(help);
    }
    let end = source.text().len();
    let span = error.span().unwrap_or(end..end);
    finding.at(source.at((span.start + offset).min(end)..(span.end + offset).min(end)))
}

/// Splits `a."b.c".d` at the dots that stand outside quotes.
fn split_path(path: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    let mut quote = None;
    for letter in path.chars() {
        match (quote, letter) {
            (None, '.') => parts.push(String::new()),
            (None, '"' | '\'') => quote = Some(letter),
            (Some(open), _) if open == letter => quote = None,
            _ => {
                if let Some(last) = parts.last_mut() {
                    last.push(letter);
                }
            }
        }
    }
    parts
}

/// The value as JSON; NaN and infinite numbers become text, for JSON has none.
impl From<&Node> for serde_json::Value {
    fn from(node: &Node) -> Self {
        match node.value() {
            Value::String(text) | Value::Datetime(text) => text.as_str().into(),
            Value::Integer(number) => match (i64::try_from(*number), u64::try_from(*number)) {
                (Ok(number), _) => number.into(),
                (_, Ok(number)) => number.into(),
                _ => number.to_string().into(),
            },
            Value::Float(number) => serde_json::Number::from_f64(*number)
                .map_or_else(|| format!("{number}").into(), Self::Number),
            Value::Bool(value) => (*value).into(),
            Value::Array(elements) => elements.iter().map(Self::from).collect(),
            Value::Table(entries) => {
                let each = entries.iter();
                let each = each.map(|entry| (entry.key.clone(), Self::from(&entry.value)));
                Self::Object(each.collect())
            }
        }
    }
}

impl From<Value> for Node {
    fn from(value: Value) -> Self {
        Self { value, place: None }
    }
}

macro_rules! from {
    ($($type:ty => $value:path;)+) => {$(
        impl From<$type> for Node {
            fn from(value: $type) -> Self {
                $value(value.into()).into()
            }
        }
    )+};
}

from! {
    &str => Value::String;
    String => Value::String;
    bool => Value::Bool;
    f64 => Value::Float;
    i64 => Value::Integer;
    u64 => Value::Integer;
}

impl<T: Into<Self>> From<Vec<T>> for Node {
    fn from(elements: Vec<T>) -> Self {
        Value::Array(elements.into_iter().map(Into::into).collect()).into()
    }
}
