//! What the data of a command looks like, as it stands in a file: with it, whoever does not know the type
//! reads postcard bytes as JSON.
//! How it is found, `trace.rs` says.

use std::{mem::discriminant, panic::AssertUnwindSafe};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::trace::{outermost, shape_of};

/// How deep values may lie in one another.
const DEPTH: usize = 64;
/// The longest JSON that is made, bytes.
const LIMIT: usize = 256 * 1024;

/// A value that holds no others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Leaf {
    Unit,
    /// A variant that is a name and no more.
    Nothing,
    Bool,
    I8,
    I16,
    I32,
    I64,
    I128,
    U8,
    U16,
    U32,
    U64,
    U128,
    F32,
    F64,
    Char,
    Text,
    Bytes,
}

/// The shape of a type.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Shape {
    /// Not found yet.
    Unknown,
    /// A number, a text and the like.
    Leaf(Leaf),
    /// Such a value, or none.
    Option(Box<Shape>),
    /// Any number of such values.
    Sequence(Box<Shape>),
    /// From keys to values.
    Map(Box<[Shape; 2]>),
    /// One value of each.
    Tuple(Vec<Shape>),
    /// The type's name, the fields' names, and these.
    Struct(String, Vec<String>, Vec<Shape>),
    /// The type's name, the variants' names, and these.
    Enum(String, Vec<String>, Vec<Shape>),
    /// The type of this name, within which it stands.
    Around(String),
}

impl Shape {
    /// The shape of `T`. `None` where it cannot be found: a type that takes not every number or text may
    /// not read itself from nothing.
    pub fn of<T: DeserializeOwned>() -> Option<Self> {
        // Types of others are asked here; theirs to fail, not the record's.
        std::panic::catch_unwind(AssertUnwindSafe(shape_of::<T>))
            .ok()
            .flatten()
    }

    /// Whether nothing is unknown.
    pub(super) fn is_whole(&self) -> bool {
        match self {
            Self::Unknown => false,
            Self::Leaf(_) | Self::Around(_) => true,
            Self::Option(inner) | Self::Sequence(inner) => inner.is_whole(),
            Self::Map(inner) => inner.iter().all(Self::is_whole),
            Self::Tuple(inner) | Self::Struct(.., inner) | Self::Enum(.., inner) => {
                inner.iter().all(Self::is_whole)
            }
        }
    }

    /// What is in this, which becomes `new` unless it is of that kind.
    pub(super) fn within(&mut self, new: Self) -> &mut [Self] {
        if discriminant(self) != discriminant(&new) {
            *self = new;
        }
        match self {
            Self::Option(inner) | Self::Sequence(inner) => std::slice::from_mut(inner),
            Self::Map(inner) => &mut inner[..],
            Self::Tuple(inner) | Self::Struct(.., inner) | Self::Enum(.., inner) => inner,
            Self::Unknown | Self::Leaf(_) | Self::Around(_) => &mut [],
        }
    }

    /// Fields or variants of which nothing is known, with their names.
    pub(super) fn unknown(names: &[&str]) -> (Vec<String>, Vec<Self>) {
        let unknown = vec![Self::Unknown; names.len()];
        (names.iter().map(|&name| name.to_owned()).collect(), unknown)
    }

    /// Appends `bytes` as JSON to `json`, which is left as it was when they are no such value.
    pub fn convert(&self, bytes: &[u8], json: &mut Vec<u8>) -> Option<()> {
        let start = json.len();
        let mut reader = Reader {
            bytes,
            json,
            limit: start + LIMIT,
            around: Vec::new(),
        };
        let read = reader.value(self, 0);
        let whole = read.filter(|()| reader.bytes.is_empty());
        if whole.is_none() {
            json.truncate(start);
        }
        whole
    }
}

