//! serde over [`Node`]: reads types from a node and knows the place of whatever does not fit.
//!
//! A deserializer of our own, and not a path looked up afterwards, because the error then carries
//! the place of the key or value it arose at, also inside arrays and enums.

use super::node::{Entry, Node, Value};
use crate::diagnostic::{Finding, Place};
use serde::de::{
    self, Deserialize, DeserializeSeed, Deserializer, EnumAccess, IntoDeserializer, MapAccess,
    SeqAccess, Unexpected, VariantAccess, Visitor, value::StrDeserializer,
};
use std::fmt;

/// Why a node cannot be read as the type asked for.
#[derive(Debug)]
pub(super) struct NodeError {
    finding: Finding,
    kind: Kind,
    /// Keys and indices from the outside in.
    path: Vec<String>,
}

#[derive(Debug)]
enum Kind {
    UnknownField(String),
    UnknownVariant,
    MissingField,
    Other,
}

impl NodeError {
    fn new(kind: Kind, code: &'static str, message: String) -> Self {
        Self {
            finding: Finding::error(code, message),
            kind,
            path: Vec::new(),
        }
    }

    fn with(mut self, more: impl FnOnce(Finding) -> Finding) -> Self {
        self.finding = more(self.finding);
        self
    }

    /// Adds the place unless a deeper one is known.
    fn at(mut self, place: Option<&Place>) -> Self {
        self.finding.place = self.finding.place.or_else(|| place.cloned());
        self
    }

    fn inside(mut self, part: impl Into<String>) -> Self {
        self.path.insert(0, part.into());
        self
    }

    /// The finding for a person, with "did you mean".
    pub(super) fn into_finding(self) -> Finding {
        let mut finding = self.finding;
        if !self.path.is_empty() {
            let (path, message) = (self.path.join("."), &finding.message);
            finding.message = match self.kind {
                Kind::UnknownField(_) | Kind::MissingField => format!("{message} in `{path}`"),
                Kind::UnknownVariant => format!("{message} for `{path}`"),
                Kind::Other => format!("`{path}`: {message}"),
            };
        }
        finding
    }

    /// Completes an error that came up while `node` was read. An unknown key that serde only found
    /// after buffering (tagged enums) is looked up again among the keys below.
    fn while_reading(self, node: &Node) -> Self {
        if let (None, Kind::UnknownField(field)) = (&self.finding.place, &self.kind)
            && let Some(entry) = find_key(node, field)
        {
            let place = entry.key_place.clone();
            return self.at(place.as_ref());
        }
        self.at(node.place())
    }
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

impl fmt::Display for NodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.finding.message)
    }
}

impl std::error::Error for NodeError {}

impl de::Error for NodeError {
    fn custom<T: fmt::Display>(text: T) -> Self {
        Self::new(Kind::Other, "ctos::config::value", text.to_string())
    }

    fn invalid_type(found: Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        let (wanted, found) = (wanted(expected), describe(found));
        Self::custom(format!("expected {wanted}, found {found}"))
    }

    fn invalid_value(found: Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        let (wanted, found) = (wanted(expected), describe(found));
        Self::custom(format!("{found} does not fit, expected {wanted}"))
    }

    fn unknown_field(field: &str, expected: &'static [&'static str]) -> Self {
        let kind = Kind::UnknownField(field.to_owned());
        let message = format!("unknown key `{field}`");
        Self::new(kind, "ctos::config::unknown_key", message).with(|finding| {
            let finding = finding.label("nobody reads this key");
            finding.suggest(field, expected.iter().copied())
        })
    }

    fn unknown_variant(variant: &str, expected: &'static [&'static str]) -> Self {
        let message = format!("unknown choice `{variant}`");
        Self::new(
            Kind::UnknownVariant,
            "ctos::config::unknown_choice",
            message,
        )
        .with(|finding| finding.suggest(variant, expected.iter().copied()))
    }

    fn missing_field(field: &'static str) -> Self {
        let message = format!("the key `{field}` is missing");
        Self::new(Kind::MissingField, "ctos::config::missing_key", message).with(|finding| {
            let finding = finding.label(format!("`{field}` belongs into this table"));
            finding.help(format!("add `{field} = ...`"))
        })
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

/// Reads `T` from a node.
pub(super) fn read<'de, T: Deserialize<'de>>(node: &'de Node) -> Result<T, NodeError> {
    T::deserialize(At(node)).map_err(|error| error.while_reading(node))
}

/// A node as something to deserialize from.
#[derive(Clone, Copy)]
struct At<'de>(&'de Node);

