//! Bytes that go from process to process without being copied on the way through the runtime: images,
//! scans, recordings.
//!
//! To everybody else a [`Blob`] looks like a `Vec<u8>`: the same bytes on the wire, the same JSON. But a
//! vector goes through its serializer number by number, and a blob as a whole; and where a message is
//! written for a link, a large blob is not even copied: it is written to the link from where it is, and
//! the receiver's blob is the memory into which the link was read. Between processes that share memory not
//! even that: a blob that was made in the memory of its chassis ([`BlobMut`]) is read where it stands.
//!
//! How: a serializer sees a slice and cannot keep it. So a blob that is being serialized is lent, for
//! this thread and this moment, to the one who collects the bytes; and what a message is read from is
//! lent to the blobs in it. Nothing of that is left behind when the message is written or read.

use std::{
    cell::RefCell,
    fmt,
    ops::{Deref, DerefMut},
    sync::Arc,
};

use bytes::Bytes;
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{DeserializeOwned, SeqAccess, Visitor},
};

use crate::link::shm::pool::{Block, Pool};

/// Smaller ones are copied, bytes: that costs less than to keep account of them.
pub(crate) const LEAST: usize = 16 * 1024;

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
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Blob(Bytes);

thread_local! {
    /// The blob that is being serialized at this moment, for whoever collects.
    static LENT: RefCell<Option<Bytes>> = const { RefCell::new(None) };
    /// What was collected so far, with where in the other bytes it belongs; `None` when nobody does.
    static COLLECTED: RefCell<Option<Vec<(usize, Bytes)>>> = const { RefCell::new(None) };
    /// What is being read at this moment.
    static READ: RefCell<Option<Vec<Bytes>>> = const { RefCell::new(None) };
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

impl fmt::Debug for Blob {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Blob({} bytes)", self.0.len())
    }
}

/// Bytes that are written once and then sent. What [`crate::Context::blob`] makes stands in memory that
/// the other processes of the host can read, so that the data of a [`Blob`] that is made of it is not copied
/// on its way to them.
pub struct BlobMut(Place);

enum Place {
    /// In the chassis's shared memory.
    Pool(Block),
    Heap(Vec<u8>),
}

impl BlobMut {
    /// So many bytes, to be written, in `pool` if there is one that has room.
    pub(crate) fn of(pool: Option<&Arc<Pool>>, size: usize) -> Self {
        let block = pool
            .filter(|_| size >= LEAST)
            .and_then(|pool| pool.block(size));
        Self(match block {
            Some(block) => Place::Pool(block),
            None => Place::Heap(vec![0; size]),
        })
    }

    /// The blob: nothing is written to it any more.
    #[must_use]
    pub fn freeze(self) -> Blob {
        Blob(match self.0 {
            Place::Pool(block) => Bytes::from_owner(block),
            Place::Heap(bytes) => bytes.into(),
        })
    }
}

impl Deref for BlobMut {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match &self.0 {
            Place::Pool(block) => block,
            Place::Heap(bytes) => bytes,
        }
    }
}

impl DerefMut for BlobMut {
    fn deref_mut(&mut self) -> &mut [u8] {
        match &mut self.0 {
            Place::Pool(block) => block,
            Place::Heap(bytes) => bytes,
        }
    }
}

impl fmt::Debug for BlobMut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "BlobMut({} bytes)", self.len())
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
                    let mut read = read.iter();
                    let read = read.find(|read| read.as_ptr_range().contains(&bytes.as_ptr()))?;
                    Some(read.slice_ref(bytes))
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
    bytes: Vec<u8>,
    /// Each with the place in `bytes` before which it belongs; in that order.
    blobs: Vec<(usize, Bytes)>,
}

impl Body {
    /// How many bytes it is.
    pub(crate) fn len(&self) -> usize {
        let blobs = self.blobs.iter().map(|(_, blob)| blob.len());
        self.bytes.len() + blobs.sum::<usize>()
    }

    /// Bytes, and blobs with the place in the bytes before which each belongs. None when the places are not
    /// in order, or not all inside.
    pub(crate) fn of_parts(bytes: Vec<u8>, blobs: Vec<(usize, Bytes)>) -> Option<Self> {
        let places = || blobs.iter().map(|(place, _)| *place);
        let fits = places().is_sorted() && places().all(|place| place <= bytes.len());
        fits.then_some(Self { bytes, blobs })
    }

    /// The bytes, when they are in one piece.
    ///
    /// # Errors
    /// The body as it is, when blobs belong in between.
    pub(crate) fn into_bytes(self) -> Result<Vec<u8>, Self> {
        if self.blobs.is_empty() {
            Ok(self.bytes)
        } else {
            Err(self)
        }
    }

