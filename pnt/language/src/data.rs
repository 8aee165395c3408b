//! Data that a net declares and keeps itself: values with types, some with a unit. Every value has one number in its
//! net; fields of one name follow each other. Knows no expression and no marking.

use std::{fmt, ops::Range};

use ctos::diagnostic::{Finding, Findings, Place as At};
use serde::{Deserialize, Serialize};

use crate::draft::{Draft, DraftField, DraftSet, DraftShape, Word};

/// The longest text that data holds, bytes: data does not grow without bound.
pub const LONGEST_TEXT: usize = 4096;

/// The units that a float may have.
pub const UNITS: [&str; 26] = [
    "m", "cm", "mm", "um", "px", "rad", "deg", "h", "min", "s", "ms", "us", "Hz", "kg", "g", "N",
    "Nm", "V", "A", "W", "J", "Pa", "K", "lx", "percent", "m_per_s",
];

/// The type of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A whole number of 64 bits.
    Int,
    /// A number, in a unit or in none.
    Float(Option<&'static str>),
    /// Yes or no.
    Bool,
    /// Text of at most [`LONGEST_TEXT`] bytes.
    Text,
}

impl Kind {
    /// The type of that name.
    #[must_use]
    pub fn called(name: &str) -> Option<Self> {
        Some(match name {
            "int" => Self::Int,
            "float" => Self::Float(None),
            "bool" => Self::Bool,
            "text" => Self::Text,
            unit => Self::Float(Some(UNITS.into_iter().find(|known| *known == unit)?)),
        })
    }

    /// Zero, no, or no text.
    #[must_use]
    pub fn nothing(self) -> Value {
        match self {
            Self::Int => Value::Int(0),
            Self::Float(_) => Value::Float(0.0),
            Self::Bool => Value::Bool(false),
            Self::Text => Value::Text(String::new()),
        }
    }

    /// The value that a word of a command line stands for.
    #[must_use]
    pub fn read(self, word: &str) -> Option<Value> {
        match self {
            Self::Int => word.parse().ok().map(Value::Int),
            Self::Float(_) => {
                let number: f64 = word.parse().ok()?;
                number.is_finite().then_some(Value::Float(number))
            }
            Self::Bool => word.parse().ok().map(Value::Bool),
            Self::Text => (word.len() <= LONGEST_TEXT).then(|| Value::Text(word.to_owned())),
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Int => "int",
            Self::Float(None) => "float",
            Self::Float(Some(unit)) => unit,
            Self::Bool => "bool",
            Self::Text => "text",
        })
    }
}

/// A value of declared data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Value {
    /// A whole number.
    Int(i64),
    /// A number, always finite.
    Float(f64),
    /// Yes or no.
    Bool(bool),
    /// Text.
    Text(String),
}

impl Value {
    /// Whether it is of that type.
    #[must_use]
    pub fn is(&self, kind: Kind) -> bool {
        matches!(
            (self, kind),
            (Self::Int(_), Kind::Int)
                | (Self::Float(_), Kind::Float(_))
                | (Self::Bool(_), Kind::Bool)
                | (Self::Text(_), Kind::Text)
        )
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Int(number) => number.fmt(f),
            Self::Float(number) => fmt::Debug::fmt(number, f),
            Self::Bool(yes) => yes.fmt(f),
            Self::Text(text) => f.write_str(text),
        }
    }
}

/// A name of declared data, and which values of its net are its own.
#[derive(Debug, Clone)]
pub struct Data {
    /// Its name.
    pub name: String,
    /// The numbers of its values.
    pub slots: Range<usize>,
    /// Where it is declared.
    pub at: At,
}

/// One value of declared data.
#[derive(Debug, Clone)]
pub struct Slot {
    /// The name, or the name, a point and the field.
    pub name: String,
    /// Its type.
    pub kind: Kind,
    /// What it is at first.
    pub initial: Value,
}

