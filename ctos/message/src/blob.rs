//! Bytes that go from process to process without being copied on the way through the runtime: images,
//! scans, recordings.
//!
//! To everybody else a [`Blob`] looks like a `Vec<u8>`: the same bytes on the wire, the same JSON. But a
//! vector goes through its serializer number by number, and a blob as a whole. A message for a link does
//! not even copy a large blob: the blob is written to the link from where it is. The receiver's blob is
//! the memory in which the frame was put together as it came.
//!
//! How: a serializer sees a slice and cannot keep it. So a blob that is being serialized is lent, for
//! this thread and this moment, to the collector of the bytes. What a message is read from is lent to
//! the blobs in it. Nothing of that is left behind when the message is written or read.

use std::{cell::RefCell, fmt, ops::Deref};

use bytes::Bytes;
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{SeqAccess, Visitor},
};

/// Smaller ones are copied, bytes: that costs less than to keep account of them.
pub const LEAST: usize = 16 * 1024;

/// Bytes that are shared, not copied: clones are the same memory, and so is what arrives in another
/// process of what the link brought there.
///
/// ```
/// use ctos::Blob;
///
/// ctos::command! {
///     /// Takes a picture.
///     pub struct Grab { pub camera: u8 } => Blob, 0x0001, "grab"
/// }
/// let picture = Blob::from(vec![0_u8; 500 * 500]);
/// assert_eq!(picture.len(), 250_000);
/// ```
#[derive(Clone, Default, PartialEq, Eq, derive_more::Debug)]
#[debug("Blob({} bytes)", self.0.len())]
pub struct Blob(Bytes);

thread_local! {
    /// The blob that is being serialized at this moment, for the collector.
    static LENT: RefCell<Option<Bytes>> = const { RefCell::new(None) };
    /// What was collected so far, with where in the other bytes it belongs; `None` when nobody does.
    static COLLECTED: RefCell<Option<Vec<(usize, Bytes)>>> = const { RefCell::new(None) };
    /// What is being read at this moment.
    static READ: RefCell<Option<Bytes>> = const { RefCell::new(None) };
}

impl Blob {
    /// The bytes, as shared as the blob is.
    #[must_use]
    pub fn into_inner(self) -> Bytes {
        self.0
    }
}

impl Deref for Blob {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}

impl AsRef<[u8]> for Blob {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl From<Vec<u8>> for Blob {
    fn from(bytes: Vec<u8>) -> Self {
        Self(bytes.into())
    }
}

impl FromIterator<u8> for Blob {
    fn from_iter<I: IntoIterator<Item = u8>>(bytes: I) -> Self {
        bytes.into_iter().collect::<Vec<u8>>().into()
    }
}

impl From<Bytes> for Blob {
    fn from(bytes: Bytes) -> Self {
        Self(bytes)
    }
}

impl From<Blob> for Vec<u8> {
    /// Without a copy where the blob is the only owner of all its memory.
    fn from(blob: Blob) -> Self {
        blob.0.into()
    }
}

impl Serialize for Blob {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let collects = COLLECTED.with_borrow(Option::is_some);
        if self.0.len() < LEAST || !collects {
            return serializer.serialize_bytes(&self.0);
        }
        LENT.set(Some(self.0.clone()));
        let serialized = serializer.serialize_bytes(&self.0);
        LENT.set(None);
        serialized
    }
}

impl<'de> Deserialize<'de> for Blob {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct BlobVisitor;
        impl<'de> Visitor<'de> for BlobVisitor {
            type Value = Blob;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("bytes")
            }

            fn visit_borrowed_bytes<E>(self, bytes: &'de [u8]) -> Result<Blob, E> {
                let shared = READ.with_borrow(|read| {
                    let read = read.as_ref().filter(|_| bytes.len() >= LEAST)?;
                    let is_part = read.as_ptr_range().contains(&bytes.as_ptr());
                    is_part.then(|| read.slice_ref(bytes))
                });
                Ok(Blob(
                    shared.unwrap_or_else(|| Bytes::copy_from_slice(bytes)),
                ))
            }

