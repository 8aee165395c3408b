//! JSON that a program in another language wrote, as the postcard bytes of a value of a known shape.

#[cfg(test)]
mod tests;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use ctos::message::{Shape, ShapeKind as Kind};
use serde::Serialize;
use serde_json::Value;

use crate::{frames::base64, types::Shown};

/// How deep values may lie in one another.
const DEPTH: usize = 64;

/// The postcard bytes of `value`. A field that is missing is none where its type has that. Bytes may stand as base64.
/// `null` is a float that is not a number.
///
/// # Errors
/// What does not fit, and where in the value.
pub fn encoded(shape: &Shape, value: &Value) -> Result<Vec<u8>, String> {
    let (bytes, depth) = (Vec::new(), 0);
    let mut writer = Writer { bytes, depth };
    let written = writer.value(shape, value, None);
    written.map(|()| writer.bytes).map_err(Wrong::told)
}

/// The JSON of postcard bytes, in which bytes stand as base64. Nothing where they are no such value.
#[must_use]
pub fn told(shape: &Shape, bytes: &[u8], limit: usize) -> Option<Vec<u8>> {
    let mut json = Vec::new();
    shape.tell(bytes, &mut json, limit, &mut base64)?;
    Some(json)
}

/// A type with a name around what is written, and those around it.
struct Around<'a> {
    shape: &'a Shape,
    outer: Option<&'a Around<'a>>,
}

/// What does not fit, and the way to it, innermost first.
struct Wrong {
    what: String,
    way: Vec<String>,
}

impl Wrong {
    fn new(what: impl Into<String>) -> Self {
        let (what, way) = (what.into(), Vec::new());
        Self { what, way }
    }

    fn within(mut self, step: impl Into<String>) -> Self {
        self.way.push(step.into());
        self
    }

    fn told(self) -> String {
        let way: Vec<String> = self.way.into_iter().rev().collect();
        match way.is_empty() {
            true => self.what,
            false => format!("`{}`: {}", way.join("."), self.what),
        }
    }
}

struct Writer {
    bytes: Vec<u8>,
    depth: usize,
}

/// A value in the words of an error, not all of a long one.
fn shown(value: &Value) -> String {
    let mut text = value.to_string();
    if let Some((end, _)) = text.char_indices().nth(60) {
        text.truncate(end);
        text.push_str("...");
    }
    text
}

