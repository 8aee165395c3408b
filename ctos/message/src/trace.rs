//! Finds the shape of a type: lets it read itself from nothing, and notes what it asks for.

use serde::{
    Deserializer,
    de::{
        DeserializeOwned, DeserializeSeed, EnumAccess, Error, IntoDeserializer, VariantAccess,
        Visitor,
        value::{Error as NoShape, MapDeserializer, SeqDeserializer, U32Deserializer},
    },
};

use super::shape::{Kind, Shape};

/// How often a type is read at most: about once for each variant of its enums.
const PASSES: usize = 4096;
/// How deep values may lie in one another.
const DEPTH: usize = 64;

/// The shape of `T`, if it reads itself from small numbers and short texts.
pub(super) fn shape_of<T: DeserializeOwned>() -> Option<Shape> {
    let mut whole = Shape::default();
    for _ in 0..PASSES {
        let (shape, here) = (&mut whole, Here::default());
        T::deserialize(Nothing { shape, here }).ok()?;
        if whole.is_whole() {
            return Some(whole);
        }
    }
    None
}

/// A type with a name, and those around it.
struct Around<'a> {
    name: &'static str,
    outer: Option<&'a Around<'a>>,
}

/// Where the type stands that is read.
#[derive(Clone, Copy, Default)]
struct Here<'a> {
    around: Option<&'a Around<'a>>,
    depth: usize,
    /// One of those around it is around itself: as little as can be is read, and nothing noted.
    again: bool,
}

impl Here<'_> {
    /// Inside the type that stands here.
    fn inside(mut self) -> Result<Self, NoShape> {
        if self.depth > DEPTH {
            return Err(NoShape::custom("it has no bottom"));
        }
        self.depth += 1;
        Ok(self)
    }
}

/// What a type is read from.
struct Nothing<'a> {
    shape: &'a mut Shape,
    here: Here<'a>,
}

impl<'a> Nothing<'a> {
    /// What the members of a type of the kind of `new` are read from.
    fn members(self, new: Shape) -> Result<impl Iterator<Item = Self>, NoShape> {
        let here = self.here.inside()?;
        let members = self.shape.within(new).iter_mut();
        Ok(members.map(move |shape| Self { shape, here }))
    }

    /// As [`Self::members`], where there need not be any.
    fn some_members(self, new: Shape) -> Result<impl Iterator<Item = Self>, NoShape> {
        let most = if self.here.again { 0 } else { usize::MAX };
        Ok(self.members(new)?.take(most))
    }

    /// Enters the type named by `around`. Within itself it is noted in a place of nobody's.
    fn enter(self, around: &'a Around<'a>, nowhere: &'a mut Shape) -> Self {
        let Self { shape, mut here } = self;
        let mut outer = std::iter::successors(around.outer, |around| around.outer);
        if here.again || outer.any(|outer| outer.name == around.name) {
            *shape = Shape::named(Kind::Around, around.name, &[]);
            here.again = true;
            return Self {
                shape: nowhere,
                here,
            };
        }
        here.around = Some(around);
        Self { shape, here }
    }
}

impl<'de> IntoDeserializer<'de, NoShape> for Nothing<'_> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

/// One variant of an enum.
struct Variant<'a> {
    variant: Nothing<'a>,
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
        *self.variant.shape = Shape::holding(Kind::Nothing, 0);
        Ok(())
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, NoShape> {
        seed.deserialize(self.variant)
    }

    fn tuple_variant<V: Visitor<'de>>(self, len: usize, visitor: V) -> Result<V::Value, NoShape> {
        self.variant.deserialize_tuple(len, visitor)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        let members = self.variant.members(Shape::named(Kind::Struct, "", fields));
        visitor.visit_seq(SeqDeserializer::new(members?))
    }
}

macro_rules! leaves {
    ($($method:ident => $leaf:ident, $visit:ident, $value:expr;)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NoShape> {
            *self.shape = Shape::holding(Kind::$leaf, 0);
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
        *self.shape = Shape::holding(Kind::Unit, 0);
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
        let Self { shape, here } = self;
        let here = here.inside()?;
        visitor.visit_newtype_struct(Nothing { shape, here })
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NoShape> {
        let mut some = self.some_members(Shape::holding(Kind::Option, 1))?;
        match some.next() {
            Some(inner) => visitor.visit_some(inner),
            None => visitor.visit_none(),
        }
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, NoShape> {
        let members = self.some_members(Shape::holding(Kind::Sequence, 1))?;
        visitor.visit_seq(SeqDeserializer::new(members))
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        len: usize,
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        let members = self.members(Shape::holding(Kind::Tuple, len))?;
        visitor.visit_seq(SeqDeserializer::new(members))
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
        let mut entry = self.some_members(Shape::holding(Kind::Map, 2))?;
        let entry = entry.next().zip(entry.next());
        visitor.visit_map(MapDeserializer::new(entry.into_iter()))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        let (name, outer) = (std::any::type_name::<V::Value>(), self.here.around);
        let (around, mut nowhere) = (Around { name, outer }, Shape::default());
        let whole = Nothing::enter(self, &around, &mut nowhere);
        let members = whole.members(Shape::named(Kind::Struct, name, fields))?;
        visitor.visit_seq(SeqDeserializer::new(members))
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, NoShape> {
        let (name, outer) = (std::any::type_name::<V::Value>(), self.here.around);
        let (around, mut nowhere) = (Around { name, outer }, Shape::default());
        let whole = Nothing::enter(self, &around, &mut nowhere);
        let here = whole.here.inside()?;
        let shapes = whole.shape.within(Shape::named(Kind::Enum, name, variants));
        // The first of which something is unknown, or the first of all.
        let missing = shapes.iter().position(|shape| !shape.is_whole());
        let number = missing.unwrap_or(0);
        match (u32::try_from(number), shapes.get_mut(number)) {
            (Ok(number), Some(shape)) => {
                let variant = Nothing { shape, here };
                visitor.visit_enum(Variant { variant, number })
            }
            _ => Err(NoShape::custom("it has no variants")),
        }
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, NoShape> {
        Err(NoShape::custom("it reads itself from anything"))
    }

    serde::forward_to_deserialize_any! { identifier ignored_any }
}