            fn visit_bytes<E>(self, bytes: &[u8]) -> Result<Blob, E> {
                Ok(Blob(Bytes::copy_from_slice(bytes)))
            }

            fn visit_byte_buf<E>(self, bytes: Vec<u8>) -> Result<Blob, E> {
                Ok(Blob(bytes.into()))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut bytes: A) -> Result<Blob, A::Error> {
                // What the other side announces is believed only so far.
                let announced = bytes.size_hint().unwrap_or(0).min(LEAST);
                let mut all = Vec::with_capacity(announced);
                while let Some(byte) = bytes.next_element()? {
                    all.push(byte);
                }
                Ok(Blob(all.into()))
            }
        }
        deserializer.deserialize_bytes(BlobVisitor)
    }
}

/// The data of a message on its way over a link: bytes, and large blobs that belong in between.
#[derive(Debug, Clone, Default)]
pub struct Body {
    /// What stands before the first large blob: mostly all.
    bytes: Vec<u8>,
    /// That blob, and what follows it.
    rest: Vec<Bytes>,
}

impl Body {
    /// Whether there are no bytes.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many bytes it is.
    pub fn len(&self) -> usize {
        let rest = self.rest.iter().map(Bytes::len);
        self.bytes.len() + rest.sum::<usize>()
    }

    /// Appends all of it to `buffer`.
    pub fn append_to(&self, buffer: &mut Vec<u8>) {
        buffer.reserve(self.len());
        buffer.extend_from_slice(&self.bytes);
        self.rest
            .iter()
            .for_each(|part| buffer.extend_from_slice(part));
    }

    /// In one piece; without a copy where it is.
    pub fn into_vec(self) -> Vec<u8> {
        if self.rest.is_empty() {
            return self.bytes;
        }
        let mut all = Vec::new();
        self.append_to(&mut all);
        all
    }

    /// The same in parts that can be shared.
    #[must_use]
    pub fn shared(mut self) -> Self {
        if !self.bytes.is_empty() {
            self.rest.insert(0, std::mem::take(&mut self.bytes).into());
        }
        self
    }

    /// What stands before the parts that can be shared.
    pub fn start(&self) -> &[u8] {
        &self.bytes
    }

    /// The parts that can be shared.
    pub fn parts(&self) -> &[Bytes] {
        &self.rest
    }
}

impl From<Vec<u8>> for Body {
    fn from(bytes: Vec<u8>) -> Self {
        let rest = Vec::new();
        Self { bytes, rest }
    }
}

impl PartialEq for Body {
    fn eq(&self, other: &Self) -> bool {
        self.clone().into_vec() == other.clone().into_vec()
    }
}

impl Eq for Body {}

/// What `encode` writes; large blobs among it are shared instead of copied, where its output asks
/// [`collect`].
///
/// # Errors
/// Those of `encode`.
pub fn body_of<E>(encode: impl FnOnce() -> Result<Vec<u8>, E>) -> Result<Body, E> {
    let emptied = scopeguard::guard((), |()| COLLECTED.set(None));
    COLLECTED.set(Some(Vec::new()));
    let mut bytes = encode()?;
    let blobs = COLLECTED.take().unwrap_or_default();
    drop(emptied);
    let mut rest = Vec::new();
    for (place, blob) in blobs.into_iter().rev() {
        let behind = bytes.split_off(place.min(bytes.len()));
        rest.extend((!behind.is_empty()).then(|| behind.into()));
        rest.push(blob);
    }
    rest.reverse();
    Ok(Body { bytes, rest })
}