impl Writer {
    fn put<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), Wrong> {
        let own = postcard::to_stdvec(value).map_err(|error| Wrong::new(error.to_string()))?;
        self.bytes.extend(own);
        Ok(())
    }

    fn whole<T: Serialize + TryFrom<i128>>(&mut self, value: &Value) -> Result<(), Wrong> {
        let wide = value.as_i64().map(i128::from);
        let wide = wide.or_else(|| value.as_u64().map(i128::from));
        let fits = wide.and_then(|wide| T::try_from(wide).ok());
        let what = || {
            let name = std::any::type_name::<T>();
            Wrong::new(format!("{} is no whole number of {name}", shown(value)))
        };
        self.put(&fits.ok_or_else(what)?)
    }

    fn opaque(&mut self, value: &Value) -> Result<(), Wrong> {
        let bytes = match value {
            Value::String(text) => STANDARD.decode(text).ok(),
            Value::Array(all) => {
                let one = |value: &Value| value.as_u64().and_then(|one| u8::try_from(one).ok());
                all.iter().map(one).collect()
            }
            _ => None,
        };
        let bytes = bytes.ok_or_else(|| Wrong::new(format!("{} is no base64", shown(value))))?;
        self.put(&bytes)
    }

    fn value(
        &mut self,
        shape: &Shape,
        value: &Value,
        around: Option<&Around<'_>>,
    ) -> Result<(), Wrong> {
        if self.depth > DEPTH {
            return Err(Wrong::new("it is too deep"));
        }
        self.depth += 1;
        self.any(shape, value, around)?;
        self.depth -= 1;
        Ok(())
    }

    fn any(
        &mut self,
        shape: &Shape,
        value: &Value,
        around: Option<&Around<'_>>,
    ) -> Result<(), Wrong> {
        let no = || no(shape, value);
        match shape.kind {
            Kind::Unknown => Err(Wrong::new("its type is not known here")),
            Kind::Unit | Kind::Nothing => value.is_null().then_some(()).ok_or_else(no),
            Kind::Bool => self.put(&value.as_bool().ok_or_else(no)?),
            Kind::I8 => self.whole::<i8>(value),
            Kind::I16 => self.whole::<i16>(value),
            Kind::I32 => self.whole::<i32>(value),
            Kind::I64 => self.whole::<i64>(value),
            Kind::I128 => self.whole::<i128>(value),
            Kind::U8 => self.whole::<u8>(value),
            Kind::U16 => self.whole::<u16>(value),
            Kind::U32 => self.whole::<u32>(value),
            Kind::U64 => self.whole::<u64>(value),
            Kind::U128 => self.whole::<u128>(value),
            Kind::F32 | Kind::F64 if value.is_null() && shape.kind == Kind::F32 => {
                self.put(&f32::NAN)
            }
            Kind::F32 | Kind::F64 if value.is_null() => self.put(&f64::NAN),
            #[expect(
                clippy::cast_possible_truncation,
                reason = "it is as exact as its type"
            )]
            Kind::F32 => self.put(&(value.as_f64().ok_or_else(no)? as f32)),
            Kind::F64 => self.put(&value.as_f64().ok_or_else(no)?),
            Kind::Char => {
                let mut letters = value.as_str().ok_or_else(no)?.chars();
                match (letters.next(), letters.next()) {
                    (Some(letter), None) => self.put(&letter),
                    _ => Err(no()),
                }
            }
            Kind::Text => self.put(value.as_str().ok_or_else(no)?),
            Kind::Bytes => self.opaque(value),
            Kind::Option if value.is_null() => self.put(&0_u8),
            Kind::Option => {
                self.put(&1_u8)?;
                self.value(first(shape)?, value, around)
            }
            Kind::Sequence if first(shape)?.kind == Kind::U8 => self.opaque(value),
            Kind::Sequence => {
                let all = value.as_array().ok_or_else(no)?;
                self.put(&all.len())?;
                let each = first(shape)?;
                self.many(all.iter().map(|value| (each, value)), around)
            }
            Kind::Tuple => {
                let all = value.as_array().ok_or_else(no)?;
                if all.len() != shape.inner.len() {
                    let (has, needs) = (all.len(), shape.inner.len());
                    return Err(Wrong::new(format!("it has {has} values, not {needs}")));
                }
                self.many(shape.inner.iter().zip(all), around)
            }
            Kind::Map => self.map(shape, value, around),
            Kind::Struct => self.members(shape, value, around),
            Kind::Enum => self.variant(shape, value, around),
            Kind::Around => {
                let mut outer = std::iter::successors(around, |around| around.outer);
                let again = outer.find(|around| around.shape.name == shape.name);
                let again = again.ok_or_else(no)?;
                self.value(again.shape, value, again.outer)
            }
        }
    }

    fn many<'s>(
        &mut self,
        values: impl Iterator<Item = (&'s Shape, &'s Value)>,
        around: Option<&Around<'_>>,
    ) -> Result<(), Wrong> {
        for (index, (shape, value)) in values.enumerate() {
            let put = self.value(shape, value, around);
            put.map_err(|wrong| wrong.within(index.to_string()))?;
        }
        Ok(())
    }

    fn map(
        &mut self,
        shape: &Shape,
        value: &Value,
        around: Option<&Around<'_>>,
    ) -> Result<(), Wrong> {
        let ([key, each], Some(all)) = (shape.inner.as_slice(), value.as_object()) else {
            return Err(no(shape, value));
        };
        self.put(&all.len())?;
        for (name, value) in all {
            let text = Value::String(name.clone());
            let number = || serde_json::from_str(name).unwrap_or_else(|_| text.clone());
            let put = match key.kind {
                Kind::Text | Kind::Char => self.value(key, &text, around),
                _ => self.value(key, &number(), around),
            };
            put.and_then(|()| self.value(each, value, around))
                .map_err(|wrong| wrong.within(name))?;
        }
        Ok(())
    }

    fn members(
        &mut self,
        shape: &Shape,
        value: &Value,
        around: Option<&Around<'_>>,
    ) -> Result<(), Wrong> {
        let nothing = serde_json::Map::new();
        let all = match value {
            Value::Object(all) => all,
            // What has no fields need not be written.
            Value::Null if shape.names.is_empty() => &nothing,
            _ => return Err(no(shape, value)),
        };
        if let Some(strange) = all.keys().find(|key| !shape.names.contains(key)) {
            let known = shape.names.join(", ");
            let text = format!("there is no field `{strange}`; there are: {known}");
            return Err(Wrong::new(text));
        }
        let within = Some(&Around {
            shape,
            outer: around,
        });
        for (name, member) in shape.names.iter().zip(&shape.inner) {
            let put = match all.get(name) {
                Some(value) => self.value(member, value, within),
                None if member.kind == Kind::Option => self.put(&0_u8),
                None => Err(Wrong::new(format!("it is missing: {}", Shown(member)))),
            };
            put.map_err(|wrong| wrong.within(name))?;
        }
        Ok(())
    }

    fn variant(
        &mut self,
        shape: &Shape,
        value: &Value,
        around: Option<&Around<'_>>,
    ) -> Result<(), Wrong> {
        let one = value.as_object().filter(|all| all.len() == 1);
        let named = match value {
            Value::String(name) => Some((name, &Value::Null)),
            _ => one.and_then(|all| all.iter().next()),
        };
        let place = named.and_then(|(name, _)| shape.names.iter().position(|one| one == name));
        let (Some((name, value)), Some(place)) = (named, place) else {
            let text = format!("{} is none of {}", shown(value), shape.names.join(", "));
            return Err(Wrong::new(text));
        };
        let within = Some(&Around {
            shape,
            outer: around,
        });
        let variant = shape.inner.get(place);
        let variant = variant.ok_or_else(|| Wrong::new("its type is not known here"))?;
        self.put(&u32::try_from(place).unwrap_or(u32::MAX))?;
        let put = self.value(variant, value, within);
        put.map_err(|wrong| wrong.within(name))
    }
}

fn no(shape: &Shape, value: &Value) -> Wrong {
    Wrong::new(format!("{} is no {}", shown(value), Shown(shape)))
}

fn first(shape: &Shape) -> Result<&Shape, Wrong> {
    let first = shape.inner.first();
    first.ok_or_else(|| Wrong::new("its type is not known here"))
}