/// What comes with a command, in order.
#[derive(Debug, Clone)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Its type.
    pub kind: Kind,
    /// Where it is declared.
    pub at: At,
}

/// The declared data of a net.
#[derive(Debug, Clone, Default)]
pub struct Declared {
    /// Every name.
    pub data: Vec<Data>,
    /// Every value.
    pub slots: Vec<Slot>,
}

impl Declared {
    /// The data of that name.
    #[must_use]
    pub fn named(&self, name: &str) -> Option<&Data> {
        self.data.iter().find(|data| data.name == name)
    }

    /// The number of the value of that name, fields with a point.
    #[must_use]
    pub fn slot(&self, name: &str) -> Option<usize> {
        self.slots.iter().position(|slot| slot.name == name)
    }

    /// What all values are at first.
    #[must_use]
    pub fn initial(&self) -> Vec<Value> {
        self.slots.iter().map(|slot| slot.initial.clone()).collect()
    }

    /// The values by their names.
    pub fn shown<'v>(&'v self, values: &'v [Value]) -> impl Iterator<Item = (&'v str, &'v Value)> {
        let names = self.slots.iter().map(|slot| slot.name.as_str());
        names.zip(values)
    }

    /// Data that a draft declares; initial values are left to who knows expressions.
    pub(crate) fn of(draft: &Draft, findings: &mut Findings) -> Self {
        let mut declared = Self::default();
        for one in &draft.data {
            let first = declared.slots.len();
            match &one.shape {
                DraftShape::One { kind, .. } => {
                    declared.add(one.name.text.clone(), kind, findings);
                }
                DraftShape::Fields(fields) => {
                    for DraftField { name, kind } in fields {
                        declared.add(format!("{}.{name}", one.name), kind, findings);
                    }
                }
            }
            if reserved(&one.name) {
                findings.push(no_name(&one.name));
            }
            declared.data.push(Data {
                name: one.name.text.clone(),
                slots: first..declared.slots.len(),
                at: one.name.at.clone(),
            });
        }
        declared
    }

    fn add(&mut self, name: String, kind: &Word, findings: &mut Findings) {
        // Of what type it is meant is not known; a float fits most.
        let kind = kind_of(kind, findings).unwrap_or(Kind::Float(None));
        self.slots.push(Slot {
            name,
            kind,
            initial: kind.nothing(),
        });
    }
}

/// The parameters of a command.
pub(crate) fn parameters(fields: &[DraftField], findings: &mut Findings) -> Vec<Parameter> {
    let parameter = |field: &DraftField| {
        if reserved(&field.name) {
            findings.push(no_name(&field.name));
        }
        Parameter {
            name: field.name.text.clone(),
            kind: kind_of(&field.kind, findings).unwrap_or(Kind::Text),
            at: field.name.at.clone(),
        }
    };
    fields.iter().map(parameter).collect()
}

fn kind_of(word: &Word, findings: &mut Findings) -> Option<Kind> {
    let kind = Kind::called(&word.text);
    if kind.is_none() {
        let known = ["int", "float", "bool", "text"].into_iter().chain(UNITS);
        findings.push(
            Finding::error("pnt::net::data", format!("`{word}` is no type and no unit"))
                .at(word.at.clone())
                .help(format!(
                    "write `int`, `float`, `bool`, `text`, or the unit of a float: {}",
                    UNITS.join(", ")
                ))
                .suggest(&word.text, known),
        );
    }
    kind
}

/// Words that mean something else in expressions.
fn reserved(word: &Word) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let text = word.text.as_str();
    [DraftSet::REPLY, "true", "false", "null", "in", "not"].contains(&text)
        || !text.chars().all(plain)
}

fn no_name(word: &Word) -> Finding {
    Finding::error("pnt::net::data", format!("data cannot be called `{word}`"))
        .at(word.at.clone())
        .help("a name of data is letters, digits and `_`, and no word of expressions")
}