/// For an output to which `bytes` are written at `place`: whether they are a blob that was collected,
/// and need not be written.
pub fn collect(place: usize, bytes: &[u8]) -> bool {
    if bytes.len() < LEAST {
        return false;
    }
    let Some(lent) = LENT.take() else {
        return false;
    };
    if !std::ptr::eq(&raw const *lent, &raw const *bytes) {
        return false;
    }
    COLLECTED.with_borrow_mut(|collected| match collected {
        Some(collected) => {
            collected.push((place, lent));
            true
        }
        None => false,
    })
}

/// Lets the blobs in `bytes` be the same memory while `decode` reads it.
pub fn read_from<T>(bytes: Vec<u8>, decode: impl FnOnce(&[u8]) -> T) -> T {
    if bytes.len() < LEAST {
        return decode(&bytes);
    }
    let bytes = Bytes::from(bytes);
    let _emptied = scopeguard::guard((), |()| READ.set(None));
    READ.set(Some(bytes.clone()));
    decode(&bytes)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Data;

    type Pair = (u32, Blob, String, Blob);

    fn pair(sizes: [usize; 2]) -> Pair {
        let blob =
            |size: usize| Blob::from((0..size).map(|at| (at % 251) as u8).collect::<Vec<_>>());
        (7, blob(sizes[0]), "between".to_owned(), blob(sizes[1]))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn a_blob_looks_like_a_vector_whatever_its_size(sizes: [u16; 2]) {
            let blobs = pair(sizes.map(usize::from));
            let vectors = (blobs.0, blobs.1.to_vec(), blobs.2.clone(), blobs.3.to_vec());
            let wire = postcard::to_stdvec(&vectors).unwrap();
            prop_assert_eq!(&postcard::to_stdvec(&blobs).unwrap(), &wire);
            let body = Data::of(blobs.clone()).into_body().unwrap();
            prop_assert_eq!(body.len(), wire.len());
            let shared = body.clone().shared();
            let parts: Vec<u8> = shared.parts().iter().flatten().copied().collect();
            prop_assert!(shared.start().is_empty());
            prop_assert_eq!(&parts, &wire);
            let again = Data::from(body.clone()).take::<Pair>().unwrap();
            prop_assert_eq!(&again, &blobs);
            prop_assert_eq!(&Data::from(body.clone()).take::<(u32, Vec<u8>, String, Vec<u8>)>().unwrap(), &vectors);
            let mut appended = Vec::new();
            body.append_to(&mut appended);
            prop_assert_eq!(&appended, &wire);
            prop_assert_eq!(&body.into_vec(), &wire);
            prop_assert_eq!(Data::Bytes(wire).take::<Pair>().unwrap(), blobs);
            let json = serde_json::to_string(&vectors).unwrap();
            prop_assert_eq!(serde_json::from_str::<Pair>(&json).unwrap().1.to_vec(), vectors.1);
        }
    }

    #[test]
    fn a_large_blob_is_the_same_memory_before_and_behind_the_wire() {
        let sent = pair([LEAST, 3 * LEAST]);
        let places = [sent.1.as_ptr(), sent.3.as_ptr()];
        let body = Data::of(sent.clone()).into_body().unwrap();
        for place in places {
            assert!(body.parts().iter().any(|part| part.as_ptr() == place));
        }
        let wire = Data::of(sent).into_body().unwrap().into_vec();
        let range = wire.as_ptr_range();
        let (_, one, _, other) = Data::Bytes(wire).take::<Pair>().unwrap();
        assert!(range.contains(&one.as_ptr()) && range.contains(&other.as_ptr()));
    }

    #[test]
    fn nothing_is_lent_to_others_once_a_message_is_written_or_read() {
        drop(Data::of(pair([LEAST, LEAST])).into_body());
        assert!(Data::Bytes(vec![0xff; 2 * LEAST]).take::<Pair>().is_err());
        assert!(LENT.with_borrow(Option::is_none));
        assert!(READ.with_borrow(Option::is_none));
        assert!(COLLECTED.with_borrow(Option::is_none));
    }
}