/// How many fields `T` has: a structure or a tuple those that it declares, a unit none, anything else is one.
pub(super) fn fields_of<T: DeserializeOwned>() -> usize {
    let shape = std::panic::catch_unwind(AssertUnwindSafe(outermost::<T>));
    match shape {
        Ok(Shape::Struct(.., fields) | Shape::Tuple(fields)) => fields.len(),
        Ok(Shape::Leaf(Leaf::Unit)) => 0,
        Ok(_) | Err(_) => 1,
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    json: &'a mut Vec<u8>,
    limit: usize,
    /// The types with names around what is read.
    around: Vec<&'a Shape>,
}

impl<'a> Reader<'a> {
    fn take<T: Deserialize<'a>>(&mut self) -> Option<T> {
        let (value, rest) = postcard::take_from_bytes(self.bytes).ok()?;
        self.bytes = rest;
        Some(value)
    }

    fn put(&mut self, value: &impl Serialize) -> Option<()> {
        serde_json::to_writer(&mut *self.json, value).ok()
    }

    fn copy<T: Deserialize<'a> + Serialize>(&mut self) -> Option<()> {
        let value: T = self.take()?;
        self.put(&value)
    }

    fn byte(&mut self, byte: u8) {
        self.json.push(byte);
    }

    fn value(&mut self, shape: &'a Shape, depth: usize) -> Option<()> {
        if depth > DEPTH || self.json.len() > self.limit {
            return None;
        }
        let depth = depth + 1;
        match shape {
            Shape::Unknown => None,
            Shape::Leaf(leaf) => self.leaf(*leaf),
            Shape::Option(some) => match self.take::<u8>()? {
                0 => self.put(&()),
                1 => self.value(some, depth),
                _ => None,
            },
            Shape::Sequence(each) => {
                let count = self.take::<usize>()?;
                self.many(std::iter::repeat_n((None, &**each), count), b"[]", depth)
            }
            Shape::Map(entry) => self.map(entry, depth),
            Shape::Tuple(inner) => self.many(inner.iter().map(|shape| (None, shape)), b"[]", depth),
            Shape::Struct(_, names, inner) => {
                self.around.push(shape);
                let members = names.iter().map(Some).zip(inner);
                let read = self.many(members, b"{}", depth);
                self.around.pop();
                read
            }
            Shape::Enum(_, names, inner) => {
                self.around.push(shape);
                let read = self.variant(names, inner, depth);
                self.around.pop();
                read
            }
            Shape::Around(name) => self.again(name, depth),
        }
    }

    fn leaf(&mut self, leaf: Leaf) -> Option<()> {
        match leaf {
            Leaf::Unit | Leaf::Nothing => self.put(&()),
            Leaf::Bool => self.copy::<bool>(),
            Leaf::I8 => self.copy::<i8>(),
            Leaf::I16 => self.copy::<i16>(),
            Leaf::I32 => self.copy::<i32>(),
            Leaf::I64 => self.copy::<i64>(),
            Leaf::I128 => self.copy::<i128>(),
            Leaf::U8 => self.copy::<u8>(),
            Leaf::U16 => self.copy::<u16>(),
            Leaf::U32 => self.copy::<u32>(),
            Leaf::U64 => self.copy::<u64>(),
            Leaf::U128 => self.copy::<u128>(),
            Leaf::F32 => self.copy::<f32>(),
            Leaf::F64 => self.copy::<f64>(),
            Leaf::Char => self.copy::<char>(),
            Leaf::Text => self.copy::<&str>(),
            Leaf::Bytes => self.copy::<&[u8]>(),
        }
    }

    /// Reads a type within itself.
    fn again(&mut self, name: &str, depth: usize) -> Option<()> {
        let place = self.around.iter().rposition(|around| {
            matches!(around, Shape::Struct(known, ..) | Shape::Enum(known, ..) if known == name)
        })?;
        let shape = *self.around.get(place)?;
        // What stands around it there stands around it here.
        let inner = self.around.split_off(place);
        let read = self.value(shape, depth);
        self.around.extend(inner);
        read
    }

    /// Values in brackets, each behind its name if it has one.
    fn many(
        &mut self,
        values: impl Iterator<Item = (Option<&'a String>, &'a Shape)>,
        [open, close]: &[u8; 2],
        depth: usize,
    ) -> Option<()> {
        self.byte(*open);
        for (index, (name, shape)) in values.enumerate() {
            if index > 0 {
                self.byte(b',');
            }
            if let Some(name) = name {
                self.put(name)?;
                self.byte(b':');
            }
            self.value(shape, depth)?;
        }
        self.byte(*close);
        Some(())
    }

    fn map(&mut self, [key, value]: &'a [Shape; 2], depth: usize) -> Option<()> {
        let count = self.take::<usize>()?;
        self.byte(b'{');
        for index in 0..count {
            if index > 0 {
                self.byte(b',');
            }
            let start = self.json.len();
            self.value(key, depth)?;
            // The keys of an object are texts; numbers become some.
            match self.json.get(start) {
                Some(b'"') => {}
                Some(b'{' | b'[') | None => return None,
                Some(_) => {
                    self.json.insert(start, b'"');
                    self.byte(b'"');
                }
            }
            self.byte(b':');
            self.value(value, depth)?;
        }
        self.byte(b'}');
        Some(())
    }

    fn variant(&mut self, names: &'a [String], inner: &'a [Shape], depth: usize) -> Option<()> {
        let number = usize::try_from(self.take::<u32>()?).ok()?;
        let (name, shape) = (names.get(number)?, inner.get(number)?);
        if *shape == Shape::Leaf(Leaf::Nothing) {
            return self.put(name);
        }
        self.many(std::iter::once((Some(name), shape)), b"{}", depth)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    #[derive(Debug, Clone, Serialize, Deserialize)]
    enum Way {
        Stop,
        Go(f64),
        Both(i32, String),
        Turn { by: f32, left: bool },
    }

    #[derive(Debug, Clone, Serialize, Deserialize)]
    struct Unit;

    #[derive(Debug, Clone, Serialize, Deserialize)]
    struct Wrapped(u16);

    #[derive(Debug, Clone, Serialize, Deserialize)]
    struct Whole {
        ways: Vec<Way>,
        #[serde(rename = "called")]
        name: Option<String>,
        by_number: BTreeMap<i64, char>,
        by_name: BTreeMap<String, (Unit, Wrapped)>,
        matrix: [[f64; 3]; 2],
        large: u128,
        bytes: Vec<u8>,
        next: Option<Box<Whole>>,
    }

    fn way() -> impl Strategy<Value = Way> {
        prop_oneof![
            Just(Way::Stop),
            any::<f64>().prop_map(Way::Go),
            (any::<i32>(), ".{0,5}").prop_map(|(number, text)| Way::Both(number, text)),
            (any::<f32>(), any::<bool>()).prop_map(|(by, left)| Way::Turn { by, left }),
        ]
    }

    fn leaf() -> impl Strategy<Value = Whole> {
        let leaf = (
            proptest::collection::vec(way(), 0..5),
            any::<Option<String>>(),
            proptest::collection::btree_map(any::<i64>(), any::<char>(), 0..3),
            proptest::collection::btree_map(".{0,3}", any::<u16>(), 0..3),
            any::<[[f64; 3]; 2]>(),
            any::<u128>(),
            proptest::collection::vec(any::<u8>(), 0..9),
        );
        leaf.prop_map(
            |(ways, name, by_number, by_name, matrix, large, bytes)| Whole {
                ways,
                name,
                by_number,
                by_name: by_name
                    .into_iter()
                    .map(|(name, number)| (name, (Unit, Wrapped(number))))
                    .collect(),
                matrix,
                large,
                bytes,
                next: None,
            },
        )
    }

    fn whole() -> impl Strategy<Value = Whole> {
        (leaf(), proptest::option::of(leaf())).prop_map(|(mut whole, next)| {
            whole.next = next.map(Box::new);
            whole
        })
    }

    proptest! {
        #[test]
        fn bytes_become_the_json_that_the_type_makes_of_itself(whole in whole()) {
            let shape = Shape::of::<Whole>().unwrap();
            let text = serde_json::to_string(&shape).unwrap();
            let shape: Shape = serde_json::from_str(&text).unwrap();
            let bytes = postcard::to_stdvec(&whole).unwrap();
            let mut json = Vec::new();
            shape.convert(&bytes, &mut json).unwrap();
            prop_assert_eq!(String::from_utf8(json).unwrap(), serde_json::to_string(&whole).unwrap());
        }

        #[test]
        fn other_bytes_leave_the_json_as_it_was(bytes in proptest::collection::vec(any::<u8>(), 0..60)) {
            let shape = Shape::of::<Whole>().unwrap();
            let mut json = b"before".to_vec();
            match shape.convert(&bytes, &mut json) {
                Some(()) => prop_assert!(postcard::from_bytes::<Whole>(&bytes).is_ok()),
                None => prop_assert_eq!(json, b"before"),
            }
        }
    }

    #[derive(Debug, Serialize, Deserialize)]
    enum Tree {
        Leaf,
        Node(Vec<Tree>),
        Two {
            left: Box<Tree>,
            right: Option<Box<Tree>>,
        },
    }

    #[test]
    fn a_type_within_itself_has_a_shape() {
        let tree = Tree::Node(vec![
            Tree::Leaf,
            Tree::Two {
                left: Box::new(Tree::Node(vec![Tree::Leaf])),
                right: None,
            },
        ]);
        let mut json = Vec::new();
        let bytes = postcard::to_stdvec(&tree).unwrap();
        Shape::of::<Tree>()
            .unwrap()
            .convert(&bytes, &mut json)
            .unwrap();
        assert_eq!(
            String::from_utf8(json).unwrap(),
            serde_json::to_string(&tree).unwrap()
        );
    }

    #[test]
    fn a_type_that_cannot_be_read_from_nothing_has_none() {
        #[derive(Deserialize)]
        struct Endless(#[allow(dead_code)] Box<Endless>);
        assert_eq!(Shape::of::<serde_json::Value>(), None);
        assert_eq!(Shape::of::<Endless>(), None);
    }

    #[test]
    fn a_shape_without_bottom_or_measure_is_refused() {
        let mut json = Vec::new();
        let itself = Shape::Around("A".to_owned());
        let bottomless = Shape::Struct("A".to_owned(), vec!["a".to_owned()], vec![itself]);
        assert_eq!(bottomless.convert(&[], &mut json), None);
        let endless = Shape::Sequence(Box::new(Shape::Leaf(Leaf::Unit)));
        let count = postcard::to_stdvec(&u64::MAX).unwrap();
        assert_eq!(endless.convert(&count, &mut json), None);
        assert!(json.is_empty());
    }
}