impl<'de> Deserializer<'de> for At<'de> {
    type Error = NodeError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NodeError> {
        let result = match &self.0.value {
            Value::String(text) | Value::Datetime(text) => visitor.visit_borrowed_str(text),
            Value::Bool(value) => visitor.visit_bool(*value),
            Value::Float(number) => visitor.visit_f64(*number),
            Value::Integer(number) => match (i64::try_from(*number), u64::try_from(*number)) {
                (Ok(number), _) => visitor.visit_i64(number),
                (_, Ok(number)) => visitor.visit_u64(number),
                _ => visitor.visit_i128(*number),
            },
            Value::Array(elements) => visitor.visit_seq(Elements { elements, read: 0 }),
            Value::Table(entries) => visitor.visit_map(Entries { entries, next: 0 }),
        };
        result.map_err(|error| error.while_reading(self.0))
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NodeError> {
        // A key that is there is a value; TOML has no null.
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, NodeError> {
        visitor
            .visit_newtype_struct(self)
            .map_err(|error| error.while_reading(self.0))
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NodeError> {
        let result = match &self.0.value {
            Value::String(variant) => visitor.visit_enum(variant.as_str().into_deserializer()),
            Value::Table(entries) => match entries.as_slice() {
                [entry] => visitor.visit_enum(Variant(entry)),
                _ => Err(de::Error::custom(format!(
                    "expected a table with exactly one key out of: {}",
                    variants.join(", ")
                ))),
            },
            _ => Err(de::Error::custom(format!(
                "expected one of {}, found {}",
                variants.join(", "),
                self.0.kind()
            ))),
        };
        result.map_err(|error| error.while_reading(self.0))
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf
        unit unit_struct seq tuple tuple_struct map struct identifier ignored_any
    }
}

struct Elements<'de> {
    elements: &'de [Node],
    read: usize,
}

impl<'de> SeqAccess<'de> for Elements<'de> {
    type Error = NodeError;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, NodeError> {
        let Some(element) = self.elements.get(self.read) else {
            return Ok(None);
        };
        let index = self.read;
        self.read += 1;
        seed.deserialize(At(element))
            .map(Some)
            .map_err(|error| error.while_reading(element).inside(index.to_string()))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.elements.len() - self.read)
    }
}

impl Entry {
    fn read_key<'de, K: DeserializeSeed<'de>>(&'de self, seed: K) -> Result<K::Value, NodeError> {
        let key: StrDeserializer<'de, NodeError> = self.key.as_str().into_deserializer();
        let read = seed.deserialize(key);
        read.map_err(|error| error.at(self.key_place.as_ref()))
    }
}

struct Entries<'de> {
    entries: &'de [Entry],
    next: usize,
}

impl<'de> MapAccess<'de> for Entries<'de> {
    type Error = NodeError;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, NodeError> {
        let Some(entry) = self.entries.get(self.next) else {
            return Ok(None);
        };
        entry.read_key(seed).map(Some)
    }

    fn next_value_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<T::Value, NodeError> {
        let Some(entry) = self.entries.get(self.next) else {
            return Err(de::Error::custom("a value was asked for without its key"));
        };
        self.next += 1;
        seed.deserialize(At(&entry.value))
            .map_err(|error| error.while_reading(&entry.value).inside(entry.key.as_str()))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.entries.len() - self.next)
    }
}

/// `{ variant = content }`.
struct Variant<'de>(&'de Entry);

impl<'de> EnumAccess<'de> for Variant<'de> {
    type Error = NodeError;
    type Variant = At<'de>;

    fn variant_seed<V: DeserializeSeed<'de>>(
        self,
        seed: V,
    ) -> Result<(V::Value, At<'de>), NodeError> {
        Ok((self.0.read_key(seed)?, At(&self.0.value)))
    }
}

impl<'de> VariantAccess<'de> for At<'de> {
    type Error = NodeError;

    fn unit_variant(self) -> Result<(), NodeError> {
        if self.0.entries().is_empty() && self.0.is_table() {
            return Ok(());
        }
        let text = "this choice takes no value: write it as a string";
        Err(<NodeError as de::Error>::custom(text).at(self.0.place()))
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, NodeError> {
        seed.deserialize(self)
    }

    fn tuple_variant<V: Visitor<'de>>(
        self,
        _len: usize,
        visitor: V,
    ) -> Result<V::Value, NodeError> {
        self.deserialize_any(visitor)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NodeError> {
        self.deserialize_any(visitor)
    }
}
