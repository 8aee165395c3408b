//! Types that a person declares by name, in a file or in what a program says of itself.

use std::fmt;

use ctos::message::{Shape, ShapeKind as Kind};
use serde::{
    Deserialize, Deserializer,
    de::{Error, MapAccess, SeqAccess, Visitor},
};

/// What a float may count.
const UNITS: [&str; 24] = [
    "m", "mm", "rad", "deg", "s", "ms", "us", "ns", "Hz", "kg", "N", "N m", "px", "m/s", "rad/s",
    "m/s^2", "rad/s^2", "V", "A", "W", "K", "%", "lx", "N/m",
];

/// Names of types, with what they are.
const NAMES: [(&str, Kind); 17] = [
    ("nothing", Kind::Unit),
    ("bool", Kind::Bool),
    ("int", Kind::I64),
    ("float", Kind::F64),
    ("text", Kind::Text),
    ("bytes", Kind::Bytes),
    ("i8", Kind::I8),
    ("i16", Kind::I16),
    ("i32", Kind::I32),
    ("i64", Kind::I64),
    ("u8", Kind::U8),
    ("u16", Kind::U16),
    ("u32", Kind::U32),
    ("u64", Kind::U64),
    ("f32", Kind::F32),
    ("f64", Kind::F64),
    ("char", Kind::Char),
];

/// A type as a person declares it:
///
/// - a name: `bool`, `int`, `float`, `text`, `bytes`, `nothing`, or one of fixed size: `u8`, `i32`, `f32`, ...;
/// - a unit, which is a float of so many: `m`, `rad`, `px`, `N m`, ...;
/// - a choice of names: `left | right`;
/// - any of these with `?` behind it: or none;
/// - `[type]`, any number of them; `[type, type]`, one of each;
/// - `{ name = type }`, with the names of its fields, in this order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Declared(pub(crate) Shape);

impl Declared {
    /// What has no fields.
    pub(crate) fn empty() -> Self {
        Self(Shape::named(Kind::Struct, "", &[]))
    }

    fn named(name: &str) -> Result<Shape, String> {
        let name = name.trim();
        if let Some(name) = name.strip_suffix('?') {
            return Ok(Shape {
                kind: Kind::Option,
                inner: vec![Self::named(name)?],
                ..Shape::default()
            });
        }
        if let Some((_, kind)) = NAMES.iter().find(|(known, _)| *known == name) {
            return Ok(Shape::holding(*kind, 0));
        }
        if UNITS.contains(&name) {
            return Ok(Shape {
                kind: Kind::F64,
                unit: name.to_owned(),
                ..Shape::default()
            });
        }
        let choices: Vec<&str> = name.split('|').map(str::trim).collect();
        if choices.len() > 1 && choices.iter().all(|choice| !choice.is_empty()) {
            let mut shape = Shape::named(Kind::Enum, "", &choices);
            shape.inner = vec![Shape::holding(Kind::Nothing, 0); choices.len()];
            return Ok(shape);
        }
        let names: Vec<&str> = NAMES.iter().map(|(name, _)| *name).collect();
        Err(format!(
            "there is no type `{name}`; there are {}, units ({}), `a | b`, and any of them with `?`",
            names.join(", "),
            UNITS.join(", ")
        ))
    }
}

impl<'de> Deserialize<'de> for Declared {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reading;
        impl<'de> Visitor<'de> for Reading {
            type Value = Declared;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a type: a name, a list or a table of fields")
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<Declared, E> {
                Declared::named(name).map(Declared).map_err(E::custom)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut types: A) -> Result<Declared, A::Error> {
                let mut inner = Vec::new();
                while let Some(Declared(shape)) = types.next_element()? {
                    inner.push(shape);
                }
                let kind = match inner.len() {
                    1 => Kind::Sequence,
                    _ => Kind::Tuple,
                };
                Ok(Declared(Shape {
                    kind,
                    inner,
                    ..Shape::default()
                }))
            }

            fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<Declared, A::Error> {
                let mut shape = Shape::named(Kind::Struct, "", &[]);
                while let Some((name, Declared(field))) = fields.next_entry::<String, _>()? {
                    shape.names.push(name);
                    shape.inner.push(field);
                }
                Ok(Declared(shape))
            }
        }
        deserializer.deserialize_any(Reading)
    }
}

/// A type as a person would declare it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shown<'a>(pub(crate) &'a Shape);

impl fmt::Display for Shown<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shape = self.0;
        let all = |f: &mut fmt::Formatter<'_>| {
            for (index, inner) in shape.inner.iter().map(Shown).enumerate() {
                let comma = if index > 0 { ", " } else { "" };
                write!(f, "{comma}{inner}")?;
            }
            Ok(())
        };
        match shape.kind {
            _ if !shape.unit.is_empty() => f.write_str(&shape.unit),
            Kind::Option => all(f).and_then(|()| f.write_str("?")),
            Kind::Sequence | Kind::Tuple => {
                f.write_str("[")?;
                all(f)?;
                f.write_str("]")
            }
            Kind::Struct => {
                f.write_str("{")?;
                for (index, (name, inner)) in shape.names.iter().zip(&shape.inner).enumerate() {
                    let (comma, inner) = (if index > 0 { ", " } else { "" }, Shown(inner));
                    write!(f, "{comma}{name}: {inner}")?;
                }
                f.write_str("}")
            }
            Kind::Enum => f.write_str(&shape.names.join(" | ")),
            Kind::Map => f.write_str("map"),
            Kind::Around => f.write_str(&shape.name),
            Kind::Unknown | Kind::Nothing => f.write_str("nothing"),
            kind => {
                let name = NAMES.iter().find(|(_, known)| *known == kind);
                f.write_str(name.map_or("number", |(name, _)| name))
            }
        }
    }
}
