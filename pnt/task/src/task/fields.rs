//! Declared data in the messages of `send` lines: each value as the field of a command that it stands for. What a
//! command's data looks like is known from its type, so what does not fit is found before anything starts.

use ctos::{diagnostic::Finding, message::DataType, task::HandlerError};
use pnt_language::{
    data::{Kind, LONGEST_TEXT, Value},
    net::Net,
};
use serde::Deserialize;

/// The form of a command's data, as far as declared data can have it.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Form {
    kind: String,
    #[serde(default)]
    inner: Vec<Form>,
}

impl Form {
    /// That of a type; nothing where it cannot be found.
    pub(super) fn of(kind: DataType) -> Option<Self> {
        let shape = serde_json::to_value(kind.shape()?).ok()?;
        serde_json::from_value(shape).ok()
    }

    fn is_several(&self) -> bool {
        matches!(self.kind.as_str(), "Struct" | "Tuple" | "Unit")
    }

    /// The form of one of `count` data objects: all of it, or a field.
    pub(super) fn part(&self, index: usize, count: usize) -> Option<&Self> {
        match self.inner.as_slice() {
            [only] if self.is_several() && count == 1 => Some(only),
            fields if self.is_several() && count > 1 => fields.get(index),
            _ => Some(self),
        }
    }

    /// What values it consists of, in order.
    fn leaves(&self) -> Vec<&str> {
        match self.is_several() {
            true => self.inner.iter().flat_map(Self::leaves).collect(),
            false => vec![&self.kind],
        }
    }
}

/// Whether a value of this type can stand where a command has such a one.
fn fits(kind: Kind, form: &str) -> bool {
    match kind {
        Kind::Int => ["I8", "I16", "I32", "I64", "U8", "U16", "U32", "U64"].contains(&form),
        Kind::Float(_) => ["F32", "F64"].contains(&form),
        Kind::Bool => form == "Bool",
        Kind::Text => form == "Text",
    }
}

/// The types of declared data, or of an argument of a command of the net.
pub(super) fn kinds(net: &Net, name: &str) -> Option<Vec<Kind>> {
    let declared = net.declared();
    if let Some(data) = declared.named(name) {
        let slots = declared.slots.get(data.slots.clone())?;
        return Some(slots.iter().map(|slot| slot.kind).collect());
    }
    let mut parameters = net
        .commands()
        .iter()
        .flat_map(|command| &command.parameters);
    parameters.find_map(|one| (one.name == name).then(|| vec![one.kind]))
}

/// What is wrong with declared data among the objects that go to, or come from, `what`.
pub(super) fn check(what: &str, net: &Net, objects: &[String], kind: DataType) -> Vec<Finding> {
    let Some(form) = Form::of(kind) else {
        return Vec::new();
    };
    let wrong = objects.iter().enumerate().filter_map(|(index, name)| {
        let own = kinds(net, name)?;
        let wanted = form
            .part(index, objects.len())
            .map(Form::leaves)
            .unwrap_or_default();
        let same = own.len() == wanted.len()
            && own.iter().zip(&wanted).all(|(own, form)| fits(*own, form));
        (!same).then(|| {
            let shown =
                |words: &mut dyn Iterator<Item = String>| words.collect::<Vec<String>>().join(", ");
            let text = format!(
                "`{name}` is ({}), and {what} has ({}) there",
                shown(&mut own.iter().map(Kind::to_string)),
                shown(&mut wanted.iter().map(|form| form.to_lowercase())),
            );
            Finding::error("pnt::net::type", text)
                .help("declare data with the fields of the command, in order")
        })
    });
    wrong.collect()
}

/// The bytes of values as a command has them.
pub(super) fn written(values: &[Value], form: &Form) -> Result<Vec<u8>, HandlerError> {
    let leaves = form.leaves();
    if leaves.len() != values.len() {
        return Err(HandlerError::new(format!(
            "{} values stand for {} fields",
            values.len(),
            leaves.len()
        )));
    }
    let mut bytes = Vec::new();
    for (value, form) in values.iter().zip(leaves) {
        bytes.extend(match (value, form) {
            (Value::Int(number), "I8") => postcard::to_stdvec(&i8::try_from(*number)?),
            (Value::Int(number), "I16") => postcard::to_stdvec(&i16::try_from(*number)?),
            (Value::Int(number), "I32") => postcard::to_stdvec(&i32::try_from(*number)?),
            (Value::Int(number), "I64") => postcard::to_stdvec(number),
            (Value::Int(number), "U8") => postcard::to_stdvec(&u8::try_from(*number)?),
            (Value::Int(number), "U16") => postcard::to_stdvec(&u16::try_from(*number)?),
            (Value::Int(number), "U32") => postcard::to_stdvec(&u32::try_from(*number)?),
            (Value::Int(number), "U64") => postcard::to_stdvec(&u64::try_from(*number)?),
            // What a field of that type holds of it.
            #[allow(clippy::cast_possible_truncation)]
            (Value::Float(number), "F32") => postcard::to_stdvec(&(*number as f32)),
            (Value::Float(number), "F64") => postcard::to_stdvec(number),
            (Value::Bool(yes), "Bool") => postcard::to_stdvec(yes),
            (Value::Text(text), "Text") => postcard::to_stdvec(text),
            (value, form) => return Err(HandlerError::new(format!("`{value}` is no {form}"))),
        }?);
    }
    Ok(bytes)
}

/// The values of a field, or of all of a reply.
pub(super) fn read(bytes: &[u8], form: &Form) -> Result<Vec<Value>, HandlerError> {
    fn next<'b, T: Deserialize<'b>>(rest: &mut &'b [u8]) -> postcard::Result<T> {
        let (value, after) = postcard::take_from_bytes(rest)?;
        *rest = after;
        Ok(value)
    }
    let mut rest = bytes;
    let mut values = Vec::new();
    for form in form.leaves() {
        values.push(match form {
            "I8" => Value::Int(next::<i8>(&mut rest)?.into()),
            "I16" => Value::Int(next::<i16>(&mut rest)?.into()),
            "I32" => Value::Int(next::<i32>(&mut rest)?.into()),
            "I64" => Value::Int(next(&mut rest)?),
            "U8" => Value::Int(next::<u8>(&mut rest)?.into()),
            "U16" => Value::Int(next::<u16>(&mut rest)?.into()),
            "U32" => Value::Int(next::<u32>(&mut rest)?.into()),
            "U64" => Value::Int(next::<u64>(&mut rest)?.try_into()?),
            "F32" => finite(next::<f32>(&mut rest)?.into())?,
            "F64" => finite(next(&mut rest)?)?,
            "Bool" => Value::Bool(next(&mut rest)?),
            "Text" => match next::<String>(&mut rest)? {
                text if text.len() <= LONGEST_TEXT => Value::Text(text),
                text => {
                    return Err(HandlerError::new(format!(
                        "a text of {} bytes came, and data holds {LONGEST_TEXT} at most",
                        text.len()
                    )));
                }
            },
            form => return Err(HandlerError::new(format!("data cannot hold a {form}"))),
        });
    }
    Ok(values)
}

fn finite(number: f64) -> Result<Value, HandlerError> {
    match number.is_finite() {
        true => Ok(Value::Float(number)),
        false => Err(HandlerError::new(format!(
            "{number} came, and data holds finite numbers"
        ))),
    }
}
