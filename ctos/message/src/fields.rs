//! A value in fields: how many a type has, and the postcard bytes of each. For whoever carries replies of types
//! that it does not know, and keeps their parts apart.

use std::{cell::Cell, fmt};

use postcard::de_flavors::Flavor;
use serde::{
    Deserializer, Serialize,
    de::{DeserializeOwned, DeserializeSeed, SeqAccess, Visitor},
};

use super::{PayloadError, data::decode, shape::fields_of};

type Split = fn(&[u8]) -> Result<Vec<Vec<u8>>, PayloadError>;

/// Takes postcard bytes of one type apart into its fields. A structure or a tuple has those that it
/// declares, a unit has none, and a value of any other type is one field.
#[derive(Clone, Copy)]
pub struct Fields {
    count: fn() -> usize,
    split: Split,
}

impl Fields {
    /// For values of type `T`.
    #[must_use]
    pub const fn of<T: Serialize + DeserializeOwned + 'static>() -> Self {
        Self {
            count: fields_of::<T>,
            split: split::<T>,
        }
    }

    /// How many fields the type has.
    #[must_use]
    pub fn count(self) -> usize {
        (self.count)()
    }

    /// The postcard bytes of each field, in order.
    ///
    /// # Errors
    /// What is wrong with the bytes.
    pub fn split(self, bytes: &[u8]) -> Result<Vec<Vec<u8>>, PayloadError> {
        (self.split)(bytes)
    }
}

/// Which fields a command's reply has follows from its code and name.
impl PartialEq for Fields {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Fields {}

impl fmt::Debug for Fields {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Fields")
    }
}

fn split<T: DeserializeOwned>(bytes: &[u8]) -> Result<Vec<Vec<u8>>, PayloadError> {
    let count = fields_of::<T>();
    if count < 2 {
        decode::<T>(bytes)?;
        // Also of a structure of one field, whose bytes are those of the field.
        return Ok(vec![bytes.to_vec(); count]);
    }
    let left = Cell::new(bytes);
    let mut parts = Vec::new();
    let apart = Apart {
        from: &mut postcard::Deserializer::from_flavor(Left(&left)),
        left: &left,
        parts: &mut parts,
        count: 0,
    };
    T::deserialize(apart).map_err(PayloadError::of::<T>)?;
    match left.get() {
        [] => Ok(parts),
        rest => Err(PayloadError::too_long::<T>(rest)),
    }
}

/// Bytes that are read, and can be seen meanwhile.
struct Left<'de>(&'de Cell<&'de [u8]>);

impl<'de> Flavor<'de> for Left<'de> {
    type Remainder = ();
    type Source = ();

    fn pop(&mut self) -> postcard::Result<u8> {
        let [byte] = *self.try_take_n(1)? else {
            return Err(postcard::Error::DeserializeUnexpectedEnd);
        };
        Ok(byte)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.0.get().len())
    }

    fn try_take_n(&mut self, count: usize) -> postcard::Result<&'de [u8]> {
        let split = self.0.get().split_at_checked(count);
        let (taken, left) = split.ok_or(postcard::Error::DeserializeUnexpectedEnd)?;
        self.0.set(left);
        Ok(taken)
    }

    fn finalize(self) -> postcard::Result<()> {
        Ok(())
    }
}

/// Reads the outermost structure or tuple, and notes the bytes of each of its fields.
struct Apart<'a, 'de> {
    from: &'a mut postcard::Deserializer<'de, Left<'de>>,
    left: &'de Cell<&'de [u8]>,
    parts: &'a mut Vec<Vec<u8>>,
    /// How many fields are still to come.
    count: usize,
}

impl<'de> SeqAccess<'de> for Apart<'_, 'de> {
    type Error = postcard::Error;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> postcard::Result<Option<T::Value>> {
        let Some(count) = self.count.checked_sub(1) else {
            return Ok(None);
        };
        self.count = count;
        let before = self.left.get();
        let value = seed.deserialize(&mut *self.from)?;
        let size = before.len() - self.left.get().len();
        self.parts.extend(before.get(..size).map(<[u8]>::to_vec));
        Ok(Some(value))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.count)
    }
}

impl<'de> Deserializer<'de> for Apart<'_, 'de> {
    type Error = postcard::Error;

    fn is_human_readable(&self) -> bool {
        false
    }

    /// No structure and no tuple: [`fields_of`] says so, and nobody comes here with one.
    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> postcard::Result<V::Value> {
        Err(postcard::Error::WontImplement)
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
        visitor.visit_seq(Self { count, ..self })
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
        option unit unit_struct seq map enum identifier ignored_any
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

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
        assert_eq!(Fields::of::<Seen>().count(), 3);
        assert_eq!(Fields::of::<Named>().count(), 3);
        assert_eq!(Fields::of::<(u8, String)>().count(), 2);
        assert_eq!(Fields::of::<[f64; 4]>().count(), 4);
        assert_eq!(Fields::of::<Vec<(u8, u8)>>().count(), 1);
        assert_eq!(Fields::of::<Option<(u8, u8)>>().count(), 1);
        assert_eq!(Fields::of::<Either>().count(), 1);
        assert_eq!(Fields::of::<u64>().count(), 1);
        assert_eq!(Fields::of::<()>().count(), 0);
        assert_eq!(Fields::of::<Choosy>().count(), 2);
        assert_eq!(Fields::of::<Tree>().count(), 2);
    }

    #[test]
    fn each_field_is_a_value_by_itself_and_all_of_them_are_the_whole() {
        for (fields, bytes) in [
            (Fields::of::<Seen>(), postcard::to_stdvec(&seen()).unwrap()),
            (
                Fields::of::<Named>(),
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
        assert_eq!(Fields::of::<Either>().split(&one), Ok(vec![one]));
    }

    #[test]
    fn what_is_no_such_value_is_refused() {
        let bytes = postcard::to_stdvec(&seen()).unwrap();
        for bytes in [&bytes[..bytes.len() - 1], &[&bytes[..], &[0]].concat(), &[]] {
            assert!(Fields::of::<Seen>().split(bytes).is_err());
        }
        let _ = Either::None;
    }
}
