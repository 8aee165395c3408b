//! What the data of a command looks like, as it stands in a file. With it, a program that does not know
//! the type reads postcard bytes as JSON. How it is found, `trace.rs` says.

pub(super) mod kept;

use std::panic::AssertUnwindSafe;

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::trace::shape_of;

/// How deep values may lie in one another.
const DEPTH: usize = 64;
/// The longest JSON that is made, bytes.
const LIMIT: usize = 256 * 1024;

/// What kind of type it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Kind {
    /// Not found yet.
    #[default]
    Unknown,
    /// Nothing at all.
    Unit,
    /// A variant that is a name and no more.
    Nothing,
    /// Yes or no.
    Bool,
    /// A whole number of 8 bits.
    I8,
    /// Of 16 bits.
    I16,
    /// Of 32 bits.
    I32,
    /// Of 64 bits.
    I64,
    /// Of 128 bits.
    I128,
    /// A whole number of 8 bits, not negative.
    U8,
    /// Of 16 bits.
    U16,
    /// Of 32 bits.
    U32,
    /// Of 64 bits.
    U64,
    /// Of 128 bits.
    U128,
    /// A float of 32 bits.
    F32,
    /// A float of 64 bits.
    F64,
    /// A character.
    Char,
    /// Text.
    Text,
    /// Opaque bytes.
    Bytes,
    /// Such a value, or none.
    Option,
    /// Any number of such values.
    Sequence,
    /// From keys to values.
    Map,
    /// One value of each.
    Tuple,
    /// One value of each, with the fields' names.
    Struct,
    /// One of these, with the variants' names.
    Enum,
    /// The type of this name, within which it stands.
    Around,
}

/// The shape of a type.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Shape {
    /// What kind of type it is.
    pub kind: Kind,
    /// The type's name, where it may stand in itself.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// The names of its fields or variants.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub names: Vec<String>,
    /// What is in it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inner: Vec<Self>,
    /// What a number counts, if that was declared: `px`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
}

/// Appends bytes to JSON as one value.
type WriteBytes<'w> = &'w mut (dyn FnMut(&[u8], &mut Vec<u8>) + 'w);

impl Shape {
    /// The shape of `T`. `None` where it cannot be found: a type that takes not every number or text may
    /// not read itself from nothing.
    pub fn of<T: DeserializeOwned>() -> Option<Self> {
        // Types of others are asked here; theirs to fail, not the record's.
        std::panic::catch_unwind(AssertUnwindSafe(shape_of::<T>))
            .ok()
            .flatten()
    }

    /// One that holds `count` others, of which nothing is known.
    #[must_use]
    pub fn holding(kind: Kind, count: usize) -> Self {
        Self {
            kind,
            inner: vec![Self::default(); count],
            ..Self::default()
        }
    }

    /// One with a name, and with names for what it holds.
    #[must_use]
    pub fn named(kind: Kind, name: &str, names: &[&str]) -> Self {
        Self {
            name: name.to_owned(),
            names: names.iter().map(|&name| name.to_owned()).collect(),
            ..Self::holding(kind, names.len())
        }
    }

    /// Whether nothing is unknown.
    pub(super) fn is_whole(&self) -> bool {
        self.kind != Kind::Unknown && self.inner.iter().all(Self::is_whole)
    }

    /// What is in this, which becomes `new` unless it is of that kind.
    pub(super) fn within(&mut self, new: Self) -> &mut [Self] {
        if self.kind != new.kind {
            *self = new;
        }
        &mut self.inner
    }

    /// Appends `bytes` as JSON to `json`, which is left as it was when they are no such value.
    pub fn convert(&self, bytes: &[u8], json: &mut Vec<u8>) -> Option<()> {
        self.write(bytes, json, LIMIT, None)
    }

    /// The same for a program of another language: `opaque` appends bytes as one value, which are numbers otherwise, and
    /// the JSON may be `limit` bytes long.
    pub fn tell(
        &self,
        bytes: &[u8],
        json: &mut Vec<u8>,
        limit: usize,
        opaque: WriteBytes<'_>,
    ) -> Option<()> {
        self.write(bytes, json, limit, Some(opaque))
    }

    /// How many bytes of `bytes` are such a value.
    fn measure(&self, bytes: &[u8]) -> Option<usize> {
        let json = &mut Vec::new();
        let mut reader = Reader {
            bytes,
            json,
            limit: usize::MAX,
            opaque: Some(&mut |_, _| ()),
            depth: 0,
        };
        reader.value(self, None)?;
        Some(bytes.len() - reader.bytes.len())
    }

    /// How many fields it has, as [`DataType::fields`](super::DataType::fields) counts them.
    pub(super) fn fields(&self) -> usize {
        match self.kind {
            Kind::Unit | Kind::Nothing => 0,
            Kind::Struct | Kind::Tuple => self.inner.len(),
            _ => 1,
        }
    }

    /// The bytes of each field. `None` when they are no such value.
    pub(super) fn split(&self, bytes: &[u8]) -> Option<Vec<Vec<u8>>> {
        let own = std::slice::from_ref(self);
        let fields = match self.kind {
            Kind::Unit | Kind::Nothing => &[],
            Kind::Struct | Kind::Tuple => &self.inner[..],
            _ => own,
        };
        let (mut left, mut parts) = (bytes, Vec::new());
        for field in fields {
            let (part, rest) = left.split_at_checked(field.measure(left)?)?;
            parts.push(part.to_vec());
            left = rest;
        }
        left.is_empty().then_some(parts)
    }

    fn write(
        &self,
        bytes: &[u8],
        json: &mut Vec<u8>,
        limit: usize,
        opaque: Option<WriteBytes<'_>>,
    ) -> Option<()> {
        let start = json.len();
        let mut reader = Reader {
            bytes,
            json,
            limit: start.saturating_add(limit),
            opaque,
            depth: 0,
        };
        let read = reader.value(self, None);
        let whole = read.filter(|()| reader.bytes.is_empty());
        if whole.is_none() {
            json.truncate(start);
        }
        whole
    }
}

struct Reader<'a, 'w> {
    bytes: &'a [u8],
    json: &'a mut Vec<u8>,
    limit: usize,
    opaque: Option<WriteBytes<'w>>,
    depth: usize,
}

/// A type with a name around what is read, and those around it.
struct Around<'a> {
    shape: &'a Shape,
    outer: Option<&'a Around<'a>>,
}

