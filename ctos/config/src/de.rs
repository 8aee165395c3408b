//! serde over [`Node`]: reads types from a node and finds the place of whatever does not fit.

use super::node::{Entry, Node, Value};
use crate::diagnostic::{Finding, Findings};
use serde::de::{
    self, Deserialize, Deserializer, IntoDeserializer, Unexpected, Visitor,
    value::{MapAccessDeserializer, MapDeserializer, SeqDeserializer},
};
use serde_path_to_error::Segment;
use std::{fmt, time::Duration};

const UNKNOWN_KEY: &str = "ctos::config::unknown_key";
const UNKNOWN_CHOICE: &str = "ctos::config::unknown_choice";
const MISSING_KEY: &str = "ctos::config::missing_key";

/// Why a node cannot be read as the type asked for.
#[derive(Debug, thiserror::Error)]
#[error("{}", finding.message)]
struct NodeError {
    finding: Finding,
    /// The key or the choice that is unknown.
    unknown: Option<String>,
}

impl From<Finding> for NodeError {
    fn from(finding: Finding) -> Self {
        Self {
            finding,
            unknown: None,
        }
    }
}

/// Reads `T` from a node.
///
/// # Errors
/// A finding for a person, with its place and "did you mean".
pub(super) fn read<'de, T: Deserialize<'de>>(node: &'de Node) -> Result<T, Finding> {
    serde_path_to_error::deserialize(At::outermost(node)).map_err(|error| {
        let path = error.path().clone();
        placed(node, path.iter().collect(), error.into_inner())
    })
}

/// Reads `T` from a table, with every mistake in it: what does not fit is told, taken out, and the rest read on. None where
/// something other than a key that nobody reads was told.
pub(super) fn read_all<T: de::DeserializeOwned>(node: &Node, findings: &mut Findings) -> Option<T> {
    let mut left = node.clone();
    let (mut taken, mut is_known) = (Vec::new(), true);
    loop {
        let finding = match read(&left) {
            Ok(value) => return is_known.then_some(value),
            Err(finding) => finding,
        };
        // What was taken out is missed, of course.
        let lacks = |key: &String| finding.message == missing(key);
        if !taken.iter().any(lacks) {
            findings.push(finding.clone());
        }
        let place = finding.place.as_ref();
        let wrong = place.and_then(|place| {
            let mut entries = left.entries().iter();
            let here = |entry: &&Entry| {
                entry.key_place.as_ref() == Some(place) || entry.value.holds(place)
            };
            let entry = entries.find(here)?;
            Some((entry.key.clone(), entry.key_place.as_ref() == Some(place)))
        });
        let (key, is_key) = wrong?;
        is_known &= is_key && finding.code == UNKNOWN_KEY;
        left = left.without(&[&key]);
        taken.push(key);
    }
}

/// What is said of a key that is not there.
fn missing(key: &str) -> String {
    format!("the key `{key}` is missing")
}

/// The finding at the place that `path` leads to.
fn placed(mut node: &Node, mut path: Vec<&Segment>, error: NodeError) -> Finding {
    let (mut finding, unknown) = (error.finding, error.unknown);
    if finding.code == UNKNOWN_KEY
        && let Some(Segment::Map { key }) = path.last()
        && unknown.as_ref() == Some(key)
    {
        path.pop();
    }
    let mut names = Vec::new();
    for segment in path {
        let inner = match segment {
            Segment::Seq { index } => {
                names.push(index.to_string());
                node.elements().get(*index)
            }
            Segment::Map { key } => {
                names.push(key.clone());
                node.entry(key).map(|entry| &entry.value)
            }
            Segment::Enum { variant } => node.entry(variant).map(|entry| &entry.value),
            Segment::Unknown => None,
        };
        node = inner.unwrap_or(node);
    }
    let (path, message) = (names.join("."), &finding.message);
    if !path.is_empty() {
        finding.message = match finding.code {
            UNKNOWN_KEY | MISSING_KEY => format!("{message} in `{path}`"),
            UNKNOWN_CHOICE => format!("{message} for `{path}`"),
            _ => format!("`{path}`: {message}"),
        };
    }
    // An unknown key may stand deeper: serde finds it only after buffering in tagged enums.
    let key = unknown.and_then(|unknown| find_key(node, &unknown));
    let place = key.and_then(|entry| entry.key_place.clone());
    finding.at(place.or_else(|| node.place.clone()))
}