    /// Its pieces, in order.
    fn pieces(&self) -> impl Iterator<Item = &[u8]> {
        let mut taken = 0;
        let mut rest = self.bytes.as_slice();
        let blobs = self.blobs.iter().flat_map(move |(place, blob)| {
            let (before, after) = rest.split_at(place.saturating_sub(taken).min(rest.len()));
            taken = *place;
            rest = after;
            [before, blob.as_ref()]
        });
        let last = self.blobs.last().map_or(0, |(place, _)| *place);
        blobs.chain(self.bytes.get(last..))
    }

    /// Appends all of it to `buffer`.
    pub(crate) fn append_to(&self, buffer: &mut Vec<u8>) {
        buffer.reserve(self.len());
        self.pieces()
            .for_each(|piece| buffer.extend_from_slice(piece));
    }

    /// Reads exactly one `T`, whose blobs are the same memory.
    ///
    /// # Errors
    /// What postcard says, or how many bytes are left.
    pub(crate) fn read<T: DeserializeOwned>(&self) -> Result<T, BodyError> {
        let blobs = self.blobs.iter().map(|(_, blob)| blob.clone()).collect();
        let emptied = Emptied(&READ);
        READ.set(Some(blobs));
        let pieces: Vec<&[u8]> = self.pieces().filter(|piece| !piece.is_empty()).collect();
        let mut reader = postcard::Deserializer::from_flavor(Pieces {
            now: &[],
            left: self.len(),
            later: pieces.into_iter(),
        });
        let value = T::deserialize(&mut reader)?;
        let left = reader.finalize()?;
        drop(emptied);
        if left > 0 {
            return Err(BodyError::Left(left));
        }
        Ok(value)
    }

    /// In one piece; without a copy where it is.
    pub(crate) fn into_vec(self) -> Vec<u8> {
        if self.blobs.is_empty() {
            return self.bytes;
        }
        let mut all = Vec::new();
        self.append_to(&mut all);
        all
    }

    /// In its parts, the first apart from the others, of which there are mostly none.
    pub(crate) fn into_parts(self) -> (Bytes, Vec<Bytes>) {
        let mut rest = Bytes::from(self.bytes);
        let mut parts = Vec::new();
        let mut taken = 0;
        for (place, blob) in self.blobs {
            let before = rest.split_to(place.saturating_sub(taken).min(rest.len()));
            taken = place;
            parts.push(before);
            parts.push(blob);
        }
        if parts.is_empty() {
            return (rest, parts);
        }
        parts.push(rest);
        let first = parts.remove(0);
        parts.retain(|part| !part.is_empty());
        (first, parts)
    }
}

/// Data that is not what is expected.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BodyError {
    #[error(transparent)]
    Postcard(#[from] postcard::Error),
    #[error("{0} bytes too many")]
    Left(usize),
}

/// Several pieces, read one after the other. What is borrowed of them lies within one.
struct Pieces<'de> {
    now: &'de [u8],
    left: usize,
    later: std::vec::IntoIter<&'de [u8]>,
}

impl Pieces<'_> {
    /// Goes on to the next piece at the end of one.
    fn advance(&mut self) {
        if self.now.is_empty()
            && let Some(next) = self.later.next()
        {
            self.now = next;
        }
    }
}

impl<'de> postcard::de_flavors::Flavor<'de> for Pieces<'de> {
    type Remainder = usize;
    type Source = ();

    fn pop(&mut self) -> postcard::Result<u8> {
        self.advance();
        let (first, rest) = self
            .now
            .split_first()
            .ok_or(postcard::Error::DeserializeUnexpectedEnd)?;
        self.now = rest;
        self.left -= 1;
        Ok(*first)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.left)
    }

    fn try_take_n(&mut self, count: usize) -> postcard::Result<&'de [u8]> {
        if count > 0 {
            self.advance();
        }
        let taken = self.now.split_at_checked(count);
        let (taken, rest) = taken.ok_or(postcard::Error::DeserializeUnexpectedEnd)?;
        self.now = rest;
        self.left -= count;
        Ok(taken)
    }

    fn finalize(self) -> postcard::Result<usize> {
        Ok(self.left)
    }
}

impl From<Vec<u8>> for Body {
    fn from(bytes: Vec<u8>) -> Self {
        Self {
            bytes,
            blobs: Vec::new(),
        }
    }
}

impl PartialEq for Body {
    fn eq(&self, other: &Self) -> bool {
        self.clone().into_vec() == other.clone().into_vec()
    }
}

impl Eq for Body {}

/// Empties a place of this thread when what it was filled for is over, also by a panic.
struct Emptied<T: 'static>(&'static std::thread::LocalKey<RefCell<Option<T>>>);