impl<'a> Reader<'a, '_> {
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

    fn bytes(&mut self) -> Option<()> {
        let bytes: &[u8] = self.take()?;
        match &mut self.opaque {
            None => self.put(&bytes),
            Some(write) => {
                write(bytes, self.json);
                Some(())
            }
        }
    }

    fn byte(&mut self, byte: u8) {
        self.json.push(byte);
    }

    /// Reads a value. After `None`, nothing more is read.
    fn value(&mut self, shape: &Shape, around: Option<&Around<'_>>) -> Option<()> {
        if self.depth > DEPTH || self.json.len() > self.limit {
            return None;
        }
        self.depth += 1;
        let within = Some(&Around {
            shape,
            outer: around,
        });
        match shape.kind {
            Kind::Unknown => None,
            Kind::Unit | Kind::Nothing => self.put(&()),
            Kind::Bool => self.copy::<bool>(),
            Kind::I8 => self.copy::<i8>(),
            Kind::I16 => self.copy::<i16>(),
            Kind::I32 => self.copy::<i32>(),
            Kind::I64 => self.copy::<i64>(),
            Kind::I128 => self.copy::<i128>(),
            Kind::U8 => self.copy::<u8>(),
            Kind::U16 => self.copy::<u16>(),
            Kind::U32 => self.copy::<u32>(),
            Kind::U64 => self.copy::<u64>(),
            Kind::U128 => self.copy::<u128>(),
            Kind::F32 => self.copy::<f32>(),
            Kind::F64 => self.copy::<f64>(),
            Kind::Char => self.copy::<char>(),
            Kind::Text => self.copy::<&str>(),
            Kind::Bytes => self.bytes(),
            Kind::Option => match self.take::<u8>()? {
                0 => self.put(&()),
                1 => self.value(shape.inner.first()?, around),
                _ => None,
            },
            Kind::Sequence => {
                let each = shape.inner.first()?;
                if each.kind == Kind::U8 && self.opaque.is_some() {
                    // A vector of bytes is as long as bytes are.
                    return self.bytes().map(|()| self.depth -= 1);
                }
                let count = self.take::<usize>()?;
                self.many(std::iter::repeat_n((None, each), count), b"[]", around)
            }
            Kind::Map => self.map(shape, around),
            Kind::Tuple => self.many(shape.inner.iter().map(|each| (None, each)), b"[]", around),
            Kind::Struct => {
                let members = shape.names.iter().map(Some).zip(&shape.inner);
                self.many(members, b"{}", within)
            }
            Kind::Enum => {
                let number = usize::try_from(self.take::<u32>()?).ok()?;
                let (name, variant) = (shape.names.get(number)?, shape.inner.get(number)?);
                if variant.kind == Kind::Nothing {
                    self.put(name)
                } else {
                    self.many(std::iter::once((Some(name), variant)), b"{}", within)
                }
            }
            Kind::Around => {
                let mut outer = std::iter::successors(around, |around| around.outer);
                let again = outer.find(|around| around.shape.name == shape.name)?;
                self.value(again.shape, again.outer)
            }
        }?;
        self.depth -= 1;
        Some(())
    }

    /// Values in brackets, each behind its name if it has one.
    fn many<'s>(
        &mut self,
        values: impl Iterator<Item = (Option<&'s String>, &'s Shape)>,
        [open, close]: &[u8; 2],
        around: Option<&Around<'_>>,
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
            self.value(shape, around)?;
        }
        self.byte(*close);
        Some(())
    }

    fn map(&mut self, shape: &Shape, around: Option<&Around<'_>>) -> Option<()> {
        let [key, value] = shape.inner.as_slice() else {
            return None;
        };
        let count = self.take::<usize>()?;
        self.byte(b'{');
        for index in 0..count {
            if index > 0 {
                self.byte(b',');
            }
            let start = self.json.len();
            self.value(key, around)?;
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
            self.value(value, around)?;
        }
        self.byte(b'}');
        Some(())
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
        let mut bottomless = Shape::named(Kind::Struct, "A", &["a"]);
        bottomless.inner = vec![Shape::named(Kind::Around, "A", &[])];
        assert_eq!(bottomless.convert(&[], &mut json), None);
        let mut endless = Shape::holding(Kind::Sequence, 1);
        endless.inner = vec![Shape::holding(Kind::Unit, 0)];
        let count = postcard::to_stdvec(&u64::MAX).unwrap();
        assert_eq!(endless.convert(&count, &mut json), None);
        assert!(json.is_empty());
    }
}
