//! Finds the shape of a type: lets it read itself from nothing, and notes what it asks for.

use std::fmt;

use serde::{
    Deserializer,
    de::{
        DeserializeOwned, DeserializeSeed, EnumAccess, IntoDeserializer, MapAccess, SeqAccess,
        VariantAccess, Visitor, value::U32Deserializer,
    },
};

use super::shape::{Leaf, Shape};

/// How often a type is read at most: about once for each variant of its enums.
const PASSES: usize = 4096;
/// How deep values may lie in one another.
const DEPTH: usize = 64;

/// The shape of `T`, if it reads itself from small numbers and short texts.
pub(super) fn shape_of<T: DeserializeOwned>() -> Option<Shape> {
    let mut shape = Shape::Unknown;
    for _ in 0..PASSES {
        let reading = Nothing {
            shape: &mut shape,
            around: &mut Vec::new(),
            depth: 0,
            again: false,
        };
        T::deserialize(reading).ok()?;
        if shape.is_whole() {
            return Some(shape);
        }
    }
    None
}

/// What `T` is at its outside. A type that does not read itself from what it gets says that much, too.
pub(super) fn outermost<T: DeserializeOwned>() -> Shape {
    let mut shape = Shape::Unknown;
    // Only what it asks for first matters here.
    let _ = T::deserialize(Nothing {
        shape: &mut shape,
        around: &mut Vec::new(),
        depth: 0,
        again: false,
    });
    shape
}

/// Why a type has no shape that can be found.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct NoShape(String);

impl serde::de::Error for NoShape {
    fn custom<T: fmt::Display>(text: T) -> Self {
        Self(text.to_string())
    }
}

/// What a type is read from.
struct Nothing<'a> {
    shape: &'a mut Shape,
    /// The names of the types around this one.
    around: &'a mut Vec<&'static str>,
    depth: usize,
    /// Within a type that is around itself: as little as can be is read, and nothing noted.
    again: bool,
}

impl Nothing<'_> {
    fn leaf(&mut self, leaf: Leaf) {
        *self.shape = Shape::Leaf(leaf);
    }

    fn inner<'b>(&'b mut self, shape: &'b mut Shape) -> Nothing<'b> {
        Nothing {
            shape,
            around: self.around,
            depth: self.depth + 1,
            again: self.again,
        }
    }

    /// Reads a type that has a name, which may be around itself.
    fn named<T>(
        mut self,
        name: &'static str,
        read: impl FnOnce(&mut Nothing<'_>, &mut Shape) -> Result<T, NoShape>,
    ) -> Result<T, NoShape> {
        if self.depth > DEPTH {
            return Err(NoShape("it has no bottom".to_owned()));
        }
        if self.again || self.around.contains(&name) {
            *self.shape = Shape::Around(name.to_owned());
            self.again = true;
            return read(&mut self, &mut Shape::Unknown);
        }
        self.around.push(name);
        let mut shape = std::mem::replace(self.shape, Shape::Unknown);
        let value = read(&mut self, &mut shape);
        *self.shape = shape;
        self.around.pop();
        value
    }
}

/// Reads the members of a tuple or a struct.
fn members<'de, V: Visitor<'de>>(
    within: &mut Nothing<'_>,
    shapes: &mut [Shape],
    visitor: V,
) -> Result<V::Value, NoShape> {
    visitor.visit_seq(Members {
        within,
        shapes: shapes.iter_mut(),
    })
}

struct Members<'a, 'b> {
    within: &'a mut Nothing<'b>,
    shapes: std::slice::IterMut<'a, Shape>,
}

impl<'de> SeqAccess<'de> for Members<'_, '_> {
    type Error = NoShape;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, NoShape> {
        let Some(shape) = self.shapes.next() else {
            return Ok(None);
        };
        seed.deserialize(self.within.inner(shape)).map(Some)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.shapes.len())
    }
}

/// One entry of a map, or none.
struct Entry<'a, 'b> {
    within: &'a mut Nothing<'b>,
    entry: &'a mut [Shape; 2],
    left: bool,
}

impl<'de> MapAccess<'de> for Entry<'_, '_> {
    type Error = NoShape;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, NoShape> {
        if !std::mem::replace(&mut self.left, false) {
            return Ok(None);
        }
        let [key, _] = &mut *self.entry;
        seed.deserialize(self.within.inner(key)).map(Some)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, NoShape> {
        let [_, value] = &mut *self.entry;
        seed.deserialize(self.within.inner(value))
    }
}

/// One variant of an enum.
struct Variant<'a, 'b> {
    within: &'a mut Nothing<'b>,
    shape: &'a mut Shape,
    number: u32,
}

impl<'de> EnumAccess<'de> for Variant<'_, '_> {
    type Error = NoShape;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self), NoShape> {
        let number: U32Deserializer<NoShape> = self.number.into_deserializer();
        Ok((seed.deserialize(number)?, self))
    }
}