impl<T> Drop for Emptied<T> {
    fn drop(&mut self) {
        self.0.set(None);
    }
}

/// What `encode` writes; large blobs among it are shared instead of copied, where its output asks
/// [`collect`].
///
/// # Errors
/// Those of `encode`.
pub(crate) fn body_of<E>(encode: impl FnOnce() -> Result<Vec<u8>, E>) -> Result<Body, E> {
    let emptied = Emptied(&COLLECTED);
    COLLECTED.set(Some(Vec::new()));
    let bytes = encode()?;
    let blobs = COLLECTED.take().unwrap_or_default();
    drop(emptied);
    Ok(Body { bytes, blobs })
}

/// For an output to which `bytes` are written at `place`: whether they are a blob that was collected,
/// and need not be written.
pub(crate) fn collect(place: usize, bytes: &[u8]) -> bool {
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
pub(crate) fn read_from<T>(bytes: Vec<u8>, decode: impl FnOnce(&[u8]) -> T) -> T {
    if bytes.len() < LEAST {
        return decode(&bytes);
    }
    let bytes = Bytes::from(bytes);
    let emptied = Emptied(&READ);
    READ.set(Some(vec![bytes.clone()]));
    let read = decode(&bytes);
    drop(emptied);
    read
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::message::Data;

    type Pair = (u32, Blob, String, Blob);

    fn pair(sizes: [usize; 2]) -> Pair {
        let blob =
            |size: usize| Blob::from((0..size).map(|at| (at % 251) as u8).collect::<Vec<_>>());
        (7, blob(sizes[0]), "between".to_owned(), blob(sizes[1]))
    }

    proptest! {
        #[test]
        fn a_blob_looks_like_a_vector_whatever_its_size(sizes: [u16; 2]) {
            let blobs = pair(sizes.map(usize::from));
            let vectors = (blobs.0, blobs.1.to_vec(), blobs.2.clone(), blobs.3.to_vec());
            let wire = postcard::to_stdvec(&vectors).unwrap();
            prop_assert_eq!(&postcard::to_stdvec(&blobs).unwrap(), &wire);
            let body = Data::of(blobs.clone()).into_body().unwrap();
            prop_assert_eq!(body.len(), wire.len());
            let (first, rest) = body.clone().into_parts();
            let parts: Vec<u8> = std::iter::once(first).chain(rest).flatten().collect();
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
        let (_, rest) = Data::of(sent.clone()).into_body().unwrap().into_parts();
        for place in places {
            assert!(rest.iter().any(|part| part.as_ptr() == place));
        }
        let wire = Data::of(sent).into_body().unwrap().into_vec();
        let range = wire.as_ptr_range();
        let (_, one, _, other) = Data::Bytes(wire).take::<Pair>().unwrap();
        assert!(range.contains(&one.as_ptr()) && range.contains(&other.as_ptr()));
    }

    proptest! {
        #[test]
        fn pieces_are_read_wherever_they_are_cut(
            text in ".{0,60}", numbers in proptest::collection::vec(any::<u64>(), 0..20),
            cuts in proptest::collection::vec(any::<prop::sample::Index>(), 0..6),
        ) {
            let value = (text, numbers, 7_u8);
            let wire = postcard::to_stdvec(&value).unwrap();
            let mut cuts: Vec<usize> = cuts.iter().map(|cut| cut.index(wire.len() + 1)).collect();
            cuts.sort_unstable();
            // Every other piece is lent.
            let (mut bytes, mut blobs, mut from) = (Vec::new(), Vec::new(), 0);
            for (number, to) in cuts.into_iter().chain([wire.len()]).enumerate() {
                if number % 2 == 0 {
                    bytes.extend_from_slice(&wire[from..to]);
                } else {
                    blobs.push((bytes.len(), Bytes::copy_from_slice(&wire[from..to])));
                }
                from = to;
            }
            let body = Body::of_parts(bytes, blobs).unwrap();
            prop_assert_eq!(Data::from(body.clone()).take::<(String, Vec<u64>, u8)>().unwrap(), value);
            prop_assert!(Data::from(body).take::<(String, Vec<u64>)>().is_err());
        }
    }

    #[test]
    fn parts_that_do_not_fit_together_are_none() {
        let blob = |place: usize| (place, Bytes::from_static(b"x"));
        assert!(Body::of_parts(vec![1, 2], vec![blob(0), blob(2)]).is_some());
        assert!(Body::of_parts(vec![1, 2], vec![blob(2), blob(0)]).is_none());
        assert!(Body::of_parts(vec![1, 2], vec![blob(3)]).is_none());
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
