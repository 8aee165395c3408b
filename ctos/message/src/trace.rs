//! Finds the shape of a type: lets it read itself from nothing, and notes what it asks for.

use std::{fmt, marker::PhantomData};

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
        Way::default().read(&mut shape, PhantomData::<T>).ok()?;
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
    let _ = Way::default().read(&mut shape, PhantomData::<T>);
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
    way: &'a mut Way,
}

/// What is around the type that is read.
#[derive(Default)]
struct Way {
    /// The types that have names.
    around: Vec<&'static str>,
    depth: usize,
    /// How many of them are around themselves: then as little as can be is read, and nothing noted.
    again: usize,
}

impl Way {
    /// Reads a type within those around it.
    fn read<'de, S: DeserializeSeed<'de>>(
        &mut self,
        shape: &mut Shape,
        seed: S,
    ) -> Result<S::Value, NoShape> {
        self.depth += 1;
        let value = seed.deserialize(Nothing { shape, way: self });
        self.depth -= 1;
        value
    }

    fn is_again(&self) -> bool {
        self.again > 0
    }

    /// Enters a type that has a name: whether it is not around itself, and where its shape is noted.
    fn enter<'s>(
        &mut self,
        name: &'static str,
        shape: &'s mut Shape,
        unnoted: &'s mut Shape,
    ) -> Result<(bool, &'s mut Shape), NoShape> {
        self.has_bottom()?;
        let new = !self.is_again() && !self.around.contains(&name);
        if new {
            self.around.push(name);
            return Ok((true, shape));
        }
        *shape = Shape::Around(name.to_owned());
        self.again += 1;
        Ok((false, unnoted))
    }

    fn leave(&mut self, new: bool) {
        if new {
            self.around.pop();
        } else {
            self.again -= 1;
        }
    }

    fn has_bottom(&self) -> Result<(), NoShape> {
        if self.depth > DEPTH {
            return Err(NoShape("it has no bottom".to_owned()));
        }
        Ok(())
    }
}

/// The members of a tuple or a struct, or one entry of a map.
struct Members<'a> {
    way: &'a mut Way,
    shapes: std::slice::IterMut<'a, Shape>,
}

impl<'a> Members<'a> {
    fn new(way: &'a mut Way, shapes: &'a mut [Shape]) -> Self {
        let shapes = shapes.iter_mut();
        Self { way, shapes }
    }

    fn next<'de, S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, NoShape> {
        let Some(shape) = self.shapes.next() else {
            return Ok(None);
        };
        self.way.read(shape, seed).map(Some)
    }
}

impl<'de> SeqAccess<'de> for Members<'_> {
    type Error = NoShape;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, NoShape> {
        self.next(seed)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.shapes.len())
    }
}

impl<'de> MapAccess<'de> for Members<'_> {
    type Error = NoShape;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, NoShape> {
        self.next(seed)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, NoShape> {
        let none = || NoShape("a value was asked for without its key".to_owned());
        self.next(seed)?.ok_or_else(none)
    }
}

fn tuple(count: usize) -> Shape {
    Shape::Tuple(vec![Shape::Unknown; count])
}

fn structure(name: &str, fields: &[&str]) -> Shape {
    let (names, unknown) = Shape::unknown(fields);
    Shape::Struct(name.to_owned(), names, unknown)
}

/// One variant of an enum.
struct Variant<'a> {
    way: &'a mut Way,
    shape: &'a mut Shape,
    number: u32,
}

impl<'de> EnumAccess<'de> for Variant<'_> {
    type Error = NoShape;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self), NoShape> {
        let number: U32Deserializer<NoShape> = self.number.into_deserializer();
        Ok((seed.deserialize(number)?, self))
    }
}

impl<'de> VariantAccess<'de> for Variant<'_> {
    type Error = NoShape;

    fn unit_variant(self) -> Result<(), NoShape> {
        *self.shape = Shape::Leaf(Leaf::Nothing);
        Ok(())
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, NoShape> {
        self.way.read(self.shape, seed)
    }

    fn tuple_variant<V: Visitor<'de>>(self, len: usize, visitor: V) -> Result<V::Value, NoShape> {
        visitor.visit_seq(Members::new(self.way, self.shape.within(tuple(len))))
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        visitor.visit_seq(Members::new(
            self.way,
            self.shape.within(structure("", fields)),
        ))
    }
}

macro_rules! leaves {
    ($($method:ident => $leaf:ident, $visit:ident, $value:expr;)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NoShape> {
            *self.shape = Shape::Leaf(Leaf::$leaf);
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

    fn deserialize_unit<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NoShape> {
        *self.shape = Shape::Leaf(Leaf::Unit);
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
        let Self { shape, way } = self;
        way.has_bottom()?;
        way.depth += 1;
        let value = visitor.visit_newtype_struct(Nothing { shape, way });
        way.depth -= 1;
        value
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NoShape> {
        let Self { shape, way } = self;
        if way.is_again() {
            return visitor.visit_none();
        }
        let [shape] = shape.within(Shape::Option(Box::new(Shape::Unknown))) else {
            return visitor.visit_none();
        };
        way.depth += 1;
        let value = visitor.visit_some(Nothing { shape, way });
        way.depth -= 1;
        value
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NoShape> {
        let Self { shape, way } = self;
        let members = if way.is_again() {
            &mut []
        } else {
            shape.within(Shape::Sequence(Box::new(Shape::Unknown)))
        };
        visitor.visit_seq(Members::new(way, members))
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        len: usize,
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        visitor.visit_seq(Members::new(self.way, self.shape.within(tuple(len))))
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        len: usize,
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        self.deserialize_tuple(len, visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NoShape> {
        let Self { shape, way } = self;
        let entry = if way.is_again() {
            &mut []
        } else {
            shape.within(Shape::Map(Box::new([Shape::Unknown, Shape::Unknown])))
        };
        visitor.visit_map(Members::new(way, entry))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        let name = std::any::type_name::<V::Value>();
        let Self { shape, way } = self;
        let mut unnoted = Shape::Unknown;
        let (new, shape) = way.enter(name, shape, &mut unnoted)?;
        let value = visitor.visit_seq(Members::new(way, shape.within(structure(name, fields))));
        way.leave(new);
        value
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        let name = std::any::type_name::<V::Value>();
        let Self { shape, way } = self;
        let mut unnoted = Shape::Unknown;
        let (new, shape) = way.enter(name, shape, &mut unnoted)?;
        let (names, unknown) = Shape::unknown(variants);
        let shapes = shape.within(Shape::Enum(name.to_owned(), names, unknown));
        // The first of which something is unknown, or the first of all.
        let missing = shapes.iter().position(|shape| !shape.is_whole());
        let number = missing.unwrap_or(0);
        let value = match (u32::try_from(number), shapes.get_mut(number)) {
            (Ok(number), Some(shape)) => visitor.visit_enum(Variant { way, shape, number }),
            _ => Err(NoShape("it has no variants".to_owned())),
        };
        way.leave(new);
        value
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