impl<'de> VariantAccess<'de> for Variant<'_, '_> {
    type Error = NoShape;

    fn unit_variant(self) -> Result<(), NoShape> {
        *self.shape = Shape::Leaf(Leaf::Nothing);
        Ok(())
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, NoShape> {
        seed.deserialize(self.within.inner(self.shape))
    }

    fn tuple_variant<V: Visitor<'de>>(self, len: usize, visitor: V) -> Result<V::Value, NoShape> {
        members(self.within, self.shape.tuple(len), visitor)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        members(self.within, self.shape.fields("", fields), visitor)
    }
}

macro_rules! leaves {
    ($($method:ident => $leaf:ident, $visit:ident, $value:expr;)*) => {
        $(fn $method<V: Visitor<'de>>(mut self, visitor: V) -> Result<V::Value, NoShape> {
            self.leaf(Leaf::$leaf);
            visitor.$visit($value)
        })*
    };
}

impl<'de> Deserializer<'de> for Nothing<'_> {
    type Error = NoShape;

    fn is_human_readable(&self) -> bool {
        false
    }

    // One rather than nothing: there are types that do not take 0.
    leaves! {
        deserialize_bool => Bool, visit_bool, false;
        deserialize_i8 => I8, visit_i8, 1;
        deserialize_i16 => I16, visit_i16, 1;
        deserialize_i32 => I32, visit_i32, 1;
        deserialize_i64 => I64, visit_i64, 1;
        deserialize_i128 => I128, visit_i128, 1;
        deserialize_u8 => U8, visit_u8, 1;
        deserialize_u16 => U16, visit_u16, 1;
        deserialize_u32 => U32, visit_u32, 1;
        deserialize_u64 => U64, visit_u64, 1;
        deserialize_u128 => U128, visit_u128, 1;
        deserialize_f32 => F32, visit_f32, 1.0;
        deserialize_f64 => F64, visit_f64, 1.0;
        deserialize_char => Char, visit_char, '1';
        deserialize_str => Text, visit_borrowed_str, "1";
        deserialize_string => Text, visit_str, "1";
        deserialize_bytes => Bytes, visit_borrowed_bytes, &[];
        deserialize_byte_buf => Bytes, visit_bytes, &[];
    }

    fn deserialize_unit<V: Visitor<'de>>(mut self, visitor: V) -> Result<V::Value, NoShape> {
        self.leaf(Leaf::Unit);
        visitor.visit_unit()
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        self.deserialize_unit(visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        let Self { depth, .. } = self;
        if depth > DEPTH {
            return Err(NoShape("it has no bottom".to_owned()));
        }
        visitor.visit_newtype_struct(Nothing {
            depth: depth + 1,
            ..self
        })
    }

    fn deserialize_option<V: Visitor<'de>>(mut self, visitor: V) -> Result<V::Value, NoShape> {
        if self.again {
            return visitor.visit_none();
        }
        let mut shape = std::mem::replace(self.shape, Shape::Unknown);
        let value = visitor.visit_some(self.inner(shape.option()));
        *self.shape = shape;
        value
    }

    fn deserialize_seq<V: Visitor<'de>>(mut self, visitor: V) -> Result<V::Value, NoShape> {
        if self.again {
            return members(&mut self, &mut [], visitor);
        }
        let mut shape = std::mem::replace(self.shape, Shape::Unknown);
        let one = std::slice::from_mut(shape.sequence());
        let value = members(&mut self, one, visitor);
        *self.shape = shape;
        value
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        mut self,
        len: usize,
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        let mut shape = std::mem::replace(self.shape, Shape::Unknown);
        let value = members(&mut self, shape.tuple(len), visitor);
        *self.shape = shape;
        value
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        len: usize,
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        self.deserialize_tuple(len, visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(mut self, visitor: V) -> Result<V::Value, NoShape> {
        let mut shape = std::mem::replace(self.shape, Shape::Unknown);
        let left = !self.again;
        let Some(entry) = shape.map() else {
            return Err(NoShape("it is no map".to_owned()));
        };
        let value = visitor.visit_map(Entry {
            within: &mut self,
            entry,
            left,
        });
        *self.shape = shape;
        value
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        let name = std::any::type_name::<V::Value>();
        self.named(name, |within, shape| {
            members(within, shape.fields(name, fields), visitor)
        })
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        let name = std::any::type_name::<V::Value>();
        self.named(name, |within, shape| {
            let Some((number, shape)) = shape.missing_variant(name, variants) else {
                return Err(NoShape("it has no variants".to_owned()));
            };
            visitor.visit_enum(Variant {
                within,
                shape,
                number,
            })
        })
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, NoShape> {
        Err(NoShape("it reads itself from anything".to_owned()))
    }

    fn deserialize_identifier<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NoShape> {
        self.deserialize_any(visitor)
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NoShape> {
        self.deserialize_any(visitor)
    }
}
