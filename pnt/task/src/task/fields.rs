//! Declared data in the messages of `send` lines: each value as the field of a command that it stands for. What a
//! command's data looks like is known from its type, so what does not fit is found before anything starts.

use ctos::{
    diagnostic::Finding,
    message::{DataType, Shape, ShapeKind},
    task::HandlerError,
};
use pnt_language::{
    data::{Kind, LONGEST_TEXT, Value},
    net::Net,
};
use serde::Deserialize;

/// The form of one of `count` data objects of a command's data: all of it, or a field.
pub(super) fn part(form: &Shape, index: usize, count: usize) -> Option<&Shape> {
    match form.inner.as_slice() {
        [only] if is_several(form) && count == 1 => Some(only),
        fields if is_several(form) && count > 1 => fields.get(index),
        _ => Some(form),
    }
}

fn is_several(form: &Shape) -> bool {
    matches!(
        form.kind,
        ShapeKind::Struct | ShapeKind::Tuple | ShapeKind::Unit
    )
}

/// What values it consists of, in order.
fn leaves(form: &Shape) -> Vec<&Shape> {
    match is_several(form) {
        true => form.inner.iter().flat_map(leaves).collect(),
        false => vec![form],
    }
}

/// A unit as a net writes it.
fn unit(form: &Shape) -> Option<&str> {
    Some(match form.unit.as_str() {
        "" => return None,
        "N m" => "Nm",
        "m/s" => "m_per_s",
        "%" => "percent",
        unit => unit,
    })
}

/// Whether a value of this type can stand where a command has such a one. Units count where both sides name one.
fn fits(kind: Kind, form: &Shape) -> bool {
    use ShapeKind::{Bool, F32, F64, I8, I16, I32, I64, Text, U8, U16, U32, U64};
    match kind {
        Kind::Int => matches!(form.kind, I8 | I16 | I32 | I64 | U8 | U16 | U32 | U64),
        Kind::Float(own) => {
            let same = own.zip(unit(form)).is_none_or(|(own, unit)| own == unit);
            same && matches!(form.kind, F32 | F64)
        }
        Kind::Bool => form.kind == Bool,
        Kind::Text => form.kind == Text,
    }
}

fn shown(form: &Shape) -> String {
    match unit(form) {
        Some(unit) => unit.to_owned(),
        None => format!("{:?}", form.kind).to_lowercase(),
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
    let Some(form) = kind.shape() else {
        return Vec::new();
    };
    let wrong = objects.iter().enumerate().filter_map(|(index, name)| {
        let own = kinds(net, name)?;
        let wanted = part(&form, index, objects.len());
        let wanted = wanted.map(leaves).unwrap_or_default();
        let same = own.len() == wanted.len()
            && own.iter().zip(&wanted).all(|(own, form)| fits(*own, form));
        (!same).then(|| {
            let listed =
                |words: &mut dyn Iterator<Item = String>| words.collect::<Vec<String>>().join(", ");
            let text = format!(
                "`{name}` is ({}), and {what} has ({}) there",
                listed(&mut own.iter().map(Kind::to_string)),
                listed(&mut wanted.iter().map(|form| shown(form))),
            );
            Finding::error("pnt::net::type", text)
                .help("declare data with the fields of the command, in order")
        })
    });
    wrong.collect()
}

/// The bytes of values as a command has them.
pub(super) fn written(values: &[Value], form: &Shape) -> Result<Vec<u8>, HandlerError> {
    let leaves = leaves(form);
    if leaves.len() != values.len() {
        return Err(HandlerError::new(format!(
            "{} values stand for {} fields",
            values.len(),
            leaves.len()
        )));
    }
    let mut bytes = Vec::new();
    for (value, form) in values.iter().zip(leaves) {
        bytes.extend(match (value, form.kind) {
            (Value::Int(number), ShapeKind::I8) => postcard::to_stdvec(&i8::try_from(*number)?),
            (Value::Int(number), ShapeKind::I16) => postcard::to_stdvec(&i16::try_from(*number)?),
            (Value::Int(number), ShapeKind::I32) => postcard::to_stdvec(&i32::try_from(*number)?),
            (Value::Int(number), ShapeKind::I64) => postcard::to_stdvec(number),
            (Value::Int(number), ShapeKind::U8) => postcard::to_stdvec(&u8::try_from(*number)?),
            (Value::Int(number), ShapeKind::U16) => postcard::to_stdvec(&u16::try_from(*number)?),
            (Value::Int(number), ShapeKind::U32) => postcard::to_stdvec(&u32::try_from(*number)?),
            (Value::Int(number), ShapeKind::U64) => postcard::to_stdvec(&u64::try_from(*number)?),
            // What a field of that type holds of it.
            #[allow(clippy::cast_possible_truncation)]
            (Value::Float(number), ShapeKind::F32) => postcard::to_stdvec(&(*number as f32)),
            (Value::Float(number), ShapeKind::F64) => postcard::to_stdvec(number),
            (Value::Bool(yes), ShapeKind::Bool) => postcard::to_stdvec(yes),
            (Value::Text(text), ShapeKind::Text) => postcard::to_stdvec(text),
            (value, _) => {
                let text = format!("`{value}` is no {}", shown(form));
                return Err(HandlerError::new(text));
            }
        }?);
    }
    Ok(bytes)
}

/// The values of a field, or of all of a reply.
pub(super) fn read(bytes: &[u8], form: &Shape) -> Result<Vec<Value>, HandlerError> {
    fn next<'b, T: Deserialize<'b>>(rest: &mut &'b [u8]) -> postcard::Result<T> {
        let (value, after) = postcard::take_from_bytes(rest)?;
        *rest = after;
        Ok(value)
    }
    let mut rest = bytes;
    let mut values = Vec::new();
    for form in leaves(form) {
        values.push(match form.kind {
            ShapeKind::I8 => Value::Int(next::<i8>(&mut rest)?.into()),
            ShapeKind::I16 => Value::Int(next::<i16>(&mut rest)?.into()),
            ShapeKind::I32 => Value::Int(next::<i32>(&mut rest)?.into()),
            ShapeKind::I64 => Value::Int(next(&mut rest)?),
            ShapeKind::U8 => Value::Int(next::<u8>(&mut rest)?.into()),
            ShapeKind::U16 => Value::Int(next::<u16>(&mut rest)?.into()),
            ShapeKind::U32 => Value::Int(next::<u32>(&mut rest)?.into()),
            ShapeKind::U64 => Value::Int(next::<u64>(&mut rest)?.try_into()?),
            ShapeKind::F32 => finite(next::<f32>(&mut rest)?.into())?,
            ShapeKind::F64 => finite(next(&mut rest)?)?,
            ShapeKind::Bool => Value::Bool(next(&mut rest)?),
            ShapeKind::Text => match next::<String>(&mut rest)? {
                text if text.len() <= LONGEST_TEXT => Value::Text(text),
                text => {
                    return Err(HandlerError::new(format!(
                        "a text of {} bytes came, and data holds {LONGEST_TEXT} at most",
                        text.len()
                    )));
                }
            },
            _ => {
                let text = format!("data cannot hold a {}", shown(form));
                return Err(HandlerError::new(text));
            }
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