/// The first entry of that name at any depth.
fn find_key<'a>(node: &'a Node, key: &str) -> Option<&'a Entry> {
    node.entry(key).or_else(|| {
        let below = node.entries().iter().map(|entry| &entry.value);
        below
            .chain(node.elements())
            .find_map(|child| find_key(child, key))
    })
}

impl de::Error for NodeError {
    fn custom<T: fmt::Display>(text: T) -> Self {
        Finding::error("ctos::config::value", text.to_string()).into()
    }

    fn invalid_type(found: Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        let (wanted, found) = (wanted(expected), describe(found));
        Self::custom(format!("expected {wanted}, found {found}"))
    }

    fn invalid_value(found: Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        let (wanted, found) = (wanted(expected), describe(found));
        Self::custom(format!("{found} does not fit, expected {wanted}"))
    }

    fn invalid_length(found: usize, expected: &dyn de::Expected) -> Self {
        let wanted = expected.to_string();
        let wanted = wanted.trim_end_matches(" in sequence");
        Self::custom(format!("expected {wanted}, found {found}"))
    }

    fn unknown_field(field: &str, expected: &'static [&'static str]) -> Self {
        let finding = Finding::error(UNKNOWN_KEY, format!("unknown key `{field}`"));
        let finding = finding.label("nobody reads this key");
        Self {
            finding: finding.suggest(field, expected.iter().copied()),
            unknown: Some(field.to_owned()),
        }
    }

    fn unknown_variant(variant: &str, expected: &'static [&'static str]) -> Self {
        let finding = Finding::error(UNKNOWN_CHOICE, format!("unknown choice `{variant}`"));
        Self {
            finding: finding.suggest(variant, expected.iter().copied()),
            unknown: Some(variant.to_owned()),
        }
    }

    fn missing_field(field: &'static str) -> Self {
        let finding = Finding::error(MISSING_KEY, missing(field));
        let finding = finding.label(format!("`{field}` belongs into this table"));
        finding.help(format!("add `{field} = ...`")).into()
    }
}

/// What serde wants, in the words of a TOML file.
fn wanted(expected: &dyn de::Expected) -> String {
    match expected.to_string().as_str() {
        "f32" | "f64" => "a number".to_owned(),
        "i8" | "i16" | "i32" | "i64" | "i128" | "isize" => "a whole number".to_owned(),
        "u8" => "a whole number from 0 to 255".to_owned(),
        "u16" => "a whole number from 0 to 65535".to_owned(),
        "u32" | "u64" | "u128" | "usize" => "a whole number from 0".to_owned(),
        other => other.to_owned(),
    }
}

/// What serde found, in the words of a TOML file.
fn describe(found: Unexpected<'_>) -> String {
    match found {
        Unexpected::Map => "a table".to_owned(),
        Unexpected::Seq => "an array".to_owned(),
        Unexpected::Str(text) => format!("the string {text:?}"),
        Unexpected::Signed(number) => format!("the integer {number}"),
        Unexpected::Unsigned(number) => format!("the integer {number}"),
        Unexpected::Float(number) => format!("the float {number:?}"),
        Unexpected::Bool(value) => format!("the boolean {value}"),
        other => other.to_string(),
    }
}

