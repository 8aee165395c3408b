//! A value in fields: how many a type has, and the postcard bytes of each. For whoever carries replies of types
//! that it does not know, and keeps their parts apart.

use std::fmt;

use serde::{
    Serialize, Serializer,
    de::DeserializeOwned,
    ser::{Impossible, SerializeStruct, SerializeTuple, SerializeTupleStruct},
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

fn split<T: Serialize + DeserializeOwned>(bytes: &[u8]) -> Result<Vec<Vec<u8>>, PayloadError> {
    let value = decode::<T>(bytes)?;
    match fields_of::<T>() {
        0 => Ok(Vec::new()),
        // Also of a structure of one field, whose bytes are those of the field.
        1 => Ok(vec![bytes.to_vec()]),
        _ => value
            .serialize(Apart(Vec::new()))
            .map_err(PayloadError::of::<T>),
    }
}

/// Writes each field of a structure or a tuple by itself.
struct Apart(Vec<Vec<u8>>);

type Parts = postcard::Result<Vec<Vec<u8>>>;

/// A value that is no structure and no tuple: [`count`] says so, and nobody comes here with one.
const fn whole<T>() -> postcard::Result<T> {
    Err(postcard::Error::WontImplement)
}

macro_rules! whole {
    ($($name:ident($($type:ty),*);)+) => {$(
        fn $name(self, $(_: $type),*) -> Parts {
            whole()
        }
    )+};
}

type Never = Impossible<Vec<Vec<u8>>, postcard::Error>;

impl Serializer for Apart {
    type Ok = Vec<Vec<u8>>;
    type Error = postcard::Error;
    type SerializeSeq = Never;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = Never;
    type SerializeMap = Never;
    type SerializeStruct = Self;
    type SerializeStructVariant = Never;

    whole! {
        serialize_bool(bool);
        serialize_i8(i8);
        serialize_i16(i16);
        serialize_i32(i32);
        serialize_i64(i64);
        serialize_u8(u8);
        serialize_u16(u16);
        serialize_u32(u32);
        serialize_u64(u64);
        serialize_f32(f32);
        serialize_f64(f64);
        serialize_char(char);
        serialize_str(&str);
        serialize_bytes(&[u8]);
        serialize_none();
        serialize_unit();
        serialize_unit_struct(&'static str);
        serialize_unit_variant(&'static str, u32, &'static str);
    }

    fn serialize_some<T: Serialize + ?Sized>(self, _: &T) -> Parts {
        whole()
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(self, _: &'static str, value: &T) -> Parts {
        value.serialize(self)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: &T,
    ) -> Parts {
        whole()
    }

    fn serialize_seq(self, _: Option<usize>) -> postcard::Result<Never> {
        whole()
    }

    fn serialize_tuple(self, _: usize) -> postcard::Result<Self> {
        Ok(self)
    }

    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> postcard::Result<Self> {
        Ok(self)
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> postcard::Result<Never> {
        whole()
    }

    fn serialize_map(self, _: Option<usize>) -> postcard::Result<Never> {
        whole()
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> postcard::Result<Self> {
        Ok(self)
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> postcard::Result<Never> {
        whole()
    }

    fn is_human_readable(&self) -> bool {
        false
    }
}

macro_rules! parts {
    ($($trait:ident::$method:ident($($name:ty)?);)+) => {$(
        impl $trait for Apart {
            type Ok = Vec<Vec<u8>>;
            type Error = postcard::Error;

            fn $method<T: Serialize + ?Sized>(
                &mut self,
                $(_: $name,)?
                value: &T,
            ) -> postcard::Result<()> {
                self.0.push(postcard::to_stdvec(value)?);
                Ok(())
            }

            fn end(self) -> Parts {
                Ok(self.0)
            }
        }
    )+};
}

parts! {
    SerializeTuple::serialize_element();
    SerializeTupleStruct::serialize_field();
    SerializeStruct::serialize_field(&'static str);
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
