//! A value in fields: how many a type has, and the postcard bytes of each. For code that carries replies of
//! types that it does not know, and keeps their parts apart.

use std::cell::Cell;

use serde::{
    Deserializer,
    de::{DeserializeOwned, DeserializeSeed, SeqAccess, Visitor},
};

use super::{PayloadError, data::decode};

/// How many fields `T` has: it says so when it is read, also from nothing.
pub(super) fn fields_of<T: DeserializeOwned>() -> usize {
    let count = Cell::new(1);
    let apart = Apart {
        left: &mut &[][..],
        count: &count,
        parts: &mut Vec::new(),
    };
    // It need not be anything that nothing is.
    let _ = T::deserialize(apart);
    count.get()
}

/// The bytes of each field of a `T`.
pub(super) fn split<T: DeserializeOwned>(bytes: &[u8]) -> Result<Vec<Vec<u8>>, PayloadError> {
    let count = Cell::new(fields_of::<T>());
    if count.get() < 2 {
        decode::<T>(bytes)?;
        // Also of a structure of one field, whose bytes are those of the field.
        return Ok(vec![bytes.to_vec(); count.get()]);
    }
    let (mut left, mut parts) = (bytes, Vec::new());
    let apart = Apart {
        left: &mut left,
        count: &count,
        parts: &mut parts,
    };
    T::deserialize(apart).map_err(PayloadError::of::<T>)?;
    match left {
        [] => Ok(parts),
        rest => Err(PayloadError::too_long::<T>(rest)),
    }
}

/// Reads the outermost structure or tuple, and notes how many fields it has and the bytes of each.
struct Apart<'a, 'de> {
    left: &'a mut &'de [u8],
    count: &'a Cell<usize>,
    parts: &'a mut Vec<Vec<u8>>,
}

impl<'de> SeqAccess<'de> for Apart<'_, 'de> {
    type Error = postcard::Error;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> postcard::Result<Option<T::Value>> {
        if self.parts.len() == self.count.get() {
            return Ok(None);
        }
        // A field is read as `decode` reads it, so that the code for its type exists once.
        let mut field = postcard::Deserializer::from_bytes(self.left);
        let value = seed.deserialize(&mut field)?;
        let left = field.finalize()?;
        let size = self.left.len() - left.len();
        self.parts.extend(self.left.get(..size).map(<[u8]>::to_vec));
        *self.left = left;
        Ok(Some(value))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.count.get() - self.parts.len())
    }
}

impl<'de> Deserializer<'de> for Apart<'_, 'de> {
    type Error = postcard::Error;

    fn is_human_readable(&self) -> bool {
        false
    }

    /// No structure and no tuple, which is one field: that is counted, and no bytes are read so.
    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> postcard::Result<V::Value> {
        Err(postcard::Error::WontImplement)
    }

    fn deserialize_unit<V: Visitor<'de>>(self, visitor: V) -> postcard::Result<V::Value> {
        self.count.set(0);
        visitor.visit_unit()
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> postcard::Result<V::Value> {
        self.deserialize_unit(visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> postcard::Result<V::Value> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        count: usize,
        visitor: V,
    ) -> postcard::Result<V::Value> {
        self.count.set(count);
        visitor.visit_seq(self)
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        count: usize,
        visitor: V,
    ) -> postcard::Result<V::Value> {
        self.deserialize_tuple(count, visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> postcard::Result<V::Value> {
        self.deserialize_tuple(fields.len(), visitor)
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf
        option seq map enum identifier ignored_any
    }
}

#[cfg(test)]
mod tests {
    use serde::{Deserialize, Serialize};

    use super::*;
    use crate::DataType;

    #[derive(Serialize, Deserialize)]
    struct Seen {
        name: String,
        at: [f64; 2],
        sure: Option<u32>,
    }

    #[derive(Serialize, Deserialize)]
    struct Named(Seen);

    /// One that is not read from just anything.
    #[derive(Serialize, Deserialize)]
    struct Choosy {
        number: std::num::NonZeroU8,
        host: std::net::IpAddr,
    }

    #[derive(Serialize, Deserialize)]
    struct Tree {
        name: String,
        twigs: Vec<Tree>,
    }

    #[derive(Serialize, Deserialize)]
    enum Either {
        One(u8, u8),
        None,
    }

    fn seen() -> Seen {
        Seen {
            name: "lamp".to_owned(),
            at: [1.0, 2.0],
            sure: Some(300),
        }
    }

    #[test]
    fn a_structure_and_a_tuple_have_their_fields_and_anything_else_is_one() {
        assert_eq!(fields_of::<Seen>(), 3);
        assert_eq!(fields_of::<Named>(), 3);
        assert_eq!(fields_of::<(u8, String)>(), 2);
        assert_eq!(fields_of::<[f64; 4]>(), 4);
        assert_eq!(fields_of::<Vec<(u8, u8)>>(), 1);
        assert_eq!(fields_of::<Option<(u8, u8)>>(), 1);
        assert_eq!(fields_of::<Either>(), 1);
        assert_eq!(fields_of::<u64>(), 1);
        assert_eq!(fields_of::<()>(), 0);
        assert_eq!(fields_of::<Choosy>(), 2);
        assert_eq!(fields_of::<Tree>(), 2);
    }

    #[test]
    fn each_field_is_a_value_by_itself_and_all_of_them_are_the_whole() {
        for (fields, bytes) in [
            (
                DataType::of::<Seen>(),
                postcard::to_stdvec(&seen()).unwrap(),
            ),
            (
                DataType::of::<Named>(),
                postcard::to_stdvec(&Named(seen())).unwrap(),
            ),
        ] {
            let parts = fields.split(&bytes).unwrap();
            assert_eq!(parts.concat(), bytes);
            let [name, at, sure] = parts.as_slice() else {
                panic!("{parts:?}");
            };
            assert_eq!(postcard::from_bytes::<String>(name).unwrap(), "lamp");
            assert_eq!(postcard::from_bytes::<[f64; 2]>(at).unwrap(), [1.0, 2.0]);
            assert_eq!(
                postcard::from_bytes::<Option<u32>>(sure).unwrap(),
                Some(300)
            );
        }
        let one = postcard::to_stdvec(&Either::One(1, 2)).unwrap();
        assert_eq!(split::<Either>(&one), Ok(vec![one]));
    }

    #[test]
    fn what_is_no_such_value_is_refused() {
        let bytes = postcard::to_stdvec(&seen()).unwrap();
        for bytes in [&bytes[..bytes.len() - 1], &[&bytes[..], &[0]].concat(), &[]] {
            assert!(split::<Seen>(bytes).is_err());
        }
        let _ = Either::None;
    }
}