/// A node as something to deserialize from, and the key and the known keys of the struct that it is part of.
#[derive(Clone, Copy)]
struct At<'de>(&'de Node, Option<(&'de str, &'static [&'static str])>);

impl<'de> At<'de> {
    /// A value that is not a field of a struct.
    fn outermost(node: &'de Node) -> Self {
        Self(node, None)
    }
}

impl<'de> IntoDeserializer<'de, NodeError> for At<'de> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

/// A table as what serde reads maps from; a struct with these fields, or a map without any.
fn map<'de>(
    entries: &'de [Entry],
    fields: Option<&'static [&'static str]>,
) -> MapDeserializer<'de, impl Iterator<Item = (&'de str, At<'de>)>, NodeError> {
    MapDeserializer::new(entries.iter().map(move |entry| {
        let key = entry.key.as_str();
        (key, At(&entry.value, fields.map(|fields| (key, fields))))
    }))
}

/// A number of seconds as serde reads a `Duration`: seconds and nanoseconds.
fn duration(node: &Node) -> Option<Result<[u64; 2], NodeError>> {
    let seconds = node.as_f64()?;
    let time = Duration::try_from_secs_f64(seconds).map_err(|_| {
        let finding = Finding::error("ctos::config::value", format!("{seconds} s is no time"));
        finding.help("give a number of seconds, 0 or more").into()
    });
    Some(time.map(|time| [time.as_secs(), time.subsec_nanos().into()]))
}

impl<'de> Deserializer<'de> for At<'de> {
    type Error = NodeError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NodeError> {
        match &self.0.value {
            Value::String(text) | Value::Datetime(text) => visitor.visit_borrowed_str(text),
            Value::Bool(value) => visitor.visit_bool(*value),
            Value::Float(number) => visitor.visit_f64(*number),
            Value::Integer(number) => match (i64::try_from(*number), u64::try_from(*number)) {
                (Ok(number), _) => visitor.visit_i64(number),
                (_, Ok(number)) => visitor.visit_u64(number),
                _ => visitor.visit_i128(*number),
            },
            Value::Array(elements) => {
                let mut elements = SeqDeserializer::new(elements.iter().map(At::outermost));
                let value = visitor.visit_seq(&mut elements)?;
                // A tuple takes as many as it has; what is left, nobody reads.
                elements.end()?;
                Ok(value)
            }
            Value::Table(entries) => visitor.visit_map(map(entries, None)),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NodeError> {
        // A key that is there is a value; TOML has no null.
        visitor.visit_some(self)
    }

    fn deserialize_unit<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NodeError> {
        if self.0.is_table() && self.0.entries().is_empty() {
            return visitor.visit_unit();
        }
        let text = "this choice takes no value: write it as a string";
        Err(de::Error::custom(text))
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, NodeError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NodeError> {
        if name == "Duration"
            && let Some(time) = duration(self.0)
        {
            return visitor.visit_seq(SeqDeserializer::new(time?.into_iter()));
        }
        match &self.0.value {
            Value::Table(entries) => visitor.visit_map(map(entries, Some(fields))),
            _ => self.deserialize_any(visitor),
        }
    }

    /// What a struct has no field for: nobody reads it, so it is a mistake.
    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NodeError> {
        match self.1 {
            Some((key, fields)) if !fields.contains(&key) => {
                Err(de::Error::unknown_field(key, fields))
            }
            _ => self.deserialize_any(visitor),
        }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NodeError> {
        let known = variants.join(", ");
        match &self.0.value {
            Value::String(variant) => visitor.visit_enum(variant.as_str().into_deserializer()),
            Value::Table(entries) if entries.len() == 1 => {
                visitor.visit_enum(MapAccessDeserializer::new(map(entries, None)))
            }
            Value::Table(_) => Err(de::Error::custom(format!(
                "expected a table with exactly one key out of: {known}"
            ))),
            _ => Err(de::Error::custom(format!(
                "expected one of {known}, found {}",
                self.0.kind()
            ))),
        }
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf
        unit_struct seq tuple tuple_struct map identifier
    }
}
